"""Which set of effects the data support: steps forward, looks backward, full refits between."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.discovery.evidence.candidates import Linearised, indistinguishable, linearise
from pa10cal.discovery.evidence.fit import Fit, fit
from pa10cal.discovery.evidence.likelihood import SIZES, Evidence, Score
from pa10cal.discovery.evidence.problem import Problem, prepare
from pa10cal.discovery.finding import name_of
from pa10cal.discovery.linear import error_mm, residual, rms
from pa10cal.discovery.preparation import effects_in
from pa10cal.results.analysis import SearchStep
from pa10cal.terms.effects.effect import Effect

#: A forward step may be a proxy for what comes later; it need only make the data likelier.
_FORWARD_GAIN = 1.0
#: Effects at a time, more than that is no longer a finding.
_MOST_EFFECTS = 10
_MOST_ROUNDS = 6


@dataclass(frozen=True)
class EndOfSearch:
    """Where the search ended."""

    problem: Problem  # the campaign, noise and weights computed about that fit
    fit: Fit  # the model with the effects found
    score: Score  # its evidence about that fit
    without: tuple[Score, ...]  # evidence of the set less each of its effects
    evidence: Evidence  # about that fit, over the whole family
    family: tuple[Effect, ...]  # the candidates, in the order of the evidence's blocks
    same: NDArray[np.bool_]  # (m, m) which of them look the same in these poses
    nothing: Score  # evidence of the empty set about that fit
    steps: tuple[
        SearchStep, ...
    ]  # sets after every refit, with their evidence gain over the empty set


def threshold(family: int, error_rate: float) -> float:
    """Return the gain in evidence that a name needs: P(any of the family reaches it) <= rate."""
    return float(np.log(max(family, 1) / error_rate))


def evidence_about(problem: Problem, found: Fit, family: tuple[Effect, ...]) -> Evidence:
    """Return the evidence of sets of a family, linear about a fit."""
    lin: Linearised = linearise(problem, found, family)
    return Evidence(
        problem.pose, problem.torque, lin.pose_data, lin.torque_data, lin.own, lin.blocks
    )


def search(
    problem: Problem, family: tuple[Effect, ...], error_rate: float, start: Fit
) -> EndOfSearch:
    """Find the set of effects of a family that the data support, from the model without effects."""
    needed = threshold(effects_in(family), error_rate)
    same = indistinguishable(problem, start, family)
    current = start
    members: tuple[int, ...] = ()
    sizes: tuple[int, ...] = ()
    seen: set[frozenset[int]] = set()
    steps: list[SearchStep] = []
    for _ in range(_MOST_ROUNDS):
        evidence = evidence_about(problem, current, family)
        members, sizes = _improve(evidence, same, members, sizes, needed)
        score = evidence.score(members, sizes)
        nothing = evidence.score((), ())
        if frozenset(members) in seen:
            break
        seen.add(frozenset(members))
        problem, current = refit(
            problem,
            tuple(family[k] for k in members),
            sizes,
            score.variances,
            current,
        )
        steps.append(
            SearchStep(
                effects=tuple(name_of(family[k]) for k in members),
                gain_nats=score.log_evidence - nothing.log_evidence,
                rms_mm=rms(error_mm(problem.cells.measured, residual(current.at, problem.cells))),
            )
        )
    return ended_at(problem, current, family, same, tuple(steps))


def ended_at(
    problem: Problem,
    current: Fit,
    family: tuple[Effect, ...],
    same: NDArray[np.bool_],
    steps: tuple[SearchStep, ...],
) -> EndOfSearch:
    """Return what the search has found where it ends at a fit, with the evidence about it."""
    evidence = evidence_about(problem, current, family)
    members = tuple(family.index(effect) for effect in current.effects)
    return EndOfSearch(
        problem=problem,
        fit=current,
        score=evidence.score(members, current.sizes),
        without=tuple(
            evidence.score(less(members, k), less(current.sizes, k)) for k in range(len(members))
        ),
        evidence=evidence,
        family=family,
        same=same,
        nothing=evidence.score((), ()),
        steps=steps,
    )


def refit(
    problem: Problem,
    effects: tuple[Effect, ...],
    sizes: tuple[int, ...],
    variances: tuple[float, float],
    start: Fit,
) -> tuple[Problem, Fit]:
    """Fit a set of effects, compute noise and weights about it, and fit again.

    A large effect that the baseline lacks bends it: the posture, hence the moments, are then a
    little wrong, and what the noise of a torque does through a joint thought rigid is missing.
    """
    first = fit(problem, effects, sizes, variances, start)
    problem = prepare(
        problem.readings,
        problem.baseline,
        problem.setup,
        first.at,
        torques_logged=problem.torques_logged,
        in_time=problem.in_time,
    )
    return problem, fit(problem, effects, sizes, variances, first)


def _improve(
    evidence: Evidence,
    same: NDArray[np.bool_],
    members: tuple[int, ...],
    sizes: tuple[int, ...],
    needed: float,
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Add, exchange and drop effects until nothing helps; each that stays must be needed."""
    forbidden: set[int] = set()
    while True:
        members, sizes = _forward(evidence, same, members, sizes, forbidden)
        weakest, loss, left_sizes = _weakest(evidence, members, sizes, needed)
        if weakest is None or loss >= needed:
            return members, sizes
        # What is not needed in the end is not tried again: forward would only bring it back.
        forbidden.add(members[weakest])
        members, sizes = less(members, weakest), left_sizes


