"""What a verdict consists of: effects found, what has no name, what the data cannot show."""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Generic, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.special import softmax
from typing_extensions import TypeVar, override

from pa10cal.arrays import Array
from pa10cal.discovery.rules import JUDGING, PROBABILITIES
from pa10cal.results import discovery
from pa10cal.results.calibration import InputFinding
from pa10cal.results.evaluation import EffectParameter
from pa10cal.results.maps import JointWitness, MapForm
from pa10cal.results.record import EffectName, FaultKind, Name, Numbers, Part
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import BandPrior, is_error_map
from pa10cal.terms.term import Term
from pa10cal.terms.weights import LogFault


@dataclass(frozen=True)
class UnknownBeside:
    """Something without a name beside an effect: the more is left, the likelier it makes it, too.

    What is left over noise of the squared error is made by something that was not tried. Where an
    effect takes away little of the rest, it may be a part of that; and where much is left, whatever
    makes it may look like an effect elsewhere as well.
    """

    without_mm: float  # root mean square error without the effect [mm]
    with_mm: float  # and with it [mm]
    odds: float  # of the effect where it takes away as much as is left
    power: float  # of what it takes over what is left, by which these odds grow
    fall: float = 0.0  # of what is left over noise, by which they fall
    # what it takes of all weighed readings over what is left of these, orientations among them; the
    # larger of that and of what it takes of positions counts
    of_readings: float = 0.0

    def probability(self, noise_floor_mm: float) -> float:
        """Return the probability of something that was not tried; noise errs by a mean [mm]."""
        # Normal errors, alike in three directions, have a mean length of 2 sqrt(2 / pi) sigma.
        noise = 3.0 * np.pi / 2.0 * (0.5 * noise_floor_mm) ** 2
        squares = self.without_mm**2, self.with_mm**2
        ratio = max(over_left(*squares, noise), self.of_readings)
        most = PROBABILITIES.most_left_of_noise * noise
        left = min(left_beyond(self.with_mm**2, noise), most) / noise if noise > 0.0 else 1.0
        odds = self.odds * ratio**self.power / left**self.fall if left > 0.0 else np.inf
        return float(max(1.0 / (1.0 + odds), PROBABILITIES.unknown))


def left_beyond(squares: float, noise: float) -> float:
    """Return what is left of squares beyond those of noise, and no less than rounding shows."""
    return max(squares - noise, PROBABILITIES.left_of_noise * noise)


def over_left(without: float, with_it: float, noise: float) -> float:
    """Return what an effect takes of squares over what it leaves beyond those of noise."""
    left = left_beyond(with_it, noise)
    return max(without - with_it, 0.0) / left if left > 0.0 else np.inf


class Proof(Part):
    """Statistics that decided about an effect, with what a verdict asks of any of them."""

    # the one pose without which not half of this would be left, and too little for a name, as where
    # a gross error makes it; None where there is no such pose
    carrier: str | None = Field(default=None, exclude=True)
    # where the weights come from under which a joint gives way; None of anything else
    weights: Literal["assumed", "total", "logged"] | None = Field(default=None, exclude=True)

    @property
    def explains(self) -> float | None:
        """Part of the squared error of poses left out that the effect explains, where known."""
        return None

    @property
    def unknown(self) -> UnknownBeside | None:
        """How probable it is that something else makes this, where errors say so."""
        return None

    @property
    @abstractmethod
    def evidence(self) -> discovery.Evidence:
        """These as they are written."""


class GivesWay(discovery.EvidenceOfSag, Proof):
    """The statistics that decided about the spring of a joint."""

    # (P,) errors of the poses held out, or else fitted, with the joint rigid
    without_each_mm: Numbers = Field(exclude=True)
    all_rigid_each_mm: Numbers = Field(exclude=True)  # with all joints rigid that give way

    @property
    @override
    def unknown(self) -> UnknownBeside:
        without_mm, with_mm = self.held_out_rigid_mm, self.held_out_gives_way_mm
        if without_mm is None or with_mm is None:
            without_mm, with_mm = self.rigid_mm, self.gives_way_mm
        return UnknownBeside(without_mm, with_mm, *PROBABILITIES.known_sag)

    @property
    @override
    def evidence(self) -> discovery.EvidenceOfSag:
        return self


