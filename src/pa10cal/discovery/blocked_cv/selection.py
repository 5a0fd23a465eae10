"""Sets of effects, judged by the sum of squares of blocks of poses that were held out.

For every block the parameters are found from all others, those of the calibrated model among them,
each with its expected size; the block is then predicted. All is linear, so an effect joins or
leaves by block elimination on the inverse of the normal equations, without solving them anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from pa10cal.arrays import Array, Index
from pa10cal.discovery.blocked_cv.survey import Products

#: Part of a parameter's own certainty that stands for a prior where it has none.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns that join together, with the sizes expected of their parameters."""

    at: Index  # (k,) which columns
    sizes: Array  # (k,) standard deviation expected of each

    @property
    def prior(self) -> Array:
        """Return the precision (k, k) that the sizes are."""
        return np.diag(self.sizes**-2.0)


@dataclass(frozen=True, eq=False)
class State:
    """A set of members beside the calibrated model."""

    products: Products  # of all columns, block by block
    total: Products  # the same summed over the blocks
    # the calibrated model's own columns, then members in the order in which they joined
    members: tuple[Columns, ...]
    inverse: Array  # (B, n, n) inverse of the normal equations with each block held out

    @cached_property
    def at(self) -> Index:
        """Return the (n,) columns in use, member by member."""
        return np.concatenate([each.at for each in self.members])

    @cached_property
    def solution(self) -> Array:
        """Return the parameters found without each block, (B, n)."""
        projection = (self.total.projection - self.products.projection)[:, self.at]
        found: Array = (self.inverse @ projection[:, :, None])[:, :, 0]
        return found

    @cached_property
    def squares(self) -> Array:
        """Return the sum of squares of every block, predicted from the others, (B,)."""
        return np.array(
            [predicted_squares(self.products, b, self.at, x) for b, x in enumerate(self.solution)]
        )

    @cached_property
    def position_squares(self) -> Array:
        """Return the part of `squares` that is of positions, (B,)."""
        positions = self.products.of_positions
        assert positions is not None
        return np.array(
            [predicted_squares(positions, b, self.at, x) for b, x in enumerate(self.solution)]
        )

    def with_each(self, candidates: Sequence[Columns]) -> Array:
        """Return the sums of squares with each of some candidates added, (m, B)."""
        blocks = range(len(self.squares))
        return np.stack([self._with_each(b, candidates) for b in blocks], axis=1)

    def without_each(self) -> Array:
        """Return the sums of squares with each member but the first taken out, (m, B)."""
        found = np.empty((len(self.members) - 1, len(self.squares)))
        for k in range(len(found)):
            for b, x in enumerate(self.solution_without(k + 1)):
                found[k, b] = predicted_squares(self.products, b, self.at, x)
        return found

    def solution_without(self, member: int) -> Array:
        """Return the parameters (B, n) with a member taken out, its own zero."""
        own = self._places()[member]
        found = np.empty_like(self.solution)
        for b, inverse in enumerate(self.inverse):
            taken = np.linalg.solve(inverse[np.ix_(own, own)], self.solution[b][own])
            found[b] = self.solution[b] - inverse[:, own] @ taken
        found[:, own] = 0.0
        return found

    def extended(self, candidate: Columns) -> State:
        """Return the set with one more member."""
        there, new = self.at, candidate.at
        n, m = len(there), len(new)
        inverse = np.empty((len(self.inverse), n + m, n + m))
        for b, known in enumerate(self.inverse):
            across = self._elsewhere(b, there, new)
            followed = known @ across
            schur = _inverse(self._elsewhere(b, new, new) - across.T @ followed, candidate.sizes)
            corner = -followed @ schur
            inverse[b, :n, :n] = known - corner @ followed.T
            inverse[b, :n, n:], inverse[b, n:, :n] = corner, corner.T
            inverse[b, n:, n:] = schur
        return State(self.products, self.total, (*self.members, candidate), inverse)

    def reduced(self, member: int) -> State:
        """Return the set without one member."""
        own = self._places()[member]
        rest = np.delete(np.arange(len(self.at)), own)
        inverse = np.empty((len(self.inverse), len(rest), len(rest)))
        for b, known in enumerate(self.inverse):
            across = known[np.ix_(rest, own)]
            corner = np.linalg.solve(known[np.ix_(own, own)], across.T)
            inverse[b] = known[np.ix_(rest, rest)] - across @ corner
        members = tuple(each for k, each in enumerate(self.members) if k != member)
        return State(self.products, self.total, members, inverse)

    def _with_each(self, b: int, candidates: Sequence[Columns]) -> Array:
        """Return the sum of squares of a block with each candidate added, (m,)."""
        there, here = self.at, self.solution[b]
        every = np.unique(np.concatenate([each.at for each in candidates]))
        across = self._elsewhere(b, there, every)
        followed = self.inverse[b] @ across
        projection = self.total.projection[every] - self.products.projection[b, every]
        open_ = projection - across.T @ here
        steps = np.zeros((len(candidates), len(there)))
        amounts = np.zeros((len(candidates), len(every)))
        for k, candidate in enumerate(candidates):
            own = np.searchsorted(every, candidate.at)
            schur = self._elsewhere(b, candidate.at, candidate.at)
            schur = schur - across[:, own].T @ followed[:, own]
            amounts[k, own] = solve(schur, open_[own], candidate.prior)
            steps[k] = -followed[:, own] @ amounts[k, own]
        gram, projection = self.products.gram[b], self.products.projection[b]
        own_gram, across = gram[np.ix_(there, there)], gram[np.ix_(there, every)]
        change = -2.0 * steps @ (projection[there] - own_gram @ here)
        change -= 2.0 * amounts @ (projection[every] - across.T @ here)
        change += np.sum(steps * (steps @ own_gram), axis=1)
        change += 2.0 * np.sum((steps @ across) * amounts, axis=1)
        change += np.sum(amounts * (amounts @ gram[np.ix_(every, every)]), axis=1)
        squares: Array = self.squares[b] + change
        return squares

    def _elsewhere(self, b: int, rows: Index, columns: Index) -> Array:
        """Return the products of columns over all blocks but one."""
        at = np.ix_(rows, columns)
        found: Array = self.total.gram[at] - self.products.gram[b][at]
        return found

    def _places(self) -> list[Index]:
        """Return where each member's columns stand in the set."""
        stops = np.cumsum([0, *(len(member.at) for member in self.members)])
        return [np.arange(first, last) for first, last in pairwise(stops)]


