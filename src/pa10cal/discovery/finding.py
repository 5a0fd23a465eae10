"""Effects found, with their rivals and probabilities, and effects that data cannot show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Generic, Self

import numpy as np
from scipy.special import softmax
from typing_extensions import TypeVar

from pa10cal.arrays import Array
from pa10cal.discovery.proof import Proof
from pa10cal.discovery.rules import PROBABILITIES
from pa10cal.results import discovery
from pa10cal.results.evaluation import EffectParameter
from pa10cal.results.maps import JointWitness, MapForm
from pa10cal.results.record import EffectName, Name
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import BandPrior, JointErrorMap, is_error_map
from pa10cal.terms.statement_faults import is_fault
from pa10cal.terms.term import Term
from pa10cal.terms.wording import parameters_text


def name_of(effect: Effect) -> EffectName:
    """Return an effect's name and place; effects of one name may differ in form."""
    return EffectName(id=effect.id, of=effect.of)


def _key(effect: Effect) -> Name:
    """Return what identifies an effect among rivals: its name and place, not its form."""
    return Name(effect.id, effect.of)


def label_of(effect: Effect, rival: Effect | None) -> str:
    """Return the names of an effect and of its rival, if there is one."""
    name = f"{effect.id} of {effect.of}"
    return name if rival is None else f"{name} or {rival.id} of {rival.of}"


def line_of(finding: Finding) -> str:
    """Return an effect with its parameters, and what else may be there unless it is surely this."""
    line = f"{label_of(finding.effect, None)}: {parameters_text(finding.parameters)}"
    if finding.probability >= PROBABILITIES.surely:
        return line
    others = [
        f"{label_of(effect, None)} ({probability:.2f})"
        for effect, probability in finding.explanations.named
        if effect != finding.effect and probability >= PROBABILITIES.least
    ]
    if (nameless := finding.explanations.none_of_these) >= PROBABILITIES.least:
        others.append(f"none of these ({nameless:.2f})")
    instead = f"; else {', '.join(others)}" if others else ""  # each of many may be unlikely
    return f"{line}, probability {finding.probability:.2f}{instead}"


def is_named(effect: Effect) -> bool:
    """Return whether an effect states a cause, and not only a place or a fault of the log."""
    return not (effect.generic or effect.id == JointErrorMap.id or is_fault(effect))


@dataclass(frozen=True, eq=False)
class Rival:
    """An effect that may be present in place of one that was found."""

    effect: Effect
    # log score with it less that with the effect found: (B,) of each held-out block of poses, or
    # (1,) of all poses
    nats: Array
    prior_odds: float = 1.0  # relative to the effect found

    def __post_init__(self) -> None:
        # One score that is none would make all probabilities none.
        assert not np.isnan(self.nats).any(), f"no score of {label_of(self.effect, None)}"

    @property
    def log_odds(self) -> float:
        """Return its log odds against the effect found, by the scores of all blocks."""
        return float(self.nats.sum() + np.log(self.prior_odds))

    def by_block(self, blocks: int) -> Array:
        """Return the log score of each block, (B,); one score of all poses is shared equally."""
        if len(self.nats) == 1:
            return np.full(blocks, self.nats[0] / blocks)
        assert len(self.nats) == blocks
        return self.nats


