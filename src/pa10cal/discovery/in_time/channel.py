"""What readings show of time beside all that does not go with it, and how that is told."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Mask
from pa10cal.discovery.finding import DiagnosedFault
from pa10cal.discovery.in_time.wander import (
    STILL,
    InTime,
    Wander,
    by_base,
    find_in_time,
    motions_along,
    sizes_of_six,
)
from pa10cal.discovery.linear import by_effects, by_joints, by_own_terms, by_targets, error_mm, rms
from pa10cal.discovery.preparation import why_unknown
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.observe.order import Driver, Parting, drivers, measured_again, partings, slow_joints
from pa10cal.results.discovery import Unexplained
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import JointErrorMap

#: Effects of time are expected to be so many plausible sizes large: theirs is what they explain.
_SIZES = 3.0
#: Waves of a joint's error a turn, and their size, that are taken out where poses are read once;
#: more of a joint that moves little from one pose to the next.
_WAVES = (8, 24)
_WAVE_RAD = 3e-4
#: Motion of the base expected from load to load [m, rad].
_BY_LOAD = 1e-3
#: Places of targets.
_TARGET_M = 3e-2
#: Of more readings so many, spread evenly over time, stand for all.
_MOST_READINGS = 1200
#: Waves of the base's motion over the positions of a joint that goes with the order, that motion,
#: and how often what is found of time is held against errors that go with more joints.
_RIVAL_WAVES = 8
_RIVAL_M = 1e-3
_MOST_RIVALS = 4
_SECONDS_AN_HOUR = 3600.0


def in_time_of(
    at: FittedModel,
    poses: Observations,
    whitener: Array,
    effects: Iterable[Effect],
    *,
    logged: bool,
    weights: bool,
) -> InTime:
    """Find how the base moves in time, beside what candidate effects and loads can explain.

    Nothing is found where times were not recorded, where the order goes with a joint or a load, and
    where poses are read once and follow each other like those of a scan: what goes with time and
    what goes with place are then the same. What is found where a joint or the load goes from one
    side to the other is held against errors that go with it, and so is a walk where a joint moves
    slowly: only what these do not take is told of time.

    The model has a term of its own for the base; the P single readings are complete, and their
    noise whitened by (P, b, b). Torques may have been logged, those of the weights be known.
    """
    once = len(np.unique(poses.pose)) == len(poses)
    slow = slow_joints(poses.states)
    if not poses.states.tells_time or (once and like_a_scan(poses)):
        return STILL
    if len(poses) > _MOST_READINGS:
        order = np.argsort(poses.states.time_s, kind="stable")
        shown = order[np.linspace(0, len(order) - 1, _MOST_READINGS).round().astype(int)]
        poses, whitener = poses.take(shown), whitener[shown]
    known = [
        effect
        for effect in effects
        if not (isinstance(effect, JointErrorMap) or (effect.generic and effect.goes_with_time))
        and why_unknown(effect, poses.states, logged=logged, weights=weights) is None
    ]
    own = [term for term in at.model.terms if not isinstance(term, JointErrorMap)]
    load_N = poses.states.load_N
    by_load = motions_along(by_base(at, poses), load_N[:, None] == np.unique(load_N)[1:])
    held = [*by_own_terms(at, poses, own), by_targets(at, poses) * _TARGET_M, _BY_LOAD * by_load]
    shapes = [effect for effect in known for _ in effect.starts]
    starts = [start for effect in known for start in effect.starts]
    static = [np.zeros((*whitener.shape[:2], 0))]
    in_time = [static[0]]
    for effect, columns in zip(shapes, by_effects(at, poses, shapes, starts), strict=True):
        if effect.goes_with_time:
            in_time.append(_SIZES * columns)
        else:
            static.append(columns)
    if once:
        static.append(_waves(at, poses, slow))
    static_columns, of_time = np.concatenate(static, axis=2), np.concatenate(in_time, axis=2)

    def find(rivals: Rivals) -> InTime:
        own = np.concatenate([*held, _motions_by(rivals, at, poses)], axis=2)
        walks = not any(isinstance(rival, Driver) for rival in rivals)
        return find_in_time(at, poses, whitener, own, static_columns, of_time, walks=walks)

    shows = find(())
    if measured_again(poses):
        return shows
    rivals: Rivals = ()
    first_mm = 0.0 if shows.wander is None else shows.wander.rms_mm[0]
    prismatic = at.model.chain.arm.prismatic
    for _ in range(_MOST_RIVALS):
        more = rivals_of(shows, poses.states, prismatic)
        if not more:
            break
        if set(more) <= set(rivals):  # what is left beside them still goes with the order
            shows = STILL
            break
        rivals = _in_order((*rivals, *more))
        shows = find(rivals)
    else:
        shows = STILL
    if not rivals:
        return shows
    said = tuple(dict.fromkeys(str(_driver(rival)) for rival in rivals))
    return replace(shows, rivals=said, rivals_mm=first_mm)


def steps_in_time(
    wander: Wander | None, at: FittedModel, readings: Observations
) -> tuple[DiagnosedFault, ...]:
    """Return the jumps as faults of the log."""
    if wander is None:
        return ()
    order = np.argsort(readings.states.time_s, kind="stable")
    time_s, pose = readings.states.time_s[order], readings.pose[order]
    found = []
    for k, jump in enumerate(wander.jumps):
        last = int(np.searchsorted(time_s, jump.before_s, side="right")) - 1
        next_ = int(np.searchsorted(time_s, jump.after_s))
        motion = wander.unit_motions[k]
        size_mm = rms(error_mm(readings.measured, by_base(at, readings) @ motion))
        turn_mrad = 1e3 * float(np.linalg.norm(motion[3:]))
        found.append(
            DiagnosedFault(
                kind="step_in_time",
                where=f"between {pose[last]} at {time_s[last]:.10g} s and {pose[next_]} at "
                f"{time_s[next_]:.10g} s",
                what=f"the instrument or the base moved by {size_mm:.2g} mm and {turn_mrad:.2f} "
                "mrad",
                remedy="measure reference targets before and after, or calibrate the readings "
                "before and after as two campaigns",
                at_s=jump.time_s,
            )
        )
    return tuple(found)


#: Errors that go with joints or the load, where these go with the order: rivals of time. They are
#: places of joints and loads that part the rows as a jump does, then joints that move slowly, where
#: a walk was found: it is one of theirs as well.
Rivals = tuple[Parting | Driver, ...]


def rivals_of(found: InTime, states: PoseStates, prismatic: Mask) -> Rivals:
    """Return the errors by joints and the load that explain as well what was found of time."""
    if found.wander is None:
        return ()
    rivals: list[Parting | Driver] = []
    for jump in found.wander.jumps:
        rivals += partings(states, jump.time_s, prismatic)
    if found.wander.walk_m:
        slow = slow_joints(states)
        rivals += [one for one in drivers(states, prismatic) if one.joint and slow[one.joint - 1]]
    return _in_order(rivals)


def _in_order(rivals: Iterable[Parting | Driver]) -> Rivals:
    return tuple(sorted(dict.fromkeys(rivals), key=lambda rival: isinstance(rival, Driver)))


def _driver(rival: Parting | Driver) -> Driver:
    return rival if isinstance(rival, Driver) else rival.driver


def _motions_by(rivals: Rivals, at: FittedModel, poses: Observations) -> Array:
    """Return how the base's motion by rivals moves the components of poses, (P, b, c)."""
    from scipy.stats import rankdata  # late: half a second, for few campaigns

    states = poses.states
    courses = [np.zeros((len(poses), 0))]
    courses += [
        (rival.driver.of(states) > rival.at).astype(np.float64)[:, None]
        for rival in rivals
        if isinstance(rival, Parting)
    ]
    waves = np.arange(1, _RIVAL_WAVES + 1)
    for driver in dict.fromkeys(map(_driver, rivals)):
        rank = rankdata(driver.of(states)) / len(poses)
        courses.append(np.cos(np.pi * np.outer(rank, waves)) / waves)
    together = np.column_stack(courses)
    six = np.tile(sizes_of_six(_RIVAL_M, 1.0), together.shape[1])
    return motions_along(by_base(at, poses), together - np.mean(together, axis=0)) * six


