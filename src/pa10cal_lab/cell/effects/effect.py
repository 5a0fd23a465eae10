"""Base classes of simulated effects, by the quantity they act on, and the states they depend on.

An effect is one small class in a module of this folder: its fields are its parameters, the amount
first; `id` is its name, `places` are its possible places, `usual` draws its usual size, and one
method is its formula. It is listed nowhere else.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
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
    """States of joints in P configurations; arrays are (P, n) for all joints, (P,) for one."""

    q_rad: Array  # positions of the motors, or of the links for effects of load
    arrival: Array  # direction in which each joint arrived: -1, 0 (did not move) or +1
    gear_ratio: Array  # (n,) motor turns a joint turn; (1,) of one joint
    tau_Nm: Array = field(default_factory=lambda: np.zeros(()))  # torques carried
    # (n,) rated torques; (1,) of one joint
    rated_Nm: Array = field(default_factory=lambda: np.full((), np.nan))
    # (P, n) move of each joint to the configuration; () where not known
    move: Array = field(default_factory=lambda: np.zeros(()))
    # (P,) path length of the end if the whole move went at its final speed [m]; () likewise
    end_goes_m: Array = field(default_factory=lambda: np.zeros(()))

    def of(self, joint: int) -> JointState:
        """Return the state of one joint, from 0."""
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
    """Loads of the structure in P configurations."""

    mechanism: Mechanism
    statics: SimulatedStatics  # loads by weights
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

    def moment_Nm(self, link: int) -> Array:
        """Return the moment (P, 3) that a link, from 0, carries at its end; -1 for the base."""
        return self.statics.base_Nm if link < 0 else self.statics.link_Nm[:, link]

    def strain_of(self, link: int, turn_rad: Array, shift_m: Array | None = None) -> Strain:
        """Return the strain by the rotation and displacement of one link's end, or of the base.

        Args:
            link: from 0; -1 for the base.
            turn_rad: (P, 3) rotation along the axes of that end, or of the base.
            shift_m: (P, 3) displacement along the same axes; None for none.
        """
        none = self.none
        shift = np.zeros_like(turn_rad) if shift_m is None else shift_m
        if link < 0:
            return replace(none, base_turn_rad=turn_rad, base_shift_m=shift)
        turns_rad, shifts_m = none.turn_rad.copy(), none.shift_m.copy()
        turns_rad[:, link], shifts_m[:, link] = turn_rad, shift
        return replace(none, turn_rad=turns_rad, shift_m=shifts_m)


@dataclass(frozen=True)
class Site:
    """The place of an effect in a trial, and the quantities that determine its usual size."""

    of: str  # the place
    rated_Nm: float = 0.0  # rated torque of the joint; 0 without one
    typical_Nm: float = 0.0  # usual torque of the joint; 0 without one
    coulomb_Nm: float = 0.0  # Coulomb friction of the joint; 0 without one
    half_m: float = 0.0  # usual distance of targets from the middle of the measured volume
    # coordinates of that middle in the instrument's frame
    middle_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    stroke_m: tuple[float, float] = (0.0, 1.0)  # ends of the range of a joint that slides


def either_sign(amount: float, rng: np.random.Generator) -> float:
    """Return the amount with a sign drawn at random."""
    return amount * float(rng.choice([-1.0, 1.0]))


def any_direction(length: float, rng: np.random.Generator) -> list[float]:
    """Return the components of a vector of a length in a direction drawn at random."""
    vector = rng.standard_normal(3)
    components: list[float] = (length * vector / np.linalg.norm(vector)).tolist()
    return components


#: Draws one parameter of an effect at a site, for a factor of its usual size.
Draw = Callable[[Site, float, np.random.Generator], Any]


def draws(**each: Draw) -> Mapping[str, Draw]:
    """Return the draws of an effect's parameters by their names, in the order drawn."""
    return each


def sized(usual: float) -> Draw:
    """Return a draw of a parameter of this usual size."""
    return lambda _site, size, _rng: size * usual


def signed(usual: float) -> Draw:
    """Return a draw of a parameter of this usual size, with either sign."""
    return lambda _site, size, rng: either_sign(size * usual, rng)


def directed(usual: float) -> Draw:
    """Return a draw of a vector of this usual length, in any direction."""
    return lambda _site, size, rng: any_direction(size * usual, rng)


Quantity = Literal["drive", "windup", "carried", "log"]


