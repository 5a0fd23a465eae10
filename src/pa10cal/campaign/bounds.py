"""Columns of the contract with the bounds of their numbers, and refusals of impossible values.

Bounds are wide: no right reading lies outside, so a number that does was not measured, or is in
another unit. `docs/raw-data.md` lists them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import loads_as_named
from pa10cal.arrays import Array, Mask
from pa10cal.campaign.column_map import UNIT_WORDS
from pa10cal.campaign.raw_rows import RawRows
from pa10cal.errors import RawDataError

NOT_UNCERTAIN = "the stated uncertainty is not above zero"
#: Joints may be logged beyond their described limits by so much.
BEYOND_LIMITS = {"deg": 10.0, "mm": 20.0}
TEMPERATURES_C = (-60.0, 150.0)
#: Temperatures between these are taken for kelvin.
_KELVIN = (220.0, 330.0)
#: Largest stated uncertainties of lengths, angles, torques and quaternions; and the least of all.
LARGEST_U = {"mm": 1e3, "deg": 90.0, "Nm": 1e5, "": 1.0}
LEAST_U = 1e-9
#: Gravity on Earth is 9.78 to 9.83 m/s2; elsewhere it is anything up to that of Jupiter, but no
#: body with a surface has about 1 m/s2, which is that of the Earth in its own unit.
EARTH_M_S2, LARGEST_M_S2 = (9.5, 10.1), 26.0
UNITS_OF_G = (0.9, 1.1)
STANDARD_M_S2 = 9.80665
#: Largest mass of a tool for each metre of the arm's reach, where the arm's mass is not known; and
#: the least mass of an arm likewise: below, the links have placeholders for masses [kg/m].
TOOL_KG_PER_M = 1000.0
LEAST_ARM_KG_PER_M = 1.0
#: Numbers beyond the limits that whole turns bring within, at least, in a log that wraps angles.
LEAST_WRAPPED = 2
ONE_TURN_DEG = 360.0
#: Part of the rows that another unit, or whole turns, must bring within bounds.
NEARLY_ALL = 0.9


@dataclass(frozen=True)
class Bound:
    """Bounds of the numbers in a column, which are allowed themselves."""

    low: float
    high: float
    below: str  # reason to quarantine a number below
    above: str  # and above


def _both(low: float, high: float, reason: str) -> Bound:
    return Bound(low, high, reason, reason)


#: No instrument measures further; loads and torques are beyond the largest industrial arms; Unix
#: time in seconds has ten digits, in milliseconds thirteen.
_LENGTH = _both(-1e6, 1e6, "a coordinate beyond any measuring volume")
_TORQUE = _both(-1e5, 1e5, "a torque beyond that of any arm")
_LOAD = Bound(0.0, 3e4, "negative load", "a load beyond any arm's")
_TIME = _both(-1e11, 1e11, "a time beyond any clock in seconds")
_COUNT = _both(-1e9, 1e9, "a number beyond any count")
_QUATERNION = _both(-2.0, 2.0, "the quaternion is not of unit length")
_TEMPERATURE = _both(
    *TEMPERATURES_C, "a temperature outside {:g} to {:g} deg C".format(*TEMPERATURES_C)
)


@dataclass(frozen=True)
class Rule:
    """A column of the contract, or several with names of one form."""

    pattern: str  # regular expression of the names
    key: str  # the key of `columns` that maps it
    words: str  # what it is, in words; groups of the name as \\1, \\2
    bound: Bound | None = _LENGTH  # None for joints, whose limits the arm states, and for text


#: The columns of the contract; the first whose expression matches a name counts.
RULES = (
    Rule(r"q(\d+)_(?:deg|mm)", "joints", r"position of joint \1", None),
    Rule(r"tau(\d+)_Nm", "torques", r"torque of joint \1", _TORQUE),
    Rule("load_N", "load", "external load", _LOAD),
    Rule("time_s", "time", "time", _TIME),
    Rule("temperature_C", "temperature", "temperature", _TEMPERATURE),
    Rule("kind", "kind", "calibration or held out", None),
    Rule("pose", "pose", "label of the pose", None),
    Rule("repeat", "repeat", "number of the repeat", _COUNT),
    Rule("touch", "touch", "touch", _COUNT),
    Rule("q[wxyz]", "rotation", "orientation of the target", _QUATERNION),
    Rule("d_mm", "distance", "distance"),
    Rule("([xyz])_mm", "position", r"\1 of the target"),
    Rule(r"(base\d+)_([xyz])_mm", "targets", r"\2 of \1, on the base"),
    Rule(r"(\w+)_([xyz])_mm", "targets", r"\2 of target \1"),
)


def rule_of(name: str) -> Rule:
    """Return the rule of a column; of an unknown one the rule of lengths."""
    known = (rule for rule in RULES if re.fullmatch(rule.pattern, name))
    return next(known, Rule("", name, name))


def in_words(name: str) -> str:
    """Return what a column of the contract is, in words; the name of any other column."""
    quantity = name.removeprefix("u_")
    rule = rule_of(quantity)
    match = re.fullmatch(rule.pattern, quantity)
    if match is None:
        return name
    words = match.expand(rule.words)
    return words if quantity == name else f"standard uncertainty of the {words}"


def bound_of(name: str, arm: Arm) -> Bound:
    """Return the bound of a column of numbers of an arm's campaign."""
    unit = _unit_of(name)
    if name.startswith("u_"):
        largest = LARGEST_U.get(unit, LARGEST_U[""])
        return Bound(LEAST_U, largest, NOT_UNCERTAIN, f"a stated uncertainty above {largest:g}")
    rule = rule_of(name)
    if rule.bound is not None:
        return rule.bound
    joint = int(name[1:].partition("_")[0])
    limits = _limits_of_log(arm)[joint - 1]
    low, high = 1e3 * np.array(limits) if unit == "mm" else np.degrees(limits)
    text = (
        f"beyond the limits of joint {joint} in the description of {arm.name} "
        f"({low:g} to {high:g} {unit})"
    )
    return _both(float(low) - BEYOND_LIMITS[unit], float(high) + BEYOND_LIMITS[unit], text)


