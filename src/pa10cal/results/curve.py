"""`curve.json`: a chain of links on a continuous curve."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar

from pydantic import Field, JsonValue

from pa10cal.results.record import Key, Part, Record


class CurveShape(Part):
    """One shape of the chain."""

    time_s: float = Field(description="when it has this shape [s]")
    ending: str = Field(description="how the chain ends on the curve, in a word")
    ending_is: str = Field(description="the same in words")
    left_m: float = Field(description="length of the curve that remains beyond the chain [m]")
    gap_m: float = Field(description="distance from the chain's end to the curve's end [m]")
    touches: tuple[int, ...] = Field(description="links that only touch the curve, from 1")
    open_joints: tuple[int, ...] = Field(
        description="joints whose first turn is undetermined, from 1"
    )
    roll_deg: float = Field(description="roll of the first link [deg]")
    largest_angle_deg: float = Field(description="largest joint angle [deg]")
    chord_error: float = Field(description="largest relative error of a link's length")
    forward_kinematics_error_m: float = Field(
        description="largest distance between links laid and forward kinematics [m]"
    )


class CurveRecord(Record):
    """`curve.json`."""

    SCHEMA: ClassVar[str] = "pa10cal-curve/1"
    FILE: ClassVar[str] = "curve.json"
    COMMAND: ClassVar[str] = "curve"

    link_m: float = Field(description="length of a link [m]")
    links: int = Field(description="number of links")
    order: str = Field(description="which turn of a joint comes first: `zy` or `yz`")
    largest_angle_deg: float = Field(description="largest joint angle of all shapes [deg]")
    largest_move_deg: float = Field(
        description="largest move of a joint from one shape to the next [deg]"
    )
    feasible_rolls_deg: tuple[tuple[float, float], ...] | None = Field(
        description="rolls that keep all joints within limits [deg]; null without limits"
    )
    shapes: tuple[CurveShape, ...] = Field(description="every shape")
    settings: Mapping[Annotated[str, Key("option")], JsonValue] = Field(
        description="settings of the curve"
    )
