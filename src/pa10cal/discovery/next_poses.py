"""What to measure next: poses that tell rivals apart, or take joints to angles not seen.

An effect and its rival are far apart where one, in the size found, leaves rows that the model's own
parameters and the other together cannot follow; what these cost the other is the difference in log
evidence to be expected. Either of the two may be the truth, so the lesser of both ways counts.

Poses are chosen by how much they are expected to say of which it is (expected information; Lindley,
Annals of Mathematical Statistics 27, 1956): what is settled already asks for none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from scipy.special import entr, expit, logit

from pa10cal.arm import room
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.evidence.problem import (
    EvidenceFit,
    EvidenceProblem,
    NoiseModel,
    noise_models,
)
from pa10cal.discovery.evidence.search import linearise
from pa10cal.discovery.finding import Finding, Untestable
from pa10cal.discovery.linear import ModelWithEffects, by_every_joint
from pa10cal.discovery.noise import Noise, same_circumstances, whitener_of
from pa10cal.discovery.other_numbers import NEXT_POSES
from pa10cal.discovery.preparation import complete, targets_m
from pa10cal.discovery.rules import EVIDENCE
from pa10cal.discovery.verdict import Plan, label_of
from pa10cal.discovery.wander import TimeFindings
from pa10cal.errors import DiscoveryError
from pa10cal.fit.angles_seen import AngleCoverage
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import with_torques
from pa10cal.numerics.exchange import Combined, SeparationCriterion, exchange, greedy_order
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.observe.order import end_travel, move_shares
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
    """How probable an effect found and its rival are, and what more log evidence would say."""

    effect: float
    rival: float

    @property
    def both(self) -> float:
        """Return the probability that it is one of the two."""
        return self.effect + self.rival

    @property
    def probability(self) -> float:
        """Return that of the effect found, between the two."""
        return self.effect / self.both if self.both else 0.5

    @property
    def open_bits(self) -> float:
        """Return what is open between the two."""
        return self.both * float(_entropy_bits(np.array(self.probability)))

    def information_bits(self, nats: Array) -> Array:
        """Return what more log evidence (...) is expected to say of which of the two it is."""
        return np.interp(nats, _GRID_NATS, self._on_grid)

    def expected_probability(self, nats: float) -> float:
        """Return the probability that whichever is the likelier then is expected to have."""
        return float(self._expected(np.array([nats]))[1][0])

    @cached_property
    def _on_grid(self) -> Array:
        left_bits, _ = self._expected(_GRID_NATS)
        # Quadrature may be out by its last digits, information does not fall.
        said = np.maximum.accumulate(left_bits[0] - left_bits)
        return np.asarray(self.both * said)

    def _expected(self, nats: Array) -> tuple[Array, Array]:
        """Return the entropy (N,) expected after so much, and the larger probability of the two.

        The log odds of the truth grow by d on average, with a variance of 2 d (Good, Weighing
        evidence, 1950).
        """
        p = float(np.clip(self.probability, NEXT_POSES.least, 1.0 - NEXT_POSES.least))
        grown = nats[:, None] + np.sqrt(2.0 * nats)[:, None] * _NODES
        truths = ((p, expit(logit(p) + grown)), (1.0 - p, expit(grown - logit(p))))
        weights = _WEIGHTS / _WEIGHTS.sum()
        left_bits = sum(prior * (_entropy_bits(after) @ weights) for prior, after in truths)
        likelier = sum(prior * (np.maximum(q, 1.0 - q) @ weights) for prior, q in truths)
        return np.asarray(left_bits), np.asarray(likelier)


def _entropy_bits(p: Array) -> Array:
    """Return the entropy of what has a probability p (...) or else is not."""
    return np.asarray((entr(p) + entr(1.0 - p)) / np.log(2.0))


#: Pairs, the most open first; None for what the verdict has no probability of.
Rivals = Mapping[Pair, PairProbability | None]


def draw_near(measured: EvidenceProblem | Survey, count: int, random_seed: int) -> Array:
    """Draw joint positions (N, n) where arm and tool may go, near the measured poses.

    Whether links, rods and instrument collide otherwise is not looked at.

    Raises:
        DiscoveryError: when none is found.
    """
    chain = measured.baseline.model.chain
    targets = targets_m(measured.baseline, measured.setup).reshape(-1, 3)
    end = room.PosturePoints.of(chain, measured.cells.states.q_rad, targets).p_base_end
    lowest, highest = end.min(axis=0), end.max(axis=0)
    room_m = np.maximum((highest - lowest) / 2.0, NEXT_POSES.box_margin_m)
    off_axis_m = float(np.hypot(end[:, 0], end[:, 1]).min())
    constraints = {
        "near the measured poses": room.end_within(room.Box(lowest - room_m, highest + room_m)),
        "above the floor": room.above(min(NEXT_POSES.floor_m, float(lowest[2]))),
        "off the column": room.off_column(min(NEXT_POSES.column_m, off_axis_m)),
        "off the links": room.off_links(NEXT_POSES.clearance_m),
    }
    low, high = chain.arm.axis_limits_rad.T
    margin = NEXT_POSES.limit_share * (high - low)
    ranges = low + margin, high - margin
    found = room.draw_within(chain, targets, ranges, constraints, count, random_seed)
    if not len(found.q):
        raise DiscoveryError(
            "no configuration keeps clear of floor, column and limits near the measured positions",
            where="configurations to measure next",
            value=f"none of {found.drawn}",
            allowed="at least one",
            remedy="allow more room",
        )
    return found.q


# Poses that tell rivals apart.


def unresolved(
    effects: Sequence[Finding], not_testable: Sequence[Untestable] = ()
) -> dict[Pair, PairProbability | None]:
    """Return what other poses might settle: effects found against their alternatives, first.

    Of these the most open first. An effect that is not testable has no rival but the model's own
    parameters, and no probability.
    """
    rivals = {
        (found.effect, other): PairProbability(
            found.explanations.of(found.effect), found.explanations.of(other)
        )
        for found in effects
        for other in found.alternatives
    }
    by_openness = sorted(rivals, key=lambda pair: -rivals[pair].open_bits)
    asked: dict[Pair, PairProbability | None] = {pair: rivals[pair] for pair in by_openness}
    for hidden in not_testable:
        if hidden.by_these_poses and not hidden.effect.generic:
            asked[hidden.effect, None] = None
    return dict(list(asked.items())[: NEXT_POSES.most_pairs])


def separating_poses(
    problem: EvidenceProblem,
    found: EvidenceFit,
    asked: Rivals,
    count: int,
    random_seed: int = 0,
    alike: float = 1.0,
) -> Plan:
    """Choose the poses that are expected to say most of which effect of each pair it is.

    Out of a pool drawn at random, in the order in which each pose says most. Pairs that no such
    choice would split are omitted. The fit is the model with what was found; of each pair the first
    is an effect of it, or one that is not testable. Log evidence is divided by a number where poses
    err alike.

    Raises:
        DiscoveryError: when nothing can be predicted, or an effect needs what is not known.
    """
    if not asked:
        return Plan((), ())
    rivals = list(asked)
    hidden = PairProbability(0.5 * NEXT_POSES.hidden, 0.5 * NEXT_POSES.hidden)
    odds = [each or hidden for each in asked.values()]
    pool = _pool(problem, random_seed)
    pairs = _separations(problem, found, rivals, predicted(problem, found, pool))
    every, count = Combined(pairs), min(count, len(pool))
    before = every.values

    def information_bits(nats: Array) -> Array:
        """Return what is expected to be learnt of each pair, by its log evidence (pairs, ...)."""
        added = [
            np.maximum(now - then, 0.0) / alike for now, then in zip(nats, before, strict=True)
        ]
        said = [each.information_bits(more) for each, more in zip(odds, added, strict=True)]
        # What is as good as settled still is the better the further it comes apart.
        return np.asarray(np.array(said) + NEXT_POSES.further_bits * np.log1p(added))

    for pair in pairs:
        greedy_order(pair, count)
    possible = every.values
    sought = np.flatnonzero(possible - before >= NEXT_POSES.apart_nats).tolist()
    order = np.zeros(0, dtype=np.intp)
    if sought:
        said = Combined(pairs, lambda nats: np.asarray(information_bits(nats)[sought].sum(axis=0)))
        chosen = exchange(
            said, greedy_order(said, count), most_sweeps=NEXT_POSES.most_sweeps
        ).chosen
        order = greedy_order(said, count, among=chosen)
    every.restart()
    steps = [every.values]
    for pose in order.tolist():
        every.add(pose)
        steps.append(every.values)
    nats = np.array(steps)  # of each pair before any pose, and after each
    bits = information_bits(nats.T).T
    even_share = (nats[-1] - nats[0]) / max(len(order), 1)
    suggestions, coupling = [], problem.baseline.arm.coupling
    for n, pose in enumerate(order.tolist()):
        last, after, learnt = nats[n], nats[n + 1], bits[n + 1] - bits[n]
        most = max(sought, key=lambda k: learnt[k])
        helped = [k for k in sought if k == most or after[k] - last[k] >= even_share[k]]
        axes_rad = coupling.to_axes(pool.q_rad[pose])
        suggestions.append(
            SuggestedPose(
                q_deg=np.degrees(axes_rad),
                q_rad=axes_rad,
                load_N=float(pool.load_N[pose]),
                arrive_from=-pool.arrival[pose][coupling.own],
                separation_nats=float(after[sought].min()),
                for_=tuple(label_of(*rivals[k]) for k in helped),
            )
        )
    separations = (
        ExpectedSeparation(
            pair=label_of(*pair),
            before_nats=float(before[k]),
            after_nats=float(nats[-1, k]),
            possible_nats=float(max(possible[k], nats[-1, k])),
            can_be_split=k in sought,
            probability=None if known is None else known.probability,
            expected_probability=None
            if known is None
            else known.expected_probability(float(nats[-1, k] - before[k]) / alike),
        )
        for k, (pair, known) in enumerate(asked.items())
    )
    return Plan(tuple(suggestions), tuple(separations))


def _pool(problem: EvidenceProblem, random_seed: int) -> PoseStates:
    """Draw poses that could be measured, with the least load or the largest, from either side.

    A spring that is soft near zero torque shows without load, all else that yields shows with it.
    All are read at the end of the campaign.
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


