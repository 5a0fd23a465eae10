"""Sets of effects under weights that are not stated, compared by their log evidence.

Springs, bearings, links and the base deflect under the same weights. If these are not stated, one
effect can replace another, and forward selection keeps the one that joined first. So whole sets are
compared, by the log evidence of the amounts of their members and of the weights, which act through
every member. Rows are linear about the model without any compliance. Each member costs the
logarithm of the number of candidates over the error rate. Log evidence is divided by
`PROBABILITIES.blocks`, as for blocks of poses, since poses share errors.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, pairwise

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array, drawn
from pa10cal.calibration.general.problem import loaded_joints
from pa10cal.calibration.rules import SPRINGS
from pa10cal.discovery import jacobians
from pa10cal.discovery.finding import Rival
from pa10cal.discovery.nameless import nameless_effects
from pa10cal.discovery.preparation import MeasurementSetup, computable
from pa10cal.discovery.proof import needed_nats
from pa10cal.discovery.rules import PROBABILITIES, TOGETHER
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import statics_of
from pa10cal.fit.problem import possible_sizes
from pa10cal.fit.uncertain_weights import weight_sizes
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.effect import Effect, is_effect
from pa10cal.terms.effects.joint import JointCompliance
from pa10cal.terms.effects.vocabulary import every_effect, everywhere_but
from pa10cal.terms.joint_spring import JointSpring, is_spring
from pa10cal.terms.model import Model
from pa10cal.terms.term import Term
from pa10cal.terms.weights import holds_weights


@dataclass(frozen=True, eq=False)
class Member:
    """A candidate: a spring, or an effect at one of its shapes."""

    term: Term
    effect: Effect  # the effect by which it is named: of a spring, its compliance
    start: Array  # parameters with an amount of zero, about which it is linearised
    sizes: Array  # (k, q) derivative of its linear parameters by amounts of unit variance

    @property
    def name(self) -> tuple[str, str]:
        """Return id and place; a set has at most one member of each name."""
        return self.effect.id, self.effect.of

    @property
    def gives_way(self) -> bool:
        """Return whether it is a compliance, whose deflection is proportional to the weights."""
        return self.effect.bends or self.effect.yields


@dataclass(frozen=True, eq=False)
class ScoredSet:
    """A set of members with its log evidence."""

    at: tuple[int, ...]  # indices of its members, in rising order
    nats: float  # log evidence less the cost of its members
    amounts: dict[int, Array] = field(repr=False)  # of each member, in units of its sizes
    weights: Array = field(repr=False)  # (w,) deviations of weights, in standard deviations
    possible: bool = True  # whether no amount is negative that physically cannot be


@dataclass(frozen=True, eq=False)
class _BilinearRows:
    """Rows in k amounts of a set's members and w combinations of weights, which multiply."""

    places: dict[int, slice]  # the amounts of each member, by its index
    described: Array  # (r, k) columns of the amounts under the weights as described
    added: Array  # (r, w, k) what each combination of weights adds to them
    data: Array  # (r,)

    def about(self, amounts: Array, weights: Array) -> Gaussian:
        """Return amounts, then weights, by the rows as they are linear about some of them."""
        by_amounts = self.described + np.tensordot(weights, self.added, (0, 1))
        by_weights = self.added @ amounts
        columns = np.concatenate([by_amounts, by_weights], axis=1)
        return Gaussian.of(columns, self.data + by_weights @ weights)


