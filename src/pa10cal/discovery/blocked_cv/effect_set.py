"""Sets of effects, judged by the sum of squares of blocks of poses held out.

For every block all parameters, those of the calibrated model among them, are estimated from the
other blocks, each with its expected size; the block is then predicted. All is linear, so an effect
joins or leaves by block elimination on the inverse of the normal equations, without solving them
anew. This is written out here because `Gaussian` would factorise them for every block and
candidate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from pa10cal.arrays import Array, Index, standard_error_of_sum
from pa10cal.discovery.blocked_cv.block_rows import ShapedEffect
from pa10cal.discovery.blocked_cv.normal_equations import BlockEquations
from pa10cal.discovery.rules import BLOCKS
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.numerics.posterior import covariance_by_sizes, posterior_means
from pa10cal.terms.effects.effect import Effect


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns that join together, with the sizes expected of their parameters."""

    index: Index  # (k,) which columns
    sizes: Array  # (k,) standard deviation expected of each parameter

    @staticmethod
    def together(parts: Sequence[Columns]) -> Columns:
        """Return the columns of some parts side by side."""
        index, sizes = zip(*((part.index, part.sizes) for part in parts), strict=True)
        return Columns(np.concatenate(index), np.concatenate(sizes))


@dataclass(frozen=True, eq=False)
class Candidate(Columns):
    """An effect at one shape, or a map of one spacing and smoothness, and its columns."""

    shaped: ShapedEffect

    @property
    def effect(self) -> Effect:
        """Return the effect."""
        return self.shaped.effect

    @property
    def is_map(self) -> bool:
        """Return whether it is a map: it has a joint and no cause."""
        return self.effect.at_knots

    @property
    def is_named(self) -> bool:
        """Return whether it has a cause: it is neither a map nor a generic function."""
        return not (self.is_map or self.effect.generic)

    @property
    def name(self) -> tuple[str, str]:
        """Return identifier and place: of one name only one form may be in a model."""
        return self.shaped.name


@dataclass(frozen=True, eq=False)
class _SameLength:
    """Candidates of k columns each; maps of several sizes have the same columns."""

    candidates: Index  # (m,) number of each candidate
    places: Index  # (u, k) distinct columns, as places among the columns of all candidates
    place: Index  # (m,) which row of `places` each candidate has
    sizes: Array  # (m, k) standard deviation expected of each parameter


def _by_length(candidates: Sequence[Columns], every: Index) -> list[_SameLength]:
    """Return candidates grouped by how many columns they have; `every` (E,) are all columns."""
    lengths = np.array([len(each.index) for each in candidates])
    groups = []
    for length in np.unique(lengths):
        numbers = np.flatnonzero(lengths == length)
        columns = np.stack([candidates[int(k)].index for k in numbers])
        sizes = np.stack([candidates[int(k)].sizes for k in numbers])
        distinct, place = np.unique(columns, axis=0, return_inverse=True)
        places = np.searchsorted(every, distinct)
        groups.append(_SameLength(numbers, places, place.ravel(), sizes))
    return groups


