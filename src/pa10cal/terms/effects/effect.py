"""What an effect is: a term with a name, a place and sizes to be expected."""

from __future__ import annotations

import inspect
import pkgutil
from abc import abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from functools import cache, cached_property
from importlib import import_module
from types import ModuleType
from typing import Any, ClassVar, Literal, Self, TypeGuard

import numpy as np

from pa10cal.arm.description import Arm, weights_known
from pa10cal.arm.statics import ObservedTargets, PoseStates, StaticLoads
from pa10cal.arrays import Array
from pa10cal.errors import CalibrationError
from pa10cal.terms import effects
from pa10cal.terms.term import Report, Role, Term, TermParameter, Traits, report_as_solved

#: Where effects sit that may be others in another campaign: of its foundation and its tool.
_OF_PLACE = ("base", "tool")
#: A joint that never carried this share of its rated torque cannot show how it winds up.
_LOADED_SHARE = 0.01
#: A joint that turned less shows no shape.
_LEAST_SPAN_RAD = 1e-3


@dataclass(frozen=True)
class CandidateContext:
    """What decides where an effect may sit."""

    arm: Arm  # the nominal arm
    flexible_joints: tuple[int, ...]  # joints, from 1, to which the model gives a spring
    reference_temperature_C: float  # temperature at which lengths are nominal
    tau_span_Nm: Array  # (n,) largest torque that each joint carried
    p_instr_middle_m: Array  # (3,) middle of the measured places in the instrument's frame
    q_span_rad: Array  # (n, 2) lowest and highest angle that each joint took
    time_span_s: tuple[float, float]  # first and last reading of the campaign
    loads_N: tuple[float, ...] = ()  # external loads that were measured at
    tool_kg: float = 0.0  # mass stated of the tool; 0 where it is not known
    # where torques come from: `logged`, `masses`, or `none`
    torques: Literal["logged", "masses", "none"] = "none"
    commanded: bool = False  # whether joint positions are those commanded, and not read back
    campaigns: tuple[str, ...] = ()  # names of the campaigns of a group; none of a single one
    # whether the instrument moves along axes of its own, each with its scale; None where not known
    three_axes: bool | None = None

    @property
    def rated_Nm(self) -> Array:
        """Return the rated torque of every joint, (n,); of unrated ones what they carried.

        One that is unrated and carried nothing counts as rated at 1 N m: there is no size to go by.
        """
        rated_Nm = self.arm.rated_Nm(self.tau_span_Nm)
        return np.where(rated_Nm == 0.0, 1.0, rated_Nm)

    def rated_at(self, joint: int) -> float:
        """Return the rated torque of a joint, from 1 [N m]; see `rated_Nm`."""
        return float(self.rated_Nm[joint - 1])

    def carried_at(self, joint: int) -> float:
        """Return the largest torque that a joint, from 1, carried [N m]; 0 where hardly any."""
        carried_Nm = float(self.tau_span_Nm[joint - 1])
        return carried_Nm if carried_Nm > _LOADED_SHARE * self.rated_at(joint) else 0.0

    def span_at(self, joint: int) -> tuple[float, float] | None:
        """Return the lowest and highest angle of a joint, from 1; None where it was not moved."""
        low, high = self.q_span_rad[joint - 1].tolist()
        return (low, high) if high - low > _LEAST_SPAN_RAD else None


#: What an effect at a joint takes of it, by the name of its field; nothing where it has none.
_OF_JOINT: dict[str, Callable[[CandidateContext, int], Any]] = {
    "rated_Nm": CandidateContext.rated_at,  # rated torque
    "span_Nm": CandidateContext.carried_at,  # largest torque that the joint carried
    "span_rad": CandidateContext.span_at,  # lowest and highest measured angle
}


