"""Weights assumed from the lengths of an arm's links, where its description states none.

Masses that are implausible count as not stated.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pa10cal.arm.chain import Chain, frames
from pa10cal.arm.description import Arm, WeightsKnown
from pa10cal.arrays import Array
from pa10cal.results.record import plain_number
from pa10cal.rules import MASSES


def implausible_masses(arm: Arm, total_kg: float | None) -> str:
    """Return why stated masses are implausible; empty where they are plausible or not stated."""
    if arm.mass_kg is None:
        return ""
    if np.isin(arm.mass_kg, MASSES.placeholders_kg).all():
        return (
            "the masses of the links are all 0 or 1 kg, as a drawing program exports them where "
            "none were given: they are treated as not known"
        )
    if arm.com_m is not None:
        far_m = np.linalg.norm(arm.com_m, axis=1)
        link = int(far_m.argmax())
        if far_m[link] > arm.reach_m:
            return (
                f"the centre of mass of link {link + 1} is stated {far_m[link]:.4g} m from its "
                f"frame, and the arm reaches {arm.reach_m:.3g} m: masses and centres are treated "
                "as not known"
            )
    sum_kg = float(arm.mass_kg.sum())
    if total_kg is not None and abs(sum_kg - total_kg) > MASSES.total_off_share * max(
        sum_kg, total_kg
    ):
        return (
            f"masses.total_kg is {total_kg:g} kg, and the masses of the links add up to "
            f"{plain_number(sum_kg, 4)} kg: both are treated as not known"
        )
    return ""


def with_assumed_weights(arm: Arm, total_kg: float | None = None) -> Arm:
    """Return an arm with weights: itself where it states them, else with assumed ones.

    Assumed masses add up to the total, where it is known.
    """
    if arm.mass_kg is not None:
        return arm
    near_m, far_m = _ends(arm)
    length_m = np.linalg.norm(far_m - near_m, axis=1)
    size_m = length_m + MASSES.drives_share * arm.reach_m
    mass_kg = size_m / size_m.sum()
    mass_kg *= MASSES.kg_at_1_m * arm.reach_m**MASSES.length_power if total_kg is None else total_kg
    known = WeightsKnown(
        "assumed" if total_kg is None else "total",
        np.full(arm.n, MASSES.u_mass if total_kg is None else MASSES.u_mass_of_total),
        MASSES.centre_share * size_m,
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
