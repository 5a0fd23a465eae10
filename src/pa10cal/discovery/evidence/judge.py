"""Verdict on the end of a search by evidence: names, alternatives, the remaining error.

A search ends (`EndOfSearch`) with a set of effects, its members, fitted together; `found.score` is
the log evidence of the set, `found.without` that of the set less each member. A member is named
where chance does not do as well; its alternatives are the effects with which, in its place, the
evidence is about as good. What readings of a pose share beyond their noise has no name.
"""

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
from pa10cal.discovery.finding import Finding, Rival, is_named, smooth_unknown
from pa10cal.discovery.rules import EVIDENCE
from pa10cal.fit.position_errors import mean_norm, position_noise_m2
from pa10cal.observe.observations import reading_groups
from pa10cal.results.discovery import Unexplained
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.statement_faults import is_fault


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
    """Judge the effects of a search; a name needs so much log evidence.

    Beside an error without a name only those names stay that flexible functions cannot replace: of
    what others explain, nobody knows whether it is part of that error.
    """
    found = _prefer_named(found)
    in_place = {effect: _in_place_of(found, effect) for effect in found.fit.effects}
    confirmations = dict(zip(found.fit.effects, confirm(found.problem, found, needed), strict=True))
    covariance = covariance_of(found.problem, found.fit)
    findings = []
    for effect in found.fit.effects:
        if effect.generic or _is_chance(confirmations[effect]):
            continue
        x, of_x = found.fit.reported(effect, covariance)
        alternatives, rivals = in_place[effect]
        findings.append(Finding(effect, x, of_x, alternatives, confirmations[effect], rivals))
    unexplained = _unexplained(found, confirmations)
    if unexplained:
        findings = [each for each in findings if not _is_replaceable(found, each.effect)]
    return Judgement(tuple(findings), unexplained, found)


def _is_chance(confirmation: Confirmation) -> bool:
    """Return whether chance does as well as an effect too often for it to be reported."""
    return confirmation.p_sign_flips_max_t > EVIDENCE.false_rate


# Another effect in the place of a member.


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
    vocabulary = {each: scored for each, scored in linear.items() if not each.generic}
    nameless = {each: scored for each, scored in linear.items() if each.generic}
    refits = _refitted(found, effect, vocabulary)
    nats = {each: scored.nats for each, scored in linear.items()}
    for refit in (*refits, *_refitted(found, effect, nameless)):
        nats[refit.effect] = refit.score.log_evidence
    # Effects that are indistinguishable in these poses are equally likely, whatever came of their
    # refits.
    same = _indistinguishable_from(found, effect)
    nats |= dict.fromkeys((each for each in same if each in nats), here)
    as_good = [
        refit.effect
        for refit in _as_good(found, refits)
        if not _is_imitation(refit.effect, effect, refit.score.log_evidence - here)
    ]
    rivals = tuple(Rival(each, np.array([value - here])) for each, value in nats.items())
    return _InPlace(tuple(dict.fromkeys([*same, *as_good])), rivals)


def _indistinguishable_from(found: EndOfSearch, effect: Effect) -> list[Effect]:
    """Return the other effects of the family that these poses cannot tell from an effect."""
    number = found.family.index(effect)
    return [found.family[k] for k in np.flatnonzero(found.same[number]) if k != number]


def _is_imitation(other: Effect, effect: Effect, nats: float) -> bool:
    """Return whether another effect is a map that only imitates a named effect of its joint.

    A map can do what every named form of its joint does. Where the name is likelier by
    `odds_over_map` the map is no alternative.

    Args:
        nats: log evidence with the other effect, less that with the named one.
    """
    is_map_of_it = is_named(effect) and other.id == JointErrorMap.id and other.of == effect.of
    return is_map_of_it and nats < -float(np.log(EVIDENCE.odds_over_map))


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


# The error without a name.


def _unexplained(
    found: EndOfSearch, confirmations: dict[Effect, Confirmation]
) -> tuple[Unexplained, ...]:
    """Return the shared errors beyond the repeatability that have no name.

    Those that generic effects follow; else those that remain. A shared error counts where its
    variance is larger than that of the noise in the mean of a pose's readings.
    """
    problem, remaining = found.problem, found.score.variances
    noise = _variance_of_means(problem)
    places = []
    for effect, less_it in zip(found.fit.effects, found.without, strict=True):
        without = less_it.variances
        is_more_than_noise = without.pose > noise or without.torque > noise
        if effect.generic and is_more_than_noise and not _is_chance(confirmations[effect]):
            places.append(smooth_unknown(effect, shared_error_mm(problem, without.pose), "it"))
    if not places and remaining.pose > noise:
        why = "no effect of the vocabulary explains what the readings of a pose share"
        remaining_mm = shared_error_mm(problem, remaining.pose)
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


# Position errors by the noise of repeats. Every pose and load that was fitted counts once, however
# often it was read.


def shared_error_mm(problem: EvidenceProblem, times_noise: float) -> float:
    """Return the position error that readings of a pose share, root mean square over poses.

    Its variance is `times_noise` that of the noise of one reading.
    """
    noise_m2, count = _position_noise(problem)
    square_m2 = np.average(np.trace(noise_m2, axis1=1, axis2=2), weights=1.0 / count)
    return float(1e3 * np.sqrt(times_noise * square_m2))


def noise_floor_mm(problem: EvidenceProblem) -> float:
    """Return the mean position error that noise alone leaves in the averaged poses of the fit."""
    noise_m2, count = _position_noise(problem)
    error_m = mean_norm(noise_m2 / count[:, None, None])
    return float(1e3 * np.average(error_m, weights=1.0 / count))


def noise_floor_of_mm(problem: EvidenceProblem, readings: NDArray[np.int64]) -> float:
    """Return the mean position error that noise alone leaves in other averaged poses.

    Each is the mean of so many `readings` (P,), with the mean noise of those fitted.
    """
    noise_m2, count = _position_noise(problem)
    of_one_m2 = np.average(noise_m2, axis=0, weights=1.0 / count)
    return float(1e3 * np.mean(mean_norm(of_one_m2 / readings[:, None, None])))


def _variance_of_means(problem: EvidenceProblem) -> float:
    """Return the variance of the mean of a pose's readings, mean over poses, over that of one."""
    return float(np.mean(1.0 / np.bincount(reading_groups(problem.readings))))


def _position_noise(problem: EvidenceProblem) -> tuple[Array, NDArray[np.int64]]:
    """Return the noise of single readings, and how many (P,) their pose and load has.

    The noise are covariances (P, d, d) [m²] of position errors (`position_noise_m2`).
    """
    group = reading_groups(problem.readings)
    noise_m2 = position_noise_m2(problem.readings.measured, problem.noise.cov)
    return noise_m2, np.bincount(group)[group]
