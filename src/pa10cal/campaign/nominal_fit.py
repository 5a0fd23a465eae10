"""Readings beside the nominal arm: how far off they are, in their rows and under their labels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arrays import MEDIAN_TO_SIGMA, Array, Index, Mask, drawn
from pa10cal.errors import CalibrationError, RawDataError
from pa10cal.frame.hand_eye import hand_eye_from_points
from pa10cal.frame.rigid_fit import Located
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.quantities import Misfit

#: Reweighted fits towards least distances, rows fitted, and the distance below which all weigh
#: the same; fits to points alone, and poses that they take.
FITS, FITS_OF_POINTS = 10, 6
FITTED_ROWS = 300
ALIKE_M = 1e-3
LEAST_POSES = 12
#: Reweighted fits end where the sum of distances stays over this part of that before.
_STILL = 0.999


def misfit_of(measured: Instrument, T_base_ee: Array, fitted: int | None = None) -> Misfit | None:
    """Return how far readings are from the nominal end (P, 4, 4), however placed.

    Base and target are fitted towards least distances, not least squares, to the first so many of
    them; None for all. The misfit is None where these do not determine a frame.
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
            if sum_m > _STILL * before_m:
                break
            weights = 1e-3 / off_m  # in millimetres, so that weights are about one
    except CalibrationError:
        return None
    return misfit


def nominal_places(T_base_ee: Array, p_m: Array) -> Array | None:
    """Return where the nominal arm, fitted towards least distances, puts the targets (P, B, 3).

    They were measured at p_m (P, B, 3), nan where not seen. None where the poses (P, 4, 4) do not
    determine base and targets.
    """
    if len(p_m) < LEAST_POSES:
        return None
    some = drawn(len(p_m), FITTED_ROWS)
    weights = np.ones(len(some))
    for _ in range(FITS_OF_POINTS):
        located = placed_by_points(T_base_ee[some], p_m[some], weights)
        if located is None:
            return None
        modelled: Array = located.targets(T_base_ee)[..., :3, 3]
        weights = 1.0 / np.maximum(misfit_mm(p_m[some], modelled[some]), 1.0)
    return modelled


def placed_by_points(
    T_base_ee: Array, p_m: Array, weights: Array | None = None, *, roughly: bool = False
) -> Located | None:
    """Return base and targets by the nominal arm; None where the poses do not determine them."""
    try:
        return hand_eye_from_points(T_base_ee, p_m, weights=weights, roughly=roughly)
    except CalibrationError:
        return None


def misfit_mm(p_m: Array, modelled_m: Array) -> Array:
    """Return the rms distance of measured from modelled targets over those seen, (P,)."""
    squares = np.sum((1e3 * (p_m - modelled_m)) ** 2, axis=2)
    return np.asarray(np.sqrt(np.nanmean(squares, axis=1)))


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
EXPECTED_SHIFTED_M = 5e-3
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


def nominal_fit(seen: Instrument, T_base_ee: Array, usable: NDArray[np.bool_] | None = None) -> Fit:
    """Return how far readings are from the nominal arm at stations, base and target fitted.

    The arm stands at (K, 4, 4) there; only usable readings (N,) are looked at, None for all.
    """
    usable = np.ones(len(seen), dtype=bool) if usable is None else usable

    def fit(rows: Index, station: Index, fitted: int) -> Array | None:
        keep = usable[rows]
        here = seen.take(rows[keep])
        misfit = misfit_of(here, T_base_ee[station[keep]], int(keep[:fitted].sum()))
        if misfit is None:
            return None
        residual_m = np.full(len(rows), np.nan)
        residual_m[keep] = misfit.size_m
        return residual_m

    return fit


