"""What a robot carries on its flange: the tooling-ball apparatus of the paper, or reflectors."""

from __future__ import annotations

import numpy as np

from pa10cal.cell.robot import Payload, Targets

#: Three balls in front of four 0.31 m rods, 2.4 kg (Section II.B of the paper); points in the
#: flange frame.
APPARATUS_MASS_KG = 2.4
APPARATUS_COM_M = np.array([0.0, 0.0, 0.190])
LOAD_POINT_M = np.array([0.0, 0.0, 0.030])
BALL_NAMES = ("A", "B", "C")
BALLS_DESIGN_M = 1e-3 * np.array([[95.0, 0.0, 310.0], [-50.0, 80.0, 310.0], [-50.0, -80.0, 312.0]])
BALL_DIAMETER_M = 0.0254
_BALL_MAKING_M = 5e-5

#: Reflectors as designed: on a ring around the flange's axis, every other one further out.
RING_RADIUS_M = 0.100
RING_HEIGHTS_M = (0.100, 0.140)
TOOL_COM_M = np.array([0.0, 0.0, 0.060])


def apparatus_payload() -> Payload:
    """Return the weight of the tooling-ball apparatus."""
    return Payload(APPARATUS_MASS_KG, APPARATUS_COM_M, LOAD_POINT_M)


def make_balls(measured_to_mm: float, rng: np.random.Generator) -> Targets:
    """Make the balls of one apparatus, and measure them.

    Args:
        measured_to_mm: standard deviation of the separate measurement, each coordinate.
        rng: draws how the balls came out, then the error of their measurement.
    """
    balls_m = BALLS_DESIGN_M + rng.normal(0.0, _BALL_MAKING_M, BALLS_DESIGN_M.shape)
    error_m = 1e-3 * measured_to_mm * rng.standard_normal(balls_m.shape)
    return Targets(BALL_NAMES, balls_m, balls_m + error_m)


def tool_payload(mass_kg: float) -> Payload:
    """Return the weight of a tool with reflectors."""
    return Payload(mass_kg, TOOL_COM_M, LOAD_POINT_M)


def ring_of_targets(count: int) -> Targets:
    """Return `count` reflectors that are where the campaign says."""
    turn = 2.0 * np.pi * np.arange(count) / count
    points_m = np.column_stack(
        [
            RING_RADIUS_M * np.cos(turn),
            RING_RADIUS_M * np.sin(turn),
            np.resize(RING_HEIGHTS_M, count),
        ]
    ).round(6)
    return Targets(tuple(f"T{number}" for number in range(1, count + 1)), points_m, points_m)
