"""`seed/base_frame.json`: base frame, and targets where the instrument's own are not stated."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pa10cal.frame.hand_eye import HandEye
from pa10cal.frame.nominal_fit import NominalSeed
from pa10cal.frame.ranging import Ranging
from pa10cal.frame.straight_lines import LineSeed, StraightLine
from pa10cal.results import seed as records
from pa10cal.results.seed import BaseFrameRecord

if TYPE_CHECKING:
    from pa10cal.campaign.description import Campaign

Array = NDArray[np.float64]

UNLOADED = "grid poses at the lowest load"


def summary(record: BaseFrameRecord) -> str:
    """Say in one line what was found."""
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


def line_record(
    seed: LineSeed, campaign: Campaign, T_ee_target: Array | None = None
) -> BaseFrameRecord:
    """Return the record of a frame from straight moves.

    Args:
        seed: what they gave.
        campaign: whose moves they are.
        T_ee_target: (4, 4) the target in the end-effector frame; None where the end-effector
            itself was measured.
    """
    return BaseFrameRecord(
        **_header(campaign),
        method="straight_lines",
        **_frame(seed.T_instr_base),
        x_direction_u_rad=seed.line_x.direction_u_rad,
        y_direction_u_rad=seed.line_y.direction_u_rad,
        line_x=_line(seed.line_x),
        line_y=_line(seed.line_y),
        angle_between_lines_deg=math.degrees(seed.angle_rad),
        origin_scatter_mm=1e3 * seed.origin_scatter_m,
        origin_poses=seed.origin_poses,
        origin_from=f"line moves and {UNLOADED}",
        T_ee_target=T_ee_target,
    )


def nominal_record(seed: NominalSeed, campaign: Campaign) -> BaseFrameRecord:
    """Return the record of a rigid fit of the nominal model's positions."""
    return BaseFrameRecord(
        **_header(campaign),
        method="rigid_fit_nominal",
        **_frame(seed.T_instr_base),
        x_direction_u_rad=float(seed.axis_u_rad[0]),
        y_direction_u_rad=float(seed.axis_u_rad[1]),
        origin_scatter_mm=1e3 * seed.residual_rms_m,
        origin_poses=seed.poses,
        origin_from=UNLOADED,
    )


def poses_record(found: HandEye, poses: int, campaign: Campaign) -> BaseFrameRecord:
    """Return the record of base frame and target, from positions and attitudes."""
    return BaseFrameRecord(
        **_header(campaign),
        method="hand_eye_poses",
        **_hand_eye(found, poses),
        attitude_scatter_rad=found.rms_rad,
        T_ee_target=found.T_ee_targets[0],
    )


def points_record(
    found: HandEye, names: Sequence[str], poses: int, campaign: Campaign, *, stated: bool
) -> BaseFrameRecord:
    """Return the record of base frame and places of targets, from positions."""
    places_m = found.T_ee_targets[:, :3, 3]
    return BaseFrameRecord(
        **_header(campaign),
        method="hand_eye_points",
        **_hand_eye(found, poses),
        p_ee_targets_m=dict(zip(names, places_m, strict=True)),
        target_stated=stated,
    )


def ranging_record(
    found: Ranging, name: str, poses: int, campaign: Campaign, *, stated: bool
) -> BaseFrameRecord:
    """Return the record of fixed point and target, from distances.

    Distances show no frame of the instrument: it is given its origin in the fixed point, and the
    directions of the base.
    """
    T_instr_base = np.eye(4)
    T_instr_base[:3, 3] = -found.p_base_point_m
    return BaseFrameRecord(
        **_header(campaign),
        method="ranging",
        **_frame(T_instr_base),
        p_base_point_m=found.p_base_point_m,
        p_ee_targets_m={name: found.p_ee_target_m},
        held_as_stated=tuple(found.held),
        origin_scatter_mm=1e3 * found.rms_m,
        origin_poses=poses,
        origin_from=UNLOADED,
        target_stated=stated,
    )


def _header(campaign: Campaign) -> dict[str, Any]:
    return {"campaign": campaign.name, "provenance": campaign.provenance}


def _line(found: StraightLine) -> records.StraightLine:
    return records.StraightLine(
        direction_instr=found.direction_instr,
        direction_u_rad=found.direction_u_rad,
        length_mm=1e3 * found.length_m,
        bend_rms_mm=1e3 * found.bend_rms_m,
        points=found.points,
    )


def _hand_eye(found: HandEye, poses: int) -> dict[str, Any]:
    return {
        **_frame(found.T_instr_base),
        "x_direction_u_rad": float(found.axis_u_rad[0]),
        "y_direction_u_rad": float(found.axis_u_rad[1]),
        "held_as_stated": tuple(found.held),
        "origin_scatter_mm": 1e3 * found.rms_m,
        "origin_poses": poses,
        "origin_from": UNLOADED,
    }


def _frame(T_instr_base: Array) -> dict[str, Array]:
    return {
        "R_instr_base": T_instr_base[:3, :3],
        "origin_instr_m": T_instr_base[:3, 3],
        "T_instr_base": T_instr_base,
    }
