"""Weighed rows of a survey: the data, the model's own parameters, effects, and fine maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from pa10cal.arrays import Array, Index
from pa10cal.discovery.blocked_cv.survey import BLOCKS, Survey
from pa10cal.discovery.linear import (
    by_joints,
    by_targets,
    by_terms,
    possible_sizes,
    residual,
    unknowns,
)
from pa10cal.discovery.weights import PoseWeights
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.numerics.least_squares import Bounds
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.effect import Effect, turning_joints
from pa10cal.terms.effects.joint_error_map import b_splines, b_splines_by_knots, harmonics_at_knots
from pa10cal.terms.weights import Weights

# Products of weighed rows with each other, block of poses by block.
#
# All that is needed of the data afterwards, which effects help and how well held-out poses are
# predicted, needs these products and no row. Maps of joint errors are kept as what turning the
# joint does and four B-splines of its angle: each pose touches four of a map's many columns.

#: Rows are left out where no more than this part of them was seen.
_WORTHWHILE = 0.75


@dataclass(frozen=True, eq=False)
class Products:
    """Products of N columns and the data in each of B blocks."""

    gram: Array  # (B, N, N) of columns with columns
    projection: Array  # (B, N) of columns with the data
    squares: Array  # (B,) of the data
    # the same of the rows of positions alone, where it was requested
    of_positions: Products | None = None

    def summed(self) -> Products:
        """Return the sums over the blocks: (N, N), (N,) and a number without dimension."""
        return Products(
            self.gram.sum(axis=0), self.projection.sum(axis=0), np.asarray(self.squares.sum())
        )


def products(data: Array, dense: Array, maps: csr_array) -> tuple[Array, Array, float]:
    """Return the products of some rows: gram (N, N), projection (N,) and squares.

    Args:
        data: (R,) weighed rows of the data.
        dense: (R, d) weighed columns.
        maps: (R, K) weighed columns of B-splines.

    Returns:
        Of N = d + K columns.
    """
    d, total = dense.shape[1], dense.shape[1] + maps.shape[1]
    seen = np.asarray(dense.any(axis=1))
    if np.count_nonzero(seen) < _WORTHWHILE * len(seen):  # components of other campaigns
        data, dense, maps = data[seen], dense[seen], maps[np.flatnonzero(seen)]
    gram = np.empty((total, total))
    gram[:d, :d] = dense.T @ dense
    gram[d:, :d] = maps.T @ dense
    gram[:d, d:] = gram[d:, :d].T
    gram[d:, d:] = (maps.T @ maps).toarray()
    return gram, np.concatenate([dense.T @ data, maps.T @ data]), float(data @ data)


def in_terms_of(
    gram: Array, projection: Array, dense: int, bases: Sequence[Array]
) -> tuple[Array, Array]:
    """Return products in terms of other parameters of the maps.

    Args:
        gram, projection: of d dense columns, then of B-splines, one map after the other.
        dense: d.
        bases: (K1, h1), (K2, h2), … coefficients of the B-splines that each map's new parameters
            stand for.
    """
    old = list(pairwise(dense + np.cumsum([0, *(len(basis) for basis in bases)])))
    new = list(pairwise(dense + np.cumsum([0, *(basis.shape[1] for basis in bases)])))
    total = dense + sum(basis.shape[1] for basis in bases)
    half = np.empty((total, len(gram)))
    half[:dense] = gram[:dense]
    turned, found = np.empty((total, total)), np.empty(total)
    found[:dense] = projection[:dense]
    for basis, (first, last), (own, end) in zip(bases, old, new, strict=True):
        half[own:end] = basis.T @ gram[first:last]
        found[own:end] = basis.T @ projection[first:last]
    turned[:, :dense] = half[:, :dense]
    for basis, (first, last), (own, end) in zip(bases, old, new, strict=True):
        turned[:, own:end] = half[:, first:last] @ basis
    return turned, found


def map_columns(screws: Array, q_rad: Array, knots: Sequence[int]) -> csr_array:
    """Return how rows follow the B-splines of every joint's map, sparse.

    Args:
        screws: (P, 6, j) how rows follow the joints' angles.
        q_rad: (P, j) these angles.
        knots: K1, K2, … of the maps.

    Returns:
        (6 P, K1 + K2 + …), the rows pose by pose.
    """
    count, rows, joints = screws.shape
    if not joints:
        return csr_array((count * rows, 0))
    splines = [b_splines(each, q_rad[:, j]) for j, each in enumerate(knots)]
    first = np.cumsum([0, *knots])
    values = np.stack([each.data.reshape(count, 4) for each in splines], axis=1)
    columns = np.stack(
        [each.indices.reshape(count, 4) + first[j] for j, each in enumerate(splines)], axis=1
    )
    data = screws[:, :, :, None] * values[:, None]
    indices = np.broadcast_to(columns[:, None], data.shape)
    starts = np.arange(count * rows + 1) * 4 * joints
    return csr_array((data.ravel(), indices.ravel(), starts), shape=(count * rows, first[-1]))


#: What is expected of weights stands among the rows, and not beside them.
_NOT_TWICE = 100.0


@dataclass(frozen=True)
class ShapedEffect:
    """An effect at one of its shapes."""

    effect: Effect  # which, and where
    shape: int = 0  # number of its start

    @property
    def start(self) -> Array:
        """Return the parameters at which it is linearised."""
        return self.effect.starts[self.shape]


@dataclass(frozen=True)
class BlockRows:
    """Weighed rows of one block of p poses."""

    data: Array  # (b p,) measured less predicted
    dense: Array  # (b p, d) columns of own parameters and effects, each in its size
    screws: Array  # (p, b, j) how the rows follow the angle of every revolute joint
    q_rad: Array  # (p, j) these angles

    def maps(self, knots: Sequence[int]) -> csr_array:
        """Return the columns of the B-splines of every revolute joint's map, K of each given."""
        return map_columns(self.screws, self.q_rad, knots)


