"""From the settings of a curve to its shape and the limits of its joints."""

from __future__ import annotations

import numpy as np

from pa10cal.curve.curve import Curve
from pa10cal.curve.feasible import JointLimits
from pa10cal.curve.options import CircleShape, CurveOptions, HelixShape, LineShape, Shape
from pa10cal.curve.shapes import circle, helix, line, serpenoid


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
