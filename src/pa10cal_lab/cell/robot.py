"""One individual robot as it was built: what a campaign's truth is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array

# What a robot carries on its flange: the tooling-ball apparatus of the paper, or reflectors.

#: Three balls in front of four 0.31 m rods, 2.4 kg (Section II.B of the paper); points in the
#: flange frame.
APPARATUS_MASS_KG = 2.4
APPARATUS_COM_M = np.array([0.0, 0.0, 0.190])
LOAD_POINT_M = np.array([0.0, 0.0, 0.030])
BALL_NAMES = ("A", "B", "C")
BALLS_DESIGN_M = 1e-3 * np.array([[95.0, 0.0, 310.0], [-50.0, 80.0, 310.0], [-50.0, -80.0, 312.0]])
BALL_DIAMETER_M = 0.0254
_BALL_MAKING_M = 5e-5

#: Reflectors as designed: on a ring around the flange's axis, every other one further out.
RING_RADIUS_M = 0.100
RING_HEIGHTS_M = (0.100, 0.140)
TOOL_COM_M = np.array([0.0, 0.0, 0.060])


def apparatus_payload() -> SimulatedPayload:
    """Return the weight of the tooling-ball apparatus."""
    return SimulatedPayload(APPARATUS_MASS_KG, APPARATUS_COM_M, LOAD_POINT_M)


def draw_balls(measured_to_mm: float, rng: np.random.Generator) -> Targets:
    """Draw the balls of one apparatus as they were made, stated as a separate measurement has them.

    Args:
        measured_to_mm: standard deviation of the separate measurement, each coordinate.
    """
    balls_m = BALLS_DESIGN_M + rng.normal(0.0, _BALL_MAKING_M, BALLS_DESIGN_M.shape)
    error_m = 1e-3 * measured_to_mm * rng.standard_normal(balls_m.shape)
    return Targets(BALL_NAMES, balls_m, balls_m + error_m)


def tool_payload(mass_kg: float) -> SimulatedPayload:
    """Return the weight of a tool with reflectors."""
    return SimulatedPayload(mass_kg, TOOL_COM_M, LOAD_POINT_M)


def ring_of_targets(count: int) -> Targets:
    """Return `count` reflectors whose stated places are their true ones."""
    turn = 2.0 * np.pi * np.arange(count) / count
    points_m = np.column_stack(
        [
            RING_RADIUS_M * np.cos(turn),
            RING_RADIUS_M * np.sin(turn),
            np.resize(RING_HEIGHTS_M, count),
        ]
    ).round(6)
    return Targets(tuple(f"T{number}" for number in range(1, count + 1)), points_m, points_m)


@dataclass(frozen=True)
class Departures:
    """What every row of the arm departs by from its nominal figure; all (n,)."""

    a_m: Array  # lengths along x
    alpha_rad: Array  # twists
    d_m: Array  # offsets along z
    theta_rad: Array  # joint offsets
    beta_rad: Array  # Hayati angles

    @classmethod
    def none(cls, n: int) -> Departures:
        """Return no departure at all, for an arm of `n` joints."""
        return cls(*np.zeros((5, n)))

    @classmethod
    def named(cls, n: int, values: Mapping[str, float]) -> Departures:
        """Return what parameters of rows say [m, rad]: `delta_a_1`, …, `delta_beta_<n>`."""
        every = cls.none(n).by_name | dict(values)
        return cls(*np.array(list(every.values())).reshape(5, n))

    @property
    def by_name(self) -> dict[str, float]:
        """Every departure by the name of its parameter: `delta_a_1`, …"""
        return {
            f"delta_{field.name.rsplit('_', 1)[0]}_{row}": value
            for field in fields(self)
            for row, value in enumerate(getattr(self, field.name).tolist(), start=1)
        }


@dataclass(frozen=True)
class Springs:
    """Cubic springs tau = k_lin delta + k_cub delta^3 between motor and link, equation (1)."""

    k_lin: Array  # (n,) [N m/rad]; infinite where the joint is rigid
    k_cub: Array  # (n,) [N m/rad^3]
    source: str  # where the figures come from, for the record of the truth

    @property
    def flexible(self) -> NDArray[np.bool_]:
        """(n,) which joints yield."""
        return np.isfinite(self.k_lin)

    def step(self, delta: Array, tau: Array) -> Array:
        """Return one Newton step of k_lin delta + k_cub delta^3 = tau in the flexible joints.

        Args:
            delta: (..., n) deflections so far; those of rigid joints stay.
            tau: (..., n) torques.
        """
        soft = self.flexible
        k_lin, k_cub, d = self.k_lin[soft], self.k_cub[soft], delta[..., soft]
        stepped = delta.copy()
        excess = k_lin * d + k_cub * d**3 - tau[..., soft]
        stepped[..., soft] = d - excess / (k_lin + 3.0 * k_cub * d**2)
        return stepped

    @classmethod
    def rigid(cls, n: int) -> Springs:
        """Return no spring at all, for an arm of `n` joints."""
        return cls(np.full(n, np.inf), np.zeros(n), "rigid")


@dataclass(frozen=True)
class SimulatedPayload:
    """What an arm carries; points in the end-effector frame."""

    mass_kg: float  # mass of the tool
    com_m: Array  # (3,) its centre of mass
    load_point_m: Array  # (3,) where an external load hangs


@dataclass(frozen=True)
class Targets:
    """B targets (tooling balls, reflectors) on the flange; points in the end-effector frame."""

    names: tuple[str, ...]  # B names
    p_ee_m: Array  # (B, 3) where they are
    p_ee_stated_m: Array  # (B, 3) where the campaign says they are


@dataclass(frozen=True)
class Robot:
    """One individual robot with its tool, standing in front of the instrument."""

    arm: Arm  # the arm as its maker describes it
    mechanism: Mechanism  # its joints, links and payload as they are
    springs: Springs  # its joint springs
    T_instr_base: Array  # (4, 4) its base in the instrument's frame [m]
    targets: Targets  # what the instrument measures
    # (4, 4) the target of a tracker of poses, in the end-effector frame [m]; the campaign says
    # that it is the end-effector frame itself
    T_ee_target: Array
    departures: Departures | None  # by what its rows depart; None where its axes depart in any way

    def T_instr_target(self, T_base_ee: Array) -> Array:
        """Return where the target of a tracker of poses is, for end-effectors (P, 4, 4)."""
        T: Array = self.T_instr_base @ T_base_ee @ self.T_ee_target
        return T

    def p_instr_targets_m(self, T_base_ee: Array, shift_m: Array | None = None) -> Array:
        """Return where the targets are in the instrument's frame, (P, B, 3).

        Args:
            T_base_ee: (P, 4, 4) end-effectors.
            shift_m: (P, 3) displacement of the tool, along the end-effector's axes.
        """
        T_instr_ee = self.T_instr_base @ T_base_ee
        p_ee_m = self.targets.p_ee_m[None]
        if shift_m is not None:
            p_ee_m = p_ee_m + shift_m[:, None, :]
        p_ee_m = np.broadcast_to(p_ee_m, (len(T_base_ee), *p_ee_m.shape[1:]))
        along = np.einsum("pij,pbj->pbi", T_instr_ee[:, :3, :3], p_ee_m)
        points: Array = along + T_instr_ee[:, None, :3, 3]
        return points


# The mechanism of one robot in many poses at once: placements, gravity torques, moments.
#
# Every joint moves about or along the z axis of a frame of its own, which sits anywhere on the
# link before it: a placement is any rigid motion, so that axes may be off in all directions. Poses
# are products of placements and joint motions; forces and moments are carried from the tool
# inward. Neither knows of Denavit-Hartenberg parameters. Tests hold both against pinocchio.

#: Gravity along the axes of the robot base [m/s^2].
GRAVITY_M_S2 = np.array([0.0, 0.0, -9.80665])


@dataclass(frozen=True)
class Strain:
    """How the structure has moved from its unloaded shape, in each of P configurations.

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
        return Strain(
            *(getattr(self, each.name) + getattr(other, each.name) for each in fields(self))
        )

    def distance(self, other: Strain) -> float:
        """Return the largest difference of any component [rad, m or 1]."""
        return max(
            float(np.abs(getattr(self, each.name) - getattr(other, each.name)).max(initial=0.0))
            for each in fields(self)
        )


