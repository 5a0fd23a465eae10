"""How joints are counted, where those of a log exceed limits of the arm, and its rows are right.

Three causes are tested: the controller counts a joint together with another one (joint 3 to the
horizontal), two columns are exchanged or one has the other sign, or angles are whole turns off. A
cause is accepted only if with it the nominal arm, base and target fitted, agrees with all readings.
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
from pa10cal.campaign.joint_positions import in_radians
from pa10cal.campaign.nominal_fit import misfit_of
from pa10cal.campaign.raw_rows import RawRows
from pa10cal.numerics.least_squares import best_candidate
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.quantities import Misfit

#: All coupled joints of an arm.
Coupled = tuple[CoupledJoint, ...]
#: Returns the nominal end (r, 4, 4) at some rows (r,) of a log.
EndsAt = Callable[[Index], Array]
#: Rows by which candidates are compared; only the best of them is fitted to all rows.
_COMPARED_ROWS = 100
#: Candidates that are fitted without gross readings.
_FITTED_CANDIDATES = 12


def couplings_near(arm: Arm) -> Iterator[Coupled]:
    """Yield couplings that differ from the arm's in the factor (1, -1 or 0) of one pair of joints.

    Both joints of a pair slide or both turn; pairs of neighbours come first.
    """
    pairs = permutations((arm.coupling.own + 1).tolist(), 2)
    for joint, by in sorted(pairs, key=lambda pair: abs(pair[0] - pair[1])):
        if arm.prismatic[joint - 1] != arm.prismatic[by - 1]:
            continue
        others = tuple(c for c in arm.coupled if (c.joint, c.by) != (joint, by))
        stated = sum(c.factor for c in arm.coupled if (c.joint, c.by) == (joint, by))
        for factor in (1.0, -1.0, 0.0):
            if factor == stated:
                continue
            coupled = (*others, CoupledJoint(joint, by, factor)) if factor else others
            if not replace(arm.coupling, joints=coupled).singular:
                yield coupled


def coupling_that_fits(
    arm: Arm, axes: Array, measured: Instrument, among: Iterable[Coupled] | None = None
) -> tuple[Coupled, Misfit] | None:
    """Return the coupling with which the nominal arm fits all readings, and their misfit.

    None where no coupling puts the readings right, or where the coupling as described does not
    leave several times what is expected of a nominal arm.

    Args:
        arm: the arm with its coupling as described.
        axes: (P, m) positions that the controller counts [rad, m].
        measured: the P readings.
        among: candidates; None for those of `couplings_near`.
    """

    def ends_with(coupled: Coupled) -> EndsAt:
        matrix = replace(arm.coupling, joints=coupled)
        return lambda rows: Chain.of(arm).forward(matrix.to_joints(axes[rows]))

    candidates = list(couplings_near(arm) if among is None else among)
    best = _candidate_that_fits(measured, ends_with(arm.coupled), list(map(ends_with, candidates)))
    if best is None:
        return None
    number, misfit = best
    return candidates[number], misfit


def _candidate_that_fits(
    measured: Instrument, as_described: EndsAt, candidates: Sequence[EndsAt]
) -> tuple[int, Misfit] | None:
    """Return the number of the candidate that fits all that was measured, and the misfit.

    None where none puts the readings right, or where there is too little wrong `as_described`.
    """
    compared = spread(len(measured), _COMPARED_ROWS)
    few = measured.take(compared)
    described_m = few.misfit_m(as_described(compared))
    if len(compared) < measured.least_rows or described_m <= NEARER * EXPECTED_M:
        return None
    T_base_ee = [ends_at(compared) for ends_at in candidates]
    lower_bounds_m = list(map(few.least_misfit_m, T_base_ee))
    best = best_candidate(
        lower_bounds_m, lambda number: few.misfit_m(T_base_ee[number]), described_m / NEARER
    )
    # A gross reading is in every such misfit: those that are nearest with it are fitted without it.
    nearest = np.argsort(lower_bounds_m, kind="stable")[:_FITTED_CANDIDATES].tolist()
    numbers = nearest if best is None else [best.number]
    medians_m = [_robust_median_m(few, T_base_ee[number]) for number in numbers]
    described_m = _robust_median_m(few, as_described(compared))
    if not numbers or min(medians_m) > described_m / NEARER:
        return None
    number = numbers[int(np.argmin(medians_m))]
    misfit = _misfit_if_right(measured, candidates[number](np.arange(len(measured))))
    return None if misfit is None else (number, misfit)


def _robust_median_m(measured: Instrument, T_base_ee: Array) -> float:
    """Return the median misfit of the nominal end, fitted for the least sum of distances."""
    misfit = misfit_of(measured, T_base_ee)
    return np.inf if misfit is None else float(np.median(misfit.size_m))


def _misfit_if_right(measured: Instrument, T_base_ee: Array) -> Misfit | None:
    """Return the misfit of the nominal end (P, 4, 4); None where it is not as of right readings."""
    misfit = misfit_of(measured, T_base_ee)
    right = misfit is not None and puts_right(float(np.median(misfit.size_m)), EXPECTED_M)
    return misfit if right else None


def arm_of_log(raw: RawRows, q: Sequence[str], arm: Arm, measured: Instrument) -> Arm:
    """Return the arm with the limits that this log obeys.

    It has another coupling, two joints exchanged or one reversed, if only that brings all rows into
    the limits and explains the readings; else it is the arm as described. Exchanged and reversed
    joints are reported when a calibration is checked, not here.

    Args:
        raw: rows of the log.
        q: its columns of joint positions.
        arm: the arm as described.
        measured: what was measured in each row.
    """
    within_limits = [
        coupled
        for coupled in couplings_near(arm)
        if not outside_bounds(raw, q, replace(arm, coupled=coupled)).any()
    ]
    axes = in_radians(raw.numbers_of(q), arm.axes_slide)
    coupling = coupling_that_fits(arm, axes, measured, within_limits)
    if coupling is not None:
        return replace(arm, coupled=coupling[0])
    if arm.coupled:
        return arm
    slips = [
        (slipped, order, signs)
        for slipped, order, signs in _exchanged_or_reversed(arm)
        if not outside_bounds(raw, q, slipped).any()
    ]

    def ends_with(order: Index, signs: Array) -> EndsAt:
        return lambda rows: Chain.of(arm).forward(signs * axes[rows][:, order])

    as_described = ends_with(np.arange(arm.n), np.ones(arm.n))
    candidates = [ends_with(order, signs) for _, order, signs in slips]
    best = _candidate_that_fits(measured, as_described, candidates)
    return arm if best is None else slips[best[0]][0]


def _exchanged_or_reversed(arm: Arm) -> Iterator[tuple[Arm, Index, Array]]:
    """Yield arms with the limits of two joints exchanged, or of one joint reversed.

    With each come the column that holds each joint (n,), and the sign of each joint (n,).
    """
    for first, second in combinations(range(arm.n), 2):
        if arm.prismatic[first] == arm.prismatic[second]:
            order = np.arange(arm.n)
            order[[first, second]] = second, first
            yield replace(arm, limits_rad=arm.limits_rad[order]), order, np.ones(arm.n)
    for joint in range(arm.n):
        signs = np.ones(arm.n)
        signs[joint] = -1.0
        limits_rad = arm.limits_rad.copy()
        limits_rad[joint] = -limits_rad[joint, ::-1]
        yield replace(arm, limits_rad=limits_rad), np.arange(arm.n), signs


def without_turns(
    raw: RawRows, q: Sequence[str], arm: Arm, usable: Index, measured: Instrument
) -> RawRows:
    """Return a log whose joints are moved by whole turns into their limits, if that fits.

    `measured` is what was measured in the usable rows (U,); it decides.
    """
    moved = unwrapped(raw, q, arm, spread_deg=np.inf)
    if moved is raw:
        return raw
    axes = in_radians(moved.at(usable).numbers_of(q), arm.axes_slide)
    T_base_ee = Chain.of(arm).forward(arm.coupling.to_joints(axes))
    return raw if _misfit_if_right(measured, T_base_ee) is None else moved