@dataclass(frozen=True)
class Explanations:
    """Explanations of what was found, with probabilities that sum to one."""

    named: tuple[tuple[Effect, float], ...]  # effects with a name, the likeliest first
    none_of_these: float  # probability of something without a name, or that was not tried

    def probability(self, effect: Effect) -> float:
        """Return the probability of an effect; 0 of one that is not among them."""
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
    # effects that explain the data as well in its place, of each name one form
    alternatives: tuple[Effect, ...]
    proof: ProofT
    rivals: tuple[Rival, ...] = ()  # every effect that was tried in its place, with its score
    # the effect whose evidence `proof` is, where this one has taken its place; None for its own
    proof_of: Effect | None = None
    # probability that the cause is one that was not tried
    unknown_probability: float = PROBABILITIES.unknown
    # odds against any other function of its joint's position, where the joint stood at few places
    odds_by_levels: float = np.inf

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

    @cached_property
    def explanations(self) -> Explanations:
        """Return the probabilities of the effect and of its rivals.

        Scores of blocks are averaged by the Bayesian bootstrap (pseudo-BMA+; Yao, Vehtari, Simpson
        and Gelman, Bayesian Analysis 13, 2018).
        """
        candidates, blocks = self._candidates.values(), self._block_count
        nats = np.stack([candidate.by_block(blocks) for candidate in candidates])
        prior_odds = np.array([candidate.prior_odds for candidate in candidates])
        # Each draw is the total score with the blocks weighted anew.
        block_weights = np.random.default_rng(0).dirichlet(np.ones(blocks), PROBABILITIES.draws)
        of_draws = softmax(blocks * block_weights @ nats.T + np.log(prior_odds), axis=1)
        share = of_draws.mean(axis=0) * (1.0 - self.unknown_probability)
        named = {
            candidate.effect: probability
            for candidate, probability in zip(candidates, share.tolist(), strict=True)
            if not candidate.effect.generic
        }
        likeliest_first = sorted(named.items(), key=lambda pair: -pair[1])
        return Explanations(tuple(likeliest_first), max(0.0, 1.0 - sum(named.values())))

    @property
    def probability(self) -> float:
        """Return the probability of the effect."""
        return self.explanations.probability(self.effect)

    @property
    def is_probably_nameless(self) -> bool:
        """Return whether something without a name is likely, and likelier than the effect."""
        least = max(PROBABILITIES.nameless, self.probability)
        return self.explanations.none_of_these > least

    @property
    def _candidates(self) -> dict[Name, Rival]:
        """Return the effect, its alternatives and its rivals by name, with scores against it.

        The effect has a score of zero; another form of it is no rival. An alternative keeps its own
        form, and has the score of the rival of its name: where none was tried, that of the effect.
        A wave of joint 2 with an alternative among the maps of joint 2 thus has that map, with the
        score of the best of all maps that were tried there.
        """
        scores = _best_by_name(self.rivals)
        scores.pop(_key(self.effect), None)
        candidates: dict[Name, Rival] = {}
        for effect in (self.effect, *self.alternatives):
            scored = scores.get(_key(effect), Rival(effect, np.zeros(1)))
            candidates.setdefault(_key(effect), replace(scored, effect=effect))
        return candidates | {name: each for name, each in scores.items() if name not in candidates}

    @property
    def _block_count(self) -> int:
        """Return of how many blocks of poses there are scores; 1 for one score of all poses."""
        return max((len(rival.nats) for rival in self.rivals), default=1)

    def exchanged_for(self, other: Effect) -> Self:
        """Return the finding with a rival in place of its effect, at the same probabilities.

        Parameters, covariance and proof stay those of its effect: `fitted_instead` fits the rival.
        """
        candidates, blocks = self._candidates, self._block_count
        chosen = candidates.pop(_key(other))
        nats = chosen.by_block(blocks)
        rivals = tuple(
            Rival(each.effect, each.by_block(blocks) - nats, each.prior_odds / chosen.prior_odds)
            for each in candidates.values()
        )
        listed = (self.effect, *self.alternatives)
        alternatives = tuple(each for each in listed if _key(each) != _key(other))
        return replace(self, effect=other, rivals=rivals, alternatives=alternatives)

    def with_proof_of(self, former: Finding) -> Self:
        """Return the finding in the place of a former one, whose proof it has and names."""
        proven = former.proof_of or former.effect
        return replace(self, proof_of=None if proven == self.effect else proven)

    def with_likely_alternatives(self) -> Self:
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
        explanations = self.explanations
        alternatives = tuple(
            discovery.Alternative(
                **dict(name_of(effect)), probability=explanations.probability(effect)
            )
            for effect in self.alternatives
        )
        listed = self.probability, *(each.probability for each in alternatives)
        return discovery.FoundEffect(
            id=self.id,
            of=self.of,
            form=form,
            parameters=self.parameters,
            probability=self.probability,
            alternatives=alternatives,
            others=max(0.0, 1.0 - explanations.none_of_these - sum(listed)),
            none_of_these=explanations.none_of_these,
            set95=tuple(map(name_of, explanations.smallest_set)),
            evidence=self.proof.evidence,
            evidence_of=None if self.proof_of is None else name_of(self.proof_of),
            witness=witness,
            weights=self.proof.weights,
            by=self.effect.by_joint,
        )


def _best_by_name(rivals: Sequence[Rival]) -> dict[Name, Rival]:
    """Return of each name the rival with the best score, whatever its form."""
    best: dict[Name, Rival] = {}
    for rival in rivals:
        name = _key(rival.effect)
        if name not in best or rival.log_odds > best[name].log_odds:
            best[name] = rival
    return best


def effect_parameters(term: Term, x: Array, covariance: Array) -> dict[str, EffectParameter]:
    """Return the reported parameters of an effect or a form by name.

    One that its fit left at the end of the range that it was sought in has no uncertainty by the
    fit; it is anywhere in that range.

    Args:
        x: (k,) their values.
        covariance: (k, k) of them.
    """
    reported = term.report(np.zeros(len(term.parameters))).parameters
    std = np.sqrt(np.diag(covariance)).tolist()
    return {
        parameter.name: EffectParameter(
            value=value, std=sigma or _std_in_range(term, parameter.name), unit=parameter.unit
        )
        for parameter, value, sigma in zip(reported, x.tolist(), std, strict=True)
    }


def _std_in_range(term: Term, name: str) -> float:
    """Return the standard deviation of a parameter anywhere in its range; 0 where it has none.

    Solved parameters with a range are reported as they are, under their name without that of the
    effect: `gear_line_2_k` as `k`.
    """
    for solved in term.parameters:
        if solved.lower is None or solved.upper is None:
            continue
        if f"_{solved.name}".endswith(f"_{name}"):
            return 0.5 * (solved.upper - solved.lower) / float(np.sqrt(3))
    return 0.0


@dataclass(frozen=True)
class Untestable:
    """An effect that these data cannot show."""

    effect: Effect  # which, and where
    why: str  # the reason
    by_these_poses: bool = True  # whether other poses may show it; else a quantity was not logged


def smooth_unknown(effect: Effect, left_mm: float, what: str) -> discovery.Unexplained:
    """Return a smooth function as an unexplained part; `what` is what it predicts, in words."""
    why = (
        f"a smooth unknown function ({effect.id}) of {effect.of} predicts {what} better than "
        f"any name{effect.advice}"
    )
    return discovery.Unexplained(of=effect.of, form=effect.id, shared_error_mm=left_mm, why=why)


def not_testable(entries: Sequence[Untestable]) -> tuple[discovery.NotTestable, ...]:
    """Return the effects that have a name, as written to the record."""
    return tuple(
        discovery.NotTestable(id=entry.effect.id, of=entry.effect.of, why=entry.why)
        for entry in entries
        if not entry.effect.generic
    )
