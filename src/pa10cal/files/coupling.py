"""Reads coupled joints from an arm's description or campaign.yaml, and states them there."""

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

#: Largest factor [deg or mm for each deg or mm of the other], and steepest screw [mm a turn].
_MOST_FACTOR, _STEEPEST_MM = 100.0, 1000.0
_TURN_DEG = 360.0


class StatedCoupling(Section):
    """A joint whose position is the one that the controller logs plus a multiple of another's.

    With `follows` the joint has no axis of its own, and only the multiple counts. With
    `counted_only` only the controller adds the multiple: the joint's own motor moves it alone.
    """

    joint: Annotated[int, Field(ge=1)]
    by: Annotated[int, Field(ge=1)]
    factor: FiniteFloat | None = None
    mm_per_turn: FiniteFloat | None = None
    follows: bool = False
    counted_only: bool = False


def coupled_joints(
    stated: Sequence[StatedCoupling], prismatic: Mask, where: str
) -> tuple[CoupledJoint, ...]:
    """Return the coupled joints of an arm.

    Args:
        stated: entries of the key `coupling`.
        prismatic: (n,) which joints slide.
        where: the file, for messages.

    Raises:
        ArmError: naming the entry, when it names no joint, couples what it cannot, or states no
            size.
    """
    coupled: list[CoupledJoint] = []
    followers = {entry.joint for entry in stated if entry.follows}
    for number, entry in enumerate(stated, start=1):
        place = f"{where}: coupling, entry {number}"
        _check(entry, followers, len(prismatic), place)
        if any((entry.joint, entry.by) == (other.joint, other.by) for other in coupled):
            raise ArmError(
                f"joint {entry.joint} is coupled to joint {entry.by} twice",
                where=place,
                value=[entry.joint, entry.by],
                allowed="each pair of joints once",
                remedy="add the two factors up",
            )
        slides, by_slides = _slide(prismatic, entry.joint, entry.by)
        factor = _factor(entry, slides, by_slides, place)
        follows = entry.joint in followers
        coupled.append(CoupledJoint(entry.joint, entry.by, factor, follows, entry.counted_only))
    if Coupling(len(prismatic), tuple(coupled)).singular:
        raise ArmError(
            "the coupling makes two joints one: some axes of the controller move nothing",
            where=f"{where}: coupling",
            value=", ".join(f"joint {c.joint} by {c.by}: {c.factor:g}" for c in coupled),
            allowed="axes that move the joints in as many ways as there are axes",
            remedy="remove one of these couplings, or set follows: true of a joint that has no "
            "axis of its own",
        )
    return tuple(coupled)


def _slide(prismatic: Mask, joint: int, by: int) -> tuple[bool, bool]:
    """Return whether each of two joints, counted from 1, slides."""
    return bool(prismatic[joint - 1]), bool(prismatic[by - 1])


def _check(entry: StatedCoupling, followers: set[int], joints: int, place: str) -> None:
    """Refuse an entry that does not name two joints, the second with an axis of its own."""
    for key, joint in (("joint", entry.joint), ("by", entry.by)):
        if joint > joints:
            raise ArmError(
                f"{key} names no joint",
                where=place,
                value=joint,
                allowed=f"1 to {joints}, one of the rows",
                remedy="correct the number",
            )
    if entry.joint == entry.by:
        raise ArmError(
            "a joint is coupled to itself",
            where=place,
            value=entry.joint,
            allowed="joint and by of two joints",
            remedy="name the other joint under by; the sign and zero of one are joint_signs and "
            "joint_offsets_deg of campaign.yaml",
        )
    if entry.counted_only and entry.joint in followers:
        raise ArmError(
            f"joint {entry.joint} has no motor of its own (follows: true), and none that moves it",
            where=f"{place}: counted_only",
            value=True,
            allowed="counted_only of a joint that has a motor",
            remedy="remove counted_only, or follows",
        )
    if entry.by in followers:
        raise ArmError(
            f"joint {entry.by} has no axis of its own (follows: true)",
            where=f"{place}: by",
            value=entry.by,
            allowed="a joint that has one",
            remedy=f"name the joint that joint {entry.by} follows",
        )


