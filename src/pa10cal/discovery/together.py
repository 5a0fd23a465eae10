"""Which effects are there, sought together: sets of them, by how likely they make the rows.

Springs, bearings, links and the base give way under the same weights. Where nobody stated these,
one stands in for another, and what joined first is hard to leave again. So sets are compared as
wholes: each by the evidence of its amounts and of the weights, which act through every member
alike, about the model with nothing in it that gives way. A member costs the log of how many may be
there over the error rate. Poses err alike: their evidence counts as that of blocks does.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array, drawn
from pa10cal.calibration.general.problem import loaded_joints
from pa10cal.calibration.rules import SPRINGS
from pa10cal.discovery.evidence.search import threshold
from pa10cal.discovery.finding import Rival
from pa10cal.discovery.linear import by_own_terms, by_targets, by_terms
from pa10cal.discovery.nameless import nameless_effects
from pa10cal.discovery.preparation import MeasurementSetup, computable
from pa10cal.discovery.rules import PROBABILITIES, TOGETHER
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import statics_of, weighed
from pa10cal.fit.problem import possible_sizes
from pa10cal.fit.weighed_arm import weight_sizes
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.effect import (
    CandidateContext,
    Effect,
    every_effect,
    everywhere_but,
    is_effect,
)
from pa10cal.terms.effects.joint import JointCompliance
from pa10cal.terms.joint_spring import JointSpring, is_spring
from pa10cal.terms.model import Model
from pa10cal.terms.term import Term
from pa10cal.terms.weights import holds_weights


@dataclass(frozen=True, eq=False)
class Member:
    """What may be there: a spring, or an effect at one of its shapes."""

    term: Term
    effect: Effect  # as it is named: that of a spring is a compliance
    start: Array  # parameters about which it is linear: no amount
    sizes: Array  # (k, q) its linear parameters for amounts in their plausible sizes

    @property
    def name(self) -> tuple[str, str]:
        """Return what only one of may be there."""
        return self.effect.id, self.effect.of

    @property
    def gives_way(self) -> bool:
        """Whether it follows the weights."""
        return self.effect.bends or self.effect.yields


@dataclass(frozen=True, eq=False)
class Scored:
    """A set, and how likely it is."""

    at: tuple[int, ...]  # which members, rising
    nats: float  # log evidence, less what its members cost
    amounts: dict[int, Array] = field(repr=False)  # of each member, in sizes
    weights: Array = field(repr=False)  # (w,) how far weights are off, in what may be
    possible: bool = True  # whether no amount is below zero that must not be


@dataclass(frozen=True, eq=False)
class Together:
    """Members that may be there, and what rows say of them; all else is integrated out."""

    members: tuple[Member, ...]
    # (r, k + 1) columns of all members, alone and under each weight, and last the data: as many
    # rows as say the same
    rows: Array
    # (1 + w, q) columns of each: as weights are described, then what each weight adds; (1, q) of
    # one that weights do not act through
    columns: tuple[NDArray[np.intp], ...]
    weights: Array  # (w, 4 n + 3) these, as columns of `StaticLoads.by_weights`
    member_nats: float  # what a member costs

    @classmethod
    def of(
        cls,
        at: FittedModel,
        poses: Observations,
        whiten: Array,
        context: CandidateContext,
        setup: MeasurementSetup,
        beside: Array | None = None,
    ) -> Together:
        """Return what poses say of sets, about a model that was fitted to them.

        Args:
            at: the model, with what was found in it.
            poses: the complete poses of the fit, P of them.
            whiten: (P, b, b) by which their components are white.
            context: where effects may sit.
            setup: what the arm carries, and the error rate.
            beside: (P, b, k + 1) columns of what is in no model, and what it comes to; None for
                nothing.
        """
        if len(poses) > TOGETHER.most_poses:
            rows = drawn(len(poses), TOGETHER.most_poses)
            poses, whiten = poses.take(rows), whiten[rows]
            beside = None if beside is None else beside[rows]
        if beside is None:
            beside = np.zeros((*whiten.shape[:2], 1))
        payload = setup.payload
        assert payload is not None
        members = tuple(_members(context, at, poses))
        bare = _without_any(at)
        loads = UnderWeights(at.arm, payload, poses)

        def columns(posed: Observations, some: Sequence[Member]) -> list[Array]:
            terms, starts = [each.term for each in some], [each.start for each in some]
            each = by_terms(bare, posed, terms, starts, whiten)
            return [
                found[:, :, : len(one.sizes)] @ one.sizes
                for found, one in zip(each, some, strict=True)
            ]

        described = columns(loads.described, members)
        way = [k for k, each in enumerate(members) if each.gives_way]
        of_way = [members[k] for k in way]
        every_added = [
            [more - described[k] for k, more in zip(way, columns(each, of_way), strict=True)]
            for _, each in loads.heavier()
        ]
        mixes = _combinations(every_added)
        added = [
            [np.tensordot(mix, np.stack(parts), (0, 0)) for parts in zip(*every_added, strict=True)]
            for mix in mixes
        ]
        own = np.concatenate(
            [_own_columns(bare, poses, whiten, members), whiten @ beside[:, :, :-1]], axis=2
        )
        every, places, first = [own], [], own.shape[2]
        for k, each in enumerate(described):
            parts = [each, *(more[way.index(k)] for more in added if k in way)]
            size = each.shape[2]
            place = first + np.arange(len(parts) * size).reshape(-1, size)
            places.append(place - own.shape[2])
            every += parts
            first += len(parts) * size
        left = bare.compared(poses).residual + beside[:, :, -1]
        data = -(whiten @ left[:, :, None])[:, :, 0]
        tempered = np.sqrt(PROBABILITIES.blocks)
        said = Gaussian.of(np.concatenate(every, axis=2) / tempered, data / tempered)
        said = said.without(np.arange(own.shape[2]))
        names = {each.name for each in members}
        cost = threshold(len(names), setup.options.error_rate)
        sizes = loads.sizes
        weights = np.zeros((len(mixes), len(sizes)))
        weights[:, sizes > 0.0] = mixes * sizes[sizes > 0.0]
        return cls(members, _as_rows(said), tuple(places), weights, cost)

    def holding(self, terms: Iterable[Term]) -> tuple[int, ...]:
        """Return which members stand for terms that a model has."""
        there = {(each.id, each.of) for each in terms}
        chosen: dict[tuple[str, str], int] = {}
        for k, member in enumerate(self.members):
            if (member.term.id, member.term.of) in there:
                chosen.setdefault(member.name, k)
        return tuple(sorted(chosen.values()))

    def giving_way(self, at: Iterable[int]) -> tuple[int, ...]:
        """Return those of a set that follow the weights."""
        return tuple(k for k in at if self.members[k].gives_way)

    def likeliest(self, *starts: Sequence[int]) -> Scored:
        """Return the most likely set that is found by single steps from some sets, or from none.

        And from each of the members that alone make the rows likeliest: the first to join decides
        which others have anything left to do.
        """
        none = self.scored(())
        alone: dict[tuple[str, str], Scored] = {}
        every = (self.scored((k,), none) for k in range(len(self.members)))
        for each in sorted(every, key=lambda each: -each.nats):
            alone.setdefault(self.members[each.at[0]].name, each)
        first = [each.at for each in list(alone.values())[: TOGETHER.begun_with]]
        ends: dict[tuple[int, ...], Scored] = {}
        found = [self._climbed(self.scored(start), ends) for start in ((), *starts, *first)]
        return max(found, key=lambda each: each.nats)

    def scored(self, at: Iterable[int], known: Scored | None = None) -> Scored:
        """Return a set with how likely it is; with a known one next to it, to first order."""
        chosen = tuple(sorted(at))
        weights = np.zeros(len(self.weights)) if known is None else known.weights
        parts = [self.rows[:, self.columns[k]] for k in chosen]  # (r, 1 + w, q) each
        sizes = [part.shape[2] for part in parts]
        described = np.concatenate([np.zeros((len(self.rows), 0)), *(p[:, 0] for p in parts)], 1)
        added = np.zeros((len(self.rows), len(self.weights), sum(sizes)))
        amounts, first = np.zeros(sum(sizes)), 0
        for k, part, size in zip(chosen, parts, sizes, strict=True):
            if part.shape[1] > 1:
                added[:, :, first : first + size] = part[:, 1:]
            if known is not None and k in known.amounts:
                amounts[first : first + size] = known.amounts[k]
            first += size
        steps = TOGETHER.steps if known is None else TOGETHER.steps_beside
        for _ in range(steps):
            by_amounts = described + np.tensordot(weights, added, (0, 1))
            by_weights = added @ amounts
            columns = np.concatenate([by_amounts, by_weights], axis=1)
            said = Gaussian.of(columns, self.rows[:, -1] + by_weights @ weights)
            before, amounts, weights = amounts, *np.split(said.mean, [len(amounts)])
            if np.abs(amounts - before).max(initial=0.0) < TOGETHER.settled:
                break
        ends = np.cumsum([0, *sizes]).tolist()
        each = {k: amounts[slice(*e)] for k, e in zip(chosen, pairwise(ends), strict=True)}
        possible = True
        if known is None:
            std = np.sqrt(np.diag(said.covariance))
            possible = all(
                each[k].min() > -TOGETHER.below_zero * std[first] and each[k].max() > 0.0
                for k, first in zip(chosen, ends, strict=False)
                if self.members[k].effect.positive
            )
        nats = said.log_evidence - self.member_nats * len(chosen)
        return Scored(chosen, nats, each, weights, possible)

    def springs(self, found: Scored) -> dict[Term, Array]:
        """Return the springs of a set, each with its parameters."""
        each = {k: self.members[k] for k in found.at}
        return {
            one.term: np.maximum(one.sizes @ found.amounts[k], SPRINGS.rigid_rad)
            for k, one in each.items()
            if is_spring(one.term)
        }

    def weights_of(self, found: Scored) -> Array:
        """Return by how much each weight is more than described, (4 n + 3,), with a set."""
        return np.asarray(found.weights @ self.weights)

    def effects(self, found: Scored) -> tuple[Effect, ...]:
        """Return the effects of a set."""
        terms = (self.members[k].term for k in found.at)
        return tuple(term for term in terms if is_effect(term))

    def missed(self, found: Scored) -> frozenset[tuple[str, str]]:
        """Return the names of the members without which a set is less likely."""
        without = {k: self.scored({*found.at} - {k}, found) for k in found.at}
        return frozenset(
            self.members[k].name for k, less in without.items() if less.nats < found.nats
        )

    def rivals(self, found: Scored) -> dict[tuple[str, str], tuple[Rival, ...]]:
        """Return what else may stand for each member of a set, by name.

        Scored against the set, or the set with the other beside it where that is likelier: what is
        there on its own account stands for nothing else. One that makes the rows likelier than what
        was found counts as equal.
        """
        every: dict[int, dict[Effect, float]] = {k: {} for k in found.at}
        for other in self._beside(found.at):
            effect = self.members[other].effect
            beside = self.scored({*found.at, other}, found)
            if beside.nats > found.nats:
                beside = self.scored(beside.at)
            least = max(found.nats, beside.nats)
            for k, best in every.items():
                instead = self.scored({*found.at, other} - {k}, beside)
                if instead.nats > least - TOGETHER.near_nats:
                    instead = self.scored(instead.at)
                if instead.possible:
                    nats = min(instead.nats - least, 0.0)
                    best[effect] = max(nats, best.get(effect, -np.inf))
        return {
            self.members[k].name: tuple(Rival(e, np.array([nats])) for e, nats in best.items())
            for k, best in every.items()
        }

    def _climbed(self, found: Scored, ends: dict[tuple[int, ...], Scored]) -> Scored:
        """Return the most likely set that single steps lead to: join, leave, be exchanged.

        Ends are where other sets have led to, and get those on the way here.
        """
        if not found.possible:
            found = replace(found, nats=-np.inf)
        way: list[tuple[int, ...]] = []
        while found.at not in ends:
            way.append(found.at)
            ahead = [self.scored(each, found) for each in self._steps(found.at)]
            ahead.sort(key=lambda each: -each.nats)
            for each in ahead[: TOGETHER.looked_at]:
                surely = self.scored(each.at)
                if surely.possible and surely.nats > found.nats + TOGETHER.settled:
                    found = surely
                    break
            else:
                ends[found.at] = found
        ends |= dict.fromkeys(way, ends[found.at])
        return ends[found.at]

    def _steps(self, at: tuple[int, ...]) -> Iterator[set[int]]:
        there = set(at)
        for k in at:
            yield there - {k}
        for k in self._beside(at):
            yield there | {k}
        for gone in at:
            rest = there - {gone}
            for k in self._beside(sorted(rest)):
                if k != gone:
                    yield rest | {k}

    def _beside(self, at: Sequence[int]) -> Iterator[int]:
        """Yield the members that may join some: of each name but one."""
        names = {self.members[k].name for k in at}
        yield from (k for k, each in enumerate(self.members) if each.name not in names)


def _members(context: CandidateContext, at: FittedModel, poses: Observations) -> Iterator[Member]:
    """Yield what may be there: springs of loaded joints, and what moves the arm with the pose."""
    arm = at.arm
    torque_Nm = poses.states.tau_Nm
    springs = {term.joint: term for term in at.model.terms if is_spring(term)}
    for joint in loaded_joints(arm, torque_Nm, SPRINGS.least_torque_share):
        tau_ref_Nm = float(np.abs(torque_Nm[:, joint - 1]).max())
        usual = JointSpring(joint, tau_ref_Nm, cubic=False, plausible_rad=SPRINGS.large_sag_rad)
        spring = springs.get(joint, usual)
        size = TOGETHER.sizes * (spring.plausible_rad or SPRINGS.large_sag_rad)
        effect = JointCompliance(spring.of, spring.tau_ref_Nm)
        yield Member(spring, effect, np.zeros(len(spring.parameters)), np.array([[size]]))
    every = (kind for kind in every_effect() if kind.yields and not kind.generic)
    soft = [kind for kind in every if kind is not JointCompliance]
    known, _ = computable(
        everywhere_but(soft, context, ()), poses.states, logged=False, weights=True
    )
    others: tuple[Effect, ...] = nameless_effects(context, poses.states, (), logged=False)
    for other in filter(lambda each: each.in_sets, (*others, *known)):
        sizes = other.prior_factor * (TOGETHER.sizes if other.bends or other.yields else 1.0)
        for start in other.starts:
            yield Member(other, other, start, sizes)


def _without_any(at: FittedModel) -> FittedModel:
    """Return a model with its springs, effects and weights at nothing, on a chain that may bend."""
    x, model = at.x.copy(), at.model
    for term in model.terms:
        columns = model.columns_of(term)
        if is_spring(term) or holds_weights(term):
            x[columns] = 0.0
        elif is_effect(term):
            x[columns.start : columns.start + term.linear] = 0.0
    return replace(at, x=x).with_bends(range(1, at.arm.n))


def _own_columns(
    bare: FittedModel, poses: Observations, whiten: Array, members: Sequence[Member]
) -> Array:
    """Return whitened columns (P, b, k) of a model beside the members, each in its size."""
    names = {each.name for each in members}
    terms = bare.model.terms
    others = [t for t in terms if is_effect(t) and (t.id, t.of) not in names]
    own = [t for t in terms if not (is_effect(t) or is_spring(t) or holds_weights(t))]
    of_others = by_terms(bare, poses, others, [bare.values_of(each) for each in others], whiten)
    targets = possible_sizes(bare.model, poses.measured)[len(bare.x) :]
    return np.concatenate(
        [
            *by_own_terms(bare, poses, own, whiten),
            *(
                columns[:, :, : each.linear] @ each.prior_factor
                for columns, each in zip(of_others, others, strict=True)
            ),
            whiten @ (by_targets(bare, poses) * targets),
        ],
        axis=2,
    )


@dataclass(frozen=True, eq=False)
class UnderWeights:
    """Poses under the weights as described, and as each may be."""

    arm: Arm
    payload: Payload
    poses: Observations

    @property
    def described(self) -> Observations:
        """Return the poses under the weights as described."""
        return self._under(self.arm, self.payload)

    @cached_property
    def sizes(self) -> Array:
        """Return by how much each weight may be off, (4 n + 3,)."""
        return weight_sizes(self.arm, self.payload).columns(self.arm)

    def heavier(self) -> Iterator[tuple[int, Observations]]:
        """Yield each weight that is uncertain, and the poses with it off by its size."""
        for column in np.flatnonzero(self.sizes).tolist():
            amounts = np.where(np.arange(len(self.sizes)) == column, self.sizes, 0.0)
            yield column, self._under(*weighed(self.arm, self.payload, amounts))

    def _under(self, arm: Arm, payload: Payload) -> Observations:
        states = self.poses.states
        found = statics_of(Model(Chain.of(arm), ()), np.zeros(0), states, payload)
        return self.poses.with_states(
            replace(states, static_loads=found.static_loads, tau_Nm=found.torque_Nm)
        )


def _combinations(added: list[list[Array]]) -> Array:
    """Return the few combinations (w, k) of k weights that rows could tell from none."""
    if not (added and added[0]):
        return np.zeros((0, len(added)))
    flat = np.stack([np.concatenate([part.ravel() for part in each]) for each in added], axis=1)
    values, vectors = np.linalg.eigh(flat.T @ flat / PROBABILITIES.blocks)
    kept: Array = vectors[:, values > TOGETHER.least_squares].T
    return kept


def _as_rows(said: Gaussian) -> Array:
    """Return the fewest rows (r, k + 1) that say the same."""
    values, vectors = np.linalg.eigh(said.products)
    kept = values > TOGETHER.rounding * values[-1]
    rows: Array = np.sqrt(values[kept])[:, None] * vectors[:, kept].T
    return rows
