"""Effects beside the joints: structure under weights, what goes with time, false readings."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np

from pa10cal.arm.chain import BASE, TOOL, Chain, bend_coordinates, frames, link_spans_m, long_links
from pa10cal.arm.description import Arm, weights_known
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.effect import (
    AtJoint,
    CandidateContext,
    Effect,
    seen_in,
    static_loads_in,
    time_in,
)
from pa10cal.terms.term import OPTIONAL, TermParameter

_LONG_LINKS = ("upper_arm", "forearm")
GRAVITY_M_S2 = 9.81
#: Turn that a structure may well make under the whole weight of its arm [rad].
_TURN_RAD = 3e-4


def moment_of_arm_Nm(arm: Arm) -> float | None:
    """Return the moment that an arm stretched out puts on its base, where weights are assumed."""
    if arm.mass_kg is None or not weights_known(arm).assumed:
        return None
    return 0.5 * GRAVITY_M_S2 * float(arm.mass_kg.sum()) * arm.reach_m


def compliance(name: str, scale: float, plausible: float, of_arm_Nm: float | None) -> TermParameter:
    """Return a compliance [rad/(N m)], as large as is plausible of its arm."""
    if of_arm_Nm is not None:
        plausible, scale = _TURN_RAD / of_arm_Nm, _TURN_RAD / of_arm_Nm * scale / plausible
    return TermParameter(name, "rad/(N m)", scale, plausible=plausible)


@dataclass(frozen=True)
class LinkEffect(Effect):
    """An effect of a long link, on the six small motions of its end."""

    row: int  # the link's row, from 1
    # from the link's joint to its end, along the axes of that end
    span_m: tuple[float, float, float]
    # moment at which a plausible turn is reached, where weights are assumed and a compliance is as
    # large as these are small; None where they are stated
    moment_of_arm_Nm: float | None = field(default=None, metadata={OPTIONAL: True})
    #: Names of the links at which it may sit.
    places: ClassVar[tuple[str, ...]] = _LONG_LINKS
    bends = True
    weights_power = -1.0
    # An aluminium tube of 60 mm and 3 mm wall, 0.4 m long, twists by 0.035 mrad per N m (L / G J):
    # 100 N m, for which no arm would have it, make 3.5 mrad.
    most_rad = (0.01, "no link of an arm turns at its end by more than 10 mrad")
    #: Scale and plausible size of its compliance [rad/(N m)].
    scale_and_size: ClassVar[tuple[float, float]]

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        """Return it at the long links that may have it."""
        spans_m = link_spans_m(context.arm)
        rows = long_links(context.arm)
        return tuple(
            cls(place, row, (float(x), float(y), float(z)), moment_of_arm_Nm(context.arm))
            for place, row in zip(_LONG_LINKS, rows, strict=False)  # a short arm has fewer
            for x, y, z in (spans_m[row - 1],)
            if place in cls.places
        )

    @property
    def coordinates(self) -> tuple[str, ...]:
        return bend_coordinates(self.row)

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        return (compliance("c", *self.scale_and_size, self.moment_of_arm_Nm),)

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
    positive = True

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
    positive = True
    places: ClassVar[tuple[str, ...]] = ("forearm",)

    @property
    def coordinates(self) -> tuple[str, ...]:
        return super().coordinates[3:]

    def per_unit(self, states: PoseStates) -> Array:
        return np.outer(self.moment_Nm(states) @ self.axis, self.axis)


@dataclass(frozen=True)
class LateralCompliance(AtJoint):
    """A joint's axis tilts about x and y across it by C_x M_x and C_y M_y under the moment M there.

    C_x and C_y in rad/(N m), M along the axes of the frame in which the joint moves, z its axis:
    its bearing and the housing around it give way. Of the first joint that is `base_compliance`.
    """

    # moment at which a plausible tilt is reached, where weights are assumed; None where they are
    # stated
    moment_of_arm_Nm: float | None = field(default=None, metadata={OPTIONAL: True})
    id = "lateral_compliance"
    clauses = ("the axis of {at} tilts under load", "the axes of {at} tilt under load")
    words = (
        "the frame of joint {0.joint} turns about x by C_x M_x and about y by C_y M_y, M the "
        "moment there across the joint's axis"
    )
    bends = True
    on_link = True
    takes_a_place = True
    positive = True
    weights_power = -1.0
    # Crossed roller bearings of joints are as stiff as 1e5 N m/rad and more: 1000 N m make 10 mrad.
    most_rad = (0.01, "no bearing of an arm tilts by more than 10 mrad")

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        return None if joint == 1 else (moment_of_arm_Nm(context.arm),)

    @property
    def coordinates(self) -> tuple[str, ...]:
        return bend_coordinates(self.joint - 1)[3:5]

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        of_arm_Nm = self.moment_of_arm_Nm
        return tuple(compliance(name, 1e-7, 3e-6, of_arm_Nm) for name in ("C_x", "C_y"))

    def per_unit(self, states: PoseStates) -> Array:
        """Return the moments across the joint's axis, each for its own tilt, (P, 2, 2)."""
        moment_Nm = static_loads_in(states, self).link_Nm[:, self.joint - 2, :2]
        return np.asarray(moment_Nm[:, :, None] * np.eye(2))


