"""Candidates and sets of them, judged by the sum of squares of blocks of poses held out.

For every block the parameters are found from all others, those of the calibrated model among them,
each with its expected size; the block is then predicted. All is linear, so an effect joins or
leaves by block elimination on the inverse of the normal equations, without solving them anew. That
is by hand: `Gaussian` would factorise them for every block and candidate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.discovery.blocked_cv.survey import BlockedRows, Products, ShapedEffect, Survey
from pa10cal.discovery.finding import Untestable
from pa10cal.discovery.linear import standard_error
from pa10cal.discovery.other_numbers import COMPUTING
from pa10cal.discovery.preparation import computable, sought, why_hidden
from pa10cal.discovery.rules import BLOCKS, MAPS
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import (
    FadingPrior,
    JointErrorMap,
    harmonic_orders,
    is_error_map,
)
from pa10cal.terms.weights import is_fault


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns that join together, with the sizes expected of their parameters."""

    at: Index  # (k,) which columns
    sizes: Array  # (k,) standard deviation expected of each


@dataclass(frozen=True, eq=False)
class Candidate(Columns):
    """An effect at one shape, or a map of one spacing and smoothness, and its columns."""

    shaped: ShapedEffect  # which

    @property
    def effect(self) -> Effect:
        """Return the effect."""
        return self.shaped.effect

    @property
    def is_map(self) -> bool:
        """Whether it knows the place and not the cause."""
        return self.effect.at_knots

    @property
    def is_named(self) -> bool:
        """Whether it says what is wrong, and not only where."""
        return not (self.is_map or self.effect.generic)

    @property
    def name(self) -> tuple[str, str]:
        """Return what only one of may be in the model."""
        return (self.effect.id, self.effect.of)


@dataclass(frozen=True, eq=False)
class _SameLength:
    """Candidates of k columns each; maps of several sizes have the same columns."""

    which: Index  # (m,) which candidates
    places: Index  # (u, k) where different columns stand among those of all candidates
    of: Index  # (m,) which of these each candidate has
    sizes: Array  # (m, k) standard deviation expected of each parameter


def _by_length(candidates: Sequence[Columns], every: Index) -> list[_SameLength]:
    """Return candidates with as many columns together, their places in (E,) columns."""
    lengths = np.array([len(each.at) for each in candidates])
    found = []
    for length in np.unique(lengths):
        which = np.flatnonzero(lengths == length)
        own = [candidates[int(k)] for k in which]
        at = np.stack([each.at for each in own])
        different, of = np.unique(at, axis=0, return_inverse=True)
        sizes = np.stack([each.sizes for each in own])
        found.append(_SameLength(which, np.searchsorted(every, different), of.ravel(), sizes))
    return found


