"""How well what else may be adjusted could do the work of an effect, and what poses would add.

Everything is linear about a fit and every adjustable parameter has an expected size, so the rows of
a pose are taken in as in recursive least squares: what the rest cannot follow adds to the
separation, and what it learns sharpens what it will say of every other pose.

A sum of squares S that cannot be followed costs a model S / 2 in log evidence where it is small.
Where it is large, the model may lay it to an error of unknown cause at every pose: with the
variance of that error chosen to suit, D components of all poses cost D / 2 log(1 + S / D).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from pa10cal.arrays import Array


@dataclass(frozen=True)
class Outlook:
    """What distinguishes an effect from all that may replace it."""

    # (N, b, k) weighed rows of N poses that could be measured: of the adjustable parameters, a
    # unit of each being what is expected of it
    adjustable: Array
    cov: Array  # (k, k) covariance of these parameters, as known so far
    # (N, b, m) rows of the effect in these poses, less what the rest says of them; of an effect of
    # unknown size, m equally likely contributions that add up in squares
    left: Array
    spread: Array  # (N, b, b) covariance of what the rest says
    energy: float  # sum of squares of the effect that the rest could not follow so far
    components: int  # D, of all poses measured so far

    @classmethod
    def of(
        cls,
        present: Array,
        effect: Array,
        adjustable: Array,
        ahead: Array,
        poses: int,
    ) -> Outlook:
        """Start with what was measured.

        Args:
            present: (R, k) weighed rows of the adjustable parameters in what was measured.
            effect: (R, m) of the effect, in its size.
            adjustable: (N, b, k) of the adjustable parameters in what could be measured.
            ahead: (N, b, m) of the effect there.
            poses: how many different poses were measured.
        """
        k = present.shape[1]
        q, triangle = np.linalg.qr(np.concatenate([present, np.eye(k)]))
        inverse = solve_triangular(triangle, np.eye(k))
        rest = inverse @ (q[: len(present)].T @ effect)
        missed = np.concatenate([effect - present @ rest, rest])
        spread = adjustable @ inverse
        return cls(
            adjustable=adjustable,
            cov=inverse @ inverse.T,
            left=ahead - adjustable @ rest,
            spread=spread @ spread.transpose(0, 2, 1),
            energy=float(np.sum(missed**2)),
            components=poses * adjustable.shape[1],
        )

    @property
    def nats(self) -> float:
        """Separation so far: the expected difference in log evidence."""
        return float(_nats(np.array(self.energy), self.components))

    def nats_with(self) -> Array:
        """Return the separation if one more pose were measured, for each, (N,)."""
        innovation = self.spread + np.eye(self.spread.shape[1])
        gain = np.sum(self.left * np.linalg.solve(innovation, self.left), axis=(1, 2))
        return _nats(self.energy + gain, self.components + self.left.shape[1])

    def after(self, pose: int) -> Outlook:
        """Return the outlook once a pose was measured."""
        rows = self.adjustable[pose]
        root = np.linalg.cholesky(self.spread[pose] + np.eye(len(rows)))
        learned = solve_triangular(root, rows @ self.cov, lower=True).T  # (k, b)
        news = solve_triangular(root, self.left[pose], lower=True)  # (b, m)
        elsewhere = self.adjustable @ learned
        return replace(
            self,
            cov=self.cov - learned @ learned.T,
            left=self.left - elsewhere @ news,
            spread=self.spread - elsewhere @ elsewhere.transpose(0, 2, 1),
            energy=self.energy + float(np.sum(news**2)),
            components=self.components + len(rows),
        )


def _nats(energy: Array, components: int) -> Array:
    """Return what a sum of squares that cannot be followed costs in log evidence."""
    nats: Array = 0.5 * components * np.log1p(energy / components)
    return nats
