"""States of measured poses, and statics: loads of joints, links and base by weights.

The load of a joint depends on the weights beyond it only by their total mass and first moment,
which one cumulative sum from the end of the chain gives for all joints and poses. Torques are
linear in mass and first moment of every link; the coefficients are the derivatives by these.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain, frames
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Mask, Rows, take_rows
from pa10cal.errors import ArmError


def loads_as_named(load_N: Array) -> Array:
    """Return loads (P,) as results name them, `44.4822N`: of six digits, and no minus zero."""
    return np.array([float(f"{load:g}") + 0.0 for load in load_N.tolist()])


@dataclass(frozen=True)
class CarriedWeights:
    """What each link of an arm carries in P poses, and where, to compute loads of other weights."""

    mass_kg: Array  # (P, n) mass of each link and all beyond it, apparatus and load included
    moment_kg_m: Array  # (P, n, 3) first moment of that mass about the base's origin
    # (P, n, 4, 3) derivative of a link's first moment about the base's origin by its mass, added at
    # its centre, and by its three first moments about the centre
    by_link: Array
    com_m: Array  # (P, n, 3) that centre in the frame of the link's own row
    by_apparatus: Array  # (P, 3) the same derivative by the mass of the apparatus
    ends: Array  # (P, n - 1, 4, 4) far ends of the links but the last: frames of the next joints
    gravity_m_s2: Array  # (P, 3) gravity along base axes
    # (P, 2, 3) derivative of gravity by small rotations about two axes normal to it
    by_level: Array

    def with_weights(self, amounts: Array) -> CarriedWeights:
        """Return the weights changed by amounts (4 n + 3,), see `StaticLoads.by_weights`."""
        n = self.mass_kg.shape[1]
        of_links = amounts[: 4 * n].reshape(n, 4)
        apparatus_kg, *level = amounts[4 * n :]
        mass_kg, moment_kg_m = self.mass_kg + apparatus_kg, self.moment_kg_m.copy()
        if apparatus_kg:
            moment_kg_m += apparatus_kg * self.by_apparatus[:, None]
        for link in np.flatnonzero(of_links.any(axis=1)):  # each link before it carries it too
            mass_kg[:, : link + 1] += of_links[link, 0]
            more_kg_m = np.einsum("pkc,k->pc", self.by_link[:, link], of_links[link])
            moment_kg_m[:, : link + 1] += more_kg_m[:, None]
        return replace(
            self,
            mass_kg=mass_kg,
            moment_kg_m=moment_kg_m,
            gravity_m_s2=self.gravity_m_s2 + np.array(level) @ self.by_level,
        )

    def moments_at_ends_Nm(self) -> Array:
        """Return `StaticLoads.link_Nm`."""
        link_Nm, R_ends = np.zeros_like(self.moment_kg_m), self.ends[..., :3, :3]
        about_ends = self.moment_kg_m[:, 1:] - self.mass_kg[:, 1:, None] * self.ends[..., :3, 3]
        moments_Nm = np.cross(about_ends, self.gravity_m_s2[:, None])
        link_Nm[:, :-1] = np.einsum("pjba,pjb->pja", R_ends, moments_Nm)
        return link_Nm

    def forces_at_ends_N(self) -> Array:
        """Return `StaticLoads.link_N`."""
        link_N = np.zeros_like(self.moment_kg_m)
        link_N[:, :-1] = np.einsum("pjba,pb->pja", self.ends[..., :3, :3], self.gravity_m_s2)
        link_N[:, :-1] *= self.mass_kg[:, 1:, None]
        return link_N

    def overturning_Nm(self) -> Array:
        """Return `StaticLoads.base_Nm`."""
        return np.cross(self.moment_kg_m[:, 0], self.gravity_m_s2)


@dataclass(frozen=True)
class StaticLoads:
    """Loads of joints and structure by weights in P poses."""

    # (P, n) torques with which the drives of the joints hold links, apparatus and load; forces [N]
    # where they slide. Where no drive moves another joint they are those of the joints themselves,
    # see `Coupling.at_drives`
    joint_Nm: Array
    down_ee: Array  # (P, 3) direction of gravity along the end-effector's axes, a unit vector
    # (P, n, 4 n + 3) derivative of `joint_Nm`: by mass, added at its centre, and by the three first
    # moments about that centre, of link 1, 2, …; by the mass of the apparatus; by small rotations
    # of gravity about two axes normal to it
    by_weights: Array
    by_load: Array  # (P, n) derivative of `joint_Nm` by the external load [N m/N]
    carried: CarriedWeights  # the weights that make the loads of links and base

    @cached_property
    def link_Nm(self) -> Array:
        """Return the moment that each link carries at its far end, (P, n, 3).

        That is where the next joint turns; along the axes of that end. Zero for the last link.
        """
        return self.carried.moments_at_ends_Nm()

    @cached_property
    def link_N(self) -> Array:
        """Return the force that it carries there, along the same axes, (P, n, 3)."""
        return self.carried.forces_at_ends_N()

    @cached_property
    def base_Nm(self) -> Array:
        """Return the overturning moment about the base's origin, along base axes, (P, 3)."""
        return self.carried.overturning_Nm()

    def with_weights(self, amounts: Array) -> StaticLoads:
        """Return the loads of links and base with weights changed by amounts (4 n + 3,).

        Amounts are ordered as the columns of `by_weights`. `joint_Nm` is not changed: the term
        `Weights` adds the change of torques.
        """
        return replace(self, carried=self.carried.with_weights(amounts))

    def by_masses(self) -> Array:
        """Return the derivative (P, n, 4 n) of `joint_Nm` by mass m and first moment m c of links.

        They are m_1, m_1 c_1x, m_1 c_1y, m_1 c_1z, m_2, … with c in the frame of the link's own
        row. Other than in `by_weights` a mass is added at the origin of that frame.
        """
        count, n = self.joint_Nm.shape
        by_links = self.by_weights[:, :, : 4 * n].reshape(count, n, n, 4).copy()
        by_links[..., 0] -= np.einsum("pjkc,pkc->pjk", by_links[..., 1:], self.carried.com_m)
        return by_links.reshape(count, n, 4 * n)


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
    tau_Nm: Array  # (P, n) torques with which the drives of the joints hold the arm
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
class _HoldingTorques:
    """Torque with which each joint holds 1 kg at a point p of the base frame: slope · p + offset.

    With the joint's origin o and axis z this is (z × g) · (p - o) where it turns, and the force
    -z · g where it slides.
    """

    slope: Array  # (P, n, 3) [N/kg]
    offset: Array  # (P, n) [N m/kg; N/kg where it slides]

    @classmethod
    def of(cls, axes: Array, origins_m: Array, turns: Mask, gravity_m_s2: Array) -> _HoldingTorques:
        """Return those of joints with axes and origins (P, n, 3), which turn or slide (n,)."""
        slope = np.where(turns[:, None], np.cross(axes, gravity_m_s2), 0.0)
        by_turn = -np.einsum("pjc,pjc->pj", slope, origins_m)
        return cls(slope, np.where(turns, by_turn, -(axes @ gravity_m_s2)))

    def by_mass_at(self, p_base_m: Array) -> Array:
        """Return the derivative (P, n) of the torques by a mass at points (P, 3) at the end."""
        return np.asarray((self.slope @ p_base_m[:, :, None])[..., 0] + self.offset)

    def by_links(self, by_link: Array) -> Array:
        """Return the derivative (P, n, 4 n) by the links; see `CarriedWeights.by_link`."""
        count, n = self.offset.shape
        by_links = self.slope @ by_link.reshape(count, 4 * n, 3).swapaxes(1, 2)
        by_links = by_links.reshape(count, n, n, 4)
        by_links[..., 0] += self.offset[:, :, None]
        # A joint holds its own link and those after it.
        return np.asarray((by_links * np.tri(n).T[..., None]).reshape(count, n, 4 * n))


