"""The base frame in the instrument's frame, and positions of targets, before any calibration.

Straight moves along the base's x and y axes give its directions by equations (5)-(7) of the paper;
without them the nominal arm is fitted to the measurements. Both use the poses at the lowest load
(of a target that is not seen there, at the lowest at which it is), or where these are few those at
every load.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, homogeneous
from pa10cal.errors import CalibrationError
from pa10cal.observe.observations import Observations, average_repeats
from pa10cal.observe.time_order import campaign_numbers
from pa10cal.options import BaseFrameOptions
from pa10cal.results.calibration import BaseFrameRecord, StraightLine

_UNLOADED, _EVERY_LOAD = "grid poses at the lowest load", "grid poses at every load"
_UNLOADED_OF_EACH = "grid poses at the lowest load of every target"


@dataclass(frozen=True)
class EndPositions:
    """Positions of the end-effector in N poses."""

    measured_instr_m: Array  # (N, 3) in the instrument's frame
    nominal_base_m: Array  # (N, 3) by the nominal arm, in the base's frame


def locate_base(
    every: Observations,
    arm: Arm,
    options: BaseFrameOptions,
    where: Path | str,
    campaign: str,
    provenance: str,
) -> BaseFrameRecord:
    """Find base frame and targets.

    Args:
        where: the table that the readings are of, for messages.

    Raises:
        CalibrationError: when there is one straight move only, one is too short, bent or along
            another axis, or the poses do not determine base and targets.
    """
    chain = Chain.of(arm)
    grid = average_repeats(every.of_kind("grid"))
    rows = least_loaded(grid)
    unloaded = grid.take(rows)
    origin_from = _UNLOADED_OF_EACH
    if np.array_equal(rows, _at_lowest_load(grid)):
        origin_from = _UNLOADED
    elif rows.all():
        origin_from = _EVERY_LOAD
    line_x, line_y = (average_repeats(every.of_kind(kind)) for kind in ("line_x", "line_y"))
    if every.measured.uses_lines:
        _refuse_one_move(len(line_x), len(line_y), where)
    T_base_ee = chain.forward(unloaded.states.q_rad)
    if not (every.measured.uses_lines and len(line_x)):
        return _located_record(unloaded, T_base_ee, campaign, provenance, origin_from)

    def positions(*kinds: Observations) -> EndPositions:
        measured = np.vstack([poses.measured.places_m[:, 0] for poses in kinds])
        nominal = np.vstack([chain.forward(poses.states.q_rad)[:, :3, 3] for poses in kinds])
        return EndPositions(measured, nominal)

    record = frame_from_lines(
        positions(line_x),
        positions(line_y),
        positions(line_x, line_y, unloaded),
        options,
        campaign=campaign,
        provenance=provenance,
        origin_from=f"line moves and {origin_from}",
    )
    target = unloaded.measured.target_on(np.asarray(record.T_instr_base), T_base_ee)
    return record.model_copy(update={"T_ee_target": target})


def least_loaded(grid: Observations) -> NDArray[np.bool_]:
    """Return which poses have the lowest load of their own campaign, (P,); where few do, all of it.

    They are few where they are not twice as many as determine frames and targets. A target that is
    not seen in them, such as one of another tool, adds its poses with the lowest load.
    """
    rows, campaign = _at_lowest_load(grid), campaign_numbers(grid.states)
    parts = [part for _, part in grid.measured.campaigns] or [grid.measured]
    for number, part in enumerate(parts):
        of_campaign = campaign == number
        # `least_rows` are four times as many
        if 2 * len(np.unique(grid.pose[rows & of_campaign])) < part.least_rows:
            rows = rows | of_campaign
    seen = _targets_seen(grid)
    for of_target in seen.T[~seen[rows].any(axis=0)]:
        rows = rows | of_target & _at_lowest_load(grid, among=of_target)
    return rows


def _targets_seen(grid: Observations) -> NDArray[np.bool_]:
    """Return which targets, of all that are named, were seen in each pose, (P, B)."""
    targets = len(grid.measured.target_names)
    return np.asarray(np.isfinite(grid.measured.places_m[:, :targets]).all(axis=2))


def _at_lowest_load(
    grid: Observations, among: NDArray[np.bool_] | None = None
) -> NDArray[np.bool_]:
    """Return which poses have the lowest load of their own campaign, (P,).

    Args:
        among: (P,) poses among which the lowest is sought; None for all.
    """
    campaign = campaign_numbers(grid.states)
    load_N = np.where(True if among is None else among, grid.states.load_N, np.inf)
    lowest_N = np.full(campaign.max(initial=0) + 1, np.inf)
    np.minimum.at(lowest_N, campaign, load_N)
    return np.asarray(load_N == lowest_N[campaign])


def summary(record: BaseFrameRecord) -> str:
    """Return the base frame and its uncertainty in one line."""
    scatter = f"{record.origin_scatter_mm:.3f} mm"
    how = "held as stated" if record.target_stated else "held where it started"
    held = f"; {how}: {_directions_held(record.held_as_stated)}" if record.held_as_stated else ""
    if record.p_base_point_m is not None:
        place = ", ".join(f"{value:.3f}" for value in record.p_base_point_m)
        return f"fixed point at ({place}) m of the base, distances scatter by {scatter}{held}"
    x_u_rad, y_u_rad = record.x_direction_u_rad or 0.0, record.y_direction_u_rad or 0.0
    return (
        f"base frame by {record.method}, directions known to {1e3 * x_u_rad:.3f} and "
        f"{1e3 * y_u_rad:.3f} mrad, origins scatter by {scatter}{held}"
    )


def _directions_held(held: Sequence[str]) -> str:
    """Return directions of targets in words; a target that is held in all three once."""
    names = [what.partition(" along ")[0] for what in held]
    every = {name: f"{name} in all directions" for name in names if names.count(name) == 3}
    words = [every.get(name, what) for name, what in zip(names, held, strict=True)]
    return ", ".join(dict.fromkeys(words))


def _located_record(
    unloaded: Observations, T_base_ee: Array, campaign: str, provenance: str, origin_from: str
) -> BaseFrameRecord:
    """Return the record of the base frame by the nominal arm, fitted to the measurements."""
    measured = unloaded.measured
    found = measured.locate(T_base_ee)
    # For a group, the method of the first campaign whose instrument has directions.
    parts = [part for _, part in measured.campaigns] or [measured]
    u_rad, places_m = found.axis_u_rad, found.p_ee_targets_m
    point_m = -found.T_instr_base[:3, 3]  # without directions the axes are those of the base
    return BaseFrameRecord(
        campaign=campaign,
        provenance=provenance,
        method=next((part for part in parts if part.directional), parts[0]).locates_by,
        **_frame_fields(found.T_instr_base),
        x_direction_u_rad=None if u_rad is None else float(u_rad[0]),
        y_direction_u_rad=None if u_rad is None else float(u_rad[1]),
        attitude_scatter_rad=found.scatter_rad,
        T_ee_target=found.T_ee_target,
        T_ee_target_of=dict(found.T_ee_target_of) or None,
        p_ee_targets_m=(
            None if places_m is None else dict(zip(measured.target_names, places_m, strict=True))
        ),
        p_base_point_m=None if measured.directional else point_m,
        held_as_stated=found.held,
        target_stated=found.stated,
        origin_scatter_mm=1e3 * found.scatter_m,
        origin_poses=found.poses,
        origin_from=origin_from,
    )


def _refuse_one_move(points_x: int, points_y: int, where: Path | str) -> None:
    """Refuse a move along one axis only, which does not determine a base frame."""
    if bool(points_x) == bool(points_y):
        return
    there, absent = ("line_x", "line_y") if points_x else ("line_y", "line_x")
    raise CalibrationError(
        f"there are {there} rows, but no {absent} rows",
        where=str(where),
        allowed="both straight moves, or neither",
        remedy=f"add the {absent} rows to the campaign, or remove its {there} rows too: the base "
        "frame is then fitted to the nominal model",
    )


def _frame_fields(T_instr_base: Array) -> dict[str, Array]:
    return {
        "R_instr_base": T_instr_base[:3, :3],
        "origin_instr_m": T_instr_base[:3, 3],
        "T_instr_base": T_instr_base,
    }


def fit_line(p_instr_m: Array, travel_m: Array, name: str = "straight move") -> StraightLine:
    """Fit a line to measured points (N, 3) by least squares of their distances from it.

    Args:
        travel_m: (N,) nominal coordinate along the move, which gives the line's direction its sign.
        name: of the move, for messages.

    Raises:
        CalibrationError: with fewer than three points, naming the move.
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