@dataclass(frozen=True, eq=False)
class Together:
    """Candidate members and the rows that judge sets of them, everything else integrated out."""

    members: tuple[Member, ...]
    # (r, k + 1) columns of all members, then the data: the fewest rows with these normal equations
    rows: Array
    # indices of the columns of each member: (1 + w, q) under the weights as described, then of what
    # each combination of weights adds; (1, q) of a member that does not depend on the weights
    columns: tuple[NDArray[np.intp], ...]
    weights: Array  # (w, 4 n + 3) combinations of weights, by columns of `StaticLoads.by_weights`
    member_nats: float  # cost of a member

    @classmethod
    def of(
        cls,
        at: FittedModel,
        poses: Observations,
        whiten: Array,
        context: CandidateContext,
        setup: MeasurementSetup,
        nuisances: Array | None = None,
    ) -> Together:
        """Return the rows of poses about a model that was fitted to them.

        Args:
            at: the extended model.
            poses: the P complete poses of the fit.
            whiten: (P, b, b) that makes their components white.
            context: where effects are possible.
            setup: what the arm carries, and the error rate.
            nuisances: (P, b, k + 1) columns of nuisances that are in no model, and last their sum;
                None for none.
        """
        if len(poses) > TOGETHER.most_poses:
            rows = drawn(len(poses), TOGETHER.most_poses)
            poses, whiten = poses.take(rows), whiten[rows]
            nuisances = None if nuisances is None else nuisances[rows]
        if nuisances is None:
            nuisances = np.zeros((*whiten.shape[:2], 1))
        payload = setup.payload
        assert payload is not None
        members = tuple(_members(context, at, poses))
        bare = _without_any(at)
        sizes = weight_sizes(at.arm, payload).columns(at.arm)
        of_members, mixes = _columns_under(
            _as_described(poses, at, payload), sizes, bare, whiten, members
        )
        own = np.concatenate(
            [_own_columns(bare, poses, whiten, members), whiten @ nuisances[:, :, :-1]], axis=2
        )
        residual = bare.compared(poses).residual + nuisances[:, :, -1]
        data = -(whiten @ residual[:, :, None])[:, :, 0]
        tempered = np.sqrt(PROBABILITIES.blocks)
        every = np.concatenate([own, *chain.from_iterable(of_members)], axis=2)
        equations = Gaussian.of(every / tempered, data / tempered)
        equations = equations.without(np.arange(own.shape[2]))
        weights = np.zeros((len(mixes), len(sizes)))
        weights[:, sizes > 0.0] = mixes * sizes[sizes > 0.0]
        names = {member.name for member in members}
        return cls(
            members,
            _as_rows(equations),
            tuple(_numbered(of_members)),
            weights,
            needed_nats(len(names), setup.options.error_rate),
        )

    def holding(self, terms: Iterable[Term]) -> tuple[int, ...]:
        """Return the indices of the members whose terms a model has, one of each name."""
        there = {(term.id, term.of) for term in terms}
        chosen: dict[tuple[str, str], int] = {}
        for k, member in enumerate(self.members):
            if (member.term.id, member.term.of) in there:
                chosen.setdefault(member.name, k)
        return tuple(sorted(chosen.values()))

    def giving_way(self, at: Iterable[int]) -> tuple[int, ...]:
        """Return the members of a set that are compliances."""
        return tuple(k for k in at if self.members[k].gives_way)

    def likeliest(self, *starts: Sequence[int]) -> ScoredSet:
        """Return the likeliest set that single steps lead to from any of several sets.

        The sets are the starts, the empty one, and each of the likeliest single members: the first
        member decides what the others have left to explain.
        """
        empty = self.scored(())
        alone: dict[tuple[str, str], ScoredSet] = {}
        of_one = [self.scored((k,), empty) for k in range(len(self.members))]
        for scored in sorted(of_one, key=lambda scored: -scored.nats):
            alone.setdefault(self.members[scored.at[0]].name, scored)
        likeliest = [scored.at for scored in list(alone.values())[: TOGETHER.begun_with]]
        ends: dict[tuple[int, ...], ScoredSet] = {}
        found = [self._climbed(self.scored(start), ends) for start in ((), *starts, *likeliest)]
        return max(found, key=lambda scored: scored.nats)

    def scored(self, at: Iterable[int], known: ScoredSet | None = None) -> ScoredSet:
        """Return a set with its log evidence, by Gauss-Newton steps.

        Rows are bilinear in the amounts and the weights. From a known set that differs by a member
        fewer steps are made.
        """
        chosen = tuple(sorted(at))
        rows = self._bilinear_rows(chosen)
        amounts, weights = np.zeros(rows.described.shape[1]), np.zeros(len(self.weights))
        if known is not None:
            weights = known.weights
            for k, place in rows.places.items():
                amounts[place] = known.amounts.get(k, 0.0)
        for _ in range(TOGETHER.steps if known is None else TOGETHER.steps_beside):
            fit, before = rows.about(amounts, weights), amounts
            amounts, weights = np.split(fit.mean, [len(amounts)])
            if np.abs(amounts - before).max(initial=0.0) < TOGETHER.settled:
                break
        of_members = {k: amounts[place] for k, place in rows.places.items()}
        possible = True
        if known is None:
            std = np.sqrt(np.diag(fit.covariance))
            possible = all(
                of_members[k].min() > -TOGETHER.below_zero * std[place.start]
                and of_members[k].max() > 0.0
                for k, place in rows.places.items()
                if self.members[k].effect.limits.positive
            )
        nats = fit.log_evidence - self.member_nats * len(chosen)
        return ScoredSet(chosen, nats, of_members, weights, possible)

    def _bilinear_rows(self, chosen: Sequence[int]) -> _BilinearRows:
        """Return the rows of a set, by the indices of its members."""
        parts = [self.rows[:, self.columns[k]] for k in chosen]  # (r, 1 + w, q) each
        ends = np.cumsum([0, *(part.shape[2] for part in parts)]).tolist()
        places = [slice(*pair) for pair in pairwise(ends)]
        described = np.zeros((len(self.rows), ends[-1]))
        added = np.zeros((len(self.rows), len(self.weights), ends[-1]))
        for part, place in zip(parts, places, strict=True):
            described[:, place] = part[:, 0]
            if part.shape[1] > 1:
                added[:, :, place] = part[:, 1:]
        return _BilinearRows(
            dict(zip(chosen, places, strict=True)), described, added, self.rows[:, -1]
        )

    def springs(self, found: ScoredSet) -> dict[Term, Array]:
        """Return the springs of a set, each with its parameters."""
        members = {k: self.members[k] for k in found.at}
        return {
            member.term: np.maximum(member.sizes @ found.amounts[k], SPRINGS.rigid_rad)
            for k, member in members.items()
            if is_spring(member.term)
        }

    def weights_of(self, found: ScoredSet) -> Array:
        """Return the deviations (4 n + 3,) of the weights from their description by a set."""
        return np.asarray(found.weights @ self.weights)

    def effects(self, found: ScoredSet) -> tuple[Effect, ...]:
        """Return the effects of a set."""
        terms = (self.members[k].term for k in found.at)
        return tuple(term for term in terms if is_effect(term))

    def missed(self, found: ScoredSet) -> frozenset[tuple[str, str]]:
        """Return the names of the members that a set is less likely without."""
        without = {k: self.scored({*found.at} - {k}, found) for k in found.at}
        return frozenset(self.members[k].name for k in found.at if without[k].nats < found.nats)

    def rivals(self, found: ScoredSet) -> dict[tuple[str, str], tuple[Rival, ...]]:
        """Return the rivals of each member of a set, by name.

        A rival in place of a member is scored against the set, or against the set with the rival
        added if that is likelier: an effect that joins the set is no rival of its members. A rival
        that is likelier than the member counts as equally likely.
        """
        rivals: dict[int, dict[Effect, float]] = {k: {} for k in found.at}
        for other in self._names_not_in(found.at):
            effect = self.members[other].effect
            joined = self.scored({*found.at, other}, found)
            if joined.nats > found.nats:
                joined = self.scored(joined.at)
            compared = max(found.nats, joined.nats)
            for k, nats_of in rivals.items():
                instead = self.scored({*found.at, other} - {k}, joined)
                if instead.nats > compared - TOGETHER.near_nats:
                    instead = self.scored(instead.at)
                if instead.possible:
                    nats = min(instead.nats - compared, 0.0)
                    nats_of[effect] = max(nats, nats_of.get(effect, -np.inf))
        return {
            self.members[k].name: tuple(Rival(e, np.array([nats])) for e, nats in nats_of.items())
            for k, nats_of in rivals.items()
        }

    def _climbed(self, found: ScoredSet, ends: dict[tuple[int, ...], ScoredSet]) -> ScoredSet:
        """Return the set at which steps to likelier sets end: a member joins, leaves, is exchanged.

        `ends` maps sets that earlier climbs passed to their ends; those of this climb are added.
        """
        if not found.possible:
            found = replace(found, nats=-np.inf)
        path: list[tuple[int, ...]] = []
        while found.at not in ends:
            path.append(found.at)
            likelier = self._likelier(found)
            if likelier is None:
                ends[found.at] = found
            else:
                found = likelier
        ends |= dict.fromkeys(path, ends[found.at])
        return ends[found.at]

    def _likelier(self, found: ScoredSet) -> ScoredSet | None:
        """Return the first likelier set among the most promising single steps; None for none."""
        steps = [self.scored(at, found) for at in self._steps(found.at)]
        steps.sort(key=lambda step: -step.nats)
        for step in steps[: TOGETHER.looked_at]:
            scored = self.scored(step.at)
            if scored.possible and scored.nats > found.nats + TOGETHER.settled:
                return scored
        return None

    def _steps(self, at: tuple[int, ...]) -> Iterator[set[int]]:
        """Yield the sets that differ by one member that leaves, joins, or is exchanged."""
        there = set(at)
        for k in at:
            yield there - {k}
        for k in self._names_not_in(at):
            yield there | {k}
        for gone in at:
            rest = there - {gone}
            for k in self._names_not_in(sorted(rest)):
                if k != gone:
                    yield rest | {k}

    def _names_not_in(self, at: Sequence[int]) -> Iterator[int]:
        """Yield the members whose names are not in a set."""
        names = {self.members[k].name for k in at}
        yield from (k for k, member in enumerate(self.members) if member.name not in names)


