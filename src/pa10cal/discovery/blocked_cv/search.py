"""The search for the set of effects that predicts held-out blocks best.

An effect has to predict the held-out blocks better than the model does without it: by some standard
errors of the gain, from its scatter between blocks; by more than the chance gain of the best of so
many candidates; and by a part of the remaining error over the noise, so that a small effect is not
named where it may only replace another one that is missing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pa10cal.arrays import Array, standard_error_of_sum
from pa10cal.discovery.blocked_cv.block_rows import ShapedEffect
from pa10cal.discovery.blocked_cv.effect_set import (
    Candidate,
    Columns,
    EffectSet,
    as_good,
    both_kinds_agree,
    start,
    surely_helps,
    within_bounds,
)
from pa10cal.discovery.blocked_cv.normal_equations import BlockEquations
from pa10cal.discovery.proof import needed_nats
from pa10cal.discovery.rules import BLOCKS
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import is_error_map
from pa10cal.terms.statement_faults import is_fault


class Search:
    """A search among the candidates of a family."""

    def __init__(
        self,
        equations: BlockEquations,
        baseline: Columns,
        family: Sequence[Candidate],
        noise_squares: float,
        error_rate: float,
        begins_with: Sequence[Effect] = (),
    ) -> None:
        """Take the normal equations, the columns of the calibrated model, and the candidates.

        Args:
            equations: in the columns of model and candidates, block by block.
            baseline: columns of the calibrated model.
            family: the candidates, all forms of each.
            noise_squares: sum of squares that noise alone leaves.
            error_rate: probability allowed of naming anything where nothing is missing.
            begins_with: effects that were found together as a set, which the search may remove;
                less is asked of some of them (`_is_needed`).
        """
        self.family = tuple(family)
        self.begins_with = tuple((effect.id, effect.of) for effect in begins_with)
        self.noise_squares = noise_squares
        self.effect_count = len({one.name for one in family if not is_fault(one.effect)})
        self.least_gain = 2.0 * needed_nats(self.effect_count, error_rate)
        self._empty = start(equations, baseline)

    def run(self) -> EffectSet:
        """Search until the set no longer changes, or for the allowed number of rounds."""
        chosen = self._empty
        for name in self.begins_with:
            best = self._best_form(chosen, name)
            ahead = chosen if best is None else chosen.with_member(best)
            if best is not None and within_bounds(ahead):
                chosen = ahead
        before: list[ShapedEffect] | None = None
        for _ in range(BLOCKS.most_rounds):
            chosen = self._exchanged(self._backward(self._forward(chosen)))
            if before == [candidate.shaped for candidate in chosen.members]:
                break
            chosen = self._prefer_named(self._backward(self._smoothed(chosen)))
            before = [candidate.shaped for candidate in chosen.members]
        return chosen

    def helps(self, before: Array, after: Array, least_share: float = BLOCKS.least_share) -> bool:
        """Return whether the sums of squares (B,) of held-out blocks decrease enough."""
        over_noise = max(float(after.sum()) - self.noise_squares, 0.0)
        return surely_helps(before - after, self.least_gain, least_share * over_noise)

    def _is_needed(self, member: Candidate, without: Array, squares: Array) -> bool:
        """Return whether held-out blocks are predicted enough worse without a member.

        Of the effects with which the search began, one that depends on time or temperature needs a
        gain of `least_gain` and one standard error: evidence has decided already. One that yields
        or bends needs no part of the remaining error, since no other can replace it.
        """
        effect, known = member.effect, member.name in self.begins_with
        if known and effect.depends_on:
            # A few poses show it, so that its gain scatters from block to block.
            gain = without - squares
            return float(gain.sum()) > max(self.least_gain, standard_error_of_sum(gain))
        of_set = known and (effect.bends or effect.yields)
        return self.helps(without, squares, 0.0 if of_set else BLOCKS.least_share)

    def is_surely_found(self, gain: float) -> bool:
        """Return whether an effect of this expected gain is found in 95 of 100 campaigns.

        A gain in squares of unit noise has a standard deviation of twice its root.
        """
        scatter = 2.0 * np.sqrt(gain)
        least = max(self.least_gain, BLOCKS.standard_errors * scatter)
        return bool(gain - BLOCKS.one_sided_deviates * scatter >= least)

    def others(self, chosen: EffectSet) -> list[Candidate]:
        """Return the candidates of which no form is in the set."""
        members = {candidate.name for candidate in chosen.members}
        return [candidate for candidate in self.family if candidate.name not in members]

    def _best_form(self, chosen: EffectSet, name: tuple[str, str]) -> Candidate | None:
        """Return the form of an effect that predicts best in a set; None if poses show none."""
        forms = [candidate for candidate in self.family if candidate.name == name]
        return _best(chosen, forms) if forms else None

    def _forward(self, chosen: EffectSet) -> EffectSet:
        """Add the candidate that helps most, while any helps enough."""
        while (ahead := self._with_best_addition(chosen)) is not None:
            chosen = ahead
        return chosen

    def _with_best_addition(self, chosen: EffectSet) -> EffectSet | None:
        """Return the set with the best candidate that helps enough; None if there is none."""
        others = [
            each for each in self.others(chosen) if each.effect.role_in_search != "substitute"
        ]
        if not others:
            return None
        squares = chosen.squares_with_each(others)
        for k in np.argsort(squares.sum(axis=1)):
            if self.helps(chosen.squares, squares[k]):
                ahead = chosen.with_member(others[k])
                if within_bounds(ahead) and both_kinds_agree(chosen, ahead):
                    return ahead
        return None

    def _smoothed(self, chosen: EffectSet) -> EffectSet:
        """Choose spacing and smoothness of each map again, with the other members in the set."""
        for member in [candidate for candidate in chosen.members if candidate.is_map]:
            rest = chosen.without_member(chosen.members.index(member))
            best = self._best_form(rest, member.name)
            if best is not None and best.shaped != member.shaped:
                chosen = rest.with_member(best)
        return chosen

    def _backward(self, chosen: EffectSet) -> EffectSet:
        """Remove members that are not needed, the least needed first."""
        while chosen.members:
            without = chosen.squares_without_each()
            idle = [
                k
                for k, member in enumerate(chosen.members)
                if not self._is_needed(member, without[k], chosen.squares)
            ]
            if not idle:
                return chosen
            chosen = chosen.without_member(min(idle, key=lambda k: float(without[k].sum())))
        return chosen

    def _exchanged(self, chosen: EffectSet) -> EffectSet:
        """Exchange names for others that predict better in their place, the best first."""
        for _ in range(BLOCKS.most_exchanges):
            ahead = self._with_best_exchange(chosen)
            if ahead is None:
                break
            chosen = ahead
        return chosen

    def _with_best_exchange(self, chosen: EffectSet) -> EffectSet | None:
        """Return the set with one name exchanged that predicts best; None if none is better."""
        best, best_squares = None, float(chosen.squares.sum())
        others = [each for each in self.others(chosen) if each.is_named]
        if not others:
            return None
        for k, member in enumerate(chosen.members):
            if not member.is_named:
                continue
            rest = chosen.without_member(k)
            squares = rest.squares_with_each(others)
            for j in np.flatnonzero(squares.sum(axis=1) < best_squares):
                substitute = others[j].effect.role_in_search == "substitute"
                if substitute and as_good(chosen.squares, squares[j]):
                    continue
                ahead = rest.with_member(others[j])
                possible = within_bounds(ahead) and both_kinds_agree(rest, ahead)
                better = float(squares[j].sum()) < best_squares
                if possible and self.helps(rest.squares, squares[j]) and better:
                    best, best_squares = ahead, float(squares[j].sum())
        return best

    def _prefer_named(self, chosen: EffectSet) -> EffectSet:
        """Replace maps and generic functions by named effects of their place that do as well."""
        for candidate in chosen.members:
            if not candidate.is_named:
                named = self._with_names_instead(chosen, chosen.members.index(candidate))
                chosen = chosen if named is None else named
        return chosen

    def _with_names_instead(self, chosen: EffectSet, member: int) -> EffectSet | None:
        """Return the set with names in a member's place that do as well; None if none do."""
        candidate, rest = chosen.members[member], chosen.without_member(member)
        names = self._names_in_place_of(candidate.effect, rest)
        if not names:
            return None
        # A cheap test first, unless columns of several places overfit: whether all names together
        # can do as well at all.
        if len({name.effect.of for name in names}) == 1:
            loss = rest.squares_with_each([Columns.together(names)])[0] - chosen.squares
            if loss.sum() > BLOCKS.hopeless_errors * standard_error_of_sum(loss):
                return None
        tried = rest
        for _ in range(BLOCKS.most_names):
            names = self._names_in_place_of(candidate.effect, tried)
            if not names:
                return None
            tried = tried.with_member(_best(tried, names))
            if self._do_as_well(tried, chosen, candidate):
                joined = len(tried.members) - len(rest.members)
                possible = within_bounds(tried, joined) and both_kinds_agree(rest, tried)
                without_names = tried.squares_without_each()[len(rest.members) :]
                all_help = all(self.helps(without, tried.squares) for without in without_names)
                return tried if possible and all_help else None
        return None

    def _do_as_well(self, named: EffectSet, chosen: EffectSet, replaced: Candidate) -> bool:
        """Return whether a set with names does as well as that with the candidate replaced.

        A map may be better by a standard error; a generic function must not help as an effect must.
        """
        if replaced.is_map:
            return as_good(named.squares, chosen.squares)
        return not self.helps(named.squares, chosen.squares)

    def _names_in_place_of(self, effect: Effect, chosen: EffectSet) -> list[Candidate]:
        """Return the named candidates, not in a set, that may replace a map or generic function."""
        names = [other for other in self.others(chosen) if other.is_named]
        if is_error_map(effect):
            return [other for other in names if other.effect.coordinates == effect.coordinates]
        places = {effect.of}
        if effect.of == "instrument":
            # The place in the instrument's frame goes with the position of a rail or column.
            places |= {each.effect.of for each in self.family if each.effect.sits == "slide"}
        return [other for other in names if other.effect.of in places]


def _best(chosen: EffectSet, candidates: Sequence[Candidate]) -> Candidate:
    """Return the candidate with which a set predicts held-out blocks best."""
    return candidates[int(np.argmin(chosen.squares_with_each(candidates).sum(axis=1)))]
