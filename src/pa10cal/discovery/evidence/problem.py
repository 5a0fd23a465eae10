"""A campaign made ready for the search: cells, what they carry, and how their rows are weighed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from pa10cal.arm.statics import Payload, Statics
from pa10cal.arrays import Array
from pa10cal.discovery.in_time import STILL, InTime
from pa10cal.discovery.linear import by_every_joint, residual
from pa10cal.discovery.noise import (
    Noise,
    mean_covariance,
    noise_of_repeats,
    same_circumstances,
    whitener_of,
)
from pa10cal.discovery.preparation import MeasurementSetup, complete_about, context_of
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import statics_of
from pa10cal.fit.uncertain_weights import unknown_tool
from pa10cal.observe.observations import Observations, average_groups
from pa10cal.options import DiscoveryOptions
from pa10cal.terms.effects.effect import CandidateContext
from pa10cal.terms.model import Kept

# Readings gathered into cells: one pose, one load, one direction of arrival, one stretch of time.
#
# A cell averages what does not differ; what may distinguish effects stays apart. The pose remains
# the unit of evidence: cells of a pose share whatever is wrong there, and `SharedByCells` is the
# covariance of an error of unknown cause that they share.

#: Readings a cell at most: a drift shows between the cells of a longer row of repeats.
READINGS_A_CELL = 4


def gather(
    readings: Observations, cov: Array, most: int = READINGS_A_CELL
) -> tuple[Observations, Array]:
    """Average readings into C cells, ordered by pose, load, direction and time.

    With the covariances (C, b, b) of their means, from those (P, b, b) of readings.
    """
    circumstances = same_circumstances(readings)
    order = np.lexsort((readings.states.time_s, circumstances))
    sizes = np.bincount(circumstances)
    stretch = np.empty(len(order), dtype=np.intp)
    for rows in np.split(order, np.cumsum(sizes)[:-1]):
        blocks = -(-len(rows) // most)
        stretch[rows] = np.arange(len(rows)) * blocks // len(rows)
    code = circumstances * (stretch.max() + 1) + stretch
    code = np.unique(code, return_inverse=True)[1]
    seen = readings.measured.components_seen
    return average_groups(readings, code), mean_covariance(cov, seen, code)


@dataclass(frozen=True)
class SharedByCells:
    """Errors that the cells of a pose share, in whitened rows.

    A pose may be off, and differently with load, with direction, and in the course of time. In
    `turn`ed rows that covariance is diagonal: 1 + variance * `size`.
    """

    turn: Array  # (C, C) orthogonal, block by block of the cells of a pose
    # (C,) variance of each turned row a unit variance of the shared error, the unit being the
    # variance of one reading
    size: Array


def shared_error(cells: Observations) -> SharedByCells:
    """Lay out the errors that C cells share, their rows whitened by each one's own noise."""
    count, states = len(cells), cells.states
    turn, size = np.zeros((count, count)), np.zeros(count)
    for pose in np.unique(cells.pose):
        rows = np.flatnonzero(cells.pose == pose)
        # An error of the pose may go with load, time and direction, each of unit size. One number a
        # cell separates directions of arrival: along the main contrast.
        arrival = states.arrival[rows] - states.arrival[rows].mean(axis=0)
        direction = arrival @ np.linalg.svd(arrival, full_matrices=False)[2][0]
        columns = [np.ones(len(rows))]
        for values in (states.load_N[rows], states.time_s[rows], direction):
            centred = values - values.mean()
            largest = float(np.abs(centred).max())
            if largest > 0:
                columns.append(centred / largest)
        # Whitening by the covariance of a mean of k readings makes a shared error sqrt(k) larger.
        shapes = np.column_stack(columns) * np.sqrt(cells.readings[rows])[:, None]
        values, vectors = np.linalg.eigh(shapes @ shapes.T)
        turn[np.ix_(rows, rows)] = vectors.T
        size[rows] = np.maximum(values, 0.0)
    return SharedByCells(turn, size)