@dataclass(frozen=True, eq=False)
class EffectSet:
    """A set of members beside the calibrated model."""

    products: Products  # of all columns, block by block
    total: Gaussian  # what all blocks say
    own: Columns  # those of the calibrated model, which stand first
    members: tuple[Candidate, ...]  # in the order in which they joined
    inverse: Array  # (B, n, n) inverse of the normal equations with each block held out

    @cached_property
    def at(self) -> Index:
        """Return the (n,) columns in use: the model's own, then member by member."""
        return np.concatenate([self.own.at, *(each.at for each in self.members)])

    @cached_property
    def solution(self) -> Array:
        """Return the parameters found without each block, (B, n)."""
        projection = (self.total.projection - self.products.projection)[:, self.at]
        found: Array = (self.inverse @ projection[:, :, None])[:, :, 0]
        return found

    @cached_property
    def squares(self) -> Array:
        """Return the sum of squares of every block, predicted from the others, (B,)."""
        return self._squares(self.products, self.solution)

    @cached_property
    def squares_by_kind(self) -> tuple[Array, ...]:
        """Return the parts of `squares` that are of positions and of orientations, (B,) each.

        What is known of weights is in neither.
        """
        readings = self.squares
        if (told := self.products.told) is not None:
            readings = readings - self.solution**2 @ told[self.at]
        if self.products.of_positions is None:
            return (readings,)
        positions = self._squares(self.products.of_positions, self.solution)
        return positions, readings - positions

    def with_each(self, candidates: Sequence[Columns]) -> Array:
        """Return the sums of squares with each of some candidates added, (m, B)."""
        every = np.unique(np.concatenate([each.at for each in candidates]))
        groups = _by_length(candidates, every)
        blocks = range(len(self.squares))
        return np.stack([self._with_each(b, every, groups) for b in blocks], axis=1)

    def without_each(self) -> Array:
        """Return the sums of squares with each member taken out, (m, B)."""
        solutions = map(self.solution_without, range(len(self.members)))
        found = [self._squares(self.products, each) for each in solutions]
        return np.array(found).reshape(-1, len(self.squares))

    def _squares(self, products: Products, solution: Array) -> Array:
        return np.array(
            [_predicted_squares(products, b, self.at, x) for b, x in enumerate(solution)]
        )

    def solution_without(self, member: int) -> Array:
        """Return the parameters (B, n) with a member taken out, its own zero."""
        own = self._places()[member]
        found = np.empty_like(self.solution)
        for b, inverse in enumerate(self.inverse):
            taken = np.linalg.solve(inverse[np.ix_(own, own)], self.solution[b][own])
            found[b] = self.solution[b] - inverse[:, own] @ taken
        found[:, own] = 0.0
        return found

    def extended(self, candidate: Candidate) -> EffectSet:
        """Return the set with one more member."""
        there, new = self.at, candidate.at
        n, m = len(there), len(new)
        inverse = np.empty((len(self.inverse), n + m, n + m))
        for b, known in enumerate(self.inverse):
            across = self._elsewhere(b, there, new)
            followed = known @ across
            schur = _inverse(self._elsewhere(b, new, new) - across.T @ followed, candidate.sizes)
            corner = -followed @ schur
            inverse[b, :n, :n] = known - corner @ followed.T
            inverse[b, :n, n:], inverse[b, n:, :n] = corner, corner.T
            inverse[b, n:, n:] = schur
        return replace(self, members=(*self.members, candidate), inverse=inverse)

    def reduced(self, member: int) -> EffectSet:
        """Return the set without one member."""
        own = self._places()[member]
        rest = np.delete(np.arange(len(self.at)), own)
        inverse = np.empty((len(self.inverse), len(rest), len(rest)))
        for b, known in enumerate(self.inverse):
            across = known[np.ix_(rest, own)]
            corner = np.linalg.solve(known[np.ix_(own, own)], across.T)
            inverse[b] = known[np.ix_(rest, rest)] - across @ corner
        members = tuple(each for k, each in enumerate(self.members) if k != member)
        return replace(self, members=members, inverse=inverse)

    def _with_each(self, b: int, every: Index, groups: Sequence[_SameLength]) -> Array:
        """Return the sum of squares of a block with each candidate added, (m,).

        The other blocks give a candidate's amounts, by a Schur complement, and the steps that the
        parameters in use take with it; the squares of the block change quadratically in both.
        """
        in_use, solution = self.at, self.solution[b]
        gram, projection = self.products.gram[b], self.products.projection[b]
        own, across = gram[np.ix_(in_use, in_use)], gram[np.ix_(in_use, every)]
        elsewhere = self._elsewhere(b, in_use, every)
        followed = self.inverse[b] @ elsewhere
        open_elsewhere = self.total.projection[every] - projection[every] - elsewhere.T @ solution
        open_here = projection[every] - across.T @ solution
        open_in_use = projection[in_use] - own @ solution
        count = sum(len(group.which) for group in groups)
        steps, change = np.zeros((count, len(in_use))), np.zeros(count)
        for group in groups:
            at = every[group.places]
            corner = gram[at[:, :, None], at[:, None, :]]
            by_in_use = followed.T[group.places]  # (u, k, n)
            known = self.total.gram[at[:, :, None], at[:, None, :]] - corner
            known -= by_in_use @ elsewhere.T[group.places].swapaxes(1, 2)
            of, places = group.of, group.places[group.of]
            amounts = _solved(known[of], open_elsewhere[places], group.sizes**-2.0)[:, None]
            its_steps = -(amounts @ by_in_use[of])
            beside = (
                its_steps @ across.T[group.places].swapaxes(1, 2)[of] - open_here[places][:, None]
            )
            steps[group.which] = its_steps[:, 0]
            change[group.which] = np.sum(
                amounts * (amounts @ corner[of] + 2.0 * beside), axis=(1, 2)
            )
        change += np.sum(steps * (steps @ own - 2.0 * open_in_use), axis=1)
        squares: Array = self.squares[b] + change
        return squares

    def _elsewhere(self, b: int, rows: Index, columns: Index) -> Array:
        """Return the products of columns over all blocks but one."""
        at = np.ix_(rows, columns)
        found: Array = self.total.gram[at] - self.products.gram[b][at]
        return found

    def _places(self) -> list[Index]:
        """Return where each member's columns stand in the set."""
        stops = len(self.own.at) + np.cumsum([0, *(len(member.at) for member in self.members)])
        return [np.arange(first, last) for first, last in pairwise(stops)]


