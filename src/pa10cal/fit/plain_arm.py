"""Arms, payloads and numbers as plain data, as `model.yaml` and results hold them, and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, cast, get_args

import numpy as np

from pa10cal.arm.chain import BASE, TOOL
from pa10cal.arm.coupling import CoupledJoint
from pa10cal.arm.description import (
    ROW_FIELDS,
    Arm,
    Controller,
    WeighedByLog,
    WeightsFrom,
    WeightsKnown,
)
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array, Mask
from pa10cal.rules import LISTS

#: Forward kinematics by each convention, in words for people who read the file.
_CONVENTIONS = {
    convention: f"T_base_row1, then {motions} of every row, then T_row_n_flange; q is added to "
    "theta of a joint that turns, to d of one that slides"
    for convention, motions in (
        ("standard", "Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta)"),
        ("modified", "Ry(beta) Rx(alpha) Tx(a) Rz(theta) Tz(d)"),
    )
}
#: Errors of logged torques, which a file has where some joint shows one.
_OF_LOG = ("zero_Nm", "friction_Nm", "u_friction_Nm", "gain", "u_gain")


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


def _by_log_to_plain(by_log: WeighedByLog) -> dict[str, Any]:
    """Return what a log shows of the weights; without errors of torques that no joint shows."""
    plain = {"x": by_log.x, "covariance": by_log.covariance, "said": by_log.said}
    plain |= {name: errors for name in _OF_LOG if len(errors := getattr(by_log, name))}
    return {name: plain_value(value) for name, value in plain.items()}


def arm_from_plain(content: Mapping[str, Any]) -> Arm:
    """Return the arm that `arm_to_plain` described.

    Raises:
        ArmError: when the arm cannot be used.
        KeyError: when a key is missing.
        ValueError: when a value cannot be used.
    """
    if content["convention"] not in _CONVENTIONS:
        raise ValueError(f"convention is not one of {', '.join(_CONVENTIONS)}")
    rows = content["rows"]
    masses_known = all(row["mass_kg"] is not None for row in rows)
    columns: dict[str, Array | Mask | None] = {
        name: _column(rows, name) if masses_known or name not in ("mass_kg", "com_m") else None
        for name in ROW_FIELDS
    }
    arm = Arm(
        name=str(content["name"]),
        title=str(content["title"]),
        convention=content["convention"],
        **cast(dict[str, Any], columns),
        T_base_row1=pose_from_plain(content["T_base_row1"], "T_base_row1"),
        T_row_n_ee=pose_from_plain(content["T_row_n_flange"], "T_row_n_flange"),
        weights_known=_weights_from_plain(content.get("weights"), len(rows)),
        # Files without the key are of models whose springs moved single joints.
        coupled=tuple(
            CoupledJoint(**({"counted_only": True} | plain))
            for plain in content.get("coupling", ())
        ),
        controller=_controller_from_plain(content.get("controller")),
    )
    named = {joint for coupled in arm.coupled for joint in (coupled.joint, coupled.by)}
    if not named <= set(range(1, arm.n + 1)) or arm.coupling.singular:
        raise ValueError("coupling is not one of the joints that the rows describe")
    return arm


def _column(rows: Sequence[Mapping[str, Any]], name: str) -> Array | Mask:
    """Return one field of all rows as a column of `Arm`; refuse what is none (ValueError)."""
    entries = [row[name] for row in rows]
    if name in ("hayati", "prismatic"):
        if not all(isinstance(entry, bool) for entry in entries):
            raise ValueError(f"{name} of the rows is not true or false")
        return np.array(entries, dtype=bool)
    shape = (len(rows), *{"limits_rad": (2,), "com_m": (3,)}.get(name, ()))
    column = np.array([np.nan if entry is None else entry for entry in entries], dtype=float)
    if column.shape != shape:
        raise ValueError(f"{name} of the rows has not {shape} numbers")
    need_not_be_known = name in ("gear_ratio", "torque_limit_Nm", "limits_rad")
    return column if need_not_be_known else finite(column, name)


def _weights_from_plain(content: Mapping[str, Any] | None, n: int) -> WeightsKnown | None:
    """Return how well the weights of n links are known; None where the file does not say."""
    if content is None:
        return None
    if content["from"] not in get_args(WeightsFrom):
        raise ValueError(f"weights are from none of {', '.join(get_args(WeightsFrom))}")
    mass, com_m = (finite(content[key], key, n) for key in ("mass_u", "com_u_m"))
    known = WeightsKnown(content["from"], mass, com_m, str(content["why"]))
    if (log := content.get("by_log")) is None:
        return known
    size = 4 * n + 3
    shapes = {"x": (size,), "covariance": (size, size), **dict.fromkeys(_OF_LOG, (n,))}
    arrays = {
        name: finite(log[name], f"by_log.{name}", *shape)
        for name, shape in shapes.items()
        if name in log
    }
    return replace(known, by_log=WeighedByLog(**{**log, **arrays}))


def _controller_from_plain(content: Mapping[str, Any] | None) -> Controller | None:
    """Return what the controller computes with; None where the file does not say."""
    if content is None:
        return None
    arm = content["arm"]
    return Controller(
        compensation=content["compensation"] == "on",
        known=bool(content["known"]),
        arm=None if arm is None else arm_from_plain(arm),
    )


def payload_to_plain(payload: Payload) -> dict[str, Any]:
    """Return a payload, and those of the campaigns of a group, as numbers and lists."""
    plain = {field.name: plain_value(getattr(payload, field.name)) for field in fields(Payload)}
    plain.pop("of_campaigns")
    if payload.of_campaigns:
        plain["of_campaigns"] = [payload_to_plain(each) for each in payload.of_campaigns]
    return plain


def payload_from_plain(plain: Mapping[str, Any]) -> Payload:
    """Return the payload that `payload_to_plain` described.

    Raises:
        KeyError: when a key is missing.
        ValueError: when a value cannot be used.
    """
    return Payload(
        mass_kg=float(finite(plain["mass_kg"], "mass_kg")),
        com_m=finite(plain["com_m"], "com_m").reshape(3),
        load_point_m=finite(plain["load_point_m"], "load_point_m").reshape(3),
        gravity_m_s2=finite(plain["gravity_m_s2"], "gravity_m_s2").reshape(3),
        known=bool(plain.get("known", True)),
        com_u_m=None if plain.get("com_u_m") is None else float(plain["com_u_m"]),
        of_campaigns=tuple(payload_from_plain(each) for each in plain.get("of_campaigns", ())),
    )


def finite(value: Any, name: str, *shape: int) -> Array:
    """Return numbers as an array, of a shape if one is given; refuse others (ValueError)."""
    numbers = np.array(value, dtype=float)
    if not np.isfinite(numbers).all():
        raise ValueError(f"{name} is not made of finite numbers")
    if shape and numbers.shape != shape:
        raise ValueError(f"{name} has not {shape} numbers")
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
    R = finite(value, name, 3, 3)
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