# One kind of measured rows, poses or torques, and the covariance by which they are weighed.
#
# Three kinds of error add up: the noise of readings, independent from cell to cell; an error of
# unknown cause that the cells of a pose share (`SharedByCells`), of a variance found from the
# data; and errors common to all poses (places of balls on the apparatus, masses, loads), whose
# standard uncertainties are known.


@dataclass(frozen=True)
class NoiseModel:
    """Rows of C cells with b components each."""

    whitener: Array  # (C, b, b) makes the noise of each cell's mean independent and of unit size
    shared: SharedByCells  # errors that the cells of a pose share
    common: Array  # (C b, c) whitened rows of errors common to all poses, each of unit size
    _whitenings: dict[float, Whitening] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, whitener: Array, shared: SharedByCells, common: Array) -> NoiseModel:
        """Lay out a channel: whitener (C, b, b), common errors (C, b, c) at their uncertainty."""
        bare = cls(whitener, shared, np.zeros((whitener.shape[0] * whitener.shape[1], 0)))
        return cls(whitener, shared, bare.rows(common))

    @property
    def shared_size(self) -> Array:
        """(R,) variance of each row a unit variance of the shared error."""
        return np.repeat(self.shared.size, self.whitener.shape[1])

    def rows(self, values: Array) -> Array:
        """Return whitened, turned rows (C b, k) of values (C, b, k)."""
        white = self.whitener @ values
        count, b, k = white.shape
        turned: Array = self._turn @ white.reshape(count, b * k)
        return turned.reshape(count * b, k)

    def weighed(self, values: Array, variance: float) -> Array:
        """Return independent rows of unit variance (C b, k) of values (C, b, k)."""
        return self.whitening(variance)(self.rows(values))

    def common_amounts(self, rows: Array, variance: float) -> Array:
        """Return the most likely amounts (c, k) of the common errors in whitened rows (R, k).

        The error that each pose shares, of a variance, keeps them from taking what a model lacks.
        """
        weight = 1.0 / (1.0 + variance * self.shared_size)[:, None]
        normal = self.common.T @ (weight * self.common) + np.eye(self.common.shape[1])
        found: Array = cho_solve(cho_factor(normal), self.common.T @ (weight * rows))
        return found

    @cached_property
    def _turn(self) -> csr_array:
        """Return the turn without its zeros: few cells belong to one pose."""
        return csr_array(self.shared.turn)

    def whitening(self, variance: float) -> Whitening:
        """Return the weights for a variance of the shared error, in those of one reading."""
        if variance not in self._whitenings:
            scale = 1.0 / np.sqrt(1.0 + variance * self.shared_size)
            self._whitenings[variance] = Whitening.of(scale, self.common)
        return self._whitenings[variance]


@dataclass(frozen=True)
class Whitening:
    """What makes rows of a channel independent and of unit variance."""

    scale: Array  # (R,) by which each row is scaled
    directions: Array  # (R, c) orthonormal directions of the common errors in scaled rows
    shrink: Array  # (c,) part by which rows shrink along them

    @classmethod
    def of(cls, scale: Array, common: Array) -> Whitening:
        """Return it for rows scaled (R,) and common errors of unit size (R, c)."""
        left, sizes, _ = np.linalg.svd(scale[:, None] * common, full_matrices=False)
        return cls(scale, left, 1.0 - 1.0 / np.sqrt(1.0 + sizes**2))

    def __call__(self, rows: Array) -> Array:
        """Weigh rows (R, k)."""
        scaled = self.scale[:, None] * rows
        weighed: Array = scaled - self.directions @ (
            self.shrink[:, None] * (self.directions.T @ scaled)
        )
        return weighed


MM = 1e-3


