"""Effects of joints: errors of their angles, deflections under torque, errors of logged torques."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, Self

import numpy as np

from pa10cal.arm.description import Arm, neighbouring_axes, weights_known
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.errors import CalibrationError
from pa10cal.terms.effects import effect
from pa10cal.terms.effects.context import CandidateContext, driven_joints, turning_joints
from pa10cal.terms.term import OPTIONAL, JointTorqueOnly, Report, TermParameter

#: Largest deflection of a joint under its torque [rad], and why. An assumption: twice the 23 mrad
#: of the softest arm measured, that of a humanoid with torque sensors in its joints.
WINDS_UP = (0.05, "no joint of an arm winds up by more than 50 mrad")
#: Least reach of the arms for which that holds [m]. Shorter arms may sag as far at their ends: they
#: are driven by servos of toys and models, whose joints give way by degrees.
WINDS_UP_REACH_M = 1.0
#: The same where positions are those commanded: a servo without integral control stops short by up
#: to its proportional band.
STOPS_SHORT = (0.2, "no servo stops short of its command by more than 200 mrad")


def most_wound_up(reach_m: float, *, commanded: bool = False) -> tuple[float, str]:
    """Return the largest deflection of a joint [rad] of an arm with this reach, and why."""
    if commanded:
        return STOPS_SHORT
    if reach_m >= WINDS_UP_REACH_M:
        return WINDS_UP
    most_rad = min(WINDS_UP[0] * WINDS_UP_REACH_M / reach_m, STOPS_SHORT[0])
    of_short = f"no joint of an arm that reaches {reach_m:.2g} m winds up by more than "
    return most_rad, f"{of_short}{1e3 * most_rad:.0f} mrad"


@dataclass(frozen=True)
class GearRatioError(effect.JointEffect):
    """A gear ratio off its nominal value: eps q_j, eps without unit.

    Of a joint that slides it is a wrong pitch of its rack or lead of its screw.
    """

    slides: bool = field(default=False, metadata={OPTIONAL: True})  # whether the joint slides
    id = "gear_ratio_error"
    sits = "driven joint"
    nouns = ("gear ratio", "gear ratios")
    clauses = ("the gear ratio of {at} is off", "the gear ratios of {at} are off")
    words = "{0.coordinates[0]} += eps q_{0.joint}"
    reported = (TermParameter("eps", "1", 1e-5, plausible=3e-4),)
    curve_of = "gear"

    @property
    def as_scale_of_instrument(self) -> bool:
        return self.slides

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        """Return it at joints with a gear, and where a joint slides, be it by another's motor."""
        sliding = (np.flatnonzero(context.arm.prismatic) + 1).tolist()
        joints = sorted([*driven_joints(context), *sliding])
        return tuple(cls(f"joint {joint}", joint in sliding) for joint in joints)

    @property
    def coordinates(self) -> tuple[str, ...]:
        return (f"{'d' if self.slides else 'theta'}_{self.joint}",)

    def per_unit(self, states: PoseStates) -> Array:
        return states.q_rad[:, self.joint - 1]


@dataclass(frozen=True)
class Backlash(effect.JointEffect):
    """Lost motion: -b s_j [rad], s_j the direction in which the joint arrived.

    q is the angle of the motor. The gear's flank pushes the link, so the link lags behind the
    motor by half of the reversal error (ISO 230-2): b > 0.
    """

    id = "backlash"
    sits = "driven joint"
    varies_with = "the direction of arrival"
    clauses = ("{at} has lost motion", "{at} have lost motion")
    # Half of the reversal error. An assumption: makers state up to 15 arcmin for standard planetary
    # gears; worn and hobbyists' gears get four times that.
    limits = effect.Limits(
        positive=True, values=(0.0, 8.7e-3), why="gears of arms have at most 1 deg of play"
    )
    words = "theta_{0.joint} -= b s_{0.joint}"
    reported = (TermParameter("b", "rad", 1e-5, plausible=3e-4),)

    @property
    def arriving(self) -> tuple[int, ...]:
        return (self.joint,)

    def per_unit(self, states: PoseStates) -> Array:
        return -states.arrival[:, self.joint - 1]


# Joints whose drives run through others: a wrist's shafts and gears, belts along an arm, quills.

#: Distance below which two axes count as one [m]: a quill slides along the axis about which it
#: turns.
_ONE_AXIS_M = 1e-3


