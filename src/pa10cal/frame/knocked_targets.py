"""Targets that were read wrongly, or moved relative to each other: which, when, how far.

Fixed targets keep their shape, however the instrument moves, and so do those of a tool. The
residuals of the best rigid motion are therefore noise: a single large residual is an outlier, and a
step of the residuals in time shows that a target was knocked. Neither counts within the stated
uncertainty.

Throughout, p_m are readings (P, K, 3) of K targets in order of time, nan where one was not seen,
and u_m their stated standard uncertainties.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter
from scipy.special import chdtri

from pa10cal.arrays import MEDIAN_TO_SIGMA, Array, Index, Mask
from pa10cal.errors import CalibrationError
from pa10cal.frame.point_fits import by_small_motion, fit_rigid
from pa10cal.rules import KNOCKS

#: Singular values of the rigid motions below this part of the largest are zero; and the smallest
#: size that is divided by (computing).
_RANK, _TINY = 1e-6, 1e-300


@dataclass(frozen=True)
class Knock:
    """A step of one target relative to the others."""

    # numbers, from 0, of the targets that explain the step equally well; usually one
    targets: tuple[int, ...]
    row: int  # the first configuration after the step
    shift_m: float  # length of the step, in the directions that show


def wrong_by_themselves(p_m: Array, u_m: Array) -> Mask:
    """Return the outliers (P, K) from the running median of each target.

    Where several targets are far off but keep their shape, they moved together and are no outliers.
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
    """Return the readings (P, K) of configurations in which the shape of the targets is wrong.

    If the shape is right without one of three targets or more, this one alone is wrong.
    """
    wrong = np.zeros(p_m.shape[:2], dtype=bool)
    places_m = np.nanmedian(p_m, axis=0)
    square, dof = misfits(p_m, u_m, places_m)
    shown = dof > 0
    if not shown.any():
        return wrong
    variance = max(float(np.median(square[shown] / chdtri(dof[shown], 0.5))), 1.0)
    misshapen = np.zeros(len(p_m), dtype=bool)
    limit = variance * chdtri(dof[shown], KNOCKS.error_rate / shown.sum())
    misshapen[shown] = square[shown] > limit
    for row in np.flatnonzero(misshapen):
        wrong[row] = np.isfinite(p_m[row, :, 0])
        target = _single_outlier(p_m[row], u_m[row], places_m, variance)
        if target is not None:
            wrong[row] = np.arange(len(places_m)) == target
    return wrong


def _single_outlier(p_m: Array, u_m: Array, places_m: Array, variance: float) -> int | None:
    """Return the one target without which the shape (K, 3) is right; None if it is not unique."""
    seen = np.flatnonzero(np.isfinite(p_m[:, 0]))
    if len(seen) < 3:
        return None
    without = np.repeat(p_m[None], len(seen), axis=0)
    without[range(len(seen)), seen] = np.nan
    square, dof = misfits(without, np.broadcast_to(u_m, without.shape), places_m)
    best, second = np.argsort(square)[:2]
    right = square[best] <= variance * chdtri(max(int(dof[best]), 1), KNOCKS.error_rate)
    if not right or (square[second] - square[best]) / 2.0 < KNOCKS.as_well_nats * variance:
        return None
    return int(seen[best])