def start(products: Products, own: Columns) -> EffectSet:
    """Return the set without members, solved from the beginning."""
    total, at = products.summed(), np.ix_(own.at, own.at)
    inverse = np.stack([_inverse(total.gram[at] - gram[at], own.sizes) for gram in products.gram])
    return EffectSet(products, total, own, (), inverse)


def _predicted_squares(products: Products, b: int, at: Index, x: Array) -> float:
    """Return what parameters x (n,) of some columns leave of a block's sum of squares."""
    gram, projection = products.gram[b][np.ix_(at, at)], products.projection[b, at]
    return float(products.squares[b] - 2.0 * projection @ x + x @ gram @ x)


def solve(gram: Array, projection: Array, prior: Array) -> Array:
    """Return the best parameters (k,) or (k, m) by products and a prior precision (k, k)."""
    normal = gram + prior
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), np.diag(prior)))
    scaled = (projection.T * scale).T
    try:
        factor = cho_factor(normal * np.outer(scale, scale), check_finite=False)
    except LinAlgError:
        return no_wider_than(normal, prior) @ projection
    solved: Array = (cho_solve(factor, scaled, check_finite=False).T * scale).T
    return solved


def _solved(gram: Array, projection: Array, precision: Array) -> Array:
    """Return the best parameters (m, k) by m products (m, k, k) and precisions (m, k)."""
    at = np.arange(gram.shape[1])
    normal = gram.copy()
    normal[:, at, at] += precision
    scale = 1.0 / np.sqrt(np.maximum(normal[:, at, at], precision))
    normal *= scale[:, :, None] * scale[:, None, :]
    try:
        np.linalg.cholesky(normal)
    except np.linalg.LinAlgError:  # of one of them at least
        each = zip(gram, projection, precision, strict=True)
        return np.stack([solve(normal, x, np.diag(size)) for normal, x, size in each])
    found: Array = scale * np.linalg.solve(normal, (scale * projection)[:, :, None])[:, :, 0]
    return found


def no_wider_than(normal: Array, prior: Array) -> Array:
    """Return the inverse of normal equations that rounding left less certain than their prior.

    The prior precision (k, k) is in them; it has a row of zeros for a parameter without.
    """
    bare = np.diag(prior) == 0.0
    root = np.linalg.cholesky(
        prior + np.diag(np.where(bare, COMPUTING.least_precision * np.diag(normal), 0.0))
    )
    within = np.linalg.solve(root, np.linalg.solve(root, normal).T)
    values, vectors = np.linalg.eigh(0.5 * (within + within.T))
    vectors = np.linalg.solve(root.T, vectors)
    inverse: Array = (vectors / np.maximum(values, 1.0)) @ vectors.T
    return inverse