class SimulatedEffect(Section):
    """A deviation of the arm, of its log or of its measurement from the paper's model.

    Its fields are its parameters; `at` sets its place. Each method is one way in which an effect
    may act; a class overrides those of its own.
    """

    id: ClassVar[str]
    #: Its possible places. `turning joint` stands for any revolute joint by its number, `any joint`
    #: for prismatic ones too, `sliding joint` for these only, `rigid joint` for one without a
    #: spring, `loaded joint` for one that weights load.
    places: ClassVar[tuple[str, ...]]
    #: Whether it is in the vocabulary of effects; others can be hidden, but not named.
    named: ClassVar[bool] = True
    #: Whether only wild trials draw it.
    wild: ClassVar[bool] = False
    #: Whether blind or wild trials draw it; else a study of its own does.
    drawn: ClassVar[bool] = True
    #: Places where trials put it so that it acts; empty for any of `places`.
    trial_places: ClassVar[tuple[str, ...]] = ()
    #: Effect that trials hide instead if the instrument has no three axes; None for itself.
    without_axes: ClassVar[type[SimulatedEffect] | None] = None
    #: Whether it needs weights to act.
    by_weights: ClassVar[bool] = False
    #: Whether it changes poses only by way of springs.
    by_spring: ClassVar[bool] = False
    #: Whether it changes logged torques only, and no pose even by way of a spring.
    in_log_alone: ClassVar[bool] = False
    #: Whether its usual size is determined by the moment of the arm's weights on it.
    by_moment: ClassVar[bool] = False
    #: Whether the calibrated model of every trial without touches has it already.
    in_every_model: ClassVar[bool] = False
    #: Whether it is an error by the joint's angle without a name: a map at its joint gives its
    #: place and leaves the cause open.
    by_angle: ClassVar[bool] = False
    #: Ids of the vocabulary that describe it rightly at its place, though it is another effect.
    also_called: ClassVar[tuple[str, ...]] = ()
    #: Forms of formulas that may be proposed for it, where it has no name or a map is found.
    forms: ClassVar[tuple[str, ...]] = ()
    #: Whether it needs changes of temperature to act.
    by_temperature: ClassVar[bool] = False
    #: Whether it moves the base or the ends of links, by `strain`.
    strains: ClassVar[bool] = False
    #: Draws of the parameters, in order, for a factor of the usual size.
    usual: ClassVar[Mapping[str, Draw]] = draws()
    #: Its plausible size in the vocabulary, as a factor of the usual size.
    plausible_size: ClassVar[float] = 1.0

    _of: str = PrivateAttr("")

    @classmethod
    def at_size(cls, site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return parameters drawn for a factor `size` of the usual size."""
        return {name: draw(site, size, rng) for name, draw in cls.usual.items()}

    @classmethod
    def formula_numbers(cls, _parameters: Mapping[str, Any]) -> tuple[float, ...]:
        """Return the first numbers of its formulas in `forms`: orders, cycles, axes from 0."""
        return ()

    def at(self, place: str) -> Self:
        """Return the effect at a place: `joint 2`, `forearm`, `base`, …"""
        placed = self.model_copy()
        placed._of = place
        return placed

    @property
    def of(self) -> str:
        """Return the place of the effect."""
        return self._of

    @property
    def joint(self) -> int:
        """Return the joint of the effect, from 0."""
        return int(self.of.removeprefix("joint ")) - 1

    def added_to(self, _quantity: Quantity, _motion: JointState) -> Array | None:
        """Return its contribution to a quantity of the joints, (P, n); None without one."""
        return None

    def strain(self, loading: Loading) -> Strain:
        """Return the deformation of base and links that it causes."""
        return loading.none

    def shift_m(self, _R_base_ee: Array) -> Array | None:
        """Return displacements (P, 3) of the tool along flange axes; None without any.

        Args:
            _R_base_ee: (P, 3, 3) orientations of the flange.
        """
        return None

    def read_too_much_m(self, _p_instr_m: Array) -> Array | None:
        """Return errors of the instrument at true points (..., 3); None without any."""
        return None


class JointsEffect(SimulatedEffect):
    """An effect of the joints, on one of four quantities.

    `drive`: the rotation of links relative to motors, independent of torque; `windup`: the same by
    the torque carried; `carried`: a torque of the motors besides that of the weights, between
    neighbouring links, so that the links' moments do not change; `log`: the logged torque only.
    """

    adds_to: ClassVar[Quantity] = "drive"
    places: ClassVar[tuple[str, ...]] = ("turning joint",)

    @abstractmethod
    def added(self, motion: JointState) -> Array:
        """Return its contribution by the states of the joints, (P, n) [rad or N m]."""

    def added_to(self, quantity: Quantity, motion: JointState) -> Array | None:
        """Return its contribution if the quantity is `adds_to`."""
        return self.added(motion) if quantity == self.adds_to else None


class SimulatedJointEffect(JointsEffect):
    """An effect of one joint."""

    @abstractmethod
    def at_joint(self, joint: JointState) -> Array:
        """Return its contribution by the state of that joint, (P,) [rad or N m]."""

    def added(self, motion: JointState) -> Array:
        """Return `at_joint` in the column of the joint."""
        columns = np.zeros_like(motion.q_rad)
        columns[:, self.joint] = self.at_joint(motion.of(self.joint))
        return columns


class LoadedJointEffect(SimulatedJointEffect):
    """An effect of one joint that needs weights to act."""

    adds_to: ClassVar[Quantity] = "windup"
    by_weights: ClassVar[bool] = True


class TorqueLogEffect(LoadedJointEffect):
    """An error of the logged torque; springs are not affected."""

    adds_to = "log"
    by_spring: ClassVar[bool] = True


def with_added(
    values: Array, to: Quantity, effects: Sequence[SimulatedEffect], motion: JointState
) -> Array:
    """Return values (P, n) of a quantity plus the contributions of effects, one after the other."""
    for effect in effects:
        if (added := effect.added_to(to, motion)) is not None:
            values = values + added
    return values
