"""The effects found, fitted by linear least squares, with maps as fine as held-out blocks support.

Each map has its own B-splines, of any number of knots, in place of the harmonics of the search.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from pa10cal.arrays import Array, Index
from pa10cal.discovery.blocked_cv.block_rows import BlockedRows, ShapedEffect
from pa10cal.discovery.blocked_cv.effect_set import as_good
from pa10cal.discovery.blocked_cv.normal_equations import inverse, solve, summed
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.position_errors import position_error_mm
from pa10cal.discovery.preparation import why_few_angles
from pa10cal.discovery.rules import BLOCKS, MAPS
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.numerics.periodic_spline import b_splines_by_knots
from pa10cal.terms.effects.joint_error_map import JointErrorMap, Spectrum, is_error_map


@dataclass(frozen=True, eq=False)
class LinearFit:
    """Model and effects fitted by linear least squares about the survey's baseline."""

    members: tuple[ShapedEffect, ...]
    # normal equations of all blocks: N columns of model and nuisances, effects, then the B-splines
    # of one map after the other that some pose touches
    equations: Gaussian
    prior: Array  # (N, N) prior precision
    columns: tuple[Index, ...]  # of each member
    # (K, v) of each map: the coefficients of all its B-splines by those touched, as its prior says
    by_touched: tuple[Array, ...]

    @cached_property
    def _solution(self) -> Array:
        return solve(self.equations.gram, self.equations.projection, self.prior)

    @property
    def model_amounts(self) -> Array:
        """Return the changes of the model's parameters, then the amounts of nuisances, (k,).

        In units of their expected sizes.
        """
        none = np.zeros(0, dtype=np.intp)
        return np.delete(self._solution, np.concatenate([none, *self.columns]))

    @property
    def effect_parameters(self) -> tuple[Array, ...]:
        """Return the parameters of each member's effect."""
        parts, by_touched = zip(self.members, self.columns, strict=True), iter(self.by_touched)
        return tuple(
            _parameters(
                member,
                next(by_touched) @ self._solution[columns]
                if is_error_map(member.effect)
                else self._solution[columns],
            )
            for member, columns in parts
        )


def linear_fit(rows: BlockedRows, members: tuple[ShapedEffect, ...]) -> LinearFit:
    """Fit members to all blocks; the effects of the rows are replaced by those of the members."""
    return linear_fit_of(summed(_equations_by_block(rows, members)), rows, members)


def refine_maps(rows: BlockedRows, members: tuple[ShapedEffect, ...]) -> LinearFit:
    """Fit members, with the finest maps of the search made finer while held-out blocks gain.

    A gain is one of more than a standard error of the blocks. A map whose joint took too few angles
    for so many knots keeps those that it has, while others go on.
    """
    rows = rows.with_effects_of(members)  # once: their designs are kept
    best, squares = _fit_and_held_out_squares(rows, members)
    for knots in MAPS.finer_knots:
        finer = tuple(made_finer(rows, member, knots) for member in best.members)
        if finer == best.members:
            continue
        ahead, finer_squares = _fit_and_held_out_squares(rows, finer)
        if as_good(squares, finer_squares):
            break
        best, squares = ahead, finer_squares
    return best


def _fit_and_held_out_squares(
    rows: BlockedRows, members: tuple[ShapedEffect, ...]
) -> tuple[LinearFit, Array]:
    """Return the fit of members, and the sum of squares of each block held out of it, (B,)."""
    blocks = _equations_by_block(rows, members)
    fit = linear_fit_of(summed(blocks), rows, members)
    squares = []
    for block in blocks:
        others = fit.equations - block
        squares.append(block.squares_at(solve(others.gram, others.projection, fit.prior)))
    return fit, np.array(squares)


class HeldOut(NamedTuple):
    """Position errors of held-out poses, each block predicted from the others."""

    block: Index  # (P,) number of the block of each pose
    errors_mm: Array  # (P,)
    # the error that noise and uncertain estimates make, over that of noise
    expected_over_noise: float

    @classmethod
    def of(cls, survey: Survey, errors_mm: Array, squares_of_estimates: float) -> HeldOut:
        """Return errors (P,) of the blocks of a survey.

        Args:
            survey: the survey.
            errors_mm: (P,) position errors.
            squares_of_estimates: sum of squares of whitened position rows that uncertain estimates
                are expected to add, where noise alone gives 1 a row.
        """
        measured = survey.poses.measured
        rows = measured.components_seen[:, measured.position_columns].sum()
        return cls(survey.block, errors_mm, float((1.0 + squares_of_estimates / rows) ** 0.5))