def statics(chain: Chain, coordinates: Array, load_N: Array, payload: Payload) -> StaticLoads:
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
    p_apparatus, p_load = (
        at.T_base_ee[:, :3, :3] @ p_ee + at.T_base_ee[:, :3, 3]
        for p_ee in (payload.com_m, payload.load_point_m)
    )
    carried = _carried_weights(
        mass_kg,
        com_m,
        np.swapaxes(at.T_base_rows, 0, 1),
        (payload.mass_kg, p_apparatus),
        (load_N / g, p_load),
        ends=np.swapaxes(at.T_base_joints[1:], 0, 1),
        gravity_m_s2=gravity,
    )
    joints, turns = np.swapaxes(at.T_base_joints, 0, 1), ~chain.arm.prismatic
    axes, origins_m = joints[..., :3, 2], joints[..., :3, 3]
    holding = _HoldingTorques.of(axes, origins_m, turns, gravity)
    by_links, by_apparatus = holding.by_links(carried.by_link), holding.by_mass_at(p_apparatus)
    by_load = holding.by_mass_at(p_load) / g
    moments_kg_m = carried.moment_kg_m - carried.mass_kg[:, :, None] * origins_m
    by_gravity = np.where(
        turns[:, None], np.cross(moments_kg_m, axes), -carried.mass_kg[:, :, None] * axes
    )
    by_level = by_gravity @ carried.by_level.swapaxes(1, 2)
    # A link as described is its mass at its centre.
    joint_Nm = (
        by_links[:, :, ::4] @ mass_kg + payload.mass_kg * by_apparatus + load_N[:, None] * by_load
    )
    by_weights = np.concatenate([by_links, by_apparatus[..., None], by_level], axis=2)
    at_drives = chain.arm.coupling.at_drives
    return StaticLoads(
        joint_Nm=at_drives(joint_Nm),
        down_ee=(gravity / g) @ at.T_base_ee[:, :3, :3],
        by_weights=at_drives(by_weights),
        by_load=at_drives(by_load),
        carried=carried,
    )