#: Least turn of a joint that shows a wobble of its axis [rad]. Of half a turn 0.57 of the wave that
#: runs against the joint are left beside a constant and one that runs along; of a third 0.29.
_WOBBLES_RAD = np.pi


@dataclass(frozen=True)
class AxisWobble(AtJoint):
    """A joint's axis tilts to and fro as the joint turns: its bearings run out.

    This is the tilt error motion of ISO 230-7. About x and y of the frame in which the joint moves
    the tilt is x + i y, a sum of waves exp(i k q). k = 0 is another direction of the axis on the
    link before it, k = 1 one on the link after it, with which it turns: both are geometry, and no
    error of a joint's angle tilts an axis. Of the first harmonic k = -1 is left, half of a tilt to
    and fro about one line; of the second k = 2 and -2, all of it. A soft bearing can do the same,
    so it is sought only where it stands out of all that gives way (`discovery/wobbles`).
    """

    # what a unit tilt about x, and about y, of the first joint is of the base's own six motions;
    # None of other joints
    of_base: tuple[tuple[float, ...], ...] | None = field(default=None, metadata={OPTIONAL: True})
    id = "axis_wobble"
    nouns = ("wobble of the axis", "wobbles of the axes")
    clauses = ("the axis of {at} wobbles as it turns", "the axes of {at} wobble as they turn")
    words = (
        "the frame of joint {0.joint} turns about x by b_c cos q_{0.joint} + b_s sin q_{0.joint} + "
        "x_c cos 2 q_{0.joint} + x_s sin 2 q_{0.joint}, about y by b_s cos q_{0.joint} - b_c sin "
        "q_{0.joint} + y_c cos 2 q_{0.joint} + y_s sin 2 q_{0.joint}"
    )
    on_link = True
    sought = False
    # ISO 492 allows inner rings of 50 to 180 mm a radial run-out of 20 to 30 um in class Normal and
    # of 5 to 8 in P5: an eighth of that between two bearings 100 mm apart are 30 to 60 urad.
    reported = tuple(
        TermParameter(name, "rad", 3e-6, plausible=5e-5)
        for name in ("b_c", "b_s", "x_c", "x_s", "y_c", "y_s")
    )
    # Two rings of class Normal, run out to opposite sides by 30 um, stand 30 mm apart at least.
    most_rad = (2e-3, "no axis between bearings wobbles by more than 2 mrad")

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        """Return what the first joint tilts of the base; None of a joint that turned too little."""
        low, high = context.q_span_rad[joint - 1]
        if high - low < _WOBBLES_RAD:
            return None
        return (_tilts_of_base(context.arm),) if joint == 1 else (None,)

    @property
    def coordinates(self) -> tuple[str, ...]:
        return bend_coordinates(self.joint - 1)[3:5] if self.of_base is None else BASE

    def per_unit(self, states: PoseStates) -> Array:
        q_rad = states.q_rad[:, self.joint - 1]
        cos, sin, none = np.cos(q_rad), np.sin(q_rad), np.zeros(len(q_rad))
        twice = [np.cos(2.0 * q_rad), np.sin(2.0 * q_rad)]
        about_x, about_y = [cos, sin, *twice, none, none], [-sin, cos, none, none, *twice]
        tilts = np.stack([np.stack(about_x, axis=1), np.stack(about_y, axis=1)], axis=1)
        return tilts if self.of_base is None else np.einsum("cm,pck->pmk", self.of_base, tilts)


