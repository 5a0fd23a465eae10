"""Problems of poses that were not measured, and of campaigns without repeats, to plan poses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.evidence.fit import EvidenceFit
from pa10cal.discovery.evidence.noise_model import SharedVariances
from pa10cal.discovery.evidence.problem import (
    EvidenceProblem,
    pose_noise_model,
    torque_noise_model,
)
from pa10cal.discovery.linear import ModelWithEffects, by_every_joint
from pa10cal.discovery.noise import Noise, same_circumstances, whitener_of
from pa10cal.discovery.nuisances import TimeFindings
from pa10cal.discovery.other_numbers import NEXT_POSES
from pa10cal.discovery.preparation import complete
from pa10cal.discovery.rules import EVIDENCE
from pa10cal.errors import DiscoveryError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import statics_of, with_torques
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations


def predicted(problem: EvidenceProblem, found: EvidenceFit, states: PoseStates) -> EvidenceProblem:
    """Return the problem of other poses, each with as many readings as a pose of the campaign.

    Readings are predicted by a fit to the campaign. The torques of the states are nan.

    Raises:
        DiscoveryError: when torques were logged but the weights that make them are not known.
    """
    baseline, setup, readings = problem.baseline, problem.setup, problem.readings
    if setup.payload is None and np.all(np.isfinite(readings.states.tau_Nm)):
        raise DiscoveryError(
            "torques cannot be predicted in configurations that were not measured",
            where=baseline.model.chain.arm.name,
            allowed="an arm and a tool whose masses are known",
            remedy="complete the descriptions of arm and tool",
        )
    repeats = round(len(readings) / (1 + int(same_circumstances(readings).max())))
    states, _ = with_torques(baseline.model, baseline.x, states, setup.payload)
    label = np.array([f"next {k}" for k in range(len(states))])
    poses = Observations.single(label, states, _as_seen(problem, baseline, states))
    poses = replace(poses, readings=np.full(len(states), repeats))
    states = complete(poses, baseline, setup).states
    if problem.torques_logged and states.static_loads is not None:
        tau_Nm = states.static_loads.joint_Nm + found.model.torque_Nm(states, found.at.x)
        states = replace(states, tau_Nm=tau_Nm)
    poses = replace(poses, states=states, measured=_as_seen(problem, found.at, states))
    cov = _reading_cov(problem, poses) / repeats
    torque = problem.torque
    if torque is not None and setup.payload is not None:
        weights = statics_of(baseline.model, baseline.x, states, setup.payload)
        u_Nm, loads_N = problem.noise.torque_Nm, problem.cells.states.load_N
        torque = torque_noise_model(poses, weights, baseline, setup, u_Nm, loads_N)
    return replace(
        problem,
        readings=poses,
        cells=poses,
        cell_cov=cov,
        pose=pose_noise_model(poses, cov, baseline, setup, problem.in_time),
        torque=torque,
        torque_without_weights_Nm=np.zeros_like(states.tau_Nm),
    )


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
    # A field of the instruments that have stated targets alone.
    stated: dict[str, Any] = {"by_apparatus": ideal.axes_of_end(T_instr_ee) @ along_end}
    return replace(ideal, **stated)


def _reading_cov(problem: EvidenceProblem, poses: Observations) -> Array:
    """Return the covariance (P, b, b) of one reading of poses from its sources."""
    readings, noise, at = problem.readings, problem.noise, problem.baseline
    measured = readings.measured

    def of_joints(some: Observations) -> Array:
        by_joint = by_every_joint(at, some)
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


def without_repeats(
    survey: Survey, found: ModelWithEffects, noise: Noise
) -> tuple[EvidenceProblem, EvidenceFit]:
    """Return a campaign without repeats as the problem of one with repeats, and a fit to it.

    The scatter beyond the noise of readings is the variance of the error that readings of a pose
    share. Of very many poses some are used.
    """
    count = len(survey.poses)
    rows = np.linspace(0, count - 1, min(count, NEXT_POSES.most_measured)).round().astype(np.intp)
    survey = replace(survey, poses=survey.poses.take(rows), block=survey.block[rows])
    poses = survey.poses
    joint_rad = noise.joint_rad if len(noise.joint_rad) else np.zeros(poses.states.n)
    noise = replace(noise, cov=noise.cov[rows], joint_rad=joint_rad)
    white = whitener_of(noise.cov) @ survey.net_residual(found.at)[:, :, None]
    scatter = float(np.sum(white**2) / poses.measured.components_seen.sum())
    in_time = TimeFindings(survey.wander, has_drift=False)
    cov = noise.cov * len(rows) / count
    setup = survey.setup
    problem = EvidenceProblem(
        baseline=survey.baseline,
        setup=setup,
        readings=poses,
        cells=poses,
        cell_cov=cov,
        noise=noise,
        pose=pose_noise_model(poses, cov, survey.baseline, setup, in_time),
        torque=None,
        torque_without_weights_Nm=np.zeros_like(poses.states.tau_Nm),
        context=survey.context,
        torques_logged=survey.torques_logged,
        in_time=in_time,
    )
    fit = EvidenceFit(
        effects=found.effects,
        at=found.at,
        converged=found.converged,
        sizes=(EVIDENCE.sizes.index(1.0),) * len(found.effects),
        variances=SharedVariances(max(scatter - 1.0, 0.0), 0.0),
    )
    return problem, fit
