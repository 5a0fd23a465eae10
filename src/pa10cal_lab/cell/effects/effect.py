"""The kinds of effects, by what they act on, and what they may depend on.

An effect is one small class in a file of this folder: its fields are its parameters, the amount
first, `id` is its name, `places` says where it may sit, `usual` how large it usually is, and one
method its formula. Nothing else lists it.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, PrivateAttr

from pa10cal.arrays import Array
from pa10cal.options import Section
from pa10cal_lab.cell.mechanism import Mechanism, SimulatedStatics, Strain

Finite = Annotated[float, Field(allow_inf_nan=False)]
FinitePositive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Triple = tuple[Finite, Finite, Finite]

ARC_SECOND = np.pi / (180.0 * 3600.0)
LONG_LINKS = ("upper_arm", "forearm")


@dataclass(frozen=True)
class JointState:
    """How joints stand in P configurations; (P, n) of all, (P,) of one."""

    q_rad: Array  # positions: of the motors, under load of the links
    arrival: Array  # direction in which each joint arrived: -1, 0 (did not move) or +1
    gear_ratio: Array  # (n,) motor turns a joint turn; (1,) of one joint
    tau_Nm: Array = field(default_factory=lambda: np.zeros(()))  # torques carried
    # (n,) rated torques; (1,) of one joint
    rated_Nm: Array = field(default_factory=lambda: np.full((), np.nan))
    # (P, n) how far each joint went to get there; () where nothing is said of it
    move: Array = field(default_factory=lambda: np.zeros(()))
    # (P,) how far the end of the arm would go with that move, at its last speed [m]; () likewise
    end_goes_m: Array = field(default_factory=lambda: np.zeros(()))

    def of(self, joint: int) -> JointState:
        """Return how one joint, from 0, stands."""
        q_rad, tau_Nm, move = np.broadcast_arrays(self.q_rad, self.tau_Nm, self.move)
        gear_ratio, rated_Nm = np.broadcast_arrays(self.gear_ratio, self.rated_Nm)
        one = slice(joint, joint + 1)
        return JointState(
            q_rad[:, joint],
            self.arrival[:, joint],
            gear_ratio[one],
            tau_Nm[:, joint],
            rated_Nm[one],
            move[:, joint],
        )


@dataclass(frozen=True)
class Loading:
    """What the structure bears in P configurations."""

    mechanism: Mechanism  # the links
    statics: SimulatedStatics  # what weights bend them with
    q: Array  # (P, n) positions of the links [rad, or m of a prismatic joint]
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
    stroke_m: tuple[float, float] = (0.0, 1.0)  # ends of the range of a joint that slides


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


Quantity = Literal["drive", "windup", "carried", "log"]


class SimulatedEffect(Section):
    """Something that moves the arm, its log or its measurement off the paper's model.

    Its fields are its parameters; `at` puts it in its place. It is asked for all that an effect
    may add, and answers what it does.
    """

    id: ClassVar[str]
    #: Where it may sit; `turning joint` stands for any that turns by its number, `any joint` for
    #: those that slide as well, `sliding joint` for these alone, `rigid joint` for one without a
    #: spring, `loaded joint` for one that weights load.
    places: ClassVar[tuple[str, ...]]
    #: Whether it is in the vocabulary of effects; what is not can be hidden, but not be named.
    named: ClassVar[bool] = True
    #: Whether wild trials alone draw it.
    wild: ClassVar[bool] = False
    #: Whether blind or wild trials draw it; else a study of its own does.
    drawn: ClassVar[bool] = True
    #: Where trials put it so that it does something; none: at any of `places`.
    trial_places: ClassVar[tuple[str, ...]] = ()
    #: What trials hide in its place where the instrument has no three axes; None for itself.
    without_axes: ClassVar[type[SimulatedEffect] | None] = None
    #: Whether it does nothing without weights.
    by_weights: ClassVar[bool] = False
    #: Whether it moves poses by way of springs alone.
    by_spring: ClassVar[bool] = False
    #: Whether the logged torque alone shows it, and no pose, not even by way of a spring.
    in_log_alone: ClassVar[bool] = False
    #: Whether its usual size goes by the moment that the weights of the arm put on it.
    by_moment: ClassVar[bool] = False
    #: Whether the calibrated model of every trial without touches has it already.
    in_every_model: ClassVar[bool] = False
    #: Whether it is an error by the joint's angle without a name: a map at its joint gives the
    #: place and leaves the cause open.
    by_angle: ClassVar[bool] = False
    #: Ids of the vocabulary that describe it, at its place, though it is no such effect.
    also_called: ClassVar[tuple[str, ...]] = ()
    #: Forms of formulas that may be proposed for it, where nothing names it or a map is found.
    forms: ClassVar[tuple[str, ...]] = ()
    #: Whether it does nothing at constant temperature.
    by_temperature: ClassVar[bool] = False
    #: Whether it moves the base or the ends of links, by `strain`.
    strains: ClassVar[bool] = False
    #: How each parameter is drawn, in turn, at some times the size that robots usually have.
    usual: ClassVar[Mapping[str, Draw]] = draws()
    #: The size that the vocabulary holds for plausible, as a factor of the usual size.
    plausible_size: ClassVar[float] = 1.0

    _of: str = PrivateAttr("")

    @classmethod
    def at_size(cls, site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return parameters at `size` times those that robots usually have.

        Args:
            size: factor of the usual size.
        """
        return {name: draw(site, size, rng) for name, draw in cls.usual.items()}

    @classmethod
    def formula_numbers(cls, _parameters: Mapping[str, Any]) -> tuple[float, ...]:
        """Return the numbers with which those formulas begin: orders, cycles, axes from 0."""
        return ()

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

    def added_to(self, _quantity: Quantity, _motion: JointState) -> Array | None:
        """Return what it adds to a quantity of the joints, (P, n); None where nothing."""
        return None

    def strain(self, loading: Loading) -> Strain:
        """Return what it adds to the unloaded shape of base and links."""
        return loading.none

    def shift_m(self, _R_base_ee: Array) -> Array | None:
        """Return displacements (P, 3) of the tool along flange axes; None where there are none.

        Args:
            _R_base_ee: (P, 3, 3) orientations of the flange.
        """
        return None

    def read_too_much_m(self, _p_instr_m: Array) -> Array | None:
        """Return what the instrument adds to true points (..., 3); None where it is right."""
        return None


