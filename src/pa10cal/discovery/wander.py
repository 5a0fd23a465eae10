"""Jumps and a slow wander of the instrument or the base: what they are, and how they are told.

A jump is six motions of the base times a unit step. A wander is a random walk of the base in its
first waves (Karhunen and Loève), of a size chosen. Gaussian sizes are expected of both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from pa10cal.arrays import Array
from pa10cal.discovery import linear
from pa10cal.discovery.finding import DiagnosedFault
from pa10cal.discovery.rules import MOTION
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.results.discovery import Unexplained


@dataclass(frozen=True)
class Jump:
    """A sudden motion of the base against the instrument."""

    time_s: float  # its most likely time
    # before_s and after_s: times of the readings between which it happened
    before_s: float
    after_s: float
    size_m: float = 0.0  # standard deviation expected of its shift
    turn: float = 0.0  # expected turn a shift [rad/m]
    pause: bool = False  # whether it happened in a pause, at once or in the course of it


@dataclass(frozen=True, eq=False)
class Wander:
    """Motion of the base in the course of time, its mean over the readings zero."""

    times_s: Array  # (P,) times of the readings, in order; the walk goes with their number
    jumps: tuple[Jump, ...]  # sudden motions, the most certain first
    walk_m: float = 0.0  # root mean square expected of the walk's shift; 0 without a walk
    walk_turn: float = 0.0  # its expected turn a shift [rad/m]
    # (6 c,) most likely motions for each course, in their expected sizes
    amounts: Array | None = None
    # root mean square of the motion at the readings, and of the walk alone
    rms_mm: tuple[float, float] = (0.0, 0.0)

    def courses(self, time_s: Array) -> Array:
        """Return the courses at times (P,), (P, c): unit steps, then waves of the walk.

        Their mean over the readings is zero.
        """

        def bare(at_s: Array) -> Array:
            steps = [(at_s > jump.time_s).astype(float) for jump in self.jumps]
            part = np.interp(at_s, self.times_s, np.linspace(0.0, 1.0, len(self.times_s)))
            number = np.arange(1, MOTION.walk_waves + 1 if self.walk_m else 1)
            waves = np.sqrt(2.0) * np.cos(np.pi * np.outer(part, number))
            return np.column_stack([*steps, waves])

        return np.asarray(bare(time_s) - bare(self.times_s).mean(axis=0))

    @property
    def sizes(self) -> Array:
        """Return the standard deviation expected of each motion of each course, (6 c,)."""
        parts = [sizes_of_six(jump.size_m, jump.turn) for jump in self.jumps]
        if self.walk_m:
            waves = self.walk_m * np.sqrt(6.0) / (np.pi * np.arange(1, MOTION.walk_waves + 1))
            parts += [sizes_of_six(size, self.walk_turn) for size in waves]
        return np.concatenate([np.zeros(0), *parts])

    def columns(self, at: FittedModel, poses: Observations) -> Array:
        """Return how measured less predicted components follow it, a unit each, (P, b, 6 c)."""
        return (
            motions_along(linear.by_base(at, poses), self.courses(poses.states.time_s)) * self.sizes
        )

    def shift(self, at: FittedModel, poses: Observations) -> Array:
        """Return by how much it moves the components of poses, (P, b)."""
        motions = self.motions(poses.states.time_s)
        return np.asarray((linear.by_base(at, poses) @ motions[:, :, None])[:, :, 0])

    def motions(self, time_s: Array) -> Array:
        """Return the most likely motions of the base at times (P,), (P, 6) [m, rad]."""
        return self.courses(time_s) @ self.unit_motions

    @property
    def unit_motions(self) -> Array:
        """Return the most likely six motions for each course, of jumps first, (c, 6) [m, rad]."""
        assert self.amounts is not None
        return (self.amounts * self.sizes).reshape(-1, 6)


@dataclass(frozen=True, eq=False)
class TimeFindings:
    """What readings show of time."""

    wander: Wander | None  # jumps and walk; None where the data prefer neither
    has_drift: bool  # whether an effect of time shows beside them
    # joints, rails and loads, in words, that the order goes with where more was seen: errors that
    # go with them explain that as well
    rivals: tuple[str, ...] = ()
    rivals_mm: float = 0.0  # root mean square of all that was seen before they were held against it


NO_MOTION = TimeFindings(None, has_drift=False)


def motions_along(by_motions: Array, courses: Array) -> Array:
    """Return columns (P, b, 6 c) of six motions (P, b, 6) in each course (P, c)."""
    both = courses[:, None, :, None] * by_motions[:, :, None, :]
    return np.asarray(both.reshape(*by_motions.shape[:2], -1))


def sizes_of_six(size_m: float, turn: float) -> Array:
    """Return the sizes of six motions: three shifts, three turns."""
    return np.array([size_m] * 3 + [size_m * turn] * 3)


_REMEDY = (
    "measure reference targets before and after, or calibrate the readings before and after as two "
    "campaigns"
)


def between_rows(readings: Observations, before_s: float, after_s: float) -> str:
    """Return in words between which readings something happened, by times that are theirs."""
    order = np.argsort(readings.states.time_s, kind="stable")
    time_s, pose = readings.states.time_s[order], readings.pose[order]
    last = int(np.searchsorted(time_s, before_s, side="right")) - 1
    next_ = int(np.searchsorted(time_s, after_s))
    begin, end = (f"{pose[k]} at {time_s[k]:.10g} s" for k in (last, next_))
    return f"between {begin} and {end}"


def steps_in_time(
    wander: Wander | None,
    at: FittedModel,
    readings: Observations,
    rivals: Mapping[float, tuple[str, ...]] = MappingProxyType({}),
) -> tuple[DiagnosedFault, ...]:
    """Return the jumps as faults of the log.

    One that has rivals, in words by its time, is no fact, but one explanation of several.
    """
    if wander is None:
        return ()
    found = []
    for k, jump in enumerate(wander.jumps):
        motion = wander.unit_motions[k]
        size_mm = linear.rms(
            linear.error_mm(readings.measured, linear.by_base(at, readings) @ motion)
        )
        turn_mrad = 1e3 * float(np.linalg.norm(motion[3:]))
        what = f"the instrument or the base moved by {size_mm:.2g} mm and {turn_mrad:.2f} mrad"
        if jump.pause:
            hours = (jump.after_s - jump.before_s) / 3600.0
            what += f" in a pause of {hours:.2g} h, at once or in the course of it"
        others = rivals.get(jump.time_s, ())
        if others:
            what = f"something changed: {what}, or {' or '.join(others)} does as well"
        where = between_rows(readings, jump.before_s, jump.after_s)
        told = {"where": where, "what": what, "remedy": _REMEDY}
        at_s = None if others else jump.time_s
        found.append(DiagnosedFault(kind="step_in_time", **told, at_s=at_s))
    return tuple(found)


def motion_unexplained(
    in_time: TimeFindings, wander: Wander | None, floor_mm: float
) -> tuple[Unexplained, ...]:
    """Return the walk, and what goes with joints as well: what exceeds the repeatability."""
    found: list[tuple[str | None, float, str]] = []
    if wander is not None and wander.walk_m and wander.rms_mm[1] > floor_mm:
        hours = float(np.ptp(wander.times_s)) / 3600.0
        why = (
            f"the instrument or the base wandered by {wander.rms_mm[1]:.3g} mm (root mean square) "
            f"in {hours:.2g} h, neither steadily nor at once"
        )
        found.append(("base", wander.rms_mm[1], why))
    if in_time.rivals and in_time.rivals_mm > floor_mm:
        why = (
            f"{in_time.rivals_mm:.3g} mm (root mean square) go with the order of the poses, and "
            f"with {' and '.join(in_time.rivals)} alike: the arm errs by that, or the instrument "
            "or the base moved; measure the poses in random order"
        )
        found.append((None, in_time.rivals_mm, why))
    return tuple(
        Unexplained(of=of, form=None, shared_error_mm=moved_mm, why=why)
        for of, moved_mm, why in found
    )
