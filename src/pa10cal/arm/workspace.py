"""Constraints on where an arm and its targets may be, and poses drawn within them.

Poses are drawn evenly over the joints' ranges by the nominal chain; those that satisfy all
constraints are candidates to be measured. Links count as line segments from joint to joint, since
their thickness is not known here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pa10cal.arm.chain import Chain, frames
from pa10cal.arrays import Array, Mask

#: Length below which a vector has no direction [m].
_NO_LENGTH_M = 1e-12
#: Decimals of joint positions in files [deg, mm].
_DECIMALS = 3
#: Postures in one draw, a power of two as Sobol's sequence needs, and largest number of draws.
_POSTURES_A_DRAW = 2**14
_MOST_DRAWS = 60
#: Number of draws after which drawing ends if no posture is admissible.
_HOPELESS_DRAWS = 6


@dataclass(frozen=True)
class PosturePoints:
    """P postures, in the base frame [m]."""

    T_base_ee: Array  # (P, 4, 4) end of the chain
    p_base_joints: Array  # (n, P, 3) origins of the joints
    p_base_targets: Array  # (P, B, 3) targets on the end

    @classmethod
    def of(cls, chain: Chain, q: Array, targets_m: Array) -> PosturePoints:
        """Return the postures at joint positions (P, n) [rad, m], of targets (B, 3) on the end."""
        at = frames(chain, chain.coordinates(q))
        T = at.T_base_ee
        carried = T[:, None, :3, 3] + np.einsum("pij,bj->pbi", T[:, :3, :3], targets_m)
        return cls(T, at.T_base_joints[..., :3, 3], carried)

    @property
    def p_base_end(self) -> Array:
        """Return the origin of the end, (P, 3)."""
        return self.T_base_ee[:, :3, 3]

    @property
    def p_base_tool(self) -> Array:
        """Return the end and its targets, (P, 1 + B, 3)."""
        return np.concatenate([self.p_base_end[:, None], self.p_base_targets], axis=1)

    def take(self, rows: Mask) -> PosturePoints:
        """Return the postures of a mask (P,)."""
        return PosturePoints(
            self.T_base_ee[rows], self.p_base_joints[:, rows], self.p_base_targets[rows]
        )

    def __len__(self) -> int:
        return len(self.T_base_ee)


#: A constraint returns which of P postures satisfy it, (P,).
Constraint = Callable[[PosturePoints], Mask]


@dataclass(frozen=True)
class Box:
    """A box along the axes of the base."""

    # (3,) opposite corners
    low_m: Array
    high_m: Array

    def holds(self, points: Array) -> Mask:
        """Return which points (..., 3) are in the box."""
        within = (points >= self.low_m) & (points <= self.high_m)
        return np.asarray(within.all(axis=-1), dtype=np.bool_)

    def meets(self, start: Array, end: Array) -> Mask:
        """Return which line segments from start to end (..., 3) pass through the box.

        By the method of slabs: a segment is start + t (end - start), t from 0 to 1. Each pair of
        faces bounds an interval of t; the segment passes through where all three intervals overlap.
        """
        start, way = np.broadcast_arrays(start, end - start)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            t_low, t_high = (self.low_m - start) / way, (self.high_m - start) / way
        parallel = way == 0.0  # to the faces: between them for every t, or for none
        between = (start >= self.low_m) & (start <= self.high_m)
        enters = np.where(parallel, np.where(between, -np.inf, np.inf), np.fmin(t_low, t_high))
        leaves = np.where(parallel, np.where(between, np.inf, -np.inf), np.fmax(t_low, t_high))
        first, last = enters.max(axis=-1), leaves.min(axis=-1)
        return np.asarray((first <= last) & (last >= 0.0) & (first <= 1.0), dtype=np.bool_)


def within(box: Box) -> Constraint:
    """The first target is in a box."""
    return lambda at: box.holds(at.p_base_targets[:, 0])


def end_within(box: Box) -> Constraint:
    """The end is in a box."""
    return lambda at: box.holds(at.p_base_end)


def reach(radius_m: float) -> Constraint:
    """The first target is in a sphere about the base's origin."""
    return lambda at: np.linalg.norm(at.p_base_targets[:, 0], axis=1) <= radius_m


def above(floor_m: float) -> Constraint:
    """End and targets are above a height over the base's origin, along the base's z axis."""
    return lambda at: at.p_base_tool[..., 2].min(axis=1) > floor_m


def off_column(column_m: float) -> Constraint:
    """End and targets are further than this from the base's z axis."""
    return lambda at: np.hypot(*at.p_base_tool[..., :2].T).min(axis=0) > column_m


def keep_out(box: Box) -> Constraint:
    """End, targets, and the segments from joint to joint and on to these are outside a box.

    The first segment begins at joint 2: joint 1 does not move, and its support may be in the box.
    """

    def allows(at: PosturePoints) -> Mask:
        clear = ~box.holds(at.p_base_tool).any(axis=1)
        for start, end in pairwise([*at.p_base_joints[1:], at.p_base_end]):
            clear &= ~box.meets(start, end)
        clear &= ~box.meets(at.p_base_end[:, None], at.p_base_targets).any(axis=1)
        return np.asarray(clear, dtype=np.bool_)

    return allows


