"""How an instrument moved between readings, from targets that are fixed to the base or the floor.

A target k at b_k is read at b_k + s + w x (b_k - c), where s and w are the small shift and turn of
the reading's configuration about the middle c of the targets. Wrong readings and
knocked targets go first. About a set of places all is linear and Gaussian, its normal equations a
band. Which motion is taken, and where it is left out: "Targets on the base" of docs/instruments.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.special import chdtri

from pa10cal.arrays import Array, Mask
from pa10cal.frame import knocked_targets
from pa10cal.frame.rigid_fit import by_small_motion
from pa10cal.rules import BASE_MOTION

Form = Literal["still", "walk", "each"]

#: Sizes of motions are found so many times, from no more readings than about this, evenly chosen,
#: to so much of their logarithm and of the evidence (computing).
_ROUNDS, _MOST_FOR_SIZES, _ARRIVED = 2, 600, {"xatol": 0.05, "fatol": 0.02}
#: Steps to the places of targets, where these move by less than the second [m]; and motions that
#: are none [m, rad] (computing).
_MOST_PLACES, _SAME_M, _NOTHING = 30, 1e-9, 1e-12


@dataclass(frozen=True)
class BaseMotion:
    """How K fixed targets moved together in P readings, as an instrument saw them."""

    form: Form  # `still`: nothing moved; `walk`: smoothed in time; `each`: reading by reading
    about_m: Array  # (3,) middle of the targets, about which they turn
    motion: Array  # (P, 6) shift [m] and turn [rad], zero on average
    cov: Array  # (P, 6, 6) their covariance; of a turn that does not show, how large it may be
    noise: float  # standard deviation of the readings over that stated
    turns: bool  # whether the targets show turns
    knocked: tuple[knocked_targets.Knock, ...]  # targets that moved against the others
    wrong: Mask  # (P, K) single readings that are not of their target
    used: Mask  # (P, K) readings that the motion rests on


def common_motion(time_s: Array, p_m: Array, u_m: Array) -> BaseMotion:
    """Find how fixed targets moved together.

    Args:
        time_s: (P,) times, ascending.
        p_m: (P, K, 3) readings in the instrument's frame, nan where a target was not seen.
        u_m: (P, K, 3) their stated standard uncertainties.
    """
    ever: Mask = np.asarray(np.isfinite(p_m[..., 0]).any(axis=0))
    if not ever.all():
        return _of_all_targets(common_motion(time_s, p_m[:, ever], u_m[:, ever]), ever)
    wrong = knocked_targets.wrong_by_themselves(p_m, u_m)
    knocked, kept_m = knocked_targets.without_knocked(np.where(wrong[..., None], np.nan, p_m), u_m)
    wrong |= (off := knocked_targets.wrong_in_shape(kept_m, u_m))
    kept_m[off] = np.nan
    readings = _Readings.of(time_s, kept_m, u_m)
    found = readings.best()
    for _ in range(_ROUNDS):
        off = readings.off(found)
        if not off.any():
            break
        wrong |= off
        readings = readings.without(off)
        found = readings.again(found)
    motion, cov = np.zeros((len(p_m), 6)), np.zeros((len(p_m), 6, 6))
    d = readings.components
    if found.form != "still":
        motion[:, :d], cov[:, :d, :d] = readings.worth_taking(found)
        cov[:, d:, d:] = readings.turn_variance(found) * np.eye(6 - d)
    return BaseMotion(
        found.form if motion.any() else "still",
        readings.about_m,
        motion,
        cov if motion.any() else np.zeros_like(cov),
        float(np.sqrt(found.variance)),
        d == 6,
        knocked,
        wrong,
        readings.seen,
    )


def _of_all_targets(found: BaseMotion, ever: Mask) -> BaseMotion:
    """Return what was found of the targets that were ever seen (K,), numbered among all."""
    number = np.flatnonzero(ever)
    wrong, used = (np.zeros((len(found.used), len(ever)), dtype=bool) for _ in range(2))
    wrong[:, ever], used[:, ever] = found.wrong, found.used
    knocked = tuple(
        replace(each, targets=tuple(int(number[k]) for k in each.targets)) for each in found.knocked
    )
    return replace(found, wrong=wrong, used=used, knocked=knocked)


@dataclass(frozen=True)
class _Readings:
    """Readings of fixed targets in order of time."""

    step: Array  # (P - 1,) times between readings over the usual one
    # p_m and u_m: (P, K, 3) readings and stated uncertainties, nan where not used
    p_m: Array
    u_m: Array
    about_m: Array  # (3,) middle of the targets
    modes: Array  # (K, 3, d) how each target follows shift and turn

    @classmethod
    def of(cls, time_s: Array, p_m: Array, u_m: Array) -> _Readings:
        """Take readings, and find what their targets can show."""
        between = np.diff(time_s)
        usual = np.median(between[between > 0.0]) if (between > 0.0).any() else 1.0
        b_m = np.nanmean(p_m, axis=0)
        about_m = b_m.mean(axis=0)
        seen = np.isfinite(p_m[..., 0])
        turns = _share(seen, lambda pattern: _not_in_line(b_m[pattern])) >= BASE_MOTION.mostly_share
        modes = by_small_motion(b_m - about_m)[..., : 6 if turns else 3]
        return cls(np.clip(between / usual, *BASE_MOTION.steps), p_m, u_m, about_m, modes)

    @property
    def components(self) -> int:
        """Return the number of components of a motion, 3 or 6."""
        return int(self.modes.shape[2])

    @cached_property
    def seen(self) -> Mask:
        """Return which readings (P, K) are used."""
        return np.isfinite(self.p_m[..., 0])

    @cached_property
    def own(self) -> Array:
        """Return the products (P, d, d) of what each configuration's readings say of its motion."""
        modes = self.modes
        found: Array = np.einsum("kxa,pkx,kxb->pab", modes, self.weight, modes, optimize=True)
        return found

    @cached_property
    def weight(self) -> Array:
        """Return the stated precision (P, K, 3) of each coordinate, 0 where not used."""
        return np.where(np.isfinite(self.p_m), np.nan_to_num(self.u_m, nan=1.0) ** -2.0, 0.0)

    def without(self, off: Mask) -> _Readings:
        """Return the readings without some (P, K)."""
        return replace(self, p_m=np.where(off[..., None], np.nan, self.p_m))

    def thinned(self) -> _Readings:
        """Return fewer of them, evenly chosen."""
        every = max(1, len(self.p_m) // _MOST_FOR_SIZES)
        time = np.concatenate([[0.0], np.cumsum(self.step)])[::every]
        return replace(self, step=np.diff(time), p_m=self.p_m[::every], u_m=self.u_m[::every])

    def best(self) -> _Fit:
        """Return the form of motion under which the readings are most probable."""
        fewer = self.thinned()
        still = _still(fewer)
        # Of one target nothing tells motions of each configuration from noise.
        forms: list[Form] = ["walk", "each"] if self.p_m.shape[1] > 1 else ["walk"]
        moving = max((_moving(fewer, form) for form in forms), key=lambda fit: fit.evidence)
        if moving.evidence <= still.evidence + BASE_MOTION.needed_nats:
            return _still(self)
        return self.again(moving)

    def again(self, fit: _Fit) -> _Fit:
        """Return motions of the same form and sizes, fitted to these readings."""
        if fit.form == "still":
            return _still(self)
        return _placed(self, fit.form, fit.sizes, fit.variance, np.nanmean(self.p_m, axis=0))

    def off(self, fit: _Fit) -> Mask:
        """Return readings (P, K) too far from the motion to be of it, the furthest of each row."""
        left = np.nan_to_num(self.p_m - fit.places_m - _moved(self.modes, fit.motion))
        # Readings that agree better than stated are no reason to reject one within its uncertainty.
        square = np.sum(left**2 * self.weight, axis=2) / max(fit.variance, 1.0)
        limit = chdtri(3, BASE_MOTION.error_rate / max(int(self.seen.sum()), 1))
        furthest = square == square.max(axis=1, keepdims=True)
        found: Mask = (square > limit) & furthest
        return found

    def worth_taking(self, fit: _Fit) -> tuple[Array, Array]:
        """Return motions (P, d) and their covariance, zero where they are worse known than large.

        To leave a motion out costs its spread, which is no more than the readings of the targets
        themselves show, configuration by configuration. Along a direction in which a motion is
        known no better than that, it is left out, and is uncertain by the spread.
        """
        motion, cov = fit.motion - fit.motion.mean(axis=0), fit.covariance()
        left = np.nan_to_num(self.p_m - fit.places_m)
        pulled = np.einsum("kxa,pkx->pa", self.modes, self.weight * left)
        whole: Mask = np.asarray(self.seen.any(axis=1))
        whole[whole] = np.linalg.cond(self.own[whole]) < BASE_MOTION.condition
        if not whole.any():
            return np.zeros_like(motion), np.zeros_like(cov)
        shown = np.linalg.solve(self.own[whole], pulled[whole][..., None])[..., 0]
        spread = np.cov(shown.T, bias=True).reshape(self.components, self.components)
        root = np.linalg.cholesky(spread + _NOTHING**2 * np.eye(self.components))
        back = np.linalg.inv(root)
        parts, axes = np.linalg.eigh(back @ cov @ back.T)
        along = np.einsum("pji,jk,pk->pi", axes, back, motion)
        along[parts >= 1.0] = 0.0
        outward = root @ axes
        parts = np.minimum(parts, 1.0)
        bounded = np.einsum("pai,pi,pbi->pab", outward, parts, outward)
        return np.einsum("pai,pi->pa", outward, along), bounded

    def turn_variance(self, fit: _Fit) -> float:
        """Return the variance of the turn about each axis that the targets do not show.

        Two targets, or more in line, show how far they turn across their line; about it the
        instrument is taken to turn as much. One shows no turn: then a shift as large as was found
        may come of an instrument that turns where it stands.
        """
        seen = self.seen
        if _share(seen, lambda pattern: pattern.sum() > 1) < BASE_MOTION.mostly_share:
            shift2 = float(np.mean(np.sum(fit.motion**2, axis=1)))
            return shift2 / (
                2.0 * max(float(np.linalg.norm(self.about_m)), BASE_MOTION.near_m) ** 2
            )
        square, count = knocked_targets.misfits(self.p_m, self.u_m, fit.places_m)
        noise = float(square.sum() / max(count.sum(), 1))
        rows = seen.sum(axis=1) > 1
        arms = by_small_motion(fit.places_m - self.about_m)[..., 3:]
        by_turn = np.einsum("kxa,pkx,kxb->pab", arms, self.weight[rows], arms, optimize=True)
        left = np.nan_to_num(self.p_m - fit.places_m - _moved(self.modes, fit.motion))[rows]
        inverse = np.linalg.pinv(by_turn, rcond=BASE_MOTION.in_line**2, hermitian=True)
        pulled = np.einsum("kxa,pkx->pa", arms, self.weight[rows] * left)
        turn = np.einsum("pab,pb->pa", inverse, pulled)
        expected = 0.5 * noise * float(np.mean(np.trace(inverse, axis1=1, axis2=2)))
        shown = 0.5 * float(np.mean(np.sum(turn**2, axis=1)))
        return max(shown - expected, 0.0) + expected / float(np.sqrt(rows.sum()))


def _share(seen: Mask, able: Callable[[Mask], bool]) -> float:
    """Return the share of configurations (P, K) with readings whose targets are able to show it."""
    patterns, times = np.unique(seen[seen.any(axis=1)], axis=0, return_counts=True)
    count = sum(int(n) for pattern, n in zip(patterns, times, strict=True) if able(pattern))
    return count / max(int(times.sum()), 1)


def _not_in_line(b_m: Array) -> bool:
    """Return whether targets (K, 3) are three or more, not in line."""
    if len(b_m) < 3:
        return False
    thickness = np.linalg.svd(b_m - b_m.mean(axis=0), compute_uv=False)
    return bool(thickness[1] > BASE_MOTION.in_line * thickness[0])


@dataclass(frozen=True)
class _Fit:
    """Motions of one form."""

    form: Form  # which
    motion: Array  # (P, d) shift and turn
    places_m: Array  # (K, 3) of the targets
    variance: float  # of a reading, over the stated one
    # logarithm of the probability of the readings, but for what is common to all forms
    evidence: float
    sizes: Array  # (d,) of the motions: standard deviation of a step, or of each of them
    normal: _Normal | None = None  # band of the normal equations; None of targets that stand still

    def covariance(self) -> Array:
        """Return the covariance (P, d, d) of each motion."""
        if self.normal is None:
            return np.zeros((*self.motion.shape, self.motion.shape[1]))
        return self.normal.covariance()


def _still(readings: _Readings) -> _Fit:
    """Return no motion at all."""
    places_m = np.nanmean(readings.p_m, axis=0)
    left = np.nan_to_num(readings.p_m - places_m)
    square = float(np.sum(left**2 * readings.weight))
    count = 3.0 * readings.seen.sum()
    variance = max(square / max(count, 1.0), np.finfo(float).tiny)
    motion = np.zeros((len(readings.p_m), readings.components))
    evidence = -0.5 * (square / variance + count * np.log(variance))
    return _Fit("still", motion, places_m, variance, float(evidence), np.zeros(0))


def _moving(readings: _Readings, form: Form) -> _Fit:
    """Return motions of a form, its sizes those of the greatest evidence."""
    from scipy.optimize import minimize  # late: it takes long to load

    fit = _still(readings)
    usual_m = float(np.nanmedian(readings.u_m))
    units = np.full(readings.components, usual_m)
    if readings.components == 6:
        units[3:] /= float(np.sqrt(np.mean(readings.modes[:, :, 3:] ** 2)))
    free = 2 if readings.components == 6 else 1
    x = np.zeros(free + 1)

    def taken(x: Array) -> tuple[Array, float]:
        sizes, noise = np.split(np.clip(x, *BASE_MOTION.sizes), [free])
        return units * np.exp(np.repeat(sizes, 3)), float(np.exp(2.0 * noise[0]))

    for _ in range(_ROUNDS):
        places_m = fit.places_m

        def unlikely(x: Array, places_m: Array = places_m) -> float:
            return -_solve(readings, form, *taken(x), places_m).evidence

        simplex = np.vstack([x, x - np.eye(len(x))])
        options: Any = {**_ARRIVED, "initial_simplex": simplex}
        x = minimize(unlikely, x, method="Nelder-Mead", options=options).x
        fit = _placed(readings, form, *taken(x), places_m)
    return fit


def _placed(
    readings: _Readings, form: Form, sizes: Array, variance: float, places_m: Array
) -> _Fit:
    """Return motions with the places of the targets found as well; see `_solve`."""
    fit = _solve(readings, form, sizes, variance, places_m)
    for _ in range(_MOST_PLACES):
        moved = np.where(readings.seen[..., None], _moved(readings.modes, fit.motion), np.nan)
        places_m = np.nanmean(readings.p_m - moved, axis=0)
        change = float(np.nanmax(np.abs(places_m - fit.places_m)))
        fit = _solve(readings, form, sizes, variance, places_m)
        if change < _SAME_M:
            break
    return fit


def _solve(readings: _Readings, form: Form, sizes: Array, variance: float, places_m: Array) -> _Fit:
    """Return the motions of given sizes (d,): steps of a walk, or those of each configuration."""
    left = np.nan_to_num(readings.p_m - places_m)
    pulled = np.einsum("kxa,pkx->pa", readings.modes, readings.weight * left) / variance
    count, d = len(left), len(sizes)
    own = readings.own / variance
    prior, joined = np.zeros((count, d)), np.zeros((count - 1, d))
    if form == "walk":
        # Where a walk began is told by the places of the targets, and so is not drawn.
        joined = 1.0 / (readings.step[:, None] * sizes**2)
        prior[:-1] += joined
        prior[1:] += joined
        expected = float(np.sum(np.log(joined))) + float(np.linalg.slogdet(own.sum(axis=0))[1])
    else:
        prior += sizes**-2.0
        expected = float(np.sum(np.log(prior)))
    normal = _Normal.of(own, prior, joined)
    motion = normal.solve(pulled)
    square = float(np.sum(left**2 * readings.weight)) / variance
    evidence = 0.5 * (
        expected
        - normal.log_determinant
        + float(np.sum(pulled * motion))
        - square
        - 3.0 * readings.seen.sum() * np.log(variance)
    )
    return _Fit(form, motion, places_m, variance, float(evidence), sizes, normal)


@dataclass(frozen=True)
class _Normal:
    """Normal equations of motions, each coupled with those before and after it."""

    blocks: Array  # (P, d, d) of each motion
    joined: Array  # (P - 1, d) coupling with the next, on the diagonal, its sign changed

    @classmethod
    def of(cls, own: Array, prior: Array, joined: Array) -> _Normal:
        """Return the normal equations of readings (P, d, d) and a prior (P, d)."""
        blocks, at = own.copy(), range(prior.shape[1])
        blocks[:, at, at] += prior
        return cls(blocks, joined)

    @cached_property
    def factor(self) -> Array:
        """Return the lower band of the Cholesky factor."""
        count, d = self.blocks.shape[:2]
        band = np.zeros((d + 1, count * d))
        for below in range(d):
            for column in range(d - below):
                band[below, column::d] = self.blocks[:, column + below, column]
        band[d, : (count - 1) * d] = -self.joined.ravel()
        found: Array = cholesky_banded(band, lower=True, check_finite=False)
        return found

    @property
    def log_determinant(self) -> float:
        """Return the logarithm of the determinant."""
        return 2.0 * float(np.sum(np.log(self.factor[0])))

    def solve(self, right: Array) -> Array:
        """Return the motions (P, d) of right sides (P, d)."""
        solved = cho_solve_banded((self.factor, True), right.ravel(), check_finite=False)
        return np.asarray(solved, dtype=np.float64).reshape(right.shape)

    def covariance(self) -> Array:
        """Return the blocks (P, d, d) on the diagonal of the inverse."""
        count = len(self.blocks)
        ahead, behind = self.blocks.copy(), self.blocks.copy()
        for i in range(1, count):
            link = self.joined[i - 1]
            ahead[i] -= link[:, None] * np.linalg.inv(ahead[i - 1]) * link
            j = count - 1 - i
            link = self.joined[j]
            behind[j] -= link[:, None] * np.linalg.inv(behind[j + 1]) * link
        return np.asarray(np.linalg.inv(ahead + behind - self.blocks), dtype=np.float64)


def _moved(modes: Array, motion: Array) -> Array:
    """Return how far motions (P, d) move K targets, (P, K, 3)."""
    found: Array = np.einsum("kxa,pa->pkx", modes, motion)
    return found
