"""Sets of poses, chosen by what they say of unknowns: one by one, then by exchange.

A pose with rows R adds R^T R to the information M of the unknowns: log det M grows by
log det (I + R M^-1 R^T), and M^-1 follows by Woodbury's formula, so that nothing as large as M is
factored anew (Fedorov, 1972; exchange of one pose after the other: Cook and Nachtsheim, 1980).

Two criteria: for a model's parameters a weighted sum of log determinants (D- and Ds-optimality);
for rivals, how far one of them is from what all else can follow (T-optimality, Atkinson and
Fedorov, 1975).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from typing_extensions import override

from pa10cal.arrays import Array, Index

#: An exchange must gain this much of the criterion, relative to one: less is rounding.
_LEAST_GAIN = 1e-6
#: Below this eigenvalue of I - R M^-1 R^T (and above its inverse where a pose is added) an update
#: would be made of rounding errors: a pose that alone determines a direction leaves 0 there.
_SAFE = 1e-6


@dataclass(frozen=True)
class ExchangeResult:
    """Poses chosen by exchange."""

    chosen: Index  # (n,) rows, in no order that means anything
    values: tuple[float, ...]  # the criterion at the start and after every exchange, never falling


def covariance_root(rows: Array) -> Array:
    """Return R (k, k), R R^T the covariance that rows (r, k) of unit variance leave of unknowns."""
    root: Array = np.linalg.inv(np.linalg.qr(rows, mode="r"))
    return root


class Information:
    """What a set of poses says of k unknowns, and what each of N candidates would add to it.

    As a criterion of sets it is log det M: D-optimality.
    """

    def __init__(self, white: Array, known: Array | None = None) -> None:
        """Start without poses, by the rows of candidates (N, b, k), of unit variance.

        And by rows (r, k) of all that is known without them; None for unknowns in the size expected
        of them, whose information is one.
        """
        self.candidates, b, k = white.shape
        self._white, self._unit = white, np.eye(b)
        self._known = np.eye(k) if known is None else np.linalg.qr(known, mode="r")
        self.restart()

    @property
    def poses(self) -> int:
        """Return how many poses were added."""
        return len(self._chosen)

    @property
    def value(self) -> float:
        """Return the criterion of the poses added."""
        return self.log_det

    def gains(self) -> Array:
        """Return by how much each candidate would make the criterion larger, (N,)."""
        gains: Array = np.linalg.slogdet(self._unit + self._spread)[1]
        return gains

    def restart(self, chosen: Sequence[int] | Index = ()) -> None:
        """Work everything out anew for some poses: updates gather rounding errors."""
        self._chosen = list(chosen)
        rows = self._white[self._chosen].reshape(-1, self._white.shape[2])
        root = covariance_root(np.concatenate([rows, self._known]))
        self.covariance: Array = root @ root.T
        self.log_det = -2.0 * float(np.log(np.abs(np.diag(root))).sum())
        self._spread: Array = self._white @ root
        self._spread = self._spread @ self._spread.transpose(0, 2, 1)

    def add(self, pose: int) -> None:
        """Add a candidate."""
        self._chosen.append(pose)
        self._update(pose, 1)

    def remove(self, pose: int) -> None:
        """Take a candidate away that was added."""
        self._chosen.remove(pose)
        self._update(pose, -1)

    def _update(self, pose: int, sign: int) -> None:
        """Add a candidate's information, or take it away; anew where rounding would decide."""
        innovation = self._unit + sign * self._spread[pose]
        eigenvalues = np.linalg.eigvalsh(innovation)
        if eigenvalues[0] < _SAFE or eigenvalues[-1] > 1.0 / _SAFE:
            self.restart(self._chosen)
            return
        root = np.linalg.cholesky(innovation)
        learned = np.linalg.solve(root, self._white[pose] @ self.covariance)
        elsewhere = self._white @ learned.T
        self.covariance = self.covariance - sign * (learned.T @ learned)
        self._spread = self._spread - sign * (elsewhere @ elsewhere.transpose(0, 2, 1))
        self.log_det += 2.0 * float(np.log(np.diag(root)).sum())


