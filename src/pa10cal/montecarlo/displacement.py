"""The displacement of the flange under finite joint errors, as products of rows and one matrix.

Joint i turns all that lies beyond it about its axis ẑ by its error δ. If the joints further out
have displaced the flange by u, and v runs from the axis to the flange, joint i adds

    sin δ ẑ×(v + u) + (1 - cos δ) ẑ×(ẑ×(v + u)),

which is exact: nothing is linearised. So the displacement is a constant matrix, in which stands all
that belongs to the pose, times rows that change with every draw: sin δ and 1 - cos δ of the joints,
and their products with the components of u across the axis. u is computed from the tip inwards;
it is small, so no digits are lost. Four simplifications, all exact:

- the length of a displacement does not depend on the link it is seen from. Seen from a link in the
  middle, the tip moves by the joints beyond that link, and the point where the flange should be
  moves by the joints before it, turned backwards: two short chains instead of a long one;
- consecutive joints with parallel axes act as one that turns by the sum of their errors; each link
  between them turns by a partial sum;
- a component of u that vanishes in every pose takes no product (axes at right angles);
- outermost joints whose axes pass through the point do not move it (their errors are drawn all the
  same).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arrays import Array

# Sine and 1 - cosine of random small angles, in as few passes over memory as they can take.

#: The series leaves out δ⁴/24 of 1 - cos δ and δ⁵/120 of sin δ; it serves while the former, of
#: an angle this many standard deviations long, stays below `_LEFT_OUT`: a longer angle comes once
#: in 1e15 draws.
_LONGEST_SIGMAS = 8.0
_LEFT_OUT = 1e-12


class Turns(Protocol):
    """How rows of standard normals become sines and cosines of angles.

    The two are wanted only as factors in a linear map, so they may come in any fixed scale.

    Attributes:
        sine_scale: sin δ over what `fill` writes for it.
        versine_scale: (1 - cos δ) over what `fill` writes for it.
        refined_scale: (1 - cos δ) over what `refine` makes of it.
    """

    @property
    def sine_scale(self) -> float:
        """Return sin δ over the sine row."""

    @property
    def versine_scale(self) -> float:
        """Return (1 - cos δ) over the versine row."""

    @property
    def refined_scale(self) -> float:
        """Return (1 - cos δ) over the refined versine row."""

    def fill(self, normals: Array, versine: Array, work: Array) -> None:
        """Replace the normals z by the sine rows of the angles σz, and write the versines."""

    def refine(self, versine: Array, work: Array) -> None:
        """Make a versine row exact for sums of errors, which are longer than single ones."""


@dataclass(frozen=True)
class SeriesTurns:
    """Taylor series: sin δ = -(σ³/6) z (z² - 6/σ²), 1 - cos δ = (σ²/2) z², with δ = σ z.

    Refined: 1 - cos δ = (σ⁴/24) z² (12/σ² - z²).
    """

    sigma_rad: float

    @property
    def sine_scale(self) -> float:
        """Return sin δ over the sine row."""
        return -(self.sigma_rad**3) / 6.0

    @property
    def versine_scale(self) -> float:
        """Return (1 - cos δ) over the versine row."""
        return self.sigma_rad**2 / 2.0

    @property
    def refined_scale(self) -> float:
        """Return (1 - cos δ) over the refined versine row."""
        return self.sigma_rad**4 / 24.0

    def fill(self, normals: Array, versine: Array, work: Array) -> None:
        """Write z (z² - 6/σ²) and z²."""
        np.square(normals, versine)
        np.subtract(versine, self._six, work)
        np.multiply(normals, work, normals)

    def refine(self, versine: Array, work: Array) -> None:
        """Make z² into z² (12/σ² - z²)."""
        np.subtract(self._twelve, versine, work)
        np.multiply(versine, work, versine)

    # Arrays, because numpy would convert a number at every call.

    @cached_property
    def _six(self) -> Array:
        return np.array(6.0 / self.sigma_rad**2)

    @cached_property
    def _twelve(self) -> Array:
        return np.array(12.0 / self.sigma_rad**2)


@dataclass(frozen=True)
class LibraryTurns:
    """numpy's sine, for angles too large for the series; 1 - cos δ = 2 sin²(δ/2)."""

    sigma_rad: float
    sine_scale: float = 1.0
    versine_scale: float = 2.0
    refined_scale: float = 2.0

    def fill(self, normals: Array, versine: Array, work: Array) -> None:
        """Write sin σz and sin² σz/2."""
        np.multiply(normals, 0.5 * self.sigma_rad, work)
        np.sin(work, work)
        np.multiply(work, work, versine)
        np.multiply(normals, self.sigma_rad, normals)
        np.sin(normals, normals)

    def refine(self, versine: Array, work: Array) -> None:
        """Leave the row as it is: exact already."""


