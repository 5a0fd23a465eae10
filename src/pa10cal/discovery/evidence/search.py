"""Which set of effects the data support: steps forward, looks backward, full refits between.

The family of candidates, every effect at every place, is settled before residuals are looked at:
which effects the model's own parameters absorb, and which are indistinguishable.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from pa10cal.arrays import Array, Mask
from pa10cal.discovery.evidence.likelihood import CandidateRows, CandidateSet, Score, SetEvidence
from pa10cal.discovery.evidence.problem import (
    EvidenceFit,
    EvidenceProblem,
    fit,
    pose_rows,
    prepare,
    torque_rows,
)
from pa10cal.discovery.finding import Untestable
from pa10cal.discovery.linear import by_end
from pa10cal.discovery.other_numbers import COMPUTING
from pa10cal.discovery.preparation import computable, effects_in, why_hidden
from pa10cal.discovery.rules import EVIDENCE
from pa10cal.fit.problem import possible_sizes
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.term import shows_torque


@dataclass(frozen=True)
class LinearisedCandidates:
    """The rows of a fit and of candidates about it."""

    # pose_data and torque_data: whitened rows of measured minus predicted, with the linear part of
    # the fit's own effects put back, as if they had not been in it
    pose_data: Array
    torque_data: Array
    own: Array  # (R, k) whitened rows of the model's own parameters, at their possible size
    blocks: tuple[CandidateRows, ...]  # of each candidate requested, in order


def linearise(
    problem: EvidenceProblem, found: EvidenceFit, candidates: tuple[Effect, ...]
) -> LinearisedCandidates:
    """Linearise the model about a fit, by its own parameters and by candidates.

    Those of the fit's effects that are among the candidates are put back.
    """
    pose = problem.pose.rows(pose_rows(problem, found.at))
    own_columns = found.own_columns()
    possible = possible_sizes(found.model, problem.cells.measured)[own_columns]
    pose_data, by_x = -pose[:, 0], pose[:, 1:]
    torque_data, torque_by_x = np.zeros(0), np.zeros((0, len(found.x)))
    if problem.torque is not None:
        torque = problem.torque.rows(torque_rows(problem, found.at))
        torque_data, torque_by_x = -torque[:, 0], torque[:, 1:]
    blocks: dict[Effect, CandidateRows] = {}
    for effect in found.effects:
        at = found.columns_of(effect)
        linear = slice(at.start, at.start + effect.linear)
        pose_data = pose_data + by_x[:, linear] @ found.x[linear]
        torque_data = torque_data + torque_by_x[:, linear] @ found.x[linear]
        # Its shape may be anything near.
        factor = np.diag(np.abs(found.of(effect)))
        factor[: effect.linear, : effect.linear] = effect.prior_factor
        blocks[effect] = CandidateRows(by_x[:, at], torque_by_x[:, at], factor)
    # Weights are expected about what is described, not about the fit.
    weights = np.flatnonzero(found.model.having("weight"))
    pose_data = pose_data + by_x[:, weights] @ found.x[weights]
    others = tuple(effect for effect in candidates if effect not in blocks)
    if others:
        blocks |= zip(others, _blocks(problem, found, others), strict=True)
    return LinearisedCandidates(
        pose_data,
        torque_data,
        by_x[:, own_columns] * possible,
        tuple(blocks[effect] for effect in candidates),
    )


def _blocks(
    problem: EvidenceProblem, found: EvidenceFit, effects: tuple[Effect, ...]
) -> list[CandidateRows]:
    """Return the rows of effects that the fit has not, at each of their shapes."""
    states, at = problem.cells.states, found.at
    terms = [effect for effect in effects for _ in effect.starts]
    starts = [start for effect in effects for start in effect.starts]
    T, in_base = at.model.by_terms(states, at.x, terms, starts)
    linear = [values[:, :, : term.linear] for values, term in zip(in_base, terms, strict=True)]
    turn = by_end(at, problem.cells, T)
    pose = problem.pose.rows(turn @ np.concatenate(linear, axis=2))
    torque = np.zeros((0, pose.shape[1]))
    if problem.torque is not None:
        by_x, first = np.zeros((*states.tau_Nm.shape, pose.shape[1])), 0
        for term, start in zip(terms, starts, strict=True):
            columns = slice(first, first + term.linear)
            if shows_torque(term):
                by_x[:, :, columns] = term.torque_derivative(states, start)
            first = columns.stop
        torque = problem.torque.rows(by_x)
    blocks, first = [], 0
    for effect in effects:
        shapes = len(effect.starts)
        columns = slice(first, first + shapes * effect.linear)
        factor = np.asarray(np.kron(np.eye(shapes), effect.prior_factor), dtype=float)
        blocks.append(CandidateRows(pose[:, columns], torque[:, columns], factor))
        first = columns.stop
    return blocks


def testable(
    problem: EvidenceProblem, found: EvidenceFit, effects: tuple[Effect, ...]
) -> tuple[tuple[Effect, ...], tuple[Untestable, ...]]:
    """Divide effects into those that these data can show and those that they cannot."""
    states = problem.cells.states
    known, refused = computable(
        effects, states, logged=problem.torques_logged, weights=problem.torque is not None
    )
    uncertain = found.model.having("weight").any()
    silent = "the poses do not exercise it"
    if not np.any(states.arrival):
        silent += ", or the direction of arrival was not logged"
    shown = []
    every = _beside_own(problem, found, tuple(known))
    for effect, (rows, left, bare, seen) in zip(known, every, strict=True):
        if uncertain:  # what weights take up of it is limited by their own uncertainty
            square = rows.T @ left
            values, vectors = np.linalg.eigh(0.5 * (square + square.T))
            left = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
        share = float(np.linalg.norm(left) / max(float(np.linalg.norm(rows)), COMPUTING.tiny))
        signal = float(np.linalg.norm(left, 2)) if left.size else 0.0
        if np.any(bare):
            share = max(share, float(np.linalg.norm(seen) / np.linalg.norm(bare)))
            signal = float(np.hypot(signal, np.linalg.norm(seen, 2)))
        why = silent if signal == 0.0 else why_hidden(share, signal)
        if why is None:
            shown.append(effect)
        else:
            refused.append(Untestable(effect, why))
    return tuple(shown), tuple(refused)


def _beside_own(
    problem: EvidenceProblem, found: EvidenceFit, effects: tuple[Effect, ...]
) -> Iterator[tuple[Array, Array, Array, Array]]:
    """Yield rows of each effect: of poses, what own parameters leave of these, torques, weighed."""
    lin = linearise(problem, found, effects)
    pose = problem.pose.whitening(0.0)
    own, _ = np.linalg.qr(np.concatenate([pose(lin.own), np.eye(lin.own.shape[1])]))
    own = own[: len(lin.own)]
    torque = None if problem.torque is None else problem.torque.whitening(0.0)
    for block in lin.blocks:
        rows, bare = pose(block.pose @ block.factor), block.torque @ block.factor
        yield rows, rows - own @ (own.T @ rows), bare, bare if torque is None else torque(bare)


def indistinguishable(
    problem: EvidenceProblem, found: EvidenceFit, effects: tuple[Effect, ...]
) -> Mask:
    """Return which effects look the same in these poses, whatever is measured, (m, m).

    Two do when every canonical cosine of what the model's own parameters leave of them is close to
    one. Known before residuals are looked at; such effects stand for each other. Torques are taken
    as the weights require, so that the noise of the log distinguishes nothing.
    """
    states = problem.cells.states
    if states.static_loads is not None:
        quiet = replace(states, tau_Nm=states.static_loads.joint_Nm)
        problem = replace(problem, cells=replace(problem.cells, states=quiet))
    bases = [
        np.linalg.qr(np.concatenate([left, seen]))[0]
        for _, left, _, seen in _beside_own(problem, found, effects)
    ]
    same = np.eye(len(effects), dtype=bool)
    for i, first in enumerate(bases):
        for j in range(i):
            if bases[j].shape == first.shape and not effects[i].generic and not effects[j].generic:
                least = np.linalg.svd(first.T @ bases[j], compute_uv=False)[-1]
                same[i, j] = same[j, i] = bool(least > EVIDENCE.indistinguishable)
    return same


# The search.


@dataclass(frozen=True)
class EndOfSearch:
    """Where the search ended."""

    problem: EvidenceProblem  # the campaign, noise and weights computed about that fit
    fit: EvidenceFit  # the model with the effects found
    evidence: SetEvidence  # about that fit, over the whole family
    family: tuple[Effect, ...]  # the candidates, in the order of the evidence's blocks
    same: Mask  # (m, m) which of them look the same in these poses
    chosen: CandidateSet  # the effects found, as a set of the family
    score: Score  # evidence of that set
    without: tuple[Score, ...]  # evidence of the set less each of its effects

    @property
    def nothing(self) -> Score:
        """Return the evidence of the empty set."""
        return self.evidence.score(())

    @property
    def as_good_nats(self) -> float:
        """Return by how much less log evidence another set is about as good.

        If a rival is the truth, the chance that it falls behind by more than this is below
        `missed_rate` for the whole family (Markov, as for the search).
        """
        return threshold(effects_in(self.family), EVIDENCE.missed_rate)


def threshold(family: int, error_rate: float) -> float:
    """Return the gain in evidence that a name needs: P(any of the family reaches it) <= rate."""
    return float(np.log(max(family, 1) / error_rate))


def evidence_about(
    problem: EvidenceProblem, found: EvidenceFit, family: tuple[Effect, ...]
) -> SetEvidence:
    """Return the evidence of sets of a family, linear about a fit."""
    lin, pose, torque = linearise(problem, found, family), problem.pose, problem.torque
    return SetEvidence(pose, torque, lin.pose_data, lin.torque_data, lin.own, lin.blocks)


def search(
    problem: EvidenceProblem, family: tuple[Effect, ...], error_rate: float, start: EvidenceFit
) -> EndOfSearch:
    """Find the set of effects of a family that the data support, from the model without effects."""
    needed = threshold(effects_in(family), error_rate)
    same = indistinguishable(problem, start, family)
    current = start
    chosen: CandidateSet = ()
    seen: set[frozenset[int]] = set()
    for _ in range(EVIDENCE.most_rounds):
        evidence = evidence_about(problem, current, family)
        chosen = _improve(evidence, same, chosen, needed)
        members = frozenset(k for k, _ in chosen)
        if members in seen:
            break
        seen.add(members)
        effects = tuple(family[k] for k, _ in chosen)
        sizes = tuple(size for _, size in chosen)
        problem, current = refit(problem, effects, sizes, evidence.score(chosen).variances, current)
    return ended_at(problem, current, family, same)


def ended_at(
    problem: EvidenceProblem, current: EvidenceFit, family: tuple[Effect, ...], same: Mask
) -> EndOfSearch:
    """Return what the search has found where it ends at a fit, with the evidence about it."""
    evidence = evidence_about(problem, current, family)
    chosen = tuple(zip(map(family.index, current.effects), current.sizes, strict=True))
    without = tuple(evidence.score(less(chosen, k)) for k in range(len(chosen)))
    score = evidence.score(chosen)
    return EndOfSearch(problem, current, evidence, family, same, chosen, score, without)


def refit(
    problem: EvidenceProblem,
    effects: tuple[Effect, ...],
    sizes: tuple[int, ...],
    variances: tuple[float, float],
    start: EvidenceFit,
) -> tuple[EvidenceProblem, EvidenceFit]:
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
    evidence: SetEvidence, same: Mask, chosen: CandidateSet, needed: float
) -> CandidateSet:
    """Add, exchange and drop effects until nothing helps; each that stays must be needed."""
    forbidden: set[int] = set()
    while chosen := _forward(evidence, same, chosen, forbidden):
        weakest, loss, rest = _weakest(evidence, chosen, needed)
        if loss >= needed:
            break
        # What is not needed in the end is not tried again: forward would only bring it back.
        forbidden.add(weakest)
        chosen = rest
    return chosen


def _forward(
    evidence: SetEvidence, same: Mask, chosen: CandidateSet, forbidden: set[int]
) -> CandidateSet:
    """Add what makes the data likeliest; when nothing does, exchange one member for better."""
    while True:
        enough = evidence.score(chosen).log_evidence + EVIDENCE.forward_nats
        tried = []
        if len(chosen) < EVIDENCE.most_effects:
            tried = [_best_addition(evidence, same, chosen, forbidden)]
        if not tried or tried[0][0] < enough:
            tried = [
                _best_addition(evidence, same, less(chosen, k), forbidden | {member})
                for k, (member, _) in enumerate(chosen)
            ]
        best = max(tried, default=(-np.inf, chosen))
        if best[0] < enough:
            return chosen
        chosen = best[1]


def _best_addition(
    evidence: SetEvidence, same: Mask, chosen: CandidateSet, forbidden: set[int]
) -> tuple[float, CandidateSet]:
    """Return the evidence of the best set with one more member, and that set.

    Nothing forbidden may join, nor what looks the same as a member.
    """
    looks_new = ~same[:, [k for k, _ in chosen]].any(axis=1)
    open_to = [k for k in np.flatnonzero(looks_new).tolist() if k not in forbidden]
    if not open_to:
        return -np.inf, chosen
    gains = evidence.additions(chosen, open_to)
    best = max(range(len(open_to)), key=lambda k: gains[k][0])
    chosen = (*chosen, (open_to[best], gains[best][1]))
    return evidence.score(chosen).log_evidence, chosen


def _weakest(
    evidence: SetEvidence, chosen: CandidateSet, needed: float
) -> tuple[int, float, CandidateSet]:
    """Return which member the set would miss least, how much, and the set without it."""
    whole = evidence.score(chosen).log_evidence
    left = [less(chosen, k) for k in range(len(chosen))]
    scores = [evidence.score(each).log_evidence for each in left]
    if whole - max(scores) >= needed:  # beside a proxy the right effect is small
        left = [resized(evidence, each) for each in left]
        scores = [evidence.score(each).log_evidence for each in left]
    weakest = int(np.argmax(scores))
    return chosen[weakest][0], whole - scores[weakest], left[weakest]


def resized(evidence: SetEvidence, chosen: CandidateSet) -> CandidateSet:
    """Return a set with the size of each member chosen anew, by its evidence."""
    best = evidence.score(chosen).log_evidence, chosen
    for k, (member, _) in enumerate(chosen):
        for size in range(len(EVIDENCE.sizes)):
            tried = (*best[1][:k], (member, size), *best[1][k + 1 :])
            best = max(best, (evidence.score(tried).log_evidence, tried))
    return best[1]


T = TypeVar("T")


def less(values: tuple[T, ...], k: int) -> tuple[T, ...]:
    """Return the values without the k-th."""
    return values[:k] + values[k + 1 :]