def told_with_rivals(found: InTime, floor_mm: float) -> tuple[Unexplained, ...]:
    """Return what goes with time and with joints or the load alike, where it exceeds noise."""
    if not found.rivals or found.rivals_mm <= floor_mm:
        return ()
    why = (
        f"{found.rivals_mm:.3g} mm (root mean square) go with the order of the poses, and with "
        f"{' and '.join(found.rivals)} alike: the arm errs by that, or the instrument or the base "
        "moved; measure the poses in random order"
    )
    return (Unexplained(of=None, form=None, shared_error_mm=found.rivals_mm, why=why),)


def wandering(wander: Wander | None, floor_mm: float) -> tuple[Unexplained, ...]:
    """Return the walk where it exceeds what the repeatability leaves."""
    if wander is None or not wander.walk_m or wander.rms_mm[1] <= floor_mm:
        return ()
    walk_mm = wander.rms_mm[1]
    hours = float(np.ptp(wander.times_s)) / _SECONDS_AN_HOUR
    why = (
        f"the instrument or the base wandered by {walk_mm:.3g} mm (root mean square) in "
        f"{hours:.2g} h, neither steadily nor at once"
    )
    return (Unexplained(of="base", form=None, shared_error_mm=walk_mm, why=why),)


def like_a_scan(poses: Observations) -> bool:
    """Return whether poses follow each other so closely that time and place go together."""
    return float(slow_joints(poses.states).mean()) > 0.5


def _waves(at: FittedModel, poses: Observations, slow: Mask) -> Array:
    """Return waves of the error of every turning joint by its angle, (P, b, w)."""
    arm = at.model.chain.arm
    joints = [joint for joint, slides in enumerate(arm.prismatic, start=1) if not slides]
    screws = by_joints(at, poses, joints)
    q_rad = poses.states.q_rad[:, [joint - 1 for joint in joints]]
    columns = [np.zeros((*screws.shape[:2], 0))]
    for k, joint in enumerate(joints):
        angle = q_rad[:, k, None] * np.arange(1, _WAVES[int(slow[joint - 1])] + 1)
        waves = np.concatenate([np.sin(angle), np.cos(angle)], axis=1)
        columns.append(screws[:, :, k, None] * waves[:, None])
    return np.asarray(_WAVE_RAD * np.concatenate(columns, axis=2))