def _members(context: CandidateContext, at: FittedModel, poses: Observations) -> Iterator[Member]:
    """Yield the candidates: springs of loaded joints, and effects that depend on the pose."""
    arm = at.arm
    torque_Nm = poses.states.tau_Nm
    springs = {term.joint: term for term in at.model.terms if is_spring(term)}
    for joint in loaded_joints(arm, torque_Nm, SPRINGS.least_torque_share):
        tau_ref_Nm = float(np.abs(torque_Nm[:, joint - 1]).max())
        new = JointSpring(joint, tau_ref_Nm, cubic=False, plausible_rad=SPRINGS.large_sag_rad)
        spring = springs.get(joint, new)
        size = TOGETHER.sizes * (spring.plausible_rad or SPRINGS.large_sag_rad)
        effect = JointCompliance(spring.of, spring.tau_ref_Nm)
        yield Member(spring, effect, np.zeros(len(spring.parameters)), np.array([[size]]))
    soft = [
        kind
        for kind in every_effect()
        if kind.yields and not kind.generic and kind is not JointCompliance
    ]
    known, _ = computable(
        everywhere_but(soft, context, ()), poses.states, logged=False, weights=True
    )
    others: tuple[Effect, ...] = nameless_effects(context, poses.states, (), logged=False)
    for other in (*others, *known):
        if other.as_scale_of_instrument:
            continue
        sizes = other.prior_factor * (TOGETHER.sizes if other.bends or other.yields else 1.0)
        for start in other.starts:
            yield Member(other, other, start, sizes)


