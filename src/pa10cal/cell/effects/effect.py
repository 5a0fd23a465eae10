"""The kinds of effects, by what they act on, and what they may depend on.

An effect is one small class in a file of this folder: its fields are its parameters, the amount
first, `id` is its name, `places` says where it may sit, `usual` how large it usually is, and one
method its formula. Nothing else lists it.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import Field, PrivateAttr

from pa10cal.arrays import Array
from pa10cal.cell.robot import Mechanism, Statics, Strain
from pa10cal.options import Section

Finite = Annotated[float, Field(allow_inf_nan=False)]
FinitePositive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Triple = tuple[Finite, Finite, Finite]

ARC_SECOND = np.pi / (180.0 * 3600.0)
LONG_LINKS = ("upper_arm", "forearm")


@dataclass(frozen=True)
class Motion:
    """How the joints came to stand in P configurations."""

    q_rad: Array  # (P, n) motor-side joint positions; (P,) of one joint
    # (P, n) direction in which each joint arrived: -1, 0 (did not move) or +1; (P,) of one joint
    arrival: Array
    gear_ratio: Array  # (n,) motor turns a joint turn; (1,) of one joint

    def of(self, joint: int) -> Motion:
        """Return how one joint, from 0, came to stand."""
        ratio = self.gear_ratio[joint : joint + 1]
        return Motion(self.q_rad[:, joint], self.arrival[:, joint], ratio)


@dataclass(frozen=True)
class Loading:
    """What the structure bears in P configurations."""

    mechanism: Mechanism  # the links
    statics: Statics  # what weights bend them with
    time_s: Array  # (P,) times since the start of the campaign
    warming_K: Array  # (P,) temperatures above the reference

    def link(self, name: str) -> int:
        """Return the number, from 0, of `upper_arm` or `forearm`."""
        return self.mechanism.long_links[LONG_LINKS.index(name)]

    @property
    def none(self) -> Strain:
        """Return the unloaded shape."""
        return Strain.none(len(self.time_s), self.mechanism.n)


@dataclass(frozen=True)
class Site:
    """Where an effect is put in a trial, and what its usual size goes by."""

    of: str  # where it sits
    rated_Nm: float = 0.0  # rated torque of the joint; 0 of none
    typical_Nm: float = 0.0  # torque under which the joint usually stands; 0 of none
    coulomb_Nm: float = 0.0  # Coulomb friction of the joint; 0 of none
    half_m: float = 0.0  # how far the targets mostly lie from the middle of the measured volume
    # coordinates of that middle in the instrument's frame
    middle_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


def either_sign(amount: float, rng: np.random.Generator) -> float:
    """Return the amount with a sign drawn at random."""
    return amount * float(rng.choice([-1.0, 1.0]))


def any_direction(length: float, rng: np.random.Generator) -> list[float]:
    """Return the components of a vector of some length in a direction drawn at random."""
    vector = rng.standard_normal(3)
    components: list[float] = (length * vector / np.linalg.norm(vector)).tolist()
    return components


#: Draws one parameter of an effect at a site, at some times its usual size.
Draw = Callable[[Site, float, np.random.Generator], Any]


def draws(**each: Draw) -> Mapping[str, Draw]:
    """Return the draws of an effect's parameters by their names, in the order drawn."""
    return each


def sized(usual: float) -> Draw:
    """Return what draws a parameter that usually is so large."""
    return lambda _site, size, _rng: size * usual


def signed(usual: float) -> Draw:
    """Return what draws a parameter that usually is so large, with either sign."""
    return lambda _site, size, rng: either_sign(size * usual, rng)


def directed(usual: float) -> Draw:
    """Return what draws a vector that usually is so long, in any direction."""
    return lambda _site, size, rng: any_direction(size * usual, rng)