def moved_along(arm: Arm) -> dict[int, int]:
    """Return, by joint from 1, the other joint whose rotation may move it a little.

    That depends on how drives are built: a belt, a chain or a parallelogram along the link before
    may drive a joint whose axis is parallel to the one before; the shafts of a wrist whose axes
    cross run through its first joint; a quill slides along the axis about which it turns. The last
    joint and the one before it are left to `wrist_coupling`.
    """
    n, slides, found = arm.n, arm.prismatic, {}
    between = neighbouring_axes(arm)
    for axes in between:
        one, other = axes.joints
        if not axes.parallel:
            continue
        if not slides[one - 1] and not slides[other - 1] and other < n:
            found[other] = one
        elif slides[one - 1] != slides[other - 1] and abs(arm.a_m[axes.row - 1]) < _ONE_AXIS_M:
            slide, turns = (one, other) if slides[one - 1] else (other, one)
            found[slide] = turns
    crossing = n > 3 and not any(axes.parallel for axes in between[-2:])
    if crossing and not slides[-3:].any():
        found |= {n - 1: n - 2, n: n - 2}
    # Where one motor drives two joints, the other joint's share of it is a gear ratio.
    return {joint: by for joint, by in found.items() if joint - 1 in arm.coupling.own}


@dataclass(frozen=True)
class JointCoupling(effect.AtJoint):
    """A joint moves as another turns, through whose axis its drive runs: c q_k, c without unit.

    Of a joint that slides, such as a quill that rises as it turns, c is in m/rad.
    """

    by: int  # k, the joint that turns, from 1
    slides: bool  # whether the joint that moves does
    id = "joint_coupling"
    varies_with = "the position of another joint"
    nouns = ("coupling", "couplings")
    clauses = (
        "{at} moves a little as another joint turns",
        "{at} move a little as other joints turn",
    )
    words = "{0.coordinates[0]} += c q_{0.by}"

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        arm = context.arm
        return tuple(
            cls(f"joint {joint}", by, bool(arm.prismatic[joint - 1]))
            for joint, by in sorted(moved_along(arm).items())
        )

    @property
    def by_joint(self) -> int:
        return self.by

    @property
    def coordinates(self) -> tuple[str, ...]:
        return (f"{'d' if self.slides else 'theta'}_{self.joint}",)

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        if self.slides:  # tenths of a millimetre to a few millimetres for a turn
            return (TermParameter("c", "m/rad", 1e-5, plausible=3e-4),)
        return (TermParameter("c", "1", 3e-5, plausible=1e-3),)

    def per_unit(self, states: PoseStates) -> Array:
        return states.q_rad[:, self.by - 1]


@dataclass(frozen=True)
class WristCoupling(effect.Effect):
    """The last joint turns with the one before it: c q_(n-1) [rad], c without unit."""

    last: int  # the last joint, n
    id = "wrist_coupling"
    varies_with = "the position of the joint before the last"
    clauses = ("the last joint is turned along by the one before it",)
    sits = "wrist"
    words = "theta_{0.last} += c q_{0.by_joint}"
    reported = (TermParameter("c", "1", 3e-5, plausible=1e-3),)

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        """Return the last joint, if it has a motor and it and the one before it turn."""
        last = context.arm.n
        driven, turning = driven_joints(context), turning_joints(context)
        return (last,) if last in driven and last - 1 in turning else None

    @property
    def by_joint(self) -> int:
        return self.last - 1

    @property
    def coordinates(self) -> tuple[str, ...]:
        return (f"theta_{self.last}",)

    def per_unit(self, states: PoseStates) -> Array:
        return states.q_rad[:, self.by_joint - 1]


# Periodic errors of a joint's angle: encoder disks and harmonic drives.


@dataclass(frozen=True)
class JointHarmonic(effect.AtJoint):
    """A sin(order q_j + phi), solved in its parts A cos phi (sine) and A sin phi (cosine)."""

    order: float  # cycles a turn of the joint
    words = "theta_{0.joint} += A sin({0.order:g} q_{0.joint} + phi)"
    order_stated: ClassVar[float]  # the order of a class that has one at every joint
    plausible_rad = 3e-4
    amounts_stand_alone = False

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        return (cls.order_stated,)

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        """Return sine and cosine part, which `report` turns into amplitude and phase."""
        return tuple(
            TermParameter(part, "rad", 1e-5, plausible=self.plausible_rad)
            for part in ("sin", "cos")
        )

    def per_unit(self, states: PoseStates) -> Array:
        return sine_and_cosine(self.order * states.q_rad[:, self.joint - 1])

    def report(self, x: Array) -> Report:
        return amplitude_and_phase(x, "rad")


def sine_and_cosine(phase: Array) -> Array:
    """Return sine and cosine of phases (P,), (P, 2)."""
    return np.stack([np.sin(phase), np.cos(phase)], axis=-1)


def amplitude_and_phase(x: Array, unit: str) -> Report:
    """Report a sine and a cosine part (2,) as A and phi of A sin(... + phi)."""
    amplitude = float(np.hypot(*x))
    phase = float(np.arctan2(x[1], x[0]))
    size = max(amplitude, np.finfo(float).tiny)
    jacobian = np.array(
        [[np.cos(phase), np.sin(phase)], [-np.sin(phase) / size, np.cos(phase) / size]]
    )
    names = (TermParameter("A", unit, 1e-5), TermParameter("phi", "rad", 1.0))
    return Report(names, np.array([amplitude, phase]), jacobian)


