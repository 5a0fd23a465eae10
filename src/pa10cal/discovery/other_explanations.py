"""What a model knows of other explanations of its readings: of those likely, and of one unknown.

Both are of the verdict with its final names. They change no name, but what the model says of its
predictions.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pa10cal.discovery.field import with_field
from pa10cal.discovery.finding import Finding, is_named
from pa10cal.discovery.refitted_verdict import (
    fitted_instead,
    with_findings,
)
from pa10cal.discovery.rules import PROBABILITIES
from pa10cal.discovery.verdict import Verdict, is_sought
from pa10cal.fit.fitted import Otherwise
from pa10cal.fit.forward import moves_robot
from pa10cal.fit.levels import of_position
from pa10cal.terms.effects.effect import Effect


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
