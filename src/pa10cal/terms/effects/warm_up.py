"""Effects of an arm that warms up: a first-order lag in time, from the first reading on.

Drives and links warm up as they are used and approach a steady temperature by 1 - exp(-t / tau), as
a body does that is heated evenly (ISO 230-3 is about such errors of machines, and ISO 9283 lets a
warm-up precede tests). What is fitted is how much of it has not yet come, -A exp(-t / tau): that is
the same but for a constant, which zeros and lengths take up. It vanishes in the warm arm, which
poses without a time are taken to be of.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from pa10cal.arm.chain import long_links
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.effect import AtJoint, Effect, Limits, time_in
from pa10cal.terms.effects.over_time import lengths_of, motions_by_link
from pa10cal.terms.effects.structure import LONG_LINKS
from pa10cal.terms.term import TermParameter

#: Parts of a campaign that a time constant may be: with a longer one it is a drift (chosen).
_SHORTEST, _USUAL, _LONGEST = 1e-3, 0.1, 0.2


@dataclass(frozen=True)
class WarmsUp(Effect):
    """Something that a part of the arm lacks until it is warm: -A exp(-(t - start) / tau).

    It is sought where the first poses show it (`discovery/warm_ups`).
    """

    start_s: float  # time of the first reading
    span_s: float  # from there to the last one
    tau_s: float  # time constant at which the fit of tau starts
    varies_with = "time"
    depends_on = "time_s"
    role_in_search = "proposed"
    stays_with_arm = False
    linear = 1  # proportional to A; tau shapes it

    @classmethod
    def start_span_and_tau(cls, context: CandidateContext) -> tuple[float, float, float] | None:
        """Return start, span and time constant [s]; None where the campaign has no length."""
        first_s, last_s = context.time_span_s
        span_s = last_s - first_s
        return (first_s, span_s, _USUAL * span_s) if span_s > 0.0 else None

    @property
    def tau(self) -> TermParameter:
        """Return the time constant as a parameter, within whose bounds the fit of it starts."""
        low, high = min(_SHORTEST * self.span_s, self.tau_s), _LONGEST * self.span_s
        return TermParameter("tau", "s", _USUAL * self.span_s, lower=low, upper=high)

    @property
    def starts(self) -> tuple[Array, ...]:
        return (np.array([0.0, self.tau_s]),)

    @property
    def directions(self) -> Array:
        """Return the shares of its coordinates in what has not yet come, (m,)."""
        return np.ones(1)

    def shift(self, states: PoseStates, x: Array) -> Array:
        _, left = self._lacking(states, x[1])
        return np.asarray(-x[0] * np.outer(left, self.directions))

    def derivative(self, states: PoseStates, x: Array) -> Array:
        since_s, left = self._lacking(states, x[1])
        by_tau = x[0] * left * since_s / x[1] ** 2
        of_each = -np.stack([left, by_tau], axis=-1)
        return np.asarray(of_each[:, None, :] * self.directions[:, None])

    def _lacking(self, states: PoseStates, tau_s: float) -> tuple[Array, Array]:
        """Return the time since the start [s], and the part that has not yet come, (P,)."""
        since_s = np.maximum(time_in(states, self) - self.start_s, 0.0)
        left = np.where(np.isnan(since_s), 0.0, np.exp(-since_s / tau_s))  # nan: warm
        return np.nan_to_num(since_s), left


@dataclass(frozen=True)
class WarmUp(WarmsUp, AtJoint):
    """The zero of a joint moves while the arm warms up: -A exp(-(t - start) / tau) [rad]."""

    id = "warm_up"
    nouns = ("warm-up", "warm-up")
    clauses = (
        "the zero of {at} moved while the arm warmed up",
        "the zeros of {at} moved while the arm warmed up",
    )
    words = "theta_{0.joint} -= A exp(-(time_s - {0.start_s:.12g}) / tau)"

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        return cls.start_span_and_tau(context)

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        return TermParameter("A", "rad", 1e-5, plausible=3e-4), self.tau


@dataclass(frozen=True)
class LinkWarmUp(WarmsUp):
    """A long link grows while the arm warms up; -A exp(-(t - start) / tau) [m] is missing yet."""

    lengths: tuple[str, ...]  # chain coordinates of its lengths
    lengths_m: tuple[float, ...]  # their nominal values, in whose proportion they grow
    id = "link_warm_up"
    sits = "long link"
    clauses = ("{at} grew while the arm warmed up",)
    limits = Limits(positive=True)

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        """Return the growth of each long link."""
        times_s = cls.start_span_and_tau(context)
        if times_s is None:
            return ()
        links = motions_by_link(context.arm)
        return tuple(
            cls(place, *times_s, *lengths_of(context.arm, links[row - 1]))
            for place, row in zip(LONG_LINKS, long_links(context.arm), strict=False)
        )

    @property
    def formula(self) -> str:
        of_each = zip(self.lengths, self.directions.tolist(), strict=True)
        moved = ", ".join(f"{name} -= {share:.3g} A left" for name, share in of_each)
        return f"{moved}, left = exp(-(time_s - {self.start_s:.12g}) / tau)"

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        return TermParameter("A", "m", 1e-6, plausible=1e-4), self.tau

    @property
    def coordinates(self) -> tuple[str, ...]:
        return self.lengths

    @property
    def directions(self) -> Array:
        lengths_m = np.array(self.lengths_m)
        return np.asarray(lengths_m / np.linalg.norm(lengths_m))


def warm_ups(context: CandidateContext) -> tuple[WarmsUp, ...]:
    """Return a warm-up of every joint that turns and of every long link."""
    kinds: Iterable[type[WarmsUp]] = (WarmUp, LinkWarmUp)
    return tuple(effect for kind in kinds for effect in kind.everywhere(context))
