"""Which roll of the first link to take ("The free roll" of docs/curve.md).

By every criterion it is the tightest of a family of limits, one within the other, that some roll
still keeps. Whether one does is known exactly (`feasible_rolls`), so halving finds the best.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.errors import CurveError
from pa10cal_curve.angles import Order, first_axes

# Every frame of the chain as a function of the first link's roll, in closed form: the axis carried
# along the chain (`angles`) is along A_i w_1 with one product A_i of 2 x 2 matrices a link.


@dataclass(frozen=True)
class RollMap:
    """How joint angles depend on the roll of the first link; build it with `RollMap.of`."""

    order: Order  # which turn comes first
    axes_at_zero: Array  # (3, 3) frame of the first link at roll zero
    bend_rad: Array  # (n - 1,) angle between neighbouring links, 0 to pi
    # (n, 2, 2) from the carried axis at the first link to that at each, but for its length, in
    # planes square to the links
    maps: Array
    side: Array  # (n,) sign of the determinant of `maps`
    heading_rad: Array  # (n - 1,) where in the plane of the link before the next one bends to
    across: Array  # (n, 3, 2) axes of those planes; those of the first link are its y and z

    @classmethod
    def of(cls, directions: Array, order: Order = "zy", z_at_zero: Array | None = None) -> RollMap:
        """Compute the maps of a chain.

        Args:
            directions: (n, 3) unit vectors along the links.
            z_at_zero: (3,) what z of the first link is nearest to at roll zero; else the normal of
                the first bend.
        """
        axes_at_zero = first_axes(directions, 0.0, z_at_zero)
        across = _planes(directions)
        across[0] = axes_at_zero[:, 1:]
        cos = np.einsum("ki,ki->k", directions[:-1], directions[1:])
        into = np.einsum("kia,ki->ka", across[:-1], directions[1:])  # the bend, in each plane
        back = np.einsum("kia,ki->ka", across[1:], directions[:-1])
        steps = cos[:, None, None] * np.einsum("kia,kib->kab", across[1:], across[:-1])
        steps -= back[:, :, None] * into[:, None, :]
        return cls(
            order=order,
            axes_at_zero=axes_at_zero,
            bend_rad=np.arctan2(np.hypot(into[:, 0], into[:, 1]), cos),
            maps=_products(steps),
            side=np.append(1.0, np.cumprod(np.where(cos < 0.0, -1.0, 1.0))),
            heading_rad=np.arctan2(into[:, 1], into[:, 0]),
            across=across,
        )

    @property
    def n(self) -> int:
        """Number of links."""
        return len(self.maps)

    def angles(self, roll_rad: Array) -> tuple[Array, Array]:
        """Return a and b of every joint at R rolls of the first link, both (R, n - 1) [rad]."""
        cos, sin = np.cos(roll_rad), np.sin(roll_rad)
        first = np.stack([cos, sin] if self.order == "zy" else [-sin, cos], axis=1)
        axis = np.einsum("kab,rb->rka", self.maps[:-1], first)
        off = np.arctan2(axis[..., 1], axis[..., 0]) - self.heading_rad
        sin = np.sin(self.bend_rad)
        turned = np.arctan2(sin * np.cos(off), np.cos(self.bend_rad))
        lifted = np.arcsin((sin * np.sin(off)).clip(-1.0, 1.0))
        return (turned, lifted) if self.order == "zy" else (lifted, -turned)

    def roll_of(self, link: NDArray[np.intp], angle_rad: Array) -> Array:
        """Return the rolls at which the carried axis has given angles in the planes of links.

        Args:
            link: (k,) links, from 0.
            angle_rad: (k,) angles in their planes.

        Returns:
            (k, 2) unit vectors cos, sin of the roll.
        """
        m, sign = self.maps[link], self.side[link]
        cos, sin = np.cos(angle_rad), np.sin(angle_rad)
        # The inverse but for its length: adjugate times the sign of the determinant.
        first = m[:, 1, 1] * cos - m[:, 0, 1] * sin, m[:, 0, 0] * sin - m[:, 1, 0] * cos
        w = sign[:, None] * np.stack(first, axis=1)
        if self.order == "yz":  # the carried axis is z, a quarter turn ahead of y
            w = np.stack([w[:, 1], -w[:, 0]], axis=1)
        return np.asarray(w / np.maximum(np.linalg.norm(w, axis=1), 1e-300)[:, None])


def _planes(directions: Array) -> Array:
    """Return two axes (n, 3, 2) square to each direction and to each other, right-handed with it.

    Built as by Duff et al. (2017): smooth but at one direction, where the sign of z changes.
    """
    x, y, z = directions.T
    sign = np.where(z < 0.0, -1.0, 1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=1)
    second = np.stack([b, sign + y * y * a, -y], axis=1)
    return np.stack([first, second], axis=2)


def _products(steps: Array) -> Array:
    """Return the running products of 2 x 2 matrices from the left, scaled, after the identity.

    By doubling: in each pass every product takes in the one that ends where it begins.
    """
    products = np.concatenate([np.eye(2)[None], steps])
    reach = 1
    while reach < len(products):
        joined = products[reach:] @ products[:-reach]
        largest = np.abs(joined).max(axis=(1, 2), keepdims=True)
        products = np.concatenate([products[:reach], joined / np.maximum(largest, 1e-300)])
        reach *= 2
    return products


# The rolls of the first link at which every joint keeps within its limits: those that no arc covers
# on which a limit is broken, where the cosine of the angle from a centre is above a bound.

_TURN = 2.0 * np.pi
#: Just below a right angle.
_BELOW = np.pi / 2.0 - 1e-15
#: A narrower gap is free by rounding alone.
_SLIVER = 1e-12


def joint_limits(a_rad: Array, b_rad: Array, joints: int) -> Array:
    """Return limits of so many joints (2, 2, joints): of a, then of b, least and most of each.

    Args:
        a_rad: (2,) least and most of the rotations about z, of every joint.
        b_rad: (2,) of the rotations about y.

    Raises:
        CurveError: when a least limit is above its most.
    """
    both = np.array([a_rad, b_rad], dtype=float)
    for name, (least, most) in zip("ab", both.tolist(), strict=True):
        if not least <= most:
            raise CurveError(
                f"the limits of {name} are invalid",
                where="limits",
                value=f"{np.degrees(least):g} to {np.degrees(most):g} degrees",
                allowed="two angles, the least first",
                remedy="correct the limits",
            )
    return np.repeat(both[:, :, None], joints, axis=2)


def feasible_rolls(chain: RollMap, limits: Array) -> Array:
    """Return the intervals of roll (k, 2) within limits, [0, 2 pi] for all of them [rad].

    Each begins between 0 and 2 pi, and may end beyond. A lower limit above an upper one is kept at
    no roll.

    Args:
        limits: (2, 2, n - 1), see `joint_limits`.
    """
    a_rad, b_rad = limits
    turned, lifted = (a_rad, b_rad) if chain.order == "zy" else (-b_rad[::-1], a_rad)
    centre, half = _broken_arcs(chain.bend_rad, turned, lifted)
    joint, which = np.nonzero(half > 0.0)
    if not len(joint):
        return np.array([[0.0, _TURN]])
    middle, half = (centre + chain.heading_rad[:, None])[joint, which], half[joint, which]
    # Where the arcs begin as rolls of the first link, and how wide they are there: each half is
    # less than half a turn and stays so, its width is the angle between its ends.
    ends = [chain.roll_of(joint, middle + part * half) for part in (-1.0, 0.0, 1.0)]
    width = sum(_angle(one, other) for one, other in itertools.pairwise(ends))
    begin = np.where((chain.side[joint] > 0.0)[:, None], ends[0], ends[2])
    start = np.arctan2(begin[:, 1], begin[:, 0]) % _TURN
    order = np.argsort(start)
    start, reach = start[order], np.maximum.accumulate((start + width)[order])
    around = reach[-1] - _TURN  # the last arc goes on at the beginning
    covered = np.maximum(np.append(around, reach[:-1]), around)
    free = start - covered > _SLIVER
    intervals = np.stack([covered[free], start[free]], axis=1)
    intervals[intervals[:, 0] < 0.0] += _TURN
    return intervals


def _broken_arcs(bend_rad: Array, turned: Array, lifted: Array) -> tuple[Array, Array]:
    """Return centres and half widths (n - 1, 6) of the arcs on which a limit is broken.

    Angles are those of the carried axis from where the next link bends to. Up to a right angle of
    bend the first turn grows with the cosine of that angle, and each of its limits is broken about
    0 or half a turn. Beyond, it is half a turn less something: it is nearest to zero about 0 and
    half a turn, and farthest from it in between, on two arcs.
    """
    sin, cos = np.sin(bend_rad), np.cos(bend_rad)
    sharp = cos < 0.0
    least, most = turned
    half = np.zeros((len(bend_rad), 6))
    half[:, 0] = np.arccos(np.where(sharp, _sharp(least, sin, cos), _gentle(most, sin, cos)))
    half[:, 1] = np.arccos(np.where(sharp, _sharp(-most, sin, cos), _gentle(-least, sin, cos)))
    begin, end = np.arccos(_sharp(most, sin, cos)), np.arccos(-_sharp(-least, sin, cos))
    half[:, 2] = half[:, 3] = np.where(sharp, (end - begin) / 2.0, 0.0)
    for column, limit in ((4, lifted[1]), (5, -lifted[0])):
        part = _over(np.sin(limit.clip(-np.pi / 2.0, np.pi / 2.0)), sin)
        half[:, column] = np.arccos(part)
    quarter, beside = np.full_like(sin, np.pi / 2.0), (begin + end) / 2.0
    centre = [np.zeros_like(sin), 2.0 * quarter, beside, -beside, quarter, -quarter]
    return np.stack(centre, axis=1), half


def _gentle(limit: Array, sin: Array, cos: Array) -> Array:
    """Return the cosine above which a first turn exceeds a limit, for bends up to a right angle."""
    part = _over(np.tan(limit.clip(-_BELOW, _BELOW)) * cos, sin)
    return np.where(np.abs(limit) >= np.pi / 2.0, np.sign(limit), part)


def _sharp(limit: Array, sin: Array, cos: Array) -> Array:
    """Return the cosine below which a first turn exceeds a limit, for bends beyond a right angle.

    Only of cosines above 0, where the turn is positive.
    """
    rest = (np.pi - limit).clip(0.0, _BELOW)
    part = _over(np.tan(rest) * -cos, sin).clip(0.0)
    return np.where(limit <= np.pi / 2.0, 1.0, np.where(rest == 0.0, 0.0, part))


def _over(part: Array, sin: Array) -> Array:
    """Divide by the sine of a bend, to a cosine; without a bend no angle exceeds zero."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.nan_to_num(part / sin, nan=1.0).clip(-1.0, 1.0))


