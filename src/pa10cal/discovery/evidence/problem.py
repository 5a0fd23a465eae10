"""A campaign made ready for the search: cells, what they carry, and how their rows are weighed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload, Statics
from pa10cal.arrays import Array
from pa10cal.discovery.evidence.cells import READINGS_A_CELL, gather, shared_error
from pa10cal.discovery.evidence.noise_model import NoiseModel
from pa10cal.discovery.in_time.wander import STILL, InTime
from pa10cal.discovery.linear import by_every_joint, residual
from pa10cal.discovery.noise import Noise, noise_of_repeats, same_circumstances
from pa10cal.discovery.options import DiscoveryOptions
from pa10cal.discovery.preparation import MeasurementSetup, complete_about, context_of, static_loads
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.uncertain_weights import unknown_tool
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.effect import CandidateContext
from pa10cal.terms.kept import Kept

MM = 1e-3


@dataclass(frozen=True)
class Problem:
    """Everything that the search weighs effects by."""

    baseline: FittedModel  # the calibrated model
    setup: MeasurementSetup  # what is known besides the poses
    readings: Observations  # single readings, with what they carry
    cells: Observations  # the same in cells
    cell_cov: Array  # (C, b, b) covariance of each cell's mean by the noise of readings
    noise: Noise  # of single readings
    pose: NoiseModel  # rows of the poses
    torque: NoiseModel | None  # rows of the torques, None where they or the masses are not known
    torque_left_Nm: Array  # (C, n) logged torques less those of all weights (zero where not known)
    context: CandidateContext  # where effects may sit
    torques_logged: bool  # whether the torques are those of a log, and scatter
    in_time: InTime = STILL  # how base or instrument move in the course of time
    # what effects make of the cells, the same in all fits
    kept: Kept = field(default_factory=Kept, compare=False, repr=False)


def prepare(
    readings: Observations,
    baseline: FittedModel,
    setup: MeasurementSetup,
    about: FittedModel | None = None,
    *,
    torques_logged: bool = True,
    in_time: InTime = STILL,
    moved: Array | None = None,
) -> Problem:
    """Make a campaign ready.

    Args:
        readings: single readings, with the instrument's covariance.
        baseline: the calibrated model.
        setup: what is known besides the poses.
        about: a better model, about which noise and weights are computed; its effects may need
            what the readings carry. None for the baseline.
        torques_logged: whether the torques are those of a log, and not of described masses.
        in_time: how base or instrument move in the course of time, which is no noise.
        moved: (P, b) by how much components moved besides, predicted less measured, which is
            no noise either; None for nothing.

    Raises:
        DiscoveryError: when too little is repeated.
    """
    about = baseline if about is None else about
    readings = complete_about(readings, baseline, about, setup)
    left = -residual(about, readings)
    if in_time.wander is not None:
        left = left - in_time.wander.shift(baseline, readings)
    if moved is not None:
        left = left + moved
    noise = noise_of_repeats(readings, left, by_every_joint(about, readings))
    cells, cell_cov = gather(readings, noise.cov, _readings_a_cell(readings, in_time))
    cells = complete_about(cells, baseline, about, setup)
    # A log that never scatters was calculated, and tells nothing of the joints.
    scatters = bool(np.any(noise.torque_Nm > 0.0))
    logged = torques_logged and scatters and bool(np.all(np.isfinite(cells.states.tau_Nm)))
    pose, torque, of_weights_Nm = noise_models(
        cells,
        cell_cov,
        about,
        setup,
        noise.torque_Nm if logged else None,
        cells.states.load_N,
        in_time,
    )
    return Problem(
        baseline,
        setup,
        readings,
        cells,
        cell_cov,
        noise,
        pose,
        torque,
        np.zeros_like(of_weights_Nm) if torque is None else cells.states.tau_Nm - of_weights_Nm,
        context_of(cells, baseline, setup),
        logged,
        in_time,
    )


def _readings_a_cell(readings: Observations, in_time: InTime) -> int:
    """Return how many readings a cell may average: one alone, where time shows between them."""
    few = np.bincount(same_circumstances(readings)).max() <= READINGS_A_CELL
    alone = in_time.wander is not None or (in_time.drifts and few)
    return 1 if alone else READINGS_A_CELL


def noise_models(
    cells: Observations,
    cell_cov: Array,
    about: FittedModel,
    setup: MeasurementSetup,
    torque_u_Nm: Array | None,
    load_N: Array,
    in_time: InTime = STILL,
) -> tuple[NoiseModel, NoiseModel | None, Array]:
    """Return how rows of poses and of torques are weighed, and the torques of all weights (C, n).

    Args:
        cells: C cells, with what they carry.
        cell_cov: (C, b, b) covariance of their means by the noise of readings.
        about: a model of the arm.
        setup: what is known besides the poses.
        torque_u_Nm: (n,) noise of one reading's torques; None where they are not weighed.
        load_N: loads of the campaign, each of which has an error of its own.
        in_time: how base or instrument move in the course of time.

    Returns:
        The two, that of torques None where these or the masses are not known.
    """
    shared = shared_error(cells)
    common = setup.apparatus_m * cells.measured.by_stated_targets
    if in_time.wander is not None:
        common = np.concatenate([common, in_time.wander.columns(about, cells)], axis=2)
    pose = NoiseModel.of(np.linalg.inv(np.linalg.cholesky(cell_cov)), shared, common)
    if setup.payload is None or torque_u_Nm is None:
        return pose, None, np.zeros_like(cells.states.q_rad)
    weights = static_loads(cells.states, about, setup.payload)
    scale = np.sqrt(cells.readings)[:, None] / torque_u_Nm
    common = _common_torques(
        cells, weights, about, setup.payload, setup.options, np.unique(load_N[load_N > 0])
    )
    torque = NoiseModel.of(scale[:, :, None] * np.eye(cells.states.n), shared, common)
    return pose, torque, weights.torque_Nm


def _common_torques(
    cells: Observations,
    weights: Statics,
    baseline: FittedModel,
    payload: Payload,
    options: DiscoveryOptions,
    loads_N: Array,
) -> Array:
    """Return what errors of masses, loads and zeros do to the torques, (C, n, c), at their size.

    Each of the loads `loads_N` has an error of its own.
    """
    arm = baseline.model.chain.arm
    mass_kg = np.zeros(arm.n) if arm.mass_kg is None else arm.mass_kg
    by_link = np.stack(
        [options.mass_uncertainty * mass_kg, *[MM * options.com_uncertainty_mm * mass_kg] * 3],
        axis=1,
    ).ravel()
    load_N = cells.states.load_N[:, None] * (cells.states.load_N[:, None] == loads_N)
    by_payload = [
        static_loads(cells.states, baseline, moved).torque_Nm - weights.torque_Nm
        for moved in _misplaced(payload, options)
    ]
    rated_Nm = arm.rated_Nm(np.abs(weights.torque_Nm).max(axis=0))
    zero = np.tile(np.diag(options.torque_zero_uncertainty * rated_Nm), (len(cells), 1, 1))
    return np.concatenate(
        [
            weights.torque_by_mass * by_link,
            options.load_uncertainty * weights.torque_by_load[:, :, None] * load_N[:, None, :],
            np.stack(by_payload, axis=2),
            _unknown_tool(arm, payload, weights),
            zero,
        ],
        axis=2,
    )


def _unknown_tool(arm: Arm, payload: Payload, weights: Statics) -> Array:
    """Return what a tool of unknown mass does to the torques, (C, n, 4); none of one known."""
    if payload.known:
        return np.zeros((*weights.torque_Nm.shape, 0))
    tool = unknown_tool(arm, payload)
    return weights.static_loads.by_weights[:, :, list(tool.columns)] * tool.sizes


def _misplaced(payload: Payload, options: DiscoveryOptions) -> list[Payload]:
    """Return the payload with load, apparatus and gravity off by their standard uncertainties."""
    g = payload.gravity_m_s2
    level = MM * options.level_uncertainty_mrad * np.linalg.norm(g)
    return [
        *(
            replace(
                payload,
                load_point_m=payload.load_point_m + MM * options.load_point_uncertainty_mm * axis,
            )
            for axis in np.eye(3)
        ),
        *(
            replace(payload, com_m=payload.com_m + MM * options.tool_com_uncertainty_mm * axis)
            for axis in np.eye(3)
        ),
        *(replace(payload, gravity_m_s2=g + level * axis) for axis in np.eye(3)[:2]),
    ]
