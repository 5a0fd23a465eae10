"""Rows by which short forms are compared with what they may stand for, on blocks left out.

Whoever judged, what is left is linear: weighed rows of the data, columns of what the model has
anyway, columns of the map or rival in question, and columns of every short form.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from pa10cal.arm.state import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.terms.forms.form import Form


@dataclass(frozen=True, eq=False)
class Contest:
    """R weighed rows, in B blocks."""

    data: Array  # (R,) measured minus predicted
    own: Array  # (R, n) columns of what the model has anyway, each in the size expected of it
    block: Index  # (R,) number of the block of each row, from 0

    @cached_property
    def blocks(self) -> list[Index]:
        """Return the rows of each block."""
        return [np.flatnonzero(self.block == b) for b in range(int(self.block.max()) + 1)]

    @cached_property
    def _own_grams(self) -> Array:
        return np.stack([self.own[at].T @ self.own[at] for at in self.blocks])

    @cached_property
    def _own_projections(self) -> Array:
        return np.stack([self.own[at].T @ self.data[at] for at in self.blocks])

    @cached_property
    def _elsewhere(self) -> list[tuple[tuple[Array, bool], Array]]:
        """Return, with each block left out, own products factored and what own columns leave it."""
        found = []
        grams, projections = self._own_grams, self._own_projections
        for own_gram, own_projection in zip(grams, projections, strict=True):
            gram = grams.sum(axis=0) - own_gram + np.eye(self.own.shape[1])
            projection = projections.sum(axis=0) - own_projection
            factor = cho_factor(gram)
            bare = cho_solve(factor, projection)
            found.append((factor, bare))
        return found

    def squares(self, candidates: Sequence[Array]) -> Array:
        """Return the squared error of every block, predicted from the others, (m, B).

        Args:
            candidates: m candidates' columns (R, k) each, in the size expected of them.
        """
        found = np.empty((len(candidates), len(self.blocks)))
        widths = np.array([each.shape[1] for each in candidates])
        for width in np.unique(widths):
            places = np.flatnonzero(widths == width)
            columns = np.stack([candidates[k] for k in places.tolist()], axis=1)
            found[places] = self._squares(columns)
        return found

    def _squares(self, columns: Array) -> Array:
        """Return the squared error of every block with columns (R, m, k), (m, B)."""
        _, m, k = columns.shape
        n = self.own.shape[1]
        here = [columns[at] for at in self.blocks]
        across = [
            (self.own[at].T @ each.reshape(len(at), m * k)).reshape(n, m, k)
            for at, each in zip(self.blocks, here, strict=True)
        ]
        grams = [_each_with(each, each) for each in here]
        with_data = [
            np.tensordot(self.data[at], each, axes=1)
            for at, each in zip(self.blocks, here, strict=True)
        ]
        every_across = np.sum(across, axis=0)
        every_gram, every_with = np.sum(grams, axis=0), np.sum(with_data, axis=0)
        found = np.empty((m, len(self.blocks)))
        for b, (at, (factor, bare)) in enumerate(zip(self.blocks, self._elsewhere, strict=True)):
            beside = every_across - across[b]
            followed = cho_solve(factor, beside.reshape(n, m * k)).reshape(n, m, k)
            open_ = every_with - with_data[b] - np.tensordot(bare, beside, axes=1)
            gram = every_gram - grams[b] - _each_with(beside, followed) + np.eye(k)
            amounts = np.linalg.solve(gram, open_[:, :, None])[:, :, 0]
            left = self.data[at] - self.own[at] @ bare
            own_moves = np.einsum("nmk,mk->nm", followed, amounts)
            moved = np.einsum("rmk,mk->rm", here[b], amounts) - self.own[at] @ own_moves
            found[:, b] = np.sum((left[:, None] - moved) ** 2, axis=0)
        return found

    def fitted(self, columns: Array) -> tuple[Array, Array]:
        """Return amounts (k,) of columns (R, k) by all blocks, and their covariance (k, k)."""
        both = np.concatenate([self.own, columns], axis=1)
        normal = both.T @ both + np.eye(both.shape[1])
        inverse = np.linalg.inv(normal)
        amounts = inverse @ (both.T @ self.data)
        k = columns.shape[1]
        return amounts[-k:] if k else amounts[:0], inverse[-k:, -k:] if k else inverse[:0, :0]


@dataclass(frozen=True, eq=False)
class Arena:
    """Where short forms are held against what they may stand for."""

    contest: Contest  # rows and blocks
    # (R, h) columns of the maps and rivals in question, in the size expected of them; None where
    # there are none
    held: Array | None
    # gives the columns (R, k) of forms, in their size
    columns_of: Callable[[Sequence[Form]], list[Array]]
    states: PoseStates  # of the poses that its rows are of
    # squared error of all rows that noise alone would leave; None where rows are weighed by that
    # noise
    noise: float | None


def _each_with(columns: Array, others: Array) -> Array:
    """Return the products (m, k, k) of columns (R, m, k) of each candidate with others of it."""
    return np.asarray(columns.transpose(1, 2, 0) @ others.transpose(1, 0, 2))
