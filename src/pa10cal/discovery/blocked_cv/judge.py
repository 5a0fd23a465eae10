"""The result of the search: evidence of each effect, its alternatives, the remaining error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from pa10cal.arrays import Array
from pa10cal.discovery.blocked_cv.family import Chosen, both_kinds_agree, standard_error
from pa10cal.discovery.blocked_cv.rows import Rows
from pa10cal.discovery.blocked_cv.search import Search
from pa10cal.discovery.blocked_cv.survey import BLOCKS
from pa10cal.discovery.linear import error_mm
from pa10cal.results.discovery import BlockedCrossValidation, Remaining, Tried, Unexplained
from pa10cal.terms.effects.effect import Effect

#: The remaining error counts as more than noise where it is so many times as large.
_OVER_FLOOR = 1.15
#: Standard errors over blocks by which it has to be larger.
_SURELY = 3.0
#: A name without one pose keeps more of its gain than this, or that pose alone carries it.
CARRIED = 0.5


class Prediction(BlockedCrossValidation):
    """How well held-out blocks are predicted without an effect and with it."""

    carrier: str | None = Field(
        default=None,
        exclude=True,
        description="the one pose without which not half of the gain would be left, and too "
        "little for a name; None where there is no such pose",
    )


@dataclass(frozen=True)
class Judged:
    """An effect that was found, with what speaks for it."""

    effect: Effect  # as the search has it; maps may be finer in the model
    proof: Prediction  # how well it predicts what was held out
    alternatives: tuple[Effect, ...]  # effects that predict that as well in its place


def prediction(
    gain: Array, whole: float, rms_mm: tuple[float, float], carrier: str | None = None
) -> Prediction:
    """Return how well held-out blocks are predicted without an effect and with it.

    Args:
        gain: (B,) what the weighed sum of squares of every block comes down by.
        whole: sum of squares without the effect.
        rms_mm: root mean square position errors without it and with it.
        carrier: the one pose that carries it.
    """
    part, std = float(gain.sum()) / whole, standard_error(gain) / whole
    return Prediction(
        rms_without_mm=rms_mm[0],
        rms_with_mm=rms_mm[1],
        blocks=BLOCKS,
        improved=int(np.sum(gain > 0.0)),
        gain=part,
        gain_std=std,
        z=part / max(std, np.finfo(float).tiny),
        carrier=carrier,
    )


def judged_members(rows: Rows, search: Search, chosen: Chosen) -> tuple[tuple[Judged, ...], Array]:
    """Return the evidence of each member, and the remaining error of every block.

    Args:
        rows: of the campaign.
        search: the search.
        chosen: what it holds.

    Returns:
        One entry a member; position errors (P,) [mm] of the held-out blocks.
    """
    state = chosen.state
    solutions = np.stack(
        [state.solution, *(state.solution_without(k + 1) for k in range(len(chosen.members)))]
    )
    count = rows.survey.block.size
    errors_mm, squares = np.empty((2, count, len(solutions)))
    for b in range(BLOCKS):
        x = np.zeros((len(state.total.projection), len(solutions)))
        x[state.at] = solutions[:, b].T
        here = rows.survey.block == b
        measured, left = rows.survey.poses.measured.take(here), rows.left_of(b, x)
        errors_mm[here] = np.stack([error_mm(measured, each) for each in left.T.swapaxes(1, 2)], 1)
        whiteners = rows.weights.whiteners(np.flatnonzero(here))
        squares[here] = np.sum((whiteners @ left) ** 2, axis=1)
    rms = np.sqrt(np.mean(errors_mm**2, axis=0))
    found = []
    for k, without in enumerate(state.without_each()):
        gain = without - chosen.squares
        by_pose = squares[:, k + 1] - squares[:, 0]
        carrier = _carrier(rows, by_pose, float(gain.sum()), search.least_gain)
        rms_mm = float(rms[k + 1]), float(rms[0])
        proof = prediction(gain, float(without.sum()), rms_mm, carrier)
        found.append(Judged(chosen.members[k].effect, proof, alternatives(search, chosen, k)))
    return tuple(found), errors_mm[:, 0]


def _carrier(rows: Rows, gain: Array, whole: float, least_gain: float) -> str | None:
    """Return the pose without which nearly nothing is gained (P,); None for none.

    The whole gain holds what uncertain weights would have to be, beside that of the poses.
    """
    by_pose: dict[str, float] = {}
    for label, each in zip(rows.survey.poses.pose.tolist(), gain.tolist(), strict=True):
        by_pose[label] = by_pose.get(label, 0.0) + each
    worst = max(by_pose, key=lambda label: by_pose[label])
    left = whole - by_pose[worst]
    return worst if left < min(least_gain, CARRIED * whole) else None


def remaining_error(
    rows: Rows, errors_mm: Array, floor_mm: float, others: tuple[Tried, ...]
) -> Remaining:
    """Return the position error of held-out blocks, against noise, and what was tried on it."""
    means = np.array([errors_mm[rows.survey.block == b].mean() for b in range(BLOCKS)])
    mean_mm, std_mm = float(errors_mm.mean()), float(means.std(ddof=1) / np.sqrt(BLOCKS))
    return Remaining(
        mean_mm=mean_mm,
        std_mm=std_mm,
        rms_mm=float(np.sqrt(np.mean(errors_mm**2))),
        floor_mm=floor_mm,
        over_floor=mean_mm > _OVER_FLOOR * floor_mm and mean_mm - floor_mm > _SURELY * std_mm,
        tried=others,
    )


def alternatives(search: Search, chosen: Chosen, member: int) -> tuple[Effect, ...]:
    """Return the effects that predict as well in one's place, within a standard error.

    One that leaves it needed all the same is no alternative. The map of a joint can always do what
    a named form of that joint does, and is none.
    """
    own = chosen.members[member]
    less = chosen.reduced(member)
    others = [
        other
        for other in search.others(chosen)
        if not other.effect.generic
        and not (other.is_map and own.effect.coordinates == other.effect.coordinates)
    ]
    if not others:
        return ()
    columns = [other.columns for other in others]
    instead, beside = less.state.with_each(columns), chosen.state.with_each(columns)
    close: dict[tuple[str, str], Effect] = {}
    for other, alone, both in zip(others, instead, beside, strict=True):
        lost = alone - chosen.squares
        if lost.sum() <= standard_error(lost) and not search.helps(alone, both):
            close.setdefault(other.name, other.effect)
    return tuple(close.values())


def tried(search: Search, chosen: Chosen) -> tuple[Tried, ...]:
    """Return what each candidate not chosen would still gain."""
    others = search.others(chosen)
    if not others:
        return ()
    found = chosen.state.with_each([other.columns for other in others])
    best: dict[tuple[str, str], Tried] = {}
    whole = float(chosen.squares.sum())
    for other, squares in zip(others, found, strict=True):
        gain = chosen.squares - squares
        helps = search.helps(chosen.squares, squares)
        entry = Tried(
            id=other.effect.id,
            of=other.effect.of,
            gain=float(gain.sum()) / whole,
            gain_std=standard_error(gain) / whole,
            helps=helps,
            positions_and_attitudes_agree=both_kinds_agree(chosen, chosen.extended(other))
            if helps
            else None,
        )
        if other.name not in best or entry.gain > best[other.name].gain:
            best[other.name] = entry
    return tuple(sorted(best.values(), key=lambda entry: -entry.gain))


def without_rivals(chosen: Chosen) -> Chosen:
    """Return the set without what has no name."""
    for k in reversed(range(len(chosen.members))):
        if chosen.members[k].effect.generic:
            chosen = chosen.reduced(k)
    return chosen


def unexplained(remaining: Remaining, nameless: Sequence[Effect]) -> tuple[Unexplained, ...]:
    """Return what remains without a name; nothing where noise explains it.

    Args:
        remaining: position error of the held-out blocks.
        nameless: smooth unknown functions that the search held.
    """
    if not remaining.over_floor:
        return ()
    left_mm, others = remaining.mean_mm, remaining.tried
    places = [
        Unexplained(
            of=effect.of,
            form=effect.id,
            shared_error_mm=left_mm,
            why=f"a smooth unknown function ({effect.id}) of {effect.of} predicts held-out blocks "
            f"better than any name{effect.advice}",
        )
        for effect in nameless
    ]
    places += [
        Unexplained(
            of=entry.of,
            form=entry.id,
            shared_error_mm=left_mm,
            why=f"{100 * entry.gain:.0f} % of the remaining error depends on {entry.id} of "
            f"{entry.of}, but positions and attitudes contradict each other: it is no "
            "effect of that name",
        )
        for entry in _contradicting(others)
    ]
    if places:
        return tuple(places)
    why = (
        f"held-out blocks have a mean error of {left_mm:.3f} mm where noise alone gives "
        f"{remaining.floor_mm:.3f} mm, and nothing that was tried significantly predicts it"
    )
    if others:
        nearest = others[0]
        why += (
            f"; the nearest is {nearest.id} of {nearest.of}, "
            f"({100 * nearest.gain:.1f} ± {100 * nearest.gain_std:.1f}) % of it"
        )
    return (Unexplained(of=None, form=None, shared_error_mm=left_mm, why=why),)


def _contradicting(others: Sequence[Tried]) -> list[Tried]:
    """Return what helps and makes positions or attitudes worse, the best of each place."""
    best: dict[str, Tried] = {}
    for entry in others:
        if entry.helps and entry.positions_and_attitudes_agree is False:
            best.setdefault(entry.of, entry)
    return list(best.values())