class Effect(Section):
    """Something that moves the arm, its log or its measurement off the paper's model.

    Its fields are its parameters; `at` puts it in its place.
    """

    id: ClassVar[str]
    #: Where it may sit; `joint` stands for any joint by its number, `rigid joint` for one
    #: without a spring, `loaded joint` for one that weights load.
    places: ClassVar[tuple[str, ...]]
    #: Whether it is in the vocabulary of effects; what is not can be hidden, but not be named.
    named: ClassVar[bool] = True
    #: Whether wild trials alone draw it.
    wild: ClassVar[bool] = False
    #: Whether blind or wild trials draw it; else a study of its own does.
    drawn: ClassVar[bool] = True
    #: Where trials put it so that it does something; none: at any of `places`.
    trial_places: ClassVar[tuple[str, ...]] = ()
    #: Whether it does nothing without weights.
    by_weights: ClassVar[bool] = False
    #: Whether it moves poses by way of springs alone.
    by_spring: ClassVar[bool] = False
    #: Whether it does nothing at constant temperature.
    by_temperature: ClassVar[bool] = False
    #: How each parameter is drawn, in turn, at some times the size that robots usually have.
    usual: ClassVar[Mapping[str, Draw]] = draws()
    #: The size that the vocabulary holds for plausible, as a factor of the usual size.
    plausible_size: ClassVar[float] = 1.0

    _of: str = PrivateAttr("")

    @classmethod
    def at_size(cls, site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return parameters at `size` times those that robots usually have.

        Args:
            site: where it is put.
            size: factor of the usual size.
            rng: draws phases, signs and directions.
        """
        return {name: draw(site, size, rng) for name, draw in cls.usual.items()}

    def at(self, place: str) -> Self:
        """Return the effect sitting at `place`: `joint 2`, `forearm`, `base`, ..."""
        placed = self.model_copy()
        placed._of = place
        return placed

    @property
    def of(self) -> str:
        """Where the effect sits."""
        return self._of

    @property
    def joint(self) -> int:
        """Index (from 0) of the joint in which the effect sits."""
        return int(self.of.removeprefix("joint ")) - 1

    def at_joint(self, values: Array, n: int) -> Array:
        """Return (P, n) zeros with `values` (P,) in the column of the effect's joint."""
        columns = np.zeros((len(values), n))
        columns[:, self.joint] = values
        return columns


class DriveEffect(Effect):
    """Turns a link against its motor, whatever the torque."""

    @abstractmethod
    def turn_rad(self, motion: Motion) -> Array:
        """Return the (P, n) angles to add to the motor angles, before springs deflect."""


class JointDriveEffect(DriveEffect):
    """An error of the angle of the joint it sits in."""

    places: ClassVar[tuple[str, ...]] = ("turning joint",)

    @abstractmethod
    def error_rad(self, motion: Motion) -> Array:
        """Return what to add to the joint's angle, (P,), by how that joint came to stand."""

    def turn_rad(self, motion: Motion) -> Array:
        """Return the error in the column of the joint, (P, n)."""
        return self.at_joint(self.error_rad(motion.of(self.joint)), motion.q_rad.shape[1])


class LoadedJointEffect(Effect):
    """Something in a joint that only shows under weights."""

    by_weights: ClassVar[bool] = True
    places: ClassVar[tuple[str, ...]] = ("turning joint",)


class WindupEffect(LoadedJointEffect):
    """Adds to the deflection of a joint under its torque."""

    @abstractmethod
    def bent_rad(self, tau_Nm: Array, q_rad: Array) -> Array:
        """Return the deflection of the joint under its torques, at its angles, both (P,)."""

    def deflection_rad(self, tau_Nm: Array, q_rad: Array) -> Array:
        """Return the (P, n) deflections under torques, with the links at `q_rad`, both (P, n)."""
        bent_rad = self.bent_rad(tau_Nm[:, self.joint], q_rad[:, self.joint])
        return self.at_joint(bent_rad, tau_Nm.shape[1])


class LostMotionEffect(LoadedJointEffect):
    """Turns a link against its motor by the torque it carries and the side it came from."""

    @abstractmethod
    def lag_rad(self, load: Array, arrival: Array) -> Array:
        """Return what to add to the angle of the link, (P,).

        Args:
            load: (P,) torque carried, in parts of the rated torque.
            arrival: (P,) direction of arrival: -1, 0 or +1.
        """

    def lost_rad(self, tau_Nm: Array, arrival: Array, rated_Nm: Array) -> Array:
        """Return the (P, n) angles to add to those of the links.

        Args:
            tau_Nm: (P, n) torques carried.
            arrival: (P, n) directions of arrival.
            rated_Nm: (n,) rated torques.
        """
        load = tau_Nm[:, self.joint] / rated_Nm[self.joint]
        return self.at_joint(self.lag_rad(load, arrival[:, self.joint]), tau_Nm.shape[1])


class CarriedTorqueEffect(LoadedJointEffect):
    """Makes a joint carry, and its log show, torque besides the weights.

    What pulls at a joint runs along it from link to link, so the links' moments stay.
    """

    by_spring: ClassVar[bool] = True

    @abstractmethod
    def pull_Nm(self, q_rad: Array) -> Array:
        """Return the torque (...) that the motor holds besides, with the link at `q_rad` (...)."""

    def carried_Nm(self, q_rad: Array) -> Array:
        """Return the (..., n) torques that the motors hold besides, with the links at `q_rad`."""
        carried = np.zeros_like(q_rad)
        carried[..., self.joint] = self.pull_Nm(q_rad[..., self.joint])
        return carried


class TorqueLogEffect(LoadedJointEffect):
    """Falsifies the logged torque; the springs do not feel it."""

    by_spring: ClassVar[bool] = True

    @abstractmethod
    def too_much_Nm(self, tau_Nm: Array, arrival: Array) -> Array:
        """Return what the log of the joint adds to the true torque `tau_Nm`, (P,)."""

    def logged_too_much_Nm(self, tau_Nm: Array, arrival: Array) -> Array:
        """Return the (P, n) torques that the log adds to the true `tau_Nm` (P, n)."""
        own = self.too_much_Nm(tau_Nm[:, self.joint], arrival[:, self.joint])
        return self.at_joint(own, tau_Nm.shape[1])


class StructureEffect(Effect):
    """Moves the base or the ends of links."""

    @abstractmethod
    def strain(self, loading: Loading) -> Strain:
        """Return what the effect adds to the unloaded shape."""


class ToolEffect(Effect):
    """Moves the tool on the flange."""

    places: ClassVar[tuple[str, ...]] = ("tool",)

    @abstractmethod
    def shift_m(self, R_base_ee: Array) -> Array:
        """Return the (P, 3) displacements of the tool along flange axes.

        Args:
            R_base_ee: (P, 3, 3) orientations of the flange.
        """


class InstrumentEffect(Effect):
    """Falsifies what the instrument reads."""

    places: ClassVar[tuple[str, ...]] = ("instrument",)

    @abstractmethod
    def read_too_much_m(self, p_instr_m: Array) -> Array:
        """Return what the instrument adds to the true points `p_instr_m` (..., 3)."""
