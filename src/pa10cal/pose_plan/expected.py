"""Design matrix of candidate poses: what they would determine of the model and missing effects.

The rows are those of the general calibration, linearised at the nominal arm. They hardly depend on
the values of the parameters, and not at all on the readings.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import Array
from pa10cal.calibration.general.problem import GeneralProblem, general_problem
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.discovery.jacobians import by_scaled_effects
from pa10cal.discovery.preparation import MeasurementSetup, complete, context_of, why_unknown
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.problem import possible_sizes
from pa10cal.numerics.pose_sets import covariance_root
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Start, StatedByCampaign, by_end_and_targets, carried_targets
from pa10cal.pose_plan.setup import MM, PlanSetup
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.vocabulary import candidates
from pa10cal.terms.term import TermParameter

_TEMPERATURE_C = 20.0
#: An effect of its plausible size shows if it moves a reading by more than this part of its
#: standard uncertainty; less is rounding (computing).
_SHOWN = 1e-6


@dataclass(frozen=True)
class ExpectedRows:
    """Whitened rows of N poses, b for each, those of all loads together."""

    parameters: tuple[TermParameter, ...]  # the k unknowns of the model
    sizes: Array  # (k,) prior standard deviation of each
    # (N, b, k + e) rows of unit variance, by the unknowns and the parameters of missing effects, in
    # units of their prior standard deviations
    white: Array
    # (N, 3, k) derivative of the first target's position [m] by the unknowns in these units,
    # under the least load
    target_jacobian: Array
    effects: dict[Effect, slice]  # effects that would show, with their columns of `white`
    springs: tuple[int, ...]  # joints to which the model gives a spring

    @property
    def of_model(self) -> Array:
        """Return the rows by the unknowns of the model alone, (N, b, k)."""
        return self.white[..., : len(self.parameters)]


def expected_rows(setup: PlanSetup, q: Array, calibration: CalibrationOptions) -> ExpectedRows:
    """Return the rows of poses at joint positions (N, n) [rad, or m of a prismatic joint]."""
    observations, start = _foreseen_observations(setup, q)
    general = general_problem(setup.arm, observations, start, setup.payload, calibration)
    problem, x = general.problem, general.x_start
    every_size = possible_sizes(problem.model, problem.observations.measured)
    model_count = len(problem.model.parameters)
    sizes = np.concatenate([every_size[:model_count], every_size[model_count + problem.places]])
    rows = problem.rows(x).jacobian * sizes
    by_effect: dict[Effect, Array] = {}
    if setup.options.effects > 0.0:
        by_effect = _effect_rows(general, setup.payload, setup.targets)
    root = np.linalg.cholesky(problem.stated_covariance)
    parts, columns, first = [np.linalg.solve(root, rows)], {}, len(sizes)
    for effect, effect_rows in by_effect.items():
        white = np.linalg.solve(root, effect_rows)
        if np.abs(white).max() > _SHOWN:
            columns[effect] = slice(first, first + white.shape[2])
            first = columns[effect].stop
            parts.append(white)
    white = np.concatenate(parts, axis=2)
    # Rows follow pose by pose, load by load; the least load of each pose stands for its position.
    loads_N = setup.options.loads_N
    least_loaded = np.arange(int(np.argmin(loads_N)), len(white), len(loads_N))
    # Of touches the end of the chain is the flange; else it is the target, or targets are unknowns.
    target_m = next(iter(setup.targets.values())) if setup.kind.from_touches else np.zeros(3)
    return ExpectedRows(
        parameters=problem.parameters,
        sizes=sizes,
        white=white.reshape(len(q), -1, white.shape[2]),
        target_jacobian=_target_jacobian(general, target_m)[least_loaded] * sizes,
        effects=columns,
        springs=general.springs,
    )


def _foreseen_observations(setup: PlanSetup, q: Array) -> tuple[Observations, Start]:
    """Return every pose under every load as the instrument would observe the nominal arm."""
    kind, options = setup.kind, setup.options
    targets_m = np.array(list(setup.targets.values()))
    T_instr_base = np.eye(4)
    T_instr_base[:3, 3] = -setup.instrument_place_m
    q = np.repeat(q, len(options.loads_N), axis=0)
    count = len(q)
    T_instr_ee = T_instr_base @ Chain.of(setup.arm).forward(q)
    attitude_rad = None if options.attitude_mrad is None else 1e-3 * options.attitude_mrad
    stated = StatedByCampaign(MM * options.uncertainty_mm, setup.targets, attitude_rad)
    measured = kind.foreseen(T_instr_ee, stated)
    states = PoseStates(
        q_rad=q,
        tau_Nm=np.full_like(q, np.nan),
        arrival=np.zeros_like(q),
        load_N=np.resize(options.loads_N, count),
        temperature_C=np.full(count, _TEMPERATURE_C),
        time_s=np.zeros(count),
    )
    label = np.array([f"plan {k}" for k in range(count)])
    # Positions of targets are unknowns of some instruments; others know them or see one point.
    unknown_count = len(measured.target_parameters)
    tool_m = np.zeros(3) if unknown_count or kind.from_touches else targets_m[0]
    start = Start(T_instr_base, tool_m, np.eye(3), targets_m.ravel()[:unknown_count])
    return Observations.single(label, states, measured), start


def _target_jacobian(general: GeneralProblem, target_m: Array) -> Array:
    """Return the derivative of the first target's position by the unknowns, (P, 3, k).

    In the instrument's frame: motions of the base that the arm's parameters can replace cancel.

    Args:
        target_m: (3,) place of the target in the frame of the end of the chain, where the places
            of targets are no unknowns.
    """
    problem, x = general.problem, general.x_start
    predicted = problem.model.predict_with_jacobian(
        problem.observations.states, problem.of_model(x)
    )
    T_instr_ee = problem.T_instr_base @ predicted.T_base_ee  # along the axes of the base
    places_m = problem.places_at(x)
    if not len(places_m):
        levers_m = predicted.T_base_ee[:, :3, :3] @ target_m
        turned = np.cross(predicted.jacobian[:, 3:], levers_m[..., None], axis=1)
        return np.asarray(predicted.jacobian[:, :3] + turned)
    _, levers_m = carried_targets(T_instr_ee, places_m)
    by_end, by_targets = by_end_and_targets(T_instr_ee, levers_m)
    by_model = by_end[:, 0] @ predicted.jacobian
    return np.concatenate([by_model, by_targets[:, 0][..., problem.places]], axis=2)


def _effect_rows(
    general: GeneralProblem, payload: Payload | None, targets: dict[str, Array]
) -> dict[Effect, Array]:
    """Return rows (P, b, e) of every effect that may be sought, in its plausible size.

    Rows of an effect with several start shapes are those of all, over the root of their number.
    Effects of time, temperature and direction of arrival are omitted: they depend on how poses are
    driven to, not on which they are.
    """
    problem, x = general.problem, general.x_start
    fitted_m = problem.places_at(x)
    nominal = FittedModel(
        problem.model,
        problem.of_model(x),
        problem.T_instr_base,
        targets_m=fitted_m,
        payload=payload,
    ).with_bends()
    stated = not len(fitted_m) and problem.observations.measured.by_stated_targets.shape[2] > 0
    stated_m = np.array(list(targets.values())) if stated else np.zeros((0, 3))
    measurement = MeasurementSetup(payload, stated_m, _TEMPERATURE_C)
    poses = complete(problem.observations, nominal, measurement)
    context = context_of(poses, nominal, measurement)
    context = replace(context, torques="none" if payload is None else "masses")
    rows = {}
    for effect in candidates(context):
        if effect.generic or effect.depends_on:
            continue
        if why_unknown(effect, poses.states, logged=False, weights=payload is not None):
            continue
        shapes = [np.array(start) for start in effect.starts]
        by_shape = by_scaled_effects(nominal, poses, [effect] * len(shapes), shapes)
        rows[effect] = np.concatenate(by_shape, axis=2) / np.sqrt(len(shapes))
    return rows


def covariance_of(white: Array) -> Array:
    """Return the posterior covariance (k, k) of unknowns by whitened rows (N, b, k).

    In units of their prior standard deviations: the prior is the identity.
    """
    k = white.shape[2]
    root = covariance_root(np.concatenate([white.reshape(-1, k), np.eye(k)]))
    return np.asarray(root @ root.T)


def target_u_mm(target_jacobian: Array, covariance: Array) -> Array:
    """Return the standard uncertainty of the first target's position in each pose, (N,) [mm].

    By its derivative (N, 3, k), as `ExpectedRows.target_jacobian`, and the covariance (k, k).
    """
    variance = np.einsum("pik,pik->p", target_jacobian, target_jacobian @ covariance)
    return np.asarray(1e3 * np.sqrt(np.maximum(variance, 0.0)))


def target_rms_u_mm(target_jacobian: Array, covariance: Array) -> float:
    """Return the root mean square of `target_u_mm` over the poses."""
    return float(np.sqrt(np.mean(target_u_mm(target_jacobian, covariance) ** 2)))