def off_links(least_m: float) -> Constraint:
    """Targets are further than this from the segments from joint to joint."""
    return lambda at: clearance_m(at) > least_m


def clearance_m(at: PosturePoints) -> Array:
    """Return the least distance of a target from the segments from joint to joint, (P,)."""
    nearest = np.full(len(at), np.inf)
    for start, end in pairwise(at.p_base_joints):
        away = distance_from_line(at.p_base_targets, start[:, None], end[:, None])
        nearest = np.minimum(nearest, away.min(axis=1, initial=np.inf))
    return nearest


def in_sight(p_base_instrument: Array, boxes: Sequence[Box]) -> Constraint:
    """The lines of sight from the instrument (3,) to the targets pass through no box."""

    def allows(at: PosturePoints) -> Mask:
        hidden = [box.meets(p_base_instrument, at.p_base_targets).any(axis=1) for box in boxes]
        return np.asarray(~np.any(hidden, axis=0), dtype=np.bool_)

    return allows


def facing(p_base_instrument: Array, axis_ee: Array, most_rad: float) -> Constraint:
    """The viewing direction of every target is within an angle of its line to the instrument.

    Args:
        p_base_instrument: (3,) the instrument.
        axis_ee: (3,) viewing direction of the targets, along the end's axes.
        most_rad: largest angle.
    """

    def allows(at: PosturePoints) -> Mask:
        viewing = at.T_base_ee[:, :3, :3] @ (axis_ee / np.linalg.norm(axis_ee))
        way = p_base_instrument - at.p_base_targets
        distance_m = np.maximum(np.linalg.norm(way, axis=-1), _NO_LENGTH_M)
        cosine = np.einsum("pbi,pi->pb", way, viewing) / distance_m
        return np.asarray(cosine.min(axis=1) >= np.cos(most_rad), dtype=np.bool_)

    return allows


def admissible(at: PosturePoints, constraints: Sequence[Constraint]) -> tuple[Mask, list[int]]:
    """Return which postures (P,) satisfy all constraints, and how many each of these removed.

    A constraint is evaluated for those postures only that satisfy all before it.
    """
    allowed = np.ones(len(at), dtype=np.bool_)
    removed = []
    for constraint in constraints:
        satisfied = constraint(at.take(allowed))
        removed.append(int((~satisfied).sum()))
        allowed[np.flatnonzero(allowed)[~satisfied]] = False
    return allowed, removed


@dataclass(frozen=True)
class Candidates:
    """Poses that could be measured."""

    q: Array  # (N, n) joint positions [rad, or m of a prismatic joint]
    drawn: int  # number of poses drawn
    # number of poses that each constraint removed, by its name
    removed: dict[str, int]


def draw_within(
    chain: Chain,
    targets_m: Array,
    ranges: tuple[Array, Array],
    constraints: Mapping[str, Constraint],
    wanted: int,
    random_seed: int,
) -> Candidates:
    """Draw poses by Sobol's sequence until enough satisfy all constraints.

    Args:
        targets_m: (B, 3) targets on the end.
        ranges: least and largest positions of the axes, (m,) each [rad, m].
        constraints: by name, the quickest first.
        wanted: N; fewer are returned where hardly any pose satisfies the constraints.
    """
    low, high = ranges
    unit = np.where(chain.arm.axes_slide, 1e-3, np.radians(1.0))  # of positions in files
    from scipy.stats import qmc  # late: half a second, for plans alone

    sobol = qmc.Sobol(len(unit), rng=random_seed)
    removed = np.zeros(len(constraints), dtype=np.int64)
    kept: list[Array] = []
    draws = 0
    while draws < _MOST_DRAWS and sum(map(len, kept)) < wanted:
        axes = low + (high - low) * sobol.random(_POSTURES_A_DRAW)
        q = chain.arm.coupling.to_joints(np.round(axes / unit, _DECIMALS) * unit)
        points = PosturePoints.of(chain, q, targets_m)
        allowed, removed_here = admissible(points, [*constraints.values()])
        kept.append(q[allowed])
        removed += removed_here
        draws += 1
        if draws == _HOPELESS_DRAWS and not sum(map(len, kept)):
            break
    by_name = dict(zip(constraints, removed.tolist(), strict=True))
    return Candidates(np.concatenate(kept)[:wanted], draws * _POSTURES_A_DRAW, by_name)


def distance_from_line(points: Array, start: Array, end: Array) -> Array:
    """Return the distances (P, B) of points (P, B, 3) from segments start to end (P, 1, 3)."""
    along = end - start
    length2 = np.maximum(np.sum(along**2, axis=-1), 1e-12)
    share = np.clip(np.sum((points - start) * along, axis=-1) / length2, 0.0, 1.0)
    distance: Array = np.linalg.norm(points - start - share[..., None] * along, axis=-1)
    return distance
