"""Lines of gears: periodic errors of joints as often a turn as a gear ratio that nobody stated.

No map follows a hundred cycles a turn. They show in the periodogram of the residual of a search, at
the unevenly spaced angles of the poses (Scargle, Astrophysical Journal 263, 1982), and so do waves
along the stroke of a joint that slides. Lines join the candidates (`model_columns`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.sparse import csr_array

from pa10cal.arrays import Array
from pa10cal.discovery import jacobians
from pa10cal.discovery.jacobians import WhitenedPoses
from pa10cal.discovery.model_columns import ModelColumns
from pa10cal.discovery.rules import LINES, PROBABILITIES
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.gear_line import GearLine
from pa10cal.terms.effects.joint_error_map import is_error_map
from pa10cal.terms.effects.slide import DEGREES, SlideError
from pa10cal.terms.forms.catalogue import all_around


def gear_lines(
    rows: WhitenedPoses,
    error_rate: float,
    known: Collection[str] = (),
    *,
    in_maps: bool = False,
) -> tuple[GearLine, ...]:
    """Return the line of each joint that has one, in the residual of a model or in its maps.

    None for a joint of which two orders fit equally well, as where its angles are whole steps, nor
    at twice a stated gear ratio, which has an effect of its own.

    Args:
        rows: the poses about the model.
        error_rate: probability allowed of finding a line where there is none.
        known: places of lines that the model has.
        in_maps: whether maps are coarse: then a line may stand in the place of each, also one of
            fewer cycles. Fine ones follow those.
    """
    rows = rows.at_most(LINES.most_poses)
    poses, arm = rows.poses, rows.at.arm
    joints = [
        joint
        for joint in (arm.coupling.own[~arm.axes_slide] + 1).tolist()
        if f"joint {joint}" not in known and _angles(poses, joint) >= LINES.least_angles
    ]
    if not joints:
        return ()
    of_model = ModelColumns.of(rows)
    beside_maps = _lines(rows, joints, of_model, error_rate)
    # A map may follow a line, which is then in the residual without maps. What a map cannot follow
    # of a line looks like another line beside it.
    maps = [term for term in rows.at.model.terms if is_error_map(term)]
    mapped = [term.joint for term in maps if term.joint in joints]
    of_model, times = of_model.without_maps(rows), LINES.of_map_times
    instead: tuple[GearLine, ...] = ()
    if in_maps and mapped:
        instead = _lines(rows, mapped, of_model, error_rate, times, in_maps=True)
    taken = {line.of for line in instead}
    found = (*instead, *(line for line in beside_maps if line.of not in taken))
    if found or not maps:
        return found
    return _lines(rows, joints, of_model, error_rate, times)


def _angles(poses: Observations, joint: int) -> int:
    """Return the number of different angles of a joint, counted from 1."""
    return len(np.unique(np.round(poses.states.q_rad[:, joint - 1], LINES.angle_decimals)))


def _lines(
    rows: WhitenedPoses,
    joints: Sequence[int],
    of_model: ModelColumns,
    error_rate: float,
    times: float = 1.0,
    *,
    in_maps: bool = False,
) -> tuple[GearLine, ...]:
    """Return the lines of joints in a residual.

    Args:
        rows: the poses about the model.
        joints: where lines are sought.
        of_model: its columns, and the residual.
        error_rate: probability allowed of finding a line where there is none.
        times: how many times as much as any other the best order has to gain.
        in_maps: whether lines stand in place of maps, so that orders that maps follow count too.
    """
    by_joint = rows.whitener @ jacobians.by_joints(rows.at, rows.poses, joints)
    q_rad = rows.poses.states.q_rad
    spectra = [
        _Periodogram.of(of_model, by_joint[:, :, k], angles, _lowest_order(angles, in_maps=in_maps))
        for k, angles in enumerate(q_rad.T[np.array(joints) - 1])
    ]
    needed = float(np.log(sum(len(spectrum.orders) for spectrum in spectra) / error_rate))
    found = []
    for joint, spectrum in zip(joints, spectra, strict=True):
        order = spectrum.line(needed, times)
        stated = 2.0 * float(rows.at.arm.gear_ratio[joint - 1])
        if order is not None and not abs(order - stated) < spectrum.width:  # nan if not stated
            # A whole turn resolves a cycle a turn, half a turn two.
            width = round(max(spectrum.width, 1.0), LINES.order_decimals)
            k, multiples = spectrum.with_multiples(order, stated, error_rate)
            k = round(k, LINES.order_decimals)
            found.append(GearLine(f"joint {joint}", k, width, multiples))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _Periodogram:
    """Gain of log evidence by waves of one joint's angle."""

    q_rad: Array  # (P,) the joint's angles
    of_model: ModelColumns
    by_joint: tuple[
        Array, csr_array
    ]  # products of the model's columns with the joint's column, by pose
    squares: Array  # (P,) squares of the joint's column
    data_by_joint: Array  # (P,) products of the joint's column with the data
    lowest: float  # order from which on a line is sought [cycles a turn]
    highest: float  # and up to which

    @classmethod
    def of(
        cls,
        of_model: ModelColumns,
        by_joint: Array,
        q_rad: Array,
        lowest: float,
        highest: float = LINES.orders[1],
    ) -> _Periodogram:
        """Return that of a joint by its whitened column (P, b) and its angles (P,)."""
        return cls(
            q_rad=q_rad,
            of_model=of_model,
            by_joint=of_model.beside(by_joint),
            squares=np.sum(by_joint**2, axis=1),
            data_by_joint=np.sum(by_joint * of_model.data, axis=1),
            lowest=lowest,
            highest=highest,
        )

    @property
    def width(self) -> float:
        """Return the width of a line: one cycle over the range of the joint's angles."""
        return float(2.0 * np.pi / np.ptp(self.q_rad))

    @property
    def orders(self) -> Array:
        """Return the orders that are tried [cycles a turn]."""
        return np.arange(self.lowest, self.highest, LINES.step_widths * self.width)

    def line(self, needed: float, times: float = 1.0) -> float | None:
        """Return the order of the line that gains what is needed [nat]; None if none does.

        Nor if another order, further away, gains nearly as much, or a part of it as stated.
        """
        orders = self.orders
        firsts = range(0, len(orders), LINES.at_once)
        gains = np.concatenate([self.gains(orders[k : k + LINES.at_once]) for k in firsts])
        best = int(np.argmax(gains))
        if gains[best] < needed:
            return None
        apart = np.abs(orders - orders[best]) > LINES.widths_apart * self.width
        other = np.max(gains[apart], initial=-np.inf)
        if other > min(gains[best] - LINES.better_nats, gains[best] / times):
            return None
        step = LINES.step_widths * self.width
        finest = minimize_scalar(
            lambda order: -float(self.gains(np.array([order]))[0]),
            bounds=(orders[best] - step, orders[best] + step),
            method="bounded",
        )
        if self.lowest < LINES.orders[0] and finest.x < self.lowest:  # a smooth error is no line
            return None
        return float(finest.x)

    def with_multiples(
        self, order: float, stated: float, error_rate: float
    ) -> tuple[float, tuple[int, ...]]:
        """Return k of the line of an order, and the multiples of it that the residual shows too.

        What repeats k times a turn need not be a sine. The line may itself be the double of k, if
        the wave of k is smaller. Each of these orders is given by that of the line: a wave has to
        gain no more than the few that are tried demand, beside the waves before it.

        Args:
            order: of the line [cycles a turn].
            stated: order that has a name of its own; nan for none.
            error_rate: probability allowed of finding a multiple where there is none.
        """
        if order < LINES.orders[0]:  # in the place of a map, which follows such multiples
            return order, ()
        halved = 0.5 * order
        half = (0.5,) if halved >= LINES.orders[0] else ()
        tried = (*half, *range(2, LINES.most_multiple + 1))
        needed = float(np.log(len(tried) / error_rate))
        waves = [1.0]
        for each in tried:
            has_name = abs(each * order - stated) < self.width
            if not has_name and self._gain_beside(waves, each, order) > needed:
                waves.append(each)
        k = min(waves)
        further = sorted(round(wave / k) for wave in waves)
        return k * order, tuple(further[1:])

    def _gain_beside(self, waves: Sequence[float], another: float, order: float) -> float:
        """Return the gain by another multiple of an order, beside waves of some multiples."""
        one = np.array([order])
        return float((self.gains(one, [*waves, another]) - self.gains(one, waves))[0])

    def gains(self, orders: Array, multiples: Sequence[float] = (1.0,)) -> Array:
        """Return the gain of log evidence by a line of each of K orders, scatter profiled, (K,).

        Args:
            orders: (K,) cycles a turn.
            multiples: of each order, of which there are waves.
        """
        phase = self.q_rad[:, None, None] * orders[:, None] * multiples
        waves = LINES.size_rad * np.concatenate([np.sin(phase), np.cos(phase)], axis=-1)
        across = self.of_model.across(*self.by_joint, waves.reshape(len(phase), -1))
        across = across.reshape(-1, *waves.shape[1:])
        weighted = (waves * self.squares[:, None, None]).transpose(1, 2, 0)
        gram = weighted @ waves.transpose(1, 0, 2)
        projection = np.tensordot(self.data_by_joint, waves, axes=1)
        further = self.of_model.equations.of_each_further(across, gram, projection)
        return np.asarray(further.gains(self.of_model.seen)[0] / PROBABILITIES.blocks)


