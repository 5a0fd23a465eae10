"""A campaign of many different poses made ready: in order of time, and in blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array

from pa10cal.arrays import Array, Index, Mask
from pa10cal.discovery.changed import Change
from pa10cal.discovery.linear import (
    by_joints,
    by_targets,
    by_terms,
    positions_of,
    residual,
    unknowns,
    with_base_term,
)
from pa10cal.discovery.noise import Noise, PoseWeights, noise_of_near_poses, with_torque_noise
from pa10cal.discovery.preparation import MeasurementSetup, Prepared, complete, context_of
from pa10cal.discovery.rules import BLOCKS
from pa10cal.discovery.wander import Wander
from pa10cal.errors import DiscoveryError
from pa10cal.fit.angles_seen import AngleCoverage, angles_seen
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.problem import possible_sizes
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.numerics.least_squares import Bounds
from pa10cal.observe.observations import Observations
from pa10cal.results.discovery import Unexplained
from pa10cal.rules import ANGLES
from pa10cal.terms.effects.effect import CandidateContext, Effect, turning_joints
from pa10cal.terms.effects.joint_error_map import b_splines, b_splines_by_knots, harmonics_at_knots
from pa10cal.terms.term import Term

#: Poses below which blocks of them cannot be held out.
LEAST_FOR_BLOCKS = BLOCKS.blocks * BLOCKS.least_poses


@dataclass(frozen=True)
class Survey:
    """P different poses and the calibrated model."""

    # in order of time; their states hold what weights do and how they were seen
    poses: Observations
    # (P,) number of the block of each pose, from 0: stretches of time of even size, or every tenth
    # pose where the base moves in the course of time
    block: Index
    baseline: FittedModel  # the calibrated model, its chain with the bends of the long links
    setup: MeasurementSetup  # what is known besides the poses
    context: CandidateContext  # where effects may sit
    torques_logged: bool  # whether the torques are those of a log, and not of described masses
    # how the base moves in the course of time; None where the data prefer that it does not
    wander: Wander | None = None
    change: Change | None = None  # of targets, beam or log at a row; None where there is none
    lag: AttitudeLag | None = None  # of orientations behind the motion; None where there is none
    # the calibrated model, where the search sets out from another; None where it does from that
    calibrated: FittedModel | None = None
    # effects that it begins with, of those that are sought and of others
    begins_with: tuple[Effect, ...] = ()

    @classmethod
    def of(cls, campaign: Prepared, baseline: FittedModel | None = None) -> Survey:
        """Make the poses of a campaign's fit ready, orientations and torques as a model has them.

        That is the calibrated model, unless another is given.

        Raises:
            DiscoveryError: when there are too few poses for blocks.
        """
        readings, setup = campaign.trusted, campaign.setup
        baseline, torques_logged = baseline or campaign.baseline, campaign.torques == "logged"
        if len(readings) < LEAST_FOR_BLOCKS:
            raise DiscoveryError(
                "too few poses to judge effects by blocked cross-validation",
                where="grid poses",
                value=len(readings),
                allowed=f"at least {LEAST_FOR_BLOCKS} poses",
                remedy="measure more poses, or measure poses repeatedly",
            )
        poses = readings.take(np.argsort(readings.states.time_s, kind="stable"))
        poses = complete(poses, baseline, setup)
        if torques_logged:
            poses = _as_springs_take_them(poses)
        context = context_of(poses, baseline, setup)
        return cls(
            poses=poses,
            block=_stretches(poses),
            baseline=baseline,
            setup=setup,
            context=context,
            torques_logged=torques_logged,
            lag=attitude_lag(context, poses),
        )

    @property
    def cells(self) -> Observations:
        """Return the poses, each a cell of its own."""
        return self.poses

    @property
    def angles_seen(self) -> AngleCoverage:
        """Return the joint positions that the poses visit, fine enough for any map."""
        order = np.where(self.context.arm.prismatic, 0.0, ANGLES.fine_order)
        return angles_seen(self.poses.states.q_rad, order)

    def moving(self, wander: Wander) -> Survey:
        """Return the survey of a base that moves, in blocks of every tenth pose.

        Between poses on either side a wander is known; past a stretch of time it is not.
        """
        return replace(self, wander=wander, block=np.arange(len(self.poses)) % BLOCKS.blocks)

    def changing(self, change: Change) -> Survey:
        """Return the survey of what changed at a row, in blocks of every tenth pose."""
        return replace(self, change=change, block=np.arange(len(self.poses)) % BLOCKS.blocks)

    def net_residual(self, at: FittedModel, poses: Observations | None = None) -> Array:
        """Return predicted minus measured components, (P, b), without motion, change or lag.

        Of complete poses of the campaign; None for all of the survey.
        """
        if poses is None:
            return residual(at, self.poses) + self._nuisance_shift
        return residual(at, poses) + self._shift(poses)

    @cached_property
    def _nuisance_shift(self) -> Array | float:
        return self._shift(self.poses)

    def _shift(self, poses: Observations) -> Array | float:
        """Return what motion, change and lag come to in the components of poses, (P, b)."""
        return sum(
            each.shift(self.baseline, poses) for each in self.nuisances if each.amounts is not None
        )

    def noise_about(self, at: FittedModel) -> Noise:
        """Return the noise of single readings by nearly equal poses, else as stated, of a model."""
        noise = noise_of_near_poses(self.poses, self.net_residual(at))
        if not self.torques_logged:
            return noise
        return with_torque_noise(noise, at, self.poses, self.setup.payload)

    @property
    def nuisances(self) -> tuple[Wander | Change | AttitudeLag, ...]:
        """Return what is found beside model and effects, and belongs to neither."""
        return tuple(each for each in (self.wander, self.change, self.lag) if each is not None)

    def with_amounts(self, found: Array) -> Survey:
        """Return the survey with the amounts of these, one after the other (k,)."""
        own, wander, change, lag = found, self.wander, self.change, self.lag
        if wander is not None:
            count = len(wander.sizes)
            wander, own = replace(wander, amounts=own[:count]), own[count:]
        if change is not None:
            count = len(change.sizes)
            change, own = replace(change, amounts=own[:count]), own[count:]
        lag = None if lag is None else replace(lag, amounts=own)
        return replace(self, wander=wander, change=change, lag=lag)


def _stretches(poses: Observations) -> Index:
    """Return the block of each pose (P,): stretches of time, of every campaign of a group.

    In blocks of one campaign each, what campaigns show more or less of would count as chance.
    """
    block = np.zeros(len(poses), dtype=np.intp)
    campaign = poses.states.campaign
    for own in [None] if campaign is None else np.unique(campaign):
        rows = np.arange(len(poses)) if own is None else np.flatnonzero(campaign == own)
        block[rows] = np.arange(len(rows)) * BLOCKS.blocks // len(rows)
    return block


def _as_springs_take_them(poses: Observations) -> Observations:
    """Return poses in which an error of the log is one of what the springs are given: the log.

    Else a gain would take noise and friction of the log out of the springs, and be preferred.
    """
    loads = poses.states.static_loads
    if loads is None:
        return poses
    loads = replace(loads, joint_Nm=poses.states.tau_Nm)
    return replace(poses, states=replace(poses.states, static_loads=loads))


# Orientations that go with the way a joint came, where positions do not.
#
# A joint that stops short takes the whole end with it. A reader of orientations may lag behind the
# motion by itself, or sway on its mount, and leaves positions where they are. Where joints are
# those commanded both look alike in orientations, so what orientations alone say of arrivals counts
# for nothing.


@dataclass(frozen=True, eq=False)
class AttitudeLag:
    """By how much orientations turn with the way that each joint came."""

    joints: tuple[int, ...]  # which, from 1
    campaigns: int = 1  # how many a group has, each with lags of its own; 1 of a single campaign
    amounts: Array | None = None  # (campaigns * joints,) in `sizes`; None until they are found

    @property
    def sizes(self) -> Array:
        """Return the size expected of each amount [rad]."""
        return np.full(self.campaigns * len(self.joints), BLOCKS.lag_rad)

    def columns(self, at: FittedModel, poses: Observations) -> Array:
        """Return how components follow the amounts, (P, b, k)."""
        turned = by_joints(at, poses, self.joints)
        turned[:, poses.measured.position_columns] = 0.0
        came = poses.states.move_from_previous[:, [joint - 1 for joint in self.joints]]
        turned = turned * came[:, None, :] * BLOCKS.lag_rad
        campaign = poses.states.campaign
        if campaign is None:
            return np.asarray(turned)
        parts = [turned * (campaign == k)[:, None, None] for k in range(self.campaigns)]
        return np.concatenate(parts, axis=2)

    def shift(self, at: FittedModel, poses: Observations) -> Array:
        """Return what orientations are off by, in the components of poses, (P, b)."""
        assert self.amounts is not None
        return np.asarray(self.columns(at, poses) @ self.amounts)

    def unexplained(self, left_mm: float) -> Unexplained:
        """Return it as a part of what is unexplained, beside the mean error that is left."""
        assert self.amounts is not None
        lags_rad = np.abs(self.amounts * self.sizes).reshape(self.campaigns, -1).max(axis=0)
        said = " and ".join(
            f"joint {joint} ({1e6 * lag_rad:.0f} µrad)"
            for joint, lag_rad in zip(self.joints, lags_rad.tolist(), strict=True)
            if lag_rad > BLOCKS.told_share * lags_rad.max()
        )
        why = (
            f"orientations go with the way that {said} came, and positions do not: it is the "
            "reader of orientations or its mount that lags, and no joint that stops short"
        )
        return Unexplained(of="instrument", form="attitude_lag", shared_error_mm=left_mm, why=why)


def attitude_lag(context: CandidateContext, poses: Observations) -> AttitudeLag | None:
    """Return the lag that orientations may have; None where joints were read, or there are none."""
    measured = poses.measured
    attitudes = measured.components_seen.shape[1] > len(measured.position_columns)
    if not (context.commanded and attitudes):
        return None
    return AttitudeLag(tuple(turning_joints(context)), max(len(context.campaigns), 1))


# Weighed rows of a survey: the data, the model's own parameters, effects, and fine maps.

# Products of weighed rows with each other, block of poses by block.
#
# All that is needed of the data afterwards, which effects help and how well held-out poses are
# predicted, needs these products and no row. Maps of joint errors are kept as what turning the
# joint does and four B-splines of its angle: each pose touches four of a map's many columns.


def said_by(data: Array, dense: Array, maps: csr_array) -> Gaussian:
    """Return what weighed rows say: data (R,), columns (R, d), then B-splines (R, K)."""
    d, total = dense.shape[1], dense.shape[1] + maps.shape[1]
    seen = np.asarray(dense.any(axis=1))
    if np.count_nonzero(seen) < BLOCKS.seen_share * len(seen):  # components of other campaigns
        data, dense, maps = data[seen], dense[seen], maps[np.flatnonzero(seen)]
    products = np.empty((total + 1, total + 1))
    products[:d, :d] = dense.T @ dense
    products[d:-1, :d] = maps.T @ dense
    products[:d, d:-1] = products[d:-1, :d].T
    products[d:-1, d:-1] = (maps.T @ maps).toarray()
    products[-1, :-1] = np.concatenate([dense.T @ data, maps.T @ data])
    products[:-1, -1], products[-1, -1] = products[-1, :-1], data @ data
    return Gaussian(products)


def in_terms_of(said: Gaussian, dense: int, bases: Sequence[Array]) -> Gaussian:
    """Return what is said of other parameters of maps.

    After so many dense columns come the B-splines of one map after the other; the bases (K, h) are
    the coefficients of these that each map's new parameters stand for. Block by block: a basis of
    all of them would be mostly zeros.
    """
    old = pairwise(dense + np.cumsum([0, *(len(basis) for basis in bases)]))
    new = pairwise(dense + np.cumsum([0, *(basis.shape[1] for basis in bases)]))
    maps = list(zip(bases, old, new, strict=True))
    total = dense + sum(basis.shape[1] for basis in bases)
    turned, found = np.empty((total, total)), np.empty(total)
    turned[:dense, :dense], found[:dense] = said.gram[:dense, :dense], said.projection[:dense]
    for k, (basis, (first, last), (own, end)) in enumerate(maps):
        found[own:end] = basis.T @ said.projection[first:last]
        beside = basis.T @ said.gram[first:last, :last]  # itself, and all that stands before it
        turned[own:end, :dense] = beside[:, :dense]
        for other, (start, stop), (its, its_end) in maps[: k + 1]:
            turned[own:end, its:its_end] = beside[:, start:stop] @ other
        turned[:own, own:end] = turned[own:end, :own].T
    return Gaussian.of_products(turned, found, said.squares)


@dataclass(frozen=True, eq=False)
class Products:
    """Products of N columns and the data of the rows in each of B blocks."""

    gram: Array  # (B, N, N) of columns with columns
    projection: Array  # (B, N) of columns with the data
    squares: Array  # (B,) of the data
    # the same of the rows of positions alone, where there are others; then of what every block is
    # told beside its rows, the precision (N,)
    of_positions: Products | None = None
    told: Array | None = None

    def summed(self) -> Gaussian:
        """Return what all blocks say."""
        return Gaussian.of_products(
            self.gram.sum(axis=0), self.projection.sum(axis=0), float(self.squares.sum())
        )


def map_columns(screws: Array, q_rad: Array, knots: Sequence[int]) -> csr_array:
    """Return how rows follow the B-splines of joints' maps, sparse (b P, K1 + K2 + …), by pose.

    From how they follow the joints' angles (P, b, j), these angles (P, j), and the maps' knots.
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

    def maps(self, knots: Sequence[int], at: Sequence[int] | slice = slice(None)) -> csr_array:
        """Return the columns of the B-splines of maps of all or some joints, of K knots each."""
        return map_columns(self.screws[:, :, at], self.q_rad[:, at], knots)


