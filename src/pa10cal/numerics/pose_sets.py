"""Sets of poses: optimal ones, chosen one by one and improved by exchange, and paths through them.

A pose with rows R adds R^T R to the information matrix M of the unknowns: log det M grows by
log det (I + R M^-1 R^T), and M^-1 follows by Woodbury's formula without factoring M again (Fedorov,
1972; exchange of one pose after the other: Cook and Nachtsheim, 1980).

Criteria are log det M of a model's parameters (D-optimality), or the part of an effect that
everything else that may be adjusted cannot reproduce (T-optimality, Atkinson and Fedorov, 1975).

The length of a path is the sum of its moves, each as long as its largest component (Chebyshev): the
time of a robot's move is that of the joint that turns furthest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist
from typing_extensions import override

from pa10cal.arrays import Array, Index

#: Least gain of an exchange: less may be rounding.
_LEAST_GAIN = 1e-6
#: Least eigenvalue of I ± R M^-1 R^T, and inverse of the largest, for which an update is accurate:
#: it is zero where a pose that alone determines a direction is removed.
_SAFE = 1e-6

#: Improvements of a path, at most (computing).
_MOST_ROUNDS = 50
#: A path must become shorter by more than this: less is rounding.
_SHORTER = 1e-9


@dataclass(frozen=True)
class ExchangeResult:
    """Poses chosen by exchange."""

    chosen: Index  # (n,) candidates; their order has no meaning
    values: tuple[float, ...]  # the criterion at the start and after every exchange, increasing


def covariance_root(rows: Array) -> Array:
    """Return R (k, k) with R R^T the covariance of unknowns by rows (r, k) of unit variance."""
    return np.asarray(np.linalg.inv(np.linalg.qr(rows, mode="r")))


class Information:
    """Information of a set of poses about k unknowns, and the gain by each of N candidates.

    The criterion is log det M: D-optimality.
    """

    def __init__(self, white: Array, known: Array | None = None) -> None:
        """Start without poses.

        Args:
            white: (N, b, k) rows of the candidates, of unit variance.
            known: (r, k) rows of prior information, of unit variance; None for unknowns over their
                prior standard deviation, whose information is a unit matrix.
        """
        self.candidates, b, k = white.shape
        self._white, self._unit = white, np.eye(b)
        self._known = np.eye(k) if known is None else np.linalg.qr(known, mode="r")
        self.restart()

    @property
    def poses(self) -> int:
        """Return the number of poses in the set."""
        return len(self._chosen)

    @property
    def value(self) -> float:
        """Return the criterion of the set."""
        return self.log_det

    def gains(self) -> Array:
        """Return the increase of the criterion by each candidate, (N,)."""
        return np.asarray(np.linalg.slogdet(self._unit + self._spread)[1])

    def restart(self, chosen: Sequence[int] | Index = ()) -> None:
        """Compute everything anew for a set of poses, since updates accumulate rounding errors."""
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
        """Remove a candidate from the set."""
        self._chosen.remove(pose)
        self._update(pose, -1)

    def _update(self, pose: int, sign: int) -> None:
        """Add (1) or remove (-1) a candidate's information; compute anew if that is inaccurate."""
        innovation = self._unit + sign * self._spread[pose]
        eigenvalues = np.linalg.eigvalsh(innovation)
        if eigenvalues[0] < _SAFE or eigenvalues[-1] > 1.0 / _SAFE:
            self.restart(self._chosen)
            return
        root = np.linalg.cholesky(innovation)
        reduction = np.linalg.solve(root, self._white[pose] @ self.covariance)
        of_candidates = self._white @ reduction.T
        self.covariance = self.covariance - sign * (reduction.T @ reduction)
        self._spread = self._spread - sign * (of_candidates @ of_candidates.transpose(0, 2, 1))
        self.log_det += 2.0 * float(np.log(np.diag(root)).sum())


