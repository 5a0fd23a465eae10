"""Carries a calibrated arm to another place: base, tool and targets are fitted anew, nothing else.

Links, springs and effects of the arm stay as the model has them, with their covariance. The tool,
and what it weighs, may be that of another campaign.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import accumulate, pairwise
from typing import NamedTuple, TypeVar

import numpy as np

from pa10cal.arm.chain import BASE
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import Array, Mask
from pa10cal.calibration.general import calibrate
from pa10cal.calibration.general.fit import GeneralSolution, fit
from pa10cal.calibration.general.problem import with_unknown_frames
from pa10cal.calibration.general.unknowns import ChosenUnknowns, choose_unknowns
from pa10cal.calibration.rules import GROUPS
from pa10cal.errors import CalibrationError
from pa10cal.fit.fitted import Fitted
from pa10cal.fit.problem import Problem
from pa10cal.fit.uncertain_weights import weight_sizes
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Start
from pa10cal.options import Tolerances
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import Offsets, is_tool, motion_of_base
from pa10cal.terms.term import Term
from pa10cal.terms.weights import Weights, holds_weights
from pa10cal.terms.wrapped import OfPart, about_moved_base, fixed

F = TypeVar("F", bound=Fitted)

#: What the states of poses may lack, in words, and the remedy.
_LACKING = {
    "q_rad": ("joint positions", "give the position of every joint in every pose"),
    "tau_Nm": ("torques", "log the torques, or describe the masses of the arm"),
    "temperature_C": ("temperatures", "log the temperature in every pose"),
    "time_s": ("times", "log the time of every pose"),
    "arrival": ("directions of arrival", "log from which side each joint arrives in every pose"),
}


class FrameFit(NamedTuple):
    """A fit of frames about a known arm."""

    problem: Problem
    x_start: Array  # (k,) start of its unknowns
    solution: GeneralSolution


class _UnknownColumns(NamedTuple):
    """Columns of the unknowns of a fit of frames, in this order; those of targets follow."""

    arm: slice  # none where its parameters are fixed
    frames: slice  # tool, and further bases
    base: slice

    @classmethod
    def of(cls, arm_parameter_count: int, unknowns: ChosenUnknowns) -> _UnknownColumns:
        of_frames = sum(len(frame.parameters) for frame in unknowns.frames)
        counts = (arm_parameter_count, of_frames, len(unknowns.base.parameters))
        return cls(*(slice(*ends) for ends in pairwise((0, *accumulate(counts)))))


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
        model: the calibrated model; all that it has of the arm stays, with the payload, and with
            the seen joint positions, discrepancy and grade of its own campaign.
        observations: P poses of the arm; their states hold all that the terms of the model read,
            such as the torques that load its springs (`evaluation.model_errors.poses_for_model`).
        cuts_s: times at which the base moved: each part between has a base of its own; the tool is
            the same in all.

    Raises:
        CalibrationError: when the states lack something, the fit does not converge, or the poses do
            not identify the frames.
    """
    chain = model.model.chain
    arm_terms = [
        term for term in model.model.terms if term.holds == "everywhere" and not is_tool(term)
    ]
    known_arm = Model(chain, tuple(fixed(term, model.values_of(term)) for term in arm_terms))
    x_arm = np.zeros(0)  # no parameter of the arm is an unknown
    _check_complete(known_arm, observations)
    start = calibrate.find_start(chain.arm, observations)
    # Tolerances are those of the links, which are no unknowns here.
    unknowns = choose_unknowns(chain.arm, Tolerances(), observations.measured, start)
    unknowns = replace(unknowns, frames=(*unknowns.frames, *_bases_of_parts(unknowns.base, cuts_s)))

    def fit_with(chosen: ChosenUnknowns) -> FrameFit:
        problem, x_start = with_unknown_frames(known_arm, x_arm, chosen, start, observations)
        return FrameFit(problem, x_start, fit(problem, x_start))

    found = fit_with_targets_shown(unknowns, start, fit_with)
    _check_identified(found)
    x, columns = found.solution.x, _UnknownColumns.of(len(x_arm), unknowns)
    motion = calibrate.base_motion(found.problem.model, x[columns.base])
    terms = (*arm_terms, *unknowns.frames)
    of_arm = model.model.parameter_indices(*arm_terms)
    x_terms = np.concatenate([model.x[of_arm], x[columns.frames]])
    falls_back = model.falls_back
    if falls_back is not None:
        of_fall_back = refit_frames(falls_back.model, observations, cuts_s)
        falls_back = replace(falls_back, model=of_fall_back)
    # Errors of an apparatus' targets (`targets_off_m`) are none that the new readings are known to
    # have, and the fit of the frames did not correct for any. Neither was another explanation of
    # the readings (`otherwise`) fitted to them.
    return replace(
        model,
        model=Model(chain, terms),
        x=about_moved_base(terms, x_terms, motion),
        covariance=_covariance_of_carried(model, arm_terms, unknowns, found),
        T_instr_base=start.T_instr_base @ motion_of_base(motion),
        R_ee_target=start.R_ee_target,
        R_first_target_of=observations.measured.R_first_target_of,
        targets_m=found.problem.places_at(x),
        target_names=observations.measured.target_names,
        targets_off_m=np.zeros(0),
        T_end_shown=np.eye(4),
        falls_back=falls_back,
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
    incomplete = np.count_nonzero(~_can_be_predicted(known_arm, observations.states))
    if not incomplete:
        return
    lacking = [_LACKING[name] for name in _lacking_states(known_arm, observations.states)]
    what = " and ".join(what for what, _ in lacking) or "finite loads"
    remedies = [remedy for _, remedy in lacking] or ["check the loads of every pose"]
    raise CalibrationError(
        f"poses lack {what} that the model needs",
        where="grid poses",
        value=f"{incomplete} of {len(observations)} poses",
        allowed="poses with all that its springs and effects depend on",
        remedy="; ".join(remedies),
    )


def _can_be_predicted(known_arm: Model, states: PoseStates) -> Mask:
    """Return in which poses (P,) a known arm predicts finite numbers."""
    predicted = known_arm.predict(states, np.zeros(0))
    return np.asarray(np.isfinite(predicted).all(axis=(1, 2)))


def _lacking_states(known_arm: Model, states: PoseStates) -> Iterator[str]:
    """Yield the states that a known arm reads and that are not finite.

    One that it does not read may be lacking as well, so each is tried with numbers for the others.
    """
    filled = {name: np.nan_to_num(getattr(states, name)) for name in _LACKING}
    for name in _LACKING:
        others = {other: values for other, values in filled.items() if other != name}
        is_read = not _can_be_predicted(known_arm, replace(states, **others)).all()
        if is_read and not np.isfinite(getattr(states, name)).all():
            yield name


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
        See `Fitted.covariance`; None where that of the model is not known.
    """
    if model.covariance is None:
        return None
    of_arm = model.model.parameter_indices(*arm_terms)
    columns = _UnknownColumns.of(len(of_arm), unknowns)
    terms = (*arm_terms, *unknowns.frames, unknowns.base)
    problem = replace(found.problem, model=Model(model.model.chain, terms))
    x = np.concatenate([model.x[of_arm], found.solution.x])
    normal = _normal_rows_of_refitted(problem, x, found.solution, len(of_arm))
    by_arm, by_refitted = normal[:, columns.arm], normal[:, columns.arm.stop :]
    cov_noise = _scaled_inverse(by_refitted)
    refitted_by_arm = -cov_noise @ by_arm  # derivative of the refitted by the arm's parameters
    cov_arm = model.covariance[np.ix_(of_arm, of_arm)]
    cov_refitted_arm = refitted_by_arm @ cov_arm
    cov_refitted = cov_refitted_arm @ refitted_by_arm.T + found.solution.widening**2 * cov_noise
    joint = np.block([[cov_arm, cov_refitted_arm.T], [cov_refitted_arm, cov_refitted]])
    before_base, places = columns.base.start, found.problem.places
    of_base = [before_base + BASE.index(name) for name in unknowns.base.coordinates]
    at = [*range(before_base), *of_base, *(before_base + len(BASE) + places)]
    # Motions of the base, and coordinates of targets, that were no unknowns have zero variance.
    whole = np.zeros((before_base + len(BASE) + len(found.problem.places_m),) * 2)
    whole[np.ix_(at, at)] = joint
    return whole


def _scaled_inverse(normal: Array) -> Array:
    """Return the inverse of a normal matrix (f, f), computed with a diagonal of ones."""
    scale = 1.0 / np.sqrt(np.diag(normal))
    return np.asarray(np.linalg.pinv(normal * np.outer(scale, scale)) * np.outer(scale, scale))


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

    Weights of the links that were fitted stay. Those of the tool belong to a campaign: if the other
    one states its tool, they are taken from there; if not, the tool of the model's own campaign is
    the best guess, as described and fitted there. Gravity is always that of the other campaign.
    Logged torques contain all weights, so fitted ones are dropped.

    Args:
        payload: what the arm carries there; None where nothing is known of it, gravity included:
            then weights and payload stay as they are.
        logged: whether torques are logged there.

    Returns:
        The model; its `payload` is what to calculate torques with in the other campaign.
    """
    if logged:
        model = model.only(*(term for term in model.model.terms if not holds_weights(term)))
    falls_back = model.falls_back
    if falls_back is not None:
        of_fall_back = with_tool_of(falls_back.model, payload, logged=logged)
        model = replace(model, falls_back=replace(falls_back, model=of_fall_back))
    if payload is None:
        return model
    x, covariance = model.x.copy(), model.covariance
    for term in filter(holds_weights, model.model.terms):
        columns = model.model.parameter_indices(term)
        kept_share, added_variance = _kept_weights(term, model, payload)
        x[columns] *= kept_share
        if covariance is not None:
            shrink = np.ones(len(covariance))
            shrink[columns] = kept_share
            covariance = covariance * np.outer(shrink, shrink)
            covariance[columns, columns] += added_variance
    payload = _with_tool_of_before(payload, model.payload)
    return replace(model, x=x, covariance=covariance, payload=payload)


def _with_tool_of_before(payload: Payload, before: Payload | None) -> Payload:
    """Return a payload with the tool of another campaign wherever it does not state its own."""
    of_campaigns = tuple(_with_tool_of_before(each, before) for each in payload.of_campaigns)
    payload = replace(payload, of_campaigns=of_campaigns)
    if payload.known or before is None:
        return payload
    return replace(
        payload,
        mass_kg=before.mass_kg,
        com_m=before.com_m,
        known=before.known,
        com_u_m=before.com_u_m,
    )


def _kept_weights(term: Weights, model: Fitted, payload: Payload) -> tuple[Array, Array]:
    """Return which share of each fitted weight (k,) stays, and the variance (k,) to add to it.

    What does not stay is as described in the other campaign, with the uncertainty that it has there
    before any fit: the direction of gravity, and a tool that is stated. A tool that is not stated
    stays.

    Args:
        term: weights that the model fitted.
        payload: what the arm carries in the other campaign, as stated there.
    """
    there = weight_sizes(model.arm, payload)
    kept_share, added_variance = np.ones(len(term.sizes)), np.zeros(len(term.sizes))
    kept_share[term.of_level] = 0.0
    added_variance[term.of_level] = there.level_rad**2
    if not payload.known:
        return kept_share, added_variance
    kept_share[term.of_tool_mass] = 0.0
    added_variance[term.of_tool_mass] = there.payload_kg**2
    before = None if model.payload is None else weight_sizes(model.arm, model.payload)
    tool_before_kg_m = 0.0 if before is None else before.payload_kg_m
    sizes_kg_m = np.array(term.sizes)
    moments = term.of_last_moment & (sizes_kg_m > 0.0)
    share, variance = _share_of_link(sizes_kg_m[moments], tool_before_kg_m)
    kept_share[moments] = share
    added_variance[moments] = variance + there.payload_kg_m**2
    return kept_share, added_variance


def _share_of_link(sizes_kg_m: Array, tool_kg_m: float) -> tuple[Array, Array]:
    """Return the last link's share of the first moments (k,) that it has together with a tool.

    Only their sum was fitted. With the prior variance L of the link and T of the tool, L / (L + T)
    of it is expected to be of the link, with the variance L T / (L + T).

    Args:
        sizes_kg_m: (k,) standard uncertainties of the sums before the fit.
        tool_kg_m: that of the tool.

    Returns:
        The shares, and the variances [kg2 m2].
    """
    link_variance = np.maximum(0.0, sizes_kg_m**2 - tool_kg_m**2)
    share = link_variance / sizes_kg_m**2
    return share, link_variance * (1.0 - share)
