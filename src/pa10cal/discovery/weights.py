"""Weights of poses: stated uncertainty, scatter of the residuals, and less far outside.

A pose is weighted by the covariance that the instrument states, brought to the scatter that a model
leaves: what the model lacks scatters like noise, and positions and attitudes are to weigh by what
the data really have. A pose far outside that scatter weighs less (Huber); none is omitted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from pa10cal.arrays import Array, Index
from pa10cal.discovery.noise import MEDIAN_TO_SIGMA
from pa10cal.observe.instrument import Instrument

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
