"""How an instrument moved between readings, from targets that are fixed to the base or the floor.

In each of P configurations a target k at b_k is read at b_k + s + w x (b_k - c), where s and w are
the small shift and turn of this configuration about the mean c of the targets. The places b_k are
the same in all. Wrong readings and knocked targets are excluded first. For given places the model
is linear and Gaussian, and its normal equations are block tridiagonal. Which form of motion is
chosen, and where it is omitted: "Targets on the base" of docs/instruments.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from scipy.special import chdtri

from pa10cal.arrays import Array, Mask
from pa10cal.frame import knocked_targets
from pa10cal.frame.point_fits import by_small_motion
from pa10cal.numerics.least_squares import BlockTridiagonal
from pa10cal.rules import BASE_MOTION

Form = Literal["still", "walk", "each"]

#: Rounds of outliers, and of sizes of motions about new places of the targets (computing).
_ROUNDS = 2
#: Configurations, about this many, from which sizes of motions are estimated (computing).
_MOST_FOR_SIZES = 600
#: Tolerances of the logarithms of sizes, and of the log evidence (computing).
_SIZE_TOLERANCES = {"xatol": 0.05, "fatol": 0.02}
#: Iterations of the places of targets, at most, until they move by less than this [m] (computing).
_MOST_ITERATIONS, _SAME_M = 30, 1e-9
#: Standard deviation of a motion that counts as zero [m, rad] (computing).
_NO_MOTION = 1e-12


@dataclass(frozen=True)
class BaseMotion:
    """How K fixed targets moved together in P readings, as an instrument saw them."""

    # `still`: no motion; `walk`: a random walk in time; `each`: every configuration by itself
    form: Form
    about_m: Array  # (3,) mean of the targets, about which they turn
    motion: Array  # (P, 6) shift [m] and turn [rad], zero on average
    cov: Array  # (P, 6, 6) their covariance; of turns that the targets do not show, a bound
    noise: float  # standard deviation of the readings over that stated
    turns: bool  # whether the targets show turns
    knocked: tuple[knocked_targets.Knock, ...]  # targets that moved relative to the others
    wrong: Mask  # (P, K) outliers
    used: Mask  # (P, K) readings that were fitted


def common_motion(time_s: Array, p_m: Array, u_m: Array) -> BaseMotion:
    """Estimate how fixed targets moved together.

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
    wrong_shape = knocked_targets.wrong_in_shape(kept_m, u_m)
    wrong |= wrong_shape
    kept_m[wrong_shape] = np.nan
    readings = _Readings.of(time_s, kept_m, u_m)
    fit = readings.best_fit()
    for _ in range(_ROUNDS):
        outliers = readings.outliers(fit)
        if not outliers.any():
            break
        wrong |= outliers
        readings = readings.without(outliers)
        fit = readings.refitted(fit)
    motion, cov = np.zeros((len(p_m), 6)), np.zeros((len(p_m), 6, 6))
    d = readings.components
    if fit.form != "still":
        motion[:, :d], cov[:, :d, :d] = readings.well_known_motion(fit)
        cov[:, d:, d:] = readings.turn_variance(fit) * np.eye(6 - d)
    moves = bool(motion.any())
    return BaseMotion(
        form=fit.form if moves else "still",
        about_m=readings.about_m,
        motion=motion,
        cov=cov if moves else np.zeros_like(cov),
        noise=float(np.sqrt(fit.variance)),
        turns=d == 6,
        knocked=knocked,
        wrong=wrong,
        used=readings.seen,
    )


def _of_all_targets(found: BaseMotion, ever: Mask) -> BaseMotion:
    """Return the motion by the targets that were ever seen (K,), numbered among all targets."""
    number = np.flatnonzero(ever)
    wrong = np.zeros((len(found.used), len(ever)), dtype=bool)
    used = wrong.copy()
    wrong[:, ever] = found.wrong
    used[:, ever] = found.used
    knocked = tuple(
        replace(each, targets=tuple(int(number[k]) for k in each.targets)) for each in found.knocked
    )
    return replace(found, wrong=wrong, used=used, knocked=knocked)


