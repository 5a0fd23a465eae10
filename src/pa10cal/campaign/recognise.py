"""Roles of the columns of an unknown file: by their names (English, German, French, Spanish)."""

from __future__ import annotations

import itertools
import re
import unicodedata
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.errors import RawDataError
from pa10cal.yaml_file import read_yaml

#: Words of units and of names, by their meaning; see the file.
WORDS = read_yaml(Path(__file__).with_name("words.yaml"), RawDataError, what="it cannot be read")
_SPELLED: dict[str, str] = {
    spelled: unit for unit, words in WORDS["units"].items() for spelled in words.split()
}
#: Longer names have no unit, and longer words are no dates: regular expressions would take long.
MOST_LETTERS = 200
_BRACKETED = re.compile(r"^(?P<bare>.*?)\s*[\[({<]\s*(?P<unit>[^\[\](){}<>]{1,14}?)\s*[\])}>]\s*$")
_APART = re.compile(r"^(?P<bare>.+?)(?:\s+in\s+|[\s_/,;:-]+)(?P<unit>[^\s_/,;:-]{1,12})$")
_SIGN = re.compile(r"^(?P<bare>.*?)\s*(?P<unit>°[CF]?)$")


def canonical_unit(text: str) -> str:
    """Return the unit as campaign.yaml writes it for a unit as files write it; empty for none."""
    bare = plain(text).replace(" ", "")
    return _SPELLED.get(bare, "")


def unit_alone(field: str) -> str:
    """Return a unit that stands alone in a field, without its brackets."""
    return field.strip(" \t[](){}<>/")


def split_unit(name: str) -> tuple[str, str]:
    """Return a column's name without its unit, and the unit; empty where there is none."""
    if len(name) > MOST_LETTERS:
        return name.strip(), ""
    for like in (_BRACKETED, _SIGN, _APART):
        found = like.match(name.strip())
        if found is not None and (unit := canonical_unit(found["unit"])):
            return found["bare"].strip(" _/,;:-"), unit
    return name.strip(), ""


def unit_of(name: str) -> str:
    """Return the unit that stands in a name; empty where there is none."""
    return split_unit(name)[1]


def apart_by_letters(names: Sequence[str]) -> tuple[str, ...]:
    """Return names in which a letter that tells columns apart is read as no unit.

    tcp_C beside tcp_A and tcp_B becomes tcp_C_; of the letters of two others at least none is one.
    """
    others: dict[str, int] = {}
    for name in names:
        if name[-1:].isalpha() and not name[-2:-1].isalnum() and not canonical_unit(name[-1]):
            others[name[:-1]] = others.get(name[:-1], 0) + 1
    marked = [
        f"{name}_" if others.get(name[:-1], 0) >= 2 and canonical_unit(name[-1]) else name
        for name in names
    ]
    return tuple(m if m not in names else name for m, name in zip(marked, names, strict=True))


# Words of names, in small letters without accents.

_GREEK = {
    **{"α": "alpha", "β": "beta", "γ": "gamma", "θ": "theta", "φ": "phi", "ϕ": "phi"},
    **{"ψ": "psi", "ω": "omega", "τ": "tau"},
}
_VOCABULARY = {
    kind: frozenset(words.split()) for kind, words in (WORDS["words"] | WORDS["single"]).items()
}
_ORIENTATIONS = [(tuple(endings.split()), word) for endings, word in WORDS["orientations"]]
#: Kinds of words that a number may follow without a sign, as in tau1.
_NUMBERED_KINDS = ("torque", "no position", "deviation")
#: The same of words of two letters and more, as in rot1: R1 is a reflector.
_TURNED_KINDS = (
    *("rotation", "vector", "quaternion", "rotation vector", "translation", "orientation"),
)
#: Vectors of a camera's pose, in one word or two: rvec, r_vec, rotation vector; tvecs.
_VECTOR = re.compile(
    r"(?<![a-z\d])([rt])(?:ot(?:ation)?|rans(?:lation)?)?[\s_.-]*vec(?:tor)?s?(?![a-z])"
)
#: Words directly before or after x, y, z, as in `tcpx`.
_BEFORE_AXIS = "p|t|pos|tcp|trans|tvec|coord|meas|act|ist"
_AFTER_AXIS = "pos|ist|act|actual|mess|meas|measured|coord|koord|soll|nom|cmd"
_AXIS = re.compile(rf"(?:{_BEFORE_AXIS})?([xyz])(?:{_AFTER_AXIS})?")
#: An axis of a numbered place, as in X1, Y1, Z1.
_NUMBERED_AXIS = re.compile(r"^([xyz])(\d+)$", re.IGNORECASE)
#: A word of two letters and more with a number, as in rx1.
_NUMBERED_WORD = re.compile(r"^([a-z]{2,})(\d+)$")
#: Numbered columns beyond the arm's joints, at most, as of a gripper.
MOST_BEYOND = 2
#: Targets that move by less than this part of the largest motion are at rest.
_STILL = 0.02
#: Of names: that an uncertainty is expanded, and by which factor; 2 where it does not say.
_EXPANDED = re.compile(
    r"\bu\W*(?:95|0\.95)\b\W*|\b95\s*%|\bk\s*=\s*(?P<k>\d(?:\.\d+)?)|(?P<sigmas>[23])\s*-?sigma\b"
    r"|\b(?:expanded|erweiterte|elargie|expandida)\b"
)
#: Other words before the seconds of a stamp.
_OF_STAMPS = ("header", "tv")
#: Encodings that are mistaken for each other.
_ENCODINGS = ("utf-8", "cp1252", "cp850", "mac_roman")
_ELEVATION = frozenset(WORDS["from horizon"].split())
_POLAR = {part: frozenset(words.split()) for part, words in WORDS["polar"].items()}


