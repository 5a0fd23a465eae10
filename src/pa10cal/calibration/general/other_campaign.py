"""Calibration with a fitted model of the arm as prior: after a crash, a new tool, in a new cell.

Links, springs and effects of the arm have the model's values and covariance as prior; base, tool
and targets are free. That covariance holds noise alone, so the readings decide how far the prior is
trusted: what moved, such as the zero of one joint, is found anew while the rest stays. Where all
parameters depart by more than noise, as under a model that lacks an effect, the prior is widened.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.calibration.general import calibrate
from pa10cal.calibration.general.fit import GeneralSolution, fit
from pa10cal.calibration.general.prior import Prior
from pa10cal.calibration.general.problem import check_enough, with_unknown_frames
from pa10cal.calibration.general.refit_frames import FrameFit, fit_with_targets_shown
from pa10cal.calibration.general.unknowns import ChosenUnknowns, choose_unknowns
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.rules import GROUPS
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
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Start
from pa10cal.results.calibration import Moved, PriorPart
from pa10cal.results.number_text import HALF_WIDTH_95
from pa10cal.terms.model import Model


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