def held_out(rows: BlockedRows, fit: LinearFit) -> HeldOut:
    """Return the errors of the blocks of some rows, each held out of a fit of its members."""
    rows, (joints, knots) = rows.with_effects_of(fit.members), joints_and_knots(fit.members)
    measured = rows.survey.poses.measured
    errors_mm, squares_of_estimates = np.empty(len(rows.survey.block)), 0.0
    for block in range(BLOCKS.blocks):
        own = rows.equations_by_kind(block, joints, knots)
        others = fit.equations - own.total
        covariance = inverse(others.gram + fit.prior, fit.prior)
        squares_of_estimates += float(np.sum(covariance * own.positions.gram))
        x, design = covariance @ others.projection, rows.design(block)
        of_joints = [rows.joints.index(joint) for joint in joints]
        maps = design.maps(knots, of_joints, rows.touched(joints, knots))
        white = design.data - design.dense @ x[: rows.dense_count] - maps @ x[rows.dense_count :]
        residual = rows.unwhitened(block, white[:, None])[:, :, 0]
        here = np.flatnonzero(rows.survey.block == block)
        errors_mm[here] = position_error_mm(measured.take(here), residual)
    return HeldOut.of(rows.survey, errors_mm, squares_of_estimates)


def linear_fit_of(
    equations: Gaussian, rows: BlockedRows, members: tuple[ShapedEffect, ...]
) -> LinearFit:
    """Fit members by the normal equations of all blocks, in columns as `LinearFit` has them."""
    touched = rows.touched(*joints_and_knots(members))
    priors = [
        _prior_by_touched(each, at) for each, at in zip(maps_among(members), touched, strict=True)
    ]
    by_touched = tuple(prior.expected_by_touched for prior in priors)
    dense_count = equations.unknowns - sum(map(len, touched))
    prior = block_diag(np.eye(dense_count), *(prior.precision_of_touched for prior in priors))
    stops = dense_count + np.cumsum([0, *map(len, touched)])
    of_maps = [np.arange(first, last) for first, last in pairwise(stops)]
    of_effects = rows.with_effects_of(members).columns_of_effects()
    columns = []
    for member in members:
        own_kind = of_maps if is_error_map(member.effect) else of_effects
        columns.append(own_kind.pop(0))
    return LinearFit(members, equations, prior, tuple(columns), by_touched)


class _PriorByTouched(NamedTuple):
    """What a map's prior says of its K coefficients, where poses touch v of their B-splines."""

    precision_of_touched: Array  # (v, v)
    expected_by_touched: Array  # (K, v): all coefficients that are expected, by those touched


def _prior_by_touched(error_map: JointErrorMap, touched: Index) -> _PriorByTouched:
    """Return the prior of a map by its touched coefficients.

    With the factor F of all coefficients' prior covariance F F^T, and F_t of the touched ones, let
    F_t^T = Q R. The covariance of the touched ones is R^T R, that of all with them F Q R, and so
    the expected ones are F Q R (R^T R)^-1 = F Q R^-T by the touched.
    """
    F = b_splines_by_knots(error_map.knots) @ error_map.prior_factor
    Q, R = np.linalg.qr(F[touched].T)
    R_inverse = np.linalg.inv(R)
    return _PriorByTouched(R_inverse @ R_inverse.T, F @ Q @ R_inverse.T)


def _equations_by_block(rows: BlockedRows, members: tuple[ShapedEffect, ...]) -> list[Gaussian]:
    """Return the normal equations of each block, in columns as `LinearFit` has them."""
    rows, (joints, knots) = rows.with_effects_of(members), joints_and_knots(members)
    blocks = range(BLOCKS.blocks)
    return [rows.equations_by_kind(block, joints, knots).total for block in blocks]


def joints_and_knots(members: Sequence[ShapedEffect]) -> tuple[list[int], list[int]]:
    """Return the joints of the maps among members, and the knots of these maps."""
    maps = maps_among(members)
    return [each.joint for each in maps], [each.knots for each in maps]


def maps_among(members: Sequence[ShapedEffect]) -> list[JointErrorMap]:
    """Return the maps among members, in their order."""
    return [member.effect for member in members if is_error_map(member.effect)]


def with_form(member: ShapedEffect, knots: int, spectrum: Spectrum | None = None) -> ShapedEffect:
    """Return a map with other knots, and with a spectrum if one is given; others as they are."""
    effect = member.effect
    if not is_error_map(effect):
        return member
    return ShapedEffect(replace(effect, knots=knots, spectrum=spectrum or effect.spectrum))


def _parameters(shaped: ShapedEffect, amounts: Array) -> Array:
    """Return the parameters of an effect for the amounts of its columns; of a map its knots."""
    effect = shaped.effect
    if is_error_map(effect):
        return np.asarray(np.linalg.solve(b_splines_by_knots(effect.knots), amounts), np.float64)
    x = shaped.start.copy()
    x[: effect.linear] += effect.prior_factor @ amounts
    return x


def made_finer(rows: BlockedRows, member: ShapedEffect, knots: int) -> ShapedEffect:
    """Return a map as fine as the finest of the search with more knots, if the angles suffice.

    Any other effect, and a map that has so many knots, is returned as it is.
    """
    effect = member.effect
    if not is_error_map(effect) or not MAPS.spacings[-1][0] <= effect.knots < knots:
        return member
    finer = with_form(member, knots)
    too_few = why_few_angles(finer.effect, rows.survey.poses.states)
    return member if too_few else finer
