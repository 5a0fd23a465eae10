"""Options of a curve laid with links, and of the study that calibrates such a chain."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, FiniteFloat, model_validator

from pa10cal.options import Positive, Section


class LineShape(Section):
    """A straight line."""

    shape: Literal["line"] = Field(description="a straight line")
    length_m: Positive = Field(description="its length")


class CircleShape(Section):
    """An arc of a circle."""

    shape: Literal["circle"] = Field(description="an arc of a circle")
    radius_m: Positive = Field(description="its radius")
    angle_deg: Positive = Field(360.0, description="how far it goes round")


class HelixShape(Section):
    """A helix; rolling, its links turn about themselves (`gait.moves: roll`)."""

    shape: Literal["helix"] = Field(description="a helix")
    radius_m: Positive = Field(description="its radius")
    pitch_m: FiniteFloat = Field(description="what it rises in one turn")
    turns: Positive = Field(description="how many turns it has")
    phase_deg: FiniteFloat = Field(0.0, description="angle at which it begins")


class SerpenoidShape(Section):
    """A serpenoid curve."""

    shape: Literal["serpenoid"] = Field(description="a serpenoid curve")
    length_m: Positive = Field(description="its length along the curve")
    waves: Positive = Field(description="how many waves it has")
    amplitude_deg: Positive = Field(description="largest angle of its tangent")
    phase_deg: FiniteFloat = Field(0.0, description="phase at which it begins")


Shape = Annotated[
    LineShape | CircleShape | HelixShape | SerpenoidShape, Field(discriminator="shape")
]
_Range = tuple[FiniteFloat, FiniteFloat]


class LimitOptions(Section):
    """Limits of every joint [deg]."""

    a_deg: _Range = Field(
        (-180.0, 180.0), description="of the rotation about z, whatever the order"
    )
    b_deg: _Range = Field((-180.0, 180.0), description="of the rotation about y")


class GaitOptions(Section):
    """How the shape moves."""

    moves: Literal["wave", "roll", "along"] = Field(
        description="wave: the shape's phase travels; roll: the shape stays, the links turn; "
        "along: the shape stays, the links follow it as a snake its path"
    )
    period_s: FiniteFloat | None = Field(
        None, description="of a wave or a turn; negative: backwards"
    )
    speed_m_s: Positive | None = Field(
        None, description="with moves: along, at which the first link's beginning follows the curve"
    )
    seconds: Positive = Field(description="how long it moves")
    shapes: Annotated[int, Field(ge=2, le=2000)] = Field(
        50, description="number of shapes that are computed over these seconds"
    )
    move_deg: Annotated[FiniteFloat, Field(ge=0)] = Field(
        0.0,
        description="largest move of a joint between successive shapes that is accepted to make "
        "the largest angle smaller; 0: the roll that moves least",
    )


class CurveOptions(Section):
    """Settings of `pa10cal curve`: a curve approximated by straight links with two-axis joints."""

    curve: Shape | None = Field(None, description="a shape by name, where no points are given")
    through: Literal["spline", "closed_spline", "straight"] = Field(
        "spline", description="what joins given points"
    )
    link_m: Positive | None = Field(None, description="length of a link; else equal links are laid")
    links: Annotated[int, Field(ge=1)] | None = Field(None, description="how many, at most")
    order: Literal["zy", "yz"] = Field("zy", description="which turn of a joint comes first")
    roll: Literal["smallest_angle", "most_room", "given", "of_last"] = Field(
        "smallest_angle",
        description="how the links are turned about the curve: for the smallest angles, the most "
        "room within limits, by roll_deg, or by z_of_last",
    )
    roll_deg: FiniteFloat = Field(0.0, description="with roll: given; at the start where it rolls")
    z_of_last: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = Field(
        (0.0, 0.0, 1.0), description="with roll: of_last, where z of the last link is to point"
    )
    limits: LimitOptions | None = Field(None, description="limits of every joint")
    gait: GaitOptions | None = Field(None, description="how the shape moves, where it does")
    arm: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,60}$")] | None = Field(
        None, description="name under which the chain, its first link fixed, is described as an arm"
    )

    @model_validator(mode="after")
    def _whole(self) -> CurveOptions:
        if self.link_m is None and self.links is None:
            raise ValueError("link_m, links, or both")
        if self.roll == "most_room" and self.limits is None:
            raise ValueError("limits, where the roll is to leave the most room within them")
        gait = self.gait
        rolling = gait is not None and gait.moves == "roll"
        if self.roll_deg and self.roll != "given" and not rolling:
            raise ValueError("roll: given, where roll_deg is stated")
        if self.roll != "of_last" and self.z_of_last != (0.0, 0.0, 1.0):
            raise ValueError("roll: of_last, where z_of_last is stated")
        if self.curve is not None and self.through != "spline":
            raise ValueError("through for points alone, no shape by name")
        if self.arm is not None and self.links is not None and self.links < 2:
            raise ValueError("two links or more, where the chain is an arm")
        if gait is None:
            return self
        if gait.move_deg and (rolling or self.roll == "given"):
            raise ValueError("a wave or along, at roll smallest_angle, where move_deg is stated")
        if self.link_m is None or self.links is None or self.links < 2:
            raise ValueError("link_m and two links or more, where the shape moves")
        along = gait.moves == "along"
        if along != (gait.speed_m_s is not None) or along != (gait.period_s is None):
            raise ValueError("gait.speed_m_s with moves: along, else gait.period_s")
        if gait.period_s == 0.0:
            raise ValueError("a period other than 0, where the shape moves")
        if gait.moves == "wave" and not isinstance(self.curve, HelixShape | SerpenoidShape):
            raise ValueError("a shape with a phase (helix, serpenoid), where a wave is to travel")
        if self.roll not in ("smallest_angle", "given"):
            raise ValueError("roll smallest_angle or given, where the shape moves")
        return self


class CurveStudyOptions(Section):
    """Calibration of a chain of links on two-axis joints, posed along curves, in the cell."""

    random_seed: Annotated[int, Field(ge=0)] = Field(
        2008, description="draws postures, individuals and noise"
    )
    individuals: Annotated[int, Field(ge=1)] = Field(
        10, description="arms calibrated that depart by their rows, and as many in any way"
    )
    links: Annotated[int, Field(ge=2, le=50)] = Field(
        6, description="of the chain; twice as many joints"
    )
    link_m: Positive = Field(0.15, description="length of a link")
    limit_deg: Annotated[FiniteFloat, Field(ge=10, le=120)] = Field(
        75.0, description="how far every joint turns, either way"
    )
    postures: Annotated[int, Field(ge=4)] = Field(
        120, description="shapes along splines, helices and travelling waves in turn, at any roll"
    )
    holdout_share: Annotated[FiniteFloat, Field(gt=0, lt=1)] = Field(
        0.25, description="share of them held out, the last ones"
    )
    position_mm: Annotated[FiniteFloat, Field(ge=1e-5)] = Field(
        0.05, description="noise of a coordinate, and its stated uncertainty"
    )
    attitude_rad: Annotated[FiniteFloat, Field(ge=1e-8)] = Field(
        2e-4, description="noise of an orientation about each axis, and its stated uncertainty"
    )

    @model_validator(mode="after")
    def _some_held_out(self) -> Self:
        if not round(self.holdout_share * self.postures):
            raise ValueError("a holdout_share that holds out one posture or more")
        return self
