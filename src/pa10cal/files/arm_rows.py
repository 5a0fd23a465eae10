"""Rows of an arm's file: their keys, and checks by which wrong units are found."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import median
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, FiniteFloat

from pa10cal.arm.chain import placed, roll_pitch_yaw
from pa10cal.arm.description import LONGEST_M
from pa10cal.arm.dh_rows import rows_of_table
from pa10cal.arrays import Array
from pa10cal.errors import ArmError
from pa10cal.options import Positive, Section

Triple = tuple[FiniteFloat, FiniteFloat, FiniteFloat]

_FULL_TURN_DEG = 360.0
#: A length is in another unit if it exceeds this, and so many times the median of the others.
_LONG_M, _OUT_OF_PROPORTION = 2.0, 20.0
#: Longest length that may be cancelled by others: of axes nearer to parallel than that makes them,
#: the rows are written as those of parallel ones.
_FARTHEST_CANCELLED_M = 1e5
#: A centre of mass, slide or constant frame is in another unit if it exceeds this, and so many
#: times the longest link: rails of tens of metres carry arms of one or two.
_FAR_M, _FAR_LINKS = 10.0, 100.0
#: Heaviest link where none is longer than a metre, as in arms that carry a ton, which weigh less
#: than five; of longer ones it grows with the cube of the longest.
_HEAVY_KG = 2000.0
#: Largest relative difference of a number from quarter turns in radians, written with few digits.
_QUARTER_TURN_DIGITS = 6e-4


class ArmRow(Section):
    """One row of Denavit-Hartenberg parameters and what is known of its joint and its link."""

    theta_deg: FiniteFloat = 0.0
    d_m: FiniteFloat = 0.0
    a_m: FiniteFloat = 0.0
    alpha_deg: FiniteFloat = 0.0
    beta_deg: FiniteFloat = 0.0
    hayati: bool | None = None
    prismatic: bool = False
    limits_deg: tuple[FiniteFloat, FiniteFloat] | None = None
    limits_m: tuple[FiniteFloat, FiniteFloat] | None = None
    gear_ratio: Positive | None = None
    torque_limit_Nm: Positive | None = None
    force_limit_N: Positive | None = None
    mass_kg: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] | None = None
    com_m: Triple | None = None

    @property
    def limits(self) -> tuple[float, float]:
        """Joint limits in radians, or in metres for a prismatic joint."""
        if self.prismatic:
            return self.limits_m or (math.nan, math.nan)
        low, high = self.limits_deg or (-_FULL_TURN_DEG, _FULL_TURN_DEG)
        return math.radians(low), math.radians(high)

    @property
    def rated(self) -> float:
        """Rated torque [N m], or force [N] of a prismatic joint; nan where not stated."""
        stated = self.force_limit_N if self.prismatic else self.torque_limit_Nm
        return math.nan if stated is None else stated


def check_rows(rows: Sequence[ArmRow], where: str) -> None:
    """Refuse rows of an arm whose keys contradict each other, or whose figures have a wrong unit.

    Args:
        rows: of one arm.
        where: its file, for messages.

    Raises:
        ArmError: naming row and key.
    """
    for number, row in enumerate(rows, start=1):
        _check_row(row, f"{where}: row {number}")
    limits_deg = {number: row.limits_deg for number, row in enumerate(rows, 1) if row.limits_deg}
    if limits_deg and all(max(map(abs, pair)) < 6.3 for pair in limits_deg.values()):
        number, pair = next(iter(limits_deg.items()))
        raise ArmError(
            "limits_deg looks like radians, in this and every other row",
            where=f"{where}: row {number}",
            value=list(pair),
            allowed="degrees",
            remedy="multiply by 180/pi",
        )
    _check_lengths(rows, where)
    _check_beside_lengths(rows, where)
    stated = any(row.mass_kg is not None for row in rows)
    for number, row in enumerate(rows, start=1):
        missing = [key for key in ("mass_kg", "com_m") if stated and getattr(row, key) is None]
        if missing or (row.com_m is not None and row.mass_kg is None):
            keys = " and ".join(missing) or "mass_kg"
            raise ArmError(
                f"{keys} is missing",
                where=f"{where}: row {number}",
                allowed="mass_kg and com_m in every row, or in none",
                remedy="complete the row, or remove all masses",
            )


def _check_lengths(rows: Sequence[ArmRow], where: str) -> None:
    """Refuse a length that is out of proportion to the others, or longer than any link."""
    lengths_m = {
        (number, key): getattr(row, key)
        for number, row in enumerate(rows, start=1)
        for key in ("d_m", "a_m")
        if getattr(row, key)
    }
    for (number, key), length_m in lengths_m.items():
        others_m = [abs(other) for place, other in lengths_m.items() if place != (number, key)]
        usual_m = median(others_m) if others_m else math.inf
        if abs(length_m) > max(_LONG_M, _OUT_OF_PROPORTION * usual_m):
            raise ArmError(
                f"{key} is out of proportion to the other lengths",
                where=f"{where}: row {number}",
                value=length_m,
                allowed=f"metres, as the others are (their median is {usual_m:g})",
                remedy="divide by 1000 if this one is in millimetres",
            )
    for number, row in enumerate(rows, start=1):
        place = f"{where}: row {number}"
        _refuse_farther((row.a_m,), "a_m", LONGEST_M, place)
        _refuse_farther((row.d_m,), "d_m", LONGEST_M, place)


def _check_beside_lengths(rows: Sequence[ArmRow], where: str) -> None:
    """Refuse strokes, centres of mass and masses that are out of proportion to the links."""
    for number, row in enumerate(rows, start=1):
        place = f"{where}: row {number}"
        refuse_far(row.limits_m or (), "limits_m", rows, place)
        refuse_far(row.com_m or (), "com_m", rows, place)
        heaviest_kg = _HEAVY_KG * max(1.0, _longest_m(rows)) ** 3
        if row.mass_kg is not None and row.mass_kg > heaviest_kg:
            raise ArmError(
                f"mass_kg exceeds {heaviest_kg:.4g} kg",
                where=place,
                value=row.mass_kg,
                allowed="kilograms, as links of these lengths weigh",
                remedy="divide by 1000 if the masses are in grams",
            )


def _longest_m(rows: Sequence[ArmRow]) -> float:
    return max((max(abs(row.a_m), abs(row.d_m)) for row in rows), default=0.0)


def refuse_far(values_m: Sequence[float], key: str, rows: Sequence[ArmRow], where: str) -> None:
    """Refuse lengths under a key that cannot be metres, beside the links of an arm.

    Where no link has a length, as of a gantry, nothing but a crane's is too long.

    Raises:
        ArmError: naming the key; `where` is file and row, or file and frame.
    """
    most_m = max(_FAR_M, min(_FAR_LINKS * (_longest_m(rows) or 1.0), LONGEST_M))
    _refuse_farther(values_m, key, most_m, where)


def _refuse_farther(values_m: Sequence[float], key: str, most_m: float, where: str) -> None:
    if max(map(abs, values_m), default=0.0) > most_m:
        value = values_m[0] if len(values_m) == 1 else list(values_m)
        raise ArmError(
            f"{key} exceeds {most_m:g} m",
            where=where,
            value=value,
            allowed="metres",
            remedy="divide by 1000 if the lengths are in millimetres",
        )


def _check_row(row: ArmRow, where: str) -> None:
    """Refuse keys of the other kind of joint, limits without room, and figures in a wrong unit."""
    own_keys, other_keys = ["limits_deg", "torque_limit_Nm"], ["limits_m", "force_limit_N"]
    kind, other = "turns", "slides"
    if row.prismatic:
        own_keys, other_keys = other_keys, [*own_keys, "gear_ratio"]
        kind, other = other, kind
    for key in other_keys:
        if (value := getattr(row, key)) is not None:
            prismatic = str(not row.prismatic).lower()
            raise ArmError(
                f"{key} is for a joint that {other}, and this one {kind}",
                where=where,
                value=value,
                allowed=" and ".join(own_keys),
                remedy=f"correct the key, or set prismatic: {prismatic}",
            )
    if row.prismatic and row.limits_m is None:
        raise ArmError(
            "a prismatic joint needs limits",
            where=where,
            allowed="limits_m: [lowest, highest], in metres",
            remedy="set limits_m",
        )
    low, high = getattr(row, own_keys[0]) or (-_FULL_TURN_DEG, _FULL_TURN_DEG)
    if low >= high:
        raise ArmError(
            f"{own_keys[0]} allows the joint no motion",
            where=where,
            value=[low, high],
            allowed="the lower limit first, then a higher one",
            remedy=f"correct {own_keys[0]}",
        )
    for key in ("theta_deg", "alpha_deg"):
        value = getattr(row, key)
        quarters = round(abs(value) / (math.pi / 2.0))
        near = quarters * math.pi / 2.0
        if 1 <= quarters <= 4 and math.isclose(abs(value), near, rel_tol=_QUARTER_TURN_DIGITS):
            raise ArmError(
                f"{key} looks like radians",
                where=where,
                value=value,
                allowed="degrees",
                remedy=f"write {math.copysign(90.0 * quarters, value):g}",
            )


class Frame(Section):
    """A constant frame: its position, and its rotations about fixed axes x, y, z in that order."""

    xyz_m: Triple = (0.0, 0.0, 0.0)
    rpy_deg: Triple = (0.0, 0.0, 0.0)

    @property
    def pose(self) -> Array:
        """Return it as (4, 4) [m]."""
        return placed(np.array(self.xyz_m), np.radians(self.rpy_deg))


def rows_through_far_ones(
    rows: Sequence[ArmRow],
    convention: Literal["standard", "modified"],
    ends: tuple[Frame, Frame],
    where: str,
) -> tuple[list[ArmRow], tuple[Frame, Frame]] | None:
    """Return rows with usual lengths for the same arm, where long lengths cancel each other.

    Between nearly parallel axes lengths may be hundreds of metres and cancel. The rows returned are
    standard ones through the same axes. None where lengths are usual, or do not cancel.

    Args:
        rows, convention: of one arm.
        ends: the frames before the first row and after the last one; those returned are of the
            rows returned.
        where: file of the arm, for messages.

    Raises:
        ArmError: when lengths cancel, but centres of mass are stated in these far frames, or other
            figures have a wrong unit.
    """
    try:
        _check_lengths(rows, where)
    except ArmError:
        pass
    else:
        return None
    table = np.array([[r.theta_deg, r.d_m, r.a_m, r.alpha_deg, r.beta_deg] for r in rows])
    table[:, [0, 3, 4]] = np.radians(table[:, [0, 3, 4]])
    if np.abs(table[:, 1:3]).max() > _FARTHEST_CANCELLED_M:
        return None
    laid = rows_of_table(table, convention, *(end.pose for end in ends))
    lengths_m = [*laid.parameters[:, 1:3].flat, *laid.T_base_row1[:3, 3], *laid.T_row_n_ee[:3, 3]]
    if np.abs(lengths_m).max() > _LONG_M or not np.isfinite(lengths_m).all():
        return None
    with_mass = [number for number, row in enumerate(rows, start=1) if row.com_m is not None]
    if with_mass:
        raise ArmError(
            "a centre of mass stands in a frame that is far from its link",
            where=f"{where}: row {with_mass[0]}",
            value=f"d_m up to {np.abs(table[:, 1]).max():.4g}, of nearly parallel axes",
            allowed="no com_m in rows whose lengths cancel each other",
            remedy="remove mass_kg and com_m, and state masses.total_kg in campaign.yaml; or "
            "describe the arm by its maker's nominal rows",
        )
    for number, row in enumerate(rows, start=1):
        _check_row(row, f"{where}: row {number}")
    new_rows = []
    for row, parameters in zip(rows, laid.parameters.tolist(), strict=True):
        theta_rad, d_m, a_m, alpha_rad, beta_rad = parameters
        geometry = {
            "theta_deg": math.degrees(theta_rad),
            "d_m": d_m,
            "a_m": a_m,
            "alpha_deg": math.degrees(alpha_rad),
            "beta_deg": math.degrees(beta_rad),
            "hayati": None,
        }
        new_rows.append(row.model_copy(update=geometry))
    return new_rows, (_frame(laid.T_base_row1), _frame(laid.T_row_n_ee))


def _frame(T: Array) -> Frame:
    rpy_deg = np.degrees(roll_pitch_yaw(T[:3, :3]))
    return Frame(xyz_m=tuple(T[:3, 3].tolist()), rpy_deg=tuple(rpy_deg.tolist()))
