"""What weights do to an arm at rest: torques in its joints, moments in its links and its base.

A joint sees the weights beyond it through two sums, their mass and their first moment; one pass
from the end of the chain inward gives both for all joints and poses. Torques are linear in mass
and first moment of every link, so their derivative by these comes along.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain, frames
from pa10cal.arm.description import Arm, WeightsKnown
from pa10cal.arrays import Array, Rows, taken
from pa10cal.errors import ArmError

# The state of the arm in each measured pose: all that a model may depend on.


@dataclass(frozen=True)
class Hung:
    """The weights of an arm in P poses, and where they hang; for loads under other weights."""

    # masses beyond each joint, its own link's included, (P, n) [kg], and their first moments about
    # the base's origin, (P, n, 3) [kg m]
    mass_kg: Array
    moment_kg_m: Array
    # (P, n, 4, 3) such a moment for a unit of each link's mass, at its centre, and of its first
    # moments about that; (P, 3) for one of the apparatus
    by_link: Array
    by_apparatus: Array
    ends: Array  # (P, n - 1, 4, 4) frames in which the joints beyond each link move
    gravity_m_s2: Array  # (P, 3) gravity along base axes
    by_level: Array  # (P, 2, 3) its derivative by two small turns about axes across it

    def with_weights(self, amounts: Array) -> Hung:
        """Return what hangs with other weights, by columns of `StaticLoads.by_weights`."""
        n = self.mass_kg.shape[1]
        of_links, (apparatus_kg, *level) = amounts[: 4 * n].reshape(n, 4), amounts[4 * n :]
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
        """Return what links carry (P, n, 3), moments and forces, and the base's moment (P, 3)."""
        link_Nm, link_N = np.zeros((2, *self.moment_kg_m.shape))
        gravity, R_ends = self.gravity_m_s2[:, None], self.ends[..., :3, :3]
        about_ends = self.moment_kg_m[:, 1:] - self.mass_kg[:, 1:, None] * self.ends[..., :3, 3]
        link_Nm[:, :-1] = np.einsum("pjba,pjb->pja", R_ends, np.cross(about_ends, gravity))
        link_N[:, :-1] = np.einsum("pjba,pb->pja", R_ends, self.gravity_m_s2)
        link_N[:, :-1] *= self.mass_kg[:, 1:, None]
        return link_Nm, link_N, np.cross(self.moment_kg_m[:, 0], self.gravity_m_s2)


@dataclass(frozen=True)
class StaticLoads:
    """What weights bend the structure with in P poses; see `arm.statics`."""

    # (P, n, 3) moment that each link carries at its far end, where the next joint turns, along the
    # axes of that end (zero for the last link)
    link_Nm: Array
    link_N: Array  # (P, n, 3) force that it carries there, along the same axes (zero for the last)
    base_Nm: Array  # (P, 3) overturning moment about the base's origin, along base axes
    joint_Nm: Array  # (P, n) torques with which the joints hold links, apparatus and load
    down_ee: Array  # (P, 3) direction of gravity along the end-effector's axes, a unit vector
    # (P, n, 4 n + 3) derivative of `joint_Nm` by the mass of every link, which sits at its centre,
    # and by its first moment about that; by the mass of the apparatus; and by two small turns of
    # gravity
    by_weights: Array
    by_load: Array  # (P, n) derivative of `joint_Nm` by the external load [N m/N]
    hung: Hung  # the weights that make these loads

    def with_weights(self, amounts: Array) -> StaticLoads:
        """Return what links and base carry with other weights, by columns of `by_weights`.

        Joints carry what they did: `Weights` has the torques.
        """
        hung = self.hung.with_weights(amounts)
        link_Nm, link_N, base_Nm = hung.loads()
        return replace(self, link_Nm=link_Nm, link_N=link_N, base_Nm=base_Nm, hung=hung)


