"""Evidence of sets of effects: the marginal likelihood of the residuals.

Linear about one solution, with a Gaussian prior on the amounts of every effect, the likelihood of
the data has a closed form with the model's own parameters, the effects and the common errors
integrated out. The variance of an error of unknown cause that the cells of a pose share is chosen
for every set. So an effect has to beat "something is wrong at each pose", not the noise alone.
Under the model without effects the expected likelihood ratio of any candidate is one:
P(ratio > m / alpha for any of m candidates) <= alpha (Markov's inequality), whatever they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from pa10cal.arrays import Array, Index
from pa10cal.discovery.evidence.noise_model import NoiseModel, SharedVariances
from pa10cal.discovery.rules import EVIDENCE
from pa10cal.discovery.tuning import COMPUTING, none_and_spaced
from pa10cal.numerics.gaussian import Gaussian, Gaussians

#: A set of candidates: the number of each in the family, and the index of its size.
CandidateSet = tuple[tuple[int, int], ...]

#: Variances of the shared error that are tried, in units of that of one reading: zero, then to some
#: 300 times the noise in size.
SHARED_VARIANCES = none_and_spaced(*EVIDENCE.pose_variances)


@dataclass(frozen=True)
class CandidateRows:
    """Derivative of whitened rows by the parameters of one candidate."""

    pose: Array  # (R, k)
    torque: Array  # (R', k)
    factor: Array  # (k, k) L, with L L^T the prior covariance of the parameters


@dataclass(frozen=True)
class LinearisedCandidates:
    """Whitened rows about a fit, of the model's own parameters and of candidates."""

    pose_data: Array  # (R,) measured minus predicted poses by the fit with its effects at zero
    torque_data: Array  # (R',) the same of torques
    own: Array  # (R, k) derivative by the model's own parameters, times their possible sizes
    blocks: tuple[CandidateRows, ...]  # of each candidate


@dataclass(frozen=True)
class Score:
    """Evidence of one set of candidates."""

    log_evidence: float  # natural logarithm, up to a constant of the data
    variances: SharedVariances  # the most likely ones
    grid_index: tuple[int, int]  # of the two nearest `SHARED_VARIANCES`


class Addition(NamedTuple):
    """A candidate added to a set."""

    nats: float  # gain in log evidence
    size: int  # index in `EVIDENCE.sizes` of its best size


