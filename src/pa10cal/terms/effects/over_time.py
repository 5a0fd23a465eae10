"""Effects that change in time: a base that moves, links that grow with temperature."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pa10cal.arm.chain import BASE, Chain, long_links
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.effect import CandidateContext, Effect, time_in
from pa10cal.terms.term import TermParameter

_SECONDS_AN_HOUR = 3600.0
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
    id = "base_drift"
    depends_on = "time_s"
    clauses = ("the base moved while the campaign lasted",)
    sits = "base"
    coordinates = BASE[:3]
    goes_with_time = True

    @property
    def formula(self) -> str:
        rate = f"base.x, base.y, base.z += rate (time_s - {self.start_s:g}) / 3600"
        if self.end_s is None:
            return rate
        return (
            f"{rate} + sum of wave_k cos(k pi (time_s - {self.start_s:g}) / "
            f"{self.end_s - self.start_s:g}), time_s held at {self.start_s:g} and {self.end_s:g}"
        )

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...]:
        return (context.time_span_s[0],)

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        rates = [TermParameter(f"rate_{axis}", "m/h", 1e-6, plausible=3e-5) for axis in "xyz"]
        waves = [
            TermParameter(f"wave_{k}_{axis}", "m", 1e-6, plausible=_WAVE_M / k)
            for k in range(1, self.waves + 1)
            for axis in "xyz"
        ]
        return (*rates, *waves)

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
    depends_on = "temperature_C"
    clauses = ("the links grow with temperature",)
    sits = "arm"
    positive = True
    goes_with_time = True
    reported = (TermParameter("alpha", "1/K", 5e-7, plausible=2e-5),)
    # A part of the arm that stays colder than the air grows less than its material would.
    possible = (0.0, 2.6e-5, "arms are of iron and steel (10 to 13e-6) or light metal (to 26e-6)")

    @property
    def formula(self) -> str:
        return (
            f"{', '.join(self.lengths)} += alpha (temperature_C - "
            f"{self.reference_temperature_C:g}) times its nominal length"
        )

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...]:
        """Return the lengths of the pedestal (the motions before joint 2) and the long links."""
        chain = Chain.of(context.arm)
        ends = [0, *(int(column) for column in chain.joint_columns)]
        pedestal = range(ends[0], ends[2] if len(ends) > 2 else len(chain.motions))
        links = (range(ends[row], ends[row + 1]) for row in long_links(context.arm))
        columns = [
            column
            for link in (pedestal, *links)
            for column in link
            if chain.nominal[column] != 0.0 and not chain.motions[column].turns
        ]
        lengths = tuple(chain.motions[column].coordinate for column in columns)
        lengths_m = tuple(float(chain.nominal[column]) for column in columns)
        return lengths, lengths_m, context.reference_temperature_C

    @property
    def coordinates(self) -> tuple[str, ...]:
        return self.lengths

    def per_unit(self, states: PoseStates) -> Array:
        return np.outer(states.temperature_C - self.reference_temperature_C, self.lengths_m)
