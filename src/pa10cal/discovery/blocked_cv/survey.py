"""A campaign prepared for blocked cross-validation: poses in order of time, divided into blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from pa10cal.arrays import Array, Index
from pa10cal.discovery.changed import Change
from pa10cal.discovery.jacobians import WhitenedPoses
from pa10cal.discovery.joint_steps import JointSteps
from pa10cal.discovery.near_poses import noise_of_near_poses
from pa10cal.discovery.noise import Noise, with_torque_noise
from pa10cal.discovery.nuisances import AttitudeLag, Nuisance, Wander, attitude_lag
from pa10cal.discovery.preparation import MeasurementSetup, Prepared, complete, context_of
from pa10cal.discovery.repeats import enough_repeats
from pa10cal.discovery.rules import BLOCKS
from pa10cal.errors import DiscoveryError
from pa10cal.fit import validity
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.observe.paths import along_a_path, outside_ranges
from pa10cal.rules import ANGLES
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.effect import Effect

#: Fewest poses from which blocks can be held out, of whatever instrument.
LEAST_FOR_BLOCKS = BLOCKS.blocks * BLOCKS.least_poses


def least_for_blocks(readings: Observations) -> int:
    """Return the fewest poses from which blocks can be held out: fewer of three targets each."""
    components, (sure, poses) = readings.measured.components_seen.sum(axis=1), BLOCKS.sure_poses
    are_sure = len(components) and np.median(components) >= sure
    return BLOCKS.blocks * poses if are_sure else LEAST_FOR_BLOCKS


def judged_by_blocks(readings: Observations) -> bool:
    """Return whether effects are judged by held-out blocks of poses, and not by repeats."""
    return len(readings) >= least_for_blocks(readings) and not enough_repeats(readings)


@dataclass(frozen=True, eq=False)
class Survey:
    """P different poses, their blocks, and the model from which the search sets out.

    Nuisances (motion of the base, a change at a row, a lag of orientations) are fitted together
    with the model and belong neither to the model nor to its effects.
    """

    # in order of time; their states hold the static loads and the directions of arrival
    poses: Observations
    # (P,) number of the block of each pose, from 0: consecutive poses, or interleaved where the
    # base moves or something changed in the course of time
    block: Index
    # the model from which the search sets out; its chain has the bends of the long links
    baseline: FittedModel
    setup: MeasurementSetup  # what is known besides the poses
    context: CandidateContext  # where effects may occur
    torques_logged: bool  # whether torques were logged; else computed from the masses described
    wander: Wander | None = None  # motion of the base in the course of time; None: at rest
    # of targets, beam or log at a row, or of zeros of joints at several; None: no change
    change: Change | JointSteps | None = None
    lag: AttitudeLag | None = None  # of orientations behind the motion; None: no lag
    calibrated_before: FittedModel | None = None  # the calibrated model, unless it is `baseline`
    begins_with: tuple[Effect, ...] = ()  # effects that the search has from its first step

    @classmethod
    def of(cls, campaign: Prepared, baseline: FittedModel | None = None) -> Survey:
        """Prepare the trusted poses of a campaign, with loads and arrivals as a model has them.

        The model is the campaign's calibrated one, unless another is given.

        Raises:
            DiscoveryError: when there are too few poses for blocks.
        """
        readings, setup = campaign.trusted, campaign.setup
        baseline, torques_logged = baseline or campaign.baseline, campaign.torques == "logged"
        if len(readings) < least_for_blocks(readings):
            raise DiscoveryError(
                "too few poses to judge effects by blocked cross-validation",
                where="grid poses",
                value=len(readings),
                allowed=f"at least {least_for_blocks(readings)} poses",
                remedy="measure more poses, or measure poses repeatedly",
            )
        poses = readings.take(np.argsort(readings.states.time_s, kind="stable"))
        poses = complete(poses, baseline, setup)
        if torques_logged:
            poses = _with_spring_loads_from_log(poses)
        context = context_of(poses, baseline, setup)
        return cls(
            poses=poses,
            block=consecutive_blocks(poses),
            baseline=baseline,
            setup=setup,
            context=context,
            torques_logged=torques_logged,
            lag=attitude_lag(context, poses),
        )

    @property
    def calibrated(self) -> FittedModel:
        """Return the calibrated model, whether or not the search sets out from it."""
        return self.calibrated_before or self.baseline

    @property
    def cells(self) -> Observations:
        """Return the poses, by the name that `EvidenceProblem` has for poses with all repeats.

        `next_poses` proposes poses by a survey or by such a problem.
        """
        return self.poses

    @property
    def angles_seen(self) -> validity.AngleCoverage:
        """Return the joint positions that the poses visit, fine enough for any map."""
        order = np.where(self.context.arm.prismatic, 0.0, ANGLES.fine_order)
        return validity.angles_seen(self.poses.states.q_rad, order)

    def moving(self, wander: Wander) -> Survey:
        """Return the survey with a base that moves, in interleaved blocks.

        The motion at a pose follows from poses before and after it, not from poses far away in
        time.
        """
        return self._interleaved(wander=wander)

    def changing(self, change: Change | JointSteps) -> Survey:
        """Return the survey with a change at a row or at several, in interleaved blocks."""
        return self._interleaved(change=change)

    def settling(self, effects: Sequence[Effect]) -> Survey:
        """Return the survey with effects of the first poses, in interleaved blocks."""
        return self._interleaved(begins_with=(*self.begins_with, *effects))

    def _interleaved(self, **changed: Any) -> Survey:
        """Return the survey with something in the course of time, in interleaved blocks."""
        return replace(self, block=interleaved_blocks(len(self.poses)), **changed)

    def net_residual(self, at: FittedModel, poses: Observations | None = None) -> Array:
        """Return predicted minus measured components (P, b) with the nuisances subtracted.

        Args:
            at: the model.
            poses: complete poses of the campaign, (P,); None: those of the survey.
        """
        if poses is None:
            return at.compared(self.poses).residual + self._nuisance_shift
        return at.compared(poses).residual + self._shift(poses)

    def whitened(self, at: FittedModel, whitener: Array) -> WhitenedPoses:
        """Return its poses about a model, the nuisances subtracted, whitened by (P, b, b)."""
        return WhitenedPoses(at, self.poses, self.net_residual(at), whitener)

    @cached_property
    def _nuisance_shift(self) -> Array | float:
        return self._shift(self.poses)

    def _shift(self, poses: Observations) -> Array | float:
        """Return the sum of the fitted nuisances in the measured components, (P, b)."""
        return sum(
            nuisance.shift(self.baseline, poses)
            for nuisance in self.nuisances
            if nuisance.amounts is not None
        )

    def noise_about(self, at: FittedModel) -> Noise:
        """Return the noise of single readings: from nearly equal poses, else as stated."""
        residual = self.net_residual(at)
        noise = noise_of_near_poses(self.poses, residual, bool(at.arm.prismatic.any()))
        if not self.torques_logged:
            return noise
        return with_torque_noise(noise, residual, at, self.poses, self.setup.payload)

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Return the nuisances of this survey, in the order of their columns."""
        return tuple(each for each in (self.wander, self.change, self.lag) if each is not None)

    @property
    def nuisance_count(self) -> int:
        """Return how many unknowns the nuisances have together."""
        return sum(len(nuisance.sizes) for nuisance in self.nuisances)

    def with_amounts(self, amounts: Array) -> Survey:
        """Return the survey with fitted amounts (k,) of its nuisances, in their order."""
        assert len(amounts) == self.nuisance_count
        stops = np.cumsum([0 if n is None else len(n.sizes) for n in (self.wander, self.change)])
        of_wander, of_change, of_lag = np.split(amounts, stops)
        return replace(
            self,
            wander=self.wander and replace(self.wander, amounts=of_wander),
            change=self.change and replace(self.change, amounts=of_change),
            lag=self.lag and replace(self.lag, amounts=of_lag),
        )


