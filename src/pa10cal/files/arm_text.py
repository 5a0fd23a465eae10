"""An arm as the text of its YAML file, with every figure to the last digit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import yaml

from pa10cal.arm.chain import roll_pitch_yaw
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array

#: Limits this near [rad, m] are one.
_SAME_LIMIT = 1e-9
_MOST_DECIMALS = 15


def arm_text(arm: Arm, comments: Iterable[str] = (), urdf: Mapping[str, str] | None = None) -> str:
    """Return the file of an arm, so that `parse_arm` gives the arm back.

    What the file may leave out and what is not known is omitted.

    Args:
        arm: the arm.
        comments: lines that stand first.
        urdf: where it came from: `file`, `base` and `tip`.
    """
    head: dict[str, Any] = {"name": arm.name, "title": arm.title, "convention": arm.convention}
    if urdf is not None:
        head["urdf"] = dict(urdf)
    lines = [f"# {line}".rstrip() for line in comments]
    lines += [f"{key}: {_flow(value)}" for key, value in head.items()]
    for key, T in (("base", arm.T_base_row1), ("tool", arm.T_row_n_ee)):
        if (np.eye(4) != T).any():
            lines.append(f"{key}: {_flow(_frame(T))}")
    lines.append("rows:")
    for row in range(arm.n):
        geometry, rest = _geometry(arm, row), _joint_and_link(arm, row)
        lines.append(f"  - {{{_flow(geometry)[1:-1]}," if geometry else "  - {")
        lines.append(f"     {_flow(rest)[1:-1]}}}")
    return "\n".join(lines) + "\n"


def with_short_limits(arm: Arm) -> Arm:
    """Return the arm with each limit the shortest number in the file that is within 1e-9 of it.

    What a URDF states in radians with a few digits has fourteen in degrees.
    """
    limits = [
        [_shortest(limit, _SAME_LIMIT, degrees=not slides) for limit in ends]
        for ends, slides in zip(arm.limits_rad, arm.prismatic, strict=True)
    ]
    turned = np.where(arm.prismatic[:, None], limits, np.radians(limits))
    return replace(arm, limits_rad=turned)


def _shortest(limit: float, within: float, *, degrees: bool) -> float | int:
    """Return a limit [deg or m] with the fewest decimals that is so near [rad or m]."""
    shown = float(np.degrees(limit)) if degrees else float(limit)
    for decimals in range(_MOST_DECIMALS):
        rounded = round(shown, decimals)
        if abs((np.radians(rounded) if degrees else rounded) - limit) <= within:
            return _number(rounded)
    return _number(shown)


def _geometry(arm: Arm, row: int) -> dict[str, Any]:
    values = {
        "theta_deg": np.degrees(arm.theta_rad[row]),
        "d_m": arm.d_m[row],
        "a_m": arm.a_m[row],
        "alpha_deg": np.degrees(arm.alpha_rad[row]),
        "beta_deg": np.degrees(arm.beta_rad[row]),
    }
    return {key: _number(value) for key, value in values.items() if value != 0.0}


def _joint_and_link(arm: Arm, row: int) -> dict[str, Any]:
    slides = bool(arm.prismatic[row])
    limits, rated = arm.limits_rad[row], arm.torque_limit_Nm[row]
    content: dict[str, Any] = {"prismatic": True} if slides else {}
    content["limits_m" if slides else "limits_deg"] = [
        _shortest(limit, 0.0, degrees=not slides) for limit in limits
    ]
    if not np.isnan(arm.gear_ratio[row]):
        content["gear_ratio"] = _number(arm.gear_ratio[row])
    if not np.isnan(rated):
        content["force_limit_N" if slides else "torque_limit_Nm"] = _number(rated)
    if arm.mass_kg is not None and arm.com_m is not None:
        content["mass_kg"] = _number(arm.mass_kg[row])
        content["com_m"] = _numbers(arm.com_m[row])
    return content


def _frame(T: Array) -> dict[str, Any]:
    return {"xyz_m": _numbers(T[:3, 3]), "rpy_deg": _numbers(np.degrees(roll_pitch_yaw(T[:3, :3])))}


def _numbers(values: Array) -> list[float | int]:
    return [_number(value) for value in values]


def _number(value: float) -> float | int:
    """Return a plain number, whole ones without a decimal point."""
    return int(value) if float(value).is_integer() else float(value)


def _flow(value: Any) -> str:
    """Return a value as YAML on one line."""
    text = yaml.safe_dump(
        value, default_flow_style=True, sort_keys=False, width=10**6, allow_unicode=True
    )
    return text.removesuffix("\n").removesuffix("\n...")
