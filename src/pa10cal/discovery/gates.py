"""Acceptance checks of a verdict after the search: of every name, and of the verdict `none`.

An effect that fails is not named: the model is fitted again without it, and its part of the error
becomes unexplained.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from pa10cal.calibration.grade_evidence import most_stated
from pa10cal.calibration.rules import GRADES
from pa10cal.discovery.balancers import with_balancers
from pa10cal.discovery.credible_amounts import holds_zero
from pa10cal.discovery.field import with_field
from pa10cal.discovery.finding import Finding, Rival, is_named, name_of
from pa10cal.discovery.in_time import grows_instead
from pa10cal.discovery.no_harm import harmed, harmless, worse_than
from pa10cal.discovery.preparation import Prepared
from pa10cal.discovery.probabilities import with_levels_held_out, with_unknown_cause
from pa10cal.discovery.refitted_verdict import (
    finding_of,
    fitted_instead,
    instead,
    no_name,
    probably_nameless,
    unfit,
    with_findings,
    without_names,
)
from pa10cal.discovery.rules import NAMES, PROBABILITIES
from pa10cal.discovery.target_wander import wander_instead_of
from pa10cal.discovery.verdict import Scorer, Verdict, is_sought
from pa10cal.fit.fitted import Otherwise
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.forward import moves_robot
from pa10cal.fit.levels import of_position
from pa10cal.fit.position_errors import mean_noise_error_mm
from pa10cal.fit.uncertain_weights import open_unknowns
from pa10cal.observe.observations import Observations
from pa10cal.observe.time_order import covariates, measured_again, slow_joints
from pa10cal.results.discovery import Unexplained
from pa10cal.terms.effects.arrivals import AlongMove, ArrivalError
from pa10cal.terms.effects.context import turning_joints
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint import Backlash, GearRatioError
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.effects.over_time import BaseDrift, ThermalGrowth
from pa10cal.terms.effects.readings import Scale
from pa10cal.terms.effects.slide import SlideScale
from pa10cal.terms.statement_faults import is_fault
from pa10cal.terms.weights import holds_weights

S = TypeVar("S", bound=Scorer)

#: Grades of the calibration that rule out the verdict `none`.
AGAINST_NONE = ("suspect_input", "not_converged")
#: The same where repeats show the noise. Without repeats the grade `incomplete` rests on a stated
#: uncertainty, which may be off by `names.agree_ratio`.
AGAINST_NONE_BY_REPEATS = (*AGAINST_NONE, "incomplete")


def gated(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict with names that pass the checks, or a `none` that passes its own."""
    found = _with_names_that_pass(with_balancers(with_levels_held_out(found)))
    found = _with_one_kind(_with_likeliest_names(found))
    found = _without_unproven_statements(_without_unlikely_names(found))
    found = _without_names_that_move_nothing(_with_other_leads(with_cable_torques(found)))
    if found.verdict == "none" and (reasons := tuple(reasons_against_none(found))):
        why = f"nothing was found beside the calibrated model, yet {'; '.join(reasons)}"
        unknown = Unexplained(
            of=None, form=None, shared_error_mm=found.train.after.mean_mm, why=why
        )
        found = replace(found, unexplained=(unknown,))
    return found


