"""Effects of the structure: links, bearings, base and tool under weights; balancers; wobbles."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np

from pa10cal.arm.chain import BASE, Chain, bend_coordinates, frames, link_spans_m, long_links
from pa10cal.arm.description import Arm, weights_known
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.effect import AtJoint, Effect, JointEffect, Limits, static_loads_in
from pa10cal.terms.term import OPTIONAL, JointTorqueOnly, Report, TermParameter

LONG_LINKS = ("upper_arm", "forearm")
GRAVITY_M_S2 = 9.81
#: Plausible rotation of a structure under the moment of the stretched arm [rad].
_TURN_RAD = 3e-4
#: Plausible torque of a balancer, as part of the weights' that goes with the joint's angle; and of
#: it the part out of gravity's phase, as of pins 11 degrees off, and that of twice the angle.
_SHARE, _ACROSS, _TWICE = 0.3, 0.2, 0.3
#: Torque of the weights from which on a joint as well has a balancer as a false sensor [N m].
_BALANCED_NM = 1e3


class Compliance(Effect):
    """Something that bends or tilts in proportion to the forces and moments that it carries."""

    #: Moment of the stretched arm, where its plausible size is relative to that; see `moment_of`.
    moment_of_arm_Nm: float | None
    #: Names of its compliances, and their scale and plausible size [rad/(N m)].
    names: ClassVar[tuple[str, ...]] = ("c",)
    scale_and_size: ClassVar[tuple[float, float]] = (1e-7, 3e-6)
    varies_with = "the load"
    bends = True
    limits = Limits(positive=True)

    @classmethod
    def moment_of(cls, arm: Arm) -> float | None:
        """Return the moment of a stretched arm, to which the plausible size is relative; or None.

        Assumed weights may be wrong by any factor, and compliances then by its inverse. An arm so
        light that it would hardly turn by the usual size is as much softer as it is lighter.
        """
        if arm.mass_kg is None or arm.mass_kg.sum() == 0.0:
            return None
        moment_Nm = 0.5 * GRAVITY_M_S2 * float(arm.mass_kg.sum()) * arm.reach_m
        light = cls.scale_and_size[1] * moment_Nm < _TURN_RAD
        return moment_Nm if light or weights_known(arm).assumed else None

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        """Return its compliances."""
        scale, size = self.scale_and_size
        if self.moment_of_arm_Nm is not None:
            plausible = _TURN_RAD / self.moment_of_arm_Nm
            size, scale = plausible, plausible * scale / size
        unit = "rad/(N m)"
        return tuple(TermParameter(name, unit, scale, plausible=size) for name in self.names)

    def report(self, x: Array) -> Report:
        """Return its compliances, which are proportional to the inverse of the weights."""
        return replace(super().report(x), by_weights=-x)


@dataclass(frozen=True)
class LinkEffect(Compliance):
    """A compliance of a long link, on the six small motions of its end."""

    row: int  # the link's row, from 1
    # from the link's joint to its end, along the axes of that end
    span_m: tuple[float, float, float]
    moment_of_arm_Nm: float | None = field(default=None, metadata={OPTIONAL: True})
    sits = "long link"
    #: Links that may have it.
    places: ClassVar[tuple[str, ...]] = LONG_LINKS
    # An aluminium tube of 60 mm and 3 mm wall, 0.4 m long, twists by 0.035 mrad per N m (L / G J):
    # 100 N m, for which no arm would have it, make 3.5 mrad.
    limits = Limits(
        positive=True,
        turn_rad=0.01,
        why="no link of an arm turns at its end by more than 10 mrad",
    )

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        """Return the effect at the long links that may have it."""
        spans_m = link_spans_m(context.arm).tolist()
        rows = long_links(context.arm)
        return tuple(
            cls(place, row, tuple(spans_m[row - 1]), cls.moment_of(context.arm))
            for place, row in zip(LONG_LINKS, rows, strict=False)  # a short arm has fewer
            if place in cls.places
        )

    @property
    def coordinates(self) -> tuple[str, ...]:
        return bend_coordinates(self.row)

    @property
    def axis(self) -> Array:
        """Return the unit vector along the link, (3,)."""
        unit: Array = np.array(self.span_m) / np.linalg.norm(self.span_m)
        return unit

    def moment_Nm(self, states: PoseStates) -> Array:
        """Return the moment that the link carries at its end, along that end's axes, (P, 3)."""
        return static_loads_in(states, self).link_Nm[:, self.row - 1]


