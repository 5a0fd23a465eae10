"""Columns whose names tell too little: joints, places and targets, found by the nominal arm."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Index, spread
from pa10cal.campaign.csv_rows import same_name
from pa10cal.campaign.file_roles import joint_sets
from pa10cal.campaign.nominal_fit import placed_by_points
from pa10cal.campaign.own_columns import TargetOfRow
from pa10cal.campaign.raw_rows import ANGLES, LENGTHS, in_radians
from pa10cal.campaign.recognise import Roles, has_word, standing, words_of_name
from pa10cal.campaign.sniffing import Sniffed
from pa10cal.campaign.two_logs import by_label, shared_labels
from pa10cal.errors import RawDataError

#: Rows that are looked at, and those that tell.
_ROWS, _LEAST_ROWS = 60, 12
#: The nominal arm is so near to the places [m], and so many times further off any other columns.
NEAR_M, NEARER = 0.02, 3.0
#: Columns at most; joints lie within the limits in so many rows.
_COLUMNS, _WITHIN = 40, 0.95
#: Places spread by more than this [m]; a column of so few whole numbers tells targets apart.
_SPREAD_M, _FAR_M, _TARGETS = 0.05, 10.0, 6
#: Joints move by more than this.
_MOVES_RAD = 0.2
#: So many sets of joints, and places, are tried; those are as near that are off by so much more, or
#: by less than what the nominal arm may be off [m].
_SETS, _AS_NEAR, _ALIKE_M = 12, 1.5, 5e-3


def roles_by_arm(
    joints: tuple[Roles, Sniffed], readings: tuple[Roles, Sniffed], arm: Arm
) -> tuple[float, Roles, Roles] | None:
    """Return roles of a log of joints and of one of readings, or twice of one file with both.

    What a header names stays; columns without names are those that the nominal arm explains, in
    rows with the same label, else row by row. The first is how far it is off [m]; None where no
    columns agree, or several do.
    """
    (of_joints, log), (of_readings, read) = joints, readings
    rows = _rows_together(log, read)
    if rows is None:
        return None
    named = [of_joints.joints] if of_joints.joints else _runs(log.names, len(arm.axes_slide))
    places = list(of_readings.positions.values())[:1] or _runs(read.names, 3)
    tried = []
    for columns, T_base_ee in _ends(log.columns, named, rows[0], arm):
        for place, p_m in _places(read.columns, places, rows[1]):
            if log is not read or not set(place) & set(columns):
                tried.append((_scatter_m(T_base_ee, p_m[:, None]), columns, place))
    tried.sort()
    others = [scatter_m for scatter_m, *_ in tried[1:]]
    if not tried or tried[0][0] > NEAR_M or (others and others[0] < NEARER * tried[0][0]):
        return None
    scatter_m, columns, place = tried[0]
    # Of several ways to read the same columns the nearest is taken as it is.
    found = replace(of_joints, joints=columns), of_readings
    if not of_readings.positions:
        found = found[0], replace(of_readings, positions={"": place}, attitude=None)
    if log is read:
        both = replace(found[0], positions=found[1].positions, attitude=found[1].attitude)
        found = both, both
    return scatter_m, *found


def of_the_arm(roles: Roles, sniffed: Sniffed, arm: Arm, own: Sequence[str] = ()) -> Roles:
    """Return roles with the joints and places that the nominal arm explains, of several arms' ones.

    These stand side by side, under the same names or beside words such as left and right. What was
    recognised stays where it agrees as well, or where nothing does.
    """
    rows = _rows_together(sniffed, sniffed)
    if rows is None or not roles.positions or sniffed.titles:
        return roles
    sets = _again(roles.joints, sniffed.names) if roles.joints else []
    sets = list(dict.fromkeys((*sets, *joint_sets(sniffed.names, len(arm.axes_slide), own))))
    places = [each for of in roles.positions.values() for each in _again(of, sniffed.names)]
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
    near = [each for each in tried if each[0] < max(_AS_NEAR * least_m, _ALIKE_M)]
    joints = near[0][1]  # the first: what was recognised, if it agrees
    of_arm = [(scatter_m, place) for scatter_m, columns, place in tried if columns == joints]
    agree = [place for scatter_m, place in of_arm if scatter_m < NEAR_M]
    still = standing({place: sniffed.columns(names) for place, names in roles.positions.items()})
    keep = {place: of for place, of in roles.positions.items() if place in still or of in agree}
    if all(place in still for place in keep):
        keep = {"": agree[0]} | keep
    attitude, first = roles.attitude, next(iter(roles.positions.values()))
    if attitude is not None and first not in agree:
        again = dict(zip(places, _again(attitude[0], sniffed.names), strict=False))
        attitude = (again[agree[0]], attitude[1]) if agree[0] in again else None
    return replace(roles, joints=joints, positions=keep, attitude=attitude)


def _again(names: Sequence[str], every: Collection[str]) -> list[tuple[str, ...]]:
    """Return columns, then those of the same names further on."""
    found = [tuple(names)]
    while all(same_name(name, len(found) + 1) in every for name in names):
        found.append(tuple(same_name(name, len(found) + 1) for name in names))
    return found


def logs_by_arm(
    both: list[tuple[Roles, Sniffed, Path]], arm: Arm
) -> list[tuple[Roles, Sniffed, Path]]:
    """Return roles of two logs, one of them at least without names, by the nominal arm."""
    found = []
    for (of_joints, log, file), (of_readings, read, other) in (both, both[::-1]):
        named = is_headerless(log) or of_joints.joints
        if named and (is_headerless(read) or of_readings.positions):
            by_arm = roles_by_arm((of_joints, log), (of_readings, read), arm)
            if by_arm is not None:
                found.append((by_arm[0], [(by_arm[1], log, file), (by_arm[2], read, other)]))
    if found:
        return min(found, key=lambda way: way[0])[1]
    for (of_joints, log, file), (of_readings, read, other) in (both, both[::-1]):
        rows = None
        if is_headerless(log) and is_headerless(read):
            rows = _rows_of_targets(log, read, arm)
        if rows is not None and rows.of_readings:
            of_readings = replace(of_readings, positions={"": rows.place}, attitude=None)
            return [(replace(of_joints, joints=rows.joints), log, file), (of_readings, read, other)]
        if rows is not None:
            raise RawDataError(
                f"column {rows.target} says which of {len(rows.words)} targets a row is of",
                where=file.name,
                value=", ".join(rows.words),
                allowed=f"that column in {other.name}, or three columns for each target",
                remedy=f"copy column {rows.target} behind those of {other.name}; or write headers, "
                f"and columns T1_x, T1_y, T1_z, T2_x … in place of columns {', '.join(rows.place)}",
            )
    return both


def _rows_together(log: Sniffed, read: Sniffed) -> tuple[Index, Index] | None:
    """Return rows of both logs that belong together; None where nothing tells them or few do."""
    labels = None if log is read else labels_of_both(log, read)
    if labels is not None:
        station = by_label(np.array(log.words(labels[0])), np.array(read.words(labels[1])))
        theirs = np.flatnonzero(station >= 0)
        ours = station[theirs]
    elif len(log.numbers) == len(read.numbers):
        ours = theirs = np.arange(len(log.numbers))
    else:
        return None
    some = spread(len(ours), _ROWS)
    return (ours[some], theirs[some]) if len(ours) >= _LEAST_ROWS else None


def labels_of_both(log: Sniffed, read: Sniffed) -> tuple[str, str] | None:
    """Return the columns of labels that two logs share; None for none.

    Numbers that count the rows of the joints' log are labels where the other has several rows of a
    number.
    """
    labels = shared_labels(log.texts, read.texts)
    if labels is None and len(log.numbers) != len(read.numbers):
        labels = shared_labels(log.counts, read.texts)
    return labels


def _runs(names: Sequence[str], count: int) -> list[tuple[str, ...]]:
    """Return so many neighbouring columns, from every column on."""
    return [tuple(names[k : k + count]) for k in range(min(len(names), _COLUMNS) - count + 1)]


@dataclass(frozen=True)
class _RowsOfTargets:
    """Columns without names that the nominal arm explains where a further one tells targets."""

    joints: tuple[str, ...]
    place: tuple[str, ...]
    target: str  # column that tells them
    of_readings: bool  # whether it is of the log of readings
    words: tuple[str, ...]  # what stands in it


def _rows_of_targets(joints: Sniffed, readings: Sniffed, arm: Arm) -> _RowsOfTargets | None:
    """Return which columns are what, where small whole numbers tell which of several targets."""
    rows = _rows_together(joints, readings)
    if rows is None:
        return None
    runs = _runs(joints.names, len(arm.axes_slide))
    logs = (joints, readings) if joints is not readings else (readings,)
    for log, k in ((each, k) for each in logs for k in range(len(each.names))):
        words = log.numbers[rows[log is readings], k]
        targets = np.unique(words)
        whole = np.isfinite(words).all() and (words == np.round(words)).all()
        if not whole or not 2 <= len(targets) <= _TARGETS:
            continue
        of_target = (words[:, None] == targets)[..., None]
        for columns, T_base_ee in _ends(joints.columns, runs, rows[0], arm):
            for place, p_m in _places(readings.columns, _runs(readings.names, 3), rows[1]):
                if joints is readings and set(place) & {*columns, log.names[k]}:
                    continue
                seen_m = np.where(of_target, p_m[:, None], np.nan)
                if _scatter_m(T_base_ee, seen_m) < NEAR_M:
                    told = tuple(f"{target:g}" for target in targets)
                    return _RowsOfTargets(columns, place, log.names[k], log is readings, told)
    return None


def of_rows_of_targets(roles: Roles, sniffed: Sniffed, arm: Arm) -> Roles:
    """Return roles of a file without names that has a row for each target, where it is one."""
    found = _rows_of_targets(sniffed, sniffed, arm)
    if found is None:
        return roles
    return replace(roles, joints=found.joints, positions={"": found.place}, attitude=None)


def _ends(
    columns_of: Callable[[Sequence[str]], Array],
    named: Sequence[tuple[str, ...]],
    rows: Index,
    arm: Arm,
) -> Iterator[tuple[tuple[str, ...], Array]]:
    """Yield columns that may be joints, and the nominal end (N, 4, 4) with them."""
    slides = arm.axes_slide
    for columns in named:
        values = columns_of(columns)[rows]
        if not np.isfinite(values).all() or np.ptp(values, axis=0).min() == 0.0:
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
    columns_of: Callable[[Sequence[str]], Array], named: Sequence[tuple[str, ...]], rows: Index
) -> Iterator[tuple[tuple[str, ...], Array]]:
    """Yield columns that may be a place, and it [m], nan where it was not seen."""
    for columns, unit in product(named, ("mm", "m")):
        p_m = 1e-3 * LENGTHS[unit] * columns_of(columns)[rows]
        known = np.flatnonzero(np.isfinite(p_m).all(axis=1))
        p_m = np.where(np.isfinite(p_m).all(axis=1, keepdims=True), p_m, np.nan)
        enough = 2 * len(known) > len(p_m)
        spread_m = np.sort(np.ptp(p_m[known], axis=0)) if enough else np.zeros(3)
        if spread_m[1] > _SPREAD_M and spread_m[2] < _FAR_M:
            yield columns, p_m


def _scatter_m(T_base_ee: Array, p_m: Array) -> float:
    located = placed_by_points(T_base_ee, p_m)
    return np.inf if located is None else located.scatter_m


def is_headerless(log: Sniffed) -> bool:
    """Return whether a file names no columns."""
    return log.layout.header == 0 and not log.titles and not log.layout.format


# Which column tells the target where rows are of one target each.

#: So many targets at most, and rows of each at least.
_MOST, _FEWEST = 12, 3
#: A label that ends with a target: a letter after a number, or what a sign sets apart.
_ENDING = re.compile(r"(?P<pose>.*\w)(?P<ending>(?<=\d)[A-Za-z]|[_.:/\s-]+[A-Za-z]{0,12}\d{0,2})")
#: Part of the labels that must end so, and of the poses that must have several targets.
_NEARLY_ALL, _SEVERAL = 0.95, 0.5
#: Targets of one pose are further apart than this part of the spread of all places.
_APART = 1e-3
#: With targets apart the nominal arm must be so many times nearer than with one.
_CLEARER = 5.0


def target_column(
    sniffed: Sniffed, roles: Roles, p_m: Array, T_base_ee: Array | None
) -> dict[str, object] | None:
    """Return `target` of campaign.yaml for rows of one target each; None for rows of one alone.

    The one position of each row is at p_m (N, 3), the nominal end at (N, 4, 4), where it is known.
    Endings of labels such as P1_A and P1_B tell it, a column that is called after targets, or one
    by whose words the nominal arm is much nearer.
    """
    used = {*roles.joints, *roles.torques, *roles.uncertain.values(), *roles.times}
    used |= {name for names in roles.positions.values() for name in names}
    free = [name for name in sniffed.names if name not in used]
    for name in free:
        if endings := label_endings(sniffed.words(name), p_m):
            return {"names": name, "endings": _named(endings)}
    for name in free:
        words = sniffed.words(name)
        counts = Counter(words)
        if "" in counts or not 2 <= len(counts) <= _MOST or min(counts.values()) < _FEWEST:
            continue
        title = words_of_name(sniffed.titled(name))
        if has_word(title, "one target") or _nearer(words, p_m, T_base_ee):
            return {"names": name, "words": _named(sorted(counts))}
    return None


def named_in_other_log(joints: Sniffed, file: str, readings: str) -> list[str]:
    """Return what is to be done where the joints' log names the target of each reading."""
    return [
        f"target: {joints.titled(name)} of {file} says which target a row is of, and is not read "
        f"there: copy that column into {readings}, and run pa10cal columns again"
        for name in joints.names
        if has_word(words_of_name(joints.titled(name)), "one target")
        and 2 <= len(set(joints.words(name))) <= _MOST
    ]


