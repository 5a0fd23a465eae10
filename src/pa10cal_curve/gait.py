"""Links laid along a curve, still or moving, as the options say; what is reported of them.

Of a shape that moves each frame's roll is chosen with regard to the last.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.errors import CurveError
from pa10cal_curve import roll
from pa10cal_curve.angles import (
    JointAngles,
    arm_on_first_link,
    chain_points,
    first_axes,
    joint_angles,
)
from pa10cal_curve.curve import Curve, circle, helix, line, serpenoid
from pa10cal_curve.options import (
    CircleShape,
    CurveOptions,
    HelixShape,
    LimitOptions,
    LineShape,
    Shape,
)
from pa10cal_curve.points import (
    CurvePoints,
    equal_links,
    farthest_m,
    lay_points,
    parameters_at,
)
from pa10cal_curve.records import CurveRecord, CurveShape

#: Places of the curve that are written for drawing, and of each of several.
_PLACES, _PLACES_OF_MANY = 1000, 150


@dataclass(frozen=True)
class Gait:
    """T shapes of a chain of n links, one after the other."""

    time_s: Array  # (T,) when
    curves: tuple[Curve, ...]  # the curve of each shape
    points: tuple[CurvePoints, ...]  # points of each shape on its curve
    joints: tuple[JointAngles, ...]  # joint angles of each shape
    roll_rad: Array  # (T,) roll of the first link, from where the frame carried along with it is

    @property
    def turns_rad(self) -> Array:
        """Turns about z and about y of every shape, (T, 2, n - 1)."""
        return np.stack([joints.turns_rad for joints in self.joints])

    @property
    def move_rad(self) -> Array:
        """Largest move of a joint from one shape to the next, (T - 1,)."""
        return np.asarray(np.abs(np.diff(self.turns_rad, axis=0)).max(axis=(1, 2), initial=0.0))


def follow(
    curves: Sequence[Curve],
    time_s: Array,
    options: CurveOptions,
    starts: Sequence[float | None] | None = None,
) -> Gait:
    """Lay links along a curve that changes in time, or along one curve at one time.

    The first shape has the roll that the options choose. Of a shape that moves by itself each one
    after has the smallest largest angle of the rolls to which no joint moves farther than allowed,
    or, where there is none, moves least.

    Args:
        starts: parameter of each curve at which the first link begins; None for its beginning.

    Raises:
        CurveError: when the links do not fit on the curve at some time, or no roll keeps the
            limits.
    """
    moves = len(curves) > 1
    shapes: list[CurvePoints] = []
    joints: list[JointAngles] = []
    rolls: list[float] = []
    z_carried: Array | None = None
    starts = [None] * len(curves) if starts is None else starts
    for curve, time, start in zip(curves, time_s, starts, strict=True):
        try:
            points = _points_on(curve, options, start, all_links=moves)
            chain = roll.RollMap.of(points.directions, options.order, z_carried)
            rolls.append(_roll(chain, options, time, joints[-1].turns_rad if joints else None))
        except CurveError as error:
            if not moves:
                raise
            raise CurveError(
                error.what,
                where=f"time {time:g} s, {error.where}",
                value=error.value,
                allowed=error.allowed,
                remedy=error.remedy,
            ) from None
        z_carried = chain.axes_at_zero[:, 2]
        axes_first = first_axes(points.directions, rolls[-1], z_carried)
        joints.append(joint_angles(points.directions, axes_first, options.order))
        shapes.append(points)
    return Gait(time_s, tuple(curves), tuple(shapes), tuple(joints), np.unwrap(rolls))


def _points_on(
    curve: Curve, options: CurveOptions, start: float | None, *, all_links: bool
) -> CurvePoints:
    """Lay the links of the options along a curve, all of them or as many as fit.

    Raises:
        CurveError: when they do not fit.
    """
    if options.link_m is None:
        assert options.links is not None  # the options have one of the two
        return equal_links(curve, options.links)
    points = lay_points(curve, options.link_m, options.links, start)
    if not points.n and not all_links:
        rest_m = curve.at(np.linspace(points.t[0], curve.bounds.end, _PLACES)) - points.p_m[0]
        farthest_away_m = float(np.linalg.norm(rest_m, axis=1).max())
        raise CurveError(
            "the curve stays within a link's length of where the links begin",
            where="link_m",
            value=options.link_m,
            allowed=f"less than {farthest_away_m:.3g} m or so, as far as it gets",
            remedy="take shorter links",
        )
    if all_links and points.n != options.links:
        raise CurveError(
            "the links do not fit on the curve",
            where="links",
            value=options.links,
            allowed=f"{points.n} at most: {points.ending.value}",
            remedy="take fewer or shorter links, or a longer curve",
        )
    return points


def _roll(chain: roll.RollMap, options: CurveOptions, time_s: float, last: Array | None) -> float:
    """Return the roll of the first link in a shape at a time [rad].

    Args:
        chain: the shape.
        options: the criterion, limits and gait.
        time_s: since the start of the gait.
        last: (2, n - 1) angles of the shape before; None for the first shape.
    """
    limits, gait = limits_of(options, chain.n - 1), options.gait
    rolling = gait is not None and gait.moves == "roll"
    if options.roll == "smallest_angle" and not rolling:
        if last is None or gait is None:
            return roll.smallest_move(chain, limits=limits).roll_rad
        return roll.smallest_move(chain, last, limits, np.radians(gait.move_deg)).roll_rad
    if options.roll == "most_room" and limits is not None:
        return roll.most_room(chain, limits).roll_rad
    roll_rad = float(np.radians(options.roll_deg))
    if options.roll == "of_last":
        roll_rad = roll.roll_for_last(chain, np.array(options.z_of_last)).roll_rad
    if gait is not None and rolling and gait.period_s is not None:
        roll_rad += 2.0 * np.pi * time_s / gait.period_s
    if limits is not None:
        kept_rad = roll.room_at(chain, roll_rad, limits).roll_rad
        roll_rad = kept_rad if gait is None else roll_rad
    return roll_rad


def limits_of(options: CurveOptions, joints: int) -> Array | None:
    """Return the limits of every joint (2, 2, joints), None where there are none."""
    if options.limits is None:
        return None
    a_rad, b_rad = np.radians([options.limits.a_deg, options.limits.b_deg])
    return roll.joint_limits(a_rad, b_rad, joints)


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


# `curve.json` and the tables beside it: joint angles, points, links and the curve.

#: Columns of a table by name.
Columns = dict[str, NDArray[np.float64] | NDArray[np.int_]]


def laid(curve: Curve, options: CurveOptions) -> tuple[CurveRecord, dict[str, Columns]]:
    """Lay a chain of links along a curve, at time zero alone where it does not move.

    Returns:
        Statuses and largest angles, and the tables `angles`, `points`, `links` and `shape`; where
        the options name an arm, `joints` as well.

    Raises:
        CurveError: when the links do not fit on the curve, or no roll keeps the limits.
    """
    curves, time_s, moves = [curve], np.zeros(1), options.gait
    starts: list[float] | None = None
    if moves is not None:
        time_s = np.linspace(0.0, moves.seconds, moves.shapes)
        curves = [curve] * len(time_s)
        if moves.speed_m_s is not None:
            starts = parameters_at(curve, moves.speed_m_s * time_s).tolist()
        if moves.moves == "wave":
            assert options.curve is not None  # the options see to it
            assert moves.period_s is not None  # and to this
            phases_rad = 2.0 * np.pi * time_s / moves.period_s
            curves = [shape_of(options.curve, phase) for phase in phases_rad]
    gait = follow(curves, time_s, options, starts)
    points, free = gait.points[0], None
    limits = limits_of(options, points.n - 1)
    if limits is not None:
        chain = roll.RollMap.of(points.directions, options.order)
        free = tuple(map(tuple, np.degrees(roll.feasible_rolls(chain, limits)).tolist()))
    shapes = tuple(map(_shape, gait.time_s, gait.curves, gait.points, gait.joints, gait.roll_rad))
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
    tables = _tables(gait)
    if options.arm is not None:
        tables["joints"] = _positions(gait)
    return record, tables


def arm_of(options: CurveOptions, record: CurveRecord) -> Arm:
    """Return the arm, standing on the first link, that a chain was laid as.

    Raises:
        ArmError: when it has more joints, or longer links, than an arm may have.
    """
    assert options.arm is not None  # the arm is asked for
    limits = options.limits or LimitOptions()
    limits_rad = np.radians([limits.a_deg, limits.b_deg])
    return arm_on_first_link(options.arm, record.links, record.link_m, limits_rad, options.order)


def _positions(gait: Gait) -> Columns:
    """Return the joint positions of `arm_of`, a row a shape, as `pa10cal predict` reads them."""
    turns_deg = np.degrees(gait.turns_rad)
    in_order = turns_deg if gait.joints[0].order == "zy" else turns_deg[:, ::-1]
    columns = np.moveaxis(in_order, 2, 1).reshape(len(turns_deg), -1).T
    named = {f"q{joint}_deg": column for joint, column in enumerate(columns, start=1)}
    return {"id": np.arange(1, len(turns_deg) + 1), **named}


def _shape(
    time_s: float, curve: Curve, points: CurvePoints, joints: JointAngles, roll_rad: float
) -> CurveShape:
    chords_m = np.linalg.norm(np.diff(points.p_m, axis=0), axis=1)
    back_m = chain_points(
        joints.a_rad, joints.b_rad, joints.order, joints.axes[0], points.p_m[0], points.link_m
    )
    return CurveShape(
        time_s=float(time_s),
        ending=points.ending.name.lower(),
        ending_is=points.ending.value,
        left_m=points.left_m,
        gap_m=points.gap_m,
        deviation_m=farthest_m(curve, points),
        touches=tuple((np.flatnonzero(points.touches) + 1).tolist()),
        open_joints=tuple((np.flatnonzero(joints.open) + 1).tolist()),
        roll_deg=float(np.degrees(roll_rad)),
        largest_angle_deg=float(np.degrees(np.abs(joints.turns_rad).max(initial=0.0))),
        chord_error=float(np.abs(chords_m / points.link_m - 1.0).max()),
        forward_kinematics_error_m=float(np.linalg.norm(back_m - points.p_m, axis=1).max()),
    )


def _tables(gait: Gait) -> dict[str, Columns]:
    """Return one row a joint, a point (from the curve's beginning on) and a link of each shape.

    Of links the axes x, along it, and z of their frames; of the curve places, for drawing.
    """
    count = _PLACES if len(gait.curves) == 1 else _PLACES_OF_MANY
    t = [np.linspace(curve.bounds.start, curve.bounds.end, count) for curve in gait.curves]
    places_m = [curve.at(at) for curve, at in zip(gait.curves, t, strict=True)]
    axes = np.stack([joints.axes for joints in gait.joints])
    a_rad, b_rad = np.swapaxes(gait.turns_rad, 0, 1)
    links = axes.shape[1]

    def numbered(name: str, first: int, count: int) -> Columns:
        number = np.tile(np.arange(first, first + count), len(gait.time_s))
        return {"time_s": np.repeat(gait.time_s, count), name: number}

    def xyz(name: str, vectors: Sequence[Array] | Array) -> Columns:
        columns = np.reshape(vectors, (-1, 3)).T
        return {name.format(axis): column for axis, column in zip("xyz", columns, strict=True)}

    return {
        "angles": {
            **numbered("joint", 1, links - 1),
            "a_rad": a_rad.ravel(),
            "b_rad": b_rad.ravel(),
            "first_turn_open": np.concatenate([joints.open for joints in gait.joints]).astype(int),
        },
        "points": {
            **numbered("point", 0, links + 1),
            "t": np.concatenate([points.t for points in gait.points]),
            **xyz("{}_m", [points.p_m for points in gait.points]),
            "touches": np.concatenate([[0, *points.touches] for points in gait.points]).astype(int),
        },
        "links": {
            **numbered("link", 1, links),
            **xyz("x_{}", axes[..., 0]),
            **xyz("z_{}", axes[..., 2]),
        },
        "shape": {
            "time_s": np.repeat(gait.time_s, count),
            "t": np.concatenate(t),
            **xyz("{}_m", places_m),
        },
    }
