"""Every frame of the chain as a function of the first link's roll, in closed form.

The axis that is carried along the chain (`angles`) goes from link to link by a linear map of the
planes square to the links, made a unit vector afterwards: w_i is along A_i w_1 with one product A_i
of 2 x 2 matrices a link. So one pass, whatever the number of rolls, and the way back from a
direction at any link to the roll that leads there is the inverse matrix. Each factor keeps the
direction square to a bend and shortens the one in its plane by the cosine of the bend: along a bent
chain the roll of the first link is gradually forgotten.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.curve.angles import Order, first_axes


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
            order: which turn comes first.
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
        first = self._carried_at_first(roll_rad)
        axis = np.einsum("kab,rb->rka", self.maps[:-1], first)
        off = np.arctan2(axis[..., 1], axis[..., 0]) - self.heading_rad
        turned, lifted = turned_and_lifted(self.bend_rad, off)
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

    def _carried_at_first(self, roll_rad: Array) -> Array:
        cos, sin = np.cos(roll_rad), np.sin(roll_rad)
        return np.stack([cos, sin] if self.order == "zy" else [-sin, cos], axis=1)


def turned_and_lifted(bend_rad: Array, off_rad: Array) -> tuple[Array, Array]:
    """Return the first and second turn of joints, as `zy` counts them.

    Args:
        bend_rad: angle between the links.
        off_rad: angle of the carried axis from where the next link bends to.
    """
    sin = np.sin(bend_rad)
    turned = np.arctan2(sin * np.cos(off_rad), np.cos(bend_rad))
    return turned, np.arcsin((sin * np.sin(off_rad)).clip(-1.0, 1.0))


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
