"""The set of effects that the data support: steps forward and back, and full refits between."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import compress
from typing import NamedTuple, TypeVar

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Mask
from pa10cal.discovery.evidence.candidates import indistinguishable, linearise
from pa10cal.discovery.evidence.fit import EvidenceFit, fit
from pa10cal.discovery.evidence.likelihood import CandidateSet, Score, SetEvidence
from pa10cal.discovery.evidence.noise_model import NO_SHARED_ERROR, SharedVariances
from pa10cal.discovery.evidence.problem import EvidenceProblem, prepare
from pa10cal.discovery.gear_lines import gear_lines
from pa10cal.discovery.jacobians import WhitenedPoses
from pa10cal.discovery.preparation import effects_in, why_few_angles
from pa10cal.discovery.proof import needed_nats
from pa10cal.discovery.rules import EVIDENCE, LINES, MAPS
from pa10cal.discovery.tuning import COMPUTING
from pa10cal.discovery.wobbles import wobbles
from pa10cal.numerics.covariances import whitener_of
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.gear_line import GearLine, is_gear_line
from pa10cal.terms.effects.joint_error_map import FadingPrior, is_error_map
from pa10cal.terms.effects.structure import AxisWobble
from pa10cal.terms.model import DerivativeCache


@dataclass(frozen=True)
class EndOfSearch:
    """The end of a search: a set of effects, its fit, and the evidence about that fit."""

    problem: EvidenceProblem  # the campaign, with noise and weights computed about the fit
    fit: EvidenceFit  # the model with the effects found
    evidence: SetEvidence  # of sets of the family, linear about the fit
    family: tuple[Effect, ...]  # the candidates
    same: Mask  # (m, m) which candidates are indistinguishable in these poses
    chosen: CandidateSet  # the effects found
    score: Score  # evidence of that set
    without: tuple[Score, ...]  # evidence of the set less each of its effects

    @property
    def nothing(self) -> Score:
        """Return the evidence of the empty set."""
        return self.evidence.score(())

    @property
    def as_good_nats(self) -> float:
        """Return by how much less log evidence another set is considered as good.

        If a rival is the truth, the probability that it falls behind by more than this is below
        `missed_rate` for the whole family (Markov's inequality, as for the search).
        """
        return needed_nats(effects_in(self.family), EVIDENCE.missed_rate)


def evidence_about(
    problem: EvidenceProblem, found: EvidenceFit, family: tuple[Effect, ...]
) -> SetEvidence:
    """Return the evidence of sets of a family, linear about a fit."""
    return SetEvidence(problem.pose, problem.torque, linearise(problem, found, family))


def search(
    problem: EvidenceProblem, family: tuple[Effect, ...], error_rate: float, start: EvidenceFit
) -> EndOfSearch:
    """Find the set of effects of a family that the data support, from the model without effects.

    Each round improves the set about the last fit and fits it anew, until a round finds a set that
    was fitted before: the one fitted last (sizes that alone would change are not fitted again), or
    an earlier one. Then rounds would repeat, and of the sets between the likeliest is returned.
    After the largest number of rounds it is the set fitted last.
    """
    needed = needed_nats(effects_in(family), error_rate)
    same = indistinguishable(problem, start, family)
    current = start
    chosen: CandidateSet = ()
    fits: dict[frozenset[int], tuple[EvidenceProblem, EvidenceFit]] = {}  # by their members
    for _ in range(EVIDENCE.most_rounds):
        evidence = evidence_about(problem, current, family)
        chosen = _improve(evidence, same, chosen, needed)
        members = frozenset(k for k, _ in chosen)
        if members in fits:
            repeated = list(fits.values())[list(fits).index(members) :]
            ends = [ended_at(*each, family, same) for each in repeated]
            return max(ends, key=lambda end: end.score.log_evidence)
        effects = tuple(family[k] for k, _ in chosen)
        sizes = tuple(size for _, size in chosen)
        problem, current = refit(problem, effects, sizes, evidence.score(chosen).variances, current)
        fits[members] = problem, current
    return ended_at(problem, current, family, same)


def ended_at(
    problem: EvidenceProblem, current: EvidenceFit, family: tuple[Effect, ...], same: Mask
) -> EndOfSearch:
    """Return the end of a search at a fit."""
    evidence = evidence_about(problem, current, family)
    chosen = tuple(zip(map(family.index, current.effects), current.sizes, strict=True))
    without = tuple(evidence.score(less(chosen, k)) for k in range(len(chosen)))
    score = evidence.score(chosen)
    return EndOfSearch(problem, current, evidence, family, same, chosen, score, without)


def refit(
    problem: EvidenceProblem,
    effects: tuple[Effect, ...],
    sizes: tuple[int, ...],
    variances: SharedVariances,
    start: EvidenceFit,
    most_steps: int = COMPUTING.fit_steps,
) -> tuple[EvidenceProblem, EvidenceFit]:
    """Fit a set of effects, compute noise and weights about the fit, and fit again.

    If the baseline lacks a large effect, its postures and the moments of the weights are a little
    wrong, and the noise of a torque does not act through a joint that is taken as rigid.
    """
    first = fit(problem, effects, sizes, variances, start, most_steps)
    problem = prepare(
        problem.readings,
        problem.calibrated,
        problem.setup,
        first.at,
        torques_logged=problem.torques_logged,
        in_time=problem.in_time,
    )
    return problem, fit(problem, effects, sizes, variances, first, most_steps)


def _improve(
    evidence: SetEvidence, same: Mask, chosen: CandidateSet, needed: float
) -> CandidateSet:
    """Add and exchange effects while that helps; then remove the least needed, and begin again.

    It ends where each effect of the set is needed.
    """
    forbidden: set[int] = set()
    while chosen := _forward(evidence, same, chosen, forbidden):
        weakest = _weakest(evidence, chosen, needed)
        if weakest.lost_nats >= needed:
            break
        # A member that was not needed is not tried again: it would be added at once.
        forbidden.add(weakest.candidate)
        chosen = weakest.others
    return chosen


def _forward(
    evidence: SetEvidence, same: Mask, chosen: CandidateSet, forbidden: set[int]
) -> CandidateSet:
    """Add the best candidate; if none helps enough, exchange one member for a better one."""
    while True:
        enough = evidence.score(chosen).log_evidence + EVIDENCE.forward_nats
        best = _Scored(-np.inf, chosen)
        if len(chosen) < EVIDENCE.most_effects:
            best = _best_addition(evidence, same, chosen, forbidden)
        if not best.nats >= enough:
            exchanged = (
                _best_addition(evidence, same, less(chosen, k), forbidden | {member})
                for k, (member, _) in enumerate(chosen)
            )
            best = max(exchanged, default=best)
        if not best.nats >= enough:  # nor where the evidence is not a number
            return chosen
        chosen = best.members


class _Scored(NamedTuple):
    """A set of candidates, and the log evidence of it."""

    nats: float
    members: CandidateSet


def _best_addition(
    evidence: SetEvidence, same: Mask, chosen: CandidateSet, forbidden: set[int]
) -> _Scored:
    """Return the log evidence of the best set with one more member, and that set.

    A candidate that is forbidden, or indistinguishable from a member, is not added. Without any
    other the evidence is -inf.
    """
    is_distinct = ~same[:, [k for k, _ in chosen]].any(axis=1)
    open_to = [k for k in np.flatnonzero(is_distinct).tolist() if k not in forbidden]
    if not open_to:
        return _Scored(-np.inf, chosen)
    gains = evidence.additions(chosen, open_to)
    best = max(range(len(open_to)), key=lambda k: gains[k].nats)
    members = (*chosen, (open_to[best], gains[best].size))
    return _Scored(evidence.score(members).log_evidence, members)


class _Weakest(NamedTuple):
    """The least needed member of a set."""

    candidate: int  # its number in the family
    lost_nats: float  # loss of log evidence without it
    others: CandidateSet  # the set without it, in sizes chosen anew if these decide


def _weakest(evidence: SetEvidence, chosen: CandidateSet, needed: float) -> _Weakest:
    """Return the least needed member of a set.

    Where every member seems needed, the others take other sizes without it before it counts as
    needed: beside a proxy of its own error the size of a true effect is too small.

    Args:
        needed: loss of log evidence from which on a member is needed.
    """
    whole = evidence.score(chosen).log_evidence
    without = [less(chosen, k) for k in range(len(chosen))]
    scores = [evidence.score(rest).log_evidence for rest in without]
    if whole - max(scores) >= needed:
        without = [resized(evidence, rest) for rest in without]
        scores = [evidence.score(rest).log_evidence for rest in without]
    k = int(np.argmax(scores))
    return _Weakest(chosen[k][0], whole - scores[k], without[k])


def resized(evidence: SetEvidence, chosen: CandidateSet) -> CandidateSet:
    """Return a set with the size of each member chosen again, one after the other."""
    best = evidence.score(chosen).log_evidence, chosen
    for k, (member, _) in enumerate(chosen):
        for size in range(len(EVIDENCE.sizes)):
            _, best_set = best
            tried = (*best_set[:k], (member, size), *best_set[k + 1 :])
            best = max(best, (evidence.score(tried).log_evidence, tried))
    return best[1]


Value = TypeVar("Value")


def less(values: tuple[Value, ...], k: int) -> tuple[Value, ...]:
    """Return the values without the k-th."""
    return values[:k] + values[k + 1 :]


# Periodic errors of joints: lines of gears, which a spectrum proposes, and maps fine enough.


def search_with_errors_of_joints(
    problem: EvidenceProblem,
    family: tuple[Effect, ...],
    error_rate: float,
    start: EvidenceFit,
    timed: Callable[[tuple[Effect, ...]], tuple[EvidenceProblem, EvidenceFit]],
) -> EndOfSearch:
    """Search as `search`, then with the lines that residuals show, and with maps as fine as needed.

    An axis that wobbles more than any compliance explains is sought from the beginning: maps and
    couplings of other joints follow it in few poses, and leave nothing of it.

    Args:
        problem: the campaign.
        family: the candidates.
        error_rate: probability allowed of finding an effect where there is none.
        start: the fit without effects.
        timed: returns problem and start with motion in time found beside some lines, which may have
            been taken for it.
    """
    lines: tuple[Effect, ...] = ()
    axes = _wobbles(problem, start, error_rate)
    if axes:
        family, (problem, start) = (*family, *axes), _bending(problem, axes)
    ended = search(problem, family, error_rate, start)
    for _ in range(LINES.most_rounds):
        added = _lines(ended, error_rate)
        if not added:
            break
        family, lines = (*family, *added), (*lines, *added)
        if problem.in_time.wander is not None:
            problem, start = timed(lines)
            problem, start = _bending(problem, axes) if axes else (problem, start)
        ended = search(problem, family, error_rate, start)
    return _with_fine_maps(ended, error_rate, start)


def _wobbles(
    problem: EvidenceProblem, start: EvidenceFit, error_rate: float
) -> tuple[AxisWobble, ...]:
    """Return the axis that wobbles most about the fit without effects, if it is significant."""
    rows = _residual_rows(problem, start)
    return wobbles(rows, problem.context, problem.setup.payload, error_rate, ())


def _bending(
    problem: EvidenceProblem, axes: tuple[Effect, ...]
) -> tuple[EvidenceProblem, EvidenceFit]:
    """Return a problem on a chain that bends as effects do, and its fit without effects."""
    problem = replace(
        problem,
        calibrated=problem.calibrated.bending_as(axes),
        baseline=problem.baseline.bending_as(axes),
        derivative_cache=DerivativeCache(),
    )
    return problem, fit(problem, (), (), NO_SHARED_ERROR)


def _residual_rows(problem: EvidenceProblem, found: EvidenceFit) -> WhitenedPoses:
    """Return the cells about a fit."""
    at, cells = found.at, problem.cells
    whiteners = whitener_of(problem.cell_cov)
    return WhitenedPoses(at, cells, at.compared(cells).residual, whiteners)


def _lines(ended: EndOfSearch, error_rate: float) -> tuple[Effect, ...]:
    """Return the lines of gears in the residuals of a search, at joints where none was tried."""
    tried = [each.of for each in ended.family if each.id == GearLine.id]
    rows = _residual_rows(ended.problem, ended.fit)
    lines = gear_lines(rows, error_rate, tried, in_maps=True)
    mapped = {each.of for each in ended.fit.effects if is_error_map(each)}
    return tuple(_in_place_of_map(ended, line) if line.of in mapped else line for line in lines)


def _in_place_of_map(ended: EndOfSearch, line: GearLine) -> GearLine:
    """Return a line about its number of cycles in a fit without the other effects of its joint.

    The spectrum is linear about a fit in which a map, and others with it, stood for the line.
    """
    kept = [each.of != line.of for each in ended.fit.effects]
    effects = tuple(compress(ended.fit.effects, kept))
    sizes = tuple(compress(ended.fit.sizes, kept))
    largest = len(EVIDENCE.sizes) - 1
    found = fit(
        ended.problem, (*effects, line), (*sizes, largest), ended.score.variances, ended.fit
    )
    *_, cycles_a_turn = found.at.values_of(line)
    return replace(line, order=round(float(cycles_a_turn), LINES.order_decimals))


def _with_fine_maps(ended: EndOfSearch, error_rate: float, start: EvidenceFit) -> EndOfSearch:
    """Return the end of a search in which no joint has several effects where a fine map is enough.

    An error of many cycles a turn, which a map of twelve knots does not follow, draws other effects
    of its joint into the set: large ones that cancel, a torque that goes with the angle, or a line
    that is one of several. Such joints are searched again, with a fine map and without slow lines;
    the set that is worth more stands. Where it holds a slow line and no map of the joint, the fine
    map becomes a candidate, so that it counts as what may be in the line's place.
    """
    effects, states = ended.fit.effects, ended.problem.cells.states
    count = Counter(each.of for each in effects)
    mapped = {each.of for each in effects if is_error_map(each)}
    with_line = {each.of for each in effects if _is_slow_line(each)}
    crowded = {of for of in mapped | with_line if count[of] > 1}
    if crowded:
        family = tuple(
            each
            for each in _with_maps_made_fine(ended.family, crowded, states)
            if not (each.of in crowded and _is_slow_line(each))
        )
        ahead = search(ended.problem, family, error_rate, start)
        if _worth_nats(ahead, error_rate) > _worth_nats(ended, error_rate):
            return ahead
    if not with_line - mapped:
        return ended
    family = _with_maps_made_fine(ended.family, with_line - mapped, states)
    same = indistinguishable(ended.problem, start, family)
    return ended_at(ended.problem, ended.fit, family, same)


def _with_maps_made_fine(
    family: tuple[Effect, ...], places: set[str], states: PoseStates
) -> tuple[Effect, ...]:
    """Return a family with the maps of some joints fine ones, where these were at enough angles."""
    knots, half_order = MAPS.spacings[0]
    spectrum = FadingPrior(MAPS.sizes_rad[-1], half_order)

    def made_fine(effect: Effect) -> Effect:
        if not is_error_map(effect) or effect.of not in places:
            return effect
        fine = replace(effect, knots=knots, spectrum=spectrum)
        return effect if why_few_angles(fine, states) else fine

    return tuple(map(made_fine, family))


def _worth_nats(ended: EndOfSearch, error_rate: float) -> float:
    """Return the evidence of a set less what its members gain by chance.

    Each is the best of a family; a slow line, whose number of cycles was found, the best of as many
    as there are.
    """
    effects = ended.fit.effects
    by_chance = len(effects) * needed_nats(effects_in(ended.family), error_rate)
    by_chance += sum(map(_is_slow_line, effects)) * float(np.log(LINES.orders[1]))
    return ended.score.log_evidence - by_chance


def _is_slow_line(effect: Effect) -> bool:
    """Return whether an effect is a line of as few cycles a turn as a fine map follows."""
    return is_gear_line(effect) and effect.order < LINES.orders[0]