@dataclass(frozen=True)
class LinkBending(LinkEffect):
    """A link bends under force F and moment M across its axis at its end, c in rad/(N m).

    An even beam, held where its joint stands, c = L / (E I): with s from there to its end, the end
    turns by c (M + s x F / 2) and shifts by c (M / 2 + s x F / 3) x s.
    """

    id = "link_bending"
    clauses = ("{at} bends under load",)
    scale_and_size = (1e-7, 5e-6)
    words = (
        "the end of link {0.row} turns by c (M + s x F / 2) and shifts by c (M / 2 + s x F / 3) x s"
        ", M and F what it carries there across its axis, s from its joint to its end"
    )

    def per_unit(self, states: PoseStates) -> Array:
        moment_Nm, axis, span_m = self.moment_Nm(states), self.axis, np.array(self.span_m)
        across_Nm = moment_Nm - np.outer(moment_Nm @ axis, axis)
        force_N = static_loads_in(states, self).link_N[:, self.row - 1]
        of_force_Nm = np.cross(span_m, force_N)
        shift = np.cross(across_Nm / 2.0 + of_force_Nm / 3.0, span_m)
        return np.hstack([shift, across_Nm + of_force_Nm / 2.0])


@dataclass(frozen=True)
class LinkTorsion(LinkEffect):
    """A link twists by c times the moment along its axis at its end, c in rad/(N m)."""

    id = "link_torsion"
    clauses = ("{at} twists under load",)
    scale_and_size = (5e-7, 2e-5)
    words = "the end of link {0.row} turns about its axis by c times the moment about it"
    places: ClassVar[tuple[str, ...]] = ("forearm",)

    @property
    def coordinates(self) -> tuple[str, ...]:
        return super().coordinates[3:]

    def per_unit(self, states: PoseStates) -> Array:
        return np.outer(self.moment_Nm(states) @ self.axis, self.axis)


@dataclass(frozen=True)
class LateralCompliance(Compliance, AtJoint):
    """A joint's axis tilts about x and y across it by C_x M_x and C_y M_y under the moment M there.

    C_x and C_y in rad/(N m), M along the axes of the frame in which the joint moves, z its axis:
    its bearing and the housing around it give way. Of the first joint that is `base_compliance`.
    """

    moment_of_arm_Nm: float | None = field(default=None, metadata={OPTIONAL: True})
    id = "lateral_compliance"
    clauses = ("the axis of {at} tilts under load", "the axes of {at} tilt under load")
    words = (
        "the frame of joint {0.joint} turns about x by C_x M_x and about y by C_y M_y, M the "
        "moment there across the joint's axis"
    )
    names: ClassVar[tuple[str, ...]] = ("C_x", "C_y")
    on_link_before = True
    role_in_search = "substitute"
    # Crossed roller bearings of joints are as stiff as 1e5 N m/rad and more: 1000 N m make 10 mrad.
    limits = Limits(
        positive=True, turn_rad=0.01, why="no bearing of an arm tilts by more than 10 mrad"
    )

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        return None if joint == 1 else (cls.moment_of(context.arm),)

    @property
    def coordinates(self) -> tuple[str, ...]:
        return bend_coordinates(self.joint - 1)[3:5]

    def per_unit(self, states: PoseStates) -> Array:
        """Return the moments about x and y, each for the tilt about the same axis, (P, 2, 2)."""
        moment_Nm = static_loads_in(states, self).link_Nm[:, self.joint - 2, :2]
        return np.asarray(moment_Nm[:, :, None] * np.eye(2))


#: Least range of a joint in which a wobble of its axis is identifiable [rad]. Over half a turn 0.57
#: of the wave k = -1 remains after a fit of those with k = 0 and 1, over a third of a turn 0.29.
_WOBBLES_RAD = 2.0 * np.pi / 3.0