# How far rivals are apart, by rows of what was measured and of what could be.


def _separations(
    problem: EvidenceProblem, found: EvidenceFit, rivals: Sequence[Pair], ahead: EvidenceProblem
) -> list[Combined]:
    """Return, for every pair, the lesser separation of either effect from the other.

    Rows are those of C measured poses, then of N candidates, b components each, of unit variance.

    Raises:
        DiscoveryError: when an effect needs what is not known of the poses ahead.
    """
    members = (effect for pair in rivals for effect in pair if effect is not None)
    effects = tuple(dict.fromkeys([*found.effects, *members]))
    factors, now = _by_parameters(problem, found, effects)
    # (C + N, b, k) of the model's own parameters and of the errors common to all poses, at the size
    # expected of them, and of each effect
    own, *others = map(
        np.concatenate, zip(now, _by_parameters(ahead, found, effects)[1], strict=True)
    )
    by_effect = dict(zip(effects, others, strict=True))
    granted = {effect: EVIDENCE.sizes[size] for effect, size in found.size_of.items()}
    sized = {  # at the size that is granted to it
        # any size is granted to an effect that is not in the fit
        effect: by_effect[effect] @ factor * granted.get(effect, EVIDENCE.sizes[-1])
        for effect, factor in zip(effects, factors, strict=True)
    }
    as_found = {  # (C + N, b, 1) of each effect of the fit, in its own amount
        effect: by_effect[effect][..., : effect.linear] @ found.of(effect)[: effect.linear, None]
        for effect in found.effects
    }
    measured, components = len(now[0]), len(np.unique(problem.cells.pose)) * own.shape[1]

    def adjustable(truth: Effect, rival: Effect | None) -> Array:
        """Return rows of all that may be adjusted, the rival last."""
        free = [effect for effect in found.effects if effect not in (truth, rival)]
        free += [] if rival is None else [rival]
        return np.concatenate([own, *(sized[effect] for effect in free)], axis=2)

    def if_true(truth: Effect, rival: Effect | None) -> Array:
        """Return the rows (C + N, b, m) of an effect taken for the truth.

        In the amount found; else in that with which it passes for its rival that was found; else in
        what is plausible of each parameter, on average over its shapes.
        """
        if truth in as_found:
            return as_found[truth]
        if rival is None or rival not in as_found:
            return np.asarray(sized[truth] / (EVIDENCE.sizes[-1] * np.sqrt(len(truth.starts))))
        columns = adjustable(rival, truth)[:measured]
        k = columns.shape[2]
        rows = np.concatenate([columns.reshape(-1, k), np.eye(k)])
        target = np.append(as_found[rival][:measured], np.zeros(k))
        passes = np.linalg.lstsq(rows, target, rcond=None)[0][-sized[truth].shape[2] :]
        return np.asarray(sized[truth] @ passes[:, None])

    def separation(truth: Effect, rival: Effect | None) -> SeparationCriterion:
        effect = if_true(truth, rival)
        rows = np.concatenate([adjustable(truth, rival), effect], axis=2)
        k = rows.shape[2]
        known = np.concatenate([rows[:measured].reshape(-1, k), np.eye(k)])
        return SeparationCriterion(rows[measured:], known, effect.shape[2], components)

    return [
        Combined([separation(effect, rival), *([separation(rival, effect)] if rival else [])])
        for effect, rival in rivals
    ]


