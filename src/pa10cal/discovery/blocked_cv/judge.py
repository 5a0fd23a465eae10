"""Evidence of the effects that a search chose, their alternatives, and the remaining error."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from pydantic import Field
from typing_extensions import override

from pa10cal.arrays import MEDIAN_TO_SIGMA, Array, Index, rms, standard_error_of_sum
from pa10cal.discovery.blocked_cv.block_rows import BlockedRows
from pa10cal.discovery.blocked_cv.effect_set import (
    Candidate,
    EffectSet,
    as_good,
    both_kinds_agree,
    within_bounds,
)
from pa10cal.discovery.blocked_cv.search import Search
from pa10cal.discovery.finding import Rival, smooth_unknown
from pa10cal.discovery.proof import (
    Proof,
    UnknownCause,
    most_influential_pose,
    removed_over_remaining,
)
from pa10cal.discovery.rules import BLOCKS, PROBABILITIES
from pa10cal.fit.position_errors import position_error_mm
from pa10cal.results.discovery import (
    BlockedCrossValidation,
    EvidenceByBlocks,
    Remaining,
    Tried,
    Unexplained,
)
from pa10cal.results.number_text import HALF_WIDTH_95
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.vocabulary import every_effect


class BlockPrediction(BlockedCrossValidation, Proof):
    """How well held-out blocks are predicted without an effect and with it."""

    # its gain in whitened squares over what remains beyond noise; 0 if not known
    ratio_of_readings: float = Field(default=0.0, exclude=True)

    @property
    @override
    def explains(self) -> float:
        return self.gain

    @property
    @override
    def evidence(self) -> EvidenceByBlocks:
        return EvidenceByBlocks(cross_validation_over_blocks=self)

    @property
    @override
    def unknown_cause(self) -> UnknownCause:
        errors_mm = self.rms_without_mm, self.rms_with_mm
        odds, power, fall = PROBABILITIES.known_effect
        return UnknownCause(
            *errors_mm, odds=odds, power=power, fall=fall, ratio_of_readings=self.ratio_of_readings
        )


@dataclass(frozen=True)
class Judged:
    """An effect that was found, with its evidence."""

    effect: Effect  # in the form of the search; maps may be finer in the model
    proof: BlockPrediction
    alternatives: tuple[Effect, ...]  # effects that predict held-out poses as well in its place
    rivals: tuple[Rival, ...] = ()  # every effect that was tried in its place, with its score


def prediction(
    gain: Array,
    whole: float,
    rms_mm: tuple[float, float],
    noise: float | None = None,
    influential_pose: str | None = None,
) -> BlockPrediction:
    """Return how well held-out blocks are predicted without an effect and with it.

    Args:
        gain: (B,) decrease of each block's whitened sum of squares by the effect.
        whole: sum of squares of all blocks without the effect.
        rms_mm: position errors without the effect and with it.
        noise: sum of squares that noise alone leaves; None if not known.
        influential_pose: the pose without which the effect has little evidence.
    """
    part, std = float(gain.sum()) / whole, standard_error_of_sum(gain) / whole
    return BlockPrediction(
        rms_without_mm=rms_mm[0],
        rms_with_mm=rms_mm[1],
        blocks=BLOCKS.blocks,
        improved=int(np.sum(gain > 0.0)),
        gain=part,
        gain_std=std,
        z=part / max(std, np.finfo(float).tiny),
        influential_pose=influential_pose,
        ratio_of_readings=0.0
        if noise is None
        else removed_over_remaining(whole, (1.0 - part) * whole, noise),
    )


def judged_members(
    rows: BlockedRows, search: Search, chosen: EffectSet, with_rivals: EffectSet
) -> tuple[tuple[Judged, ...], Array]:
    """Return the evidence of each member, and the position errors (P,) [mm] of held-out blocks.

    Alternatives are judged with the generic rivals in the set: without them, an effect that
    imitates a rival does as well as the member in its place.
    """
    errors_mm, squares = _held_out_errors(rows, chosen)
    rms_mm = np.sqrt(np.mean(errors_mm**2, axis=0))
    others = search.others(with_rivals)
    squares_with = (
        dict(zip(others, with_rivals.squares_with_each(others), strict=True)) if others else {}
    )
    labels, pose = np.unique(rows.survey.poses.pose, return_inverse=True)
    row_count = int(rows.survey.poses.measured.components_seen.sum())
    found = []
    for k, without in enumerate(chosen.squares_without_each()):
        member, gain = chosen.members[k], without - chosen.squares
        total_gain = float(gain.sum())  # the prior on the arm's weights included
        by_pose = np.bincount(pose, squares[:, k + 1] - squares[:, 0])
        without_pose = np.asarray(total_gain - by_pose, dtype=np.float64)
        influential = most_influential_pose(labels, without_pose, total_gain, search.least_gain)
        both_mm = float(rms_mm[k + 1]), float(rms_mm[0])
        proof = prediction(gain, float(without.sum()), both_mm, search.noise_squares, influential)
        place = with_rivals.members.index(member)
        in_place = in_place_of(search, with_rivals, place, squares_with, row_count)
        found.append(Judged(member.effect, proof, in_place.alternatives, in_place.rivals))
    return tuple(found), errors_mm[:, 0]


def _held_out_errors(rows: BlockedRows, chosen: EffectSet) -> tuple[Array, Array]:
    """Return position errors [mm] and squared whitened errors of held-out poses, (P, 1 + m) each.

    First with all members of a set, then without each of them.
    """
    solutions = np.stack(
        [chosen.solution, *(chosen.solution_without(k) for k in range(len(chosen.members)))]
    )
    errors_mm, squares = np.empty((2, rows.survey.block.size, len(solutions)))
    for block in range(BLOCKS.blocks):
        x = np.zeros((len(chosen.total.projection), len(solutions)))
        x[chosen.index] = solutions[:, block].T
        here = np.flatnonzero(rows.survey.block == block)
        measured, residual = rows.survey.poses.measured.take(here), rows.block_residual(block, x)
        errors_mm[here] = np.stack(
            [position_error_mm(measured, each) for each in residual.T.swapaxes(1, 2)], axis=1
        )
        squares[here] = np.sum((rows.weights.whiteners(here) @ residual) ** 2, axis=1)
    return errors_mm, squares


def remaining_error(
    block: Index, errors_mm: Array, floor_mm: float, expected_mm: float, tried: tuple[Tried, ...]
) -> Remaining:
    """Return the position error of held-out blocks, against noise, and what was tried on it.

    Args:
        block: (P,) block of each pose.
        errors_mm: (P,) position errors.
        floor_mm: mean error that noise alone leaves.
        expected_mm: mean error that noise and uncertain estimates leave.
        tried: what each candidate that was not chosen would still gain.
    """
    means_mm = np.array([errors_mm[block == number].mean() for number in range(BLOCKS.blocks)])
    mean_mm = float(errors_mm.mean())
    return Remaining(
        mean_mm=mean_mm,
        std_mm=float(means_mm.std(ddof=1) / np.sqrt(BLOCKS.blocks)),
        rms_mm=rms(errors_mm),
        floor_mm=floor_mm,
        expected_mm=expected_mm,
        over_floor=over_expected(means_mm, mean_mm, expected_mm),
        tried=tried,
    )


def over_expected(means_mm: Array, mean_mm: float, expected_mm: float) -> bool:
    """Return whether mean errors of blocks (B,) exceed the expected one, robustly against outliers.

    By their mean and its standard error; or by their median and its standard error for normal
    deviates, from their median absolute deviation.
    """
    if mean_mm <= BLOCKS.over_expected * expected_mm:
        return False
    root = np.sqrt(len(means_mm))
    median_mm = float(np.median(means_mm))
    scatter_mm = MEDIAN_TO_SIGMA * float(np.median(np.abs(means_mm - median_mm)))
    median_std_mm = BLOCKS.median_errors * scatter_mm / root
    by_mean = mean_mm - expected_mm > BLOCKS.over_expected_errors * means_mm.std(ddof=1) / root
    by_median = (
        median_mm > BLOCKS.over_expected * expected_mm
        and median_mm - expected_mm > BLOCKS.over_expected_errors * median_std_mm
    )
    return bool(by_mean or by_median)


class InPlace(NamedTuple):
    """Effects that may be present in place of a member."""

    alternatives: tuple[Effect, ...]  # effects that predict as well, to within a standard error
    rivals: tuple[Rival, ...]  # every effect that was tried there, with its score


def in_place_of(
    search: Search,
    chosen: EffectSet,
    member: int,
    squares_with: Mapping[Candidate, Array],
    row_count: int,
) -> InPlace:
    """Return the effects that may be present in place of a member.

    A candidate is no alternative if the member is needed in addition to it. Neither is the map of
    the member's joint, which can always imitate a named effect there.

    Args:
        search: the search, with its criteria.
        chosen: the set that it found.
        member: number of the member.
        squares_with: squares (B,) of the whole set with each other candidate added.
        row_count: how many rows there are; their variance is estimated from the squares.
    """
    own = chosen.members[member]
    rest = chosen.without_member(member)
    if not squares_with:
        return InPlace((), ())
    variance = max(float(chosen.squares.sum()), search.noise_squares) / row_count
    alternatives: dict[tuple[str, str], Effect] = {}
    best: dict[tuple[str, str], Rival] = {}
    instead_of = rest.squares_with_each(tuple(squares_with))
    for other, instead in zip(squares_with, instead_of, strict=True):
        nats = 0.5 * (chosen.squares - instead) / variance / PROBABILITIES.blocks
        known = best.get(other.name)
        if known is None or nats.sum() > known.nats.sum():
            # Unlike evidence, held-out squares hardly penalise a more flexible effect.
            flexible = other.effect.generic or (other.is_map and not own.is_map)
            weight = PROBABILITIES.flexible if flexible else 1.0
            best[other.name] = Rival(other.effect, nats, weight)
        own_map = other.is_map and own.effect.coordinates == other.effect.coordinates
        if other.effect.generic or own_map or not as_good(instead, chosen.squares):
            continue
        if not search.helps(instead, squares_with[other]):
            alternatives.setdefault(other.name, other.effect)
    return InPlace(tuple(alternatives.values()), tuple(best.values()))


def gains_of_others(search: Search, chosen: EffectSet) -> tuple[Tried, ...]:
    """Return the gain by each candidate that was not chosen, the largest first."""
    others = search.others(chosen)
    if not others:
        return ()
    best: dict[tuple[str, str], Tried] = {}
    whole = float(chosen.squares.sum())
    for other, squares in zip(others, chosen.squares_with_each(others), strict=True):
        gain = chosen.squares - squares
        helps = search.helps(chosen.squares, squares)
        ahead = chosen.with_member(other) if helps else None
        entry = Tried(
            id=other.effect.id,
            of=other.effect.of,
            gain=float(gain.sum()) / whole,
            gain_std=standard_error_of_sum(gain) / whole,
            helps=helps,
            positions_and_attitudes_agree=ahead and both_kinds_agree(chosen, ahead),
            physical=ahead and within_bounds(ahead),
        )
        known = best.get(other.name)
        if known is None or (entry.helps, entry.gain) > (known.helps, known.gain):
            best[other.name] = entry
    return tuple(sorted(best.values(), key=lambda entry: -entry.gain))


def unexplained(
    remaining: Remaining, nameless: Sequence[Effect], places: Collection[str]
) -> tuple[Unexplained, ...]:
    """Return the unexplained parts of the remaining error.

    Where noise explains what is left, only what was found that has no name: held-out blocks show it
    as surely as a name, however little it moves the poses.

    Args:
        nameless: what was found that has no name.
        places: those where something was found, such as `joint 2`.
    """
    mean_mm, others = remaining.mean_mm, remaining.tried
    found = [smooth_unknown(each, mean_mm, "held-out blocks") for each in nameless]
    if not remaining.over_floor:
        return tuple(found)
    helpful: dict[str, Tried] = {}  # of each place the best effect that helps and was not taken
    for entry in others:
        if entry.helps:
            helpful.setdefault(entry.of, entry)
    found += [
        Unexplained(
            of=entry.of,
            form=entry.id,
            shared_error_mm=mean_mm,
            why=f"{100 * entry.gain:.0f} % of the remaining error depends on {entry.id} of "
            f"{entry.of}, but {_why_not_taken(entry, places)}",
        )
        for entry in helpful.values()
    ]
    if found:
        return tuple(found)
    why = (
        f"held-out blocks have a mean error of {mean_mm:.3f} mm where noise and uncertain "
        f"parameters give {remaining.expected_mm:.3f} mm, and nothing that was tried significantly "
        "predicts it"
    )
    # What predicts as much by chance would send a reader after a name.
    if others and others[0].gain > HALF_WIDTH_95 * others[0].gain_std:
        nearest = others[0]
        why += (
            f"; the nearest is {nearest.id} of {nearest.of}, "
            f"({100 * nearest.gain:.1f} ± {100 * nearest.gain_std:.1f}) % of it"
        )
    return (Unexplained(of=None, form=None, shared_error_mm=mean_mm, why=why),)


def _why_not_taken(entry: Tried, places: Collection[str]) -> str:
    """Return in words why an effect that helps is not in the model."""
    if entry.physical is False:
        return "with a sign or size that it physically cannot have: it is no effect of that name"
    if entry.positions_and_attitudes_agree is False:
        return "positions and orientations contradict each other: it is no effect of that name"
    if entry.of in places:
        return "what was found in its place predicts as much of it"
    if any(each.role_in_search == "substitute" for each in every_effect() if each.id == entry.id):
        return (
            "it is flexible enough to imitate several others: it is only exchanged for a named "
            "effect"
        )
    return "it joined no set within the rounds of the search"
