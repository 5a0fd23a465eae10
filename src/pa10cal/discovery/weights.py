"""Weights of poses: stated uncertainty, scatter of the residuals, and less far outside.

A pose is weighted by the covariance that the instrument states, brought to the scatter that a model
leaves: what the model lacks scatters like noise, and positions and attitudes are to weigh by what
the data really have. A pose far outside that scatter weighs less (Huber); none is omitted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.special import chdtri

from pa10cal.arrays import Array, Index
from pa10cal.discovery.linear import by_joints, position_m
from pa10cal.discovery.noise import MEDIAN_TO_SIGMA
from pa10cal.fit.fitted import TOOL_FRAME
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.forward import Forward
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations

#: Share of undisturbed poses that weigh less than fully.
_HUBER_TAIL = 1e-3
#: Stated uncertainties are brought down by no more than this: data without noise have no scatter.
_MOST_SHRINK = 1e-3


@dataclass(frozen=True)
class PoseWeights:
    """Whitening and weights of P poses."""

    whitener: Array  # (P, b, b) makes the residuals of each pose independent and of unit size
    weight: Array  # (P,) 1, or less far outside the scatter

    def whiteners(self, rows: Index) -> Array:
        """Return the whiteners of some poses times the roots of their weights."""
        found: Array = np.sqrt(self.weight[rows])[:, None, None] * self.whitener[rows]
        return found

    def widened(self, by: Widening) -> PoseWeights:
        """Return the weights of poses whose components scatter otherwise than by their median."""
        if by == AS_FOUND:
            return self
        scale = np.full(self.whitener.shape[1], by.attitudes)
        scale[list(by.positions)] = 1.0
        return replace(self, whitener=self.whitener * (scale / by.scatter)[:, None])


@dataclass(frozen=True)
class Widening:
    """By how much components scatter otherwise than the median of what is left says."""

    scatter: float = 1.0  # of all of them, in that of the median
    # weight of what is no position, in that of its scatter: errors that go with the pose do not
    # average out, however many poses there are
    attitudes: float = 1.0
    positions: tuple[int, ...] = ()  # columns of positions


AS_FOUND = Widening()


def unweighted(measured: Instrument) -> PoseWeights:
    """Return the weights by what the instrument states alone."""
    stated = measured.stated_covariance
    return PoseWeights(np.linalg.inv(np.linalg.cholesky(stated)), np.ones(len(stated)))


def pose_weights(residual: Array, dof: float, measured: Instrument) -> PoseWeights:
    """Weigh poses by what a model leaves of them.

    Args:
        residual: (P, b) what remains of the components.
        dof: parameters that the data determine, which the residuals are smaller by.
        measured: states the covariance of the components, and which were seen.
    """
    stated, seen = measured.stated_covariance, measured.components_seen
    rows = int(seen.sum())
    inflate = rows / max(rows - dof, 0.5 * rows)
    covariance = stated.copy()
    for _, kind in measured.component_kinds:
        here = seen[:, kind]
        found = inflate * (MEDIAN_TO_SIGMA * np.median(np.abs(residual[:, kind][here]))) ** 2
        variances = np.diagonal(stated[:, kind, kind], axis1=1, axis2=2)
        said = float(np.median(variances[here]))
        if found < said:
            shrink = max(np.sqrt(found / said), _MOST_SHRINK)
            covariance[:, kind] *= shrink
            covariance[:, :, kind] *= shrink
        else:
            at = range(residual.shape[1])[kind]
            covariance[:, at, at] += (found - said) * here
    whitener = np.linalg.inv(np.linalg.cholesky(covariance))
    distance = np.linalg.norm((whitener @ residual[:, :, None])[:, :, 0], axis=1)
    limit = np.sqrt(chdtri(np.maximum(seen.sum(axis=1), 1), _HUBER_TAIL))
    return PoseWeights(whitener, np.minimum(1.0, limit / np.maximum(distance, limit)))


# What single poses scatter by: where joints come to stand, and the instrument.
#
# A controller stops a joint where friction lets it, some ten microradians from where it is told,
# and all directions that the joint moves are off together. What poses are left with by a model is
# split into a scatter of every joint's position and one of every kind of component, by maximum
# likelihood. With the uncertainty of the model it makes the interval in which a measured pose is
# to be expected.

#: Poses that say enough.
_ENOUGH_POSES = 1500
#: Variances are found between these, in [rad²], [m²].
_LEAST, _MOST = 1e-14, 1e-4
#: Standard deviations between which 95 of 100 lie.
INSIDE95 = 1.96


@dataclass(frozen=True, eq=False)
class Scatter:
    """Standard deviations of single poses about a model."""

    joints: Array  # (n,) of joint positions [rad, m]
    kinds: Mapping[str, float]  # of each kind of component, by its name [m, rad]

    def covariance(self, at: FittedModel, poses: Observations) -> Array:
        """Return the covariance of the components of poses, (P, b, b)."""
        turned = by_joints(at, poses, range(1, at.arm.n + 1)) * self.joints
        found = turned @ np.swapaxes(turned, 1, 2)
        for name, kind in poses.measured.component_kinds:
            own = np.arange(found.shape[1])[kind]
            found[:, own, own] += self.kinds[name] ** 2
        return np.asarray(found, dtype=np.float64)


def scatter_of(at: FittedModel, poses: Observations, left: Array) -> Scatter:
    """Return what poses scatter by about a model.

    Args:
        at: the model.
        poses: P complete poses of its fit.
        left: (P, b) what it leaves of their components.
    """
    every = max(1, len(poses) // _ENOUGH_POSES)
    poses, left = poses.take(np.arange(0, len(poses), every)), left[::every]
    turned = by_joints(at, poses, range(1, at.arm.n + 1))
    parts = [each[:, :, None] * each[:, None, :] for each in np.moveaxis(turned, 2, 0)]
    components = left.shape[1]
    for _, kind in poses.measured.component_kinds:
        own = np.zeros(components)
        own[kind] = 1.0
        parts.append(np.diag(own)[None])
    seen = poses.measured.components_seen
    unseen = np.where(seen, 0.0, 1.0)[:, :, None] * np.eye(components)
    both = seen[:, :, None] & seen[:, None, :]
    parts = [np.where(both, part, 0.0) for part in parts]
    left = np.where(seen, left, 0.0)

    def cost(logs: Array) -> tuple[float, Array]:
        sizes = np.exp(logs)
        covariance = unseen + sum(size * part for size, part in zip(sizes, parts, strict=True))
        inverse = np.linalg.inv(covariance)
        white = (inverse @ left[:, :, None])[:, :, 0]
        value = np.linalg.slogdet(covariance)[1].sum() + np.sum(white * left)
        slope = inverse - white[:, :, None] * white[:, None, :]
        by_size = np.array([np.sum(slope * part) for part in parts])
        return float(value) / len(left), sizes * by_size / len(left)

    of_kinds = _by_kind(poses.measured, left)
    start = np.log(np.concatenate([np.full(turned.shape[2], 1e-9), of_kinds]))
    found = minimize(
        cost,
        start,
        jac=True,
        method="L-BFGS-B",
        bounds=[(np.log(_LEAST), np.log(_MOST))] * len(start),
        options={"maxiter": 60},
    )
    sizes = np.exp(0.5 * found.x)
    names = [name for name, _ in poses.measured.component_kinds]
    found_kinds = sizes[turned.shape[2] :].tolist()
    return Scatter(sizes[: turned.shape[2]], dict(zip(names, found_kinds, strict=True)))


def share_inside(
    fitted: FittedModel, scatter: Scatter, poses: Observations, left: Array | None = None
) -> float:
    """Return how many coordinates of measured positions lie in their 95 % intervals.

    Args:
        fitted: a model with its covariance.
        scatter: of single poses.
        poses: P complete poses.
        left: (P, b) predicted less measured; None to predict them.
    """
    left = fitted.compared(poses).residual if left is None else left
    of_poses = scatter.covariance(fitted, poses)
    off_m, variance = position_m(fitted, poses, left, of_poses)
    forward = Forward.of(fitted, TOOL_FRAME)
    R = fitted.T_instr_base[:3, :3]
    own = R @ forward.position_covariance(poses.states, forward.end(poses.states)) @ R.T
    total = variance + np.diagonal(own, axis1=1, axis2=2)
    seen = np.isfinite(off_m) & (total > 0.0)
    inside = np.abs(off_m[seen]) <= INSIDE95 * np.sqrt(total[seen])
    return float(inside.mean())


def _by_kind(measured: Instrument, left: Array) -> Array:
    """Return half the mean square of every kind of component."""
    seen = measured.components_seen
    return np.array(
        [
            max(0.5 * float(np.mean(left[:, kind][seen[:, kind]] ** 2)), _LEAST)
            for _, kind in measured.component_kinds
        ]
    )
