"""Options of a plan: where arm and instrument may be, what is measured, how poses are chosen."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, FiniteFloat, ValidationInfo, field_validator

from pa10cal.options import NonNegative, Positive, Section

Triple = tuple[FiniteFloat, FiniteFloat, FiniteFloat]


class KeepOutBox(Section):
    """A box along the axes of the robot's base that arm, tool and lines of sight stay out of."""

    min_mm: Triple = Field(description="its least corner, in the robot's base frame")
    max_mm: Triple = Field(description="its largest corner")
    name: str = Field("box", description="what it is, for messages")

    @field_validator("max_mm")
    @classmethod
    def _has_a_volume(cls, high: Triple, info: ValidationInfo) -> Triple:
        low = info.data.get("min_mm", high)
        if any(least >= largest for least, largest in zip(low, high, strict=True)):
            raise ValueError(f"a volume: every coordinate above that of min_mm, {low}")
        return high


class KeepOut(Section):
    """Boxes to keep out of."""

    boxes: tuple[KeepOutBox, ...] = Field((), description="list of {min_mm, max_mm, name}")


class PlanOptions(Section):
    """A plan of poses to measure."""

    workspace_mm: tuple[Triple, Triple] | None = Field(
        None, description="corners of a box, in the base frame, that the target stays in"
    )
    reach_mm: Positive | None = Field(
        None, description="radius of a sphere about the base's origin that the target stays in"
    )
    keep_out: tuple[KeepOutBox, ...] = Field(
        (), description="boxes {min_mm, max_mm, name} that arm, tool and lines of sight avoid"
    )
    instrument_at_mm: Triple | None = Field(
        None, description="where the instrument is, in the base frame; lines of sight need it"
    )
    facing_deg: Annotated[FiniteFloat, Field(gt=0, le=180)] | None = Field(
        None,
        description="largest angle between the end-effector's z axis and the way from a target to "
        "the instrument",
    )
    floor_mm: FiniteFloat | None = Field(
        0.0, description="the tool stays above this height over the base's origin; none: anywhere"
    )
    limit_margin: Annotated[FiniteFloat, Field(ge=0, lt=0.5)] = Field(
        0.05, description="part of each joint's range that is not used, at either end"
    )
    largest_angle_deg: Positive = Field(
        180.0, description="turning joints go no further from zero than this"
    )
    joints_deg: tuple[tuple[FiniteFloat, FiniteFloat], ...] = Field(
        (),
        description="least and largest position of every joint [deg; mm of a sliding joint], in "
        "place of the arm's limits and the two keys above",
    )
    targets_mm: tuple[Triple, ...] = Field(
        (),
        description="places of the targets on the end-effector; none: three of an instrument that "
        "sees several, else one, 100 mm in front of the flange",
    )
    uncertainty_mm: Positive = Field(
        0.05, description="standard uncertainty of a measured coordinate or distance"
    )
    attitude_mrad: Positive | None = Field(
        None,
        description="standard uncertainty of a measured orientation; none: a place's over 0.1 m",
    )
    loads_N: tuple[NonNegative, ...] = Field(
        (0.0,), min_length=1, description="external loads; every pose is measured under each"
    )
    tool_kg: NonNegative | None = Field(
        None, description="mass of the tool; none: not known, an unknown where joints have springs"
    )
    tool_com_mm: Triple = Field(
        (0.0, 0.0, 0.0), description="centre of mass of the tool, and where loads hang"
    )
    gravity_m_s2: Triple = Field((0.0, 0.0, -9.81), description="along the axes of the base")
    effects: Annotated[FiniteFloat, Field(ge=0, le=1)] = Field(
        0.2,
        description="what telling missing effects apart counts, against the model's parameters; "
        "0: parameters alone",
    )
    candidates: Annotated[int, Field(ge=10)] = Field(
        1000, description="poses from which the plan is chosen"
    )
    random_seed: Annotated[int, Field(ge=0)] = Field(2008, description="draws these")

    @field_validator("workspace_mm")
    @classmethod
    def _has_a_volume(cls, corners: tuple[Triple, Triple] | None) -> tuple[Triple, Triple] | None:
        if corners is not None and any(a == b for a, b in zip(*corners, strict=True)):
            raise ValueError("a box with a volume: corners that differ in x, y and z")
        return corners
