"""Effects that change in time: a base that moves, an arm or a link that grows with temperature."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Self

import numpy as np

from pa10cal.arm.chain import BASE, Chain, long_links
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.effect import Effect, Limits, time_in
from pa10cal.terms.effects.structure import LONG_LINKS
from pa10cal.terms.term import OPTIONAL, TermParameter

_SECONDS_AN_HOUR = 3600.0
#: Expected rate of a base that drifts steadily [m/h].
_RATE_M_H = 3e-5
#: Largest rate of a steady drift [m/h]: a floor or a column of steel moves by hundredths of a
#: millimetre in an hour, a tripod that settles or a camera that warms up by up to some millimetres.
#: So it is around an arm that reaches this far [m]; what carries a larger one is larger in
#: proportion, up to the soil under a crane.
_MOST_M_H, _USUAL_REACH_M = 3e-3, 1.7
#: Expected amplitude of the slowest wave of a drifting base [m]; that of wave k is 1/k of it, as of
#: a random walk.
_WAVE_M = 1e-4


@dataclass(frozen=True)
class BaseDrift(Effect):
    """The base moves along its axes at a constant rate [m/h], counted from the first reading.

    With `waves` a cosine series of time is added, and the base is held before the first and after
    the last reading, where nothing is known of it. Poses without a time (nan) have no drift.
    """

    start_s: float  # time of the first reading
    end_s: float | None = None  # time of the last one; None for a constant rate, not held
    waves: int = 0  # cosines along each axis, wave k of k/2 cycles; 0 for a constant rate
    # expected rate [m/h], where it is not the usual one
    plausible_m_h: float | None = field(default=None, metadata={OPTIONAL: True})
    id = "base_drift"
    varies_with = "time"
    depends_on = "time_s"
    clauses = ("the base moved while the campaign lasted",)
    sits = "base"
    coordinates = BASE[:3]

    @property
    def formula(self) -> str:
        start = f"{self.start_s:.12g}"  # of Unix times six digits would be off by an hour
        rate = f"base.x, base.y, base.z += rate (time_s - {start}) / 3600"
        if self.end_s is None:
            return rate
        return (
            f"{rate} + sum of wave_k cos(k pi (time_s - {start}) / "
            f"{self.end_s - self.start_s:g}), time_s held at {start} and {self.end_s:.12g}"
        )

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...]:
        return (context.time_span_s[0],)

    @classmethod
    def over(cls, time_s: Array, times: float = 1.0) -> Self:
        """Return a steady drift over times that is expected to be as large as one with waves.

        Or so many times as large.
        """
        start_s, hours = float(time_s.min()), float(np.ptp(time_s)) / _SECONDS_AN_HOUR
        rate_m_h = times * _WAVE_M / hours
        return cls("base", start_s, plausible_m_h=rate_m_h if rate_m_h > _RATE_M_H else None)

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        usual = self.plausible_m_h or _RATE_M_H
        rates = [TermParameter(f"rate_{axis}", "m/h", 1e-6, plausible=usual) for axis in "xyz"]
        waves = [
            TermParameter(f"wave_{k}_{axis}", "m", 1e-6, plausible=_WAVE_M / k)
            for k in range(1, self.waves + 1)
            for axis in "xyz"
        ]
        return (*rates, *waves)

    def limits_at(self, reach_m: float) -> Limits:
        """Return its limits: of a steady drift the rate that a mount of the instrument may have."""
        if self.waves:
            return super().limits_at(reach_m)
        of_mount_m_h = _MOST_M_H * max(1.0, reach_m / _USUAL_REACH_M)
        most_m_h = max(of_mount_m_h, self.plausible_m_h or 0.0)
        why = f"no mount of an arm or instrument moves by {1e3 * most_m_h:.2g} mm in an hour"
        return Limits(values=(-most_m_h, most_m_h), why=why)

    def per_unit(self, states: PoseStates) -> Array:
        """Return hours since the first reading, then the waves, for each axis separately."""
        last_s = np.inf if self.end_s is None else self.end_s
        first_s = -np.inf if self.end_s is None else self.start_s
        since_s = np.clip(time_in(states, self), first_s, last_s) - self.start_s
        courses = [since_s / _SECONDS_AN_HOUR]
        courses += [
            np.cos(np.pi * k * since_s / (last_s - self.start_s)) for k in range(1, self.waves + 1)
        ]
        of_time = np.nan_to_num(np.stack(courses, axis=1))  # nan: no time
        return np.asarray(of_time[:, None, :, None] * np.eye(3)[:, None, :])


@dataclass(frozen=True)
class ThermalGrowth(Effect):
    """Pedestal and long links grow by alpha (T - reference), alpha in 1/K."""

    lengths: tuple[str, ...]  # chain coordinates of these links' lengths
    lengths_m: tuple[float, ...]  # their nominal values
    reference_temperature_C: float  # temperature at which lengths are nominal
    id = "thermal_growth"
    varies_with = "temperature"
    depends_on = "temperature_C"
    clauses = ("the links grow with temperature",)
    sits = "arm"
    reported = (TermParameter("alpha", "1/K", 5e-7, plausible=2e-5),)
    # A part of the arm that stays colder than the air grows less than its material would.
    limits = Limits(
        positive=True,
        values=(0.0, 2.6e-5),
        why="arms are of iron and steel (10 to 13e-6) or light metal (to 26e-6)",
    )

    @property
    def formula(self) -> str:
        return (
            f"{', '.join(self.lengths)} += alpha (temperature_C - "
            f"{self.reference_temperature_C:g}) times its nominal length"
        )

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...]:
        """Return the lengths of the pedestal (the motions before joint 2) and the long links."""
        links = motions_by_link(context.arm)
        grown = [links[0], *(links[row - 1] for row in long_links(context.arm))]
        columns = [column for link in grown for column in link]
        return *lengths_of(context.arm, columns), context.reference_temperature_C

    @property
    def coordinates(self) -> tuple[str, ...]:
        return self.lengths

    def per_unit(self, states: PoseStates) -> Array:
        return np.outer(states.temperature_C - self.reference_temperature_C, self.lengths_m)


@dataclass(frozen=True)
class LinkGrowth(ThermalGrowth):
    """One long link grows by alpha (T - reference), alpha in 1/K, T as logged and not of the link.

    A motor in it, or the sun, warms it more than where the temperature is logged.
    """

    id = "link_growth"
    clauses = ("{at} grows with temperature",)
    limits = Limits(
        positive=True,
        values=(0.0, 1.3e-4),
        why="light metal grows by 26e-6, and no link warms five times as much",
    )

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        """Return the growth of each long link."""
        links, reference_C = motions_by_link(context.arm), context.reference_temperature_C
        return tuple(
            cls(place, *lengths_of(context.arm, links[row - 1]), reference_C)
            for place, row in zip(LONG_LINKS, long_links(context.arm), strict=False)
        )


def motions_by_link(arm: Arm) -> list[range]:
    """Return the columns of the motions of each link; before joint 2, of the pedestal too."""
    ends = [*Chain.of(arm).joint_columns.tolist(), len(Chain.of(arm).motions)]
    ends[0] = 0
    return [range(first, last) for first, last in pairwise(ends)]


def lengths_of(arm: Arm, columns: Iterable[int]) -> tuple[tuple[str, ...], tuple[float, ...]]:
    """Return the coordinates of those motions that are lengths other than zero, and these [m]."""
    chain = Chain.of(arm)
    lengths = {
        chain.motions[column].coordinate: float(chain.nominal[column])
        for column in columns
        if chain.nominal[column] != 0.0 and not chain.motions[column].turns
    }
    return tuple(lengths), tuple(lengths.values())
