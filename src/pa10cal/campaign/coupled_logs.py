"""Joints logged together with another, or turns away: does the nominal arm agree then?

A controller that counts joint 3 to the horizontal makes rows look wrong in which joint 2 moved:
their joint angles beyond limits, their places far from the nominal arm. They are right. So are
those of a controller that goes on counting turns.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.coupling import CoupledJoint
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Index, spread
from pa10cal.campaign.bounds import outside_bounds, unwrapped
from pa10cal.campaign.conventions import EXPECTED_M, NEARER, puts_right
from pa10cal.campaign.nominal_fit import misfit_of
from pa10cal.campaign.raw_rows import RawRows, in_radians
from pa10cal.errors import CalibrationError
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.quantities import Misfit

Coupled = tuple[CoupledJoint, ...]
#: Rows that couplings are tried on.
_LOOKED_AT = 100


def couplings_near(arm: Arm) -> Iterator[tuple[CoupledJoint, Coupled]]:
    """Yield what another controller of the arm might count: one joint more or less the other.

    Both slide or both turn; neighbours come first. Beside each stands the whole coupling with it.
    """
    pairs = permutations((arm.coupling.own + 1).tolist(), 2)
    for joint, by in sorted(pairs, key=lambda pair: abs(pair[0] - pair[1])):
        if arm.prismatic[joint - 1] != arm.prismatic[by - 1]:
            continue
        others = tuple(each for each in arm.coupled if (each.joint, each.by) != (joint, by))
        stated = sum(each.factor for each in arm.coupled if each not in others)
        for factor in (factor for factor in (1.0, -1.0, 0.0) if factor != stated):
            changed = CoupledJoint(joint, by, factor)
            coupled = (*others, changed) if factor else others
            if not replace(arm.coupling, joints=coupled).singular:
                yield changed, coupled


def coupling_that_fits(
    arm: Arm, axes: Array, measured: Instrument, among: Iterable[Coupled] | None = None
) -> tuple[Coupled, Misfit] | None:
    """Return the coupling with which the nominal arm fits all readings, and their misfit.

    None where no coupling does, or the arm fits nearly as well as it is described.

    Args:
        axes: (P, m) positions that the controller counts [rad, m].
        among: which are tried; None for all that are near.
    """

    some = spread(len(axes), _LOOKED_AT)
    few = measured.take(some)

    def ends(coupled: Coupled, at: Array) -> Array:
        return Chain.of(arm).forward(replace(arm.coupling, joints=coupled).to_joints(at))

    def size_m(coupled: Coupled) -> float:
        try:
            return few.locate(ends(coupled, axes[some]), roughly=True).misfit_m
        except CalibrationError:
            return np.inf

    as_stated_m = size_m(arm.coupled)
    if len(some) < measured.least_rows or as_stated_m <= NEARER * EXPECTED_M:
        return None
    tried = [each for _, each in couplings_near(arm)] if among is None else list(among)
    sizes_m = [size_m(coupled) for coupled in tried]
    best = int(np.argmin(sizes_m)) if tried else -1
    if best < 0 or NEARER * sizes_m[best] > as_stated_m:
        return None
    found = misfit_of(measured, ends(tried[best], axes))
    fits = found is not None and puts_right(float(np.median(found.size_m)), EXPECTED_M)
    return (tried[best], found) if found is not None and fits else None


def arm_of_log(raw: RawRows, q: Sequence[str], arm: Arm, measured: Instrument) -> Arm:
    """Return the arm as a log has its limits: coupled, where rows beyond them fit so alone.

    The joints' columns are `q`; what was measured in each of the rows is `measured`.
    """
    within = [
        coupled
        for _, coupled in couplings_near(arm)
        if not outside_bounds(raw, q, replace(arm, coupled=coupled)).any()
    ]
    axes = in_radians(raw.numbers_of(q), arm.axes_slide)
    found = coupling_that_fits(arm, axes, measured, within)
    return arm if found is None else replace(arm, coupled=found[0])


def without_turns(
    raw: RawRows, q: Sequence[str], arm: Arm, usable: Index, measured: Instrument
) -> RawRows:
    """Return a log with its joints moved by whole turns into their limits, where it fits so.

    What was measured in the usable rows is `measured`.
    """
    moved = unwrapped(raw, q, arm, spread_deg=np.inf)
    if moved is raw or len(usable) < measured.least_rows:
        return raw
    axes = in_radians(moved.at(usable).numbers_of(q), arm.axes_slide)
    found = misfit_of(measured, Chain.of(arm).forward(arm.coupling.to_joints(axes)))
    fits = found is not None and puts_right(float(np.median(found.size_m)), EXPECTED_M)
    return moved if fits else raw
