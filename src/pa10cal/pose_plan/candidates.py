"""Poses from which a plan is chosen, within all limits, and what each would say.

They are spread evenly over the joints' ranges. Rows are those of the general calibration at the
nominal arm: what a pose says of the parameters and of missing effects hardly depends on their
values, and not at all on what is read.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.room import (
    Box,
    Candidates,
    Constraint,
    above,
    draw_within,
    facing,
    in_sight,
    keep_out,
    off_column,
    off_links,
    reach,
    within,
)
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import Array
from pa10cal.calibration.general.problem import GeneralProblem, general_problem
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.discovery.linear import by_effects, possible_sizes
from pa10cal.discovery.preparation import MeasurementSetup, complete, context_of, why_unknown
from pa10cal.errors import CalibrationError, remedy_for
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.kinds import instruments
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Start, Stated, by_end_and_targets, carried_targets
from pa10cal.pose_plan.options import PlanOptions
from pa10cal.terms.effects.effect import Effect, candidates
from pa10cal.terms.term import TermParameter

_MM = 1e-3
#: There is something to choose among so many candidates for each pose.
_FOR_EACH = 3
#: The tool stays off the base's axis, and targets off the lines from joint to joint, by these parts
#: of the arm's reach: about how thick arms are.
_COLUMN_SHARE = 0.1
_CLEARANCE_SHARE = 0.05
_TEMPERATURE_C = 20.0
#: Where targets sit by default: so far in front of the flange, and off its axis [m].
_AHEAD_M, _OFF_M = 0.1, 0.06
_SEVERAL = 3
#: Where an instrument is whose place is not given: so many reaches of the arm in front of it.
_STANDS_OFF = 1.5


def joint_ranges(arm: Arm, options: PlanOptions) -> tuple[Array, Array]:
    """Return the least and largest joint positions of a plan, (n,) each [rad, m].

    Raises:
        CalibrationError: when ranges are given and are not one a joint, within its limits.
    """
    low, high = arm.limits_rad.T
    if options.joints_deg:
        unit = np.where(arm.prismatic, _MM, np.radians(1.0))
        given = np.array(options.joints_deg, dtype=float)
        if len(given) != arm.n:
            raise CalibrationError(
                "not one range a joint",
                where="joints_deg",
                value=f"{len(given)} ranges",
                allowed=f"{arm.n} ranges, least and largest",
                remedy="give one range a joint",
            )
        first, last = given.T * unit
        wrong = (first > last) | (first < low - 1e-9) | (last > high + 1e-9)
        if wrong.any():
            joint = int(np.argmax(wrong))
            raise CalibrationError(
                "the range is none, or leaves the joint's limits",
                where=f"joints_deg of joint {joint + 1}",
                value=tuple(given[joint].tolist()),
                allowed=f"{low[joint] / unit[joint]:.1f} to {high[joint] / unit[joint]:.1f}",
                remedy="correct the range",
            )
        return first, last
    margin = options.limit_margin * (high - low)
    widest = np.where(arm.prismatic, np.inf, np.radians(options.largest_angle_deg))
    return np.maximum(low + margin, -widest), np.minimum(high - margin, widest)


def constraints_of(arm: Arm, options: PlanOptions) -> dict[str, Constraint]:
    """Return where arm and tool may be, by the option that says so, the quickest first."""
    found: dict[str, Constraint] = {}
    if options.workspace_mm is not None:
        corners = _MM * np.array(options.workspace_mm)
        found["workspace_mm"] = within(Box(corners.min(axis=0), corners.max(axis=0)))
    if options.reach_mm is not None:
        found["reach_mm"] = reach(_MM * options.reach_mm)
    if options.floor_mm is not None:
        found["floor_mm"] = above(_MM * options.floor_mm)
    found["the tool off the base's axis"] = off_column(_COLUMN_SHARE * arm.reach_m)
    found["the tool off the links"] = off_links(_CLEARANCE_SHARE * arm.reach_m)
    boxes = [
        Box(_MM * np.array(box.min_mm), _MM * np.array(box.max_mm)) for box in options.keep_out
    ]
    for number, (box, given) in enumerate(zip(boxes, options.keep_out, strict=True), start=1):
        found[f"keep-out {number} ({given.name})"] = keep_out(box)
    if options.instrument_at_mm is not None:
        at = _MM * np.array(options.instrument_at_mm)
        if options.facing_deg is not None:
            most_rad = float(np.radians(options.facing_deg))
            found["facing_deg"] = facing(at, np.array([0.0, 0.0, 1.0]), most_rad)
        if boxes:
            found["line of sight"] = in_sight(at, boxes)
    return found


def draw_candidates(arm: Arm, targets_m: Array, options: PlanOptions, least: int) -> Candidates:
    """Draw poses within all constraints, for targets (B, 3) on the end.

    As many as the options want, and some for each pose that is needed.

    Raises:
        CalibrationError: when too few are left, saying which constraint removed how many.
    """
    wanted = max(options.candidates, _FOR_EACH * least)
    ranges, constraints = joint_ranges(arm, options), constraints_of(arm, options)
    seed = options.random_seed
    found = draw_within(Chain.of(arm), targets_m, ranges, constraints, wanted, seed)
    if len(found.q) >= least:
        return found
    removed = {name: number for name, number in found.removed.items() if number}
    worst = max(removed, key=lambda name: removed[name])
    each = "; ".join(f"{name}: {number}" for name, number in removed.items())
    raise CalibrationError(
        "hardly any pose keeps within all limits" if len(found.q) else "no pose is left",
        where="poses drawn within the joint limits",
        value=f"{len(found.q)} of {found.drawn}; removed, one after the other: {each}",
        allowed=f"at least {least}",
        remedy=f"allow more room, first of all for: {worst}",
    )


# What poses would say of the model and of missing effects, before they are measured.


@dataclass(frozen=True)
class ExpectedRows:
    """Rows of N poses, those of all loads together."""

    parameters: tuple[TermParameter, ...]  # the k unknowns of the model
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
        # Off the last joint's axis, unless an orientation shows what that joint does.
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
) -> ExpectedRows:
    """Return the rows of poses at joint positions (N, n) [rad, or m of a prismatic joint]."""
    loads = len(options.loads_N)
    observations, start = _foreseen(arm, kind, q, options)
    payload = payload_of(arm, options)
    posed = general_problem(arm, observations, start, payload, calibration)
    problem, x = posed.problem, posed.x_start
    every, of_model = (
        possible_sizes(problem.model, problem.observations.measured),
        len(problem.model.parameters),
    )
    sizes = np.concatenate([every[:of_model], every[of_model + problem.places]])
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
    return ExpectedRows(
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
    if not problem.observations.measured.by_stated_targets.shape[2]:
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
        scaled = by_effects(at, poses, [effect] * len(shapes), shapes)
        together = np.concatenate(scaled, axis=2) / np.sqrt(len(shapes))
        if np.any(together):
            found[effect] = together
    return found
