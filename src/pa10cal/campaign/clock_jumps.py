"""Logs joined by time of which a clock goes back or jumps once.

After a restart, or at the end of summer time, a clock goes back; where it is set by another one it
jumps either way. Rows stand in the order in which they were written, so the parts before and after
a jump can each be joined at an offset of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array, Index, Mask
from pa10cal.campaign.dwells import PAUSE, Samples, Stations
from pa10cal.campaign.raw_rows import RawRows
from pa10cal.campaign.time_join import LEAST_VISITS, JoinedReadings, TimeJoin, clock_offset
from pa10cal.errors import RawDataError

#: A clock that goes back more often is none that jumps: rows are out of order.
_MOST_BACK = 3
#: The longest steps ahead, which are tried as jumps.
_AHEAD = 3
#: Parts at offsets of their own bring so much more to stations than one offset does, of all
#: readings or dwells, and so much at least.
_LEAST_GAIN, _LEAST_INSIDE = 0.1, 0.7


@dataclass(frozen=True)
class ClockJump:
    """A place in a log of N rows at which its clock may have jumped."""

    file: Path
    line: int  # line of the first row after it
    order: Index  # (N,) the rows in the order of the file, which is that of all below
    later: Mask  # (N,) rows after it
    stamp_s: Array  # (N,) times as the file has them
    joined_s: Array  # (N,) times with which the later rows follow at once

    def time_s(self, later_s: float) -> Array:
        """Return times (N,) without the jump, in the order of the file.

        Rows after it are `later_s` later than if they followed at once.
        """
        return self.joined_s + np.where(self.later, later_s, 0.0)

    @property
    def split_s(self) -> float:
        """Return the first time after it, if those rows follow at once."""
        return float(self.joined_s[self.later].min())

    @property
    def back(self) -> bool:
        """Return whether the clock goes back."""
        first = int(np.argmax(self.later))
        return bool(self.stamp_s[first] < self.stamp_s[first - 1])

    def words(self, later_s: float = 0.0) -> str:
        """Return what happened at which row; for `later_s` see `time_s`."""
        first = int(np.argmax(self.later))
        ahead_s = float(self.stamp_s[first] - self.time_s(later_s)[first])
        way = "ahead" if ahead_s > 0.0 else "back"
        return (
            f"the clock of {self.file.name} jumps {way} by {abs(ahead_s):.2f} s at line {self.line}"
        )


def possible_jumps(file: Path, line: NDArray[np.int64], stamp_s: Array) -> list[ClockJump]:
    """Return where the clock of a log goes back; where it does not, its longest steps ahead.

    Args:
        file: the log.
        line: (N,) line of each row in it.
        stamp_s: (N,) their times.
    """
    order = np.argsort(line, kind="stable")
    in_file_s = stamp_s[order]
    steps_s = np.diff(in_file_s)
    if not (steps_s > 0.0).any():
        return []
    usual_s = float(np.median(steps_s[steps_s > 0.0]))
    at = np.flatnonzero(steps_s < -PAUSE * usual_s)
    if len(at) > _MOST_BACK:
        return []
    if not len(at):
        pauses = np.flatnonzero(steps_s > PAUSE * usual_s)
        at = pauses[np.argsort(-steps_s[pauses], kind="stable")[:_AHEAD]]
    jumps = []
    for k in at.tolist():
        later = np.arange(len(order)) > k
        joined_s = in_file_s - np.where(later, steps_s[k] - usual_s, 0.0)
        jumps.append(ClockJump(file, int(line[order[k + 1]]), order, later, in_file_s, joined_s))
    return jumps


def join_by_time(join: TimeJoin, read: RawRows) -> JoinedReadings:
    """Return readings with their stations, see `TimeJoin.join`, also where a clock jumps once.

    A jump is sought where less than nearly all are joined and no offset of the clocks is stated.

    Raises:
        RawDataError: when the logs cannot be joined; it names the row at which a clock goes back.
    """
    try:
        joined = join.join(read)
    except RawDataError as refusal:
        jumps = _possible_jumps(join, read)
        repaired = _without_jump(join, read, jumps, 0)
        if repaired is not None:
            return repaired
        back = [jump for jump in jumps if jump.back]
        if not back:
            raise
        raise RawDataError(
            f"{back[0].words()}, and its parts cannot be joined each for itself: {refusal.what}",
            where=f"{back[0].file}:{back[0].line}",
            value=refusal.value,
            allowed="times that go on within a log",
            remedy="correct the times from that row on, or make two campaigns of the parts",
        ) from refusal
    if joined.nearly_all or not (jumps := _possible_jumps(join, read)):
        return joined
    inside, _ = _inside(join, *join.at_rest_of(read))
    return _without_jump(join, read, jumps, inside) or joined


class _Parts(NamedTuple):
    """What offsets of their own bring to stations, before and after a jump."""

    jump: ClockJump
    inside: int  # number of dwells or readings at stations
    total: int  # number of all
    before_s: float  # to add to times of readings before the jump
    after_s: float  # and after it


def _possible_jumps(join: TimeJoin, read: RawRows) -> list[ClockJump]:
    """Return the places at which either clock may have jumped; none where an offset is stated."""
    if join.stated_offset_s is not None:
        return []
    known = _known(read)
    return [
        *possible_jumps(join.joints, join.samples.line, join.samples.time_s),
        *possible_jumps(join.readings, read.line[known], read["time_s"][known]),
    ]


def _known(read: RawRows) -> Index:
    """Return the readings that have a time."""
    return np.flatnonzero(np.isfinite(read["time_s"]))


def _without_jump(
    join: TimeJoin, read: RawRows, jumps: list[ClockJump], stamped: int
) -> JoinedReadings | None:
    """Return the logs joined without the jump that parted them; None where none did.

    `stamped` is how many dwells or readings one offset brings to stations.
    """
    tried = [parts for jump in jumps if (parts := _in_parts(join, read, jump)) is not None]
    best = max(tried, key=lambda parts: parts.inside, default=None)
    if best is None or best.inside < _LEAST_INSIDE * best.total:
        return None
    if best.inside < stamped + _LEAST_GAIN * best.total:
        return None
    jump, of_joints = best.jump, best.jump.file == join.joints
    later_s = (best.before_s - best.after_s) * (1.0 if of_joints else -1.0)
    split_s = jump.split_s - (best.before_s if of_joints else 0.0)
    again, rows, _ = _retimed(join, read, jump, later_s)
    change_s = again.offset_after_less_before(rows, split_s, best.before_s)
    later_s -= change_s if of_joints else -change_s
    again, rows, order = _retimed(join, read, jump, later_s)
    joined = again.join(rows)
    note = f"{joined.note}; {jump.words(later_s)}, and later rows are read without that jump"
    return replace(joined, stations=joined.stations.of_rows(order), note=note)


def _retimed(
    join: TimeJoin, read: RawRows, jump: ClockJump, later_s: float
) -> tuple[TimeJoin, RawRows, Index]:
    """Return logs without a jump; and the order of their samples, in terms of those of `join`."""
    time_s = jump.time_s(later_s)
    if jump.file != join.joints:
        of_readings = read["time_s"].copy()
        of_readings[_known(read)[jump.order]] = time_s
        unchanged = np.arange(len(join.samples))
        return join, read.with_columns({"time_s": of_readings}), unchanged
    in_time = np.argsort(time_s, kind="stable")
    order = jump.order[in_time]
    columns = {each.name: getattr(join.samples, each.name)[order] for each in fields(Samples)}
    samples = Samples(**columns | {"time_s": time_s[in_time]})
    return replace(join, samples=samples), read, order


def _in_parts(join: TimeJoin, read: RawRows, jump: ClockJump) -> _Parts | None:
    """Return what both parts bring to stations; None where one of them holds too little."""
    of_joints = jump.file == join.joints
    join, read, _ = _retimed(join, read, jump, 0.0)
    try:
        time_s, rows, stations = join.at_rest_of(read)
    except RawDataError:
        return None
    later = (stations.start_s if of_joints else time_s) >= jump.split_s
    found = []
    for part in map(np.flatnonzero, (~later, later)):
        if len(part) < LEAST_VISITS:
            return None
        found.append(
            _inside(join, time_s, rows, stations.take(part))
            if of_joints
            else _inside(join, time_s[part], rows.at(part), stations)
        )
    (before, before_s), (after, after_s) = found
    return _Parts(jump, before + after, len(time_s), before_s, after_s)


def _inside(join: TimeJoin, time_s: Array, rows: RawRows, stations: Stations) -> tuple[int, float]:
    """Return how many times (N,) the best offset of the clocks brings to stations, and it."""
    offset_s, _ = clock_offset(stations, time_s, join.nominal.at_stations(rows, stations))
    return int((stations.at(time_s + offset_s) >= 0).sum()), offset_s