def _by_parameters(
    problem: EvidenceProblem, found: EvidenceFit, effects: tuple[Effect, ...]
) -> tuple[list[Array], list[Array]]:
    """Return what is expected of effects, and rows of a problem's poses.

    Returns:
        The factors (k', k') of each effect, and rows (C, b, k) of all that is common to the rivals,
        at its size, then of a unit of the parameters of each effect. Errors common to all poses
        have columns of their own: future poses share them.

    Raises:
        DiscoveryError: when an effect needs what is not known of the poses.
    """
    lin, pose = linearise(problem, found, effects), problem.pose

    def scaled(channel: NoiseModel, variance: float, rows: Array) -> Array:
        scaled = rows / np.sqrt(1.0 + variance * channel.shared_size)[:, None]
        return scaled.reshape(len(channel.whitener), -1, rows.shape[1])

    rows = [np.hstack([lin.own, pose.common]), *(block.pose for block in lin.blocks)]
    rows = [scaled(pose, found.pose_variance, part) for part in rows]
    if problem.torque is not None and any(shows_torque(effect) for effect in effects):
        torque = problem.torque
        # Nothing but effects is seen in poses and torques both.
        first, last = rows[0].shape[2], torque.common.shape[1]
        rows[0] = np.pad(rows[0], [(0, 0), (0, 0), (0, last)])
        of_torques = [np.pad(torque.common, [(0, 0), (first, 0)])]
        of_torques += [block.torque for block in lin.blocks]
        rows = [
            np.concatenate([part, scaled(torque, found.torque_variance, more)], axis=1)
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


def predicted(problem: EvidenceProblem, found: EvidenceFit, states: PoseStates) -> EvidenceProblem:
    """Return the problem as it would be of other poses, read as often as the campaign's were.

    A fit to the campaign predicts them; their states have torques nan.

    Raises:
        DiscoveryError: when torques were logged but the weights that make them are not known.
    """
    baseline, setup, readings = problem.baseline, problem.setup, problem.readings
    if setup.payload is None and np.all(np.isfinite(readings.states.tau_Nm)):
        raise DiscoveryError(
            "torques cannot be predicted in configurations that were not measured",
            where=baseline.model.chain.arm.name,
            allowed="an arm and a tool whose masses are known",
            remedy="complete the descriptions of arm and tool",
        )
    repeats = round(len(readings) / (1 + int(same_circumstances(readings).max())))
    states, _ = with_torques(baseline.model, baseline.x, states, setup.payload)
    label = np.array([f"next {k}" for k in range(len(states))])
    poses = Observations.single(label, states, _as_seen(problem, baseline, states))
    poses = replace(poses, readings=np.full(len(states), repeats))
    states = complete(poses, baseline, setup).states
    if problem.torques_logged and states.static_loads is not None:
        tau_Nm = states.static_loads.joint_Nm + found.model.torque_Nm(states, found.at.x)
        states = replace(states, tau_Nm=tau_Nm)
    poses = replace(poses, states=states, measured=_as_seen(problem, found.at, states))
    cov = _reading_cov(problem, poses) / repeats
    torque_u_Nm = None if problem.torque is None else problem.noise.torque_Nm
    load_N = problem.cells.states.load_N
    pose, torque, _ = noise_models(
        poses, cov, baseline, setup, torque_u_Nm, load_N, problem.in_time
    )
    ahead = replace(problem, readings=poses, cells=poses, cell_cov=cov, pose=pose, torque=torque)
    return replace(ahead, torque_without_weights_Nm=np.zeros_like(states.tau_Nm))


def _as_seen(problem: EvidenceProblem, at: FittedModel, states: PoseStates) -> Instrument:
    """Return what the instrument would see of a model.

    What places of stated targets do to it is about the same along the end's own axes: the mean.
    """
    measured = problem.readings.measured
    T_instr_ee = at.T_instr_base @ at.model.predict(states, at.x)
    ideal = measured.ideal(T_instr_ee, at.targets_m)
    if not measured.by_stated_targets.shape[2]:
        return ideal
    before = _axes_of_end(at, problem.readings).transpose(0, 2, 1)
    own = np.mean(before @ measured.by_stated_targets, axis=0)
    stated: dict[str, Any] = {"by_apparatus": ideal.axes_of_end(T_instr_ee) @ own}
    return replace(ideal, **stated)


def _reading_cov(problem: EvidenceProblem, poses: Observations) -> Array:
    """Return the covariance of one reading of poses, (P, b, b), from its sources."""
    readings, noise, at = problem.readings, problem.noise, problem.baseline
    measured = readings.measured
    of_joints, ahead_of_joints = (
        (by_joint * noise.joint_rad**2) @ by_joint.transpose(0, 2, 1)
        for by_joint in (by_every_joint(at, readings), by_every_joint(at, poses))
    )
    stated = noise.instrument**2 * measured.stated_covariance
    # Noise of neither joints nor instrument is equal in all poses and directions.
    rest = np.mean(np.diagonal(noise.cov - of_joints - stated, axis1=1, axis2=2), axis=0)
    for _, columns in measured.component_kinds:
        rest[columns] = np.maximum(rest[columns].mean(), 0.0)
    before, turn = _axes_of_end(at, readings), _axes_of_end(at, poses)
    own = np.mean(before.transpose(0, 2, 1) @ stated @ before, axis=0)
    total: Array = ahead_of_joints + turn @ own @ turn.transpose(0, 2, 1) + np.diag(rest)
    return total


def _axes_of_end(at: FittedModel, poses: Observations) -> Array:
    """Return the end's axes in the components of poses, (P, b, b), where a model has the end."""
    T_instr_ee = at.T_instr_base @ at.model.predict(poses.states, at.x)
    return poses.measured.axes_of_end(T_instr_ee)


def without_repeats(
    survey: Survey, found: ModelWithEffects, noise: Noise
) -> tuple[EvidenceProblem, EvidenceFit]:
    """Return a campaign of many different poses as one with repeats is weighed, and a fit to it.

    What scatters beyond the noise of readings is the error that every pose may have. Of very many
    poses some stand for all.
    """
    count = len(survey.poses)
    rows = np.linspace(0, count - 1, min(count, NEXT_POSES.most_measured)).round().astype(np.intp)
    survey = replace(survey, poses=survey.poses.take(rows), block=survey.block[rows])
    poses = survey.poses
    joint_rad = noise.joint_rad if len(noise.joint_rad) else np.zeros(poses.states.n)
    noise = replace(noise, cov=noise.cov[rows], joint_rad=joint_rad)
    white = whitener_of(noise.cov) @ survey.net_residual(found.at)[:, :, None]
    scatter = float(np.sum(white**2) / poses.measured.components_seen.sum())
    in_time = TimeFindings(survey.wander, has_drift=False)
    cov = noise.cov * len(rows) / count
    setup, load_N = survey.setup, poses.states.load_N
    pose, _, _ = noise_models(poses, cov, survey.baseline, setup, None, load_N, in_time)
    base, context, logged = survey.baseline, survey.context, survey.torques_logged
    none_Nm = np.zeros_like(poses.states.tau_Nm)
    problem = EvidenceProblem(
        base, setup, poses, poses, cov, noise, pose, None, none_Nm, context, logged, in_time
    )
    sizes, variance = ((EVIDENCE.sizes.index(1.0),) * len(found.effects), max(scatter - 1.0, 0.0))
    return problem, EvidenceFit(found.effects, found.at, found.converged, sizes, variance, 0.0)


def poses_at_unseen_angles(
    measured: EvidenceProblem | Survey, seen: AngleCoverage, count: int, random_seed: int = 0
) -> tuple[SuggestedPose, ...]:
    """Choose poses that take joints to angles not seen, the most of them first.

    Out of a pool drawn at random, within limits and near the measured places. An angle once chosen
    counts as seen, so that each pose after the first goes elsewhere. None where all angles within
    reach were seen, or no pose is admissible.
    """
    whole = (  # its turn was seen; prismatic joints do not count
        not turns or (len(stretches) == 1 and np.ptp(stretches[0]) >= 2.0 * np.pi)
        for turns, stretches in zip(seen.turns, seen.intervals, strict=True)
    )
    if not count or all(whole):
        return ()
    try:
        q_rad = draw_near(measured, NEXT_POSES.drawn, random_seed)
    except DiscoveryError:
        return ()
    new = ~seen.each(q_rad) & np.array(seen.turns)
    place = np.floor(np.mod(q_rad, 2.0 * np.pi) / (2.0 * ANGLES.within_rad)).astype(np.intp)
    load_N = float(measured.cells.states.load_N.min())
    coupling = measured.baseline.arm.coupling
    chosen: list[SuggestedPose] = []
    while len(chosen) < count and new.any():
        best = int(np.argmax(new.sum(axis=1)))
        joints = np.flatnonzero(new[best])
        purposes = tuple(f"angle of joint {joint + 1} not seen" for joint in joints)
        axes_rad = coupling.to_axes(q_rad[best])
        q_deg = np.degrees(axes_rad)
        chosen.append(SuggestedPose(q_deg=q_deg, q_rad=axes_rad, load_N=load_N, for_=purposes))
        new[:, joints] &= place[:, joints] != place[best, joints]
    return tuple(chosen)
