"""What a term is: parameters that shift chain coordinates or torques, and what is asked of it."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection
from dataclasses import dataclass
from functools import cache
from typing import ClassVar, Literal, Protocol, TypeGuard

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array

#: In the metadata of a field of a term: omitted from files where it has its default.
OPTIONAL = "optional"
#: Standard deviation of the starts of fits at random, in scales of the parameters (computing).
_SCATTERED_SCALES = 5.0


#: What a parameter describes.
Role = Literal[
    "link",  # a length or twist of a link, or the zero of a joint that slides
    "zero",  # the zero of a joint that turns
    "tilt",  # the tilt of an axis against the one before, parallel by design
    "windup",  # the deflection of a joint's spring at its reference torque
    "cubic",  # the share of that torque which is the cubic part of the spring
    "weight",  # a mass, first moment or direction of gravity, as it differs from the described one
    "base",  # the pose of the base in the instrument's frame
    "tool",  # the pose of the tool on the flange
    "target",  # the position of a target on the tool
    "effect",  # the size of an effect
    "field",  # the amount of a field
]


@dataclass(frozen=True)
class TermParameter:
    """One unknown of a model.

    Two are equal only if their scales and ranges are, which may come from a campaign: parameters of
    two models are the same by name and unit, see `InOtherCampaigns.same_as`.
    """

    name: str  # unique within a model
    unit: str  # SI unit
    scale: float  # typical size, the unit in which fits are solved and rank is judged
    # manufacturing tolerance (paper, Section II.C), or None where it has none
    tolerance: float | None = None
    # lower and upper: ends of the physically possible range, or None
    lower: float | None = None
    upper: float | None = None
    plausible: float | None = None  # prior standard deviation of an effect, about zero, or None


@dataclass(frozen=True)
class Report:
    """Parameters in the form that is reported, by those that a term is solved in."""

    parameters: tuple[TermParameter, ...]  # k' reported parameters
    values: Array  # (k',) their values
    jacobian: Array  # (k', k) derivative by the solved parameters, for uncertainties
    # (k',) derivative by a common relative error of all weights, positive where it grows with them;
    # None where they do not depend on the weights
    by_weights: Array | None = None
    # names of parameters that are zero by definition, as K_cub of a linear spring
    zero: frozenset[str] = frozenset()

    def covariance(self, of_solved: Array, u_scale: float = 0.0) -> Array:
        """Return the covariance (k', k') of the reported parameters.

        Args:
            of_solved: (k, k) covariance of the solved parameters.
            u_scale: relative standard uncertainty of the weights as a whole, see `Model.u_scale`.
        """
        found: Array = self.jacobian @ of_solved @ self.jacobian.T
        if self.by_weights is not None:
            found = found + u_scale**2 * np.outer(self.by_weights, self.by_weights)
        return found


# What may be asked of any term beside its form, with the answer of most terms; a class that differs
# states its own. Where classes are asked, before there are terms, the answer is a class variable.

#: Where a term applies: in all poses, in those of one campaign of a group, or of a part of one.
Holds = Literal["everywhere", "campaign", "part"]
#: What a term corrects, and with it who shows that error.
ErrorOf = Literal[
    "robot",  # arm, base or tool: they are elsewhere
    "log",  # logged joints or torques
    "readings",  # what the instrument reads
    "statement",  # a load or a tool as campaign.yaml states it, which moves the robot otherwise
]
#: The state of a pose, beside joints and loads, on which a term depends.
Condition = Literal["temperature_C", "time_s"]


class InPredictions(Protocol):
    """What predictions ask of a term; searches choose effects by some of it."""

    #: Whether it turns a joint under the torque that this carries, see `Yielding`.
    yields: ClassVar[bool] = False
    #: Whether it changes the logged torques, see `TorqueTerm`.
    shows_torque: ClassVar[bool] = False
    #: Whether it bends links or base in proportion to the loads that they carry.
    bends: ClassVar[bool] = False
    #: In which poses it applies.
    holds: ClassVar[Holds] = "everywhere"
    #: The condition on which it depends; None for none. Searches judge effects of time apart.
    depends_on: ClassVar[Condition | None] = None
    #: What it corrects. `fit/forward.moves_robot` leaves errors of log and readings out of what is
    #: predicted, `discovery/gates` prefers the robot to the readings, `is_fault` finds statements.
    error_of: ClassVar[ErrorOf] = "robot"

    @property
    def constant(self) -> bool:
        """Return whether it adds each parameter to one coordinate, the same wherever it applies.

        Such are departures, which `Model.departures` names and `fit/rigid` puts into the geometry.
        """
        return False

    def moves_in(self, campaign: int) -> bool:
        """Return whether it may move the robot in a campaign of a group, by its number from 0."""
        return True

    def targets_derivative(self, states: PoseStates, x: Array) -> Array | None:
        """Return the derivative (P, t, k) by x of how it distorts the pattern of the targets.

        That is of their coordinates in the end-effector frame as they are read [m]. It is
        proportional to x. None where it distorts none.
        """
        return None

    def distortion_m(self, states: PoseStates, x: Array) -> Array | None:
        """Return by what it distorts the pattern of the targets as it is read, (P, t), or None."""
        derivative = self.targets_derivative(states, x)
        return None if derivative is None else np.asarray(derivative @ x)

    def carried(self, states: PoseStates, x: Array) -> PoseStates:
        """Return states with the loads that it puts on links and base: unchanged but by weights."""
        return states


class InFits(Protocol):
    """What fits ask of a term."""

    #: Whether it is a periodic spline of its joint's angle, solved in the errors at the knots: its
    #: rows are sparse in B-splines.
    at_knots: ClassVar[bool] = False

    @property
    def proportional(self) -> bool:
        """Return whether it is known to be proportional to all its parameters."""
        return False

    def only(self: Term, names: Collection[str]) -> Term:
        """Return the term with the named parameters only; unchanged, where it needs all of them."""
        return self

    def scattered(self: Term, generator: np.random.Generator, spread: float) -> Array:
        """Return parameters (k,) to start a fit from: nominal at spread 0, random at 1."""
        sizes = np.array([parameter.scale for parameter in self.parameters])
        factor = _SCATTERED_SCALES * spread
        return np.asarray(factor * sizes * generator.standard_normal(len(sizes)))


@dataclass(frozen=True)
class Transferred:
    """A term for another campaign of the same arm."""

    term: Term
    same_amounts: bool  # whether its parameters there are those of this campaign, else unknown


class InOtherCampaigns(Protocol):
    """What is asked of the terms of a model that another campaign uses or is compared with."""

    @property
    def stays_with_arm(self) -> bool:
        """Return whether it is of the arm as it is built, and not of how one campaign went.

        Base and tool that give way are; where base and tool stood, and what drifts, are not.
        """
        return True

    def elsewhere(self: Term) -> Transferred | None:
        """Return the term for another campaign of the arm; None where it does not apply there."""
        return Transferred(self, same_amounts=True) if self.stays_with_arm else None

    def same_as(self: Term, other: Term) -> bool:
        """Return whether a term of another model is this one, so that its amounts compare.

        By default a term of this kind at this place, of parameters of the same names and units.
        Ranges, scales and plausible sizes may differ: they are of a campaign. What two models name
        alike is not the same where it has another form, as waves of another order.
        """
        mine, theirs = ([(p.name, p.unit) for p in term.parameters] for term in (self, other))
        return type(self) is type(other) and self.of == other.of and mine == theirs

    def restated(self: Term, other: Term, x: Array) -> tuple[Array, Array]:
        """Return the parameters of `other`, converted to those that this term is solved in.

        Two models may have the same term about different references, as springs at different
        torques: their parameters compare only about the same one.

        Args:
            other: the same term of another model, see `same_as`.
            x: (k,) the parameters of `other`; of a constant term those that both have.

        Returns:
            (k,) parameters of this term; (k, k) their derivative by x.
        """
        return x, identity(len(x))


class Traits(InPredictions, InFits, InOtherCampaigns, Protocol):
    """All that may be asked of a term beside its form."""


class Term(Traits, Protocol):
    """A part of the model that adds to chain coordinates."""

    @property
    def id(self) -> str:
        """Return the name of its kind, by which a file names it."""

    @property
    def of(self) -> str:
        """Return where it sits: `joint 2`, `forearm`, `base`, ..."""

    @property
    def formula(self) -> str:
        """Return the formula as plain text, in terms of the reported parameters."""

    @property
    def parameters(self) -> tuple[TermParameter, ...]:
        """Return the k parameters it is solved in."""

    @property
    def roles(self) -> tuple[Role, ...]:
        """Return the role of each of its k parameters."""

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Return the m chain coordinates it adds to."""

    def shift(self, states: PoseStates, x: Array) -> Array:
        """Return what it adds to its coordinates, (P, m) or (1, m)."""

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return the derivative of `shift` by x, (P, m, k) or (1, m, k)."""

    def report(self, x: Array) -> Report:
        """Return the parameters in the form readers know them."""


class Yielding(Term, Protocol):
    """A term that turns a joint at its drive, under the torque that this carries.

    Its shift is that of the drive: a model moves by it all joints that this drive moves.
    """

    @property
    def joint(self) -> int:
        """Return the joint, 1 … n, whose angle is the term's only coordinate."""

    def by_torque(self, states: PoseStates, x: Array) -> Array:
        """Return the derivative of `shift` by the joint's torque, (P,) [rad/(N m)]."""