@dataclass(frozen=True)
class ObservedTargets:
    """How P measured poses were read from B targets of the instrument."""

    p_instr_targets_m: Array  # (P, B, 3) places of the targets in the instrument's frame
    # (P, 6, 3 B) derivative of the pose (position, small rotation, along the end-effector's axes)
    # by what the instrument reads too much of each target's place
    pose_by_targets: Array


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
    # what weights bend the structure with, where it was computed
    static_loads: StaticLoads | None = None
    # how the pose was read from the instrument's targets, where it was computed
    seen: ObservedTargets | None = None
    # (P,) which campaign of a group each pose is of, from 0; None where there is one, or where no
    # campaign is meant: then what belongs to a campaign is that of the first
    campaign: NDArray[np.intp] | None = None
    # (P, n) direction in which each joint moved from the pose before: -1, 0 (it stayed) or +1;
    # None where `arrival` says so
    moved: Array | None = None
    # (P, n) move from the pose before over that of the joint that went furthest, a metre of one
    # that slides counting as a radian; None where no order of poses is known
    move_share: Array | None = None
    # (P,) how far the end goes along that move, for a radian of the joint that goes furthest [m];
    # None where no order of poses is known, or it was not asked for
    move_end_m: Array | None = None
    # (P,) whether `time_s` tells time; where it does not, as where times were not recorded or the
    # order goes with a joint or a load, it gives an order alone. None where all do.
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
        """Whether what goes with time can be told from these poses."""
        return self.timed is None or bool(self.timed.all())

    def take(self, rows: Rows) -> PoseStates:
        """Return the states of some poses."""
        return taken(self, rows)


@dataclass(frozen=True)
class Payload:
    """What the arm carries besides its own links."""

    mass_kg: float  # mass of the apparatus
    com_m: Array  # (3,) its centre of mass in the end-effector frame, the end of the chain
    load_point_m: Array  # (3,) where the external load hangs, in the end-effector frame
    gravity_m_s2: Array  # (3,) gravity along the axes of the robot base
    known: bool = True  # whether the mass is that of the apparatus, and not merely left at zero
    # standard uncertainty of its centre of mass, per axis, where nobody stated that; else None
    com_u_m: float | None = None
    # what the arm carried in each campaign of a group, in their order; empty where that was the
    # same
    of_campaigns: tuple[Payload, ...] = ()


@dataclass(frozen=True)
class Statics:
    """An arm at rest in P poses."""

    # (P, n) what the joints exert to hold links, apparatus and load; a force [N] for a prismatic
    # joint
    torque_Nm: Array
    # (P, n, 4 n) its derivative by mass m and first moment m c of every link: m_1, m_1 c_1x, m_1
    # c_1y, m_1 c_1z, m_2, … with c in the frame of the link's own row
    torque_by_mass: Array
    torque_by_load: Array  # (P, n) its derivative by the load [N m/N]
    static_loads: StaticLoads  # what weights bend the structure with


