"""Rows of a model, linear about its fit, from which groups of poses can be held out.

What noise and parameters add to squared errors of position is known of each component; components
count by how certainly noise lets their squares be known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from pa10cal.arm.chain import BASE
from pa10cal.arrays import Array, Index, Mask
from pa10cal.fit.fitted import Fitted
from pa10cal.fit.position_errors import noise_mm2, to_mm
from pa10cal.fit.problem import GaussianPrior, Problem, Rows, possible_sizes
from pa10cal.fit.repeatability import along_noise_axes, components_factor, trust_of
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.observe.points import keep_their_distances
from pa10cal.rules import LACK
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import base_frame
from pa10cal.terms.wrapped import fixed

#: Least divisor, and least variance [m², rad²] (computing).
_TINY, _NO_VARIANCE, _NO_SQUARE_MM2 = 1e-300, 1e-24, 1e-18


def _by_variance(measured: Instrument, residual: Array, variance: Array) -> Array:
    """Return root weights of components (P, b): by the larger of stated and observed variance."""
    seen, weight = measured.components_seen, np.zeros_like(residual)
    for _, columns in measured.component_kinds:
        of_kind = residual[:, columns][seen[:, columns]]
        observed = np.median(of_kind**2) / LACK.median_square if len(of_kind) else 1.0
        larger = np.maximum(variance[:, columns], max(observed, _NO_VARIANCE))
        weight[:, columns] = np.where(seen[:, columns], 1.0 / np.sqrt(larger), 0.0)
    return weight


def less_far_off(measured: Instrument, white: Array) -> Array:
    """Return by how much poses count in the fit of the others, (P,), by white residuals (P, b)."""
    seen = measured.components_seen
    size = np.sqrt((white**2).sum(axis=1) / np.maximum(seen.sum(axis=1), 1))
    return np.asarray(np.minimum(1.0, LACK.far * np.median(size) / np.maximum(size, _TINY)))


def _prior_about(expected: GaussianPrior, x: Array, free: Index, sizes: Array) -> Gaussian:
    """Return a prior of parameters as one of their deviations from x (k,), over sizes (u,).

    The first of the u unknowns are the parameters `free`. The prior is one of the first parameters
    of x, those of the arm, and says nothing of the others, such as those of the tool.
    """
    count = len(expected.mean)
    known = np.append(free < count, np.zeros(len(sizes) - len(free), bool))
    at = np.zeros(len(sizes), np.intp)  # of others the size is 0
    at[known] = free[free < count]
    off = expected.precision @ (x[:count] - expected.mean)
    gaussian = Gaussian.of_products(expected.precision[np.ix_(at, at)], off[at])
    return gaussian.in_sizes(np.where(known, sizes, 0.0))


def _with_maps_held(model: Fitted) -> tuple[Model, Index]:
    """Return a model with its maps held and a free base, and the indices of the free parameters."""
    held, free = [], []
    for term in model.model.terms:
        held.append(fixed(term, model.values_of(term)) if term.at_knots else term)
        if not term.at_knots:
            free.append(term)
    at = Model(model.model.chain, (*held, base_frame()))
    return at, model.model.parameter_indices(*free)


class SquaresOfPoses(NamedTuple):
    """Squares of position errors beyond noise, and by how much each counts."""

    mm2: Array  # (N,)
    certainty: Array  # (N,)


@dataclass(frozen=True, eq=False)
class RowsAboutFit:
    """Weighted rows of a model, linear about its fit, from which groups of poses can be taken.

    The unknowns are the model's parameters but for those of maps, six small motions of the base,
    and t coordinates of targets.
    """

    data: Array  # (P, b) weighted residuals without the field
    residual: Array  # (P, b) weighted residuals of the whole model, the field included
    weight: Array  # (P, b) root weights of the components, 0 where nothing was seen
    columns: Array  # (P, b, k) weighted derivative by the unknowns, each over its possible size
    sizes: Array  # (k,) possible size of each unknown
    # (k - 6 - t,) indices, among the model's parameters, of the first unknowns
    parameter_index: Index
    of_field: Mask  # (k,) which unknowns are those of a field, fitted to residuals of the others
    to_mm: Array  # (P, b) factor from a weighted component to its part of the position error [mm]
    noise_mm2: Array  # (P, b) what noise of each component adds to the square of that error
    # ratio of the variance of predictions by the model's covariance to that by these rows
    of_parameters: float
    # factor of a squared error: 3 where only the line-of-sight component is measured, else 1
    components_factor: float
    trust: Array  # (P,) by how much the error of each pose counts, 1 but for gross errors
    before: Gaussian  # what was known of the unknowns besides the rows
    of_noise: float = 1.0  # variance of the noise over the stated one

    @property
    def by_unknowns(self) -> Array:
        """Return the weighted derivative by the unknowns in their own units, (P, b, k)."""
        return self.columns / self.sizes

    @cached_property
    def every(self) -> Gaussian:
        """Return the normal equations of all rows and of what was known before."""
        return Gaussian.of(self.columns, self.data) + self.before

    def solved(self, rows: Gaussian, columns: Array) -> tuple[Array, Array]:
        """Return the unknowns (k,) by some rows, and variances of predictions by columns (…, k).

        A field is fitted to the residuals of the other unknowns.
        """
        others, field = np.flatnonzero(~self.of_field), np.flatnonzero(self.of_field)
        if not len(field):
            return rows.mean, rows.variances(columns)
        first, then, mean = rows.in_turn(others, field)
        return mean, first.variances(columns[..., others]) + then.variances(columns[..., field])

    @classmethod
    def of(
        cls,
        model: Fitted,
        poses: Observations,
        weight: Array | None = None,
        expected: GaussianPrior | None = None,
    ) -> RowsAboutFit:
        """Return the rows of averaged poses, as modelled.

        Args:
            weight: (P, b) root weights; None for those by the residuals.
            expected: prior of the model's parameters besides the rows; None for none.
        """
        poses = replace(poses, measured=poses.measured.of_end(model.T_end_shown))
        at, free = _with_maps_held(model)
        x = np.concatenate([model.x[free], np.zeros(len(BASE))])
        measured, count = poses.measured, len(model.targets_m)
        problem = Problem(at, np.arange(count), model.targets_m, model.T_instr_base, poses)
        rows, covariance = problem.rows(problem.start(x)), measured.stated_covariance
        jacobian, _ = along_noise_axes(measured, rows.jacobian, covariance)
        residual, covariance = along_noise_axes(measured, rows.residual, covariance)
        rows = Rows(residual, jacobian)
        variance = np.diagonal(covariance, axis1=1, axis2=2)
        by_variance = _by_variance(measured, rows.residual, variance)
        white = by_variance * rows.residual
        if weight is None:
            weight = by_variance * less_far_off(measured, white)[:, None]
        sizes = possible_sizes(at, measured if count else None)
        of_field = np.append(at.having("field"), np.zeros(len(sizes) - len(at.parameters), bool))
        # Residuals are with the field, whose prior mean is zero.
        by_field = rows.jacobian[:, :, of_field] @ x[of_field[: len(x)]]
        trust = trust_of(measured, white)
        trust[keep_their_distances(measured)] = 1.0  # these readings are right
        before = Gaussian.none(len(sizes))
        if expected is not None:
            before = _prior_about(expected, model.x, free, sizes)
        about = cls(
            data=weight * (rows.residual - by_field),
            residual=weight * rows.residual,
            weight=weight,
            columns=weight[:, :, None] * rows.jacobian * sizes,
            sizes=sizes,
            parameter_index=free,
            of_field=of_field,
            to_mm=to_mm(measured, weight),
            noise_mm2=noise_mm2(measured, variance),
            of_parameters=1.0,
            components_factor=components_factor(measured),
            trust=trust,
            before=before,
        )
        if model.covariance is None:
            return about
        return replace(about, of_parameters=about._share_of_variance(model.covariance))

    def _by_parameters_mm2(self, covariance: Array) -> Array:
        """Return what a model's covariance (k, k) adds to the square of the position error, (P,).

        That of its maps is left out.
        """
        others = self.columns.shape[2] - len(self.parameter_index)  # base and targets
        known = np.append(self.parameter_index, np.arange(-others, 0))
        moved_mm = self.to_mm[:, :, None] * self.by_unknowns
        of_known = covariance[np.ix_(known, known)]
        return np.asarray(np.einsum("pbk,pbk->p", moved_mm @ of_known, moved_mm))

    def _share_of_variance(self, covariance: Array) -> float:
        """Return `of_parameters` by the model's covariance, at most 1."""
        by_model_mm2 = float(self._by_parameters_mm2(covariance).sum())
        by_rows_mm2 = float(np.sum(self.to_mm**2 * self.solved(self.every, self.columns)[1]))
        return min(by_model_mm2 / max(by_rows_mm2, _TINY), 1.0)

    def squares_mm2(self, covariance: Array) -> tuple[Array, Array]:
        """Return squared position errors (P,), and those by noise and a model's covariance (P,)."""
        error_mm2 = np.sum((self.to_mm * self.residual) ** 2, axis=1)
        expected_mm2 = self.noise_mm2.sum(axis=1) + self._by_parameters_mm2(covariance)
        return self.components_factor * error_mm2, self.components_factor * expected_mm2

    def from_zero(self, model: Fitted, effects: Sequence[Effect], *, held: bool) -> RowsAboutFit:
        """Return the rows with what effects are linear in unknown from zero on, not about the fit.

        What rows do not tell is then none, and not as all rows together had it.

        Args:
            held: whether these unknowns stay zero.
        """
        x, columns = np.zeros(len(model.x)), self.columns.copy()
        for effect in effects:
            linear = model.model.parameter_indices(effect)[: effect.linear]
            x[linear] = model.x[linear]
        count = len(self.parameter_index)
        by_effects = columns[:, :, :count] @ (x[self.parameter_index] / self.sizes[:count])
        if held:
            columns[:, :, np.flatnonzero(x[self.parameter_index])] = 0.0
        return replace(self, data=self.data - by_effects, columns=columns)

    def with_noise_of_pairs(self, points: Array, label: Index, within_m: float) -> RowsAboutFit:
        """Return the rows with noise estimated from nearest neighbours, where it is the smaller.

        Two poses within a distance have the same error of the model: half the square of the
        difference of their residuals is noise (the nugget of a variogram). If it is less than the
        stated noise, the latter was too large.
        """
        away_m, at = map(np.asarray, cKDTree(points).query(points, k=2))
        other = at[:, 1]
        near = (away_m[:, 1] < within_m) & (label != label[other])
        if np.count_nonzero(near) < LACK.least_pairs:
            return self
        error_mm = self.to_mm * self.data
        half = 0.5 * ((error_mm - error_mm[other]) ** 2).sum(axis=1)[near]
        trust = (self.trust * self.trust[other])[near]
        stated = 0.5 * (self.noise_mm2 + self.noise_mm2[other]).sum(axis=1)[near]
        part = float(np.sum(trust * half)) / max(float(np.sum(trust * stated)), _TINY)
        return self.with_noise_by(min(part, 1.0))

    def with_noise_by(self, factor: float) -> RowsAboutFit:
        """Return the rows with variances of noise times a factor."""
        return replace(self, noise_mm2=factor * self.noise_mm2, of_noise=factor)

    def with_repeatability(self, of_reading_mm: float, readings: Index) -> RowsAboutFit:
        """Return the rows with noise that has the repeatability of the arm, too.

        Args:
            of_reading_mm: rms of the position in a single reading.
            readings: (P,) how many were averaged.
        """
        shown = self.to_mm > 0.0
        of_pose_mm2 = of_reading_mm**2 / (self.components_factor * readings)
        share = shown / np.maximum(shown.sum(axis=1, keepdims=True), 1)
        return replace(self, noise_mm2=self.noise_mm2 + of_pose_mm2[:, None] * share)

    def certainty(self, square_mm2: Array) -> Array:
        """Return by how much each component counts in mean squares beyond noise, (P, b).

        A square varies by its own expected size, so that those of noisy components would hide what
        a model lacks: each counts by the inverse square of noise and lack together, 1 for the least
        noisy. All count alike where together they surely show more than the certain ones.

        Args:
            square_mm2: (P, b) squares beyond noise and parameters.
        """
        shown = self.to_mm > 0.0
        count = np.maximum(shown.sum(axis=1, keepdims=True), 1)
        noise_mm2 = self.components_factor * count * self.noise_mm2  # if all components had it
        alike = certainty = shown.astype(float)
        every_mm2 = lack_mm2 = self._mean_mm2(square_mm2, alike)
        for _ in range(LACK.rounds):
            size_mm2 = np.maximum(noise_mm2 + max(lack_mm2, 0.0), _NO_SQUARE_MM2)
            certainty = np.where(shown, (size_mm2[shown].min(initial=np.inf) / size_mm2) ** 2, 0.0)
            lack_mm2 = self._mean_mm2(square_mm2, certainty)
        variance = 2.0 * np.sum(np.where(shown, size_mm2 / count, 0.0) ** 2, axis=1)
        u_mm2 = np.sqrt(np.sum(self.trust**2 * variance)) / self.trust.sum()
        return alike if every_mm2 - lack_mm2 > LACK.surely * u_mm2 else certainty

    def _mean_mm2(self, square_mm2: Array, certainty: Array) -> float:
        of_poses = self.of_poses(square_mm2, certainty)
        return float(np.average(of_poses.mm2, weights=self.trust * of_poses.certainty))

    @staticmethod
    def of_poses(square_mm2: Array, certainty: Array) -> SquaresOfPoses:
        """Return squares of position errors by those of components, and by how much they count.

        Args:
            square_mm2: (N, b) of components.
            certainty: (N, b) by how much each counts.
        """
        count, whole = np.count_nonzero(certainty, axis=1), certainty.sum(axis=1)
        mm2 = count * np.sum(certainty * square_mm2, axis=1) / np.maximum(whole, _TINY)
        return SquaresOfPoses(mm2, whole / np.maximum(count, 1))

    def beyond_noise_mm2(self, by_apparatus: Array, certainty: Array) -> float:
        """Return the mean squared error of the model at the poses fitted, less that of noise.

        Base and targets, which are no part of the model, are fitted; so is an apparatus, by which
        readings (P, b, a) depend on its stated coordinates.

        Args:
            certainty: (P, b) by how much each component counts.
        """
        not_own = self.columns[:, :, len(self.parameter_index) :]
        columns = np.concatenate([not_own, self.weight[:, :, None] * by_apparatus], axis=2)
        flat = columns.reshape(-1, columns.shape[2])
        flat = flat / np.maximum(np.linalg.norm(flat, axis=0), _TINY)
        fitted = flat @ np.linalg.lstsq(flat, self.residual.ravel(), rcond=None)[0]
        error_mm = self.to_mm * (self.residual - fitted.reshape(self.residual.shape))
        off_mm2 = self.components_factor * (error_mm**2 - self.noise_mm2)
        return self._mean_mm2(off_mm2, certainty)

    def beyond_parameters_mm2(self, out: Index) -> Array:
        """Return squared errors of held-out poses, less those by noise and parameters.

        They are those of components of the position error, (N, b).
        """
        error, variances = self._held_out(out)
        beyond = self.to_mm[out] ** 2 * (error**2 - self.of_parameters * variances)
        return np.asarray(self.components_factor * (beyond - self.noise_mm2[out]))

    def held_out_mm2(self, out: Index) -> tuple[Array, Array]:
        """Return squared position errors of held-out poses, and those expected, (N,) each.

        Expected are those by noise and parameters.
        """
        error, variances = self._held_out(out)
        error_mm2 = (self.to_mm[out] * error) ** 2
        expected_mm2 = self.noise_mm2[out] + self.of_parameters * variances * self.to_mm[out] ** 2
        squares = self.components_factor * np.sum([error_mm2, expected_mm2], axis=2)
        return squares[0], squares[1]

    def fitted_mm2(self) -> Array:
        """Return squared position errors that the unknowns fitted to all rows leave, (P,)."""
        mean = self.solved(self.every, self.columns)[0]
        error_mm = self.to_mm * (self.data - self.columns @ mean)
        return np.asarray(self.components_factor * np.sum(error_mm**2, axis=1))

    def _held_out(self, out: Index) -> tuple[Array, Array]:
        """Return weighted errors of held-out poses, and variances by parameters, (N, b) each."""
        columns, data = self.columns[out], self.data[out]
        mean, variances = self.solved(self.every - Gaussian.of(columns, data), columns)
        return data - columns @ mean, variances