def shifted(station: Index, stations: int, fit: Fit) -> Shift | None:
    """Return whether readings fit the joints a row away, and from which reading on.

    The joints have so many rows, or stations; `station` (N,) is that of each reading as joined, -1
    for none.
    """
    rows = np.flatnonzero(station >= 0)
    count = len(rows)
    if count < 4 * FEW:
        return None
    misfits = _misfits(rows, station[rows], stations, fit)
    if misfits is None:
        return None
    typical = float(np.nanmedian(np.nanmin(misfits, axis=0)))
    # Beyond some size it does not matter how far a row is off.
    cost = np.minimum(np.where(np.isfinite(misfits), misfits, np.inf), 50.0 * max(typical, 1e-5))
    sums = np.concatenate([np.zeros((3, 1)), np.cumsum(cost, axis=1)], axis=1)
    before, after = sums, sums[:, -1:] - sums
    total = before[:, None, :] + after[None, :, :]  # shift before, shift after, reading
    one, two, first = map(int, np.unravel_index(int(np.argmin(total)), total.shape))
    one, two = (two if first == 0 else one), (one if first == count else two)
    if (one, two) == (1, 1):
        return None
    moved = np.where(np.arange(count) < first, one != 1, two != 1)
    shift = (one if one != 1 else two) - 1
    if moved.sum() < FEW or (one != 1 and two != 1 and one != two):
        return None
    as_joined, as_shifted = (float(np.nanmedian(misfits[row][moved])) for row in (1, shift + 1))
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
            of = np.concatenate([rows[used], np.broadcast_to(rows, there.shape)[there]])
            at = np.concatenate([shifts[shift, used], shifts[there]])
            residual_m = fit(of, at, len(used))
            if residual_m is None:
                continue
            misfits = np.full(there.shape, np.nan)
            misfits[there] = residual_m[len(used) :]
            size = float(np.median(residual_m[: len(used)]))
            if best is None or size < 0.5 * best[0]:
                best = size, misfits
            if shift == 1 and len(part) == count:
                before, here, after = misfits
                away = min(np.nanmedian(before), np.nanmedian(after))
                # No doubt then that no reading is shifted.
                if np.nanmax(here) < EXPECTED_SHIFTED_M and away > EVIDENT * np.nanmax(here):
                    return misfits
    return None if best is None or best[0] > FITS_M else best[1]


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
        away = np.fmax(_correlation(one[1:], two[:-1]), _correlation(one[:-1], two[1:]))
        if away > max(AGREE, np.nan_to_num(as_they_stand) + 1.0 - AGREE):
            return True
    return False


def _correlation(one: Array, two: Array) -> float:
    """Return the correlation of what is known of both; nan where it is too little."""
    return float(pd.Series(one).corr(pd.Series(two), min_periods=2 * FEW))


