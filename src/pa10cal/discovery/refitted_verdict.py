"""Verdicts with other findings: the model is fitted again, and its effects are checked anew."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from scipy.special import chdtri

from pa10cal.arm.description import weights_known
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.discovery.finding import Finding, label_of
from pa10cal.discovery.rules import NAMES
from pa10cal.discovery.tuning import COMPUTING
from pa10cal.discovery.verdict import Scorer, Verdict
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.results.discovery import Unexplained
from pa10cal.results.number_text import HALF_WIDTH_95
from pa10cal.terms.effects.effect import Effect, Limits

S = TypeVar("S", bound=Scorer)


def with_findings(found: Verdict[S], findings: Sequence[Finding]) -> Verdict[S]:
    """Return a verdict with these findings and their parameters, the model fitted again.

    Args:
        found: the verdict.
        findings: some of its findings, each with its own effect or one of its alternatives.
    """
    scorer = found.scorer.refitted(tuple(each.effect for each in findings), found.findings)
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
    )


def without_names(found: Verdict[S], reasons: Mapping[Finding, str]) -> Verdict[S]:
    """Return a verdict without some names, which become unexplained parts for the reasons given.

    The model is fitted again, and its mean error is reported of these parts.
    """
    gone = [finding.effect for finding in reasons]
    found = with_findings(found, [one for one in found.findings if one.effect not in gone])
    left_mm = found.train.after.mean_mm
    unknown = (no_name(finding, left_mm, why) for finding, why in reasons.items())
    return replace(found, unexplained=(*found.unexplained, *unknown))


def no_name(finding: Finding, left_mm: float, why: str) -> Unexplained:
    """Return a finding that is not named as an unexplained part, with the mean error without it."""
    said = f"{label_of(finding.effect, None)} fits best, but is not named: {why}"
    return Unexplained(of=finding.of, form=finding.id, shared_error_mm=left_mm, why=said)


def too_many_others(count: int) -> str:
    """Return that an effect has too many alternatives, as a reason."""
    return f"{count} other effects explain the data as well"


def probably_nameless(finding: Finding) -> str:
    """Return that something without a name is likelier than a finding, as a reason."""
    return (
        "what has no name, or something of several effects, explains as much in its place "
        f"(probability {finding.explanations.none_of_these:.2f})"
    )


def instead(found: Verdict, finding: Finding, effect: Effect | None = None) -> tuple[Finding, ...]:
    """Return the findings, one of them replaced: that of `effect`, by default of the new one's."""
    effect = effect or finding.effect
    return tuple(finding if one.effect == effect else one for one in found.findings)


def fitted_instead(found: Verdict[S], old: Finding, new: Finding) -> Verdict[S] | None:
    """Return the verdict with a finding in place of another; None if the new fit rules it out."""
    # A new fit accepts alternatives of findings only.
    known = replace(old, alternatives=(new.effect, *old.alternatives))
    tried = replace(found, findings=instead(found, known))
    tried = with_findings(tried, instead(found, new.with_proof_of(old), old.effect))
    now = finding_of(tried, new.effect)
    return None if any(unfit(now, tried.model, tried.states)) else tried


def finding_of(found: Verdict, effect: Effect) -> Finding:
    """Return the finding of an effect as the model fitted last has it."""
    return next(finding for finding in found.findings if finding.effect == effect)


def unfit(finding: Finding, model: FittedModel, states: PoseStates | None = None) -> Iterator[str]:
    """Yield why an effect cannot be named, by the extended model.

    Args:
        states: poses at which the rotations that it causes must be possible; None for no check.
    """
    effect = finding.effect
    linear = slice(0, effect.linear)
    x = model.values_of(effect)[linear]
    limits = effect.limits_at(model.arm.reach_m)
    if limits.positive and x.min() < 0.0:
        names = ", ".join(finding.parameters)
        yield f"its {names} would be negative, which is not physical"
    if limits.values is not None:
        yield from _beyond(finding, limits.values, limits.why)
    least = _least_size(effect, model)
    if least > NAMES.most_sizes and not _has_other_limits(limits, model):
        yield f"it would be {effect.size(x):.0f} times as large as is plausible"
    if states is not None and limits.turn_rad is not None:
        x_whole, most_rad = model.values_of(effect), limits.turn_rad
        yield from _turns_too_far(finding, x_whole, states, most_rad, limits.why)
    yield from holds_zero(effect, model)
    if len(finding.alternatives) > NAMES.most_alternatives:
        yield too_many_others(len(finding.alternatives))


def _beyond(finding: Finding, values: tuple[float, float], why: str) -> Iterator[str]:
    """Yield that a linear parameter of an effect is beyond its lowest or highest value."""
    low, high = values
    half_widths = HALF_WIDTH_95 * np.sqrt(np.maximum(np.diag(finding.covariance), 0.0))
    for k, each in enumerate(finding.effect.reported[: finding.effect.linear]):
        value, half = float(finding.x[k]), float(half_widths[k])
        if value + half < low or value - half > high:
            yield f"its {each.name} would be {value:.2g} ± {half:.1g} {each.unit}: {why}"


def _least_size(effect: Effect, model: FittedModel) -> float:
    """Return the largest amount in plausible sizes, at the lower end of its 95 % interval."""
    linear = slice(0, effect.linear)
    amounts = np.linalg.solve(effect.prior_factor, model.values_of(effect)[linear])
    if model.covariance is None:
        return float(np.abs(amounts).max())
    columns = model.model.columns_of(effect)
    covariance = model.covariance[columns, columns][linear, linear]
    inverse = np.linalg.inv(effect.prior_factor)
    variance = np.maximum(np.diag(inverse @ covariance @ inverse.T), 0.0)
    return float((np.abs(amounts) - HALF_WIDTH_95 * np.sqrt(variance)).max())


def _has_other_limits(limits: Limits, model: FittedModel) -> bool:
    """Return whether another limit applies to an effect than its plausible size.

    Compliances under weights that are not stated are as uncertain as these: their limit is the
    rotation that they cause.
    """
    by_turn = limits.turn_rad is not None and weights_known(model.arm).assumed
    return limits.values is not None or by_turn


def _turns_too_far(
    finding: Finding, x: Array, states: PoseStates, most_rad: float, why: str
) -> Iterator[str]:
    """Yield that an effect causes larger rotations of joints or links than are possible."""
    effect = finding.effect
    value, std = abs(float(finding.x[0])), float(np.sqrt(max(finding.covariance[0, 0], 0.0)))
    turn_rad = effect.turn_rad(states, x)
    # The rotation is proportional to the first parameter, or to its inverse, a stiffness.
    least_rad = turn_rad * max(0.0, 1.0 - HALF_WIDTH_95 * std / max(value, COMPUTING.tiny))
    if least_rad > most_rad:
        yield f"it would turn by {1e3 * turn_rad:.0f} mrad: {why}"


def holds_zero(effect: Effect, model: FittedModel) -> Iterator[str]:
    """Yield why the amount of an effect of a model is not significantly different from zero.

    Zero is in the 95 % confidence region of its linear parameters, or in the interval of each of
    them: if only a combination is significant, the poses do not determine the amounts. The latter
    counts where each amount has a meaning by itself.
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
    if square < chdtri(effect.linear, 1.0 - NAMES.confidence):
        yield f"it is {np.sqrt(max(square, 0.0)):.1f} standard uncertainties from zero"
    elif effect.amounts_stand_alone and np.abs(white).max() < HALF_WIDTH_95:
        names = ", ".join(each.name for each in effect.reported[linear])
        yield f"the intervals of its {names} hold zero"
