"""Displacement of the flange by errors of all joints: exact, as products of rows with a matrix.

Joint i turns everything beyond it about its axis ẑ by its error δ. If the joints further out have
displaced the flange by u, and v is the vector from the axis to the flange, joint i adds

    sin δ ẑ×(v + u) + (1 - cos δ) ẑ×(ẑ×(v + u)).

So the displacement is a matrix, constant for a pose, times rows that change with every draw: sin δ
and 1 - cos δ of the joints, and their products with the components of u across the axis. u is
computed from the tip inwards; it is small, so that no digits are lost. Three simplifications, all
exact:

- The length of a displacement does not depend on the link from which it is seen. Seen from a link
  in the middle, the tip moves by the joints beyond that link, and the target point by the joints
  before it, turned backwards: two short chains instead of a long one.
- A component of u that vanishes in every pose needs no product (axes at right angles).
- Outermost joints whose axes pass through the point do not move it (their errors are still drawn).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arrays import Array
from pa10cal.montecarlo.places import flange_with_screws

#: The series omits δ⁴/24 of 1 - cos δ and δ⁵/120 of sin δ. It is used if the former is below
#: `_OMITTED` for an angle of so many standard deviations, which one draw in 1e15 exceeds.
_LONGEST_SIGMAS = 8.0
_OMITTED = 1e-12
#: Least motion of the flange by a joint [m/rad].
_STILL_M = 1e-13
#: Least component of a displacement [m/rad].
_VANISHES_M = 1e-14


def series_is_exact(sigma_rad: float) -> bool:
    """Return whether the series of `sines_and_versines` holds for this standard deviation."""
    return bool((_LONGEST_SIGMAS * sigma_rad) ** 4 / 24.0 <= _OMITTED)


def sines_and_versines(
    normals: Array, versine: Array, scratch: Array, sigma_rad: float, *, series: bool
) -> None:
    """Replace normals z by sin σz, and write 1 - cos σz, in few passes over memory.

    They follow from the series σz - (σz)³/6 and (σz)²/2, or from numpy's sine and
    1 - cos δ = 2 sin²(δ/2). `scratch`, of the same shape, is overwritten.
    """
    if series:
        np.square(normals, scratch)
        np.multiply(scratch, sigma_rad**2 / 2.0, versine)
        np.multiply(scratch, -(sigma_rad**3) / 6.0, scratch)
        np.add(scratch, sigma_rad, scratch)
        np.multiply(normals, scratch, normals)
        return
    np.multiply(normals, 0.5 * sigma_rad, scratch)
    np.sin(scratch, scratch)
    np.square(scratch, versine)
    np.multiply(versine, 2.0, versine)
    np.multiply(normals, sigma_rad, normals)
    np.sin(normals, normals)


def joint_screws(chain: Chain, q_rad: Array) -> Array:
    """Return the motion of the flange by each joint at joint positions (P, n), (P, 6, n).

    It is the flange's velocity [m/rad], then the unit vector of the joint's axis, in the base.
    """
    return flange_with_screws(chain, q_rad)[1]


@dataclass(frozen=True)
class Product:
    """Products of a displacement's components across an axis with sine and versine of the joint."""

    components: Array  # (P, c, rows) matrix from rows to the components, one or two
    rows: slice  # the rows that they are computed from
    joint: int  # the joint whose sine and versine multiply them
    into: slice  # the 2 c rows of the products, those with the sine first


@dataclass(frozen=True)
class DisplacementPlan:
    """The constant part of the displacement of the flange at P positions.

    Rows are sines of all n joints, versines of those up to the last that moves the flange, then
    products.
    """

    sigma_rad: float  # standard deviation of the error of a joint
    joints: int  # n, all of which are drawn
    moving: int  # number of joints, from the base outwards, that may move the flange
    products: tuple[Product, ...]  # in the order in which they are computed
    matrix: Array  # (P, 3, rows) from rows to displacements [m]