def _as_described(poses: Observations, at: FittedModel, payload: Payload) -> Observations:
    """Return poses with the static loads and torques that the weights as described cause."""
    loads = statics_of(Model(Chain.of(at.arm), ()), np.zeros(0), poses.states, payload)
    return poses.with_states(replace(poses.states, static_loads=loads, tau_Nm=loads.joint_Nm))


def _numbered(of_members: Iterable[Sequence[Array]]) -> Iterator[NDArray[np.intp]]:
    """Yield the places, (1 + w, q) of each member, of columns that stand one after the other."""
    first = 0
    for parts in of_members:
        size = parts[0].shape[2]
        yield first + np.arange(len(parts) * size).reshape(-1, size)
        first += len(parts) * size


def _without_any(at: FittedModel) -> FittedModel:
    """Return a model with springs, effects and weights at zero, on a chain that can bend."""
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
    """Return whitened columns (P, b, k) of a model's other parameters, in their sizes."""
    names = {member.name for member in members}
    terms = bare.model.terms
    others = [t for t in terms if is_effect(t) and (t.id, t.of) not in names]
    own = [t for t in terms if not (is_effect(t) or is_spring(t) or holds_weights(t))]
    of_others = jacobians.by_terms(
        bare, poses, others, [bare.values_of(other) for other in others], whiten
    )
    targets = possible_sizes(bare.model, poses.measured)[len(bare.x) :]
    return np.concatenate(
        [
            *jacobians.by_scaled_terms(bare, poses, own, whiten),
            *(
                columns[:, :, : other.linear] @ other.prior_factor
                for columns, other in zip(of_others, others, strict=True)
            ),
            whiten @ (bare.compared(poses).by_targets * targets),
        ],
        axis=2,
    )