def _carried_weights(
    mass_kg: Array,
    com_m: Array,
    T_base_rows: Array,
    apparatus: tuple[float, Array],
    load: tuple[Array, Array],
    *,
    ends: Array,
    gravity_m_s2: Array,
) -> CarriedWeights:
    """Return the weights of links, with those that the last of them carries.

    Args:
        mass_kg, com_m: (n,) and (n, 3) of the links; `com_m` in the frame of the link's own row.
        T_base_rows: (P, n, 4, 4) these frames.
        ends: see `CarriedWeights`.
        apparatus, load: mass [kg], of the load (P,), and its position in the base (P, 3).
        gravity_m_s2: (3,) along base axes.
    """
    count = len(T_base_rows)
    by_link = T_base_rows[..., :3, [3, 0, 1, 2]].swapaxes(2, 3).copy()  # origin, then axes
    by_link[:, :, 0] += np.einsum("pjkc,jk->pjc", by_link[:, :, 1:], com_m)
    (apparatus_kg, p_apparatus), (load_kg, p_load) = apparatus, load
    masses_kg = np.tile(mass_kg, (count, 1))
    masses_kg[:, -1] += apparatus_kg + load_kg
    moments_kg_m = mass_kg[:, None] * by_link[:, :, 0]
    moments_kg_m[:, -1] += apparatus_kg * p_apparatus + load_kg[:, None] * p_load
    level = across(gravity_m_s2)
    return CarriedWeights(
        mass_kg=_with_all_beyond(masses_kg),
        moment_kg_m=_with_all_beyond(moments_kg_m),
        by_link=by_link,
        com_m=np.broadcast_to(com_m, (count, *com_m.shape)),
        by_apparatus=p_apparatus,
        ends=ends,
        gravity_m_s2=np.broadcast_to(gravity_m_s2, (count, 3)),
        by_level=np.broadcast_to(level, (count, 2, 3)),
    )


def across(gravity_m_s2: Array) -> Array:
    """Return the derivative (2, 3) of gravity by its two tilts, of which zero is as stated."""
    level: Array = np.linalg.norm(gravity_m_s2) * np.linalg.svd(gravity_m_s2[None])[2][1:]
    return level


def _with_all_beyond(of_links: Array) -> Array:
    """Return sums over each link and all beyond it, of values (P, n, …) of the links."""
    return np.asarray(of_links[:, ::-1].cumsum(axis=1)[:, ::-1])


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
