"""What each pose counts: its stated uncertainty, the scatter of what is left, and less far outside.

A pose is weighed by the covariance that the instrument states, brought to the scatter that a model
leaves: what the model lacks scatters like noise, and positions and attitudes are to weigh by what
they really tell. A pose far outside that scatter weighs less (Huber); none is left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, ndtri

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_KINDS = (slice(0, 3), slice(3, 6))
#: Share of undisturbed poses that weigh less than fully.
_HUBER_TAIL = 1e-3
#: Stated uncertainties are brought down by no more than this: data without noise have no scatter.
_MOST_SHRINK = 1e-3
_MEDIAN_TO_SIGMA = 1.0 / float(ndtri(0.75))


@dataclass(frozen=True)
class Weighing:
    """Whitening and weights of P poses.

    Attributes:
        whitener: (P, 6, 6) makes what is left of each pose independent and of unit size.
        weight: (P,) 1, or less far outside the scatter.
    """

    whitener: Array
    weight: Array

    def whiteners(self, rows: Index) -> Array:
        """Return the whiteners of some poses times the roots of their weights."""
        found: Array = np.sqrt(self.weight[rows])[:, None, None] * self.whitener[rows]
        return found


def unweighed(stated: Array) -> Weighing:
    """Return the weighing by what the instrument states, (P, 6, 6), alone."""
    return Weighing(np.linalg.inv(np.linalg.cholesky(stated)), np.ones(len(stated)))


def weigh(residual: Array, dof: float, stated: Array) -> Weighing:
    """Weigh poses by what a model leaves of them.

    Args:
        residual: (P, 6) what is left: position [m], attitude [rad].
        dof: parameters that the data determine, which the residuals are smaller by.
        stated: (P, 6, 6) covariance that the instrument states.
    """
    inflate = residual.size / max(residual.size - dof, 0.5 * residual.size)
    covariance = stated.copy()
    for kind in _KINDS:
        found = inflate * (_MEDIAN_TO_SIGMA * np.median(np.abs(residual[:, kind]))) ** 2
        said = float(np.median(np.diagonal(stated[:, kind, kind], axis1=1, axis2=2)))
        if found < said:
            shrink = max(np.sqrt(found / said), _MOST_SHRINK)
            covariance[:, kind] *= shrink
            covariance[:, :, kind] *= shrink
        else:
            rows = range(6)[kind]
            covariance[:, rows, rows] += found - said
    whitener = np.linalg.inv(np.linalg.cholesky(covariance))
    distance = np.linalg.norm((whitener @ residual[:, :, None])[:, :, 0], axis=1)
    limit = float(np.sqrt(chdtri(6, _HUBER_TAIL)))
    return Weighing(whitener, np.minimum(1.0, limit / np.maximum(distance, limit)))
