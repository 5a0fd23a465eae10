"""Roles of the columns of an unknown file: by their names (English, German, French, Spanish)."""

from __future__ import annotations

import itertools
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pa10cal.campaign.column_map import LENGTHS
from pa10cal.campaign.column_names import (
    VOCABULARY,
    WORDS,
    has_part_of,
    has_word,
    is_of,
    parts_of_stamps,
    plain,
    said_by_unit,
    split_unit,
    stated_coverage,
    unit_of,
    without_coverage,
    words_of_name,
)
from pa10cal.campaign.numbered_columns import NO_JOINT, numbered_joints, series_of

_ORIENTATIONS = [(tuple(endings.split()), word) for endings, word in WORDS["orientations"]]
#: Words directly before or after x, y, z, as in `tcpx`.
_BEFORE_AXIS = "p|t|pos|tcp|trans|tvec|coord|meas|act|ist"
_AFTER_AXIS = "pos|ist|act|actual|mess|meas|measured|coord|koord|soll|nom|cmd"
_AXIS = re.compile(rf"(?:{_BEFORE_AXIS})?([xyz])(?:{_AFTER_AXIS})?")
#: An axis of a numbered place, as in X1, Y1, Z1.
_NUMBERED_AXIS = re.compile(r"^([xyz])(\d+)$", re.IGNORECASE)
#: A word of two letters and more with a number, as in rx1.
_NUMBERED_WORD = re.compile(r"^([a-z]{2,})(\d+)$")
#: Targets that move by less than this part of the largest motion are at rest.
_STILL = 0.02
#: A difference of x, y or z in one word, as in dX and dx_mm.
_DIFFERENCE = re.compile(r"^d[_ ]?([xyz])(?![a-z])", re.IGNORECASE)
#: An uncertainty and its column in one word, as in sx and stdq1.
_RUN_ON = re.compile(r"(?:s|u|std|sigma)([xyz]|q\d)")
#: Kinds of words of columns that hold no position of a target.
_NO_PLACE = ("no position", "extreme", "torque", "force")
_ELEVATION = frozenset(WORDS["from horizon"].split())
_POLAR = {part: frozenset(words.split()) for part, words in WORDS["polar"].items()}


@dataclass(frozen=True)
class Roles:
    """Names of columns by their possible roles."""

    joints: tuple[str, ...]  # in order; empty where none were recognised
    torques: tuple[str, ...]  # in order; empty where none were recognised
    # triples x, y, z by the words before them, those of commands last
    positions: dict[str, tuple[str, ...]]
    # columns of the orientation, and the convention that the names suggest; None without any
    attitude: tuple[tuple[str, ...], str] | None
    uncertain: dict[str, str]  # columns of uncertainties by the columns that they are of
    single: dict[str, str]  # other columns, by the key of `columns`
    times: tuple[str, ...] = ()  # all columns that may hold a date or a time of day
    # polar readings, which are then the only position: horizontal, vertical angle, distance
    polar: tuple[str, ...] | None = None
    # columns of a stated place, and of deviations from it, where their sum was measured
    deviations: tuple[tuple[str, ...], tuple[str, ...]] | None = None

    def renamed(self, names: Mapping[str, str]) -> Roles:
        """Return the roles with other names of the columns; `names` has the new by the old."""

        def of(columns: Sequence[str]) -> tuple[str, ...]:
            return tuple(names[name] for name in columns)

        return Roles(
            of(self.joints),
            of(self.torques),
            {place: of(columns) for place, columns in self.positions.items()},
            None if self.attitude is None else (of(self.attitude[0]), self.attitude[1]),
            {names[name]: names[u] for name, u in self.uncertain.items()},
            {key: names[name] for key, name in self.single.items()},
            of(self.times),
            None if self.polar is None else of(self.polar),
        )