class TorqueTerm(Term, Protocol):
    """A term that changes the logged torques."""

    @property
    def acts_on_joint(self) -> bool:
        """Return whether the joint carries that torque; else only the log shows it."""

    def torque_Nm(self, states: PoseStates, x: Array) -> Array:
        """Return the torques that it adds to those of the weights in the log, (P, n)."""

    def torque_derivative(self, states: PoseStates, x: Array) -> Array:
        """Return the derivative of `torque_Nm` by x, (P, n, k)."""


def yields(term: Term) -> TypeGuard[Yielding]:
    """Return whether a term turns a joint under the torque it carries."""
    return term.yields


def shows_torque(term: Term) -> TypeGuard[TorqueTerm]:
    """Return whether a term changes the logged torques."""
    return term.shows_torque


def report_as_solved(parameters: tuple[TermParameter, ...], x: Array) -> Report:
    """Report parameters in the form that they are solved in."""
    return Report(parameters, x, np.eye(len(x)))


@cache
def identity(size: int) -> Array:
    """Return the identity (size, size), read only."""
    matrix = np.eye(size)
    matrix.setflags(write=False)
    return matrix


# Base classes of terms that change torques, and move the arm through its springs alone.


class TorqueOnly(Traits):
    """A term that adds to no coordinate of the chain, and to torques in proportion to x."""

    shows_torque = True
    coordinates: ClassVar[tuple[str, ...]] = ()

    def shift(self, states: PoseStates, x: Array) -> Array:
        """Return nothing, (P, 0)."""
        return np.zeros((len(states), 0))

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return nothing, (P, 0, k)."""
        return np.zeros((len(states), 0, len(x)))

    @property
    @abstractmethod
    def acts_on_joint(self) -> bool:
        """Return whether the joint carries that torque; else only the log shows it."""

    @abstractmethod
    def torque_derivative(self, states: PoseStates, x: Array) -> Array:
        """Return the derivative of `torque_Nm` by x, (P, n, k)."""

    def torque_Nm(self, states: PoseStates, x: Array) -> Array:
        """Return the torques that it adds to those of the weights in the log, (P, n)."""
        return np.asarray(self.torque_derivative(states, x) @ x)


class JointTorqueOnly(TorqueOnly):
    """A term that adds to the torque of one joint alone."""

    joint: int  # 1 … n

    @abstractmethod
    def per_unit(self, states: PoseStates) -> Array:
        """Return the joint's torque by a unit of each parameter, (P, k); (P,) for one [N m]."""

    def torque_derivative(self, states: PoseStates, x: Array) -> Array:
        """Return the derivative of `torque_Nm` by x, (P, n, k)."""
        derivative = np.zeros((*states.tau_Nm.shape, len(x)))
        derivative[:, self.joint - 1] = self.per_unit(states).reshape(len(states), len(x))
        return derivative