def carrier_of(labels: NDArray[np.str_], left: Array, whole: float, needed: float) -> str | None:
    """Return the pose that carries a name alone; None for none.

    By what of the whole that speaks for it is left without each of the poses (P,).
    """
    worst = int(left.argmin())
    carried = left[worst] < min(needed, JUDGING.carried_share * whole)
    return str(labels[worst]) if carried else None


@dataclass(frozen=True, eq=False)
class Rival:
    """What may stand in the place of an effect that was found."""

    effect: Effect
    # (B,) log score of the data with it there, less that with the effect found: of each block of
    # poses held out, or one number where repeats are the judge
    nats: Array
    weight: float = 1.0  # how likely it is beside that effect before the data are looked at


@dataclass(frozen=True)
class Explanations:
    """What may explain what was found, with probabilities that sum to one."""

    named: tuple[tuple[Effect, float], ...]  # effects of the vocabulary, the likeliest first
    none_of_these: float  # of something without a name, or that was not tried

    def of(self, effect: Effect) -> float:
        """Return the probability of an effect."""
        return dict(self.named).get(effect, 0.0)

    @property
    def smallest_set(self) -> tuple[Effect, ...]:
        """Return the effects of the smallest set that surely holds what is there.

        What none of these is, is a member of it, too, where it is that likely.
        """
        members: list[Effect] = []
        open_to = 1.0 - PROBABILITIES.surely
        left, without = 1.0, self.none_of_these
        for effect, probability in self.named:
            if left <= open_to:
                break
            if without > probability:
                left, without = left - without, 0.0
                if left <= open_to:
                    break
            members.append(effect)
            left -= probability
        return tuple(members)


P = TypeVar("P", bound=Proof, default=Proof, covariant=True)