def statics(chain: Chain, coordinates: Array, load_N: Array, payload: Payload) -> Statics:
    """Compute torques and moments of an arm at rest.

    The chain starts from the axes along which gravity is given. A link carries, at its far end,
    force and moment of the weights beyond it: about the origin and along the axes of the frame in
    which the next joint moves, where the chain has its bends.

    Args:
        chain: the chain of an arm whose masses are known.
        coordinates: (P, m) chain coordinates.
        load_N: (P,) weights that hang at the load point.
        payload: apparatus, load point and gravity.

    Raises:
        ArmError: when the arm has no masses, or gravity no direction.
    """
    mass_kg, com_m = chain.arm.mass_kg, chain.arm.com_m
    if mass_kg is None or com_m is None:
        raise ArmError(
            "the arm has no masses, so its weights are not known",
            where=chain.arm.name,
            allowed="mass_kg and com_m, one entry a joint",
            remedy="complete the arm description",
        )
    first_moments_kg_m = mass_kg[:, None] * com_m
    gravity = payload.gravity_m_s2
    g = float(np.linalg.norm(gravity))
    if g == 0.0:
        raise ArmError(
            "gravity has no direction",
            where="gravity_m_s2",
            value=gravity.tolist(),
            allowed="three components, not all zero",
            remedy="give gravity along the axes of the robot base",
        )
    found = frames(chain, coordinates)
    p_base_apparatus, p_base_load = (
        found.T_base_ee[:, :3, :3] @ place + found.T_base_ee[:, :3, 3]
        for place in (payload.com_m, payload.load_point_m)
    )
    # What a kilogram at p costs a joint is pull · p + own: with origin o and axis z it holds
    # (z × g) · (p - o) where it turns, and -z · g where it slides.
    joints = np.swapaxes(found.T_base_joints, 0, 1)
    axes, origins = joints[..., :3, 2], joints[..., :3, 3]
    turns = ~chain.arm.prismatic
    pull = np.where(turns[:, None], np.cross(axes, gravity), 0.0)
    own = np.where(turns, -np.einsum("pjc,pjc->pj", pull, origins), -(axes @ gravity))
    by_load, by_apparatus = (
        (pull @ p_base[:, :, None])[..., 0] + own for p_base in (p_base_load, p_base_apparatus)
    )
    by_load /= g
    # By mass and first moment of links: columns of a row's pose as these unknowns come are its
    # origin, then its axes. A joint holds its own link and those after it.
    n, count = found.T_base_rows.shape[:2]
    columns = found.T_base_rows[..., :3, [3, 0, 1, 2]].transpose(1, 2, 0, 3)
    by_link = (pull @ columns.reshape(count, 3, 4 * n)).reshape(count, n, n, 4)
    by_link[..., 0] += own[:, :, None]
    by_link *= np.tri(n).T[..., None]
    by_mass = by_link.reshape(count, n, 4 * n)
    torque_Nm = (
        by_mass @ np.column_stack([mass_kg, first_moments_kg_m]).ravel()
        + payload.mass_kg * by_apparatus
        + load_N[:, None] * by_load
    )

    # Mass and first moment about the base's origin, each of one link and all that sits beyond.
    hung_kg = load_N / g
    masses_kg = np.tile(mass_kg[:, None], (1, count))
    masses_kg[-1] += payload.mass_kg + hung_kg
    moments_kg_m = (
        mass_kg[:, None, None] * found.T_base_rows[..., :3, 3]
        + (found.T_base_rows[..., :3, :3] @ first_moments_kg_m[:, None, :, None])[..., 0]
    )
    moments_kg_m[-1] += payload.mass_kg * p_base_apparatus + hung_kg[:, None] * p_base_load
    masses_kg = masses_kg[::-1].cumsum(axis=0)[::-1].T
    moments_kg_m = np.swapaxes(moments_kg_m[::-1].cumsum(axis=0)[::-1], 0, 1)
    # Gravity changes with two small turns about axes across it, masses sit at their centres.
    turning = np.cross(moments_kg_m - masses_kg[:, :, None] * origins, axes)
    by_gravity = np.where(turns[:, None], turning, -masses_kg[:, :, None] * axes)
    level = g * np.linalg.svd(gravity[None])[2][1:]
    at_centres = by_link.copy()
    at_centres[..., 0] += np.sum(at_centres[..., 1:] * com_m, axis=-1)
    places = columns.transpose(0, 2, 3, 1).copy()
    places[:, :, 0] += np.einsum("pjkc,jk->pjc", places[:, :, 1:], com_m)
    hung = Hung(
        mass_kg=masses_kg,
        moment_kg_m=moments_kg_m,
        by_link=places,
        by_apparatus=p_base_apparatus,
        ends=np.swapaxes(found.T_base_joints[1:], 0, 1),
        gravity_m_s2=np.broadcast_to(gravity, (count, 3)),
        by_level=np.broadcast_to(level, (count, 2, 3)),
    )
    link_Nm, link_N, base_Nm = hung.loads()
    loads = StaticLoads(
        link_Nm=link_Nm,
        link_N=link_N,
        base_Nm=base_Nm,
        joint_Nm=torque_Nm,
        down_ee=(gravity / g) @ found.T_base_ee[:, :3, :3],
        by_weights=np.concatenate(
            [at_centres.reshape(by_mass.shape), by_apparatus[..., None], by_gravity @ level.T],
            axis=2,
        ),
        by_load=by_load,
        hung=hung,
    )
    return Statics(torque_Nm, by_mass, by_load, loads)


# The torsional spring of a joint, paper equation (1), solved in closed form.
#
# In units of a reference torque and of the deflection there, equation (1) reads (1 - s) x + s x^3
# = t: s is the share of the cubic part at the reference. Every s from 0 (linear) to below 1 (cubic
# alone) is an ordinary point, and x has one real root.

#: Below this s t^2 the root is t + s (t - t^3) to the last digit.
_SERIES_SUFFICES = 1e-9


#: The stiffness that readers know, by the parameter that is solved in its place.
_REPORTED = {"windup": "K_lin", "cubic_share": "K_cub"}