@dataclass(frozen=True, eq=False)
class EffectSet:
    """A set of effects that are fitted together with the calibrated model."""

    equations: BlockEquations  # in all columns, block by block
    total: Gaussian  # the same of all blocks together
    baseline: Columns  # of the calibrated model, which stand first
    members: tuple[Candidate, ...]  # in the order in which they joined
    inverse: Array  # (B, n, n) inverse of the normal equations with each block held out

    @cached_property
    def index(self) -> Index:
        """Return the (n,) columns in use: those of the model, then member by member."""
        return np.concatenate([self.baseline.index, *(each.index for each in self.members)])

    @cached_property
    def solution(self) -> Array:
        """Return the parameters estimated without each block, (B, n)."""
        projection = (self.total.projection - self.equations.projection)[:, self.index]
        return np.asarray((self.inverse @ projection[:, :, None])[:, :, 0])

    @cached_property
    def squares(self) -> Array:
        """Return the sum of squares of every block, predicted from the others, (B,)."""
        return self._squares(self.equations, self.solution)

    @cached_property
    def squares_by_kind(self) -> tuple[Array, ...]:
        """Return the parts of `squares` of positions and, if measured, of orientations, (B,) each.

        Neither contains the prior on the arm's weights.
        """
        readings = self.squares
        if (precision := self.equations.prior_precision) is not None:
            readings = readings - self.solution**2 @ precision[self.index]
        if self.equations.of_positions is None:
            return (readings,)
        positions = self._squares(self.equations.of_positions, self.solution)
        return positions, readings - positions

    @property
    def squares_of_estimates(self) -> float:
        """Return the sum of squares of held-out positions that estimates are expected to add.

        The sum over blocks of tr(C J'J), C the covariance of the parameters as the other blocks
        determine them, J the whitened position rows of the block: noise alone adds 1 a row.
        """
        of = self.equations.of_positions or self.equations
        gram = of.gram[:, self.index[:, None], self.index]
        if of is self.equations and (precision := of.prior_precision) is not None:
            gram = gram - np.diag(precision[self.index])
        return float(np.sum(self.inverse * gram))

    def squares_with_each(self, candidates: Sequence[Columns]) -> Array:
        """Return the sums of squares with each of some candidates added, (m, B).

        What was computed is kept: several steps of a search ask for the same candidates.
        """
        known = self._squares_with
        if new := [each for each in candidates if each not in known]:
            every = np.unique(np.concatenate([each.index for each in new]))
            groups = _by_length(new, every)
            total = _between(self.total.gram, every, self.index)
            blocks = range(len(self.squares))
            by_block = [self._block_with_each(b, every, groups, total) for b in blocks]
            known |= zip(new, np.stack(by_block, axis=1), strict=True)
        return np.stack([known[each] for each in candidates])

    @cached_property
    def _squares_with(self) -> dict[Columns, Array]:
        """Sums of squares (B,) with candidates added, which are known by identity."""
        return {}

    def squares_without_each(self) -> Array:
        """Return the sums of squares with each member taken out, (m, B)."""
        solutions = map(self.solution_without, range(len(self.members)))
        found = [self._squares(self.equations, solution) for solution in solutions]
        return np.array(found).reshape(-1, len(self.squares))

    def _squares(self, equations: BlockEquations, solution: Array) -> Array:
        """Return the sums of squares (B,) of blocks at parameters (B, n) of the columns in use."""
        # Zeros for the columns that are not in use: to take those in use out of the products costs
        # more than to multiply them all.
        x = np.zeros_like(equations.projection)
        x[:, self.index] = solution
        along = (equations.gram @ x[:, :, None])[:, :, 0] - 2.0 * equations.projection
        return np.asarray(equations.squares + np.sum(x * along, axis=1))

    def solution_without(self, member: int) -> Array:
        """Return the parameters (B, n) with a member taken out, its own being zero."""
        of_member = self._places()[member]
        found = np.empty_like(self.solution)
        for b, inverse in enumerate(self.inverse):
            removed = np.linalg.solve(
                inverse[np.ix_(of_member, of_member)], self.solution[b][of_member]
            )
            found[b] = self.solution[b] - inverse[:, of_member] @ removed
        found[:, of_member] = 0.0
        return found

    def with_member(self, candidate: Candidate) -> EffectSet:
        """Return the set with one more member."""
        in_use, new = self.index, candidate.index
        n, m = len(in_use), len(new)
        inverse = np.empty((len(self.inverse), n + m, n + m))
        for b, known in enumerate(self.inverse):
            across = self._gram_of_others(b, in_use, new)
            response = known @ across
            schur = covariance_by_sizes(
                self._gram_of_others(b, new, new) - across.T @ response, candidate.sizes
            )
            corner = -response @ schur
            inverse[b, :n, :n] = known - corner @ response.T
            inverse[b, :n, n:], inverse[b, n:, :n] = corner, corner.T
            inverse[b, n:, n:] = schur
        return replace(self, members=(*self.members, candidate), inverse=inverse)

    def is_within_bounds(self, member: int) -> bool:
        """Return whether no parameter of a member is below its lower bound, if it has one."""
        effect = self.members[member].effect
        lower = [parameter.lower for parameter in effect.parameters[: effect.linear]]
        if self.members[member].is_map or all(bound is None for bound in lower):
            return True
        x = effect.prior_factor @ self.solution.mean(axis=0)[self._places()[member]]
        return all(bound is None or value >= bound for value, bound in zip(x, lower, strict=True))

    def without_member(self, member: int) -> EffectSet:
        """Return the set without one member."""
        of_member = self._places()[member]
        rest = np.delete(np.arange(len(self.index)), of_member)
        inverse = np.empty((len(self.inverse), len(rest), len(rest)))
        for b, known in enumerate(self.inverse):
            across = known[np.ix_(rest, of_member)]
            corner = np.linalg.solve(known[np.ix_(of_member, of_member)], across.T)
            inverse[b] = _between(known, rest, rest) - across @ corner
        members = tuple(each for k, each in enumerate(self.members) if k != member)
        return replace(self, members=members, inverse=inverse)

    def _block_with_each(
        self, b: int, every: Index, groups: Sequence[_SameLength], total: Array
    ) -> Array:
        """Return the sum of squares of a block with each candidate added, (m,).

        The products of `every` (E,) column with the columns in use over all blocks are `total`.

        With A the columns in use, C those of a candidate, r the residual, and G the inverse of the
        set, all of the other blocks but for G, the candidate's amounts are a = (S + P)^-1 C'r, P
        their prior precision and S = C'C - C'A G A'C the Schur complement; the parameters in use
        take the step s = -G A'C a. With A, C and r of this block, its squares change by
        |C a + A s|^2 - 2 r'(C a + A s), which is

            a'C'C a + 2 a'(C'A s - C'r) + s'(A'A s - 2 A'r).
        """
        in_use, solution = self.index, self.solution[b]
        gram, projection = self.equations.gram[b], self.equations.projection[b]
        # products of this block: A'A, C'A and those of A and C with r
        AA, CA = _between(gram, in_use, in_use), _between(gram, every, in_use)
        Ar, Cr = projection[in_use] - AA @ solution, projection[every] - CA @ solution
        # the same of the other blocks
        CA_others = total - CA
        Cr_others = self.total.projection[every] - projection[every] - CA_others @ solution
        response = CA_others @ self.inverse[b]  # C'A G
        count = sum(len(group.candidates) for group in groups)
        steps, change = np.zeros((count, len(in_use))), np.zeros(count)
        for group in groups:
            place, places = group.place, group.places[group.place]
            columns = every[group.places]
            CC = gram[columns[:, :, None], columns[:, None, :]]  # (u, k, k)
            CC_others = self.total.gram[columns[:, :, None], columns[:, None, :]] - CC
            responses = response[group.places]  # (u, k, n)
            schur = CC_others - responses @ CA_others[group.places].swapaxes(1, 2)
            amounts = posterior_means(schur[place], Cr_others[places], group.sizes**-2.0)[:, None]
            of_group = -(amounts @ responses[place])  # (m, 1, n)
            slope = of_group @ CA[group.places].swapaxes(1, 2)[place] - Cr[places][:, None]
            steps[group.candidates] = of_group[:, 0]
            change[group.candidates] = np.sum(
                amounts * (amounts @ CC[place] + 2.0 * slope), axis=(1, 2)
            )
        change += np.sum(steps * (steps @ AA - 2.0 * Ar), axis=1)
        return np.asarray(self.squares[b] + change)

    def _gram_of_others(self, b: int, rows: Index, columns: Index) -> Array:
        """Return the products of columns over all blocks but one."""
        of_all = _between(self.total.gram, rows, columns)
        return of_all - _between(self.equations.gram[b], rows, columns)

    def _places(self) -> list[Index]:
        """Return where each member's columns stand in the set."""
        counts = [len(member.index) for member in self.members]
        stops = len(self.baseline.index) + np.cumsum([0, *counts])
        return [np.arange(first, last) for first, last in pairwise(stops)]