def _limits_of_log(arm: Arm) -> Array:
    """Return the limits (m, 2) of what a controller may count for each axis [rad, m].

    Stated limits of a coupled joint may be of the joint, or of what the controller counts.
    """
    return arm.coupling.axis_ranges(arm.axis_limits_rad)


def outside_bounds(raw: RawRows, names: Sequence[str], arm: Arm) -> Mask:
    """Return the rows (N,) with a number outside the bounds of its column."""
    off = np.zeros(len(raw), dtype=bool)
    for name in names:
        bound = bound_of(name, arm)
        off |= (raw[name] < bound.low) | (raw[name] > bound.high)
    return off


def within_bounds(raw: RawRows, names: list[str], arm: Arm) -> RawRows:
    """Quarantine rows with a number outside the bounds of its column; blanks are allowed.

    Temperatures in kelvin, and numbers in another unit than is stated, are refused.
    """
    _refuse_own_unit(raw, names, arm)
    if "temperature_C" in names:
        _refuse_kelvin(raw)
    for name in names:
        bound = bound_of(name, arm)
        raw = _without(raw, name, raw[name] < bound.low, bound.below)
        raw = _without(raw, name, raw[name] > bound.high, bound.above)
    return raw


def _without(raw: RawRows, name: str, off: Mask, reason: str) -> RawRows:
    """Quarantine rows `off` (N,) for the number in a column."""
    values = [raw.shown(name, int(row)) for row in np.flatnonzero(off)]
    return raw.take(~off, reason, values)


def _refuse_kelvin(raw: RawRows) -> None:
    """Refuse a column of temperatures in kelvin that campaign.yaml states in another unit."""
    name = "temperature_C"
    source = raw.own.sources.get(name)
    if not np.isfinite(raw[name]).any() or (source is not None and source.unit == "K"):
        return
    middle = float(np.nanmedian(raw[name]))
    if source is not None:  # the file's own number, which may be stated as degrees Fahrenheit
        middle = (middle - source.offset) / source.factor
    if _KELVIN[0] < middle < _KELVIN[1]:
        remedy = "subtract 273.15" if source is None else raw.own.set_unit(name, "K", "")
        raise _kelvin(f"{raw.file}: {raw.own.column(name)}", middle, remedy)