@dataclass(frozen=True)
class TransmissionError(JointHarmonic):
    """Kinematic error of a harmonic drive: two cycles a turn of the wave generator."""

    id = "transmission_error"
    sits = "driven joint"
    clauses = (
        "the gear of {at} errs twice a turn of its motor",
        "the gears of {at} err twice a turn of their motors",
    )

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        """Return twice the gear ratio; nan where that is not known."""
        return (2.0 * float(context.arm.gear_ratio[joint - 1]),)

    def per_unit(self, states: PoseStates) -> Array:
        """Return sine and cosine of order q_j.

        Raises:
            CalibrationError: when the gear ratio is not known.
        """
        if np.isnan(self.order):
            raise CalibrationError(
                "the gear ratio of the joint is not known",
                where=f"{self.id} of {self.of}",
                allowed="an arm description with gear_ratio",
                remedy="add it to the joint's row",
            )
        return super().per_unit(states)


@dataclass(frozen=True)
class EncoderEccentricity(JointHarmonic):
    """An encoder disk off its centre: one cycle a turn of the joint."""

    id = "encoder_eccentricity"
    sits = "driven joint"
    clauses = (
        "the position sensor of {at} is off centre",
        "the position sensors of {at} are off centre",
    )
    order_stated = 1.0
    curve_of = "sensor"


@dataclass(frozen=True)
class EncoderEllipticity(JointHarmonic):
    """An encoder disk out of round: two cycles a turn of the joint."""

    id = "encoder_ellipticity"
    sits = "driven joint"
    clauses = (
        "the position sensor of {at} errs twice a turn",
        "the position sensors of {at} err twice a turn",
    )
    order_stated = 2.0
    curve_of = "sensor"


# A periodic error whose number of cycles a turn is found from the data; of gears `gear_line`.


@dataclass(frozen=True)
class PeriodicError(JointHarmonic):
    """A sin(k q_j + phi) with a whole number k, in place of a map that is no better than this.

    It is not sought: k is that of the short form that does as well as the map
    (`discovery/short_forms`). One and two cycles, and those of the gear, have names of their own.
    """

    order: float = 3.0  # k; by default the lowest without another name
    id = "periodic_error"
    clauses = (
        "{at} turns wrongly in even waves of its angle",
        "{at} turn wrongly in even waves of their angles",
    )
    order_stated = 3.0
    role_in_search = "proposed"

    def report(self, x: Array) -> Report:
        known = super().report(x)
        order = TermParameter("k", "1", 1.0)
        return replace(
            known,
            parameters=(*known.parameters, order),
            values=np.append(known.values, self.order),
            jacobian=np.vstack([known.jacobian, np.zeros(2)]),
        )


# Errors of logged torques: the log shows another torque than the joint carries.


@dataclass(frozen=True)
class FalseTorque(JointTorqueOnly, effect.JointEffect):
    """An error of one joint's logged torque, with a single parameter; no joint carries it."""

    acts_on_joint = False
    error_of = "log"
    sits = "driven joint"
    weighed_as: ClassVar[Literal["friction_Nm", "gain"]]  # the error in `WeighedByLog`

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        """Return its fields; None also where it was taken out of the log."""
        by_log = weights_known(context.arm).by_log
        if by_log is not None and getattr(by_log, cls.weighed_as)[joint - 1 : joint].any():
            return None
        return super().fields_at(context, joint)


@dataclass(frozen=True)
class FrictionTorque(FalseTorque):
    """Coulomb friction in the log: logged torque = tau_j + tau_c s_j, tau_c in N m."""

    rated_Nm: float  # rated torque of the joint
    id = "friction_torque"
    weighed_as = "friction_Nm"
    varies_with = "the direction of arrival"
    clauses = (
        "the logged torque of {at} holds friction",
        "the logged torques of {at} hold friction",
    )
    words = "logged tau_{0.joint} = tau_{0.joint} + tau_c s_{0.joint}"
    limits = effect.Limits(positive=True)

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        return (
            TermParameter("tau_c", "N m", 1e-3 * self.rated_Nm, plausible=0.03 * self.rated_Nm),
        )

    def per_unit(self, states: PoseStates) -> Array:
        return states.arrival[:, self.joint - 1]


