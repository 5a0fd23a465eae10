"""From the set the search found to a verdict: names, alternatives, the remaining error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.discovery.evidence.confirm import FLIP_RATE, Confirmation, confirm
from pa10cal.discovery.evidence.fit import Fit, covariance_of, fit
from pa10cal.discovery.evidence.likelihood import Score
from pa10cal.discovery.evidence.problem import Problem
from pa10cal.discovery.evidence.search import EndOfSearch, ended_at, evidence_about, less, threshold
from pa10cal.discovery.finding import Finding
from pa10cal.discovery.linear import mean_length, position_noise
from pa10cal.discovery.preparation import effects_in, is_fault
from pa10cal.discovery.verdict import MAP, Word, is_named, word_of
from pa10cal.observe.observations import reading_groups
from pa10cal.results.discovery import Unexplained
from pa10cal.terms.effects.effect import Effect

#: Probability allowed that the truth is missing among an effect and its alternatives.
MISSED_RATE = 0.03
#: A map of a joint's error can always do what a named form does: it is a rival of one only where
#: the name has no odds of 20 to 1.
_BY_NAME = float(np.log(20.0))
#: What linear evidence may be wrong by where it picks rivals to refit.
_MARGIN = 4.0
_MOST_REFITS = 12


@dataclass(frozen=True)
class Judgement:
    """What the search comes to."""

    verdict: Word  # in a word
    findings: tuple[Finding[Confirmation], ...]  # effects of the vocabulary, in the order found
    unexplained: tuple[Unexplained, ...]  # what remains without a name
    found: EndOfSearch  # the search, its fit holding every finding and every generic effect


def judge(found: EndOfSearch, needed: float = 0.0) -> Judgement:
    """Judge what the search found.

    Args:
        found: where the search ended.
        needed: evidence that a name needs, natural logarithm.
    """
    found = _prefer_named(found)
    rivals = {effect: _rivals(found, effect) for effect in found.fit.effects}
    confirmations = dict(zip(found.fit.effects, confirm(found.problem, found, needed), strict=True))
    covariance = covariance_of(found.problem, found.fit)
    findings = []
    for effect in found.fit.effects:
        if effect.generic or confirmations[effect].p_sign_flips_max_t > FLIP_RATE:
            continue
        x, of_x = found.fit.reported(effect, covariance)
        findings.append(Finding(effect, x, of_x, rivals[effect], confirmations[effect]))
    unexplained = _unexplained(found, confirmations)
    findings = [f for f in findings if not _bent(found, f.effect, unexplained)]
    return Judgement(word_of(findings, unexplained), tuple(findings), unexplained, found)


def _prefer_named(found: EndOfSearch) -> EndOfSearch:
    """Put a named form in the place of a map or a generic effect that is no better."""
    for effect in found.fit.effects:
        if is_named(effect) or is_fault(effect):
            continue
        for rival, _ in _refitted(found, effect, tuple(filter(is_named, found.family))):
            return _prefer_named(
                ended_at(found.problem, rival, found.family, found.same, found.steps)
            )
    return found


def _rivals(found: EndOfSearch, effect: Effect) -> tuple[Effect, ...]:
    """Return the effects of the vocabulary that explain the data as well in one's place."""
    if effect.generic:
        return ()
    family = tuple(each for each in found.family if not each.generic)
    here = found.score.log_evidence
    rivals = [
        each
        for rival, score in _refitted(found, effect, family)
        for each in rival.effects
        if each not in found.fit.effects
        and not (is_named(effect) and each.id == MAP and score.log_evidence < here - _BY_NAME)
    ]
    place = found.family.index(effect)
    same = [found.family[k] for k in np.flatnonzero(found.same[place]) if k != place]
    return tuple(dict.fromkeys([*same, *rivals]))