def unwrapped(
    raw: RawRows, q: Sequence[str], arm: Arm, *, spread_deg: float = ONE_TURN_DEG
) -> RawRows:
    """Return rows with joints moved by whole turns into their limits, if the log wraps angles.

    It does if whole turns bring nearly all numbers of some joint that are beyond its limits within
    them. Then the numbers of all joints are taken nearest to the middle of their limits, as a log
    wraps all or none. Joints of which a whole turn would change the pose, as by a coupling, are
    left as they are.

    Args:
        raw: N rows.
        q: columns of the joint positions, in order.
        arm: the arm.
        spread_deg: a joint whose numbers span more is left as it is, as they may be in another
            unit. Infinite for controllers that count turns, if the result is compared with what
            was measured.
    """
    moved: dict[str, NDArray[Any]] = {}
    wraps = False
    limits, turns_freely = np.degrees(_limits_of_log(arm)), _turns_freely(arm)
    for k, name in enumerate(q):
        if turns_freely[k]:
            column, wrapped = _moved_by_turns(raw[name], limits[k], spread_deg)
            wraps |= wrapped >= LEAST_WRAPPED
            if not np.array_equal(column, raw[name], equal_nan=True):
                moved[name] = column
    if not wraps:
        return raw
    words = ", ".join(raw.own.column(name) for name in moved)
    logged = "angles logged within one turn" if spread_deg == ONE_TURN_DEG else "angles"
    note = f"{words}: {logged} are moved by whole turns, into the limits"
    return replace(raw.with_columns(moved), notes=(*raw.notes, f"{raw.file}: {note}"))


def _turns_freely(arm: Arm) -> Mask:
    """Return the axes (m,) of which a whole turn leaves the pose as it is.

    It turns every joint a whole number of times, and no joint slides.
    """
    C = arm.coupling.matrix
    whole = np.where(arm.prismatic[:, None], C == 0.0, np.isclose(C, np.round(C), atol=1e-9))
    return np.asarray(whole.all(axis=0))


def _moved_by_turns(
    column: NDArray[Any], limits_deg: Array, spread_deg: float
) -> tuple[NDArray[Any], int]:
    """Return a joint's angles (N,) [deg] moved by whole turns into its limits, if they are wrapped.

    A few numbers too far off to be wrapped angles, as of a sensor that failed, count for nothing
    and stay.

    Returns:
        (N,) the angles, as they are where they are not wrapped; how many of them were beyond the
        limits, 0 where they are not wrapped.
    """
    low, high = limits_deg + BEYOND_LIMITS["deg"] * np.array([-1.0, 1.0])
    if not np.isfinite([low, high]).all():
        return column, 0
    plausible = (column >= low - spread_deg) & (column <= high + spread_deg)
    if not plausible.any() or plausible.sum() < NEARLY_ALL * np.isfinite(column).sum():
        return column, 0
    turns = np.round((column - 0.5 * (low + high)) / ONE_TURN_DEG)
    nearest = column - ONE_TURN_DEG * turns
    brought_inside = plausible & (nearest >= low) & (nearest <= high)
    outside = plausible & ((column < low) | (column > high))
    if np.ptp(column[plausible]) > spread_deg:  # perhaps another unit
        return column, 0
    if brought_inside[outside].sum() < NEARLY_ALL * outside.sum():  # whole turns do not explain it
        return column, 0
    return np.where(brought_inside, nearest, column), int(outside.sum())


def only_whole_numbers(raw: RawRows, name: str, arm: Arm) -> RawRows:
    """Quarantine rows whose column holds no whole number within its bounds."""
    raw = within_bounds(raw.finite([name]), [name], arm)
    keep = raw[name] == np.round(raw[name])
    values = [f"{raw.name_of(name)} = {value:.10g}" for value in raw[name][~keep]]
    raw = raw.take(keep, "not a whole number", values)
    return raw.with_columns({name: raw[name].astype(np.int64)})


