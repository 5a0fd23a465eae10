"""What a term is: parameters that shift chain coordinates or torques; offsets and fixed terms."""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import ClassVar, Literal, Protocol, TypeGuard, cast

import numpy as np

from pa10cal.arm.chain import BASE, TOOL
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.options import Tolerances

#: In the metadata of a field of a term: omitted from files where it has its default.
OPTIONAL = "optional"


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
    """One unknown of a model."""

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
    # (k',) derivative by a common relative error of all weights; None where they do not depend on
    # the weights
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
    """What predictions ask of a term: `terms/model`, `fit/forward`, `fit/rigid`, `commands/models`.

    Searches ask some of it of classes, to choose among effects.
    """

    #: Whether it turns a joint under the torque that this carries, see `Yielding`.
    yields: ClassVar[bool] = False
    #: Whether it changes the logged torques, see `TorqueTerm`.
    shows_torque: ClassVar[bool] = False
    #: Whether it bends links or base in proportion to the loads that they carry.
    bends: ClassVar[bool] = False
    #: In which poses it applies.
    holds: ClassVar[Holds] = "everywhere"
    #: The condition on which it depends; None for none.
    depends_on: ClassVar[Condition | None] = None
    #: What it corrects. Predicted poses leave out errors of log and readings.
    error_of: ClassVar[ErrorOf] = "robot"

    @property
    def constant(self) -> bool:
        """Return whether it adds each parameter to one coordinate, the same wherever it applies."""
        return False

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
    """What fits ask of a term: `calibration/`, `discovery/`, the cache of `terms/model`."""

    #: Whether it is a periodic spline of its joint's angle, solved in the errors at the knots: its
    #: rows are sparse in B-splines. Asked by `is_error_map`, and of classes.
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
        return np.asarray(5.0 * spread * sizes * generator.standard_normal(len(sizes)))


@dataclass(frozen=True)
class Transferred:
    """A term for another campaign of the same arm."""

    term: Term
    same_amounts: bool  # whether its parameters there are those of this campaign, else unknown


