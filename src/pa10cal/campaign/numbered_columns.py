"""Columns whose names differ by a number only, and which of them are the joints of an arm."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from pa10cal.campaign.column_names import (
    has_word,
    is_of,
    plain,
    said_by_unit,
    split_unit,
    unit_of,
    words_of_name,
)

#: Numbered columns beyond the arm's joints, at most, as of a gripper.
MOST_BEYOND = 2
#: Kinds of words of columns that hold no position of a joint.
NO_JOINT = ("no position", "extreme")
#: A short unit in brackets that is none we know, as in J1 [A].
_OTHER_UNIT = re.compile(r"[\[(]\s*[a-z%]{1,2}\s*[\])]$")


class Series(NamedTuple):
    """Columns whose names differ only by a number."""

    before: str  # the text before the number, and that after it without the unit
    after: str
    by_number: dict[int, str]

    @property
    def run(self) -> list[str]:
        """Return the columns from the number 1 (or 0) on, up to the first that is missing."""
        numbers = itertools.count(0 if 0 in self.by_number else 1)
        there = itertools.takewhile(self.by_number.__contains__, numbers)
        return [self.by_number[k] for k in there]

    @property
    def words(self) -> list[str]:
        """Return the words around the number."""
        return re.findall(r"[a-z]+", f"{self.before} {self.after}")

    @property
    def called_joints(self) -> bool:
        """Return whether a word around the number says that they are joints."""
        return has_word(self.words, "joint")


def series_of(names: Sequence[str]) -> list[Series]:
    """Return the series of columns; J1 … [deg], J1 … [rad] and J1 … [Nm] are three."""
    columns: dict[tuple[str, str, str], dict[int, list[str]]] = {}
    for name in names:
        bare, said = plain(split_unit(name)[0]), said_by_unit(name)
        for found in re.finditer(r"\d+", bare):
            around = (bare[: found.start()], bare[found.end() :], said)
            columns.setdefault(around, {}).setdefault(int(found[0]), []).append(name)
    return [
        Series(before, after, by_number)
        for (before, after, _), of_number in columns.items()
        for by_number in _one_of_each_number(of_number)
    ]


def _one_of_each_number(of_number: Mapping[int, Sequence[str]]) -> Iterator[dict[int, str]]:
    """Yield sets of columns that have a number once.

    Where one has several columns, those with and without a unit are apart. Then the first of each
    number are together, whatever their units: an arm may turn and slide.
    """
    several = any(len(alike) > 1 for alike in of_number.values())
    sets: dict[tuple[bool, int], dict[int, str]] = {}
    for number, alike in of_number.items():
        placed = {False: 0, True: 0}
        for name in alike:
            has_unit = several and bool(unit_of(name))
            sets.setdefault((has_unit, placed[has_unit]), {})[number] = name
            placed[has_unit] += 1
    yield from sets.values()


class _Likeness(NamedTuple):
    """How well a series of columns suits the joints; what comes first decides first."""

    as_many: bool = False  # as the arm has joints, or their number is not known
    few_more: bool = False  # called joints, and not many more than the arm has
    measured: bool = False  # and not commanded
    called_joints: bool = False
    may_be_positions: bool = False  # by their unit
    length: int = 0


def numbered_joints(names: Sequence[str], joints: int | None) -> tuple[str, ...]:
    """Return columns of joints: numbered ones from 1 (or 0), or ones that are called joints.

    Of a few more columns than joints the first are taken: a gripper or an outer axis follows. Of
    several series that suit alike, the first in the file counts.
    """
    best, numbered = _Likeness(), tuple[str, ...]()
    for series in series_of(names):
        run = series.run
        suits = _Likeness(
            as_many=joints is None or len(run) == joints,
            few_more=joints is not None
            and series.called_joints
            and 0 <= len(run) - joints <= MOST_BEYOND,
            measured=not has_word(series.words, "commanded"),
            called_joints=series.called_joints,
            may_be_positions=not _OTHER_UNIT.search(series.after),
            length=len(run),
        )
        may_be_joints = series.called_joints or (bool(series.words) and joints is not None)
        if may_be_joints and suits > best:
            best, numbered = suits, tuple(run[:joints] if suits.few_more else run)
    called = tuple(name for name in names if has_word(words_of_name(name), "called joint"))
    more_called = len(called) > len(numbered) or not best.as_many
    if called and more_called and (joints is None or len(called) == joints):
        return called if len(called) >= 2 else ()
    return numbered if len(numbered) >= 2 and (best.as_many or best.few_more) else ()


def numbered_sets(names: Sequence[str], joints: int) -> list[tuple[str, ...]]:
    """Return every set of `joints` columns that are called joints and numbered from 1 (or 0).

    Of columns that differ by their unit only, the first are one.
    """
    found: dict[tuple[str, str], tuple[str, ...]] = {}
    for series in series_of([name for name in names if not is_of(name, "torque", *NO_JOINT)]):
        if len(series.run) >= joints and series.called_joints:
            found.setdefault((series.before, series.after), tuple(series.run[:joints]))
    return list(found.values())


def beyond(names: Sequence[str], joints: Sequence[str]) -> tuple[str, ...]:
    """Return columns that continue the numbers of the joints' columns, as of a gripper."""
    found = []
    for series in series_of(names):
        if not series.before and not series.after:
            continue  # columns without names
        listed = sorted(series.by_number.items())
        own = [number for number, name in listed if name in joints]
        if len(own) == len(joints) >= 2:
            found += [name for number, name in listed if number > max(own)]
    return tuple(found)
