"""Shapes that move: joint angles over time, each frame's roll chosen with regard to the last."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.curve import roll
from pa10cal.curve.angles import JointAngles, Order, chain_points, first_axes, joint_angles
from pa10cal.curve.curve import Curve, circle, helix, line, polyline, serpenoid, spline_through
from pa10cal.curve.options import CircleShape, CurveOptions, HelixShape, LineShape, Shape
from pa10cal.curve.points import Points, equal_links, lay_points
from pa10cal.errors import CurveError
from pa10cal.results.studies import CurveRecord, CurveShape


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


def follow(
    curves: Sequence[Curve],
    time_s: Array,
    link_m: float,
    links: int,
    *,
    rolls_rad: Array | None = None,
    move_rad: float = 0.0,
    limits: roll.JointLimits | None = None,
    order: Order = "zy",
) -> Gait:
    """Follow a curve that changes in time.

    Without rolls given the first shape has the smallest largest angle. Each one after has the
    smallest of those to which no joint moves farther than allowed, or, where there is none, moves
    least.

    Args:
        rolls_rad: (T,) roll of every shape; None to choose it.
        move_rad: how far a joint may move from one shape to the next for the sake of smaller
            angles; 0 for the smallest moves.

    Raises:
        CurveError: when the links do not fit on the curve at some time, or no roll keeps the
            limits.
    """

    def chosen(chain: roll.RollMap, number: int) -> float:
        if rolls_rad is not None:
            if limits is not None:
                roll.room_at(chain, rolls_rad[number], limits)
            return float(rolls_rad[number])
        if not number:
            return roll.smallest_angle(chain, limits).roll_rad
        last = joints[-1]
        return roll.smallest_angle_near(chain, last.a_rad, last.b_rad, move_rad, limits).roll_rad

    shapes: list[Points] = []
    joints: list[JointAngles] = []
    rolls: list[float] = []
    z_carried: Array | None = None
    for curve, time in zip(curves, time_s, strict=True):
        try:
            points = _fitting(curve, link_m, links)
            chain = roll.RollMap.of(points.directions, order, z_carried)
            rolls.append(chosen(chain, len(shapes)))
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


def _fitting(curve: Curve, link_m: float, links: int) -> Points:
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


# From the options of a curve to links laid along it, still or moving.


def shape_of(shape: Shape, phase_rad: float = 0.0) -> Curve:
    """Return a shape, its phase (where it has one) ahead by so much."""
    if isinstance(shape, LineShape):
        return line(shape.length_m)
    if isinstance(shape, CircleShape):
        return circle(shape.radius_m, np.radians(shape.angle_deg))
    phase_rad += np.radians(shape.phase_deg)
    if isinstance(shape, HelixShape):
        return helix(shape.radius_m, shape.pitch_m, shape.turns, phase_rad)
    amplitude_rad = np.radians(shape.amplitude_deg)
    return serpenoid(shape.length_m, shape.waves, amplitude_rad, phase_rad)


def limits_of(settings: CurveOptions, joints: int) -> roll.JointLimits | None:
    """Return the limits of every joint, None where there are none."""
    if settings.limits is None:
        return None
    a_rad, b_rad = np.radians([settings.limits.a_deg, settings.limits.b_deg])
    return roll.JointLimits(np.tile(a_rad, (joints, 1)), np.tile(b_rad, (joints, 1)))


def curve_through(
    points_m: NDArray[np.float64], through: Literal["spline", "closed_spline", "straight"]
) -> Curve:
    """Return the curve through points (P, 3) [m]."""
    if through == "straight":
        return polyline(points_m)
    return spline_through(points_m, closed=through == "closed_spline")


def _still(curve: Curve, options: CurveOptions) -> Gait:
    """Lay links along a curve: one shape, at time zero."""
    if options.link_m is not None:
        points = lay_points(curve, options.link_m, options.links)
    else:
        points = equal_links(curve, options.links or 1)
    chain = roll.RollMap.of(points.directions, options.order)
    roll_rad = _roll(chain, options)
    axes_first = first_axes(points.directions, roll_rad)
    joints = joint_angles(points.directions, axes_first, options.order)
    return Gait(np.zeros(1), (curve,), (points,), (joints,), np.array([roll_rad]), np.zeros(0))


def _roll(chain: roll.RollMap, options: CurveOptions) -> float:
    limits = limits_of(options, chain.n - 1)
    if options.roll == "smallest_angle":
        return roll.smallest_angle(chain, limits).roll_rad
    if options.roll == "most_room" and limits is not None:
        return roll.most_room(chain, limits).roll_rad
    roll_rad = float(np.radians(options.roll_deg))
    if options.roll == "of_last":
        roll_rad = roll.roll_for_last(chain, np.array(options.z_of_last)).roll_rad
    return roll_rad if limits is None else roll.room_at(chain, roll_rad, limits).roll_rad


def _moving(curve: Curve, options: CurveOptions) -> Gait:
    moves, shape = options.gait, options.curve
    assert moves is not None  # with what else moving takes, the options see to it
    assert options.link_m is not None
    assert options.links is not None
    time_s = np.linspace(0.0, moves.seconds, moves.shapes)
    limits = limits_of(options, options.links - 1)
    rolls_rad = np.full(len(time_s), np.radians(options.roll_deg))
    curves = [curve] * len(time_s)
    if moves.moves == "roll":
        rolls_rad += 2.0 * np.pi * time_s / moves.period_s
    else:
        assert shape is not None
        curves = [shape_of(shape, phase) for phase in 2.0 * np.pi * time_s / moves.period_s]
    given = moves.moves == "roll" or options.roll == "given"
    return follow(
        curves,
        time_s,
        options.link_m,
        options.links,
        rolls_rad=rolls_rad if given else None,
        move_rad=float(np.radians(moves.move_deg)),
        limits=limits,
        order=options.order,
    )


# `curve.json` and the tables beside it: joint angles, points, links and the curve.

#: Columns of a table by name.
Columns = dict[str, NDArray[np.float64] | NDArray[np.int_]]

#: Places of the curve that are written for drawing, and of each of several.
_PLACES, _PLACES_OF_MANY = 1000, 150


def laid(curve: Curve, options: CurveOptions) -> tuple[CurveRecord, dict[str, Columns]]:
    """Lay a chain of links along a curve, at time zero alone where it does not move.

    Returns:
        Statuses and largest angles, and the tables `angles`, `points`, `links` and `shape`.

    Raises:
        CurveError: when the links do not fit on the curve, or no roll keeps the limits.
    """
    gait = _still(curve, options) if options.gait is None else _moving(curve, options)
    points, free = gait.points[0], None
    limits = limits_of(options, points.n - 1)
    if limits is not None:
        chain = roll.RollMap.of(points.directions, options.order)
        free = tuple(map(tuple, np.degrees(roll.feasible_rolls(chain, limits)).tolist()))
    shapes = tuple(map(_shape, gait.time_s, gait.points, gait.joints, gait.roll_rad))
    record = CurveRecord(
        link_m=points.link_m,
        links=points.n,
        order=options.order,
        largest_angle_deg=max(shape.largest_angle_deg for shape in shapes),
        largest_move_deg=float(np.degrees(gait.move_rad.max(initial=0.0))),
        feasible_rolls_deg=free,
        shapes=shapes,
        settings=options.model_dump(mode="json"),
    )
    return record, _tables(gait)


def _shape(time_s: float, points: Points, joints: JointAngles, roll_rad: float) -> CurveShape:
    chords_m = np.linalg.norm(np.diff(points.p_m, axis=0), axis=1)
    back_m = chain_points(
        joints.a_rad, joints.b_rad, joints.order, joints.axes[0], points.p_m[0], points.link_m
    )
    largest = np.abs([joints.a_rad, joints.b_rad]).max(initial=0.0)
    return CurveShape(
        time_s=float(time_s),
        ending=points.ending.name.lower(),
        ending_is=points.ending.value,
        left_m=points.left_m,
        gap_m=points.gap_m,
        touches=tuple((np.flatnonzero(points.touches) + 1).tolist()),
        open_joints=tuple((np.flatnonzero(joints.open) + 1).tolist()),
        roll_deg=float(np.degrees(roll_rad)),
        largest_angle_deg=float(np.degrees(largest)),
        chord_error=float(np.abs(chords_m / points.link_m - 1.0).max()),
        forward_kinematics_error_m=float(np.linalg.norm(back_m - points.p_m, axis=1).max()),
    )


def _tables(gait: Gait) -> dict[str, Columns]:
    """Return one row a joint, a point (from the curve's beginning on) and a link of each shape.

    Of links the axes x, along it, and z of their frames; of the curve places, for drawing.
    """
    count = _PLACES if len(gait.curves) == 1 else _PLACES_OF_MANY
    t = [np.linspace(curve.bounds.start, curve.bounds.end, count) for curve in gait.curves]
    places_m = [curve.at(each) for curve, each in zip(gait.curves, t, strict=True)]
    axes = np.stack([each.axes for each in gait.joints])
    joints, ends, links = gait.a_rad.shape[1], gait.p_m.shape[1], axes.shape[1]
    touches = [np.append(False, points.touches) for points in gait.points]

    def numbered(name: str, first: int, count: int) -> Columns:
        number = np.tile(np.arange(first, first + count), len(gait.time_s))
        return {"time_s": np.repeat(gait.time_s, count), name: number}

    def xyz(name: str, vectors: Array) -> Columns:
        return dict(
            zip((name.format(axis) for axis in "xyz"), vectors.reshape(-1, 3).T, strict=True)
        )

    return {
        "angles": {
            **numbered("joint", 1, joints),
            "a_rad": gait.a_rad.ravel(),
            "b_rad": gait.b_rad.ravel(),
            "first_turn_open": np.concatenate([each.open for each in gait.joints]).astype(int),
        },
        "points": {
            **numbered("point", 0, ends),
            "t": np.concatenate([points.t for points in gait.points]),
            **xyz("{}_m", gait.p_m),
            "touches": np.concatenate(touches).astype(int),
        },
        "links": {
            **numbered("link", 1, links),
            **xyz("x_{}", axes[..., 0]),
            **xyz("z_{}", axes[..., 2]),
        },
        "shape": {
            "time_s": np.repeat(gait.time_s, count),
            "t": np.concatenate(t),
            **xyz("{}_m", np.stack(places_m)),
        },
    }
