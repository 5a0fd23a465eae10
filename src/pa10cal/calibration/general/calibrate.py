"""Calibration with the general model, whatever the arm and the instrument."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from pa10cal.arm.chain import BASE, Chain
from pa10cal.arm.description import Arm, weights_known
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import Array
from pa10cal.calibration.general.fit import GeneralSolution, fit
from pa10cal.calibration.general.problem import (
    GeneralProblem,
    check_enough,
    general_problem,
    loaded_joints,
)
from pa10cal.calibration.general.springs import rigid_at, springs_not_shown, with_proven_springs
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.rules import FIT, SPRINGS
from pa10cal.errors import RecordError
from pa10cal.fit.loads import with_loads_read_by, with_torques
from pa10cal.fit.problem import Problem
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Start
from pa10cal.results.calibration import BaseFrameRecord, CalibratedParameter, PriorPart
from pa10cal.terms.model import Model


@dataclass(frozen=True)
class GeneralCalibration(GeneralProblem):
    """A calibrated general model: the problem as it was solved in the end.

    `x_start` is where the last fit began: springs and tilts that were dropped are not in it.
    """

    # tilts of parallel axes left at zero, as the readings do not show them, with the uncertainty
    # that they would have had
    settled: dict[str, CalibratedParameter]
    fit: GeneralSolution  # where it ended
    prior: PriorPart | None = None  # what it started from, and what moved since; None for nothing
    # joints, from 1, whose springs the poses fitted show, and held-out clusters of them do not
    unproven: tuple[int, ...] = ()


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

    All that may be identified is fitted; springs that the readings do not show go, then tilts of
    parallel axes that they do not show; in the end torques of the masses are computed anew where
    the arm stands, until they move nothing.

    Args:
        payload: what the arm carries; None where it is not known. Springs need torques, logged or
            of the masses that the description of the arm states.
        links: whether the links are calibrated; else their parameters keep their nominal values.

    Raises:
        CalibrationError: when there are too few poses, or springs are requested whose torques are
            not known.
    """
    options = options or CalibrationOptions()
    fitted = partial(fit, robust=options.general.robust, max_iterations=options.max_iterations)
    posed = general_problem(arm, observations, start, payload, options, links=links)
    problem, x_start, springs = posed.problem, posed.x_start, posed.springs
    states_as_logged, source = observations.states, posed.torques_from
    tau_Nm = problem.observations.states.tau_Nm
    check_enough(problem)
    found = fitted(problem, x_start)
    # Under weights that nobody stated no spring is sure to be there, and any may stand in for
    # another: they go one by one, each with what it takes along.
    assumed = source == "masses" and weights_known(arm).assumed
    sure = () if assumed else loaded_joints(arm, tau_Nm, SPRINGS.full_torque_share)
    searched = options.general.springs == "auto"
    while searched and (
        rigid := springs_not_shown(problem, found, springs, sure, stepwise=assumed)
    ):
        springs = tuple(joint for joint in springs if joint not in rigid)
        problem, kept = rigid_at(problem, rigid)
        x_start = found.x[kept]
        found, searched = fitted(problem, x_start), assumed
    unproven: tuple[int, ...] = ()
    if assumed and springs and options.general.springs == "auto":
        names = (each.name for each in posed.problem.parameters)
        begin = dict(zip(names, posed.x_start.tolist(), strict=True))
        if fewer_springs := with_proven_springs(problem, found, springs, begin, fitted):
            judged = springs
            problem, found, springs, x_start = fewer_springs
            unproven = tuple(joint for joint in judged if joint not in springs)
    settled = tilts_not_shown(problem, found)
    by_masses = bool(springs) and source == "masses"
    if settled:
        kept = np.array([parameter.name not in settled for parameter in problem.parameters])
        problem = replace(problem, model=problem.model.without("tilt"))
        # Where the others go with the tilts at zero, to first order.
        covariance = found.covariance[np.ix_(~kept, ~kept)]
        follow = found.covariance[np.ix_(kept, ~kept)] @ np.linalg.inv(covariance)
        about, x_start = found.x[kept], found.x[kept] - follow @ found.x[~kept]
        if by_masses:
            problem = _with_torques_at(problem, x_start, states_as_logged, payload)
        fewer = fitted(problem, x_start, scatter_start=found.scatter, about=about)
        # That they are zero is not known: what the others are known to is what it was with them.
        found = replace(fewer, covariance=found.covariance[np.ix_(kept, kept)])
    if by_masses:
        covariance = found.covariance
        problem, found = at_rest(problem, found, states_as_logged, payload, fitted)
        found = replace(found, covariance=covariance) if settled else found
    return GeneralCalibration(
        *(problem, x_start, start, posed.redundant, source, payload, settled, found),
        unproven=unproven,
    )


def at_rest(
    problem: Problem,
    found: GeneralSolution,
    states_as_logged: PoseStates,
    payload: Payload | None,
    fitted: Callable[..., GeneralSolution],
) -> tuple[Problem, GeneralSolution]:
    """Fit again, from where a fit ended, until the torques of weights move nothing any more.

    Args:
        problem, found: what was solved, and where that ended.
        fitted: fits a problem from a point, with a scatter to set out with; see `fit`.
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
    """Return the problem with the torques of weights at a point; itself if that moves nothing."""
    states, _ = with_torques(problem.model, problem.of_model(x), states_as_logged, payload)
    states = with_loads_read_by(problem.model.terms, states)
    weighed = replace(problem, observations=problem.observations.with_states(states))
    moved = weighed.predict(x)[:, :3, 3] - problem.predict(x)[:, :3, 3]
    return weighed if np.abs(moved).max() > FIT.moves_nothing_m else problem


# Whether the readings show that parallel axes are tilted.
#
# Hayati's parameters take up a tilt across the common normal. Where axes are as parallel as they
# were designed, within the uncertainty of the readings, these parameters only spread the noise:
# zero then predicts better. Schwarz's criterion (1978) decides, over all of them together.


def tilts_not_shown(problem: Problem, fit: GeneralSolution) -> dict[str, CalibratedParameter]:
    """Return the tilts of parallel axes that the readings do not show; none where they do."""
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
    """Return whether so many readings show parameters (k,) all together, by Schwarz's criterion."""
    gain = float(values @ np.linalg.solve(covariance, values))
    return bool(gain > len(values) * np.log(readings))


# Frames and targets from which a fit starts, by the nominal arm, and where the base moves to.


def find_start(arm: Arm, observations: Observations) -> Start:
    """Find frames and targets by the nominal arm, from any place of instrument and target.

    Raises:
        CalibrationError: when the poses do not determine them.
    """
    T_base_ee = Chain.of(arm).forward(observations.states.q_rad)
    return observations.measured.find_start(T_base_ee)


def start_of(seed: BaseFrameRecord, measured: Instrument) -> Start:
    """Return where frames and targets are, from what `seed/base_frame.json` holds.

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
    return Start(seed.T_instr_base, T_ee_target[:3, 3], T_ee_target[:3, :3], targets_m, tools_m)


def base_motion(model: Model, x_base: Array) -> Array:
    """Return the six small motions (6,) of the base, zero for those that are no unknowns."""
    values = dict(zip(model.terms[-1].coordinates, x_base, strict=True))
    return np.array([values.get(name, 0.0) for name in BASE])
