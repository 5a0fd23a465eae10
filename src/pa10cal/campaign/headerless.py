"""Columns whose names say too little: joints and places, found by the nominal arm."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Index, spread
from pa10cal.campaign.column_map import ANGLES, LENGTHS
from pa10cal.campaign.csv_rows import same_name
from pa10cal.campaign.joint_names import joint_sets
from pa10cal.campaign.joint_positions import in_radians
from pa10cal.campaign.log_labels import by_label, shared_labels
from pa10cal.campaign.matrices import rows_of_a_matrix
from pa10cal.campaign.nominal_fit import placed_by_points
from pa10cal.campaign.recognise import Roles, standing
from pa10cal.campaign.sniffing import Sniffed
from pa10cal.errors import RawDataError

#: Rows that are compared, at most and at least.
_ROWS, _LEAST_ROWS = 60, 12
#: Columns agree with the nominal arm below this rms misfit [m], if any others leave so many times
#: more.
NEAR_M, NEARER = 0.02, 3.0
#: Columns that are tried, at most; part of the rows in which joints must lie within their limits.
_COLUMNS, _WITHIN = 40, 0.95
#: Places spread by more than the first and less than the second in their two largest extents [m].
_SPREAD_M, _FAR_M = 0.05, 10.0
#: Different whole numbers in a column that names targets, at most.
_TARGETS = 6
#: Joints move by more than this.
_MOVES_RAD = 0.2
#: Sets of joints, and of places, that are tried where arms are side by side. They agree equally
#: well within this factor of the least misfit, or below this misfit [m].
_SETS, _AS_NEAR, _ALIKE_M = 12, 1.5, 5e-3


class RolesByArm(NamedTuple):
    """Roles of columns with which the nominal arm agrees."""

    scatter_m: float  # rms misfit, base and target fitted
    of_joints: Roles  # of the joints' log
    of_readings: Roles  # the same if that is the file of the readings


def roles_by_arm(
    joints: tuple[Roles, Sniffed], readings: tuple[Roles, Sniffed], arm: Arm
) -> RolesByArm | None:
    """Return the roles of the joints' log and of the readings; both may be of one file.

    Columns that a header names keep their roles. Others get the role in which the nominal arm
    explains them best, in rows with the same label, else row by row. None where no columns agree
    with the arm, or several sets do.
    """
    (joint_roles, log), (reading_roles, measured) = joints, readings
    rows = _rows_together(log, measured)
    if rows is None:
        return None
    sets = [joint_roles.joints] if joint_roles.joints else _runs(log.names, len(arm.axes_slide))
    places = list(reading_roles.positions.values())[:1] or _runs(measured.names, 3)
    tried = []
    for columns, T_base_ee in _ends(log.columns, sets, rows[0], arm):
        for place, p_m in _places(measured.columns, places, rows[1]):
            if log is not measured or not set(place) & set(columns):
                tried.append((_scatter_m(T_base_ee, p_m[:, None]), columns, place))
    tried.sort()
    if not tried or tried[0][0] > NEAR_M:
        return None
    scatter_m, columns, place = tried[0]
    if len(tried) > 1 and tried[1][0] < NEARER * scatter_m:
        return None
    joint_roles = replace(joint_roles, joints=columns)
    if not reading_roles.positions:
        reading_roles = replace(reading_roles, positions={"": place}, attitude=None)
    if log is measured:
        joint_roles = reading_roles = replace(
            joint_roles, positions=reading_roles.positions, attitude=reading_roles.attitude
        )
    return RolesByArm(scatter_m, joint_roles, reading_roles)


def of_the_arm(roles: Roles, sniffed: Sniffed, arm: Arm, own: Sequence[str] = ()) -> Roles:
    """Return roles with the joints and places of this arm, in a file with columns of several arms.

    Such columns have the same names, or names that differ by words such as left and right. The
    roles stay as they are where they agree with the nominal arm as well as any, or where none do.

    Args:
        roles: roles by the names of the columns.
        sniffed: the file.
        arm: the nominal arm.
        own: names of the joints in the arm's description, in order; empty where it has none.
    """
    rows = _rows_together(sniffed, sniffed)
    if rows is None or not roles.positions or sniffed.titles:
        return roles
    sets = _same_named(roles.joints, sniffed.names) if roles.joints else []
    sets = list(dict.fromkeys((*sets, *joint_sets(sniffed.names, len(arm.axes_slide), own))))
    places = [
        place for names in roles.positions.values() for place in _same_named(names, sniffed.names)
    ]
    if len(sets) < 1 + bool(roles.joints):
        return roles
    tried = [
        (_scatter_m(T_base_ee, p_m[:, None]), columns, place)
        for columns, T_base_ee in _ends(sniffed.columns, sets[:_SETS], rows[0], arm)
        for place, p_m in _places(sniffed.columns, places[:_SETS], rows[1])
    ]
    least_m = min((scatter_m for scatter_m, *_ in tried), default=np.inf)
    if least_m > NEAR_M:
        return roles
    limit_m = max(_AS_NEAR * least_m, _ALIKE_M)
    # The first set that agrees: the one by the names, if it does.
    joints = next(columns for scatter_m, columns, _ in tried if scatter_m < limit_m)
    agree = [
        place for scatter_m, columns, place in tried if columns == joints and scatter_m < NEAR_M
    ]
    return replace(_with_places(roles, sniffed, agree), joints=joints)


def _with_places(roles: Roles, sniffed: Sniffed, agree: Sequence[tuple[str, ...]]) -> Roles:
    """Return roles with the places that agree with the nominal arm, or that stand still.

    Where none of the roles agrees, the first place of `agree` goes before those that stand still.
    An orientation goes with the first place: the k-th of the columns of the same names with the
    k-th place.
    """
    still = standing({label: sniffed.columns(names) for label, names in roles.positions.items()})
    positions = {
        label: names for label, names in roles.positions.items() if label in still or names in agree
    }
    if all(label in still for label in positions):
        positions = {"": agree[0]} | positions
    attitude, first = roles.attitude, next(iter(roles.positions.values()))
    if attitude is not None and first not in agree:
        places = [
            place
            for names in roles.positions.values()
            for place in _same_named(names, sniffed.names)
        ]
        of_place = dict(zip(places, _same_named(attitude[0], sniffed.names), strict=False))
        attitude = (of_place[agree[0]], attitude[1]) if agree[0] in of_place else None
    return replace(roles, positions=positions, attitude=attitude)


def _same_named(names: Sequence[str], all_names: Collection[str]) -> list[tuple[str, ...]]:
    """Return the columns, then every further set of columns of the same names in the file."""
    sets = [tuple(names)]
    while all(same_name(name, len(sets) + 1) in all_names for name in names):
        sets.append(tuple(same_name(name, len(sets) + 1) for name in names))
    return sets


def logs_by_arm(
    both: list[tuple[Roles, Sniffed, Path]], arm: Arm
) -> list[tuple[Roles, Sniffed, Path]]:
    """Return roles of two logs, at least one of them without a header, by the nominal arm.

    Either may be the joints' log, which is returned first where the arm decides.

    Raises:
        RawDataError: when the joints' log has the column that names the target of a reading.
    """
    fits = []
    for (joint_roles, log, file), (reading_roles, measured, other) in (both, both[::-1]):
        joints_possible = is_headerless(log) or joint_roles.joints
        if joints_possible and (is_headerless(measured) or reading_roles.positions):
            by_arm = roles_by_arm((joint_roles, log), (reading_roles, measured), arm)
            if by_arm is not None:
                in_order = [(by_arm.of_joints, log, file), (by_arm.of_readings, measured, other)]
                fits.append((by_arm.scatter_m, in_order))
    if fits:
        return min(fits, key=lambda fit: fit[0])[1]
    for (joint_roles, log, file), (reading_roles, measured, other) in (both, both[::-1]):
        # What was measured is known by itself, and nothing else can be meant.
        alone = is_headerless(log) and len(log.names) == len(arm.axes_slide)
        if alone and reading_roles.positions and not joint_roles.positions:
            joint_roles = replace(joint_roles, joints=tuple(log.names))
            return [(joint_roles, log, file), (reading_roles, measured, other)]
    if not all(is_headerless(log) for _, log, _ in both):
        return both
    for (joint_roles, log, file), (reading_roles, measured, other) in (both, both[::-1]):
        rows = _rows_of_targets(log, measured, arm)
        if rows is None:
            continue
        if rows.of_readings:
            joint_roles = replace(joint_roles, joints=rows.joints)
            reading_roles = replace(reading_roles, positions={"": rows.place}, attitude=None)
            return [(joint_roles, log, file), (reading_roles, measured, other)]
        raise RawDataError(
            f"column {rows.target} says which of {len(rows.words)} targets a row is of",
            where=file.name,
            value=", ".join(rows.words),
            allowed=f"that column in {other.name}, or three columns for each target",
            remedy=f"copy column {rows.target} behind those of {other.name}; or write headers, "
            f"and columns T1_x, T1_y, T1_z, T2_x … in place of columns {', '.join(rows.place)}",
        )
    return both


def refuse_untold(files: Sequence[tuple[Sniffed, Path]]) -> None:
    """Refuse files without headers whose rows are too few, or too unlike in number, for the arm.

    Raises:
        RawDataError: for one file or two logs, at least one of them without a header.
    """
    (log, file), (measured, other) = files[0], files[-1]
    if not any(is_headerless(each) for each, _ in files) or _rows_together(log, measured):
        return
    count, others = len(log.numbers), len(measured.numbers)
    named = next(path.name for each, path in files if is_headerless(each))
    remedy = "write headers, such as q1_deg, q2_deg … and x_mm, y_mm, z_mm"
    for each, path in files:
        if rows := rows_of_a_matrix(each.numbers):
            raise RawDataError(
                f"{path.name} holds matrices of {rows} rows, one below another",
                where=f"{file.name} and {other.name}",
                value=f"{count} and {others} rows",
                allowed="one row for each pose",
                remedy=f"write each into one row of {4 * rows} numbers",
            )
    if count == others:
        what, allowed = "too few rows", f"at least {_LEAST_ROWS} rows"
    else:
        what, allowed = "rows that do not belong together", "one row in each log, or shared labels"
        fewer, more = sorted((count, others))
        if fewer and more % fewer == 0:
            many = more // fewer
            remedy += (
                f"; where each pose has {many} rows of readings, put them in one row, as T1_x, "
                f"T1_y, T1_z, T2_x … of {many} targets, or write its joints {many} times"
            )
    raise RawDataError(
        f"{named} has no header, and {what} to tell its columns by the nominal arm",
        where=" and ".join(dict.fromkeys((file.name, other.name))),
        value=f"{count} rows" if log is measured else f"{count} and {others} rows",
        allowed=allowed,
        remedy=remedy,
    )


def _rows_together(log: Sniffed, measured: Sniffed) -> tuple[Index, Index] | None:
    """Return rows of both logs that belong together; None where too few are known to."""
    labels = None if log is measured else labels_of_both(log, measured)
    if labels is not None:
        station = by_label(np.array(log.words(labels[0])), np.array(measured.words(labels[1])))
        read_rows = np.flatnonzero(station >= 0)
        log_rows = station[read_rows]
    elif len(log.numbers) == len(measured.numbers):
        log_rows = read_rows = np.arange(len(log.numbers))
    else:
        return None
    some = spread(len(log_rows), _ROWS)
    return (log_rows[some], read_rows[some]) if len(log_rows) >= _LEAST_ROWS else None


def labels_of_both(log: Sniffed, measured: Sniffed) -> tuple[str, str] | None:
    """Return the columns of labels that two logs share; None for none.

    Numbers that count the rows of the joints' log are labels where the other log has another number
    of rows.
    """
    labels = shared_labels(log.texts, measured.texts)
    if labels is None and len(log.numbers) != len(measured.numbers):
        labels = shared_labels(log.counts, measured.texts)
    return labels


def _runs(names: Sequence[str], count: int) -> list[tuple[str, ...]]:
    """Return all runs of `count` neighbouring columns."""
    return [tuple(names[k : k + count]) for k in range(min(len(names), _COLUMNS) - count + 1)]


@dataclass(frozen=True)
class _RowsOfTargets:
    """Columns without names that the nominal arm explains, in rows of one target each."""

    joints: tuple[str, ...]
    place: tuple[str, ...]
    target: str  # column that names the target of a row
    of_readings: bool  # whether that column is in the log of readings
    words: tuple[str, ...]  # the different words in that column


def _rows_of_targets(joints: Sniffed, readings: Sniffed, arm: Arm) -> _RowsOfTargets | None:
    """Return the columns that agree with the arm where one of few whole numbers names the target.

    Joints and readings may be one file.
    """
    rows = _rows_together(joints, readings)
    if rows is None:
        return None
    runs = _runs(joints.names, len(arm.axes_slide))
    # Those of the readings first: there, a column that was copied is read.
    columns_of_targets = [(readings, rows[1], name) for name in readings.names]
    if joints is not readings:
        columns_of_targets += [(joints, rows[0], name) for name in joints.names]
    for log, log_rows, name in columns_of_targets:
        numbers = log.column(name)[log_rows]
        targets = np.unique(numbers)
        whole = np.isfinite(numbers).all() and (numbers == np.round(numbers)).all()
        if not whole or not 2 <= len(targets) <= _TARGETS:
            continue
        of_target = (numbers[:, None] == targets)[..., None]
        for columns, T_base_ee in _ends(joints.columns, runs, rows[0], arm):
            for place, p_m in _places(readings.columns, _runs(readings.names, 3), rows[1]):
                if joints is readings and set(place) & {*columns, name}:
                    continue
                seen_m = np.where(of_target, p_m[:, None], np.nan)
                if _scatter_m(T_base_ee, seen_m) < NEAR_M:
                    words = tuple(f"{target:g}" for target in targets)
                    return _RowsOfTargets(columns, place, name, log is readings, words)
    return None


def of_rows_of_targets(roles: Roles, sniffed: Sniffed, arm: Arm) -> Roles:
    """Return the roles in a file without a header; changed if its rows are of one target each."""
    rows = _rows_of_targets(sniffed, sniffed, arm)
    if rows is None:
        return roles
    return replace(roles, joints=rows.joints, positions={"": rows.place}, attitude=None)


def _ends(
    columns_of: Callable[[Sequence[str]], Array],
    sets: Sequence[tuple[str, ...]],
    rows: Index,
    arm: Arm,
) -> Iterator[tuple[tuple[str, ...], Array]]:
    """Yield the sets of columns that may be joints, in each possible unit, with the nominal end.

    The end (N, 4, 4) is that at the N rows.
    """
    slides = arm.axes_slide
    for columns in sets:
        values = columns_of(columns)[rows]
        # A joint may stand still throughout where nothing else can be meant.
        still = len(sets) > 1 and np.ptp(values, axis=0).min() == 0.0
        if still or not np.isfinite(values).all():
            continue
        for angle, length in product(("deg", "rad"), ("mm", "m") if slides.any() else ("mm",)):
            axes = in_radians(values * np.where(slides, LENGTHS[length], ANGLES[angle]), slides)
            q = arm.coupling.to_joints(axes)
            low, high = arm.limits_rad.T
            margin = 0.02 * (high - low)
            within = ((q >= low - margin) & (q <= high + margin)).all(axis=1)
            # Degrees taken for radians are far out of the limits; radians for degrees hardly move.
            if within.mean() >= _WITHIN and np.ptp(q, axis=0).max() > _MOVES_RAD:
                yield columns, Chain.of(arm).forward(q)


def _places(
    columns_of: Callable[[Sequence[str]], Array], sets: Sequence[tuple[str, ...]], rows: Index
) -> Iterator[tuple[tuple[str, ...], Array]]:
    """Yield the sets of columns that may be a place, with it (N, 3) [m]; nan where not seen."""
    for columns, unit in product(sets, ("mm", "m")):
        p_m = 1e-3 * LENGTHS[unit] * columns_of(columns)[rows]
        known = np.flatnonzero(np.isfinite(p_m).all(axis=1))
        p_m = np.where(np.isfinite(p_m).all(axis=1, keepdims=True), p_m, np.nan)
        enough = 2 * len(known) > len(p_m)
        spread_m = np.sort(np.ptp(p_m[known], axis=0)) if enough else np.zeros(3)
        if spread_m[1] > _SPREAD_M and spread_m[2] < _FAR_M:
            yield columns, p_m


def _scatter_m(T_base_ee: Array, p_m: Array) -> float:
    """Return the rms misfit of targets (N, B, 3), base and targets fitted; inf for no fit."""
    located = placed_by_points(T_base_ee, p_m)
    return np.inf if located is None else located.scatter_m


def is_headerless(log: Sniffed) -> bool:
    """Return whether a file names no columns."""
    return log.layout.header == 0 and not log.titles and not log.layout.format