def turns_of(sigma_rad: float, most_added: int) -> Turns:
    """Return the series where it is exact, else numpy's sine.

    Args:
        sigma_rad: standard deviation of one joint's angle.
        most_added: how many independent angles at most are added into one.
    """
    longest = _LONGEST_SIGMAS * np.sqrt(most_added) * sigma_rad
    return SeriesTurns(sigma_rad) if longest**4 / 24.0 <= _LEFT_OUT else LibraryTurns(sigma_rad)


#: A joint that moves the flange by less than this per radian does not move it [m].
_STILL_M = 1e-13
#: Axes whose sine of the angle between is below this are parallel; a part of a displacement below
#: this [m for one radian] vanishes.
_PARALLEL = 1e-14


@dataclass(frozen=True)
class JointMotion:
    """What each joint does to the flange at P positions of the arm."""

    axes: Array  # (P, n, 3) unit vectors of the joint axes, in the base frame
    jacobian: Array  # (P, 3, n) velocity of the flange by each joint [m/rad], in the base frame


def joint_motion(chain: Chain, q_rad: Array) -> JointMotion:
    """Return axes and Jacobian at joint positions (P, n) of an arm whose joints all turn."""
    screws = chain.forward_with_screws(q_rad).screws[:, :, chain.joint_columns]
    return JointMotion(axes=screws[:, 3:].transpose(0, 2, 1), jacobian=screws[:, :3])


@dataclass(frozen=True)
class Product:
    """One component of a displacement, times sine and versine of the next joint inwards."""

    # (P, rows) matrix of the component; None where it is one row as it stands
    component: Array | None
    rows: slice  # the rows it is made of, or that row
    # the rows of the joint's sine and versine, which multiply it, each with the row that holds the
    # product
    turns: tuple[tuple[int, int], tuple[int, int]]


@dataclass(frozen=True)
class DisplacementPlan:
    """Everything constant in the displacement of the flange at P positions.

    The rows are: `before` products, sines of the joints up to the last that moves something,
    versines of the joints `moving`, other products.
    """

    joints: int  # n, all of which are drawn
    # for the two chains that meet at the link from which the displacement is seen, to the tip and
    # to the base: groups of joints with parallel axes that follow each other, from that link
    # outwards. Joints that move nothing are omitted.
    chains: tuple[tuple[tuple[int, ...], ...], tuple[tuple[int, ...], ...]]
    moving: slice  # range of joints whose sines and versines are needed
    before: int  # how many rows stand before the sines
    products: tuple[Product, ...]  # in the order they are computed
    matrix: Array  # (P, 3, rows) from rows to displacements [m], in a frame in which most vanishes
    # for each of the three components the rows that are not zero at every position
    ranges: tuple[slice, ...]
    turns: Turns  # how drawn normals become sines and versines

    @property
    def added(self) -> list[tuple[int, int]]:
        """Pairs of joints: the error of the first is added to that of the second, in this order."""
        groups = [group for chain in self.chains for group in chain]
        return [pair for group in groups for pair in pairwise(group)]


def plan_displacement(motion: JointMotion, sigma_rad: float) -> DisplacementPlan:
    """Lay out the displacement for joint errors of `sigma_rad` at the given positions."""
    layouts = [_Layout(motion, split) for split in range(motion.axes.shape[1] + 1)]
    return min(layouts, key=_Layout.passes).plan(sigma_rad)


