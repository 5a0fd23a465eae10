"""Acceptance checks of a verdict after the search: of every name, and of the word `none`.

An effect that fails is no name: the model is fitted anew without it, and what it explained is
unexplained.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from scipy.special import chdtri

from pa10cal.arm.description import weights_known
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.calibration.health import most_stated
from pa10cal.calibration.rules import GRADES
from pa10cal.discovery.finding import Finding, Rival, name_of
from pa10cal.discovery.linear import mean_error_of_noise_mm
from pa10cal.discovery.no_harm import harmed, harmless
from pa10cal.discovery.other_numbers import COMPUTING
from pa10cal.discovery.preparation import Prepared
from pa10cal.discovery.rules import NAMES, PROBABILITIES
from pa10cal.discovery.verdict import (
    Scorer,
    Verdict,
    in_doubt,
    instead,
    is_named,
    no_name,
    with_findings,
    without_names,
)
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.uncertain_weights import open_unknowns
from pa10cal.observe.order import drivers, measured_again, slow_joints
from pa10cal.results.discovery import Unexplained
from pa10cal.results.record import HALF_WIDTH_95
from pa10cal.terms.effects.arrivals import ArrivalError
from pa10cal.terms.effects.effect import Effect, turning_joints
from pa10cal.terms.effects.joint import Backlash, GearRatioError
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.effects.over_time import BaseDrift
from pa10cal.terms.weights import holds_weights

S = TypeVar("S", bound=Scorer)

#: Grades of the calibration that rule out the verdict `none`.
AGAINST_NONE = ("suspect_input", "not_converged")
#: The same where repeats show the noise. Without repeats the grade `incomplete` rests on a stated
#: uncertainty, which may be off by `names.agree_ratio`.
AGAINST_NONE_BY_REPEATS = (*AGAINST_NONE, "incomplete")


def gated(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict whose names, or whose `none`, have passed the checks."""
    found = _without_unlikely_names(_with_likeliest_names(_with_names_that_pass(found)))
    found = _without_names_that_move_nothing(with_pulls(found))
    if found.verdict == "none" and (reasons := tuple(reasons_against_none(found))):
        why = f"no effect was found, yet {'; '.join(reasons)}"
        unknown = Unexplained(
            of=None, form=None, shared_error_mm=found.train.after.mean_mm, why=why
        )
        found = replace(found, unexplained=(unknown,))
    return found