def label_endings(labels: Sequence[str], p: Array) -> list[str]:
    """Return the endings of labels that stand for targets at places (N, 3); nothing for none."""
    found = [_ENDING.fullmatch(label) for label in labels]
    split = [(each["pose"], each["ending"]) for each in found if each is not None]
    endings = Counter(ending for _, ending in split)
    poses: dict[str, set[str]] = {}
    for pose, ending in split:
        poses.setdefault(pose, set()).add(ending)
    if len(split) < _NEARLY_ALL * len(labels) or not 2 <= len(endings) <= _MOST:
        return []
    several = float(np.mean([len(of) > 1 for of in poses.values()]))
    if min(endings.values()) < _FEWEST or several < _SEVERAL or len(poses) < _FEWEST:
        return []
    # Repeats of one target end so too.
    rows = pd.DataFrame(p, columns=list("xyz")).assign(
        pose=[each["pose"] if each else "" for each in found]
    )
    rows = rows.dropna()
    within = rows.groupby("pose")[list("xyz")].std().max(axis=1).median()
    apart = float(within) > _APART * float(rows[list("xyz")].std().max())
    return sorted(endings) if apart else []


def labels_without_targets(sniffed: Sniffed, roles: Roles) -> dict[str, list[str]]:
    """Return columns of labels such as P1_A, by their name, without what stands for targets."""
    bare: dict[str, list[str]] = {}
    for name in sniffed.texts if len(roles.positions) == 1 else ():
        (place,) = roles.positions.values()
        if endings := label_endings(sniffed.words(name), sniffed.columns(place)):
            stated = TargetOfRow(names=(name,), endings=dict.fromkeys(endings, "T1"))
            bare[name] = [stated.of(word)[0] for word in sniffed.words(name)]
    return bare


def _nearer(words: Sequence[str], p_m: Array, T_base_ee: Array | None) -> bool:
    """Return whether the nominal arm is much nearer where each word is a target of its own."""
    if T_base_ee is None:
        return False
    known = np.isfinite(p_m).all(axis=1) & np.isfinite(T_base_ee).all(axis=(1, 2))
    number, count = pd.factorize(np.array(words)[known])
    one = p_m[known][:, None]
    apart = np.full((len(one), len(count), 3), np.nan)
    apart[np.arange(len(one)), number] = one[:, 0]
    fits = [placed_by_points(T_base_ee[known], each) for each in (one, apart)]
    if fits[0] is None or fits[1] is None:
        return False
    return fits[1].scatter_m * _CLEARER < fits[0].scatter_m


def _named(words: Sequence[str]) -> Mapping[str, str]:
    """Return a name of letters and digits for each word."""
    named: dict[str, str] = {}
    for k, word in enumerate(words, start=1):
        bare = "".join(letter for letter in word if letter.isascii() and letter.isalnum())
        bare = f"T{bare}" if bare.isdigit() or bare.startswith("base") else bare
        taken = bare in ("", "u") or bare in named.values()
        named[word] = f"T{k}" if taken else bare
    return named