def _refitted(
    found: EndOfSearch, effect: Effect, family: tuple[Effect, ...]
) -> list[tuple[Fit, Score]]:
    """Return full refits with another effect in one's place that are about as good, best first.

    If a rival is the truth, the chance that it falls behind by more than `worse` is below
    `MISSED_RATE` for the whole family (Markov, as for the search).
    """
    worse = threshold(effects_in(found.family), MISSED_RATE)
    place = found.fit.effects.index(effect)
    members = tuple(found.family.index(e) for e in found.fit.effects)
    kept, sizes = less(members, place), less(found.fit.sizes, place)
    candidates = [found.family.index(e) for e in family if e not in found.fit.effects]
    without = found.evidence.score(kept, sizes).log_evidence
    here = found.score.log_evidence
    gains = found.evidence.additions(kept, sizes, candidates)
    close = [
        (without + gain, candidate, size)
        for (gain, size), candidate in zip(gains, candidates, strict=True)
        if without + gain >= here - worse - _MARGIN
    ]
    refits = []
    for _, candidate, size in sorted(close, reverse=True)[:_MOST_REFITS]:
        effects = tuple(found.family[k] for k in kept)
        refit = fit(
            found.problem,
            (*effects, found.family[candidate]),
            (*sizes, size),
            found.score.variances,
            found.fit,
        )
        own = evidence_about(found.problem, refit, refit.effects)
        score = own.score(tuple(range(len(refit.effects))), refit.sizes)
        if score.log_evidence >= here - worse:
            refits.append((refit, score))
    return sorted(refits, key=lambda pair: -pair[1].log_evidence)


def _unexplained(
    found: EndOfSearch, confirmations: dict[Effect, Confirmation]
) -> tuple[Unexplained, ...]:
    """Return what generic effects hold, or what poses still share, beyond the repeatability."""
    problem = found.problem
    floor = floor_mm(problem)
    places = []
    for effect, without in zip(found.fit.effects, found.without, strict=True):
        shared_mm = shared_error_mm(problem, without.pose_variance)
        counts = shared_mm > floor or without.torque_variance > _of_averages(problem)
        if effect.generic and counts and confirmations[effect].p_sign_flips_max_t <= FLIP_RATE:
            why = (
                f"a smooth unknown function ({effect.id}) of {effect.of} predicts it better than "
                f"any name{effect.advice}"
            )
            places.append(
                Unexplained(of=effect.of, form=effect.id, shared_error_mm=shared_mm, why=why)
            )
    left_mm = shared_error_mm(problem, found.score.pose_variance)
    if not places and left_mm > floor:
        why = "no effect of the vocabulary explains what the readings of a pose share"
        places.append(Unexplained(of=None, form=None, shared_error_mm=left_mm, why=why))
    return tuple(places)


def _bent(found: EndOfSearch, effect: Effect, unexplained: tuple[Unexplained, ...]) -> bool:
    """Return whether an effect may only stand in for something unexplained at its own place.

    It may where generic effects of its place, all together, could do without it.
    """
    if not unexplained:
        return False
    members = tuple(found.family.index(e) for e in found.fit.effects)
    sizes = found.fit.sizes
    for k, rival in enumerate(found.family):
        if (rival.generic or rival.id == MAP) and rival.of == effect.of and k not in members:
            _, size = found.evidence.additions(members, sizes, [k])[0]
            members, sizes = (*members, k), (*sizes, size)
    place = members.index(found.family.index(effect))
    whole = found.evidence.score(members, sizes).log_evidence
    without = found.evidence.score(less(members, place), less(sizes, place)).log_evidence
    return whole - without < threshold(effects_in(found.family), MISSED_RATE)


def shared_error_mm(problem: Problem, variance: float) -> float:
    """Return the position error that a shared variance amounts to, root mean square over poses."""
    position = np.trace(_position_noise(problem), axis1=1, axis2=2).mean()
    return float(1e3 * np.sqrt(variance * position))


def floor_mm(problem: Problem, repeats: NDArray[np.int64] | None = None) -> float:
    """Return the mean position error that the repeatability alone leaves in averaged poses.

    Args:
        problem: gives the noise of a reading.
        repeats: (P,) readings averaged into each pose; None for those of the poses fitted.
    """
    variance = _position_noise(problem)
    if repeats is None:
        group = reading_groups(problem.readings)
        variance = variance / np.bincount(group)[group][:, None, None]
    else:
        variance = variance.mean(axis=0) / repeats[:, None, None]
    return float(1e3 * np.mean(mean_length(variance)))


def _position_noise(problem: Problem) -> Array:
    return position_noise(problem.readings.measured, problem.noise.cov)


def _of_averages(problem: Problem) -> float:
    """Return the variance of an averaged pose in those of one reading."""
    group = reading_groups(problem.readings)
    return float(np.mean(1.0 / np.bincount(group)[group]))