def interleaved_blocks(count: int) -> Index:
    """Return block numbers (count,) of which each block has every tenth pose."""
    return np.arange(count) % BLOCKS.blocks


def consecutive_blocks(poses: Observations) -> Index:
    """Return block numbers (P,) of consecutive poses, a tenth of every campaign in each block.

    If each block held a single campaign, differences between campaigns would count as chance.

    Of a campaign alone, last poses that are apart from all others (`_last_apart`) are dealt to the
    smallest blocks, one by one, and the others are divided without them: of 105 poses whose last
    five are apart, each block has ten consecutive ones, and five blocks one more.
    """
    campaign = poses.states.campaign
    if campaign is not None:
        return _tenths(campaign)
    campaign = np.zeros(len(poses), dtype=np.intp)
    block = _tenths(campaign)
    apart = _last_apart(poses.states.q_rad, block)
    if len(apart):
        others = np.delete(np.arange(len(poses)), apart)
        block[others] = _tenths(campaign[others])
        held = np.bincount(block[others], minlength=BLOCKS.blocks)
        for row in apart:
            block[row] = held.argmin()
            held[block[row]] += 1
    return block


def _tenths(campaign: Index) -> Index:
    """Return block numbers (P,) of poses by the number of their campaign (P,), in order of time.

    Poses of campaigns with fewer poses than blocks are dealt to the blocks in turn, from one such
    campaign to the next. The others begin at the block that leaves the sizes most even. So of
    campaigns with 7, 25 and 6 poses the first is in blocks 0 to 6, the last in 7, 8, 9, 0, 1, 2,
    and the second has two or three consecutive poses in every block.
    """
    block = np.zeros(len(campaign), dtype=np.intp)
    held = np.zeros(BLOCKS.blocks, dtype=np.intp)
    dealt = 0
    for number in np.unique(campaign):
        rows = np.flatnonzero(campaign == number)
        count = len(rows)
        if count < BLOCKS.blocks:
            own, first = np.arange(count), dealt
            dealt += count
        else:
            own = np.arange(count) * BLOCKS.blocks // count
            sizes = np.bincount(own)
            uneven = [np.sum((held + np.roll(sizes, k)) ** 2) for k in range(BLOCKS.blocks)]
            first = int(np.argmin(uneven))
        block[rows] = (first + own) % BLOCKS.blocks
        held += np.bincount(block[rows], minlength=BLOCKS.blocks)
    return block


