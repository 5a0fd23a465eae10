"""How well sets of effects explain what the model leaves, judged pose by pose.

Linear about one solution, with Gaussian sizes to be expected of every effect, the likelihood of the
data is known in closed form with the model's own parameters, the effects and the common errors
integrated out; the variance of an error of unknown cause that each pose shares is chosen anew for
every set. So an effect has to beat "something is wrong at each pose", not the noise alone, and
under the model without effects the expectation of the likelihood ratio of any candidate is one:
P(ratio > m / alpha for any of m candidates) <= alpha (Markov), however strange the candidates.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from pa10cal.arrays import Array, Index
from pa10cal.discovery.evidence.problem import NoiseModel
from pa10cal.discovery.other_numbers import COMPUTING, none_and_spaced
from pa10cal.discovery.rules import EVIDENCE
from pa10cal.numerics.gaussian import Gaussian, Gaussians

#: A set of candidates: the number of each in the family, and the index of its size.
CandidateSet = tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class CandidateRows:
    """Linearised rows of one candidate."""

    # pose and torque: (R, k), (R', k) whitened rows a unit of each parameter
    pose: Array
    torque: Array
    factor: Array  # (k, k) L, with L L^T the covariance to be expected of the parameters


@dataclass(frozen=True)
class Score:
    """Evidence of one set of candidates."""

    log_evidence: float  # natural logarithm, up to a constant of the data
    # pose_variance and torque_variance: shared errors that go with it, in variances of a reading
    pose_variance: float
    torque_variance: float
    grid_index: tuple[int, int]  # of the variances tried, those next to the two

    @property
    def variances(self) -> tuple[float, float]:
        """Return the variances of the shared errors of poses and of torques."""
        return self.pose_variance, self.torque_variance


class SetEvidence:
    """Evidence of sets of candidates, about one linearisation."""

    def __init__(
        self,
        pose: NoiseModel,
        torque: NoiseModel | None,
        pose_data: Array,
        torque_data: Array,
        own: Array,
        blocks: tuple[CandidateRows, ...],
    ) -> None:
        """Reduce the rows of both channels, of torques where any is logged.

        Data (R,), (R',) are whitened rows of measured minus predicted; own ones (R, k) those of the
        model's own parameters, each times the standard deviation that is thought possible for it.
        """
        stops = np.cumsum([0, *(block.factor.shape[1] for block in blocks)])
        self._columns = [np.arange(a, b) for a, b in pairwise(stops.tolist())]
        self._shows_in_torque = np.array([np.any(block.torque) for block in blocks], dtype=bool)
        of_pose = [np.zeros((len(pose_data), 0)), *(block.pose @ block.factor for block in blocks)]
        self._pose = reduced(pose, np.concatenate(of_pose, axis=1), pose_data, own)
        # A channel that says nothing, where there are no torques.
        width = int(stops[-1])
        self._torque = Gaussians.of([Gaussian.none(width)])
        if torque is not None:
            none = np.zeros((len(torque_data), 0))
            showing = np.flatnonzero(self._shows_in_torque).tolist()
            of_torque = [none, *(blocks[k].torque @ blocks[k].factor for k in showing)]
            # Columns of the others are zero.
            at = np.concatenate([np.zeros(0, np.intp), *(self._columns[k] for k in showing)])
            found = reduced(torque, np.concatenate(of_torque, axis=1), torque_data, none)
            self._torque = found.among(at, width)
        self._scores: dict[CandidateSet, Score] = {}
        self._additions: dict[tuple[CandidateSet, tuple[int, ...]], list[tuple[float, int]]] = {}
        self._last: tuple[tuple[int, ...], Gaussians, Gaussians] | None = None

    def score(self, chosen: CandidateSet) -> Score:
        """Return the evidence of a set of candidates."""
        if chosen not in self._scores:
            self._scores[chosen] = self._score(chosen)
        return self._scores[chosen]

    def additions(self, chosen: CandidateSet, candidates: list[int]) -> list[tuple[float, int]]:
        """Return, for each candidate, what it would add to the evidence of a set, and its size.

        To within the step between the variances tried; `score` interpolates between them.
        """
        if (key := (chosen, tuple(candidates))) in self._additions:
            return self._additions[key]
        g0, h0 = self.score(chosen).grid_index
        at_g0, at_h0, every = slice(g0, g0 + 1), slice(h0, h0 + 1), slice(None)
        gains = np.empty((len(EVIDENCE.sizes), len(candidates)))
        widths = np.array([len(self._columns[k]) for k in candidates], dtype=np.intp)
        for width in np.unique(widths):
            at = np.flatnonzero(widths == width)
            own = np.stack([self._columns[candidates[k]] for k in at])
            gains[:, at] = self._gains(chosen, own, every, at_h0)
            shows = self._shows_in_torque[np.array(candidates)[at]]
            if shows.any():  # their shared error is then chosen anew as well
                again = self._gains(chosen, own[shows], at_g0, every)
                gains[:, at[shows]] = np.maximum(gains[:, at[shows]], again)
        best, cost = np.argmax(gains, axis=0), float(np.log(len(EVIDENCE.sizes)))
        found = [(float(gains[size, k]) - cost, int(size)) for k, size in enumerate(best)]
        self._additions[key] = found
        return found

    def _gains(self, chosen: CandidateSet, own: Index, g: slice, h: slice) -> Array:
        """Return the gain in evidence of c candidates at each of the sizes tried, (sizes, c).

        By their columns (c, k), beside a set that is taken as there, at the best of some variances.
        """
        columns, scale = self._of(chosen)
        pose, torque = self._pose[g], self._torque[h]
        of_set = (pose.along(columns) + torque.along(columns)).in_sizes(scale)
        across = pose.across(columns, own.ravel()) + torque.across(columns, own.ravel())
        across = (across * scale[:, None]).reshape(*across.shape[:2], *own.shape)
        inner = (slice(None), own[:, :, None], own[:, None, :])
        gram = pose.gram[inner] + torque.gram[inner]
        projection = pose.projection[:, own] + torque.projection[:, own]
        beside = of_set.of_each_further(across, gram, projection)
        sizes = np.array(EVIDENCE.sizes)[:, None, None, None]
        with_each = beside.in_sizes(sizes).log_evidence.max(axis=1)
        return np.asarray(with_each - of_set.log_evidence.max())

    def _score(self, chosen: CandidateSet) -> Score:
        columns, scale = self._of(chosen)
        members = tuple(k for k, _ in chosen)
        shows = bool(self._shows_in_torque[list(members)].any())
        if self._last is None or self._last[0] != members:  # often asked at other sizes
            self._last = members, self._pose.along(columns), self._torque.along(columns)
        pose, torque = (channel.in_sizes(scale) for channel in self._last[1:])
        # Of torques that say nothing of the set only their own evidence is looked at.
        by_pose = None if shows else -2.0 * pose.log_evidence
        by_torque = torque.squares + torque.log_det

        @cache
        def over_pose(h: int) -> Array:
            if by_pose is None:
                return -2.0 * (pose + torque[h]).log_evidence
            return np.asarray(by_pose + by_torque[h])

        @cache
        def over_torque(g: int) -> Array:
            if by_pose is None:
                return -2.0 * (torque + pose[g]).log_evidence
            return np.asarray(by_pose[g] + by_torque)

        g, last = 0, np.inf
        while True:  # one variance after the other: they hardly depend on each other
            h = int(np.argmin(over_torque(g)))
            over_g = over_pose(h)
            g = int(np.argmin(over_g))
            if not over_g[g] < last - COMPUTING.same_nats:
                break
            last = float(over_g[g])
        over_h = over_torque(g)
        pose_gain, pose_variance = _refined_by_spline(over_g, g)
        torque_gain, torque_variance = _refined_by_spline(over_h, h)
        return Score(
            log_evidence=-0.5 * (float(over_g[g]) - pose_gain - torque_gain)
            - float(np.log(len(EVIDENCE.sizes))) * len(members),
            pose_variance=pose_variance,
            torque_variance=torque_variance,
            grid_index=(g, h),
        )

    def _of(self, chosen: CandidateSet) -> tuple[Index, Array]:
        """Return the columns of a set and the size by which each is scaled."""
        columns = [self._columns[k] for k, _ in chosen]
        scale = [
            np.full(len(own), EVIDENCE.sizes[size])
            for own, (_, size) in zip(columns, chosen, strict=True)
        ]
        return (
            np.concatenate([np.zeros(0, dtype=np.intp), *columns]),
            np.concatenate([np.zeros(0), *scale]),
        )


def _refined_by_spline(values: Array, least: int) -> tuple[float, float]:
    """Return how much lower a spline through the values lies near the least, and at which variance.

    A parabola through three values would be wrong by tens of nats where hundreds of rows have a
    part in the error.
    """
    if least < 2 or least >= len(values) - 1:
        return 0.0, float(SHARED_VARIANCES[least])
    variances, spline = _spline_below(least)
    between = spline @ values[1:]
    lowest = int(np.argmin(between))
    return float(values[least] - between[lowest]), float(variances[lowest])


@cache
def _spline_below(least: int) -> tuple[Array, Array]:
    """Return variances (V,) about one of those tried, and the spline by its knots (V, G-1)."""
    logarithm = np.log(SHARED_VARIANCES[1:])
    near = np.linspace(logarithm[least - 2], logarithm[least], EVIDENCE.variances_between)
    return np.exp(near), np.asarray(CubicSpline(logarithm, np.eye(len(logarithm)))(near))


# What rows of one channel say of candidates, at every variance of the error that poses share.

#: Variances of the shared error tried, in those of one reading: from none to some 300 times the
#: noise in size.
SHARED_VARIANCES = none_and_spaced(*EVIDENCE.pose_variances)


def reduced(channel: NoiseModel, columns: Array, data: Array, own: Array) -> Gaussians:
    """Return what is said of candidates at each shared variance, (G,); all else is integrated out.

    That is the model's own parameters, and the errors common to all poses.
    """
    k, c = own.shape[1], channel.common.shape[1]
    rows = np.concatenate([channel.common, own, columns, data[:, None]], axis=1)
    # Most rows have no part in the shared error: their products are the same for all variances.
    shared = channel.shared_size > COMPUTING.no_part
    always = rows[~shared].T @ rows[~shared]
    rows, size = rows[shared], channel.shared_size[shared]

    def at(variance: float) -> Gaussian:
        total = 1.0 + variance * size
        weighed = rows / np.sqrt(total)[:, None]
        every = Gaussian(always + weighed.T @ weighed, float(np.log(total).sum()))
        return every.without(np.arange(c + k))

    return Gaussians.of(map(at, SHARED_VARIANCES))
