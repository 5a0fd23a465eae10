"""Acceptance checks of a verdict after the search: of every name, and of the verdict `none`.

An effect that fails is not named: the model is fitted again without it, and its part of the error
becomes unexplained.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from pa10cal.discovery.against_drift import reasons_against_drift
from pa10cal.discovery.against_none import reasons_against_none
from pa10cal.discovery.balancers import with_balancers
from pa10cal.discovery.credible_amounts import holds_zero
from pa10cal.discovery.finding import Finding, Rival, is_named, name_of
from pa10cal.discovery.no_harm import harmed, harmless, worse_than
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
from pa10cal.discovery.verdict import Scorer, Verdict
from pa10cal.results.discovery import Unexplained
from pa10cal.terms.effects.arrivals import AlongMove, ArrivalError
from pa10cal.terms.effects.context import turning_joints
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint import Backlash, GearRatioError
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.effects.readings import Scale
from pa10cal.terms.effects.slide import SlideScale
from pa10cal.terms.statement_faults import is_fault

S = TypeVar("S", bound=Scorer)


def gated(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict with names that pass the checks, or a `none` that passes its own.

    The order matters: rivals are likely or not by all that is known of them, names are exchanged
    before any is withdrawn for want of probability, and that no harm is done is judged of the names
    that are left.
    """
    # what is known of findings and rivals besides the search
    found = with_balancers(with_levels_held_out(found))
    # each name by itself, then among its rivals, and the likeliest of them
    found = _with_one_kind(_with_likeliest_names(_with_names_that_pass(found)))
    found = _without_unproven_statements(_without_unlikely_names(found))
    # rivals that need no further fit, and held-out poses
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
        *reasons_against_drift(found, finding),
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
