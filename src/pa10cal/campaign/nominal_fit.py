"""Readings compared with the nominal arm, base and targets fitted: misfits, and rows out of place.

Fits go towards least distances, so that gross errors hardly count. A row of a file that is missing,
or stands twice, shows as readings that fit the joint positions of the row before or after theirs.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arrays import Array, Index, Mask, drawn
from pa10cal.errors import CalibrationError, RawDataError
from pa10cal.frame.hand_eye import Located, hand_eye_from_points
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.quantities import Misfit

#: Reweighted fits towards least distances, at most: of any instrument, and of points alone.
FITS, FITS_OF_POINTS = 10, 6
#: Rows that are fitted, at most.
FITTED_ROWS = 300
#: Distances below this weigh the same [m].
ALIKE_M = 1e-3
#: Poses that a fit of points needs.
LEAST_POSES = 12
#: Reweighting ends where a fit leaves more than this part of the sum of distances before.
_CONVERGED = 0.999
#: What a controller computes from the joints is nearer to the nominal arm than this, by which the
#: decimals of its joints put it off, and no arm is built so exactly [m]; nor in this part of the
#: spread of the places. It is in the arm's own base, whose axes are those of the description within
#: this angle, or quarter turns of them [rad].
_COMPUTED_M, _COMPUTED_SHARE, _OWN_BASE_RAD = 1e-4, 2e-4, 1e-3


def misfit_of(measured: Instrument, T_base_ee: Array, fitted: int | None = None) -> Misfit | None:
    """Return how far readings are from the nominal end (P, 4, 4), base and target fitted.

    The fit minimises the sum of distances (iteratively reweighted least squares) over the first
    `fitted` readings, None for all. The misfit is None where these do not determine a frame.
    """
    rows = len(T_base_ee) if fitted is None else fitted
    if rows < measured.least_rows:
        return None
    used = drawn(rows, FITTED_ROWS)
    weights, sum_m = np.ones(len(used)), np.inf
    try:
        for _ in range(FITS):
            misfit = measured.misfit(T_base_ee, used, weights)
            off_m = np.maximum(misfit.size_m[used], ALIKE_M)
            before_m, sum_m = sum_m, float(off_m.sum())
            if sum_m > _CONVERGED * before_m:
                break
            weights = 1e-3 / off_m  # in millimetres, so that weights are about one
    except CalibrationError:
        return None
    return misfit


def nominal_places(T_base_ee: Array, p_m: Array) -> Array | None:
    """Return where the nominal arm, fitted for the least sum of distances, puts the targets [m].

    Targets (P, B, 3) were measured at p_m, nan where not seen. None where the poses (P, 4, 4) do
    not determine base and targets.
    """
    located = None if len(p_m) < LEAST_POSES else placed_at_least_distances(T_base_ee, p_m)
    return None if located is None else located.targets(T_base_ee)[..., :3, 3]


def placed_at_least_distances(T_base_ee: Array, p_m: Array) -> Located | None:
    """Return base and targets fitted to positions (P, B, 3) [m] for the least sum of distances.

    None where the poses (P, 4, 4) do not determine them.
    """
    used = drawn(len(p_m), FITTED_ROWS)
    weights, sum_mm = np.ones(len(used)), np.inf
    for _ in range(FITS_OF_POINTS):
        located = placed_by_points(T_base_ee[used], p_m[used], weights, roughly=True)
        if located is None:
            return None
        modelled_m = located.targets(T_base_ee[used])[..., :3, 3]
        off_mm = np.maximum(misfit_mm(p_m[used], modelled_m), 1.0)
        before_mm, sum_mm = sum_mm, float(off_mm.sum())
        if sum_mm > _CONVERGED * before_mm:
            break
        weights = 1.0 / off_mm
    return located


def placed_by_points(
    T_base_ee: Array, p_m: Array, weights: Array | None = None, *, roughly: bool = False
) -> Located | None:
    """Return base and targets fitted to positions; None where the poses do not determine them."""
    try:
        return hand_eye_from_points(T_base_ee, p_m, weights=weights, roughly=roughly)
    except CalibrationError:
        return None


def off_computed_m(T_base_ee: Array, p_m: Array) -> float | None:
    """Return by how much places (P, 3) differ from those of the nominal arm in its own base [m].

    None where they differ by more than what a controller computes from its joints, where their base
    is another one, as of any instrument, or where the poses (P, 4, 4) are too few.
    """
    known = np.isfinite(p_m).all(axis=1) & np.isfinite(T_base_ee).all(axis=(1, 2))
    used = np.flatnonzero(known)[drawn(int(known.sum()), FITTED_ROWS)]
    if len(used) < LEAST_POSES:
        return None
    located = placed_by_points(T_base_ee[used], p_m[used, None])
    spread_m = float(np.sqrt(np.var(p_m[used], axis=0).sum()))
    if located is None or located.scatter_m > min(_COMPUTED_M, _COMPUTED_SHARE * spread_m):
        return None
    R = located.T_instr_base[:3, :3]
    return located.scatter_m if np.abs(R - np.round(R)).max() < _OWN_BASE_RAD else None


def misfit_mm(p_m: Array, modelled_m: Array) -> Array:
    """Return the rms distance (P,) of measured from modelled targets, over those seen."""
    squares = np.sum((1e3 * (p_m - modelled_m)) ** 2, axis=2)
    return np.asarray(np.sqrt(np.nanmean(squares, axis=1)))


# Readings that stand a row away from the joint positions at which they were taken.

#: A shift must reduce the median misfit of its rows by this factor; rows that it moves, at least.
_SHIFT_BETTER, _LEAST_SHIFTED = 4.0, 3
#: Steps of joints and readings from row to row that correlate so well are of the same rows.
_STEPS_AGREE = 0.8
#: No shift is reported where the nominal arm leaves a larger median misfit [m].
_LARGEST_MISFIT_M = 0.03
#: Misfit expected of the nominal arm where readings stand in the right rows [m].
RIGHT_ROWS_M = 5e-3
#: No row is shifted where all misfits are as expected, and this many times larger a row away.
_EVIDENT = 10.0
#: A gross error counts as so many typical misfits in the choice of a split, and those are at least
#: so large [m].
_MOST_TYPICAL, _LEAST_TYPICAL_M = 50.0, 1e-5
#: Sums of distances that differ by this part are the same (computing).
_ROUNDING = 1e-9
#: The three cases of a reading: with the joints of the row before, of its own, of the row after.
_BEFORE, _AS_JOINED, _AFTER = range(3)


@dataclass(frozen=True)
class ReadingsAtStations:
    """N readings, and the nominal end at K stations, or rows of joints, where they were taken."""

    seen: Instrument  # the readings
    T_base_ee: Array  # (K, 4, 4) nominal end at the stations
    usable: Mask  # (N,) readings that are complete and in bounds

    def misfit_m(self, rows: Index, station: Index, fitted: int) -> Array | None:
        """Return the misfit (R,) of readings `rows` to the nominal arm at the stations (R,).

        Base and target are fitted to the first `fitted` of them; None where these do not determine
        them. Readings that are not usable have the misfit nan.
        """
        keep = self.usable[rows]
        readings = self.seen.take(rows[keep])
        misfit = misfit_of(readings, self.T_base_ee[station[keep]], int(keep[:fitted].sum()))
        if misfit is None:
            return None
        misfit_m = np.full(len(rows), np.nan)
        misfit_m[keep] = misfit.size_m
        return misfit_m


@dataclass(frozen=True)
class Shift:
    """A shift of readings against the joints they were taken at, by one row."""

    first: int  # first shifted reading, from 0
    rows: int  # +1: readings belong to the joints of the row after, -1: of the row before
    as_joined_m: float  # median misfit of the shifted readings as they are joined
    as_shifted_m: float  # and with the joints of that other row


def find_shift(readings: ReadingsAtStations, station: Index) -> Shift | None:
    """Return the shift that explains readings better than the joints they are joined with, if any.

    `station` (N,) is that of each reading as joined, -1 for none.
    """
    rows = np.flatnonzero((station >= 0) & readings.usable)
    count = len(rows)
    misfits_m = None if count < 4 * _LEAST_SHIFTED else _misfits(readings, rows, station[rows])
    if misfits_m is None:
        return None
    typical_m = float(np.nanmedian(np.nanmin(misfits_m, axis=0)))
    before, after, split = _best_split(misfits_m, _MOST_TYPICAL * max(typical_m, _LEAST_TYPICAL_M))
    shifted_case = before if before != _AS_JOINED else after
    opposite = _AS_JOINED not in (before, after) and before != after
    moved = np.where(np.arange(count) < split, before != _AS_JOINED, after != _AS_JOINED)
    if moved.sum() < _LEAST_SHIFTED or opposite:
        return None
    as_joined_m = float(np.nanmedian(misfits_m[_AS_JOINED][moved]))
    as_shifted_m = float(np.nanmedian(misfits_m[shifted_case][moved]))
    not_better = as_joined_m < _SHIFT_BETTER * max(as_shifted_m, typical_m)
    if as_shifted_m > _LARGEST_MISFIT_M or not_better:
        return None
    first = int(rows[np.flatnonzero(moved)[0]])
    return Shift(first, shifted_case - _AS_JOINED, as_joined_m, as_shifted_m)


def _best_split(misfits_m: Array, cap_m: float) -> tuple[int, int, int]:
    """Return the split of readings into two parts, each in one case, with the least sum of misfits.

    Args:
        misfits_m: (3, N) misfits in the three cases, nan where there is no such row.
        cap_m: what larger or missing misfits count as.

    Returns:
        The case of the part before, that of the part after, and the first reading of the latter.
    """
    cost_m = np.minimum(np.where(np.isfinite(misfits_m), misfits_m, np.inf), cap_m)
    sums_m = np.concatenate([np.zeros((3, 1)), np.cumsum(cost_m, axis=1)], axis=1)
    total_m = sums_m[:, None, :] + (sums_m[:, -1:] - sums_m)[None, :, :]
    # A last reading without any right row costs the same in each case: all are in one case then.
    one_case, least_m = int(np.argmin(sums_m[:, -1])), float(total_m.min())
    if sums_m[one_case, -1] <= least_m * (1.0 + _ROUNDING):
        return one_case, one_case, misfits_m.shape[1]
    before, after, split = map(int, np.unravel_index(int(np.argmin(total_m)), total_m.shape))
    # Of a split at an end one part is empty: its case is that of the other part.
    if split == 0:
        before = after
    if split == misfits_m.shape[1]:
        after = before
    return before, after, split


def _misfits(readings: ReadingsAtStations, rows: Index, station: Index) -> Array | None:
    """Return the misfits (3, N) of readings in the three cases; nan where there is no such row.

    Base and target are fitted to all readings, to the first or to the last third, in each of the
    three cases; the fit with the least median misfit is taken. None where none fits.
    """
    count = len(rows)
    third = max(count // 3, 2 * _LEAST_SHIFTED)
    parts = [np.arange(count), np.arange(third), np.arange(count - third, count)]
    best: tuple[float, Array] | None = None
    cases = np.stack([station - 1, station, station + 1])
    exists = (cases >= 0) & (cases < len(readings.T_base_ee))
    for case in (_AS_JOINED, _BEFORE, _AFTER):
        for part in parts:
            used = part[exists[case, part]]
            if len(used) < 2 * _LEAST_SHIFTED:
                continue
            # Fitted to this part, then evaluated for all readings in all three cases.
            tried = np.concatenate([rows[used], np.broadcast_to(rows, exists.shape)[exists]])
            at_stations = np.concatenate([cases[case, used], cases[exists]])
            residual_m = readings.misfit_m(tried, at_stations, len(used))
            if residual_m is None:
                continue
            misfits_m = np.full(exists.shape, np.nan)
            misfits_m[exists] = residual_m[len(used) :]
            size_m = float(np.nanmedian(residual_m[: len(used)]))
            if best is None or size_m < 0.5 * best[0]:
                best = size_m, misfits_m
            if case == _AS_JOINED and len(part) == count:
                largest_m = np.nanmax(misfits_m[_AS_JOINED])
                away_m = min(np.nanmedian(misfits_m[_BEFORE]), np.nanmedian(misfits_m[_AFTER]))
                if largest_m < RIGHT_ROWS_M and away_m > _EVIDENT * largest_m:
                    return misfits_m  # clearly none is shifted: no further fit is needed
    return None if best is None or best[0] > _LARGEST_MISFIT_M else best[1]


def steps_agree(T_base_ee: Array, p_m: Array) -> bool:
    """Return whether the steps from row to row agree a row away, and not as they stand.

    This needs no fit, so it selects the files for which the fits of `find_shift` are worth while.
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
        if away > max(_STEPS_AGREE, np.nan_to_num(as_they_stand) + 1.0 - _STEPS_AGREE):
            return True
    return False


def _correlation(first: Array, second: Array) -> float:
    """Return the correlation over entries known in both; nan where these are too few."""
    return float(pd.Series(first).corr(pd.Series(second), min_periods=2 * _LEAST_SHIFTED))


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
