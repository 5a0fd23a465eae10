"""Is an effect there? Sign flips over poses, and poses and loads held out.

The unit of evidence is the pose. If an effect is absent, what it seems to explain at one pose has
either sign; flipping all rows of a pose together keeps whatever its loads, repeats and components
share. The largest gain of any candidate under flips is what chance makes of this family on these
data (max-T), whatever the noise really is.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pa10cal.arrays import Array, Index
from pa10cal.discovery.evidence.likelihood import CandidateRows, Score
from pa10cal.discovery.evidence.problem import (
    EvidenceFit,
    EvidenceProblem,
    NoiseModel,
    Whitening,
    covariance_of,
    fit,
)
from pa10cal.discovery.evidence.search import (
    EndOfSearch,
    ended_at,
    evidence_about,
    less,
    linearise,
)
from pa10cal.discovery.finding import Finding, Proof, Rival, carrier_of
from pa10cal.discovery.linear import left_out, mean_length, position_noise
from pa10cal.discovery.rules import EVIDENCE
from pa10cal.discovery.verdict import is_named, smooth_unknown
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.observations import reading_groups
from pa10cal.results.discovery import CrossValidation, EvidenceByRepeats, Unexplained
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.weights import is_fault


class Confirmation(EvidenceByRepeats, Proof):
    """What speaks for one effect, all others being in the model."""

    @property
    @override
    def explains(self) -> float:
        return self.cross_validation_over_poses.explained

    @property
    @override
    def evidence(self) -> EvidenceByRepeats:
        return self


@dataclass(frozen=True)
class WeighedRows:
    """Weighed rows of both channels."""

    own: Array  # (R, k) of the model's own parameters and of the members
    members: tuple[slice, ...]  # columns of each member in `own`
    data: Array  # (R,) measured minus predicted
    family: tuple[Array, ...]  # rows of each candidate
    cell: Index  # (R,) the cell of each row


def confirm(
    problem: EvidenceProblem, found: EndOfSearch, needed: float = 0.0
) -> tuple[Confirmation, ...]:
    """Confirm every effect that the search found; a name needs so much log evidence."""
    if not found.fit.effects:
        return ()
    rows = weighed_rows(problem, found, found.family)
    unturned = weighed_rows(problem, found, found.fit.effects, turned=False)
    labels, pose = np.unique(problem.cells.pose, return_inverse=True)
    loads, load = np.unique(problem.cells.states.load_N, return_inverse=True)
    signs = np.random.default_rng(EVIDENCE.flips_seed).choice(
        [-1.0, 1.0], (EVIDENCE.flips, int(pose.max()) + 1)
    )
    return tuple(
        Confirmation(
            lost_without_it_nats=found.score.log_evidence - without.log_evidence,
            needed_nats=needed,
            p_sign_flips_max_t=_flipped(rows, k, pose, signs),
            p_needed=EVIDENCE.false_rate,
            cross_validation_over_poses=_cross_validation(rows, k, pose % EVIDENCE.folds, pose),
            cross_validation_over_loads=_cross_validation(unturned, k, load, pose)
            if len(loads) > 1
            else None,
            carrier=_carrier(rows, k, pose, labels, needed),
        )
        for k, without in enumerate(found.without)
    )


def weighed_rows(
    problem: EvidenceProblem, found: EndOfSearch, family: tuple[Effect, ...], *, turned: bool = True
) -> WeighedRows:
    """Return all rows by independent errors of unit variance.

    Those of candidates, and of effects that the search holds; turned by what the cells of a pose
    share, else by cell.
    """
    wanted = tuple(dict.fromkeys((*family, *found.fit.effects)))
    lin, score = linearise(problem, found.fit, wanted), found.score
    blocks = dict(zip(wanted, lin.blocks, strict=True))

    def rows_of(channel: NoiseModel, variance: float, rows: Array) -> Array:
        if turned:
            return channel.whitening(variance)(rows)
        cells, b, _ = channel.whitener.shape
        weighed = channel.whitening(0.0)(rows).reshape(cells, -1)
        back: Array = (channel.shared.turn.T @ weighed).reshape(cells * b, -1)
        return back

    def both(pose_rows: Array, torque_rows: Array) -> Array:
        parts = [rows_of(problem.pose, score.pose_variance, pose_rows)]
        if problem.torque is not None:
            parts.append(rows_of(problem.torque, score.torque_variance, torque_rows))
        return np.concatenate(parts)

    def block(candidate: CandidateRows, scale: float) -> Array:
        factor = scale * candidate.factor
        return both(candidate.pose @ factor, candidate.torque @ factor)

    own = both(lin.own, np.zeros((len(lin.torque_data), lin.own.shape[1])))
    # Weights that are uncertain are an error that all poses share: as parameters they would take up
    # what their uncertainty leaves no room for.
    uncertain = np.isin(found.fit.own_columns(), np.flatnonzero(found.fit.model.having("weight")))
    known = Whitening.of(np.ones(len(own)), own[:, uncertain])
    own = known(own[:, ~uncertain])
    of_members = [
        known(block(blocks[effect], EVIDENCE.sizes[found.fit.size_of[effect]]))
        for effect in found.fit.effects
    ]
    stops = np.cumsum([own.shape[1], *(part.shape[1] for part in of_members)]).tolist()
    cells = [np.repeat(np.arange(len(problem.cells)), problem.pose.whitener.shape[1])]
    if problem.torque is not None:
        cells.append(np.repeat(np.arange(len(problem.cells)), problem.torque.whitener.shape[1]))
    return WeighedRows(
        own=np.concatenate([own, *of_members], axis=1),
        members=tuple(slice(a, b) for a, b in pairwise(stops)),
        data=known(both(lin.pose_data[:, None], lin.torque_data[:, None]))[:, 0],
        family=tuple(known(block(blocks[effect], 1.0)) for effect in family) if turned else (),
        cell=np.concatenate(cells),
    )


def _flipped(rows: WeighedRows, k: int, pose: Index, signs: Array) -> float:
    """Return the share of sign flips in which some candidate gains as much as member k."""
    others = np.delete(rows.own, rows.members[k], axis=1)
    other = Gaussian.of(others, rows.data)

    def left(columns: Array) -> Array:
        taken: Array = columns - others @ other.taken_of(others.T @ columns)
        return taken

    data, of_row = left(rows.data[:, None]), pose[rows.cell]

    def gain(columns: Array, signs: Array) -> Array:
        """Return the gain in evidence under each flip of signs (F, P)."""
        columns = left(columns)
        scores = np.zeros((int(of_row.max()) + 1, columns.shape[1]))  # pose by pose
        np.add.at(scores, of_row, columns * data)
        values, vectors = np.linalg.eigh(columns.T @ columns)
        values = np.maximum(values, 0.0)
        sizes = np.array(EVIDENCE.sizes)[:, None] ** 2
        explained = (signs @ scores @ vectors) ** 2 @ (sizes / (1.0 + sizes * values)).T
        best: Array = 0.5 * (explained - np.log1p(sizes * values).sum(axis=1)).max(axis=1)
        return best

    mine = gain(rows.own[:, rows.members[k]], np.ones((1, signs.shape[1])))
    highest = np.full(len(signs), -np.inf)
    for columns in rows.family:
        highest = np.maximum(highest, gain(columns, signs))
    return float((1 + np.count_nonzero(highest >= mine[0])) / (1 + len(signs)))


def _carrier(
    rows: WeighedRows, k: int, pose: Index, labels: NDArray[np.str_], needed: float
) -> str | None:
    """Return the pose without which nearly nothing speaks for member k; None for none."""
    without = np.delete(np.arange(rows.own.shape[1]), rows.members[k])
    total = Gaussian.of(rows.own, rows.data)

    def loss(of: Gaussian) -> float:
        return of.log_evidence - of.along(without).log_evidence

    of_row, whole = pose[rows.cell], loss(total)
    left = np.empty(len(labels))
    for number in range(len(labels)):
        at = of_row == number
        left[number] = loss(total - Gaussian.of(rows.own[at], rows.data[at]))
    return carrier_of(labels, left, whole, needed)


def _cross_validation(
    rows: WeighedRows, k: int, fold_of_cell: Index, pose_of_cell: Index
) -> CrossValidation:
    """Return how member k does on each fold, all being fitted on the others."""
    fold, pose = fold_of_cell[rows.cell], pose_of_cell[rows.cell]
    without = np.delete(rows.own, rows.members[k], axis=1)
    errors = [np.bincount(pose, left_out(rows.data, own, fold) ** 2) for own in (rows.own, without)]
    gain = errors[1] - errors[0]
    spread = float(gain.std(ddof=1)) / np.sqrt(len(gain))
    return CrossValidation(
        explained=float(gain.sum() / errors[1].sum()),
        z=float(gain.mean() / spread) if spread > 0 else 0.0,
    )


# From the set the search found to a verdict: names, alternatives, the remaining error.


@dataclass(frozen=True)
class Judgement:
    """What the search comes to."""

    findings: tuple[Finding, ...]  # effects of the vocabulary, in the order found
    unexplained: tuple[Unexplained, ...]  # what remains without a name
    found: EndOfSearch  # the search, its fit holding every finding and every generic effect


#: A full refit with another effect in one's place: that other one, the fit, and its evidence.
_Refit = tuple[Effect, EvidenceFit, Score]


def judge(found: EndOfSearch, needed: float) -> Judgement:
    """Judge what the search found; a name needs so much log evidence."""
    found = _prefer_named(found)
    rivals = {effect: _rivals(found, effect) for effect in found.fit.effects}
    confirmations = dict(zip(found.fit.effects, confirm(found.problem, found, needed), strict=True))
    covariance = covariance_of(found.problem, found.fit)
    findings = []
    for effect in found.fit.effects:
        if effect.generic or confirmations[effect].p_sign_flips_max_t > EVIDENCE.false_rate:
            continue
        x, of_x = found.fit.reported(effect, covariance)
        close, every = rivals[effect]
        findings.append(Finding(effect, x, of_x, close, confirmations[effect], every))
    unexplained = _unexplained(found, confirmations)
    findings = [f for f in findings if not _bent(found, f.effect, unexplained)]
    return Judgement(tuple(findings), unexplained, found)


def _prefer_named(found: EndOfSearch) -> EndOfSearch:
    """Put a named form in the place of a map or a generic effect that is no better."""
    for effect in found.fit.effects:
        if is_named(effect) or is_fault(effect):
            continue
        named = _linear_scores(found, effect, filter(is_named, found.family))
        for _, rival, _ in _as_good(found, _refitted(found, effect, named)):
            return _prefer_named(ended_at(found.problem, rival, found.family, found.same))
    return found


def _rivals(found: EndOfSearch, effect: Effect) -> tuple[tuple[Effect, ...], tuple[Rival, ...]]:
    """Return the effects of the vocabulary that explain the data as well in one's place, and all.

    By full refits where they come near, else linear about the fit with the effect.
    """
    if effect.generic:
        return (), ()
    here = found.score.log_evidence
    linear = _linear_scores(found, effect, found.family)
    scores = {each: nats for each, (nats, _) in linear.items()}
    nameless = {each: score for each, score in linear.items() if each.generic}
    refits = _refitted(found, effect, {e: linear[e] for e in linear if e not in nameless})
    for each, _, score in (*refits, *_refitted(found, effect, nameless)):
        scores[each] = score.log_evidence
    rivals = []
    for each, _, score in _as_good(found, refits):
        # A map can always do what a named form of its joint does.
        of_map = is_named(effect) and each.id == JointErrorMap.id
        if not of_map or score.log_evidence >= here - float(np.log(EVIDENCE.odds_over_map)):
            rivals.append(each)
    place = found.family.index(effect)
    same = [found.family[k] for k in np.flatnonzero(found.same[place]) if k != place]
    # Nothing that was measured in these poses speaks for either of what looks the same.
    scores |= dict.fromkeys((each for each in same if each in scores), here)
    every = tuple(Rival(each, np.array([nats - here])) for each, nats in scores.items())
    return tuple(dict.fromkeys([*same, *rivals])), every


def _linear_scores(
    found: EndOfSearch, effect: Effect, some: Iterable[Effect]
) -> dict[Effect, tuple[float, int]]:
    """Return the log evidence of each of some effects in one's place, and its size.

    Of those alone that the model has not.
    """
    kept = less(found.chosen, found.fit.effects.index(effect))
    without = found.evidence.score(kept).log_evidence
    others = [each for each in some if each not in found.fit.effects]
    gains = found.evidence.additions(kept, list(map(found.family.index, others)))
    return {each: (without + gain, size) for each, (gain, size) in zip(others, gains, strict=True)}


def _as_good(found: EndOfSearch, refits: Sequence[_Refit]) -> list[_Refit]:
    """Return the refits that are about as good, best first."""
    least = found.score.log_evidence - found.as_good_nats
    return [each for each in refits if each[2].log_evidence >= least]


def _refitted(
    found: EndOfSearch, effect: Effect, linear: Mapping[Effect, tuple[float, int]]
) -> list[_Refit]:
    """Return full refits with another effect in one's place that come near, best first."""
    kept = less(found.chosen, found.fit.effects.index(effect))
    least = found.score.log_evidence - found.as_good_nats - EVIDENCE.refit_margin_nats
    close = [
        (nats, found.family.index(each), size)
        for each, (nats, size) in linear.items()
        if nats >= least
    ]
    refits = []
    for _, candidate, size in sorted(close, reverse=True)[: EVIDENCE.most_refits]:
        effects = tuple(found.family[k] for k in (*(k for k, _ in kept), candidate))
        sizes = (*(size for _, size in kept), size)
        refit = fit(found.problem, effects, sizes, found.score.variances, found.fit)
        own = evidence_about(found.problem, refit, refit.effects)
        score = own.score(tuple(enumerate(refit.sizes)))
        refits.append((found.family[candidate], refit, score))
    return sorted(refits, key=lambda each: -each[2].log_evidence)