def refuse_shifted(
    shift: Shift, path: Path, lines: NDArray[np.int64], joined: str, other_file: str
) -> None:
    """Stop where readings, at lines (N,) of a file, stand a row away from their joints.

    They were joined as `joined` says, with joints of another file, or of the same where it is
    empty.
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


# Targets under each other's labels, and distances between them.

EXCHANGED = "the labels of these targets are exchanged"
NOT_RIGID = "its distances from the other targets are not those of the other poses"

#: Targets whose orders are all tried.
MOST_TARGETS = 5
#: Labels are exchanged where another order leaves so much less of a misfit that is so large.
EXCHANGED_LEFT = 0.25
EXCHANGED_MM = 5.0
EXCHANGED_TYPICAL = 6.0
#: Places of targets on the arm are exchanged where the stated ones are off by so much.
EXCHANGED_LARGE_MM = 20.0
#: Distances between targets of one pose may differ from their median by so much.
RIGID_MM = 1.0
RIGID_SIGMAS = 10.0


@dataclass(frozen=True)
class ShapeOff:
    """How far the targets are from their stated places among each other."""

    target: int  # the one that explains it best
    largest_mm: float  # largest difference of a distance
    u_mm: float  # standard uncertainty of that difference
    # the order of the stated places that would agree; None where none does
    order: tuple[int, ...] | None


def stated_shape(p_mm: Array, stated_mm: Array) -> ShapeOff | None:
    """Compare distances between measured targets (P, B, 3) with those of stated places (B, 3).

    What was not seen is nan. None with fewer than two targets seen together.
    """
    measured, stated = _distances(p_mm), _distances(stated_mm[None])[0]
    seen = np.isfinite(measured).sum(axis=0)
    pairs = np.argwhere(np.triu(seen > 0, 1))
    if not len(pairs):
        return None
    first, second = pairs.T
    of_pairs = measured[:, first, second]
    middle = np.nanmedian(of_pairs, axis=0)
    scatter = MEDIAN_TO_SIGMA * np.nanmedian(np.abs(of_pairs - middle), axis=0)
    off = middle - stated[first, second]
    worst = int(np.abs(off).argmax())
    # A target that is off shows in all its distances, and in no other.
    of_target = [np.mean(off[(first == b) | (second == b)] ** 2) for b in pairs[worst]]
    target = int(pairs[worst][int(np.argmax(of_target))])
    u_mm = float(1.25 * scatter[worst] / np.sqrt(seen[first[worst], second[worst]]))
    order = _other_order(
        len(stated), lambda k: np.abs(middle - stated[np.ix_(k, k)][first, second]).max()
    )
    return ShapeOff(target, float(abs(off[worst])), u_mm, order)


def stated_order(T_base_ee: Array, p_m: Array, stated_mm: Array) -> tuple[int, ...] | None:
    """Return the order of the stated places (B, 3) in which the nominal arm carries the targets.

    They were measured at p_m (P, B, 3), nan where not seen. None where it is the order stated, or
    where no order fits much better.
    """
    located = placed_by_points(T_base_ee, p_m) if len(p_m) >= LEAST_POSES else None
    if located is None or len(stated_mm) < 2:
        return None
    places_mm = 1e3 * located.T_ee_targets[:, :3, 3]
    far = EXCHANGED_LARGE_MM
    return _other_order(len(stated_mm), lambda k: np.abs(places_mm - stated_mm[k]).max(), far)


def _other_order(
    count: int, off_of: Callable[[list[int]], float], least: float = 0.0
) -> tuple[int, ...] | None:
    """Return the order of so many places that is off by much less than the stated one, if any."""
    if count > MOST_TARGETS:
        return None
    orders = list(permutations(range(count)))
    off = [off_of(list(order)) for order in orders]
    best = int(np.argmin(off))
    much = off[0] > least and off[best] < EXCHANGED_LEFT * off[0]
    return orders[best] if best and much else None


def not_rigid(p_m: Array) -> Mask:
    """Return (P, B) targets whose distances from the others are not those of the other poses.

    They were measured at (P, B, 3), nan where not seen.
    """
    off = np.zeros(p_m.shape[:2], dtype=bool)
    if p_m.shape[1] < 2 or len(p_m) < LEAST_POSES:
        return off
    distances_mm = 1e3 * _distances(p_m)

    def middle(values: Array) -> Array:
        seen = np.isfinite(values).any(axis=0)  # 0 of pairs never seen together
        return np.nanmedian(np.where(seen, values, 0.0), axis=0)

    away = np.abs(distances_mm - middle(distances_mm))
    wrong = away > np.maximum(RIGID_MM, RIGID_SIGMAS * MEDIAN_TO_SIGMA * middle(away))
    for row in np.flatnonzero(wrong.any(axis=(1, 2))):
        off[row, int(wrong[row].sum(axis=1).argmax())] = True
    return off


def exchanged(p_m: Array, modelled: Array) -> NDArray[np.object_]:
    """Return (P,) the order of the targets that would fit much better; None where labels are right.

    They were measured at p_m (P, B, 3), nan where not seen; `nominal_places` modelled them.
    """
    count, targets = p_m.shape[:2]
    orders: NDArray[np.object_] = np.full(count, None, dtype=object)
    if not 2 <= targets <= MOST_TARGETS or count < LEAST_POSES:
        return orders
    as_read = misfit_mm(p_m, modelled)
    limit = max(EXCHANGED_MM, EXCHANGED_TYPICAL * float(np.median(as_read)))
    rows = np.flatnonzero(as_read > limit)
    tried = list(permutations(range(targets)))[1:]
    left = np.array([misfit_mm(p_m[rows][:, list(order)], modelled[rows]) for order in tried])
    best = left.argmin(axis=0)
    for row, k, mm in zip(rows, best, left.min(axis=0), strict=True):
        if mm < min(EXCHANGED_LEFT * as_read[row], limit):
            orders[row] = tried[k]
    return orders


def exchange_text(order: tuple[int, ...], names: tuple[str, ...]) -> str:
    """Name the labels that an order exchanges."""
    moved = [names[b] for b, other in enumerate(order) if other != b]
    return " and ".join((", ".join(moved[:-1]), moved[-1]))


def _distances(p: Array) -> Array:
    return np.asarray(np.linalg.norm(p[:, :, None] - p[:, None], axis=3))
