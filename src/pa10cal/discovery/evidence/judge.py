"""Verdict on the end of a search by evidence: names, alternatives, the remaining error."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.discovery.evidence.confirmation import Confirmation, confirm
from pa10cal.discovery.evidence.fit import EvidenceFit, covariance_of, fit
from pa10cal.discovery.evidence.likelihood import Score
from pa10cal.discovery.evidence.problem import EvidenceProblem
from pa10cal.discovery.evidence.search import EndOfSearch, ended_at, evidence_about, less
from pa10cal.discovery.finding import Finding, Rival, is_named
from pa10cal.discovery.position_errors import mean_norm, position_noise_m2
from pa10cal.discovery.rules import EVIDENCE
from pa10cal.discovery.verdict import smooth_unknown
from pa10cal.observe.observations import reading_groups
from pa10cal.results.discovery import Unexplained
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.weights import is_fault


@dataclass(frozen=True)
class Judgement:
    """The verdict on the end of a search."""

    findings: tuple[Finding, ...]  # effects of the vocabulary, in the order found
    unexplained: tuple[Unexplained, ...]  # parts of the error without a name
    ended: EndOfSearch  # the search, with every finding and every generic effect in its fit


class _Refit(NamedTuple):
    """A full fit with another effect in the place of a member."""

    effect: Effect  # the other one
    fit: EvidenceFit
    score: Score


class _Scored(NamedTuple):
    """Log evidence with another effect in a member's place, linear about the fit."""

    nats: float
    size: int  # index in `EVIDENCE.sizes` of its best size


class _InPlace(NamedTuple):
    """Effects that may be present in place of a member."""

    alternatives: tuple[Effect, ...]  # effects of the vocabulary that are as good there
    rivals: tuple[Rival, ...]  # every effect that was tried there, with its score


def judge(found: EndOfSearch, needed: float) -> Judgement:
    """Judge the effects of a search; a name needs so much log evidence."""
    found = _prefer_named(found)
    in_place = {effect: _in_place_of(found, effect) for effect in found.fit.effects}
    confirmations = dict(zip(found.fit.effects, confirm(found.problem, found, needed), strict=True))
    covariance = covariance_of(found.problem, found.fit)
    findings = []
    for effect in found.fit.effects:
        if effect.generic or confirmations[effect].p_sign_flips_max_t > EVIDENCE.false_rate:
            continue
        x, of_x = found.fit.reported(effect, covariance)
        alternatives, rivals = in_place[effect]
        findings.append(Finding(effect, x, of_x, alternatives, confirmations[effect], rivals))
    unexplained = _unexplained(found, confirmations)
    if unexplained:
        findings = [each for each in findings if not _is_replaceable(found, each.effect)]
    return Judgement(tuple(findings), unexplained, found)


def _prefer_named(found: EndOfSearch) -> EndOfSearch:
    """Replace maps and generic effects by named effects that are as good."""
    for effect in found.fit.effects:
        if is_named(effect) or is_fault(effect):
            continue
        named = _linear_scores(found, effect, filter(is_named, found.family))
        as_good = _as_good(found, _refitted(found, effect, named))
        if as_good:
            end = ended_at(found.problem, as_good[0].fit, found.family, found.same)
            return _prefer_named(end)
    return found


def _in_place_of(found: EndOfSearch, effect: Effect) -> _InPlace:
    """Return the effects that may be present in place of a member; none of a generic one.

    Rivals that come near are scored by full refits, others linearly about the fit with the member.
    """
    if effect.generic:
        return _InPlace((), ())
    here = found.score.log_evidence
    linear = _linear_scores(found, effect, found.family)
    nats = {each: scored.nats for each, scored in linear.items()}
    nameless = {each: scored for each, scored in linear.items() if each.generic}
    vocabulary = {each: scored for each, scored in linear.items() if not each.generic}
    refits = _refitted(found, effect, vocabulary)
    for refit in (*refits, *_refitted(found, effect, nameless)):
        nats[refit.effect] = refit.score.log_evidence
    close = []
    for refit in _as_good(found, refits):
        # A map can always do what a named form of its joint does: if the name is likelier by
        # `odds_over_map`, the map is no alternative.
        is_map = is_named(effect) and refit.effect.id == JointErrorMap.id
        least = here - float(np.log(EVIDENCE.odds_over_map))
        if not is_map or refit.score.log_evidence >= least:
            close.append(refit.effect)
    number = found.family.index(effect)
    same = [found.family[k] for k in np.flatnonzero(found.same[number]) if k != number]
    # Effects that are indistinguishable in these poses are equally likely.
    nats |= dict.fromkeys((each for each in same if each in nats), here)
    rivals = tuple(Rival(each, np.array([value - here])) for each, value in nats.items())
    return _InPlace(tuple(dict.fromkeys([*same, *close])), rivals)


