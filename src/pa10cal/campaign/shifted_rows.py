"""Readings that stand a row away from the joint positions at which they were taken.

The nominal arm is fitted to the readings as joined, and to the same readings with the joints of the
row before and of the row after. A row that is missing, or stands twice, shows as a shift by a row.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arrays import Array, Index, Mask
from pa10cal.campaign.nominal_fit import misfit_of
from pa10cal.errors import RawDataError
from pa10cal.observe.instrument import Instrument

#: A shift must reduce the median misfit of its rows by this factor.
BETTER = 4.0
#: Shifted rows, at least.
FEW = 3
#: Steps of joints and readings from row to row that correlate so well are of the same rows.
AGREE = 0.8
#: No shift is reported where the nominal arm leaves a larger median misfit [m].
FITS_M = 0.03
#: Misfit expected of the nominal arm where readings stand in the right rows [m].
EXPECTED_SHIFTED_M = 5e-3
#: No row is shifted where all misfits are as expected, and this many times larger a row away.
EVIDENT = 10.0

#: Misfit [m] of readings (rows) to the nominal arm at stations, base and target fitted to the first
#: so many of them; None where these do not determine base and target.
Fit = Callable[[Index, Index, int], Array | None]
#: Of the three cases row before, row as joined, row after: the second.
_AS_JOINED = 1


@dataclass(frozen=True)
class Shift:
    """A shift of readings against the joints they were taken at, by one row."""

    first: int  # first shifted reading, from 0
    rows: int  # +1: readings belong to the joints of the row after, -1: of the row before
    as_joined_m: float  # median misfit of the shifted readings as they are joined
    as_shifted_m: float  # and with the joints of that other row


def nominal_fit(seen: Instrument, T_base_ee: Array, usable: Mask | None = None) -> Fit:
    """Return the misfit of readings to the nominal arm, as a function of rows and stations.

    The nominal end at the stations is T_base_ee (K, 4, 4). Readings that are not `usable` (N,) have
    the misfit nan; None for all usable.
    """
    usable = np.ones(len(seen), dtype=bool) if usable is None else usable

    def fit(rows: Index, station: Index, fitted: int) -> Array | None:
        keep = usable[rows]
        readings = seen.take(rows[keep])
        misfit = misfit_of(readings, T_base_ee[station[keep]], int(keep[:fitted].sum()))
        if misfit is None:
            return None
        residual_m = np.full(len(rows), np.nan)
        residual_m[keep] = misfit.size_m
        return residual_m

    return fit


def shifted(station: Index, stations: int, fit: Fit) -> Shift | None:
    """Return the shift that explains readings better than the joints they are joined with, if any.

    Every split of the readings into a part before and a part after is tried, each part with its own
    shift of -1, 0 or +1 rows; the split with the least sum of misfits is taken.

    Args:
        station: (N,) station of each reading as joined, -1 for none.
        stations: number of stations, or of rows of joints.
        fit: see `nominal_fit`.
    """
    rows = np.flatnonzero(station >= 0)
    count = len(rows)
    if count < 4 * FEW:
        return None
    misfits = _misfits(rows, station[rows], stations, fit)
    if misfits is None:
        return None
    typical = float(np.nanmedian(np.nanmin(misfits, axis=0)))
    # A cap makes the cost robust against gross errors.
    cost = np.minimum(np.where(np.isfinite(misfits), misfits, np.inf), 50.0 * max(typical, 1e-5))
    sums = np.concatenate([np.zeros((3, 1)), np.cumsum(cost, axis=1)], axis=1)
    total = sums[:, None, :] + (sums[:, -1:] - sums)[None, :, :]  # case before, case after, split
    before, after, split = map(int, np.unravel_index(int(np.argmin(total)), total.shape))
    # Of a split at an end one part is empty: its case is that of the other part.
    if split == 0:
        before = after
    if split == count:
        after = before
    if before == after == _AS_JOINED:
        return None
    moved = np.where(np.arange(count) < split, before != _AS_JOINED, after != _AS_JOINED)
    shifted_case = before if before != _AS_JOINED else after
    if moved.sum() < FEW or (_AS_JOINED not in (before, after) and before != after):
        return None
    as_joined_m = float(np.nanmedian(misfits[_AS_JOINED][moved]))
    as_shifted_m = float(np.nanmedian(misfits[shifted_case][moved]))
    if as_shifted_m > FITS_M or as_joined_m < BETTER * max(as_shifted_m, typical):
        return None
    first = int(rows[np.flatnonzero(moved)[0]])
    return Shift(first, shifted_case - _AS_JOINED, as_joined_m, as_shifted_m)


def _misfits(rows: Index, station: Index, stations: int, fit: Fit) -> Array | None:
    """Return the misfits (3, N) of readings with the row before, the joined row and the row after.

    Base and target are fitted to all readings, to the first or to the last third, in each of the
    three cases; the fit with the least median misfit is taken. None where none fits.
    """
    count = len(rows)
    third = max(count // 3, 2 * FEW)
    parts = [np.arange(count), np.arange(third), np.arange(count - third, count)]
    best: tuple[float, Array] | None = None
    cases = np.stack([station - 1, station, station + 1])
    exists = (cases >= 0) & (cases < stations)
    for case in (_AS_JOINED, 0, 2):
        for part in parts:
            used = part[exists[case, part]]
            if len(used) < 2 * FEW:
                continue
            # Fitted to this part, then evaluated for all readings in all three cases.
            readings = np.concatenate([rows[used], np.broadcast_to(rows, exists.shape)[exists]])
            at_stations = np.concatenate([cases[case, used], cases[exists]])
            residual_m = fit(readings, at_stations, len(used))
            if residual_m is None:
                continue
            misfits = np.full(exists.shape, np.nan)
            misfits[exists] = residual_m[len(used) :]
            size_m = float(np.median(residual_m[: len(used)]))
            if best is None or size_m < 0.5 * best[0]:
                best = size_m, misfits
            if case == _AS_JOINED and len(part) == count:
                largest_m = np.nanmax(misfits[_AS_JOINED])
                away_m = min(np.nanmedian(misfits[0]), np.nanmedian(misfits[2]))
                if largest_m < EXPECTED_SHIFTED_M and away_m > EVIDENT * largest_m:
                    return misfits  # clearly none is shifted: no further fit is needed
    return None if best is None or best[0] > FITS_M else best[1]


def steps_agree(T_base_ee: Array, p_m: Array) -> bool:
    """Return whether the steps from row to row agree a row away, and not as they stand.

    This needs no fit, so it selects the files for which the fits of `shifted` are worth while.
    The target was measured at p_m (N, 3), nan where not seen.
    """
    arm_m = np.linalg.norm(np.diff(T_base_ee[:, :3, 3], axis=0), axis=1)
    target_m = np.linalg.norm(np.diff(p_m, axis=0), axis=1)
    third = len(target_m) // 3
    for part in (slice(None), slice(third), slice(-third, None)):
        arm_steps, target_steps = arm_m[part], target_m[part]
        as_they_stand = _correlation(arm_steps, target_steps)
        away = np.fmax(
            _correlation(arm_steps[1:], target_steps[:-1]),
            _correlation(arm_steps[:-1], target_steps[1:]),
        )
        if away > max(AGREE, np.nan_to_num(as_they_stand) + 1.0 - AGREE):
            return True
    return False


def _correlation(first: Array, second: Array) -> float:
    """Return the correlation over entries known in both; nan where these are too few."""
    return float(pd.Series(first).corr(pd.Series(second), min_periods=2 * FEW))


def refuse_shifted(
    shift: Shift, path: Path, lines: NDArray[np.int64], joined: str, other_file: str
) -> None:
    """Refuse readings, at `lines` (N,) of a file, that stand a row away from their joints.

    `joined` says how they were joined; `other_file` is that of the joints, empty for the same file.
    """
    line = int(lines[shift.first])
    place = "from the first row on" if shift.first == 0 else f"from line {line} on"
    other, way = ("after", "down") if shift.rows > 0 else ("before", "up")
    value = (
        f"the nominal arm is {1e3 * shift.as_joined_m:.0f} mm off {joined}, and "
        f"{1e3 * shift.as_shifted_m:.2g} mm one row {other}"
    )
    if other_file:
        remedy = (
            "a row is missing or stands twice there: take it out, or put it in, in one of "
            f"{path.name} and {other_file}"
        )
    else:
        remedy = f"move the readings one row {way}, or the joints the other way, in {path.name}"
    raise RawDataError(
        f"{place} the readings fit the joints of the row {other} theirs",
        where=f"{path}:{line}",
        value=value,
        allowed="every reading in the row of its joints",
        remedy=remedy,
    )
