"""Sets of poses with the largest determinant of information: one by one, then by exchange.

A pose with rows R adds R^T R to the information M of the unknowns, whatever is read there. By the
matrix determinant lemma log det M grows by log det (I + R M^-1 R^T), a matrix as small as the rows
of one pose; M^-1 follows by Woodbury's formula. So one pose against all others costs one product of
their rows, and nothing as large as M is ever factored anew (Fedorov, 1972; the exchange of one pose
after the other is that of Cook and Nachtsheim, 1980).

Criteria are weighted sums of log determinants, each of some of the unknowns: of all, or of some
with the others projected out (Ds-optimality), whose determinant is a quotient of two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array, Index

#: An exchange must gain this much of the criterion, relative to one: less is rounding.
_LEAST_GAIN = 1e-6


@dataclass(frozen=True)
class Share:
    """One log determinant of a criterion."""

    weight: float  # with which it counts; may be negative
    columns: int  # the unknowns it is of, from the first


@dataclass(frozen=True)
class Exchanged:
    """Poses chosen by exchange."""

    chosen: Index  # (n,) rows, in no order that means anything
    values: tuple[float, ...]  # the criterion at the start and after every exchange, never falling


class Information:
    """What a set of poses says of k unknowns, and what each candidate would add to it.

    Unknowns are in the size expected of them, so that before any pose their information is one.
    """

    def __init__(self, white: Array) -> None:
        """Start without poses.

        Args:
            white: (N, b, k) rows of the candidates, of unit variance.
        """
        self._white = white
        self.restart()

    def restart(self, chosen: Sequence[int] | Index = ()) -> None:
        """Work everything out anew for some poses: updates gather rounding errors."""
        b, k = self._white.shape[1:]
        rows = self._white[list(chosen)].reshape(-1, k)
        triangle = np.linalg.qr(np.concatenate([rows, np.eye(k)]), mode="r")
        inverse = np.linalg.inv(triangle)
        self.covariance: Array = inverse @ inverse.T
        self.log_det = 2.0 * float(np.log(np.abs(np.diag(triangle))).sum())
        self._spread: Array = self._white @ inverse
        self._spread = self._spread @ self._spread.transpose(0, 2, 1)
        self._unit = np.eye(b)

    def gains(self) -> Array:
        """Return by how much each candidate would make the log determinant larger, (N,)."""
        gains: Array = np.linalg.slogdet(self._unit + self._spread)[1]
        return gains

    def add(self, pose: int) -> None:
        """Add a candidate."""
        self._update(pose, 1.0)

    def remove(self, pose: int) -> None:
        """Take a candidate away that was added."""
        self._update(pose, -1.0)

    def _update(self, pose: int, sign: float) -> None:
        """Add a candidate's information, or take it away."""
        innovation = self._unit + sign * self._spread[pose]
        root = np.linalg.cholesky(innovation)
        learned = np.linalg.solve(root, self._white[pose] @ self.covariance)
        elsewhere = self._white @ learned.T
        self.covariance = self.covariance - sign * (learned.T @ learned)
        self._spread = self._spread - sign * (elsewhere @ elsewhere.transpose(0, 2, 1))
        self.log_det += 2.0 * float(np.log(np.diag(root)).sum())


class Criterion:
    """A weighted sum of log determinants, of a set of poses."""

    def __init__(self, white: Array, shares: Sequence[Share]) -> None:
        """Start without poses.

        Args:
            white: (N, b, k) rows of the candidates, of unit variance, each unknown in the size
                expected of it.
            shares: of the criterion.
        """
        self.candidates = len(white)
        self._parts = [
            (share.weight, Information(np.ascontiguousarray(white[..., : share.columns])))
            for share in shares
            if share.weight and share.columns
        ]

    @property
    def value(self) -> float:
        """Return the criterion of the poses added."""
        return sum(weight * each.log_det for weight, each in self._parts)

    def gains(self) -> Array:
        """Return by how much each candidate would make the criterion larger, (N,)."""
        return np.asarray(sum(weight * each.gains() for weight, each in self._parts))

    def restart(self, chosen: Sequence[int] | Index = ()) -> None:
        """Work everything out anew for some poses."""
        for _, each in self._parts:
            each.restart(chosen)

    def add(self, pose: int) -> None:
        """Add a candidate."""
        for _, each in self._parts:
            each.add(pose)

    def remove(self, pose: int) -> None:
        """Take a candidate away that was added."""
        for _, each in self._parts:
            each.remove(pose)


def one_by_one(criterion: Criterion, most: int) -> Index:
    """Add candidates to a criterion without poses, each time the one that it gains most by.

    Args:
        criterion: without poses; with these afterwards.
        most: how many are wanted.

    Returns:
        (most,) candidates in the order in which they were added.
    """
    left = np.ones(criterion.candidates, dtype=bool)
    order = np.empty(most, dtype=np.intp)
    for n in range(most):
        best = int(np.argmax(np.where(left, criterion.gains(), -np.inf)))
        order[n], left[best] = best, False
        criterion.add(best)
    return order


def exchange(
    criterion: Criterion, start: Sequence[int] | Index, *, most_sweeps: int = 20
) -> Exchanged:
    """Exchange poses for better candidates until none is left that gains anything.

    Every pose in turn is taken out, and the candidate put in its place that the criterion gains
    most by: often itself. No candidate is chosen twice.

    Args:
        criterion: of the candidates; with the poses chosen afterwards.
        start: (n,) candidates to set out with.
        most_sweeps: bound on the turns through all poses.
    """
    chosen = np.array(start, dtype=np.intp)
    criterion.restart(chosen)
    values = [criterion.value]
    for _ in range(most_sweeps):
        better = False
        for place, pose in enumerate(chosen.tolist()):
            criterion.remove(pose)
            gains = criterion.gains()
            back = float(gains[pose])
            gains[chosen] = -np.inf
            best = int(np.argmax(gains))
            if gains[best] <= back + _LEAST_GAIN:
                criterion.add(pose)
                continue
            chosen[place] = best
            criterion.restart(chosen)
            if criterion.value > values[-1]:
                values.append(criterion.value)
                better = True
            else:  # the gain was of rounding
                chosen[place] = pose
                criterion.restart(chosen)
        if not better:
            break
    return Exchanged(chosen, tuple(values))
