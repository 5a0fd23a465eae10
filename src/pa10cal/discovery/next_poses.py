"""What to measure next: poses that separate rival effects, or take joints to angles not visited.

Poses are chosen by the expected information about which of two effects is present (Lindley, Annals
of Mathematical Statistics 27, 1956), which is small for a pair that is nearly decided.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from scipy.special import entr, expit, logit

from pa10cal.arm import workspace
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.evidence.fit import EvidenceFit
from pa10cal.discovery.evidence.problem import EvidenceProblem
from pa10cal.discovery.finding import Finding, Untestable, label_of
from pa10cal.discovery.preparation import targets_m
from pa10cal.discovery.separation import separation_criteria
from pa10cal.discovery.tuning import NEXT_POSES
from pa10cal.discovery.unmeasured_poses import as_if_measured
from pa10cal.discovery.verdict import Plan
from pa10cal.errors import DiscoveryError
from pa10cal.fit.validity import AngleCoverage, span_visited
from pa10cal.numerics.pose_sets import Combined, exchange, greedy_order
from pa10cal.observe.arrivals import end_travel, move_shares
from pa10cal.results.discovery import Separation, SuggestedPose
from pa10cal.rules import ANGLES
from pa10cal.terms.effects.effect import Effect

#: An effect and what may stand in its place: another, or the model's own parameters alone.
Pair = tuple[Effect, Effect | None]
#: Nodes and weights of a standard Gaussian, at which expectations are taken.
_NODES, _WEIGHTS = hermegauss(NEXT_POSES.quadrature)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()
#: Log evidence at which expected information is worked out [nat]; it is interpolated between.
_GRID_NATS = np.append(0.0, np.geomspace(*NEXT_POSES.grid_nats))


@dataclass(frozen=True)
class PairProbability:
    """Probabilities of an effect found and of its rival, and the information in log evidence."""

    effect: float
    rival: float

    @property
    def both(self) -> float:
        """Return the probability that it is one of the two."""
        return self.effect + self.rival

    @property
    def probability(self) -> float:
        """Return the probability of the effect found, given that it is one of the two."""
        return self.effect / self.both if self.both else 0.5

    @property
    def open_bits(self) -> float:
        """Return the entropy of which of the two it is, times the probability of both."""
        return self.both * float(_entropy_bits(np.array(self.probability)))

    def information_bits(self, nats: Array) -> Array:
        """Return the information about which of the two it is, expected of log evidence (...)."""
        return np.interp(nats, _GRID_NATS, self._on_grid)

    def expected_probability(self, nats: float) -> float:
        """Return the probability expected, after so much evidence, of the likelier of the two."""
        truths = self._after(np.array([nats]))
        likelier = [prior * (np.maximum(p, 1.0 - p) @ _WEIGHTS) for prior, p in truths]
        return float(np.sum(likelier))

    @cached_property
    def _on_grid(self) -> Array:
        """Return the information (N,) at the log evidence of the grid."""
        truths = self._after(_GRID_NATS)
        entropy_bits = np.sum([prior * (_entropy_bits(p) @ _WEIGHTS) for prior, p in truths], 0)
        # Information never falls; its quadrature may, in the last digits.
        gained_bits = np.maximum.accumulate(entropy_bits[0] - entropy_bits)
        return np.asarray(self.both * gained_bits)

    def _after(self, nats: Array) -> Iterator[tuple[float, Array]]:
        """Yield for either truth its probability, and that of the effect after log evidence (N,).

        The latter (N, nodes) at the nodes of the quadrature: the log odds of the truth grow by d on
        average, with a variance of 2 d (Good, Weighing evidence, 1950).
        """
        p = float(np.clip(self.probability, NEXT_POSES.least, 1.0 - NEXT_POSES.least))
        grown = nats[:, None] + np.sqrt(2.0 * nats)[:, None] * _NODES
        yield p, expit(logit(p) + grown)
        yield 1.0 - p, expit(logit(p) - grown)


def _entropy_bits(p: Array) -> Array:
    """Return the entropy of an event of probability p (...)."""
    return np.asarray((entr(p) + entr(1.0 - p)) / np.log(2.0))


def draw_near(measured: EvidenceProblem | Survey, count: int, random_seed: int) -> Array:
    """Draw joint positions (N, n) that keep clear of obstacles, near the measured poses.

    Collisions of links with rods or the instrument are not checked.

    Raises:
        DiscoveryError: when none is found.
    """
    chain = measured.baseline.model.chain
    targets = targets_m(measured.baseline, measured.setup).reshape(-1, 3)
    at_poses = workspace.PosturePoints.of(chain, measured.cells.states.q_rad, targets)
    end = at_poses.p_base_end
    lowest, highest = end.min(axis=0), end.max(axis=0)
    room_m = np.maximum((highest - lowest) / 2.0, NEXT_POSES.box_margin_m)
    off_axis_m = float(np.hypot(end[:, 0], end[:, 1]).min())
    off_links_m = float(workspace.clearance_m(at_poses).min()) - NEXT_POSES.same_m
    constraints = {
        "near the measured poses": workspace.end_within(
            workspace.Box(lowest - room_m, highest + room_m)
        ),
        "above the floor": workspace.above(min(NEXT_POSES.floor_m, float(lowest[2]))),
        "off the column": workspace.off_column(min(NEXT_POSES.column_m, off_axis_m)),
        "off the links": workspace.off_links(min(NEXT_POSES.clearance_m, off_links_m)),
    }
    low, high = chain.arm.axis_limits_rad.T
    margin = NEXT_POSES.limit_share * (high - low)
    ranges = low + margin, high - margin
    found = workspace.draw_within(chain, targets, ranges, constraints, count, random_seed)
    if not len(found.q):
        raise DiscoveryError(
            "no configuration keeps clear of floor, column and limits near the measured positions",
            where="configurations to measure next",
            value=f"none of {found.drawn}",
            allowed="at least one",
            remedy="allow more room",
        )
    return found.q


def unresolved_pairs(
    effects: Sequence[Finding], not_testable: Sequence[Untestable] = ()
) -> dict[Pair, PairProbability | None]:
    """Return the pairs that other poses may separate, those with the largest entropy first.

    Effects found are paired with their alternatives. Effects that are not testable follow, without
    a probability: their only rivals are the model's own parameters.
    """
    found = {
        (finding.effect, other): PairProbability(
            finding.probability, finding.explanations.probability(other)
        )
        for finding in effects
        for other in finding.alternatives
    }
    by_openness = sorted(found, key=lambda pair: -found[pair].open_bits)
    pairs: dict[Pair, PairProbability | None] = {pair: found[pair] for pair in by_openness}
    for hidden in not_testable:
        if hidden.by_these_poses and not hidden.effect.generic:
            pairs[hidden.effect, None] = None
    return dict(list(pairs.items())[: NEXT_POSES.most_pairs])


def separating_poses(
    problem: EvidenceProblem,
    found: EvidenceFit,
    asked: Mapping[Pair, PairProbability | None],
    count: int,
    random_seed: int = 0,
    divisor: float = 1.0,
) -> Plan:
    """Choose the poses that are expected to give most information about which effect is true.

    They are chosen from a random pool, in the order of the information that each adds. Pairs that
    no choice would separate do not count.

    Args:
        problem: the campaign.
        found: the fit of the model with what was found.
        asked: pairs of effects with their probabilities, None where these are not known; the first
            of each pair is an effect of the fit, or not testable.
        count: number of poses; of 0 nothing is said of what poses would tell.
        random_seed: of the pool.
        divisor: factor by which log evidence is divided where poses share errors.

    Raises:
        DiscoveryError: when torques of other poses cannot be predicted, or no pose is admissible.
    """
    if not asked or not count:
        return Plan((), ())
    pool = _pool(problem, random_seed)
    count = min(count, len(pool))
    candidates = as_if_measured(problem, found, pool)
    criteria = separation_criteria(problem, found, list(asked), candidates)
    before_nats = Combined(criteria).values  # of each pair, by the measured poses
    hidden = PairProbability(0.5 * NEXT_POSES.hidden, 0.5 * NEXT_POSES.hidden)
    odds = tuple(known or hidden for known in asked.values())
    information = _ExpectedInformation(odds, before_nats, divisor)
    possible_nats = np.array([_best_value(criterion, count) for criterion in criteria])
    separable = np.flatnonzero(possible_nats - before_nats >= NEXT_POSES.apart_nats).tolist()
    order = _most_informative(criteria, information, separable, count) if separable else []
    nats = _nats_along(criteria, order)
    labels = [label_of(*pair) for pair in asked]
    poses = []
    for n, pose in enumerate(order):
        purposes = tuple(labels[k] for k in information.separated_by(n, nats, separable))
        after_nats = float(nats[n + 1][separable].min())
        poses.append(_suggested(problem, pool, pose, after_nats, purposes))
    separations = (
        Separation(
            pair=labels[k],
            before_nats=float(before_nats[k]),
            after_nats=float(nats[-1, k]),
            possible_nats=float(max(possible_nats[k], nats[-1, k])),
            can_be_split=k in separable,
            probability=None if known is None else known.probability,
            expected_probability=None
            if known is None
            else known.expected_probability(float(nats[-1, k] - before_nats[k]) / divisor),
        )
        for k, known in enumerate(asked.values())
    )
    return Plan(tuple(poses), tuple(separations))


@dataclass(frozen=True, eq=False)
class _ExpectedInformation:
    """Information that further poses are expected to give about each of several pairs."""

    odds: Sequence[PairProbability]
    before_nats: Array  # (pairs,) separation by the measured poses
    divisor: float  # of log evidence, where poses share errors

    def bits(self, nats: Array) -> Array:
        """Return the information about each pair, (pairs, ...), by its separation (pairs, ...)."""
        pairs = zip(self.odds, nats, self.before_nats, strict=True)
        every = []
        for pair, now_nats, before_nats in pairs:
            added_nats = np.maximum(now_nats - before_nats, 0.0) / self.divisor
            # A pair that is nearly settled is still better the further it is separated.
            further = NEXT_POSES.further_bits * np.log1p(added_nats)
            every.append(pair.information_bits(added_nats) + further)
        return np.array(every)

    def separated_by(self, n: int, nats: Array, separable: Sequence[int]) -> list[int]:
        """Return which of the separable pairs the n-th of several poses separates.

        The pair about which it informs most, and those to whose separation it adds at least as much
        as the mean pose. The separations (poses + 1, pairs) are before any pose and after each.
        """
        even_share = (nats[-1] - nats[0]) / (len(nats) - 1)
        learnt = self.bits(nats[n + 1]) - self.bits(nats[n])
        added = nats[n + 1] - nats[n]
        most = max(separable, key=lambda k: learnt[k])
        return [k for k in separable if k == most or added[k] >= even_share[k]]


def _best_value(criterion: Combined, count: int) -> float:
    """Return the value of a criterion for the poses that are chosen for it alone."""
    greedy_order(criterion, count)
    return criterion.value


def _most_informative(
    criteria: Sequence[Combined],
    information: _ExpectedInformation,
    separable: Sequence[int],
    count: int,
) -> list[int]:
    """Return the poses of most information about the separable pairs, in the order of its gain."""

    def total(nats: Array) -> Array:
        return np.asarray(information.bits(nats)[separable].sum(axis=0))

    criterion = Combined(criteria, total)
    start = greedy_order(criterion, count)
    chosen = exchange(criterion, start, most_sweeps=NEXT_POSES.most_sweeps).chosen
    order: list[int] = greedy_order(criterion, count, among=chosen).tolist()
    return order


def _nats_along(criteria: Sequence[Combined], order: Sequence[int]) -> Array:
    """Return the separation of each pair before any pose and after each, (poses + 1, pairs)."""
    every = Combined(criteria)
    every.restart()
    steps = [every.values]
    for pose in order:
        every.add(pose)
        steps.append(every.values)
    return np.array(steps)


def _suggested(
    problem: EvidenceProblem, pool: PoseStates, pose: int, nats: float, purposes: tuple[str, ...]
) -> SuggestedPose:
    """Return a pose of the pool as it is written, with the least separation after it."""
    arm = problem.baseline.arm
    axes_rad = arm.coupling.to_axes(pool.q_rad[pose])
    return SuggestedPose(
        q_deg=np.where(arm.axes_slide, 1e3 * axes_rad, np.degrees(axes_rad)),
        q_rad=axes_rad,
        load_N=float(pool.load_N[pose]),
        arrive_from=-pool.arrival[pose][arm.coupling.own],
        separation_nats=nats,
        for_=purposes,
    )


def _pool(problem: EvidenceProblem, random_seed: int) -> PoseStates:
    """Draw poses that could be measured, with the least load or the largest, from either side.

    A spring that is soft near zero torque shows without load, other compliances with the largest.
    All poses are read at the end of the campaign.
    """
    q_rad = draw_near(problem, NEXT_POSES.pool, random_seed)
    rng, measured = np.random.default_rng(random_seed), problem.readings.states
    count, last = len(q_rad), int(np.argmax(measured.time_s))
    loads_N = np.array([measured.load_N.min(), measured.load_N.max()])
    share = move_shares(np.diff(q_rad, axis=0, prepend=q_rad[-1:]))
    return PoseStates(
        q_rad=q_rad,
        tau_Nm=np.full(q_rad.shape, np.nan),
        arrival=rng.choice(np.array([-1.0, 1.0]), q_rad.shape),
        load_N=rng.choice(loads_N, count),
        temperature_C=np.full(count, measured.temperature_C[last]),
        time_s=np.full(count, measured.time_s[last]),
        move_share=share,
        move_end_m=end_travel(problem.context.arm, q_rad, share),
    )


def poses_at_unseen_angles(
    measured: EvidenceProblem | Survey, seen: AngleCoverage, count: int, random_seed: int = 0
) -> tuple[SuggestedPose, ...]:
    """Choose poses that take joints to angles seldom or never seen, most such joints first.

    They are chosen from a random pool, within limits and near the measured places. An angle once
    chosen counts as seen. None where all angles within reach were seen, or no pose is admissible.
    An angle between others that were measured is told as one near which there are few poses.
    """
    all_around = (  # prismatic joints do not count
        not turns or (len(stretches) == 1 and np.ptp(stretches[0]) >= 2.0 * np.pi)
        for turns, stretches in zip(seen.turns, seen.intervals, strict=True)
    )
    if not count or all(all_around):
        return ()
    try:
        q_rad = draw_near(measured, NEXT_POSES.drawn, random_seed)
    except DiscoveryError:
        return ()
    unseen = ~seen.covers(q_rad) & np.array(seen.turns)
    cell = np.floor(np.mod(q_rad, 2.0 * np.pi) / (2.0 * ANGLES.within_rad)).astype(np.intp)
    between = span_visited(measured.cells.states.q_rad).covers(q_rad)
    load_N = float(measured.cells.states.load_N.min())
    arm = measured.baseline.arm
    chosen: list[SuggestedPose] = []
    while len(chosen) < count and unseen.any():
        best = int(np.argmax(unseen.sum(axis=1)))
        joints = np.flatnonzero(unseen[best])
        purposes = tuple(
            f"few poses near the angle of joint {joint + 1}"
            if between[best, joint]
            else f"angle of joint {joint + 1} not seen"
            for joint in joints
        )
        axes_rad = arm.coupling.to_axes(q_rad[best])
        q_deg = np.where(arm.axes_slide, 1e3 * axes_rad, np.degrees(axes_rad))
        chosen.append(SuggestedPose(q_deg=q_deg, q_rad=axes_rad, load_N=load_N, for_=purposes))
        unseen[:, joints] &= cell[:, joints] != cell[best, joints]
    return tuple(chosen)