def start(products: Products, members: Sequence[Columns]) -> State:
    """Return a set, solved from the beginning; the calibrated model's own columns come first."""
    total = products.summed()
    at = np.concatenate([each.at for each in members])
    sizes = np.concatenate([each.sizes for each in members])
    own = np.ix_(at, at)
    inverse = np.stack([_inverse(total.gram[own] - gram[own], sizes) for gram in products.gram])
    return State(products, total, tuple(members), inverse)


def predicted_squares(products: Products, b: int, at: Index, x: Array) -> float:
    """Return what parameters x (n,) of some columns leave of a block's sum of squares."""
    gram, projection = products.gram[b][np.ix_(at, at)], products.projection[b, at]
    return float(products.squares[b] - 2.0 * projection @ x + x @ gram @ x)


def solve(gram: Array, projection: Array, prior: Array) -> Array:
    """Return the best parameters (k,) or (k, m) by products and a prior precision (k, k)."""
    normal = gram + prior
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), np.diag(prior)))
    scaled = (projection.T * scale).T
    try:
        factor = cho_factor(normal * np.outer(scale, scale), check_finite=False)
    except LinAlgError:
        return no_wider_than(normal, prior) @ projection
    solved: Array = (cho_solve(factor, scaled, check_finite=False).T * scale).T
    return solved


def no_wider_than(normal: Array, prior: Array) -> Array:
    """Return the inverse of normal equations that rounding left less certain than their prior.

    Products less what other columns take of them are no smaller than zero.

    Args:
        normal: (k, k) with the prior in it.
        prior: (k, k) precision expected; a row of zeros for a parameter without.
    """
    bare = np.diag(prior) == 0.0
    root = np.linalg.cholesky(prior + np.diag(np.where(bare, _ROUNDING * np.diag(normal), 0.0)))
    within = np.linalg.solve(root, np.linalg.solve(root, normal).T)
    values, vectors = np.linalg.eigh(0.5 * (within + within.T))
    vectors = np.linalg.solve(root.T, vectors)
    inverse: Array = (vectors / np.maximum(values, 1.0)) @ vectors.T
    return inverse


def _inverse(gram: Array, sizes: Array) -> Array:
    """Return the inverse of products plus what is expected of the parameters."""
    return solve(gram, np.eye(len(sizes)), np.diag(sizes**-2.0))
