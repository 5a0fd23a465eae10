"""A campaign of many different poses made ready: in order of time, and in blocks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from pa10cal.arrays import Array, Index
from pa10cal.discovery.blocked_cv.attitude_lag import AttitudeLag, attitude_lag
from pa10cal.discovery.in_time.wander import Wander
from pa10cal.discovery.linear import residual
from pa10cal.discovery.preparation import MeasurementSetup, complete, context_of
from pa10cal.discovery.with_effects import with_base_term
from pa10cal.errors import DiscoveryError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.effect import CandidateContext, Effect
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