@dataclass(frozen=True)
class EvidenceProblem:
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
) -> EvidenceProblem:
    """Make a campaign ready, by single readings with the instrument's covariance.

    Noise and weights are computed about the baseline, or a better model, whose effects may need
    what the readings carry. Motion of base or instrument in time is no noise, nor is by how much
    components moved besides (P, b), predicted less measured. Torques may be those of a log, and not
    of described masses.

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
    # Readings stay alone in their cells where time shows between them.
    few = np.bincount(same_circumstances(readings)).max() <= READINGS_A_CELL
    alone = in_time.wander is not None or (in_time.drifts and few)
    cells, cell_cov = gather(readings, noise.cov, 1 if alone else READINGS_A_CELL)
    cells = complete_about(cells, baseline, about, setup)
    # A log that never scatters was calculated, and tells nothing of the joints.
    scatters = bool(np.any(noise.torque_Nm > 0.0))
    logged = torques_logged and scatters and bool(np.all(np.isfinite(cells.states.tau_Nm)))
    torque_u_Nm, load_N = noise.torque_Nm if logged else None, cells.states.load_N
    pose, torque, of_weights_Nm = noise_models(
        cells, cell_cov, about, setup, torque_u_Nm, load_N, in_time
    )
    return EvidenceProblem(
        baseline=baseline,
        setup=setup,
        readings=readings,
        cells=cells,
        cell_cov=cell_cov,
        noise=noise,
        pose=pose,
        torque=torque,
        torque_left_Nm=np.zeros_like(of_weights_Nm)
        if torque is None
        else cells.states.tau_Nm - of_weights_Nm,
        context=context_of(cells, baseline, setup),
        torques_logged=logged,
        in_time=in_time,
    )


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

    Torques are None where these or the masses are not known. Cells are complete; the covariance of
    their means (C, b, b) is by the noise of readings. The noise of one reading's torques (n,) is
    None where they are not weighed. Each load of the campaign has an error of its own.
    """
    shared = shared_error(cells)
    common = setup.apparatus_m * cells.measured.by_stated_targets
    if in_time.wander is not None:
        common = np.concatenate([common, in_time.wander.columns(about, cells)], axis=2)
    pose = NoiseModel.of(whitener_of(cell_cov), shared, common)
    if setup.payload is None or torque_u_Nm is None:
        return pose, None, np.zeros_like(cells.states.q_rad)
    weights = statics_of(about.model, about.x, cells.states, setup.payload)
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
    # Load, apparatus and gravity are off by their standard uncertainties.
    point_m, com_m = MM * options.load_point_uncertainty_mm, MM * options.tool_com_uncertainty_mm
    level = MM * options.level_uncertainty_mrad * np.linalg.norm(payload.gravity_m_s2)
    moved = [
        replace(payload, load_point_m=payload.load_point_m + off) for off in point_m * np.eye(3)
    ]
    moved += [replace(payload, com_m=payload.com_m + off) for off in com_m * np.eye(3)]
    moved += [
        replace(payload, gravity_m_s2=payload.gravity_m_s2 + off) for off in level * np.eye(3)[:2]
    ]
    by_payload = [
        statics_of(baseline.model, baseline.x, cells.states, each).torque_Nm - weights.torque_Nm
        for each in moved
    ]
    of_tool = np.zeros((*weights.torque_Nm.shape, 0))
    if not payload.known:
        tool = unknown_tool(arm, payload)
        of_tool = weights.static_loads.by_weights[:, :, list(tool.columns)] * tool.sizes
    rated_Nm = arm.rated_Nm(np.abs(weights.torque_Nm).max(axis=0))
    zero = np.tile(np.diag(options.torque_zero_uncertainty * rated_Nm), (len(cells), 1, 1))
    return np.concatenate(
        [
            weights.torque_by_mass * by_link,
            options.load_uncertainty * weights.torque_by_load[:, :, None] * load_N[:, None, :],
            np.stack(by_payload, axis=2),
            of_tool,
            zero,
        ],
        axis=2,
    )