@dataclass(frozen=True)
class SimulatedStatics:
    """What weights do to an arm at rest in P poses."""

    torque_Nm: Array  # (P, n) what the motors exert (forces [N] of prismatic joints)
    # (P, n, 3) moment that each link carries at its far end, about and along the axes of the frame
    # from which the next joint moves (zero for the last link, whose payload is part of it)
    link_Nm: Array
    link_N: Array  # (P, n, 3) force that each link carries there, along the same axes
    base_Nm: Array  # (P, 3) overturning moment about the base's origin, along base axes


@dataclass(frozen=True)
class Mechanism:
    """Joints and links of one robot, with their weights."""

    # (n, 4, 4) frame of each joint at position 0, in the frame that the joint before it carries
    # along (the base, for the first) [m]
    placements: Array
    T_last_ee: Array  # (4, 4) end-effector in the frame that the last joint carries along [m]
    slides: NDArray[np.bool_]  # (n,) whether the joint slides along its z axis
    mass_kg: Array  # (n,) masses of the links, zero where they are not known
    com_m: Array  # (n, 3) their centres of mass in the frame that their joint carries along
    payload: SimulatedPayload  # what the arm carries

    @classmethod
    def of(
        cls,
        arm: Arm,
        departures: Departures,
        payload: SimulatedPayload,
        mass_kg: Array | None = None,
    ) -> Mechanism:
        """Lay out the rows of an arm.

        Args:
            mass_kg: (n,) true masses of its links; None for those of the description, and links
                without weight where that has none.
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
        """(n, 4, 4) end of each link in the frame that its joint carries along [m]."""
        return np.concatenate([self.placements[1:], self.T_last_ee[None]])

    @cached_property
    def spans_m(self) -> Array:
        """(n, 3) from each joint to the end of its link, along the axes of that end."""
        ends = self.link_ends
        spans: Array = np.einsum("kij,ki->kj", ends[:, :3, :3], ends[:, :3, 3])
        return spans

    @cached_property
    def long_links(self) -> tuple[int, ...]:
        """Upper arm and forearm, as numbers from 0 in the order of the chain.

        Of the links after the first and before the last they are the two longest; an arm of fewer
        than four joints has fewer.
        """
        length_m = np.linalg.norm(self.spans_m, axis=1)
        inner = range(1, self.n - 1)
        return tuple(sorted(sorted(inner, key=lambda link: -float(length_m[link]))[:2]))

    def T_base_ee(self, q: Array, strain: Strain | None = None) -> Array:
        """Return the end-effector in the base, (P, 4, 4) [m], with the links at `q` (P, n)."""
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
        """Return torques and moments (P, …) that go with the links at rest at `q` (P, n).

        Args:
            q: (P, n) positions of the links [rad, or m of a prismatic joint].
            load_N: (P,) weights that hang at the load point.
            strain: of the structure; None for its unloaded shape.
        """
        placements, T_last_ee = self._strained(strain)
        cos, sin = np.cos(q), np.sin(q)
        down = self._gravity(placements, cos, sin)
        tau, (link_Nm, link_N) = np.empty(q.shape), np.zeros((2, *q.shape, 3))
        force, moment = self._hold_up_payload(T_last_ee, down[-1], load_N)
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
                # The link carries the opposite of what holds it.
                link_Nm[:, joint - 1], link_N[:, joint - 1] = -moment, -force
            R, p = placements[joint][..., :3, :3], placements[joint][..., :3, 3]
            force = np.einsum("...ij,...j->...i", R, force)
            moment = np.einsum("...ij,...j->...i", R, moment) + np.cross(p, force)
        return SimulatedStatics(tau, link_Nm, link_N, -moment)

    def _strained(self, strain: Strain | None) -> tuple[list[Array], Array]:
        """Return placements of the joints and the end-effector's, (4, 4) or (P, 4, 4) each."""
        if strain is None:
            return list(self.placements), self.T_last_ee
        ends = [*self.placements[1:], self.T_last_ee]
        moved = []
        for link, end in enumerate(ends):
            T = np.tile(end, (len(strain.stretch), 1, 1))
            turn = Rotation.from_rotvec(strain.turn_rad[:, link]).as_matrix()
            T[:, :3, 3] *= 1.0 + strain.stretch[:, link, None]
            T[:, :3, 3] += strain.shift_m[:, link] @ end[:3, :3].T
            T[:, :3, :3] = end[:3, :3] @ turn
            moved.append(T)
        T_base = np.tile(np.eye(4), (len(strain.stretch), 1, 1))
        T_base[:, :3, :3] = Rotation.from_rotvec(strain.base_turn_rad).as_matrix()
        T_base[:, :3, 3] = strain.base_shift_m
        return [T_base @ self.placements[0], *moved[:-1]], moved[-1]

    def _carried_along(self, placement: Array, joint: int, q: Array) -> Array:
        """Return what a joint at `q` (P,) carries along, seen from the joint before it."""
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
        """Return gravity (P, 3) along the axes of what each joint carries along."""
        down, found = np.broadcast_to(GRAVITY_M_S2, (len(cos), 3)), []
        for joint, placement in enumerate(placements):
            down = np.einsum("...ji,...j->...i", placement[..., :3, :3], down)
            if not self.slides[joint]:
                down = _turned_about_z(down, cos[:, joint], -sin[:, joint])
            found.append(down)
        return found

    def _hold_up_payload(self, T_last_ee: Array, down: Array, load_N: Array) -> tuple[Array, Array]:
        """Return force and moment (P, 3) on tool and load, about and along the last link's axes."""
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
    """Return the constant motions (n, 4, 4) before and after each row's joint.

    The frames before the first row and after the last are not in them.
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
