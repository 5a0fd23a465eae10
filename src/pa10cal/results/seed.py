"""`seed/base_frame.json`: base frame, and targets where the instrument's own are not stated."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from pa10cal.results.record import Key, Matrix3, MeasuredRecord, Part, PoseMatrix, Vector3, optional


class StraightLine(Part):
    """A straight move as it was measured."""

    direction_instr: Vector3 = Field(description="its direction in the instrument's frame")
    direction_u_rad: float = Field(description="standard uncertainty of the direction [rad]")
    length_mm: float = Field(description="its length [mm]")
    bend_rms_mm: float = Field(description="root mean square distance from the line [mm]")
    points: int = Field(description="points measured along it")


class BaseFrameRecord(MeasuredRecord):
    """`seed/base_frame.json`."""

    SCHEMA: ClassVar[str] = "pa10cal-base-frame/1"
    FILE: ClassVar[str] = "seed/base_frame.json"
    COMMAND: ClassVar[str] = "seed"

    method: Literal[
        "straight_lines",
        "rigid_fit_nominal",
        "hand_eye_poses",
        "hand_eye_points",
        "ranging",
        "nominal_arm",
    ] = Field(description="how the frame was found")
    R_instr_base: Matrix3 = Field(description="attitude of the base in the instrument's frame")
    origin_instr_m: Vector3 = Field(description="origin of the base in the instrument's frame [m]")
    T_instr_base: PoseMatrix = Field(description="both as a homogeneous matrix [m]")
    x_direction_u_rad: float | None = optional("standard uncertainty of the x axis [rad]")
    y_direction_u_rad: float | None = optional("standard uncertainty of the y axis [rad]")
    line_x: StraightLine | None = optional("the straight move along x")
    line_y: StraightLine | None = optional("the straight move along y")
    angle_between_lines_deg: float | None = optional("angle between the straight moves [deg]")
    attitude_scatter_rad: float | None = optional("root mean square attitude residual [rad]")
    T_ee_target: PoseMatrix | None = optional("the target in the end-effector frame [m]")
    T_ee_target_of: Mapping[Annotated[str, Key("campaign")], PoseMatrix] | None = optional(
        "of a group, the target of each campaign in the end-effector frame [m]"
    )
    p_ee_targets_m: Mapping[Annotated[str, Key("target")], Vector3] | None = optional(
        "places of the targets in the end-effector frame [m]"
    )
    p_base_point_m: Vector3 | None = optional("the instrument's fixed point in the base frame [m]")
    held_as_stated: tuple[str, ...] | None = optional(
        "what the data do not identify, held at its stated or starting value"
    )
    target_stated: bool | None = optional("whether the campaign states the places of its targets")
    origin_scatter_mm: float = Field(description="root mean square position residual [mm]")
    origin_poses: int = Field(description="poses that the origin stands on")
    origin_from: str = Field(description="which poses they are")