def only_labelled_rows(raw: RawRows, arm: Arm) -> RawRows:
    """Quarantine rows that lack a label, a load or the number of the repeat.

    Loads of one name become one load.
    """
    raw = within_bounds(raw.finite(["load_N"]), ["load_N"], arm)
    raw = only_whole_numbers(raw, "repeat", arm)
    raw = raw.with_columns({"load_N": loads_as_named(raw["load_N"])})
    return raw.take(raw.text_of("pose") != "", "the pose has no label")


class _RowsByUnit(NamedTuple):
    """Rows (N,) of some columns, as they are read and as the contract's unit would have them."""

    filled: Mask  # a number is there
    outside_as_stated: Mask  # (C, N) numbers out of bounds in the unit that campaign.yaml states
    # a number is there, and all would be within bounds if the file were in the contract's unit
    within_in_contract_unit: Mask

    @classmethod
    def of(cls, raw: RawRows, columns: Sequence[str], arm: Arm) -> _RowsByUnit:
        """Return the rows of columns (C) that campaign.yaml states in another unit."""
        bounds, sources = [bound_of(name, arm) for name in columns], raw.own.sources
        low, high, factor, offset, zero = (
            np.array(each)[:, None]
            for each in (
                [bound.low for bound in bounds],
                [bound.high for bound in bounds],
                [sources[name].factor for name in columns],
                [sources[name].offset for name in columns],
                [sources[name].zero for name in columns],
            )
        )
        as_stated = np.stack([raw[name] for name in columns])
        own_numbers = (as_stated - offset) / factor
        # Stated signs and zeros of joints count in either unit.
        in_contract_unit = np.sign(factor) * own_numbers + zero
        filled = np.isfinite(as_stated).any(axis=0)
        outside = ((in_contract_unit < low) | (in_contract_unit > high)).any(axis=0)
        return cls(filled, (as_stated < low) | (as_stated > high), filled & ~outside)


def _refuse_own_unit(raw: RawRows, names: list[str], arm: Arm) -> None:
    """Refuse columns that are in the contract's unit though campaign.yaml states another one.

    That is a larger one, or one with another zero. Blanks count neither way. Angles and strokes of
    joints have one key, but a unit each.
    """
    by_key_and_unit: dict[tuple[str, str], list[str]] = {}
    for name in names:
        own = raw.own.sources.get(name)
        if own is None or name.startswith("u_"):
            continue
        if abs(own.factor) > 1.0 or own.offset != own.zero:
            by_key_and_unit.setdefault((own.key, _unit_of(name)), []).append(name)
    for columns in by_key_and_unit.values():
        rows = _RowsByUnit.of(raw, columns, arm)
        count, wrong = rows.filled.sum(), rows.outside_as_stated.any(axis=0)
        explained = rows.within_in_contract_unit.sum() >= NEARLY_ALL * count
        if wrong.sum() > 0.5 * count and explained:
            raise _own_unit(raw, columns, rows)


def _unit_of(name: str) -> str:
    """Return the unit in the name of a column of the contract."""
    return name.rpartition("_")[2]


def _own_unit(raw: RawRows, columns: Sequence[str], rows: _RowsByUnit) -> RawDataError:
    """Return the refusal of columns that are in the contract's unit, with a row that shows it."""
    words, first, last = raw.own, columns[0], columns[-1]
    count, wrong = rows.filled.sum(), rows.outside_as_stated.any(axis=0)
    row = int(np.argmax(wrong & rows.within_in_contract_unit))
    shown = raw.shown(columns[int(np.argmax(rows.outside_as_stated[:, row]))], row)
    unit = _unit_of(first)
    what = {"deg": "joint angles", "mm": "positions", "C": "temperatures"}.get(unit, "numbers")
    if unit == "mm" and rule_of(first).key == "joints":
        what = "strokes"
    named = words.column(first) + (f" … {words.column(last)}" if first != last else "")
    return RawDataError(
        f"the {what} look like {UNIT_WORDS.get(unit, unit)}",
        where=f"{raw.file}:{raw.line[row]}: {named}",
        value=f"{wrong.sum()} of {count} rows are out of bounds in {words.sources[first].unit}, "
        f"and {count - rows.within_in_contract_unit.sum() or 'none'} so in {unit}: {shown}",
        allowed=f"numbers in the unit that {words.sources[first].key} states",
        remedy=words.set_unit(first, unit, unit),
    )


