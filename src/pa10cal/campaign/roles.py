"""What the columns of an unknown file may be, by their names."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: Targets that move by less than this part of what others do stand still.
_STILL = 0.02
#: Words of columns that hold what was commanded, and of uncertainties.
_COMMANDED = re.compile(r"goal|target|command|cmd|nominal|nom\b|setpoint|desired|soll|ref", re.I)
_UNCERTAIN = re.compile(r"std|sigma|uncert|unc\b|stdev|(^|_)u_|(^|[ _])s[xyz]", re.I)
_UNIT = re.compile(
    r"[\[(/ _.-]*[\[(/_ ](rad|radians|deg|degrees|degree|mm|cm|um|m|in|nm|n\.m|n|c|k|f|s|ms|us)"
    r"[\])]?$",
    re.I,
)
_TORQUE = re.compile(r"tau|torque|effort|moment|drehmoment", re.I)
_JOINT = re.compile(r"joint|axis|achse|gelenk", re.I)
_NUMBERED = re.compile(r"(?:^|[^a-z])(q|j|a|axis|joint|theta|th|jnt|achse|pos)[ _.-]?(\d)\b", re.I)
#: Endings of the columns of an attitude, and the convention that the names alone suggest.
_ATTITUDES = (
    (("qw", "qx", "qy", "qz"), "quaternion_wxyz"),
    (("q0", "q1", "q2", "q3"), "quaternion_wxyz"),
    (("qx", "qy", "qz", "qw"), "quaternion_xyzw"),
    (("roll", "pitch", "yaw"), "rpy"),
    (("rx", "ry", "rz"), "rpy"),
    (("rotx", "roty", "rotz"), "rpy"),
    (("w", "p", "r"), "rpy"),
    (("a", "b", "c"), "euler_ZYX"),
    (("o", "a", "t"), "euler_ZYZ"),
    (tuple(f"r{i}{j}" for i in "123" for j in "123"), "matrix"),
    (tuple(f"r{i}{j}" for i in "012" for j in "012"), "matrix"),
)
#: What stands before x, y, z without anything between.
_RUN_ON = ("p", "t", "pos", "tcp", "trans")
_SINGLE = {
    "temperature": re.compile(r"temp", re.I),
    "time": re.compile(r"time|stamp|date|zeit|datum|^t$", re.I),
    "load": re.compile(r"load|payload|last\b", re.I),
    "pose": re.compile(r"^(pose|label|point|name|id|punkt)$", re.I),
    "repeat": re.compile(r"^(repeat|run|cycle)$", re.I),
    "kind": re.compile(r"^(kind|set|split)$", re.I),
    "distance": re.compile(r"dist|range", re.I),
}


@dataclass(frozen=True)
class Roles:
    """Names of columns by what they may be."""

    joints: tuple[str, ...]  # in order; empty where none were recognised
    torques: tuple[str, ...]  # likewise
    # triples by what stands before x, y, z, those of commands last
    positions: dict[str, tuple[str, ...]]
    # columns, and the convention that the names suggest; None where there is none
    attitude: tuple[tuple[str, ...], str] | None
    uncertain: dict[str, str]  # uncertainties by the column that they are of
    single: dict[str, str]  # further columns, by the key of `columns`
    times: tuple[str, ...] = ()  # every column that may hold a date or a time of day


def roles_of(names: Sequence[str], joints: int | None) -> Roles:
    """Return what columns may be.

    Args:
        names: of all columns.
        joints: how many joints the arm has; None where that is not known.
    """
    certain = [name for name in names if not _UNCERTAIN.search(name)]
    turns = _joints([name for name in certain if not _TORQUE.search(name)], joints)
    torques = _joints([name for name in certain if _TORQUE.search(name)], joints)
    rest = [name for name in certain if name not in {*turns, *torques}]
    attitude = _attitude(rest)
    rest = [name for name in rest if attitude is None or name not in attitude[0]]
    positions = dict(_positions(rest))
    taken = {name for triple in positions.values() for name in triple}
    single = {}
    for key, like in _SINGLE.items():
        found = next((name for name in rest if like.search(name) and name not in taken), None)
        if found is not None:
            single[key] = found
            taken.add(found)
    times = tuple(
        name
        for name in rest
        if _SINGLE["time"].search(name) and name not in taken - {single.get("time")}
    )
    return Roles(turns, torques, positions, attitude, _uncertain(names), single, times)


def unit_of(name: str) -> str | None:
    """Return the unit that stands in a name, in lower case; None where there is none."""
    found = _UNIT.search(name)
    return found[1].lower() if found else None


def _bare(name: str) -> str:
    return _UNIT.sub("", name.strip()).strip()


def _joints(names: Sequence[str], joints: int | None) -> tuple[str, ...]:
    """Return columns of joints: numbered ones from 1 (or 0), or such as are called joints."""
    numbered: dict[str, dict[int, str]] = {}
    for name in names:
        if (found := _NUMBERED.search(_bare(name))) is not None:
            stem = _bare(name)[: found.start(2)].lower()
            numbered.setdefault(stem, {})[int(found[2])] = name
    best: tuple[str, ...] = ()
    for listed in numbered.values():
        start = 0 if 0 in listed else 1
        found_ones: list[str] = []
        while start + len(found_ones) in listed:
            found_ones.append(listed[start + len(found_ones)])
        best = max(best, tuple(found_ones), key=lambda each: (_fits(each, joints), len(each)))
    called = tuple(name for name in names if _JOINT.search(name))
    best = max(best, called, key=lambda each: (_fits(each, joints), len(each)))
    return best if len(best) >= 2 and (joints is None or len(best) == joints) else ()


def _fits(names: Sequence[str], joints: int | None) -> bool:
    return joints is None or len(names) == joints


def _attitude(names: Sequence[str]) -> tuple[tuple[str, ...], str] | None:
    """Return the columns of an attitude, measured rather than commanded."""
    for commanded in (False, True):
        some = [name for name in names if bool(_COMMANDED.search(name)) == commanded]
        for endings, convention in _ATTITUDES:
            for stem in _stems(some, endings[0]):
                found = [_ending(some, stem, ending) for ending in endings]
                if all(each is not None for each in found):
                    order = sorted((str(each) for each in found), key=names.index)
                    if convention.startswith("quaternion"):
                        first = "w" if order[0] == found[endings.index(_scalar(endings))] else "x"
                        convention = "quaternion_wxyz" if first == "w" else "quaternion_xyzw"
                        return tuple(order), convention
                    return tuple(str(each) for each in found), convention
    return None


def _scalar(endings: Sequence[str]) -> str:
    return "qw" if "qw" in endings else "q0"


def _stems(names: Sequence[str], ending: str) -> Iterator[str]:
    """Yield what stands before an ending; a single letter stands apart, but in `px` or `tx`."""
    for name in names:
        bare = _bare(name).lower()
        before = bare.removesuffix(ending)
        apart = not before[-1:].isalnum() or before in _RUN_ON
        if before != bare and (len(ending) > 1 or apart):
            yield before


def _ending(names: Sequence[str], stem: str, ending: str) -> str | None:
    return next((name for name in names if _bare(name).lower() == stem + ending), None)


def _positions(names: Sequence[str]) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield triples of coordinates by what stands before x, y, z; commanded ones last."""
    for commanded in (False, True):
        some = [name for name in names if bool(_COMMANDED.search(name)) == commanded]
        for stem in dict.fromkeys(_stems(some, "x")):
            found = [_ending(some, stem, f"{axis}") for axis in "xyz"]
            if all(each is not None for each in found):
                triple = tuple(str(each) for each in found)
                yield triple[0][: len(stem)], triple


def _uncertain(names: Sequence[str]) -> dict[str, str]:
    """Return the columns of uncertainties by the one that each is of."""
    plain = {re.sub(r"[^a-z0-9]", "", name.lower()): name for name in names}
    found = {}
    for name in names:
        if _UNCERTAIN.search(name):
            without = re.sub(r"std(ev)?|sigma|uncert(ainty)?|unc|(?:^|_)u_", "", name, flags=re.I)
            of = plain.get(re.sub(r"[^a-z0-9]", "", without.lower()))
            if of is not None and of != name:
                found[of] = name
    return found


def standing(positions: Mapping[str, NDArray[np.float64]]) -> list[str]:
    """Return which of several positions (N, 3) hardly move, by what stands before their x, y, z."""
    spread = {
        place: float(np.max(np.nanmax(p, axis=0) - np.nanmin(p, axis=0)))
        for place, p in positions.items()
        if np.isfinite(p).any(axis=0).all()
    }
    most = max(spread.values(), default=0.0)
    return [place for place, size in spread.items() if size < _STILL * most]
