"""What to measure next: configurations that best distinguish what the data so far cannot.

An effect and its rival are far apart where one, in the size found, leaves rows that the model's own
parameters and the other together cannot follow; what these cost the other is the difference in log
evidence to be expected. Either of the two may be the truth, so the lesser of both ways counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.discovery.evidence.fit import Fit
from pa10cal.discovery.evidence.problem import Problem, noise_models
from pa10cal.discovery.linear import by_every_joint
from pa10cal.discovery.next_poses.contest import Outlook, Pair, outlooks
from pa10cal.discovery.next_poses.room import (
    Measured,
    Room,
    draw_admissible,
    measured_ends_m,
)
from pa10cal.discovery.noise import same_circumstances
from pa10cal.discovery.preparation import complete
from pa10cal.discovery.verdict import Plan, label_of
from pa10cal.errors import DiscoveryError
from pa10cal.fit.angles_seen import WITHIN_RAD, AnglesSeen
from pa10cal.fit.loads import statics_of
from pa10cal.observe.observations import Observations
from pa10cal.results.discovery import Separation, SuggestedPose
from pa10cal.terms.model import Model

#: A pair that the best configurations bring apart by less (odds of 20 to 1) counts as one that
#: poses cannot distinguish.
LEAST_NATS = 3.0
_POOL = 1000


def plan(
    problem: Problem,
    found: Fit,
    rivals: Sequence[Pair],
    count: int = 10,
    random_seed: int = 0,
    room: Room | None = None,
) -> Plan:
    """Choose the configurations that best separate pairs of effects.

    Out of a pool drawn at random, one after the other, each time the one with which the closest
    pair comes furthest apart. Pairs that no such choice would split are omitted.

    Args:
        problem: the campaign.
        found: the model with what was found, fitted.
        rivals: pairs of an effect (of the fit, or not testable) and what explains the data as well
            in its place: another effect, or None for the model's own parameters alone.
        count: configurations wanted.
        random_seed: draws the pool.
        room: where arm and tool may go; the default where None.

    Raises:
        DiscoveryError: when nothing can be foreseen, or an effect needs what is not known.
    """
    if not rivals:
        return Plan((), ())
    pool = _draw(problem, room or Room(), np.random.default_rng(random_seed))
    ahead = foresee(problem, found, pool.q_rad, pool.load_N, pool.arrival)
    pairs = outlooks(problem, found, rivals, ahead)
    count = min(count, len(pool.q_rad))
    possible = [float(_choose([pair], count, [0])[1][-1, 0]) for pair in pairs]
    sought = [k for k, pair in enumerate(pairs) if possible[k] - _nats(pair) >= LEAST_NATS]
    chosen, nats = _choose(pairs, count if sought else 0, sought)
    return Plan(
        _chosen_poses(pool, chosen, nats, rivals, sought),
        tuple(
            Separation(
                pair=label_of(*pair),
                before_nats=float(nats[0, k]),
                after_nats=float(nats[-1, k]),
                possible_nats=possible[k],
                can_be_split=possible[k] - float(nats[0, k]) >= LEAST_NATS,
            )
            for k, pair in enumerate(rivals)
        ),
    )


@dataclass(frozen=True)
class _Pool:
    """N configurations that could be measured: joint angles, loads, directions of arrival."""

    q_rad: Array
    load_N: Array
    arrival: Array


def _draw(problem: Problem, room: Room, rng: np.random.Generator) -> _Pool:
    """Draw the pool: with the least load or the largest, from either side of every joint.

    A spring that is soft near zero torque shows without load, all else that yields shows with it.
    """
    q_rad = draw_admissible(problem, _POOL, room, rng)
    load_N = problem.cells.states.load_N
    loads = np.array([load_N.min(), load_N.max()])
    return _Pool(
        q_rad, rng.choice(loads, len(q_rad)), rng.choice(np.array([-1.0, 1.0]), q_rad.shape)
    )


def _choose(
    pairs: Sequence[tuple[Outlook, ...]], count: int, sought: Sequence[int]
) -> tuple[list[int], Array]:
    """Choose configurations one after the other by the closest of the pairs sought.

    Returns:
        The configurations, and the separation (count + 1, pairs) before the first and after each.
    """
    chosen: list[int] = []
    nats = [[_nats(pair) for pair in pairs]]
    for _ in range(count):
        ahead = np.min([outlook.nats_with() for k in sought for outlook in pairs[k]], axis=0)
        ahead[chosen] = -np.inf
        chosen.append(int(np.argmax(ahead)))
        pairs = [tuple(outlook.after(chosen[-1]) for outlook in pair) for pair in pairs]
        nats.append([_nats(pair) for pair in pairs])
    return chosen, np.array(nats)


def _nats(pair: tuple[Outlook, ...]) -> float:
    return min(outlook.nats for outlook in pair)


def _chosen_poses(
    pool: _Pool, chosen: list[int], nats: Array, rivals: Sequence[Pair], sought: list[int]
) -> tuple[SuggestedPose, ...]:
    """Return what was chosen, with the pairs it is for."""
    suggestions = []
    for order, k in enumerate(chosen):
        gained = nats[order + 1] - nats[order]
        even_share = (nats[-1] - nats[0]) / len(chosen)
        closest = min(sought, key=lambda pair: nats[order, pair])
        suggestions.append(
            SuggestedPose(
                q_deg=np.degrees(pool.q_rad[k]),
                q_rad=pool.q_rad[k],
                load_N=float(pool.load_N[k]),
                arrive_from=-pool.arrival[k],
                separation_nats=float(nats[order + 1, sought].min()),
                for_=tuple(
                    label_of(*rivals[pair])
                    for pair in sought
                    if pair == closest or gained[pair] >= even_share[pair]
                ),
            )
        )
    return tuple(suggestions)


# Configurations that could be measured next: what is foreseen there.


def foresee(problem: Problem, found: Fit, q_rad: Array, load_N: Array, arrival: Array) -> Problem:
    """Return the problem as it would be of other configurations, measured at the end.

    The poses are those that the fit predicts; each is read as often as the campaign's were.

    Args:
        problem: the campaign.
        found: a fit to it.
        q_rad: (N, n) joint angles.
        load_N: (N,) loads.
        arrival: (N, n) directions of arrival.

    Raises:
        DiscoveryError: when torques were logged but the weights that make them are not known.
    """
    baseline, setup, measured = problem.baseline, problem.setup, problem.readings.states
    if setup.payload is None and np.all(np.isfinite(measured.tau_Nm)):
        raise DiscoveryError(
            "torques cannot be predicted in configurations that were not measured",
            where=baseline.model.chain.arm.name,
            allowed="an arm and a tool whose masses are known",
            remedy="complete the descriptions of arm and tool",
        )
    count, last = len(q_rad), int(np.argmax(measured.time_s))
    states = PoseStates(
        q_rad=q_rad,
        tau_Nm=np.full(q_rad.shape, np.nan if setup.payload is None else 0.0),
        arrival=arrival,
        load_N=load_N,
        temperature_C=np.full(count, measured.temperature_C[last]),
        time_s=np.full(count, measured.time_s[last]),
    )
    if setup.payload is not None:
        nominal = statics_of(Model(baseline.model.chain, ()), np.zeros(0), states, setup.payload)
        states = replace(states, static_loads=nominal.static_loads)
    repeats = round(len(problem.readings) / (1 + int(same_circumstances(problem.readings).max())))
    T_instr_ee = baseline.T_instr_base @ baseline.model.predict(states, baseline.x)
    poses = Observations(
        pose=np.array([f"next {k}" for k in range(count)]),
        states=states,
        measured=problem.readings.measured.ideal(T_instr_ee, baseline.targets_m),
        kind=np.full(count, "grid"),
        repeat=np.ones(count, dtype=np.int64),
        readings=np.full(count, repeats),
    )
    poses = _on_apparatus(poses, T_instr_ee, problem)
    states = complete(poses, baseline, setup).states
    if states.static_loads is not None:
        tau_Nm = states.static_loads.joint_Nm
        if problem.torques_logged:
            tau_Nm = tau_Nm + found.model.torque_Nm(states, found.at.x)
        states = replace(states, tau_Nm=tau_Nm)
    T_instr_ee = found.at.T_instr_base @ found.model.predict(states, found.at.x)
    ideal = problem.readings.measured.ideal(T_instr_ee, found.at.targets_m)
    poses = _on_apparatus(replace(poses, states=states, measured=ideal), T_instr_ee, problem)
    return _weighed(problem, poses, _reading_cov(poses, T_instr_ee, problem) / repeats)


def _weighed(problem: Problem, poses: Observations, cov: Array) -> Problem:
    """Return the problem of other poses, whose means have given covariances."""
    torque_u_Nm = None if problem.torque is None else problem.noise.torque_Nm
    pose, torque, _ = noise_models(
        poses,
        cov,
        problem.baseline,
        problem.setup,
        torque_u_Nm,
        problem.cells.states.load_N,
        problem.in_time,
    )
    return replace(
        problem,
        readings=poses,
        cells=poses,
        cell_cov=cov,
        pose=pose,
        torque=torque,
        torque_left_Nm=np.zeros_like(poses.states.tau_Nm),
    )


def _on_apparatus(poses: Observations, T_instr_ee: Array, problem: Problem) -> Observations:
    """Return poses with what places of stated targets do to them.

    That is about the same along the end's own axes everywhere: the mean of the readings.
    """
    measured = problem.readings.measured
    if not measured.by_stated_targets.shape[2]:
        return poses
    turn = measured.axes_of_end(_ends(problem))
    own = np.mean(turn.transpose(0, 2, 1) @ measured.by_stated_targets, axis=0)
    return poses.with_measured(by_apparatus=poses.measured.axes_of_end(T_instr_ee) @ own)


def _reading_cov(poses: Observations, T_instr_ee: Array, problem: Problem) -> Array:
    """Return the covariance of one reading of poses, (P, b, b), from its sources."""
    readings, noise, measured = problem.readings, problem.noise, problem.readings.measured
    at, by_joint = problem.baseline, noise.joint_rad**2
    of_joints = _spread(by_every_joint(at, readings), by_joint)
    stated = noise.instrument**2 * measured.stated_covariance
    # Noise of neither joints nor instrument is equal in all poses and directions.
    rest = np.mean(np.diagonal(noise.cov - of_joints - stated, axis1=1, axis2=2), axis=0)
    for _, columns in measured.component_kinds:
        rest[columns] = np.maximum(rest[columns].mean(), 0.0)
    turn = measured.axes_of_end(_ends(problem))
    own = np.mean(turn.transpose(0, 2, 1) @ stated @ turn, axis=0)
    turn = poses.measured.axes_of_end(T_instr_ee)
    of_instrument: Array = turn @ own @ turn.transpose(0, 2, 1)
    total: Array = _spread(by_every_joint(at, poses), by_joint) + of_instrument + np.diag(rest)
    return total


def _ends(problem: Problem) -> Array:
    """Return where the baseline has the end in the readings, (P, 4, 4)."""
    at = problem.baseline
    T: Array = at.T_instr_base @ at.model.predict(problem.readings.states, at.x)
    return T


def _spread(screws: Array, variance: Array) -> Array:
    """Return what variances (n,) of the joints make of components, (P, b, b)."""
    spread: Array = (screws * variance) @ screws.transpose(0, 2, 1)
    return spread


# Configurations that would show joint angles which no pose of the fit has seen.

_DRAWN = 2000
_TURN = 2.0 * np.pi


def fill(
    measured: Measured, seen: AnglesSeen, count: int, random_seed: int = 0, room: Room | None = None
) -> tuple[SuggestedPose, ...]:
    """Choose configurations that take joints to angles not seen, the most of them first.

    Out of a pool drawn at random, within limits and near the measured places. An angle once chosen
    counts as seen, so that each configuration after the first goes elsewhere.

    Args:
        measured: the campaign.
        seen: angles that its poses have seen.
        count: configurations wanted at most.
        random_seed: draws the pool.
        room: where arm and tool may go; where None, the usual one, and wherever they were measured.

    Returns:
        The configurations; none where all angles within reach were seen, or none is admissible.
    """
    if not count or all(_everywhere(seen, joint) for joint in range(len(seen.turns))):
        return ()
    rng = np.random.default_rng(random_seed)
    try:
        q_rad = draw_admissible(measured, _DRAWN, room or _room(measured), rng)
    except DiscoveryError:
        return ()
    turns = np.array(seen.turns)
    new = ~seen.each(q_rad) & turns
    place = np.floor(np.mod(q_rad, _TURN) / (2.0 * WITHIN_RAD)).astype(np.intp)
    load_N = float(measured.cells.states.load_N.min())
    chosen = []
    for _ in range(count):
        gains = new.sum(axis=1)
        best = int(np.argmax(gains))
        if not gains[best]:
            break
        joints = np.flatnonzero(new[best])
        purposes = tuple(f"angle of joint {joint + 1} not seen" for joint in joints)
        q_deg = np.degrees(q_rad[best])
        chosen.append(SuggestedPose(q_deg=q_deg, q_rad=q_rad[best], load_N=load_N, for_=purposes))
        new[:, joints] &= place[:, joints] != place[best, joints]
    return tuple(chosen)


def _room(measured: Measured) -> Room:
    """Return the usual room, and as low and as near to the column as poses were measured."""
    T_instr_base, usual = measured.baseline.T_instr_base, Room()
    p_base_m = (measured_ends_m(measured) - T_instr_base[:3, 3]) @ T_instr_base[:3, :3]
    return Room(
        floor_m=min(usual.floor_m, float(p_base_m[:, 2].min())),
        column_m=min(usual.column_m, float(np.hypot(*p_base_m[:, :2].T).min())),
    )


def _everywhere(seen: AnglesSeen, joint: int) -> bool:
    """Return whether a revolute joint has seen its whole turn; prismatic ones do not count."""
    if not seen.turns[joint]:
        return True
    stretches = seen.intervals[joint]
    return len(stretches) == 1 and bool(np.ptp(stretches[0]) >= _TURN)