def frame_from_lines(
    x_move: EndPositions,
    y_move: EndPositions,
    origin_poses: EndPositions,
    options: BaseFrameOptions,
    **identity: str,
) -> BaseFrameRecord:
    """Find the base frame: axes from the straight moves, origin from the nominal model.

    The origin is the mean over its poses of p_instr_ee - R_instr_base p_base_ee.

    Args:
        options: what the moves must satisfy.
        identity: campaign, provenance and `origin_from` of the record.

    Raises:
        CalibrationError: when a move has fewer than three points, is too short, bent or along
            another axis, or the two are parallel.
    """
    line_x = _checked_line(x_move, "x", options)
    line_y = _checked_line(y_move, "y", options)
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
    origins = origin_poses.measured_instr_m - origin_poses.nominal_base_m @ R_instr_base.T
    T_instr_base = homogeneous(R_instr_base, origins.mean(axis=0))
    scatter = np.sqrt(((origins - T_instr_base[:3, 3]) ** 2).sum(axis=1).mean())
    return BaseFrameRecord(
        **identity,
        method="straight_lines",
        **_frame_fields(T_instr_base),
        x_direction_u_rad=line_x.direction_u_rad,
        y_direction_u_rad=line_y.direction_u_rad,
        line_x=line_x,
        line_y=line_y,
        angle_between_lines_deg=math.degrees(angle),
        origin_scatter_mm=1e3 * float(scatter),
        origin_poses=len(origins),
    )


def _checked_line(
    move: EndPositions, axis: Literal["x", "y"], options: BaseFrameOptions
) -> StraightLine:
    """Return the line of a move along an axis of the base; refuse one that gives no direction."""
    where, column = f"line_{axis}", "xyz".index(axis)
    line = fit_line(move.measured_instr_m, move.nominal_base_m[:, column], where)
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
    travelled_mm = 1e3 * np.ptp(move.nominal_base_m, axis=0)
    if np.argmax(travelled_mm) != column:
        along = ", ".join(f"{each:.0f}" for each in travelled_mm)
        raise CalibrationError(
            f"the straight move is not along {axis} of the base",
            where=where,
            value=f"{along} mm along x, y, z, by the joint positions and the nominal arm",
            allowed=f"a move along {axis} of the base",
            remedy="check the labels line_x and line_y, or measure the moves again",
        )
    return line
