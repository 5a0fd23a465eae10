"""A calibrated arm in another place: base, tool and targets are fitted anew, and nothing else.

Links, springs and effects of the arm stay as the model has them, with their covariance. The tool,
and what it weighs, may be that of another campaign.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TypeVar

import numpy as np

from pa10cal.arm.chain import BASE, TOOL
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.calibration.general import calibrate
from pa10cal.calibration.general.fit import GeneralSolution, fit
from pa10cal.calibration.general.problem import with_unknown_frames
from pa10cal.calibration.general.unknowns import ChosenUnknowns, choose_unknowns
from pa10cal.calibration.rules import GROUPS
from pa10cal.errors import CalibrationError
from pa10cal.fit.fitted import FallBack, Fitted
from pa10cal.fit.problem import Problem
from pa10cal.fit.uncertain_weights import weight_sizes
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Start
from pa10cal.options import Tolerances
from pa10cal.terms.model import Model
from pa10cal.terms.of_campaign import OfPart, about_moved_base, motion_of_base
from pa10cal.terms.term import Term, fixed
from pa10cal.terms.weights import Weights, WeightSizes, holds_weights

F = TypeVar("F", bound=Fitted)

#: A problem, the start of its fit, and the solution.
Fit = tuple[Problem, Array, GeneralSolution]


def about_known_arm(
    unknowns: ChosenUnknowns, start: Start, fitted: Callable[[ChosenUnknowns], Fit]
) -> Fit:
    """Return a fit of frames about a known arm, with all coordinates of targets if these show.

    Where all axes are parallel by design, the height of a target cannot be separated from that of
    the base, and is no unknown. The axes of a known arm are tilted a little, so the height may be
    identifiable after all.

    Args:
        fitted: fits the frames with these unknowns.
    """
    places_are_unknowns = len(unknowns.base.parameters) == len(BASE) and len(unknowns.places) > 0
    if places_are_unknowns and len(unknowns.places) < len(start.targets_m):
        fit_of_all = fitted(replace(unknowns, places=np.arange(len(start.targets_m))))
        problem, _, found = fit_of_all
        if found.identifiability.rank == len(problem.parameters):
            return fit_of_all
    return fitted(unknowns)


def refit_frames(model: F, observations: Observations, cuts_s: Sequence[float] = ()) -> F:
    """Fit base and tool, or targets, of a calibrated model to other observations of the same arm.

    Args:
        model: the calibrated model; everything in it but base, tool and targets stays.
        observations: P poses of the arm; their states hold all that the terms of the model read,
            such as the torques that load its springs (`evaluation.model_errors.poses_for_model`).
        cuts_s: times at which the base moved: each part between has a base of its own; the tool is
            the same in all.

    Raises:
        CalibrationError: when the states lack something, the fit does not converge, or the poses do
            not identify the frames.
    """
    _check_complete(model, observations)
    arm = model.model.chain.arm
    start = calibrate.find_start(arm, observations)
    unknowns = choose_unknowns(arm, Tolerances(), observations.measured, start)
    arm_terms = [
        term for term in model.model.terms if term.holds == "everywhere" and not is_tool(term)
    ]
    known = [fixed(term, model.values_of(term)) for term in arm_terms]
    of_arm = model.model.parameter_indices(*arm_terms)
    chain = model.model.chain
    ends_s = pairwise((*sorted(cuts_s), float("inf")))  # of every part but the first
    parts = (
        OfPart(unknowns.base, from_s, to_s, f"part {number}")
        for number, (from_s, to_s) in enumerate(ends_s, start=2)
    )
    own_frames = (*unknowns.frames, *parts)
    unknowns, as_known = replace(unknowns, frames=own_frames), Model(chain, tuple(known))

    def placed(unknowns: ChosenUnknowns) -> Fit:
        problem, x_start = with_unknown_frames(as_known, np.zeros(0), unknowns, start, observations)
        return problem, x_start, fit(problem, x_start)

    problem, _, found = about_known_arm(unknowns, start, placed)
    _check_identified(problem, found)
    of_model = problem.of_model(found.x)
    away = model.falls_back
    terms = (*arm_terms, *own_frames)
    frames = sum(len(each.parameters) for each in own_frames)
    small = calibrate.base_motion(problem.model, of_model[frames:])
    covariance = None
    if model.covariance is not None:
        opened = replace(problem, model=Model(chain, (*terms, unknowns.base)))
        own = model.covariance[np.ix_(of_arm, of_arm)]
        x = np.concatenate([model.x[of_arm], found.x])
        covariance = _with_frames(opened, x, found, own, unknowns.base.coordinates)
    x_terms = np.concatenate([model.x[of_arm], of_model[:frames]])
    return replace(
        model,
        model=Model(chain, terms),
        x=about_moved_base(terms, x_terms, small),
        covariance=covariance,
        T_instr_base=start.T_instr_base @ motion_of_base(small),
        R_ee_target=start.R_ee_target,
        R_first_target_of=observations.measured.R_first_target_of,
        targets_m=problem.places_at(found.x),
        falls_back=None
        if away is None
        else FallBack(away.within, refit_frames(away.model, observations, cuts_s)),
    )


def _check_complete(model: Fitted, observations: Observations) -> None:
    """Refuse poses whose states lack something that the terms of a model read."""
    predicted = model.model.predict(observations.states, model.x)
    incomplete = int(np.count_nonzero(~np.isfinite(predicted).all(axis=(1, 2))))
    if incomplete:
        raise CalibrationError(
            "poses lack torques, temperatures or times that the model needs",
            where="grid poses",
            value=f"{incomplete} of {len(observations)} poses",
            allowed="poses with all that its springs and effects depend on",
            remedy="log the torques, or describe the masses of the arm",
        )


def _check_identified(problem: Problem, found: GeneralSolution) -> None:
    """Refuse a fit of frames that did not converge, or whose poses do not identify the frames.

    Along a direction that no reading determines the fit stays at its start, by the prior of the
    unknowns, so it converges all the same.

    Raises:
        CalibrationError: with the number of directions that are identified.
    """
    rank, count = found.identifiability.rank, len(problem.parameters)
    if found.converged and rank == count:
        return
    what, value = "base and tool could not be fitted", found.reason
    if found.converged:
        what = "the poses do not identify base and tool"
        value = f"{rank} of {count} directions of their parameters"
    raise CalibrationError(
        what,
        where="grid poses",
        value=value,
        allowed="poses that identify base and tool",
        remedy="measure more poses, with orientations further apart",
    )


def with_tool_of(model: F, payload: Payload | None, *, logged: bool = False) -> F:
    """Return a calibrated model with what the arm carries in another campaign.

    Weights of the links that were fitted stay. Those of the tool belong to a campaign: they are
    taken from the other one if it states its tool, else those of the model's own campaign are the
    best guess. The first moments of the last link and of the tool were fitted as one number, which
    is divided by their variances. The direction of gravity in the base frame is that of the new
    base. Logged torques contain all weights, so fitted ones are dropped.

    Args:
        payload: what the arm carries there; None where it is not known.
        logged: whether torques are logged there.
    """
    away = model.falls_back
    if logged:
        model = model.only(*(term for term in model.model.terms if not holds_weights(term)))
    x, covariance = model.x.copy(), model.covariance
    for term in model.model.terms:
        if payload is None or not holds_weights(term):
            continue
        columns = model.model.parameter_indices(term)
        before = None if model.payload is None else weight_sizes(model.arm, model.payload)
        kept, rest_variance = _of_link(term, before, weight_sizes(model.arm, payload), payload)
        x[columns] *= kept
        if covariance is not None:
            shrink = np.ones(len(covariance))
            shrink[columns] = kept
            covariance = covariance * np.outer(shrink, shrink)
            covariance[columns, columns] += rest_variance
    return replace(
        model,
        x=x,
        covariance=covariance,
        payload=model.payload if payload is None else payload,
        falls_back=None
        if away is None
        else FallBack(away.within, with_tool_of(away.model, payload, logged=logged)),
    )


def _of_link(
    term: Weights, before: WeightSizes | None, there: WeightSizes, payload: Payload
) -> tuple[Array, Array]:
    """Return the part of each weight that belongs to the arm, and the variance of the rest, (k,).

    Column 4 j of the weights is the mass of link j, the next three are its first moment; column 4 n
    is the mass of the tool, and tilts of gravity follow.

    Args:
        before: uncertainties of the weights in the campaign of the model; None where not known.
        there: their uncertainties in the other campaign.
    """
    kept, rest_variance = np.ones(len(term.columns)), np.zeros(len(term.columns))
    tool_kg_m = 0.0 if before is None else before.payload_kg_m
    for k, (column, size) in enumerate(zip(term.columns, term.sizes, strict=True)):
        beyond = column - 4 * term.n
        if beyond > 0:
            kept[k], rest_variance[k] = 0.0, there.level_rad**2
        elif payload.known and beyond == 0:
            kept[k], rest_variance[k] = 0.0, there.payload_kg**2
        elif payload.known and -4 < beyond < 0:  # first moment of the last link, and of the tool
            own = max(0.0, size**2 - tool_kg_m**2)
            kept[k] = own / size**2
            rest_variance[k] = own * (1.0 - kept[k]) + there.payload_kg_m**2
    return kept, rest_variance


def _with_frames(
    problem: Problem, x: Array, found: GeneralSolution, of_arm: Array, base: tuple[str, ...]
) -> Array:
    """Return the joint covariance of the arm, of refitted frames, and of the base's six motions.

    With d the error of the arm's parameters the refitted frames err by -N^-1 C d, where N is the
    normal matrix of the frames and C its block by the arm: what frames can take up of an error of
    the arm is no error of predictions any more. Their noise adds N^-1. Rows have the weights that
    the fit ended with, so that noise beyond what the instrument states is part of it; errors of the
    arm that frames cannot take up are in that scatter too.

    Args:
        problem: with the terms of the arm, those of the frames and of the base as unknowns.
        x: (k,) its unknowns, those of the arm first.
        found: the fit of the frames.
        of_arm: (a, a) covariance of the arm's parameters.
        base: coordinates of the base that were unknowns.
    """
    poses, own = len(problem.observations), len(of_arm)
    # A part of the poses is enough, and taken in batches: Jacobians of maps have many columns.
    every = max(1, poses // GROUPS.enough_poses)
    normal = np.zeros((len(x) - own, len(x)))
    for first in range(0, poses, every * GROUPS.at_once):
        rows = np.arange(first, min(first + every * GROUPS.at_once, poses), every)
        part = replace(problem, observations=problem.observations.take(rows))
        root = np.sqrt(found.weights[rows])[:, None, None]
        white = (root * found.whitener[rows] @ part.rows(x).jacobian).reshape(-1, len(x))
        normal += every * white[:, own:].T @ white
    of_frames = normal[:, own:]
    scale = 1.0 / np.sqrt(np.diag(of_frames))
    inverse = np.linalg.pinv(of_frames * np.outer(scale, scale)) * np.outer(scale, scale)
    follow = -inverse @ normal[:, :own]
    across = follow @ of_arm
    noise = found.widening**2 * inverse
    whole = np.block([[of_arm, across.T], [across, across @ follow.T + noise]])
    terms = len(problem.model.parameters) - len(base)
    covariance = np.zeros((terms + len(BASE),) * 2)
    at = np.concatenate([np.arange(terms), terms + np.array([BASE.index(name) for name in base])])
    kept = slice(0, len(problem.model.parameters))
    covariance[np.ix_(at, at)] = whole[kept, kept]
    return covariance


def is_tool(term: Term) -> bool:
    """Return whether a term is the mounting of the tool; a tool that sags is another term."""
    return "tool" in term.roles and set(term.coordinates) <= set(TOOL)
