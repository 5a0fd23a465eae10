"""A campaign made ready for the search: cells, what they carry, and how their rows are weighed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import end_pose_with_screws
from pa10cal.arm.statics import Payload, Statics
from pa10cal.discovery.evidence.cells import gather, shared_error
from pa10cal.discovery.evidence.noise_model import NoiseModel
from pa10cal.discovery.linear import by_end
from pa10cal.discovery.noise import Noise, noise_of_repeats
from pa10cal.discovery.options import DiscoveryOptions
from pa10cal.discovery.preparation import (
    MeasurementSetup,
    complete_about,
    context_of,
    static_loads,
)
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.effect import CandidateContext

Array = NDArray[np.float64]
MM = 1e-3


@dataclass(frozen=True)
class Problem:
    """Everything that the search weighs effects by.

    Attributes:
        baseline: the calibrated model.
        setup: what is known besides the poses.
        readings: single readings, with what they carry.
        cells: the same in cells.
        cell_cov: (C, b, b) covariance of each cell's mean by the noise of readings.
        noise: of single readings.
        pose: rows of the poses.
        torque: rows of the torques, None where they or the masses are not known.
        torque_left_Nm: (C, n) logged torques less those of all weights (zero where not known).
        context: where effects may sit.
        torques_logged: whether the torques are those of a log.
    """

    baseline: FittedModel
    setup: MeasurementSetup
    readings: Observations
    cells: Observations
    cell_cov: Array
    noise: Noise
    pose: NoiseModel
    torque: NoiseModel | None
    torque_left_Nm: Array
    context: CandidateContext
    torques_logged: bool


def prepare(
    readings: Observations,
    baseline: FittedModel,
    setup: MeasurementSetup,
    about: FittedModel | None = None,
    *,
    torques_logged: bool = True,
) -> Problem:
    """Make a campaign ready.

    Args:
        readings: single readings, with the instrument's covariance.
        baseline: the calibrated model.
        setup: what is known besides the poses.
        about: a better model, about which noise and weights are computed; its effects may need
            what the readings carry. None for the baseline.
        torques_logged: whether the torques are those of a log, and not of described masses.

    Raises:
        DiscoveryError: when too little is repeated.
    """
    about = baseline if about is None else about
    readings = complete_about(readings, baseline, about, setup)
    noise = noise_of_repeats(readings, *_deviation_and_screws(readings, about))
    cells, cell_cov = gather(readings, noise.cov)
    cells = complete_about(cells, baseline, about, setup)
    shared = shared_error(cells)
    pose = NoiseModel.of(
        np.linalg.inv(np.linalg.cholesky(cell_cov)),
        shared,
        setup.apparatus_m * cells.measured.by_stated_targets,
    )
    torque, left = None, np.zeros_like(cells.states.tau_Nm)
    logged = torques_logged and bool(np.all(np.isfinite(cells.states.tau_Nm)))
    if setup.payload is not None and logged:
        weights = static_loads(cells.states, about, setup.payload)
        left = cells.states.tau_Nm - weights.torque_Nm
        scale = np.sqrt(cells.readings)[:, None] / noise.torque_Nm
        loads_N = np.unique(cells.states.load_N)
        common = common_torques(
            cells, weights, about, setup.payload, setup.options, loads_N[loads_N > 0]
        )
        torque = NoiseModel.of(
            scale[:, :, None] * np.eye(baseline.model.chain.arm.n), shared, common
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
        left,
        context_of(cells, baseline, setup),
        logged,
    )


def _deviation_and_screws(poses: Observations, at: FittedModel) -> tuple[Array, Array]:
    """Return measured minus predicted (P, b), and how that follows the joints, (P, b, n)."""
    chain = at.model.chain
    end = end_pose_with_screws(chain, at.model.chain_coordinates(poses.states, at.x))
    error = poses.measured.compare(at.T_instr_base @ end.T, at.targets_m).residual
    screws = by_end(at, poses, end.T) @ end.screws[:, :, chain.joint_columns]
    return -error, screws


def common_torques(
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
            zero,
        ],
        axis=2,
    )


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
