"""Candidates of the search by held-out blocks, and sets of them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from pa10cal.arrays import Array
from pa10cal.discovery.blocked_cv.rows import Rows, ShapedEffect
from pa10cal.discovery.blocked_cv.selection import Columns, State
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import JointErrorMap, harmonic_orders
from pa10cal.terms.effects.spectrum import Fading

#: Spacings and smoothnesses of maps that are tried: knots a turn, with the order at which half as
#: much is expected; and sizes [rad].
SPACINGS = ((36, 4.0), (72, 10.0), (144, 25.0))
SIZES_RAD = (3e-5, 1e-4, 3e-4)
#: Standard errors by which positions or attitudes may come out worse for an effect.
_SURELY_WORSE = 2.0


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect at one shape, or a map of one spacing and smoothness."""

    shaped: ShapedEffect  # which
    columns: Columns  # its columns and the sizes expected

    @property
    def effect(self) -> Effect:
        """Return the effect."""
        return self.shaped.effect

    @property
    def is_map(self) -> bool:
        """Whether it knows the place and not the cause."""
        return isinstance(self.effect, JointErrorMap)

    @property
    def is_named(self) -> bool:
        """Whether it says what is wrong, and not only where."""
        return not (self.is_map or self.effect.generic)

    @property
    def name(self) -> tuple[str, str]:
        """Return what only one of may be in the model."""
        return (self.effect.id, self.effect.of)


def map_candidates(rows: Rows) -> list[Candidate]:
    """Return maps of every revolute joint in all spacings, smoothnesses and sizes."""
    found = []
    for joint in rows.joints:
        for (knots, half_order), size_rad in product(SPACINGS, SIZES_RAD):
            effect = JointErrorMap(f"joint {joint}", knots, Fading(size_rad, half_order))
            found.append(map_candidate(effect, rows))
    return found


def map_candidate(effect: JointErrorMap, rows: Rows) -> Candidate:
    """Return a map in the harmonics of rows, whose knots are at least as many."""
    assert effect.spectrum is not None
    # Of the highest order of an even number of knots only one part is there.
    harmonics = effect.knots - (1 if effect.knots == rows.knots else 2)
    orders = harmonic_orders(rows.knots)[1 : 1 + harmonics]
    columns = Columns(rows.of_map(effect.joint)[:harmonics], effect.spectrum.sizes_rad(orders))
    return Candidate(ShapedEffect(effect), columns)


@dataclass(frozen=True, eq=False)
class Chosen:
    """A set that the search holds."""

    members: tuple[Candidate, ...]  # in the order in which they joined
    state: State  # its products, the model's own columns before those of the members

    @property
    def squares(self) -> Array:
        """Return the remaining squared error of each block, (B,)."""
        return self.state.squares

    def extended(self, candidate: Candidate) -> Chosen:
        """Return the set with one more member."""
        return Chosen((*self.members, candidate), self.state.extended(candidate.columns))

    def reduced(self, member: int) -> Chosen:
        """Return the set without one member."""
        members = tuple(each for k, each in enumerate(self.members) if k != member)
        return Chosen(members, self.state.reduced(member + 1))


def within_bounds(chosen: Chosen) -> bool:
    """Return whether what was last added has the sign that it physically must have."""
    effect = chosen.members[-1].effect
    lower = [parameter.lower for parameter in effect.parameters[: effect.linear]]
    if chosen.members[-1].is_map or all(bound is None for bound in lower):
        return True
    amounts = chosen.state.solution.mean(axis=0)[-effect.linear :]
    x = effect.prior_factor @ amounts
    return all(bound is None or value >= bound for value, bound in zip(x, lower, strict=True))


def both_kinds_agree(before: Chosen, after: Chosen) -> bool:
    """Return whether neither positions nor attitudes are predicted worse for an effect.

    What turns the end one way and moves it another is not what its name says.
    """
    positions = before.state.position_squares - after.state.position_squares
    attitudes = before.squares - after.squares - positions
    return not (surely_worse(positions) or surely_worse(attitudes))


def surely_worse(gain: Array) -> bool:
    """Return whether a sum over blocks is below zero by more than its scatter between them."""
    return float(gain.sum()) < -_SURELY_WORSE * standard_error(gain)


def standard_error(gain: Array) -> float:
    """Return the standard error of a sum over blocks, from how it scatters between them."""
    return float(np.sqrt(len(gain)) * gain.std(ddof=1))