def misfits(p_m: Array, u_m: Array, places_m: Array) -> tuple[Array, Index]:
    """Return the misfit of each configuration (R, K, 3) to the places (K, 3), moved rigidly.

    Returns:
        (R,) weighted sums of squared residuals after the best small rigid motion, and (R,) their
        degrees of freedom.
    """
    seen = np.isfinite(p_m[..., 0])
    square, dof = np.zeros(len(p_m)), np.zeros(len(p_m), dtype=np.intp)
    patterns, pattern_of = np.unique(seen, axis=0, return_inverse=True)
    for number, pattern in enumerate(patterns):
        if pattern.sum() < 2:
            continue
        rows = np.flatnonzero(pattern_of.ravel() == number)
        mean_m = places_m[pattern].mean(axis=0)
        modes = by_small_motion(places_m[pattern] - mean_m).reshape(-1, 6)
        rank = np.linalg.matrix_rank(modes, tol=_RANK * np.linalg.norm(modes, 2))
        u_rows_m = u_m[rows][:, pattern].reshape(len(rows), -1)
        whitened = modes / u_rows_m[..., None]
        basis = np.linalg.svd(whitened, full_matrices=False)[0][..., :rank]
        residual = (p_m[rows][:, pattern] - places_m[pattern]).reshape(len(rows), -1) / u_rows_m
        residual -= np.einsum("rij,rkj,rk->ri", basis, basis, residual, optimize=True)
        square[rows] = np.sum(residual**2, axis=1)
        dof[rows] = u_rows_m.shape[1] - rank
    return square, dof


def without_knocked(p_m: Array, u_m: Array) -> tuple[tuple[Knock, ...], Array]:
    """Return knocked targets, and the readings (P, K, 3) with the shorter part of theirs removed.

    The shorter part is that before or after the knock.
    """
    kept_m, found = p_m.copy(), []
    others = list(range(p_m.shape[1]))  # targets that were not knocked
    for _ in range(2 * p_m.shape[1]):
        if len(others) < 2:
            break
        knock = clearest_knock(kept_m[:, others], u_m[:, others])
        if knock is None:
            break
        targets = tuple(others[k] for k in knock.targets)
        found.append(Knock(targets, knock.row, knock.shift_m))
        longer_after = 2 * knock.row < len(p_m)
        removed = slice(0, knock.row) if longer_after else slice(knock.row, None)
        for k in targets:
            kept_m[removed, k] = np.nan
            others.remove(k)
    return tuple(found), kept_m


def knocks_on_body(p_m: Array, u_m: Array) -> tuple[Knock, ...]:
    """Return the knocks of targets of a body that moves as it likes, in order of time.

    The body is turned to where it was first. Before and after a step more steps are sought. A shape
    that changes steadily, as a body that warms, is none: a line in time explains it better.
    """
    rows = np.flatnonzero(np.isfinite(p_m[..., 0]).all(axis=1))
    if len(rows) <= 2 * KNOCKS.either_side or p_m.shape[1] < 3:
        return ()
    try:
        T = fit_rigid(p_m[rows], p_m[rows[0]]).T
    except CalibrationError:  # targets in one line
        return ()
    on_body_m = p_m[rows] @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3]
    return tuple(
        Knock(each.targets, int(rows[each.row]), each.shift_m)
        for each in _knocks_of(on_body_m, u_m[rows])
    )


def _knocks_of(p_m: Array, u_m: Array) -> list[Knock]:
    """Return the clearest knock, and those before and after it."""
    knock = clearest_knock(p_m, u_m)
    if knock is None or _is_steady(p_m, u_m, knock.row):
        return []
    row = knock.row
    later = [Knock(k.targets, row + k.row, k.shift_m) for k in _knocks_of(p_m[row:], u_m[row:])]
    return [*_knocks_of(p_m[:row], u_m[:row]), knock, *later]


def _is_steady(p_m: Array, u_m: Array, row: int) -> bool:
    """Return whether the shape changes along a line in the order of rows rather than by a step."""
    shape = _shape(p_m, u_m)[0]
    order = np.arange(len(shape), dtype=float)

    def left(course: Array) -> float:
        design = np.column_stack([np.ones(len(shape)), course])
        rest = shape - design @ np.linalg.lstsq(design, shape, rcond=None)[0]
        return float(np.sum(rest**2))

    return left(order) < left((order >= row).astype(float))


