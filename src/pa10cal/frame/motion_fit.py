"""Motions of an instrument fitted to its readings of targets that are fixed to base or floor.

In each of P configurations a target k at b_k is read at b_k + s + w x (b_k - c), where s and w are
the small shift and turn of this configuration about the mean c of the targets. The places b_k are
the same in all. A motion has a normal prior of some size: for given places, sizes and noise of the
readings the model is linear and Gaussian, and its normal equations are block tridiagonal. Sizes and
noise are those of the largest evidence (marginal likelihood), and the form of motion is chosen by
it: "Targets on the base" of docs/instruments.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from pa10cal.arrays import Array, Mask
from pa10cal.frame.point_fits import by_small_motion
from pa10cal.numerics.least_squares import BlockTridiagonal
from pa10cal.rules import BASE_MOTION

#: `still`: no motion; `walk`: a random walk in time; `each`: every configuration by itself.
Form = Literal["still", "walk", "each"]

#: Rounds in which sizes of motions are sought about new places of the targets (computing).
_ROUNDS = 2
#: Configurations, about this many, from which sizes of motions are estimated (computing).
_MOST_FOR_SIZES = 600
#: Tolerances of the logarithms of sizes, and of the log evidence (computing).
_SIZE_TOLERANCES = {"xatol": 0.05, "fatol": 0.02}
#: Iterations of the places of targets, at most, until they move by less than this [m] (computing).
_MOST_ITERATIONS, _SAME_M = 30, 1e-9


@dataclass(frozen=True)
class TargetReadings:
    """Readings of K fixed targets in P configurations, in order of time."""

    step: Array  # (P - 1,) times between configurations over the median one
    p_m: Array  # (P, K, 3) readings in the instrument's frame, nan where not used
    u_m: Array  # (P, K, 3) their stated standard uncertainties
    about_m: Array  # (3,) mean of the targets, about which they turn
    # (K, 3, d) derivative of each target's reading by a motion: shift [m] and, if d is 6, turn
    # [rad]; turns are unknowns where most configurations show them
    by_motion: Array

    @classmethod
    def of(cls, time_s: Array, p_m: Array, u_m: Array) -> TargetReadings:
        """Return readings (P, K, 3) at ascending times (P,)."""
        between_s = np.diff(time_s)
        rising = between_s > 0.0
        usual_s = np.median(between_s[rising]) if rising.any() else 1.0
        places_m = mean_places(p_m)
        about_m = places_m.mean(axis=0)
        seen = np.isfinite(p_m[..., 0])
        turn_shown = share_of_configurations(seen, lambda used: _is_planar(places_m[used]))
        d = 6 if turn_shown >= BASE_MOTION.mostly_share else 3
        by_motion = by_small_motion(places_m - about_m)[..., :d]
        return cls(np.clip(between_s / usual_s, *BASE_MOTION.steps), p_m, u_m, about_m, by_motion)

    @property
    def components(self) -> int:
        """Return the number d of components of a motion, 3 or 6."""
        return int(self.by_motion.shape[2])

    @cached_property
    def seen(self) -> Mask:
        """Return which readings (P, K) are used."""
        return np.isfinite(self.p_m[..., 0])

    @cached_property
    def weight(self) -> Array:
        """Return the stated precision (P, K, 3) of each coordinate, 0 where not used."""
        return np.where(np.isfinite(self.p_m), np.nan_to_num(self.u_m, nan=1.0) ** -2.0, 0.0)

    @cached_property
    def information(self) -> Array:
        """Return the information (P, d, d) of each configuration's readings on its motion."""
        by = self.by_motion
        information: Array = np.einsum("kxa,pkx,kxb->pab", by, self.weight, by, optimize=True)
        return information

    def residual(self, places_m: Array) -> Array:
        """Return the readings minus places (K, 3) of their targets, (P, K, 3), 0 if not used."""
        return np.nan_to_num(self.p_m - places_m)

    def projected(self, residual: Array) -> Array:
        """Return residuals (P, K, 3) as right-hand sides (P, d) of normal equations of motions."""
        right: Array = np.einsum("kxa,pkx->pa", self.by_motion, self.weight * residual)
        return right

    def displacement(self, motion: Array) -> Array:
        """Return how far motions (P, d) move the targets, (P, K, 3)."""
        displacement: Array = np.einsum("kxa,pa->pkx", self.by_motion, motion)
        return displacement

    def without(self, excluded: Mask) -> TargetReadings:
        """Return the readings without some (P, K)."""
        return replace(self, p_m=np.where(excluded[..., None], np.nan, self.p_m))

    def thinned(self) -> TargetReadings:
        """Return every n-th configuration, so that about `_MOST_FOR_SIZES` remain."""
        every = max(1, len(self.p_m) // _MOST_FOR_SIZES)
        time = np.concatenate([[0.0], np.cumsum(self.step)])[::every]
        return replace(self, step=np.diff(time), p_m=self.p_m[::every], u_m=self.u_m[::every])


def mean_places(p_m: Array) -> Array:
    """Return the mean place (K, 3) of each target over its readings (P, K, 3).

    A target of which no reading is left weighs nothing: it gets the mean place of the others.
    """
    count = np.isfinite(p_m[..., 0]).sum(axis=0)
    places_m: Array = np.nansum(p_m, axis=0) / np.maximum(count, 1)[:, None]
    if count.any():
        places_m[count == 0] = places_m[count > 0].mean(axis=0)
    return places_m


def share_of_configurations(seen: Mask, suffices: Callable[[Mask], bool]) -> float:
    """Return the share of configurations (P, K) with any target whose targets suffice.

    Args:
        seen: (P, K) which targets are used in each.
        suffices: whether targets (K,) do.
    """
    patterns, counts = np.unique(seen[seen.any(axis=1)], axis=0, return_counts=True)
    enough = sum(int(n) for pattern, n in zip(patterns, counts, strict=True) if suffices(pattern))
    return enough / max(int(counts.sum()), 1)


def _is_planar(places_m: Array) -> bool:
    """Return whether targets (K, 3) are three or more, and not in line: they span a plane."""
    if len(places_m) < 3:
        return False
    extent_m = np.linalg.svd(places_m - places_m.mean(axis=0), compute_uv=False)
    return bool(extent_m[1] > BASE_MOTION.in_line * extent_m[0])


@dataclass(frozen=True)
class MotionFit:
    """A fit of one form of motion."""

    form: Form
    motion: Array  # (P, d) shift [m] and turn [rad]
    places_m: Array  # (K, 3) of the targets
    variance: float  # of a reading, over the stated one
    evidence: float  # log marginal likelihood of the readings, up to a constant of all forms
    # (d,) prior standard deviations: of a step of a walk, or of every motion by itself
    prior_std: Array
    normal: BlockTridiagonal | None = None  # normal equations of the motions; None where still

    def covariance(self) -> Array:
        """Return the covariance (P, d, d) of each motion."""
        if self.normal is None:
            return np.zeros((*self.motion.shape, self.motion.shape[1]))
        return self.normal.covariance()


def best_fit(readings: TargetReadings) -> MotionFit:
    """Return the fit of the form of motion with the largest evidence."""
    thinned = readings.thinned()
    # With one target, independent motions of the configurations cannot be told from noise.
    several = np.count_nonzero(readings.seen.any(axis=0)) > 1
    forms: list[Form] = ["walk", "each"] if several else ["walk"]
    moving = max((_moving(thinned, form) for form in forms), key=lambda fit: fit.evidence)
    if moving.evidence <= _still(thinned).evidence + BASE_MOTION.needed_nats:
        return _still(readings)
    return refitted(readings, moving)


def refitted(readings: TargetReadings, fit: MotionFit) -> MotionFit:
    """Return motions of the same form, sizes and noise as another fit, fitted to readings."""
    if fit.form == "still":
        return _still(readings)
    places_m = mean_places(readings.p_m)
    return _with_places(readings, fit.form, fit.prior_std, fit.variance, places_m)


def _still(readings: TargetReadings) -> MotionFit:
    """Return the fit without any motion."""
    places_m = mean_places(readings.p_m)
    square = float(np.sum(readings.residual(places_m) ** 2 * readings.weight))
    count = 3.0 * readings.seen.sum()
    variance = max(square / max(count, 1.0), np.finfo(float).tiny)
    motion = np.zeros((len(readings.p_m), readings.components))
    evidence = -0.5 * (square / variance + count * np.log(variance))
    return MotionFit("still", motion, places_m, variance, float(evidence), np.zeros(0))


def _moving(readings: TargetReadings, form: Form) -> MotionFit:
    """Return the fit of a form of motion, with the sizes and the noise of the largest evidence.

    The sizes are one of shifts and, if turns show, one of turns, in units of the usual uncertainty.
    They and the noise of readings are sought as logarithms, in turn with the places of the targets.
    """
    from scipy.optimize import minimize  # late: it takes long to load

    usual_m = float(np.nanmedian(readings.u_m))
    units = np.full(readings.components, usual_m)
    if readings.components == 6:
        units[3:] /= float(np.sqrt(np.mean(readings.by_motion[:, :, 3:] ** 2)))
    size_count = readings.components // 3
    log_sizes_and_noise = np.zeros(size_count + 1)

    def prior_std_and_variance(x: Array) -> tuple[Array, float]:
        log_sizes, log_noise = np.split(np.clip(x, *BASE_MOTION.sizes), [size_count])
        return units * np.exp(np.repeat(log_sizes, 3)), float(np.exp(2.0 * log_noise[0]))

    fit = _still(readings)
    for _ in range(_ROUNDS):
        places_m = fit.places_m

        def negative_evidence(x: Array, places_m: Array = places_m) -> float:
            return -_at_places(readings, form, *prior_std_and_variance(x), places_m).evidence

        start = log_sizes_and_noise
        options: Any = {
            **_SIZE_TOLERANCES,
            "initial_simplex": np.vstack([start, start - np.eye(len(start))]),
        }
        found = minimize(negative_evidence, start, method="Nelder-Mead", options=options)
        log_sizes_and_noise = found.x
        fit = _with_places(readings, form, *prior_std_and_variance(found.x), places_m)
    return fit


def _with_places(
    readings: TargetReadings, form: Form, prior_std: Array, variance: float, places_m: Array
) -> MotionFit:
    """Return motions and places of the targets, each for the other in turn; see `_at_places`.

    Args:
        places_m: (K, 3) places to start from.
    """
    fit = _at_places(readings, form, prior_std, variance, places_m)
    for _ in range(_MOST_ITERATIONS):
        places_m = mean_places(readings.p_m - readings.displacement(fit.motion))
        change_m = float(np.abs(places_m - fit.places_m).max())
        fit = _at_places(readings, form, prior_std, variance, places_m)
        if change_m < _SAME_M:
            break
    return fit


def _at_places(
    readings: TargetReadings, form: Form, prior_std: Array, variance: float, places_m: Array
) -> MotionFit:
    """Return the motions for given places (K, 3), and their evidence.

    The log evidence is half of: log|prior precision| - log|posterior precision| + r'm - chi-square
    - log|covariance of the readings|, with r the right-hand side and m the motions that solve it.

    Args:
        prior_std: (d,) and
        variance: see `MotionFit`.
    """
    residual = readings.residual(places_m)
    right = readings.projected(residual) / variance
    count, d = len(residual), len(prior_std)
    information = readings.information / variance
    prior, coupling = np.zeros((count, d)), np.zeros((count - 1, d))
    if form == "walk":
        coupling = 1.0 / (readings.step[:, None] * prior_std**2)
        prior[:-1] += coupling
        prior[1:] += coupling
        # The start of a walk has no prior: the places of the targets determine it.
        of_start = float(np.linalg.slogdet(information.sum(axis=0))[1])
        prior_log_determinant = float(np.sum(np.log(coupling))) + of_start
    else:
        prior += prior_std**-2.0
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
    return MotionFit(form, motion, places_m, variance, float(evidence), prior_std, normal)