def _tilts_of_base(arm: Arm) -> tuple[tuple[float, ...], ...]:
    """Return which motions of the base tilt the first joint about its x and its y, (2, 6)."""
    chain = Chain.of(arm)
    T_base_joint = frames(chain, chain.nominal[None]).T_base_joints[0, 0]
    axes, place = T_base_joint[:3, :2].T, T_base_joint[:3, 3]
    motions = np.hstack([np.cross(place, axes), axes])
    return tuple(tuple(motion) for motion in motions.tolist())


@dataclass(frozen=True)
class BaseCompliance(Effect):
    """The base tilts about x and y by cx M_x and cy M_y, M the overturning moment.

    cx and cy in rad/(N m), M about the base's origin along base axes.
    """

    # moment at which a plausible tilt is reached, where weights are assumed; None where they are
    # stated
    moment_of_arm_Nm: float | None = field(default=None, metadata={OPTIONAL: True})
    bends = True
    id = "base_compliance"
    clauses = ("the base tilts under the arm's weight",)
    sits = "base"
    words = "base.rx += cx M_x, base.ry += cy M_y, M the overturning moment"
    coordinates = ("base.rx", "base.ry")
    positive = True
    weights_power = -1.0
    # A pedestal of which the top turns by this much stands loose: 1 mm for each 0.1 m of height.
    most_rad = (0.01, "no base that is bolted down tilts by more than 10 mrad")

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...]:
        return (moment_of_arm_Nm(context.arm),)

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        of_arm_Nm = self.moment_of_arm_Nm
        return tuple(compliance(name, 1e-7, 3e-6, of_arm_Nm) for name in ("cx", "cy"))

    def per_unit(self, states: PoseStates) -> Array:
        """Return the overturning moments, each for its own tilt, (P, 2, 2)."""
        return static_loads_in(states, self).base_Nm[:, :2, None] * np.eye(2)


@dataclass(frozen=True)
class ToolSag(Effect):
    """The tooling gives way by c [m] times the part of gravity's direction across its axis."""

    id = "tool_sag"
    clauses = ("the tool sags under its weight",)
    sits = "tool"
    words = "tool.x, tool.y += c times the part of the unit vector of gravity along them"
    reported = (TermParameter("c", "m", 3e-6, plausible=1e-4),)
    coordinates = ("tool.x", "tool.y")
    positive = True

    def per_unit(self, states: PoseStates) -> Array:
        return static_loads_in(states, self).down_ee[:, :2]


# What changes while a campaign lasts.

_SECONDS_AN_HOUR = 3600.0
#: Amplitude expected of the slowest wave of a base that drifts; of others a part as of a random
#: walk.
_WAVE_M = 1e-4