class SetEvidence:
    """Evidence of sets of candidates, about one linearisation."""

    def __init__(
        self, pose: NoiseModel, torque: NoiseModel | None, rows: LinearisedCandidates
    ) -> None:
        """Reduce the rows of both channels to normal equations of the candidates.

        By the noise models of poses and of torques; None where torques are not logged.
        """
        blocks = rows.blocks
        stops = np.cumsum([0, *(block.factor.shape[1] for block in blocks)])
        self._columns = [np.arange(first, last) for first, last in pairwise(stops.tolist())]
        self._shows_in_torque = np.array([np.any(block.torque) for block in blocks], dtype=bool)
        none = np.zeros((len(rows.pose_data), 0))
        of_pose = [none, *(block.pose @ block.factor for block in blocks)]
        self._pose = reduced(pose, np.concatenate(of_pose, axis=1), rows.pose_data, rows.own)
        # Without torques their normal equations are zero.
        width = int(stops[-1])
        self._torque = Gaussians.of([Gaussian.none(width)])
        if torque is not None:
            none = np.zeros((len(rows.torque_data), 0))
            showing = np.flatnonzero(self._shows_in_torque).tolist()
            of_torque = [none, *(blocks[k].torque @ blocks[k].factor for k in showing)]
            # The columns of all others are zero.
            at = np.concatenate([np.zeros(0, np.intp), *(self._columns[k] for k in showing)])
            found = reduced(torque, np.concatenate(of_torque, axis=1), rows.torque_data, none)
            self._torque = found.among(at, width)
        self._scores: dict[CandidateSet, Score] = {}
        self._additions: dict[tuple[CandidateSet, tuple[int, ...]], list[Addition]] = {}
        self._last: tuple[tuple[int, ...], Gaussians, Gaussians] | None = None

    def score(self, chosen: CandidateSet) -> Score:
        """Return the evidence of a set of candidates."""
        if chosen not in self._scores:
            self._scores[chosen] = self._score(chosen)
        return self._scores[chosen]

    def additions(self, chosen: CandidateSet, candidates: list[int]) -> list[Addition]:
        """Return the gain of a set by each of some candidates.

        At the variances of the grid; `score` interpolates between them.
        """
        if (key := (chosen, tuple(candidates))) in self._additions:
            return self._additions[key]
        g, h = self.score(chosen).grid_index
        at_g, at_h, every = slice(g, g + 1), slice(h, h + 1), slice(None)
        gains = np.empty((len(EVIDENCE.sizes), len(candidates)))
        widths = np.array([len(self._columns[k]) for k in candidates], dtype=np.intp)
        for width in np.unique(widths):
            at = np.flatnonzero(widths == width)
            own = np.stack([self._columns[candidates[k]] for k in at])
            gains[:, at] = self._gains(chosen, own, every, at_h)
            shows = self._shows_in_torque[np.array(candidates)[at]]
            if shows.any():  # then the variance of the torques' shared error is varied, too
                again = self._gains(chosen, own[shows], at_g, every)
                gains[:, at[shows]] = np.maximum(gains[:, at[shows]], again)
        best, cost = np.argmax(gains, axis=0), float(np.log(len(EVIDENCE.sizes)))
        found = [Addition(float(gains[size, k]) - cost, int(size)) for k, size in enumerate(best)]
        self._additions[key] = found
        return found

    def _gains(
        self, chosen: CandidateSet, own: Index, pose_variances: slice, torque_variances: slice
    ) -> Array:
        """Return the gain in log evidence of a set by c candidates at each size, (sizes, c).

        By their columns (c, k), at the best of some of the grid's variances.
        """
        columns, scale = self._columns_and_sizes(chosen)
        pose, torque = self._pose[pose_variances], self._torque[torque_variances]
        of_set = (pose.along(columns) + torque.along(columns)).in_sizes(scale)
        across = pose.across(columns, own.ravel()) + torque.across(columns, own.ravel())
        across = (across * scale[:, None]).reshape(*across.shape[:2], *own.shape)
        inner = (slice(None), own[:, :, None], own[:, None, :])
        gram = pose.gram[inner] + torque.gram[inner]
        projection = pose.projection[:, own] + torque.projection[:, own]
        of_candidates = of_set.of_each_further(across, gram, projection)
        sizes = np.array(EVIDENCE.sizes)[:, None, None, None]
        with_each = of_candidates.in_sizes(sizes).log_evidence.max(axis=1)
        return np.asarray(with_each - of_set.log_evidence.max())

    def _score(self, chosen: CandidateSet) -> Score:
        """Return the evidence of a set, at the most likely variances of both shared errors."""
        columns, scale = self._columns_and_sizes(chosen)
        members = tuple(k for k, _ in chosen)
        if self._last is None or self._last[0] != members:  # often scored at other sizes
            self._last = members, self._pose.along(columns), self._torque.along(columns)
        pose, torque = (channel.in_sizes(scale) for channel in self._last[1:])
        shows = bool(self._shows_in_torque[list(members)].any())
        costs = _Costs(pose, torque, both_show=shows)
        g, h = costs.least()
        pose_gain, pose_variance = _refined_by_spline(costs.by_pose(h), g)
        torque_gain, torque_variance = _refined_by_spline(costs.by_torque(g), h)
        return Score(
            log_evidence=-0.5 * (float(costs.by_pose(h)[g]) - pose_gain - torque_gain)
            - float(np.log(len(EVIDENCE.sizes))) * len(members),
            variances=SharedVariances(pose_variance, torque_variance),
            grid_index=(g, h),
        )

    def _columns_and_sizes(self, chosen: CandidateSet) -> tuple[Index, Array]:
        """Return the columns of a set, and the size expected of each."""
        columns = [self._columns[k] for k, _ in chosen]
        sizes = np.array([EVIDENCE.sizes[size] for _, size in chosen])
        lengths = np.array([len(own) for own in columns], dtype=np.intp)
        return np.concatenate([np.zeros(0, dtype=np.intp), *columns]), np.repeat(sizes, lengths)


