"""Poses from which a plan is chosen: spread evenly over the joints' ranges, within all limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.room import (
    Above,
    Box,
    Constraint,
    Facing,
    InSight,
    KeepOut,
    OffColumn,
    OffLinks,
    Postures,
    Reach,
    Within,
    admissible,
)
from pa10cal.arrays import Array
from pa10cal.errors import CalibrationError
from pa10cal.pose_plan.options import PlanOptions

_MM = 1e-3
#: Joint positions are chosen as a plan's file has them [deg, mm].
DECIMALS = 3
#: Poses drawn at once, a power of two as Sobol's sequence needs, and how often at most.
_AT_ONCE = 2**14
_MOST_DRAWS = 60
#: After so many draws of which nothing is left, nothing will be.
_HOPELESS = 6
#: There is something to choose among so many candidates for each pose.
_FOR_EACH = 3
#: The tool stays off the base's axis, and targets off the lines from joint to joint, by these parts
#: of the arm's reach: about how thick arms are.
_COLUMN_SHARE = 0.1
_CLEARANCE_SHARE = 0.05


@dataclass(frozen=True)
class Candidates:
    """Poses from which a plan is chosen."""

    q: Array  # (N, n) joint positions [rad, or m of a prismatic joint]
    drawn: int  # how many were drawn
    # how many of these each constraint removed, by the option that states it
    removed: dict[str, int]


def joint_ranges(arm: Arm, options: PlanOptions) -> tuple[Array, Array]:
    """Return the least and largest joint positions of a plan, (n,) each [rad, m].

    Raises:
        CalibrationError: when ranges are given and are not one a joint, within its limits.
    """
    low, high = arm.limits_rad.T
    if options.joints_deg:
        unit = np.where(arm.prismatic, _MM, np.radians(1.0))
        given = np.array(options.joints_deg, dtype=float)
        if len(given) != arm.n:
            raise CalibrationError(
                "not one range a joint",
                where="joints_deg",
                value=f"{len(given)} ranges",
                allowed=f"{arm.n} ranges, least and largest",
                remedy="give one range a joint",
            )
        first, last = given.T * unit
        wrong = (first > last) | (first < low - 1e-9) | (last > high + 1e-9)
        if wrong.any():
            joint = int(np.argmax(wrong))
            raise CalibrationError(
                "the range is none, or leaves the joint's limits",
                where=f"joints_deg of joint {joint + 1}",
                value=tuple(given[joint].tolist()),
                allowed=f"{low[joint] / unit[joint]:.1f} to {high[joint] / unit[joint]:.1f}",
                remedy="correct the range",
            )
        return first, last
    margin = options.limit_margin * (high - low)
    widest = np.where(arm.prismatic, np.inf, np.radians(options.largest_angle_deg))
    return np.maximum(low + margin, -widest), np.minimum(high - margin, widest)


def constraints_of(arm: Arm, options: PlanOptions) -> dict[str, Constraint]:
    """Return where arm and tool may be, by the option that says so, the quickest first."""
    found: dict[str, Constraint] = {}
    if options.workspace_mm is not None:
        corners = _MM * np.array(options.workspace_mm)
        found["workspace_mm"] = Within(Box(corners.min(axis=0), corners.max(axis=0)))
    if options.reach_mm is not None:
        found["reach_mm"] = Reach(_MM * options.reach_mm)
    if options.floor_mm is not None:
        found["floor_mm"] = Above(_MM * options.floor_mm)
    found["the tool off the base's axis"] = OffColumn(_COLUMN_SHARE * arm.reach_m)
    found["the tool off the links"] = OffLinks(_CLEARANCE_SHARE * arm.reach_m)
    boxes = [
        Box(_MM * np.array(box.min_mm), _MM * np.array(box.max_mm)) for box in options.keep_out
    ]
    for number, (box, given) in enumerate(zip(boxes, options.keep_out, strict=True), start=1):
        found[f"keep-out {number} ({given.name})"] = KeepOut(box)
    if options.instrument_at_mm is not None:
        at = _MM * np.array(options.instrument_at_mm)
        if options.facing_deg is not None:
            facing = float(np.radians(options.facing_deg))
            found["facing_deg"] = Facing(at, np.array([0.0, 0.0, 1.0]), facing)
        if boxes:
            found["line of sight"] = InSight(at, tuple(boxes))
    return found


def draw_candidates(arm: Arm, targets_m: Array, options: PlanOptions, least: int) -> Candidates:
    """Draw poses by Sobol's sequence, and keep those within all constraints.

    As many as the options want, and some for each pose that is needed.

    Args:
        arm: the nominal arm.
        targets_m: (B, 3) targets on the end.
        options: where arm and tool may be, and how many poses are wanted.
        least: how many are needed.

    Raises:
        CalibrationError: when too few are left, saying which constraint removed how many.
    """
    wanted = max(options.candidates, _FOR_EACH * least)
    low, high = joint_ranges(arm, options)
    constraints, chain = constraints_of(arm, options), Chain.of(arm)
    sobol = qmc.Sobol(arm.n, rng=options.random_seed)
    removed = np.zeros(len(constraints), dtype=np.int64)
    kept: list[Array] = []
    draws = 0
    while draws < _MOST_DRAWS and sum(map(len, kept)) < wanted:
        q = _as_written(arm, low + (high - low) * sobol.random(_AT_ONCE))
        allowed, fewer = admissible(Postures.of(chain, q, targets_m), [*constraints.values()])
        kept.append(q[allowed])
        removed += fewer
        draws += 1
        if draws == _HOPELESS and not sum(map(len, kept)):
            break
    found = Candidates(
        np.concatenate(kept)[:wanted],
        draws * _AT_ONCE,
        {name: int(number) for name, number in zip(constraints, removed, strict=True)},
    )
    _refuse_too_few(found, least)
    return found


def _as_written(arm: Arm, q: Array) -> Array:
    """Return joint positions rounded as a plan's file has them."""
    unit = np.where(arm.prismatic, _MM, np.radians(1.0))
    rounded: Array = np.round(q / unit, DECIMALS) * unit
    return rounded


def _refuse_too_few(found: Candidates, least: int) -> None:
    if len(found.q) >= least:
        return
    removed = {name: number for name, number in found.removed.items() if number}
    worst = max(removed, key=lambda name: removed[name])
    each = "; ".join(f"{name}: {number}" for name, number in removed.items())
    raise CalibrationError(
        "hardly any pose keeps within all limits" if len(found.q) else "no pose is left",
        where="poses drawn within the joint limits",
        value=f"{len(found.q)} of {found.drawn}; removed, one after the other: {each}",
        allowed=f"at least {least}",
        remedy=f"allow more room, first of all for: {worst}",
    )
