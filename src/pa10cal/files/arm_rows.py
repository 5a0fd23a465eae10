"""One row of an arm's file: its keys, and what its figures give away of wrong units."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import median
from typing import Annotated

from pydantic import Field, FiniteFloat

from pa10cal.errors import ArmError
from pa10cal.settings_section import Positive, Section

Triple = tuple[FiniteFloat, FiniteFloat, FiniteFloat]

_FULL_TURN_DEG = 360.0
#: A length so much longer than the others of its arm, and than this, was meant in another unit.
_OUT_OF_PROPORTION = 20.0
_LONG_M = 2.0
#: No link is longer, and no centre of mass, slide or constant frame is further.
_FAR_M = 10.0
#: No link is heavier: whole arms that carry a ton weigh less than five.
_HEAVY_KG = 2000.0
#: How near a number of degrees lies to a quarter turn in radians that was written with few digits.
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
    mass_kg: Annotated[float, Field(ge=0.0, le=_HEAVY_KG, allow_inf_nan=False)] | None = None
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
    """Refuse rows whose keys or figures cannot be meant.

    Args:
        rows: rows of one arm.
        where: its file.

    Raises:
        ArmError: naming row and key.
    """
    for number, row in enumerate(rows, start=1):
        _check_joint(row, f"{where}: row {number}")
        _check_angles(row, f"{where}: row {number}")
    _check_limits_are_degrees(rows, where)
    _check_proportions(rows, where)
    for number, row in enumerate(rows, start=1):
        for key, value_m in (("a_m", row.a_m), ("d_m", row.d_m)):
            refuse_far((value_m,), key, f"{where}: row {number}")
    _check_masses(rows, where)


def refuse_far(values_m: Sequence[float], key: str, where: str) -> None:
    """Refuse lengths that cannot be metres.

    Args:
        values_m: the lengths.
        key: their key.
        where: file and row, or file and frame.

    Raises:
        ArmError: naming the key.
    """
    if max(map(abs, values_m), default=0.0) > _FAR_M:
        raise ArmError(
            f"{key} exceeds {_FAR_M:g} m",
            where=where,
            value=values_m[0] if len(values_m) == 1 else list(values_m),
            allowed="metres",
            remedy="divide by 1000 if the lengths are in millimetres",
        )


def _check_joint(row: ArmRow, where: str) -> None:
    kind, other = ("slides", "turns") if row.prismatic else ("turns", "slides")
    foreign = {
        "slides": ("limits_deg", "torque_limit_Nm", "gear_ratio"),
        "turns": ("limits_m", "force_limit_N"),
    }
    own = "limits_m and force_limit_N" if row.prismatic else "limits_deg and torque_limit_Nm"
    for key in foreign[kind]:
        if getattr(row, key) is not None:
            raise ArmError(
                f"{key} is for a joint that {other}, and this one {kind}",
                where=where,
                value=getattr(row, key),
                allowed=own,
                remedy=f"correct the key, or set prismatic: {str(not row.prismatic).lower()}",
            )
    if row.prismatic and row.limits_m is None:
        raise ArmError(
            "a prismatic joint needs limits",
            where=where,
            allowed="limits_m: [lowest, highest], in metres",
            remedy="set limits_m",
        )
    key = "limits_m" if row.prismatic else "limits_deg"
    low, high = getattr(row, key) or (-_FULL_TURN_DEG, _FULL_TURN_DEG)
    if low >= high:
        raise ArmError(
            f"{key} allows the joint no motion",
            where=where,
            value=[low, high],
            allowed="the lower limit first, then a higher one",
            remedy=f"correct {key}",
        )
    lengths = {"limits_m": row.limits_m or (), "com_m": row.com_m or ()}
    for key, values in lengths.items():
        refuse_far(values, key, where)


def _check_angles(row: ArmRow, where: str) -> None:
    for key in ("theta_deg", "alpha_deg"):
        value = getattr(row, key)
        quarters = round(abs(value) / (math.pi / 2.0))
        if 1 <= quarters <= 4 and math.isclose(
            abs(value), quarters * math.pi / 2.0, rel_tol=_QUARTER_TURN_DIGITS
        ):
            raise ArmError(
                f"{key} looks like radians",
                where=where,
                value=value,
                allowed="degrees",
                remedy=f"write {math.copysign(90.0 * quarters, value):g}",
            )


def _check_limits_are_degrees(rows: Sequence[ArmRow], where: str) -> None:
    limits_deg = {number: row.limits_deg for number, row in enumerate(rows, 1) if row.limits_deg}
    if limits_deg and all(max(map(abs, pair)) < 6.3 for pair in limits_deg.values()):
        number = next(iter(limits_deg))
        raise ArmError(
            "limits_deg looks like radians, in this and every other row",
            where=f"{where}: row {number}",
            value=list(limits_deg[number]),
            allowed="degrees",
            remedy="multiply by 180/pi",
        )


def _check_proportions(rows: Sequence[ArmRow], where: str) -> None:
    lengths_m = [
        (abs(getattr(row, key)), number, key)
        for number, row in enumerate(rows, start=1)
        for key in ("d_m", "a_m")
        if getattr(row, key)
    ]
    for k, (length_m, number, key) in enumerate(lengths_m):
        others = [other for j, (other, _, _) in enumerate(lengths_m) if j != k]
        if length_m > _LONG_M and others and length_m > _OUT_OF_PROPORTION * median(others):
            raise ArmError(
                f"{key} is out of proportion to the other lengths",
                where=f"{where}: row {number}",
                value=getattr(rows[number - 1], key),
                allowed=f"metres, as the others are (their median is {median(others):g})",
                remedy="divide by 1000 if this one is in millimetres",
            )


def _check_masses(rows: Sequence[ArmRow], where: str) -> None:
    stated = [number for number, row in enumerate(rows, 1) if row.mass_kg is not None]
    for number, row in enumerate(rows, start=1):
        missing = [key for key in ("mass_kg", "com_m") if stated and getattr(row, key) is None]
        if missing or (row.com_m is not None and row.mass_kg is None):
            raise ArmError(
                f"{' and '.join(missing) or 'mass_kg'} is missing",
                where=f"{where}: row {number}",
                allowed="mass_kg and com_m in every row, or in none",
                remedy="complete the row, or remove all masses",
            )