def plain(text: str) -> str:
    """Return a text in lower case without accents; Greek letters and micro signs are spelled."""
    spelled = "".join(_GREEK.get(letter, letter) for letter in text.lower())
    spelled = spelled.replace("μ", "u").replace("µ", "u").replace("ß", "ss")
    apart = unicodedata.normalize("NFKD", spelled)
    return "".join(letter for letter in apart if not unicodedata.combining(letter))


@lru_cache(maxsize=4096)
def words_of_name(name: str) -> tuple[str, ...]:
    """Return the words of a name without its unit, parted at signs and camel case."""
    if len(name) > MOST_LETTERS:
        return ()
    bare = re.sub(r"(?<=[a-zäöüéèí])(?=[A-Z])", " ", split_unit(name)[0])
    return tuple(re.findall(r"[a-z]+\d*|\d+", _VECTOR.sub(r"\1vec", plain(bare))))


def has_word(words: Sequence[str], *kinds: str) -> bool:
    """Return whether one of the words is of one of these kinds of `WORDS`."""
    bare = [word.rstrip("0123456789") for word in words]
    turned = [*words, *(word for word in bare if len(word) > 1)]
    return any(
        not _VOCABULARY[kind].isdisjoint(
            bare if kind in _NUMBERED_KINDS else turned if kind in _TURNED_KINDS else words
        )
        for kind in kinds
    )


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
    turns: tuple[str, ...] = (),
) -> Roles:
    """Return the roles of columns by their names.

    Args:
        names: names of the columns.
        joints: number of the arm's joints; None where not known.
        text: columns of text, which may be labels, kinds of rows or times, but not measured.
        turns: columns of joint positions in order, where they are known by the joints' names.
    """
    uncertain, of_whole = _uncertain(names)
    uncertainties = {*uncertain.values(), *of_whole.values()}
    certain = [
        name
        for name in _without_words(names, "deviation")
        if name not in (*uncertainties, *text, *turns)
        and not has_word(words_of_name(name)[:1], "uncertain")
    ]
    attitude = attitude_of(_without_words(certain, "no position"))
    free = [name for name in certain if attitude is None or name not in attitude[0]]
    positions = positions_of(free)
    if attitude is not None and not positions:
        triple = next(_numbered_vectors(free, ("t", "p")), None)
        positions = {} if triple is None else {"": triple}
    for label, triple in positions.items():
        u = of_whole.get("".join(words_of_name(label)), of_whole.get(""))
        if u is not None and not any(name in uncertain for name in triple):
            uncertain |= dict.fromkeys(triple, u)
    taken = {name for triple in positions.values() for name in triple}
    free = [name for name in free if name not in taken]
    no_torques = _without_words(free, "torque")
    still = _without_words(no_torques, "no position")
    turns = turns or numbered_joints(still, joints)
    of_torques = [name for name in free if name not in no_torques]
    torques = numbered_joints(of_torques, joints or len(turns) or None)
    if not turns and joints == 4 and attitude is not None and attitude[1].startswith("quaternion"):
        # q0 … q3 of an arm with four joints are these, where nothing else is.
        turns = numbered_joints([*still, *attitude[0]], joints)
        attitude = None if turns else attitude
    free = [name for name in names if name in (*no_torques, *text) and name not in turns]
    single = _single_columns(free, text)
    if "distance" in single and "" in of_whole:
        uncertain.setdefault(single["distance"], of_whole[""])
    others = {name for key, name in single.items() if key != "time"}
    times = [name for name in free if has_word(words_of_name(name), "time") and name not in others]
    parts = next(iter(parts_of_stamps([name for name in free if name not in others])), None)
    if parts is not None and single.get("time", parts[0]) in parts:
        single["time"] = parts[0]
        times = list(dict.fromkeys((*times, *parts)))
    return Roles(turns, torques, positions, attitude, uncertain, single, tuple(times))


