"""Joints that stood at few positions only, as on a grid, and the error of a model between these.

What depends on such a joint's position is known at its levels alone: lines of gears, bumps of a
rail and smooth errors take the same values there. How far off a model may be between them is
estimated by holding out whole levels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, TypeGuard

import numpy as np

from pa10cal.arrays import Array, Index
from pa10cal.fit.fitted import Fitted
from pa10cal.fit.repeatability import is_chance
from pa10cal.fit.rows_about_fit import RowsAboutFit
from pa10cal.fit.validity import Discrepancy, apart
from pa10cal.observe.observations import Observations
from pa10cal.rules import ANGLES, LEVELS
from pa10cal.terms.effects.effect import AtJoint, Effect, is_effect
from pa10cal.terms.term import Term

_TURN = 2.0 * np.pi


def levels_of(position: Array, *, turns: bool) -> Array:
    """Return the levels (m,) at which a joint stood in poses (P,), ascending; (0,) for no levels.

    Angles of a joint that turns count modulo a turn.
    """
    along, first = np.asarray(position, dtype=float), 0.0
    if turns:  # the circle is cut where the joint stood least
        angle = np.sort(np.mod(position, _TURN))
        arcs = np.diff(angle, append=angle[0] + _TURN)
        first = float(angle[(int(np.argmax(arcs)) + 1) % len(angle)])
        # Rounding may take the first angle to just below a whole turn.
        along = np.mod(position - first + 0.5 * arcs.max(), _TURN) - 0.5 * arcs.max()
    along = np.sort(along)
    span, gaps = float(np.ptp(along)), np.diff(along)
    starts = np.append(0, 1 + np.flatnonzero(gaps > LEVELS.gap_share * span))
    parts = np.split(along, starts[1:])
    width = sum(float(np.ptp(part)) for part in parts)
    if len(parts) < LEVELS.least or len(along) < LEVELS.poses * len(parts):
        return np.zeros(0)
    least_gap = min(gaps[starts[1:] - 1])
    if width > LEVELS.width_share * span or (turns and least_gap < ANGLES.reach_rad):
        return np.zeros(0)
    return first + np.array([part.mean() for part in parts])


def of_position(term: Term) -> TypeGuard[Effect]:
    """Return whether a term is an effect of the position of its joint alone."""
    return is_effect(term) and term.varies_with == AtJoint.varies_with


def level_of(position: Array, levels: Array, *, turns: bool) -> Index:
    """Return the number of the nearest of levels (m,) for positions (P,), (P,)."""
    return np.asarray(np.abs(apart(position, levels, turns=turns)).argmin(axis=1), dtype=np.intp)


class ByLevels(NamedTuple):
    """What levels of a joint say, held out one by one, but for the lowest and the highest."""

    # odds of the effects of its position against any other function of it; inf without effects
    odds: float
    between_mm2: float  # mean squared position error between the levels, beyond that at them


def by_levels(
    model: Fitted,
    rows: RowsAboutFit,
    poses: Observations,
    joint: int,
    levels: Array,
    found: Discrepancy | None = None,
) -> ByLevels:
    """Hold out levels (m,) of a joint, from 0, of poses as modelled.

    Any function that has the same values at the levels explains the readings as the effects do, and
    differs from them between by as much as levels differ. Effects are surely there only if they
    leave far less of the differences between levels than free values would. Maps follow all.

    Args:
        found: what the model lacks whatever the levels, which is no error between them, with the
            levers by which maps count; None for nothing.
    """
    position = poses.states.q_rad[:, joint]
    number = level_of(position, levels, turns=not model.arm.prismatic[joint])
    groups = [np.flatnonzero(number == k) for k in range(1, len(levels) - 1)]
    of_joint = [
        term for term in model.model.terms if of_position(term) and term.of == f"joint {joint + 1}"
    ]
    effects = [term for term in of_joint if not term.at_knots]
    over_mm2 = _held_out_mm2(rows.from_zero(model, effects, held=False), poses, groups, found)
    if found is not None:
        for term in of_joint:
            if term.at_knots:
                shift_rad = term.shift(poses.states, model.values_of(term))
                over_mm2 += LEVELS.of_both * (1e3 * found.lever_m[joint] * np.std(shift_rad)) ** 2
    if not effects:
        return ByLevels(np.inf, over_mm2)
    left_mm2, left_without_mm2 = (
        rows.from_zero(model, effects, held=held).fitted_mm2() for held in (False, True)
    )
    odds = LEVELS.odds
    if (free := _free(levels, effects)) > 0:
        # How large the errors of either are is not known: those of levels show it.
        at_levels = [np.flatnonzero(number == k) for k in range(len(levels))]
        of_levels, of_levels_without = (
            sum(_beyond_noise_mm2(rows, each, out) for out in at_levels)
            for each in (left_mm2, left_without_mm2)
        )
        ratio = of_levels_without / (len(levels) - 1) / (of_levels / free)
        odds *= max(ratio, 1.0) ** (0.5 * free)
    if odds < LEVELS.sure_odds:
        explained_mm2 = float(np.average(left_without_mm2 - left_mm2, weights=rows.trust))
        between = _between_share(model, effects, poses, number)
        over_mm2 = max(over_mm2, LEVELS.of_both * between * explained_mm2)
    return ByLevels(odds, over_mm2)


def _held_out_mm2(
    fitted: RowsAboutFit,
    poses: Observations,
    levels: Sequence[Index],
    found: Discrepancy | None,
) -> float:
    """Return the mean squared error of levels held out, beyond what the fit without each expects.

    Args:
        levels: the poses of each.
        found: what the model lacks whatever the levels; None for nothing.
    """
    held_out = [fitted.held_out_mm2(out) for out in levels]
    errors_mm2, expected_mm2 = (np.concatenate(each) for each in zip(*held_out, strict=True))
    out = np.concatenate(levels)
    if found is not None:
        expected_mm2 += found.error_at_mm(poses.states.q_rad[out]) ** 2
    error_mm2, usual_mm2 = (
        float(np.average(each, weights=fitted.trust[out])) for each in (errors_mm2, expected_mm2)
    )
    if is_chance(error_mm2 / usual_mm2, len(out)):
        return 0.0
    return max(error_mm2 - usual_mm2, 0.0)


def _between_share(
    model: Fitted, effects: Sequence[Effect], poses: Observations, level: Index
) -> float:
    """Return the variance of what effects do from level to level over that of all levels.

    It is half the mean square of successive differences: little for a trend, all of it for what
    does not go on. Of coordinates the largest counts. Poses (P,) are at levels by number.
    """
    shifts: dict[str, Array] = {}
    for effect in effects:
        moved = effect.shift(poses.states, model.values_of(effect))
        for coordinate, shift in zip(effect.coordinates, moved.T, strict=True):
            shifts[coordinate] = shifts.get(coordinate, 0.0) + shift
    shares: list[float] = []
    counts = np.bincount(level)
    for shift in shifts.values():
        at_levels = np.bincount(level, shift) / counts
        if (variance := float(np.var(at_levels, ddof=1))) > 0.0:
            shares.append(0.5 * float(np.mean(np.diff(at_levels) ** 2)) / variance)
    return min(max(shares, default=1.0), 1.0)


def _free(levels: Array, effects: Sequence[Effect]) -> int:
    """Return how many of the differences between levels (m,) effects leave, at a coordinate.

    Where they leave none they follow whatever values there are.
    """
    coordinates = {each for effect in effects for each in effect.coordinates}
    parameters = sum(len(effect.parameters) for effect in effects)
    return len(levels) - 1 - math.ceil(parameters / len(coordinates))


def _beyond_noise_mm2(rows: RowsAboutFit, square_mm2: Array, out: Index) -> float:
    """Return the mean of squared errors (P,) at some poses, beyond noise.

    It is at least what noise leaves of the mean of these poses.
    """
    noise_mm2, trust = rows.components_factor * rows.noise_mm2[out].sum(axis=1), rows.trust[out]
    error, noise = (float(np.average(each, weights=trust)) for each in (square_mm2[out], noise_mm2))
    return max(error - noise, noise / len(out))


def with_levels(
    found: Discrepancy, model: Fitted, rows: RowsAboutFit, poses: Observations
) -> Discrepancy:
    """Return the discrepancy with the error between the levels of joints that stood at few only."""
    levels = levels_of_joints(poses, model)
    between_mm2 = np.zeros(len(levels))
    for joint, stood_at in enumerate(levels):
        if len(stood_at):
            told = by_levels(model, rows, poses, joint, stood_at, found)
            between_mm2[joint] = told.between_mm2
    if not between_mm2.any():
        return found
    return replace(found, levels=levels, between_mm=np.sqrt(between_mm2))


def levels_of_joints(poses: Observations, model: Fitted) -> tuple[Array, ...]:
    """Return the levels of each joint in averaged poses; (0,) of one that stood at many places."""
    q = poses.states.q_rad[np.unique(poses.pose, return_index=True)[1]]
    turns = (~model.arm.prismatic).tolist()
    return tuple(levels_of(of_joint, turns=t) for of_joint, t in zip(q.T, turns, strict=True))
