"""A campaign of many different poses made ready: in order of time, and in blocks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from pa10cal.arrays import Array, Index
from pa10cal.discovery.in_time.wander import Wander
from pa10cal.discovery.linear import by_joints, residual, with_base_term
from pa10cal.discovery.preparation import MeasurementSetup, complete, context_of
from pa10cal.errors import DiscoveryError
from pa10cal.fit.angles_seen import AnglesSeen, angles_seen
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.results.discovery import Unexplained
from pa10cal.terms.effects.effect import CandidateContext, Effect, turning_joints
from pa10cal.terms.model import Model

#: Blocks of poses, each held out in turn.
BLOCKS = 10
#: A block of fewer poses says too little of how well it is predicted.
_LEAST_POSES = 10
#: Poses below which blocks of them cannot be held out.
LEAST_FOR_BLOCKS = BLOCKS * _LEAST_POSES


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
    lag: AttitudeLag | None = None  # of attitudes behind the motion; None where there can be none

    @property
    def cells(self) -> Observations:
        """Return the poses, each a cell of its own."""
        return self.poses

    @property
    def angles_seen(self) -> AnglesSeen:
        """Return the joint positions that the poses visit."""
        return angles_seen(self.poses.states.q_rad, ~self.context.arm.prismatic)

    def moving(self, wander: Wander) -> Survey:
        """Return the survey of a base that moves, in blocks of every tenth pose.

        Between poses on either side a wander is known; past a stretch of time it is not.
        """
        return replace(self, wander=wander, block=np.arange(len(self.poses)) % BLOCKS)

    def left_by(self, at: FittedModel, poses: Observations | None = None) -> Array:
        """Return predicted minus measured components, (P, b), without motion of the base or lag.

        Args:
            at: the model.
            poses: P complete poses of the campaign; None for all of the survey.
        """
        poses = self.poses if poses is None else poses
        left = residual(at, poses)
        for own in self.nuisances:
            if own.amounts is not None:
                left = left + own.shift(self.baseline, poses)
        return left

    @property
    def nuisances(self) -> tuple[Wander | AttitudeLag, ...]:
        """Return what is found beside model and effects, and belongs to neither."""
        return tuple(each for each in (self.wander, self.lag) if each is not None)

    def with_amounts(self, found: Array) -> Survey:
        """Return the survey with the amounts of these, one after the other (k,)."""
        stops = np.cumsum([0, *(len(each.sizes) for each in self.nuisances)])
        parts = [found[first:last] for first, last in pairwise(stops)]
        own = [
            replace(each, amounts=part) for each, part in zip(self.nuisances, parts, strict=True)
        ]
        wander = next((each for each in own if isinstance(each, Wander)), None)
        lag = next((each for each in own if isinstance(each, AttitudeLag)), None)
        return replace(self, wander=wander, lag=lag)

    def model(self, effects: tuple[Effect, ...] = ()) -> Model:
        """Return the calibrated model with effects, and small motions of the base last."""
        return with_base_term(self.baseline, effects)


def survey(
    readings: Observations,
    baseline: FittedModel,
    setup: MeasurementSetup,
    *,
    torques_logged: bool,
) -> Survey:
    """Make a campaign ready.

    Args:
        readings: the poses of the fit, attitudes and torques as the model has them.
        baseline: the calibrated model, its chain with the bends of the long links.
        setup: what is known besides the poses.
        torques_logged: whether the torques are those of a log.

    Raises:
        DiscoveryError: when there are too few poses for blocks.
    """
    if not enough(len(readings)):
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
    return Survey(
        poses=poses,
        block=_stretches(poses),
        baseline=baseline,
        setup=setup,
        context=context,
        torques_logged=torques_logged,
        lag=attitude_lag(context, poses),
    )


def _stretches(poses: Observations) -> Index:
    """Return the block of each pose (P,): stretches of time, in a group one of every campaign.

    Campaigns show an effect more or less; in blocks of one campaign each, that difference would
    count as chance.
    """
    block = np.zeros(len(poses), dtype=np.intp)
    campaign = poses.states.campaign
    for own in [None] if campaign is None else np.unique(campaign):
        rows = np.arange(len(poses)) if own is None else np.flatnonzero(campaign == own)
        block[rows] = np.arange(len(rows)) * BLOCKS // len(rows)
    return block


def _as_springs_take_them(poses: Observations) -> Observations:
    """Return poses in which an error of the log is one of what the springs are given: the log.

    With the weights' torques in its place, a gain would take the noise and the friction of the log
    out of the springs, and be preferred for that.
    """
    loads = poses.states.static_loads
    if loads is None:
        return poses
    loads = replace(loads, joint_Nm=poses.states.tau_Nm)
    return replace(poses, states=replace(poses.states, static_loads=loads))


def enough(poses: int) -> bool:
    """Return whether there are so many poses that blocks of them can be held out."""
    return poses >= LEAST_FOR_BLOCKS


# Attitudes that go with the way a joint came, where positions do not.
#
# A joint that stops short takes the whole end with it. A reader of attitudes may lag behind the
# motion by itself, or sway on its mount, and leaves positions where they are. Where joints are
# those commanded both look alike in attitudes, so what attitudes alone say of arrivals counts for
# nothing.

#: What attitudes are expected to lag by [rad].
_LAG_RAD = 1e-4
#: Joints are told whose way counts for this part of the largest.
_TOLD = 0.5


@dataclass(frozen=True, eq=False)
class AttitudeLag:
    """By how much attitudes turn with the way that each joint came."""

    joints: tuple[int, ...]  # which, from 1
    campaigns: int = 1  # how many a group has, each with lags of its own; 1 of a single campaign
    amounts: Array | None = None  # (campaigns * joints,) in `sizes`; None until they are found

    @property
    def sizes(self) -> Array:
        """Return the size expected of each amount [rad]."""
        return np.full(self.campaigns * len(self.joints), _LAG_RAD)

    def columns(self, at: FittedModel, poses: Observations) -> Array:
        """Return how components follow the amounts, (P, b, k)."""
        turned = by_joints(at, poses, self.joints)
        turned[:, poses.measured.position_columns] = 0.0
        came = poses.states.since_before[:, [joint - 1 for joint in self.joints]]
        turned = turned * came[:, None, :] * _LAG_RAD
        campaign = poses.states.campaign
        if campaign is None:
            return np.asarray(turned)
        parts = [turned * (campaign == k)[:, None, None] for k in range(self.campaigns)]
        return np.concatenate(parts, axis=2)

    def shift(self, at: FittedModel, poses: Observations) -> Array:
        """Return what attitudes are off by, in the components of poses, (P, b)."""
        assert self.amounts is not None
        return np.asarray(self.columns(at, poses) @ self.amounts)

    def unexplained(self, left_mm: float) -> Unexplained:
        """Return it as a part of what is unexplained, beside the mean error that is left."""
        assert self.amounts is not None
        lags_rad = np.abs(self.amounts * self.sizes).reshape(self.campaigns, -1).max(axis=0)
        said = " and ".join(
            f"joint {joint} ({1e6 * lag_rad:.0f} µrad)"
            for joint, lag_rad in zip(self.joints, lags_rad.tolist(), strict=True)
            if lag_rad > _TOLD * lags_rad.max()
        )
        why = (
            f"attitudes go with the way that {said} came, and positions do not: it is the reader "
            "of attitudes or its mount that lags, and no joint that stops short"
        )
        return Unexplained(of="instrument", form="attitude_lag", shared_error_mm=left_mm, why=why)


def attitude_lag(context: CandidateContext, poses: Observations) -> AttitudeLag | None:
    """Return the lag that attitudes may have; None where joints were read, or there are none."""
    measured = poses.measured
    attitudes = measured.components_seen.shape[1] > len(measured.position_columns)
    if not (context.commanded and attitudes):
        return None
    return AttitudeLag(tuple(turning_joints(context)), max(len(context.campaigns), 1))