def _without_words(names: Sequence[str], *kinds: str) -> list[str]:
    """Return the names that have no word of these kinds of `WORDS`."""
    return [name for name in names if not has_word(words_of_name(name), *kinds)]


def positions_of(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return triples of columns x, y, z by the words before them; those of commands are last.

    Where there are none, x1, y1, z1, x2, … are places by their numbers. Components of a translation
    may be numbered, too.
    """
    numbered = _numbered_vectors(names, _VOCABULARY["translation"])
    vectors = {_around_axis(triple[0]).rstrip("0123456789"): triple for triple in numbered}
    return (_triples(names) or _triples(names, numbered=True)) | vectors


def _numbered_vectors(names: Sequence[str], words: Collection[str]) -> Iterator[tuple[str, ...]]:
    """Yield three columns that are numbered from 0 or 1 behind one of these words, as in tvec0."""
    for (before, after), listed in _series(names).items():
        numbers = sorted(listed)
        called = not words_of_name(after) and not {*words_of_name(before)[-1:]}.isdisjoint(words)
        if called and numbers in ([0, 1, 2], [1, 2, 3]):
            yield tuple(listed[k] for k in numbers)


def _triples(names: Sequence[str], *, numbered: bool = False) -> dict[str, tuple[str, ...]]:
    """Return triples of columns of measured, then of commanded places, by the words before them."""
    positions: dict[str, tuple[str, ...]] = {}
    for some in _measured_first(names):
        for axes, place in _by_axis(some, "xyz", numbered=numbered):
            if not has_word(place, "rotation", "no position", "torque", "force"):
                before = _around_axis(axes["x"])
                label = before if before not in positions else f"{before}{len(positions) + 1}"
                positions[label] = tuple(axes.values())
    return positions


def _single_columns(names: Sequence[str], text: Collection[str]) -> dict[str, str]:
    """Return the columns that stand alone, such as time or load, by the key of `columns`.

    Quantities are named by a word, or by a part of one; of them only a time may be text.
    """
    single: dict[str, str] = {}
    for key, vocabulary in WORDS["single"].items():
        free = [name for name in names if name not in single.values()]
        if key in ("temperature", "load", "distance"):
            free = [name for name in free if name not in text]
        named = [name for name in free if has_word(words_of_name(name), key)]
        if key == "distance" and "d_mm" in free:  # the name that raw data have for it
            named = ["d_mm"]
        if not named and key in ("time", "temperature", "load", "distance"):
            part = re.compile("|".join(word for word in vocabulary.split() if len(word) > 3))
            named = [name for name in free if any(map(part.search, words_of_name(name)))]
        if named:
            single[key] = named[0]
    return single


def parts_of_stamps(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return the stamps in two columns, seconds and the part of a second, as ROS has them.

    Their names differ only by a last word, such as secs and nsecs, sec and nanosec.
    """
    by_unit: dict[str, dict[str, str]] = {}
    for name in names:
        bare = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name[:MOST_LETTERS]).rstrip(")]} ")
        found = re.fullmatch(r"(?P<rest>.*?)[\W_]*(?P<unit>[a-z]+)", plain(bare))
        rest = () if found is None else words_of_name(found["rest"])
        if found is not None and (not rest or has_word(rest, "time") or rest[-1] in _OF_STAMPS):
            by_unit.setdefault(canonical_unit(found["unit"]), {})[found["rest"]] = name
    return [
        (seconds, by_unit[part][rest])
        for rest, seconds in by_unit.get("s", {}).items()
        for part in ("ns", "us", "ms")
        if rest in by_unit.get(part, {})
    ]


