"""Terms around another one: restricted to some poses, or held at fixed parameters."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, TypeGuard

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import BASE
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.errors import TermError
from pa10cal.terms.offsets import motion_of_base, small_motion
from pa10cal.terms.term import (
    Holds,
    Report,
    Role,
    Term,
    TermParameter,
    TorqueTerm,
    Traits,
    Yielding,
    shows_torque,
    yields,
)

#: Separates the name of a parameter or target from that of its campaign; neither contains it.
OF = "@"


class _AroundTerm(Traits):
    """What a term around another one takes from that."""

    term: Term
    #: Traits that classes state and that are those of the term here, hence of each instance.
    of_term: ClassVar[tuple[str, ...]] = ("bends", "depends_on", "error_of")

    def __post_init__(self) -> None:
        for trait in self.of_term:
            object.__setattr__(self, trait, getattr(self.term, trait))

    @property
    def coordinates(self) -> tuple[str, ...]:
        return self.term.coordinates


# Terms of a campaign of a group, or of a part of a campaign.


class _InSomePoses(_AroundTerm):
    """Another term, restricted to some poses."""

    term: Term  # it neither turns joints under torque nor shows in logged torques
    name: str  # name of those poses, which names of parameters end with

    def __post_init__(self) -> None:
        if self.term.yields or self.term.shows_torque:
            raise TermError(
                "a term of torques cannot belong to one campaign",
                where=f"{self.term.id} of {self.term.of}",
                allowed="terms that move the chain alone",
                remedy="give the term to all campaigns of the group",
            )
        super().__post_init__()

    @property
    def of(self) -> str:
        return f"{self.term.of}{OF}{self.name}"

    @property
    def formula(self) -> str:
        return f"in the poses of {self.name}: {self.term.formula}"

    @property
    def parameters(self) -> tuple[TermParameter, ...]:
        return self._named(self.term.parameters)

    @property
    def roles(self) -> tuple[Role, ...]:
        return self.term.roles

    @property
    def constant(self) -> bool:
        return self.term.constant

    @property
    def stays_with_arm(self) -> bool:
        return False

    def shift(self, states: PoseStates, x: Array) -> Array:
        return np.asarray(self._here(states)[:, None] * self.term.shift(states, x))

    def derivative(self, states: PoseStates, x: Array) -> Array:
        return np.asarray(self._here(states)[:, None, None] * self.term.derivative(states, x))

    def targets_derivative(self, states: PoseStates, x: Array) -> Array | None:
        derivative = self.term.targets_derivative(states, x)
        return None if derivative is None else self._here(states)[:, None, None] * derivative

    def report(self, x: Array) -> Report:
        report = self.term.report(x)
        return replace(report, parameters=self._named(report.parameters))

    def _named(self, parameters: Sequence[TermParameter]) -> tuple[TermParameter, ...]:
        return tuple(replace(each, name=of_campaign(each.name, self.name)) for each in parameters)

    @abstractmethod
    def _here(self, states: PoseStates) -> NDArray[np.bool_]:
        """Return which poses it holds in, (P,) or (1,)."""


@dataclass(frozen=True)
class OfCampaign(_InSomePoses):
    """Another term, restricted to the poses of one campaign of a group."""

    term: Term  # see `_InSomePoses`
    campaign: int  # number of the campaign in the group, from 0
    name: str  # its name
    id: ClassVar[str] = "of_campaign"
    holds: ClassVar[Holds] = "campaign"

    def only(self, names: Collection[str]) -> OfCampaign:
        """Return the parameters that are named, see `Term.only`."""
        own = (parameter.name for parameter in self.term.parameters)
        kept = {name for name in own if of_campaign(name, self.name) in names}
        return replace(self, term=self.term.only(kept))

    def _here(self, states: PoseStates) -> NDArray[np.bool_]:
        """Return which poses are of the campaign, (P,); (1,) where states name no campaigns."""
        campaign = np.zeros(1) if states.campaign is None else states.campaign
        return np.asarray(campaign == self.campaign)


@dataclass(frozen=True)
class OfPart(_InSomePoses):
    """Another term, restricted to the poses of one part of a campaign."""

    term: Term  # see `_InSomePoses`
    from_s: float  # the part begins after this time
    to_s: float  # and ends with this one; infinite for the last part
    name: str  # its name
    id: ClassVar[str] = "of_part"
    holds: ClassVar[Holds] = "part"

    def _here(self, states: PoseStates) -> NDArray[np.bool_]:
        """Return which poses are of the part, (P,)."""
        return np.asarray((states.time_s > self.from_s) & (states.time_s <= self.to_s))


def of_campaign(name: str, campaign: str) -> str:
    """Return the name of what belongs to a campaign."""
    return f"{name}{OF}{campaign}"


def of_one_campaign(term: Term) -> TypeGuard[OfCampaign]:
    """Return whether a term holds in one campaign of a group alone."""
    return term.holds == "campaign"


def about_moved_base(terms: Sequence[Term], x: Array, small: Array) -> Array:
    """Return the parameters of terms (k,) once a motion of the base (6,) is part of its frame.

    Base terms of a campaign or part add to that motion. Their values about the moved frame follow
    from T(motion)^-1 T(motion + x); `terms` do not include the motion itself.
    """
    x, first = x.copy(), 0
    back = np.linalg.inv(motion_of_base(small))
    for term in terms:
        columns = slice(first, first + len(term.parameters))
        first = columns.stop
        if term.holds == "everywhere" or not set(term.coordinates) <= set(BASE):
            continue
        at = [BASE.index(name) for name in term.coordinates]
        whole = small.copy()
        whole[at] += x[columns]
        away = back @ motion_of_base(whole)
        x[columns] = small_motion(away)[at]
    return x


# Terms with fixed parameters.


@dataclass(frozen=True, eq=False)
class Fixed(_AroundTerm):
    """A term at fixed parameters: it has no unknowns, and predicts as the term does."""

    term: Term
    x_term: Array  # (k,) its parameters
    of_term = (*_AroundTerm.of_term, "holds")
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
        return FixedTorque(term, x_term)
    return FixedYielding(term, x_term) if yields(term) else Fixed(term, x_term)
