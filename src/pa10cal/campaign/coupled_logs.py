"""Joints logged beyond their limits: together with another, exchanged, or turns away.

A controller that counts joint 3 to the horizontal makes rows look wrong in which joint 2 moved:
their joint angles beyond limits, their places far from the nominal arm. They are right. So are
those of a controller that goes on counting turns. The nominal arm tells.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations, permutations

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.coupling import CoupledJoint
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Index, spread
from pa10cal.campaign.bounds import outside_bounds, unwrapped
from pa10cal.campaign.conventions import EXPECTED_M, NEARER, puts_right
from pa10cal.campaign.nominal_fit import misfit_of
from pa10cal.campaign.raw_rows import RawRows, in_radians
from pa10cal.frame.target_problem import first_of_least
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

    def ends(coupled: Coupled) -> Ends:
        matrix = replace(arm.coupling, joints=coupled)
        return lambda rows: Chain.of(arm).forward(matrix.to_joints(axes[rows]))

    tried = [each for _, each in couplings_near(arm)] if among is None else list(among)
    found = _that_fits(measured, ends(arm.coupled), list(map(ends, tried)))
    return None if found is None else (tried[found[0]], found[1])


#: The nominal end (r, 4, 4) at some rows.
Ends = Callable[[Index], Array]


def _that_fits(
    measured: Instrument, as_stated: Ends, tried: Sequence[Ends]
) -> tuple[int, Misfit] | None:
    """Return which of some readings of a log fits all that was measured, and the misfit.

    None where none does, or where the log fits nearly as well as it is read.
    """
    some = spread(len(measured), _LOOKED_AT)
    few = measured.take(some)
    as_stated_m = few.misfit_m(as_stated(some))
    if len(some) < measured.least_rows or as_stated_m <= NEARER * EXPECTED_M:
        return None
    T_base_ee = [ends(some) for ends in tried]
    least_m = list(map(few.least_misfit_m, T_base_ee))
    least = first_of_least(least_m, lambda k: few.misfit_m(T_base_ee[k]), as_stated_m / NEARER)
    if least is None:
        return None
    best = least[1]
    found = misfit_of(measured, tried[best](np.arange(len(measured))))
    fits = found is not None and puts_right(float(np.median(found.size_m)), EXPECTED_M)
    return (best, found) if found is not None and fits else None


def arm_of_log(raw: RawRows, q: Sequence[str], arm: Arm, measured: Instrument) -> Arm:
    """Return the arm as a log has its limits: coupled, where rows beyond them fit so alone.

    Or with limits exchanged or reversed, as the columns of two joints or the sign of one then are,
    which is told where a calibration is checked. The joints' columns are `q`; what was measured in
    each of the rows is `measured`.
    """
    within = [
        coupled
        for _, coupled in couplings_near(arm)
        if not outside_bounds(raw, q, replace(arm, coupled=coupled)).any()
    ]
    axes = in_radians(raw.numbers_of(q), arm.axes_slide)
    found = coupling_that_fits(arm, axes, measured, within)
    if found is not None or arm.coupled:
        return arm if found is None else replace(arm, coupled=found[0])
    slips = [
        (slipped, order, signs)
        for slipped, order, signs in _slips(arm)
        if not outside_bounds(raw, q, slipped).any()
    ]

    def ends(order: Index, signs: Array) -> Ends:
        return lambda rows: Chain.of(arm).forward(signs * axes[rows][:, order])

    as_read = ends(np.arange(arm.n), np.ones(arm.n))
    slip = _that_fits(measured, as_read, [ends(order, signs) for _, order, signs in slips])
    return arm if slip is None else slips[slip[0]][0]


def _slips(arm: Arm) -> Iterator[tuple[Arm, Index, Array]]:
    """Yield arms with the limits of a log in which two joints are exchanged, or one is reversed.

    Beside each, which column holds each joint (n,), and its sign (n,).
    """
    for one, other in combinations(range(arm.n), 2):
        if arm.prismatic[one] == arm.prismatic[other]:
            order = np.arange(arm.n)
            order[[one, other]] = other, one
            yield replace(arm, limits_rad=arm.limits_rad[order]), order, np.ones(arm.n)
    for joint in range(arm.n):
        signs, limits = np.ones(arm.n), arm.limits_rad.copy()
        signs[joint], limits[joint] = -1.0, -limits[joint, ::-1]
        yield replace(arm, limits_rad=limits), np.arange(arm.n), signs


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