class _Layout:
    """Computes rows and matrices for one link from which the displacement is seen.

    While rows are still being added, sines count from 0, versines and products follow. Products
    that move the point along the axis of the largest group count down from -1 (from the end of an
    array with room enough). Other joints' sines do the same and versines hardly ever, so rows that
    one component needs stand close together.
    """

    def __init__(self, motion: JointMotion, split: int) -> None:
        """`split` joints lie before the link."""
        positions, n = motion.axes.shape[:2]
        self._motion = motion
        self._chains = (
            _groups(motion, list(range(split, n))),
            _groups(motion, list(range(split))[::-1]),
        )
        self._all_groups = [group for chain in self._chains for group in chain]
        used = [joint for group in self._all_groups for joint in group]
        self._moving = slice(min(used, default=0), max(used, default=0) + 1)
        self._versine = self._moving.stop - self._moving.start
        self._first, self._end = 0, self._versine + self._moving.stop
        self._room = self._end + 4 * n * n
        self._axis = motion.axes[:, max(self._all_groups, key=len, default=(0,))[0]]
        #: Component, its rows and the joint of every product, and the rows with sine and versine.
        self._products: list[tuple[Array | None, list[int], int, tuple[int, int]]] = []
        # Seen from the link, the joints before it turn the other way.
        tip = self._displacement(self._chains[0], 1.0, positions)
        base = self._displacement(self._chains[1], -1.0, positions)
        self._matrix = tip - base

    def passes(self) -> int:
        """Count, roughly, how often memory is passed over beyond what every layout does."""
        components = sum(component is not None for component, *_ in self._products)
        added = sum(len(group) - 1 for group in self._all_groups)
        return 3 * components + 6 * len(self._products) + 4 * added

    def plan(self, sigma_rad: float) -> DisplacementPlan:
        """Return the plan, with the scales of sines and versines taken into its matrices."""
        turns = turns_of(sigma_rad, max(map(len, self._all_groups), default=1))
        order, before = self._order(), -self._first
        scale = np.full(self._room, turns.versine_scale)
        scale[: self._moving.stop] = turns.sine_scale
        for group in self._all_groups:
            scale[[self._versine + joint for joint in group[1:]]] = turns.refined_scale
        products = []
        for component, rows, joint, into in self._products:
            turning = joint, self._versine + joint
            scale[list(into)] = scale[list(turning)]
            if component is None:
                scale[list(into)] *= scale[rows[0]]
            else:
                component = component * scale[rows]
            (sine, to_sine), (versine, to_versine) = zip(turning, into, strict=True)
            pairs = (sine + before, to_sine + before), (versine + before, to_versine + before)
            products.append(Product(component, _run(rows, before), pairs))
        matrix = _sparse_frame(self._axis) @ self._matrix
        needed = np.abs(matrix[:, :, order]).max(axis=0) > _PARALLEL
        return DisplacementPlan(
            joints=self._motion.axes.shape[1],
            chains=self._chains,
            moving=self._moving,
            before=before,
            products=tuple(products),
            matrix=np.ascontiguousarray((matrix * scale)[:, :, order]),
            ranges=tuple(_range(np.flatnonzero(row)) for row in needed),
            turns=turns,
        )

    def _order(self) -> list[int]:
        """Rows that are used so far, as they will stand."""
        return list(range(self._first, self._end))

    def _displacement(
        self, chain: tuple[tuple[int, ...], ...], sign: float, positions: int
    ) -> Array:
        """Return (P, 3, rows): the point moved by the groups of a chain, in the base frame."""
        u = np.zeros((positions, 3, self._room))
        for group in reversed(chain):
            axis = sign * self._motion.axes[:, group[0]]
            self._multiply(u, axis, group[-1])
            velocity = sign * self._motion.jacobian[:, :, group]
            links = velocity.copy()
            links[:, :, :-1] -= velocity[:, :, 1:]
            u[:, :, group] += links
            versines = [self._versine + joint for joint in group]
            u[:, :, versines] += np.cross(axis[:, :, None], links, axis=1)
        return u

    def _multiply(self, u: Array, axis: Array, joint: int) -> None:
        """Add to `u` what a joint does to it: products of its components across the axis (P, 3)."""
        order = self._order()
        turned = np.cross(axis[:, :, None], u[:, :, order], axis=1)
        found = np.flatnonzero(np.abs(turned).max(axis=(0, 1)) > _PARALLEL)
        if not len(found):
            return
        if len(found) > 2:
            found = np.arange(found[0], found[-1] + 1)
        turned, rows = turned[:, :, found], [order[k] for k in found]
        directions, sizes, components = np.linalg.svd(turned, full_matrices=False)
        count = int((sizes > _PARALLEL).sum(axis=1).max())
        if len(rows) <= count:
            for k, row in enumerate(rows):
                self._append(u, (None, [row], joint), turned[:, :, k], axis)
            return
        components = np.ascontiguousarray((sizes[:, :, None] * components).transpose(1, 0, 2))
        for k in range(count):
            self._append(u, (components[k], rows, joint), directions[:, :, k], axis)

    def _append(
        self, u: Array, product: tuple[Array | None, list[int], int], turned: Array, axis: Array
    ) -> None:
        """Add a product; `turned` (P, 3) is ẑ× the direction of its component."""
        component, rows, joint = product
        into = self._new_row(u, turned), self._new_row(u, np.cross(axis, turned))
        self._products.append((component, rows, joint, into))

    def _new_row(self, u: Array, direction: Array) -> int:
        """Add a row that moves the point in a direction (P, 3)."""
        if np.abs(np.cross(self._axis, direction)).max() < _PARALLEL:
            row = self._first = self._first - 1
        else:
            row, self._end = self._end, self._end + 1
        u[:, :, row] = direction
        return row


