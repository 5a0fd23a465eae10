"""A campaign of repeated poses prepared for the search by evidence."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from pa10cal.arm.statics import Payload, StaticLoads
from pa10cal.arrays import Array
from pa10cal.discovery.evidence.noise_model import NoiseModel, average_into_cells, shared_error
from pa10cal.discovery.noise import Noise
from pa10cal.discovery.nuisances import NO_MOTION, TimeFindings
from pa10cal.discovery.preparation import MeasurementSetup, complete, context_of
from pa10cal.discovery.repeats import noise_of_repeats, same_circumstances
from pa10cal.discovery.rules import EVIDENCE
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.joint_noise import ideal_by_joints
from pa10cal.fit.loads import statics_of
from pa10cal.fit.uncertain_weights import unknown_tool
from pa10cal.fit.weighed_arm import weighed_model
from pa10cal.numerics.covariances import whitener_of
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import MM
from pa10cal.options import DiscoveryOptions
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.joint import TorqueGain
from pa10cal.terms.model import DerivativeCache


@dataclass(frozen=True)
class EvidenceProblem:
    """A campaign prepared for the search: cells, noise models, and what is known besides."""

    calibrated: FittedModel  # the calibrated model
    # the same, with the weights that the log has less its errors (`_weighed_without_errors`)
    baseline: FittedModel
    setup: MeasurementSetup  # what is known besides the poses
    readings: Observations  # single readings, with their static loads
    cells: Observations  # the same averaged into cells
    cell_cov: Array  # (C, b, b) covariance of each cell's mean by the noise of readings
    noise: Noise  # of single readings
    pose: NoiseModel  # of the rows of poses
    torque: NoiseModel | None  # of the rows of torques; None where these or masses are not known
    # (C, n) logged torques less those of all weights; zero where not known
    torque_without_weights_Nm: Array
    context: CandidateContext  # where effects may sit
    torques_logged: bool  # whether torques were logged, and scatter
    in_time: TimeFindings = NO_MOTION  # motion of base or instrument in the course of time
    poses_a_cell: float = 1.0  # poses that each measured one stands for, as one of very many
    # cache of the derivatives of effects at the cells, the same in all fits
    derivative_cache: DerivativeCache = field(
        default_factory=DerivativeCache, compare=False, repr=False
    )


def prepare(
    readings: Observations,
    calibrated: FittedModel,
    setup: MeasurementSetup,
    about: FittedModel | None = None,
    *,
    torques_logged: bool = True,
    in_time: TimeFindings = NO_MOTION,
    moved_between_repeats: Array | None = None,
) -> EvidenceProblem:
    """Prepare a campaign by its single readings.

    Args:
        readings: single readings, with the instrument's covariance.
        calibrated: the calibrated model.
        setup: what is known besides the poses.
        about: model about which residuals, noise and weights are computed; None for the calibrated.
        torques_logged: whether torques were logged; else they are those of described masses.
        in_time: motion of base or instrument, subtracted before the noise is estimated.
        moved_between_repeats: (P, b) motion in the components, predicted less measured, subtracted
            too. None for none.

    Raises:
        DiscoveryError: when too little is repeated.
    """
    about, baseline = calibrated if about is None else about, calibrated
    if any(term.id == TorqueGain.id for term in about.model.terms):
        baseline = _weighed_without_errors(calibrated, about, complete(readings, calibrated, setup))
        about = replace(about, model=replace(about.model, chain=baseline.model.chain))
    readings = complete(readings, baseline, setup, about)
    deviation = -about.compared(readings).residual
    if in_time.wander is not None:
        deviation = deviation - in_time.wander.shift(baseline, readings)
    if moved_between_repeats is not None:
        deviation = deviation + moved_between_repeats
    noise = noise_of_repeats(readings, deviation, ideal_by_joints(about, readings))
    cells, cell_cov = average_into_cells(readings, noise.cov, _most_in_a_cell(readings, in_time))
    cells = complete(cells, baseline, setup, about)
    pose = pose_noise_model(cells, cell_cov, about, setup, in_time)
    # A log that never scatters was calculated and has no information about the joints.
    scatters = bool(np.any(noise.torque_Nm > 0.0))
    logged = torques_logged and scatters and bool(np.all(np.isfinite(cells.states.tau_Nm)))
    torque: NoiseModel | None = None
    without_weights_Nm = np.zeros_like(cells.states.q_rad)
    if logged and setup.payload is not None:
        weights = statics_of(about.model, about.x, cells.states, setup.payload)
        loads_N = cells.states.load_N
        torque = torque_noise_model(cells, weights, about, setup, noise.torque_Nm, loads_N)
        without_weights_Nm = cells.states.tau_Nm - weights.joint_Nm
    return EvidenceProblem(
        calibrated=calibrated,
        baseline=baseline,
        setup=setup,
        readings=readings,
        cells=cells,
        cell_cov=cell_cov,
        noise=noise,
        pose=pose,
        torque=torque,
        torque_without_weights_Nm=without_weights_Nm,
        context=context_of(cells, baseline, setup),
        torques_logged=logged,
        in_time=in_time,
    )


def _weighed_without_errors(
    calibrated: FittedModel, about: FittedModel, readings: Observations
) -> FittedModel:
    """Return the calibrated model with the weights of the log less its errors by a model `about`.

    Weights by the log are in its scale, as the springs of the calibrated model. With a wrong scale
    of a torque as an effect the springs are in the true scale: under weights of the log as it is
    they would sag too far, and the error itself would be that part of wrong torques. Friction is
    not in these weights: they were fitted beside it.
    """
    without = about.model.with_joint_torques(readings.states, about.x)
    return weighed_model(calibrated, readings.with_states(without))


def _most_in_a_cell(readings: Observations, in_time: TimeFindings) -> int:
    """Return how many readings a cell has at most: one where the next may differ in time."""
    few = np.bincount(same_circumstances(readings)).max() <= EVIDENCE.readings_a_cell
    alone = in_time.wander is not None or (in_time.has_drift and few)
    return 1 if alone else EVIDENCE.readings_a_cell


def pose_noise_model(
    cells: Observations,
    cell_cov: Array,
    about: FittedModel,
    setup: MeasurementSetup,
    in_time: TimeFindings = NO_MOTION,
) -> NoiseModel:
    """Return the noise model of the poses of cells.

    Common to all poses are the places of targets on the apparatus, and motion in time.

    Args:
        cells: averaged readings.
        cell_cov: (C, b, b) covariance of each cell's mean by the noise of readings.
        about: model about which motions are computed.
        setup: what is known besides the poses.
        in_time: motion of base or instrument.
    """
    common = setup.apparatus_m * cells.measured.by_stated_targets
    if in_time.wander is not None:
        common = np.concatenate([common, in_time.wander.columns(about, cells)], axis=2)
    return NoiseModel.of(
        whitener_of(cell_cov), shared_error(cells, cells.measured.components_seen), common
    )


def torque_noise_model(
    cells: Observations,
    weights: StaticLoads,
    about: FittedModel,
    setup: MeasurementSetup,
    torque_u_Nm: Array,
    load_N: Array,
) -> NoiseModel:
    """Return the noise model of the torques of cells.

    Common to all poses are errors of masses, centres of mass, loads, and zeros of torques.

    Args:
        cells: averaged readings, complete with their static loads.
        weights: torques of all weights in them, and derivatives of these.
        about: model about which the weights are computed.
        setup: what is known besides the poses, the payload too.
        torque_u_Nm: (n,) standard deviation of a reading's torques.
        load_N: loads of the campaign, of which each one has an error of its own.
    """
    assert setup.payload is not None
    loads_N = np.unique(load_N[load_N > 0])
    common = _common_torques(cells, weights, about, setup.payload, setup.options, loads_N)
    per_Nm = np.sqrt(cells.readings)[:, None] / torque_u_Nm
    whitener = per_Nm[:, :, None] * np.eye(cells.states.n)
    logged = np.ones(cells.states.tau_Nm.shape, dtype=bool)
    return NoiseModel.of(whitener, shared_error(cells, logged), common)


def _common_torques(
    cells: Observations,
    weights: StaticLoads,
    baseline: FittedModel,
    payload: Payload,
    options: DiscoveryOptions,
    loads_N: Array,
) -> Array:
    """Return the torques (C, n, c) of one standard uncertainty of each error common to all poses.

    Of masses and centres of mass, of each of the loads `loads_N`, of the payload, and of zeros.
    """
    arm = baseline.model.chain.arm
    mass_kg = np.zeros(arm.n) if arm.mass_kg is None else arm.mass_kg
    by_link = np.stack(
        [options.mass_uncertainty * mass_kg, *[MM * options.com_uncertainty_mm * mass_kg] * 3],
        axis=1,
    ).ravel()
    load_N = cells.states.load_N[:, None] * (cells.states.load_N[:, None] == loads_N)
    point_m, com_m = MM * options.load_point_uncertainty_mm, MM * options.tool_com_uncertainty_mm
    level = MM * options.level_uncertainty_mrad * np.linalg.norm(payload.gravity_m_s2)
    shifted = [
        *(replace(payload, load_point_m=payload.load_point_m + off) for off in point_m * np.eye(3)),
        *(replace(payload, com_m=payload.com_m + off) for off in com_m * np.eye(3)),
        *(
            replace(payload, gravity_m_s2=payload.gravity_m_s2 + off)
            for off in level * np.eye(3)[:2]
        ),
    ]
    by_payload = [
        statics_of(baseline.model, baseline.x, cells.states, each).joint_Nm - weights.joint_Nm
        for each in shifted
    ]
    of_tool = np.zeros((*weights.joint_Nm.shape, 0))
    for tool in unknown_tool(arm, payload):
        of_tool = weights.by_weights[:, :, list(tool.columns)] * tool.sizes
    rated_Nm = arm.rated_Nm(np.abs(weights.joint_Nm).max(axis=0))
    zero = np.tile(np.diag(options.torque_zero_uncertainty * rated_Nm), (len(cells), 1, 1))
    return np.concatenate(
        [
            weights.by_masses() * by_link,
            options.load_uncertainty * weights.by_load[:, :, None] * load_N[:, None, :],
            np.stack(by_payload, axis=2),
            of_tool,
            zero,
        ],
        axis=2,
    )
