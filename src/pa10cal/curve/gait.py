"""Shapes that move: joint angles over time, each frame's roll chosen with regard to the last.

The frame of the first link is carried from one shape to the next, its z staying as near as it can
to where it was, and the roll is counted from there: it does not jump where a bend changes sides.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array
from pa10cal.curve.angles import JointAngles, Order, first_axes, joint_angles
from pa10cal.curve.curve import Curve
from pa10cal.curve.feasible import JointLimits
from pa10cal.curve.points import Points, lay_points
from pa10cal.curve.roll import room_at, smallest_angle, smallest_angle_near
from pa10cal.curve.roll_map import RollMap
from pa10cal.errors import CurveError


@dataclass(frozen=True)
class Gait:
    """T shapes of a chain of n links, one after the other."""

    time_s: Array  # (T,) when
    curves: tuple[Curve, ...]  # the curve of each shape
    points: tuple[Points, ...]  # points of each shape on its curve
    joints: tuple[JointAngles, ...]  # joint angles of each shape
    roll_rad: Array  # (T,) roll of the first link, from where the frame carried along with it is
    move_rad: Array  # (T - 1,) largest move of a joint from one shape to the next

    @property
    def a_rad(self) -> Array:
        """Turns about z of every shape, (T, n - 1)."""
        return np.stack([joints.a_rad for joints in self.joints])

    @property
    def b_rad(self) -> Array:
        """Turns about y of every shape, (T, n - 1)."""
        return np.stack([joints.b_rad for joints in self.joints])

    @property
    def p_m(self) -> Array:
        """Points of every shape, (T, n + 1, 3) [m]."""
        return np.stack([points.p_m for points in self.points])


#: Chooses the roll of a shape: its number, its links, and the joints of the shape before.
RollChoice = Callable[[int, RollMap, JointAngles | None], float]


def given_rolls(rolls_rad: Array, limits: JointLimits | None = None) -> RollChoice:
    """Return the choice of rolls given for every shape, (T,).

    Args:
        rolls_rad: (T,) the rolls.
        limits: of the joints; `follow` raises where they are not kept.
    """

    def choose(shape: int, chain: RollMap, _last: JointAngles | None) -> float:
        if limits is not None:
            room_at(chain, rolls_rad[shape], limits)
        return float(rolls_rad[shape])

    return choose


def small_angles(move_rad: float = 0.0, limits: JointLimits | None = None) -> RollChoice:
    """Return the choice of small joint angles, reached by small moves.

    The first shape has the smallest largest angle. Each one after has the smallest of those to
    which no joint moves farther than allowed, or, where there is none, moves least.

    Args:
        move_rad: how far a joint may move from one shape to the next for the sake of smaller
            angles; 0 for the smallest moves.
        limits: of the joints; `follow` raises where no roll keeps them.
    """

    def choose(_shape: int, chain: RollMap, last: JointAngles | None) -> float:
        if last is None:
            return smallest_angle(chain, limits).roll_rad
        return smallest_angle_near(chain, last.a_rad, last.b_rad, move_rad, limits).roll_rad

    return choose


def follow(
    curves: Sequence[Curve],
    time_s: Array,
    link_m: float,
    links: int,
    choose: RollChoice,
    order: Order = "zy",
) -> Gait:
    """Follow a curve that changes in time.

    Args:
        curves: the curve at each time.
        time_s: (T,) times.
        link_m: length of a link.
        links: how many.
        choose: the roll of every shape.
        order: which turn of a joint comes first.

    Raises:
        CurveError: when the links do not fit on the curve at some time, or no roll keeps the
            limits.
    """
    shapes: list[Points] = []
    joints: list[JointAngles] = []
    rolls: list[float] = []
    z_carried: Array | None = None
    for curve, time in zip(curves, time_s, strict=True):
        try:
            points = _fitting(curve, link_m, links)
            chain = RollMap.of(points.directions, order, z_carried)
            rolls.append(choose(len(shapes), chain, joints[-1] if joints else None))
        except CurveError as error:
            raise CurveError(
                error.what,
                where=f"time {time:g} s, {error.where}",
                value=error.value,
                allowed=error.allowed,
                remedy=error.remedy,
            ) from None
        z_carried = chain.axes_at_zero[:, 2]
        axes_first = first_axes(points.directions, rolls[-1], z_carried)
        joints.append(joint_angles(points.directions, axes_first, order))
        shapes.append(points)
    turns = np.stack([np.concatenate([each.a_rad, each.b_rad]) for each in joints])
    return Gait(
        time_s=time_s,
        curves=tuple(curves),
        points=tuple(shapes),
        joints=tuple(joints),
        roll_rad=np.unwrap(rolls),
        move_rad=np.abs(np.diff(turns, axis=0)).max(axis=1, initial=0.0),
    )


def travelling(shape: Callable[[float], Curve], time_s: Array, period_s: float) -> list[Curve]:
    """Return a shape at each time, its phase one turn farther every period.

    Args:
        shape: the curve at a phase [rad], such as a serpenoid.
        time_s: (T,) times.
        period_s: time of a wave; negative for one that travels the other way.
    """
    return [shape(phase) for phase in 2.0 * np.pi * time_s / period_s]


def _fitting(curve: Curve, link_m: float, links: int) -> Points:
    """Lay so many links along a curve."""
    points = lay_points(curve, link_m, links)
    if points.n < links:
        raise CurveError(
            "the links do not fit on the curve",
            where="links",
            value=links,
            allowed=f"{points.n} at most: {points.ending.value}",
            remedy="take fewer or shorter links, or a longer curve",
        )
    return points
