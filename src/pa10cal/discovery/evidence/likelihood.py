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
from scipy.linalg.blas import dtrsm

from pa10cal.arrays import Array, Index
from pa10cal.discovery.evidence.problem import NoiseModel
from pa10cal.discovery.other_numbers import COMPUTING, none_and_spaced
from pa10cal.discovery.rules import EVIDENCE
from pa10cal.numerics.gaussian import Gaussian

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


@dataclass(frozen=True)
class _Given:
    """Products of w columns at V variances, a set of candidates taken as there."""

    place: Index  # (p,) where each of all columns stands among the w
    projection: Array  # (V, w) products with the data, after the set took its part
    constant: Array  # (V,) minus twice the logarithm of the likelihood with the set
    taken: Array  # (V, m, w) what the set takes of each column

    def gains(self, own: Index, grams: Array) -> Array:
        """Return the gain in evidence of c candidates at each of the sizes tried, (sizes, c).

        At the best variance, by their columns (c, k), all among the w, and the products of these
        before the set took its part, (V, c, k, k).
        """
        own = self.place[own]
        taken = self.taken[:, :, own].transpose(0, 2, 3, 1)
        grams = grams - taken @ taken.swapaxes(2, 3)
        sizes = np.array(EVIDENCE.sizes)[:, None, None, None]
        twice = _minus_twice_log(
            grams * sizes[..., None] ** 2, self.projection[:, own] * sizes, self.constant[:, None]
        )
        found: Array = 0.5 * (self.constant.min() - twice.min(axis=1))
        return found


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
        self._torque = Reduced(np.zeros((1, width, width)), np.zeros((1, width)), np.zeros(1))
        if torque is not None:
            none = np.zeros((len(torque_data), 0))
            showing = np.flatnonzero(self._shows_in_torque).tolist()
            of_torque = [none, *(blocks[k].torque @ blocks[k].factor for k in showing)]
            found = reduced(torque, np.concatenate(of_torque, axis=1), torque_data, none)
            # Columns of the others are zero.
            at = np.concatenate([np.zeros(0, np.intp), *(self._columns[k] for k in showing)])
            count = len(found.constant)
            gram, projection = np.zeros((count, width, width)), np.zeros((count, width))
            gram[:, at[:, None], at], projection[:, at] = found.gram, found.projection
            self._torque = Reduced(gram, projection, found.constant)
        self._scores: dict[CandidateSet, Score] = {}
        self._additions: dict[tuple[CandidateSet, tuple[int, ...]], list[tuple[float, int]]] = {}
        self._last: tuple[tuple[int, ...], Reduced, Reduced] | None = None

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
        columns, scale = self._of(chosen)
        at_g0, at_h0, every = slice(g0, g0 + 1), slice(h0, h0 + 1), slice(None)
        poses = self._given(columns, scale, every, at_h0, candidates)
        showing = [k for k in candidates if self._shows_in_torque[k]]
        torques = self._given(columns, scale, at_g0, every, showing) if showing else None
        gains = np.empty((len(EVIDENCE.sizes), len(candidates)))
        widths = np.array([len(self._columns[k]) for k in candidates], dtype=np.intp)
        for width in np.unique(widths):
            at = np.flatnonzero(widths == width)
            own = np.stack([self._columns[candidates[k]] for k in at])
            inner = (slice(None), own[:, :, None], own[:, None, :])
            of_pose, of_torque = self._pose.gram[inner], self._torque.gram[inner]
            gains[:, at] = poses.gains(own, of_pose + of_torque[at_h0])
            shows = self._shows_in_torque[np.array(candidates)[at]]
            if torques and shows.any():  # their shared error is then chosen anew as well
                again = torques.gains(own[shows], of_pose[at_g0, shows] + of_torque[:, shows])
                gains[:, at[shows]] = np.maximum(gains[:, at[shows]], again)
        best, cost = np.argmax(gains, axis=0), float(np.log(len(EVIDENCE.sizes)))
        found = [(float(gains[size, k]) - cost, int(size)) for k, size in enumerate(best)]
        self._additions[key] = found
        return found

    def _given(
        self, columns: Index, scale: Array, g: slice, h: slice, candidates: list[int]
    ) -> _Given:
        """Reduce the products of the columns of candidates by a set that is taken as there."""
        wanted = np.concatenate([np.zeros(0, np.intp), *(self._columns[k] for k in candidates)])
        place = np.zeros(self._pose.projection.shape[1], dtype=np.intp)
        place[wanted] = np.arange(len(wanted))
        projection = self._pose.projection[g] + self._torque.projection[h]
        constant = self._pose.constant[g] + self._torque.constant[h]
        taken = np.empty((len(constant), len(columns), len(wanted) + 1))
        np.add(
            self._pose.products_of(g, columns, wanted),
            self._torque.products_of(h, columns, wanted),
            out=taken[..., :-1],
        )
        taken[..., -1] = projection[:, columns]
        taken *= scale[:, None]
        of_set = self._pose.products_of(g, columns, columns) + self._torque.products_of(
            h, columns, columns
        )
        factor = np.linalg.cholesky(np.eye(len(columns)) + of_set * np.outer(scale, scale))
        for lower, rows in zip(factor, taken, strict=True):  # triangular: a third of a solution
            dtrsm(1.0, lower.T, rows.T, side=1, overwrite_b=1)
        log_determinant = 2.0 * np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        return _Given(
            place,
            projection[:, wanted] - np.einsum("gmp,gm->gp", taken[:, :, :-1], taken[:, :, -1]),
            constant - np.sum(taken[:, :, -1] ** 2, axis=1) + log_determinant,
            taken[:, :, :-1],
        )

    def _score(self, chosen: CandidateSet) -> Score:
        columns, scale = self._of(chosen)
        members = tuple(k for k, _ in chosen)
        shows = bool(self._shows_in_torque[list(members)].any())
        if self._last is None or self._last[0] != members:  # often asked at other sizes
            self._last = members, self._pose.of(columns), self._torque.of(columns)
        pose, torque = self._last[1].scaled(scale), self._last[2]
        # Of torques that say nothing of the set only the constant is looked at.
        torque = torque.scaled(scale) if shows else torque
        by_pose = None if shows else _minus_twice_log(pose.gram, pose.projection, pose.constant)

        def together(channel: Reduced, other: Reduced, k: int) -> Array:
            """Return minus twice the log evidence at all variances of one, and one of another."""
            gram, projection = (
                channel.gram + other.gram[k],
                channel.projection + other.projection[k],
            )
            return _minus_twice_log(gram, projection, channel.constant + other.constant[k])

        @cache
        def over_pose(h: int) -> Array:
            return together(pose, torque, h) if by_pose is None else by_pose + torque.constant[h]

        @cache
        def over_torque(g: int) -> Array:
            return together(torque, pose, g) if by_pose is None else by_pose[g] + torque.constant

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