@dataclass(frozen=True)
class Rows:
    """Rows about the calibrated model, in columns: own parameters, effects, harmonics of maps."""

    survey: Survey  # the campaign
    weights: PoseWeights  # what each pose counts
    shaped: tuple[ShapedEffect, ...]  # effects, in the order of their columns
    knots: int  # K of the maps, whose columns are the K - 1 harmonics of each revolute joint

    @cached_property
    def place(self) -> FittedModel:
        """Return the calibrated model."""
        baseline = self.survey.baseline
        x = np.concatenate([baseline.x, np.zeros(6)])
        return replace(baseline, model=self.survey.model(), x=x)

    @cached_property
    def joints(self) -> tuple[int, ...]:
        """Return the joints, from 1, that have maps."""
        return turning_joints(self.survey.context)

    @cached_property
    def basis(self) -> Array:
        """Return the coefficients of B-splines (K, K - 1) of every harmonic of unit amplitude."""
        found: Array = b_splines_by_knots(self.knots) @ harmonics_at_knots(self.knots)[:, 1:]
        return found

    @property
    def own(self) -> Index:
        """Return the columns of the model's own parameters, and of the survey's nuisances."""
        beside = sum(len(each.sizes) for each in self.survey.nuisances)
        return np.arange(len(unknowns(self.place)) + beside)

    @property
    def of_weights(self) -> Index:
        """Return the columns of weights that are uncertain, among the model's own."""
        model = self.place.model
        places = [model.columns_of(each) for each in model.terms if isinstance(each, Weights)]
        return np.concatenate([np.zeros(0, np.intp), *(self.own[at] for at in places)])

    @property
    def own_sizes(self) -> Array:
        """Return the sizes expected of the model's own parameters, beside what rows say of them."""
        sizes = np.ones(len(self.own))
        sizes[self.of_weights] = _NOT_TWICE
        return sizes

    @property
    def pressing(self) -> NDArray[np.bool_]:
        """Return which of the model's own parameters the calibration left at a bound."""
        model, x = self.place.model, self.place.x
        bounds = Bounds.of(model.parameters)
        pressing = np.zeros(len(self.own), dtype=bool)
        pressing[: len(x)] = (x <= bounds.lower) | (x >= bounds.upper)
        return pressing

    def of_shaped(self) -> list[Index]:
        """Return the columns of each effect."""
        stops = len(self.own) + np.cumsum([0, *(each.effect.linear for each in self.shaped)])
        return [np.arange(*ends) for ends in pairwise(stops)]

    def of_map(self, joint: int) -> Index:
        """Return the columns of the map of a joint, from 1."""
        first = len(self.own) + sum(each.effect.linear for each in self.shaped)
        harmonics = self.knots - 1
        first += self.joints.index(joint) * harmonics
        return np.arange(first, first + harmonics)

    def products(self) -> Products:
        """Return the products of all columns, block by block."""
        total = len(self.own) + sum(each.effect.linear for each in self.shaped)
        total += len(self.joints) * (self.knots - 1)
        gram = np.empty((2, BLOCKS, total, total))
        projection, squares = np.empty((2, BLOCKS, total)), np.empty((2, BLOCKS))
        for b in range(BLOCKS):
            rows = self.block(b)
            maps = rows.maps([self.knots] * len(self.joints))
            for kind, at in enumerate(self.kinds(len(rows.data))):
                of_splines, with_data, squares[kind, b] = products(
                    rows.data[at], rows.dense[at], maps[at]
                )
                gram[kind, b], projection[kind, b] = in_terms_of(
                    of_splines, with_data, rows.dense.shape[1], [self.basis] * len(self.joints)
                )
        gram[1] += gram[0]
        projection[1] += projection[0]
        # What is known of the weights is told like readings, some in every block: what they would
        # have to be to explain an error counts against them.
        of_weights = self.of_weights
        gram[1][:, of_weights, of_weights] += 1.0 / BLOCKS
        positions = Products(gram[0], projection[0], squares[0])
        return Products(gram[1], projection[1], squares.sum(axis=0), positions)

    def block(self, b: int) -> BlockRows:
        """Return the rows of one block."""
        here = np.flatnonzero(self.survey.block == b)
        poses, whiten = self.survey.poses.take(here), self.weights.whiteners(here)
        dense = whiten @ np.concatenate([self._own(poses), *self._effects(poses)], axis=2)
        screws = whiten @ by_joints(self.place, poses, self.joints)
        q_rad = poses.states.q_rad[:, [joint - 1 for joint in self.joints]]
        data = -whiten @ residual(self.place, poses)[:, :, None]
        return BlockRows(data.ravel(), dense.reshape(-1, dense.shape[2]), screws, q_rad)

    def left_of(self, b: int, x: Array) -> Array:
        """Return what m sets of parameters (N, m) leave of a block, measured less predicted.

        Returns:
            (p, b, m) components [m, rad], neither whitened nor weighed.
        """
        rows = self.block(b)
        first = rows.dense.shape[1]
        harmonics = x[first:].reshape(len(self.joints), self.knots - 1, x.shape[1])
        splines = np.einsum("kh,jhm->jkm", self.basis, harmonics, optimize=True)
        columns = rows.maps([self.knots] * len(self.joints))
        maps = columns @ splines.reshape(columns.shape[1], x.shape[1])
        left_over = rows.data[:, None] - rows.dense @ x[:first] - maps
        whiteners = self.weights.whiteners(np.flatnonzero(self.survey.block == b))
        found: Array = np.linalg.solve(whiteners, left_over.reshape(*whiteners.shape[:2], -1))
        return found

    def _own(self, poses: Observations) -> Array:
        model, x = self.place.model, self.place.x
        stops = np.cumsum([0, *(len(term.parameters) for term in model.terms)])
        points = [x[first:last] for first, last in pairwise(stops)]
        columns = by_terms(self.place, poses, model.terms, points)
        columns.append(by_targets(self.place, poses))
        found: Array = np.concatenate(columns, axis=2) * possible_sizes(model, poses.measured)
        beside = [each.columns(self.place, poses) for each in self.survey.nuisances]
        return np.concatenate([found, *beside], axis=2)

    def _effects(self, poses: Observations) -> Sequence[Array]:
        effects = [each.effect for each in self.shaped]
        found = by_terms(self.place, poses, effects, [each.start for each in self.shaped])
        return [
            columns[:, :, : effect.linear] @ effect.prior_factor
            for effect, columns in zip(effects, found, strict=True)
        ]

    def kinds(self, count: int) -> tuple[Index, Index]:
        """Return which of so many rows are of positions, and which of attitudes."""
        measured = self.survey.poses.measured
        components = measured.components_seen.shape[1]
        of_positions = np.isin(np.arange(count) % components, measured.position_columns)
        return np.flatnonzero(of_positions), np.flatnonzero(~of_positions)
