"""Evidence of sets of effects: the marginal likelihood of the residuals.

Linear about one solution, with a Gaussian prior on the amounts of every effect, the likelihood of
the data has a closed form with the model's own parameters, the effects and the common errors
integrated out. The variance of an error of unknown cause that the cells of a pose share is chosen
for every set. So an effect has to beat "something is wrong at each pose", not the noise alone.
Under the model without effects, and with known variances, the expected likelihood ratio of any
candidate is one: P(ratio > m / alpha for any of m candidates) <= alpha (Markov's inequality).
Variances that are chosen raise it to 1.15 for usual priors (2.3 where data and priors are far from
each other); ratios above 20 were less frequent than one in 200 all the same.
"""

from __future__ import annotations

from collections.abc import Iterable
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
#: 300 times the noise in size. A channel has more where the last is the best without candidates:
#: held below what it is, the shared error would make any candidate likely.
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
    grid_index: tuple[int, int]  # of the best variances of the grid, before interpolation


class Addition(NamedTuple):
    """A candidate added to a set."""

    nats: float  # gain in log evidence
    size: int  # index in `EVIDENCE.sizes` of its best size


class _Along(NamedTuple):
    """The normal equations of both channels for the columns of a set."""

    members: tuple[int, ...]
    pose: Gaussians
    torque: Gaussians


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
        no_columns = np.zeros((len(rows.pose_data), 0))
        of_pose = [no_columns, *(block.pose @ block.factor for block in blocks)]
        self._pose = reduced(pose, np.concatenate(of_pose, axis=1), rows.pose_data, rows.own)
        # Without torques their normal equations are zero.
        width = int(stops[-1])
        self._torque = Gaussians.of([Gaussian.none(width)])
        if torque is not None:
            no_columns = np.zeros((len(rows.torque_data), 0))
            showing = np.flatnonzero(self._shows_in_torque).tolist()
            of_torque = [no_columns, *(blocks[k].torque @ blocks[k].factor for k in showing)]
            of_showing = reduced(
                torque, np.concatenate(of_torque, axis=1), rows.torque_data, no_columns
            )
            # The columns of all others are zero.
            self._torque = of_showing.among(_joined(self._columns[k] for k in showing), width)
        self._scores: dict[CandidateSet, Score] = {}
        self._additions: dict[tuple[CandidateSet, tuple[int, ...]], list[Addition]] = {}
        self._last: _Along | None = None

    def score(self, chosen: CandidateSet) -> Score:
        """Return the evidence of a set of candidates."""
        if chosen not in self._scores:
            self._scores[chosen] = self._score(chosen)
        return self._scores[chosen]

    def additions(self, chosen: CandidateSet, candidates: list[int]) -> list[Addition]:
        """Return the gain of a set by each of some candidates.

        It is the best at variances of the grid: at any of the poses' with that of the torques that
        is best without the candidate, and the other way round if the candidate shows in torques. A
        candidate may be what one of both shared errors was, seldom both; `score` then looks
        everywhere, and between the variances of the grid.
        """
        if (key := (chosen, tuple(candidates))) in self._additions:
            return self._additions[key]
        pose_index, torque_index = self.score(chosen).grid_index
        best_pose = slice(pose_index, pose_index + 1)
        best_torque = slice(torque_index, torque_index + 1)
        every = slice(None)
        gains = np.empty((len(EVIDENCE.sizes), len(candidates)))
        # Candidates with equally many columns are computed together.
        widths = np.array([len(self._columns[k]) for k in candidates], dtype=np.intp)
        for width in np.unique(widths):
            at = np.flatnonzero(widths == width)
            columns = np.stack([self._columns[candidates[k]] for k in at])
            gains[:, at] = self._gains(chosen, columns, every, best_torque)
            shows = self._shows_in_torque[np.array(candidates)[at]]
            if shows.any():
                by_torque = self._gains(chosen, columns[shows], best_pose, every)
                gains[:, at[shows]] = np.maximum(gains[:, at[shows]], by_torque)
        best, cost = np.argmax(gains, axis=0), float(np.log(len(EVIDENCE.sizes)))
        found = [Addition(float(gains[size, k]) - cost, int(size)) for k, size in enumerate(best)]
        self._additions[key] = found
        return found

    def _gains(
        self, chosen: CandidateSet, columns: Index, pose_variances: slice, torque_variances: slice
    ) -> Array:
        """Return the gain in log evidence of a set by c candidates at each size, (sizes, c).

        Args:
            chosen: the set; it has k columns.
            columns: (c, j) the columns of each candidate.
            pose_variances: those of the grid to try; one of them, or all.
            torque_variances: likewise. v pairs are tried, of which the best counts.
        """
        of_set, set_sizes = self._columns_and_sizes(chosen)
        pose, torque = self._pose[pose_variances], self._torque[torque_variances]
        without = (pose.along(of_set) + torque.along(of_set)).in_sizes(set_sizes)  # (v,)
        across = pose.across(of_set, columns.ravel()) + torque.across(of_set, columns.ravel())
        across = across * set_sizes[:, None]  # (v, k, c j)
        across = across.reshape(*across.shape[:2], *columns.shape)  # (v, k, c, j)
        of_each = (slice(None), columns[:, :, None], columns[:, None, :])
        gram = pose.gram[of_each] + torque.gram[of_each]  # (v, c, j, j)
        projection = pose.projection[:, columns] + torque.projection[:, columns]  # (v, c, j)
        with_each = without.of_each_further(across, gram, projection)  # (v, c)
        sizes = np.array(EVIDENCE.sizes)[:, None, None, None]
        log_evidence = with_each.in_sizes(sizes).log_evidence  # (sizes, v, c)
        return np.asarray(log_evidence.max(axis=1) - without.log_evidence.max())

    def _score(self, chosen: CandidateSet) -> Score:
        """Return the evidence of a set, at the most likely variances of both shared errors."""
        on_grid = self._on_grid(chosen)
        g, h = _place_of_largest(on_grid)
        pose_variances, by_pose = _spline_about(g, on_grid.shape[0])
        torque_variances, by_torque = _spline_about(h, on_grid.shape[1])
        between = by_pose @ on_grid @ by_torque.T
        p, t = _place_of_largest(between)
        return Score(
            log_evidence=float(between[p, t]) - float(np.log(len(EVIDENCE.sizes))) * len(chosen),
            variances=SharedVariances(float(pose_variances[p]), float(torque_variances[t])),
            grid_index=(g, h),
        )

    def _on_grid(self, chosen: CandidateSet) -> Array:
        """Return the log evidence of a set at the grid of variances of poses and torques, (G, H).

        Without the cost of choosing sizes.
        """
        columns, sizes = self._columns_and_sizes(chosen)
        members = tuple(k for k, _ in chosen)
        if self._last is None or self._last.members != members:  # often scored at other sizes
            self._last = _Along(members, self._pose.along(columns), self._torque.along(columns))
        pose, torque = self._last.pose.in_sizes(sizes), self._last.torque.in_sizes(sizes)
        if self._shows_in_torque[list(members)].any():
            each_torque = (torque[h] for h in range(len(torque.squares)))
            return np.stack([(pose + of_torque).log_evidence for of_torque in each_torque], axis=1)
        # The set does not act on torques: what both channels say adds up.
        of_torque = -0.5 * (torque.squares + torque.log_det)  # (H,), or (1,) if none are logged
        grid = (len(pose.squares), max(len(torque.squares), len(SHARED_VARIANCES)))
        return np.broadcast_to(pose.log_evidence[:, None] + of_torque, grid)

    def _columns_and_sizes(self, chosen: CandidateSet) -> tuple[Index, Array]:
        """Return the columns (k,) of a set, and the size expected of each (k,)."""
        columns = [self._columns[k] for k, _ in chosen]
        sizes = np.array([EVIDENCE.sizes[size] for _, size in chosen])
        widths = np.array([len(of_member) for of_member in columns], dtype=np.intp)
        return _joined(columns), np.repeat(sizes, widths)