def _with_likeliest_names(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict in which likelier rivals take the place of names, if they fit as well.

    Probabilities are by rows linear about the calibrated model; the new fit decides.
    """
    for finding in found.effects:
        known = in_doubt(found, finding).explanations
        likely = [(effect, p) for effect, p in known.named if is_named(effect)]
        if not is_named(finding.effect) or not likely:
            continue
        best, probability = likely[0]
        held = {name_of(other.effect) for other in found.findings}
        rivals = {name_of(rival.effect) for rival in finding.rivals}
        likelier = probability > NAMES.likelier * known.of(finding.effect)
        if not likelier or name_of(best) in held or name_of(best) not in rivals:
            continue
        tried = fitted_instead(found, finding, finding.about(best))
        most_mm = NAMES.worse_ratio * found.train.after.rms_mm
        if tried is not None and tried.train.after.rms_mm <= most_mm:
            found = tried
    return found


def fitted_instead(found: Verdict[S], old: Finding, new: Finding) -> Verdict[S] | None:
    """Return the verdict fitted anew with a finding in another's place; None if it is unfit."""
    # A new fit accepts alternatives of findings only.
    known = replace(old, alternatives=(new.effect, *old.alternatives))
    tried = replace(found, findings=instead(found, known))
    tried = with_findings(tried, instead(found, new, old.effect))
    now = next(finding for finding in tried.findings if finding.effect == new.effect)
    return None if any(unfit(now, tried.model, tried.states)) else tried


def _with_names_that_pass(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict without names that fail, each replaced by an alternative that passes."""
    for finding in found.effects:
        if not is_named(finding.effect):
            continue
        reasons = (*unfit(finding, found.model, found.states), *of_order(finding, found.prepared))
        if not reasons:
            found = _of_the_robot(found, finding)
            continue
        # Of joints that are commanded and not read back, a controller may stop short of its command
        # or beyond: either sign is possible, unlike that of lost motion.
        stops = ArrivalError(finding.of, found.context.campaigns)
        commanded = finding.id == Backlash.id and found.context.commanded
        if commanded and stops not in finding.alternatives:
            finding = replace(finding, alternatives=(stops, *finding.alternatives))
            found = replace(found, findings=instead(found, finding))
        found = (
            _alternative(found, finding)
            or _taken_up(found, finding, reasons)
            or without_names(found, {finding: "; ".join(reasons)})
        )
    return found


def _taken_up(found: Verdict[S], finding: Finding, reasons: Sequence[str]) -> Verdict[S] | None:
    """Return the verdict without an effect that the rest of the model, fitted anew, replaces.

    Its amount may as well be zero and poses are predicted no worse without it, so that nothing
    remains unexplained. None for any other effect.
    """
    if set(reasons) - set(holds_zero(finding.effect, found.model)):
        return None
    without = with_findings(found, [other for other in found.findings if other != finding])
    most_mm = NAMES.worse_ratio * found.train.after.rms_mm
    if without.train.after.rms_mm > most_mm or harmed(without.holdout, found.holdout):
        return None
    return without


def _without_unlikely_names(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict without names that are less likely than something without a name.

    A name that held-out poses need stays, with its probability.
    """
    names = [in_doubt(found, name) for name in found.findings if is_named(name.effect)]
    for finding in sorted(names, key=lambda name: name.explanations.of(name.effect)):
        if not finding.is_unlikely:
            continue
        why = (
            "what has no name, or something of several effects, explains as much in its place "
            f"(probability {finding.explanations.none_of_these:.2f})"
        )
        (now,) = (other for other in found.findings if other.effect == finding.effect)
        without = without_names(found, {now: why})
        held_out = found.trusted_holdout
        if harmed(held_out) or not harmed(without.trusted_holdout, held_out):
            found = without
    return found


def _without_names_that_move_nothing(found: Verdict[S]) -> Verdict[S]:
    """Return a harmless verdict, without names that remove no error.

    That is so if the model falls back on the calibrated one everywhere, and the poses of the fit
    are not significantly better by it either.
    """
    safe, names = harmless(found), [name for name in found.findings if is_named(name.effect)]
    if not safe.holds_nowhere or not names or found.train.reduction.interval95_mm[0] > 0.0:
        return safe
    before_mm, after_mm = found.train.before.mean_mm, found.train.after.mean_mm
    why = (
        f"it removes no error, {before_mm:.4g} mm before and "
        f"{after_mm:.4g} mm with it at the poses of the fit, and no less at others"
    )
    rest = [finding for finding in found.findings if finding not in names]
    safe = harmless(with_findings(found, rest))
    unknown = (no_name(name, safe.train.after.mean_mm, why) for name in names)
    return replace(safe, unexplained=(*safe.unexplained, *unknown))


def of_order(finding: Finding, campaign: Prepared) -> Iterator[str]:
    """Yield why a drift cannot be named: the poses came in the order of a joint or a rail."""
    states, slides = campaign.readings.states, campaign.baseline.arm.prismatic
    if finding.id != BaseDrift.id or measured_again(campaign.readings):
        return
    slow = slow_joints(states)
    along = [str(by) for by in drivers(states, slides) if by.joint and slow[by.joint - 1]]
    if along:
        joints = " and ".join(along)
        yield f"the order of the poses follows {joints}, whose error may look the same"


def with_pulls(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict in which a pull at a joint is an alternative of its gear ratio error.

    A cable that pulls like a spring turns a compliant joint in proportion to its angle, as a wrong
    gear ratio does; only logged torques distinguish them. A pull has no name: the map of the joint
    stands for it. Sliding joints have none.
    """
    turning = {f"joint {joint}" for joint in turning_joints(found.context)}
    if found.prepared.torques == "logged":
        return found
    held = {finding.of for finding in found.findings if finding.id == JointErrorMap.id}
    for finding in found.findings:
        if finding.id == GearRatioError.id and finding.of in turning - held:
            others = [e for e in finding.alternatives if e.id != JointErrorMap.id]
            map_of_joint = JointErrorMap(finding.of)
            rivals = [rival for rival in finding.rivals if rival.effect.id != JointErrorMap.id]
            pull = Rival(map_of_joint, np.zeros(1), PROBABILITIES.pull)
            wider = replace(finding, alternatives=(*others, map_of_joint), rivals=(*rivals, pull))
            found = replace(found, findings=instead(found, wider))
    return found


def _alternative(found: Verdict[S], finding: Finding) -> Verdict[S] | None:
    """Return the verdict with the first alternative of a finding that passes in its place."""
    held = {other.effect for other in found.findings}
    for other in finding.alternatives[: NAMES.most_alternatives]:
        if not is_named(other) or other in held:
            continue
        rest = tuple(effect for effect in finding.alternatives if effect != other)
        stands_in = replace(finding, effect=other, alternatives=rest)
        if (tried := fitted_instead(found, finding, stands_in)) is not None:
            return tried
    return None


def _of_the_robot(found: Verdict[S], finding: Finding) -> Verdict[S]:
    """Return the verdict with an effect of the robot in place of the instrument's, if one fits.

    Where both fit, the robot's is named: predictions leave out the instrument's, and geometry
    fitted beside a wrong one is off by as much.
    """
    if not finding.effect.falsifies_readings:
        return found
    robots = [effect for effect in finding.alternatives if not effect.falsifies_readings]
    others = [effect for effect in finding.alternatives if effect not in robots]
    first = replace(finding, alternatives=(*robots, *others, finding.effect))
    return _alternative(found, first) or found


def holds_zero(effect: Effect, model: FittedModel) -> Iterator[str]:
    """Yield why the amount of an effect of a model may as well be zero.

    Zero is in the 95 % confidence region of its linear parameters, or in the interval of each: if
    only a combination differs from zero, the poses do not determine the amounts, and other
    parameters depend on them. Scales of three axes are exempt from the latter: only their
    differences are determined, their mean is correlated with the arm's lengths.
    """
    linear = slice(0, effect.linear)
    if model.covariance is None:
        return
    columns = model.model.columns_of(effect)
    x, covariance = model.values_of(effect)[linear], model.covariance[columns, columns]
    covariance = covariance[linear, linear]
    scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    white = x / scale
    square = float(white @ np.linalg.pinv(covariance / np.outer(scale, scale)) @ white)
    each_counts = type(effect).report is Effect.report and not effect.by_differences
    if square < chdtri(effect.linear, 1.0 - NAMES.confidence):
        yield f"it is {np.sqrt(max(square, 0.0)):.1f} standard uncertainties from zero"
    elif each_counts and np.abs(white).max() < HALF_WIDTH_95:
        names = ", ".join(each.name for each in effect.reported[linear])
        yield f"the intervals of its {names} hold zero"


def unfit(finding: Finding, model: FittedModel, states: PoseStates | None = None) -> Iterator[str]:
    """Yield why an effect cannot be named, by the calibrated model with the effects found.

    Args:
        states: poses at which its turns must be possible; None for no such check.
    """
    effect = finding.effect
    linear = slice(0, effect.linear)
    x = model.values_of(effect)[linear]
    if effect.positive and x.min() < 0.0:
        names = ", ".join(finding.parameters)
        yield f"its {names} would be negative, which is not physical"
    if effect.possible is not None:
        low, high, why = effect.possible
        value, std = float(finding.x[0]), float(np.sqrt(max(finding.covariance[0, 0], 0.0)))
        if value + HALF_WIDTH_95 * std < low or value - HALF_WIDTH_95 * std > high:
            name, unit = effect.reported[0].name, effect.reported[0].unit
            yield f"its {name} would be {value:.2g} ± {HALF_WIDTH_95 * std:.1g} {unit}: {why}"
    size = effect.size(x)
    if size > NAMES.most_sizes and not _has_other_limits(effect, model):
        yield f"it would be {size:.0f} times as large as is plausible"
    limit = None if states is None else effect.turn_limit(model.arm.reach_m)
    if limit is not None and states is not None:
        yield from _turns_too_far(finding, model.values_of(effect), states, *limit)
    yield from holds_zero(effect, model)
    if len(finding.alternatives) > NAMES.most_alternatives:
        yield f"{len(finding.alternatives)} other effects explain the data as well"


def _has_other_limits(effect: Effect, model: FittedModel) -> bool:
    """Return whether the size of an effect is limited otherwise than by its plausible size.

    Compliances under weights that nobody stated are as uncertain as these: only turns are limited.
    """
    by_turn = effect.most_rad is not None and weights_known(model.arm).assumed
    return effect.possible is not None or by_turn


def _turns_too_far(
    finding: Finding, x: Array, states: PoseStates, most_rad: float, why: str
) -> Iterator[str]:
    """Yield why an effect cannot be named that turns joints or links farther than they can."""
    effect = finding.effect
    value, std = abs(float(finding.x[0])), float(np.sqrt(max(finding.covariance[0, 0], 0.0)))
    turn_rad = effect.turn_rad(states, x)
    # The turn is proportional to the first parameter, or to its inverse, a stiffness.
    least_rad = turn_rad * max(0.0, 1.0 - HALF_WIDTH_95 * std / max(value, COMPUTING.tiny))
    if least_rad > most_rad:
        yield f"it would turn by {1e3 * turn_rad:.0f} mrad: {why}"


def _disagreements(found: Verdict) -> Iterator[str]:
    """Yield where errors, repeatability and stated uncertainty do not agree."""
    train, holdout = found.train, found.trusted_holdout
    measured, floor_mm = train.poses.measured, train.noise_floor_mm
    # Residuals of the fit are smaller than errors by the parameters it takes up; predictions have
    # its uncertainty in addition.
    unknowns, components = open_unknowns(found.model.model), int(measured.components_seen.sum())
    taken = min(unknowns / max(components, 1), GRADES.most_taken_share)
    compared = [("the remaining error", train.after.mean_mm / np.sqrt(1.0 - taken), floor_mm)]
    if holdout is not None:
        expected_mm = float(np.hypot(holdout.noise_floor_mm, floor_mm * np.sqrt(taken)))
        compared.append(("the held-out error", holdout.after.mean_mm, expected_mm))
    # Errors below the repeatability are not those of these readings. Errors below a stated
    # uncertainty cannot be seen, and need not be.
    by_repeats = found.noise_floor_from is None
    for name, value_mm, expected_mm in compared:
        below = by_repeats and value_mm < expected_mm / NAMES.agree_ratio
        if below or value_mm > NAMES.agree_ratio * expected_mm:
            yield f"{name} is {value_mm:.3g} mm where the repeatability gives {expected_mm:.3g} mm"
    stated_mm = mean_error_of_noise_mm(measured, measured.stated_covariance)
    joints_mm = GRADES.joint_rad * measured.spread_mm
    most = most_stated(NAMES.agree_ratio, from_touches=measured.from_touches)
    too_small = stated_mm > most * floor_mm
    if too_small or floor_mm > NAMES.agree_ratio * np.hypot(stated_mm, joints_mm):
        yield (
            f"the repeatability is {floor_mm:.3g} mm where the stated uncertainty gives "
            f"{stated_mm:.3g} mm"
        )


def reasons_against_none(found: Verdict) -> Iterator[str]:
    """Yield why the verdict cannot be that nothing is missing."""
    yield from _disagreements(found)
    train = found.train
    weights = [term for term in found.model.model.terms if holds_weights(term)]
    before_mm, after_mm = train.before.mean_mm, train.after.mean_mm
    if (
        weights
        and after_mm < NAMES.most_left_share * before_mm
        and train.reduction.interval95_mm[0] > 0.0
    ):
        yield (
            f"the error falls from {before_mm:.3g} to {after_mm:.3g} mm if the weights may differ "
            "from the description: they do, or an effect of gravity is present (such as "
            "encoder_eccentricity of a joint that lifts); logged torques would show which"
        )
    torque = found.scorer.torque_test
    if (
        torque is not None
        and NAMES.most_torque_ratio < torque.F
        and torque.p_value < NAMES.torque_p_value
    ):
        yield (
            f"the logged torques differ from those of the weights: F = {torque.F:.3g}, "
            "as with wrong loads, masses or directions"
        )
    by_repeats = found.noise_floor_from is None
    if found.baseline.grade in (AGAINST_NONE_BY_REPEATS if by_repeats else AGAINST_NONE):
        yield f"the calibration is {found.baseline.grade}"