def _inverse(gram: Array, sizes: Array) -> Array:
    """Return the inverse of products plus what is expected of the parameters."""
    return solve(gram, np.eye(len(sizes)), np.diag(sizes**-2.0))


# The family of candidates of a survey, and what its poses can show of each.
#
# All of it is settled before residuals are looked at.


def map_candidates(rows: BlockedRows) -> list[Candidate]:
    """Return maps of every revolute joint in all spacings, smoothnesses and sizes."""
    found = []
    for joint, (knots, half_order), size_rad in product(rows.joints, MAPS.spacings, MAPS.sizes_rad):
        spectrum = FadingPrior(size_rad, half_order)
        # Of the highest order of an even number of knots only one part is there.
        harmonics = knots - (1 if knots == rows.knots else 2)
        sizes_rad = spectrum.sizes_rad(harmonic_orders(rows.knots)[1 : 1 + harmonics])
        shaped = ShapedEffect(JointErrorMap(f"joint {joint}", knots, spectrum))
        found.append(Candidate(rows.of_map(joint)[:harmonics], sizes_rad, shaped))
    return found


def within_bounds(chosen: EffectSet) -> bool:
    """Return whether what was last added has the sign that it physically must have."""
    effect = chosen.members[-1].effect
    lower = [parameter.lower for parameter in effect.parameters[: effect.linear]]
    if chosen.members[-1].is_map or all(bound is None for bound in lower):
        return True
    amounts = chosen.solution.mean(axis=0)[-effect.linear :]
    x = effect.prior_factor @ amounts
    return all(bound is None or value >= bound for value, bound in zip(x, lower, strict=True))


def both_kinds_agree(before: EffectSet, after: EffectSet) -> bool:
    """Return whether neither positions nor orientations are predicted worse for an effect.

    What turns the end one way and moves it another is not what its name says.
    """
    pairs = zip(before.squares_by_kind, after.squares_by_kind, strict=True)
    return not any(surely_worse(less - more) for less, more in pairs)


def as_good(squares: Array, than: Array) -> bool:
    """Return whether sums of squares of blocks (B,) are no larger, to within a standard error."""
    lost = squares - than
    return bool(lost.sum() <= standard_error(lost))


def surely_helps(gain: Array, least_gain: float, least: float = 0.0) -> bool:
    """Return whether blocks (B,) gain enough, by two least sums and by more than chance makes."""
    total = float(gain.sum())
    by_chance = BLOCKS.standard_errors * standard_error(gain)
    return total > max(least_gain, least) and total > by_chance


def surely_worse(gain: Array) -> bool:
    """Return whether a sum over blocks is below zero by more than its scatter between them."""
    return float(gain.sum()) < -BLOCKS.worse_errors * standard_error(gain)


def computable_shapes(survey: Survey) -> tuple[tuple[ShapedEffect, ...], tuple[Untestable, ...]]:
    """Return effects that can be computed with what is known of the poses, and the others.

    Each effect at each of its shapes; maps are not among them.
    """
    every = {(each.id, each.of): each for each in survey.begins_with}
    every |= {
        (each.id, each.of): each for each in sought(survey.context, survey.baseline.model.terms)
    }
    known, refused = computable(
        (each for each in every.values() if not is_error_map(each)),
        survey.poses.states,
        logged=survey.torques_logged,
        weights=True,
    )
    return (
        tuple(ShapedEffect(each, shape) for each in known for shape in range(len(each.starts))),
        tuple(each for each in refused if not is_fault(each.effect)),
    )


@dataclass(frozen=True)
class Family:
    """The candidates of a survey."""

    shown: tuple[Candidate, ...]  # candidates that these poses can show, all forms of each
    hidden: tuple[Untestable, ...]  # effects that they cannot
    # of each effect shown, by name: sum of squares of all poses that it is expected to take away
    # at its plausible size, beside the model's own parameters, in all but one of twenty directions
    # of its parameters
    gains: dict[tuple[str, str], float]


