"""Roles of the columns of a whole file, whether they suffice, and what each column is read as.

Joints with names are ordered by their names in the arm's description, by words of a limb, which
follow each other from the base to the hand, or by the letters of a maker.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.campaign.bounds import in_words
from pa10cal.campaign.csv_rows import CONTRACT, same_name
from pa10cal.campaign.own_columns import FileColumns
from pa10cal.campaign.recognise import (
    WORDS,
    Roles,
    apart_by_letters,
    beyond,
    has_word,
    numbered_joints,
    numbered_sets,
    plain,
    positions_of,
    roles_of,
    split_unit,
    standing,
    unit_of,
    with_matrix,
    with_polar,
    words_of_name,
)
from pa10cal.campaign.sniffing import Sniffed
from pa10cal.errors import RawDataError

_LIMB = WORDS["limb"]
#: Order of words of a limb from base to hand, and of words of motions within a segment.
_SEGMENT = {word: k for k, words in enumerate(_LIMB["segments"]) for word in words.split()}
_MOTION = {word: k for k, words in enumerate(_LIMB["motions"], 1) for word in words.split()}
_RAIL, _HAND = min(_SEGMENT.values()), max(_SEGMENT.values())
#: Words of columns that are of a limb, but of none of its joints.
_NO_JOINT = frozenset(_LIMB["no joint"].split())
#: Segments that tell a limb where the number of joints is not known, at least.
_LEAST_SEGMENTS = 3
#: Letters that stand for the joints of an arm, in order.
_LETTERS = tuple(tuple(letters.split()) for letters in _LIMB["letters"])
_NUMBERED = re.compile(r"^(?P<stem>.*?\D)(?P<number>\d+)$")
#: Columns of the contract that are read wherever they are.
_CONTRACT_ALONE = ("time_s", "kind", "pose", "load_N", "repeat", "temperature_C")
#: Columns are text if less than this part of their fields are numbers.
_NUMBERS = 0.5
#: Larger positions are no radians.
_TURN_RAD = 2.0 * np.pi + 0.1


def roles_of_file(sniffed: Sniffed, joints: int | None, joint_names: Sequence[str]) -> Roles:
    """Return the roles of the columns of a file, with polar readings and matrices."""
    names = apart_by_letters(sniffed.titles or sniffed.names)
    called = replace(sniffed, names=names)
    roles = with_matrix(_roles_by_name(called, joints, joint_names), names, sniffed.numbers)
    roles = _of_what_moves(with_polar(roles, names), called)
    return roles.renamed(dict(zip(names, sniffed.names, strict=True)))


def _of_what_moves(roles: Roles, sniffed: Sniffed) -> Roles:
    """Return roles whose orientation is that of a moving body, not of one at rest as the base."""
    readings = {place: sniffed.columns(names) for place, names in roles.positions.items()}
    at_rest = {_body(roles.positions[place]) for place in standing(readings)} - {()}
    attitude, names = roles.attitude, list(sniffed.names)
    while attitude is not None and _body(attitude[0]) in at_rest:
        names = [name for name in names if name not in attitude[0]]
        attitude = roles_of(names, None).attitude
    return replace(roles, attitude=attitude)


def _body(columns: Sequence[str]) -> tuple[str, ...]:
    """Return the words that all columns of a position or orientation share, as of their body."""
    first, *others = map(words_of_name, columns)
    shared = [word for word in first if all(word in words for words in others)]
    return tuple(w for w in shared if not has_word([w], "of any joint", "rotation", "quaternion"))


def _roles_by_name(
    sniffed: Sniffed, joints: int | None, own_joint_names: Sequence[str] = ()
) -> Roles:
    """Return the roles of the columns of a file by names, joints in the order of the arm's.

    Args:
        sniffed: the file.
        joints: number of the arm's joints; None where not known.
        own_joint_names: those in the arm's description, in order; empty where it has none.
    """
    fields = {name: [word for word in sniffed.words(name) if word] for name in sniffed.names}
    text_columns = [
        name
        for name, words in fields.items()
        if words and np.isfinite(sniffed.column(name)).sum() < _NUMBERS * len(words)
    ]
    constant_text = {name: fields[name][0] for name in text_columns if len(set(fields[name])) == 1}
    alias_of = {name: name for name in sniffed.names}
    alias_of |= named_by_text(sniffed.names, constant_text)
    column_of_alias = {alias: name for name, alias in alias_of.items()}

    def by_name(count: int | None, *, torques: bool) -> tuple[str, ...]:
        candidates = []
        for name, alias in alias_of.items():
            words = words_of_name(alias)
            uncertain = len(words) > 1 and has_word(words[:1], "uncertain")
            excluded = uncertain or has_word(words, "deviation", "no position")
            if name not in text_columns and not excluded and has_word(words, "torque") == torques:
                candidates.append(alias)
        found = columns_by_name(candidates, count, own_joint_names)
        return tuple(column_of_alias[alias] for alias in found)

    turns = by_name(joints, torques=False)
    torques = by_name(joints or len(turns) or None, torques=True)
    roles = roles_of(sniffed.names, joints, text_columns, turns)
    return replace(roles, torques=torques) if torques and turns else roles


def columns_by_name(
    names: Sequence[str], joints: int | None, own_joint_names: Sequence[str] = ()
) -> tuple[str, ...]:
    """Return the columns of joints with names, in the order of the joints; empty for none.

    Args:
        names: columns that may hold positions of joints.
        joints: number of the arm's joints; None where not known.
        own_joint_names: those in the arm's description, in order; empty where it has none.
    """
    measured = [name for name in names if not has_word(words_of_name(name), "commanded")]
    commanded = [name for name in names if name not in measured]
    for candidates in (measured, commanded):
        found = (
            _by_own(candidates, own_joint_names)
            or _by_limb(candidates, joints)
            or _by_letters(candidates, joints)
        )
        if found:
            return found
    return ()


def joint_sets(
    names: Sequence[str], joints: int, own_joint_names: Sequence[str] = ()
) -> list[tuple[str, ...]]:
    """Return every set of columns that may be the joints of one arm, as of two arms side by side.

    They are numbered, or have names of joints and a word that all of a set share, such as left.
    """
    groups = _by_other_words(names)
    by_name = (columns_by_name(group, joints, own_joint_names) for group in groups)
    return list(dict.fromkeys(filter(None, (*numbered_sets(names, joints), *by_name))))


def _by_other_words(names: Sequence[str]) -> list[list[str]]:
    """Return names in groups, by their words other than those of limbs and numbers."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for name in names:
        rest = (w for w in _bare(name) if w not in _SEGMENT and w not in _MOTION)
        groups.setdefault(tuple(w for w in rest if not w.isdigit()), []).append(name)
    return list(groups.values())


