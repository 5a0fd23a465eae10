"""Motion of the instrument or the base in the course of time, found by log evidence.

Readings of one pose at different times differ by noise and by motion between them, however
incomplete the model of the arm is (`timed_rows`). Jumps and a walk are added one after the other as
long as each gains enough; what a joint or a load explains as well is no motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index, Mask, rms
from pa10cal.discovery import jacobians
from pa10cal.discovery.nuisances import (
    NO_MOTION,
    TimeFindings,
    Wander,
    motions_along,
    sizes_of_motions,
)
from pa10cal.discovery.pose_columns import by_pose_and_time
from pa10cal.discovery.rules import MOTION
from pa10cal.discovery.target_wander import target_wander
from pa10cal.discovery.timed_rows import WALKS_M, TimedRows
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.position_errors import position_error_mm, position_noise_m2
from pa10cal.observe.observations import Observations
from pa10cal.observe.time_order import (
    Threshold,
    covariates,
    like_a_scan,
    measured_again,
    slow_joints,
    spread_over_time,
    step_thresholds,
    with_place_labels,
)
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import is_error_map


def in_time_of(
    at: FittedModel,
    poses: Observations,
    whitener: Array,
    effects: Iterable[Effect],
    *,
    logged: bool,
    weights: bool,
) -> TimeFindings:
    """Return how the base moves in time, beyond what candidate effects and loads explain.

    Nothing is found where times were not recorded, nor where poses are read once and in the order
    of a scan that returns to no place: time and place then cannot be distinguished. Motion found
    where a joint or the load passes from one side to the other, or where a joint moves slowly, is
    compared with errors that depend on that joint or load: only what these leave is attributed to
    time. A walk is none where readings of single targets wander as much, each by itself.

    Args:
        at: the model, with small motions of the base.
        poses: P complete single readings.
        whitener: (P, b, b) that makes their noise white.
        effects: candidate effects.
        logged: whether torques were logged.
        weights: whether torques of the weights are known.
    """
    once, again = len(np.unique(poses.pose)) == len(poses), measured_again(poses)
    if not poses.states.tells_time or (once and not again and like_a_scan(poses)):
        return NO_MOTION
    poses = with_place_labels(poses) if again else poses
    if len(poses) > MOTION.most_readings:
        shown: Index = spread_over_time(poses, MOTION.most_readings)
        poses, whitener = poses.take(shown), whitener[shown]
    own = [term for term in at.model.terms if not is_error_map(term)]
    load_N = poses.states.load_N
    by_load = motions_along(jacobians.by_base(at, poses), load_N[:, None] == np.unique(load_N)[1:])
    held = [
        *jacobians.by_scaled_terms(at, poses, own),
        at.compared(poses).by_targets * MOTION.targets_m,
        MOTION.by_load_m * by_load,
    ]
    static, of_time = by_pose_and_time(at, poses, effects, logged=logged, weights=weights)

    def beside(rivals: tuple[Threshold, ...]) -> TimeFindings:
        own = np.concatenate([*held, _motions_by(rivals, at, poses)], axis=2)
        walks = all(np.isfinite(rival.value) for rival in rivals)
        return _motion_in(TimedRows(at, poses, whitener, own, static, of_time), walks=walks)

    found = beside(())
    if found.wander is not None and found.wander.walk_m:
        of_targets = target_wander(at, poses, at.compared(poses).residual)
        if of_targets is not None:
            return replace(NO_MOTION, has_drift=found.has_drift, of_targets=of_targets)
    if again:  # poses measured again show that no joint and no load explains the motion
        return found
    return _beyond_rivals(found, beside, poses.states, at.arm.prismatic)


def _motion_in(rows: TimedRows, *, walks: bool) -> TimeFindings:
    """Return the jumps of the base, its walk where one is sought, and whether it drifts."""
    poses, found = rows.poses, _likeliest(rows, walks=walks)
    static = rows.without_time()
    has_drift = rows.about(found).nats - static.about(found).nats > MOTION.drift_nats
    if not found.jumps and not found.walk_m:
        return TimeFindings(None, has_drift)
    # Where no effect of time is significant, everything that follows time is due to the motion.
    amounts = (rows if has_drift else static).about(found).courses.mean
    found = replace(found, amounts=amounts)
    walk = replace(found, jumps=(), amounts=amounts[6 * len(found.jumps) :])
    all_mm, walk_mm = (
        rms(position_error_mm(poses.measured, motion.shift(rows.at, poses)))
        for motion in (found, walk)
    )
    cov = np.asarray(np.linalg.inv(np.swapaxes(rows.whitener, 1, 2) @ rows.whitener))
    variance = np.trace(position_noise_m2(poses.measured, cov), axis1=1, axis2=2)
    noise_mm = 1e3 * float(np.sqrt(np.median(variance))) * rows.about(found).noise_scale
    if all_mm < MOTION.least_noise_ratio * noise_mm:
        return TimeFindings(None, has_drift)
    return TimeFindings(replace(found, rms_mm=(all_mm, walk_mm)), has_drift)


def _likeliest(rows: TimedRows, *, walks: bool) -> Wander:
    """Return the jumps, and the walk where one is sought, that gain enough one after the other."""
    sizes = len(MOTION.jumps_m) * len(MOTION.turns_rad_per_m)
    needed_jump = float(np.log(len(rows.poses) * sizes / MOTION.false_rate))
    needed_walk = float(np.log(len(WALKS_M) * len(MOTION.turns_rad_per_m) / MOTION.false_rate))
    found = rows.in_pauses(needed_jump)
    in_pauses = len(found.jumps)
    nats = rows.about(found).nats
    while not in_pauses and len(found.jumps) < MOTION.most_jumps:
        with_more_nats, with_more = rows.best_jump(found)
        beyond = with_more_nats - nats - needed_jump
        if walks and not found.walk_m:
            with_walk_nats, with_walk = rows.best_walk(found)
            walk_beyond = with_walk_nats - nats - needed_walk
            if walk_beyond >= beyond:
                with_more_nats, with_more, beyond = with_walk_nats, with_walk, walk_beyond
        if beyond <= 0.0:
            break
        nats, found = with_more_nats, with_more
    if walks:  # a walk may explain a jump that was found before it
        for jump in found.jumps[in_pauses:]:
            others = tuple(other for other in found.jumps if other != jump)
            without_nats, without = rows.best_walk(replace(found, jumps=others))
            if nats - without_nats < needed_jump - needed_walk:
                nats, found = without_nats, without
    return found


def _beyond_rivals(
    found: TimeFindings,
    beside: Callable[[tuple[Threshold, ...]], TimeFindings],
    states: PoseStates,
    prismatic: Mask,
) -> TimeFindings:
    """Return the motion that remains beside joints and loads whose errors may explain it as well.

    Args:
        found: the motion found beside none of them.
        beside: returns the motion found beside errors that depend on some of them.
    """
    rivals: tuple[Threshold, ...] = ()
    first_mm = 0.0 if found.wander is None else found.wander.rms_mm[0]
    for _ in range(MOTION.most_rivals):
        more = _rivals_of(found, states, prismatic)
        if not more:
            break
        if set(more) <= set(rivals):  # the motion found beside them still follows their order
            found = NO_MOTION
            break
        both = dict.fromkeys((*rivals, *more))
        rivals = tuple(sorted(both, key=lambda rival: rival.value == np.inf))
        found = beside(rivals)
    else:
        found = NO_MOTION
    if not rivals:
        return found
    names = tuple(dict.fromkeys(str(rival.covariate) for rival in rivals))
    return replace(found, rivals=names, rivals_mm=first_mm)


def _rivals_of(found: TimeFindings, states: PoseStates, prismatic: Mask) -> tuple[Threshold, ...]:
    """Return the joints or the load whose errors may explain the motion that was found.

    For a jump, thresholds of a joint or the load that divide the rows as it does; for a walk, slow
    joints, without a threshold.
    """
    if (wander := found.wander) is None:
        return ()
    rivals = [
        threshold
        for jump in wander.jumps
        for threshold in step_thresholds(states, jump.time_s, prismatic)
    ]
    if wander.walk_m:
        slow = slow_joints(states)
        rivals += [
            Threshold(each, np.inf)
            for each in covariates(states, prismatic)
            if each.joint is not None and slow[each.joint - 1]
        ]
    return tuple(rivals)


def _motions_by(rivals: tuple[Threshold, ...], at: FittedModel, poses: Observations) -> Array:
    """Return columns (P, b, c) of motions of the base that depend on rivals: steps and waves."""
    states = poses.states
    courses = [np.zeros((len(poses), 0))]
    courses += [
        (rival.covariate.values(states) > rival.value).astype(np.float64)[:, None]
        for rival in rivals
        if np.isfinite(rival.value)
    ]
    waves = np.arange(1, MOTION.rival_waves + 1)
    for covariate in dict.fromkeys(rival.covariate for rival in rivals):
        values = covariate.values(states)
        ends = [np.searchsorted(np.sort(values), values, side) for side in ("left", "right")]
        rank = (0.5 * sum(ends) + 0.5) / len(poses)  # of equal values the mean one
        courses.append(np.cos(np.pi * np.outer(rank, waves)) / waves)
    every = np.column_stack(courses)
    sizes = np.tile(sizes_of_motions(MOTION.rival_m, 1.0), every.shape[1])
    return motions_along(jacobians.by_base(at, poses), every - np.mean(every, axis=0)) * sizes