def _angle(first: Array, second: Array) -> Array:
    """Return the angles between unit vectors (k, 2), 0 to pi."""
    across = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    return np.asarray(np.arctan2(np.abs(across), (first * second).sum(axis=1)))


#: Levels are found to so much [rad].
_LEVEL_RAD = 1e-12
#: Limits exceeded by less are kept, but for rounding [rad].
_KEPT_RAD = 1e-9
#: Room where nothing limits a joint, or there is none [rad].
_ALL_ROOM = 2.0 * _TURN
_OUTWARD = np.array([-1.0, 1.0])[:, None]  # by which least and most of limits move apart


class Roll(NamedTuple):
    """A roll of the first link, the best in some sense."""

    roll_rad: float  # 0 to 2 pi
    # what it reaches: the largest angle, the room left within limits, or the largest move
    level_rad: float


def smallest_move(
    chain: RollMap,
    last: Array | float = 0.0,
    limits: Array | None = None,
    move_rad: float | None = None,
) -> Roll:
    """Return the roll at which no joint moves far from where it stood.

    Where some roll moves no joint farther than `move_rad`, it is the one of these with the smallest
    largest angle.

    Args:
        last: turns (2, n - 1) of the last shape about z and about y; 0 for the smallest angles.
        limits: what the angles must keep besides, (2, 2, n - 1).

    Raises:
        CurveError: when no roll keeps the limits, naming the joint and by how much.
    """
    kept = np.tile(_TURN * _OUTWARD, (2, 1, chain.n - 1)) if limits is None else limits
    if limits is not None and not len(feasible_rolls(chain, limits)):
        # Limits that are kept at single rolls only are widened by what rounding may exceed them by.
        kept = limits + (_KEPT_RAD - most_room(chain, limits).level_rad) * _OUTWARD
    middle = np.broadcast_to(last, (2, chain.n - 1))
    if move_rad is not None:
        near = _within(kept, middle, move_rad)
        if len(feasible_rolls(chain, near)):
            kept, middle = near, np.zeros_like(middle)
    return _tightest(chain, lambda level: _within(kept, middle, level))