@dataclass(frozen=True)
class BaseDrift(Effect):
    """The base moves along its axes at a constant rate [m/h], counted from the first reading.

    In its slow form it moves by a few cosines of the time besides, and stands still before the
    first and after the last reading, where nothing is known of it. In poses of no time (nan) it is
    where its frame has it.
    """

    start_s: float  # time of the first reading
    end_s: float | None = None  # time of the last one; None of a constant rate, which goes on
    waves: int = 0  # cosines along each axis, of half a cycle more each; 0 of a constant rate
    id = "base_drift"
    depends_on = "time_s"
    clauses = ("the base moved while the campaign lasted",)
    sits = "base"
    coordinates = BASE[:3]
    goes_with_time = True

    @property
    def formula(self) -> str:
        rate = f"base.x, base.y, base.z += rate (time_s - {self.start_s:g}) / 3600"
        if self.end_s is None:
            return rate
        return (
            f"{rate} + sum of wave_k cos(k pi (time_s - {self.start_s:g}) / "
            f"{self.end_s - self.start_s:g}), time_s held at {self.start_s:g} and {self.end_s:g}"
        )

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...]:
        return (context.time_span_s[0],)

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        rates = [TermParameter(f"rate_{axis}", "m/h", 1e-6, plausible=3e-5) for axis in "xyz"]
        waves = [
            TermParameter(f"wave_{k}_{axis}", "m", 1e-6, plausible=_WAVE_M / k)
            for k in range(1, self.waves + 1)
            for axis in "xyz"
        ]
        return (*rates, *waves)

    def per_unit(self, states: PoseStates) -> Array:
        """Return hours since the first reading, then waves, each axis for itself."""
        last_s = np.inf if self.end_s is None else self.end_s
        first_s = -np.inf if self.end_s is None else self.start_s
        since_s = np.clip(time_in(states, self), first_s, last_s) - self.start_s  # nan: not given
        courses = [since_s / _SECONDS_AN_HOUR]
        courses += [
            np.cos(np.pi * k * since_s / (last_s - self.start_s)) for k in range(1, self.waves + 1)
        ]
        known = np.nan_to_num(np.stack(courses, axis=1))
        return np.asarray(known[:, None, :, None] * np.eye(3)[:, None, :])


@dataclass(frozen=True)
class ThermalGrowth(Effect):
    """Pedestal and long links grow by alpha (T - reference), alpha in 1/K."""

    lengths: tuple[str, ...]  # chain coordinates of these links' lengths
    lengths_m: tuple[float, ...]  # their nominal values
    reference_temperature_C: float  # temperature at which lengths are nominal
    id = "thermal_growth"
    depends_on = "temperature_C"
    clauses = ("the links grow with temperature",)
    sits = "arm"
    positive = True
    goes_with_time = True
    reported = (TermParameter("alpha", "1/K", 5e-7, plausible=2e-5),)
    # A part of the arm may stay colder than the air, and so seem to grow less than its material.
    possible = (0.0, 2.6e-5, "arms are of iron and steel (10 to 13e-6) or light metal (to 26e-6)")

    @property
    def formula(self) -> str:
        return (
            f"{', '.join(self.lengths)} += alpha (temperature_C - "
            f"{self.reference_temperature_C:g}) times its nominal length"
        )

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...]:
        chain = Chain.of(context.arm)
        ends = [0, *(int(column) for column in chain.joint_columns)]
        pedestal = range(ends[0], ends[2] if len(ends) > 2 else len(chain.motions))
        links = (range(ends[row], ends[row + 1]) for row in long_links(context.arm))
        columns = [
            column
            for link in (pedestal, *links)
            for column in link
            if chain.nominal[column] != 0.0 and not chain.motions[column].turns
        ]
        lengths = tuple(chain.motions[column].coordinate for column in columns)
        lengths_m = tuple(float(chain.nominal[column]) for column in columns)
        return lengths, lengths_m, context.reference_temperature_C

    @property
    def coordinates(self) -> tuple[str, ...]:
        return self.lengths

    def per_unit(self, states: PoseStates) -> Array:
        return np.outer(states.temperature_C - self.reference_temperature_C, self.lengths_m)


