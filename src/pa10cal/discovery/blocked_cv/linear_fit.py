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
from pa10cal.discovery.blocked_cv.normal_equations import summed
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.preparation import why_few_angles
from pa10cal.discovery.rules import BLOCKS, MAPS
from pa10cal.fit.position_errors import position_error_mm
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.numerics.periodic_spline import b_splines_by_knots
from pa10cal.numerics.posterior import posterior_covariance, posterior_mean
from pa10cal.terms.effects.joint_error_map import JointErrorMap, Spectrum, is_error_map


class _Unknowns(NamedTuple):
    """Where the c columns of a member stand, and its l linear parameters by their solution."""

    columns: Index  # (c,)
    # (l, c) parameters less those of its start: of a map the errors at all knots that its prior
    # expects, by the coefficients of the B-splines touched
    parameters: Array


@dataclass(frozen=True, eq=False)
class LinearFit:
    """Model and effects fitted by linear least squares about the survey's baseline."""

    members: tuple[ShapedEffect, ...]
    # normal equations of all blocks: N columns of model and nuisances, effects, then the B-splines
    # of one map after the other that some pose touches
    equations: Gaussian
    prior: Array  # (N, N) prior precision
    unknowns: tuple[_Unknowns, ...]  # of each member

    @cached_property
    def _solution(self) -> Array:
        return posterior_mean(self.equations.gram, self.equations.projection, self.prior)

    @property
    def model_amounts(self) -> Array:
        """Return the changes of the model's parameters, then the amounts of nuisances, (k,).

        In units of their expected sizes.
        """
        of_model = np.ones(len(self._solution), dtype=bool)
        for own in self.unknowns:
            of_model[own.columns] = False
        return self._solution[of_model]

    @property
    def effect_parameters(self) -> tuple[Array, ...]:
        """Return the parameters of each member's effect."""
        found = tuple(member.start.copy() for member in self.members)
        for x, own in zip(found, self.unknowns, strict=True):
            x[: len(own.parameters)] += own.parameters @ self._solution[own.columns]
        return found


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
        squares.append(block.squares_at(posterior_mean(others.gram, others.projection, fit.prior)))
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
        covariance = posterior_covariance(others.gram + fit.prior, fit.prior)
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
    maps = [_ByTouched.of(*each) for each in zip(maps_among(members), touched, strict=True)]
    stops = np.cumsum([equations.unknowns - sum(map(len, touched)), *map(len, touched)])
    prior = block_diag(np.eye(stops[0]), *(each.precision for each in maps))
    of_maps = (
        _Unknowns(np.arange(first, last), each.knots)
        for (first, last), each in zip(pairwise(stops), maps, strict=True)
    )
    rows = rows.with_effects_of(members)  # either kind of columns is in the order of its members
    factors = (each.effect.prior_factor for each in rows.shaped)
    of_effects = map(_Unknowns, rows.columns_of_effects(), factors)
    unknowns = (next(of_maps if is_error_map(each.effect) else of_effects) for each in members)
    return LinearFit(members, equations, prior, tuple(unknowns))


class _ByTouched(NamedTuple):
    """What a map's prior says of its K knots, where poses touch v of its B-splines."""

    precision: Array  # (v, v) of the coefficients of the B-splines touched
    knots: Array  # (K, v) errors expected at all knots, by these coefficients

    @classmethod
    def of(cls, error_map: JointErrorMap, touched: Index) -> _ByTouched:
        """Return the prior of a map by its touched coefficients.

        Errors at the knots have the prior covariance L L^T. Coefficients are B times them: with the
        rows B_t of those touched let (B_t L)^T = Q R. Their covariance is R^T R, that of the knots
        with them L Q R, and so the expected knots are L Q R (R^T R)^-1 = L Q R^-T by them.
        """
        L = error_map.prior_factor
        Q, R = np.linalg.qr((b_splines_by_knots(error_map.knots)[touched] @ L).T)
        R_inverse = np.linalg.inv(R)
        return cls(R_inverse @ R_inverse.T, L @ Q @ R_inverse.T)


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
