"""Poses that were not measured, as a campaign of repeated poses would have them if they were.

A fit to the campaign predicts what the instrument would read there and the joints would log, with
the noise of the campaign. Nothing is drawn: readings are those of the fit itself.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.discovery.evidence.fit import EvidenceFit
from pa10cal.discovery.evidence.noise_model import NoiseModel
from pa10cal.discovery.evidence.problem import EvidenceProblem, pose_noise_model, torque_noise_model
from pa10cal.discovery.preparation import complete
from pa10cal.discovery.repeats import same_circumstances
from pa10cal.errors import DiscoveryError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.joint_noise import ideal_by_joints
from pa10cal.fit.loads import statics_of, with_torques
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.terms.term import yields


def as_if_measured(
    problem: EvidenceProblem, found: EvidenceFit, states: PoseStates
) -> EvidenceProblem:
    """Return the problem of other poses, each with as many readings as a pose of the campaign.

    Readings are predicted by a fit to the campaign. The torques of the states are nan.

    Raises:
        DiscoveryError: when torques were logged, or bend the model, but the weights that make them
            are not known.
    """
    _refuse_unknown_torques(problem, found)
    poses = _with_readings(problem, found, _with_torques(problem, found, states))
    cov = _reading_cov(problem, poses) / poses.readings[:, None, None]
    return replace(
        problem,
        readings=poses,
        cells=poses,
        cell_cov=cov,
        pose=pose_noise_model(poses, cov, problem.baseline, problem.setup, problem.in_time),
        torque=_torque_noise(problem, poses),
        # Derivatives alone separate effects: no data of these poses are needed.
        torque_without_weights_Nm=np.zeros_like(poses.states.tau_Nm),
    )


def _refuse_unknown_torques(problem: EvidenceProblem, found: EvidenceFit) -> None:
    logged = np.all(np.isfinite(problem.readings.states.tau_Nm))
    if problem.setup.payload is None and (logged or any(map(yields, found.model.terms))):
        raise DiscoveryError(
            "torques cannot be predicted in configurations that were not measured",
            where=problem.baseline.model.chain.arm.name,
            allowed="an arm and a tool whose masses are known",
            remedy="complete the descriptions of arm and tool",
        )


def _with_torques(problem: EvidenceProblem, found: EvidenceFit, states: PoseStates) -> Observations:
    """Return poses with the torques that a log would have, and with the baseline's readings."""
    baseline, setup = problem.baseline, problem.setup
    states, _ = with_torques(baseline.model, baseline.x, states, setup.payload)
    label = np.array([f"next {k}" for k in range(len(states))])
    poses = Observations.single(label, states, _as_seen(problem, baseline, states))
    poses = complete(poses, baseline, setup)
    loads = poses.states.static_loads
    if not problem.torques_logged or loads is None:
        return poses
    # A log holds what friction and effects do to torques, besides the weights.
    tau_Nm = loads.joint_Nm + found.model.torque_Nm(poses.states, found.at.x)
    return poses.with_states(replace(poses.states, tau_Nm=tau_Nm))


def _with_readings(
    problem: EvidenceProblem, found: EvidenceFit, poses: Observations
) -> Observations:
    """Return poses with the readings of what was found, which their torques bend, and their number.

    Each is read as often as a measured one is on average.
    """
    measured = problem.readings
    poses_measured = 1 + int(same_circumstances(measured).max())
    return replace(
        poses,
        measured=_as_seen(problem, found.at, poses.states),
        readings=np.full(len(poses), round(len(measured) / poses_measured)),
    )


def _torque_noise(problem: EvidenceProblem, poses: Observations) -> NoiseModel | None:
    """Return the noise model of the torques of poses; None where the campaign has none."""
    baseline, setup = problem.baseline, problem.setup
    if problem.torque is None or setup.payload is None:
        return None
    weights = statics_of(baseline.model, baseline.x, poses.states, setup.payload)
    u_Nm, loads_N = problem.noise.torque_Nm, problem.cells.states.load_N
    return torque_noise_model(poses, weights, baseline, setup, u_Nm, loads_N)


def _as_seen(problem: EvidenceProblem, at: FittedModel, states: PoseStates) -> Instrument:
    """Return the readings of a model by the instrument, without noise.

    The derivative by stated places of targets is nearly constant along the end's axes: its mean is
    used.
    """
    measured = problem.readings.measured
    T_instr_ee = at.T_instr_base @ at.model.predict(states, at.x)
    ideal = measured.ideal(T_instr_ee, at.targets_m)
    if not measured.by_stated_targets.shape[2]:
        return ideal
    to_end = _axes_of_end(at, problem.readings).transpose(0, 2, 1)
    along_end = np.mean(to_end @ measured.by_stated_targets, axis=0)
    return ideal.with_stated_targets(ideal.axes_of_end(T_instr_ee) @ along_end)


def _reading_cov(problem: EvidenceProblem, poses: Observations) -> Array:
    """Return the covariance (P, b, b) of one reading of poses from its sources."""
    readings, noise, at = problem.readings, problem.noise, problem.baseline
    measured = readings.measured

    def of_joints(some: Observations) -> Array:
        by_joint = ideal_by_joints(at, some)
        return np.asarray((by_joint * noise.joint_rad**2) @ by_joint.transpose(0, 2, 1))

    stated = noise.instrument**2 * measured.stated_covariance
    # Noise of neither joints nor instrument is equal in all poses and directions.
    other = noise.cov - of_joints(readings) - stated
    rest = np.mean(np.diagonal(other, axis1=1, axis2=2), axis=0)
    for _, columns in measured.component_kinds:
        rest[columns] = np.maximum(rest[columns].mean(), 0.0)
    before, axes = _axes_of_end(at, readings), _axes_of_end(at, poses)
    along_end = np.mean(before.transpose(0, 2, 1) @ stated @ before, axis=0)
    of_instrument = axes @ along_end @ axes.transpose(0, 2, 1)
    return np.asarray(of_joints(poses) + of_instrument + np.diag(rest))


def _axes_of_end(at: FittedModel, poses: Observations) -> Array:
    """Return the axes of the end by a model, in the components of poses, (P, b, b)."""
    T_instr_ee = at.T_instr_base @ at.model.predict(poses.states, at.x)
    return poses.measured.axes_of_end(T_instr_ee)