def most_room(chain: RollMap, limits: Array) -> Roll:
    """Return the roll at which the joint nearest to a limit is farthest from it.

    Raises:
        CurveError: when no roll keeps the limits, naming the joint and by how much.
    """
    least = -float(np.diff(limits, axis=1).min(initial=2.0 * _ALL_ROOM)) / 2.0
    roll_rad, level = _tightest(chain, lambda level: limits + level * _OUTWARD, least)
    return _kept("no roll keeps", chain, limits, Roll(roll_rad, -level))


def room_at(chain: RollMap, roll_rad: float, limits: Array) -> Roll:
    """Return a roll with the room that it leaves within limits.

    Raises:
        CurveError: when it does not keep them, naming the joint and by how much.
    """
    at = np.concatenate(chain.angles(np.array([roll_rad])))
    room = np.stack([at - limits[:, 0], limits[:, 1] - at])
    found = Roll(roll_rad % _TURN, float(room.min(initial=_ALL_ROOM)))
    return _kept("this roll does not keep", chain, limits, found)


def roll_for_last(chain: RollMap, z_wanted: Array) -> Roll:
    """Return the roll at which z of the last link is nearest to a wanted direction.

    It is in the plane of the wanted direction and the link, exactly, at one roll and no other; its
    level is the remaining angle between the two. Along a bent chain that roll becomes sharp:
    most rolls end the same.

    Raises:
        CurveError: when the direction is none, or along the link.
    """
    one, other = chain.across[-1].T
    x = np.cross(one, other)
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
    angle = np.arctan2(axis @ other, axis @ one)
    cos, sin = chain.roll_of(np.array([chain.n - 1]), np.array([angle]))[0]
    aside = np.arctan2(abs(z_wanted @ x), np.linalg.norm(off))
    return Roll(float(np.arctan2(sin, cos) % _TURN), float(aside))