def reported_name(name: str) -> str:
    """Return what readers call a solved parameter: `K_cub_3` for `cubic_share_3`; others as is."""
    kind, _, joint = name.rpartition("_")
    return f"{_REPORTED[kind]}_{joint}" if kind in _REPORTED else name


@dataclass(frozen=True)
class UnitDeflection:
    """Deflection of a spring over that at the reference torque."""

    x: Array  # (P,) the root
    by_share: Array  # (P,) its derivative by the cubic share


def unit_deflection(t: Array, share: float) -> UnitDeflection:
    """Solve (1 - s) x + s x^3 = t for a share s, 0 <= s < 1, t (P,) over the reference torque."""
    if share * max(1.0, float(np.max(t**2, initial=0.0))) <= _SERIES_SUFFICES:
        x = t + share * (t - t**3)
    else:
        # Cardano in its hyperbolic form: no cancellation. One Newton step takes off the rounding.
        reach = np.sqrt(3.0 * share / (1.0 - share))
        x = 2.0 / reach * np.sinh(np.arcsinh(1.5 * reach * t / (1.0 - share)) / 3.0)
        x = x - ((1.0 - share) * x + share * x**3 - t) / ((1.0 - share) + 3.0 * share * x**2)
    slope = (1.0 - share) + 3.0 * share * x**2
    return UnitDeflection(x, (x - x**3) / slope)


def deflection_rad(tau_Nm: Array, k_lin: float, k_cub: float) -> Array:
    """Solve tau = K_lin delta + K_cub delta^3 for delta, (P,); K_lin > 0, K_cub >= 0."""
    linear = tau_Nm / k_lin
    if k_cub * np.max(linear**2, initial=0.0) <= 1e-18 * k_lin:  # no digit of it shows
        return linear
    unit_rad = np.sqrt(k_lin / k_cub)
    # In this unit linear and cubic part are equal at x = 1: s = 1/2, t = tau / (2 K_lin unit).
    found: Array = unit_rad * unit_deflection(tau_Nm / (2.0 * k_lin * unit_rad), 0.5).x
    return found


# Weights for an arm for which none are stated.

#: Mass of an arm of 1 m [kg]; arms weigh as the cube of their length (a UR10 of 1.7 m 29 kg, an
#: MA2010 of 2.8 m 260 kg, a KR 1000 titan of 5.1 m 4690 kg by their makers' data sheets).
_KG_AT_1_M = 15.0
_POWER = 3.0
#: Drives and flanges weigh as if every link were longer by this part of the arm.
DRIVES = 0.1
#: Standard uncertainty of an assumed mass, relative: of a part of a known total, and of all else.
_MASS, _MASS_OF_TOTAL = 1.0, 0.5
#: Of an assumed centre of mass along each axis, of the link's length and its drives.
CENTRE = 0.3


def with_assumed_weights(arm: Arm, total_kg: float | None = None) -> Arm:
    """Return an arm with weights: itself where it states them, else with assumed ones.

    Those of a known total mass add up to it.
    """
    if arm.mass_kg is not None:
        return arm
    near_m, far_m = _ends(arm)
    length_m = np.linalg.norm(far_m - near_m, axis=1)
    size_m = length_m + DRIVES * arm.reach_m
    mass_kg = size_m / size_m.sum()
    mass_kg *= _KG_AT_1_M * arm.reach_m**_POWER if total_kg is None else total_kg
    known = WeightsKnown(
        "assumed" if total_kg is None else "total",
        np.full(arm.n, _MASS if total_kg is None else _MASS_OF_TOTAL),
        CENTRE * size_m,
    )
    return replace(arm, mass_kg=mass_kg, com_m=0.5 * (near_m + far_m), weights_known=known)


def _ends(arm: Arm) -> tuple[Array, Array]:
    """Return where links begin and end (n, 3) each, in the frames of their own rows [m].

    A link begins where its joint stands, and ends where the next one does, or at the end-effector.
    """
    chain = Chain.of(arm)
    found = frames(chain, chain.coordinates(np.zeros((1, arm.n))))
    places = np.concatenate([found.T_base_joints[:, 0, :3, 3], found.T_base_ee[:, :3, 3]])
    rows = found.T_base_rows[:, 0]

    def in_rows(p_base: Array) -> Array:
        in_row: Array = np.einsum("jba,jb->ja", rows[:, :3, :3], p_base - rows[:, :3, 3])
        return in_row

    return in_rows(places[:-1]), in_rows(places[1:])
