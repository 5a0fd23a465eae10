"""Members of the search in rows of their own, each map with its own B-splines, as fine as helps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.linalg import block_diag
from scipy.sparse import csr_array

from pa10cal.arrays import Array, Index
from pa10cal.discovery.blocked_cv.family import (
    SPACINGS,
    Candidate,
    predicted_squares,
    solve,
)
from pa10cal.discovery.blocked_cv.search import Step
from pa10cal.discovery.blocked_cv.survey import (
    BLOCKS,
    BlockRows,
    Products,
    Rows,
    ShapedEffect,
    map_columns,
    products,
)
from pa10cal.discovery.linear import standard_error
from pa10cal.terms.effects.joint_error_map import JointErrorMap, Spectrum, b_splines_by_knots

#: Spacings beyond those of the search, tried once it is known which joints have a map.
FINER_KNOTS = (216, 360)


@dataclass(frozen=True, eq=False)
class Level:
    """Members with maps of one spacing each, by linear least squares about the calibrated one."""

    members: tuple[Candidate, ...]
    squares: Array  # (B,) squared errors of the held-out blocks
    # products over all blocks: own parameters, effects, B-splines of one map after the other
    total: Products
    prior: Array  # (N, N) precision expected of these columns
    at: tuple[Index, ...]  # columns of each member

    def fit(self) -> tuple[Array, tuple[Array, ...]]:
        """Solve for all columns.

        Returns:
            Own parameters (k,), beyond those calibrated and in their possible sizes; parameters of
            each member's effect.
        """
        own = np.setdiff1d(np.arange(len(self.prior)), np.concatenate([np.zeros(0, int), *self.at]))
        at = np.concatenate([own, *self.at])
        there = np.ix_(at, at)
        x = np.zeros(len(self.prior))
        x[at] = solve(self.total.gram[there], self.total.projection[at], self.prior[there])
        return x[own], tuple(
            _amounts(member.shaped, x[columns])
            for member, columns in zip(self.members, self.at, strict=True)
        )


def finest(rows: Rows, members: tuple[Candidate, ...]) -> tuple[Level, tuple[Step, ...]]:
    """Make maps of the search's finest spacing finer, all at once, while held-out blocks gain.

    Returns:
        The finest level that helps, and what each left of the held-out blocks.
    """
    rows = replace(rows, shaped=tuple(member.shaped for member in members if not member.is_map))
    best = level(rows, members)
    steps: list[Step] = []
    for knots in FINER_KNOTS:
        if not any(_has_finest(member) for member in members):
            break
        ahead = level(
            rows, tuple(with_form(each, knots) if _has_finest(each) else each for each in members)
        )
        gain = best.squares - ahead.squares
        if gain.sum() <= standard_error(gain):
            break
        best = ahead
        steps.append(Step(best.members, best.squares))
    return best, tuple(steps)


def level(rows: Rows, members: tuple[Candidate, ...]) -> Level:
    """Solve members with every block held out; rows hold their effects, in their order."""
    inside = products_of(rows, members)
    found = level_of(inside.summed(), rows, members, np.empty(BLOCKS))
    every = np.arange(len(found.prior))
    for b in range(BLOCKS):
        gram, projection = inside.gram[b], inside.projection[b]
        x = solve(found.total.gram - gram, found.total.projection - projection, found.prior)
        found.squares[b] = predicted_squares(inside, b, every, x)
    return found


def level_of(total: Products, rows: Rows, members: tuple[Candidate, ...], squares: Array) -> Level:
    """Return members with their products, by the squared errors (B,) of held-out blocks."""
    maps = maps_among(members)
    dense = len(total.projection) - sum(each.knots for each in maps)
    factors = [b_splines_by_knots(each.knots) @ each.prior_factor for each in maps]
    inverses = [np.linalg.inv(factor) for factor in factors]
    prior = block_diag(np.eye(dense), *(inverse.T @ inverse for inverse in inverses))
    of_maps = iter(pairwise(dense + np.cumsum([0, *(each.knots for each in maps)])))
    of_effects = iter(rows.of_shaped())
    at = tuple(
        np.arange(*next(of_maps)) if member.is_map else next(of_effects) for member in members
    )
    return Level(members, squares, total, prior, at)


def products_of(rows: Rows, members: tuple[Candidate, ...]) -> Products:
    """Return the products of own parameters, effects, and B-splines of maps, block by block."""
    maps, found = maps_among(members), []
    for b in range(BLOCKS):
        block, splines = _columns(rows, maps, b)
        found.append(products(block.data, block.dense, splines))
    gram, projection, squares = zip(*found, strict=True)
    return Products(np.stack(gram), np.stack(projection), np.array(squares))


def products_by_kind(rows: Rows, maps: Sequence[JointErrorMap], b: int) -> tuple[Products, ...]:
    """Return the products of one block: of its rows of positions, and of the others."""
    block, splines = _columns(rows, maps, b)
    found = []
    for at in rows.kinds(len(block.data)):
        gram, projection, squares = products(block.data[at], block.dense[at], splines[at])
        found.append(Products(gram, projection, np.asarray(squares)))
    return tuple(found)


def _columns(rows: Rows, maps: Sequence[JointErrorMap], b: int) -> tuple[BlockRows, csr_array]:
    """Return the rows of a block, and the columns of the B-splines of some maps."""
    at, block = [rows.joints.index(each.joint) for each in maps], rows.block(b)
    knots = [each.knots for each in maps]
    return block, map_columns(block.screws[:, :, at], block.q_rad[:, at], knots)


def maps_among(members: Sequence[Candidate]) -> list[JointErrorMap]:
    """Return the maps among members, in their order."""
    return [member.effect for member in members if isinstance(member.effect, JointErrorMap)]


def _amounts(shaped: ShapedEffect, found: Array) -> Array:
    """Return the parameters of an effect for what was found of its columns."""
    effect = shaped.effect
    if isinstance(effect, JointErrorMap):
        knots = np.linalg.solve(b_splines_by_knots(effect.knots), found)
        return np.asarray(knots, dtype=np.float64)
    x = shaped.start.copy()
    x[: effect.linear] += effect.prior_factor @ found
    return x


def _has_finest(member: Candidate) -> bool:
    """Return whether a member is a map as fine as the search has them."""
    effect = member.effect
    return isinstance(effect, JointErrorMap) and effect.knots >= SPACINGS[-1][0]


def with_form(member: Candidate, knots: int, spectrum: Spectrum | None = None) -> Candidate:
    """Return a map with so many knots, and with a spectrum if one is given; others as they are."""
    effect = member.effect
    if not isinstance(effect, JointErrorMap):
        return member
    effect = replace(effect, knots=knots, spectrum=spectrum or effect.spectrum)
    return replace(member, shaped=ShapedEffect(effect))