class SeparationCriterion(Information):
    """Expected log evidence for an effect against everything that may be adjusted instead.

    The part of an effect that nothing else can reproduce has a sum of squares S: the inverse of the
    posterior variance of its amount, less one for the prior. A small S costs a model without the
    effect S / 2 in log evidence. A large S may be attributed to an additional error in every pose:
    with its likeliest variance, D components of all poses cost D / 2 log(1 + S / D).

    For an effect of unknown shape, the squares of several equally likely contributions are added.
    """

    def __init__(self, white: Array, known: Array, contributions: int, components: int) -> None:
        """Start with what is measured already.

        Args:
            white: (N, b, k + m) rows of the candidates, of unit variance: by k unknowns over their
                prior standard deviations, and by m contributions of the effect.
            known: (r, k + m) rows of what is measured, and of the priors.
            contributions: m.
            components: number of components that are measured.
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
        gain = np.linalg.solve(self._unit + self._spread, crossed)
        covariances = self.covariance[-m:, -m:] - crossed.transpose(0, 2, 1) @ gain
        return self._nats(covariances, self.poses + 1) - self.value

    def _nats(self, covariances: Array, poses: int) -> Array:
        """Return the criterion for covariances (..., m, m) of the effect by a number of poses."""
        components = self._measured + poses * len(self._unit)
        squares = np.trace(np.linalg.inv(covariances), axis1=-2, axis2=-1) - self._of_effect
        return np.asarray(0.5 * components * np.log1p(squares / components))


def least_of(values: Array) -> Array:
    """Return the minimum of values (parts, ...)."""
    return np.asarray(values.min(axis=0))


class Combined:
    """A function of several criteria of the same candidates, as a criterion."""

    def __init__(
        self, parts: Sequence[Criterion], combined: Callable[[Array], Array] = least_of
    ) -> None:
        """Combine criteria by a function that maps their values (parts, ...) to (...)."""
        self.candidates: int = parts[0].candidates
        self._parts, self._combined = parts, combined

    @property
    def value(self) -> float:
        """Return the criterion of the set."""
        return float(self._combined(self.values))

    @property
    def values(self) -> Array:
        """Return the values of the single criteria, (parts,)."""
        return np.array([part.value for part in self._parts])

    def gains(self) -> Array:
        """Return the increase of the criterion by each candidate, (N,)."""
        after = [part.value + part.gains() for part in self._parts]
        return self._combined(np.array(after)) - self.value

    def restart(self, chosen: Sequence[int] | Index = ()) -> None:
        """Compute everything anew for a set of poses."""
        for part in self._parts:
            part.restart(chosen)

    def add(self, pose: int) -> None:
        """Add a candidate."""
        for part in self._parts:
            part.add(pose)

    def remove(self, pose: int) -> None:
        """Remove a candidate from the set."""
        for part in self._parts:
            part.remove(pose)


#: A criterion of sets of poses, to be maximised.
Criterion = Information | Combined


def greedy_order(
    criterion: Criterion, most: int, among: Sequence[int] | Index | None = None
) -> Index:
    """Return candidates, each the one of the largest gain after those before it.

    The set of the criterion then consists of these.

    Args:
        most: number of candidates to choose; all available ones where there are fewer.
        among: candidates to choose from; None for all.
    """
    candidates = np.arange(criterion.candidates)
    available = np.isin(candidates, candidates if among is None else among)
    order = np.empty(min(most, int(available.sum())), dtype=np.intp)
    criterion.restart()
    for n in range(len(order)):
        best = int(np.argmax(np.where(available, criterion.gains(), -np.inf)))
        order[n], available[best] = best, False
        criterion.add(best)
    return order


def exchange(
    criterion: Criterion, start: Sequence[int] | Index, *, most_sweeps: int = 20
) -> ExchangeResult:
    """Exchange poses for better candidates until no exchange increases the criterion.

    Every pose in turn is removed, and the candidate of the largest gain takes its place: often the
    pose itself. No candidate is chosen twice.

    Args:
        start: the first set.
        most_sweeps: largest number of rounds through all poses.
    """
    chosen = np.array(start, dtype=np.intp)
    criterion.restart(chosen)
    values = [criterion.value]
    for _ in range(most_sweeps):
        better = False
        for place, pose in enumerate(chosen.tolist()):
            criterion.remove(pose)
            gains = criterion.gains()
            gain_of_pose = float(gains[pose])
            gains[chosen] = -np.inf
            best = int(np.argmax(gains))
            if gains[best] <= gain_of_pose + _LEAST_GAIN:
                criterion.add(pose)
                continue
            chosen[place] = best
            criterion.restart(chosen)
            if criterion.value > values[-1]:
                values.append(criterion.value)
                better = True
            else:  # the gain was rounding
                chosen[place] = pose
                criterion.restart(chosen)
        if not better:
            break
    return ExchangeResult(chosen, tuple(values))


def short_path(q: Array) -> Index:
    """Return an order of points (N, n) whose path is short.

    Nearest neighbour, from the best of all starts; then 2-opt: the stretch whose reversal shortens
    the path most is reversed, until none does. For robots: collisions between poses are ignored.
    """
    if len(q) < 3:
        return np.arange(len(q), dtype=np.intp)
    distance = cdist(q, q, metric="chebyshev")
    paths = [_nearest_neighbours(distance, start) for start in range(len(q))]
    path = min(paths, key=lambda order: float(distance[order[:-1], order[1:]].sum()))
    for _ in range(_MOST_ROUNDS):
        shorter = _best_reversal(distance, path)
        if shorter is None:
            break
        path = shorter
    return path


def path_length(q: Array) -> float:
    """Return the length of the path through points (N, n) in the order given."""
    return float(np.abs(np.diff(q, axis=0)).max(axis=1, initial=0.0).sum())


def _nearest_neighbours(distance: Array, start: int) -> Index:
    """Return the path from a start that goes to the nearest point not yet visited, (N,)."""
    unvisited = distance.copy()
    path = [start]
    for _ in range(len(distance) - 1):
        unvisited[:, path[-1]] = np.inf
        path.append(int(np.argmin(unvisited[path[-1]])))
    return np.array(path, dtype=np.intp)


def _best_reversal(distance: Array, path: Index) -> Index | None:
    """Return the path with one stretch reversed that shortens it most; None where none does."""
    count = len(path)
    # Row and column `count`, also index -1, are beyond the ends: moves to there have no length.
    between = np.zeros((count + 1, count + 1))
    between[:count, :count] = distance[np.ix_(path, path)]
    first, last = np.triu_indices(count, k=1)
    before = first - 1
    after = np.where(last + 1 < count, last + 1, -1)
    length = between[before, first] + between[last, after]
    reversed_length = between[before, last] + between[first, after]
    best = int(np.argmin(reversed_length - length))
    if reversed_length[best] >= length[best] - _SHORTER:
        return None
    shorter = path.copy()
    stretch = slice(first[best], last[best] + 1)
    shorter[stretch] = path[stretch][::-1]
    return shorter