def roles_of(
    names: Sequence[str],
    joints: int | None,
    text: Collection[str] = (),
    named_joints: tuple[str, ...] = (),
) -> Roles:
    """Return the roles of columns by their names.

    A name may suit several roles, so the most particular one takes its columns first: u_x is also
    an x; qx, qy, qz and w are also an x, y and z; x1, y1, z1 are numbered as joints are, and tau1 …
    tau6 still more so. Single columns are sought by parts of words, among what no other role takes.

    Args:
        names: names of the columns.
        joints: number of the arm's joints; None where not known.
        text: columns of text, which may be labels, kinds of rows or times, but not measured.
        named_joints: columns of joint positions in order, where they are known by joints' names.
    """
    u = _uncertainties(names)
    measured = _measured(
        names, (*u.of_column.values(), *u.of_target.values(), *text, *named_joints)
    )
    attitude = attitude_of(_without(measured, "no position", "extreme"))
    no_attitude = _others(measured, attitude[0] if attitude else ())
    positions = _positions_beside(attitude, no_attitude)
    numbered = _others(no_attitude, *positions.values())  # or single
    no_torques = _without(numbered, "torque")
    may_turn = _without(no_torques, *NO_JOINT)
    turns = named_joints or numbered_joints(may_turn, joints)
    torques = numbered_joints(_others(numbered, no_torques), joints or len(turns) or None)
    if not turns and joints == 4 and attitude is not None and attitude[1].startswith("quaternion"):
        # q0 … q3 were taken for a quaternion, but no other columns are the joints of this arm.
        turns = numbered_joints([*may_turn, *attitude[0]], joints)
        attitude = None if turns else attitude
    left = [name for name in names if name in (*no_torques, *text) and name not in turns]
    single, times = _single_columns_and_times(_without_orientations(left, text), text)
    uncertain = _with_uncertain_targets(u, positions, single.get("distance"))
    return Roles(turns, torques, positions, attitude, uncertain, single, times)


def _without_orientations(names: Sequence[str], text: Collection[str]) -> list[str]:
    """Return the names but those of orientations besides the first: the t of t_qx is no time."""
    left = list(names)
    while (other := attitude_of(_others(left, tuple(text)))) is not None:
        left = _others(left, other[0])
    return left


def _without(names: Sequence[str], *kinds: str) -> list[str]:
    """Return the names of which no word and no unit is of these kinds of `WORDS`."""
    return [name for name in names if not is_of(name, *kinds)]


def _others(names: Sequence[str], *taken: Sequence[str]) -> list[str]:
    """Return the names that are in none of some sequences of columns."""
    return [name for name in names if not any(name in columns for columns in taken)]


def _measured(names: Sequence[str], taken: Sequence[str]) -> list[str]:
    """Return the names of columns that may be measured: no differences and no uncertainties."""
    return [
        name
        for name in _others(_without(names, "deviation"), taken)
        if not has_word(words_of_name(name)[:1], "uncertain")
    ]


def _positions_beside(
    attitude: tuple[tuple[str, ...], str] | None, names: Sequence[str]
) -> dict[str, tuple[str, ...]]:
    """Return `positions_of`; beside an orientation t1, t2, t3 are one, too."""
    positions = positions_of(names)
    if attitude is not None and not positions:
        triple = next(_numbered_vectors(names, ("t", "p")), None)
        return {} if triple is None else {"": triple}
    return positions


def _with_uncertain_targets(
    u: Uncertainties, positions: Mapping[str, Sequence[str]], distance: str | None
) -> dict[str, str]:
    """Return uncertainties by the column that each is of, those of whole targets included."""
    uncertain = dict(u.of_column)
    for label, triple in positions.items():
        of_target = u.of_target.get("".join(words_of_name(label)), u.of_target.get(""))
        if of_target is not None and not any(name in uncertain for name in triple):
            uncertain |= dict.fromkeys(triple, of_target)
    if distance is not None:
        called = (*words_of_name(distance), "")  # by one word of its name, or of all targets
        for of_target in (u.of_target[word] for word in called if word in u.of_target):
            uncertain.setdefault(distance, of_target)
    return uncertain


