"""What poses would say of the model and of missing effects, before they are measured.

Rows are those of the general calibration at the nominal arm: what a pose says of the parameters
hardly depends on their values, and not at all on what is read.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import Array
from pa10cal.calibration.general.problem import GeneralProblem, general_problem
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.discovery.linear import by_terms, possible_sizes
from pa10cal.discovery.preparation import MeasurementSetup, complete, context_of, why_unknown
from pa10cal.errors import CalibrationError, remedy_for
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.kinds import instruments
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Start, Stated, by_end_and_targets, carried_targets
from pa10cal.pose_plan.options import PlanOptions
from pa10cal.terms.effects.effect import Effect, candidates
from pa10cal.terms.term import Parameter

_MM = 1e-3
_TEMPERATURE_C = 20.0
#: Where targets sit by default: so far in front of the flange, and off its axis [m].
_AHEAD_M, _OFF_M = 0.1, 0.06
_SEVERAL = 3
#: Where an instrument is whose place is not given: so many reaches of the arm in front of it.
_STANDS_OFF = 1.5


@dataclass(frozen=True)
class Expected:
    """Rows of N poses, those of all loads together."""

    parameters: tuple[Parameter, ...]  # the k unknowns of the model
    sizes: Array  # (k,) standard deviation thought possible of each
    # (N, b, k + e) rows of unit variance, each unknown in the size possible of it, each parameter
    # of an effect in its plausible one
    white: Array
    # (N, 3, k) derivative of the first target's position by the unknowns in these sizes [m],
    # without load
    tool: Array
    # missing effects that would show, with the columns (from k on) of each
    effects: dict[Effect, slice]
    springs: tuple[int, ...]  # joints to which the model gives a spring

    @property
    def unknowns(self) -> int:
        """Return how many unknowns the model has."""
        return len(self.parameters)


def instrument_named(name: str) -> type[Instrument]:
    """Return the class of an instrument.

    Raises:
        CalibrationError: when there is none of that name.
    """
    known = instruments()
    if name not in known:
        raise CalibrationError(
            "no such instrument",
            where="instrument",
            value=name,
            allowed=", ".join(known),
            remedy=remedy_for(name, known, "choose one of these"),
        )
    return known[name]


def targets_of(kind: type[Instrument], options: PlanOptions) -> dict[str, Array]:
    """Return the targets on the end, (3,) each [m], by name."""
    given = _MM * np.array(options.targets_mm, dtype=float).reshape(-1, 3)
    if not len(given):
        # Off the last joint's axis, unless an attitude shows what that joint does.
        count = _SEVERAL if kind.several_targets or kind.from_touches else 1
        off_m = 0.0 if kind.measures_pose and not kind.from_touches else _OFF_M
        angle = 2.0 * np.pi * np.arange(count) / count
        around = off_m * np.column_stack([np.cos(angle), np.sin(angle)])
        given = np.column_stack([around, np.full(count, _AHEAD_M)])
    return {f"T{number}": place for number, place in enumerate(given, start=1)}


def instrument_place_m(arm: Arm, options: PlanOptions) -> Array:
    """Return where the instrument is, (3,) in the base frame."""
    if options.instrument_at_mm is not None:
        return _MM * np.array(options.instrument_at_mm)
    return np.array([_STANDS_OFF * arm.reach_m, 0.0, 0.0])


def payload_of(arm: Arm, options: PlanOptions) -> Payload | None:
    """Return what the arm carries; None where the masses of its links are not known."""
    if arm.mass_kg is None:
        return None
    com_m = _MM * np.array(options.tool_com_mm)
    return Payload(
        options.tool_kg or 0.0,
        com_m,
        com_m,
        np.array(options.gravity_m_s2),
        known=options.tool_kg is not None,
    )


def expect(
    arm: Arm,
    kind: type[Instrument],
    q: Array,
    options: PlanOptions,
    calibration: CalibrationOptions,
) -> Expected:
    """Return the rows of poses.

    Args:
        arm: the nominal arm.
        kind: what measures.
        q: (N, n) joint positions [rad, or m of a prismatic joint].
        options: targets, uncertainties, loads.
        calibration: how it will be calibrated.
    """
    loads = len(options.loads_N)
    observations, start = _foreseen(arm, kind, q, options)
    payload = payload_of(arm, options)
    posed = general_problem(arm, observations, start, payload, calibration)
    problem, x = posed.problem, posed.x_start
    sizes = _sizes(posed)
    rows = problem.rows(x).jacobian * sizes
    columns, effects = [rows], {}
    if options.effects > 0.0:
        at, found = len(sizes), _effects(posed, payload, targets_of(kind, options))
        for effect, of_effect in found.items():
            effects[effect] = slice(at, at + of_effect.shape[2])
            at += of_effect.shape[2]
        columns += found.values()
    root = np.linalg.cholesky(problem.stated_covariance)
    white = np.linalg.solve(root, np.concatenate(columns, axis=2))
    unloaded = np.arange(0, len(white), loads)
    return Expected(
        parameters=problem.parameters,
        sizes=sizes,
        white=white.reshape(len(q), -1, white.shape[2]),
        tool=_tool(posed)[unloaded] * sizes,
        effects=effects,
        springs=posed.springs,
    )


def _foreseen(
    arm: Arm, kind: type[Instrument], q: Array, options: PlanOptions
) -> tuple[Observations, Start]:
    """Return every pose under every load, as the instrument would see the nominal arm."""
    places = targets_of(kind, options)
    targets_m = np.array(list(places.values()))
    T_instr_base = np.eye(4)
    T_instr_base[:3, 3] = -instrument_place_m(arm, options)
    q = np.repeat(q, len(options.loads_N), axis=0)
    count = len(q)
    T_instr_ee = T_instr_base @ Chain.of(arm).forward(q)
    attitude = options.attitude_mrad
    stated = Stated(
        _MM * options.uncertainty_mm, places, None if attitude is None else 1e-3 * attitude
    )
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
    own = len(measured.target_parameters)
    tool_m = np.zeros(3) if own or kind.from_touches else targets_m[0]
    start = Start(T_instr_base, tool_m, np.eye(3), targets_m.ravel()[:own])
    return Observations.single(label, states, measured), start


def _sizes(posed: GeneralProblem) -> Array:
    """Return the standard deviation thought possible of every unknown, (k,)."""
    problem = posed.problem
    every = possible_sizes(problem.model, problem.measured)
    of_model = len(problem.model.parameters)
    return np.concatenate([every[:of_model], every[of_model + problem.places]])


def _tool(posed: GeneralProblem) -> Array:
    """Return the derivative of the first target's position by the unknowns, (P, 3, k).

    In the instrument's frame, so that what arm and base share counts once.
    """
    problem, x = posed.problem, posed.x_start
    predicted = problem.model.predict_with_jacobian(
        problem.observations.states, problem.of_model(x)
    )
    T_instr_ee = problem.T_instr_base @ predicted.T_base_ee  # along the axes of the base
    places_m = problem.places_at(x)
    if not len(places_m):
        return predicted.jacobian[:, :3]
    _, arms = carried_targets(T_instr_ee, places_m)
    by_end, by_targets = by_end_and_targets(T_instr_ee, arms)
    by_model = by_end[:, 0] @ predicted.jacobian
    return np.concatenate([by_model, by_targets[:, 0][..., problem.places]], axis=2)


def _effects(
    posed: GeneralProblem, payload: Payload | None, places: dict[str, Array]
) -> dict[Effect, Array]:
    """Return rows (P, b, e) of every effect that these poses can show, in its plausible size.

    Of effects with a shape the mean over their shapes counts. Those of time, of temperature and of
    the direction of arrival depend on how poses are driven, not on which they are.
    """
    problem, x = posed.problem, posed.x_start
    own = problem.places_at(x)
    at = FittedModel(
        problem.model, problem.of_model(x), problem.T_instr_base, targets_m=own, payload=payload
    ).with_bends()
    stated_m = np.zeros((0, 3)) if len(own) else np.array(list(places.values()))
    if not problem.measured.by_stated_targets.shape[2]:
        stated_m = np.zeros((0, 3))
    setup = MeasurementSetup(payload, stated_m, _TEMPERATURE_C)
    poses = complete(problem.observations, at, setup)
    context = replace(context_of(poses, at, setup), torques="none" if payload is None else "masses")
    found = {}
    for effect in candidates(context):
        if effect.generic or effect.goes_with_time:
            continue
        if why_unknown(effect, poses.states, logged=False, weights=payload is not None):
            continue
        shapes = [np.array(start) for start in effect.starts]
        rows = by_terms(at, poses, [effect] * len(shapes), shapes)
        scaled = [each[..., : effect.linear] @ effect.prior_factor for each in rows]
        together = np.concatenate(scaled, axis=2) / np.sqrt(len(shapes))
        if np.any(together):
            found[effect] = together
    return found
