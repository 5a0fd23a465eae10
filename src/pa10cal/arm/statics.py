"""States of measured poses, and statics: loads of joints, links and base by weights.

The load of a joint depends on the weights beyond it only by their total mass and first moment,
which one cumulative sum from the end of the chain gives for all joints and poses. Torques are
linear in mass and first moment of every link; the coefficients are the derivatives by these.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain, frames
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Rows, take_rows
from pa10cal.errors import ArmError


@dataclass(frozen=True)
class Hung:
    """The weights of an arm in P poses and where they act, to compute loads of other weights."""

    mass_kg: Array  # (P, n) mass of each link and all beyond it, apparatus and load included
    moment_kg_m: Array  # (P, n, 3) first moment of that mass about the base's origin
    # (P, n, 4, 3) derivative of a link's first moment about the base's origin by its mass, added at
    # its centre, and by its three first moments about the centre
    by_link: Array
    by_apparatus: Array  # (P, 3) the same derivative by the mass of the apparatus
    ends: Array  # (P, n - 1, 4, 4) far ends of the links but the last: frames of the next joints
    gravity_m_s2: Array  # (P, 3) gravity along base axes
    by_level: (
        Array  # (P, 2, 3) derivative of gravity by small rotations about two axes normal to it
    )

    def with_weights(self, amounts: Array) -> Hung:
        """Return the weights changed by amounts (4 n + 3,), see `StaticLoads.by_weights`."""
        n = self.mass_kg.shape[1]
        of_links = amounts[: 4 * n].reshape(n, 4)
        apparatus_kg, *level = amounts[4 * n :]
        mass_kg = of_links[:, 0].copy()
        mass_kg[-1] += apparatus_kg
        moment = np.einsum("pjkc,jk->pjc", self.by_link, of_links)
        moment[:, -1] += apparatus_kg * self.by_apparatus
        return replace(
            self,
            mass_kg=self.mass_kg + mass_kg[::-1].cumsum()[::-1],
            moment_kg_m=self.moment_kg_m + moment[:, ::-1].cumsum(axis=1)[:, ::-1],
            gravity_m_s2=self.gravity_m_s2 + np.array(level) @ self.by_level,
        )

    def loads(self) -> tuple[Array, Array, Array]:
        """Return `link_Nm`, `link_N` and `base_Nm` of `StaticLoads`."""
        link_Nm, link_N = np.zeros((2, *self.moment_kg_m.shape))
        gravity, R_ends = self.gravity_m_s2[:, None], self.ends[..., :3, :3]
        about_ends = self.moment_kg_m[:, 1:] - self.mass_kg[:, 1:, None] * self.ends[..., :3, 3]
        link_Nm[:, :-1] = np.einsum("pjba,pjb->pja", R_ends, np.cross(about_ends, gravity))
        link_N[:, :-1] = np.einsum("pjba,pb->pja", R_ends, self.gravity_m_s2)
        link_N[:, :-1] *= self.mass_kg[:, 1:, None]
        return link_Nm, link_N, np.cross(self.moment_kg_m[:, 0], self.gravity_m_s2)


@dataclass(frozen=True)
class StaticLoads:
    """Loads of joints and structure by weights in P poses."""

    # (P, n, 3) moment that each link carries at its far end, where the next joint turns, along the
    # axes of that end (zero for the last link)
    link_Nm: Array
    link_N: Array  # (P, n, 3) force that it carries there, along the same axes (zero for the last)
    base_Nm: Array  # (P, 3) overturning moment about the base's origin, along base axes
    joint_Nm: Array  # (P, n) torques with which the joints hold links, apparatus and load
    down_ee: Array  # (P, 3) direction of gravity along the end-effector's axes, a unit vector
    # (P, n, 4 n + 3) derivative of `joint_Nm`: by mass, added at its centre, and by the three first
    # moments about that centre, of link 1, 2, …; by the mass of the apparatus; by small rotations
    # of gravity about two axes normal to it
    by_weights: Array
    by_load: Array  # (P, n) derivative of `joint_Nm` by the external load [N m/N]
    hung: Hung  # the weights that make these loads

    def with_weights(self, amounts: Array) -> StaticLoads:
        """Return the loads of links and base with weights changed by amounts (4 n + 3,).

        Amounts are ordered as the columns of `by_weights`. `joint_Nm` is not changed: the term
        `Weights` adds the change of torques.
        """
        hung = self.hung.with_weights(amounts)
        link_Nm, link_N, base_Nm = hung.loads()
        return replace(self, link_Nm=link_Nm, link_N=link_N, base_Nm=base_Nm, hung=hung)


@dataclass(frozen=True)
class ObservedTargets:
    """How P measured poses follow from readings of B targets."""

    p_instr_targets_m: Array  # (P, B, 3) positions of the targets in the instrument's frame
    # (P, 6, 3 B) derivative of the pose (position, small rotation, along the end-effector's axes)
    # by the errors of the targets' readings
    pose_by_targets: Array
    # (P, t, 3 B) derivative of the targets' coordinates in the end-effector frame by those errors,
    # beyond that of the pose; None where a fit estimates no targets
    places_by_targets: Array | None = None


@dataclass(frozen=True)
class PoseStates:
    """States of P poses of an arm with n joints."""

    # (P, n) motor-side joint positions after the gear ratio; metres where a joint slides
    q_rad: Array
    tau_Nm: Array  # (P, n) joint torques that hold the arm
    arrival: Array  # (P, n) direction in which each joint arrived: -1, 0 (did not move) or +1
    load_N: Array  # (P,) external load
    temperature_C: Array  # (P,) temperature
    time_s: Array  # (P,) time of the reading
    static_loads: StaticLoads | None = None  # None where they were not computed
    seen: ObservedTargets | None = None  # None where the pose was not read from targets
    # (P,) number of each pose's campaign in a group, from 0; None: all belong to the first
    campaign: NDArray[np.intp] | None = None
    # (P, n) direction in which each joint moved from the pose before: -1, 0 (it stayed) or +1;
    # None where it equals `arrival`
    moved: Array | None = None
    # (P, n) move of each joint from the pose before, divided by the largest of them; metres of a
    # sliding joint count as radians. None where the order of poses is not known
    move_share: Array | None = None
    # (P,) path length of the end along that move, divided by the largest move of a joint [m/rad];
    # None where the order of poses is not known, or it was not computed
    move_end_m: Array | None = None
    # (P,) whether effects of time can be identified by `time_s`: not where only the order of poses
    # is known, or where time is correlated with a joint or a load. None where they can in all.
    timed: NDArray[np.bool_] | None = None

    def __len__(self) -> int:
        return len(self.q_rad)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q_rad.shape[1])

    @property
    def move_from_previous(self) -> Array:
        """Direction moved from the pose before, (P, n): unlike `arrival` 0 where a joint stayed."""
        return self.arrival if self.moved is None else self.moved

    @property
    def tells_time(self) -> bool:
        """Whether effects of time can be identified in these poses."""
        return self.timed is None or bool(self.timed.all())

    def take(self, rows: Rows) -> PoseStates:
        """Return the states of some poses."""
        return take_rows(self, rows)


@dataclass(frozen=True)
class Payload:
    """What the arm carries besides its own links."""

    mass_kg: float  # mass of the apparatus
    com_m: Array  # (3,) its centre of mass in the end-effector frame, the end of the chain
    load_point_m: Array  # (3,) where the external load hangs, in the end-effector frame
    gravity_m_s2: Array  # (3,) gravity along the axes of the robot base
    known: bool = True  # False where nobody stated the mass and it is zero
    # standard uncertainty of com_m, per axis; None where com_m was stated
    com_u_m: float | None = None
    # payload of each campaign of a group, in their order; empty where all are the same
    of_campaigns: tuple[Payload, ...] = ()


@dataclass(frozen=True)
class Statics:
    """An arm at rest in P poses."""

    # (P, n) torques of the joints that hold links, apparatus and load; forces [N] where prismatic
    torque_Nm: Array
    # (P, n, 4 n) their derivative by mass m and first moment m c of every link: m_1, m_1 c_1x,
    # m_1 c_1y, m_1 c_1z, m_2, … with c in the frame of the link's own row
    torque_by_mass: Array
    torque_by_load: Array  # (P, n) their derivative by the load [N m/N]
    static_loads: StaticLoads


def statics(chain: Chain, coordinates: Array, load_N: Array, payload: Payload) -> Statics:
    """Compute torques and moments of an arm at rest.

    The load of a link is the force and the moment of all weights beyond its far end: about the
    origin and along the axes of the frame in which the next joint moves, where the chain bends.

    Args:
        chain: the chain of an arm whose masses are known.
        coordinates: (P, m) chain coordinates.
        load_N: (P,) weights that hang at the load point.
        payload: apparatus, load point and gravity, which is along the axes of the chain's start.

    Raises:
        ArmError: when the arm has no masses, or gravity no direction.
    """
    mass_kg, com_m = _masses(chain.arm)
    gravity, g = payload.gravity_m_s2, _gravity_size(payload.gravity_m_s2)
    at = frames(chain, coordinates)
    n, count = at.T_base_rows.shape[:2]
    p_base_apparatus, p_base_load = (
        at.T_base_ee[:, :3, :3] @ p_ee + at.T_base_ee[:, :3, 3]
        for p_ee in (payload.com_m, payload.load_point_m)
    )
    # The torque by which a joint holds 1 kg at p is slope · p + offset: with the joint's origin o
    # and axis z it is (z × g) · (p - o) where it turns, and -z · g where it slides.
    joints = np.swapaxes(at.T_base_joints, 0, 1)
    axes, origins = joints[..., :3, 2], joints[..., :3, 3]
    turns = ~chain.arm.prismatic
    slope = np.where(turns[:, None], np.cross(axes, gravity), 0.0)
    offset = np.where(turns, -np.einsum("pjc,pjc->pj", slope, origins), -(axes @ gravity))
    by_load, by_apparatus = (
        (slope @ p_base[:, :, None])[..., 0] + offset for p_base in (p_base_load, p_base_apparatus)
    )
    by_load /= g
    # A link's first moment about the base's origin is m origin + R m c: its derivatives by m and
    # m c, the columns, are the origin and the axes of the row's frame. A joint holds its own link
    # and those after it.
    columns = at.T_base_rows[..., :3, [3, 0, 1, 2]].transpose(1, 2, 0, 3)
    by_link = (slope @ columns.reshape(count, 3, 4 * n)).reshape(count, n, n, 4)
    by_link[..., 0] += offset[:, :, None]
    by_link *= np.tri(n).T[..., None]
    by_mass = by_link.reshape(count, n, 4 * n)
    first_moments_kg_m = mass_kg[:, None] * com_m
    torque_Nm = (
        by_mass @ np.column_stack([mass_kg, first_moments_kg_m]).ravel()
        + payload.mass_kg * by_apparatus
        + load_N[:, None] * by_load
    )

    # Mass and first moment about the base's origin of each link and all beyond it.
    hung_kg = load_N / g
    masses_kg = np.tile(mass_kg[:, None], (1, count))
    masses_kg[-1] += payload.mass_kg + hung_kg
    moments_kg_m = (
        mass_kg[:, None, None] * at.T_base_rows[..., :3, 3]
        + (at.T_base_rows[..., :3, :3] @ first_moments_kg_m[:, None, :, None])[..., 0]
    )
    moments_kg_m[-1] += payload.mass_kg * p_base_apparatus + hung_kg[:, None] * p_base_load
    masses_kg = masses_kg[::-1].cumsum(axis=0)[::-1].T
    moments_kg_m = np.swapaxes(moments_kg_m[::-1].cumsum(axis=0)[::-1], 0, 1)
    # Derivative of the torques by gravity, and of gravity by rotations about axes normal to it.
    turning = np.cross(moments_kg_m - masses_kg[:, :, None] * origins, axes)
    by_gravity = np.where(turns[:, None], turning, -masses_kg[:, :, None] * axes)
    level = g * np.linalg.svd(gravity[None])[2][1:]
    # Derivatives by a mass that is added at the link's centre, not at the row's origin.
    by_link_at_centre = by_link.copy()
    by_link_at_centre[..., 0] += np.sum(by_link_at_centre[..., 1:] * com_m, axis=-1)
    moment_at_centre = columns.transpose(0, 2, 3, 1).copy()
    moment_at_centre[:, :, 0] += np.einsum("pjkc,jk->pjc", moment_at_centre[:, :, 1:], com_m)
    by_weights = [by_link_at_centre.reshape(by_mass.shape), by_apparatus[..., None]]
    hung = Hung(
        mass_kg=masses_kg,
        moment_kg_m=moments_kg_m,
        by_link=moment_at_centre,
        by_apparatus=p_base_apparatus,
        ends=np.swapaxes(at.T_base_joints[1:], 0, 1),
        gravity_m_s2=np.broadcast_to(gravity, (count, 3)),
        by_level=np.broadcast_to(level, (count, 2, 3)),
    )
    link_Nm, link_N, base_Nm = hung.loads()
    loads = StaticLoads(
        link_Nm=link_Nm,
        link_N=link_N,
        base_Nm=base_Nm,
        joint_Nm=torque_Nm,
        down_ee=(gravity / g) @ at.T_base_ee[:, :3, :3],
        by_weights=np.concatenate([*by_weights, by_gravity @ level.T], axis=2),
        by_load=by_load,
        hung=hung,
    )
    return Statics(torque_Nm, by_mass, by_load, loads)


def _masses(arm: Arm) -> tuple[Array, Array]:
    """Return the masses (n,) and centres of mass (n, 3) of an arm; refuse an arm without them."""
    if arm.mass_kg is None or arm.com_m is None:
        raise ArmError(
            "the arm has no masses, so its weights are not known",
            where=arm.name,
            allowed="mass_kg and com_m, one entry a joint",
            remedy="complete the arm description",
        )
    return arm.mass_kg, arm.com_m


def _gravity_size(gravity: Array) -> float:
    """Return the magnitude of gravity; refuse zero."""
    g = float(np.linalg.norm(gravity))
    if g == 0.0:
        raise ArmError(
            "gravity has no direction",
            where="gravity_m_s2",
            value=gravity.tolist(),
            allowed="three components, not all zero",
            remedy="give gravity along the axes of the robot base",
        )
    return g
