"""The search by held-out blocks: what joins, what leaves, how smooth maps are, what has a name.

An effect has to predict the held-out blocks better than the model does without it: by more than
three standard errors of the gain, from its scatter between blocks; by more than the chance gain of
the best of so many candidates; and by a part of the remaining error over the noise, so that a small
effect is not named where it may only replace another one that is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.linalg import block_diag

from pa10cal.arrays import Array, Index
from pa10cal.discovery.blocked_cv.family import (
    Candidate,
    Columns,
    EffectSet,
    as_good,
    both_kinds_agree,
    solve,
    start,
    surely_helps,
    within_bounds,
)
from pa10cal.discovery.blocked_cv.survey import BlockedRows, Products, ShapedEffect
from pa10cal.discovery.evidence.search import threshold
from pa10cal.discovery.linear import standard_error
from pa10cal.discovery.rules import BLOCKS, MAPS
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import (
    JointErrorMap,
    Spectrum,
    b_splines_by_knots,
    is_error_map,
)
from pa10cal.terms.weights import is_fault


class Search:
    """Looks for the set of effects that predicts left-out blocks best."""

    def __init__(
        self,
        products: Products,
        own: Columns,
        family: Sequence[Candidate],
        noise: float,
        error_rate: float,
        begins_with: Sequence[Effect] = (),
    ) -> None:
        """Take products of all columns, those of the calibrated model, and the candidates.

        Noise is the sum of squares that it alone leaves; the error rate the probability allowed of
        naming anything where nothing is missing. Effects to begin with were found together: what
        gives way among them stands in for nothing else that does.
        """
        self.family = tuple(family)
        self.begins_with = tuple((effect.id, effect.of) for effect in begins_with)
        self.noise = noise
        names = {candidate.name for candidate in family if not is_fault(candidate.effect)}
        self.effects = len(names)
        self.least_gain = 2.0 * threshold(max(self.effects, 1), error_rate)
        self._nothing = start(products, own)

    def run(self) -> EffectSet:
        """Search until the set stays, from the effects to begin with that these poses can show."""
        chosen = self._nothing
        for name in self.begins_with:
            forms = [candidate for candidate in self.family if candidate.name == name]
            if forms:
                best = forms[int(np.argmin(chosen.with_each(forms).sum(axis=1)))]
                ahead = chosen.extended(best)
                chosen = ahead if within_bounds(ahead) else chosen
        settled: list[ShapedEffect] | None = None
        for _ in range(BLOCKS.most_rounds):
            chosen = self._exchanged(self._backward(self._forward(chosen)))
            if settled == [candidate.shaped for candidate in chosen.members]:
                break
            chosen = self._prefer_named(self._backward(self._smoothed(chosen)))
            settled = [candidate.shaped for candidate in chosen.members]
        return chosen

    def helps(self, before: Array, after: Array, least_share: float = BLOCKS.least_share) -> bool:
        """Return whether sums of squares (B,) of held-out blocks come down enough."""
        left_over = max(float(after.sum()) - self.noise, 0.0)
        return surely_helps(before - after, self.least_gain, least_share * left_over)

    def _needs(self, one: Candidate, without: Array, squares: Array) -> bool:
        """Return whether a member is missed: by however little, of a set of what gives way."""
        of_set = one.name in self.begins_with and (one.effect.bends or one.effect.yields)
        return self.helps(without, squares, 0.0 if of_set else BLOCKS.least_share)

    def is_surely_found(self, gain: float) -> bool:
        """Return whether an expected gain helps enough in 95 of 100 campaigns.

        A gain in squares of unit noise scatters by twice its root.
        """
        scatter = 2.0 * np.sqrt(gain)
        least = max(self.least_gain, BLOCKS.standard_errors * scatter)
        return bool(gain - BLOCKS.one_sided_deviates * scatter >= least)

    def others(self, chosen: EffectSet) -> list[Candidate]:
        """Return the candidates of which no form is in the set."""
        there = {candidate.name for candidate in chosen.members}
        return [candidate for candidate in self.family if candidate.name not in there]

    def _forward(self, chosen: EffectSet) -> EffectSet:
        """Add what helps most, while anything helps enough."""
        while others := [one for one in self.others(chosen) if not one.effect.takes_a_place]:
            found = chosen.with_each(others)
            for k in np.argsort(found.sum(axis=1)):
                if not self.helps(chosen.squares, found[k]):
                    continue
                ahead = chosen.extended(others[k])
                if within_bounds(ahead) and both_kinds_agree(chosen, ahead):
                    break
            else:
                return chosen
            chosen = ahead
        return chosen

    def _smoothed(self, chosen: EffectSet) -> EffectSet:
        """Choose spacing and smoothness of each map anew, the others being there."""
        for one in [candidate for candidate in chosen.members if candidate.is_map]:
            forms = [candidate for candidate in self.family if candidate.name == one.name]
            less = chosen.reduced(chosen.members.index(one))
            best = forms[int(np.argmin(less.with_each(forms).sum(axis=1)))]
            if best.shaped != one.shaped:
                chosen = less.extended(best)
        return chosen

    def _backward(self, chosen: EffectSet) -> EffectSet:
        """Take out what is not missed, the least needed first."""
        while chosen.members:
            found = chosen.without_each()
            idle = [
                k
                for k, (one, each) in enumerate(zip(chosen.members, found, strict=True))
                if not self._needs(one, each, chosen.squares)
            ]
            if not idle:
                return chosen
            least = min(idle, key=lambda k: float(found[k].sum()))
            chosen = chosen.reduced(least)
        return chosen

    def _exchanged(self, chosen: EffectSet) -> EffectSet:
        """Exchange names for others that predict better in their place, the best first."""
        for _ in range(BLOCKS.most_exchanges):
            best, best_squares = None, float(chosen.squares.sum())
            for k, one in enumerate(chosen.members):
                if not one.is_named:
                    continue
                less = chosen.reduced(k)
                others = [each for each in self.others(chosen) if each.is_named]
                found = less.with_each(others) if others else np.zeros((0, len(less.squares)))
                for j in np.flatnonzero(found.sum(axis=1) < best_squares):
                    if others[j].effect.takes_a_place and as_good(chosen.squares, found[j]):
                        continue
                    ahead = less.extended(others[j])
                    squares, helps = float(found[j].sum()), self.helps(less.squares, found[j])
                    sound = within_bounds(ahead) and both_kinds_agree(less, ahead)
                    if sound and helps and squares < best_squares:
                        best, best_squares = ahead, squares
            if best is None:
                return chosen
            chosen = best
        return chosen

    def _prefer_named(self, chosen: EffectSet) -> EffectSet:
        """Put named forms of the same place where they do as well as a map or a rival."""
        for candidate in chosen.members:
            if candidate.is_named:
                continue
            named = self._named_instead(chosen, chosen.members.index(candidate))
            if named is not None:
                chosen = named
        return chosen

    def _named_instead(self, chosen: EffectSet, place: int) -> EffectSet | None:
        """Return the set with names in one's place that do as well, None without."""
        candidate, tried = chosen.members[place], chosen.reduced(place)
        there = len(tried.members)
        every = self._names_at(tried, candidate.effect)
        if not every:
            return None
        together = Columns(
            np.concatenate([each.at for each in every]),
            np.concatenate([each.sizes for each in every]),
        )  # show first whether names can do its work at all
        lost = tried.with_each([together])[0] - chosen.squares
        if lost.sum() > BLOCKS.hopeless_errors * standard_error(lost):
            return None
        for _ in range(BLOCKS.most_names):
            names = self._names_at(tried, candidate.effect)
            if not names:
                return None
            found = tried.with_each(names)
            tried = tried.extended(names[int(np.argmin(found.sum(axis=1)))])
            if self._as_good(tried, chosen, candidate):
                sound = within_bounds(tried) and both_kinds_agree(chosen.reduced(place), tried)
                needed = tried.without_each()[there:]
                all_help = all(self.helps(each, tried.squares) for each in needed)
                return tried if sound and all_help else None
        return None

    def _as_good(self, named: EffectSet, chosen: EffectSet, candidate: Candidate) -> bool:
        """Return whether names do as well: as a map, or so that a rival does not help over them."""
        if candidate.is_map:
            return as_good(named.squares, chosen.squares)
        return not self.helps(named.squares, chosen.squares)

    def _names_at(self, chosen: EffectSet, effect: Effect) -> list[Candidate]:
        """Return the named candidates that may do the work of a map or a rival."""
        names = [other for other in self.others(chosen) if other.is_named]
        if is_error_map(effect):
            return [other for other in names if other.effect.coordinates == effect.coordinates]
        return [other for other in names if other.effect.of == effect.of]