def _factor(entry: StatedCoupling, slides: bool, by_slides: bool, place: str) -> float:
    """Return the factor in radians and metres."""
    screw = slides and not by_slides
    stated = [key for key in ("factor", "mm_per_turn") if getattr(entry, key) is not None]
    turning = stated == ["mm_per_turn"]
    if len(stated) != 1 or (turning and not screw):
        what = "the size of the coupling is not stated once"
        if "mm_per_turn" in stated and not screw:
            what = "mm_per_turn is for a joint that slides with one that turns"
        raise ArmError(
            what,
            where=place,
            value=", ".join(stated) or None,
            allowed="factor or mm_per_turn, one of them" if screw else "factor",
            remedy="state how far the joint moves for each degree, or mm, of the other, as factor",
        )
    size: float = getattr(entry, stated[0])
    # In the file's units, degrees and millimetres.
    factor, limit = (size / _TURN_DEG, _STEEPEST_MM) if turning else (size, _MOST_FACTOR)
    if screw and not turning:
        limit = _STEEPEST_MM / _TURN_DEG  # of either key, since a screw is stated back by turns
    if factor == 0.0 or abs(size) > limit:
        raise ArmError(
            f"{stated[0]} is none that couples joints",
            where=place,
            value=size,
            allowed=f"not 0, and at most {limit:g} in size",
            remedy="correct the number, or remove the entry",
        )
    unit, by_unit = (
        1e-3 if one_slides else math.radians(1.0) for one_slides in (slides, by_slides)
    )
    return factor if unit == by_unit else factor * unit / by_unit


def stated_coupling(coupled: CoupledJoint, prismatic: Mask) -> dict[str, Any]:
    """Return the entry that states a coupled joint of an arm whose joints (n,) slide or turn."""
    slides, by_slides = _slide(prismatic, coupled.joint, coupled.by)
    entry: dict[str, Any] = {"joint": coupled.joint, "by": coupled.by}
    if slides and not by_slides:
        entry["mm_per_turn"] = _short(1e3 * 2.0 * math.pi * coupled.factor)
    elif by_slides and not slides:
        entry["factor"] = _short(1e-3 * math.degrees(coupled.factor))
    else:
        entry["factor"] = _short(coupled.factor)
    keys = ("follows", "counted_only")
    return entry | {key: True for key in keys if getattr(coupled, key)}


def _short(value: float) -> float | int:
    """Return a number without its last digit, which is rounding; as an integer if it is whole."""
    rounded = float(f"{value:.15g}")
    return int(rounded) if rounded.is_integer() else rounded


def set_coupling(coupled: Sequence[CoupledJoint], arm: Arm) -> str:
    """Return the remedy that states coupled joints of an arm.

    Joint positions alone do not tell whether bars couple two joints that turn or the controller
    only counts them together; their springs differ.
    """
    entries = []
    for joint in coupled:
        stated = stated_coupling(joint, arm.prismatic)
        pairs = (f"{key}: {_in_yaml(value)}" for key, value in stated.items())
        entries.append(f"{{{', '.join(pairs)}}}")
    either = dict.fromkeys(
        str(each.joint)
        for each in coupled
        if not (
            each.counted_only or each.follows or arm.prismatic[[each.joint - 1, each.by - 1]].any()
        )
    )
    counted = (
        f", with counted_only: true where the motor of joint {' or '.join(either)} is at the joint "
        "itself, as FANUC's"
    )
    return (
        f"set coupling: [{', '.join(entries)}] in campaign.yaml, or in the arm's description"
        f"{counted if either else ''}"
    )


def _in_yaml(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value:.6g}"


def coupling_in_words(arm: Arm) -> str:
    """Return coupled joints by what the controller counts (J), such as `joint 3 = J3 + J2`."""
    axis = {joint + 1: f"J{k}" for k, joint in enumerate(arm.coupling.own.tolist(), start=1)}
    sums: dict[int, list[str]] = {}
    for coupled in arm.coupled:
        stated = stated_coupling(coupled, arm.prismatic)
        if "factor" in stated:
            factor, unit = stated["factor"], ""
        else:
            factor, unit = stated["mm_per_turn"], " mm a turn of"
        size = "" if abs(factor) == 1 and not unit else f"{abs(factor):g}{unit} "
        terms = sums.setdefault(coupled.joint, [] if coupled.follows else [axis[coupled.joint]])
        sign = "-" if factor < 0 else "+" if terms else ""
        terms.append(f"{sign} {size}{axis[coupled.by]}".strip())
    return ", ".join(f"joint {joint} = {' '.join(terms)}" for joint, terms in sums.items())
