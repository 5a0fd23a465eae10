"""Calibration with a fitted model of the arm as prior: after a crash, a new tool, in a new cell.

Links, springs and effects of the arm have the model's values and covariance as prior; base, tool
and targets are free. That covariance holds noise alone, so the readings decide how far the prior is
trusted: what moved, such as the zero of one joint, is found anew while the rest stays. Where all
parameters depart by more than noise, as under a model that lacks an effect, the prior is widened.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array, Mask
from pa10cal.calibration.general import calibrate
from pa10cal.calibration.general.fit import GeneralSolution, fit
from pa10cal.calibration.general.problem import check_enough, with_unknown_frames
from pa10cal.calibration.general.refit_frames import FrameFit, fit_with_targets_shown
from pa10cal.calibration.general.unknowns import ChosenUnknowns, choose_unknowns
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.rules import GROUPS, UNKNOWNS
from pa10cal.campaign.description import CampaignDescription
from pa10cal.errors import CalibrationError
from pa10cal.fit.fitted import Fitted
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import with_torques
from pa10cal.fit.moved import (
    EVERYTHING,
    JOINT_ZERO,
    LINK,
    MODEL_ERROR,
    STIFFNESS,
    Hypothesis,
    Misfit,
    MovedPart,
    everything,
    hypotheses,
    smallest_set,
    sought,
)
from pa10cal.fit.problem import GaussianPrior, Problem, disagreement
from pa10cal.fit.uncertain_weights import unknown_tool, weight_sizes
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.observations import Observations, reading_checksums
from pa10cal.observe.quantities import Start
from pa10cal.results.calibration import Moved, PriorPart
from pa10cal.results.number_text import HALF_WIDTH_95
from pa10cal.terms.model import Model
from pa10cal.terms.term import Term
from pa10cal.terms.weights import Weights, holds_weights

F = TypeVar("F", bound=Fitted)

#: Grades of calibrations that are not reliable.
_UNSOUND = ("suspect_input", "not_converged")


@dataclass(frozen=True, eq=False)
class Prior:
    """What a fitted model says of an arm in another campaign."""

    model: FittedModel  # the fitted model
    terms: tuple[Term, ...]  # its terms that belong to the arm
    expected: GaussianPrior  # prior of their parameters


def refuse_unsound(model: FittedModel, *, force: bool = False) -> None:
    """Refuse a model whose calibration is not reliable, unless `force`.

    Raises:
        CalibrationError: naming its grade.
    """
    if model.grade in _UNSOUND and not force:
        raise CalibrationError(
            f"the prior is graded {model.grade}",
            where="prior",
            value="" if model.fitted_to is None else model.fitted_to.health,
            allowed="a model graded good, few_poses or incomplete",
            remedy="follow the remedy of its grade, or override with --force",
        )


def refuse_own_readings(
    model: FittedModel, poses: Observations, campaign: CampaignDescription
) -> None:
    """Refuse a prior that was fitted to the poses to be fitted: their noise would count twice.

    Raises:
        CalibrationError: when the prior is of the same readings under some load, whatever name
            they have; of a member of the group; or of as many poses between the same times, and of
            a campaign of this name, or, where it has no checksums of its readings, of these poses.
    """
    of, time_s = model.fitted_to, poses.states.time_s
    if of is None:
        return
    of_prior = np.array([of.poses, *of.time_s])
    of_poses = np.array([len(poses), time_s.min(), time_s.max()])
    same = not set(of.readings).isdisjoint(reading_checksums(poses))
    if np.array_equal(of_prior, of_poses, equal_nan=True):
        same |= of.campaign == campaign.name
        if not of.readings and model.discrepancy is not None:
            kept = model.discrepancy.q[:, None]
            same |= bool((kept == poses.states.q_rad).all(axis=2).any(axis=1).all())
    if same or of.campaign in [member.name for member in campaign.campaigns]:
        raise CalibrationError(
            "a campaign is not its own prior: the same readings would count twice",
            where="prior",
            value=of.campaign,
            allowed="the model of another campaign of the same arm",
            remedy="omit the prior, or give the other campaign a name of its own; a copy of the "
            "readings is no other campaign",
        )


def prior_of(model: FittedModel, arm: Arm, payload: Payload | None) -> Prior:
    """Return the prior of an arm, which may carry another tool, by a fitted model.

    Raises:
        CalibrationError: when the model is of another arm, or its covariance is not known.
    """
    refuse_as_prior(model, arm)
    assert model.covariance is not None
    covariance = model.covariance[: len(model.x), : len(model.x)].copy()
    terms: list[Term] = []
    # of every parameter: its column in the model, -1 for one that the model does not determine, and
    # its standard deviation where nothing is known
    sources: list[int] = []
    sizes: list[float] = []
    for term in model.model.terms:
        columns = model.model.parameter_indices(term).tolist()
        transferred = term.elsewhere()
        if transferred is None:
            continue
        there = transferred.term
        if holds_weights(term):
            weights = _weights(term, arm, payload)
            if weights is None:
                continue
            column_of = dict(zip(term.columns, columns, strict=True))
            links = _columns_of_links(term)
            columns = [column_of[c] if c in links else -1 for c in weights.columns]
            there = weights
        elif not transferred.same_amounts:
            columns = [-1] * len(there.parameters)
        terms.append(there)
        sources += columns
        sizes += [
            GROUPS.bound_squares * each.scale if each.plausible is None else each.plausible
            for each in there.parameters
        ]
    index = np.array(sources, dtype=np.intp)
    new = index < 0
    mean = np.where(new, 0.0, model.x[index])
    known = covariance[np.ix_(index, index)]
    known[new] = known[:, new] = 0.0
    without_variance = np.diag(known) <= 0.0  # new, or at a bound
    known[without_variance, without_variance] = np.square(sizes)[without_variance]
    variances = _with_windups_at_bound(terms, without_variance & ~new, np.diag(known))
    known[without_variance, without_variance] = variances[without_variance]
    return Prior(model, tuple(terms), GaussianPrior(mean, known))


def _columns_of_links(term: Weights) -> set[int]:
    """Return the columns of weights that another tool does not change.

    Column 4 j is the mass of link j, the next three are its first moment. Of the last link only the
    mass is without the tool.
    """
    return {column for column in term.columns if column <= 4 * (term.n - 1)}


def _with_windups_at_bound(terms: Sequence[Term], held: Mask, variances: Array) -> Array:
    """Return variances (k,), with those of windups that a fit held at a bound estimated.

    The poses would have shown a windup there about as well as those of the other joints, so these
    have at most the median variance of the others.
    """
    springs = np.array(
        [role in ("windup", "cubic") for term in terms for role in term.roles], dtype=bool
    )
    others = springs & ~held
    if others.any():
        usual = float(np.median(variances[others]))
        variances = np.where(springs & held, np.minimum(usual, variances), variances)
    return variances


def refuse_as_prior(model: FittedModel, arm: Arm) -> None:
    """Refuse a prior that is a model of another arm, or one without covariance.

    Raises:
        CalibrationError: see `refuse_another_arm`; or when there is no covariance.
    """
    refuse_another_arm(model, arm)
    if model.covariance is None:
        raise CalibrationError(
            "the covariance of the prior is not known",
            where="prior",
            value=model.arm.name,
            allowed="a model with the file of its covariance beside it",
            remedy="copy model.covariance.npz together with model.yaml, or export it again",
        )


def refuse_another_arm(
    model: FittedModel, arm: Arm, where: str = "prior", called: str = "the prior"
) -> None:
    """Refuse a model of another arm.

    Args:
        where, called: parameter that it is, and what it is called in the refusal.

    Raises:
        CalibrationError: naming the arms, or the rows that differ.
    """
    layout = ("prismatic", "theta_rad", "d_m", "a_m", "alpha_rad", "beta_rad")
    same = model.arm.n == arm.n and model.arm.convention == arm.convention
    differs = [
        name
        for name in layout
        if not same
        or not np.allclose(getattr(model.arm, name), getattr(arm, name), 0.0, UNKNOWNS.same_length)
    ]
    what, value = f"{called} is a model of another arm", model.arm.name
    if model.arm.name != arm.name:
        allowed = f"a model of {arm.name}"
        remedy = (
            "give a model of the arm that was measured; where it is one arm under two names, give "
            "both descriptions the same name"
        )
    elif differs:
        value = f"{model.arm.name}; its {', '.join(differs)} differ"
        allowed = f"a model of {arm.name} with the same nominal rows"
        remedy = "give a model of the arm that was measured"
    else:
        return
    raise CalibrationError(what, where=where, value=value, allowed=allowed, remedy=remedy)


def _weights(term: Weights, arm: Arm, payload: Payload | None) -> Weights | None:
    """Return the weights that are uncertain with another tool; None where there are none."""
    if payload is None:
        return None
    if _columns_of_links(term):
        weights = Weights.about(arm, weight_sizes(arm, payload))
        if term.held is not None:  # stiffness is relative to weights as heavy as these
            size = dict(zip(weights.columns, weights.sizes, strict=True))
            sizes = tuple(size.get(column, 0.0) for column in term.columns)
            weights = replace(term, sizes=sizes)
        return replace(weights, unknown_tool=not payload.known)
    return next(iter(unknown_tool(arm, payload)), None)


def calibrate_from(
    prior: Prior,
    arm: Arm,
    observations: Observations,
    start: Start,
    payload: Payload | None = None,
    options: CalibrationOptions | None = None,
) -> calibrate.GeneralCalibration:
    """Calibrate an arm with a fitted model of it as prior.

    What moved since is searched in rounds: the prior is widened along what the last fit shows to
    have moved, and the arm is fitted again. With few readings the smallest set of changes that
    explains them is sought in place of that. Readings that contradict the result all the same free
    the whole arm.

    Raises:
        CalibrationError: when there are too few poses to find base and tool.
    """
    options = options or CalibrationOptions()
    model, expected = Model(prior.model.model.chain, prior.terms), prior.expected
    unknowns = choose_unknowns(arm, options.tolerances, observations.measured, start)
    states, source = with_torques(model, expected.mean, observations.states, payload)
    fitted = partial(fit, robust=options.general.robust, max_iterations=options.max_iterations)
    posed = observations.with_states(states)

    def of_prior(unknowns: ChosenUnknowns) -> FrameFit:
        problem, x_start = with_unknown_frames(model, expected.mean, unknowns, start, posed)
        check_enough(problem, known=len(expected.mean))
        return FrameFit(problem, x_start, fitted(problem, x_start, expected=expected))

    problem, x_start, found = fit_with_targets_shown(unknowns, start, of_prior)
    possible = hypotheses(arm, prior.terms, expected.mean, expected.covariance)
    anew, frames = everything(possible), len(problem.parameters) - len(expected.mean)
    few = problem.readings < GROUPS.few_readings * (len(anew.columns) + frames)
    moved = _released(prior, problem, found, possible, fitted, few=few)
    residual_m, stated_m = _residual_m(moved.found, observations)
    if residual_m > GROUPS.contradicted_ratio * stated_m and not few:
        freed = prior.expected.widened(anew.directions)
        fit_of_new_arm = fitted(problem, x_start, expected=freed)
        if _residual_m(fit_of_new_arm, observations)[0] < GROUPS.explained_share * residual_m:
            moved = _Released((MovedPart(anew, 1.0, 0.0),), freed, fit_of_new_arm)
    found = moved.found
    if source == "masses":
        about = partial(fitted, expected=moved.expected)
        problem, found = calibrate.at_rest(problem, found, observations.states, payload, about)
    unknown = len(anew.columns) + frames if few else None
    return calibrate.GeneralCalibration(
        problem=problem,
        x_start=x_start,
        start=start,
        redundant=unknowns.redundant,
        torques_from=source,
        payload=payload,
        settled={},
        fit=found,
        prior=_changed(prior, problem, found, moved.parts, possible, unknown),
    )


class _Released(NamedTuple):
    """A fit about a prior that was widened along what moved."""

    parts: tuple[MovedPart, ...]  # what moved
    expected: GaussianPrior  # the prior, widened
    found: GeneralSolution


def _released(
    prior: Prior,
    problem: Problem,
    found: GeneralSolution,
    possible: Sequence[Hypothesis],
    fitted: Callable[..., GeneralSolution],
    *,
    few: bool,
) -> _Released:
    """Search what moved, in rounds, each about the fit with what the one before found.

    Args:
        found: the fit about the prior as it is.
        possible: what may have moved.
        fitted: fits a problem from a start, about an expected prior.
        few: whether the readings are so few that the smallest set of changes is sought.
    """
    parts: tuple[MovedPart, ...] = ()
    expected = prior.expected
    for _ in range(GROUPS.most_rounds):
        before = parts
        if few:
            at = problem, found.x, np.sqrt(found.weights), prior.expected
            parts = smallest_set(Misfit.of_poses(*at, prior.model.discrepancy), possible)
        else:
            parts = sought(_disagreement(found, expected, prior.expected), possible)
        if [each.name for each in parts] == [each.name for each in before]:
            return _Released(before, expected, found)
        expected = prior.expected
        for each in parts:
            expected = expected.widened(each.directions)
        found = fitted(problem, found.x, expected=expected)
    return _Released(parts, expected, found)


def _disagreement(
    found: GeneralSolution, expected: GaussianPrior, prior: GaussianPrior
) -> Gaussian:
    """Return the disagreement of the readings with a prior, by a fit under a wider one of its mean.

    The precision of the readings is that of the fit without its prior's. Parameters that the fit
    held at a bound show nothing.
    """
    k = len(prior.mean)
    of_fit = GaussianPrior(found.x[:k], found.covariance[:k, :k] / found.widening**2)
    free = np.diag(of_fit.covariance) > 0.0
    of_fit, expected, prior = (each.marginal(free) for each in (of_fit, expected, prior))
    of_readings = of_fit.precision - expected.precision
    covariance = np.linalg.inv(prior.precision + of_readings).astype(float)
    x = prior.mean + covariance @ of_fit.precision @ (of_fit.mean - prior.mean)
    return disagreement(prior, x, covariance).in_terms_of(np.eye(k)[free])


def _residual_m(found: GeneralSolution, observations: Observations) -> tuple[float, float]:
    """Return the standard deviation of a component by the fit, and as the instrument states it [m].

    It is that of the first kind of components, positions or distances.
    """
    kind, part = observations.measured.component_kinds[0]
    variances = np.diagonal(observations.measured.stated_covariance, axis1=1, axis2=2)[:, part]
    stated_m = float(np.sqrt(np.median(variances)))
    return float(np.hypot(found.scatter.get(kind, 0.0), stated_m)), stated_m


def _changed(
    prior: Prior,
    problem: Problem,
    found: GeneralSolution,
    released: Sequence[MovedPart],
    possible: Sequence[Hypothesis],
    unknown: int | None,
) -> PriorPart:
    """Return what moved, by how much it differs from the prior, and a line that says so.

    Args:
        unknown: number of unknowns of a new arm, where the readings are too few for it; else None.
    """
    mean, before = prior.expected.mean, np.diag(prior.expected.covariance)
    after, off = np.diag(found.covariance), found.x[: len(mean)] - mean
    moved, factor = [], 1.0
    anew = any(each.what.kind == EVERYTHING for each in released)
    for each in _clearest(possible, off, after) if anew else released:
        what = each.what
        if what.kind == MODEL_ERROR:
            factor += each.size**2
            continue
        by, std, unit = None, None, ""
        if len(what.columns) == 1:
            (k,) = what.columns
            by, std = float(off[k]), float(np.sqrt(before[k] + after[k]))
            unit = problem.parameters[k].unit
            if what.kind == STIFFNESS:
                by, std, unit = by / mean[k], std / mean[k], "1"
        moved.append(Moved(kind=what.kind, of=what.of, by=by, std=std, unit=unit, gain=each.gain))
    fitted_to = prior.model.fitted_to
    campaign = None if fitted_to is None else fitted_to.campaign
    sentences = list(map(_words, moved))
    if factor > 1.0:
        sentences.append(
            "links and springs changed by more than noise explains: their variances are "
            f"multiplied by {factor:.0f}, as under a model that lacks an effect"
        )
    if anew:
        sentences.insert(
            0, "more moved than can be separated: all joints, links and springs are anew"
        )
    few = "" if unknown is None or anew else _beyond_few(prior, problem, found, unknown)
    if few:
        sentences.append(few)
    elif not sentences and unknown is not None:
        sentences.append("these poses show nothing in it that moved")
    text = "; ".join(sentences) or "nothing in it moved, within its uncertainty"
    line = f"started from the model of {campaign or 'an unnamed campaign'}: {text}"
    return PriorPart(campaign=campaign, moved=tuple(moved), factor=factor, line=line)


def _beyond_few(prior: Prior, problem: Problem, found: GeneralSolution, unknown: int) -> str:
    """Return a sentence if few readings contradict the changes found; empty where they do not."""
    observations, discrepancy = problem.observations, prior.model.discrepancy
    residual_m, usual_m = _residual_m(found, observations)
    if discrepancy is not None:
        error_mm = discrepancy.error_at_mm(observations.states.q_rad)
        usual_m = float(np.hypot(usual_m, 1e-3 * np.sqrt(np.mean(error_mm**2))))
    if residual_m < GROUPS.unexplained_ratio * usual_m:
        return ""
    poses = int(np.ceil(unknown * len(observations) / problem.readings)) + 1
    return (
        f"the poses are off by {1e3 * residual_m:.2g} mm on each axis, which no few changes "
        f"explain: measure {poses} poses or more, to find all joints and links anew"
    )


def _clearest(possible: Sequence[Hypothesis], by: Array, variances: Array) -> list[MovedPart]:
    """Return the parameters of a new arm that moved by most of their standard uncertainties."""
    std = np.sqrt(np.maximum(variances, 0.0))
    sigmas = [
        (float(abs(by[k]) / std[k]), each)
        for each in possible
        if each.kind in (JOINT_ZERO, LINK, STIFFNESS)
        for k in each.columns
        if std[k] > 0.0
    ]
    clear = sorted(
        (pair for pair in sigmas if pair[0] > GROUPS.clear_errors), key=lambda pair: -pair[0]
    )
    return [MovedPart(each, 1.0, 0.5 * sigma**2) for sigma, each in clear[: GROUPS.most_named]]


def _words(moved: Moved) -> str:
    """Return in words what moved, by how much, with its interval of 95 %."""
    what = {JOINT_ZERO: "the zero of ", STIFFNESS: "the stiffness of "}.get(moved.kind, "")
    if moved.by is None or moved.std is None:
        return f"{what}{moved.of} changed"
    if moved.kind == STIFFNESS:
        part = (
            f"{100.0 * moved.by:+.0f} % (95 % interval ±{100.0 * HALF_WIDTH_95 * moved.std:.0f} %)"
        )
        return f"the windup of {moved.of} changed by {part}"
    times, unit = {"rad": (1e3, "mrad"), "m": (1e3, "mm")}.get(moved.unit, (1.0, moved.unit))
    by, half = times * moved.by, HALF_WIDTH_95 * times * moved.std
    return f"{what}{moved.of} moved by {by:+.3f} {unit} (95 % interval ±{half:.3f} {unit})"
