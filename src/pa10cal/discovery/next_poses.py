"""What to measure next: poses that separate rival effects, or take joints to angles not visited.

The separation of an effect from its rival is the expected difference of their log evidence if the
effect is present in the size found: the squares of its signal that the rival and the model's own
parameters cannot follow. Either may be present, so the smaller of both separations counts.

Poses are chosen by the expected information about which of the two is present (Lindley, Annals of
Mathematical Statistics 27, 1956), which is small for a pair that is nearly decided.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from scipy.special import entr, expit, logit

from pa10cal.arm import workspace
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.evidence.candidates import linearise
from pa10cal.discovery.evidence.fit import EvidenceFit
from pa10cal.discovery.evidence.noise_model import NoiseModel
from pa10cal.discovery.evidence.problem import EvidenceProblem
from pa10cal.discovery.finding import Finding, Untestable
from pa10cal.discovery.other_numbers import NEXT_POSES
from pa10cal.discovery.predicted_rows import predicted
from pa10cal.discovery.preparation import targets_m
from pa10cal.discovery.rules import EVIDENCE
from pa10cal.discovery.verdict import Plan, label_of
from pa10cal.errors import DiscoveryError
from pa10cal.fit.validity import AngleCoverage
from pa10cal.numerics.pose_sets import Combined, SeparationCriterion, exchange, greedy_order
from pa10cal.observe.arrivals import end_travel, move_shares
from pa10cal.results.discovery import Separation as ExpectedSeparation
from pa10cal.results.discovery import SuggestedPose
from pa10cal.rules import ANGLES
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.term import shows_torque

#: An effect and what may stand in its place: another, or the model's own parameters alone.
Pair = tuple[Effect, Effect | None]
#: Nodes and weights of a standard Gaussian, at which expectations are taken.
_NODES, _WEIGHTS = hermegauss(NEXT_POSES.quadrature)
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
        return float(self._expected(np.array([nats]))[1][0])

    @cached_property
    def _on_grid(self) -> Array:
        entropy_bits, _ = self._expected(_GRID_NATS)
        # Information never falls; its quadrature may, in the last digits.
        gained_bits = np.maximum.accumulate(entropy_bits[0] - entropy_bits)
        return np.asarray(self.both * gained_bits)

    def _expected(self, nats: Array) -> tuple[Array, Array]:
        """Return the entropy (N,) expected after log evidence (N,), and the larger probability.

        The log odds of the truth grow by d on average, with a variance of 2 d (Good, Weighing
        evidence, 1950).
        """
        p = float(np.clip(self.probability, NEXT_POSES.least, 1.0 - NEXT_POSES.least))
        grown = nats[:, None] + np.sqrt(2.0 * nats)[:, None] * _NODES
        truths = ((p, expit(logit(p) + grown)), (1.0 - p, expit(grown - logit(p))))
        weights = _WEIGHTS / _WEIGHTS.sum()
        entropy_bits = sum(prior * (_entropy_bits(after) @ weights) for prior, after in truths)
        likelier = sum(prior * (np.maximum(q, 1.0 - q) @ weights) for prior, q in truths)
        return np.asarray(entropy_bits), np.asarray(likelier)


def _entropy_bits(p: Array) -> Array:
    """Return the entropy of an event of probability p (...)."""
    return np.asarray((entr(p) + entr(1.0 - p)) / np.log(2.0))


#: Pairs, the most open first; None for what the verdict has no probability of.
Rivals = Mapping[Pair, PairProbability | None]


def draw_near(measured: EvidenceProblem | Survey, count: int, random_seed: int) -> Array:
    """Draw joint positions (N, n) that keep clear of obstacles, near the measured poses.

    Collisions of links with rods or the instrument are not checked.

    Raises:
        DiscoveryError: when none is found.
    """
    chain = measured.baseline.model.chain
    targets = targets_m(measured.baseline, measured.setup).reshape(-1, 3)
    end = workspace.PosturePoints.of(chain, measured.cells.states.q_rad, targets).p_base_end
    lowest, highest = end.min(axis=0), end.max(axis=0)
    room_m = np.maximum((highest - lowest) / 2.0, NEXT_POSES.box_margin_m)
    off_axis_m = float(np.hypot(end[:, 0], end[:, 1]).min())
    constraints = {
        "near the measured poses": workspace.end_within(
            workspace.Box(lowest - room_m, highest + room_m)
        ),
        "above the floor": workspace.above(min(NEXT_POSES.floor_m, float(lowest[2]))),
        "off the column": workspace.off_column(min(NEXT_POSES.column_m, off_axis_m)),
        "off the links": workspace.off_links(NEXT_POSES.clearance_m),
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


def unresolved(
    effects: Sequence[Finding], not_testable: Sequence[Untestable] = ()
) -> dict[Pair, PairProbability | None]:
    """Return the pairs that other poses may separate, those with the largest entropy first.

    Effects found are paired with their alternatives. Effects that are not testable follow, without
    a probability: their only rivals are the model's own parameters.
    """
    found = {
        (finding.effect, other): PairProbability(
            finding.explanations.of(finding.effect), finding.explanations.of(other)
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
    asked: Rivals,
    count: int,
    random_seed: int = 0,
    alike: float = 1.0,
) -> Plan:
    """Choose the poses that are expected to give most information about which effect is true.

    They are chosen from a random pool, in the order of the information that each adds. Pairs that
    no choice would separate do not count.

    Args:
        problem: the campaign.
        found: the fit of the model with what was found.
        asked: pairs of effects; the first of each is an effect of the fit, or not testable.
        count: number of poses.
        random_seed: of the pool.
        alike: factor by which log evidence is divided where poses share errors.

    Raises:
        DiscoveryError: when nothing can be predicted, or an effect needs what is not known.
    """
    if not asked:
        return Plan((), ())
    labels = [label_of(*pair) for pair in asked]
    hidden = PairProbability(0.5 * NEXT_POSES.hidden, 0.5 * NEXT_POSES.hidden)
    odds = [known or hidden for known in asked.values()]
    pool = _pool(problem, random_seed)
    pairs = _separations(problem, found, list(asked), predicted(problem, found, pool))
    every, count = Combined(pairs), min(count, len(pool))
    before = every.values  # of each pair, by the measured poses

    def information_bits(nats: Array) -> Array:
        """Return the information expected of each pair by its log evidence, (pairs, ...)."""
        added = np.array(
            [np.maximum(now - then, 0.0) / alike for now, then in zip(nats, before, strict=True)]
        )
        bits = [pair.information_bits(more) for pair, more in zip(odds, added, strict=True)]
        # A pair that is nearly settled is still better the further it is separated.
        return np.asarray(np.array(bits) + NEXT_POSES.further_bits * np.log1p(added))

    for pair in pairs:
        greedy_order(pair, count)
    possible = every.values
    sought = np.flatnonzero(possible - before >= NEXT_POSES.apart_nats).tolist()
    order: list[int] = []
    if sought:
        total = Combined(pairs, lambda nats: np.asarray(information_bits(nats)[sought].sum(axis=0)))
        start = greedy_order(total, count)
        chosen = exchange(total, start, most_sweeps=NEXT_POSES.most_sweeps).chosen
        order = greedy_order(total, count, among=chosen).tolist()
    every.restart()
    steps = [every.values]
    for pose in order:
        every.add(pose)
        steps.append(every.values)
    nats = np.array(steps)  # (poses + 1, pairs) before any pose, and after each
    bits = information_bits(nats.T).T
    poses = []
    for n, pose in enumerate(order):
        helped = _separated_by(n, nats, bits, sought)
        purposes = tuple(labels[k] for k in helped)
        after_nats = float(nats[n + 1][sought].min())
        poses.append(_suggested(problem, pool, pose, after_nats, purposes))
    separations = (
        ExpectedSeparation(
            pair=labels[k],
            before_nats=float(before[k]),
            after_nats=float(nats[-1, k]),
            possible_nats=float(max(possible[k], nats[-1, k])),
            can_be_split=k in sought,
            probability=None if known is None else known.probability,
            expected_probability=None
            if known is None
            else known.expected_probability(float(nats[-1, k] - before[k]) / alike),
        )
        for k, known in enumerate(asked.values())
    )
    return Plan(tuple(poses), tuple(separations))


def _separated_by(n: int, nats: Array, bits: Array, sought: Sequence[int]) -> list[int]:
    """Return the pairs that the n-th pose separates.

    The pair about which it informs most, and those to whose log evidence it adds at least as much
    as the mean pose. Log evidence and information (poses + 1, pairs) are before any pose and after
    each.
    """
    even_share = (nats[-1] - nats[0]) / (len(nats) - 1)
    learnt, added = bits[n + 1] - bits[n], nats[n + 1] - nats[n]
    most = max(sought, key=lambda k: learnt[k])
    return [k for k in sought if k == most or added[k] >= even_share[k]]


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


def _separations(
    problem: EvidenceProblem, found: EvidenceFit, rivals: Sequence[Pair], ahead: EvidenceProblem
) -> list[Combined]:
    """Return, for every pair, the lesser separation of either effect from the other.

    Rows are of C measured poses, then of N candidates, with b components of unit variance each.

    Raises:
        DiscoveryError: when an effect needs what is not known of the poses ahead.
    """
    members = (effect for pair in rivals for effect in pair if effect is not None)
    effects = tuple(dict.fromkeys([*found.effects, *members]))
    factors, now = _by_parameters(problem, found, effects)
    _, then = _by_parameters(ahead, found, effects)
    # (C + N, b, k) of the model's own parameters and of the errors common to all poses, scaled to
    # their expected sizes, and of each effect
    own, *of_effects = map(np.concatenate, zip(now, then, strict=True))
    by_effect = dict(zip(effects, of_effects, strict=True))
    size_of = {effect: EVIDENCE.sizes[size] for effect, size in found.size_of.items()}
    sized = {  # scaled to the size of each; the largest for an effect that is not in the fit
        effect: by_effect[effect] @ factor * size_of.get(effect, EVIDENCE.sizes[-1])
        for effect, factor in zip(effects, factors, strict=True)
    }
    as_found = {  # (C + N, b, 1) of each effect of the fit, in the amount found
        effect: by_effect[effect][..., : effect.linear] @ found.of(effect)[: effect.linear, None]
        for effect in found.effects
    }
    measured, components = len(now[0]), len(np.unique(problem.cells.pose)) * own.shape[1]

    def adjustable(truth: Effect, rival: Effect | None) -> Array:
        """Return columns of all that may be adjusted if an effect is true, the rival last."""
        free = [effect for effect in found.effects if effect not in (truth, rival)]
        free += [] if rival is None else [rival]
        return np.concatenate([own, *(sized[effect] for effect in free)], axis=2)

    def if_true(truth: Effect, rival: Effect | None) -> Array:
        """Return the signal (C + N, b, m) of an effect if it is true.

        It has the amount found; or else the amount with which it best imitates its rival that was
        found; or else plausible amounts of each parameter, on average over its shapes.
        """
        if truth in as_found:
            return as_found[truth]
        if rival is None or rival not in as_found:
            return np.asarray(sized[truth] / (EVIDENCE.sizes[-1] * np.sqrt(len(truth.starts))))
        columns = adjustable(rival, truth)[:measured]
        k = columns.shape[2]
        rows = np.concatenate([columns.reshape(-1, k), np.eye(k)])
        target = np.append(as_found[rival][:measured], np.zeros(k))
        imitating = np.linalg.lstsq(rows, target, rcond=None)[0][-sized[truth].shape[2] :]
        return np.asarray(sized[truth] @ imitating[:, None])

    def separation(truth: Effect, rival: Effect | None) -> SeparationCriterion:
        """Return the squares of a true effect that all that may be adjusted leaves."""
        effect = if_true(truth, rival)
        rows = np.concatenate([adjustable(truth, rival), effect], axis=2)
        k = rows.shape[2]
        known = np.concatenate([rows[:measured].reshape(-1, k), np.eye(k)])
        return SeparationCriterion(rows[measured:], known, effect.shape[2], components)

    combined = []
    for effect, rival in rivals:
        both_ways = [separation(effect, rival)]
        if rival is not None:
            both_ways.append(separation(rival, effect))
        combined.append(Combined(both_ways))
    return combined


def _by_parameters(
    problem: EvidenceProblem, found: EvidenceFit, effects: tuple[Effect, ...]
) -> tuple[list[Array], list[Array]]:
    """Return the columns of effects at a problem's poses, and the factors of their priors.

    Returns:
        The factor (k', k') of each effect's prior; and columns (C, b, k), first of all that is
        common to the rivals, scaled to its size, then of the parameters of each effect. Errors
        common to all poses have columns of their own, which future poses share.

    Raises:
        DiscoveryError: when an effect needs what is not known of the poses.
    """
    lin, pose = linearise(problem, found, effects), problem.pose

    def scaled(channel: NoiseModel, variance: float, rows: Array) -> Array:
        """Return rows divided by their noise with the error that all readings of a pose share."""
        divided = rows / np.sqrt(1.0 + variance * channel.shared_size)[:, None]
        return divided.reshape(len(channel.whitener), -1, rows.shape[1])

    rows = [np.hstack([lin.own, pose.common]), *(block.pose for block in lin.blocks)]
    rows = [scaled(pose, found.variances.pose, part) for part in rows]
    if problem.torque is not None and any(shows_torque(effect) for effect in effects):
        torque = problem.torque
        # Effects alone show in poses and torques both: all other columns are zero in one of them.
        of_poses, of_torque = rows[0].shape[2], torque.common.shape[1]
        rows[0] = np.pad(rows[0], [(0, 0), (0, 0), (0, of_torque)])
        of_torques = [np.pad(torque.common, [(0, 0), (of_poses, 0)])]
        of_torques += [block.torque for block in lin.blocks]
        rows = [
            np.concatenate([part, scaled(torque, found.variances.torque, more)], axis=1)
            for part, more in zip(rows, of_torques, strict=True)
        ]
    for effect, part in zip(effects, rows[1:], strict=True):
        if not np.all(np.isfinite(part)):
            raise DiscoveryError(
                "the effect depends on a quantity that is unknown for future poses",
                where=f"{effect.id} of {effect.of}",
                allowed="effects of logged quantities",
                remedy="omit the effect",
            )
    return [block.factor for block in lin.blocks], rows


def poses_at_unseen_angles(
    measured: EvidenceProblem | Survey, seen: AngleCoverage, count: int, random_seed: int = 0
) -> tuple[SuggestedPose, ...]:
    """Choose poses that take joints to angles not seen, the one with most such joints first.

    They are chosen from a random pool, within limits and near the measured places. An angle once
    chosen counts as seen. None where all angles within reach were seen, or no pose is admissible.
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
    load_N = float(measured.cells.states.load_N.min())
    arm = measured.baseline.arm
    chosen: list[SuggestedPose] = []
    while len(chosen) < count and unseen.any():
        best = int(np.argmax(unseen.sum(axis=1)))
        joints = np.flatnonzero(unseen[best])
        purposes = tuple(f"angle of joint {joint + 1} not seen" for joint in joints)
        axes_rad = arm.coupling.to_axes(q_rad[best])
        q_deg = np.where(arm.axes_slide, 1e3 * axes_rad, np.degrees(axes_rad))
        chosen.append(SuggestedPose(q_deg=q_deg, q_rad=axes_rad, load_N=load_N, for_=purposes))
        unseen[:, joints] &= cell[:, joints] != cell[best, joints]
    return tuple(chosen)