# Members in rows of their own, each map with its own B-splines, as fine as helps.


@dataclass(frozen=True, eq=False)
class Level:
    """Members with maps of one spacing each, by linear least squares about the calibrated model."""

    members: tuple[Candidate, ...]
    # what all blocks say: of own parameters, effects, B-splines of one map after the other
    total: Gaussian
    prior: Array  # (N, N) precision expected of these columns
    at: tuple[Index, ...]  # columns of each member

    def fit(self) -> tuple[Array, tuple[Array, ...]]:
        """Return own parameters (k,), beyond those calibrated and in their possible sizes.

        Then the parameters of each member's effect.
        """
        x = solve(self.total.gram, self.total.projection, self.prior)
        return np.delete(x, np.concatenate([np.zeros(0, int), *self.at])), tuple(
            _amounts(member.shaped, x[columns])
            for member, columns in zip(self.members, self.at, strict=True)
        )


def refine_maps(rows: BlockedRows, members: tuple[Candidate, ...]) -> Level:
    """Make maps of the search's finest spacing finer, all at once, while held-out blocks gain."""
    rows = replace(rows, shaped=tuple(member.shaped for member in members if not member.is_map))
    best, left = _held_out(rows, members)
    for knots in MAPS.finer_knots:
        if not any(_has_finest(member) for member in members):
            break
        ahead, after = _held_out(
            rows, tuple(with_form(each, knots) if _has_finest(each) else each for each in members)
        )
        if as_good(left, after):
            break
        best, left = ahead, after
    return best


