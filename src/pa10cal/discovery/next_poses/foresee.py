"""Configurations that could be measured next: what is foreseen there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pa10cal.arm.state import PoseStates
from pa10cal.arrays import Array
from pa10cal.discovery.evidence.fit import Fit
from pa10cal.discovery.evidence.problem import Problem, noise_models
from pa10cal.discovery.linear import by_every_joint
from pa10cal.discovery.noise import same_circumstances
from pa10cal.discovery.preparation import complete
from pa10cal.errors import DiscoveryError
from pa10cal.fit.loads import statics_of
from pa10cal.observe.observations import Observations
from pa10cal.terms.model import Model


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