def _linear_scores(
    found: EndOfSearch, effect: Effect, some: Iterable[Effect]
) -> dict[Effect, _Scored]:
    """Return the score of each of some effects in a member's place, of those not in the fit."""
    kept = less(found.chosen, found.fit.effects.index(effect))
    without = found.evidence.score(kept).log_evidence
    others = [each for each in some if each not in found.fit.effects]
    gains = found.evidence.additions(kept, list(map(found.family.index, others)))
    return {
        other: _Scored(without + gain, size)
        for other, (gain, size) in zip(others, gains, strict=True)
    }


def _as_good(found: EndOfSearch, refits: Sequence[_Refit]) -> list[_Refit]:
    """Return the refits that are as good as the search's end, in their order."""
    least = found.score.log_evidence - found.as_good_nats
    return [refit for refit in refits if refit.score.log_evidence >= least]


def _refitted(found: EndOfSearch, effect: Effect, linear: Mapping[Effect, _Scored]) -> list[_Refit]:
    """Return full fits with other effects in a member's place that come near, best first."""
    kept = less(found.chosen, found.fit.effects.index(effect))
    least = found.score.log_evidence - found.as_good_nats - EVIDENCE.refit_margin_nats
    close = [
        (scored.nats, found.family.index(other), scored.size)
        for other, scored in linear.items()
        if scored.nats >= least
    ]
    refits = []
    for _, candidate, size in sorted(close, reverse=True)[: EVIDENCE.most_refits]:
        chosen = (*kept, (candidate, size))
        effects = tuple(found.family[number] for number, _ in chosen)
        sizes = tuple(size for _, size in chosen)
        refit = fit(found.problem, effects, sizes, found.score.variances, found.fit)
        evidence = evidence_about(found.problem, refit, refit.effects)
        score = evidence.score(tuple(enumerate(refit.sizes)))
        refits.append(_Refit(found.family[candidate], refit, score))
    return sorted(refits, key=lambda each: -each.score.log_evidence)


def _unexplained(
    found: EndOfSearch, confirmations: dict[Effect, Confirmation]
) -> tuple[Unexplained, ...]:
    """Return the shared errors beyond the repeatability that have no name.

    Those that generic effects follow; else those that remain.
    """
    problem = found.problem
    floor, group = floor_mm(problem), reading_groups(problem.readings)
    # variance of the mean of a pose's readings, in units of that of one reading
    of_averages = np.mean(1.0 / np.bincount(group)[group])
    places = []
    for effect, without in zip(found.fit.effects, found.without, strict=True):
        shared_mm = shared_error_mm(problem, without.variances.pose)
        counts = shared_mm > floor or without.variances.torque > of_averages
        if (
            effect.generic
            and counts
            and confirmations[effect].p_sign_flips_max_t <= EVIDENCE.false_rate
        ):
            places.append(smooth_unknown(effect, shared_mm, "it"))
    remaining_mm = shared_error_mm(problem, found.score.variances.pose)
    if not places and remaining_mm > floor:
        why = "no effect of the vocabulary explains what the readings of a pose share"
        places.append(Unexplained(of=None, form=None, shared_error_mm=remaining_mm, why=why))
    return tuple(places)


def _is_replaceable(found: EndOfSearch, effect: Effect) -> bool:
    """Return whether all generic effects and the map of an effect's place could replace it."""
    chosen, evidence = found.chosen, found.evidence
    for k, rival in enumerate(found.family):
        flexible = rival.generic or rival.id == JointErrorMap.id
        if flexible and rival.of == effect.of and rival not in found.fit.effects:
            ((_, size),) = evidence.additions(chosen, [k])
            chosen = (*chosen, (k, size))
    member = found.fit.effects.index(effect)
    whole = evidence.score(chosen).log_evidence
    without = evidence.score(less(chosen, member)).log_evidence
    return whole - without < found.as_good_nats


def shared_error_mm(problem: EvidenceProblem, variance: float) -> float:
    """Return the position error of a shared variance, root mean square over poses."""
    position_m2 = np.trace(_position_noise(problem), axis1=1, axis2=2).mean()
    return float(1e3 * np.sqrt(variance * position_m2))


def floor_mm(problem: EvidenceProblem, repeats: NDArray[np.int64] | None = None) -> float:
    """Return the mean position error of averaged poses by the repeatability alone.

    Each pose is a mean of `repeats` (P,) readings; None for the poses of the fit.
    """
    variance = _position_noise(problem)
    if repeats is None:
        group = reading_groups(problem.readings)
        variance = variance / np.bincount(group)[group][:, None, None]
    else:
        variance = variance.mean(axis=0) / repeats[:, None, None]
    return float(1e3 * np.mean(mean_norm(variance)))


def _position_noise(problem: EvidenceProblem) -> Array:
    """Return the covariances (P, d, d) [m²] of the position errors of single readings."""
    return position_noise_m2(problem.readings.measured, problem.noise.cov)