# Effects of an instrument that reads the places of its targets falsely.


@dataclass(frozen=True)
class FalseReading(Effect):
    """The instrument reads each target's place p off by a field e(p), and so the pose.

    The model predicts what is read: the end moves by what the field makes of the fitted pose.
    """

    falsifies_readings = True
    sits = "instrument"
    coordinates = TOOL

    @abstractmethod
    def field(self, p_instr_m: Array) -> Array:
        """Return e(p) a unit of each parameter, (P, B, 3, k), at places p (P, B, 3)."""

    def derivative(self, states: PoseStates, x: Array) -> Array:
        seen = seen_in(states, self)
        count, targets, _ = seen.p_instr_targets_m.shape
        field = self.field(seen.p_instr_targets_m).reshape(count, 3 * targets, len(x))
        derivative: Array = seen.pose_by_targets @ field
        return derivative


@dataclass(frozen=True)
class CmmScale(FalseReading):
    """Axis k of the instrument reads (1 + s_k) times the length, s without unit.

    Only a machine that moves along three axes has a scale to each; see `Scale`.
    """

    by_differences = True
    id = "cmm_scale"
    clauses = ("the scales of the instrument's axes are off",)
    words = "reading of x, y, z = (1 + s_x) x, (1 + s_y) y, (1 + s_z) z"
    reported = tuple(TermParameter(f"s_{axis}", "1", 3e-6, plausible=1e-4) for axis in "xyz")

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        return None if context.three_axes is False else ()

    def field(self, p_instr_m: Array) -> Array:
        return p_instr_m[..., None] * np.eye(3)


@dataclass(frozen=True)
class Scale(FalseReading):
    """The instrument reads (1 + s) times every length, whatever its direction, s without unit.

    Trackers and cameras have one: that of a wavelength, of a base line or of a tag.
    """

    id = "scale"
    clauses = ("the instrument's scale is off",)
    words = "reading of x, y, z = (1 + s) x, (1 + s) y, (1 + s) z"
    reported = (TermParameter("s", "1", 3e-6, plausible=1e-4),)

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        return None if context.three_axes else ()

    def field(self, p_instr_m: Array) -> Array:
        return p_instr_m[..., None]


@dataclass(frozen=True)
class RangeConstant(FalseReading):
    """The instrument reads every distance from itself longer by c, in m.

    A tracker's distance meter has a zero of its own, and a reflector a radius that is stated. Its
    frame begins where its beams do; where readings are given in another frame it is not known.
    """

    id = "range_constant"
    clauses = ("the instrument reads all distances too long by one length",)
    words = "reading of x, y, z += c times the unit vector from the instrument to the target"
    reported = (TermParameter("c", "m", 1e-6, plausible=1e-4),)

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        """Return that it may be there where beams come from outside of the arm's reach."""
        if context.three_axes is None:  # it is asked for
            return ()
        outside = np.linalg.norm(context.p_instr_middle_m) > context.arm.reach_m
        return () if outside and not context.three_axes else None

    def field(self, p_instr_m: Array) -> Array:
        length_m = np.linalg.norm(p_instr_m, axis=-1, keepdims=True)
        along: Array = p_instr_m / np.maximum(length_m, np.finfo(float).tiny)
        return along[..., None]


@dataclass(frozen=True)
class CmmSquareness(FalseReading):
    """The instrument's x axis is not square to y: x reads x + xy y, xy in rad."""

    id = "cmm_squareness"
    clauses = ("the instrument's axes are not square",)
    words = "reading of x = x + xy y"
    reported = (TermParameter("xy", "rad", 3e-6, plausible=1e-4),)

    def field(self, p_instr_m: Array) -> Array:
        field: Array = p_instr_m[..., 1:2] * np.array([1.0, 0.0, 0.0])
        return field[..., None]