@dataclass(frozen=True)
class Effect(Traits):
    """A term of the vocabulary; its parameters are zero where the effect is absent.

    A class says its `id`, where it `sits`, its form in `words`, what it does in `clauses`, the
    parameters it is `reported` by, and what a unit of each makes of its `coordinates` (`per_unit`).
    Parameters past the first `linear` shape the effect and matter only where it is present.
    """

    of: str  # where it sits: `joint 2`, `forearm`, `base`, ..
    id: ClassVar[str]
    #: Where it may sit: `joint`, at every one that turns, or the one place of that name.
    sits: ClassVar[str]
    #: The form in words a reader can type, by the parameters it reports; the effect itself is {0}.
    words: ClassVar[str]
    #: What it is called, of one place and of several; {id} are the words of its id.
    nouns: ClassVar[tuple[str, ...]] = ("{id}",)
    #: What it does {at} a place, one clause, and at several joints, where that is said otherwise.
    clauses: ClassVar[tuple[str, ...]] = ("there is {id} of {at}",)
    #: Whether it only gives the place of a missing effect, not its cause: no name.
    generic: ClassVar[bool] = False
    #: What a reader should do who finds it without a name, one clause.
    advice: ClassVar[str] = ""
    #: Whether its linear parameters cannot be negative, as of a stiffness, a Coulomb torque or lost
    #: motion. Every effect decides (a test holds all of them): a fit of the other sign is not it.
    positive: ClassVar[bool] = False
    #: Lowest and highest value that its first parameter can have, and why; None for no such limit.
    #: Where there is one it decides, and not what is plausible.
    possible: ClassVar[tuple[float, float, str] | None] = None
    #: Most that it can turn anything by [rad], and why; None for no such limit.
    most_rad: ClassVar[tuple[float, str] | None] = None
    #: Power of the weights with which its reported parameters go: -1 of a compliance.
    weights_power: ClassVar[float] = 0.0
    #: Whether it moves what its joint sits on, so that the link before it is to bend in a chain.
    on_link: ClassVar[bool] = False
    #: Whether the instrument reads falsely by it, and the robot has nothing of it.
    falsifies_readings: ClassVar[bool] = False
    #: Whether its amounts are known by their differences: the arm's lengths take up what is common.
    by_differences: ClassVar[bool] = False
    #: Whether it is a fault of the whole log, reported and never named as an effect.
    fault: ClassVar[bool] = False
    #: Whether it goes with time or temperature.
    goes_with_time: ClassVar[bool] = False
    #: Whether searches try it; else it is a name for what another form finds.
    sought: ClassVar[bool] = True
    #: Whether it takes up what several others do, one after the other: it comes in the place of
    #: another where blocks of poses judge under stated weights, in sets under others, else never.
    takes_a_place: ClassVar[bool] = False

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        """Return the effect at every place where it may sit."""
        joints = turning_joints(context) if cls.sits == "joint" else (0,)
        rest = {joint: cls.fields_at(context, joint) for joint in joints}
        return tuple(
            cls(f"joint {joint}" if joint else cls.sits, *fields)
            for joint, fields in rest.items()
            if fields is not None
        )

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        """Return its fields, but for the place, at a joint (0 for elsewhere); None for not there.

        Those of a name in `_OF_JOINT` are taken by it, and it sits where the joint has all of them.
        """
        names = [field.name for field in fields(cls) if field.name in _OF_JOINT]
        taken = tuple(_OF_JOINT[name](context, joint) for name in names)
        return taken if all(taken) else None

    @property
    @abstractmethod
    def reported(self) -> tuple[TermParameter, ...]:
        """Return its parameters under the names readers know, each with its plausible size."""

    @property
    def roles(self) -> tuple[Role, ...]:
        role: Role = "effect"
        return (role,) * len(self.parameters)

    @cached_property
    def parameters(self) -> tuple[TermParameter, ...]:
        """Return the k parameters it is solved in: by default those reported."""
        start = f"{self.id}_{self.of.removeprefix('joint ')}_"
        return tuple(replace(known, name=start + known.name) for known in self.reported)

    def report(self, x: Array) -> Report:
        """Return the parameters in the form of the vocabulary."""
        report = report_as_solved(self.reported, x)
        return replace(report, by_weights=self.weights_power * x) if self.weights_power else report

    @property
    def formula(self) -> str:
        """Return the form in words a reader can type, by the parameters it reports."""
        return self.words.format(self)

    @property
    def linear(self) -> int:
        """Return how many parameters, from the first, it is proportional to."""
        return len(self.parameters)

    @property
    def proportional(self) -> bool:
        return self.linear == len(self.parameters)

    @property
    def stays_with_arm(self) -> bool:
        moved = self.of in _OF_PLACE and self.goes_with_time
        return not moved and self.of != "instrument"

    @property
    def known_elsewhere(self) -> bool:
        return self.of not in _OF_PLACE

    @property
    def in_sets(self) -> bool:
        """Return whether sets under unknown weights may have it."""
        return True

    @property
    def by_joint(self) -> int | None:
        """Return the joint, from 1, that moves by it the one where it sits; None without any."""
        return None

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Return the m chain coordinates it adds to."""
        return ()

    def per_unit(self, states: PoseStates) -> Array:
        """Return what it adds to its coordinates a unit of each parameter, (P, m, k).

        Axes of length one may be absent.
        """
        raise NotImplementedError(f"{self.id} has no form")

    def shift(self, states: PoseStates, x: Array) -> Array:
        """Return what it adds to its coordinates, (P, m): proportional, where nothing else."""
        shift: Array = self.derivative(states, x) @ x
        return shift

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return the derivative of `shift` by x, (P, m, k)."""
        return self.per_unit(states).reshape(len(states), len(self.coordinates), len(x))

    def turn_limit(self, reach_m: float) -> tuple[float, str] | None:
        """Return `most_rad` of an arm that reaches so far."""
        del reach_m
        return self.most_rad

    def turn_rad(self, states: PoseStates, x: Array) -> float:
        """Return the largest turn that it makes of one of its coordinates in some poses."""
        turns = [not name.endswith((".x", ".y", ".z")) for name in self.coordinates]
        return float(np.abs(self.shift(states, x)[:, turns]).max(initial=0.0))

    @property
    def starts(self) -> tuple[Array, ...]:
        """Return points (k,) from which to look for it: shapes to try, in zero amount."""
        return (np.zeros(len(self.parameters)),)

    @property
    def prior_factor(self) -> Array:
        """Return L (l, l) with L L^T the covariance to be expected of the linear parameters."""
        sizes = [parameter.plausible for parameter in self.parameters[: self.linear]]
        return np.diag(np.array(sizes, dtype=float))

    def size(self, x: Array) -> float:
        """Return how large linear parameters (l,) are: the largest, in what is to be expected."""
        return float(np.abs(np.linalg.solve(self.prior_factor, x)).max())


