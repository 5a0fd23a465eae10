"""A campaign made ready for the search: cells, what they carry, and how their rows are weighed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from pa10cal.arm.statics import Payload, Statics
from pa10cal.arrays import Array
from pa10cal.discovery.linear import (
    ModelWithEffects,
    at_unknowns,
    by_every_joint,
    held_of_base,
    residual,
    residual_and_jacobian,
    residual_then_jacobian,
    unknowns,
    with_base_term,
)
from pa10cal.discovery.noise import (
    Noise,
    mean_covariance,
    noise_of_repeats,
    same_circumstances,
    whitener_of,
)
from pa10cal.discovery.other_numbers import COMPUTING
from pa10cal.discovery.preparation import MeasurementSetup, complete_about, context_of
from pa10cal.discovery.rules import EVIDENCE
from pa10cal.discovery.wander import NO_MOTION, TimeFindings
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import statics_of
from pa10cal.fit.problem import possible_sizes
from pa10cal.fit.weighed_arm import unknown_tool
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.numerics.least_squares import Bounds, Equations, minimise
from pa10cal.observe.observations import Observations, average_groups
from pa10cal.observe.quantities import MM
from pa10cal.options import DiscoveryOptions
from pa10cal.terms.effects.effect import CandidateContext, Effect
from pa10cal.terms.model import Kept
from pa10cal.terms.term import shows_torque

# Readings gathered into cells: one pose, one load, one direction of arrival, one stretch of time.
#
# A cell averages what does not differ; what may distinguish effects stays apart. The pose remains
# the unit of evidence: cells of a pose share whatever is wrong there, and `SharedByCells` is the
# covariance of an error of unknown cause that they share.


def gather(
    readings: Observations, cov: Array, most: int = EVIDENCE.readings_a_cell
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
        said = Gaussian.of_products(self.common.T @ (weight * self.common))
        return said.taken_of(self.common.T @ (weight * rows))

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
        directions, sizes, _ = np.linalg.svd(scale[:, None] * common, full_matrices=False)
        return cls(scale, directions, 1.0 - 1.0 / np.sqrt(1.0 + sizes**2))

    def __call__(self, rows: Array) -> Array:
        """Weigh rows (R, k)."""
        scaled = self.scale[:, None] * rows
        weighed: Array = scaled - self.directions @ (
            self.shrink[:, None] * (self.directions.T @ scaled)
        )
        return weighed


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
    torque_without_weights_Nm: (
        Array  # (C, n) logged torques less those of all weights (zero where not known)
    )
    context: CandidateContext  # where effects may sit
    torques_logged: bool  # whether the torques are those of a log, and scatter
    in_time: TimeFindings = NO_MOTION  # how base or instrument move in the course of time
    # what effects make of the cells, the same in all fits
    kept: Kept = field(default_factory=Kept, compare=False, repr=False)


def prepare(
    readings: Observations,
    baseline: FittedModel,
    setup: MeasurementSetup,
    about: FittedModel | None = None,
    *,
    torques_logged: bool = True,
    in_time: TimeFindings = NO_MOTION,
    moved_between_repeats: Array | None = None,
) -> EvidenceProblem:
    """Make a campaign ready, by single readings with the instrument's covariance.

    Args:
        about: model about which residuals, noise and weights are computed; None for the baseline.
        torques_logged: whether torques are those of a log, and not of described masses.
        in_time: motion of base or instrument, which is no noise.
        moved_between_repeats: (P, b) of the components, predicted less measured: no noise
            either. None for nothing.

    Raises:
        DiscoveryError: when too little is repeated.
    """
    about = baseline if about is None else about
    readings = complete_about(readings, baseline, about, setup)
    left = -residual(about, readings)
    if in_time.wander is not None:
        left = left - in_time.wander.shift(baseline, readings)
    if moved_between_repeats is not None:
        left = left + moved_between_repeats
    noise = noise_of_repeats(readings, left, by_every_joint(about, readings))
    # Readings stay alone in their cells where time shows between them.
    few = np.bincount(same_circumstances(readings)).max() <= EVIDENCE.readings_a_cell
    alone = in_time.wander is not None or (in_time.has_drift and few)
    cells, cell_cov = gather(readings, noise.cov, 1 if alone else EVIDENCE.readings_a_cell)
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
        torque_without_weights_Nm=np.zeros_like(of_weights_Nm)
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
    in_time: TimeFindings = NO_MOTION,
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
    shifted_payloads = [
        replace(payload, load_point_m=payload.load_point_m + off) for off in point_m * np.eye(3)
    ]
    shifted_payloads += [replace(payload, com_m=payload.com_m + off) for off in com_m * np.eye(3)]
    shifted_payloads += [
        replace(payload, gravity_m_s2=payload.gravity_m_s2 + off) for off in level * np.eye(3)[:2]
    ]
    by_payload = [
        statics_of(baseline.model, baseline.x, cells.states, each).torque_Nm - weights.torque_Nm
        for each in shifted_payloads
    ]
    of_tool = np.zeros((*weights.torque_Nm.shape, 0))
    for tool in unknown_tool(arm, payload):
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


# The full non-linear fit of the model with some effects, weighed as the evidence weighs.


@dataclass(frozen=True, eq=False)
class EvidenceFit(ModelWithEffects):
    """The calibrated model with effects, fitted as the evidence weighs."""

    sizes: tuple[int, ...]  # index in the sizes tried of that expected of each effect
    # pose_variance and torque_variance: shared errors by which it was weighed
    pose_variance: float
    torque_variance: float

    @property
    def size_of(self) -> dict[Effect, int]:
        """Return the index of the size expected of each effect."""
        return dict(zip(self.effects, self.sizes, strict=True))

    @property
    def variances(self) -> tuple[float, float]:
        """Return both variances."""
        return self.pose_variance, self.torque_variance


def fit(
    problem: EvidenceProblem,
    effects: tuple[Effect, ...],
    sizes: tuple[int, ...],
    variances: tuple[float, float],
    start: EvidenceFit | None = None,
) -> EvidenceFit:
    """Fit the model with some effects; from several shapes where an effect has them, the best.

    Each effect has the index of the size expected of it; variances are those of the shared errors
    of poses and of torques. It sets out from another fit, or from the baseline.
    """
    baseline, first = problem.baseline, len(problem.baseline.x)
    model = replace(with_base_term(baseline, effects), kept=problem.kept)
    targets = problem.cells.measured.target_parameters[: len(baseline.targets_m)]
    bounds = Bounds.of((*model.parameters, *targets))
    own = np.concatenate([baseline.x, np.zeros(6), baseline.targets_m])
    known: dict[Effect, Array] = {}
    if start is not None:
        own, known = start.x[start.own_columns()], {e: start.of(e) for e in start.effects}
    # An effect that the start has keeps its shape: only those that join have shapes to try.
    shapes = max((len(effect.starts) for effect in effects if effect not in known), default=1)
    best: tuple[float, EvidenceFit] | None = None
    for shape in range(shapes):
        parts = [
            known[effect] if effect in known else effect.starts[min(shape, len(effect.starts) - 1)]
            for effect in effects
        ]
        x_start = np.concatenate([own[:first], *parts, own[first:]])
        x, targets_m = np.split(x_start, [len(model.parameters)])
        at = replace(baseline, model=model, x=x, targets_m=targets_m)
        weighed = _Weighed(problem, effects, sizes, variances, at)
        found = minimise(
            bounds.clip(x_start),
            weighed.equations,
            lambda x, step: bounds.clip(x + step),
            lambda _, taken: (
                taken.gained <= COMPUTING.fit_precision * (1.0 + taken.before.cost - taken.gained)
            ),
            most_steps=COMPUTING.fit_steps,
            held=bounds.held,
            beyond=bounds.beyond,
            cost=weighed.cost,
            first_damping=COMPUTING.fit_damping,
        )
        if best is None or found.equations.cost < best[0]:
            fitted = EvidenceFit(
                effects, at_unknowns(at, found.at), found.converged, sizes, *variances
            )
            best = found.equations.cost, fitted
    assert best is not None
    return best[1]


def covariance_of(problem: EvidenceProblem, found: EvidenceFit) -> Array:
    """Return the covariance (k, k) that data and expected sizes leave of all parameters.

    Zero of the base where the calibration held it.
    """
    weighed = _Weighed(problem, found.effects, found.sizes, found.variances, found.at)
    free = np.ones(len(found.x), dtype=bool)
    base = found.at.model.columns_of(found.at.model.terms[-1])
    free[base] = ~held_of_base(problem.baseline)
    own = np.ix_(free, free)
    information = weighed.equations(found.x).normal[own]
    size = 1.0 / np.sqrt(np.diag(information))
    covariance = np.zeros((len(free), len(free)))
    covariance[own] = np.linalg.inv(information * np.outer(size, size)) * np.outer(size, size)
    return covariance


def targets_off_m(problem: EvidenceProblem, found: EvidenceFit) -> Array:
    """Return how far the targets are from their stated places on the apparatus, (a,) [m].

    They are integrated out in the fit, and are known best once it is done: the error of their
    places that the poses all share.
    """
    left = problem.pose.rows(residual(found.at, problem.cells)[:, :, None])
    units = problem.pose.common_amounts(left, found.pose_variance)[:, 0]
    stated = problem.cells.measured.by_stated_targets.shape[2]  # what else is common follows
    return np.asarray(-problem.setup.apparatus_m * units[:stated], dtype=np.float64)


class _Weighed:
    """Rows of the fit: weighed poses and torques, and what is expected of every parameter."""

    def __init__(
        self,
        problem: EvidenceProblem,
        effects: tuple[Effect, ...],
        sizes: tuple[int, ...],
        variances: tuple[float, float],
        at: FittedModel,
    ) -> None:
        self._problem, self._at, self._variances = problem, at, variances
        self._torque = problem.torque if any(map(shows_torque, effects)) else None
        possible = possible_sizes(at.model, problem.cells.measured)
        rows = np.diag(1.0 / possible)
        # Expected are tool and targets as calibrated, the shape of an effect where it starts (an
        # amount of zero says nothing of it: its first step would end at a bound), all else at zero.
        x_start, baseline = unknowns(at), problem.baseline
        of_tool = baseline.model.having("tool")
        middle = np.zeros(len(x_start))
        middle[: len(of_tool)] = np.where(of_tool, baseline.x, 0.0)
        middle[len(at.x) :] = baseline.targets_m
        for effect, size in zip(effects, sizes, strict=True):
            at_effect = at.model.columns_of(effect)
            linear = slice(at_effect.start, at_effect.start + effect.linear)
            rows[linear, linear] = np.linalg.inv(EVIDENCE.sizes[size] * effect.prior_factor)
            middle[linear.stop : at_effect.stop] = x_start[linear.stop : at_effect.stop]
        self._expected, self._middle = rows, middle
        self._last_x: Array | None = None

    def _look_at(self, x: Array) -> None:
        """Find what the model leaves of poses at parameters, once for cost and equations."""
        if self._last_x is not x:
            self._last_x, self._at = x, at_unknowns(self._at, x)
            self._residual, self._jacobian = residual_then_jacobian(self._at, self._problem.cells)

    def cost(self, x: Array) -> float:
        """Return the sum of squares at parameters (k,): all that a step uphill needs."""
        self._look_at(x)
        problem, off = self._problem, self._expected @ (x - self._middle)[:, None]
        rows = [problem.pose.weighed(self._residual[:, :, None], self._variances[0])]
        if self._torque is not None:
            left_Nm = torque_residual_Nm(problem, self._at)
            rows.append(self._torque.weighed(left_Nm[:, :, None], self._variances[1]))
        return float(sum(np.sum(part**2) for part in (*rows, off)))

    def equations(self, x: Array) -> Equations:
        """Return the problem at parameters (k,): rows (R,) and their derivative (R, k)."""
        self._look_at(x)
        problem, off = self._problem, self._expected @ (x - self._middle)
        of_pose = np.concatenate([self._residual[:, :, None], self._jacobian()], axis=2)
        rows = [problem.pose.weighed(of_pose, self._variances[0])]
        if self._torque is not None:
            rows.append(self._torque.weighed(torque_rows(problem, self._at), self._variances[1]))
        rows.append(np.concatenate([off[:, None], self._expected], axis=1))
        everything = np.concatenate(rows)
        return Equations.of(everything[:, 0], everything[:, 1:])


def pose_rows(problem: EvidenceProblem, at: FittedModel) -> Array:
    """Return predicted minus measured and its derivative side by side, (C, b, 1 + k + t)."""
    left, jacobian = residual_and_jacobian(at, problem.cells)
    return np.concatenate([left[:, :, None], jacobian], axis=2)


def torque_rows(problem: EvidenceProblem, at: FittedModel) -> Array:
    """Return predicted minus logged torque and its derivative side by side, (C, n, 1 + k + t)."""
    states, model = problem.cells.states, at.model
    left = torque_residual_Nm(problem, at)
    by_targets = np.zeros((*left.shape, len(at.targets_m)))
    return np.concatenate(
        [left[:, :, None], model.torque_jacobian(states, at.x), by_targets], axis=2
    )


def torque_residual_Nm(problem: EvidenceProblem, at: FittedModel) -> Array:
    """Return predicted minus logged torque, (C, n)."""
    return at.model.torque_Nm(problem.cells.states, at.x) - problem.torque_without_weights_Nm