def family(rows: BlockedRows, products: Products) -> Family:
    """Return the candidates that these poses can show, and the effects that they cannot."""
    total, of_own = products.summed().gram, rows.baseline_columns
    own = Gaussian.of_products(total[np.ix_(of_own, of_own)])
    shown, refused = [], {}
    gains: dict[tuple[str, str], float] = {}
    named = [
        Candidate(at, np.ones(len(at)), shaped)
        for shaped, at in zip(rows.shaped, rows.of_shaped(), strict=True)
    ]
    for candidate in (*named, *map_candidates(rows)):
        whole, left = _beside(total, of_own, own, candidate)
        why = _hidden(rows, candidate, whole, left)
        if why is None:
            shown.append(candidate)
            gains[candidate.name] = max(gains.get(candidate.name, 0.0), _nearly_always(left))
        elif not is_fault(candidate.effect):
            refused[candidate.name] = Untestable(_plain(candidate.effect), why)
    hidden = tuple(found for name, found in refused.items() if name not in gains)
    return Family(tuple(shown), hidden, gains)


def below_detection_limit(
    found: Family, is_surely_found: Callable[[float], bool]
) -> tuple[Untestable, ...]:
    """Return effects of which the plausible size may well be missed, though they are sought."""
    effects = {
        candidate.name: _plain(candidate.effect)
        for candidate in found.shown
        if not is_fault(candidate.effect)
    }
    return tuple(
        Untestable(
            effects[name],
            f"at its plausible size it stands {np.sqrt(gain):.1f} standard deviations out of the "
            "noise of all poses together, too little to be found in 95 of 100 such campaigns",
        )
        for name, gain in found.gains.items()
        if name in effects and not is_surely_found(gain)
    )


def _beside(gram: Array, of_own: Index, own: Gaussian, columns: Columns) -> tuple[Array, Array]:
    """Return the products of columns in their sizes, whole and beside the model's parameters."""
    at, sizes = columns.at, columns.sizes
    across = gram[np.ix_(of_own, at)] * sizes
    whole = gram[np.ix_(at, at)] * np.outer(sizes, sizes)
    return whole, own.of_further(across, whole, np.zeros(len(at))).gram


def _nearly_always(left: Array) -> float:
    """Return the gain that an effect of plausible size reaches in all but one of 20 directions.

    Poses may show one parameter well and another hardly. Products of columns (k, k) are in sizes.
    """
    values = np.maximum(np.linalg.eigvalsh(left), 0.0)
    drawn = np.random.default_rng(0).standard_normal((BLOCKS.directions, len(values))) ** 2
    shares = drawn / drawn.mean(axis=1, keepdims=True)
    return float(np.quantile(shares @ values, BLOCKS.hidden_share))


def _hidden(rows: BlockedRows, candidate: Candidate, whole: Array, left: Array) -> str | None:
    """Return why the poses cannot show a candidate, None where they can."""
    if not np.trace(whole) > 0.0:
        return _why_silent(rows.survey.poses.states, candidate.shaped)
    share = float(np.sqrt(max(np.trace(left), 0.0) / np.trace(whole)))
    signal = float(np.sqrt(max(np.linalg.eigvalsh(left)[-1], 0.0)))
    return why_hidden(share, signal)


def _why_silent(states: PoseStates, shaped: ShapedEffect) -> str:
    """Return why an effect moves nothing at all in these poses."""
    arrived = replace(states, arrival=np.ones_like(states.arrival))
    if np.any(shaped.effect.derivative(arrived, shaped.start)):
        return "the direction of arrival is not known"
    return "the poses do not exercise it"


def _plain(effect: Effect) -> Effect:
    """Return the map of a joint in its usual form, whatever its spacing; others as they are."""
    return JointErrorMap(effect.of) if is_error_map(effect) else effect
