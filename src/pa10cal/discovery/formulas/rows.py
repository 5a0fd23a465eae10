"""Rows by which short forms are compared with what they may stand for, on blocks left out.

Whoever judged, what is left is linear: weighed rows of the data, columns of what the model has
anyway, columns of the map or rival in question, and columns of every short form.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from pa10cal.terms.forms.form import Form

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Contest:
    """R weighed rows, in B blocks.

    Attributes:
        data: (R,) measured minus predicted.
        own: (R, n) columns of what the model has anyway, each in the size expected of it.
        block: (R,) number of the block of each row, from 0.
    """

    data: Array
    own: Array
    block: Index

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

    def squares(self, candidates: Sequence[Array]) -> Array:
        """Return the squared error of every block, predicted from the others, (m, B).

        Args:
            candidates: m candidates' columns (R, k) each, in the size expected of them.
        """
        stops = np.cumsum([0, *(each.shape[1] for each in candidates)])
        places = [np.arange(*ends) for ends in pairwise(stops.tolist())]
        columns = np.concatenate([np.zeros((len(self.data), 0)), *candidates], axis=1)
        across = np.stack([self.own[at].T @ columns[at] for at in self.blocks])
        projection = np.stack([columns[at].T @ self.data[at] for at in self.blocks])
        grams = [
            np.stack([columns[np.ix_(at, own)].T @ columns[np.ix_(at, own)] for at in self.blocks])
            for own in places
        ]
        found = np.empty((len(candidates), len(self.blocks)))
        for b, at in enumerate(self.blocks):
            n = self.own.shape[1]
            gram = self._own_grams.sum(axis=0) - self._own_grams[b] + np.eye(n)
            factor = cho_factor(gram)
            of_data = self._own_projections.sum(axis=0) - self._own_projections[b]
            elsewhere = across.sum(axis=0) - across[b]
            followed = cho_solve(factor, np.column_stack([of_data, elsewhere]))
            bare, followed = followed[:, 0], followed[:, 1:]
            open_ = projection.sum(axis=0) - projection[b] - elsewhere.T @ bare
            left = self.data[at] - self.own[at] @ bare
            for k, own in enumerate(places):
                schur = grams[k].sum(axis=0) - grams[k][b] + np.eye(len(own))
                schur = schur - elsewhere[:, own].T @ followed[:, own]
                amounts = np.linalg.solve(schur, open_[own])
                moved = columns[np.ix_(at, own)] - self.own[at] @ followed[:, own]
                found[k, b] = np.sum((left - moved @ amounts) ** 2)
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
    """Where short forms are held against what they may stand for.

    Attributes:
        contest: rows and blocks.
        held: (R, h) columns of the maps and rivals in question, in the size expected of them; None
            where there are none.
        columns_of: gives the columns (R, k) of forms, in their size.
        noise: squared error of all rows that noise alone would leave; None where rows are weighed
            by that noise.
    """

    contest: Contest
    held: Array | None
    columns_of: Callable[[Sequence[Form]], list[Array]]
    noise: float | None