def _bare(name: str) -> tuple[str, ...]:
    """Return the words of a name without those of any joint, such as position."""
    words = [part for word in words_of_name(name) for part in re.findall(r"[a-z]+|\d+", word)]
    return tuple(word for word in words if not has_word([word], "of any joint"))


def _same(column: tuple[str, ...], joint: tuple[str, ...]) -> bool:
    return column == joint


def _ends_with(column: tuple[str, ...], joint: tuple[str, ...]) -> bool:
    return bool(joint) and column[-len(joint) :] == joint


def _is_end_of(column: tuple[str, ...], joint: tuple[str, ...]) -> bool:
    return _ends_with(joint, column)


def _by_own(names: Sequence[str], own_joint_names: Sequence[str]) -> tuple[str, ...]:
    """Return one column for each of the arm's own names: of equal words, else of ending words."""
    words_of = {name: _bare(name) for name in names}
    wanted = [_bare(each) for each in own_joint_names]
    if not wanted or len(set(wanted)) < len(wanted) or not all(wanted):
        return ()
    # Of a joint called elbow also ours_elbow, and of one called ours_elbow also elbow.
    for matches in (_same, _ends_with, _is_end_of):
        found = [
            [name for name, words in words_of.items() if matches(words, joint)] for joint in wanted
        ]
        if all(len(each) == 1 for each in found):
            chosen = tuple(each[0] for each in found)
            if len(set(chosen)) == len(chosen):
                return chosen
    return ()


class _Place(NamedTuple):
    """Where a joint sits on a limb; places follow each other from the base on."""

    segment: int
    motion: int  # 0 without a word of it
    number: int  # 0 without one