def _within(limits: Array, angles: Array, level: float) -> Array:
    """Return limits (2, 2, n - 1) that keep angles (2, n - 1), of a and b, to a distance too."""
    least = np.maximum(limits[:, 0], angles - level)
    return np.stack([least, np.minimum(limits[:, 1], angles + level)], axis=1)


def _tightest(chain: RollMap, family: Callable[[float], Array], least: float = 0.0) -> Roll:
    """Return a roll within the tightest limits of a family that some roll keeps, and their level.

    Args:
        family: gives limits at a level, wider at a higher one; some roll must keep those at the
            level of a whole turn.
    """
    low, high = least, _TURN
    free = feasible_rolls(chain, family(high))
    while high - low > _LEVEL_RAD:
        middle = (low + high) / 2.0
        found = feasible_rolls(chain, family(middle))
        if len(found):
            free, high = found, middle
        else:
            low = middle
    begin, end = free[np.argmax(free[:, 1] - free[:, 0])]
    return Roll(float((begin + end) / 2.0 % _TURN), high)


def _kept(who: str, chain: RollMap, limits: Array, roll: Roll) -> Roll:
    """Return a roll that keeps limits but for rounding.

    Raises:
        CurveError: when it does not, with the joint that exceeds its limits most.
    """
    if roll.level_rad >= -_KEPT_RAD:
        return roll
    at = np.concatenate(chain.angles(np.array([roll.roll_rad])))
    over = np.maximum(at - limits[:, 1], limits[:, 0] - at)
    which, joint = np.unravel_index(np.argmax(over), over.shape)
    least_deg, most_deg = np.degrees(limits[which, :, joint])
    raise CurveError(
        f"{who} the joints within their limits: {'ab'[which]} is "
        f"{np.degrees(-roll.level_rad):.3g} degrees beyond",
        where=f"joint {joint + 1}",
        value=f"{np.degrees(at[which, joint]):.4g} degrees",
        allowed=f"{least_deg:g} to {most_deg:g} degrees",
        remedy="widen the limits, take shorter links or a curve that bends less",
    )
