"""The search by held-out blocks: what joins, what leaves, how smooth maps are, what has a name.

An effect has to predict the held-out blocks better than the model does without it: by more than
three standard errors of the gain, from its scatter between blocks; by more than the chance gain of
the best of so many candidates; and by a part of the remaining error over the noise, so that a small
effect is not named where it may only replace another one that is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array, Index
from pa10cal.discovery.blocked_cv.family import (
    Candidate,
    Columns,
    EffectSet,
    both_kinds_agree,
    start,
    within_bounds,
)
from pa10cal.discovery.blocked_cv.survey import Products, ShapedEffect
from pa10cal.discovery.evidence.search import threshold
from pa10cal.discovery.linear import standard_error
from pa10cal.discovery.preparation import is_fault
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import JointErrorMap

#: Standard errors over blocks by which an effect must help.
STANDARD_ERRORS = 3.0
#: Part of the remaining error over the noise that an effect must be worth.
LEAST_SHARE = 0.05
#: Standard deviations below which 5 of 100 lie.
_NEARLY_ALWAYS = 1.645
_MOST_ROUNDS = 3
_MOST_NAMES = 4
#: Standard errors by which all names of a place together may fall behind a map, to be tried.
_HOPELESS = 3.0


@dataclass(frozen=True, eq=False)
class Step:
    """One step of the search."""

    members: tuple[Candidate, ...]  # what is in the model after it
    squares: Array  # (B,) what is then left of each block


class Search:
    """Looks for the set of effects that predicts left-out blocks best."""

    def __init__(
        self,
        products: Products,
        own: Index,
        family: Sequence[Candidate],
        noise: float,
        error_rate: float,
        own_sizes: Array | None = None,
    ) -> None:
        """Take what is judged.

        Args:
            products: of all columns, block by block.
            own: columns of the calibrated model.
            family: candidates.
            noise: sum of squares that noise alone leaves.
            error_rate: probability allowed of naming anything where nothing is missing.
            own_sizes: sizes expected of the calibrated model's parameters; None for one.
        """
        self.family = tuple(family)
        self.noise = noise
        names = {candidate.name for candidate in family if not is_fault(candidate.effect)}
        self.effects = len(names)
        self.least_gain = 2.0 * threshold(max(self.effects, 1), error_rate)
        self.steps: list[Step] = []
        own_sizes = np.ones(len(own)) if own_sizes is None else own_sizes
        self._nothing = start(products, Columns(own, own_sizes))

    def run(self) -> EffectSet:
        """Search until the set stays."""
        chosen = self._noted(self._nothing)
        settled: list[ShapedEffect] | None = None
        for _ in range(_MOST_ROUNDS):
            chosen = self._backward(self._forward(chosen))
            if settled == [candidate.shaped for candidate in chosen.members]:
                break
            chosen = self._prefer_named(self._backward(self._smoothed(chosen)))
            settled = [candidate.shaped for candidate in chosen.members]
        return chosen

    def helps(self, before: Array, after: Array) -> bool:
        """Return whether sums of squares (B,) of held-out blocks come down enough."""
        gain = before - after
        total = float(gain.sum())
        left_over = max(float(after.sum()) - self.noise, 0.0)
        return total > max(
            self.least_gain, LEAST_SHARE * left_over
        ) and total > STANDARD_ERRORS * standard_error(gain)

    def is_surely_found(self, gain: float) -> bool:
        """Return whether an expected gain helps enough in 95 of 100 campaigns.

        A gain in squares of unit noise scatters by twice its root.
        """
        scatter = 2.0 * np.sqrt(gain)
        least = max(self.least_gain, STANDARD_ERRORS * scatter)
        return bool(gain - _NEARLY_ALWAYS * scatter >= least)

    def others(self, chosen: EffectSet) -> list[Candidate]:
        """Return the candidates of which no form is in the set."""
        there = {candidate.name for candidate in chosen.members}
        return [candidate for candidate in self.family if candidate.name not in there]

    def _forward(self, chosen: EffectSet) -> EffectSet:
        """Add what helps most, while anything helps enough."""
        while others := self.others(chosen):
            found = chosen.with_each(others)
            for k in np.argsort(found.sum(axis=1)):
                if not self.helps(chosen.squares, found[k]):
                    continue
                ahead = chosen.extended(others[k])
                if within_bounds(ahead) and both_kinds_agree(chosen, ahead):
                    break
            else:
                return chosen
            chosen = self._noted(ahead)
        return chosen

    def _smoothed(self, chosen: EffectSet) -> EffectSet:
        """Choose spacing and smoothness of each map anew, the others being there."""
        for name in [candidate.name for candidate in chosen.members if candidate.is_map]:
            place = [candidate.name for candidate in chosen.members].index(name)
            forms = [candidate for candidate in self.family if candidate.name == name]
            less = chosen.reduced(place)
            found = less.with_each(forms).sum(axis=1)
            best = forms[int(np.argmin(found))]
            if best.shaped != chosen.members[place].shaped:
                chosen = self._noted(less.extended(best))
        return chosen

    def _backward(self, chosen: EffectSet) -> EffectSet:
        """Take out what is not missed, the least needed first."""
        while chosen.members:
            found = chosen.without_each()
            idle = [k for k, each in enumerate(found) if not self.helps(each, chosen.squares)]
            if not idle:
                return chosen
            least = min(idle, key=lambda k: float(found[k].sum()))
            chosen = self._noted(chosen.reduced(least))
        return chosen

    def _prefer_named(self, chosen: EffectSet) -> EffectSet:
        """Put named forms of the same place where they do as well as a map or a rival."""
        for candidate in chosen.members:
            if candidate.is_named:
                continue
            named = self._named_instead(chosen, chosen.members.index(candidate))
            if named is not None:
                chosen = self._noted(named)
        return chosen

    def _named_instead(self, chosen: EffectSet, place: int) -> EffectSet | None:
        """Return the set with names in one's place that do as well, None without.

        All names of the place together show first whether they can do its work at all.
        """
        candidate, tried = chosen.members[place], chosen.reduced(place)
        there = len(tried.members)
        every = self._names_at(tried, candidate.effect)
        if not every:
            return None
        lost = tried.with_each([_together(every)])[0] - chosen.squares
        if lost.sum() > _HOPELESS * standard_error(lost):
            return None
        for _ in range(_MOST_NAMES):
            names = self._names_at(tried, candidate.effect)
            if not names:
                return None
            found = tried.with_each(names)
            tried = tried.extended(names[int(np.argmin(found.sum(axis=1)))])
            if self._as_good(tried, chosen, candidate):
                sound = within_bounds(tried) and both_kinds_agree(chosen.reduced(place), tried)
                return tried if sound and self._all_help(tried, there) else None
        return None

    def _as_good(self, named: EffectSet, chosen: EffectSet, candidate: Candidate) -> bool:
        """Return whether names do as well: as a map, within a standard error of what they lose.

        As a rival without a name, where it does not help enough over them to be found at all.
        """
        lost = named.squares - chosen.squares
        if candidate.is_map:
            return bool(lost.sum() <= standard_error(lost))
        return not self.helps(named.squares, chosen.squares)

    def _all_help(self, chosen: EffectSet, first: int) -> bool:
        """Return whether members from some number on are all needed."""
        found = chosen.without_each()[first:]
        return all(self.helps(each, chosen.squares) for each in found)

    def _names_at(self, chosen: EffectSet, effect: Effect) -> list[Candidate]:
        """Return the named candidates that may do the work of a map or a rival."""
        return [
            other
            for other in self.others(chosen)
            if other.is_named and _same_place(other.effect, effect)
        ]

    def _noted(self, chosen: EffectSet) -> EffectSet:
        self.steps.append(Step(chosen.members, chosen.squares))
        return chosen


def _together(candidates: Sequence[Candidate]) -> Columns:
    """Return the columns of candidates as if they were one."""
    return Columns(
        np.concatenate([candidate.at for candidate in candidates]),
        np.concatenate([candidate.sizes for candidate in candidates]),
    )


def _same_place(named: Effect, other: Effect) -> bool:
    """Return whether a named form may do the work of a map or a rival."""
    if isinstance(other, JointErrorMap):
        return named.coordinates == other.coordinates
    return named.of == other.of