def _by_limb(names: Sequence[str], joints: int | None) -> tuple[str, ...]:
    """Return the columns with words of a limb, such as shoulder and elbow, from the base on."""
    places = _places_on_limb(names)
    if joints is None:
        others = [name for name in names if name not in places]
        segments = {place.segment for place in places.values()}
        if len(segments) < _LEAST_SEGMENTS or len(numbered_joints(others, None)) > 2:
            return ()  # two words may have other meanings; fingers are numbered, too
        return _from_base_on(places)
    if len(places) == joints:
        return _from_base_on(places)
    chosen = {
        _from_base_on({name: places[name] for name in group})
        for group in _parts_of_limb(places)
        if len(group) == joints
    } - {()}
    return chosen.pop() if len(chosen) == 1 else ()


def _places_on_limb(names: Sequence[str]) -> dict[str, _Place]:
    """Return the place of each column with words of a limb that may be a joint."""
    taken = {name for triple in positions_of(names).values() for name in triple}
    places = {}
    for name in names:
        words = _bare(name)
        segments = [_SEGMENT[word] for word in words if word in _SEGMENT]
        other = name in taken or not _NO_JOINT.isdisjoint(words) or has_word(words, "time")
        if segments and not other:
            motions = [_MOTION[word] for word in words if word in _MOTION]
            numbers = [int(word) for word in words if word.isdigit()]
            places[name] = _Place(max(segments), max(motions, default=0), max(numbers, default=0))
    return places


def _from_base_on(places: Mapping[str, _Place]) -> tuple[str, ...]:
    """Return columns from the base on; empty unless all places differ, in two segments or more."""
    apart = len(set(places.values())) == len(places)
    segments = {place.segment for place in places.values()}
    return tuple(sorted(places, key=places.__getitem__)) if apart and len(segments) > 1 else ()


def _parts_of_limb(places: Mapping[str, _Place]) -> Iterator[list[str]]:
    """Yield columns of equal other words, and all columns: also without a rail and without a hand.

    An arm may stand on a rail and carry a hand that are no joints of its own.
    """
    for group in (list(places), *_by_other_words(list(places))):
        for ends in ((), (_RAIL,), (_HAND,), (_RAIL, _HAND)):
            yield [name for name in group if places[name].segment not in ends]


def _by_letters(names: Sequence[str], joints: int | None) -> tuple[str, ...]:
    """Return the columns that are called by the letters of a maker, such as S, L, U, R, B, T."""
    words_of = {name: _bare(name) for name in names}
    for letters in (each for each in _LETTERS if joints in (None, len(each))):
        found = []
        for letter in letters:
            last = tuple(re.findall(r"[a-z]+|\d+", plain(letter)))
            alike = [name for name, words in words_of.items() if _ends_with(words, last)]
            # A time t may be beside a joint T.
            exact = [name for name in alike if split_unit(name)[0].rstrip("_").endswith(letter)]
            found.append(exact if len(alike) > 1 else alike)
        if all(len(each) == 1 for each in found):
            return tuple(each[0] for each in found)
    return ()


def named_by_text(names: Sequence[str], same: Mapping[str, str]) -> dict[str, str]:
    """Return names of numbered columns by numbered columns of text.

    A table of `/joint_states` has the joints' names under name0, name1, … and their positions under
    position0, position1, …: with 'elbow' in all rows of name0, position0 is "elbow position".

    Args:
        names: all columns.
        same: the text of each column of text that is the same in all rows.
    """
    series: dict[str, dict[str, str]] = {}  # columns by their number, by what is before it
    for name in names:
        if (found := _NUMBERED.match(split_unit(name)[0])) is not None:
            series.setdefault(found["stem"], {})[found["number"]] = name
    lists = [
        column_of
        for column_of in series.values()
        if len(column_of) >= 2 and all(name in same for name in column_of.values())
    ]
    alias_of: dict[str, str] = {}
    for column_of in lists:
        texts = {number: same[name] for number, name in column_of.items()}
        if len({plain(text) for text in texts.values()}) < len(texts):
            continue
        for stem, others in series.items():
            if set(others) == set(texts) and not set(others.values()) & set(same):
                alias_of |= {name: f"{texts[number]} {stem}" for number, name in others.items()}
    return alias_of