def _single_columns_and_times(
    names: Sequence[str], text: Collection[str]
) -> tuple[dict[str, str], tuple[str, ...]]:
    """Return the columns that stand alone by their keys, and all that may hold a time."""
    single = _single_columns(names, text)
    free = _others(names, [name for key, name in single.items() if key != "time"])
    times = [name for name in free if has_word(words_of_name(name), "time")]
    parts = next(iter(parts_of_stamps(free)), None)
    if parts is not None and single.get("time", parts[0]) in parts:
        single["time"] = parts[0]
        times = list(dict.fromkeys((*times, *parts)))
    return single, tuple(times)


def positions_of(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return triples of columns x, y, z by the words before them; those of commands are last.

    Where there are none, x1, y1, z1, x2, … are places by their numbers. Components of a translation
    may be numbered, too.
    """
    numbered = _numbered_vectors(names, VOCABULARY["translation"])
    vectors = {_around_axis(triple[0]).rstrip("0123456789"): triple for triple in numbered}
    return (_triples(names) or _triples(names, numbered=True)) | vectors


def deviations_of(names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return triples x, y, z of deviations from a place: ΔX, x_dif, X error, dx."""
    apart = {_DIFFERENCE.sub(r"delta \1", name): name for name in names}
    differences = [name for name in apart if is_of(name, "deviation")]
    return [
        tuple(apart[name] for name in axes.values())
        for axes, place in _by_axis(differences, "xyz")
        if not has_word(place, "rotation", *_NO_PLACE)
    ]


def _numbered_vectors(names: Sequence[str], words: Collection[str]) -> Iterator[tuple[str, ...]]:
    """Yield three columns that are numbered from 0 or 1 behind one of these words, as in tvec0."""
    for before, after, by_number in series_of(names):
        numbers = sorted(by_number)
        called = not words_of_name(after) and not {*words_of_name(before)[-1:]}.isdisjoint(words)
        if called and numbers in ([0, 1, 2], [1, 2, 3]):
            yield tuple(by_number[k] for k in numbers)


def _triples(names: Sequence[str], *, numbered: bool = False) -> dict[str, tuple[str, ...]]:
    """Return triples of columns of measured, then of commanded places, by the words before them."""
    positions: dict[str, tuple[str, ...]] = {}
    for some in _measured_first(names):
        for axes, place in _by_axis(some, "xyz", numbered=numbered):
            no_position = has_word(place, "rotation", *_NO_PLACE) or any(
                said_by_unit(name) in _NO_PLACE for name in axes.values()
            )
            if not no_position:
                label = _unused_label(_around_axis(axes["x"]), positions)
                positions[label] = tuple(axes.values())
    # dX, dY, dZ beside another place are differences, except of a target D that comes after C.
    if len(positions) > 1 and "c" not in map(str.lower, positions):
        positions = {
            label: triple
            for label, triple in positions.items()
            if words_of_name(triple[0]) != ("d", "x") or triple[0][:2].casefold() != "dx"
        }
    return positions


def _unused_label(label: str, positions: Collection[str]) -> str:
    """Return a label, with a number where one is called so already: of tcp_x and x_tcp, of x, x."""
    numbered = (f"{label}{k}" for k in itertools.count(len(positions) + 1))
    return next(each for each in itertools.chain([label], numbered) if each not in positions)


def _single_columns(names: Sequence[str], text: Collection[str]) -> dict[str, str]:
    """Return the columns that stand alone, such as time or load, by the key of `columns`.

    Quantities are named by a word, or by a part of one; of them only a time may be text.
    """
    single: dict[str, str] = {}
    for key in WORDS["single"]:
        free = [name for name in names if name not in single.values()]
        if key in ("temperature", "load", "distance"):
            free = [name for name in free if name not in text]
        named = [name for name in free if has_word(words_of_name(name), key)]
        if key == "distance" and "d_mm" in free:  # the name that raw data have for it
            named = ["d_mm"]
        if not named and key in ("time", "temperature", "load", "distance"):
            named = [name for name in free if has_part_of(name, key)]
        if named:
            single[key] = named[0]
    return single


def _measured_first(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the columns of measured, then those of commanded quantities."""
    commanded = [name for name in names if has_word(words_of_name(name), "commanded")]
    return [name for name in names if name not in commanded], commanded


def attitude_of(names: Sequence[str]) -> tuple[tuple[str, ...], str] | None:
    """Return the columns of an orientation, measured rather than commanded."""

    def quaternion(wxyz: Sequence[str]) -> tuple[tuple[str, ...], str]:
        """Return the columns with w first or last, as the file has it, and the convention."""
        w, *xyz = wxyz
        if min(wxyz, key=names.index) == w:
            return (w, *xyz), "quaternion_wxyz"
        return (*xyz, w), "quaternion_xyzw"

    kind = "rotation vector"
    for some in _measured_first(names):
        # What a camera's software writes, before what may be the controller's own pose.
        called = [
            *(
                tuple(axes.values())
                for axes, place in _by_axis(some, "xyz")
                if has_word(place, kind)
            ),
            *_numbered_vectors(some, VOCABULARY[kind]),
        ]
        if called:
            return called[0], "rotation_vector"
        for numbered in (False, True):
            for endings, convention in _ORIENTATIONS:
                columns = next(_with_endings(some, endings, numbered=numbered), None)
                if columns is not None:
                    if convention.startswith("quaternion"):
                        return quaternion(columns)
                    vector = has_word(words_of_name(columns[0]), "vector")
                    return columns, "rotation_vector" if vector else convention
        for axes, place in _by_axis(some, "wxyz"):
            if has_word(place, "quaternion", "rotation"):
                return quaternion(tuple(axes.values()))
        for axes, place in _by_axis(some, "xyz"):
            if has_word(place, "rotation"):
                vector = has_word(place, "vector")
                return tuple(axes.values()), "rotation_vector" if vector else "rpy"
    return None


def _with_endings(
    names: Sequence[str], endings: Sequence[str], *, numbered: bool = False
) -> Iterator[tuple[str, ...]]:
    """Yield columns that differ only by these words, the first column of each.

    `numbered` words have the number of the target behind them, as in rx1. Where several targets
    have such columns none is that of all.
    """
    # q1 … q4 that a q5 follows are joints, and no quaternion.
    next_joint = {"q0": "q4", "q1": "q5"}.get(endings[0], "")
    sought = {*endings, next_joint} - {""}
    groups: dict[tuple[str, ...], dict[str, str]] = {}  # by the other words, then by the ending
    for name in names:
        words = _parted(words_of_name(name), _NUMBERED_WORD) if numbered else words_of_name(name)
        for others, ending in _endings_of(words, sought):
            groups.setdefault(others, {}).setdefault(ending, name)
    found = [
        tuple(group[ending] for ending in endings)
        for group in groups.values()
        if next_joint not in group and group.keys() >= set(endings)
    ]
    if not numbered or len(found) == 1:
        yield from found


def _endings_of(
    words: tuple[str, ...], sought: Collection[str]
) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield the words of a name without an ending that is sought, and that ending.

    It is a word anywhere beside which there is no x of a target, or the last two in one: rot x.
    """
    for k, word in enumerate(words):
        others = (*words[:k], *words[k + 1 :])
        if word in sought and not any(map(_AXIS.fullmatch, others)):
            yield others, word
    last_two = "".join(words[-2:])
    if len(words) >= 2 and last_two in sought:
        yield words[:-2], last_two


def _parted(words: Sequence[str], numbered: re.Pattern[str]) -> tuple[str, ...]:
    """Return words, those with a number behind as two: x1 as x and 1."""
    parted = (numbered.sub(r"\1 \2", word).split() for word in words)
    return tuple(itertools.chain.from_iterable(parted))


def _by_axis(
    names: Sequence[str], letters: str, *, numbered: bool = False
) -> Iterator[tuple[dict[str, str], tuple[str, ...]]]:
    """Yield columns that differ only by a letter x, y, z (w), by it, and the words around it.

    Of several columns of one letter between the same words the first is taken.

    A `numbered` letter has its number behind it, as in x1, which counts as a word.
    """
    groups: dict[tuple[str, ...], dict[str, str]] = {}
    for name in names:
        listed = words_of_name(name)
        if numbered:
            listed = _parted(listed, _NUMBERED_AXIS)
        for k, word in enumerate(listed):
            found = re.fullmatch(f"[{letters}]", word) or (
                _AXIS.fullmatch(word) if letters == "xyz" else None
            )
            if found is not None:
                axis = found[found.lastindex or 0]
                run_on = tuple(part for part in word.split(axis) if part)
                place = (*listed[:k], *run_on, "#", *listed[k + 1 :])
                groups.setdefault(place, {}).setdefault(axis, name)
                break
    for place, group in groups.items():
        if set(group) == set(letters):
            yield {axis: group[axis] for axis in letters}, place


def _around_axis(name: str) -> str:
    """Return a name as written without its unit and without its word x, y or z."""
    bare = split_unit(name)[0]
    parts = re.findall(r"[^\W_]+", bare)
    if not any(_AXIS.fullmatch(plain(part)) for part in parts):  # as in BallX
        parts = re.findall(r"[^\W_]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", bare))
    k = next((k for k, part in enumerate(parts) if _AXIS.fullmatch(plain(part))), len(parts))
    parts = [_NUMBERED_AXIS.sub(r"\2", part) for part in (*parts[:k], *parts[k + 1 :])]
    return "".join(parts)


class Uncertainties(NamedTuple):
    """Columns of uncertainties."""

    of_column: dict[str, str]  # by the column that each is of
    # by the words before x, y, z of the target, in lower case; empty for all targets
    of_target: dict[str, str]


def _uncertainties(names: Sequence[str]) -> Uncertainties:
    """Return the columns of uncertainties, of single columns and of whole targets."""
    called: dict[str, str] = {}
    for name in names:
        if words := words_of_name(name):  # of # there are none
            called.setdefault("".join(words), name)
    found = Uncertainties({}, {})
    for name in names:
        has_coverage = stated_coverage(name) is not None
        words = words_of_name(without_coverage(name) if has_coverage else name)
        others = _words_of_uncertain(words, has_coverage=has_coverage)
        if others is None:
            continue
        of = called.get(others)
        is_length = unit_of(name) in LENGTHS and has_word(words, "uncertain length")
        if of is not None and of != name:
            found.of_column[of] = name
        elif has_coverage or is_length or has_word(words, "uncertain target"):
            found.of_target[others] = name
    return found


def _words_of_uncertain(words: Sequence[str], *, has_coverage: bool) -> str | None:
    """Return what an uncertainty is of, the other words of its name in one; None if it is none."""
    others = [word for word in words if word not in VOCABULARY["uncertain"]]
    says_so = len(others) < len(words)
    run_on = _RUN_ON.fullmatch(others[-1]) if others else None
    if run_on is not None and (has_coverage or not says_so):
        others[-1] = run_on[1]
    return "".join(others) if says_so or run_on is not None else None


def standing(positions: Mapping[str, NDArray[np.float64]]) -> list[str]:
    """Return the labels of those of several positions (N, 3) that hardly move."""
    spread = {
        place: float(np.max(np.nanmax(p, axis=0) - np.nanmin(p, axis=0)))
        for place, p in positions.items()
        if np.isfinite(p).any(axis=0).all()
    }
    most = max(spread.values(), default=0.0)
    return [place for place, size in spread.items() if size < _STILL * most]


def polar_columns(names: Sequence[str]) -> tuple[str, str, str] | None:
    """Return the columns of the horizontal angle, the vertical one and the distance, if any.

    A horizontal distance is none of these.
    """
    found: dict[str, str] = {}
    of_angles, of_distances = _POLAR["horizontal"] | _POLAR["vertical"], _POLAR["distance"]
    for part, words in _POLAR.items():
        others = of_angles if part == "distance" else of_distances
        no_part = {word for word in others if len(word) > 1}  # r and s may stand beside an angle
        named = [
            name
            for name in _others(names, tuple(found.values()))
            if not words.isdisjoint(listed := words_of_name(name)) and no_part.isdisjoint(listed)
        ]
        if not named:
            return None
        found[part] = named[0]
    horizontal, vertical, distance = found.values()
    return horizontal, vertical, distance


def from_horizon(name: str) -> bool:
    """Return whether the name of a vertical angle says that it counts from the horizon."""
    return not _ELEVATION.isdisjoint(words_of_name(name))
