"""Conversion of arms and numbers to plain data, as `model.yaml` and results hold them, and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from pa10cal.arm.chain import BASE, TOOL
from pa10cal.arm.coupling import CoupledJoint
from pa10cal.arm.description import ROW_FIELDS, Arm, Controller, WeighedByLog, WeightsKnown
from pa10cal.arrays import Array
from pa10cal.rules import LISTS

_CONVENTIONS = {
    "standard": "T_base_row1, then Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta) of every row, then "
    "T_row_n_flange; q is added to theta of a joint that turns, to d of one that slides",
    "modified": "T_base_row1, then Ry(beta) Rx(alpha) Tx(a) Rz(theta) Tz(d) of every row, then "
    "T_row_n_flange; q is added to theta of a joint that turns, to d of one that slides",
}


def arm_to_plain(arm: Arm, bends: tuple[int, ...] = ()) -> dict[str, Any]:
    """Return an arm as numbers, texts, lists and mappings, with the bends of its chain."""
    columns = {name: getattr(arm, name) for name in ROW_FIELDS}
    plain: dict[str, Any] = {
        "name": arm.name,
        "title": arm.title,
        "convention": arm.convention,
        "T_base_flange": _CONVENTIONS[arm.convention],
        "base_motions": list(BASE),
        "tool_motions": list(TOOL),
        "bends": list(bends),
        "rows": [
            {
                name: None if values is None else plain_value(values[row])
                for name, values in columns.items()
            }
            for row in range(arm.n)
        ],
        "T_base_row1": arm.T_base_row1.tolist(),
        "T_row_n_flange": arm.T_row_n_ee.tolist(),
    }
    if arm.coupled:
        plain["coupling"] = [vars(coupled) for coupled in arm.coupled]
    if (known := arm.weights_known) is not None:
        plain["weights"] = {
            "from": known.origin,
            "why": known.why,
            "mass_u": known.mass.tolist(),
            "com_u_m": known.com_m.tolist(),
            "by_log": None if known.by_log is None else _by_log_to_plain(known.by_log),
        }
    if (stated := arm.controller) is not None:
        plain["controller"] = {
            "compensation": "on" if stated.compensation else "off",
            "known": stated.known,
            "arm": None if stated.arm is None else arm_to_plain(stated.arm),
        }
    return plain


#: Errors of logged torques, which a file has where some joint shows one.
_OF_LOG = ("zero_Nm", "friction_Nm", "u_friction_Nm")


def _by_log_to_plain(by_log: WeighedByLog) -> dict[str, Any]:
    plain = {"x": by_log.x, "covariance": by_log.covariance, "said": by_log.said}
    plain |= {name: errors for name in _OF_LOG if len(errors := getattr(by_log, name))}
    return {name: plain_value(value) for name, value in plain.items()}


def arm_from_plain(content: Mapping[str, Any]) -> Arm:
    """Return the arm that `arm_to_plain` described.

    Raises:
        KeyError: when a key is missing.
        ValueError: when a value cannot be used.
    """
    rows = content["rows"]
    has_masses = all(row["mass_kg"] is not None for row in rows)
    columns: dict[str, Any] = {
        name: np.array(
            [np.nan if row[name] is None else row[name] for row in rows],
            dtype=bool if name in ("hayati", "prismatic") else float,
        )
        for name in ROW_FIELDS
        if has_masses or name not in ("mass_kg", "com_m")
    }
    for name, values in columns.items():
        shape = {"limits_rad": (len(rows), 2), "com_m": (len(rows), 3)}.get(name, (len(rows),))
        if values.shape != shape:
            raise ValueError(f"{name} of the rows has not {shape} numbers")
        # These need not be known.
        if name not in ("gear_ratio", "torque_limit_Nm", "limits_rad"):
            finite(values, name)
    if not has_masses:
        columns |= {"mass_kg": None, "com_m": None}
    known = None
    if (weights := content.get("weights")) is not None:
        mass, com_m = (np.array(weights[key], dtype=float) for key in ("mass_u", "com_u_m"))
        known = WeightsKnown(weights["from"], mass, com_m, str(weights["why"]))
        if (log := weights.get("by_log")) is not None:
            log = {**log, "x": finite(log["x"], "x"), "covariance": finite(log["covariance"], "")}
            log |= {name: finite(log[name], name) for name in _OF_LOG if name in log}
            known = replace(known, by_log=WeighedByLog(**log))
    return Arm(
        name=str(content["name"]),
        title=str(content["title"]),
        convention=content["convention"],
        **columns,
        T_base_row1=pose_from_plain(content["T_base_row1"], "T_base_row1"),
        T_row_n_ee=pose_from_plain(content["T_row_n_flange"], "T_row_n_flange"),
        weights_known=known,
        coupled=tuple(CoupledJoint(**plain) for plain in content.get("coupling", ())),
        controller=_controller(content.get("controller")),
    )


def _controller(content: Mapping[str, Any] | None) -> Controller | None:
    if content is None:
        return None
    arm = content["arm"]
    return Controller(
        compensation=content["compensation"] == "on",
        known=bool(content["known"]),
        arm=None if arm is None else arm_from_plain(arm),
    )


def finite(value: Any, name: str) -> Array:
    """Return numbers as an array; refuse others (ValueError)."""
    numbers = np.array(value, dtype=float)
    if not np.isfinite(numbers).all():
        raise ValueError(f"{name} is not made of finite numbers")
    return numbers


def pose_from_plain(value: Any, name: str) -> Array:
    """Return a pose (4, 4); refuse another matrix (ValueError)."""
    T = finite(value, name)
    if T.shape != (4, 4) or (T[3] != [0.0, 0.0, 0.0, 1.0]).any():
        raise ValueError(f"{name} is not a 4 by 4 matrix whose last row is 0, 0, 0, 1")
    rotation_from_plain(T[:3, :3], name)
    return T


def rotation_from_plain(value: Any, name: str) -> Array:
    """Return a rotation (3, 3); refuse another matrix (ValueError)."""
    R = finite(value, name).reshape(3, 3)
    if np.abs(R @ R.T - np.eye(3)).max() > LISTS.rotation_within or np.linalg.det(R) < 0.0:
        raise ValueError(f"{name} has no rotation: its columns are axes of length one")
    return R


def plain_value(value: Any) -> Any:
    """Return arrays, sequences and mappings as plain lists, numbers and texts; None for nan."""
    if isinstance(value, Mapping):
        return {key: plain_value(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain_value(entry) for entry in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value