def _unexplained(
    found: EndOfSearch, confirmations: dict[Effect, Confirmation]
) -> tuple[Unexplained, ...]:
    """Return what generic effects hold, or what poses still share, beyond the repeatability."""
    problem = found.problem
    floor, group = floor_mm(problem), reading_groups(problem.readings)
    of_averages = np.mean(1.0 / np.bincount(group)[group])  # variance, in those of one reading
    places = []
    for effect, without in zip(found.fit.effects, found.without, strict=True):
        shared_mm = shared_error_mm(problem, without.pose_variance)
        counts = shared_mm > floor or without.torque_variance > of_averages
        if (
            effect.generic
            and counts
            and confirmations[effect].p_sign_flips_max_t <= EVIDENCE.false_rate
        ):
            places.append(smooth_unknown(effect, shared_mm, "it"))
    left_mm = shared_error_mm(problem, found.score.pose_variance)
    if not places and left_mm > floor:
        why = "no effect of the vocabulary explains what the readings of a pose share"
        places.append(Unexplained(of=None, form=None, shared_error_mm=left_mm, why=why))
    return tuple(places)


def _bent(found: EndOfSearch, effect: Effect, unexplained: tuple[Unexplained, ...]) -> bool:
    """Return whether generic effects of an effect's place, all together, could do without it."""
    if not unexplained:
        return False
    chosen, evidence = found.chosen, found.evidence
    for k, rival in enumerate(found.family):
        there = rival in found.fit.effects
        if (rival.generic or rival.id == JointErrorMap.id) and rival.of == effect.of and not there:
            ((_, size),) = evidence.additions(chosen, [k])
            chosen = (*chosen, (k, size))
    place = found.fit.effects.index(effect)
    whole = evidence.score(chosen).log_evidence
    without = evidence.score(less(chosen, place)).log_evidence
    return whole - without < found.as_good_nats


def shared_error_mm(problem: EvidenceProblem, variance: float) -> float:
    """Return the position error that a shared variance amounts to, root mean square over poses."""
    position = np.trace(_position_noise(problem), axis1=1, axis2=2).mean()
    return float(1e3 * np.sqrt(variance * position))


def floor_mm(problem: EvidenceProblem, repeats: NDArray[np.int64] | None = None) -> float:
    """Return the mean position error that the repeatability alone leaves in averaged poses.

    Of so many readings (P,) each; None for those of the poses fitted.
    """
    variance = _position_noise(problem)
    if repeats is None:
        group = reading_groups(problem.readings)
        variance = variance / np.bincount(group)[group][:, None, None]
    else:
        variance = variance.mean(axis=0) / repeats[:, None, None]
    return float(1e3 * np.mean(mean_length(variance)))


def _position_noise(problem: EvidenceProblem) -> Array:
    return position_noise(problem.readings.measured, problem.noise.cov)
