"""Which roll of the first link to take.

Every criterion (the smallest largest angle, the most room within limits, the smallest move from
the last shape), it is the tightest of a family of limits, one within the other, that some roll
still keeps. Whether one does is known exactly (`feasible`), so halving finds the best of all rolls,
not just one better than its neighbours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array
from pa10cal.curve.feasible import JointLimits, feasible_rolls, free_rolls
from pa10cal.curve.roll_map import RollMap
from pa10cal.errors import CurveError

#: Limits (2, n - 1) of a and of b at a level; wider at a higher one.
_Family = Callable[[float], tuple[Array, Array]]

#: Levels are found to so much [rad].
_LEVEL_RAD = 1e-12
#: Limits exceeded by less are kept, but for rounding [rad].
_KEPT_RAD = 1e-9
_WHOLE = 2.0 * np.pi
#: Room where nothing limits a joint, or there is none [rad].
_ALL_ROOM = 2.0 * _WHOLE


@dataclass(frozen=True)
class Roll:
    """A roll of the first link, the best in some sense."""

    roll_rad: float  # the roll, 0 to 2 pi
    # what it reaches: the largest angle, the room left within limits, or the largest move
    level_rad: float


def smallest_angle(chain: RollMap, limits: JointLimits | None = None) -> Roll:
    """Return the roll at which the largest of all joint angles is smallest.

    Args:
        chain: the links.
        limits: what the angles must keep besides.

    Raises:
        CurveError: when no roll keeps the limits, naming the joint and by how much.
    """
    zeros = np.zeros(chain.n - 1)
    return smallest_move(chain, zeros, zeros, limits)


def smallest_move(
    chain: RollMap, a_rad: Array, b_rad: Array, limits: JointLimits | None = None
) -> Roll:
    """Return the roll at which no joint moves far from where it stood.

    Args:
        chain: the links.
        a_rad: (n - 1,) turns about z of the last shape.
        b_rad: (n - 1,) turns about y of it.
        limits: what the angles must keep besides.

    Raises:
        CurveError: as `smallest_angle`.
    """
    kept = _kept(chain, limits)
    return _tightest(chain, lambda level: _both(kept, _around(a_rad, b_rad, level)))


def smallest_angle_near(
    chain: RollMap,
    a_rad: Array,
    b_rad: Array,
    move_rad: float,
    limits: JointLimits | None = None,
) -> Roll:
    """Return the roll with the smallest largest angle of those at which no joint moves too far.

    Where every roll moves some joint farther than `move_rad`, it is the one that moves least.

    Raises:
        CurveError: as `smallest_angle`.
    """
    near = _both(_kept(chain, limits), _around(a_rad, b_rad, move_rad))
    if not len(free_rolls(chain, *near)):
        return smallest_move(chain, a_rad, b_rad, limits)
    zeros = np.zeros(chain.n - 1)
    return _tightest(chain, lambda level: _both(near, _around(zeros, zeros, level)))


def most_room(chain: RollMap, limits: JointLimits) -> Roll:
    """Return the roll at which the joint nearest to a limit is farthest from it.

    Raises:
        CurveError: when no roll keeps the limits, naming the joint and by how much.
    """
    best = _widest(chain, limits)
    if best.level_rad < -_KEPT_RAD:
        raise _exceeded("no roll keeps", chain, limits, best)
    return best


def room_at(chain: RollMap, roll_rad: float, limits: JointLimits) -> Roll:
    """Return a roll with the room that it leaves within limits.

    Raises:
        CurveError: when it does not keep them, naming the joint and by how much.
    """
    a_rad, b_rad = chain.angles(np.array([roll_rad]))
    (a_least, a_most), (b_least, b_most) = limits.widened(chain.n - 1, 0.0)
    room = np.stack([a_rad - a_least, a_most - a_rad, b_rad - b_least, b_most - b_rad])
    found = Roll(roll_rad % (2.0 * np.pi), float(room.min(initial=_ALL_ROOM)))
    if found.level_rad < -_KEPT_RAD:
        raise _exceeded("this roll does not keep", chain, limits, found)
    return found


def roll_for_last(chain: RollMap, z_wanted: Array) -> Roll:
    """Return the roll at which z of the last link is nearest to a wanted direction.

    It is in the plane of the wanted direction and the link, exactly, at one roll and no other; its
    level is the remaining angle between the two. Along a bent chain that roll becomes sharp:
    most rolls end the same.

    Raises:
        CurveError: when the direction is none, or along the link.
    """
    x = np.cross(chain.across[-1, :, 0], chain.across[-1, :, 1])
    off = z_wanted - (z_wanted @ x) * x
    if not np.linalg.norm(off) > _KEPT_RAD * np.linalg.norm(z_wanted):
        raise CurveError(
            "the direction for z of the last link is parallel to the link",
            where="z_wanted",
            value=z_wanted.tolist(),
            allowed="a direction that is not parallel to the link",
            remedy="choose another one",
        )
    axis = np.cross(off, x) if chain.order == "zy" else off
    angle = np.arctan2(axis @ chain.across[-1, :, 1], axis @ chain.across[-1, :, 0])
    cos, sin = chain.roll_of(np.array([chain.n - 1]), np.array([angle]))[0]
    aside = np.arctan2(abs(z_wanted @ x), np.linalg.norm(off))
    return Roll(float(np.arctan2(sin, cos) % (2.0 * np.pi)), float(aside))


def _tightest(chain: RollMap, family: _Family, least: float = 0.0) -> Roll:
    """Return a roll within the tightest limits of a family that some roll keeps, and their level.

    Some roll must keep those at the level of a whole turn.
    """
    low, high = least, 2.0 * np.pi
    free = free_rolls(chain, *family(high))
    while high - low > _LEVEL_RAD:
        middle = (low + high) / 2.0
        found = free_rolls(chain, *family(middle))
        if len(found):
            free, high = found, middle
        else:
            low = middle
    begin, end = free[np.argmax(free[:, 1] - free[:, 0])]
    return Roll(float((begin + end) / 2.0 % (2.0 * np.pi)), high)


def _widest(chain: RollMap, limits: JointLimits) -> Roll:
    """Return the roll with the most room within limits; less than none where they are exceeded."""
    (a_least, a_most), (b_least, b_most) = limits.widened(chain.n - 1, 0.0)
    widths = np.concatenate([a_most - a_least, b_most - b_least])
    least = -float(widths.min(initial=2.0 * _ALL_ROOM)) / 2.0
    best = _tightest(chain, lambda level: limits.widened(chain.n - 1, level), least)
    return Roll(best.roll_rad, -best.level_rad)


def _kept(chain: RollMap, limits: JointLimits | None) -> tuple[Array, Array]:
    """Return limits that some roll keeps: those given, or none.

    Limits that are kept at single rolls only are widened by what rounding may exceed them by.

    Raises:
        CurveError: when no roll keeps them.
    """
    if limits is None:
        whole = np.tile([[-_WHOLE], [_WHOLE]], chain.n - 1)
        return whole, whole
    if len(feasible_rolls(chain, limits)):
        return limits.widened(chain.n - 1, 0.0)
    best = _widest(chain, limits)
    if best.level_rad < -_KEPT_RAD:
        raise _exceeded("no roll keeps", chain, limits, best)
    return limits.widened(chain.n - 1, _KEPT_RAD - best.level_rad)


def _exceeded(who: str, chain: RollMap, limits: JointLimits, roll: Roll) -> CurveError:
    """Describe which joint exceeds its limits most at a roll, and by how much."""
    a_rad, b_rad = (angles[0] for angles in chain.angles(np.array([roll.roll_rad])))
    over = {
        name: np.maximum(angle - limit[:, 1], limit[:, 0] - angle)
        for name, angle, limit in (("a", a_rad, limits.a_rad), ("b", b_rad, limits.b_rad))
    }
    name = max(over, key=lambda each: float(over[each].max()))
    joint = int(np.argmax(over[name]))
    limit = (limits.a_rad if name == "a" else limits.b_rad)[joint]
    return CurveError(
        f"{who} the joints within their limits: {name} is {np.degrees(-roll.level_rad):.3g} "
        "degrees beyond",
        where=f"joint {joint + 1}",
        value=f"{np.degrees((a_rad if name == 'a' else b_rad)[joint]):.4g} degrees",
        allowed=f"{np.degrees(limit[0]):g} to {np.degrees(limit[1]):g} degrees",
        remedy="widen the limits, take shorter links or a curve that bends less",
    )


def _around(a_rad: Array, b_rad: Array, level: float) -> tuple[Array, Array]:
    """Return limits (2, n - 1) at a distance from angles."""
    return np.stack([a_rad - level, a_rad + level]), np.stack([b_rad - level, b_rad + level])


def _both(first: tuple[Array, Array], second: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return the limits within two."""
    a, b = (
        np.stack([np.maximum(one[0], other[0]), np.minimum(one[1], other[1])])
        for one, other in zip(first, second, strict=True)
    )
    return a, b
