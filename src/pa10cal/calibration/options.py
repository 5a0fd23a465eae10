"""Options of both calibrations: the paper's two levels, and the general model."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from pa10cal.errors import remedy_for
from pa10cal.options import NonNegative, Positive, Section, Tolerances

#: Arm of the paper, on whose flange the balls are known.
PAPERS_ARM = "pa10_6ce"


def takes_general_model(model: str, *, robot: str, from_touches: bool) -> bool:
    """Return whether load cases are computed with the general model.

    Args:
        model: `calibration.model` of the settings.
        robot: name of the arm. On another one than the paper's, balls are where somebody mounted
            them: the paper's model, which takes them as stated, is then off by the mounting.
        from_touches: whether the instrument touches balls, as the paper's does.
    """
    papers = from_touches and robot == PAPERS_ARM
    return model == "general" or (model == "auto" and not papers)


class EffectOfPlace(Section):
    """An effect to calibrate with."""

    id: str = Field(description="of the vocabulary of effects, such as transmission_error")
    of: str = Field(description="where it sits: joint 2, forearm, base, ...")

    @field_validator("id")
    @classmethod
    def _known(cls, name: str) -> str:
        from pa10cal.terms.effects.vocabulary import every_effect  # late: it needs numpy

        known = [effect.id for effect in every_effect()]
        if name not in known:
            remedy = remedy_for(name, known, "correct the id")
            raise ValueError(f"one of {', '.join(known)}; {remedy}")
        return name


class GeneralOptions(Section):
    """What belongs to the general model alone, for any arm and instrument."""

    springs: tuple[Annotated[int, Field(ge=1)], ...] | Literal["auto"] = Field(
        "auto",
        description="a list of joints from 1, those with a linear spring; or auto: those whose "
        "torque varies",
    )
    robust: bool = Field(True, description="poses far outside the scatter weigh less")


class CalibrationOptions(Section):
    """The two-level calibration, equations (1)-(4), and the general one."""

    model: Literal["auto", "paper", "general"] = Field(
        "auto",
        description="paper, general, or auto: the paper's where balls are touched on its arm, "
        "pa10_6ce, else the general one",
    )
    general: GeneralOptions = Field(
        GeneralOptions(), description="the general model, for any arm and instrument"
    )
    effects: tuple[EffectOfPlace, ...] | Literal["named"] = Field(
        (),
        description="effects to calibrate with: {id, of} each; or named: those of the verdict",
    )
    prior: str | None = Field(
        None,
        description="model.yaml of the same arm to start from, as after a crash or with a new "
        "tool; null for none",
    )
    wanted_uncertainty_mm: Positive | None = Field(
        None,
        description="required standard uncertainty of predicted positions; null: none",
    )
    epsilon: NonNegative = Field(1.6e-4, description="weight of the tolerance terms")
    epsilon_acts_on: Literal["residual", "cost"] = Field(
        "residual", description="what epsilon multiplies"
    )
    tolerance_terms: Literal["null_space", "all"] = Field(
        "null_space",
        description="null_space: only on directions not identifiable; all: on every departure, as "
        "printed",
    )
    tolerances: Tolerances = Field(
        Tolerances(), description="manufacturing tolerances that scale the departures"
    )
    inner_poses: Annotated[int, Field(ge=1)] | Literal["all"] = Field(
        8, description="M: poses of the inner level, or all"
    )
    flexible_joints: tuple[Annotated[int, Field(ge=1)], ...] = Field(
        (2, 3, 5), description="joints with a cubic spring; the others are rigid"
    )
    r_max_m: Positive = Field(1.0, description="length that normalises positions")
    starts: Annotated[int, Field(ge=1)] = Field(8, description="initial guesses tried")
    random_seed: Annotated[int, Field(ge=0)] = Field(20080427, description="of the starts")
    max_iterations: Annotated[int, Field(ge=1)] = Field(
        200, description="of the outer level, for each start"
    )
    apparatus_uncertainty_mm: NonNegative = Field(
        0.005,
        description="standard uncertainty of a tooling ball's place on the apparatus, per axis",
    )

    def with_springs(self, joints: tuple[int, ...]) -> CalibrationOptions:
        """Return these options with linear springs at the joints given, for the general model."""
        general = self.general.model_copy(update={"springs": joints})
        return self.model_copy(update={"general": general})

    @field_validator("flexible_joints")
    @classmethod
    def _each_once(cls, joints: tuple[int, ...]) -> tuple[int, ...]:
        if len(set(joints)) < len(joints):
            raise ValueError("each joint once")
        return joints
