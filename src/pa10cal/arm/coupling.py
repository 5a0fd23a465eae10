"""Coupled joints: joint positions q = C c for positions c of the axes that a controller counts.

For most controllers joints and axes are the same. Some count joint 3 from the horizontal (FANUC,
parallelograms); gears of a wrist turn its last joint with another axis; a quill rises as it turns;
and one motor may drive several joints (a telescope). Positions are converted where a log becomes
observations, and back where commands are written; everything in between has joint positions.

Bars, gears and screws move a joint by the drive of another. Such a drive carries part of that
joint's torque (virtual work: tau_drives = D^T tau_joints), and as it gives way it moves both. Where
only the controller adds the other position, the motor is at the joint and moves that alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array, Index

#: Determinant of C, of the joints with an axis, below which it counts as singular.
_SINGULAR = 1e-6


@dataclass(frozen=True)
class CoupledJoint:
    """A joint that moves with the axis of another."""

    # numbers, from 1, of the joint, and of the joint whose axis moves it too
    joint: int
    by: int
    factor: float  # its motion [rad or m] for a unit [rad or m] of that axis
    follows: bool = False  # whether the joint has no axis of its own
    # whether only the controller adds that motion, and the drive of that axis does not make it
    counted_only: bool = False


@dataclass(frozen=True)
class Coupling:
    """How the n joints of an arm follow from the m axes that its controller counts."""

    n: int
    joints: tuple[CoupledJoint, ...] = ()  # empty: every joint moves with its own axis only

    @property
    def none(self) -> bool:
        """Return whether joints and axes are the same."""
        return not self.joints

    @cached_property
    def own(self) -> Index:
        """Return the joints that have an axis of their own, from 0, (m,)."""
        followers = {coupled.joint for coupled in self.joints if coupled.follows}
        return np.array([k for k in range(self.n) if k + 1 not in followers], dtype=np.intp)

    @cached_property
    def matrix(self) -> Array:
        """Return C (n, m)."""
        return self._moved_by(self.joints)[:, self.own]

    @cached_property
    def by_drives(self) -> Array:
        """Return D (n, n), by which joints move with the drive of each; zero where one has none."""
        matrix = np.zeros((self.n, self.n))
        mechanical = tuple(coupled for coupled in self.joints if not coupled.counted_only)
        matrix[:, self.own] = self._moved_by(mechanical)[:, self.own]
        return matrix

    def _moved_by(self, joints: tuple[CoupledJoint, ...]) -> Array:
        """Return the motions of the joints (n, n) by the axis of each of them."""
        square = np.eye(self.n)
        for coupled in joints:
            square[coupled.joint - 1, coupled.by - 1] += coupled.factor
        return square

    @cached_property
    def inverse(self) -> Array:
        """Return the matrix (m, n) that gives c by q; joints without an axis have zeros."""
        inverse = np.zeros((len(self.own), self.n))
        inverse[:, self.own] = np.linalg.inv(self.matrix[self.own])
        return inverse

    @property
    def singular(self) -> bool:
        """Return whether some motion of the axes leaves all joints with an axis at rest."""
        return bool(abs(np.linalg.det(self.matrix[self.own])) < _SINGULAR)

    def leads(self, joint: int) -> CoupledJoint | None:
        """Return the coupling of a joint, from 0, that only follows an uncoupled one; else None."""
        entries = [coupled for coupled in self.joints if coupled.joint == joint + 1]
        if len(entries) != 1 or not entries[0].follows:
            return None
        leader_is_coupled = any(coupled.joint == entries[0].by for coupled in self.joints)
        return None if leader_is_coupled else entries[0]

    def to_joints(self, axes: Array) -> Array:
        """Return joint positions (..., n) for positions of the axes (..., m) [rad, m]."""
        return axes if self.none else np.asarray(axes @ self.matrix.T)

    def to_axes(self, q: Array) -> Array:
        """Return positions of the axes (..., m) for joint positions (..., n)."""
        return q if self.none else np.asarray(q @ self.inverse.T)

    def by_axes(self, by_joints: Array) -> Array:
        """Return derivatives by the axes (..., m) from those by the joints (..., n)."""
        return by_joints if self.none else np.asarray(by_joints @ self.matrix)

    def at_drives(self, of_joints: Array) -> Array:
        """Return torques of the drives (P, n, ...) by those of the joints, or derivatives of these.

        Forces [N] of drives that slide. A joint without a drive has zeros.
        """
        if self.none:
            return of_joints
        return np.asarray(np.einsum("jd,pj...->pd...", self.by_drives, of_joints))

    def moved_by_drives(self, by_joints: Array) -> Array:
        """Return derivatives by the motions of drives (..., n) from those by the joints' own."""
        return by_joints if self.none else np.asarray(by_joints @ self.by_drives)

    def with_drives(self, of_drives: Array) -> Array:
        """Return the motions of joints (..., n) for motions of drives (..., n) [rad, m]."""
        return of_drives if self.none else np.asarray(of_drives @ self.by_drives.T)

    def uncertainty(self, u_axes: Array) -> Array:
        """Return standard uncertainties of joints (P, n) from those of the axes (P, m)."""
        return u_axes if self.none else np.sqrt(u_axes**2 @ self.matrix.T**2)

    def beside_joints(self, of_axes: Array) -> Array:
        """Return values of axes (P, m) as values of joints (P, n), nan where one has no axis."""
        if len(self.own) == self.n:
            return of_axes
        of_joints = np.full((len(of_axes), self.n), np.nan)
        of_joints[:, self.own] = of_axes
        return of_joints

    def arrivals(self, of_axes: Array) -> Array:
        """Return the direction of arrival of each joint, (P, n), from those of the axes (P, m)."""
        if len(self.own) == self.n:
            return of_axes
        directions = np.sign(of_axes @ self.matrix.T)
        directions[:, self.own] = of_axes
        return directions

    def joint_ranges(self, axis_ranges: Array) -> Array:
        """Return the least and largest position of every joint (n, 2) for ranges of axes (m, 2)."""
        if self.none:
            return axis_ranges
        ends = self.matrix[..., None] * axis_ranges
        return np.column_stack([ends.min(axis=2).sum(axis=1), ends.max(axis=2).sum(axis=1)])

    def axis_ranges(self, limits: Array) -> Array:
        """Return the widest range of every axis (m, 2) by the limits (m, 2) of its joint.

        Stated limits may be meant for the axis itself: the range includes them too.
        """
        if self.none:
            return limits
        others = (self.matrix[self.own] - np.eye(len(self.own)))[..., None] * limits
        low = limits[:, 0] - others.max(axis=2).sum(axis=1)
        high = limits[:, 1] - others.min(axis=2).sum(axis=1)
        return np.column_stack([np.minimum(low, limits[:, 0]), np.maximum(high, limits[:, 1])])

    def turns(self, prismatic: NDArray[np.bool_]) -> Array:
        """Return the changes of the axes (m, m) by which each joint with an axis turns once.

        They leave the pose unchanged, and are zero where none does: for a joint that slides, and
        where another joint would slide or not turn a whole number of times.
        """
        shifts = 2.0 * np.pi * self.inverse.T[self.own]
        moved = self.to_joints(shifts) if not self.none else shifts
        whole = np.where(prismatic, moved == 0.0, np.isclose(np.sin(moved / 2.0), 0.0, atol=1e-9))
        free = whole.all(axis=1) & ~prismatic[self.own]
        return np.asarray(shifts * free[:, None])
