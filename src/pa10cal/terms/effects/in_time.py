"""Effects of the instrument, and of what changes while a campaign lasts."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from pa10cal.arm.chain import BASE, TOOL, Chain, long_links
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.effect import CandidateContext, Effect, seen_in, time_in
from pa10cal.terms.term import TermParameter

_SECONDS_AN_HOUR = 3600.0
#: Amplitude expected of the slowest wave of a base that drifts; of others a part as of a random
#: walk.
_WAVE_M = 1e-4


@dataclass(frozen=True)
class BaseDrift(Effect):
    """The base moves along its axes at a constant rate [m/h], counted from the first reading.

    In its slow form it moves by a few cosines of the time besides, and stands still before the
    first and after the last reading, where nothing is known of it.
    """

    start_s: float  # time of the first reading
    end_s: float | None = None  # time of the last one; None of a constant rate, which goes on
    waves: int = 0  # cosines along each axis, of half a cycle more each; 0 of a constant rate
    id = "base_drift"
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
        """Return hours since the first reading, then waves, each axis for itself."""
        last_s = np.inf if self.end_s is None else self.end_s
        first_s = -np.inf if self.end_s is None else self.start_s
        since_s = np.clip(time_in(states, self), first_s, last_s) - self.start_s
        courses = [since_s / _SECONDS_AN_HOUR]
        courses += [
            np.cos(np.pi * k * since_s / (last_s - self.start_s)) for k in range(1, self.waves + 1)
        ]
        return np.asarray(np.stack(courses, axis=1)[:, None, :, None] * np.eye(3)[:, None, :])


@dataclass(frozen=True)
class ThermalGrowth(Effect):
    """Pedestal and long links grow by alpha (T - reference), alpha in 1/K."""

    lengths: tuple[str, ...]  # chain coordinates of these links' lengths
    lengths_m: tuple[float, ...]  # their nominal values
    reference_temperature_C: float  # temperature at which lengths are nominal
    id = "thermal_growth"
    sits = "arm"
    positive = True
    goes_with_time = True
    reported = (TermParameter("alpha", "1/K", 5e-7, plausible=2e-5),)

    @property
    def formula(self) -> str:
        return (
            f"{', '.join(self.lengths)} += alpha (temperature_C - "
            f"{self.reference_temperature_C:g}) times its nominal length"
        )

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...]:
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


# Effects of an instrument that reads the places of its targets falsely.


@dataclass(frozen=True)
class FalseReading(Effect):
    """The instrument reads each target's place p off by a field e(p), and so the pose.

    The model predicts what is read: the end moves by what the field makes of the fitted pose.
    """

    sits = "instrument"
    coordinates = TOOL

    @abstractmethod
    def field(self, p_instr_m: Array) -> Array:
        """Return e(p) a unit of each parameter, (P, B, 3, k), at places p (P, B, 3)."""

    def derivative(self, states: PoseStates, x: Array) -> Array:
        seen = seen_in(states, self)
        count, targets, _ = seen.p_instr_targets_m.shape
        field = self.field(seen.p_instr_targets_m).reshape(count, 3 * targets, len(x))
        derivative: Array = seen.pose_by_targets @ field
        return derivative


@dataclass(frozen=True)
class CmmScale(FalseReading):
    """Axis k of the instrument reads (1 + s_k) times the length, s without unit."""

    id = "cmm_scale"
    words = "reading of x, y, z = (1 + s_x) x, (1 + s_y) y, (1 + s_z) z"
    reported = tuple(TermParameter(f"s_{axis}", "1", 3e-6, plausible=1e-4) for axis in "xyz")

    def field(self, p_instr_m: Array) -> Array:
        return p_instr_m[..., None] * np.eye(3)


@dataclass(frozen=True)
class CmmSquareness(FalseReading):
    """The instrument's x axis is not square to y: x reads x + xy y, xy in rad."""

    id = "cmm_squareness"
    words = "reading of x = x + xy y"
    reported = (TermParameter("xy", "rad", 3e-6, plausible=1e-4),)

    def field(self, p_instr_m: Array) -> Array:
        field: Array = p_instr_m[..., 1:2] * np.array([1.0, 0.0, 0.0])
        return field[..., None]