def heavier(poses: Observations, sizes: Array) -> Iterator[Observations]:
    """Yield poses with each weight in turn larger by its size (4 n + 3,), if that is not 0.

    The poses have static loads.
    """
    states, loads = poses.states, poses.states.static_loads
    assert loads is not None
    for amounts in np.diag(sizes)[sizes > 0.0]:
        tau_Nm = states.tau_Nm + loads.by_weights @ amounts
        loaded = replace(states, static_loads=loads.with_weights(amounts), tau_Nm=tau_Nm)
        yield poses.with_states(loaded)


def _columns_under(
    described: Observations,
    sizes: Array,
    bare: FittedModel,
    whiten: Array,
    members: Sequence[Member],
) -> tuple[list[list[Array]], Array]:
    """Return whitened columns of members under weights as described, and by combinations of them.

    Args:
        described: the poses under the weights as described.
        sizes: (4 n + 3,) standard deviation of each weight.

    Returns:
        Of each member its columns (P, b, q) under the described weights, followed by what each
        combination adds if weights act through it; and the combinations (w, k) of k weights.
    """

    def columns(posed: Observations, some: Sequence[Member]) -> list[Array]:
        terms, starts = [member.term for member in some], [member.start for member in some]
        by_terms_of = jacobians.by_terms(bare, posed, terms, starts, whiten)
        return [
            by_term[:, :, : len(member.sizes)] @ member.sizes
            for by_term, member in zip(by_terms_of, some, strict=True)
        ]

    parts = [[under_described] for under_described in columns(described, members)]
    giving_way = [k for k, member in enumerate(members) if member.gives_way]
    added = []
    for each in heavier(described, sizes):
        more = columns(each, [members[k] for k in giving_way])
        added.append([part - parts[k][0] for k, part in zip(giving_way, more, strict=True)])
    mixes = _combinations(added)
    for mix in mixes:
        for k, by_weights in zip(giving_way, zip(*added, strict=True), strict=True):
            parts[k].append(np.tensordot(mix, np.stack(by_weights), (0, 0)))
    return parts, mixes


def _combinations(added: list[list[Array]]) -> Array:
    """Return the combinations (w, k) of k weights that the rows can determine."""
    if not (added and added[0]):
        return np.zeros((0, len(added)))
    flat = np.stack([np.concatenate([part.ravel() for part in parts]) for parts in added], axis=1)
    values, vectors = np.linalg.eigh(flat.T @ flat / PROBABILITIES.blocks)
    return np.asarray(vectors[:, values > TOGETHER.least_squares].T)


def _as_rows(equations: Gaussian) -> Array:
    """Return the fewest rows (r, k + 1) with the same normal equations."""
    values, vectors = np.linalg.eigh(equations.products)
    kept = values > TOGETHER.rounding * values[-1]
    return np.asarray(np.sqrt(values[kept])[:, None] * vectors[:, kept].T)
