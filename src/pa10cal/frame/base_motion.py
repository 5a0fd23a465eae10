"""How an instrument moved between readings, from targets that are fixed to the base or the floor.

Wrong readings and knocked targets are excluded (`knocked_targets`), the form of motion is chosen
and fitted (`motion_fit`), and motions that are badly known are omitted: "Targets on the base" of
docs/instruments.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from pa10cal.arrays import Array, Mask
from pa10cal.frame import knocked_targets
from pa10cal.frame.motion_fit import (
    Form,
    MotionFit,
    TargetReadings,
    best_fit,
    refitted,
    share_of_configurations,
)
from pa10cal.frame.point_fits import by_small_motion
from pa10cal.rules import BASE_MOTION

#: Rounds in which outliers of a fit are excluded (computing).
_ROUNDS = 2
#: Standard deviation of a motion that counts as zero [m, rad] (computing).
_NO_MOTION = 1e-12


@dataclass(frozen=True)
class BaseMotion:
    """How K fixed targets moved together in P readings, as an instrument saw them."""

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
    ever_seen: Mask = np.asarray(np.isfinite(p_m[..., 0]).any(axis=0))
    if not ever_seen.all():
        of_seen = common_motion(time_s, p_m[:, ever_seen], u_m[:, ever_seen])
        return _of_all_targets(of_seen, ever_seen)
    wrong = knocked_targets.wrong_by_themselves(p_m, u_m)
    knocked, kept_m = knocked_targets.without_knocked(np.where(wrong[..., None], np.nan, p_m), u_m)
    wrong_shape = knocked_targets.wrong_in_shape(kept_m, u_m)
    kept_m[wrong_shape] = np.nan
    all_kept = TargetReadings.of(time_s, kept_m, u_m)
    readings, fit = _without_outliers(all_kept)
    motion, cov = np.zeros((len(p_m), 6)), np.zeros((len(p_m), 6, 6))
    d = readings.components
    if fit.form != "still":
        motion[:, :d], cov[:, :d, :d] = _well_known_motion(readings, fit)
        cov[:, d:, d:] = _hidden_turn_variance(readings, fit) * np.eye(6 - d)
    moves = bool(motion.any())
    return BaseMotion(
        form=fit.form if moves else "still",
        about_m=readings.about_m,
        motion=motion,
        cov=cov if moves else np.zeros_like(cov),
        noise=float(np.sqrt(fit.variance)),
        turns=d == 6,
        knocked=knocked,
        wrong=wrong | wrong_shape | (all_kept.seen & ~readings.seen),
        used=readings.seen,
    )


def _of_all_targets(found: BaseMotion, ever_seen: Mask) -> BaseMotion:
    """Return the motion by the targets that were ever seen (K,), numbered among all targets."""
    number = np.flatnonzero(ever_seen)
    wrong = np.zeros((len(found.used), len(ever_seen)), dtype=bool)
    used = wrong.copy()
    wrong[:, ever_seen] = found.wrong
    used[:, ever_seen] = found.used
    knocked = tuple(
        replace(each, targets=tuple(int(number[k]) for k in each.targets)) for each in found.knocked
    )
    return replace(found, wrong=wrong, used=used, knocked=knocked)


def _without_outliers(readings: TargetReadings) -> tuple[TargetReadings, MotionFit]:
    """Return the readings without outliers of the best fit, and the fit to them."""
    fit = best_fit(readings)
    for _ in range(_ROUNDS):
        outliers = _outliers(readings, fit)
        if not outliers.any():
            break
        readings = readings.without(outliers)
        fit = refitted(readings, fit)
    return readings, fit


def _outliers(readings: TargetReadings, fit: MotionFit) -> Mask:
    """Return the outliers (P, K) of a fit; in each configuration at most the furthest one."""
    residual_m = np.nan_to_num(readings.p_m - fit.places_m - readings.displacement(fit.motion))
    # Readings that agree better than stated are no reason to reject one within its uncertainty.
    square = np.sum(residual_m**2 * readings.weight, axis=2) / max(fit.variance, 1.0)
    limit = chdtri(3, BASE_MOTION.error_rate / max(int(readings.seen.sum()), 1))
    furthest = square == square.max(axis=1, keepdims=True)
    outliers: Mask = (square > limit) & furthest
    return outliers


def _well_known_motion(readings: TargetReadings, fit: MotionFit) -> tuple[Array, Array]:
    """Return motions (P, d) and their covariance, zero along directions that are badly known.

    A motion that is omitted costs its spread over all configurations. Along the principal
    directions of the covariance relative to that spread a motion is omitted if its variance is 1 or
    more; its variance is 1 then.
    """
    motion, cov = fit.motion - fit.motion.mean(axis=0), fit.covariance()
    spread = _spread_of_motions(readings, fit)
    if spread is None:
        return np.zeros_like(motion), np.zeros_like(cov)
    root = np.linalg.cholesky(spread + _NO_MOTION**2 * np.eye(readings.components))
    whitener = np.linalg.inv(root)
    variances, axes = np.linalg.eigh(whitener @ cov @ whitener.T)
    along = np.einsum("pji,jk,pk->pi", axes, whitener, motion)
    along[variances >= 1.0] = 0.0
    variances = np.minimum(variances, 1.0)
    directions = root @ axes
    bounded = np.einsum("pai,pi,pbi->pab", directions, variances, directions)
    return np.einsum("pai,pi->pa", directions, along), bounded


def _spread_of_motions(readings: TargetReadings, fit: MotionFit) -> Array | None:
    """Return the covariance (d, d) of motions over configurations; None where none shows its own.

    It is that of the motions that configurations show by themselves, which are spread a little
    more.
    """
    complete: Mask = np.asarray(readings.seen.any(axis=1))
    condition = np.linalg.cond(readings.information[complete])
    complete[complete] = condition < BASE_MOTION.condition
    if not complete.any():
        return None
    right = readings.projected(readings.residual(fit.places_m))[complete]
    by_themselves = np.linalg.solve(readings.information[complete], right[..., None])[..., 0]
    d = readings.components
    return np.asarray(np.cov(by_themselves.T, bias=True).reshape(d, d))


def _hidden_turn_variance(readings: TargetReadings, fit: MotionFit) -> float:
    """Return the variance of turns [rad^2], per axis, where the targets do not show turns."""
    pairs = share_of_configurations(readings.seen, lambda used: bool(used.sum() > 1))
    if pairs >= BASE_MOTION.mostly_share:
        return _turn_variance_of_line(readings, fit)
    # One target shows none: then all of its shift may be due to an instrument that turns where it
    # stands, at the distance of the target.
    shift_m2 = float(np.mean(np.sum(fit.motion**2, axis=1)))
    distance_m = max(float(np.linalg.norm(readings.about_m)), BASE_MOTION.near_m)
    return shift_m2 / (2.0 * distance_m**2)


def _turn_variance_of_line(readings: TargetReadings, fit: MotionFit) -> float:
    """Return the variance of turns [rad^2], per axis, by targets in line.

    They show turns across their line; turns about it are assumed as large. Of the mean square of
    turns the part that noise explains is taken off, but for its own standard error.
    """
    rows = readings.seen.sum(axis=1) > 1
    square, dof = knocked_targets.misfits(readings.p_m, readings.u_m, fit.places_m)
    noise = float(square.sum() / max(dof.sum(), 1))
    by_turn = by_small_motion(fit.places_m - readings.about_m)[..., 3:]
    weight = readings.weight[rows]
    information = np.einsum("kxa,pkx,kxb->pab", by_turn, weight, by_turn, optimize=True)
    residual_m = np.nan_to_num(readings.p_m - fit.places_m - readings.displacement(fit.motion))
    cofactor = np.linalg.pinv(information, rcond=BASE_MOTION.in_line**2, hermitian=True)
    right = np.einsum("kxa,pkx->pa", by_turn, weight * residual_m[rows])
    turn = np.einsum("pab,pb->pa", cofactor, right)
    # Two components across the line show; the noise makes `expected` of their mean square.
    expected = 0.5 * noise * float(np.mean(np.trace(cofactor, axis1=1, axis2=2)))
    shown = 0.5 * float(np.mean(np.sum(turn**2, axis=1)))
    return max(shown - expected, 0.0) + expected / float(np.sqrt(rows.sum()))
