"""The rolls of the first link at which every joint keeps within its limits.

Each limit of a joint is broken on an arc of its own about the link before it: where the cosine of
the angle from a centre is above a bound. The ends of these arcs go back to rolls of the first link
in closed form (`roll_map`), and what no arc covers is feasible: exact intervals, without a scan.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.curve.roll_map import RollMap
from pa10cal.errors import CurveError

_TURN = 2.0 * np.pi
#: Just below a right angle.
_BELOW = np.pi / 2.0 - 1e-15
#: A narrower gap is free by rounding alone.
_SLIVER = 1e-12


@dataclass(frozen=True)
class JointLimits:
    """Limits of the joints between n links."""

    a_rad: Array  # (n - 1, 2) least and most of the turns about z
    b_rad: Array  # (n - 1, 2) of the turns about y

    def __post_init__(self) -> None:
        for name, limits in (("a", self.a_rad), ("b", self.b_rad)):
            bad = np.flatnonzero(~(limits[:, 0] <= limits[:, 1]))
            if len(bad):
                raise CurveError(
                    f"the limits of {name} are invalid",
                    where=f"joint {bad[0] + 1}",
                    value=limits[bad[0]].tolist(),
                    allowed="two angles, the least first",
                    remedy="correct the limits",
                )

    @classmethod
    def uniform(cls, joints: int, least_rad: float, most_rad: float) -> JointLimits:
        """Return the same limits for every joint and turn."""
        limits = np.tile([least_rad, most_rad], (joints, 1))
        return cls(limits, limits)

    def widened(self, joints: int, by_rad: float) -> tuple[Array, Array]:
        """Return the limits (2, n - 1) of a and b, each so much farther out.

        Raises:
            CurveError: when they are not of so many joints.
        """
        if not len(self.a_rad) == len(self.b_rad) == joints:
            raise CurveError(
                "the limits are of another chain",
                where="limits",
                value=f"{len(self.a_rad)} of a, {len(self.b_rad)} of b",
                allowed=f"{joints} each, one a joint between two links",
                remedy="give limits for every joint",
            )
        aside = np.array([[-by_rad], [by_rad]])
        return self.a_rad.T + aside, self.b_rad.T + aside


def feasible_rolls(chain: RollMap, limits: JointLimits) -> Array:
    """Return the intervals of roll (k, 2) within the limits, [0, 2 pi] for all of them [rad].

    Each begins between 0 and 2 pi, and may end beyond.

    Raises:
        CurveError: when the limits are of another number of joints.
    """
    return free_rolls(chain, *limits.widened(chain.n - 1, 0.0))


def free_rolls(chain: RollMap, a_rad: Array, b_rad: Array) -> Array:
    """Return the intervals of roll (k, 2) at which a and b are within (2, n - 1) limits [rad].

    A lower limit above an upper one is kept at no roll.
    """
    turned, lifted = (a_rad, b_rad) if chain.order == "zy" else (-b_rad[::-1], a_rad)
    centre, half = _broken_arcs(chain.bend_rad, turned, lifted)
    joint, which = np.nonzero(half > 0.0)
    if not len(joint):
        return np.array([[0.0, _TURN]])
    middle, half = (centre + chain.heading_rad[:, None])[joint, which], half[joint, which]
    start, width = _as_rolls(chain, joint, middle, half)
    return _left_free(start, width)


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


def _as_rolls(
    chain: RollMap, link: NDArray[np.intp], centre: Array, half: Array
) -> tuple[Array, Array]:
    """Return where arcs about links begin as rolls of the first, and how wide they are there.

    Each half is less than half a turn, and stays so: its width is the angle between its ends.
    """
    low, middle, high = (chain.roll_of(link, centre + part * half) for part in (-1.0, 0.0, 1.0))
    width = sum(_between(first, second) for first, second in ((low, middle), (middle, high)))
    begin = np.where((chain.side[link] > 0.0)[:, None], low, high)
    return np.arctan2(begin[:, 1], begin[:, 0]), np.asarray(width)


def _between(first: Array, second: Array) -> Array:
    """Return the angles between unit vectors (k, 2), 0 to pi."""
    across = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    return np.asarray(np.arctan2(np.abs(across), (first * second).sum(axis=1)))


def _left_free(start: Array, width: Array) -> Array:
    """Return the intervals (k, 2) of a circle that no arc covers."""
    start = start % _TURN
    order = np.argsort(start)
    start, reach = start[order], np.maximum.accumulate((start + width)[order])
    around = reach[-1] - _TURN  # the last arc goes on at the beginning
    covered = np.maximum(np.append(around, reach[:-1]), around)
    free = start - covered > _SLIVER
    intervals = np.stack([covered[free], start[free]], axis=1)
    intervals[intervals[:, 0] < 0.0] += _TURN
    return intervals
