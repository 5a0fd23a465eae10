"""From the options of a curve to links laid along it, still or moving."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pa10cal.curve.angles import first_axes, joint_angles
from pa10cal.curve.curve import Curve
from pa10cal.curve.feasible import JointLimits
from pa10cal.curve.gait import Gait, follow, given_rolls, small_angles, travelling
from pa10cal.curve.options import CircleShape, CurveOptions, HelixShape, LineShape, Shape
from pa10cal.curve.points import equal_links, lay_points
from pa10cal.curve.polynomial import polyline, spline_through
from pa10cal.curve.roll import most_room, roll_for_last, room_at, smallest_angle
from pa10cal.curve.roll_map import RollMap
from pa10cal.curve.shapes import circle, helix, line, serpenoid

Through = Literal["spline", "closed_spline", "straight"]


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


def limits_of(settings: CurveOptions, joints: int) -> JointLimits | None:
    """Return the limits of every joint, None where there are none."""
    if settings.limits is None:
        return None
    a_rad, b_rad = np.radians([settings.limits.a_deg, settings.limits.b_deg])
    return JointLimits(np.tile(a_rad, (joints, 1)), np.tile(b_rad, (joints, 1)))


def curve_through(points_m: NDArray[np.float64], through: Through) -> Curve:
    """Return the curve through points (P, 3) [m]."""
    if through == "straight":
        return polyline(points_m)
    return spline_through(points_m, closed=through == "closed_spline")


def gait_of(curve: Curve, options: CurveOptions) -> Gait:
    """Return the chain of links along a curve, at time zero alone where it does not move."""
    return _still(curve, options) if options.gait is None else _moving(curve, options)


def _still(curve: Curve, options: CurveOptions) -> Gait:
    """Lay links along a curve: one shape, at time zero."""
    if options.link_m is not None:
        points = lay_points(curve, options.link_m, options.links)
    else:
        points = equal_links(curve, options.links or 1)
    chain = RollMap.of(points.directions, options.order)
    roll_rad = _roll(chain, options)
    axes_first = first_axes(points.directions, roll_rad)
    joints = joint_angles(points.directions, axes_first, options.order)
    return Gait(np.zeros(1), (curve,), (points,), (joints,), np.array([roll_rad]), np.zeros(0))


def _roll(chain: RollMap, options: CurveOptions) -> float:
    """Choose the roll of a shape [rad]."""
    limits = limits_of(options, chain.n - 1)
    if options.roll == "smallest_angle":
        return smallest_angle(chain, limits).roll_rad
    if options.roll == "most_room" and limits is not None:
        return most_room(chain, limits).roll_rad
    roll_rad = float(np.radians(options.roll_deg))
    if options.roll == "of_last":
        roll_rad = roll_for_last(chain, np.array(options.z_of_last)).roll_rad
    return roll_rad if limits is None else room_at(chain, roll_rad, limits).roll_rad


def _moving(curve: Curve, options: CurveOptions) -> Gait:
    """Follow a shape that moves."""
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
        choose = given_rolls(rolls_rad, limits)
    else:
        assert shape is not None
        curves = travelling(lambda phase: shape_of(shape, phase), time_s, moves.period_s)
        small = options.roll == "smallest_angle"
        given = given_rolls(rolls_rad, limits)
        choose = small_angles(np.radians(moves.move_deg), limits) if small else given
    return follow(curves, time_s, options.link_m, options.links, choose, options.order)
