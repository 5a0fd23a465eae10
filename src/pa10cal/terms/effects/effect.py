"""Base classes of effects: what a class states of itself, and what it may need of poses."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, ClassVar, Literal, Self, TypeGuard, TypeVar, get_args

import numpy as np

from pa10cal.arm.statics import ObservedTargets, PoseStates, StaticLoads
from pa10cal.arrays import Array
from pa10cal.errors import CalibrationError
from pa10cal.rules import COMPARED
from pa10cal.terms.effects.context import (
    CandidateContext,
    driven_joints,
    joint_of,
    slides_before_turns,
    turning_joints,
)
from pa10cal.terms.term import (
    Report,
    Role,
    Term,
    TermParameter,
    Traits,
    Transferred,
    report_as_solved,
)

#: Places whose effects depend on the foundation and the tool of a campaign.
_OF_PLACE = ("base", "tool")
Value = TypeVar("Value")
#: Fields of effects at a joint that `Effect.fields_at` takes from the context, by their names.
_OF_JOINT: dict[str, Callable[[CandidateContext, int], Any]] = {
    "rated_Nm": CandidateContext.rated_at,  # rated torque
    "span_Nm": CandidateContext.carried_at,  # largest torque that the joint carried
    "span_rad": CandidateContext.span_at,  # lowest and highest measured angle
}


@dataclass(frozen=True)
class Limits:
    """What an effect cannot be physically: a name beyond that is refused.

    Where a value or a rotation is limited, the plausible size of the effect is no limit.
    """

    #: Whether its linear parameters cannot be negative, as those of compliances, friction or lost
    #: motion; a fit of the other sign is then another effect.
    positive: bool = False
    values: tuple[float, float] | None = None  # lowest and highest of each linear parameter
    turn_rad: float | None = None  # largest rotation that it can cause
    why: str = ""  # reason of the limit of values or of the rotation


#: Where a class of effects may sit; see `Effect.sits`.
Place = Literal[
    "joint",
    "driven joint",
    "slide",
    "long link",
    "wrist",
    "load",
    "base",
    "tool",
    "arm",
    "instrument",
]
#: How searches try an effect.
RoleInSearch = Literal[
    "candidate",  # by itself, at every place where it is possible
    # As it is flexible enough to imitate several others: where blocks judge and weights are stated,
    # only in place of another effect; under other weights only in sets.
    "substitute",
    # Where a residual shows it or a map goes by its name: `discovery/model_columns`,
    # `discovery/short_forms`, `discovery/blocked_cv/map_causes`.
    "proposed",
]


@dataclass(frozen=True)
class Effect(Traits):
    """A term of the vocabulary; its linear parameters are zero where the effect is absent.

    A class states its `id`, where it `sits`, its formula in `words`, what it does in `clauses`, the
    `reported` parameters, and the derivative of its `coordinates` by these (`per_unit`). The effect
    is proportional to its first `linear` parameters; the others shape it.
    """

    of: str  # where it sits: `joint 2`, `forearm`, `base`, ..
    id: ClassVar[str]

    # Where it is possible. Asked by `everywhere`; of slides by `discovery/blocked_cv/search`.

    #: `joint`, at every joint that turns; `driven joint`, at those of them with a motor of their
    #: own, as effects of motor, gear and sensor; `slide`, at every joint that slides before all
    #: that turn, a rail or column; `long link`, `wrist` and `load`, at those that its class finds;
    #: or else at this one place.
    sits: ClassVar[Place]
    #: Its fields that say how large it is expected to be, or in which range it is sought: an effect
    #: of another model may differ in them (`same_as`), not in those that scale its form.
    ranges_and_sizes: ClassVar[frozenset[str]] = frozenset({"rated_Nm", "spectrum"})

    # In words. Asked by `terms/wording`, its formula by model files and lists of effects, the
    # advice by `discovery/verdict`.

    #: Its formula as text, in the reported parameters; the effect itself is {0}.
    words: ClassVar[str]
    #: Its noun at one place, and at several if another; {id} is its id in words.
    nouns: ClassVar[tuple[str, ...]] = ("{id}",)
    #: A clause that says what it does {at} one place, and one for several joints if another.
    clauses: ClassVar[tuple[str, ...]] = ("there is {id} of {at}",)
    #: What it depends on, in words.
    varies_with: ClassVar[str] = "the pose"
    #: A clause that says what to do where it is found and not named.
    advice: ClassVar[str] = ""

    # Which amounts are credible. Asked by `discovery/credible_amounts`; of the sign also by
    # `discovery/together` and lists of effects.

    limits: ClassVar[Limits] = Limits()
    #: Whether each linear parameter has a meaning by itself, and one of them has to be
    #: significant; not of sine and cosine, which count together.
    amounts_stand_alone: ClassVar[bool] = True

    # Its part in searches. Asked by both scorers of `discovery/`.

    #: Whether it is a smooth function that gives the place of a missing effect and no cause.
    generic: ClassVar[bool] = False
    #: Which of its linear parameters may act without the others. Where blocks judge, each part is
    #: tried beside the whole: where a few of many would do, the others cost more than these gain.
    parts: ClassVar[tuple[tuple[int, ...], ...]] = ()
    role_in_search: ClassVar[RoleInSearch] = "candidate"
    #: Whether it is a part of the move before each pose: of the log, so that no robot moves by it.
    of_moves: ClassVar[bool] = False
    #: What makes it, where it is a curve of the joint's angle: sensor, gear or joint.
    curve_of: ClassVar[str] = ""
    #: Whether it moves the link before its joint, for which `discovery/given` lets that link bend.
    on_link_before: ClassVar[bool] = False

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        """Return the effect at every place where it may sit.

        Raises:
            ValueError: when its class `sits` at no such place.
        """
        if cls.sits not in get_args(Place):
            raise ValueError(f"{cls.__name__} sits at none of {get_args(Place)}: {cls.sits!r}")
        joints = _JOINTS[cls.sits](context) if cls.sits in _JOINTS else (0,)
        rest = {joint: cls.fields_at(context, joint) for joint in joints}
        return tuple(
            cls(f"joint {joint}" if joint else cls.sits, *fields)
            for joint, fields in rest.items()
            if fields is not None
        )

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        """Return its fields after `of` at a joint (0 elsewhere); None where it is not possible.

        By default fields named in `_OF_JOINT`, and None where the joint lacks one of these.

        Raises:
            ValueError: when it has such fields and sits at no joint.
        """
        names = [field.name for field in fields(cls) if field.name in _OF_JOINT]
        if names and not joint:
            raise ValueError(f"{cls.__name__} has {', '.join(names)} of a joint and sits at none")
        taken = tuple(_OF_JOINT[name](context, joint) for name in names)
        return taken if all(taken) else None

    @property
    @abstractmethod
    def reported(self) -> tuple[TermParameter, ...]:
        """Return the parameters as readers know them, each with its plausible size."""

    @property
    def roles(self) -> tuple[Role, ...]:
        role: Role = "effect"
        return (role,) * len(self.parameters)

    @cached_property
    def parameters(self) -> tuple[TermParameter, ...]:
        """Return the k parameters that are solved for: by default those reported."""
        start = f"{self.id}_{self.of.removeprefix('joint ')}_"
        return tuple(replace(known, name=start + known.name) for known in self.reported)

    def report(self, x: Array) -> Report:
        """Return the parameters as readers know them."""
        return report_as_solved(self.reported, x)

    @property
    def formula(self) -> str:
        """Return its formula as text, in the reported parameters."""
        return self.words.format(self)

    @property
    def linear(self) -> int:
        """Return the number of leading parameters that it is proportional to."""
        return len(self.parameters)

    @property
    def proportional(self) -> bool:
        return self.linear == len(self.parameters)

    @property
    def stays_with_arm(self) -> bool:
        moved = self.of in _OF_PLACE and self.depends_on is not None
        return not moved and self.of != "instrument"

    def elsewhere(self) -> Transferred | None:
        """Return the effect for another campaign; of base or tool it has other amounts there."""
        of_place = self.of in _OF_PLACE
        return Transferred(self, same_amounts=not of_place) if self.stays_with_arm else None

    def same_as(self, other: Term) -> bool:
        """Return whether an effect of another model is this one: equal but for ranges and sizes."""
        return super().same_as(other) and all(
            _same_value(getattr(self, each.name), getattr(other, each.name))
            for each in fields(self)
            if each.name not in self.ranges_and_sizes
        )

    @property
    def as_scale_of_instrument(self) -> bool:
        """Return whether a wrong scale of the instrument has the same effect.

        That scale is in no set of effects under unknown weights, hence nor are its likes
        (`discovery/together`).
        """
        return False

    @property
    def by_joint(self) -> int | None:
        """Return the joint, from 1, whose motion causes it at another joint; None for none.

        Asked by records of findings.
        """
        return None

    @property
    def arriving(self) -> tuple[int, ...]:
        """Return the joints, from 1, that stand elsewhere by how they arrived."""
        return ()

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Return the m chain coordinates it adds to."""
        return ()

    def per_unit(self, states: PoseStates) -> Array:
        """Return the derivative of its coordinates by each parameter, (P, m, k).

        Axes of length one may be absent, and that of the parameters may be several.
        """
        raise NotImplementedError(f"{self.id} has no form")

    def shift(self, states: PoseStates, x: Array) -> Array:
        """Return what it adds to its coordinates, (P, m): by default proportional to x."""
        return np.asarray(self.derivative(states, x) @ x)

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return the derivative of `shift` by x, (P, m, k).

        Raises:
            ValueError: when `per_unit` has another shape.
        """
        shape, unit = (len(states), len(self.coordinates), len(x)), self.per_unit(states)
        axes = [n for n in unit.shape[1:] if n != 1]
        if unit.size != math.prod(shape) or (shape[1] != 1 and axes[0] != shape[1]):
            raise ValueError(f"per_unit of {self.id}: shape {unit.shape} in place of {shape}")
        return unit.reshape(shape)

    def limits_at(self, reach_m: float) -> Limits:
        """Return its limits in an arm of this reach [m]."""
        return self.limits

    def rotations(self, states: PoseStates, x: Array) -> tuple[Array, Array]:
        """Return what it adds to angles in some poses (R,) [rad], and the derivative by x (R, k).

        A row is one angle in one pose.
        """
        turns = [
            not name.startswith(("a_", "d_")) and not name.endswith((".x", ".y", ".z"))
            for name in self.coordinates
        ]
        by_x = self.derivative(states, x)[:, turns].reshape(-1, len(x))
        return self.shift(states, x)[:, turns].ravel(), by_x

    @property
    def starts(self) -> tuple[Array, ...]:
        """Return the parameters (k,) from which fits start: zero amounts, each with one shape."""
        return (np.zeros(len(self.parameters)),)

    @property
    def prior_factor(self) -> Array:
        """Return L (l, l), where L L^T is the prior covariance of the linear parameters.

        Raises:
            ValueError: when one of these states no plausible size.
        """
        sizes = [parameter.plausible for parameter in self.parameters[: self.linear]]
        if None in sizes:
            raise ValueError(f"{self.id} of {self.of}: a linear parameter has no plausible size")
        return np.diag(np.array(sizes, dtype=float))

    def size(self, x: Array) -> float:
        """Return the largest of linear parameters (l,), in units of their plausible sizes."""
        return float(np.abs(np.linalg.solve(self.prior_factor, x)).max())


def _same_value(mine: object, theirs: object) -> bool:
    """Return whether two values of a field are the same; numbers may be rounded, as in files."""
    if isinstance(mine, tuple) and isinstance(theirs, tuple):
        return len(mine) == len(theirs) and all(map(_same_value, mine, theirs))
    if isinstance(mine, float) and isinstance(theirs, float):
        return math.isclose(mine, theirs, rel_tol=COMPARED.same, abs_tol=COMPARED.same)
    return mine == theirs


@dataclass(frozen=True)
class AtJoint(Effect):
    """An effect of a joint, by default of one that turns, on its angle."""

    sits: ClassVar[Place] = "joint"
    varies_with: ClassVar[str] = "its position"

    @property
    def joint(self) -> int:
        """Return the joint, 1 … n."""
        return joint_of(self.of)

    @property
    def coordinates(self) -> tuple[str, ...]:
        return (f"theta_{self.joint}",)


@dataclass(frozen=True)
class JointEffect(AtJoint):
    """An effect at a joint that held-out poses beyond its visited positions can contradict.

    `discovery/no_harm` then drops these names first. Waves of the angle are none: they go on there.
    """


def is_effect(term: Term) -> TypeGuard[Effect]:
    """Return whether a term is an effect of which something is unknown."""
    return "effect" in term.roles


#: Joints at which an effect is possible, by where its class `sits`.
_JOINTS: dict[str, Callable[[CandidateContext], tuple[int, ...]]] = {
    "joint": turning_joints,
    "driven joint": driven_joints,
    "slide": slides_before_turns,
}


# Quantities of poses that an effect may need; a CalibrationError where they are not known.


def static_loads_in(states: PoseStates, effect: Effect) -> StaticLoads:
    """Return the forces and moments by which the weights bend the structure."""
    return _known(
        states.static_loads,
        effect,
        "the effect needs the moments of the weights on the structure",
        "poses of an arm and a tool whose masses are known",
        "describe the masses, or omit the effect",
    )


def time_in(states: PoseStates, effect: Effect) -> Array:
    """Return the times of poses, (P,) [s]; not known where they give an order alone."""
    return _known(
        states.time_s if states.tells_time else None,
        effect,
        "time was not recorded, or the order of the poses goes with a joint or a load",
        "poses in another order than that of a joint or load, with their times",
        "omit the effect, or measure in random order and log time_s",
    )


def move_share_in(states: PoseStates, effect: Effect) -> Array:
    """Return each joint's move from the pose before over the largest of all joints, (P, n)."""
    return _known(
        states.move_share,
        effect,
        "the order in which poses were measured is not known",
        "poses with times of their own",
        "log time_s, or omit the effect",
    )


def move_end_in(states: PoseStates, effect: Effect) -> Array:
    """Return the path of the end in these moves for a radian of the largest one, (P,) [m]."""
    move_share_in(states, effect)
    return _known(
        states.move_end_m,
        effect,
        "the moves of the end are not known",
        "poses of a campaign",
        "omit the effect",
    )


def seen_in(states: PoseStates, effect: Effect) -> ObservedTargets:
    """Return the measured positions of the instrument's targets in these poses."""
    return _known(
        states.seen,
        effect,
        "the effect needs the positions of the instrument's targets",
        "poses read from targets",
        "omit the effect for this instrument",
    )


def _known(value: Value | None, effect: Effect, what: str, allowed: str, remedy: str) -> Value:
    if value is None:
        where = f"{effect.id} of {effect.of}"
        raise CalibrationError(what, where=where, allowed=allowed, remedy=remedy)
    return value
