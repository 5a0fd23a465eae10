"""Calibration with the general model: what is fitted, what the readings do not show, the start.

First all parameters are fitted that arm and instrument can identify. Then springs and tilts of
parallel axes are dropped that the readings do not show. Torques calculated from masses depend a
little on the fitted arm; they are calculated anew until that moves nothing. In the end what the
readings hardly determine is fitted with what is usual; the torques stay then (poses of few readings
would move by 0.3 um).
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from pa10cal.arm.chain import BASE, Chain
from pa10cal.arm.description import Arm, weights_known
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import Array, Mask
from pa10cal.calibration.general.fit import GeneralSolution, fit, reach_of
from pa10cal.calibration.general.problem import (
    GeneralProblem,
    check_enough,
    general_problem,
    loaded_joints,
    to_determine,
)
from pa10cal.calibration.general.springs import (
    SpringFit,
    rigid_at,
    springs_not_shown,
    with_proven_springs,
)
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.rules import FIT, GRADES, SPRINGS, UNKNOWNS
from pa10cal.calibration.serial_correlation import SerialCorrelation, serial_correlation
from pa10cal.errors import RecordError
from pa10cal.fit.loads import with_loads_read_by, with_torques
from pa10cal.fit.problem import DEPARTURES, Problem, hardly_known, usual_departures
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Start
from pa10cal.observe.time_order import may_show_changes
from pa10cal.results.calibration import BaseFrameRecord, CalibratedParameter, PriorPart
from pa10cal.terms.model import Model


@dataclass(frozen=True)
class GeneralCalibration(GeneralProblem):
    """A calibrated general model: the problem of the last fit, its start, and its solution.

    Springs and tilts that were dropped are in none of them.
    """

    # tilts of parallel axes that are zero, as the readings do not show them, with the uncertainty
    # that they had when they were fitted
    settled: dict[str, CalibratedParameter]
    fit: GeneralSolution  # the solution
    prior: PriorPart | None = None  # the prior, and what moved since; None without one
    # joints, from 1, with springs that the fit shows but that do not help to predict held-out poses
    unproven: tuple[int, ...] = ()
    # joints, from 1, whose springs the poses are too few for: they are held rigid
    held_rigid: tuple[int, ...] = ()
    # (k, k) covariance of the unknowns beside the tilts that are zero; None where none is
    beside_tilts: Array | None = None
    # how alike errors of poses are that follow each other in time, which the covariances hold;
    # None where they are not
    alike: SerialCorrelation | None = None

    @property
    def covariance_of_each(self) -> Array:
        """Return the covariance (k, k) that the uncertainty of each unknown alone is read from.

        Whether tilts are zero that the readings do not show is not known, so each unknown keeps
        what it is uncertain by beside them. Predictions do not: what an unknown is off by with a
        tilt, others take up, which holds for the covariance of the fit alone.
        """
        return self.fit.covariance if self.beside_tilts is None else self.beside_tilts


def calibrate_general(
    arm: Arm,
    observations: Observations,
    start: Start,
    payload: Payload | None = None,
    options: CalibrationOptions | None = None,
    *,
    links: bool = True,
) -> GeneralCalibration:
    """Calibrate the general model.

    Args:
        payload: what the arm carries; None where it is not known. Springs need torques, logged or
            of the masses that the description of the arm states.
        links: whether the links are calibrated; else their parameters keep their nominal values.

    Raises:
        TooFewPosesError: when there are too few poses, with rigid joints too unless springs are
            requested.
        CalibrationError: when springs are requested whose torques are not known.
    """
    options = options or CalibrationOptions()
    fitted = partial(fit, robust=options.general.robust, max_iterations=options.max_iterations)
    posed = general_problem(arm, observations, start, payload, options, links=links)
    held_rigid = _springs_beyond(posed) if options.general.springs == "auto" else ()
    if held_rigid:
        problem, kept = rigid_at(posed.problem, set(held_rigid))
        posed = replace(posed, problem=problem, x_start=posed.x_start[kept])
    check_enough(posed.problem)
    found = fitted(posed.problem, posed.x_start)
    last = SpringFit(posed.problem, found, posed.springs, posed.x_start)
    unproven: tuple[int, ...] = ()
    if options.general.springs == "auto":
        last, unproven = _with_springs_that_help(posed, last, fitted)
    logged = observations.states
    by_masses = bool(last.springs) and posed.torques_from == "masses"
    settled = tilts_not_shown(last.problem, last.found)
    beside_tilts: Array | None = None
    tilted = last.problem
    if settled:
        last = _without_tilts(last, settled, fitted, logged if by_masses else None, payload)
    problem, found = last.problem, last.found
    if by_masses:
        problem, found = at_rest(problem, found, logged, payload, fitted)
    found = _of_usual_size(problem, found, start, fitted)
    if settled:
        beside_tilts = _beside_tilts(tilted, problem, found)
    alike, added = _by_alike_errors(problem, found)
    return GeneralCalibration(
        problem=problem,
        x_start=last.x_start,
        start=start,
        redundant=posed.redundant,
        torques_from=posed.torques_from,
        payload=payload,
        settled=settled,
        fit=replace(found, covariance=found.covariance + added),
        unproven=unproven,
        held_rigid=held_rigid,
        beside_tilts=None if beside_tilts is None else beside_tilts + added,
        alike=alike,
    )


def _by_alike_errors(
    problem: Problem, found: GeneralSolution
) -> tuple[SerialCorrelation | None, Array | float]:
    """Return how alike errors in order of time are, and what that adds to the covariance (k, k).

    What many poses determine together, as the base, is the less certain. Nothing where time goes
    with place: there errors are alike that the model makes.
    """
    poses = problem.observations
    if not may_show_changes(poses):
        return None, 0.0
    order = np.argsort(poses.states.time_s, kind="stable")
    whitener = (np.sqrt(found.weights)[:, None, None] * found.whitener)[order]
    alike = serial_correlation((whitener @ found.residual[order, :, None])[:, :, 0])
    if alike is None:
        return None, 0.0
    pairs = alike.beside_independent(whitener @ problem.rows(found.x).jacobian[order])
    covariance = found.covariance / found.widening
    return alike, covariance @ pairs @ covariance


def _springs_beyond(posed: GeneralProblem) -> tuple[int, ...]:
    """Return the joints with a spring if there are fewer equations than unknowns with them."""
    return posed.springs if posed.problem.readings < to_determine(posed.problem) else ()


def _with_springs_that_help(
    posed: GeneralProblem, full: SpringFit, fitted: Callable[..., GeneralSolution]
) -> tuple[SpringFit, tuple[int, ...]]:
    """Return a fit without the springs that are not needed.

    Under weights that nobody stated they also have to help to predict held-out poses.

    Returns:
        The fit, and the joints, from 1, of springs that the readings show and that do not help.
    """
    assumed = posed.torques_from == "masses" and weights_known(posed.arm).assumed
    shown_fit = _with_shown_springs(full, fitted, stepwise=assumed)
    if not (assumed and shown_fit.springs):
        return shown_fit, ()
    names = (each.name for each in posed.problem.parameters)
    begin = dict(zip(names, posed.x_start.tolist(), strict=True))
    proven = with_proven_springs(shown_fit, begin, fitted)
    return proven, tuple(joint for joint in shown_fit.springs if joint not in proven.springs)


def _with_shown_springs(
    full: SpringFit, fitted: Callable[..., GeneralSolution], *, stepwise: bool
) -> SpringFit:
    """Return a fit without the springs that the readings do not show.

    Args:
        stepwise: whether springs are dropped one by one. Under weights that nobody stated none is
            sure to be there, and any of them may stand in for another.
    """
    arm, tau_Nm = full.problem.model.chain.arm, full.problem.observations.states.tau_Nm
    sure = () if stepwise else loaded_joints(arm, tau_Nm, SPRINGS.full_torque_share)
    while rigid := springs_not_shown(full, sure, stepwise=stepwise):
        full = full.without(rigid, fitted)
        if not stepwise:
            break
    return full


def _without_tilts(
    last: SpringFit,
    tilts: Collection[str],
    fitted: Callable[..., GeneralSolution],
    states_as_logged: PoseStates | None,
    payload: Payload | None,
) -> SpringFit:
    """Return a fit in which some tilts of parallel axes, by name, are zero.

    Args:
        states_as_logged: the states before torques were calculated; None where these stay.
    """
    kept = np.array([parameter.name not in tilts for parameter in last.problem.parameters])
    problem = replace(last.problem, model=last.problem.model.without("tilt"))
    x_start = _where_others_go(last.found, kept)
    if states_as_logged is not None:
        problem = _with_torques_at(problem, x_start, states_as_logged, payload)
    about, scatter = last.found.x[kept], last.found.scatter
    found = fitted(problem, x_start, scatter_start=scatter, about=about)
    return SpringFit(problem, found, last.springs, x_start)


def _beside_tilts(tilted: Problem, problem: Problem, found: GeneralSolution) -> Array:
    """Return the covariance (k, k) of a solution if the tilts that are zero in it were unknowns.

    Args:
        tilted: the problem whose unknowns they are.
        problem, found: the problem without them, and its solution.
    """
    tilts = tilted.having("tilt")
    x = np.zeros(len(tilts))
    x[~tilts] = found.x
    at = replace(tilted, observations=problem.observations)
    root = np.sqrt(found.weights)[:, None, None]
    rows = (root * found.whitener @ at.rows(x).jacobian).reshape(-1, len(x))
    of_tilts, covariance = rows[:, tilts], found.covariance / found.widening**2
    moved = covariance @ rows[:, ~tilts].T @ of_tilts  # what others take up of each tilt
    left = of_tilts.T @ (of_tilts - rows[:, ~tilts] @ moved)
    left += np.diag(reach_of(tilted)[tilts] ** -2.0)
    return np.asarray(found.covariance + found.widening**2 * moved @ np.linalg.solve(left, moved.T))


def _of_usual_size(
    problem: Problem,
    found: GeneralSolution,
    start: Start,
    fitted: Callable[..., GeneralSolution],
) -> GeneralSolution:
    """Fit again with what is usual where readings hardly determine links, zeros and targets.

    Departures are expected to be as large as those found, and targets where they are stated. The
    fit stays where noise is stated far too large: what readings know is by their noise.
    """
    if _is_stated_too_large(problem, found):
        return found
    covariance, prior = found.covariance / found.widening**2, np.diag(found.span.precision)
    groups = [problem.having(*roles) for roles in DEPARTURES]
    usual = usual_departures(found.x, covariance, problem.scale, groups, prior)
    about = np.where(np.isfinite(usual), 0.0, found.x)
    if start.targets_stated:
        of_targets = problem.having("target")
        about[of_targets] = start.targets_m[problem.places]
        usual[of_targets] = UNKNOWNS.stated_target_m
    rows = hardly_known(covariance, usual, prior)
    if not len(rows):
        return found
    last = fitted(problem, found.x, scatter_start=found.scatter, about=about, usual=rows)
    return replace(last, iterations=found.iterations + last.iterations)


def _is_stated_too_large(problem: Problem, found: GeneralSolution) -> bool:
    """Return whether residuals of a kind of component are far smaller than their stated noise."""
    measured, white = problem.observations.measured, found.whitener @ found.residual[:, :, None]
    dof_share = 1.0 - found.identifiability.rank / max(problem.readings, 1)
    for _, columns in measured.component_kinds:
        of_kind = white[:, columns, 0][measured.components_seen[:, columns]]
        dof = dof_share * len(of_kind)
        if dof >= UNKNOWNS.least_dof and np.sum(of_kind**2) < GRADES.stated_ratio**-2.0 * dof:
            return True
    return False


def _where_others_go(found: GeneralSolution, kept: Mask) -> Array:
    """Return the unknowns kept, (kept,), if all others are set to zero, to first order."""
    dropped_covariance = found.covariance[np.ix_(~kept, ~kept)]
    by_dropped = found.covariance[np.ix_(kept, ~kept)] @ np.linalg.inv(dropped_covariance)
    return np.asarray(found.x[kept] - by_dropped @ found.x[~kept])


def at_rest(
    problem: Problem,
    found: GeneralSolution,
    states_as_logged: PoseStates,
    payload: Payload | None,
    fitted: Callable[..., GeneralSolution],
) -> tuple[Problem, GeneralSolution]:
    """Fit again with the torques of the weights at the solution, until they move nothing.

    Args:
        problem, found: the problem, and its solution.
        states_as_logged: the states before torques were calculated.
        fitted: fits a problem from a start; see `fit`.

    Returns:
        The problem with these torques, and its solution.
    """
    for _ in range(FIT.most_refits):
        weighed = _with_torques_at(problem, found.x, states_as_logged, payload)
        if weighed is problem:
            break
        problem, before = weighed, found
        found = fitted(problem, before.x, scatter_start=before.scatter)
        found = replace(found, iterations=before.iterations + found.iterations)
    return problem, found


def _with_torques_at(
    problem: Problem, x: Array, states_as_logged: PoseStates, payload: Payload | None
) -> Problem:
    """Return the problem with the torques of the weights at x (k,); itself if nothing moves."""
    states, _ = with_torques(problem.model, problem.of_model(x), states_as_logged, payload)
    states = with_loads_read_by(problem.model.terms, states)
    weighed = replace(problem, observations=problem.observations.with_states(states))
    moved = weighed.predict(x)[:, :3, 3] - problem.predict(x)[:, :3, 3]
    return weighed if np.abs(moved).max() > FIT.moves_nothing_m else problem


def tilts_not_shown(problem: Problem, fit: GeneralSolution) -> dict[str, CalibratedParameter]:
    """Return the tilts of parallel axes if the readings do not show them, all together.

    Hayati's parameters are tilts across the common normal. Where axes are as parallel as designed,
    within the uncertainty of the readings, they only fit noise, and zero predicts better.
    """
    names = [parameter.name for parameter in problem.parameters]
    at = np.flatnonzero(problem.having("tilt"))
    covariance = fit.covariance[np.ix_(at, at)]
    std = np.sqrt(np.diag(covariance))
    if not len(at) or not np.all(std > 0.0):
        return {}
    if shown(fit.x[at], covariance, problem.readings):
        return {}
    return {
        names[k]: CalibratedParameter(
            value=0.0,
            std=float(sigma),
            unit="rad",
            tolerance=problem.parameters[k].tolerance,
            identifiable=True,
            at_bound=False,
            settled=True,
        )
        for k, sigma in zip(at, std, strict=True)
    }


def shown(values: Array, covariance: Array, readings: int) -> bool:
    """Return whether readings show parameters (k,), by Schwarz's criterion (1978) for all of them.

    Args:
        readings: number of scalar readings.
    """
    gain = float(values @ np.linalg.solve(covariance, values))
    return bool(gain > len(values) * np.log(readings))


def find_start(arm: Arm, observations: Observations) -> Start:
    """Find approximate frames and targets by the nominal arm, without a prior guess.

    Raises:
        CalibrationError: when the poses do not determine them.
    """
    T_base_ee = Chain.of(arm).forward(observations.states.q_rad)
    return observations.measured.find_start(T_base_ee)


def start_of(seed: BaseFrameRecord, measured: Instrument) -> Start:
    """Return approximate frames and targets, as `seed/base_frame.json` holds them.

    Raises:
        RecordError: when it lacks a target.
    """
    stated, target_names = seed.p_ee_targets_m or {}, measured.target_names
    missing = [name for name in target_names if name not in stated]
    if missing:
        raise RecordError(
            f"the record lacks target {missing[0]}",
            where=f"{seed.FILE}: p_ee_targets_m",
            value=list(stated),
            allowed="a position for every target",
            remedy="run pa10cal seed again",
        )
    T_ee_target = np.eye(4) if seed.T_ee_target is None else seed.T_ee_target
    targets_m = np.concatenate([np.zeros(0), *(stated[name] for name in target_names)])
    tools_m = dict.fromkeys(dict(measured.campaigns), np.zeros(3))  # where no tool was located
    tools_m |= {name: T[:3, 3] for name, T in (seed.T_ee_target_of or {}).items()}
    return Start(
        seed.T_instr_base,
        T_ee_target[:3, 3],
        T_ee_target[:3, :3],
        targets_m,
        tools_m,
        targets_stated=bool(seed.target_stated),
    )


def base_motion(model: Model, x_base: Array) -> Array:
    """Return the six small motions (6,) of the base; those that are no unknowns are zero.

    Args:
        x_base: values of the last term, which is that of the base.
    """
    values = dict(zip(model.terms[-1].coordinates, x_base, strict=True))
    return np.array([values.get(name, 0.0) for name in BASE])