def read_as(
    sniffed: Sniffed, columns: Mapping[str, Any], file: str, arm: Arm | None
) -> tuple[str, ...]:
    """Return a line for every column of a file: what it is read as, or that it is not read.

    Without an arm all joints are taken for revolute ones. A file of the contract needs no mapping
    of what it states beside its readings.
    """
    model = FileColumns.model_validate(columns)
    count = 0 if model.joints is None else len(model.joints.names)
    slides = np.zeros(count, dtype=bool) if arm is None else arm.axes_slide
    uses: dict[str, dict[str, None]] = {}
    for ours, source in model.sources(slides):
        for own in source.names:
            how = in_words(ours) + (f", in {source.unit}" if source.unit else "")
            uses.setdefault(own, {})[how] = None
    if model.target is not None:
        uses.setdefault(model.target.names[0], {})["which target the row is of"] = None
    if follows_contract(sniffed):
        for name in sniffed.names:
            if name in _CONTRACT_ALONE or name.removeprefix("u_") in uses:
                unit = unit_of(name)
                uses.setdefault(name, {in_words(name) + (f", in {unit}" if unit else ""): None})
    encoding = sniffed.encoding.removesuffix("-sig")
    encoding = encoding or ("arrays" if sniffed.format else "a workbook")
    lines = [f"{file}: {encoding}, {len(sniffed.names)} columns, {len(sniffed.text)} rows seen"]
    shown = list(sniffed.names)
    if sniffed.titles:
        shown = [f"{k} ({title})" for k, title in zip(shown, sniffed.titles, strict=True)]
    width = max(map(len, shown))
    for name, label in zip(sniffed.names, shown, strict=True):
        lines.append(f"  {label:{width}}  {'; '.join(uses.get(name, ['not read']))}")
    return tuple(lines)


def notes_on_joints(sniffed: Sniffed, joints: Sequence[str]) -> list[str]:
    """Return what the user should check of the columns chosen for joints."""
    every = sniffed.titles or sniffed.names
    titled = [every[sniffed.names.index(name)] for name in joints]
    first = titled[0].partition(" (")[0]
    same = [k for k in range(1, len(every)) if same_name(first, k) in every]
    found = []
    if more := beyond(every, titled):
        found.append(
            f"joints: the arm has {len(joints)}, so {', '.join(more)} is not read: a gripper, or "
            "an outer axis? if it is an axis of the arm, name another arm"
        )
    largest = np.nanmax(np.abs(sniffed.columns(joints)), initial=0.0)
    if all(name.endswith(".pos") for name in titled) and _TURN_RAD < largest <= 100.0:
        found.append(
            f"joints: {titled[0]} … lie within -100 to 100: LeRobot writes percents of each "
            "joint's range so, which are no angles; log degrees (use_degrees)"
        )
    if len(same) > 1:
        found.append(
            f"joints: {titled[0]} is there {len(same)} times, of several arms perhaps; "
            f"{titled[0]} to {titled[-1]} is read: name others where the arm is another one"
        )
    return found


def unit_by_size(p: Array) -> str:
    """Return the unit of positions (N, k) of a target by their size: metres or millimetres."""
    seen = np.isfinite(p).all(axis=1)
    far = np.abs(p[seen]).max(initial=0.0)  # for a target at rest, too
    extent = np.ptp(p[seen], axis=0).max() if seen.any() else 0.0
    return "mm" if max(extent, 0.2 * far) > 20.0 else "m"


def follows_contract(sniffed: Sniffed) -> bool:
    """Return whether a file has the names and layout of the contract, and needs no mapping."""
    names = set(sniffed.names)
    labelled = {"time_s", "pose", "load_N", "repeat"} <= names and names & {"q1_deg", "q1_mm"}
    return sniffed.layout == CONTRACT and bool(labelled)


def refuse_unrecognised(
    roles: Roles, sniffed: Sniffed, file: str, *, measured: bool = False
) -> None:
    """Refuse a file without recognised joint positions, or without a measured quantity.

    The latter may be `measured` in another file.
    """
    measured = measured or bool(roles.positions) or "distance" in roles.single
    if roles.joints and measured:
        return
    what, other = "no joint positions were", "joint positions are"
    if roles.joints:
        what, other = "no position and no distance was", "readings are"
    header = ""
    if not sniffed.layout.header and not sniffed.layout.format and not sniffed.titles:
        header = "the file has no header: write one; or "
    raise RawDataError(
        f"{what} recognised",
        where=file,
        value=", ".join(sniffed.titles or sniffed.names),
        allowed="a column for each joint of the arm, such as q1, J1 or joint_1, and columns such "
        "as x, y, z",
        remedy=header
        + f"give both logs where the {other} in another: pa10cal columns JOINTS READINGS; or "
        "write columns.poses in campaign.yaml by hand, see docs/raw-data.md; column names may "
        "also be numbers",
    )
