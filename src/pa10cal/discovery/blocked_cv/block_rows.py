"""Whitened rows of a survey, linear about its baseline, with their columns and their weights.

The columns are, in this order: parameters of the model, places of targets and nuisances, effects,
and harmonics of the maps of all revolute joints.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array

from pa10cal.arrays import Array, Index, Mask
from pa10cal.discovery import jacobians
from pa10cal.discovery.blocked_cv.normal_equations import (
    BlockEquations,
    ByKind,
    map_columns,
    normal_equations_of,
    solve,
    touched_by,
)
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.model_with_effects import all_unknowns, with_base_motion
from pa10cal.discovery.noise import Noise
from pa10cal.discovery.pose_scatter import PoseWeights, pose_weights, unweighted
from pa10cal.discovery.rules import BLOCKS, MAPS
from pa10cal.discovery.tuning import COMPUTING
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.problem import possible_sizes
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.numerics.least_squares import Bounds
from pa10cal.numerics.periodic_spline import b_splines_by_knots, harmonic_orders, harmonics_at_knots
from pa10cal.terms.effects.effect import Effect, turning_joints
from pa10cal.terms.effects.joint_error_map import FadingPrior, is_error_map
from pa10cal.terms.term import Term


@dataclass(frozen=True)
class ShapedEffect:
    """An effect, linearised at one of its starts."""

    effect: Effect
    shape: int = 0  # number of the start

    @property
    def start(self) -> Array:
        """Return the parameters at which it is linearised."""
        return self.effect.starts[self.shape]

    @property
    def name(self) -> tuple[str, str]:
        """Return identifier and place: of one name only one form may be in a model."""
        return (self.effect.id, self.effect.of)


@dataclass(frozen=True)
class BlockDesign:
    """Whitened rows of one block of p poses with b components each."""

    data: Array  # (b p,) measured less predicted
    dense: Array  # (b p, d) columns of all but the maps, each times its expected size
    by_angle: Array  # (p, b, j) derivative by the angle of every revolute joint
    q_rad: Array  # (p, j) these angles

    def maps(
        self,
        knots: Sequence[int],
        joints: Sequence[int] | slice = slice(None),
        touched: Sequence[Index] = (),
    ) -> csr_array:
        """Return the columns of the B-splines of maps of all or some joints, of K knots each.

        Only of those that are touched, where these are given.
        """
        return map_columns(self.by_angle[:, :, joints], self.q_rad[:, joints], knots, touched)


@dataclass(frozen=True)
class BlockedRows:
    """The rows of a survey by blocks, and where the columns of each unknown stand."""

    survey: Survey
    weights: PoseWeights
    shaped: tuple[ShapedEffect, ...]  # effects, in the order of their columns
    knots: int  # K of the maps, whose columns are the K - 1 harmonics of each revolute joint

    def with_effects_of(self, members: Iterable[ShapedEffect]) -> BlockedRows:
        """Return the rows with those of some members that are no maps as effects."""
        shaped = tuple(each for each in members if not is_error_map(each.effect))
        return self if shaped == self.shaped else replace(self, shaped=shaped)

    @cached_property
    def operating_point(self) -> FittedModel:
        """Return the survey's baseline with small motions of the base as parameters, at zero."""
        baseline = self.survey.baseline
        x = np.concatenate([baseline.x, np.zeros(6)])
        return replace(baseline, model=with_base_motion(baseline), x=x)

    @cached_property
    def joints(self) -> tuple[int, ...]:
        """Return the joints, from 1, that have maps."""
        return turning_joints(self.survey.context)

    @cached_property
    def basis(self) -> Array:
        """Return the B-spline coefficients (K, K - 1) of every harmonic of unit amplitude."""
        return np.asarray(b_splines_by_knots(self.knots) @ harmonics_at_knots(self.knots)[:, 1:])

    @property
    def baseline_columns(self) -> Index:
        """Return the columns of the model's parameters, of targets and of nuisances."""
        return np.arange(len(all_unknowns(self.operating_point)) + self.survey.nuisance_count)

    @property
    def dense_count(self) -> int:
        """Return how many columns stand before the maps."""
        return len(self.baseline_columns) + sum(each.effect.linear for each in self.shaped)

    @property
    def weight_columns(self) -> Index:
        """Return the columns of masses and centres of mass that are uncertain."""
        return np.flatnonzero(self.operating_point.model.having("weight"))

    @property
    def baseline_sizes(self) -> Array:
        """Return the standard deviations expected of the unknowns of `baseline_columns`.

        The normal equations contain the prior on the arm's weights already.
        """
        sizes = np.ones(len(self.baseline_columns))
        sizes[self.weight_columns] = BLOCKS.sizes_not_twice
        return sizes

    @property
    def at_bound(self) -> Mask:
        """Return which of `baseline_columns` are of parameters that the baseline has at a bound."""
        model, x = self.operating_point.model, self.operating_point.x
        bounds = Bounds.of(model.parameters)
        at_bound = np.zeros(len(self.baseline_columns), dtype=bool)
        at_bound[: len(x)] = (x <= bounds.lower) | (x >= bounds.upper)
        return at_bound

    def columns_of_effects(self) -> list[Index]:
        """Return the columns of each effect."""
        counts = [each.effect.linear for each in self.shaped]
        stops = len(self.baseline_columns) + np.cumsum([0, *counts])
        return [np.arange(first, last) for first, last in pairwise(stops)]

    def columns_of_map(self, joint: int) -> Index:
        """Return the columns of the map of a joint, from 1."""
        first = self.dense_count + self.joints.index(joint) * (self.knots - 1)
        return np.arange(first, first + self.knots - 1)

    def normal_equations(self) -> BlockEquations:
        """Return the normal equations in all columns, block by block."""
        found = BlockEquations.empty(BLOCKS.blocks, len(self._precision))
        of_positions = None
        if self._other_rows:
            of_positions = BlockEquations.empty(BLOCKS.blocks, len(self._precision))
        for block in range(BLOCKS.blocks):
            total, positions = self._of_block(block)
            found.put(block, total)
            if of_positions is not None:
                of_positions.put(block, positions)
        return replace(found, of_positions=of_positions, prior_precision=self._precision)

    def summed_equations(self) -> Gaussian:
        """Return the normal equations of all blocks together, of which one is held at a time."""
        total, _ = self._of_block(0)
        for block in range(1, BLOCKS.blocks):
            total = total + self._of_block(block)[0]
        return total

    def _of_block(self, block: int) -> tuple[Gaussian, Gaussian]:
        """Return the normal equations of a block with the prior, and of its position rows alone.

        The prior on the arm's weights enters as pseudo-observations, shared among the blocks: if an
        effect needs weights unlike those described, it counts against the effect.
        """
        knots, bases = [self.knots] * len(self.joints), [self.basis] * len(self.joints)
        by_kind = self.equations_by_kind(block, self.joints, knots, bases)
        total = by_kind.total
        diagonal = np.arange(total.unknowns)
        total.gram[diagonal, diagonal] += self._precision
        return total, by_kind.positions

    @cached_property
    def _precision(self) -> Array:
        """Return the prior precision (N,) that every block's gram contains."""
        precision = np.zeros(self.dense_count + len(self.joints) * (self.knots - 1))
        precision[self.weight_columns] = 1.0 / BLOCKS.blocks
        return precision

    @property
    def _other_rows(self) -> bool:
        """Return whether there are rows of anything but positions."""
        measured = self.survey.poses.measured
        return bool(measured.components_seen.shape[1] > len(measured.position_columns))

    def equations_by_kind(
        self, block: int, joints: Sequence[int], knots: Sequence[int], bases: Sequence[Array] = ()
    ) -> ByKind:
        """Return the normal equations of a block, in the dense columns, then those of maps.

        Args:
            block: number of the block.
            joints: joints of the maps.
            knots: B-splines a turn of each map.
            bases: coefficients (K, h) of the B-splines of each map for other unknowns of it, see
                `in_map_bases`; none where the coefficients of those `touched` are the unknowns.
        """
        design, measured = self.design(block), self.survey.poses.measured
        touched = self.touched(joints, knots)
        splines = design.maps(knots, [self.joints.index(joint) for joint in joints], touched)
        bases = [basis[at] for basis, at in zip(bases, touched, strict=True)] if bases else ()
        component = np.arange(len(design.data)) % measured.components_seen.shape[1]
        of_positions = np.isin(component, measured.position_columns)
        return ByKind(
            *(
                normal_equations_of(design.data[rows], design.dense[rows], splines[rows], bases)
                for rows in (np.flatnonzero(of_positions), np.flatnonzero(~of_positions))
            )
        )

    def touched(self, joints: Sequence[int], knots: Sequence[int]) -> list[Index]:
        """Return the B-splines of maps of joints, from 1, that some pose of the survey touches."""
        q_rad, known = self.survey.poses.states.q_rad, self._touched
        for joint, each in zip(joints, knots, strict=True):
            if (joint, each) not in known:
                known[joint, each] = touched_by(q_rad[:, joint - 1], each)
        return [known[key] for key in zip(joints, knots, strict=True)]

    @cached_property
    def _touched(self) -> dict[tuple[int, int], Index]:
        """B-splines that were found to be touched, by joint and knots."""
        return {}

    @cached_property
    def _kept(self) -> dict[int, BlockDesign]:
        """Blocks that were computed, where all of them together are small."""
        return {}

    def design(self, block: int) -> BlockDesign:
        """Return the whitened rows of one block."""
        if block in self._kept:
            return self._kept[block]
        found = self._design(block)
        if self.survey.block.size * found.dense.shape[1] < COMPUTING.most_kept:
            self._kept[block] = found
        return found

    def _design(self, block: int) -> BlockDesign:
        rows = np.flatnonzero(self.survey.block == block)
        poses, whiten = self.survey.poses.take(rows), self.weights.whiteners(rows)
        at, model = self.operating_point, self.operating_point.model
        terms: list[Term] = [*model.terms, *(shaped.effect for shaped in self.shaped)]
        points = [at.x[model.columns_of(term)] for term in model.terms]
        points += [shaped.start for shaped in self.shaped]
        joints = jacobians.joint_positions(at, self.joints)
        *derivatives, by_angle = jacobians.by_terms(
            at, poses, [*terms, joints], [*points, np.zeros(len(self.joints))], whiten
        )
        of_model, of_effects = derivatives[: len(model.terms)], derivatives[len(model.terms) :]
        sizes = possible_sizes(model, poses.measured)
        columns = [np.concatenate(of_model, axis=2) * sizes[: len(at.x)]]
        columns.append(whiten @ (at.compared(poses).by_targets * sizes[len(at.x) :]))
        columns += [whiten @ each.columns(at, poses) for each in self.survey.nuisances]
        for shaped, derivative in zip(self.shaped, of_effects, strict=True):
            columns.append(derivative[:, :, : shaped.effect.linear] @ shaped.effect.prior_factor)
        dense = np.concatenate(columns, axis=2)
        q_rad = poses.states.q_rad[:, [joint - 1 for joint in self.joints]]
        data = -whiten @ at.compared(poses).residual[:, :, None]
        return BlockDesign(data.ravel(), dense.reshape(-1, dense.shape[2]), by_angle, q_rad)

    def block_residual(self, block: int, x: Array) -> Array:
        """Return measured less predicted components of a block, (p, b, m), not whitened.

        At m points x (N, m) in units of the expected sizes.
        """
        design, points = self.design(block), x.shape[1]
        harmonics = x[self.dense_count :].reshape(len(self.joints), self.knots - 1, points)
        maps = design.maps([self.knots] * len(self.joints)) @ (
            (self.basis @ harmonics).reshape(-1, points)
        )
        white = design.data[:, None] - design.dense @ x[: self.dense_count] - maps
        return self.unwhitened(block, white)

    def unwhitened(self, block: int, white: Array) -> Array:
        """Return whitened rows (b p, m) of a block as its components, (p, b, m)."""
        whiteners = self.weights.whiteners(np.flatnonzero(self.survey.block == block))
        return np.asarray(np.linalg.solve(whiteners, white.reshape(*whiteners.shape[:2], -1)))


