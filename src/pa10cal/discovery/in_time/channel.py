"""What readings show of time beside all that does not go with it, and how that is told."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from pa10cal.discovery.family import why_unknown
from pa10cal.discovery.faults import Fault
from pa10cal.discovery.in_time.find import find_in_time
from pa10cal.discovery.in_time.wander import STILL, InTime, Wander, by_base
from pa10cal.discovery.linear import by_joints, by_targets, by_terms, error_mm, possible_sizes
from pa10cal.discovery.verdict import Unexplained
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import JointErrorMap

Array = NDArray[np.float64]

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
#: Moves from one pose to the next, in those between any two, that are small: time then goes with
#: the joint's angle.
_SMALL_MOVES = 0.3
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
    """Find how the base moves in time, beside what effects and loads can explain.

    Nothing is found where poses are read once and follow each other like those of a scan: what
    goes with time and what goes with place are then the same.

    Args:
        at: the model, with a term of its own for the base.
        poses: P single readings, complete.
        whitener: (P, b, b) makes the noise of a reading independent and of unit size.
        effects: the candidates.
        logged: whether torques were logged.
        weights: whether the torques of the weights are known.
    """
    once = len(np.unique(poses.pose)) == len(poses)
    slow = _slow_joints(poses)
    if once and like_a_scan(poses):
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
    points = [at.x[at.model.columns_of(term)] for term in own]
    possible = possible_sizes(at.model)
    held = [
        columns * possible[at.model.columns_of(term)]
        for term, columns in zip(own, by_terms(at, poses, own, points), strict=True)
    ]
    static: list[Array] = []
    in_time: list[Array] = []
    asked = [(effect, start) for effect in known for start in effect.starts]
    found = by_terms(at, poses, [effect for effect, _ in asked], [start for _, start in asked])
    for (effect, _), columns in zip(asked, found, strict=True):
        scaled = columns[:, :, : effect.linear] @ effect.prior_factor
        if effect.goes_with_time:
            in_time.append(_SIZES * scaled)
        else:
            static.append(scaled)
    held += [by_targets(at, poses) * _TARGET_M, _by_load(at, poses)]
    if once:
        static.append(_waves(at, poses, slow))
    none = np.zeros((*whitener.shape[:2], 0))
    return find_in_time(
        at,
        poses,
        whitener,
        np.concatenate(held, axis=2),
        np.concatenate([none, *static], axis=2),
        np.concatenate([none, *in_time], axis=2),
    )


def steps_in_time(wander: Wander, at: FittedModel, readings: Observations) -> tuple[Fault, ...]:
    """Return the jumps as faults of the log."""
    order = np.argsort(readings.states.time_s, kind="stable")
    time_s, pose = readings.states.time_s[order], readings.pose[order]
    found = []
    for k, jump in enumerate(wander.jumps):
        last = int(np.searchsorted(time_s, jump.before_s, side="right")) - 1
        next_ = int(np.searchsorted(time_s, jump.after_s))
        motion = wander.of_jump(k)
        moved = by_base(at, readings) @ motion
        size_mm = float(np.sqrt(np.mean(error_mm(readings.measured, moved) ** 2)))
        turn_mrad = 1e3 * float(np.linalg.norm(motion[3:]))
        found.append(
            Fault(
                "step_in_time",
                f"between {pose[last]} at {time_s[last]:.10g} s and {pose[next_]} at "
                f"{time_s[next_]:.10g} s",
                f"the instrument or the base moved by {size_mm:.2g} mm and {turn_mrad:.2f} mrad",
                "measure reference targets before and after, or calibrate the readings before and "
                "after as two campaigns",
            )
        )
    return tuple(found)


def wandering(wander: Wander, floor_mm: float) -> tuple[Unexplained, ...]:
    """Return the walk where it exceeds what the repeatability leaves."""
    walk_mm = wander.rms_mm[1]
    if not wander.walk_m or walk_mm <= floor_mm:
        return ()
    hours = float(np.ptp(wander.times_s)) / _SECONDS_AN_HOUR
    why = (
        f"the instrument or the base wandered by {walk_mm:.3g} mm (root mean square) in "
        f"{hours:.2g} h, neither steadily nor at once"
    )
    return (Unexplained("base", None, walk_mm, why),)


def _by_load(at: FittedModel, poses: Observations) -> Array:
    """Return motions of the base from load to load, (P, b, 6 (loads - 1))."""
    load_N = poses.states.load_N
    under = load_N[:, None] == np.unique(load_N)[1:]
    columns = under[:, None, :, None] * by_base(at, poses)[:, :, None, :]
    return np.asarray(_BY_LOAD * columns.reshape(*columns.shape[:2], -1))


def like_a_scan(poses: Observations) -> bool:
    """Return whether poses follow each other so closely that time and place go together."""
    return float(_slow_joints(poses).mean()) > 0.5


def _slow_joints(poses: Observations) -> NDArray[np.bool_]:
    """Return (n,) which joints move little from one pose to the next."""
    q_rad = poses.states.q_rad[np.argsort(poses.states.time_s, kind="stable")]
    steps = np.median(np.abs(np.diff(q_rad, axis=0)), axis=0)
    spread = np.median(np.abs(q_rad - np.median(q_rad, axis=0)), axis=0)
    return np.asarray(steps < _SMALL_MOVES * spread)


def _waves(at: FittedModel, poses: Observations, slow: NDArray[np.bool_]) -> Array:
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