def _run(rows: list[int], before: int) -> slice:
    """Return consecutive or two or one row, with `before` rows put in front of row 0."""
    step = rows[1] - rows[0] if len(rows) == 2 else 1
    return slice(rows[0] + before, rows[-1] + before + 1, step)


def _range(needed: NDArray[np.intp]) -> slice:
    return slice(int(needed[0]), int(needed[-1]) + 1) if len(needed) else slice(0, 1)


def _sparse_frame(axis: Array) -> Array:
    """Return (P, 3, 3) rotations into a frame along the axis of the largest group.

    Along its axis, a group moves nothing.
    """
    least = np.eye(3)[np.argmin(np.abs(axis), axis=1)]
    x = np.cross(least, axis)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(axis, x), axis], axis=1)


def _groups(motion: JointMotion, joints: list[int]) -> tuple[tuple[int, ...], ...]:
    """Split joints, given from a link outwards, where neighbouring axes are not parallel."""
    moves = np.linalg.norm(motion.jacobian, axis=1).max(axis=0) > _STILL_M
    while joints and not moves[joints[-1]]:
        joints = joints[:-1]
    groups: list[tuple[int, ...]] = []
    for joint in joints:
        if groups and _parallel(motion.axes[:, groups[-1][-1]], motion.axes[:, joint]):
            groups[-1] = (*groups[-1], joint)
        else:
            groups.append((joint,))
    return tuple(groups)


def _parallel(one: Array, other: Array) -> bool:
    """Return whether two axes (P, 3) point the same way at every position."""
    apart = np.linalg.norm(np.cross(one, other), axis=1)
    return bool((apart < _PARALLEL).all() and (np.sum(one * other, axis=1) > 0).all())


class DisplacementBlock:
    """One block of cycles: from drawn normals to lengths of displacements, without allocating.

    A block fills the processor's cache, so no row is kept longer than it is needed: the normals of
    the last joints, if these move nothing, make way for versines, and the work of one stage is
    written over that of the stage before.

    Attributes:
        normals: (n, cycles), one row a joint: to be filled with standard normals before every
            `displace`, which uses it up.
        error_m: (cycles,) lengths of the displacements, after `displace`.
    """

    def __init__(self, plan: DisplacementPlan, cycles: int) -> None:
        moving, used = plan.moving, plan.matrix.shape[2]
        count, after = moving.stop - moving.start, plan.before + moving.stop
        # Three rows of work come last; `fill` needs `count` and takes rows of products as well.
        room = max(used + 3, after + 2 * count, plan.before + plan.joints)
        rows = np.zeros((room, cycles))
        versines = rows[after:][:count]
        self.normals = rows[plan.before :][: plan.joints]
        self.error_m = rows[-3]
        self._turns = plan.turns
        self._added = [(self.normals[outer], self.normals[inner]) for inner, outer in plan.added]
        self._turned = self.normals[moving], versines, rows[-count:]
        self._work = rows[-1]
        self._refined = [versines[outer - moving.start] for _, outer in plan.added]
        self._products = [
            (
                product.component,
                rows[product.rows],
                rows[product.rows.start] if product.component is None else self._work,
                [(rows[turn], rows[into]) for turn, into in product.turns],
            )
            for product in plan.products
        ]
        self._components = [
            (plan.matrix[:, k, part], rows[part], rows[k - 3]) for k, part in enumerate(plan.ranges)
        ]
        self._displacement = rows[-3:]

    def displace(self, position: int) -> None:
        """Turn the drawn normals into displacements at one position of the plan."""
        for outer, inner in self._added:
            np.add(outer, inner, outer)
        self._turns.fill(*self._turned)
        for versine in self._refined:
            self._turns.refine(versine, self._work)
        for component, rows, factor, products in self._products:
            if component is not None:
                np.matmul(component[position], rows, factor)
            # Row by row: rows that stand apart take longer in one call.
            for turn, product in products:
                np.multiply(turn, factor, product)
        for matrix, rows, out in self._components:
            matrix[position].dot(rows, out)
        squares, error_m = self._displacement, self.error_m
        np.square(squares, squares)
        np.add(squares[0], squares[1], error_m)
        np.add(error_m, squares[2], error_m)
        np.sqrt(error_m, error_m)