@dataclass(frozen=True)
class AxisWobble(AtJoint):
    """A joint's axis tilts to and fro as the joint turns: its bearings run out.

    This is the tilt error motion of ISO 230-7. With the tilts x and y about the axes of the frame
    in which the joint moves, x + i y is a sum of waves exp(i k q). k = 0 is another direction of
    the axis on the link before it, k = 1 one on the link after it: both are geometry. Of the first
    harmonic only k = -1 remains, half of a tilt about one fixed line; of the second k = 2 and -2,
    all of it. A soft bearing can do the same: the effect is sought only where it explains more than
    all compliances (`discovery/wobbles`).
    """

    # of the first joint, its unit tilts about x and y as motions of the base (2, 6); else None
    of_base: tuple[tuple[float, ...], ...] | None = field(default=None, metadata={OPTIONAL: True})
    id = "axis_wobble"
    nouns = ("wobble of the axis", "wobbles of the axes")
    clauses = ("the axis of {at} wobbles as it turns", "the axes of {at} wobble as they turn")
    words = (
        "the frame of joint {0.joint} turns about x by b_c cos q_{0.joint} + b_s sin q_{0.joint} + "
        "x_c cos 2 q_{0.joint} + x_s sin 2 q_{0.joint}, about y by b_s cos q_{0.joint} - b_c sin "
        "q_{0.joint} + y_c cos 2 q_{0.joint} + y_s sin 2 q_{0.joint}"
    )
    on_link_before = True
    role_in_search = "proposed"
    amounts_stand_alone = False
    # ISO 492 allows inner rings of 50 to 180 mm a radial run-out of 20 to 30 um in class Normal and
    # of 5 to 8 in P5: an eighth of that between two bearings 100 mm apart are 30 to 60 urad.
    reported = tuple(
        TermParameter(name, "rad", 3e-6, plausible=5e-5)
        for name in ("b_c", "b_s", "x_c", "x_s", "y_c", "y_s")
    )
    # Two rings of class Normal, run out to opposite sides by 30 um, stand 30 mm apart at least.
    limits = Limits(turn_rad=2e-3, why="no axis between bearings wobbles by more than 2 mrad")

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        """Return `of_base`; None, for not there, of a joint that turned too little."""
        low, high = context.q_span_rad[joint - 1]
        if high - low < _WOBBLES_RAD:
            return None
        return (_tilts_of_base(context.arm),) if joint == 1 else (None,)

    @property
    def coordinates(self) -> tuple[str, ...]:
        return bend_coordinates(self.joint - 1)[3:5] if self.of_base is None else BASE

    def per_unit(self, states: PoseStates) -> Array:
        q_rad = states.q_rad[:, self.joint - 1]
        cos, sin, zero = np.cos(q_rad), np.sin(q_rad), np.zeros(len(q_rad))
        second = [np.cos(2.0 * q_rad), np.sin(2.0 * q_rad)]
        about_x = [cos, sin, *second, zero, zero]
        about_y = [-sin, cos, zero, zero, *second]
        tilts = np.stack([np.stack(about_x, axis=1), np.stack(about_y, axis=1)], axis=1)
        return tilts if self.of_base is None else np.einsum("cm,pck->pmk", self.of_base, tilts)


def _tilts_of_base(arm: Arm) -> tuple[tuple[float, ...], ...]:
    """Return unit tilts of the first joint about its x and y as motions of the base, (2, 6)."""
    chain = Chain.of(arm)
    T_base_joint = frames(chain, chain.nominal[None]).T_base_joints[0, 0]
    axes, origin = T_base_joint[:3, :2].T, T_base_joint[:3, 3]
    motions = np.hstack([np.cross(origin, axes), axes])
    return tuple(tuple(motion) for motion in motions.tolist())


@dataclass(frozen=True)
class BaseCompliance(Compliance):
    """The base tilts about x and y by cx M_x and cy M_y, M the overturning moment.

    cx and cy in rad/(N m), M about the base's origin along base axes.
    """

    moment_of_arm_Nm: float | None = field(default=None, metadata={OPTIONAL: True})
    id = "base_compliance"
    clauses = ("the base tilts under the arm's weight",)
    sits = "base"
    words = "base.rx += cx M_x, base.ry += cy M_y, M the overturning moment"
    coordinates = ("base.rx", "base.ry")
    names = ("cx", "cy")
    # A pedestal of which the top turns by this much stands loose: 1 mm for each 0.1 m of height.
    limits = Limits(
        positive=True,
        turn_rad=0.01,
        why="no base that is bolted down tilts by more than 10 mrad",
    )

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...]:
        return (cls.moment_of(context.arm),)

    def per_unit(self, states: PoseStates) -> Array:
        """Return the overturning moments, each for the tilt about the same axis, (P, 2, 2)."""
        return static_loads_in(states, self).base_Nm[:, :2, None] * np.eye(2)