def level(rows: BlockedRows, members: tuple[Candidate, ...]) -> Level:
    """Return members with their products; rows hold their effects, in their order."""
    return level_of(_summed(_said_by_blocks(rows, members)), rows, members)


def _held_out(rows: BlockedRows, members: tuple[Candidate, ...]) -> tuple[Level, Array]:
    """Return the level of members, and the squared error of each block held out, (B,)."""
    inside = _said_by_blocks(rows, members)
    found = level_of(_summed(inside), rows, members)
    squares = []
    for out in inside:
        others = found.total - out
        squares.append(out.squares_at(solve(others.gram, others.projection, found.prior)))
    return found, np.array(squares)


def level_of(total: Gaussian, rows: BlockedRows, members: tuple[Candidate, ...]) -> Level:
    """Return members with what all blocks say."""
    maps = maps_among(members)
    dense = total.unknowns - sum(each.knots for each in maps)
    factors = [b_splines_by_knots(each.knots) @ each.prior_factor for each in maps]
    inverses = [np.linalg.inv(factor) for factor in factors]
    prior = block_diag(np.eye(dense), *(inverse.T @ inverse for inverse in inverses))
    of_maps = iter(pairwise(dense + np.cumsum([0, *(each.knots for each in maps)])))
    of_effects = iter(rows.of_shaped())
    at = tuple(
        np.arange(*next(of_maps)) if member.is_map else next(of_effects) for member in members
    )
    return Level(members, total, prior, at)


def _said_by_blocks(rows: BlockedRows, members: tuple[Candidate, ...]) -> list[Gaussian]:
    """Return what each block says of own parameters, effects, and B-splines of maps."""
    joints, knots = joints_and_knots(members)
    kinds = (rows.products_by_kind(b, joints, knots) for b in range(BLOCKS.blocks))
    return [positions + others for positions, others in kinds]


def _summed(blocks: Sequence[Gaussian]) -> Gaussian:
    """Return what all blocks say."""
    return sum(blocks, Gaussian.none(blocks[0].unknowns))


def joints_and_knots(members: Sequence[Candidate]) -> tuple[list[int], list[int]]:
    """Return the joints that have maps among members, and the knots of these."""
    maps = maps_among(members)
    return [each.joint for each in maps], [each.knots for each in maps]


def maps_among(members: Sequence[Candidate]) -> list[JointErrorMap]:
    """Return the maps among members, in their order."""
    return [member.effect for member in members if is_error_map(member.effect)]


def _amounts(shaped: ShapedEffect, found: Array) -> Array:
    """Return the parameters of an effect for what was found of its columns."""
    effect = shaped.effect
    if is_error_map(effect):
        knots = np.linalg.solve(b_splines_by_knots(effect.knots), found)
        return np.asarray(knots, dtype=np.float64)
    x = shaped.start.copy()
    x[: effect.linear] += effect.prior_factor @ found
    return x


def _has_finest(member: Candidate) -> bool:
    """Return whether a member is a map as fine as the search has them."""
    effect = member.effect
    return is_error_map(effect) and effect.knots >= MAPS.spacings[-1][0]


def with_form(member: Candidate, knots: int, spectrum: Spectrum | None = None) -> Candidate:
    """Return a map with so many knots, and with a spectrum if one is given; others as they are."""
    effect = member.effect
    if not is_error_map(effect):
        return member
    effect = replace(effect, knots=knots, spectrum=spectrum or effect.spectrum)
    return replace(member, shaped=ShapedEffect(effect))
