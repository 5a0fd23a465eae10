"""A verdict with other findings than its search ended with: all is fitted anew."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

from pa10cal.discovery.finding import Finding
from pa10cal.discovery.verdict import Scorer, Verdict, label_of
from pa10cal.results.discovery import Unexplained
from pa10cal.terms.effects.effect import Effect

S = TypeVar("S", bound=Scorer)


def with_findings(found: Verdict[S], findings: Sequence[Finding]) -> Verdict[S]:
    """Return a verdict with these findings, all fitted anew, and their parameters with it.

    Args:
        found: the verdict.
        findings: some of its own, each with its own effect or one of its alternatives.
    """
    scorer = found.scorer.refitted(tuple(each.effect for each in findings), found.findings)
    held_out, floor_mm = found.prepared.held_out, found.noise_floor_mm
    reported = [scorer.extended.reported(each.effect, scorer.covariance) for each in findings]
    return replace(
        found,
        scorer=scorer,
        findings=tuple(
            replace(each, x=x, covariance=covariance)
            for each, (x, covariance) in zip(findings, reported, strict=True)
        ),
        train=scorer.gap_on(scorer.fitted_poses(found.prepared), floor_mm, found.train),
        holdout=None if held_out is None else scorer.gap_on(held_out, floor_mm, found.holdout),
    )


def instead(found: Verdict, finding: Finding, effect: Effect | None = None) -> tuple[Finding, ...]:
    """Return the findings, one in the place of that of an effect, or else of its own."""
    effect = effect or finding.effect
    return tuple(finding if one.effect == effect else one for one in found.findings)


def without_names(
    found: Verdict[S], reasons: Mapping[Finding, str], left_mm: float | None = None
) -> Verdict[S]:
    """Return a verdict, fitted anew, without some names: they are unexplained, for a reason.

    With the mean error [mm] that is left without them; None for that of the new fit.
    """
    gone = [finding.effect for finding in reasons]
    found = with_findings(found, [one for one in found.findings if one.effect not in gone])
    left_mm = found.train.after.mean_mm if left_mm is None else left_mm
    unknown = (no_name(finding, left_mm, why) for finding, why in reasons.items())
    return replace(found, unexplained=(*found.unexplained, *unknown))


def no_name(finding: Finding, left_mm: float, why: str) -> Unexplained:
    """Return what a finding is that fits best and is no name, by the mean error left without it."""
    said = f"{label_of(finding.effect, None)} fits best, but is not named: {why}"
    return Unexplained(of=finding.of, form=finding.id, shared_error_mm=left_mm, why=said)