def _forward(
    evidence: Evidence,
    same: NDArray[np.bool_],
    members: tuple[int, ...],
    sizes: tuple[int, ...],
    forbidden: set[int],
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Add what makes the data likeliest; when nothing does, exchange one member for better."""
    while True:
        here = evidence.score(members, sizes).log_evidence
        tried = (
            [_best_addition(evidence, members, sizes, _open(same, members, forbidden))]
            if (len(members) < _MOST_EFFECTS)
            else []
        )
        if not tried or tried[0][0] < here + _FORWARD_GAIN:
            tried = [
                _best_addition(
                    evidence,
                    less(members, k),
                    less(sizes, k),
                    _open(same, less(members, k), forbidden | {members[k]}),
                )
                for k in range(len(members))
            ]
        best = max(tried, default=(-np.inf, members, sizes))
        if best[0] < here + _FORWARD_GAIN:
            return members, sizes
        _, members, sizes = best


def _open(same: NDArray[np.bool_], members: tuple[int, ...], forbidden: set[int]) -> list[int]:
    """Return what may join: nothing forbidden, nothing that looks the same as a member."""
    return [k for k in range(len(same)) if k not in forbidden and not same[k, list(members)].any()]


def _best_addition(
    evidence: Evidence, members: tuple[int, ...], sizes: tuple[int, ...], open_to: list[int]
) -> tuple[float, tuple[int, ...], tuple[int, ...]]:
    """Return the evidence of the best set with one more member, and that set.

    Where nothing may join, the set as it is, and no evidence for it.
    """
    if not open_to:
        return -np.inf, members, sizes
    gains = evidence.additions(members, sizes, open_to)
    best = max(range(len(open_to)), key=lambda k: gains[k][0])
    members, sizes = (*members, open_to[best]), (*sizes, gains[best][1])
    return evidence.score(members, sizes).log_evidence, members, sizes


def _weakest(
    evidence: Evidence, members: tuple[int, ...], sizes: tuple[int, ...], needed: float
) -> tuple[int | None, float, tuple[int, ...]]:
    """Return which member the set would miss least, how much, and the sizes of those left.

    Those left may take the size they have without it: beside a proxy the right effect is small.
    """
    if not members:
        return None, 0.0, sizes
    whole = evidence.score(members, sizes).log_evidence
    left = [
        (evidence.score(less(members, k), less(sizes, k)).log_evidence, less(sizes, k))
        for k in range(len(members))
    ]
    if whole - max(left)[0] >= needed:  # only then is it worth the time
        left = [resized(evidence, less(members, k), less(sizes, k)) for k in range(len(members))]
    weakest = max(range(len(members)), key=lambda k: left[k][0])
    return weakest, whole - left[weakest][0], left[weakest][1]


def resized(
    evidence: Evidence, members: tuple[int, ...], sizes: tuple[int, ...]
) -> tuple[float, tuple[int, ...]]:
    """Return the evidence of a set with the size of each member chosen anew, and the sizes."""
    best = evidence.score(members, sizes).log_evidence, sizes
    for k in range(len(members)):
        for size in range(len(SIZES)):
            tried = (*best[1][:k], size, *best[1][k + 1 :])
            best = max(best, (evidence.score(members, tried).log_evidence, tried))
    return best


def less(values: tuple[int, ...], k: int) -> tuple[int, ...]:
    """Return the values without the k-th."""
    return values[:k] + values[k + 1 :]
