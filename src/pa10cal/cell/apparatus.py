"""The tooling-ball apparatus: as it was designed, and one as it was made."""

from __future__ import annotations

import numpy as np

from pa10cal.cell.built import Apparatus

#: Three balls in front of four 0.31 m rods, 2.4 kg (Section II.B of the paper); places in the
#: flange frame.
APPARATUS_MASS_KG = 2.4
APPARATUS_COM_M = np.array([0.0, 0.0, 0.190])
LOAD_POINT_M = np.array([0.0, 0.0, 0.030])
BALL_NAMES = ("A", "B", "C")
BALLS_DESIGN_M = 1e-3 * np.array([[95.0, 0.0, 310.0], [-50.0, 80.0, 310.0], [-50.0, -80.0, 312.0]])
BALL_DIAMETER_M = 0.0254
_BALL_MAKING_M = 5e-5


def make_apparatus(measured_to_mm: float, rng: np.random.Generator) -> Apparatus:
    """Make one apparatus, and measure it.

    Args:
        measured_to_mm: standard deviation of the separate measurement, each coordinate.
        rng: draws how the balls came out, then the error of their measurement.
    """
    balls_m = BALLS_DESIGN_M + rng.normal(0.0, _BALL_MAKING_M, BALLS_DESIGN_M.shape)
    error_m = 1e-3 * measured_to_mm * rng.standard_normal(balls_m.shape)
    return Apparatus(
        mass_kg=APPARATUS_MASS_KG,
        com_m=APPARATUS_COM_M,
        load_point_m=LOAD_POINT_M,
        ball_names=BALL_NAMES,
        balls_m=balls_m,
        balls_measured_m=balls_m + error_m,
        ball_diameter_m=BALL_DIAMETER_M,
    )
