"""Base frame from moves along the robot's x and y axes, equations (5)-(7) of the paper."""

from __future__ import annotations

import math

import numpy as np

from pa10cal.arrays import Array, homogeneous
from pa10cal.errors import CalibrationError
from pa10cal.options import BaseFrameOptions
from pa10cal.results.calibration import BaseFrameRecord, StraightLine

#: Positions of the same poses as measured and as the nominal model has them.
Positions = tuple[Array, Array]


def frame_fields(T_instr_base: Array) -> dict[str, Array]:
    """Return a base frame (4, 4) as `BaseFrameRecord` has it."""
    return {
        "R_instr_base": T_instr_base[:3, :3],
        "origin_instr_m": T_instr_base[:3, 3],
        "T_instr_base": T_instr_base,
    }


def fit_line(p_instr_m: Array, travel_m: Array, name: str = "straight move") -> StraightLine:
    """Fit a line to points by least squares of their distances from it.

    Args:
        p_instr_m: (N, 3) measured points, N >= 3.
        travel_m: (N,) the robot's own coordinate along the move at each point; gives the sense.
        name: of the move, for messages.

    Returns:
        The line. Its direction follows `travel_m`, in whatever order the points come.

    Raises:
        CalibrationError: with fewer than three points.
    """
    count = len(p_instr_m)
    if count < 3:
        raise CalibrationError(
            "too few points for a line and its uncertainty",
            where=name,
            value=count,
            allowed="at least 3 measured points",
            remedy="measure more points along the move",
        )
    offsets = p_instr_m - p_instr_m.mean(axis=0)
    direction = np.linalg.svd(offsets, full_matrices=False)[2][0]
    along = offsets @ direction
    if along @ (travel_m - travel_m.mean()) < 0.0:
        direction, along = -direction, -along
    across = offsets - np.outer(along, direction)
    square = float((across**2).sum())
    scatter = np.sqrt(square / (2 * (count - 2)))  # two axes across, N - 2 dof each
    spread = float(np.sqrt((along**2).sum()))
    return StraightLine(
        direction_instr=direction,
        length_mm=1e3 * float(np.ptp(along)),
        bend_rms_mm=1e3 * float(np.sqrt(square / count)),
        direction_u_rad=float(scatter / spread) if spread > 0.0 else float("inf"),
        points=count,
    )


def axes_from_lines(x_instr: Array, y_instr: Array) -> Array:
    """Return R_instr_base (3, 3) from the directions of the two moves.

    z = x × y (5), y = z × x (6), R = [x y z] (7). x is kept as measured, z is normalised, since
    the measured lines are not exactly perpendicular.
    """
    x = x_instr / np.linalg.norm(x_instr)
    z = np.cross(x, y_instr)
    z /= np.linalg.norm(z)
    return np.column_stack([x, np.cross(z, x), z])


def seed_from_lines(
    x_move: Positions,
    y_move: Positions,
    origin_poses: Positions,
    options: BaseFrameOptions,
    **measured: str,
) -> BaseFrameRecord:
    """Find the base frame: axes from the straight moves, origin from the nominal model.

    The origin is the mean over the given poses of p_instr_ee - R_instr_base p_base_ee.

    Args:
        x_move: end-effector positions of the move along x, (N, 3) each [m]: measured in the
            instrument's frame, and the nominal model's in the base frame for the same poses.
        y_move: the same for the move along y.
        origin_poses: the same for the poses that fix the origin.
        options: what the moves must satisfy.
        measured: campaign, provenance and `origin_from` of the record.

    Raises:
        CalibrationError: when a move has fewer than three points, is too short or bent, or the
            two are parallel.
    """
    line_x = _checked_line(x_move[0], x_move[1][:, 0], "line_x", options)
    line_y = _checked_line(y_move[0], y_move[1][:, 1], "line_y", options)
    x, y = line_x.direction_instr, line_y.direction_instr
    angle = float(np.arctan2(np.linalg.norm(np.cross(x, y)), x @ y))
    least = options.min_angle_deg
    if not np.radians(least) <= angle <= np.pi - np.radians(least):
        raise CalibrationError(
            "the straight moves are too close to parallel",
            where="line_x and line_y",
            value=f"{np.degrees(angle):.2f} deg",
            allowed=f"an angle of {least:g} to {180 - least:g} deg between them",
            remedy="check the labels line_x and line_y, or move along two perpendicular axes",
        )
    R_instr_base = axes_from_lines(x, y)
    p_instr_m, p_base_m = origin_poses
    origins = p_instr_m - p_base_m @ R_instr_base.T
    T_instr_base = homogeneous(R_instr_base, origins.mean(axis=0))
    scatter = np.sqrt(((origins - T_instr_base[:3, 3]) ** 2).sum(axis=1).mean())
    return BaseFrameRecord(
        **measured,
        method="straight_lines",
        **frame_fields(T_instr_base),
        x_direction_u_rad=line_x.direction_u_rad,
        y_direction_u_rad=line_y.direction_u_rad,
        line_x=line_x,
        line_y=line_y,
        angle_between_lines_deg=math.degrees(angle),
        origin_scatter_mm=1e3 * float(scatter),
        origin_poses=len(origins),
    )


def _checked_line(
    p_instr_m: Array, travel_m: Array, where: str, options: BaseFrameOptions
) -> StraightLine:
    line = fit_line(p_instr_m, travel_m, where)
    if line.length_mm < options.min_length_mm:
        raise CalibrationError(
            "the straight move is too short",
            where=where,
            value=f"{line.length_mm:.3f} mm",
            allowed=f"at least {options.min_length_mm:g} mm (base_frame.min_length_mm)",
            remedy="measure a longer move",
        )
    if line.bend_rms_mm > options.max_bend_mm:
        raise CalibrationError(
            "the straight move is bent",
            where=where,
            value=f"{line.bend_rms_mm:.3f} mm rms from the line",
            allowed=f"at most {options.max_bend_mm:g} mm (base_frame.max_bend_mm)",
            remedy="check for a point of another move, or measure the move again",
        )
    return line
