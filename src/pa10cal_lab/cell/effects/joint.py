"""Effects that sit in joints: transmissions, encoders, windup and the torque log."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field, ValidationInfo, field_validator
from scipy.interpolate import CubicSpline

from pa10cal.arrays import Array
from pa10cal.errors import SimulationError
from pa10cal_lab.cell.effects import effect

#: Amplitudes are those to expect of harmonic drives of the PA10's class: errors of 10 to 30 arc
#: seconds an order, lost motion up to 1 arc minute, motor torque off by a part of the Coulomb band.
MAP_KNOTS = 8
_MAP_ORDERS = 3
#: Stiffness of a joint for each N m of its rated torque, as of the joints known to yield.
STIFFNESS_PER_RATED = 120.0


class Harmonic(effect.SimulatedJointEffect):
    """A sine of the joint's angle, of the usual amplitude and in any phase."""

    usual_arc_seconds: ClassVar[float] = 30.0
    cycles: ClassVar[float]
    forms: ClassVar[tuple[str, ...]] = ("harmonic",)

    A: effect.Finite = Field(description="amplitude [rad]")
    phi: effect.Finite = Field(description="phase [rad]")

    @classmethod
    def at_size(cls, _site: effect.Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return the usual amplitude and any phase."""
        return {
            "A": size * cls.usual_arc_seconds * effect.ARC_SECOND,
            "phi": float(rng.uniform(-np.pi, np.pi)),
        }

    @classmethod
    def formula_numbers(cls, _parameters: Mapping[str, Any]) -> tuple[float, ...]:
        return (cls.cycles,)

    def cycles_of(self, _joint: effect.JointState) -> float:
        return self.cycles

    def at_joint(self, joint: effect.JointState) -> Array:
        return np.asarray(self.A * np.sin(self.cycles_of(joint) * joint.q_rad + self.phi))


class SimulatedGearLine(Harmonic):
    """A wheel of a gear off its centre: one cycle a turn of its own, k of the joint."""

    id = "gear_line"
    drawn = False  # `small_waves` have such lines, and `python -m benchmarks.gear_lines` draws them

    k: effect.FinitePositive = Field(description="turns of the wheel a turn of the joint")

    @classmethod
    def at_size(cls, site: effect.Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return it of a wheel that turns 30 to 160 times."""
        return super().at_size(site, size, rng) | {"k": float(rng.uniform(30.0, 160.0))}

    @classmethod
    def formula_numbers(cls, parameters: Mapping[str, Any]) -> tuple[float, ...]:
        return (parameters["k"],)

    def cycles_of(self, _joint: effect.JointState) -> float:
        return self.k


class SimulatedTransmissionError(Harmonic):
    """Kinematic error of a harmonic drive: two cycles a turn of the wave generator."""

    id = "transmission_error"
    trial_places = ("geared joint",)
    usual_arc_seconds = 20.0
    plausible_size = 3.1
    forms = ()  # no map follows so many cycles

    def cycles_of(self, joint: effect.JointState) -> float:
        """Return twice the gear ratio.

        Raises:
            SimulationError: when the gear ratio is not known.
        """
        ratio = float(joint.gear_ratio[0])
        if np.isnan(ratio):
            raise SimulationError(
                "the gear ratio is not known",
                where=f"{self.id} of joint {self.joint + 1}",
                allowed="an arm description with gear_ratio in the joint's row",
                remedy="add it, or hide another effect",
            )
        return 2.0 * ratio


class SimulatedEncoderEccentricity(Harmonic):
    """An encoder disk off its centre: one cycle a turn of the joint."""

    id = "encoder_eccentricity"
    cycles = 1.0
    plausible_size = 2.1


class SimulatedEncoderEllipticity(Harmonic):
    """An encoder disk out of round: two cycles a turn of the joint."""

    id = "encoder_ellipticity"
    cycles = 2.0
    plausible_size = 2.1


class SimulatedJointErrorMap(effect.SimulatedJointEffect):
    """An error that depends on the joint's angle, smooth and periodic in a turn.

    The knots are evenly spaced over one turn from q_j = 0; a cubic spline joins them.
    """

    id = "joint_error_map"
    plausible_size = 2.1

    knots: Annotated[tuple[effect.Finite, ...], Field(min_length=3)] = Field(
        description="errors at the knots [rad]"
    )

    @classmethod
    def at_size(cls, _site: effect.Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return a map of orders 1 to 3 in equal parts, whose largest knot is 30 arc seconds."""
        angle = 2.0 * np.pi * np.arange(MAP_KNOTS) / MAP_KNOTS
        phase = rng.uniform(-np.pi, np.pi, _MAP_ORDERS)
        waves = np.cos(np.outer(angle, np.arange(1, _MAP_ORDERS + 1)) + phase).sum(axis=1)
        return {"knots": (size * 30.0 * effect.ARC_SECOND * waves / np.abs(waves).max()).tolist()}

    def at_joint(self, joint: effect.JointState) -> Array:
        closed = [*self.knots, self.knots[0]]
        angles = np.linspace(0.0, 2.0 * np.pi, len(closed))
        spline = CubicSpline(angles, closed, bc_type="periodic")
        return np.asarray(spline(joint.q_rad))


class SimulatedGearRatioError(effect.SimulatedJointEffect):
    """A joint that turns by a little more than its ratio says."""

    id = "gear_ratio_error"
    usual = effect.draws(eps=effect.signed(2e-4))
    plausible_size = 1.5

    eps: effect.Finite = Field(description="relative excess")

    def at_joint(self, joint: effect.JointState) -> Array:
        return self.eps * joint.q_rad


class SimulatedBacklash(effect.SimulatedJointEffect):
    """Lost motion: the motor takes up the play before it moves the link, which stays behind."""

    id = "backlash"
    # A sign is drawn and not taken, so that what is drawn after it stays as it was.
    usual = effect.draws(
        b=lambda _site, size, rng: abs(effect.either_sign(20.0 * effect.ARC_SECOND * size, rng))
    )
    plausible_size = 3.1

    b: effect.Finite = Field(description="half the lost motion [rad]")

    def at_joint(self, joint: effect.JointState) -> Array:
        return -self.b * joint.arrival


class SimulatedFrictionTorque(effect.TorqueLogEffect):
    """Friction holds part of the load or adds to it, by the direction of arrival.

    It usually is a part of the joint's Coulomb friction.
    """

    id = "friction_torque"
    usual = effect.draws(tau_c=lambda site, size, _rng: size * 0.15 * site.coulomb_Nm)
    plausible_size = 2.0

    tau_c: effect.Finite = Field(description="torque that friction holds [N m]")

    def at_joint(self, joint: effect.JointState) -> Array:
        return self.tau_c * joint.arrival


class SimulatedTorqueGain(effect.TorqueLogEffect):
    """The motor's torque constant is not what the log assumes."""

    id = "torque_gain"
    trial_places = ("loaded joint",)
    in_log_alone = True
    usual = effect.draws(g=effect.signed(0.04))
    plausible_size = 1.25

    g: effect.Finite = Field(description="relative excess of the logged torque")

    def at_joint(self, joint: effect.JointState) -> Array:
        return self.g * joint.tau_Nm


class SimulatedJointCompliance(effect.LoadedJointEffect):
    """A joint held rigid by the paper's model yields after all.

    It usually is as stiff as joints known to yield are, for its rated torque.
    """

    id = "joint_compliance"
    places = ("rigid joint",)
    trial_places = ("rigid loaded joint",)
    in_every_model = True
    usual = effect.draws(K=lambda site, size, _rng: STIFFNESS_PER_RATED * site.rated_Nm / size)
    plausible_size = 1.2

    K: effect.FinitePositive = Field(description="stiffness [N m/rad]")

    def at_joint(self, joint: effect.JointState) -> Array:
        return -joint.tau_Nm / self.K


class SimulatedSoftWindup(effect.LoadedJointEffect):
    """Extra deflection, softer near zero torque: most of it below a fifth of the typical one."""

    id = "soft_windup"
    trial_places = ("loaded joint",)
    usual = effect.draws(A=effect.sized(1e-4), tau0=lambda site, _size, _rng: 0.2 * site.typical_Nm)
    plausible_size = 3.0

    A: effect.Finite = Field(description="extra deflection under large torque [rad]")
    tau0: effect.FinitePositive = Field(description="torque by which most of it has come [N m]")

    def at_joint(self, joint: effect.JointState) -> Array:
        bent: Array = self.A * np.tanh(joint.tau_Nm / self.tau0)
        return -bent


class SimulatedWristCoupling(effect.JointsEffect):
    """The last joint turns along with the joint before it."""

    id = "wrist_coupling"
    places = ("wrist",)
    usual = effect.draws(c=effect.signed(5e-4))
    plausible_size = 2.0

    c: effect.Finite = Field(description="turn of the last joint a turn of the one before")

    def added(self, motion: effect.JointState) -> Array:
        turn = np.zeros_like(motion.q_rad)
        turn[:, -1] = self.c * motion.q_rad[:, -2]
        return turn


class SimulatedJointCoupling(effect.JointsEffect):
    """A joint moves as another one turns: gears in its wrist, its belt, the screw of its quill."""

    id = "joint_coupling"
    places = ("any joint",)
    drawn = False
    usual = effect.draws(c=effect.signed(1e-3))

    c: effect.Finite = Field(description="motion of the joint by a turn of the other [1; m/rad]")
    by: Annotated[int, Field(ge=0)] = Field(
        0, description="number of the joint that turns; 0 for the one before"
    )

    def added(self, motion: effect.JointState) -> Array:
        """Return the motion of the joint that is moved along.

        Raises:
            SimulationError: where there is no such other joint.
        """
        turns = self.by - 1 if self.by else self.joint - 1
        count = motion.q_rad.shape[1]
        if turns == self.joint or not 0 <= turns < count:
            raise SimulationError(
                "no other joint turns there",
                where=f"{self.id} of {self.of}",
                value=turns + 1,
                allowed=f"by: another joint, from 1 to {count}",
                remedy="correct `by`",
            )
        moved = np.zeros_like(motion.q_rad)
        moved[:, self.joint] = self.c * motion.q_rad[:, turns]
        return moved


class SimulatedAlongMove(effect.JointsEffect):
    """The arm is read a little before, or after, its log says where it stands.

    All joints brake together, the one that goes furthest as hard in every move: what is left of a
    move then is as far for it, and for the others in proportion; of a short move no more than it.
    """

    id = "along_move"
    places = ("arm",)
    drawn = False
    usual = effect.draws(c=effect.signed(3e-4))

    c: effect.Finite = Field(description="how far the joint that goes furthest is ahead [rad]")

    def added(self, motion: effect.JointState) -> Array:
        furthest = np.abs(motion.move).max(axis=1, keepdims=True)
        part = np.clip(self.c / np.maximum(furthest, 1e-9), -1.0, 1.0)
        return np.asarray(part * motion.move)


class SimulatedMoveSettling(effect.JointsEffect):
    """The end of the arm is braked as hard in every move, and read before it stands.

    It then has the square of its speed left to go, of a speed that goes with how far it is carried
    as the joint that goes furthest turns.
    """

    id = "move_settling"
    places = ("arm",)
    drawn = False
    usual = effect.draws(c=effect.signed(1e-3))

    c: effect.Finite = Field(
        description="way left of the end over the square of how far a radian of the joint that "
        "goes furthest carries it [1/m]"
    )

    def added(self, motion: effect.JointState) -> Array:
        furthest = np.maximum(np.abs(motion.move).max(axis=1), 1e-9)
        speed_m = motion.end_goes_m / furthest
        left_m = self.c * speed_m**2
        part = np.clip(left_m / np.maximum(motion.end_goes_m, 1e-9), -1.0, 1.0)
        return np.asarray(part[:, None] * motion.move)


# Errors of a drive: of the sensor behind the gear, or of the gear itself, and the motor's position.
#
# A controller turns the motor until the sensor at the output reads the commanded angle. An error of
# the sensor is then one of the true angle, and the motor is at the gear ratio times the true angle.
# With an error of the gear, the motor is at the gear ratio times the commanded angle. Cogging
# shifts the motor from its target by an amount that depends on its own angle, in joints that moved.

#: Orders of the band in which such errors lie, and their root mean square over a turn.
_BAND = (6, 30)
_USUAL_ARC_SECONDS = 55.0
#: Multiples of the ratio at which motors cog, how many of them one motor shows, how far they move
#: the joint, and the motor turns a joint turn of a gear. One of them makes so many cycles a joint
#: turn, and none makes more than so many.
_COGS = (4, 8, 10, 12, 16, 20, 24, 36)
_LINES = (3, 5)
_COG_ARC_SECONDS = 8.0
RATIOS = (50.0, 160.0)
_FINE, _FINEST = 1500.0, 4000.0

Amplitudes = tuple[effect.Finite, ...]


def drawn_ratio(rng: np.random.Generator) -> float:
    """Return the ratio of a gear."""
    return float(rng.integers(int(RATIOS[0]), int(RATIOS[1]), endpoint=True))


def drawn_cogs(ratio: float, count: int, rng: np.random.Generator) -> list[int]:
    """Return the cogs of a motor at a gear, one of them fine."""
    cycles = ratio * np.array(_COGS)
    fine = rng.choice(np.flatnonzero((cycles >= _FINE) & (cycles <= _FINEST)))
    others = np.setdiff1d(np.flatnonzero(cycles <= _FINEST), [fine])
    chosen = [fine, *rng.choice(others, count - 1, replace=False)]
    return sorted(int(_COGS[k]) for k in chosen)


class SimulatedMotorRipple(effect.SimulatedJointEffect):
    """A joint stops where the cogging of its motor lets it."""

    id = "motor_ripple"
    named = False
    drawn = False

    ratio: effect.FinitePositive = Field(description="motor turns a joint turn")
    cogs: tuple[Annotated[int, Field(ge=1)], ...] = Field(description="cycles a motor turn")
    ripple: Amplitudes = Field(description="how far each moves the joint [rad]")
    ripple_phi: Amplitudes = Field(description="their phases [rad]")

    @classmethod
    def at_size(cls, _site: effect.Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return cogging as of servo motors at a gear, at `size` times its usual amplitude."""
        count = int(rng.integers(*_LINES, endpoint=True))
        ratio = drawn_ratio(rng)
        return {
            "ratio": ratio,
            "cogs": drawn_cogs(ratio, count, rng),
            "ripple": (
                size * _COG_ARC_SECONDS * effect.ARC_SECOND * rng.uniform(0.7, 1.4, count)
            ).tolist(),
            "ripple_phi": rng.uniform(-np.pi, np.pi, count).tolist(),
        }

    @field_validator("ripple", "ripple_phi", "A", "phi", check_fields=False)
    @classmethod
    def _one_each(cls, values: Amplitudes, info: ValidationInfo) -> Amplitudes:
        of = "cogs" if str(info.field_name).startswith("ripple") else "orders"
        if len(values) != len(info.data.get(of, values)):
            raise ValueError(f"as many as {of}")
        return values

    def at_joint(self, joint: effect.JointState) -> Array:
        """Return sum a sin(cogs ratio angle + phi) where the joint moved, at the motor's angle."""
        return self.stops_off_rad(joint, joint.q_rad)

    def stops_off_rad(self, joint: effect.JointState, stands_rad: Array) -> Array:
        """Return how far the joint stops off, (P,).

        Args:
            stands_rad: (P,) turns of the motor over the ratio.
        """
        phase = np.outer(stands_rad, self.ratio * np.array(self.cogs, dtype=float))
        off: Array = np.sin(phase + np.array(self.ripple_phi)) @ np.array(self.ripple)
        return np.where(joint.arrival == 0.0, 0.0, off)


class _ErrsByAngle(SimulatedMotorRipple):
    """A drive with an error of many cycles a turn, besides its ripple."""

    #: Whether the motor stands by the true angle; else by the angle commanded.
    by_sensor: ClassVar[bool]

    orders: tuple[Annotated[int, Field(ge=1)], ...] = Field(description="cycles a joint turn")
    A: Amplitudes = Field(description="amplitude of each [rad]")
    phi: Amplitudes = Field(description="phase of each [rad]")

    @classmethod
    def at_size(cls, site: effect.Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return a broad band of cycles, at `size` times its usual size, and ripple."""
        orders = list(range(_BAND[0], _BAND[1] + 1))
        amplitudes = rng.rayleigh(1.0, len(orders))
        usual = np.sqrt(2.0) * _USUAL_ARC_SECONDS * effect.ARC_SECOND
        return {
            **super().at_size(site, 1.0, rng),
            "orders": orders,
            "A": (size * usual * amplitudes / np.linalg.norm(amplitudes)).tolist(),
            "phi": rng.uniform(-np.pi, np.pi, len(orders)).tolist(),
        }

    def at_joint(self, joint: effect.JointState) -> Array:
        """Return the error by the angle, and what cogging adds at the motor's angle."""
        phase = np.outer(joint.q_rad, self.orders) + np.array(self.phi)
        error: Array = np.sin(phase) @ np.array(self.A)
        stands_rad = joint.q_rad + error if self.by_sensor else joint.q_rad
        return error + self.stops_off_rad(joint, stands_rad)


class SimulatedSensorError(_ErrsByAngle):
    """The sensor at the joint's output errs, and the controller follows it."""

    id = "sensor_error"
    drawn = False
    by_sensor = True


class SimulatedGearError(_ErrsByAngle):
    """The gear errs, behind a motor that stands where it was commanded to."""

    id = "gear_error"
    drawn = False
    by_sensor = False
