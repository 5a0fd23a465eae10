"""Fixed targets that were read wrongly, or moved against each other: which, when, by how much.

Whatever the instrument did, the shape that the targets make stays as it is. What of the readings no
rigid motion makes is therefore noise: a single reading far out of it is wrong, and a step in it
shows that a target was knocked. Neither counts where it is smaller than the stated uncertainty:
what is within that is expected of good readings.

Throughout, p_m are readings (P, K, 3) of K targets in order of time, nan where one was not seen,
and u_m their stated standard uncertainties.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter
from scipy.special import chdtri

from pa10cal.arrays import MEDIAN_TO_SIGMA, Array, Index, Mask
from pa10cal.frame.rigid_fit import by_small_motion
from pa10cal.rules import KNOCKS

#: Directions that rigid motions move less than this part are left to noise; and a size that is
#: none (computing).
_RANK, _TINY = 1e-6, 1e-300


@dataclass(frozen=True)
class Knock:
    """Targets of which one moved against the others."""

    # numbers of those that explain the step equally well, from 0; one as a rule
    targets: tuple[int, ...]
    row: int  # the first reading after the step
    shift_m: float  # how far it moved, in the directions that show


def wrong_by_themselves(p_m: Array, u_m: Array) -> Mask:
    """Return readings (P, K) far from those of the same target around them, where others are not.

    Targets that are far off together, in the shape that they always make, were moved together.
    """
    off_m = np.full(p_m.shape, np.nan)
    for k in range(p_m.shape[1]):
        seen = np.isfinite(p_m[:, k, 0])
        around = median_filter(p_m[seen, k], size=(KNOCKS.around, 1), mode="nearest")
        off_m[seen, k] = p_m[seen, k] - around
    usual = MEDIAN_TO_SIGMA * np.nanmedian(np.abs(off_m), axis=0)
    size = np.linalg.norm(off_m / np.maximum(usual, np.nan_to_num(u_m)), axis=2)
    far: Mask = np.asarray(size > KNOCKS.far_off * np.sqrt(3.0))
    together = np.flatnonzero(far.sum(axis=1) > 1)
    square, count = misfits(p_m[together], u_m[together], np.nanmedian(p_m, axis=0))
    far[together[square < KNOCKS.far_off**2 * count]] = False
    return far


def wrong_in_shape(p_m: Array, u_m: Array) -> Mask:
    """Return readings (P, K) that make the targets' shape another one.

    Of three targets or more the one without which the shape is right, if there is no other such;
    else all of a configuration.
    """
    wrong = np.zeros(p_m.shape[:2], dtype=bool)
    places_m = np.nanmedian(p_m, axis=0)
    square, count = misfits(p_m, u_m, places_m)
    shown = count > 0
    if not shown.any():
        return wrong
    usual = float(np.median(square[shown] / chdtri(count[shown], 0.5)))
    variance = max(usual, 1.0)
    off = np.zeros(len(p_m), dtype=bool)
    off[shown] = square[shown] > variance * chdtri(count[shown], KNOCKS.error_rate / shown.sum())
    for row in np.flatnonzero(off):
        wrong[row] = np.isfinite(p_m[row, :, 0])
        if (alone := _the_wrong_one(p_m[row], u_m[row], places_m, variance)) is not None:
            wrong[row] = np.arange(len(places_m)) == alone
    return wrong


def _the_wrong_one(p_m: Array, u_m: Array, places_m: Array, variance: float) -> int | None:
    """Return the one target without which a configuration's shape is right; None if several are."""
    seen = np.flatnonzero(np.isfinite(p_m[:, 0]))
    if len(seen) < 3:
        return None
    without = np.repeat(p_m[None], len(seen), axis=0)
    without[range(len(seen)), seen] = np.nan
    square, count = misfits(without, np.broadcast_to(u_m, without.shape), places_m)
    best, second = np.argsort(square)[:2]
    right = square[best] <= variance * chdtri(max(int(count[best]), 1), KNOCKS.error_rate)
    if not right or (square[second] - square[best]) / 2.0 < KNOCKS.as_well_nats * variance:
        return None
    return int(seen[best])


def misfits(p_m: Array, u_m: Array, places_m: Array) -> tuple[Array, Index]:
    """Return what no rigid motion makes of the readings (R, K, 3) of each configuration.

    Returns:
        (R,) sums of its squares in stated standard deviations, and of how many components.
    """
    seen = np.isfinite(p_m[..., 0])
    square, count = np.zeros(len(p_m)), np.zeros(len(p_m), dtype=np.intp)
    patterns, of = np.unique(seen, axis=0, return_inverse=True)
    for number, pattern in enumerate(patterns):
        if pattern.sum() < 2:
            continue
        rows = np.flatnonzero(of.ravel() == number)
        middle_m = places_m[pattern].mean(axis=0)
        modes = by_small_motion(places_m[pattern] - middle_m).reshape(-1, 6)
        rank = np.linalg.matrix_rank(modes, tol=_RANK * np.linalg.norm(modes, 2))
        over = u_m[rows][:, pattern].reshape(len(rows), -1)
        left = np.linalg.svd(modes / over[..., None], full_matrices=False)[0][..., :rank]
        off = (p_m[rows][:, pattern] - places_m[pattern]).reshape(len(rows), -1) / over
        off -= np.einsum("rij,rkj,rk->ri", left, left, off, optimize=True)
        square[rows] = np.sum(off**2, axis=1)
        count[rows] = over.shape[1] - rank
    return square, count