def _minus_twice_log(gram: Array, projection: Array, constant: Array) -> Array:
    """Return minus twice the log evidence for Gaussian parameters of unit variance."""
    k = gram.shape[-1]
    if k == 0:
        return constant
    # With the projection as a last row, the factor's last row is what the factor makes of it.
    beside = np.empty((*gram.shape[:-2], k + 1, k + 1))
    beside[..., :k, :k] = gram + np.eye(k)
    beside[..., k, :k] = beside[..., :k, k] = projection
    beside[..., k, k] = 1.0 + 2.0 * np.sum(projection**2, axis=-1)
    factor = np.linalg.cholesky(beside)
    log_determinant = 2.0 * np.log(np.diagonal(factor, axis1=-2, axis2=-1)[..., :k]).sum(axis=-1)
    found: Array = constant - np.sum(factor[..., k, :k] ** 2, axis=-1) + log_determinant
    return found


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


# Rows of one channel reduced to products, at every variance of the error that poses share.
#
# The model's own parameters, and the errors common to all poses, are integrated out.

#: Variances of the shared error tried, in those of one reading: from none to some 300 times the
#: noise in size.
SHARED_VARIANCES = none_and_spaced(*EVIDENCE.pose_variances)


@dataclass(frozen=True)
class Reduced:
    """One channel at each of the G shared variances, the model's own parameters integrated out."""

    gram: Array  # (G, p, p) products of the candidates' columns, in units of their expected sizes
    projection: Array  # (G, p) products with the data
    constant: Array  # (G,) minus twice the logarithm of the likelihood without candidates

    def of(self, columns: Index) -> Reduced:
        """Return the products of some columns (p',)."""
        return Reduced(
            self.products_of(slice(None), columns, columns),
            self.projection[:, columns],
            self.constant,
        )

    def products_of(self, variances: slice, rows: Index, columns: Index) -> Array:
        """Return the products of some columns with some others, at some variances, (V, r, c)."""
        places = self.gram.shape[1] * rows[:, None] + columns
        chosen = self.gram[variances]
        return np.asarray(chosen.reshape(len(chosen), -1).take(places, axis=1))

    def scaled(self, scale: Array) -> Reduced:
        """Return the products of the columns, each scaled (p,)."""
        return Reduced(self.gram * np.outer(scale, scale), self.projection * scale, self.constant)


def reduced(channel: NoiseModel, columns: Array, data: Array, own: Array) -> Reduced:
    """Integrate the model's own parameters and the common errors out, at every shared variance."""
    k, c = own.shape[1], channel.common.shape[1]
    rows = np.concatenate([channel.common, own, columns, data[:, None]], axis=1)
    # Most rows have no part in the shared error: their products are the same for all variances.
    shared = channel.shared_size > COMPUTING.no_part
    always = rows[~shared].T @ rows[~shared]
    rows, size = rows[shared], channel.shared_size[shared]
    grams, projections, constants = [], [], []
    for variance in SHARED_VARIANCES:
        total = 1.0 + variance * size
        weighed = rows / np.sqrt(total)[:, None]
        products = always + weighed.T @ weighed
        left = Gaussian(products, float(np.log(total).sum())).without(np.arange(c + k))
        grams.append(left.gram)
        projections.append(left.projection)
        constants.append(left.squares + left.log_det)
    return Reduced(np.array(grams), np.array(projections), np.array(constants))