@dataclass(frozen=True)
class _Readings:
    """Readings of K fixed targets in P configurations, in order of time."""

    step: Array  # (P - 1,) times between configurations over the median one
    p_m: Array  # (P, K, 3) readings, nan where not used
    u_m: Array  # (P, K, 3) their stated standard uncertainties
    about_m: Array  # (3,) mean of the targets
    modes: Array  # (K, 3, d) derivative of each target by shift and, where it shows, turn

    @classmethod
    def of(cls, time_s: Array, p_m: Array, u_m: Array) -> _Readings:
        """Return the readings; turns are unknowns where most configurations show them."""
        between = np.diff(time_s)
        usual = np.median(between[between > 0.0]) if (between > 0.0).any() else 1.0
        b_m = _mean_places(p_m)
        about_m = b_m.mean(axis=0)
        seen = np.isfinite(p_m[..., 0])
        shown = _share(seen, lambda pattern: _not_collinear(b_m[pattern]))
        turns = shown >= BASE_MOTION.mostly_share
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
    def information(self) -> Array:
        """Return the information (P, d, d) of each configuration's readings on its motion."""
        modes = self.modes
        products: Array = np.einsum("kxa,pkx,kxb->pab", modes, self.weight, modes, optimize=True)
        return products

    @cached_property
    def weight(self) -> Array:
        """Return the stated precision (P, K, 3) of each coordinate, 0 where not used."""
        return np.where(np.isfinite(self.p_m), np.nan_to_num(self.u_m, nan=1.0) ** -2.0, 0.0)

    def without(self, outliers: Mask) -> _Readings:
        """Return the readings without outliers (P, K)."""
        return replace(self, p_m=np.where(outliers[..., None], np.nan, self.p_m))

    def thinned(self) -> _Readings:
        """Return every n-th configuration, so that about `_MOST_FOR_SIZES` remain."""
        every = max(1, len(self.p_m) // _MOST_FOR_SIZES)
        time = np.concatenate([[0.0], np.cumsum(self.step)])[::every]
        return replace(self, step=np.diff(time), p_m=self.p_m[::every], u_m=self.u_m[::every])

    def best_fit(self) -> _Fit:
        """Return the fit of the form of motion with the largest evidence."""
        fewer = self.thinned()
        still = _still(fewer)
        # With one target, independent motions of the configurations cannot be told from noise.
        several = np.count_nonzero(self.seen.any(axis=0)) > 1
        forms: list[Form] = ["walk", "each"] if several else ["walk"]
        moving = max((_moving(fewer, form) for form in forms), key=lambda fit: fit.evidence)
        if moving.evidence <= still.evidence + BASE_MOTION.needed_nats:
            return _still(self)
        return self.refitted(moving)

    def refitted(self, fit: _Fit) -> _Fit:
        """Return motions of the same form and sizes, fitted to these readings."""
        if fit.form == "still":
            return _still(self)
        return _solve_with_places(self, fit.form, fit.sizes, fit.variance, _mean_places(self.p_m))

    def outliers(self, fit: _Fit) -> Mask:
        """Return the outliers (P, K) of a fit; in each configuration at most the furthest one."""
        residual = np.nan_to_num(self.p_m - fit.places_m - _moved(self.modes, fit.motion))
        # Readings that agree better than stated are no reason to reject one within its uncertainty.
        square = np.sum(residual**2 * self.weight, axis=2) / max(fit.variance, 1.0)
        limit = chdtri(3, BASE_MOTION.error_rate / max(int(self.seen.sum()), 1))
        furthest = square == square.max(axis=1, keepdims=True)
        outliers: Mask = (square > limit) & furthest
        return outliers

    def well_known_motion(self, fit: _Fit) -> tuple[Array, Array]:
        """Return motions (P, d) and their covariance, zero along directions that are badly known.

        A motion that is omitted costs its spread over all configurations, S. This is estimated from
        the motions that each configuration shows by itself, which are spread a little more. Along
        the principal directions of the covariance relative to S a motion is omitted if its variance
        is 1 or more; its variance is 1 then.
        """
        motion, cov = fit.motion - fit.motion.mean(axis=0), fit.covariance()
        residual = np.nan_to_num(self.p_m - fit.places_m)
        right = np.einsum("kxa,pkx->pa", self.modes, self.weight * residual)
        complete: Mask = np.asarray(self.seen.any(axis=1))
        complete[complete] = np.linalg.cond(self.information[complete]) < BASE_MOTION.condition
        if not complete.any():
            return np.zeros_like(motion), np.zeros_like(cov)
        alone = np.linalg.solve(self.information[complete], right[complete][..., None])[..., 0]
        spread = np.cov(alone.T, bias=True).reshape(self.components, self.components)
        root = np.linalg.cholesky(spread + _NO_MOTION**2 * np.eye(self.components))
        whitener = np.linalg.inv(root)
        variances, axes = np.linalg.eigh(whitener @ cov @ whitener.T)
        along = np.einsum("pji,jk,pk->pi", axes, whitener, motion)
        along[variances >= 1.0] = 0.0
        variances = np.minimum(variances, 1.0)
        directions = root @ axes
        bounded = np.einsum("pai,pi,pbi->pab", directions, variances, directions)
        return np.einsum("pai,pi->pa", directions, along), bounded

    def turn_variance(self, fit: _Fit) -> float:
        """Return the variance of turns [rad^2], per axis, where the targets do not show turns.

        Collinear targets show turns across their line; turns about it are assumed as large. One
        target shows none: then all of its shift may be due to an instrument that turns where it
        stands, at the distance of the target.
        """
        seen = self.seen
        if _share(seen, lambda pattern: pattern.sum() > 1) < BASE_MOTION.mostly_share:
            shift_m2 = float(np.mean(np.sum(fit.motion**2, axis=1)))
            distance_m = max(float(np.linalg.norm(self.about_m)), BASE_MOTION.near_m)
            return shift_m2 / (2.0 * distance_m**2)
        square, dof = knocked_targets.misfits(self.p_m, self.u_m, fit.places_m)
        noise = float(square.sum() / max(dof.sum(), 1))
        rows = seen.sum(axis=1) > 1
        arms = by_small_motion(fit.places_m - self.about_m)[..., 3:]
        by_turn = np.einsum("kxa,pkx,kxb->pab", arms, self.weight[rows], arms, optimize=True)
        residual = np.nan_to_num(self.p_m - fit.places_m - _moved(self.modes, fit.motion))[rows]
        inverse = np.linalg.pinv(by_turn, rcond=BASE_MOTION.in_line**2, hermitian=True)
        right = np.einsum("kxa,pkx->pa", arms, self.weight[rows] * residual)
        turn = np.einsum("pab,pb->pa", inverse, right)
        # Two components across the line show; of their mean square the noise makes `expected`.
        expected = 0.5 * noise * float(np.mean(np.trace(inverse, axis1=1, axis2=2)))
        shown = 0.5 * float(np.mean(np.sum(turn**2, axis=1)))
        return max(shown - expected, 0.0) + expected / float(np.sqrt(rows.sum()))


def _mean_places(p_m: Array) -> Array:
    """Return the mean place (K, 3) of each target over its readings (P, K, 3).

    A target of which no reading is left weighs nothing: it gets the mean place of the others.
    """
    times = np.isfinite(p_m[..., 0]).sum(axis=0)
    places_m: Array = np.nansum(p_m, axis=0) / np.maximum(times, 1)[:, None]
    if times.any():
        places_m[times == 0] = places_m[times > 0].mean(axis=0)
    return places_m


def _share(seen: Mask, suffices: Callable[[Mask], bool]) -> float:
    """Return the share of configurations (P, K) with any target whose targets suffice."""
    patterns, times = np.unique(seen[seen.any(axis=1)], axis=0, return_counts=True)
    count = sum(int(n) for pattern, n in zip(patterns, times, strict=True) if suffices(pattern))
    return count / max(int(times.sum()), 1)


def _not_collinear(b_m: Array) -> bool:
    """Return whether targets (K, 3) are three or more, and not collinear."""
    if len(b_m) < 3:
        return False
    extent_m = np.linalg.svd(b_m - b_m.mean(axis=0), compute_uv=False)
    return bool(extent_m[1] > BASE_MOTION.in_line * extent_m[0])


@dataclass(frozen=True)
class _Fit:
    """A fit of one form of motion."""

    form: Form
    motion: Array  # (P, d) shift and turn
    places_m: Array  # (K, 3) of the targets
    variance: float  # of a reading, over the stated one
    evidence: float  # log marginal likelihood of the readings, up to a constant of all forms
    sizes: Array  # (d,) standard deviations: of a step of a walk, or of every motion by itself
    normal: BlockTridiagonal | None = None  # normal equations of the motions; None where still

    def covariance(self) -> Array:
        """Return the covariance (P, d, d) of each motion."""
        if self.normal is None:
            return np.zeros((*self.motion.shape, self.motion.shape[1]))
        return self.normal.covariance()


def _still(readings: _Readings) -> _Fit:
    """Return the fit without any motion."""
    places_m = _mean_places(readings.p_m)
    residual = np.nan_to_num(readings.p_m - places_m)
    square = float(np.sum(residual**2 * readings.weight))
    count = 3.0 * readings.seen.sum()
    variance = max(square / max(count, 1.0), np.finfo(float).tiny)
    motion = np.zeros((len(readings.p_m), readings.components))
    evidence = -0.5 * (square / variance + count * np.log(variance))
    return _Fit("still", motion, places_m, variance, float(evidence), np.zeros(0))


def _moving(readings: _Readings, form: Form) -> _Fit:
    """Return the fit of a form of motion, with the sizes of the largest evidence.

    The sizes are one of shifts and, if turns show, one of turns, in units of the usual uncertainty.
    They and the noise of readings are sought as logarithms, in turn with the places of the targets.
    """
    from scipy.optimize import minimize  # late: it takes long to load

    fit = _still(readings)
    usual_m = float(np.nanmedian(readings.u_m))
    units = np.full(readings.components, usual_m)
    if readings.components == 6:
        units[3:] /= float(np.sqrt(np.mean(readings.modes[:, :, 3:] ** 2)))
    size_count = 2 if readings.components == 6 else 1
    x = np.zeros(size_count + 1)

    def sizes_and_variance(x: Array) -> tuple[Array, float]:
        log_sizes, log_noise = np.split(np.clip(x, *BASE_MOTION.sizes), [size_count])
        return units * np.exp(np.repeat(log_sizes, 3)), float(np.exp(2.0 * log_noise[0]))

    for _ in range(_ROUNDS):
        places_m = fit.places_m

        def negative_evidence(x: Array, places_m: Array = places_m) -> float:
            return -_solve(readings, form, *sizes_and_variance(x), places_m).evidence

        simplex = np.vstack([x, x - np.eye(len(x))])
        options: Any = {**_SIZE_TOLERANCES, "initial_simplex": simplex}
        x = minimize(negative_evidence, x, method="Nelder-Mead", options=options).x
        fit = _solve_with_places(readings, form, *sizes_and_variance(x), places_m)
    return fit


def _solve_with_places(
    readings: _Readings, form: Form, sizes: Array, variance: float, places_m: Array
) -> _Fit:
    """Return motions and places of the targets, by turns; see `_solve`."""
    fit = _solve(readings, form, sizes, variance, places_m)
    for _ in range(_MOST_ITERATIONS):
        moved = np.where(readings.seen[..., None], _moved(readings.modes, fit.motion), np.nan)
        places_m = _mean_places(readings.p_m - moved)
        change = float(np.abs(places_m - fit.places_m).max())
        fit = _solve(readings, form, sizes, variance, places_m)
        if change < _SAME_M:
            break
    return fit


def _solve(readings: _Readings, form: Form, sizes: Array, variance: float, places_m: Array) -> _Fit:
    """Return the motions for given places, and their evidence.

    Args:
        sizes: (d,) prior standard deviations, see `_Fit`.
        variance: of a reading, over the stated one.
    """
    residual = np.nan_to_num(readings.p_m - places_m)
    right = np.einsum("kxa,pkx->pa", readings.modes, readings.weight * residual) / variance
    count, d = len(residual), len(sizes)
    information = readings.information / variance
    prior, coupling = np.zeros((count, d)), np.zeros((count - 1, d))
    if form == "walk":
        coupling = 1.0 / (readings.step[:, None] * sizes**2)
        prior[:-1] += coupling
        prior[1:] += coupling
        # The start of a walk has no prior: the places of the targets determine it.
        of_start = float(np.linalg.slogdet(information.sum(axis=0))[1])
        prior_log_determinant = float(np.sum(np.log(coupling))) + of_start
    else:
        prior += sizes**-2.0
        prior_log_determinant = float(np.sum(np.log(prior)))
    normal = BlockTridiagonal.of(information, prior, coupling)
    motion = normal.solve(right)
    square = float(np.sum(residual**2 * readings.weight)) / variance
    evidence = 0.5 * (
        prior_log_determinant
        - normal.log_determinant
        + float(np.sum(right * motion))
        - square
        - 3.0 * readings.seen.sum() * np.log(variance)
    )
    return _Fit(form, motion, places_m, variance, float(evidence), sizes, normal)


def _moved(modes: Array, motion: Array) -> Array:
    """Return the displacements (P, K, 3) of K targets by motions (P, d)."""
    displacements: Array = np.einsum("kxa,pa->pkx", modes, motion)
    return displacements