@dataclass(frozen=True)
class ToolSag(Effect):
    """The tooling gives way by c [m] times the part of gravity's direction across its axis."""

    size_ratio: float = field(default=1.0, metadata={OPTIONAL: True})  # `Arm.size_ratio`
    id = "tool_sag"
    varies_with = "the direction of gravity"
    clauses = ("the tool sags under its weight",)
    sits = "tool"
    words = "tool.x, tool.y += c times the part of the unit vector of gravity along them"
    coordinates = ("tool.x", "tool.y")
    limits = Limits(positive=True)

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...]:
        return (context.arm.size_ratio,)

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        return (TermParameter("c", "m", 3e-6, plausible=1e-4 * self.size_ratio),)

    def per_unit(self, states: PoseStates) -> Array:
        return static_loads_in(states, self).down_ee[:, :2]


@dataclass(frozen=True)
class Balancer(JointTorqueOnly, JointEffect):
    """A torque that goes with the joint's angle and moves the arm through the joint's spring.

    A counterweight or a spring of constant rate and no free length puts a sine of the angle on the
    joint, as gravity does on a link; a gas spring or cylinder between two pins also a part of twice
    the angle. The mass or the centre of the joint's own link stated wrongly puts the same sine
    there. It is possible at the first joint that lifts the arm: of this the torque of its own link
    goes with its angle alone, and there balancers are. Logged torques are less by it already.
    """

    # sine and cosine part of the torque that the described weights put there [N m]
    weights_Nm: tuple[float, float]
    id = "balancer"
    sits = "driven joint"
    nouns = ("balancer or weight", "balancers or weights")
    clauses = (
        "a torque acts on {at} that its description lacks: a balancer, counterweight or gas "
        "spring, or its link weighs other than stated",
        "torques act on {at} that their description lacks: balancers, counterweights or gas "
        "springs, or their links weigh other than stated",
    )
    words = (
        "tau_{0.joint} += s_1 sin q_{0.joint} + c_1 cos q_{0.joint} + s_2 sin 2 q_{0.joint} + "
        "c_2 cos 2 q_{0.joint}"
    )
    advice = "; state what the description lacks, or log torques"
    role_in_search = "substitute"
    amounts_stand_alone = False
    acts_on_joint = False  # calculated torques do not have it
    of_calculated: ClassVar[bool] = True

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        """Return the torque of the weights at the first joint that lifts the arm."""
        if context.torques != "masses" or weights_known(context.arm).origin != "stated":
            return None
        if context.lifts is None or context.lifts[0] != joint:
            return None
        return (context.lifts[1:],)

    @property
    def prior_odds(self) -> float:
        """Return the odds against a sensor or gear that errs: small arms have no balancers."""
        return min(1.0, float(np.hypot(*self.weights_Nm)) / _BALANCED_NM)

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        """Return sine and cosine of the angle and of twice the angle [N m]."""
        sizes_Nm = np.linalg.norm(self.prior_factor, axis=1).tolist()
        scale_Nm = 1e-2 * max(sizes_Nm)
        return tuple(
            TermParameter(name, "N m", scale_Nm, plausible=size_Nm)
            for name, size_Nm in zip(("s_1", "c_1", "s_2", "c_2"), sizes_Nm, strict=True)
        )

    @property
    def prior_factor(self) -> Array:
        """Return the factor of the prior covariance: mostly in gravity's phase, see `_ACROSS`."""
        sine, cosine = _SHARE * np.array(self.weights_Nm)
        twice = _TWICE * np.hypot(sine, cosine)
        factor = np.diag([0.0, 0.0, twice, twice])
        factor[:2, :2] = [[sine, -_ACROSS * cosine], [cosine, _ACROSS * sine]]
        return factor

    def per_unit(self, states: PoseStates) -> Array:
        """Return what the calculated torque has too much of by each parameter, (P, 4)."""
        q_rad = states.q_rad[:, self.joint - 1]
        return -np.stack(
            [np.sin(q_rad), np.cos(q_rad), np.sin(2.0 * q_rad), np.cos(2.0 * q_rad)], axis=-1
        )