class InOtherCampaigns(Protocol):
    """What is asked of the terms of a model that another campaign uses or is compared with.

    By `calibration/general/other_campaign`, `evaluation/parameter_differences` and
    `evaluation/holdout`.
    """

    @property
    def stays_with_arm(self) -> bool:
        """Return whether other campaigns of the arm have it too, be it by amounts of their own."""
        return True

    def elsewhere(self: Term) -> Transferred | None:
        """Return the term for another campaign of the arm; None where it does not apply there."""
        return Transferred(self, same_amounts=True) if self.stays_with_arm else None

    def restated(self: Term, other: Term, x: Array) -> tuple[Array, Array]:
        """Return the parameters of `other`, converted to those that this term is solved in.

        Two models may have the same term about different references, as springs at different
        torques: their parameters compare only about the same one.

        Args:
            other: the same term of another model, of as many parameters.
            x: (k,) the parameters of `other`.

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
    """A term that turns a joint under the torque it carries."""

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


# Constant departures of chain coordinates: link parameters and the base frame.

#: Roles of chain coordinates by what their names begin with (`theta_2`, `base.rx`).
_KIND = re.compile(r"[._]")
_ROLES: dict[str, Role] = {"theta": "zero", "beta": "tilt", "base": "base", "tool": "tool"}


@dataclass(frozen=True)
class Offsets(Traits):
    """Adds each parameter to one chain coordinate, the same in every pose."""

    parameters: tuple[TermParameter, ...]  # k parameters
    coordinates: tuple[str, ...]  # the k coordinates they shift
    of: str = "links"  # `links`, `base` or `tool`
    id: ClassVar[str] = "offsets"
    formula: ClassVar[str] = (
        "each parameter is added to the coordinate of the chain at its place in the list"
    )
    constant: ClassVar[bool] = True

    @property
    def stays_with_arm(self) -> bool:
        return self.of == "links"

    @cached_property
    def roles(self) -> tuple[Role, ...]:
        return tuple(_ROLES.get(_KIND.split(name)[0], "link") for name in self.coordinates)

    def only(self, names: Collection[str]) -> Offsets:
        """Return the named parameters with their coordinates, in the order of this term."""
        kept = [k for k, parameter in enumerate(self.parameters) if parameter.name in names]
        return replace(
            self,
            parameters=tuple(self.parameters[k] for k in kept),
            coordinates=tuple(self.coordinates[k] for k in kept),
        )

    def shift(self, states: PoseStates, x: Array) -> Array:
        return x[None, :]

    def derivative(self, states: PoseStates, x: Array) -> Array:
        return identity(len(x))[None]

    def report(self, x: Array) -> Report:
        return report_as_solved(self.parameters, x)


@cache
def identity(size: int) -> Array:
    """Return the identity (size, size), read only."""
    matrix = np.eye(size)
    matrix.setflags(write=False)
    return matrix


def link_departures(arm: Arm, tolerances: Tolerances) -> Offsets:
    """Build the departures of all link parameters: a, alpha, d (or beta), theta of every row.

    A row with Hayati's parameter has beta in place of d (paper, Table I).
    """
    kinds = {
        "a": (tolerances.a_m, "m"),
        "alpha": (tolerances.alpha_rad, "rad"),
        "d": (tolerances.d_m, "m"),
        "beta": (tolerances.beta_rad, "rad"),
        "theta": (tolerances.theta_rad, "rad"),
    }
    coordinates = tuple(
        f"{kind}_{row}"
        for kind in kinds
        for row, hayati in enumerate(arm.hayati, start=1)
        if not (kind == "d" and hayati) and not (kind == "beta" and not hayati)
    )
    parameters = tuple(
        TermParameter(f"delta_{name}", unit, tolerance, tolerance)
        for name in coordinates
        for tolerance, unit in (kinds[name.rpartition("_")[0]],)
    )
    return Offsets(parameters, coordinates)


def base_frame() -> Offsets:
    """Build the six small motions of the base from its estimated frame."""
    return _small_motions(BASE, "base")


def tool_frame() -> Offsets:
    """Build the six small motions of the tool at the end of the chain."""
    return _small_motions(TOOL, "tool")


def is_tool(term: Term) -> bool:
    """Return whether a term is the mounting of the tool; a tool that sags is another term."""
    return "tool" in term.roles and set(term.coordinates) <= set(TOOL)


def _small_motions(names: tuple[str, ...], of: str) -> Offsets:
    parameters = (
        TermParameter(name.replace(".", "_"), "rad" if ".r" in name else "m", 1e-3)
        for name in names
    )
    return Offsets(tuple(parameters), names, of=of)


# Terms with fixed parameters.


@dataclass(frozen=True, eq=False)
class Fixed(Traits):
    """A term at fixed parameters: it has no unknowns, and predicts as the term does."""

    term: Term
    x_term: Array  # (k,) its parameters
    parameters: ClassVar[tuple[TermParameter, ...]] = ()
    roles: ClassVar[tuple[Role, ...]] = ()

    @property
    def id(self) -> str:
        """Return the id of the term."""
        return self.term.id

    @property
    def of(self) -> str:
        return self.term.of

    @property
    def formula(self) -> str:
        return self.term.formula

    @property
    def coordinates(self) -> tuple[str, ...]:
        return self.term.coordinates

    @property
    def bends(self) -> bool:  # type: ignore[override]
        return self.term.bends

    @property
    def holds(self) -> Holds:  # type: ignore[override]
        return self.term.holds

    @property
    def depends_on(self) -> Condition | None:  # type: ignore[override]
        return self.term.depends_on

    @property
    def error_of(self) -> ErrorOf:  # type: ignore[override]
        return self.term.error_of

    @property
    def stays_with_arm(self) -> bool:
        return self.term.stays_with_arm

    def shift(self, states: PoseStates, x: Array) -> Array:
        return self.term.shift(states, self.x_term)

    def derivative(self, states: PoseStates, x: Array) -> Array:
        return np.zeros((1, len(self.coordinates), 0))

    def distortion_m(self, states: PoseStates, x: Array) -> Array | None:
        return self.term.distortion_m(states, self.x_term)

    def carried(self, states: PoseStates, x: Array) -> PoseStates:
        return self.term.carried(states, self.x_term)

    def report(self, x: Array) -> Report:
        return Report((), x, np.zeros((0, 0)))


@dataclass(frozen=True, eq=False)
class FixedYielding(Fixed):
    """A term that turns a joint under the torque it carries, at fixed parameters."""

    term: Yielding
    yields = True

    @property
    def joint(self) -> int:
        return self.term.joint

    def by_torque(self, states: PoseStates, x: Array) -> Array:
        return self.term.by_torque(states, self.x_term)


@dataclass(frozen=True, eq=False)
class FixedTorque(Fixed):
    """A term that changes torques, at fixed parameters."""

    term: TorqueTerm
    shows_torque = True

    @property
    def acts_on_joint(self) -> bool:
        return self.term.acts_on_joint

    def torque_Nm(self, states: PoseStates, x: Array) -> Array:
        return self.term.torque_Nm(states, self.x_term)

    def torque_derivative(self, states: PoseStates, x: Array) -> Array:
        return np.zeros((*states.tau_Nm.shape, 0))


def fixed(term: Term, x_term: Array) -> Term:
    """Return a term at fixed parameters (k,)."""
    if shows_torque(term):
        kind: type[Fixed] = FixedTorque
    else:
        kind = FixedYielding if yields(term) else Fixed
    # Its traits are those of its term, not of its class: a type checker takes them for read-only.
    return cast("Term", kind(term, x_term))