class SeparationCriterion(Information):
    """Log evidence expected for an effect against all that may be adjusted in its place.

    What cannot be followed of an effect has a sum of squares S: the inverse of the variance that
    poses leave of its amount, less one for what is expected of that. S costs a model without the
    effect S / 2 in log evidence where it is small. Where it is large, the model may lay it to an
    error of unknown cause at every pose: with the variance of that error chosen to suit, D
    components of all poses cost D / 2 log(1 + S / D).

    Of an effect of unknown shape, several equally likely contributions add up in squares.
    """

    def __init__(self, white: Array, known: Array, contributions: int, components: int) -> None:
        """Start with what was measured: D components of it.

        By the rows of candidates (N, b, k + m), of unit variance: of what may be adjusted, in the
        size expected of it, and of the m contributions of the effect; and by those (r, k + m) of
        what was measured, and of the sizes expected.
        """
        self._of_effect, self._measured = contributions, components
        super().__init__(white, known)

    @property
    @override
    def value(self) -> float:
        m = self._of_effect
        return float(self._nats(self.covariance[-m:, -m:], self.poses))

    @override
    def gains(self) -> Array:
        m = self._of_effect
        crossed = self._white @ self.covariance[:, -m:]
        learned = np.linalg.solve(self._unit + self._spread, crossed)
        covariances = self.covariance[-m:, -m:] - crossed.transpose(0, 2, 1) @ learned
        return self._nats(covariances, self.poses + 1) - self.value

    def _nats(self, covariances: Array, poses: int) -> Array:
        """Return the criterion for covariances (..., m, m) of the effect after some poses."""
        components = self._measured + poses * len(self._unit)
        squares = np.trace(np.linalg.inv(covariances), axis1=-2, axis2=-1) - self._of_effect
        return np.asarray(0.5 * components * np.log1p(squares / components))


def least_of(values: Array) -> Array:
    """Return the least of values (parts, ...)."""
    return np.asarray(values.min(axis=0))


class Combined:
    """A criterion of several of the same candidates: any function of their values."""

    def __init__(
        self, parts: Sequence[Criterion], combined: Callable[[Array], Array] = least_of
    ) -> None:
        """Combine criteria by a function of their values (parts, ...), of shape (...)."""
        self.candidates: int = parts[0].candidates
        self._parts, self._combined = parts, combined

    @property
    def value(self) -> float:
        """Return the criterion of the poses added."""
        return float(self._combined(self.values))

    @property
    def values(self) -> Array:
        """Return what is combined, of the poses added."""
        return np.array([each.value for each in self._parts])

    def gains(self) -> Array:
        """Return by how much each candidate would make the criterion larger, (N,)."""
        after = [each.value + each.gains() for each in self._parts]
        return self._combined(np.array(after)) - self.value

    def restart(self, chosen: Sequence[int] | Index = ()) -> None:
        """Work everything out anew for some poses."""
        for each in self._parts:
            each.restart(chosen)

    def add(self, pose: int) -> None:
        """Add a candidate."""
        for each in self._parts:
            each.add(pose)

    def remove(self, pose: int) -> None:
        """Take a candidate away that was added."""
        for each in self._parts:
            each.remove(pose)


#: What sets of poses are judged by: the larger the better.
Criterion = Information | Combined


def greedy_order(
    criterion: Criterion, most: int, among: Sequence[int] | Index | None = None
) -> Index:
    """Return the candidates, some or all, that a criterion gains most by, one after the other.

    The criterion has these poses afterwards, and no others.
    """
    every = np.arange(criterion.candidates)
    left = np.isin(every, every if among is None else among)
    order = np.empty(most, dtype=np.intp)
    criterion.restart()
    for n in range(most):
        best = int(np.argmax(np.where(left, criterion.gains(), -np.inf)))
        order[n], left[best] = best, False
        criterion.add(best)
    return order


def exchange(
    criterion: Criterion, start: Sequence[int] | Index, *, most_sweeps: int = 20
) -> ExchangeResult:
    """Exchange poses for better candidates until none is left that gains anything.

    Every pose in turn is taken out, and the candidate put in its place that the criterion gains
    most by: often itself. No candidate is chosen twice. The turns through all poses are bounded.
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
    return ExchangeResult(chosen, tuple(values))