def plan_displacement(screws: Array, sigma_rad: float) -> DisplacementPlan:
    """Return the plan for joint errors of `sigma_rad` at positions of screws (P, 6, n).

    The displacement is seen from the link for which it has the fewest rows.
    """
    n = screws.shape[2]
    moves = np.linalg.norm(screws[:, :3], axis=1).max(axis=0) > _STILL_M
    plans = []
    for link in range(n + 1):  # number of joints before the link
        chains = []  # of joints from the link outwards, to the tip and to the base
        for chain in (list(range(link, n)), list(range(link))[::-1]):
            while chain and not moves[chain[-1]]:
                chain.pop()
            chains.append(chain)
        moving = 1 + max((*chains[0], *chains[1]), default=-1)
        products: list[Product] = []
        # Seen from the link, the joints before it turn the other way.
        tip = _displacement(screws, chains[0], 1.0, moving, products)
        base = _displacement(screws, chains[1], -1.0, moving, products)
        used = products[-1].into.stop if products else n + moving
        matrix = np.ascontiguousarray((tip - base)[:, :, :used])
        plans.append(DisplacementPlan(sigma_rad, n, moving, tuple(products), matrix))
    return min(plans, key=lambda plan: plan.matrix.shape[2])


def _displacement(
    screws: Array, chain: list[int], sign: float, moving: int, products: list[Product]
) -> Array:
    """Return the matrix (P, 3, rows) of the point's displacement by the joints of a chain.

    Products that it needs are appended to `products`.
    """
    positions, _, n = screws.shape
    u = np.zeros((positions, 3, n + moving + 4 * n * n))
    for joint in reversed(chain):
        velocity, axis = sign * screws[:, :3, joint], sign * screws[:, 3:, joint]
        turned = np.cross(axis[:, :, None], u, axis=1)
        used = np.flatnonzero(np.abs(turned).max(axis=(0, 1)) > _VANISHES_M)
        if len(used):
            rows = slice(int(used[0]), int(used[-1]) + 1)
            directions, sizes, parts = np.linalg.svd(turned[:, :, rows], full_matrices=False)
            count = int((sizes > _VANISHES_M).sum(axis=1).max())
            components = np.ascontiguousarray((sizes[:, :, None] * parts)[:, :count])
            first = products[-1].into.stop if products else n + moving
            into = slice(first, first + 2 * count)
            products.append(Product(components, rows, joint, into))
            turned = directions[:, :, :count]
            u[:, :, into] = np.dstack([turned, np.cross(axis[:, :, None], turned, axis=1)])
        u[:, :, joint] += velocity
        u[:, :, n + joint] += np.cross(axis, velocity)
    return u


class DisplacementBlock:
    """One block of cycles: from drawn normals to lengths of displacements, without allocating.

    `normals` (n, cycles) have to be filled before every `displace`, which overwrites them and
    computes the lengths `error_m` (cycles,).
    """

    def __init__(self, plan: DisplacementPlan, cycles: int) -> None:
        n, moving, used = plan.joints, plan.moving, plan.matrix.shape[2]
        # A block should fit into the processor's cache, so that its rows are used several times.
        rows = np.zeros((max(used + 5, n + 2 * moving), cycles))
        self._plan, self._rows = plan, rows
        self.normals, self._factors = rows[:n], rows[-5:-3]
        self._turned = rows[:moving], rows[n : n + moving], rows[len(rows) - moving :]
        self._used, self._displacement, self.error_m = rows[:used], rows[-3:], rows[-3]
        self._series = series_is_exact(plan.sigma_rad)

    def displace(self, position: int) -> None:
        """Compute the lengths of displacements at one position of the plan."""
        plan, rows = self._plan, self._rows
        sines_and_versines(*self._turned, plan.sigma_rad, series=self._series)
        for product in plan.products:
            components = product.components[position]
            count = len(components)
            factors, into = self._factors[:count], rows[product.into]
            np.matmul(components, rows[product.rows], factors)
            np.multiply(rows[product.joint], factors, into[:count])
            np.multiply(rows[plan.joints + product.joint], factors, into[count:])
        squares = self._displacement
        np.matmul(plan.matrix[position], self._used, squares)
        np.square(squares, squares)
        np.add(squares[0], squares[1], self.error_m)
        np.add(self.error_m, squares[2], self.error_m)
        np.sqrt(self.error_m, self.error_m)
