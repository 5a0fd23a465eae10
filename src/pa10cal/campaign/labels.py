"""Targets and their labels: distances between them, and labels that are exchanged."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array, Index, Mask
from pa10cal.errors import CalibrationError
from pa10cal.frame.hand_eye import hand_eye_from_points
from pa10cal.frame.rigid_fit import Located

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
#: Fits towards least distances, and poses fitted.
FITS = 6
FITTED = 300
LEAST_POSES = 12


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
    found = _distances(p_mm)
    stated = _distances(stated_mm[None])[0]
    seen = np.isfinite(found).sum(axis=0)
    pairs = np.argwhere(np.triu(seen > 0, 1))
    if not len(pairs):
        return None
    first, second = pairs.T
    each = found[:, first, second]
    middle = np.nanmedian(each, axis=0)
    scatter = 1.4826 * np.nanmedian(np.abs(each - middle), axis=0)
    off = middle - stated[first, second]
    worst = int(np.abs(off).argmax())
    largest_mm = float(abs(off[worst]))
    # A target that is off shows in all its distances, and in no other.
    of_target = [
        float(np.sqrt(np.mean(off[(first == b) | (second == b)] ** 2))) for b in pairs[worst]
    ]
    u_mm = float(1.25 * scatter[worst] / np.sqrt(seen[first[worst], second[worst]]))
    target = int(pairs[worst][int(np.argmax(of_target))])
    return ShapeOff(target, largest_mm, u_mm, _other_order(middle, stated, pairs))


def _other_order(middle: Array, stated: Array, pairs: Index) -> tuple[int, ...] | None:
    """Return the order of the stated places that agrees with the distances found, if any does."""
    if len(stated) > MOST_TARGETS:
        return None
    first, second = pairs.T
    orders = list(permutations(range(len(stated))))
    off = [np.abs(middle - stated[np.ix_(k, k)][first, second]).max() for k in orders]
    best = int(np.argmin(off))
    return orders[best] if best and off[best] < EXCHANGED_LEFT * off[0] else None


def stated_order(T_base_ee: Array, p_m: Array, stated_mm: Array) -> tuple[int, ...] | None:
    """Return the order of the stated places (B, 3) in which the nominal arm carries the targets.

    None where it is the order stated, or where no order fits much better.

    Args:
        T_base_ee: (P, 4, 4) nominal end-effector [m].
        p_m: (P, B, 3) measured targets, nan where not seen.
        stated_mm: (B, 3) stated.
    """
    if not 2 <= len(stated_mm) <= MOST_TARGETS or len(p_m) < LEAST_POSES:
        return None
    found = placed_by_points(T_base_ee, p_m)
    if found is None:
        return None
    places_mm = 1e3 * found.T_ee_targets[:, :3, 3]
    orders = list(permutations(range(len(stated_mm))))
    off_mm = [np.abs(places_mm - stated_mm[list(order)]).max() for order in orders]
    best = int(np.argmin(off_mm))
    far = off_mm[0] > EXCHANGED_LARGE_MM
    return orders[best] if far and off_mm[best] < EXCHANGED_LEFT * off_mm[0] else None


def not_rigid(p_m: Array) -> Mask:
    """Return (P, B) targets whose distances from the others are not those of the other poses.

    They were measured at (P, B, 3), nan where not seen.
    """
    count, targets = p_m.shape[:2]
    off = np.zeros((count, targets), dtype=bool)
    if targets < 2 or count < LEAST_POSES:
        return off
    each = 1e3 * _distances(p_m)
    with np.errstate(invalid="ignore"):
        away = np.abs(each - _nanmedian(each))
        allowed = np.maximum(RIGID_MM, RIGID_SIGMAS * 1.4826 * _nanmedian(away))
        wrong = away > allowed
    for row in np.flatnonzero(wrong.any(axis=(1, 2))):
        off[row, int(wrong[row].sum(axis=1).argmax())] = True
    return off


def exchanged(p_m: Array, modelled: Array) -> NDArray[np.object_]:
    """Return (P,) the order of the targets that would fit much better; None where labels are right.

    Args:
        p_m: (P, B, 3) measured targets, nan where not seen.
        modelled: (P, B, 3) where the nominal arm puts them, from `nominal_places`.
    """
    count, targets = p_m.shape[:2]
    orders: NDArray[np.object_] = np.full(count, None, dtype=object)
    if not 2 <= targets <= MOST_TARGETS or count < LEAST_POSES:
        return orders
    as_read = misfit_mm(p_m, modelled)
    limit = max(EXCHANGED_MM, EXCHANGED_TYPICAL * float(np.median(as_read)))
    rows = np.flatnonzero(as_read > limit)
    if not len(rows):
        return orders
    tried = [order for order in permutations(range(targets)) if order != tuple(range(targets))]
    left = np.array([misfit_mm(p_m[rows][:, list(order)], modelled[rows]) for order in tried])
    best = left.argmin(axis=0)
    for row, k, mm in zip(rows, best, left.min(axis=0), strict=True):
        if mm < max(EXCHANGED_LEFT * as_read[row], 0.0) and mm < limit:
            orders[row] = tried[k]
    return orders


def exchange_text(order: tuple[int, ...], names: tuple[str, ...]) -> str:
    """Name the labels that an order exchanges."""
    moved = [names[b] for b, other in enumerate(order) if other != b]
    return " and ".join((", ".join(moved[:-1]), moved[-1]))


def nominal_places(T_base_ee: Array, p_m: Array) -> Array | None:
    """Return where the nominal arm, fitted towards least distances, puts the targets (P, B, 3).

    They were measured at p_m (P, B, 3), nan where not seen. None where the poses (P, 4, 4) do not
    determine base and targets.
    """
    if len(p_m) < LEAST_POSES:
        return None
    some = np.sort(np.random.default_rng(0).permutation(len(p_m))[:FITTED])
    weights = np.ones(len(some))
    for _ in range(FITS):
        found = placed_by_points(T_base_ee[some], p_m[some], weights)
        if found is None:
            return None
        modelled: Array = found.targets(T_base_ee)[..., :3, 3]
        weights = 1.0 / np.maximum(misfit_mm(p_m[some], modelled[some]), 1.0)
    return modelled


def placed_by_points(T_base_ee: Array, p_m: Array, weights: Array | None = None) -> Located | None:
    """Return base and targets by the nominal arm; None where the poses do not determine them."""
    try:
        return hand_eye_from_points(T_base_ee, p_m, weights=weights)
    except CalibrationError:
        return None


def misfit_mm(p_m: Array, modelled_m: Array) -> Array:
    """Return the rms distance of measured from modelled targets over those seen, (P,)."""
    squares = np.sum((1e3 * (p_m - modelled_m)) ** 2, axis=2)
    return np.asarray(np.sqrt(np.nanmean(squares, axis=1)))


def _distances(p: Array) -> Array:
    return np.asarray(np.linalg.norm(p[:, :, None] - p[:, None], axis=3))


def _nanmedian(each: Array) -> Array:
    """Return the median over poses; 0 of pairs never seen together."""
    middle = np.zeros(each.shape[1:])
    seen = np.isfinite(each).any(axis=0)
    middle[seen] = np.nanmedian(each[:, seen], axis=0)
    return middle