def _joined(columns: Iterable[Index]) -> Index:
    """Return the numbers of the columns of several candidates as one array, which may be empty."""
    return np.concatenate([np.zeros(0, dtype=np.intp), *columns])


def _place_of_largest(values: Array) -> tuple[int, int]:
    """Return row and column of the largest of values (r, c)."""
    row, column = divmod(int(np.argmax(values)), values.shape[1])
    return row, column


def _grid(count: int) -> Array:
    """Return so many variances of a grid: `SHARED_VARIANCES`, and higher ones evenly spaced."""
    ratio = SHARED_VARIANCES[-1] / SHARED_VARIANCES[-2]
    powers = np.arange(1, count - len(SHARED_VARIANCES) + 1)
    return np.append(SHARED_VARIANCES, SHARED_VARIANCES[-1] * ratio**powers)


@cache
def _spline_about(best: int, count: int) -> tuple[Array, Array]:
    """Return variances (V,) between the neighbours of one of a grid, and a spline (V, count) there.

    The spline is by its values at `_grid(count)`, in the logarithm of the variance. A parabola
    through three values would be wrong by tens of nats if hundreds of rows share the error; the
    spline is high by some thousandths of a nat a row between them, for all sets alike. At the ends
    of the grid, and at the least variance above zero, there is only the variance itself.
    """
    variances = _grid(count)
    if best < 2 or best >= count - 1:
        return variances[[best]], np.eye(count)[[best]]
    logarithm = np.log(variances[1:])  # zero has none
    between = np.linspace(logarithm[best - 2], logarithm[best], EVIDENCE.variances_between)
    spline = np.asarray(CubicSpline(logarithm, np.eye(count - 1))(between))
    return np.exp(between), np.column_stack([np.zeros(len(between)), spline])


def reduced(channel: NoiseModel, columns: Array, data: Array, own: Array) -> Gaussians:
    """Return normal equations of candidates at each variance of a grid, (G,).

    It is `SHARED_VARIANCES`, and as many higher ones as the best without candidates needs. The
    model's own parameters and the errors common to all poses are integrated out.
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
        return every.without(
            np.arange(c + k)
        )  # those of common errors and of the model stand first

    models = [at(variance) for variance in SHARED_VARIANCES.tolist()]
    while np.argmin([each.squares + each.log_det for each in models]) == len(models) - 1:
        models.append(at(float(_grid(len(models) + 1)[-1])))
    return Gaussians.of(models)