class _Costs:
    """Minus twice the log evidence of a set at `SHARED_VARIANCES`, g of poses and h of torques."""

    def __init__(self, pose: Gaussians, torque: Gaussians, *, both_show: bool) -> None:
        """Keep the set's equations (G,) by poses and by torques; `both_show`: it acts on both."""
        self._pose, self._torque = pose, torque
        # If the set does not act on torques, the costs of both add up.
        self._parts = (
            None if both_show else (-2.0 * pose.log_evidence, torque.squares + torque.log_det)
        )
        self._by_pose: dict[int, Array] = {}
        self._by_torque: dict[int, Array] = {}

    def by_pose(self, h: int) -> Array:
        """Return the costs at every variance of poses, at one of torques, (G,)."""
        if h not in self._by_pose:
            if self._parts is None:
                self._by_pose[h] = -2.0 * (self._pose + self._torque[h]).log_evidence
            else:
                self._by_pose[h] = self._parts[0] + self._parts[1][h]
        return self._by_pose[h]

    def by_torque(self, g: int) -> Array:
        """Return the costs at every variance of torques, at one of poses, (G,)."""
        if g not in self._by_torque:
            if self._parts is None:
                self._by_torque[g] = -2.0 * (self._torque + self._pose[g]).log_evidence
            else:
                self._by_torque[g] = self._parts[0][g] + self._parts[1]
        return self._by_torque[g]

    def least(self) -> tuple[int, int]:
        """Return g and h of the least cost, one after the other: they hardly interact."""
        g, last = 0, np.inf
        while True:
            h = int(np.argmin(self.by_torque(g)))
            costs = self.by_pose(h)
            g = int(np.argmin(costs))
            if not costs[g] < last - COMPUTING.same_nats:
                return g, h
            last = float(costs[g])


def _refined_by_spline(values: Array, least: int) -> tuple[float, float]:
    """Return the decrease of a spline through the values below the least one, and its variance.

    A parabola through three values would be wrong by tens of nats if hundreds of rows share the
    error.
    """
    if least < 2 or least >= len(values) - 1:
        return 0.0, float(SHARED_VARIANCES[least])
    variances, spline = _spline_below(least)
    interpolated = spline @ values[1:]
    lowest = int(np.argmin(interpolated))
    return float(values[least] - interpolated[lowest]), float(variances[lowest])


@cache
def _spline_below(least: int) -> tuple[Array, Array]:
    """Return variances (V,) about one of the grid, and the spline there by its knots (V, G - 1)."""
    logarithm = np.log(SHARED_VARIANCES[1:])
    # zero has no logarithm: number `least` of the grid is number `least - 1` of the knots
    near = np.linspace(logarithm[least - 2], logarithm[least], EVIDENCE.variances_between)
    return np.exp(near), np.asarray(CubicSpline(logarithm, np.eye(len(logarithm)))(near))


def reduced(channel: NoiseModel, columns: Array, data: Array, own: Array) -> Gaussians:
    """Return normal equations of candidates at each of `SHARED_VARIANCES`, (G,).

    The model's own parameters and the errors common to all poses are integrated out.
    """
    k, c = own.shape[1], channel.common.shape[1]
    rows = np.concatenate([channel.common, own, columns, data[:, None]], axis=1)
    # Most rows have none of the shared error: their products are the same at all variances.
    shared = channel.shared.variance > COMPUTING.no_part
    always = rows[~shared].T @ rows[~shared]
    rows, size = rows[shared], channel.shared.variance[shared]

    def at(variance: float) -> Gaussian:
        total = 1.0 + variance * size
        white = rows / np.sqrt(total)[:, None]
        every = Gaussian(always + white.T @ white, float(np.log(total).sum()))
        return every.without(np.arange(c + k))

    return Gaussians.of(map(at, SHARED_VARIANCES))