def clearest_knock(p_m: Array, u_m: Array) -> Knock | None:
    """Return the clearest step of one target relative to the others; None without any.

    For a step at each row the means before and after are compared, by the likelihood ratio of the
    directions in which each target moves the shape. Far values are clipped.
    """
    shape, by_target, rows = _shape(p_m, u_m)
    count = len(shape)
    if count < 2 * KNOCKS.either_side + 1 or not shape.shape[1]:
        return None
    sigma = _scale(shape)
    median = np.median(shape, axis=0)
    spread = np.maximum(MEDIAN_TO_SIGMA * np.median(np.abs(shape - median), axis=0), sigma)
    clipped = np.clip(shape - median, -KNOCKS.far_errors * spread, KNOCKS.far_errors * spread)
    summed = np.cumsum(clipped, axis=0)
    first = np.arange(KNOCKS.either_side, count - KNOCKS.either_side + 1)
    before = summed[first - 1] / first[:, None]
    after = (summed[-1] - summed[first - 1]) / (count - first)[:, None]
    scaled = np.sqrt(first * (count - first) / count)[:, None] * (after - before) / sigma
    # Of each target and row of the step, (K, rows): twice the gain in log likelihood.
    gains = np.stack([np.sum((scaled @ _directions(each)) ** 2, axis=1) for each in by_target])
    best = gains.max(axis=1)
    k = int(best.argmax())
    row = int(first[gains[k].argmax()])
    step = np.median(shape[row:], axis=0) - np.median(shape[:row], axis=0)
    of_target = by_target[k] @ np.linalg.pinv(by_target[k], rcond=KNOCKS.follows_share) @ step
    shift = np.linalg.lstsq(by_target[k], of_target, rcond=KNOCKS.follows_share)[0]
    stated_m = float(np.nanmedian(u_m))
    shift_m = float(np.linalg.norm(shift)) * stated_m
    smallest_m = KNOCKS.least_errors * max(sigma, 1.0) * stated_m
    if best[k] / 2.0 < KNOCKS.needed_nats or shift_m < smallest_m:
        return None
    as_good = tuple(int(j) for j in np.flatnonzero(best > best[k] - 2.0 * KNOCKS.as_well_nats))
    return Knock(as_good, int(rows[row]), shift_m)


def _shape(p_m: Array, u_m: Array) -> tuple[Array, list[Array], Index]:
    """Return the components of the readings that no small rigid motion makes.

    Returns:
        (R, m) components in stated standard deviations, in the R configurations that show all
        targets; their derivatives (m, 3) by the place of each target; and the R configurations.
    """
    rows = np.flatnonzero(np.isfinite(p_m[..., 0]).all(axis=1))
    if not len(rows):
        return np.zeros((0, 0)), [], rows
    places_m = np.median(p_m[rows], axis=0)
    targets = len(places_m)
    modes = by_small_motion(places_m - places_m.mean(axis=0)).reshape(3 * targets, 6)
    basis, sizes, _ = np.linalg.svd(modes)
    not_rigid = basis[:, int(np.sum(sizes > _RANK * sizes[0])) :]
    offsets = (p_m[rows] - places_m).reshape(len(rows), -1) / np.nanmedian(u_m)
    by_place = not_rigid.T.reshape(-1, targets, 3)
    return offsets @ not_rigid, [by_place[:, k] for k in range(targets)], rows


def _scale(shape: Array) -> float:
    """Return the standard deviation of a component, by successive differences."""
    differences = np.abs(np.diff(shape, axis=0)) / np.sqrt(2.0)
    return max(MEDIAN_TO_SIGMA * float(np.median(differences)), np.finfo(float).tiny)


def _directions(by_place: Array) -> Array:
    """Return an orthonormal basis of the components that a target's place moves, (m, r)."""
    basis, sizes, _ = np.linalg.svd(by_place, full_matrices=False)
    return np.asarray(basis[:, sizes > KNOCKS.follows_share * max(sizes.max(), _TINY)])
