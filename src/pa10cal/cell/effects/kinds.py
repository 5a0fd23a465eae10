"""The kinds of effects, by what they act on, and what they may depend on.

An effect is one small class: its fields are its parameters, `id` is its name in the vocabulary of
effects and `places` says where it may sit. To add one, derive it from the kind that fits and list
it in `library`.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PrivateAttr

from pa10cal.cell.mechanism import Mechanism, Moments, Strain
from pa10cal.settings import Section

Array = NDArray[np.float64]

Finite = Annotated[float, Field(allow_inf_nan=False)]
FinitePositive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Triple = tuple[Finite, Finite, Finite]


@dataclass(frozen=True)
class Motion:
    """How the joints came to stand in P configurations.

    Attributes:
        q_rad: (P, n) motor-side joint angles.
        arrival: (P, n) direction in which each joint arrived: -1, 0 (did not move) or +1.
        gear_ratio: (n,) motor turns a joint turn.
    """

    q_rad: Array
    arrival: Array
    gear_ratio: Array


@dataclass(frozen=True)
class Shape:
    """The links of an arm as lengths.

    Attributes:
        spans_m: (n, 3) from each joint to the end of its link, along the axes of that end.
        long_links: the upper arm and the forearm: of the links after the first and before the
            last, the two longest, in the order of the chain (row numbers from 0; fewer than two
            in an arm of fewer than four joints).
    """

    spans_m: Array
    long_links: tuple[int, ...]

    @classmethod
    def of(cls, mechanism: Mechanism) -> Shape:
        """Return the shape of a mechanism."""
        spans_m = mechanism.spans_m
        inner = range(1, mechanism.n - 1)
        longest = sorted(inner, key=lambda link: -float(np.linalg.norm(spans_m[link])))[:2]
        return cls(spans_m, tuple(sorted(longest)))

    def link(self, name: str) -> int:
        """Return the row number of `upper_arm` or `forearm`."""
        return self.long_links[LONG_LINKS.index(name)]


LONG_LINKS = ("upper_arm", "forearm")


@dataclass(frozen=True)
class Loading:
    """What the structure bears in one configuration.

    Attributes:
        shape: the links.
        moments: what weights bend them with.
        time_s: time since the start of the campaign.
        warming_K: temperature above the reference.
    """

    shape: Shape
    moments: Moments
    time_s: float
    warming_K: float


class Effect(Section):
    """Something that moves the arm, its log or its measurement off the paper's model.

    Its fields are its parameters; `at` puts it in its place.
    """

    id: ClassVar[str]
    #: Where it may sit; `joint` stands for any joint by its number, `rigid joint` for one
    #: without a spring.
    places: ClassVar[tuple[str, ...]]

    _of: str = PrivateAttr("")

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

    places: ClassVar[tuple[str, ...]] = ("joint",)

    @abstractmethod
    def turn_rad(self, motion: Motion) -> Array:
        """Return the (P, n) angles to add to the motor angles, before springs deflect."""


class WindupEffect(Effect):
    """Adds to the deflection of a joint under its torque."""

    @abstractmethod
    def deflection_rad(self, tau_Nm: Array) -> Array:
        """Return the (n,) deflections under the torques `tau_Nm` (n,)."""


class LostMotionEffect(Effect):
    """Turns a link against its motor by the torque it carries and the side it came from."""

    places: ClassVar[tuple[str, ...]] = ("joint",)

    @abstractmethod
    def lost_rad(self, tau_Nm: Array, arrival: Array, rated_Nm: Array) -> Array:
        """Return the (n,) angles to add to those of the links.

        Args:
            tau_Nm: (n,) torques carried.
            arrival: (n,) directions of arrival: -1, 0 or +1.
            rated_Nm: (n,) rated torques.
        """


class CarriedTorqueEffect(Effect):
    """Makes a joint carry, and its log show, torque besides the weights.

    What pulls at a joint runs along it from link to link, so the links' moments stay.
    """

    places: ClassVar[tuple[str, ...]] = ("joint",)

    @abstractmethod
    def carried_Nm(self, q_rad: Array) -> Array:
        """Return the (..., n) torques that the motors hold besides, with the links at `q_rad`."""


class TorqueLogEffect(Effect):
    """Falsifies the logged torque; the springs do not feel it."""

    places: ClassVar[tuple[str, ...]] = ("joint",)

    @abstractmethod
    def logged_too_much_Nm(self, tau_Nm: Array, arrival: Array) -> Array:
        """Return the (P, n) torques that the log adds to the true `tau_Nm` (P, n)."""


class StructureEffect(Effect):
    """Moves the base or the ends of links."""

    @abstractmethod
    def strain(self, loading: Loading) -> Strain:
        """Return what the effect adds to the unloaded shape."""


class ToolEffect(Effect):
    """Moves the apparatus on the flange."""

    places: ClassVar[tuple[str, ...]] = ("tool",)

    @abstractmethod
    def shift_m(self, R_base_ee: Array) -> Array:
        """Return the (P, 3) displacements of the apparatus along flange axes.

        Args:
            R_base_ee: (P, 3, 3) attitudes of the flange.
        """


class InstrumentEffect(Effect):
    """Falsifies what the instrument reads."""

    places: ClassVar[tuple[str, ...]] = ("instrument",)

    @abstractmethod
    def read_too_much_m(self, p_instr_m: Array) -> Array:
        """Return what the instrument adds to the true points `p_instr_m` (..., 3)."""
