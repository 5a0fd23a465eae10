"""Joints and links of one robot in many poses at once: kinematics and statics.

Every joint moves about or along the z axis of a frame that has any pose, its placement, on the link
before it: axes may deviate in all directions. Poses are products of placements and joint motions;
forces and moments are carried from the tool inward. Neither uses Denavit-Hartenberg parameters.
Tests compare both with pinocchio.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array

#: Gravity along the axes of the robot base [m/s^2].
GRAVITY_M_S2 = np.array([0.0, 0.0, -9.80665])


@dataclass(frozen=True)
class Departures:
    """Deviations of the rows of an arm from nominal; all (n,)."""

    a_m: Array  # lengths along x
    alpha_rad: Array  # twists
    d_m: Array  # offsets along z
    theta_rad: Array  # joint offsets
    beta_rad: Array  # Hayati angles

    @classmethod
    def none(cls, n: int) -> Departures:
        """Return no deviation, for an arm of `n` joints."""
        return cls(*np.zeros((5, n)))

    @classmethod
    def named(cls, n: int, values: Mapping[str, float]) -> Departures:
        """Return the deviations of parameters by name [m, rad]: `delta_a_1`, …; others are zero."""
        by_name = cls.none(n).by_name | dict(values)
        return cls(*np.array(list(by_name.values())).reshape(5, n))

    @property
    def by_name(self) -> dict[str, float]:
        """Return every deviation by the name of its parameter: `delta_a_1`, …"""
        return {
            f"delta_{field.name.rsplit('_', 1)[0]}_{row}": value
            for field in fields(self)
            for row, value in enumerate(getattr(self, field.name).tolist(), start=1)
        }


@dataclass(frozen=True)
class SimulatedPayload:
    """What an arm carries; points in the end-effector frame."""

    mass_kg: float  # mass of the tool
    com_m: Array  # (3,) its centre of mass
    load_point_m: Array  # (3,) where an external load hangs


@dataclass(frozen=True)
class Strain:
    """Deformation of the structure in each of P configurations.

    A link's end is the frame in which the next joint moves (the flange, for the last link).
    """

    base_turn_rad: Array  # (P, 3) small rotation of the base about its origin, along base axes
    base_shift_m: Array  # (P, 3) displacement of the base along base axes
    turn_rad: Array  # (P, n, 3) rotation of each link's end, along the axes of that end
    shift_m: Array  # (P, n, 3) displacement of each link's end, along the axes of that end
    stretch: Array  # (P, n) relative growth of each link

    @classmethod
    def none(cls, poses: int, joints: int) -> Strain:
        """Return the unloaded shape."""
        return cls(
            np.zeros((poses, 3)),
            np.zeros((poses, 3)),
            np.zeros((poses, joints, 3)),
            np.zeros((poses, joints, 3)),
            np.zeros((poses, joints)),
        )

    def __add__(self, other: Strain) -> Strain:
        return Strain(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    def distance(self, other: Strain) -> float:
        """Return the largest difference of any component [rad, m or 1]."""
        return max(
            float(np.abs(getattr(self, f.name) - getattr(other, f.name)).max(initial=0.0))
            for f in fields(self)
        )


@dataclass(frozen=True)
class SimulatedStatics:
    """Loads of an arm at rest in P poses by its weights."""

    torque_Nm: Array  # (P, n) torques of the motors (forces [N] of prismatic joints)
    # (P, n, 3) moment that each link carries at its far end, about and along the axes of the frame
    # from which the next joint moves (zero for the last link, whose payload is part of it)
    link_Nm: Array
    link_N: Array  # (P, n, 3) force that each link carries there, along the same axes
    base_Nm: Array  # (P, 3) overturning moment about the base's origin, along base axes


@dataclass(frozen=True)
class Mechanism:
    """Joints and links of one robot, with their weights."""

    # (n, 4, 4) frame of each joint at position 0, in the frame that moves with the joint before it
    # (the base, for the first) [m]
    placements: Array
    T_last_ee: Array  # (4, 4) end-effector in the frame that moves with the last joint [m]
    slides: NDArray[np.bool_]  # (n,) whether the joint slides along its z axis
    mass_kg: Array  # (n,) masses of the links, zero where they are not known
    com_m: Array  # (n, 3) their centres of mass in the frame that moves with their joint
    payload: SimulatedPayload

    @classmethod
    def of(
        cls,
        arm: Arm,
        departures: Departures,
        payload: SimulatedPayload,
        mass_kg: Array | None = None,
    ) -> Mechanism:
        """Return the mechanism of an arm's rows with their deviations.

        Args:
            mass_kg: (n,) true masses of its links; None for those of the description, or zero where
                it has none.
        """
        before, after = _row_parts(arm, departures)
        placements = before.copy()
        placements[0] = arm.T_base_row1 @ before[0]
        placements[1:] = after[:-1] @ before[1:]
        com_m = np.zeros((arm.n, 3)) if arm.com_m is None else arm.com_m
        described_kg = np.zeros(arm.n) if arm.mass_kg is None else arm.mass_kg
        return cls(
            placements=placements,
            T_last_ee=after[-1] @ arm.T_row_n_ee,
            slides=arm.prismatic,
            mass_kg=described_kg if mass_kg is None else mass_kg,
            com_m=np.einsum("kij,kj->ki", after[:, :3, :3], com_m) + after[:, :3, 3],
            payload=payload,
        )

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.placements)

    @cached_property
    def link_ends(self) -> Array:
        """Return the end of each link in the frame that moves with its joint, (n, 4, 4) [m]."""
        return np.concatenate([self.placements[1:], self.T_last_ee[None]])

    @cached_property
    def spans_m(self) -> Array:
        """Return the vector from each joint to its link's end, along the end's axes, (n, 3)."""
        ends = self.link_ends
        return np.asarray(np.einsum("kij,ki->kj", ends[:, :3, :3], ends[:, :3, 3]))

    @cached_property
    def long_links(self) -> tuple[int, ...]:
        """Return upper arm and forearm, as numbers from 0 in the order of the chain.

        They are the two longest links between the first and the last; a short arm has fewer.
        """
        length_m = np.linalg.norm(self.spans_m, axis=1)
        inner = range(1, self.n - 1)
        return tuple(sorted(sorted(inner, key=lambda link: -float(length_m[link]))[:2]))

    def T_base_ee(self, q: Array, strain: Strain | None = None) -> Array:
        """Return the end-effector in the base, (P, 4, 4) [m], for link positions `q` (P, n)."""
        placements, T_last_ee = self._strained(strain)
        T = np.eye(4)
        for joint in range(self.n):
            T = T @ self._carried_along(placements[joint], joint, q[:, joint])
        return np.broadcast_to(T @ T_last_ee, (len(q), 4, 4)).copy()

    def T_base_joints(self, q: Array) -> Array:
        """Return the frames of the joints in the base, (n, P, 4, 4) [m]; z is the joint's axis."""
        T, frames = np.eye(4), []
        for joint in range(self.n):
            T = T @ self._carried_along(self.placements[joint], joint, q[:, joint])
            frames.append(T)
        return np.array(frames)

    def statics(self, q: Array, load_N: Array, strain: Strain | None = None) -> SimulatedStatics:
        """Return torques and moments of the arm at rest.

        Args:
            q: (P, n) positions of the links [rad, or m of a prismatic joint].
            load_N: (P,) weights that hang at the load point.
            strain: of the structure; None for its unloaded shape.
        """
        placements, T_last_ee = self._strained(strain)
        cos, sin = np.cos(q), np.sin(q)
        down = self._gravity(placements, cos, sin)
        tau, (link_Nm, link_N) = np.empty(q.shape), np.zeros((2, *q.shape, 3))
        # Force and moment by which the rest of the arm holds everything beyond a joint.
        force, moment = self._hold_payload(T_last_ee, down[-1], load_N)
        for joint in reversed(range(self.n)):
            weight = self.mass_kg[joint] * down[joint]
            force = force - weight
            moment = moment - np.cross(self.com_m[joint], weight)
            tau[:, joint] = (force if self.slides[joint] else moment)[:, 2]
            if self.slides[joint]:
                lever_m = q[:, joint, None] * np.array([0.0, 0.0, 1.0])
                moment = moment + np.cross(lever_m, force)
            else:
                force = _turned_about_z(force, cos[:, joint], sin[:, joint])
                moment = _turned_about_z(moment, cos[:, joint], sin[:, joint])
            if joint:
                # The link before carries the opposite.
                link_Nm[:, joint - 1], link_N[:, joint - 1] = -moment, -force
            R, p = placements[joint][..., :3, :3], placements[joint][..., :3, 3]
            force = np.einsum("...ij,...j->...i", R, force)
            moment = np.einsum("...ij,...j->...i", R, moment) + np.cross(p, force)
        return SimulatedStatics(tau, link_Nm, link_N, -moment)

    def _strained(self, strain: Strain | None) -> tuple[list[Array], Array]:
        """Return the placements of joints and end-effector under strain, (P, 4, 4) each.

        Without strain they are (4, 4) each.
        """
        if strain is None:
            return list(self.placements), self.T_last_ee
        ends = [*self.placements[1:], self.T_last_ee]
        strained_ends = []
        for link, end in enumerate(ends):
            T = np.tile(end, (len(strain.stretch), 1, 1))
            turn = Rotation.from_rotvec(strain.turn_rad[:, link]).as_matrix()
            T[:, :3, 3] *= 1.0 + strain.stretch[:, link, None]
            T[:, :3, 3] += strain.shift_m[:, link] @ end[:3, :3].T
            T[:, :3, :3] = end[:3, :3] @ turn
            strained_ends.append(T)
        T_base = np.tile(np.eye(4), (len(strain.stretch), 1, 1))
        T_base[:, :3, :3] = Rotation.from_rotvec(strain.base_turn_rad).as_matrix()
        T_base[:, :3, 3] = strain.base_shift_m
        return [T_base @ self.placements[0], *strained_ends[:-1]], strained_ends[-1]

    def _carried_along(self, placement: Array, joint: int, q: Array) -> Array:
        """Return the frame that moves with a joint at `q` (P,), in that of the joint before."""
        T = np.broadcast_to(placement, (len(q), 4, 4)).copy()
        if self.slides[joint]:
            T[:, :3, 3] += q[:, None] * placement[..., :3, 2]
            return T
        cos, sin = np.cos(q)[:, None], np.sin(q)[:, None]
        x, y = placement[..., :3, 0], placement[..., :3, 1]
        T[:, :3, 0] = cos * x + sin * y
        T[:, :3, 1] = cos * y - sin * x
        return T

    def _gravity(self, placements: list[Array], cos: Array, sin: Array) -> list[Array]:
        """Return gravity (P, 3) along the axes of the frame that moves with each joint."""
        down, by_joint = np.broadcast_to(GRAVITY_M_S2, (len(cos), 3)), []
        for joint, placement in enumerate(placements):
            down = np.einsum("...ji,...j->...i", placement[..., :3, :3], down)
            if not self.slides[joint]:
                down = _turned_about_z(down, cos[:, joint], -sin[:, joint])
            by_joint.append(down)
        return by_joint

    def _hold_payload(self, T_last_ee: Array, down: Array, load_N: Array) -> tuple[Array, Array]:
        """Return force and moment (P, 3) that hold tool and load, in the last link's frame."""
        R, p = T_last_ee[..., :3, :3], T_last_ee[..., :3, 3]
        tool = self.payload.mass_kg * down
        load = (load_N / np.linalg.norm(GRAVITY_M_S2))[:, None] * down
        moment = np.cross(R @ self.payload.com_m + p, tool)
        moment += np.cross(R @ self.payload.load_point_m + p, load)
        return -(tool + load), -moment


