"""Rows of the joints' log that were written only where a joint changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pa10cal.campaign.dwells import PAUSE
from pa10cal.campaign.raw_rows import RawRows

#: Of neighbouring rows without a pause between them at most this part is equal, and pauses are this
#: part of the time and so many, at least.
_EQUAL, _PAUSES_SHARE, _PAUSES = 0.01, 0.1, 5
#: Part of the pauses over which no joint moves further than between rows beside, at least.
_HELD = 0.9
#: Rows made in one pause, at most.
_MOST_ROWS = 500


def held_between_changes(logged: RawRows, q: Sequence[str]) -> RawRows:
    """Return a log of joints, columns `q`, with its last row repeated where none was written.

    A controller that writes a row only where a joint changed has none while the arm stands. Such a
    log has hardly two equal rows after each other, and long pauses over which the arm hardly
    moved. Rows are in order of time. Any other log is returned as it is.
    """
    time_s, steps_s = logged["time_s"], np.diff(logged["time_s"])
    if not (steps_s > 0.0).any():
        return logged
    usual_s = float(np.median(steps_s[steps_s > 0.0]))
    travel = np.abs(np.diff(logged.numbers_of(q), axis=0)).max(axis=1)
    pause = steps_s > PAUSE * usual_s
    beside = travel[~pause]
    if pause.sum() < _PAUSES or steps_s[pause].sum() < _PAUSES_SHARE * steps_s.sum():
        return logged
    held = pause & (travel <= np.median(beside))
    if held.sum() < _HELD * pause.sum() or np.mean(beside == 0.0) > _EQUAL:
        return logged
    count = np.ones(len(time_s), dtype=np.intp)
    count[:-1][held] = np.clip(np.round(steps_s[held] / usual_s), 2, _MOST_ROWS).astype(np.intp)
    rows = np.repeat(np.arange(len(time_s)), count)
    part = (np.arange(len(rows)) - np.repeat(np.cumsum(count) - count, count)) / count[rows]
    full = logged.at(rows)
    note = (
        f"{logged.file} has rows only where a joint changed: where the next is late "
        f"({held.sum()} times), the last one holds until then"
    )
    later_s = part * np.append(steps_s, 0.0)[rows]
    return replace(
        full.with_columns({"time_s": full["time_s"] + later_s}), notes=(*logged.notes, note)
    )