def without_knocked(p_m: Array, u_m: Array) -> tuple[tuple[Knock, ...], Array]:
    """Return knocked targets, and the readings (P, K, 3) without theirs of the shorter stretch."""
    kept_m, found = p_m.copy(), []
    standing = list(range(p_m.shape[1]))
    for _ in range(2 * p_m.shape[1]):
        knock = knocks(kept_m[:, standing], u_m[:, standing]) if len(standing) > 1 else None
        if knock is None:
            break
        named = tuple(standing[k] for k in knock.targets)
        found.append(Knock(named, knock.row, knock.shift_m))
        after = 2 * knock.row < len(p_m)
        for k in named:
            kept_m[slice(0, knock.row) if after else slice(knock.row, None), k] = np.nan
            standing.remove(k)
    return tuple(found), kept_m


def knocks(p_m: Array, u_m: Array) -> Knock | None:
    """Return the clearest step of one target against the others; None without any."""
    shape, across, rows = _shape(p_m, u_m)
    count = len(shape)
    if count < 2 * KNOCKS.either_side + 1 or not shape.shape[1]:
        return None
    sigma = _scale(shape)
    middle = np.median(shape, axis=0)
    spread = np.maximum(MEDIAN_TO_SIGMA * np.median(np.abs(shape - middle), axis=0), sigma)
    clipped = np.clip(shape - middle, -KNOCKS.far_errors * spread, KNOCKS.far_errors * spread)
    summed = np.cumsum(clipped, axis=0)
    first = np.arange(KNOCKS.either_side, count - KNOCKS.either_side + 1)
    before = summed[first - 1] / first[:, None]
    after = (summed[-1] - summed[first - 1]) / (count - first)[:, None]
    scaled = np.sqrt(first * (count - first) / count)[:, None] * (after - before) / sigma
    gains = np.stack([np.sum((scaled @ _directions(each)) ** 2, axis=1) for each in across])
    best = gains.max(axis=1)
    k, at = int(best.argmax()), int(first[gains[best.argmax()].argmax()])
    moved = np.median(shape[at:], axis=0) - np.median(shape[:at], axis=0)
    within = across[k] @ np.linalg.pinv(across[k], rcond=KNOCKS.follows_share) @ moved
    shift_m = np.linalg.lstsq(across[k], within, rcond=KNOCKS.follows_share)[0]
    said_m = float(np.nanmedian(u_m))
    size_m = float(np.linalg.norm(shift_m)) * said_m
    if (
        best[k] / 2.0 < KNOCKS.needed_nats
        or size_m < KNOCKS.least_errors * max(sigma, 1.0) * said_m
    ):
        return None
    as_well = tuple(int(j) for j in np.flatnonzero(best > best[k] - 2.0 * KNOCKS.as_well_nats))
    return Knock(as_well, int(rows[at]), size_m)


def _shape(p_m: Array, u_m: Array) -> tuple[Array, list[Array], Index]:
    """Return what no rigid motion makes of the readings.

    Returns:
        (R, m) components in stated standard deviations, in the R configurations that show all
        targets; how they follow each target's place (m, 3); and which configurations.
    """
    rows = np.flatnonzero(np.isfinite(p_m[..., 0]).all(axis=1))
    if not len(rows):
        return np.zeros((0, 0)), [], rows
    places_m = np.median(p_m[rows], axis=0)
    targets = len(places_m)
    modes = by_small_motion(places_m - places_m.mean(axis=0)).reshape(3 * targets, 6)
    left, sizes, _ = np.linalg.svd(modes)
    others = left[:, int(np.sum(sizes > _RANK * sizes[0])) :]
    whole = (p_m[rows] - places_m).reshape(len(rows), -1) / np.nanmedian(u_m)
    across = others.T.reshape(-1, targets, 3)
    return whole @ others, [across[:, k] for k in range(targets)], rows


def _scale(shape: Array) -> float:
    """Return the standard deviation of a component, by successive differences."""
    differences = np.abs(np.diff(shape, axis=0)) / np.sqrt(2.0)
    return max(MEDIAN_TO_SIGMA * float(np.median(differences)), np.finfo(float).tiny)


def _directions(across: Array) -> Array:
    """Return an orthonormal basis of where a target's place moves the shape."""
    left, sizes, _ = np.linalg.svd(across, full_matrices=False)
    return np.asarray(left[:, sizes > KNOCKS.follows_share * max(sizes.max(), _TINY)])