def _between(gram: Array, rows: Index, columns: Index) -> Array:
    """Return the products (r, c) of some columns with others.

    Whole rows are fastest to take, and the fewer of them: products are symmetric.
    """
    if len(columns) < len(rows):
        return np.ascontiguousarray(gram.take(columns, axis=0).take(rows, axis=1).T)
    return np.asarray(gram.take(rows, axis=0).take(columns, axis=1))


def start(equations: BlockEquations, baseline: Columns) -> EffectSet:
    """Return the set without members, solved from the beginning."""
    total, at = equations.summed(), np.ix_(baseline.index, baseline.index)
    inverse = np.stack(
        [covariance_by_sizes(total.gram[at] - gram[at], baseline.sizes) for gram in equations.gram]
    )
    return EffectSet(equations, total, baseline, (), inverse)


# Criteria, on sums of squares of held-out blocks (B,) before and after a change of the set.


def as_good(squares: Array, than: Array) -> bool:
    """Return whether sums of squares are no larger than others, to within a standard error."""
    loss = squares - than
    return bool(loss.sum() <= standard_error_of_sum(loss))


def surely_helps(gain: Array, least_gain: float, least: float = 0.0) -> bool:
    """Return whether the total gain exceeds two limits and is significant over the blocks."""
    total = float(gain.sum())
    by_chance = BLOCKS.standard_errors * standard_error_of_sum(gain)
    return total > max(least_gain, least) and total > by_chance


def surely_worse(gain: Array) -> bool:
    """Return whether the total gain is significantly negative over the blocks."""
    return float(gain.sum()) < -BLOCKS.worse_errors * standard_error_of_sum(gain)


def within_bounds(chosen: EffectSet, joined: int = 1) -> bool:
    """Return whether the members that joined last have physically possible signs.

    Those before them are not judged: one that stands for what has just joined may be about to
    leave, and what stays to the end has its sign judged by the gates.
    """
    return all(map(chosen.is_within_bounds, range(len(chosen.members))[-joined:]))


def both_kinds_agree(before: EffectSet, after: EffectSet) -> bool:
    """Return whether neither positions nor orientations are predicted worse with an effect.

    An effect that improves one and spoils the other is not the physical effect of its name.
    """
    pairs = zip(before.squares_by_kind, after.squares_by_kind, strict=True)
    return not any(surely_worse(squares - squares_after) for squares, squares_after in pairs)