def _measured_first(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the columns of measured, then those of commanded quantities."""
    commanded = [name for name in names if has_word(words_of_name(name), "commanded")]
    return [name for name in names if name not in commanded], commanded


def numbered_joints(names: Sequence[str], joints: int | None) -> tuple[str, ...]:
    """Return columns of joints: numbered ones from 1 (or 0), or ones that are called joints.

    Of a few more columns than joints the first are taken: a gripper or an outer axis follows.
    """
    best: tuple[tuple[bool, bool, bool, bool, int], tuple[str, ...]] = ((False,) * 4 + (0,), ())
    for around, listed in _series(names).items():
        numbers = itertools.count(0 if 0 in listed else 1)
        run = [listed[k] for k in itertools.takewhile(listed.__contains__, numbers)]
        around_words = re.findall(r"[a-z]+", " ".join(around))
        a_joint = has_word(around_words, "joint")
        fits = joints is None or len(run) == joints
        more = joints is not None and a_joint and 0 <= len(run) - joints <= MOST_BEYOND
        score = (fits, more, not has_word(around_words, "commanded"), a_joint, len(run))
        if score > best[0] and around_words and (a_joint or joints is not None):
            best = score, tuple(run[:joints] if more else run)
    (fits, more, *_), numbered = best
    called = tuple(name for name in names if has_word(words_of_name(name), "called joint"))
    if (joints is None or len(called) == joints) and len(called) > len(numbered) * fits:
        return called if len(called) >= 2 else ()
    return numbered if len(numbered) >= 2 and (fits or more) else ()


def _series(names: Sequence[str]) -> dict[tuple[str, str], dict[int, str]]:
    """Return names that differ only by a number: by the text around it, then by the number."""
    series: dict[tuple[str, str], dict[int, str]] = {}
    for name in names:
        bare = plain(split_unit(name)[0])
        for found in re.finditer(r"\d+", bare):
            around = (bare[: found.start()], bare[found.end() :])
            series.setdefault(around, {})[int(found[0])] = name
    return series


def numbered_sets(names: Sequence[str], joints: int) -> list[tuple[str, ...]]:
    """Return every set of `joints` columns that are called joints and numbered from 1 (or 0)."""
    found = []
    for around, listed in _series(names).items():
        first = 0 if 0 in listed else 1
        run = [listed[k] for k in range(first, first + joints) if k in listed]
        if len(run) == joints and has_word(re.findall(r"[a-z]+", " ".join(around)), "joint"):
            found.append(tuple(run))
    return found


def beyond(names: Sequence[str], joints: Sequence[str]) -> tuple[str, ...]:
    """Return columns that continue the numbers of the joints' columns, as of a gripper."""
    found = []
    for around, listed in _series(names).items():
        if not any(around):
            continue  # columns without names
        own = [number for number, name in listed.items() if name in joints]
        if len(own) == len(joints) >= 2:
            found += [name for number, name in sorted(listed.items()) if number > max(own)]
    return tuple(found)


def attitude_of(names: Sequence[str]) -> tuple[tuple[str, ...], str] | None:
    """Return the columns of an orientation, measured rather than commanded."""

    def quaternion(wxyz: Sequence[str]) -> tuple[tuple[str, ...], str]:
        """Return the columns in the order of the file, and the convention."""
        order = tuple(sorted(wxyz, key=names.index))
        return order, "quaternion_wxyz" if order[0] == wxyz[0] else "quaternion_xyzw"

    kind = "rotation vector"
    for some in _measured_first(names):
        # What a camera's software writes, before what may be the controller's own pose.
        called = [
            *(
                tuple(axes.values())
                for axes, place in _by_axis(some, "xyz")
                if has_word(place, kind)
            ),
            *_numbered_vectors(some, _VOCABULARY[kind]),
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
    """Yield columns that differ only by these words; q1 … q4 followed by q5 are joints.

    `numbered` words have the number of the target behind them, as in rx1, if it is the same of all.
    """
    beyond = {"q0": "q4", "q1": "q5"}.get(endings[0], "")
    groups: dict[tuple[str, ...], dict[str, str]] = {}
    for name in names:
        listed = words_of_name(name)
        if numbered:
            parted = (_NUMBERED_WORD.sub(r"\1 \2", word).split() for word in listed)
            listed = tuple(itertools.chain.from_iterable(parted))
        for k, word in enumerate(listed):
            rest = (*listed[:k], *listed[k + 1 :])
            if any(map(_AXIS.fullmatch, rest)):
                continue  # x of a target that is called so
            if word in (*endings, beyond):
                groups.setdefault(rest, {}).setdefault(word, name)
        if len(listed) >= 2 and listed[-2] + listed[-1] in (*endings, beyond):
            groups.setdefault(tuple(listed[:-2]), {}).setdefault(listed[-2] + listed[-1], name)
    found = [
        tuple(group[ending] for ending in endings)
        for group in groups.values()
        if beyond not in group and all(ending in group for ending in endings)
    ]
    if not numbered or len(found) == 1:
        yield from found


def _by_axis(
    names: Sequence[str], letters: str, *, numbered: bool = False
) -> Iterator[tuple[dict[str, str], tuple[str, ...]]]:
    """Yield columns that differ only by a letter x, y, z (w), by it, and the words around it.

    A `numbered` letter has its number behind it, as in x1, which counts as a word.
    """
    groups: dict[tuple[str, ...], dict[str, str]] = {}
    for name in names:
        listed = words_of_name(name)
        if numbered:
            parted = (_NUMBERED_AXIS.sub(r"\1 \2", word).split() for word in listed)
            listed = tuple(itertools.chain.from_iterable(parted))
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
    parts = re.findall(r"[^\W_]+", split_unit(name)[0])
    k = next((k for k, part in enumerate(parts) if _AXIS.fullmatch(plain(part))), len(parts))
    parts = [_NUMBERED_AXIS.sub(r"\2", part) for part in (*parts[:k], *parts[k + 1 :])]
    return "".join(parts)


def coverage_of(name: str) -> float:
    """Return the coverage factor of a column of uncertainties; 1 for standard uncertainties."""
    found = _EXPANDED.search(plain(name)) if len(name) <= MOST_LETTERS else None
    if found is None:
        return 1.0
    return float(found["k"] or found["sigmas"] or 2.0)


def _uncertain(names: Sequence[str]) -> tuple[dict[str, str], dict[str, str]]:
    """Return columns of uncertainties by the column that each is of, and those of whole targets.

    The latter are by the words before x, y, z of the target, in lower case; empty for all targets.
    """
    known = _VOCABULARY["uncertain"]
    called: dict[str, str] = {}
    for name in names:
        called.setdefault("".join(words_of_name(name)), name)
    uncertain, whole = {}, {}
    for name in names:
        expanded = coverage_of(name) != 1.0
        bare = _EXPANDED.sub(" u ", plain(split_unit(name)[0])) if expanded else name
        listed = words_of_name(bare)
        rest = [word for word in listed if word not in known]
        run_on = re.fullmatch(r"(?:s|u|std|sigma)([xyz]|q\d)", rest[-1]) if rest else None
        if len(rest) == len(listed) and run_on is None:
            continue
        if run_on is not None and (expanded or len(rest) == len(listed)):
            rest = [*rest[:-1], run_on[1]]
        of = called.get("".join(rest))
        if of is not None and of != name:
            uncertain[of] = name
        elif expanded or not _VOCABULARY["uncertainty"].isdisjoint(listed):
            whole["".join(rest)] = name
    return uncertain, whole


def standing(positions: Mapping[str, NDArray[np.float64]]) -> list[str]:
    """Return the labels of those of several positions (N, 3) that hardly move."""
    spread = {
        place: float(np.max(np.nanmax(p, axis=0) - np.nanmin(p, axis=0)))
        for place, p in positions.items()
        if np.isfinite(p).any(axis=0).all()
    }
    most = max(spread.values(), default=0.0)
    return [place for place, size in spread.items() if size < _STILL * most]


def mistaken_encoding(name: str, names: Sequence[str]) -> tuple[str, str, str] | None:
    """Return which of `names` is a name read in a wrong encoding, if any.

    With it come the encoding that was taken to read `name`, and the right one.
    """
    for taken in _ENCODINGS:
        for right in _ENCODINGS:
            try:
                other = name.encode(taken).decode(right)
            except UnicodeError:
                continue
            if other != name and other in names:
                return other, taken, right
    return None


def polar_columns(names: Sequence[str]) -> tuple[str, str, str] | None:
    """Return the columns of the horizontal angle, the vertical one and the distance, if any."""
    found: dict[str, str] = {}
    for part, words in _POLAR.items():
        named = [name for name in names if not words.isdisjoint(words_of_name(name))]
        named = [name for name in named if name not in found.values()]
        if not named:
            return None
        found[part] = named[0]
    horizontal, vertical, distance = found.values()
    return horizontal, vertical, distance


def from_horizon(name: str) -> bool:
    """Return whether the name of a vertical angle says that it counts from the horizon."""
    return not _ELEVATION.isdisjoint(words_of_name(name))


def with_polar(roles: Roles, names: Sequence[str]) -> Roles:
    """Return roles in which polar readings are a position, where there is no other."""
    taken = {*roles.joints, *roles.torques, *roles.uncertain.values()}
    polar = polar_columns([name for name in names if name not in taken])
    if roles.positions or polar is None:
        return roles
    single = {key: name for key, name in roles.single.items() if name not in polar}
    return replace(roles, positions={"": polar}, attitude=None, single=single, polar=polar)