@dataclass(frozen=True)
class TorqueGain(FalseTorque):
    """A wrong scale of the torque: logged torque = (1 + g) tau_j, g without unit.

    tau_j is computed from the weights: with the logged one, its noise would explain itself.
    """

    id = "torque_gain"
    weighed_as = "gain"
    varies_with = "its logged torque"
    clauses = (
        "the logged torque of {at} is off by a factor",
        "the logged torques of {at} are off by factors",
    )
    words = "logged tau_{0.joint} = (1 + g) tau_{0.joint}"
    reported = (TermParameter("g", "1", 1e-3, plausible=0.05),)

    def per_unit(self, states: PoseStates) -> Array:
        return effect.static_loads_in(states, self).joint_Nm[:, self.joint - 1]


# Deflections of a joint under its torque beyond the springs of the model.

#: Least compliance of which a stiffness is reported, so that it stays finite [rad/(N m)].
_RIGID = 1e-12


@dataclass(frozen=True)
class WindsUp(effect.JointEffect):
    """A joint that deflects further under the torque that it carries."""

    rated_Nm: float  # rated torque of the joint
    sits = "driven joint"
    varies_with = "its torque"
    yields = True
    limits = effect.Limits(positive=True, turn_rad=WINDS_UP[0], why=WINDS_UP[1])

    def limits_at(self, reach_m: float) -> effect.Limits:
        turn_rad, why = most_wound_up(reach_m)
        return replace(self.limits, turn_rad=turn_rad, why=why)

    def tau_Nm(self, states: PoseStates) -> Array:
        """Return the torque that the joint carries, (P,)."""
        return states.tau_Nm[:, self.joint - 1]


@dataclass(frozen=True)
class JointCompliance(WindsUp):
    """A spring at a joint that the model holds rigid: deflection tau_j / K, K in N m/rad.

    Solved in the compliance 1/K [rad/(N m)], zero for a rigid joint.
    """

    id = "joint_compliance"
    nouns = ("spring", "springs")
    clauses = ("{at} gives way under the arm's weight", "{at} give way under the arm's weight")
    words = "theta_{0.joint} -= tau_{0.joint} / K"

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        """Return the rated torque of a joint without a spring."""
        return None if joint in context.flexible_joints else super().fields_at(context, joint)

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        """Return the compliance that is solved for, which `report` turns into the stiffness."""
        size = 1.0 / (100.0 * self.rated_Nm)
        return (TermParameter("compliance", "rad/(N m)", 0.01 * size, lower=0.0, plausible=size),)

    def per_unit(self, states: PoseStates) -> Array:
        return -self.tau_Nm(states)

    def by_torque(self, states: PoseStates, x: Array) -> Array:
        return np.full(len(states), -x[0])

    def report(self, x: Array) -> Report:
        stiffness = 1.0 / max(float(x[0]), _RIGID)
        known = TermParameter("K", "N m/rad", 100.0 * self.rated_Nm)
        values = np.array([stiffness])
        return Report((known,), values, np.array([[-(stiffness**2)]]), by_weights=values)


@dataclass(frozen=True)
class SoftWindup(WindsUp):
    """A drive softer near zero torque: it deflects further by A tanh(tau_j / tau0).

    A in rad, tau0 in N m.
    """

    span_Nm: float  # largest torque that the joint carried
    id = "soft_windup"
    clauses = ("{at} is softer near zero torque", "{at} are softer near zero torque")
    words = "theta_{0.joint} -= A tanh(tau_{0.joint} / tau0)"
    linear = 1  # proportional to A; tau0 shapes it
    ranges_and_sizes = effect.Effect.ranges_and_sizes | {"span_Nm"}

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        span_Nm = self.span_Nm
        return (
            TermParameter("A", "rad", 1e-5, plausible=3e-4),
            TermParameter("tau0", "N m", 0.1 * span_Nm, lower=1e-3 * span_Nm, upper=3.0 * span_Nm),
        )

    def shift(self, states: PoseStates, x: Array) -> Array:
        return np.asarray(-x[0] * np.tanh(self.tau_Nm(states) / x[1])[:, None])

    def derivative(self, states: PoseStates, x: Array) -> Array:
        tau_Nm = self.tau_Nm(states)
        full = np.tanh(tau_Nm / x[1])
        by_tau0 = x[0] * (1.0 - full**2) * tau_Nm / x[1] ** 2
        return np.stack([-full, by_tau0], axis=-1)[:, None, :]

    def by_torque(self, states: PoseStates, x: Array) -> Array:
        return np.asarray(-x[0] / x[1] * (1.0 - np.tanh(self.tau_Nm(states) / x[1]) ** 2))

    @property
    def starts(self) -> tuple[Array, ...]:
        """Return zero amount at a tenth, a third and the whole of the torque carried."""
        turns_Nm = np.maximum(self.span_Nm * np.array([0.1, 0.3, 1.0]), 0.005 * self.rated_Nm)
        return tuple(np.array([0.0, tau0]) for tau0 in np.unique(turns_Nm))
