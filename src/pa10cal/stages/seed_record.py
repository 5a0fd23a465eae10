"""`seed/base_frame.json`: base frame, and targets where the instrument's own are not stated."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pa10cal.frame.hand_eye import HandEye
    from pa10cal.frame.nominal_fit import NominalSeed
    from pa10cal.frame.ranging import Ranging
    from pa10cal.frame.straight_lines import LineSeed, StraightLine

UNLOADED = "grid poses at the lowest load"


def summary(record: dict[str, Any]) -> str:
    """Say in one line what was found."""
    scatter = f"{record['origin_scatter_mm']:.3f} mm"
    how = "held as stated" if record.get("target_stated") else "held where it started"
    held = "".join(f"; {how}: {what}" for what in record.get("held_as_stated", ()))
    if "x_direction_u_rad" not in record:
        place = ", ".join(f"{value:.3f}" for value in record["p_base_point_m"])
        return f"fixed point at ({place}) m of the base, distances scatter by {scatter}{held}"
    return (
        f"base frame by {record['method']}, directions known to "
        f"{1e3 * record['x_direction_u_rad']:.3f} and {1e3 * record['y_direction_u_rad']:.3f} "
        f"mrad, origins scatter by {scatter}{held}"
    )


def line_record(seed: LineSeed) -> dict[str, Any]:
    """Return what `base_frame.json` says of straight moves."""

    def line(found: StraightLine) -> dict[str, Any]:
        return {
            "direction_instr": found.direction_instr.tolist(),
            "direction_u_rad": found.direction_u_rad,
            "length_mm": 1e3 * found.length_m,
            "bend_rms_mm": 1e3 * found.bend_rms_m,
            "points": found.points,
        }

    return {
        "method": "straight_lines",
        **_frame(seed.T_instr_base),
        "x_direction_u_rad": seed.line_x.direction_u_rad,
        "y_direction_u_rad": seed.line_y.direction_u_rad,
        "line_x": line(seed.line_x),
        "line_y": line(seed.line_y),
        "angle_between_lines_deg": math.degrees(seed.angle_rad),
        "origin_scatter_mm": 1e3 * seed.origin_scatter_m,
        "origin_poses": seed.origin_poses,
        "origin_from": f"line moves and {UNLOADED}",
    }


def nominal_record(seed: NominalSeed) -> dict[str, Any]:
    """Return what it says of a rigid fit of the nominal model's positions."""
    return {
        "method": "rigid_fit_nominal",
        **_frame(seed.T_instr_base),
        "x_direction_u_rad": float(seed.axis_u_rad[0]),
        "y_direction_u_rad": float(seed.axis_u_rad[1]),
        "origin_scatter_mm": 1e3 * seed.residual_rms_m,
        "origin_poses": seed.poses,
        "origin_from": UNLOADED,
    }


def poses_record(found: HandEye, poses: int) -> dict[str, Any]:
    """Return what it says of base frame and target, from positions and attitudes."""
    return {
        "method": "hand_eye_poses",
        **_hand_eye(found, poses),
        "attitude_scatter_rad": found.rms_rad,
        "T_ee_target": found.T_ee_targets[0].tolist(),
    }


def points_record(found: HandEye, names: Sequence[str], poses: int) -> dict[str, Any]:
    """Return what it says of base frame and places of targets, from positions."""
    places = found.T_ee_targets[:, :3, 3].tolist()
    return {
        "method": "hand_eye_points",
        **_hand_eye(found, poses),
        "p_ee_targets_m": dict(zip(names, places, strict=True)),
    }


def ranging_record(found: Ranging, name: str, poses: int) -> dict[str, Any]:
    """Return what it says of fixed point and target, from distances.

    Distances show no frame of the instrument: it is given its origin in the fixed point, and the
    directions of the base.
    """
    import numpy as np

    T_instr_base = np.eye(4)
    T_instr_base[:3, 3] = -found.p_base_point_m
    return {
        "method": "ranging",
        **_frame(T_instr_base),
        "p_base_point_m": found.p_base_point_m.tolist(),
        "p_ee_targets_m": {name: found.p_ee_target_m.tolist()},
        "held_as_stated": list(found.held),
        "origin_scatter_mm": 1e3 * found.rms_m,
        "origin_poses": poses,
        "origin_from": UNLOADED,
    }


def _hand_eye(found: HandEye, poses: int) -> dict[str, Any]:
    return {
        **_frame(found.T_instr_base),
        "x_direction_u_rad": float(found.axis_u_rad[0]),
        "y_direction_u_rad": float(found.axis_u_rad[1]),
        "held_as_stated": list(found.held),
        "origin_scatter_mm": 1e3 * found.rms_m,
        "origin_poses": poses,
        "origin_from": UNLOADED,
    }


def _frame(T_instr_base: Any) -> dict[str, Any]:
    return {
        "R_instr_base": T_instr_base[:3, :3].tolist(),
        "origin_cmm_m": T_instr_base[:3, 3].tolist(),
        "T_instr_base": T_instr_base.tolist(),
    }