@dataclass(frozen=True)
class BlockedRows:
    """Rows about the calibrated model, in columns: own parameters, effects, harmonics of maps."""

    survey: Survey  # the campaign
    weights: PoseWeights  # what each pose counts
    shaped: tuple[ShapedEffect, ...]  # effects, in the order of their columns
    knots: int  # K of the maps, whose columns are the K - 1 harmonics of each revolute joint

    @cached_property
    def operating_point(self) -> FittedModel:
        """Return the calibrated model."""
        baseline = self.survey.baseline
        x = np.concatenate([baseline.x, np.zeros(6)])
        return replace(baseline, model=with_base_term(baseline), x=x)

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
    def baseline_columns(self) -> Index:
        """Return the columns of the model's own parameters, and of the survey's nuisances."""
        beside = sum(len(each.sizes) for each in self.survey.nuisances)
        return np.arange(len(unknowns(self.operating_point)) + beside)

    @property
    def dense(self) -> int:
        """Return how many columns stand before the maps."""
        return len(self.baseline_columns) + sum(each.effect.linear for each in self.shaped)

    @property
    def of_weights(self) -> Index:
        """Return the columns of weights that are uncertain, among the model's own."""
        return np.flatnonzero(self.operating_point.model.having("weight"))

    @property
    def baseline_sizes(self) -> Array:
        """Return the sizes expected of the model's own parameters, beside what rows say of them."""
        sizes = np.ones(len(self.baseline_columns))
        sizes[self.of_weights] = BLOCKS.sizes_not_twice
        return sizes

    @property
    def at_bound(self) -> Mask:
        """Return which of the model's own parameters the calibration left at a bound."""
        model, x = self.operating_point.model, self.operating_point.x
        bounds = Bounds.of(model.parameters)
        at_bound = np.zeros(len(self.baseline_columns), dtype=bool)
        at_bound[: len(x)] = (x <= bounds.lower) | (x >= bounds.upper)
        return at_bound

    def of_shaped(self) -> list[Index]:
        """Return the columns of each effect."""
        stops = len(self.baseline_columns) + np.cumsum(
            [0, *(each.effect.linear for each in self.shaped)]
        )
        return [np.arange(*ends) for ends in pairwise(stops)]

    def of_map(self, joint: int) -> Index:
        """Return the columns of the map of a joint, from 1."""
        first = self.dense + self.joints.index(joint) * (self.knots - 1)
        return np.arange(first, first + self.knots - 1)

    def products(self) -> Products:
        """Return the products of all columns, block by block."""
        knots, bases = [self.knots] * len(self.joints), [self.basis] * len(self.joints)
        total = self.dense + len(self.joints) * (self.knots - 1)
        gram = np.empty((2, BLOCKS.blocks, total, total))
        projection, squares = (np.empty((2, BLOCKS.blocks, total)), np.empty((2, BLOCKS.blocks)))
        for b in range(BLOCKS.blocks):
            for kind, rows in enumerate(self.products_by_kind(b, self.joints, knots)):
                found = in_terms_of(rows, self.dense, bases)
                gram[kind, b], projection[kind, b] = found.gram, found.projection
                squares[kind, b] = found.squares
        gram[1] += gram[0]
        projection[1] += projection[0]
        # What is known of the weights is told like readings, some in every block: what they would
        # have to be to explain an error counts against them.
        told = np.zeros(total)
        told[self.of_weights] = 1.0 / BLOCKS.blocks
        every = np.arange(total)
        gram[1][:, every, every] += told
        measured, positions = self.survey.poses.measured, None
        if measured.components_seen.shape[1] > len(measured.position_columns):
            positions = Products(gram[0], projection[0], squares[0])
        return Products(gram[1], projection[1], squares.sum(axis=0), positions, told)

    def products_by_kind(
        self, b: int, joints: Sequence[int], knots: Sequence[int]
    ) -> tuple[Gaussian, Gaussian]:
        """Return what one block says: its rows of positions, and the others.

        Of own parameters, effects, and B-splines of so many knots a turn of some joints.
        """
        block, measured = self.block(b), self.survey.poses.measured
        splines = block.maps(knots, [self.joints.index(joint) for joint in joints])
        component = np.arange(len(block.data)) % measured.components_seen.shape[1]
        of_positions = np.isin(component, measured.position_columns)
        positions, others = (
            said_by(block.data[rows], block.dense[rows], splines[rows])
            for rows in (np.flatnonzero(of_positions), np.flatnonzero(~of_positions))
        )
        return positions, others

    def block(self, b: int) -> BlockRows:
        """Return the rows of one block."""
        here = np.flatnonzero(self.survey.block == b)
        poses, whiten = self.survey.poses.take(here), self.weights.whiteners(here)
        at, model = self.operating_point, self.operating_point.model
        terms: list[Term] = [*model.terms, *(shaped.effect for shaped in self.shaped)]
        points = [at.x[model.columns_of(term)] for term in model.terms]
        points += [shaped.start for shaped in self.shaped]
        joints = positions_of(at, self.joints)
        *found, screws = by_terms(
            at, poses, [*terms, joints], [*points, np.zeros(len(self.joints))], whiten
        )
        own = len(model.terms)
        sizes = possible_sizes(model, poses.measured)
        beside = [by_targets(at, poses) * sizes[len(at.x) :]]
        beside += [each.columns(at, poses) for each in self.survey.nuisances]
        columns = [np.concatenate(found[:own], axis=2) * sizes[: len(at.x)]]
        columns += [whiten @ each for each in beside]
        for shaped, of_effect in zip(self.shaped, found[own:], strict=True):
            columns.append(of_effect[:, :, : shaped.effect.linear] @ shaped.effect.prior_factor)
        dense = np.concatenate(columns, axis=2)
        q_rad = poses.states.q_rad[:, [joint - 1 for joint in self.joints]]
        data = -whiten @ residual(at, poses)[:, :, None]
        return BlockRows(data.ravel(), dense.reshape(-1, dense.shape[2]), screws, q_rad)

    def block_residual(self, b: int, x: Array) -> Array:
        """Return what parameters (N, m) leave of a block, measured less predicted, (p, b, m)."""
        rows, columns = self.block(b), x.shape[1]
        harmonics = x[self.dense :].reshape(len(self.joints), self.knots - 1, columns)
        maps = rows.maps([self.knots] * len(self.joints)) @ (
            (self.basis @ harmonics).reshape(-1, columns)
        )
        left_over = rows.data[:, None] - rows.dense @ x[: self.dense] - maps
        whiteners = self.weights.whiteners(np.flatnonzero(self.survey.block == b))
        found: Array = np.linalg.solve(whiteners, left_over.reshape(*whiteners.shape[:2], -1))
        return found