def refuse_impossible_tool(mass_kg: float, arm: Arm, where: str) -> None:
    """Refuse a tool that is heavier than the arm can carry; its mass may be in grams."""
    arm_kg = 0.0 if arm.mass_kg is None else float(np.sum(arm.mass_kg))
    weighed = arm_kg > LEAST_ARM_KG_PER_M * arm.reach_m
    largest_kg = arm_kg if weighed else TOOL_KG_PER_M * arm.reach_m
    if mass_kg > largest_kg:
        most = f"{largest_kg:.4g}" + (", the mass of the arm itself" if weighed else "")
        grams = mass_kg / 1000.0 <= largest_kg
        remedy = f"set tool.mass_kg: {mass_kg / 1000.0:g} if the mass is in grams"
        remedy = remedy if grams else "state it in kilograms"
        if weighed:  # whole kilograms for every link are placeholders, as in many URDF files
            remedy += f"; or correct the masses of the links in the description of {arm.name}"
        raise RawDataError(
            "the tool is heavier than the arm can carry",
            where=f"{where}: tool.mass_kg",
            value=mass_kg,
            allowed=f"kilograms, at most {most}",
            remedy=remedy,
        )


def refuse_impossible_gravity(gravity_m_s2: tuple[float, float, float], where: str) -> None:
    """Refuse gravity in another unit; zero means that it is not stated."""
    size = float(np.linalg.norm(gravity_m_s2))
    in_units_of_g = UNITS_OF_G[0] <= size <= UNITS_OF_G[1]
    if size <= LARGEST_M_S2 and not in_units_of_g:
        return
    what, factor = "of another size", 0.0
    if EARTH_M_S2[0] <= 1e-3 * size <= EARTH_M_S2[1]:
        what, factor = "in mm/s2", 1e-3
    elif in_units_of_g:
        what, factor = "in units of g", STANDARD_M_S2 / size
    meant = ", ".join(f"{factor * part:.6g}" for part in gravity_m_s2)
    upright = f"[0, 0, {-STANDARD_M_S2}]"
    other = f"state it in m/s2 in the robot's base frame, {upright} for a base that stands upright"
    remedy = f"set gravity_m_s2: [{meant}]" if factor else other
    least, most = EARTH_M_S2
    raise RawDataError(
        f"gravity is {what}",
        where=f"{where}: gravity_m_s2",
        value=list(gravity_m_s2),
        allowed=f"m/s2: {least:g} to {most:g} in size on Earth, at most {LARGEST_M_S2:g} anywhere",
        remedy=remedy,
    )


def refuse_impossible_temperature(temperature_C: float, where: str) -> None:
    """Refuse a stated temperature that is in kelvin, or not that of a laboratory."""
    if not TEMPERATURES_C[0] <= temperature_C <= TEMPERATURES_C[1]:
        set_to = f"set reference_temperature_C: {temperature_C - 273.15:.4g}"
        raise _kelvin(f"{where}: reference_temperature_C", temperature_C, set_to)


def _kelvin(where: str, value: float, remedy: str) -> RawDataError:
    kelvin = _KELVIN[0] < value < _KELVIN[1]
    what = "the temperature looks like kelvin" if kelvin else "no temperature of a laboratory"
    remedy = remedy if kelvin else "check its unit"
    least, most = TEMPERATURES_C
    return RawDataError(
        what,
        where=where,
        value=value,
        allowed=f"degrees Celsius, {least:g} to {most:g}",
        remedy=remedy,
    )
