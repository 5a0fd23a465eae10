"""How far residuals lie outside what their own distribution makes, tails and all.

Right data may have heavy tails. Their heaviness is read off the bulk, where a few wrong readings do
not show, as degrees of freedom of Student's t: the largest of many such deviates is known then.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtrit

from pa10cal.arrays import Array

#: Probability that any of many right deviates, whatever their tails, is called wrong.
ACCUSED_RATE = 1e-4
#: Part of the deviates inside the two quantiles whose ratio tells how heavy the tails are.
_INNER, _OUTER = 0.5, 0.95
#: Degrees of freedom from which on tails count as those of the normal distribution.
_NORMAL_DOF = 200.0
_DOF = np.geomspace(1.5, _NORMAL_DOF, 60)
_RATIOS = stdtrit(_DOF, 0.5 + 0.5 * _OUTER) / stdtrit(_DOF, 0.5 + 0.5 * _INNER)
#: Standard errors by which the ratio of quantiles may be larger than it was found, and its relative
#: standard error times the root of the number of deviates.
_SURELY = 2.0
_ERROR_OF_RATIO = 1.4


@dataclass(frozen=True)
class Tails:
    """Distribution of many deviates about zero: Student's t of some scale."""

    scale: float  # of the deviates, as a standard deviation of its bulk
    # degrees of freedom; the fewer, the heavier the tails. No more than they surely are.
    dof: float
    count: int  # deviates behind it

    @staticmethod
    def of(deviates: Array, surely: float = _SURELY) -> Tails:
        """Return the distribution of deviates (N,).

        Args:
            deviates: about zero.
            surely: standard errors by which tails may be heavier than they were found.
        """
        sizes = np.abs(deviates)
        if not len(sizes):
            return Tails(0.0, _NORMAL_DOF, 0)
        inner, outer = np.quantile(sizes, [_INNER, _OUTER])
        if inner == 0.0:
            return Tails(0.0, _NORMAL_DOF, len(sizes))
        ratio = outer / inner * (1.0 + surely * _ERROR_OF_RATIO / np.sqrt(len(sizes)))
        dof = float(np.interp(-ratio, -_RATIOS, _DOF))
        scale = inner / ndtri(0.5 + 0.5 * _INNER)
        return Tails(float(scale), dof, len(sizes))

    def largest(self, rate: float, count: int | None = None) -> float:
        """Return the size that the largest of so many deviates exceeds with this probability."""
        count = max(self.count, 1) if count is None else count
        quantile = -float(stdtrit(self.dof, 0.5 * rate / count))
        bulk = float(stdtrit(self.dof, 0.5 + 0.5 * _INNER)) / float(ndtri(0.5 + 0.5 * _INNER))
        return self.scale * quantile / bulk
