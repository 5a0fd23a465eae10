"""What the stage `curve` is asked for: a shape, links, a roll, limits, and how it moves."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from pa10cal.curve.curve import Curve
from pa10cal.curve.feasible import JointLimits
from pa10cal.curve.shapes import circle, helix, line, serpenoid
from pa10cal.settings_section import Positive, Section


class LineShape(Section):
    """A straight line."""

    shape: Literal["line"]
    length_m: Positive


class CircleShape(Section):
    """An arc of a circle."""

    shape: Literal["circle"]
    radius_m: Positive
    angle_deg: Positive = 360.0


class HelixShape(Section):
    """A helix; rolling, its links turn about themselves (`gait.moves: roll`)."""

    shape: Literal["helix"]
    radius_m: Positive
    pitch_m: FiniteFloat
    turns: Positive
    phase_deg: FiniteFloat = 0.0


class SerpenoidShape(Section):
    """A serpenoid curve."""

    shape: Literal["serpenoid"]
    length_m: Positive
    waves: Positive
    amplitude_deg: Positive
    phase_deg: FiniteFloat = 0.0


Shape = Annotated[
    LineShape | CircleShape | HelixShape | SerpenoidShape, Field(discriminator="shape")
]
_Range = tuple[FiniteFloat, FiniteFloat]


class LimitSettings(Section):
    """Limits of every joint [deg]."""

    a_deg: _Range = (-180.0, 180.0)
    b_deg: _Range = (-180.0, 180.0)


class GaitSettings(Section):
    """How the shape moves."""

    moves: Literal["wave", "roll"] = Field(
        description="wave: the shape's phase travels; roll: the shape stays, the links turn"
    )
    period_s: Annotated[FiniteFloat, Field(description="of a wave or a turn; negative: backwards")]
    seconds: Positive
    shapes: Annotated[int, Field(ge=2, le=2000)] = Field(50, description="moments worked out")
    move_deg: Annotated[FiniteFloat, Field(ge=0)] = Field(
        0.0, description="move of a joint from one moment to the next, for smaller angles"
    )


class CurveSettings(Section):
    """A curve as links."""

    curve: Shape | None = Field(None, description="a shape by name, where no points are given")
    through: Literal["spline", "closed_spline", "straight"] = Field(
        "spline", description="what goes through points"
    )
    link_m: Positive | None = Field(None, description="length of a link; else equal links are laid")
    links: Annotated[int, Field(ge=1)] | None = Field(None, description="how many, at most")
    order: Literal["zy", "yz"] = Field("zy", description="which turn of a joint comes first")
    roll: Literal["smallest_angle", "most_room", "given", "of_last"] = "smallest_angle"
    roll_deg: FiniteFloat = Field(0.0, description="with roll: given; at the start where it rolls")
    z_of_last: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = Field(
        (0.0, 0.0, 1.0), description="with roll: of_last, where z of the last link is to point"
    )
    limits: LimitSettings | None = None
    gait: GaitSettings | None = None

    @model_validator(mode="after")
    def _whole(self) -> CurveSettings:
        if self.link_m is None and self.links is None:
            raise ValueError("link_m, links, or both")
        if self.roll == "most_room" and self.limits is None:
            raise ValueError("limits, where the roll is to leave the most room within them")
        if self.gait is not None:
            self._check_gait(self.gait)
        return self

    def _check_gait(self, gait: GaitSettings) -> None:
        if self.link_m is None or self.links is None or self.links < 2:
            raise ValueError("link_m and two links or more, where the shape moves")
        if gait.period_s == 0.0:
            raise ValueError("a period other than 0, where the shape moves")
        if gait.moves == "wave" and not isinstance(self.curve, HelixShape | SerpenoidShape):
            raise ValueError("a shape with a phase (helix, serpenoid), where a wave is to travel")
        if self.roll not in ("smallest_angle", "given"):
            raise ValueError("roll smallest_angle or given, where the shape moves")


def shape_of(shape: Shape, phase_rad: float = 0.0) -> Curve:
    """Return a shape, its phase (where it has one) ahead by so much."""
    if isinstance(shape, LineShape):
        return line(shape.length_m)
    if isinstance(shape, CircleShape):
        return circle(shape.radius_m, np.radians(shape.angle_deg))
    phase_rad += np.radians(shape.phase_deg)
    if isinstance(shape, HelixShape):
        return helix(shape.radius_m, shape.pitch_m, shape.turns, phase_rad)
    amplitude_rad = np.radians(shape.amplitude_deg)
    return serpenoid(shape.length_m, shape.waves, amplitude_rad, phase_rad)


def limits_of(settings: CurveSettings, joints: int) -> JointLimits | None:
    """Return the limits of every joint, None where there are none."""
    if settings.limits is None:
        return None
    a_rad, b_rad = np.radians([settings.limits.a_deg, settings.limits.b_deg])
    return JointLimits(np.tile(a_rad, (joints, 1)), np.tile(b_rad, (joints, 1)))
