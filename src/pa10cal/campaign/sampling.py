"""How an instrument or a log goes on in time: freely while the arm moves, or once a pose.

A list has one row a pose, or some rows of each. From pose to pose it changes at once. A log of
motion, or an instrument that runs freely, has rows at rest, and rows on the way between them.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from pa10cal.arrays import Array, Mask
from pa10cal.campaign.description import DESCRIPTION_FILE
from pa10cal.campaign.dwells import PAUSE, SPEED_WINDOW_S, scatter_at_rest
from pa10cal.errors import RawDataError

#: Readings are a stream with a median interval of at most this [s], and at least so many rows.
STREAM_S, STREAM_ROWS = 0.25, 100
#: Rows at rest scatter by less than this part of the larger steps, those of this quantile.
_REST_PART, _LARGER = 0.05, 0.95
#: Part of the steps that are at rest, at least; steps of one move have about the same direction,
#: by the cosine of the angle between neighbours (their median).
_AT_REST, _SAME_WAY = 0.1, 0.5
#: Part of the intervals that are no longer than this many median ones, where rows are regular.
_REGULAR, _LONGEST = 0.8, 1.5
#: Part of the groups of readings between pauses in which the target rests, where they are bursts.
_BURSTS_REST = 0.9
#: No arm is moved from pose to pose slower than this: joints [deg/s; mm/s], its target [mm/s].
SLOWEST_JOINT, SLOWEST_SLIDE, SLOWEST_TARGET_MM_S = 0.2, 1.0, 3.0
#: Two lists of the same run have numbers of rows within this factor, and durations within the
#: second.
_ALIKE_ROWS, _ALIKE_DURATIONS = 3.0, 300.0


class _Steps(NamedTuple):
    """The N - 1 steps between N rows in order of time."""

    interval_s: Array
    way: Array  # (N - 1, m)
    rest: Mask  # that move no further than the scatter; all False where there is no such


def goes_on(time_s: Array, p_mm: Array) -> bool:
    """Return whether readings go on while the arm moves: a stream.

    They are frequent, unless in short bursts of a target at rest, as of an instrument that is
    triggered several times a pose. Slower ones are regular, and some are of a target on its way.

    Args:
        time_s: (N,) times; nan where there is none.
        p_mm: (N, m) places or distances of a target; nan where it was not seen.
    """
    known_s = np.sort(time_s[np.isfinite(time_s)])
    if len(known_s) < STREAM_ROWS:
        return False
    steps = _steps_of(time_s, p_mm)
    if np.median(np.diff(known_s)) <= STREAM_S:
        return not _in_bursts(steps)
    return is_of_motion(time_s, p_mm) and is_regular(known_s)


def is_of_motion(time_s: Array, values: Array) -> bool:
    """Return whether rows (N, m) show something at rest and, for several rows, on its way.

    From one row of a list to the next but one the arm goes back as often as on.
    """
    steps = _steps_of(time_s, values)
    if not len(steps.rest) or steps.rest.mean() < _AT_REST:
        return False
    both = np.flatnonzero(~steps.rest[:-1] & ~steps.rest[1:])
    before, after = steps.way[both], steps.way[both + 1]
    lengths = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    cosine = np.sum(before * after, axis=1) / lengths
    return bool(len(both) and np.median(cosine) > _SAME_WAY)


def refuse_creeping(path: Path, key: str, time_s: Array, values: Array, slowest: Array) -> None:
    """Refuse times by which all moves of a log of motion are slower than any arm moves.

    Args:
        path: the log.
        key: of the log under `columns`, joints or readings.
        time_s: (N,) its times as they are read.
        values: (N, m) what moves.
        slowest: (m,) slowest speeds.
    """
    if not is_of_motion(time_s, values):
        return
    known = np.flatnonzero(np.isfinite(time_s) & np.isfinite(values).all(axis=1))
    known = known[np.argsort(time_s[known], kind="stable")]
    step_s, travel = np.diff(time_s[known]), np.abs(np.diff(values[known], axis=0))
    speed = travel[step_s > 0.0] / step_s[step_s > 0.0, None]
    if len(speed) and (speed.max(axis=0) < slowest).all():
        unit = "mm/s" if key == "readings" else "deg/s or mm/s"
        value = f"{_lasts(time_s)}, in which nothing is faster than {speed.max():.2g} {unit}"
        raise _other_unit(path, key, value)


def refuse_unlike_durations(paths: tuple[Path, Path], joints_s: Array, readings_s: Array) -> None:
    """Refuse two lists with about as many rows, one of which lasts hundreds of times as long."""
    rows = len(joints_s) / len(readings_s)
    durations_s = [_duration_s(times_s) for times_s in (joints_s, readings_s)]
    if not 1.0 / _ALIKE_ROWS < rows < _ALIKE_ROWS or not min(durations_s) > 0.0:
        return
    longer = int(np.argmax(durations_s))
    if durations_s[longer] > _ALIKE_DURATIONS * durations_s[1 - longer]:
        shorter = (readings_s, joints_s)[longer]
        value = f"{_lasts((joints_s, readings_s)[longer])}; {paths[1 - longer].name}: "
        raise _other_unit(
            paths[longer], ("joints", "readings")[longer], f"{value}{_lasts(shorter)}"
        )


def _duration_s(time_s: Array) -> float:
    """Return the time between the first and the last row, without a tenth of them at either end."""
    known_s = time_s[np.isfinite(time_s)]
    return float(np.ptp(np.quantile(known_s, [0.1, 0.9]))) if len(known_s) else 0.0


def _lasts(time_s: Array) -> str:
    return f"{len(time_s)} rows in {np.nanmax(time_s) - np.nanmin(time_s):.0f} s"


def _other_unit(path: Path, key: str, value: str) -> RawDataError:
    return RawDataError(
        f"the times of {path.name} cannot be in the unit in which they are read",
        where=f"{path.parent / DESCRIPTION_FILE}: columns.{key}.time",
        value=value,
        allowed="times in the unit that is stated",
        remedy=f"check what unit they are in, and state it: columns.{key}.time.unit, such as ms",
    )


def _steps_of(time_s: Array, values: Array) -> _Steps:
    """Return the steps between rows with a time and all values."""
    known = np.flatnonzero(np.isfinite(time_s) & np.isfinite(values).all(axis=1))
    known = known[np.argsort(time_s[known], kind="stable")]
    way = np.diff(values[known], axis=0)
    travel = np.abs(way).max(axis=1, initial=0.0)
    rest = np.zeros(len(travel), dtype=bool)
    if len(travel):
        scatter = scatter_at_rest(way)
        if scatter < _REST_PART * np.quantile(travel, _LARGER):
            rest = travel <= scatter
    return _Steps(np.diff(time_s[known]), way, rest)


def is_regular(time_s: Array) -> bool:
    """Return whether most intervals between times (N,), in order, are no longer than usual."""
    interval_s = np.diff(time_s)
    return bool(np.mean(interval_s <= _LONGEST * np.median(interval_s)) >= _REGULAR)


def _in_bursts(steps: _Steps) -> bool:
    """Return whether readings are short bursts, of a target at rest in each."""
    pause = steps.interval_s > PAUSE * np.median(steps.interval_s)
    burst = np.cumsum(pause)[~pause]  # of each step within one
    if not len(burst) or not steps.rest.any():
        return False
    _, number = np.unique(burst, return_inverse=True)
    lasts_s = np.bincount(number, steps.interval_s[~pause])
    rests = np.bincount(number, ~steps.rest[~pause]) == 0
    short = np.median(lasts_s) < 2.0 * SPEED_WINDOW_S
    return bool(len(rests) > 1 and short and rests.mean() >= _BURSTS_REST)