@dataclass(frozen=True, eq=False)
class Finding(Generic[P]):
    """One effect that was found."""

    effect: Effect  # which, and where
    # x and covariance: its reported parameters, and their covariance
    x: Array
    covariance: Array
    alternatives: tuple[Effect, ...]  # effects that explain the data as well in its place
    proof: P  # the statistics that decided
    # whatever else was tried in its place, of the vocabulary and without a name
    rivals: tuple[Rival, ...] = ()
    unknown: float = PROBABILITIES.unknown  # probability that nothing that was tried is there

    @cached_property
    def explanations(self) -> Explanations:
        """Return how probable it is, among all that was tried in its place.

        Of blocks of poses by Bayesian bootstrap of their scores (pseudo-BMA+; Yao, Vehtari, Simpson
        and Gelman, Bayesian Analysis 13, 2018). What is as good and has no score has that of the
        effect itself.
        """
        rivals = {name_of(each.effect).name: each for each in self.rivals}
        # Another form of the effect itself is no other name.
        effects: dict[Name, Effect] = {}
        for each in (self.effect, *self.alternatives, *(e.effect for e in self.rivals)):
            effects.setdefault(name_of(each).name, each)
        rivals.pop(name_of(self.effect).name, None)
        blocks = max((len(each.nats) for each in self.rivals), default=1)
        nats = np.zeros((len(effects), blocks))
        weight = np.ones(len(effects))
        for k, name in enumerate(effects):
            if name in rivals:
                # One score of all blocks is that of each, in equal parts.
                nats[k] = rivals[name].nats * len(rivals[name].nats) / blocks
                weight[k] = rivals[name].weight if k else 1.0
        drawn = np.random.default_rng(0).dirichlet(np.ones(blocks), PROBABILITIES.draws)
        share = softmax(blocks * drawn @ nats.T + np.log(weight), axis=1).mean(axis=0)
        share *= 1.0 - self.unknown
        every = list(zip(effects.values(), share.tolist(), strict=True))
        named = [pair for pair in every if not pair[0].generic]
        return Explanations(
            tuple(sorted(named, key=lambda pair: -pair[1])),
            max(0.0, 1.0 - sum(probability for _, probability in named)),
        )

    @property
    def id(self) -> str:
        """Return the id of the effect."""
        return self.effect.id

    @property
    def of(self) -> str:
        """Return where it sits."""
        return self.effect.of

    @property
    def gain(self) -> float | None:
        """Return the part of the squared error of poses left out that it explains, if known."""
        return self.proof.explains

    @property
    def carrier(self) -> str | None:
        """Return the one pose that carries it, without which nothing speaks for it; else None."""
        return self.proof.carrier

    @property
    def parameters(self) -> dict[str, EffectParameter]:
        """Return its reported parameters by name."""
        return effect_parameters(self.effect, self.x, self.covariance)

    @property
    def is_unlikely(self) -> bool:
        """Whether something that has no name is likelier than its name."""
        said = self.explanations
        return said.none_of_these > max(PROBABILITIES.nameless, said.of(self.effect))

    def about(self, other: Effect) -> Self:
        """Return the same with one of its rivals as its name: nothing is more or less probable."""
        known = {name_of(each.effect).name: each for each in self.rivals}
        # What is as good and has no score has that of the effect itself.
        for effect in (*self.alternatives, self.effect):
            known.setdefault(name_of(effect).name, Rival(effect, np.zeros(1)))
        chosen = known.pop(name_of(other).name)
        blocks = max(len(each.nats) for each in self.rivals)

        def of_blocks(nats: Array) -> Array:
            return np.broadcast_to(nats * len(nats) / blocks, blocks)

        rivals = tuple(
            Rival(
                each.effect,
                of_blocks(each.nats) - of_blocks(chosen.nats),
                each.weight / chosen.weight,
            )
            for each in known.values()
        )
        others = (self.effect, *self.alternatives)
        alternatives = tuple(e for e in others if name_of(e).name != name_of(other).name)
        return replace(self, effect=other, rivals=rivals, alternatives=alternatives)

    def with_likely(self) -> Self:
        """Return it with what is likely enough as its alternatives, the likeliest first."""
        likely = (e for e, p in self.explanations.named if p >= PROBABILITIES.least)
        return replace(self, alternatives=tuple(e for e in likely if e != self.effect))

    def record(self, witness: JointWitness | None = None) -> discovery.FoundEffect:
        """Return it as it is written, with what says whose error an error by angle is."""
        form = None
        if is_error_map(self.effect) and self.effect.spectrum is not None:
            kind = "band" if isinstance(self.effect.spectrum, BandPrior) else "fading"
            keys = {"knots": self.effect.knots, kind: asdict(self.effect.spectrum)}
            form = MapForm.model_validate(keys)
        said = self.explanations
        listed = tuple(
            discovery.Alternative(**dict(name_of(effect)), probability=said.of(effect))
            for effect in self.alternatives
        )
        return discovery.FoundEffect(
            id=self.id,
            of=self.of,
            form=form,
            parameters=self.parameters,
            probability=said.of(self.effect),
            alternatives=listed,
            others=max(
                0.0,
                1.0 - said.none_of_these - sum(map(said.of, (self.effect, *self.alternatives))),
            ),
            none_of_these=said.none_of_these,
            set95=tuple(map(name_of, said.smallest_set)),
            evidence=self.proof.evidence,
            witness=witness,
            weights=self.proof.weights,
            by=self.effect.by_joint,
        )


