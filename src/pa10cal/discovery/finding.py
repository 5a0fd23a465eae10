"""Effects found, with their rivals and probabilities, and effects that data cannot show."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import KW_ONLY, asdict, dataclass, replace
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
from pa10cal.results.arrays import Numbers
from pa10cal.results.evaluation import EffectParameter
from pa10cal.results.maps import JointWitness, MapForm
from pa10cal.results.record import EffectName, Name, Part
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import BandPrior, is_error_map
from pa10cal.terms.term import Term


@dataclass(frozen=True)
class UnknownBeside:
    """Model of the probability that an effect is caused by something that was not tried.

    The squared error that remains beyond noise has an unknown cause. An effect that removes little
    compared with it may be a part of it; and the larger it is, the more often it looks like an
    effect elsewhere. The odds of the effect are
    odds * (removed / remaining)^power / (remaining / noise)^fall.

    What remains counts as at least `left_of_noise` of the noise and, over noise, as at most
    `most_left_of_noise`; the probability is at least `unknown` (rules, PROBABILITIES). Without
    noise remaining / noise is 1.
    """

    without_mm: float  # root mean square error without the effect [mm]
    with_mm: float  # and with it [mm]
    _: KW_ONLY
    odds: float  # odds of an effect that removes as much as remains
    power: float
    fall: float = 0.0
    # removed over remaining squares of all whitened readings, orientations included; the larger of
    # this ratio and that of positions counts
    of_readings: float = 0.0

    def probability(self, noise_floor_mm: float) -> float:
        """Return that probability, by the mean position error that noise alone leaves [mm]."""
        # Normal errors, alike in three directions, have a mean length of 2 sqrt(2 / pi) sigma.
        noise = 3.0 * np.pi / 2.0 * (0.5 * noise_floor_mm) ** 2
        squares = self.without_mm**2, self.with_mm**2
        ratio = max(over_left(*squares, noise), self.of_readings)
        most = PROBABILITIES.most_left_of_noise * noise
        beyond = min(left_beyond(self.with_mm**2, noise), most) / noise if noise > 0.0 else 1.0
        odds = self.odds * ratio**self.power / beyond**self.fall
        return float(max(1.0 / (1.0 + odds), PROBABILITIES.unknown))


def left_beyond(squares: float, noise: float) -> float:
    """Return squares less those of noise, but at least a small part of the latter."""
    return max(squares - noise, PROBABILITIES.left_of_noise * noise)


def over_left(without: float, with_it: float, noise: float) -> float:
    """Return the squares that an effect removes over those that remain beyond noise.

    It is 0 where nothing is removed, even if nothing remains.
    """
    removed, remaining = max(without - with_it, 0.0), left_beyond(with_it, noise)
    if removed == 0.0:
        return 0.0
    return removed / remaining if remaining > 0.0 else np.inf


class Proof(Part):
    """The statistics that decided about an effect."""

    # the pose without which less than half of the evidence remains, and too little for a name, as
    # if a gross error caused it; None where there is no such pose
    carrier: str | None = Field(default=None, exclude=True)
    # source of the weights under which a joint gives way; None for all other effects
    weights: Literal["assumed", "total", "logged"] | None = Field(default=None, exclude=True)

    @property
    def explains(self) -> float | None:
        """Part of the squared error of held-out poses that the effect explains, where known."""
        return None

    @property
    def unknown_cause(self) -> UnknownBeside | None:
        """Model of the probability of an unknown cause; None where errors give none."""
        return None

    @property
    @abstractmethod
    def evidence(self) -> discovery.Evidence:
        """The statistics as written to the record."""


class GivesWay(discovery.EvidenceOfSag, Proof):
    """The statistics that decided about the spring of a joint."""

    # (P,) errors of the poses held out, or else fitted, with the joint rigid
    without_each_mm: Numbers = Field(exclude=True)
    all_rigid_each_mm: Numbers = Field(exclude=True)  # with all joints rigid that give way

    @property
    @override
    def unknown_cause(self) -> UnknownBeside:
        without_mm, with_mm = self.held_out_rigid_mm, self.held_out_gives_way_mm
        if without_mm is None or with_mm is None:
            without_mm, with_mm = self.rigid_mm, self.gives_way_mm
        odds, power = PROBABILITIES.known_sag
        return UnknownBeside(without_mm, with_mm, odds=odds, power=power)

    @property
    @override
    def evidence(self) -> discovery.EvidenceOfSag:
        return self


def threshold(effect_count: int, error_rate: float) -> float:
    """Return the gain in log evidence that a name needs where so many effects are sought.

    If none of them is present, the probability that any reaches it is at most the error rate.
    """
    return float(np.log(max(effect_count, 1) / error_rate))


def carrier_of(labels: NDArray[np.str_], left: Array, whole: float, needed: float) -> str | None:
    """Return the pose on which alone the evidence of a name rests; None for none.

    Args:
        labels: (P,) poses.
        left: (P,) evidence that remains without each pose.
        whole: evidence by all poses.
        needed: evidence that a name needs.
    """
    worst = int(left.argmin())
    carried = left[worst] < min(needed, JUDGING.carried_share * whole)
    return str(labels[worst]) if carried else None


@dataclass(frozen=True, eq=False)
class Rival:
    """An effect that may be present in place of one that was found."""

    effect: Effect
    # (B,) log score with it less that with the effect found: of each held-out block of poses, or
    # one number where repeats judge
    nats: Array
    weight: float = 1.0  # prior odds, relative to the effect found

    @property
    def log_odds(self) -> float:
        """Return its log odds against the effect found, by the scores of all blocks."""
        return float(self.nats.sum() + np.log(self.weight))

    def by_block(self, blocks: int) -> Array:
        """Return the log score of each block, (B,); one score of all blocks is shared equally."""
        return np.broadcast_to(self.nats * len(self.nats) / blocks, blocks)


@dataclass(frozen=True)
class Explanations:
    """Explanations of what was found, with probabilities that sum to one."""

    named: tuple[tuple[Effect, float], ...]  # effects of the vocabulary, the likeliest first
    none_of_these: float  # probability of something without a name, or that was not tried

    def of(self, effect: Effect) -> float:
        """Return the probability of an effect."""
        return dict(self.named).get(effect, 0.0)

    @property
    def smallest_set(self) -> tuple[Effect, ...]:
        """Return the effects of the smallest set that holds the truth with enough probability.

        "None of these" is a member, in the order of its probability, but not returned.
        """
        members: list[Effect] = []
        allowed = 1.0 - PROBABILITIES.surely  # probability that may remain outside the set
        outside, none_of_these = 1.0, self.none_of_these
        for effect, probability in self.named:
            if outside <= allowed:
                break
            if none_of_these > probability:
                outside, none_of_these = outside - none_of_these, 0.0
                if outside <= allowed:
                    break
            members.append(effect)
            outside -= probability
        return tuple(members)


ProofT = TypeVar("ProofT", bound=Proof, default=Proof, covariant=True)


@dataclass(frozen=True, eq=False)
class Finding(Generic[ProofT]):
    """One effect that was found."""

    effect: Effect  # which, and where
    x: Array  # (k,) its reported parameters
    covariance: Array  # (k, k) of them
    alternatives: tuple[Effect, ...]  # effects that explain the data as well in its place
    proof: ProofT
    rivals: tuple[Rival, ...] = ()  # every effect that was tried in its place, with its score
    unknown: float = PROBABILITIES.unknown  # probability that none of those tried is present

    @cached_property
    def explanations(self) -> Explanations:
        """Return the probabilities of the effect and of its rivals.

        Scores of blocks are averaged by the Bayesian bootstrap (pseudo-BMA+; Yao, Vehtari, Simpson
        and Gelman, Bayesian Analysis 13, 2018). An alternative without a score of its own has that
        of the effect.
        """
        rivals = self._rivals_by_name
        effects: dict[Name, Effect] = {}
        of_rivals = (rival.effect for rival in rivals.values())
        for effect in (self.effect, *self.alternatives, *of_rivals):
            effects.setdefault(name_of(effect).name, effect)
        blocks = max((len(rival.nats) for rival in self.rivals), default=1)
        nats = np.zeros((len(effects), blocks))
        weight = np.ones(len(effects))
        for k, name in enumerate(effects):
            if name in rivals:
                nats[k] = rivals[name].by_block(blocks)
                weight[k] = rivals[name].weight
        drawn = np.random.default_rng(0).dirichlet(np.ones(blocks), PROBABILITIES.draws)
        share = softmax(blocks * drawn @ nats.T + np.log(weight), axis=1).mean(axis=0)
        share *= 1.0 - self.unknown
        named = {
            effect: probability
            for effect, probability in zip(effects.values(), share.tolist(), strict=True)
            if not effect.generic
        }
        likeliest_first = sorted(named.items(), key=lambda pair: -pair[1])
        return Explanations(tuple(likeliest_first), max(0.0, 1.0 - sum(named.values())))

    @property
    def _rivals_by_name(self) -> dict[Name, Rival]:
        """Return the rivals of other names than the effect, each in the form that scores best."""
        best: dict[Name, Rival] = {}
        for rival in self.rivals:
            name = name_of(rival.effect).name
            if name not in best or rival.log_odds > best[name].log_odds:
                best[name] = rival
        best.pop(name_of(self.effect).name, None)  # another form of the effect is no rival
        return best

    @property
    def id(self) -> str:
        """Return the id of the effect."""
        return self.effect.id

    @property
    def of(self) -> str:
        """Return where it sits."""
        return self.effect.of

    @property
    def parameters(self) -> dict[str, EffectParameter]:
        """Return its reported parameters by name."""
        return effect_parameters(self.effect, self.x, self.covariance)

    @property
    def is_unlikely(self) -> bool:
        """Return whether something without a name is likelier than the effect."""
        known = self.explanations
        return known.none_of_these > max(PROBABILITIES.nameless, known.of(self.effect))

    def exchanged_for(self, other: Effect) -> Self:
        """Return the finding with a rival in place of its effect, at the same probabilities."""
        known = self._rivals_by_name
        # An alternative without a score of its own has that of the effect.
        for effect in (self.effect, *self.alternatives):
            known.setdefault(name_of(effect).name, Rival(effect, np.zeros(1)))
        chosen = known.pop(name_of(other).name)
        blocks = max((len(rival.nats) for rival in self.rivals), default=1)
        nats = chosen.by_block(blocks)
        rivals = tuple(
            Rival(rival.effect, rival.by_block(blocks) - nats, rival.weight / chosen.weight)
            for rival in known.values()
        )
        others = (self.effect, *self.alternatives)
        alternatives = tuple(e for e in others if name_of(e).name != name_of(other).name)
        return replace(self, effect=other, rivals=rivals, alternatives=alternatives)

    def with_likely(self) -> Self:
        """Return the finding with all likely effects as alternatives, the likeliest first."""
        likely = (e for e, p in self.explanations.named if p >= PROBABILITIES.least)
        return replace(self, alternatives=tuple(e for e in likely if e != self.effect))

    def record(self, witness: JointWitness | None = None) -> discovery.FoundEffect:
        """Return the finding as written to the record, with the evidence for sensor or gear."""
        form = None
        if is_error_map(self.effect) and self.effect.spectrum is not None:
            kind = "band" if isinstance(self.effect.spectrum, BandPrior) else "fading"
            keys = {"knots": self.effect.knots, kind: asdict(self.effect.spectrum)}
            form = MapForm.model_validate(keys)
        known = self.explanations
        listed = (self.effect, *self.alternatives)
        alternatives = tuple(
            discovery.Alternative(**dict(name_of(effect)), probability=known.of(effect))
            for effect in self.alternatives
        )
        return discovery.FoundEffect(
            id=self.id,
            of=self.of,
            form=form,
            parameters=self.parameters,
            probability=known.of(self.effect),
            alternatives=alternatives,
            others=max(0.0, 1.0 - known.none_of_these - sum(map(known.of, listed))),
            none_of_these=known.none_of_these,
            set95=tuple(map(name_of, known.smallest_set)),
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
    by_these_poses: bool = True  # whether other poses may show it; else a quantity was not logged


def with_a_name(entries: Sequence[Untestable]) -> tuple[discovery.NotTestable, ...]:
    """Return the effects that are no smooth functions, as written to the record."""
    return tuple(
        discovery.NotTestable(id=entry.effect.id, of=entry.effect.of, why=entry.why)
        for entry in entries
        if not entry.effect.generic
    )
