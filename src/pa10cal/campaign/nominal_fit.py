"""Readings beside the nominal arm: how far off they are, and whether they stand a row away."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array, Index
from pa10cal.errors import CalibrationError, RawDataError
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.quantities import Misfit

#: Reweighted fits towards least distances, rows fitted, and the distance below which all weigh
#: the same.
FITS = 10
FITTED_ROWS = 300
ALIKE_M = 1e-3


def misfit_of(measured: Instrument, T_base_ee: Array, fitted: int | None = None) -> Misfit | None:
    """Return how far readings are from the nominal end (P, 4, 4), however placed.

    Base and target are fitted towards least distances, not least squares, to the first so many of
    them; None for all. The misfit is None where these do not determine a frame.
    """
    rows = len(T_base_ee) if fitted is None else fitted
    if rows < measured.least_rows:
        return None
    used = np.sort(np.random.default_rng(0).permutation(rows)[:FITTED_ROWS])
    weights = np.ones(len(used))
    try:
        for _ in range(FITS):
            misfit = measured.misfit(T_base_ee, used, weights)
            # In millimetres, so that weights are about one.
            before, weights = weights, 1e-3 / np.maximum(misfit.size_m[used], ALIKE_M)
            if np.array_equal(weights, before):
                break  # the next fit would be this one
    except CalibrationError:
        return None
    return misfit


# Readings that stand a row away from the joints they were taken at.

#: Joints fit the nominal arm so many times better when shifted by a row, or it is not said.
BETTER = 4.0
#: Rows that are shifted, at the least.
FEW = 3
#: Steps from row to row that correlate so well are of the same rows.
AGREE = 0.8
#: Where the nominal arm, however placed, is further off in the median, nothing is said [m].
FITS_M = 0.03

#: So near is the nominal arm expected to be to readings that stand in their rows [m].
EXPECTED_M = 5e-3
#: Where it is so near to all of them, and so many times further off a row away, none is shifted.
EVIDENT = 10.0

#: What the nominal arm leaves of readings (rows, at stations), base and target fitted to the first
#: so many of them [m]; None where they do not determine it.
Fit = Callable[[Index, Index, int], Array | None]


@dataclass(frozen=True)
class Shift:
    """Readings that are a row away from the joints they were taken at."""

    first: int  # reading from which on it is so, from 0
    rows: int  # +1: they belong to the joints of the row after, -1: of the row before
    as_joined_m: float  # median misfit of these rows as they are
    as_shifted_m: float  # and shifted


def shifted(station: Index, stations: int, fit: Fit) -> Shift | None:
    """Return whether readings fit the joints a row away, and from which reading on.

    Args:
        station: (N,) row of the joints of each reading, as joined; -1 for none.
        stations: how many rows the joints have.
        fit: the nominal arm fitted to readings at rows of the joints.
    """
    rows = np.flatnonzero(station >= 0)
    count = len(rows)
    if count < 4 * FEW:
        return None
    left = _misfits(rows, station[rows], stations, fit)
    if left is None:
        return None
    typical = float(np.nanmedian(np.nanmin(left, axis=0)))
    # Beyond some size it does not matter how far a row is off.
    cost = np.minimum(np.where(np.isfinite(left), left, np.inf), 50.0 * max(typical, 1e-5))
    sums = np.concatenate([np.zeros((3, 1)), np.cumsum(cost, axis=1)], axis=1)
    before, after = sums, sums[:, -1:] - sums
    total = before[:, None, :] + after[None, :, :]  # shift before, shift after, reading
    one, two, first = map(int, np.unravel_index(int(np.argmin(total)), total.shape))
    one, two = (two if first == 0 else one), (one if first == count else two)
    if (one, two) == (1, 1):
        return None
    moved = np.zeros(count, dtype=bool)
    if one != 1:
        moved[:first] = True
    if two != 1:
        moved[first:] = True
    shift = (one if one != 1 else two) - 1
    if moved.sum() < FEW or (one != 1 and two != 1 and one != two):
        return None
    as_joined, as_shifted = (
        float(np.median(left[each][moved & np.isfinite(left[each])])) for each in (1, shift + 1)
    )
    if as_shifted > FITS_M or as_joined < BETTER * max(as_shifted, typical):
        return None
    return Shift(int(rows[np.flatnonzero(moved)[0]]), int(shift), as_joined, as_shifted)


def _misfits(rows: Index, station: Index, stations: int, fit: Fit) -> Array | None:
    """Return the misfit (3, N) of readings at the row before, at the joined one and at the next.

    Base and target are those of the part of the readings, as joined or shifted, that fits best.
    """
    count = len(rows)
    third = max(count // 3, 2 * FEW)
    parts = [np.arange(count), np.arange(third), np.arange(count - third, count)]
    best: tuple[float, Array] | None = None
    shifts = np.stack([station - 1, station, station + 1])
    there = (shifts >= 0) & (shifts < stations)
    for shift in (1, 0, 2):
        for part in parts:
            used = part[there[shift, part]]
            if len(used) < 2 * FEW:
                continue
            # Fitted to this part, judged at all three.
            known = [(k, np.flatnonzero(there[k])) for k in range(3)]
            at = np.concatenate([shifts[shift, used], *(shifts[k, each] for k, each in known)])
            of = np.concatenate([rows[used], *(rows[each] for _, each in known)])
            left_m = fit(of, at, len(used))
            if left_m is None:
                continue
            left, start = np.full((3, count), np.nan), len(used)
            for k, each in known:
                left[k, each] = left_m[start : start + len(each)]
                start += len(each)
            size = float(np.median(left_m[: len(used)]))
            if best is None or size < 0.5 * best[0]:
                best = size, left
            if shift == 1 and len(part) == count and _as_they_stand(left):
                return left
    return None if best is None or best[0] > FITS_M else best[1]


def _as_they_stand(left: Array) -> bool:
    """Return whether misfits (3, N) leave no doubt that no reading is shifted."""
    before, here, after = left
    away = min(np.nanmedian(before), np.nanmedian(after))
    return bool(np.nanmax(here) < EXPECTED_M and away > EVIDENT * np.nanmax(here))


def steps_agree(T_base_ee: Array, p_m: Array) -> bool:
    """Return whether the steps from row to row agree a row away, and not as they stand.

    It takes no fit, so it says where the fits of `shifted` are worth while. A target was measured
    at p_m (N, 3), nan where it was not.
    """
    moved_m = np.linalg.norm(np.diff(T_base_ee[:, :3, 3], axis=0), axis=1)
    seen_m = np.linalg.norm(np.diff(p_m, axis=0), axis=1)
    third = len(seen_m) // 3
    for part in (slice(None), slice(third), slice(-third, None)):
        one, two = moved_m[part], seen_m[part]
        as_they_stand = _correlation(one, two)
        away = max(_correlation(one[1:], two[:-1]), _correlation(one[:-1], two[1:]))
        if away > AGREE and away > as_they_stand + 1.0 - AGREE:
            return True
    return False


def _correlation(one: Array, two: Array) -> float:
    known = np.isfinite(one) & np.isfinite(two)
    if known.sum() < 2 * FEW or not np.ptp(one[known]) or not np.ptp(two[known]):
        return 0.0
    return float(np.corrcoef(one[known], two[known])[0, 1])


def nominal_fit(seen: Instrument, T_base_ee: Array, usable: NDArray[np.bool_] | None = None) -> Fit:
    """Return how far readings are from the nominal arm at stations, base and target fitted.

    The arm stands at (K, 4, 4) there; only usable readings (N,) are looked at, None for all.
    """
    usable = np.ones(len(seen), dtype=bool) if usable is None else usable

    def fit(rows: Index, station: Index, fitted: int) -> Array | None:
        keep = usable[rows]
        here = seen.take(rows[keep])
        found = misfit_of(here, T_base_ee[station[keep]], int(keep[:fitted].sum()))
        if found is None:
            return None
        left_m = np.full(len(rows), np.nan)
        left_m[keep] = found.size_m
        return left_m

    return fit


def refuse_shifted(
    shift: Shift, path: Path, lines: NDArray[np.int64], joined: str, other_file: str
) -> None:
    """Stop where readings stand a row away from their joints.

    Args:
        shift: from which reading on, and which way.
        path: the file of the readings.
        lines: (N,) line of each reading.
        joined: how they were joined, in words.
        other_file: name of the file of the joints; empty where it is the same.
    """
    line = int(lines[shift.first])
    place = "from the first row on" if shift.first == 0 else f"from line {line} on"
    other, way = ("after", "down") if shift.rows > 0 else ("before", "up")
    raise RawDataError(
        f"{place} the readings fit the joints of the row {other} theirs",
        where=f"{path}:{line}",
        value=f"the nominal arm is {1e3 * shift.as_joined_m:.0f} mm off {joined}, and "
        f"{1e3 * shift.as_shifted_m:.2g} mm one row {other}",
        allowed="every reading in the row of its joints",
        remedy="a row is missing or stands twice there: take it out, or put it in, in one of "
        f"{path.name} and {other_file}"
        if other_file
        else f"move the readings one row {way}, or the joints the other way, in {path.name}",
    )