def _lowest_order(q_rad: Array, *, in_maps: bool) -> float:
    """Return the order from which on a line is sought at angles (P,) of a joint.

    What a map follows may be a line of a lower order, of a joint that was not seen all around: a
    line of a whole number is no better known there than others, and has no name of its own.
    """
    if not in_maps or all_around(q_rad):
        return LINES.orders[0]
    of_range = LINES.least_cycles * 2.0 * np.pi / float(np.ptp(q_rad))
    return min(max(LINES.lowest_in_map, of_range), LINES.orders[0])


# Waves along strokes: supports of a rail, teeth of a rack or turns of a screw err as often as they
# come along it. Polynomials of the stroke follow no such wave, and no effect has it as its form:
# where nothing predicts what is left, it is told where the waves are and how long.


class StrokeWave(NamedTuple):
    """A wave of what a model leaves, along the stroke of a joint that slides."""

    of: str  # the joint
    length_m: float


def stroke_waves(
    rows: WhitenedPoses, context: CandidateContext, error_rate: float
) -> tuple[StrokeWave, ...]:
    """Return the wave of each slide along whose stroke the residual of a model has one.

    It may be of any of the six small motions of the carriage; the one that shows it best counts.
    None where two lengths fit equally well, as where a joint stood at places in even steps.

    Args:
        rows: the poses about the model.
        context: what decides which joints slide.
        error_rate: probability allowed of finding a wave where there is none.
    """
    rows = rows.at_most(LINES.most_poses)
    slides = [
        slide
        for slide in SlideError.everywhere(context)
        if _angles(rows.poses, slide.joint) >= LINES.least_angles
    ]
    if not slides:
        return ()
    rows = replace(rows, at=rows.at.bending_as(slides))
    of_model, spectra = ModelColumns.of(rows), {}
    for slide in slides:
        q_m = rows.poses.states.q_rad[:, slide.joint - 1]
        # Polynomials follow at most half as many waves as their degree; as many waves come along
        # the stroke as along a turn, however long it is.
        range_m = float(np.ptp(q_m))
        lowest, highest = np.pi * DEGREES / range_m, 2.0 * np.pi * LINES.orders[1] / range_m
        moves = rows.whitener @ jacobians.by_coordinates(rows.at, rows.poses, slide.coordinates)
        spectra[slide.of] = [
            _Periodogram.of(of_model, move, q_m, lowest, highest)
            for move in np.moveaxis(moves, 2, 0)
        ]
    tried = sum(len(each.orders) for of_slide in spectra.values() for each in of_slide)
    needed = float(np.log(max(tried, 1) / error_rate))
    return tuple(
        StrokeWave(of, 2.0 * np.pi / order)
        for of, of_slide in spectra.items()
        if (order := _strongest_line(of_slide, needed)) is not None
    )


def _strongest_line(spectra: Sequence[_Periodogram], needed: float) -> float | None:
    """Return the order of the line that gains most in several spectra of one joint, if any does."""
    lines = [(each, order) for each in spectra if (order := each.line(needed)) is not None]
    gains = [float(each.gains(np.array([order]))[0]) for each, order in lines]
    return lines[int(np.argmax(gains))][1] if lines else None
