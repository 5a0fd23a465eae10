"""How well the weights of an arm are known, and weights for one of which none are stated.

An arm described without masses still sags under its weight. It gets masses and centres assumed
from its lengths alone, with uncertainties as wide as they are unknown, so that all that needs
torques and moments works for it. What its poses then show is stiffness over weight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from pa10cal.arrays import Array

if TYPE_CHECKING:
    from pa10cal.arm.description import Arm

WeightsFrom = Literal["stated", "total", "assumed", "logged"]

#: Mass of an arm of 1 m [kg]; arms weigh as the cube of their length (a UR10 of 1.7 m 29 kg, an
#: MA2010 of 2.8 m 260 kg, a KR 1000 titan of 5.1 m 4690 kg by their makers' data sheets).
_KG_AT_1_M = 15.0
_POWER = 3.0
#: Drives and flanges weigh as if every link were longer by this part of the arm.
DRIVES = 0.1
#: Standard uncertainty of an assumed mass, relative: of a part of a known total, and of all else.
_MASS, _MASS_OF_TOTAL = 1.0, 0.5
#: Of an assumed centre of mass along each axis, of the link's length and its drives.
CENTRE = 0.3
#: Standard uncertainty of a stated mass, relative, and of its centre, per axis [m].
STATED_MASS = 0.06
STATED_COM_M = 0.01


@dataclass(frozen=True)
class WeightsKnown:
    """How well the weights of the links are known."""

    # `stated` in the description; `total`: the mass of the whole arm alone is; `assumed` from the
    # lengths of the links; `logged`: stated ones that logged torques contradict
    origin: WeightsFrom
    mass: Array  # (n,) standard uncertainty of each mass, relative
    com_m: Array  # (n,) standard uncertainty of each centre of mass, per axis
    why: str = ""  # why they are not taken as stated, one clause; empty where they are

    @property
    def assumed(self) -> bool:
        """Return whether stiffness is known relative to weights that nobody stated."""
        return self.origin in ("assumed", "total")


def weights_known(arm: Arm) -> WeightsKnown:
    """Return how well the weights of an arm are known, of one that states them as makers do."""
    if arm.weights_known is not None:
        return arm.weights_known
    return WeightsKnown("stated", np.full(arm.n, STATED_MASS), np.full(arm.n, STATED_COM_M))


def with_assumed_weights(arm: Arm, total_kg: float | None = None) -> Arm:
    """Return an arm with weights: itself where it states them, else with assumed ones.

    Args:
        arm: the nominal arm.
        total_kg: mass of the whole arm, where that is known; None where it is not.
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
    """Return where links begin and end (n, 3) each, in the frames of their own rows [m].

    A link begins where its joint stands, and ends where the next one does, or at the end-effector.
    """
    from pa10cal.arm.chain import Chain, frames  # late: it imports the description

    chain = Chain.of(arm)
    found = frames(chain, chain.coordinates(np.zeros((1, arm.n))))
    places = np.concatenate([found.T_base_joints[:, 0, :3, 3], found.T_base_ee[:, :3, 3]])
    rows = found.T_base_rows[:, 0]

    def in_rows(p_base: Array) -> Array:
        in_row: Array = np.einsum("jba,jb->ja", rows[:, :3, :3], p_base - rows[:, :3, 3])
        return in_row

    return in_rows(places[:-1]), in_rows(places[1:])