def effect_parameters(term: Term, x: Array, covariance: Array) -> dict[str, EffectParameter]:
    """Return reported parameters of an effect or a form by name, with their covariance."""
    known = term.report(np.zeros(len(term.parameters))).parameters
    std = np.sqrt(np.diag(covariance)).tolist()
    return {
        parameter.name: EffectParameter(value=value, std=sigma, unit=parameter.unit)
        for parameter, value, sigma in zip(known, x.tolist(), std, strict=True)
    }


def name_of(effect: Effect) -> EffectName:
    """Return an effect's name and place."""
    return EffectName(id=effect.id, of=effect.of)


@dataclass(frozen=True)
class Untestable:
    """An effect that these data cannot show."""

    effect: Effect  # which, and where
    why: str  # the reason
    # whether other poses might show it; not where what it needs was not logged
    by_these_poses: bool = True


def with_a_name(entries: Sequence[Untestable]) -> tuple[discovery.NotTestable, ...]:
    """Return the effects with a name among those that the data cannot show."""
    return tuple(
        discovery.NotTestable(id=entry.effect.id, of=entry.effect.of, why=entry.why)
        for entry in entries
        if not entry.effect.generic
    )


# Faults of a log that discovery finds: what is wrong, where, and what to do.

#: Kinds of what a calibration finds in its input that are faults of the log.
_OF_INPUT: dict[str, FaultKind] = {
    "joint_sign": "joint_sign",
    "joint_order": "joint_sign",
    "joint_coupling": "joint_sign",
    "joint_zero": "joint_zero",
    "target_label": "label",
    "campaigns": "step_in_time",
}


class DiagnosedFault(discovery.Fault):
    """Something in the log that is wrong, and what it does to the verdict; that is not written."""

    gain: float | None = None
    # whether the verdict is `check_the_log` whatever else was found; a reading with a gross error,
    # once excluded, leaves the effects found standing
    decides: bool = Field(default=True, exclude=True)
    # of a step that is told as a fact, its most likely time; readings before and after have bases
    # of their own
    at_s: float | None = Field(default=None, exclude=True)
    # effect that it is as well; found, that is what it is
    effect: EffectName | None = Field(default=None, exclude=True)


def steps_told(faults: Sequence[DiagnosedFault]) -> tuple[float, ...]:
    """Return the times of the steps that are told as facts [s], the most certain first."""
    return tuple(fault.at_s for fault in faults if fault.at_s is not None)


def fault_of(term: LogFault, x: Array, covariance: Array, gain: float | None) -> DiagnosedFault:
    """Return a fault found as a term, which explains a part of the squared error."""
    told = term.fault_text(x, np.sqrt(np.diag(covariance)))
    return DiagnosedFault(
        kind=term.kind, where=told.where, what=told.what, remedy=told.remedy, gain=gain
    )


def faults_of_input(suspicions: Sequence[InputFinding]) -> tuple[DiagnosedFault, ...]:
    """Return what the calibration found wrong in the input, as far as it is a fault of the log."""
    faults = []
    for finding in suspicions:
        kind = _OF_INPUT.get(finding.kind)
        joint = re.fullmatch(r"(?:[^,;]* \(`)?(?:delta_theta_|q)(\d+)(?:`\))?", finding.where)
        if finding.kind == "departure" and joint is not None:
            kind = "joint_zero"
        if kind is None:
            continue
        where, what = finding.where if joint is None else f"joint {joint[1]}", finding.what
        if finding.would_leave_mm is not None:
            what += f" ({finding.would_leave_mm:.3g} mm rms would remain if that is put right)"
        faults.append(
            DiagnosedFault(
                kind=kind, where=where, what=what, remedy=finding.remedy, effect=finding.effect
            )
        )
    return tuple(faults)


def to_check(faults: Sequence[DiagnosedFault], *, effects: bool) -> bool:
    """Return whether a verdict is `check_the_log`, by its faults and whether effects stand."""
    return any(fault.decides or not effects for fault in faults)
