"""Errors that touches share: a wrong radius of probe or balls, and balls that were knocked.

Neither is a stray touch, so that a test of single touches gives a wrong reason for them, or none.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from pa10cal.arrays import MEDIAN_TO_SIGMA, Array, Mask
from pa10cal.frame.knocked_targets import Knock, knocks_on_body
from pa10cal.frame.point_fits import Spheres, normals_and_residuals
from pa10cal.observe.quantities import MM

#: A radius is off from so many standard errors of its mean, and by this part of a touch's standard
#: uncertainty.
RADIUS_ERRORS, RADIUS_PART = 6.0, 0.3
#: Standard error of a median over that of a mean.
MEDIAN_ERROR = 1.2533
#: A ball with less information on its radius than this, of 1 for each touch, says nothing of it.
LEAST_INFORMATION = 0.1


def radius_off_mm(
    spheres: Spheres, p_mm: Array, touched: Mask, radius_mm: float, sigma_mm: float
) -> tuple[float, float]:
    """Return how much larger the touched spheres are than stated, and its standard error.

    It is the median over G balls of the radius that T touches show beside the centre. Zero where it
    is not significant, or small against the uncertainty of one touch.

    Args:
        spheres: the balls, fitted with the stated radius.
        p_mm: (G, T, 3) their touches, padded.
        touched: (G, T) which of them are no padding.
        radius_mm: the stated radius.
        sigma_mm: standard uncertainty of one touch.
    """
    weight = touched.astype(float)
    normals, residual_mm = normals_and_residuals(p_mm, weight, spheres.centre_mm, radius_mm)
    summed = normals.sum(axis=1)
    # A centre takes up a part of a wrong radius: what is left of it is the information.
    information = weight.sum(axis=1) - np.einsum("gi,gij,gj->g", summed, spheres.cofactor, summed)
    shows = ~spheres.coplanar & (information > LEAST_INFORMATION)
    if shows.sum() < 2:
        return 0.0, 0.0
    off_mm = residual_mm.sum(axis=1)[shows] / information[shows]
    mean_mm = float(np.median(off_mm))
    scatter_mm = MEDIAN_TO_SIGMA * float(np.median(np.abs(off_mm - mean_mm)))
    u_mm = MEDIAN_ERROR * scatter_mm / float(np.sqrt(len(off_mm)))
    if abs(mean_mm) < max(RADIUS_ERRORS * u_mm, RADIUS_PART * sigma_mm):
        return 0.0, 0.0
    return mean_mm, u_mm


def radius_remark(off_mm: float, u_mm: float, radius_mm: float) -> str:
    """Return what is said of a wrong radius that was taken out."""
    side, small = ("outside", "small") if off_mm > 0.0 else ("inside", "large")
    return (
        f"the touches lie {abs(off_mm):.4f} ± {u_mm:.4f} mm {side} the spheres of "
        f"{2.0 * radius_mm:g} mm in the mean: ball_diameter_mm is {abs(2.0 * off_mm):.3f} mm too "
        f"{small}, or the compensation of the probe's radius {abs(off_mm):.3f} mm; spheres "
        f"of {2.0 * (radius_mm + off_mm):.3f} mm are fitted; correct ball_diameter_mm, or "
        "qualify the probe anew"
    )


def knocked_balls(p_instr_mm: Array, uncertainty_mm: float) -> tuple[Knock, ...]:
    """Return the knocks that distances between centres (C, B, 3), in order of time, show."""
    p_m = MM * p_instr_mm
    return knocks_on_body(p_m, np.full(p_m.shape, MM * uncertainty_mm))


def knock_remarks(
    knocks: Sequence[Knock], names: Sequence[str], visits: Sequence[str]
) -> Iterator[str]:
    """Yield what is said of knocked balls; `visits` (C,) are the configurations in words."""
    for knock in knocks:
        ball = " or ".join(names[k] for k in knock.targets)
        yield (
            f"ball {ball} moved by {1e3 * knock.shift_m:.3f} mm on the tool between "
            f"{visits[knock.row - 1]} and {visits[knock.row]}, and stayed there: its distances "
            "from the other balls changed; it was knocked. Poses are wrong by a part of that: "
            "calibrate the configurations before and after as two campaigns, with the place of the "
            "ball measured anew (tool.balls_mm)"
        )