def _turned_about_z(vectors: Array, cos: Array, sin: Array) -> Array:
    """Return vectors (P, 3) turned about z by angles of these cosines and sines (P,)."""
    x, y, z = vectors.T
    return np.column_stack([cos * x - sin * y, sin * x + cos * y, z])


def _row_parts(arm: Arm, departures: Departures) -> tuple[Array, Array]:
    """Return the constant transforms (n, 4, 4) of each row before and after its joint.

    They do not include the arm's constant frames before the first row and after the last.
    """
    before, after = [], []
    for i in range(arm.n):
        offset = _turn("z", arm.theta_rad[i] + departures.theta_rad[i])
        along_z = _slide(2, arm.d_m[i] + departures.d_m[i])
        along_x = _slide(0, arm.a_m[i] + departures.a_m[i])
        twist = _turn("x", arm.alpha_rad[i] + departures.alpha_rad[i])
        hayati = _turn("y", arm.beta_rad[i] + departures.beta_rad[i])
        if arm.convention == "standard":
            before.append(offset)
            after.append(along_z @ along_x @ twist @ hayati)
        else:
            before.append(hayati @ twist @ along_x @ offset)
            after.append(along_z)
    return np.array(before), np.array(after)


def _turn(axis: str, angle_rad: float) -> Array:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler(axis, angle_rad).as_matrix()
    return T


def _slide(axis: int, distance_m: float) -> Array:
    T = np.eye(4)
    T[axis, 3] = distance_m
    return T
