"""Probabilities of findings in their verdict: that their cause is one that was not tried.

That may be so by the errors that remain, by what else was found at the same joint, and where the
joint stood at few positions only.
"""

from __future__ import annotations

from dataclasses import replace

from typing_extensions import TypeVar

from pa10cal.discovery.finding import Finding, is_named
from pa10cal.discovery.rules import PROBABILITIES
from pa10cal.discovery.verdict import Scorer, Verdict
from pa10cal.fit.levels import by_levels, levels_of_joints, of_position
from pa10cal.fit.rows_about_fit import RowsAboutFit
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.vocabulary import every_effect

S = TypeVar("S", bound=Scorer)
F = TypeVar("F", bound=Finding)


def with_likely_alternatives(found: Verdict) -> Verdict:
    """Return a verdict whose findings list every likely rival as an alternative."""
    findings = (with_unknown_cause(found, each) for each in found.findings)
    gives_way = (with_unknown_cause(found, each) for each in found.gives_way)
    return replace(
        found,
        findings=tuple(each.with_likely_alternatives() for each in findings),
        gives_way=tuple(each.with_likely_alternatives() for each in gives_way),
    )


def with_unknown_cause(found: Verdict, finding: F) -> F:
    """Return a finding with the probability that its cause is one that was not tried.

    Its proof may know it, by the error that would remain. Else it is larger where more than noise
    remains without a name. It is also larger where a machine that touches may read by the side from
    which it comes, and where the effect is larger than such effects are and weights pull at its
    joint: then another cause looks like it. So it is where something else would have to stiffen
    under weights: then what gives way is not in proportion to them, as a bearing with play is not.
    """
    if (by_errors := finding.proof.unknown_cause) is not None:
        unknown = by_errors.probability(found.train.noise_rms_mm)
    elif found.unexplained or found.over_noise:
        unknown = PROBABILITIES.unknown_beside
    else:
        unknown = PROBABILITIES.unknown
    unknown = max(unknown, 1.0 / (1.0 + finding.odds_by_levels))
    if (beside := _causes_beside(found, finding)) > 0:
        odds_of_one = PROBABILITIES.one_curve / PROBABILITIES.second ** (beside - 1)
        unknown = max(unknown, odds_of_one / (1.0 + odds_of_one))
    if finding.proof.weights is None and _stiffens(found, finding.effect):
        unknown = max(unknown, PROBABILITIES.unknown_beside)
    touched = found.prepared.readings.measured.from_touches
    if touched and finding.effect.of_moves:
        unknown = max(unknown, PROBABILITIES.machine_reverses)
    size = _plausible_sizes(found, finding.effect) / PROBABILITIES.usual_sizes
    odds = max(1.0, size) ** PROBABILITIES.size_power * unknown
    return replace(finding, unknown_probability=odds / (1.0 - unknown + odds))


def _stiffens(found: Verdict, effect: Effect) -> bool:
    """Return whether an effect gives way under weights, and something else stiffens under them.

    What does so has a compliance surely below zero, and no name for it.
    """
    kinds = {kind.id for kind in every_effect() if kind.bends or kind.yields}
    left = found.unexplained
    return effect.id in kinds and any(each.below_zero and each.form in kinds for each in left)


def _causes_beside(found: Verdict, finding: Finding) -> int:
    """Return how many other causes are named of errors of a joint's angle that are a curve of it.

    Eccentric and elliptic are one sensor. What needs several parts of a joint to err at once may be
    one curve without a name, as of a pack of cables that pulls. Lines of gears are no such curves.
    """
    own = finding.effect.curve_of
    if not own or not is_named(finding.effect):
        return 0
    causes = {each.effect.curve_of for each in found.findings if each.of == finding.of}
    return len(causes - {"", own})


def _plausible_sizes(found: Verdict, effect: Effect) -> float:
    """Return how many plausible sizes an effect of the model has; 0 where physics limits it.

    Or where nothing that weights cause looks like it: at a joint before the first one that lifts,
    whose axis is along gravity, the arm's weights turn nothing by the joint's angle.
    """
    extended = found.scorer.extended
    if not is_named(effect) or effect not in extended.effects:
        return 0.0
    lifts = found.context.lifts
    if lifts is not None and effect.of in (f"joint {joint}" for joint in range(1, lifts[0])):
        return 0.0
    limits = effect.limits_at(extended.at.arm.reach_m)
    if limits.values is not None or limits.turn_rad is not None:
        return 0.0
    return effect.size(extended.at.values_of(effect)[: effect.linear])


def with_levels_held_out(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict whose findings have their odds by levels of their joint, held out.

    Effects of one joint's position count together: each was fitted beside the others.
    """
    places = {each.of for each in found.findings if of_position(each.effect)}
    if not places:
        return found
    poses, model = found.train.poses, found.extended.fitted()
    joints = {
        f"joint {joint + 1}": (joint, levels)
        for joint, levels in enumerate(levels_of_joints(poses, model))
        if len(levels) and f"joint {joint + 1}" in places
    }
    if not joints:
        return found
    rows = RowsAboutFit.of(model, poses)
    odds = {
        place: by_levels(model, rows, poses, *of_joint).odds for place, of_joint in joints.items()
    }
    findings = tuple(
        replace(each, odds_by_levels=odds[each.of])
        if each.of in odds and of_position(each.effect) and not each.effect.at_knots
        else each
        for each in found.findings
    )
    return replace(found, findings=findings)