# Weights of poses, by the scatter about a model with all named effects and maps of all joints.

_FADING = FadingPrior(*MAPS.weighing_prior)


def weighted_rows(survey: Survey, shaped: tuple[ShapedEffect, ...], knots: int) -> BlockedRows:
    """Return rows of effects and of maps with so many knots a turn, weighted.

    The weights come from the scatter about a model with all named effects and maps of all joints:
    no pose then weighs less because of an effect that is still to be found. If there are too few
    readings for that, as with an instrument that measures one number a pose, the model has no maps,
    or no effects either.
    """
    measured = survey.poses.measured
    named = tuple(each for each in shaped if not (each.effect.generic or each.shape))
    rows = BlockedRows(survey, unweighted(measured), named, MAPS.weighing_knots)
    weights = pose_weights(
        rows.operating_point.compared(survey.poses).residual,
        float(len(rows.baseline_columns)),
        measured,
    )
    for _ in range(MAPS.reweighted):
        rows = BlockedRows(survey, weights, named, MAPS.weighing_knots)
        weights = pose_weights(*_residual_of_richest_model(rows), measured)
    return BlockedRows(survey, weights, shaped, knots)


def _residual_of_richest_model(rows: BlockedRows) -> tuple[Array, float]:
    """Return measured less predicted components (P, b), and the model's degrees of freedom.

    Of the model with all columns, without maps, or without effects too: the first that leaves
    enough degrees of freedom of the readings.
    """
    total = rows.summed_equations()
    harmonics = np.tile(_FADING.sizes_rad(harmonic_orders(rows.knots)[1:]), len(rows.joints))
    count = total.unknowns
    without_maps = count - len(harmonics)
    seen = rows.survey.poses.measured.components_seen
    for fitted in (count, without_maps, len(rows.baseline_columns)):
        sizes = np.concatenate([np.ones(without_maps), harmonics])
        sizes[fitted:] *= COMPUTING.not_fitted
        prior = np.diag(sizes**-2.0)
        dof = float(np.trace(solve(total.gram, total.gram, prior)))
        if dof <= MAPS.most_taken_share * seen.sum():
            break
    x = solve(total.gram, total.projection, prior)
    remaining = np.empty(seen.shape)
    for block in range(BLOCKS.blocks):
        remaining[rows.survey.block == block] = rows.block_residual(block, x[:, None])[:, :, 0]
    return remaining, dof


def noise_squares(rows: BlockedRows, noise: Noise) -> float:
    """Return the sum of squares of whitened rows that noise alone is expected to leave.

    A row has at most unit variance: a stated uncertainty may be too large.
    """
    whitener = rows.weights.whitener
    noisy = np.einsum("pij,pjk,pik->pi", whitener, noise.cov, whitener, optimize=True)
    seen = rows.survey.poses.measured.components_seen
    return float(np.sum(rows.weights.weight[:, None] * seen * np.minimum(noisy, 1.0)))
