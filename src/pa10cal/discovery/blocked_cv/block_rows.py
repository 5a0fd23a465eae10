"""Whitened rows of a survey, linear about its baseline, with their columns and their weights.

The columns are, in this order: parameters of the model, places of targets and nuisances, effects,
and harmonics of the maps of all revolute joints.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from itertools import pairwise
from operator import add

import numpy as np
from scipy.sparse import csr_array

from pa10cal.arrays import Array, Index, Mask
from pa10cal.discovery import jacobians
from pa10cal.discovery.blocked_cv.normal_equations import (
    BlockEquations,
    ByKind,
    normal_equations_of,
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
from pa10cal.numerics.periodic_spline import (
    b_splines_by_knots,
    harmonic_orders,
    harmonics_at_knots,
    spline_columns,
    touched_splines,
)
from pa10cal.numerics.posterior import posterior_mean
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.context import turning_joints
from pa10cal.terms.effects.effect import Effect
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
    """Whitened rows of p poses with b components each: of one block, or of all."""

    data: Array  # (b p,) measured less predicted
    dense: Array  # (b p, d) columns of all but the maps, each times its expected size
    by_angle: Array  # (p, b, j) derivative by the angle of every revolute joint
    q_rad: Array  # (p, j) these angles

    def take(self, rows: Index) -> BlockDesign:
        """Return the rows of some of the poses."""
        count, components = self.by_angle.shape[:2]
        data = self.data.reshape(count, components)[rows].ravel()
        dense = self.dense.reshape(count, components, -1)[rows].reshape(len(data), -1)
        return BlockDesign(data, dense, self.by_angle[rows], self.q_rad[rows])

    def maps(
        self,
        knots: Sequence[int],
        joints: Sequence[int] | slice = slice(None),
        touched: Sequence[Index] = (),
    ) -> csr_array:
        """Return the columns of the B-splines of maps of all or some joints, of K knots each.

        Only of those that are touched, where these are given.
        """
        return spline_columns(self.by_angle[:, :, joints], self.q_rad[:, joints], knots, touched)


@dataclass(frozen=True, eq=False)
class Linearised:
    """Poses about the operating point of their rows: what columns are made of, for any weights."""

    poses: Observations
    residual: Array  # (p, b) predicted less measured components
    by_targets: Array  # (p, b, t) derivative by the targets' coordinates
    nuisances: tuple[Array, ...]  # (p, b, k) columns of each
    # motions by the terms of the model, by the angle of every revolute joint, and by the effects
    motions: jacobians.MotionsByTerms
    shaped: tuple[ShapedEffect, ...]  # these effects

    def only(self, shaped: Sequence[ShapedEffect]) -> Linearised | None:
        """Return the same of some effects; None where one of them was not worked out."""
        if shaped == self.shaped:
            return self
        others = len(self.motions.in_base) - len(self.shaped)
        place = {each: k for k, each in enumerate(self.shaped, start=others)}
        if any(each not in place for each in shaped):
            return None
        motions = self.motions.of([*range(others), *(place[each] for each in shaped)])
        return replace(self, motions=motions, shaped=tuple(shaped))


@dataclass(frozen=True)
class BlockedRows:
    """The rows of a survey by blocks, and where the columns of each unknown stand."""

    survey: Survey
    weights: PoseWeights
    shaped: tuple[ShapedEffect, ...]  # effects, in the order of their columns
    knots: int  # K of the maps, whose columns are the K - 1 harmonics of each revolute joint
    # all poses with these effects or more, where that was worked out for other rows
    known: Linearised | None = field(default=None, compare=False, repr=False)

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

    @cached_property
    def baseline_columns(self) -> Index:
        """Return the columns of the model's parameters, of targets and of nuisances."""
        return np.arange(len(all_unknowns(self.operating_point)) + self.survey.nuisance_count)

    @cached_property
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
        for block, (total, positions) in enumerate(self._of_blocks()):
            found.put(block, total)
            if of_positions is not None:
                of_positions.put(block, positions)
        return replace(found, of_positions=of_positions, prior_precision=self._precision)

    def summed_equations(self) -> Gaussian:
        """Return the normal equations of all blocks together, of which one is held at a time."""
        return reduce(add, (total for total, _ in self._of_blocks()))

    def _of_blocks(self) -> Iterator[tuple[Gaussian, Gaussian]]:
        """Yield the normal equations of each block with the prior, and of its position rows alone.

        The prior on the arm's weights enters as pseudo-observations, shared among the blocks: if an
        effect needs weights unlike those described, it counts against the effect.
        """
        diagonal = np.arange(len(self._precision))
        for by_kind in self._by_kind():
            total = by_kind.total
            total.gram[diagonal, diagonal] += self._precision
            yield total, by_kind.positions

    def _by_kind(self) -> Iterator[ByKind]:
        """Yield the normal equations of each block in all columns, without the prior."""
        if not self._are_kept(len(self._precision)):
            knots, bases = [self.knots] * len(self.joints), [self.basis] * len(self.joints)
            for block in range(BLOCKS.blocks):
                yield self.equations_by_kind(block, self.joints, knots, bases)
            return
        # The columns of few rows take less than the products of all coefficients.
        every, (count, components) = self._every, self.weights.whitener.shape[:2]
        turned = [every.maps([self.knots], [j]) @ self.basis for j in range(len(self.joints))]
        columns = np.hstack([every.dense, *turned, every.data[:, None]])
        columns = columns.reshape(count, components, -1)
        kinds = np.isin(np.arange(components), self.survey.poses.measured.position_columns)
        for block in range(BLOCKS.blocks):
            own = columns[self.rows_of(block)]
            yield ByKind(*(Gaussian.of_rows(own[:, at]) for at in (kinds, ~kinds)))

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
        """Return the normal equations of a block, see `equations_of`."""
        return self.equations_of(self.rows_of(block), joints, knots, bases)

    def equations_of(
        self, poses: Index, joints: Sequence[int], knots: Sequence[int], bases: Sequence[Array] = ()
    ) -> ByKind:
        """Return the normal equations of some poses, in the dense columns, then those of maps.

        Args:
            poses: numbers of the poses.
            joints: joints of the maps.
            knots: B-splines a turn of each map.
            bases: coefficients (K, h) of the B-splines of each map for other unknowns of it, see
                `in_map_bases`; none where the coefficients of those `touched` are the unknowns.
        """
        design, measured = self.design_of(poses), self.survey.poses.measured
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
                known[joint, each] = touched_splines(q_rad[:, joint - 1], each)
        return [known[key] for key in zip(joints, knots, strict=True)]

    @cached_property
    def _touched(self) -> dict[tuple[int, int], Index]:
        """B-splines that were found to be touched, by joint and knots."""
        return {}

    def _are_kept(self, columns: int) -> bool:
        """Return whether the poses are so few that so many columns of all of them are kept."""
        return self.survey.block.size * columns < COMPUTING.most_kept

    def rows_of(self, block: int) -> Index:
        """Return the numbers of the poses of one block."""
        return np.flatnonzero(self.survey.block == block)

    def design(self, block: int) -> BlockDesign:
        """Return the whitened rows of one block."""
        return self.design_of(self.rows_of(block))

    def design_of(self, poses: Index) -> BlockDesign:
        """Return the whitened rows of some poses, by their numbers."""
        if self._are_kept(self.dense_count):
            return self._every.take(poses)
        return self._design(self._linearised(self.survey.poses.take(poses)), poses)

    @cached_property
    def _every(self) -> BlockDesign:
        """Return the whitened rows of all poses."""
        poses, known = self.survey.poses, self.known
        same = known.only(self.shaped) if known is not None and known.poses is poses else None
        return self._design(same or self._linearised(poses), slice(None))

    @property
    def few_linearised(self) -> Linearised | None:
        """Return all poses about the operating point; None where they are too many to be kept."""
        return self._linearised(self.survey.poses) if self._are_kept(self.dense_count) else None

    def _linearised(self, poses: Observations) -> Linearised:
        at, model = self.operating_point, self.operating_point.model
        joints = jacobians.joint_positions(at, self.joints)
        terms: list[Term] = [*model.terms, joints, *(each.effect for each in self.shaped)]
        points = [at.x[model.columns_of(term)] for term in model.terms]
        points += [np.zeros(len(self.joints)), *(each.start for each in self.shaped)]
        compared = at.compared(poses)
        return Linearised(
            poses=poses,
            residual=compared.residual,
            by_targets=compared.by_targets,
            nuisances=tuple(each.columns(at, poses) for each in self.survey.nuisances),
            motions=jacobians.motions_by_terms(at, poses, terms, points),
            shaped=self.shaped,
        )

    def _design(self, here: Linearised, rows: Index | slice) -> BlockDesign:
        """Return the whitened rows of some of the survey's poses."""
        whiten, model = self.weights.whiteners(rows), self.operating_point.model
        derivatives = here.motions.by_parameters(whiten)
        of_model, of_effects = derivatives[: len(model.terms)], derivatives[len(model.terms) + 1 :]
        sizes = possible_sizes(model, here.poses.measured)
        count = len(self.operating_point.x)
        columns = [np.concatenate(of_model, axis=2) * sizes[:count]]
        columns.append(whiten @ (here.by_targets * sizes[count:]))
        columns += [whiten @ each for each in here.nuisances]
        for shaped, derivative in zip(self.shaped, of_effects, strict=True):
            columns.append(derivative[:, :, : shaped.effect.linear] @ shaped.effect.prior_factor)
        dense = np.concatenate(columns, axis=2)
        return BlockDesign(
            data=(-whiten @ here.residual[:, :, None]).ravel(),
            dense=dense.reshape(-1, dense.shape[2]),
            by_angle=derivatives[len(model.terms)],
            q_rad=here.poses.states.q_rad[:, [joint - 1 for joint in self.joints]],
        )

    def block_residual(self, block: int, x: Array) -> Array:
        """Return measured less predicted components of a block, (p, b, m), not whitened.

        At m points x (N, m) in units of the expected sizes.
        """
        design, points = self.design(block), x.shape[1]
        harmonics = x[self.dense_count :].reshape(len(self.joints), self.knots - 1, points)
        coefficients = (self.basis @ harmonics).reshape(-1, points)
        if self._are_kept(len(self._precision)):
            own = np.repeat(self.survey.block == block, design.by_angle.shape[1])
            maps = self._every_map[own]
        else:
            maps = design.maps([self.knots] * len(self.joints))
        white = design.data[:, None] - design.dense @ x[: self.dense_count] - maps @ coefficients
        return self.unwhitened(block, white)

    @cached_property
    def _every_map(self) -> csr_array:
        """Return the columns of the B-splines of all maps, of all poses."""
        return self._every.maps([self.knots] * len(self.joints))

    def unwhitened(self, block: int, white: Array) -> Array:
        """Return whitened rows (b p, m) of a block as its components, (p, b, m)."""
        whiteners = self.weights.whiteners(self.rows_of(block))
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
    known = BlockedRows(survey, unweighted(measured), shaped, knots).few_linearised
    rows = BlockedRows(survey, unweighted(measured), named, MAPS.weighing_knots, known)
    weights = pose_weights(
        rows.operating_point.compared(survey.poses).residual,
        float(len(rows.baseline_columns)),
        measured,
    )
    for _ in range(MAPS.reweighted):
        rows = replace(rows, weights=weights)
        weights = pose_weights(*_residual_of_richest_model(rows), measured)
    return BlockedRows(survey, weights, shaped, knots, known)


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
        dof = float(np.trace(posterior_mean(total.gram, total.gram, prior)))
        if dof <= MAPS.most_taken_share * seen.sum():
            break
    x = posterior_mean(total.gram, total.projection, prior)
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
