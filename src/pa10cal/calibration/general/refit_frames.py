"""Carries a calibrated arm to another place: base, tool and targets are fitted anew, nothing else.

Links, springs and effects of the arm stay as the model has them, with their covariance. The tool,
and what it weighs, may be that of another campaign.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np

from pa10cal.arm.chain import BASE
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
from pa10cal.terms.offsets import Offsets, is_tool, motion_of_base
from pa10cal.terms.term import Term
from pa10cal.terms.weights import Weights, WeightSizes, holds_weights
from pa10cal.terms.wrapped import OfPart, about_moved_base, fixed

F = TypeVar("F", bound=Fitted)

#: What poses may lack, by what a term depends on, and the remedy. Others depend on torques.
_LACKING = {
    None: ("torques", "log the torques, or describe the masses of the arm"),
    "temperature_C": ("temperatures", "log the temperature in every pose"),
    "time_s": ("times", "log the time of every pose"),
}


class FrameFit(NamedTuple):
    """A fit of frames about a known arm."""

    problem: Problem
    x_start: Array  # (k,) start of its unknowns
    solution: GeneralSolution


def fit_with_targets_shown(
    unknowns: ChosenUnknowns, start: Start, fit_with: Callable[[ChosenUnknowns], FrameFit]
) -> FrameFit:
    """Return a fit of frames about a known arm, with all coordinates of targets if these show.

    Where all axes are parallel by design, the height of a target cannot be separated from that of
    the base, and is no unknown. The axes of a known arm are tilted a little, so the height may be
    identifiable after all. Tried where all six motions of the base are unknowns.

    Args:
        fit_with: fits the frames with these unknowns.
    """
    base_is_free = len(unknowns.base.parameters) == len(BASE)
    if base_is_free and 0 < len(unknowns.targets_kept) < len(start.targets_m):
        fit_of_all = fit_with(replace(unknowns, targets_kept=np.arange(len(start.targets_m))))
        if fit_of_all.solution.converged and _identifies_all(fit_of_all):
            return fit_of_all
    return fit_with(unknowns)


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
    chain = model.model.chain
    start = calibrate.find_start(chain.arm, observations)
    # Tolerances are those of the links, which are no unknowns here.
    unknowns = choose_unknowns(chain.arm, Tolerances(), observations.measured, start)
    unknowns = replace(unknowns, frames=(*unknowns.frames, *_bases_of_parts(unknowns.base, cuts_s)))
    arm_terms = [
        term for term in model.model.terms if term.holds == "everywhere" and not is_tool(term)
    ]
    known_arm = Model(chain, tuple(fixed(term, model.values_of(term)) for term in arm_terms))
    _check_complete(known_arm, observations)

    def fit_with(chosen: ChosenUnknowns) -> FrameFit:
        x_arm = np.zeros(0)  # no parameter of the arm is an unknown
        problem, x_start = with_unknown_frames(known_arm, x_arm, chosen, start, observations)
        return FrameFit(problem, x_start, fit(problem, x_start))

    found = fit_with_targets_shown(unknowns, start, fit_with)
    _check_identified(found)
    x, frame_count = found.solution.x, sum(len(frame.parameters) for frame in unknowns.frames)
    x_frames, x_base = np.split(found.problem.of_model(x), [frame_count])
    motion = calibrate.base_motion(found.problem.model, x_base)
    terms = (*arm_terms, *unknowns.frames)
    x_terms = np.concatenate([model.x[model.model.parameter_indices(*arm_terms)], x_frames])
    falls_back = model.falls_back
    return replace(
        model,
        model=Model(chain, terms),
        x=about_moved_base(terms, x_terms, motion),
        covariance=_covariance_of_carried(model, arm_terms, unknowns, found),
        T_instr_base=start.T_instr_base @ motion_of_base(motion),
        R_ee_target=start.R_ee_target,
        R_first_target_of=observations.measured.R_first_target_of,
        targets_m=found.problem.places_at(x),
        falls_back=None
        if falls_back is None
        else FallBack(falls_back.within, refit_frames(falls_back.model, observations, cuts_s)),
        otherwise=None,
    )


def _bases_of_parts(base: Offsets, cuts_s: Sequence[float]) -> Iterator[OfPart]:
    """Yield the base of every part of a campaign but the first, by the times between them."""
    spans_s = pairwise((*sorted(cuts_s), float("inf")))
    for number, (from_s, to_s) in enumerate(spans_s, start=2):
        yield OfPart(base, from_s, to_s, f"part {number}")


def _check_complete(known_arm: Model, observations: Observations) -> None:
    """Refuse poses whose states lack something that the terms of a known arm read.

    Raises:
        CalibrationError: with what they lack, and how to provide it.
    """
    nothing = np.zeros(0)
    predicted = known_arm.predict(observations.states, nothing)
    incomplete = int(np.count_nonzero(~np.isfinite(predicted).all(axis=(1, 2))))
    if not incomplete:
        return
    carried = known_arm.carried(observations.states, nothing)
    lacking = {
        term.depends_on
        for term in known_arm.terms
        if not np.isfinite(term.shift(carried, nothing)).all()
    }
    what, remedies = zip(*(_LACKING[each] for each in _LACKING if each in lacking), strict=True)
    raise CalibrationError(
        f"poses lack {' and '.join(what)} that the model needs",
        where="grid poses",
        value=f"{incomplete} of {len(observations)} poses",
        allowed="poses with all that its springs and effects depend on",
        remedy="; ".join(remedies),
    )


def _identifies_all(found: FrameFit) -> bool:
    """Return whether the readings of a fit determine every direction of its unknowns."""
    return found.solution.identifiability.rank == len(found.problem.parameters)


def _check_identified(found: FrameFit) -> None:
    """Refuse a fit of frames that did not converge, or whose poses do not identify the frames.

    Along a direction that no reading determines the fit stays at its start, by the prior of the
    unknowns, so it converges all the same.

    Raises:
        CalibrationError: with the number of directions that are identified.
    """
    converged = found.solution.converged
    if converged and _identifies_all(found):
        return
    what, value = "base and tool could not be fitted", found.solution.reason
    if converged:
        rank, count = found.solution.identifiability.rank, len(found.problem.parameters)
        what = "the poses do not identify base and tool"
        value = f"{rank} of {count} directions of their parameters"
    raise CalibrationError(
        what,
        where="grid poses",
        value=value,
        allowed="poses that identify base and tool",
        remedy="measure more poses, with orientations further apart",
    )


def _covariance_of_carried(
    model: Fitted, arm_terms: Sequence[Term], unknowns: ChosenUnknowns, found: FrameFit
) -> Array | None:
    """Return the joint covariance of the arm, of refitted frames, and of the base's six motions.

    With d the error of the arm's parameters the refitted ones err by -N^-1 C d, where N is their
    normal matrix and C its block by the arm: what frames can take up of an error of the arm is no
    error of predictions any more. Their noise adds N^-1. Rows have the weights that the fit ended
    with, so that noise beyond what the instrument states is part of it; errors of the arm that
    frames cannot take up are in that scatter too.

    Args:
        arm_terms: terms of the model that belong to the arm.
        unknowns: the frames fitted.
        found: their fit.

    Returns:
        (k + 6, k + 6); None where the covariance of the model is not known.
    """
    if model.covariance is None:
        return None
    of_arm = model.model.parameter_indices(*arm_terms)
    cov_arm = model.covariance[np.ix_(of_arm, of_arm)]
    # Parameters are in the order arm | frames | base | targets; the last three were refitted.
    terms = (*arm_terms, *unknowns.frames, unknowns.base)
    problem = replace(found.problem, model=Model(model.model.chain, terms))
    x = np.concatenate([model.x[of_arm], found.solution.x])
    normal = _normal_rows_of_refitted(problem, x, found.solution, len(of_arm))
    by_arm, by_refitted = normal[:, : len(of_arm)], normal[:, len(of_arm) :]
    scale = 1.0 / np.sqrt(np.diag(by_refitted))
    cov_noise = np.linalg.pinv(by_refitted * np.outer(scale, scale)) * np.outer(scale, scale)
    refitted_by_arm = -cov_noise @ by_arm
    cov_refitted_arm = refitted_by_arm @ cov_arm
    cov_refitted = cov_refitted_arm @ refitted_by_arm.T + found.solution.widening**2 * cov_noise
    joint = np.block([[cov_arm, cov_refitted_arm.T], [cov_refitted_arm, cov_refitted]])
    # Targets are not kept; motions of the base that were no unknowns have zero variance.
    before_base = len(problem.model.parameters) - len(unknowns.base.coordinates)
    of_base = [before_base + BASE.index(name) for name in unknowns.base.coordinates]
    kept = np.array([*range(before_base), *of_base], dtype=np.intp)
    covariance = np.zeros((before_base + len(BASE),) * 2)
    covariance[np.ix_(kept, kept)] = joint[: len(kept), : len(kept)]
    return covariance


def _normal_rows_of_refitted(
    problem: Problem, x: Array, solution: GeneralSolution, arm_parameter_count: int
) -> Array:
    """Return the rows of the normal matrix (f, k) that belong to frames, base and targets.

    Args:
        problem: with the terms of the arm, those of the frames and of the base as unknowns.
        x: (k,) its unknowns, those of the arm first, `arm_parameter_count` in number.
        solution: the fit of the frames, for the weights of its rows.
    """
    pose_count = len(problem.observations)
    normal = np.zeros((len(x) - arm_parameter_count, len(x)))
    # In batches, as Jacobians of maps have many columns.
    for first in range(0, pose_count, GROUPS.at_once):
        rows = np.arange(first, min(first + GROUPS.at_once, pose_count))
        part = replace(problem, observations=problem.observations.take(rows))
        root = np.sqrt(solution.weights[rows])[:, None, None]
        white = (root * solution.whitener[rows] @ part.rows(x).jacobian).reshape(-1, len(x))
        normal += white[:, arm_parameter_count:].T @ white
    return normal


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
    if logged:
        model = model.only(*(term for term in model.model.terms if not holds_weights(term)))
    falls_back = model.falls_back
    if falls_back is not None:
        of_fall_back = with_tool_of(falls_back.model, payload, logged=logged)
        model = replace(model, falls_back=FallBack(falls_back.within, of_fall_back))
    if payload is None:
        return model
    before = None if model.payload is None else weight_sizes(model.arm, model.payload)
    there = weight_sizes(model.arm, payload)
    x, covariance = model.x.copy(), model.covariance
    for term in filter(holds_weights, model.model.terms):
        columns = model.model.parameter_indices(term)
        kept, added_variance = _kept_by_arm(term, before, there, payload)
        x[columns] *= kept
        if covariance is not None:
            shrink = np.ones(len(covariance))
            shrink[columns] = kept
            covariance = covariance * np.outer(shrink, shrink)
            covariance[columns, columns] += added_variance
    return replace(model, x=x, covariance=covariance, payload=payload)


def _kept_by_arm(
    term: Weights, before: WeightSizes | None, there: WeightSizes, payload: Payload
) -> tuple[Array, Array]:
    """Return the part of each weight (k,) that belongs to the arm, and the variance to add.

    Tilts of gravity and the mass of the tool belong to a campaign: none is kept, and they are as
    uncertain as in the other one. The first moment m of the last link and the tool is divided by
    their variances L and T: that of the link is m L / (L + T), with the variance L T / (L + T), to
    which that of the other campaign's tool is added.

    Args:
        before: uncertainties of the weights in the campaign of the model; None where not known.
        there: their uncertainties in the other campaign.
        payload: what the arm carries there.
    """
    sizes = np.array(term.sizes)
    kept, added_variance = np.ones(len(sizes)), np.zeros(len(sizes))
    kept[term.of_level] = 0.0
    added_variance[term.of_level] = there.level_rad**2
    if not payload.known:
        return kept, added_variance
    kept[term.of_tool_mass] = 0.0
    added_variance[term.of_tool_mass] = there.payload_kg**2
    moment = term.of_last_moment & (sizes > 0.0)
    tool_kg_m = 0.0 if before is None else before.payload_kg_m
    link_variance = np.maximum(0.0, sizes[moment] ** 2 - tool_kg_m**2)
    kept[moment] = link_variance / sizes[moment] ** 2
    added_variance[moment] = link_variance * (1.0 - kept[moment]) + there.payload_kg_m**2
    return kept, added_variance
