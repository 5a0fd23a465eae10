"""The gain of log evidence by candidates in a residual, beside all columns of the model.

A search by itself cannot try some candidates: a line of a gear may have any number of cycles a turn
(`gear_lines`), a soft bearing looks nearly like a wobble (`wobbles`), and a stretch of time that
alone shows a warm-up is predicted from all others (`warm_ups_shown`). So the gain of their log
evidence is computed in the residual of a search, beside all that could imitate them. What stands
out joins the candidates, and the search decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array

from pa10cal.arrays import Array
from pa10cal.discovery import jacobians
from pa10cal.discovery.blocked_cv.normal_equations import normal_equations_of
from pa10cal.discovery.jacobians import WhitenedPoses
from pa10cal.fit.problem import possible_sizes
from pa10cal.numerics.gaussian import Gaussian, Gaussians
from pa10cal.numerics.periodic_spline import b_splines_by_knots, spline_columns
from pa10cal.terms.effects.joint_error_map import is_error_map


@dataclass(frozen=True, eq=False)
class ModelColumns:
    """Columns of a model, and of what else could imitate candidates: all that is integrated out.

    Maps of the model may be kept as the derivative by the angles of their joints, since a pose
    touches four of a map's hundreds of columns. They stand last, in knots of the expected size.
    """

    columns: Array  # (P, b, d) whitened, each in its expected size; of all but such maps
    data: Array  # (P, b) whitened, measured less predicted
    by_angle: Array  # (P, b, m) whitened derivative by the angle of each map
    q_rad: Array  # (P, m) these angles
    bases: tuple[Array, ...]  # (K, K) coefficients of the B-splines of each map, by its knots

    @classmethod
    def of(cls, rows: WhitenedPoses, *others: Array) -> ModelColumns:
        """Return a model's terms and targets, and other whitened columns (P, b, k)."""
        at, poses, sizes = rows.at, rows.poses, possible_sizes(rows.at.model)
        maps = [term for term in at.model.terms if is_error_map(term)]
        terms = [term for term in at.model.terms if not is_error_map(term)]
        own = jacobians.by_scaled_terms(at, poses, terms, rows.whitener)
        return cls(
            np.concatenate([*own, rows.by_targets, *others], axis=2),
            rows.data,
            rows.whitener @ jacobians.by_joints(at, poses, [term.joint for term in maps]),
            poses.states.q_rad[:, [term.joint - 1 for term in maps]],
            tuple(b_splines_by_knots(m.knots) * sizes[at.model.columns_of(m)] for m in maps),
        )

    @classmethod
    def dense(cls, columns: Array, data: Array) -> ModelColumns:
        """Return columns without such maps."""
        return cls(columns, data, columns[:, :, :0], np.zeros((len(data), 0)), ())

    def without_maps(self, rows: WhitenedPoses) -> ModelColumns:
        """Return the columns without the maps; what these predict is in the data then."""
        states, values_of, data = rows.poses.states, rows.at.values_of, self.data.copy()
        maps = [term for term in rows.at.model.terms if is_error_map(term)]
        for term, by_angle in zip(maps, np.moveaxis(self.by_angle, 2, 0), strict=True):
            data += by_angle * term.shift(states, values_of(term))
        return ModelColumns.dense(self.columns, data)

    @cached_property
    def equations(self) -> Gaussian:
        """Return the normal equations of the columns."""
        columns, data = self.columns.reshape(-1, self.columns.shape[2]), self.data.ravel()
        return normal_equations_of(data, columns, self._by_splines(self.by_angle), self.bases)

    @property
    def seen(self) -> int:
        """Return the number of components that were measured; all others are zero."""
        return int(np.count_nonzero(self.data))

    def beside(self, column: Array) -> tuple[Array, csr_array]:
        """Return products with a column (P, b), pose by pose: (P, d), and with all B-splines."""
        of_maps = np.einsum("pbm,pb->pm", self.by_angle, column)[:, None]
        return np.einsum("pbn,pb->pn", self.columns, column), self._by_splines(of_maps)

    def across(self, dense: Array, splines: csr_array, right: Array) -> Array:
        """Return products (n, t) with right sides (R, t), by rows of `columns` and B-splines."""
        of_splines = splines.T @ right
        stops = np.cumsum([0, *(len(basis) for basis in self.bases)])
        of_maps = zip(self.bases, pairwise(stops), strict=True)
        turned = [basis.T @ of_splines[first:last] for basis, (first, last) in of_maps]
        return np.concatenate([dense.T @ right, *turned])

    def with_each(self, candidates: Array) -> Gaussians:
        """Return the equations of each of K candidates, by whitened columns (P, b, K, k)."""
        right, columns = candidates.reshape(self.data.size, -1), self.columns
        dense, splines = columns.reshape(len(right), -1), self._by_splines(self.by_angle)
        across = self.across(dense, splines, right).reshape(-1, *candidates.shape[2:])
        gram = np.einsum("pbki,pbkj->kij", candidates, candidates, optimize=True)
        projection = np.einsum("pbki,pb->ki", candidates, self.data, optimize=True)
        return self.equations.of_each_further(across, gram, projection)

    def _by_splines(self, by_angle: Array) -> csr_array:
        """Return derivatives (P, b, m) by the angles of maps as those by B-splines, (P b, K)."""
        return spline_columns(by_angle, self.q_rad, [len(basis) for basis in self.bases])
