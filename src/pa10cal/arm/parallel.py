"""Neighbouring joint axes that are all but parallel, where Hayati's beta has to replace d.

Between such axes the common normal is nowhere in particular: plain Denavit-Hartenberg rows answer
a small tilt of the one axis with an offset d of any length. Ry(beta) in its place keeps every
departure small (paper, Section II.C). The effect of d is not lost: along parallel axes the
offsets of both joints, revolute or prismatic, move the end in the same way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arm.description import Arm

#: Axes closer than this to parallel count as such.
NEARLY_PARALLEL_RAD = float(np.radians(5.0))


@dataclass(frozen=True)
class NeighbouringAxes:
    """The axes of two joints that follow each other."""

    joints: tuple[int, int]  # the two joints, from 1
    row: int  # the row, from 1, whose alpha and beta lead from one axis to the other
    angle_rad: float  # angle between the axes as lines, 0 to pi/2

    @property
    def parallel(self) -> bool:
        """Whether the axes are parallel or nearly so."""
        return self.angle_rad < NEARLY_PARALLEL_RAD


def neighbouring_axes(arm: Arm) -> tuple[NeighbouringAxes, ...]:
    """Return the angles between the axes of joints 1 and 2, 2 and 3, …, in that order.

    Rows in the modified form turn before their joint does, rows in the standard form after it.
    """
    after = 1 if arm.convention == "modified" else 0
    found = []
    for joint in range(1, arm.n):
        row = joint + after
        alpha_rad, beta_rad = arm.alpha_rad[row - 1], arm.beta_rad[row - 1]
        across = np.hypot(np.sin(beta_rad), np.sin(alpha_rad) * np.cos(beta_rad))
        along = np.abs(np.cos(alpha_rad) * np.cos(beta_rad))
        found.append(NeighbouringAxes((joint, joint + 1), row, float(np.arctan2(across, along))))
    return tuple(found)


def with_hayati_rows(arm: Arm) -> Arm:
    """Return the arm with Hayati's beta in place of d in every row between near-parallel axes."""
    hayati = np.zeros(arm.n, dtype=bool)
    for axes in neighbouring_axes(arm):
        hayati[axes.row - 1] = axes.parallel
    return replace(arm, hayati=hayati)