def _last_apart(q_rad: Array, block: Index) -> Index:
    """Return poses of the last block at joint positions (P, n) outside those of all other blocks.

    As where poses that a verdict asked for were measured after all others. If they were held out
    together, what they show would be in one block, which is then predicted badly whatever the model
    holds.

    None if they are no more than ranges of joints have by chance. None in rows sorted by a joint:
    there the first block is as far apart as the last one, or a step of the joint fills several
    blocks, each within the range of the others. None along a path, where poses that are close
    together err alike.
    """
    if along_a_path(q_rad):
        return np.zeros(0, np.intp)
    apart = np.zeros(len(block), bool)
    for number in range(BLOCKS.blocks):
        here = block == number
        apart[here] = outside_ranges(q_rad[here], q_rad[~here])
    count = np.bincount(block[apart], minlength=BLOCKS.blocks)
    last = BLOCKS.blocks - 1
    beyond_chance = count[last] >= max(BLOCKS.least_apart, 2 * count[:last].max())
    return np.flatnonzero(apart & (block == last) & beyond_chance)


def _with_spring_loads_from_log(poses: Observations) -> Observations:
    """Return poses whose joint springs carry the logged torques.

    An error of the log then acts through the springs. If they carried computed torques, a gain of
    the log would be preferred, as it replaces those by torques with noise and friction.
    """
    loads = poses.states.static_loads
    if loads is None:
        return poses
    loads = replace(loads, joint_Nm=poses.states.tau_Nm)
    return replace(poses, states=replace(poses.states, static_loads=loads))