@dataclass(frozen=True)
class AtJoint(Effect):
    """An effect that may sit at every joint that turns, and turns it further."""

    sits: ClassVar[str] = "joint"

    @property
    def joint(self) -> int:
        """Return the joint, 1 … n."""
        return joint_of(self.of)

    @property
    def coordinates(self) -> tuple[str, ...]:
        return (f"theta_{self.joint}",)


@dataclass(frozen=True)
class JointEffect(AtJoint):
    """An effect at a joint that is no periodic error of its angle."""


def is_effect(term: Term) -> TypeGuard[Effect]:
    """Return whether a term is an effect of which something is unknown."""
    return "effect" in term.roles


def turning_joints(context: CandidateContext) -> tuple[int, ...]:
    """Return the joints, from 1, that turn."""
    return tuple(int(joint) for joint in np.flatnonzero(~context.arm.prismatic) + 1)


def joint_of(place: str) -> int:
    """Return the number of the joint, from 1, that a place names."""
    return int(place.removeprefix("joint "))


def static_loads_in(states: PoseStates, effect: Effect) -> StaticLoads:
    """Return what weights bend the structure with.

    Raises:
        CalibrationError: when that was not computed for these poses.
    """
    if states.static_loads is None:
        raise _lacking(
            effect,
            "the effect needs the moments of the weights on the structure",
            "poses of an arm and a tool whose masses are known",
            "describe the masses, or omit the effect",
        )
    return states.static_loads


def time_in(states: PoseStates, effect: Effect) -> Array:
    """Return the times of poses, (P,) [s].

    Raises:
        CalibrationError: when they give an order alone.
    """
    if not states.tells_time:
        raise _lacking(
            effect,
            "time was not recorded, or the order of the poses goes with a joint or a load",
            "poses in another order than that of a joint or load, with their times",
            "omit the effect, or measure in random order and log time_s",
        )
    return states.time_s


