"""Weights assumed from the lengths of an arm's links, where its description states none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pa10cal.arm.chain import Chain, frames
from pa10cal.arm.description import Arm, WeightsKnown
from pa10cal.arrays import Array

#: Mass of an arm of 1 m [kg]; arms weigh as the cube of their length (a UR10 of 1.7 m 29 kg, an
#: MA2010 of 2.8 m 260 kg, a KR 1000 titan of 5.1 m 4690 kg by their makers' data sheets).
_KG_AT_1_M = 15.0
_POWER = 3.0
#: Drives and flanges weigh as if every link were longer by this part of the arm.
DRIVES = 0.1
#: Relative standard uncertainty of an assumed mass: without a known total, and with one.
_MASS, _MASS_OF_TOTAL = 1.0, 0.5
#: Standard uncertainty of an assumed centre of mass along each axis, relative to the length that a
#: link weighs by.
CENTRE = 0.3


def with_assumed_weights(arm: Arm, total_kg: float | None = None) -> Arm:
    """Return an arm with weights: itself where it states them, else with assumed ones.

    Assumed masses add up to the total, where it is known.
    """
    if arm.mass_kg is not None:
        return arm
    near_m, far_m = _ends(arm)
    length_m = np.linalg.norm(far_m - near_m, axis=1)
    size_m = length_m + DRIVES * arm.reach_m
    mass_kg = size_m / size_m.sum()
    mass_kg *= _KG_AT_1_M * arm.reach_m**_POWER if total_kg is None else total_kg
    known = WeightsKnown(
        "assumed" if total_kg is None else "total",
        np.full(arm.n, _MASS if total_kg is None else _MASS_OF_TOTAL),
        CENTRE * size_m,
    )
    return replace(arm, mass_kg=mass_kg, com_m=0.5 * (near_m + far_m), weights_known=known)


def _ends(arm: Arm) -> tuple[Array, Array]:
    """Return start and end of each link, (n, 3) both, in the frame of its own row [m].

    A link starts at its joint and ends at the next one; the last link ends at the end-effector.
    """
    chain = Chain.of(arm)
    at = frames(chain, chain.coordinates(np.zeros((1, arm.n))))
    places = np.concatenate([at.T_base_joints[:, 0, :3, 3], at.T_base_ee[:, :3, 3]])
    rows = at.T_base_rows[:, 0]

    def in_rows(p_base: Array) -> Array:
        in_row: Array = np.einsum("jba,jb->ja", rows[:, :3, :3], p_base - rows[:, :3, 3])
        return in_row

    return in_rows(places[:-1]), in_rows(places[1:])
