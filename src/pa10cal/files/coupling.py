"""Coupled joints as an arm's description and campaign.yaml state them, and back."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import Field, FiniteFloat

from pa10cal.arm.coupling import CoupledJoint, Coupling
from pa10cal.arm.description import Arm
from pa10cal.arrays import Mask
from pa10cal.errors import ArmError
from pa10cal.options import Section

#: No joint moves further with the axis of another [deg or mm, a deg or mm]; no screw is steeper.
_MOST, _STEEPEST_MM = 100.0, 1000.0
_TURN_DEG = 360.0


class StatedCoupling(Section):
    """A joint whose position in the model is more than the controller logs under its name."""

    joint: Annotated[int, Field(ge=1)]
    by: Annotated[int, Field(ge=1)]
    factor: FiniteFloat | None = None
    mm_per_turn: FiniteFloat | None = None
    follows: bool = False


def coupled_joints(
    stated: Sequence[StatedCoupling], prismatic: Mask, where: str
) -> tuple[CoupledJoint, ...]:
    """Return the coupled joints of an arm whose joints (n,) slide or turn.

    Raises:
        ArmError: naming the entry, when it names no joint, couples what it cannot, or states no
            size.
    """
    found: list[CoupledJoint] = []
    followers = {each.joint for each in stated if each.follows}
    for number, each in enumerate(stated, start=1):
        place = f"{where}: coupling, entry {number}"
        _check(each, followers, len(prismatic), place)
        if any((each.joint, each.by) == (other.joint, other.by) for other in found):
            raise ArmError(
                f"joint {each.joint} is coupled to joint {each.by} twice",
                where=place,
                value=[each.joint, each.by],
                allowed="each pair of joints once",
                remedy="add the two factors up",
            )
        slides, by_slides = (bool(prismatic[k - 1]) for k in (each.joint, each.by))
        factor = _factor(each, slides, by_slides, place)
        found.append(CoupledJoint(each.joint, each.by, factor, each.joint in followers))
    if Coupling(len(prismatic), tuple(found)).singular:
        raise ArmError(
            "the coupling makes two joints one: some axes of the controller move nothing",
            where=f"{where}: coupling",
            value=", ".join(f"joint {c.joint} by {c.by}: {c.factor:g}" for c in found),
            allowed="axes that move the joints in as many ways as there are axes",
            remedy="remove one of these couplings, or set follows: true of a joint that has no "
            "axis of its own",
        )
    return tuple(found)


def _check(each: StatedCoupling, followers: set[int], joints: int, place: str) -> None:
    """Refuse an entry that does not name two joints, the second with an axis of its own."""
    for key, joint in (("joint", each.joint), ("by", each.by)):
        if joint > joints:
            raise ArmError(
                f"{key} names no joint",
                where=place,
                value=joint,
                allowed=f"1 to {joints}, one of the rows",
                remedy="correct the number",
            )
    if each.joint == each.by:
        raise ArmError(
            "a joint is coupled to itself",
            where=place,
            value=each.joint,
            allowed="joint and by of two joints",
            remedy="name the other joint under by; the sign and zero of one are joint_signs and "
            "joint_offsets_deg of campaign.yaml",
        )
    if each.by in followers:
        raise ArmError(
            f"joint {each.by} has no axis of its own (follows: true)",
            where=f"{place}: by",
            value=each.by,
            allowed="a joint that has one",
            remedy=f"name the joint that joint {each.by} follows",
        )


def _factor(each: StatedCoupling, slides: bool, by_slides: bool, place: str) -> float:
    """Return the factor in radians and metres."""
    screw = slides and not by_slides
    keys = "factor or mm_per_turn, one of them" if screw else "factor"
    stated = [key for key in ("factor", "mm_per_turn") if getattr(each, key) is not None]
    if len(stated) != 1 or (stated == ["mm_per_turn"] and not screw):
        turning = "mm_per_turn is for a joint that slides with one that turns"
        no_screw = "mm_per_turn" in stated and not screw
        raise ArmError(
            turning if no_screw else "the size of the coupling is not stated once",
            where=place,
            value=", ".join(stated) or None,
            allowed=keys,
            remedy="state how far the joint moves for each degree, or mm, of the other, as factor",
        )
    value = each.factor if each.mm_per_turn is None else each.mm_per_turn / _TURN_DEG
    assert value is not None
    most = _MOST if each.mm_per_turn is None else _STEEPEST_MM / _TURN_DEG
    if value == 0.0 or abs(value) > most:
        limit = most if each.mm_per_turn is None else _STEEPEST_MM
        raise ArmError(
            f"{stated[0]} is none that couples joints",
            where=place,
            value=getattr(each, stated[0]),
            allowed=f"not 0, and at most {limit:g} in size",
            remedy="correct the number, or remove the entry",
        )
    unit, by_unit = (1e-3 if one else math.radians(1.0) for one in (slides, by_slides))
    return value if unit == by_unit else value * unit / by_unit


def stated_coupling(coupled: CoupledJoint, prismatic: Mask) -> dict[str, Any]:
    """Return the entry that states a coupled joint of an arm whose joints (n,) slide or turn."""
    slides, by_slides = (bool(prismatic[k - 1]) for k in (coupled.joint, coupled.by))
    entry: dict[str, Any] = {"joint": coupled.joint, "by": coupled.by}
    if slides and not by_slides:
        entry["mm_per_turn"] = _short(1e3 * 2.0 * math.pi * coupled.factor)
    elif by_slides and not slides:
        entry["factor"] = _short(1e-3 * math.degrees(coupled.factor))
    else:
        entry["factor"] = _short(coupled.factor)
    return entry | ({"follows": True} if coupled.follows else {})


def _short(value: float) -> float | int:
    """Return a number without the last digit, which is rounding, and whole ones as such."""
    shown = float(f"{value:.15g}")
    return int(shown) if shown.is_integer() else shown


def set_coupling(coupled: Sequence[CoupledJoint], arm: Arm) -> str:
    """Say what to set so that joints of an arm are coupled."""
    entries = [stated_coupling(each, arm.prismatic) for each in coupled]
    shown = ", ".join(
        f"{{{', '.join(f'{key}: {_in_yaml(value)}' for key, value in entry.items())}}}"
        for entry in entries
    )
    return f"set coupling: [{shown}] in campaign.yaml, or in the arm's description"


def _in_yaml(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value:.6g}"


def coupling_in_words(arm: Arm) -> str:
    """Say what joints are of what the controller counts, such as `joint 3 = J3 + J2`."""
    axis = {joint + 1: f"J{k}" for k, joint in enumerate(arm.coupling.own.tolist(), start=1)}
    of_joint: dict[int, list[str]] = {}
    for each in arm.coupled:
        entry = stated_coupling(each, arm.prismatic)
        factor, unit = entry.get("factor"), ""
        if factor is None:
            factor, unit = entry["mm_per_turn"], " mm a turn of"
        size = "" if abs(factor) == 1 and not unit else f"{abs(factor):g}{unit} "
        terms = of_joint.setdefault(each.joint, [] if each.follows else [axis[each.joint]])
        sign = "-" if factor < 0 else "+" if terms else ""
        terms.append(f"{sign} {size}{axis[each.by]}".strip())
    return ", ".join(f"joint {joint} = {' '.join(terms)}" for joint, terms in of_joint.items())