def move_share_in(states: PoseStates, effect: Effect) -> Array:
    """Return the moves from the pose before, (P, n), over that of the joint that went furthest.

    Raises:
        CalibrationError: when no order of poses is known.
    """
    if states.move_share is None:
        raise _lacking(
            effect,
            "the order in which poses were measured is not known",
            "poses with times of their own",
            "log time_s, or omit the effect",
        )
    return states.move_share


def move_end_in(states: PoseStates, effect: Effect) -> Array:
    """Return how far the end goes along these moves, (P,), for a radian of that joint [m].

    Raises:
        CalibrationError: when no order of poses is known.
    """
    move_share_in(states, effect)
    if states.move_end_m is None:
        raise _lacking(
            effect, "the moves of the end are not known", "poses of a campaign", "omit the effect"
        )
    return states.move_end_m


def seen_in(states: PoseStates, effect: Effect) -> ObservedTargets:
    """Return how the poses were read from the instrument's targets.

    Raises:
        CalibrationError: when the poses were not read from targets.
    """
    if states.seen is None:
        raise _lacking(
            effect,
            "the effect needs the positions of the instrument's targets",
            "poses read from targets",
            "omit the effect for this instrument",
        )
    return states.seen


def _lacking(effect: Effect, what: str, allowed: str, remedy: str) -> CalibrationError:
    where = f"{effect.id} of {effect.of}"
    return CalibrationError(what, where=where, allowed=allowed, remedy=remedy)


# All effects of the vocabulary, found by looking through this package.


@cache
def every_effect() -> tuple[type[Effect], ...]:
    """Return every class of effect, named ones before generic ones, ordered by id."""
    return classes_in(effects, Effect)


def classes_in(package: ModuleType, kind: Any) -> tuple[Any, ...]:
    """Return every class of a kind in a package, named ones before generic ones, by id."""
    modules = [
        import_module(f"{package.__name__}.{module.name}")
        for module in pkgutil.iter_modules(package.__path__)
    ]
    found = {
        each
        for module in modules
        for _, each in inspect.getmembers(module, inspect.isclass)
        if issubclass(each, kind) and not inspect.isabstract(each) and "id" in vars(each)
    }
    return tuple(sorted(found, key=lambda each: (each.generic, each.id)))


def candidates(context: CandidateContext, held: Iterable[Term] = ()) -> tuple[Effect, ...]:
    """Return every effect sought, at every place where it may sit, but those that a model has.

    Under weights that nobody stated without what is sought in sets alone there.
    """
    stated = weights_known(context.arm).origin == "stated"
    kinds = (each for each in every_effect() if each.sought and (stated or not each.takes_a_place))
    return everywhere_but(kinds, context, held)


def everywhere_but(
    kinds: Iterable[type[Effect]], context: CandidateContext, held: Iterable[Term]
) -> tuple[Effect, ...]:
    """Return effects of some kinds at every place where they may sit, but those held."""
    there = {(term.id, term.of) for term in held}
    return tuple(
        effect
        for kind in kinds
        for effect in kind.everywhere(context)
        if (effect.id, effect.of) not in there
    )


def vocabulary_of(arm: Arm) -> tuple[tuple[Effect, ...], ...]:
    """Return the effects that can be named at an arm of any campaign, each with all its places.

    Where the arm does not state what an effect needs (nan), as a gear ratio, it is not there.
    """
    anywhere = CandidateContext(
        arm=arm,
        flexible_joints=(),
        reference_temperature_C=20.0,
        tau_span_Nm=arm.rated_Nm(np.ones(arm.n)),
        p_instr_middle_m=np.zeros(3),
        q_span_rad=arm.joint_ranges_rad,
        time_span_s=(0.0, 3600.0),
        commanded=True,
    )
    kinds = (kind.everywhere(anywhere) for kind in every_effect() if not kind.generic)
    stated = (
        tuple(
            e for e in places if not any(isinstance(v, float) and v != v for v in vars(e).values())
        )
        for places in kinds
    )
    return tuple(places for places in stated if places)