class JointsEffect(SimulatedEffect):
    """Something in the joints: adds to one of four quantities.

    `drive`: the turn of the links against the motors, whatever the torque; `windup`: the same by
    the torque carried; `carried`: the torque that motors hold besides the weights, which runs along
    the joint from link to link, so that the links' moments stay; `log`: the logged torque alone.
    """

    adds_to: ClassVar[Quantity] = "drive"
    places: ClassVar[tuple[str, ...]] = ("turning joint",)

    @abstractmethod
    def added(self, motion: JointState) -> Array:
        """Return what is added by how the joints stand, (P, n) [rad or N m]."""

    def added_to(self, quantity: Quantity, motion: JointState) -> Array | None:
        """Return what is added to its quantity."""
        return self.added(motion) if quantity == self.adds_to else None


class SimulatedJointEffect(JointsEffect):
    """Something in the joint it sits in."""

    @abstractmethod
    def at_joint(self, joint: JointState) -> Array:
        """Return what is added by how that joint stands, (P,) [rad or N m]."""

    def added(self, motion: JointState) -> Array:
        """Return that in the column of the joint."""
        columns = np.zeros_like(motion.q_rad)
        columns[:, self.joint] = self.at_joint(motion.of(self.joint))
        return columns


class LoadedJointEffect(SimulatedJointEffect):
    """Something in a joint that only shows under weights."""

    adds_to: ClassVar[Quantity] = "windup"
    by_weights: ClassVar[bool] = True


class TorqueLogEffect(LoadedJointEffect):
    """Falsifies the logged torque; the springs do not feel it."""

    adds_to = "log"
    by_spring: ClassVar[bool] = True


def with_added(
    values: Array, to: Quantity, effects: Sequence[SimulatedEffect], motion: JointState
) -> Array:
    """Return values (P, n) with what effects add to such a quantity, one after the other."""
    for effect in effects:
        if (added := effect.added_to(to, motion)) is not None:
            values = values + added
    return values
