"""Scatter of single poses about a model, and the weights that it gives them in a fit.

The covariance that the instrument states is scaled to the scatter of the residuals, for each kind
of component, as an incomplete model leaves residuals that scatter like noise. A pose far outside
that scatter weighs less (Huber); none is omitted.

A controller stops a joint where friction lets it, some ten microradians from its command; such an
error moves all components of a pose together. So residuals are split into a variance of each
joint's position and one of each kind of component, by maximum likelihood. With the uncertainty of
the model they give the interval in which a measured pose is expected.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.special import chdtri

from pa10cal.arrays import Array, Index, Mask, drawn
from pa10cal.discovery.jacobians import by_joints
from pa10cal.discovery.rules import NOISE
from pa10cal.discovery.tuning import COMPUTING
from pa10cal.fit.fitted import TOOL_FRAME
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.forward import Forward
from pa10cal.fit.position_errors import position_errors_along_axes, seen_along_axes
from pa10cal.numerics.covariances import whitener_of
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.results.number_text import HALF_WIDTH_95


@dataclass(frozen=True)
class PoseWeights:
    """Whitening and weights of P poses."""

    whitener: Array  # (P, b, b) makes the residuals of each pose independent and of unit size
    weight: Array  # (P,) 1, or less far outside the scatter

    def whiteners(self, rows: Index | slice = slice(None)) -> Array:
        """Return the whiteners of all or some poses, times the square roots of their weights."""
        return np.asarray(np.sqrt(self.weight[rows])[:, None, None] * self.whitener[rows])

    def widened(self, by: Widening) -> PoseWeights:
        """Return the weights with the scatter changed by a widening."""
        if by == AS_FOUND:
            return self
        scale = np.full(self.whitener.shape[1], by.attitude_root_weight)
        scale[list(by.position_columns)] = 1.0
        return replace(self, whitener=self.whitener * (scale / by.scatter)[:, None])


@dataclass(frozen=True)
class Widening:
    """How weights change from those that the median residual gives."""

    scatter: float = 1.0  # factor on the scatter of all components, which lowers their weight
    # factor on the root weight of orientations: their errors follow the pose, and do not average
    # out over many poses
    attitude_root_weight: float = 1.0
    position_columns: tuple[int, ...] = ()  # columns that are no orientations


AS_FOUND = Widening()


def unweighted(measured: Instrument) -> PoseWeights:
    """Return weights by the covariance that the instrument states."""
    stated = measured.stated_covariance
    return PoseWeights(whitener_of(stated), np.ones(len(stated)))


def pose_weights(residual: Array, fitted_count: float, measured: Instrument) -> PoseWeights:
    """Return weights of poses by the residual (P, b) of a model.

    Args:
        fitted_count: number of parameters fitted, by which residuals are smaller than errors.
        measured: states the covariance of the components, and which were seen.
    """
    stated, seen = measured.stated_covariance, measured.components_seen
    seen_count = int(seen.sum())
    if not seen_count:
        return unweighted(measured)
    inflate = seen_count / max(seen_count - fitted_count, NOISE.least_left_share * seen_count)
    if measured.inverse:  # all components are uncertain together
        whitener = whitener_of(stated)
        white = (whitener @ residual[:, :, None])[:, :, 0]
        size = np.sqrt(inflate) * NOISE.median_to_sigma * float(np.median(np.abs(white)))
        return _weighed(whitener / max(size, NOISE.least_shrink), residual, seen)
    covariance = stated.copy()
    for _, kind in measured.component_kinds:
        here = seen[:, kind]
        if not here.any():
            continue
        variance = (
            inflate * (NOISE.median_to_sigma * np.median(np.abs(residual[:, kind][here]))) ** 2
        )
        variances = np.diagonal(stated[:, kind, kind], axis1=1, axis2=2)
        stated_variance = float(np.median(variances[here]))
        if variance < stated_variance:
            shrink = max(np.sqrt(variance / stated_variance), NOISE.least_shrink)
            covariance[:, kind] *= shrink
            covariance[:, :, kind] *= shrink
        else:
            at = range(residual.shape[1])[kind]
            covariance[:, at, at] += (variance - stated_variance) * here
    return _weighed(whitener_of(covariance), residual, seen)


def _weighed(whitener: Array, residual: Array, seen: Mask) -> PoseWeights:
    """Return a whitener with the weights of poses by their residual (P, b)."""
    distance = np.linalg.norm((whitener @ residual[:, :, None])[:, :, 0], axis=1)
    limit = np.sqrt(chdtri(np.maximum(seen.sum(axis=1), 1), NOISE.huber_tail))
    return PoseWeights(whitener, np.minimum(1.0, limit / np.maximum(distance, limit)))


def weights_with_joints(
    weights: PoseWeights, at: FittedModel, poses: Observations, residual: Array
) -> PoseWeights:
    """Return weights of poses whose whitener knows what an error of a joint does.

    Such an error moves all components of a pose together: counted one by one, they would show
    whatever is sought in them too surely. Poses are as `preparation.complete` makes them, with the
    torques at their joints; the residual is (P, b).
    """
    covariance = scatter_of(at, poses, residual).covariance(at, poses)
    return replace(weights, whitener=whitener_of(covariance))


@dataclass(frozen=True, eq=False)
class PoseDeviations:
    """Standard deviations of single poses about a model."""

    joints: Array  # (n,) of joint positions [rad, m]
    kinds: Mapping[str, float]  # of each kind of component, by its name [m, rad]

    def covariance(self, at: FittedModel, poses: Observations) -> Array:
        """Return the covariance of the components of poses, (P, b, b).

        A kind of component that these deviations were not fitted to has its stated variance.
        """
        moved = by_joints(at, poses, range(1, at.arm.n + 1)) * self.joints
        covariance = np.asarray(moved @ np.swapaxes(moved, 1, 2), dtype=np.float64)
        stated = np.diagonal(poses.measured.stated_covariance, axis1=1, axis2=2)
        for name, kind in poses.measured.component_kinds:
            columns = np.arange(covariance.shape[1])[kind]
            known = self.kinds.get(name)
            covariance[:, columns, columns] += stated[:, kind] if known is None else known**2
        return covariance


def _enough(poses: Observations) -> Index:
    """Return the rows of poses that suffice for their scatter: all, or some drawn of each kind.

    They are not every n-th, as rows may alternate between kinds of pose. In a group of campaigns
    those of a small one are among them, too.
    """
    most = len(poses) // max(1, len(poses) // NOISE.enough_poses)
    rows, seen = [drawn(len(poses), most)], poses.measured.components_seen
    kinds = poses.measured.component_kinds
    for _, kind in kinds:
        of_kind = np.flatnonzero(seen[:, kind].any(axis=1))
        rows.append(of_kind[drawn(len(of_kind), most // len(kinds))])
    return np.unique(np.concatenate(rows))


def scatter_of(at: FittedModel, poses: Observations, residual: Array) -> PoseDeviations:
    """Return the scatter of the poses of a fit, by their residual (P, b).

    Poses are as `preparation.complete` makes them.
    """
    rows = _enough(poses)
    poses, residual = poses.take(rows), residual[rows]
    by_joint = by_joints(at, poses, range(1, at.arm.n + 1))
    # Covariances (P, b, b) by a unit variance of each joint, then of each kind of component.
    units = [moved[:, :, None] * moved[:, None, :] for moved in np.moveaxis(by_joint, 2, 0)]
    seen, identity = poses.measured.components_seen, np.eye(residual.shape[1])
    units += [
        np.diag(identity[kind].sum(axis=0))[None] for _, kind in poses.measured.component_kinds
    ]
    unseen = np.where(seen, 0.0, 1.0)[:, :, None] * identity
    both = seen[:, :, None] & seen[:, None, :]
    units = [np.where(both, unit, 0.0) for unit in units]
    residual = np.where(seen, residual, 0.0)

    def cost(logs: Array) -> tuple[float, Array]:
        variances = np.exp(logs)
        covariance = unseen + sum(size * unit for size, unit in zip(variances, units, strict=True))
        inverse = np.linalg.inv(covariance)
        white = (inverse @ residual[:, :, None])[:, :, 0]
        value = np.linalg.slogdet(covariance)[1].sum() + np.sum(white * residual)
        slope = inverse - white[:, :, None] * white[:, None, :]
        by_variance = np.array([np.sum(slope * unit) for unit in units])
        return float(value) / len(residual), variances * by_variance / len(residual)

    of_kinds = {  # to begin with: half the mean square of each kind
        name: max(float(np.mean(residual[:, kind][seen[:, kind]] ** 2)) / 2.0, NOISE.variances[0])
        for name, kind in poses.measured.component_kinds
    }
    start = np.log(np.concatenate([np.full(at.arm.n, NOISE.first_variance), [*of_kinds.values()]]))
    found = minimize(
        cost,
        start,
        jac=True,
        method="L-BFGS-B",
        bounds=[(np.log(NOISE.variances[0]), np.log(NOISE.variances[1]))] * len(start),
        options={"maxiter": COMPUTING.noise_steps},
    )
    std = np.exp(0.5 * found.x)
    return PoseDeviations(
        std[: at.arm.n], dict(zip(of_kinds, std[at.arm.n :].tolist(), strict=True))
    )


def share_inside(
    fitted: FittedModel, scatter: PoseDeviations, poses: Observations, residual: Array | None = None
) -> float:
    """Return the share of coordinates of measured positions that lie in their 95 % intervals.

    They are along the instrument's axes; of an instrument of distances, along the line of sight.
    The model has a covariance; its residual (P, b) is computed if it is not given.
    """
    residual = fitted.compared(poses).residual if residual is None else residual
    of_poses = scatter.covariance(fitted, poses)
    off_m, of_scatter_m2 = position_errors_along_axes(fitted, poses, residual, of_poses)
    forward = Forward.of(fitted, TOOL_FRAME)
    # What the instrument sees of an error of the model's position, as it sees the error itself.
    by_base = seen_along_axes(fitted, poses) @ fitted.T_instr_base[:3, :3]
    of_position_m2 = forward.position_covariance(poses.states, forward.end(poses.states))
    of_model_m2 = np.einsum("pik,pkl,pil->pi", by_base, of_position_m2, by_base, optimize=True)
    variance_m2 = of_scatter_m2 + of_model_m2
    seen = np.isfinite(off_m) & (variance_m2 > 0.0)
    inside = np.abs(off_m[seen]) <= HALF_WIDTH_95 * np.sqrt(variance_m2[seen])
    return float(inside.mean())
