"""Whether readings of single targets wander in time, each by itself, and not all targets together.

A motion of the instrument or the base moves all targets as one rigid body and leaves their mutual
distances alone. Errors of single readings that last for some poses, as those by turbulent air, show
in these distances in proportion. So what a model leaves of each pose is split into the part that a
small motion of the base makes and the rest, and covariances of either between poses that follow
each other in time are compared, per degree of freedom.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pa10cal.arrays import Array
from pa10cal.discovery import jacobians
from pa10cal.discovery.jacobians import WhitenedPoses
from pa10cal.discovery.rules import BLOCKS, MOTION
from pa10cal.discovery.tuning import COMPUTING
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.position_errors import position_noise_m2
from pa10cal.fit.rows_about_fit import less_far_off
from pa10cal.observe.observations import Observations
from pa10cal.results.number_text import duration_text
from pa10cal.terms.effects.effect import Effect


@dataclass(frozen=True)
class TargetWander:
    """Errors of single readings that last for some poses, independent from target to target."""

    rms_mm: float  # their root mean square, as a position error
    lasting_s: float  # time in which their correlation falls to 1/e


def in_words(found: TargetWander | None) -> str | None:
    """Return what a reader is told of it; None where nothing wanders."""
    if found is None:
        return None
    return (
        f"readings of single targets wander in time by {found.rms_mm:.2g} mm (root mean square), "
        f"each by itself for about {duration_text(found.lasting_s)}: distances between targets "
        "change as much as all of them move together, so this is no motion of the "
        "instrument or the base; means of readings that follow each other are less certain than "
        "independent noise would make them"
    )


def target_wander(at: FittedModel, poses: Observations, residual: Array) -> TargetWander | None:
    """Return how single targets wander; None where they do not, or move together by more.

    Nothing is found with a single target or with poses, where a motion of the base makes any error,
    nor in a group of campaigns or where times were not recorded.

    Args:
        at: the model, with small motions of the base.
        poses: P complete poses.
        residual: (P, b) predicted less measured components.
    """
    most_lag = len(poses) // (2 * BLOCKS.drift_waves)  # a quarter of the fastest wave
    if not (most_lag and poses.states.tells_time) or poses.states.campaign is not None:
        return None
    rows = rows_in_time(at, poses, residual)
    rigid, rest = _projectors(rows)
    if not rest.any():
        return None
    single = _Lagged.of(_without_pattern(rows, rest), rest, most_lag)
    common = _Lagged.of((rigid @ rows.data[:, :, None])[:, :, 0], rigid, most_lag)
    by_chance = single.variance / np.sqrt(single.slow_freedom)
    least = max(MOTION.single_errors * by_chance, MOTION.single_share * common.slow_covariance)
    if not single.slow_covariance > least:
        return None
    return TargetWander(
        rms_mm=float(np.sqrt(max(single.covariance[0], 0.0))) * _stated_mm(poses),
        lasting_s=_lasting_s(single.covariance, rows.poses.states.time_s),
    )


def wander_instead_of(
    drift: Effect, at: FittedModel, poses: Observations, residual: Array
) -> TargetWander | None:
    """Return how single targets wander where a drift of the base is left in what they leave.

    None where the drift moves all targets together by more than they wander by themselves.

    Args:
        drift: shifts of the base, a term of the model.
        at: the model.
        poses: P complete poses.
        residual: (P, b) predicted by the model less measured components.
    """
    shift_m = drift.shift(poses.states, at.values_of(drift))
    moved_m = shift_m - shift_m.mean(axis=0)  # a base that stands still is fitted to all poses
    by_drift = (jacobians.by_base(at, poses)[:, :, :3] @ moved_m[:, :, None])[:, :, 0]
    return target_wander(at, poses, residual - by_drift)


def rows_in_time(at: FittedModel, poses: Observations, residual: Array) -> WhitenedPoses:
    """Return poses in order of time, over the uncertainty stated of each component by itself.

    Weights by the scatter of the residuals would hide a common motion: joints that scatter move all
    targets together, too. Poses far outside the others weigh less.
    """
    root = np.sqrt(np.diagonal(poses.measured.stated_covariance, axis1=1, axis2=2))
    weight = less_far_off(poses.measured, residual / root)
    whitener = (weight[:, None] / root)[:, :, None] * np.eye(root.shape[1])
    order = np.argsort(poses.states.time_s, kind="stable")
    return WhitenedPoses(at, poses, residual, whitener).take(order)


class _Lagged(NamedTuple):
    """Products of a part of the components of poses with those of later poses, by lag in poses."""

    products: Array  # (L + 1,) their sums over all pairs of poses, from lag 0 on
    freedom: Array  # (L + 1,) what these sums would be with a covariance of one

    @classmethod
    def of(cls, part: Array, projector: Array, most_lag: int) -> _Lagged:
        """Return the products of a part (P, b) of which projectors (P, b, b) are the covariance."""
        freedom = np.maximum(_lagged_products(projector, most_lag), 1.0)
        return cls(_lagged_products(part, most_lag), freedom)

    @property
    def covariance(self) -> Array:
        """Return the covariance at lags 1 to L, (L,)."""
        return np.asarray(self.products[1:] / self.freedom[1:])

    @property
    def variance(self) -> float:
        return float(self.products[0] / self.freedom[0])

    @property
    def slow_freedom(self) -> float:
        return float(self.freedom[1:].sum())

    @property
    def slow_covariance(self) -> float:
        """Return the covariance over all lags."""
        return float(self.products[1:].sum()) / self.slow_freedom


def _lagged_products(values: Array, most_lag: int) -> Array:
    """Return the sums of the products of rows with later rows, by their lag from 0 on, (L + 1,)."""
    flat = values.reshape(len(values), -1)
    lags = range(most_lag + 1)
    return np.array([np.vdot(flat[lag:], flat[: len(flat) - lag]) for lag in lags])


def _projectors(rows: WhitenedPoses) -> tuple[Array, Array]:
    """Return projectors (P, b, b) on what motions of the base make of a pose, and on the rest."""
    by_motion = rows.whitener @ jacobians.by_base(rows.at, rows.poses)
    rigid = by_motion @ np.linalg.pinv(by_motion, rcond=COMPUTING.least_singular)
    seen = rows.poses.measured.components_seen
    rest = seen[:, :, None] * np.eye(seen.shape[1]) - rigid
    rest[np.rint(np.trace(rest, axis1=1, axis2=2)) == 0.0] = 0.0  # without degrees of freedom
    return rigid, rest


def _without_pattern(rows: WhitenedPoses, rest: Array) -> Array:
    """Return the rest of each pose (P, b) without what wrong places of the targets make of it."""
    by_targets = rest @ rows.by_targets
    columns = by_targets.reshape(-1, by_targets.shape[2])
    data = (rest @ rows.data[:, :, None]).ravel()
    places = np.linalg.lstsq(columns, data, rcond=COMPUTING.least_singular)[0]
    return np.asarray(data - columns @ places).reshape(rest.shape[:2])


def _stated_mm(poses: Observations) -> float:
    """Return the usual position error by the stated uncertainty."""
    noise_m2 = position_noise_m2(poses.measured, poses.measured.stated_covariance)
    return 1e3 * float(np.sqrt(np.median(np.trace(noise_m2, axis1=1, axis2=2))))


def _lasting_s(covariance: Array, time_s: Array) -> float:
    """Return the time in which a covariance at lags 1 to L falls to 1/e, or that of lag L."""
    below = np.flatnonzero(covariance < covariance[0] / np.e)
    lag = int(below[0]) + 1 if len(below) else len(covariance)
    return float(np.median(time_s[lag:] - time_s[:-lag]))
