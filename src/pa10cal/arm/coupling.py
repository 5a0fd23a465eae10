"""Coupled joints: positions q = C c of joints by the axes c that a controller counts.

Most controllers count every joint by itself. Some log joint 3 to the horizontal (FANUC,
parallelograms), turn a wrist's last joint by its gears, or raise a quill as it turns; and one motor
may drive several joints (a telescope). Positions are those of the arm's joints from where a log
becomes observations to where commands leave; nothing in between knows of the controller's count.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array, Index

#: Determinant below which C of the joints with an axis counts as singular.
_ONE_JOINT = 1e-6


@dataclass(frozen=True)
class CoupledJoint:
    """A joint that moves with an axis of another."""

    # joint and by: numbers of the joint, and of the one with whose axis it moves, from 1
    joint: int
    by: int
    factor: float  # how far, in radians or metres of the joint a radian or metre of that axis
    follows: bool = False  # whether the joint has no axis of its own


@dataclass(frozen=True)
class Coupling:
    """How the n joints of an arm follow from the m axes that its controller counts."""

    n: int
    joints: tuple[CoupledJoint, ...] = ()  # none: every joint has its own axis and no other

    @property
    def none(self) -> bool:
        """Return whether every joint is an axis of its own."""
        return not self.joints

    @cached_property
    def own(self) -> Index:
        """Return the joints that have an axis of their own, from 0, (m,)."""
        follow = {each.joint for each in self.joints if each.follows}
        return np.array([k for k in range(self.n) if k + 1 not in follow], dtype=np.intp)

    @cached_property
    def matrix(self) -> Array:
        """Return C (n, m)."""
        every = np.eye(self.n)
        for each in self.joints:
            every[each.joint - 1, each.by - 1] += each.factor
        return every[:, self.own]

    @cached_property
    def inverse(self) -> Array:
        """Return the matrix (m, n) of c by q, with zeros for joints without an axis."""
        back = np.zeros((len(self.own), self.n))
        back[:, self.own] = np.linalg.inv(self.matrix[self.own])
        return back

    @property
    def singular(self) -> bool:
        """Return whether some motion of the axes moves no joint that has an axis."""
        return bool(abs(np.linalg.det(self.matrix[self.own])) < _ONE_JOINT)

    def leads(self, joint: int) -> CoupledJoint | None:
        """Return the coupling of a joint, from 0, that only follows an uncoupled one; else None."""
        entries = [each for each in self.joints if each.joint == joint + 1]
        if len(entries) != 1 or not entries[0].follows:
            return None
        coupled = {each.joint for each in self.joints}
        return None if entries[0].by in coupled else entries[0]

    def to_joints(self, axes: Array) -> Array:
        """Return joint positions (..., n) at positions of the axes (..., m) [rad, m]."""
        return axes if self.none else np.asarray(axes @ self.matrix.T)

    def to_axes(self, q: Array) -> Array:
        """Return the positions of the axes (..., m) that bring the joints to q (..., n)."""
        return q if self.none else np.asarray(q @ self.inverse.T)

    def by_axes(self, by_joints: Array) -> Array:
        """Return derivatives (..., m) by the axes of those by the joints (..., n)."""
        return by_joints if self.none else np.asarray(by_joints @ self.matrix)

    def uncertainty(self, u_axes: Array) -> Array:
        """Return standard uncertainties of joints (P, n) of those of the axes (P, m)."""
        return u_axes if self.none else np.sqrt(u_axes**2 @ self.matrix.T**2)

    def beside_joints(self, of_axes: Array) -> Array:
        """Return values of axes (P, m) by joints (P, n), nan for joints without an axis."""
        if len(self.own) == self.n:
            return of_axes
        known = np.full((len(of_axes), self.n), np.nan)
        known[:, self.own] = of_axes
        return known

    def arrivals(self, of_axes: Array) -> Array:
        """Return the direction of arrival of each joint, (P, n), from those of the axes (P, m)."""
        if len(self.own) == self.n:
            return of_axes
        sides = np.sign(of_axes @ self.matrix.T)
        sides[:, self.own] = of_axes
        return sides

    def joint_ranges(self, axis_ranges: Array) -> Array:
        """Return the least and largest position of every joint (n, 2) within ranges of axes."""
        if self.none:
            return axis_ranges
        ends = self.matrix[..., None] * axis_ranges
        return np.column_stack([ends.min(axis=2).sum(axis=1), ends.max(axis=2).sum(axis=1)])

    def axis_ranges(self, limits: Array) -> Array:
        """Return the widest range of every axis (m, 2) whose limits (m, 2) are those of its joint.

        Stated limits may be meant for the axis itself: the range includes these too.
        """
        if self.none:
            return limits
        others = (self.matrix[self.own] - np.eye(len(self.own)))[..., None] * limits
        low = limits[:, 0] - others.max(axis=2).sum(axis=1)
        high = limits[:, 1] - others.min(axis=2).sum(axis=1)
        return np.column_stack([np.minimum(low, limits[:, 0]), np.maximum(high, limits[:, 1])])

    def turns(self, prismatic: NDArray[np.bool_]) -> Array:
        """Return the changes of the axes (m, m) by a full turn of each joint with an axis.

        These leave the pose unchanged. They are zero for joints that slide, and for those whose
        turn moves another joint by other than full turns.
        """
        shifts = 2.0 * np.pi * self.inverse.T[self.own]
        moved = self.to_joints(shifts) if not self.none else shifts
        whole = np.where(prismatic, moved == 0.0, np.isclose(np.sin(moved / 2.0), 0.0, atol=1e-9))
        free = whole.all(axis=1) & ~prismatic[self.own]
        return np.asarray(shifts * free[:, None])
