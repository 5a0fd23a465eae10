"""The base frame in the instrument's frame, and places of targets, before any calibration.

Where straight moves along the base's axes were measured they give its directions; else the nominal
arm is fitted to what was measured. Both use the poses at the lowest load.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.errors import CalibrationError
from pa10cal.frame.straight_lines import frame_fields, seed_from_lines
from pa10cal.observe.observations import Observations, average_repeats
from pa10cal.options import BaseFrameOptions
from pa10cal.results.calibration import BaseFrameRecord

UNLOADED = "grid poses at the lowest load"


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
        CalibrationError: when there is one straight move only, one is too short or bent, or the
            poses do not determine base and targets.
    """
    chain = Chain.of(arm)
    grid = average_repeats(every.of_kind("grid"))
    unloaded = grid.take(_least_loaded(grid))
    line_x, line_y = (average_repeats(every.of_kind(kind)) for kind in ("line_x", "line_y"))
    if every.measured.uses_lines:
        _refuse_one_move(len(line_x), len(line_y), where)
    T_base_ee = chain.forward(unloaded.states.q_rad)
    if not (every.measured.uses_lines and len(line_x)):
        return _located_record(unloaded, T_base_ee, campaign, provenance)

    def positions(*kinds: Observations) -> tuple[Array, Array]:
        """Measured and nominal positions of the end-effector."""
        measured = np.vstack([poses.measured.places_m[:, 0] for poses in kinds])
        nominal = np.vstack([chain.forward(poses.states.q_rad)[:, :3, 3] for poses in kinds])
        return measured, nominal

    record = seed_from_lines(
        positions(line_x),
        positions(line_y),
        positions(line_x, line_y, unloaded),
        options,
        campaign=campaign,
        provenance=provenance,
        origin_from=f"line moves and {UNLOADED}",
    )
    target = unloaded.measured.target_on(np.asarray(record.T_instr_base), T_base_ee)
    return record.model_copy(update={"T_ee_target": target})


def _least_loaded(grid: Observations) -> NDArray[np.bool_]:
    """Return which poses bear the lowest load, (P,), of their own campaign."""
    load_N, campaign = grid.states.load_N, grid.states.campaign
    if campaign is None:
        return np.asarray(load_N == load_N.min())
    lowest_N = np.full(campaign.max() + 1, np.inf)
    np.minimum.at(lowest_N, campaign, load_N)
    return np.asarray(load_N == lowest_N[campaign])


def summary(record: BaseFrameRecord) -> str:
    """Return in one line what was found."""
    scatter = f"{record.origin_scatter_mm:.3f} mm"
    how = "held as stated" if record.target_stated else "held where it started"
    held = "".join(f"; {how}: {what}" for what in record.held_as_stated or ())
    if record.p_base_point_m is not None:
        place = ", ".join(f"{value:.3f}" for value in record.p_base_point_m)
        return f"fixed point at ({place}) m of the base, distances scatter by {scatter}{held}"
    x_u_rad, y_u_rad = record.x_direction_u_rad or 0.0, record.y_direction_u_rad or 0.0
    return (
        f"base frame by {record.method}, directions known to {1e3 * x_u_rad:.3f} and "
        f"{1e3 * y_u_rad:.3f} mrad, origins scatter by {scatter}{held}"
    )


def _located_record(
    unloaded: Observations, T_base_ee: Array, campaign: str, provenance: str
) -> BaseFrameRecord:
    """Return the record of what the nominal arm, fitted to the instrument's readings, gives."""
    measured = unloaded.measured
    found = measured.locate(T_base_ee)
    # Of a group the first campaign counts whose instrument has directions.
    parts = [part for _, part in measured.campaigns] or [measured]
    u_rad, places_m = found.axis_u_rad, found.p_ee_targets_m
    point_m = -found.T_instr_base[:3, 3]  # the instrument's axes are then those of the base
    return BaseFrameRecord(
        campaign=campaign,
        provenance=provenance,
        method=next((part for part in parts if part.directional), parts[0]).locates_by,
        **frame_fields(found.T_instr_base),
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
        origin_from=UNLOADED,
    )


def _refuse_one_move(points_x: int, points_y: int, where: Path | str) -> None:
    """Refuse a move along one axis only, which gives no base frame."""
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
