"""Verdicts with other findings: the model is fitted again, and its effects are checked anew.

A name that does not pass becomes an unexplained part, with the reason in words.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

from pa10cal.arm.statics import PoseStates
from pa10cal.discovery.credible_amounts import reasons_against_amounts, surely_negative
from pa10cal.discovery.finding import Finding, label_of
from pa10cal.discovery.rules import NAMES
from pa10cal.discovery.verdict import Scorer, Verdict
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.results.discovery import Unexplained
from pa10cal.terms.effects.effect import Effect

S = TypeVar("S", bound=Scorer)


def with_findings(found: Verdict[S], findings: Sequence[Finding]) -> Verdict[S]:
    """Return a verdict with these findings and their parameters, the model fitted again.

    Parameters and the gap are those of the new fit, in which nothing is `predicted` or in `doubt`:
    both are of the fit before. All else stays as the verdict has it: what has no name, what these
    data cannot show, and limits within which the model holds.

    Args:
        found: the verdict.
        findings: some of its findings, each with its own effect or one of its alternatives.

    Raises:
        ValueError: when a finding is there twice.
    """
    effects = [each.effect for each in findings]
    if twice := [effect for effect in effects if effects.count(effect) > 1]:
        raise ValueError(f"{label_of(twice[0], None)} is among the findings twice")
    scorer = found.scorer.refitted(tuple(effects), found.findings)
    held_out = found.prepared.held_out
    reported = [scorer.extended.reported(each.effect, scorer.covariance) for each in findings]
    return replace(
        found,
        scorer=scorer,
        findings=tuple(
            replace(each, x=x, covariance=covariance)
            for each, (x, covariance) in zip(findings, reported, strict=True)
        ),
        train=scorer.gap_on(scorer.fitted_poses(found.prepared), found.train),
        holdout=None if held_out is None else scorer.gap_on(held_out, found.holdout),
        predicted=None,
        doubt=None,
    )


def without_names(found: Verdict[S], reasons: Mapping[Finding, str]) -> Verdict[S]:
    """Return a verdict without some names, which become unexplained parts for the reasons given.

    The model is fitted again, and its mean error is reported of these parts.

    Raises ValueError for a name that the verdict does not have.
    """
    gone = [finding_of(found, finding.effect).effect for finding in reasons]
    negative = [surely_negative(effect, found.model) for effect in gone]
    found = with_findings(found, [one for one in found.findings if one.effect not in gone])
    left_mm = found.train.after.mean_mm
    unknown = (
        no_name(finding, left_mm, why).model_copy(update={"below_zero": below_zero})
        for (finding, why), below_zero in zip(reasons.items(), negative, strict=True)
    )
    return replace(found, unexplained=(*found.unexplained, *unknown))


def no_name(finding: Finding, left_mm: float, why: str) -> Unexplained:
    """Return a finding that is not named as an unexplained part, with the mean error without it."""
    said = f"{label_of(finding.effect, None)} fits best, but is not named: {why}"
    return Unexplained(of=finding.of, form=finding.id, shared_error_mm=left_mm, why=said)


def too_many_others(count: int) -> str:
    """Return that an effect has too many alternatives, as a reason."""
    return f"{count} other effect{'s explain' if count != 1 else ' explains'} the data as well"


def probably_nameless(finding: Finding) -> str:
    """Return that something without a name is likelier than a finding, as a reason."""
    return (
        "what has no name, or something of several effects, explains as much in its place "
        f"(probability {finding.explanations.none_of_these:.2f})"
    )


def instead(found: Verdict, finding: Finding, effect: Effect | None = None) -> tuple[Finding, ...]:
    """Return the findings, one of them replaced: that of `effect`, by default of the new one's.

    Raises ValueError if there is none of that effect.
    """
    old = finding_of(found, effect or finding.effect)
    return tuple(finding if one is old else one for one in found.findings)


def fitted_instead(found: Verdict[S], old: Finding, new: Finding) -> Verdict[S] | None:
    """Return the verdict with a finding in place of another; None if the new fit rules it out."""
    # A new fit accepts alternatives of findings only.
    with_alternative = replace(old, alternatives=(new.effect, *old.alternatives))
    allowing_new = replace(found, findings=instead(found, with_alternative))
    tried = with_findings(allowing_new, instead(found, new.with_proof_of(old), old.effect))
    now = finding_of(tried, new.effect)
    return None if any(unfit(now, tried.model, tried.states)) else tried


def finding_of(found: Verdict, effect: Effect) -> Finding:
    """Return the finding of an effect as the model fitted last has it.

    Raises ValueError if there is none.
    """
    for finding in found.findings:
        if finding.effect == effect:
            return finding
    raise ValueError(f"{label_of(effect, None)} is not among the findings")


def unfit(finding: Finding, model: FittedModel, states: PoseStates | None = None) -> Iterator[str]:
    """Yield why an effect cannot be named: by its amounts in a model, or by its alternatives.

    Args:
        finding: says which effect, and what explains the data as well; its numbers may be of an
            earlier fit and do not count.
        model: has the effect.
        states: poses at which the rotations that it causes must be possible; None for no check.
    """
    yield from reasons_against_amounts(finding.effect, model, states)
    if len(finding.alternatives) > NAMES.most_alternatives:
        yield too_many_others(len(finding.alternatives))