def _with_likeliest_names(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict in which likelier rivals replace names, if they fit as well.

    Probabilities are linear about the calibrated model, so the new fit decides.
    """
    for finding in found.effects:
        judged = with_unknown_cause(found, finding)
        likely = [(effect, p) for effect, p in judged.explanations.named if is_named(effect)]
        if not is_named(finding.effect) or not likely:
            continue
        best, probability = likely[0]
        held = {name_of(other.effect) for other in found.findings}
        rivals = {name_of(rival.effect) for rival in finding.rivals}
        likelier = probability > NAMES.likelier * judged.probability
        if not likelier or name_of(best) in held or name_of(best) not in rivals:
            continue
        tried = fitted_instead(found, finding, finding.exchanged_for(best))
        most_mm = NAMES.worse_ratio * found.train.after.rms_mm
        if tried is not None and tried.train.after.rms_mm <= most_mm:
            found = tried
    return found


def _with_one_kind(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict in which names are of a kind that was found elsewhere, if as likely.

    Wrong leads of three axes are also those of two and one factor for all: three effects of one
    kind are told.
    """
    for effect in [finding.effect for finding in found.effects if is_named(finding.effect)]:
        finding = finding_of(found, effect)
        held = {other.effect for other in found.effects}
        kinds = {other.id for other in found.effects if other.effect != effect}
        judged = with_unknown_cause(found, finding)
        least = NAMES.as_likely * judged.probability
        as_likely = [other for other, p in judged.explanations.named if p >= least]
        of_a_kind = [other for other in as_likely if other.id in kinds and other not in held]
        if effect.id not in kinds and of_a_kind and is_named(of_a_kind[0]):
            found = fitted_instead(found, finding, finding.exchanged_for(of_a_kind[0])) or found
    return found


def _with_names_that_pass(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict in which names that fail are replaced by alternatives, or withdrawn."""
    for effect in [finding.effect for finding in found.effects if is_named(finding.effect)]:
        finding = finding_of(found, effect)
        reasons = _reasons_against(found, finding)
        if not reasons:
            found = _robot_in_place_of_instrument(found, finding)
            continue
        if finding.id == Backlash.id and found.context.commanded:
            finding = _or_arrival_error(found, finding)
            found = replace(found, findings=instead(found, finding))
        stands_in = _logged_late(found, finding)
        stands_in = stands_in or _alternative(found, finding, finding.alternatives)
        found = stands_in or _withdrawn(found, finding, reasons)
    return _still_passing(found)


def _or_arrival_error(found: Verdict, finding: Finding) -> Finding:
    """Return lost motion with an arrival error among its alternatives, first if it was not there.

    Where positions are commanded, a controller may stop before or beyond its command: unlike lost
    motion, an arrival error can have either sign.
    """
    stops = ArrivalError(finding.of, found.context.campaigns)
    if stops in finding.alternatives:
        return finding
    return replace(finding, alternatives=(stops, *finding.alternatives))


def _logged_late(found: Verdict[S], finding: Finding) -> Verdict[S] | None:
    """Return the verdict with a joint that is logged at another instant in place of lost motion.

    Lost motion leaves a joint behind its motor. One that stands further along its move than logged
    was logged before it came to rest, or its log lags behind: that error grows with the move, and
    has to leave no more of the errors. None for lost motion of the sign that it can have.
    """
    arm, moves_known = found.context.arm, found.states.move_share is not None
    if finding.id != Backlash.id or found.context.commanded or not moves_known:
        return None
    joint = finding.effect.arriving[0]
    if finding.x[0] >= 0.0 or arm.prismatic[joint - 1]:
        return None
    late = AlongMove(finding.of, (joint,), found.context.campaigns)
    others = tuple(each for each in finding.alternatives if each != late)
    tried = fitted_instead(found, finding, replace(finding, effect=late, alternatives=others))
    worse = tried is None or tried.train.after.rms_mm > found.train.after.rms_mm
    return None if worse else tried


def _still_passing(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict without names that fail since others were replaced or withdrawn."""
    names = [finding for finding in found.effects if is_named(finding.effect)]
    for finding in names:
        if reasons := _reasons_against(found, finding):
            return _still_passing(_withdrawn(found, finding, reasons))
    return found


def _reasons_against(found: Verdict[S], finding: Finding) -> tuple[str, ...]:
    """Return why a finding of a verdict cannot be named; empty where it can."""
    by_fit = unfit(finding, found.model, found.states)
    return (
        *by_fit,
        *confounded_with_order(finding, found.prepared),
        *drift_of_single_targets(finding.effect, found.model, found.prepared.trusted),
        *drift_of_a_growing_arm(finding.effect, found),
    )


def _withdrawn(found: Verdict[S], finding: Finding, reasons: Sequence[str]) -> Verdict[S]:
    """Return the verdict without a name, its part taken up by the model or else unexplained."""
    return _without_if_replaceable(found, finding, reasons) or without_names(
        found, {finding: "; ".join(reasons)}
    )


def _without_if_replaceable(
    found: Verdict[S], finding: Finding, reasons: Sequence[str]
) -> Verdict[S] | None:
    """Return the verdict without an effect that the rest of the model can replace, else None.

    The amount of such an effect is not significant, and poses are predicted no worse without it by
    the new fit, so that nothing becomes unexplained.
    """
    if set(reasons) - set(holds_zero(finding.effect, found.model)):
        return None
    rest = [other for other in found.findings if other.effect != finding.effect]
    without = with_findings(found, rest)
    most_mm = NAMES.worse_ratio * found.train.after.rms_mm
    worse = worse_than(without.trusted_holdout, found.trusted_holdout)
    return None if worse or without.train.after.rms_mm > most_mm else without


def _without_unlikely_names(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict without names that are less likely than something without a name.

    A name stays if held-out poses are predicted worse without it. Of an effect of the instrument
    these readings are no judge: they are false as it says, or the base is moved for nothing.
    """
    names = [with_unknown_cause(found, name) for name in found.findings if is_named(name.effect)]
    for finding in sorted(names, key=lambda name: name.probability):
        if not finding.is_probably_nameless:
            continue
        why = probably_nameless(finding)
        without = without_names(found, {finding_of(found, finding.effect): why})
        held_out = found.trusted_holdout
        worse_without = not harmed(held_out) and worse_than(without.trusted_holdout, held_out)
        if not worse_without or finding.effect.error_of == "readings":
            found = without
    return found


def _without_unproven_statements(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict that tells no statement about weights as wrong unless it surely is.

    Whoever corrects a right one spoils the file. What it explained becomes unexplained.
    """
    passed = found
    for effect in [each.effect for each in found.findings if is_fault(each.effect)]:
        finding = finding_of(passed, effect)
        if reasons := tuple(_reasons_against_statement(passed, finding)):
            passed = without_names(passed, {finding: "; ".join(reasons)})
    return found if passed is found else _still_passing(passed)


def _reasons_against_statement(found: Verdict[S], finding: Finding) -> Iterator[str]:
    """Yield why a statement about weights is not told as wrong."""
    std = np.sqrt(np.maximum(np.diag(finding.covariance), np.finfo(float).tiny))
    errors = float(np.abs(finding.x / std).max())
    if errors < NAMES.statement_errors:
        yield f"it is {errors:.1f} standard errors from what is stated"
    probability = with_unknown_cause(found, finding).probability
    if probability < PROBABILITIES.nameless:
        yield f"other causes are likelier (probability {1.0 - probability:.2f} together)"
    if found.prepared.torques == "logged":  # these show it, and poses do not
        return
    rest = [each for each in found.findings if each.effect != finding.effect]
    without_mm = with_findings(found, rest).train.after.rms_mm
    left_mm, noise_mm = found.train.after.rms_mm, found.train.noise_rms_mm
    if without_mm**2 - left_mm**2 < left_mm**2 - noise_mm**2:
        yield (
            f"it explains less ({without_mm:.3g} mm without it, {left_mm:.3g} mm with it) than "
            f"what is left beyond the noise of {noise_mm:.3g} mm"
        )


def _without_names_that_move_nothing(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict that does no harm, without names that reduce no error.

    They reduce none if the model falls back on the calibrated one everywhere, and the errors at the
    poses fitted are not significantly smaller either.
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


def confounded_with_order(finding: Finding, campaign: Prepared) -> Iterator[str]:
    """Yield why a drift cannot be named: the poses came in the order of a joint or a rail."""
    states, slides = campaign.readings.states, campaign.baseline.arm.prismatic
    if finding.id != BaseDrift.id or measured_again(campaign.readings):
        return
    slow = slow_joints(states)
    along = [str(by) for by in covariates(states, slides) if by.joint and slow[by.joint - 1]]
    if along:
        joints = " and ".join(along)
        yield f"the order of the poses follows {joints}, whose error may look the same"


def drift_of_single_targets(
    effect: Effect, model: FittedModel, readings: Observations
) -> Iterator[str]:
    """Yield why a drift cannot be named: targets wander as much, each by itself.

    Args:
        model: the model with the effect.
        readings: single readings.
    """
    if effect.id != BaseDrift.id or effect not in model.model.terms:
        return
    residual = model.compared(readings).residual
    if (found := wander_instead_of(effect, model, readings, residual)) is not None:
        yield (
            f"readings of single targets wander in time by {found.rms_mm:.2g} mm, each by itself, "
            "as much as it moves all of them together"
        )


def drift_of_a_growing_arm(effect: Effect, found: Verdict[S]) -> Iterator[str]:
    """Yield why a drift cannot be named: an arm that grows fits as well, no temperature known."""
    if effect.id != BaseDrift.id or effect not in found.model.model.terms:
        return
    growths = ThermalGrowth.everywhere(found.context)
    if any(grows_instead(effect, each, found.model, found.prepared.trusted) for each in growths):
        yield (
            "an arm that grows as it warms up explains as much or more, and no temperature was "
            "logged; log it"
        )


def with_cable_torques(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict in which a pull at a joint is an alternative of its gear ratio error.

    A cable that pulls like a spring turns a compliant joint in proportion to its angle, as a wrong
    gear ratio does; only logged torques distinguish them. A pull is no effect of the vocabulary
    and is represented by the map of the joint. Sliding joints have none.
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


def _with_other_leads(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict in which leads beside a scale have those of all other axes as rivals.

    Only differences of leads are identifiable beside a scale, of the instrument or of all axes that
    slide: a factor of three axes and the lead of one are two wrong leads of the others, too.
    """
    scales = [each for each in found.findings if each.id in (SlideScale.id, Scale.id)]
    leads = [each for each in found.findings if getattr(each.effect, "slides", False)]
    slides = {f"joint {k}" for k in np.flatnonzero(found.context.arm.prismatic) + 1}
    others = sorted(slides - {lead.of for lead in leads})
    if not scales or not leads or not others or len(others) > len(scales) + len(leads):
        return found
    equal = [
        Rival(GearRatioError(of, slides=True), np.zeros(1), 1.0 / len(others)) for of in others
    ]
    for finding in (*scales, *leads):
        known = {name_of(rival.effect) for rival in equal}
        rest = [rival for rival in finding.rivals if name_of(rival.effect) not in known]
        wider = replace(finding, rivals=(*rest, *equal))
        found = replace(found, findings=instead(found, wider))
    return found


def _alternative(
    found: Verdict[S],
    finding: Finding,
    tried: Sequence[Effect],
    also_listed: Sequence[Effect] = (),
) -> Verdict[S] | None:
    """Return the verdict with the first effect that passes in a finding's place, or None.

    The others become its alternatives, and those that are `also_listed`.
    """
    held = {other.effect for other in found.findings}
    for effect in tried[: NAMES.most_alternatives]:
        if not is_named(effect) or effect in held:
            continue
        rest = tuple(other for other in (*tried, *also_listed) if other != effect)
        stands_in = replace(finding, effect=effect, alternatives=rest)
        if (fitted := fitted_instead(found, finding, stands_in)) is not None:
            return fitted
    return None


def _robot_in_place_of_instrument(found: Verdict[S], finding: Finding) -> Verdict[S]:
    """Return the verdict with an effect of the robot in place of the instrument's, if one fits.

    Predictions omit effects of the instrument, and a wrong one falsifies the geometry fitted with
    it: so the robot's effect is named where both fit.
    """
    if finding.effect.error_of != "readings":
        return found
    robots = tuple(effect for effect in finding.alternatives if effect.error_of != "readings")
    others = tuple(effect for effect in finding.alternatives if effect.error_of == "readings")
    listed = (*others, finding.effect)
    return _alternative(found, finding, robots, listed) or found


def with_other_readings(found: Verdict) -> Verdict:
    """Return a verdict whose model knows what it predicts if instrument or log err otherwise.

    That is where an effect of the robot and one of the instrument, or of the log, explain the
    readings alike: predictions hold the first alone. An effect of the instrument that is not sure
    may not be there, and the geometry is then false that was fitted beside it. Of several such
    explanations it is the likeliest. So with effects of a joint's position where it stood at few
    places, and these are alike: between them predictions differ by as much as the likeliest other
    does, unless it is the effect named.
    """
    if not is_sought(found):
        return found
    pairs: list[tuple[float, Finding, Effect | None]] = [
        (probability, finding, other)
        for finding in found.findings
        for other, probability in finding.explanations.named
        if _whose_error(other) != _whose_error(finding.effect)
        and probability >= PROBABILITIES.other_readings
        and is_named(finding.effect)
        and is_named(other)
    ]
    pairs += [
        (may_be_right, finding, None)
        for finding in found.findings
        if finding.effect.error_of == "readings"
        and is_named(finding.effect)
        and (may_be_right := _readings_may_be_right(finding)) > 1.0 - PROBABILITIES.surely
    ]
    pairs += [
        (1.0 - finding.explanations.probability(finding.effect), finding, other)
        for finding in found.findings
        if is_named(finding.effect) and np.isfinite(finding.odds_by_levels)
        for other in others_of_position(finding)[:1]
    ]
    if not pairs:
        return found
    probability, finding, other = max(pairs, key=lambda pair: pair[0])
    about: Verdict | None
    if other is None:
        about = with_findings(found, [one for one in found.findings if one is not finding])
    else:
        about = fitted_instead(found, finding, finding.exchanged_for(other))
    if about is None:
        return found
    model = about.with_targets_off(about.scorer.extended.fitted())
    if found.predicted is not None:
        model = with_field(model, found.predicted.fit)
    model = replace(model, covariance=None)
    return replace(found, otherwise=Otherwise(model, probability))


def with_doubt(found: Verdict) -> Verdict:
    """Return a verdict that knows what its model lacks if an effect named is none of those known.

    Of an error without a name an effect is an imitation: it then predicts other poses no better
    than the model without it, as far as is known. Of several such effects it is the least sure.
    """
    # A field is fitted beside all effects. Of the instrument's `otherwise` says more.
    if not is_sought(found) or found.predicted is not None:
        return found
    doubted = [
        finding
        for finding in found.findings
        if is_named(finding.effect)
        and moves_robot(finding.effect)
        and finding.explanations.none_of_these > 1.0 - PROBABILITIES.surely
    ]
    if not doubted:
        return found
    least_sure = max(doubted, key=lambda finding: finding.explanations.none_of_these)
    without = with_findings(found, [each for each in found.findings if each is not least_sure])
    lacks = without.model.discrepancy
    if lacks is None:
        return found
    return replace(found, doubt=(least_sure.explanations.none_of_these, lacks))


def others_of_position(finding: Finding) -> list[Effect]:
    """Return the likely other effects of the position of a finding's joint, the likeliest first."""
    return [
        other
        for other, probability in finding.explanations.named
        if other != finding.effect
        and other.of == finding.of
        and probability >= PROBABILITIES.least
        and of_position(other)
        and is_named(other)
    ]


def _readings_may_be_right(finding: Finding) -> float:
    """Return the probability that no error of the instrument is in the place of a finding."""
    of_readings = [p for effect, p in finding.explanations.named if effect.error_of == "readings"]
    return 1.0 - sum(of_readings)


def _whose_error(effect: Effect) -> str:
    """Return whose error an effect is, as far as predictions differ by it."""
    return "robot" if moves_robot(effect) else effect.error_of


def _origin(found: Verdict) -> str:
    """Return where the noise of a verdict comes from, in words without a reason."""
    return (found.noise_floor_from or "").partition(":")[0]


def _disagreements(found: Verdict) -> Iterator[str]:
    """Yield disagreements between errors, repeatability and stated uncertainty, in words."""
    train, holdout = found.train, found.trusted_holdout
    measured, floor_mm = train.poses.measured, train.noise_floor_mm
    # Residuals of the fit are smaller than errors by the parameters it takes up; predictions have
    # its uncertainty in addition.
    unknowns, components = open_unknowns(found.model.model), int(measured.components_seen.sum())
    fitted_share = min(unknowns / max(components, 1), GRADES.most_taken_share)
    compared = [
        ("the remaining error", train.after.mean_mm / np.sqrt(1.0 - fitted_share), floor_mm)
    ]
    if holdout is not None:
        expected_mm = float(np.hypot(holdout.noise_floor_mm, floor_mm * np.sqrt(fitted_share)))
        compared.append(("the held-out error", holdout.after.mean_mm, expected_mm))
    # Errors below the repeatability are not those of these readings. Errors below a stated
    # uncertainty cannot be seen, and need not be.
    by_repeats = found.noise_floor_from is None
    source = "the repeatability" if by_repeats else f"the noise by {_origin(found)}"
    for name, value_mm, expected_mm in compared:
        below = by_repeats and value_mm < expected_mm / NAMES.agree_ratio
        if below or value_mm > NAMES.agree_ratio * expected_mm:
            yield f"{name} is {value_mm:.3g} mm where {source} gives {expected_mm:.3g} mm"
    stated_mm = mean_noise_error_mm(measured, measured.stated_covariance)
    joints_mm = GRADES.joint_rad * measured.spread_mm
    most = most_stated(NAMES.agree_ratio, from_touches=measured.from_touches)
    too_small = stated_mm > most * floor_mm
    if too_small or floor_mm > NAMES.agree_ratio * np.hypot(stated_mm, joints_mm):
        yield (
            f"{source} is {floor_mm:.3g} mm where the stated uncertainty gives {stated_mm:.3g} mm"
        )


def reasons_against_none(found: Verdict) -> Iterator[str]:
    """Yield what speaks against the verdict that nothing is missing, in words."""
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
    by_repeats, grade = found.noise_floor_from is None, found.baseline.grade
    fitted = found.baseline.fitted_to
    shown = "" if fitted is None else fitted.outliers_show
    if grade == "incomplete" and shown:
        yield f"the calibration is {grade}, with suspected outliers: {shown}"
    elif grade in (AGAINST_NONE_BY_REPEATS if by_repeats else AGAINST_NONE):
        suspicions = () if fitted is None else fitted.suspicions
        yield ": ".join([f"the calibration is {grade}", *(str(each) for each in suspicions[:1])])
