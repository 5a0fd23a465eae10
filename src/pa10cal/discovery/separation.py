"""How far poses that were not measured would separate effects: their rows, and a criterion.

The separation of an effect from its rival is the expected difference of their log evidence if the
effect is present in the size found: D / 2 log(1 + S / D), where S is the sum of squares of its
signal that the rival and the model's own parameters cannot follow, and D the number of measured
components (`SeparationCriterion`). Either may be present, so the smaller of both counts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.evidence.candidates import linearise
from pa10cal.discovery.evidence.fit import EvidenceFit
from pa10cal.discovery.evidence.noise_model import NoiseModel, SharedVariances
from pa10cal.discovery.evidence.problem import EvidenceProblem, pose_noise_model, torque_noise_model
from pa10cal.discovery.model_with_effects import ModelWithEffects
from pa10cal.discovery.noise import Noise
from pa10cal.discovery.nuisances import TimeFindings
from pa10cal.discovery.preparation import complete
from pa10cal.discovery.repeats import same_circumstances
from pa10cal.discovery.rules import EVIDENCE
from pa10cal.discovery.tuning import NEXT_POSES
from pa10cal.errors import DiscoveryError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.joint_noise import ideal_by_joints
from pa10cal.fit.loads import statics_of, with_torques
from pa10cal.numerics.covariances import whitener_of
from pa10cal.numerics.pose_sets import Combined, SeparationCriterion
from pa10cal.observe.instrument import Instrument, group_means
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.term import shows_torque, yields


def predicted(problem: EvidenceProblem, found: EvidenceFit, states: PoseStates) -> EvidenceProblem:
    """Return the problem of other poses, each with as many readings as a pose of the campaign.

    Readings are predicted by a fit to the campaign. The torques of the states are nan.

    Raises:
        DiscoveryError: when torques were logged, or bend the model, but the weights that make them
            are not known.
    """
    _refuse_unknown_torques(problem, found)
    poses = _with_readings(problem, found, _with_torques(problem, found, states))
    cov = _reading_cov(problem, poses) / poses.readings[:, None, None]
    return replace(
        problem,
        readings=poses,
        cells=poses,
        cell_cov=cov,
        pose=pose_noise_model(poses, cov, problem.baseline, problem.setup, problem.in_time),
        torque=_torque_noise(problem, poses),
        # Derivatives alone separate effects: no data of these poses are needed.
        torque_without_weights_Nm=np.zeros_like(poses.states.tau_Nm),
    )


def _refuse_unknown_torques(problem: EvidenceProblem, found: EvidenceFit) -> None:
    logged = np.all(np.isfinite(problem.readings.states.tau_Nm))
    if problem.setup.payload is None and (logged or any(map(yields, found.model.terms))):
        raise DiscoveryError(
            "torques cannot be predicted in configurations that were not measured",
            where=problem.baseline.model.chain.arm.name,
            allowed="an arm and a tool whose masses are known",
            remedy="complete the descriptions of arm and tool",
        )


def _with_torques(problem: EvidenceProblem, found: EvidenceFit, states: PoseStates) -> Observations:
    """Return poses with the torques that a log would have, and with the baseline's readings."""
    baseline, setup = problem.baseline, problem.setup
    states, _ = with_torques(baseline.model, baseline.x, states, setup.payload)
    label = np.array([f"next {k}" for k in range(len(states))])
    poses = Observations.single(label, states, _as_seen(problem, baseline, states))
    poses = complete(poses, baseline, setup)
    loads = poses.states.static_loads
    if not problem.torques_logged or loads is None:
        return poses
    # A log holds what friction and effects do to torques, besides the weights.
    tau_Nm = loads.joint_Nm + found.model.torque_Nm(poses.states, found.at.x)
    return poses.with_states(replace(poses.states, tau_Nm=tau_Nm))


def _with_readings(
    problem: EvidenceProblem, found: EvidenceFit, poses: Observations
) -> Observations:
    """Return poses with the readings of what was found, which their torques bend, and their number.

    Each is read as often as a measured one is on average.
    """
    measured = problem.readings
    poses_measured = 1 + int(same_circumstances(measured).max())
    return replace(
        poses,
        measured=_as_seen(problem, found.at, poses.states),
        readings=np.full(len(poses), round(len(measured) / poses_measured)),
    )


def _torque_noise(problem: EvidenceProblem, poses: Observations) -> NoiseModel | None:
    """Return the noise model of the torques of poses; None where the campaign has none."""
    baseline, setup = problem.baseline, problem.setup
    if problem.torque is None or setup.payload is None:
        return None
    weights = statics_of(baseline.model, baseline.x, poses.states, setup.payload)
    u_Nm, loads_N = problem.noise.torque_Nm, problem.cells.states.load_N
    return torque_noise_model(poses, weights, baseline, setup, u_Nm, loads_N)


def _as_seen(problem: EvidenceProblem, at: FittedModel, states: PoseStates) -> Instrument:
    """Return the readings of a model by the instrument, without noise.

    The derivative by stated places of targets is nearly constant along the end's axes: its mean is
    used.
    """
    measured = problem.readings.measured
    T_instr_ee = at.T_instr_base @ at.model.predict(states, at.x)
    ideal = measured.ideal(T_instr_ee, at.targets_m)
    if not measured.by_stated_targets.shape[2]:
        return ideal
    to_end = _axes_of_end(at, problem.readings).transpose(0, 2, 1)
    along_end = np.mean(to_end @ measured.by_stated_targets, axis=0)
    return ideal.with_stated_targets(ideal.axes_of_end(T_instr_ee) @ along_end)


def _reading_cov(problem: EvidenceProblem, poses: Observations) -> Array:
    """Return the covariance (P, b, b) of one reading of poses from its sources."""
    readings, noise, at = problem.readings, problem.noise, problem.baseline
    measured = readings.measured

    def of_joints(some: Observations) -> Array:
        by_joint = ideal_by_joints(at, some)
        return np.asarray((by_joint * noise.joint_rad**2) @ by_joint.transpose(0, 2, 1))

    stated = noise.instrument**2 * measured.stated_covariance
    # Noise of neither joints nor instrument is equal in all poses and directions.
    other = noise.cov - of_joints(readings) - stated
    rest = np.mean(np.diagonal(other, axis1=1, axis2=2), axis=0)
    for _, columns in measured.component_kinds:
        rest[columns] = np.maximum(rest[columns].mean(), 0.0)
    before, axes = _axes_of_end(at, readings), _axes_of_end(at, poses)
    along_end = np.mean(before.transpose(0, 2, 1) @ stated @ before, axis=0)
    of_instrument = axes @ along_end @ axes.transpose(0, 2, 1)
    return np.asarray(of_joints(poses) + of_instrument + np.diag(rest))


def _axes_of_end(at: FittedModel, poses: Observations) -> Array:
    """Return the axes of the end by a model, in the components of poses, (P, b, b)."""
    T_instr_ee = at.T_instr_base @ at.model.predict(poses.states, at.x)
    return poses.measured.axes_of_end(T_instr_ee)


def as_repeated(
    survey: Survey, found: ModelWithEffects, noise: Noise
) -> tuple[EvidenceProblem, EvidenceFit]:
    """Return a campaign without repeats as the problem of one with repeats, and a fit to it.

    The scatter beyond the noise of readings is the variance of the error that readings of a pose
    share. Of very many poses some are used, each of which stands for several.
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
    setup = survey.setup
    problem = EvidenceProblem(
        calibrated=survey.baseline,
        baseline=survey.baseline,
        setup=setup,
        readings=poses,
        cells=poses,
        cell_cov=cov,
        noise=noise,
        pose=pose_noise_model(poses, cov, survey.baseline, setup, in_time),
        torque=None,
        torque_without_weights_Nm=np.zeros_like(poses.states.tau_Nm),
        context=survey.context,
        torques_logged=survey.torques_logged,
        in_time=in_time,
        poses_a_cell=count / len(rows),
    )
    fit = EvidenceFit(
        effects=found.effects,
        at=found.at,
        converged=found.converged,
        iterations=found.iterations,
        sizes=(EVIDENCE.sizes.index(1.0),) * len(found.effects),
        variances=SharedVariances(max(scatter - 1.0, 0.0), 0.0),
    )
    return problem, fit


def separation_criteria(
    problem: EvidenceProblem,
    found: EvidenceFit,
    pairs: Sequence[tuple[Effect, Effect | None]],
    ahead: EvidenceProblem,
) -> list[Combined]:
    """Return, for every pair, the lesser separation of either effect from the other.

    Args:
        problem: the campaign.
        found: the fit of the model with what was found.
        pairs: effects, each with its rival; None for the model's own parameters alone.
        ahead: the problem of the poses that may be chosen, see `predicted`.
    """
    rows = _Rows.of(problem, found, pairs, ahead)
    criteria = []
    for effect, rival in pairs:
        both_ways = [rows.separation(effect, rival)]
        if rival is not None:
            both_ways.append(rows.separation(rival, effect))
        criteria.append(Combined(both_ways))
    return criteria


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of C measured poses, then of N candidates, with b components of unit variance each."""

    # (C + N, b, k) by the model's own parameters and the errors common to all poses, each in its
    # expected size
    own: Array
    # (C + N, b, q) by the parameters of each effect, in its size; the largest for an effect that is
    # not in the fit
    by_effect: Mapping[Effect, Array]
    as_found: Mapping[Effect, Array]  # (C + N, b, 1) of each effect of the fit, in its amount
    measured: int  # C
    components: int  # components of all poses of the campaign, repeats counted once

    @classmethod
    def of(
        cls,
        problem: EvidenceProblem,
        found: EvidenceFit,
        pairs: Sequence[tuple[Effect, Effect | None]],
        ahead: EvidenceProblem,
    ) -> _Rows:
        """Return the rows by the effects of a fit and of pairs; see `separation_criteria`."""
        members = (effect for pair in pairs for effect in pair if effect is not None)
        effects = tuple(dict.fromkeys([*found.effects, *members]))
        now, then = (_by_parameters(part, found, effects) for part in (problem, ahead))
        _, pose = np.unique(problem.cells.pose, return_inverse=True)
        never = group_means(problem.cells.measured.components_seen.astype(float), pose) == 0.0
        rows = {e: np.concatenate([now.of_effects[e], then.of_effects[e]]) for e in effects}
        sizes = dict.fromkeys(effects, EVIDENCE.sizes[-1])
        sizes |= {effect: EVIDENCE.sizes[size] for effect, size in found.size_of.items()}
        amounts = {e: found.at.values_of(e)[: e.linear, None] for e in found.effects}
        return cls(
            own=np.concatenate([now.common, then.common]),
            by_effect={e: rows[e] @ now.factors[e] * sizes[e] for e in effects},
            as_found={e: rows[e][..., : e.linear] @ amount for e, amount in amounts.items()},
            measured=len(now.common),
            components=round(
                problem.poses_a_cell * (len(never) * now.common.shape[1] - int(never.sum()))
            ),
        )

    def separation(self, truth: Effect, rival: Effect | None) -> SeparationCriterion:
        """Return the separation of a true effect from all that may be adjusted instead."""
        signal = self._signal(truth, rival)
        rows = np.concatenate([self._adjustable(truth, rival), signal], axis=2)
        k = rows.shape[2]
        known = np.concatenate([rows[: self.measured].reshape(-1, k), np.eye(k)])
        return SeparationCriterion(rows[self.measured :], known, signal.shape[2], self.components)

    def _adjustable(self, truth: Effect, rival: Effect | None) -> Array:
        """Return columns of all that may be adjusted if an effect is true, the rival last."""
        free = [effect for effect in self.as_found if effect not in (truth, rival)]
        free += [] if rival is None else [rival]
        return np.concatenate([self.own, *(self.by_effect[effect] for effect in free)], axis=2)

    def _signal(self, truth: Effect, rival: Effect | None) -> Array:
        """Return the signal (C + N, b, m) of an effect if it is true.

        It has the amount found; or else the amount with which it best imitates its rival that was
        found; or else plausible amounts of each parameter, on average over its shapes.
        """
        if truth in self.as_found:
            return self.as_found[truth]
        own = self.by_effect[truth]
        if rival is None or rival not in self.as_found:
            return np.asarray(own / (EVIDENCE.sizes[-1] * np.sqrt(len(truth.starts))))
        columns = self._adjustable(rival, truth)[: self.measured]
        k = columns.shape[2]
        rows = np.concatenate([columns.reshape(-1, k), np.eye(k)])
        target = np.append(self.as_found[rival][: self.measured], np.zeros(k))
        imitating = np.linalg.lstsq(rows, target, rcond=None)[0][-own.shape[2] :]
        return np.asarray(own @ imitating[:, None])


class _ByParameters(NamedTuple):
    """Rows of C poses by parameters, with b components each, divided by their noise."""

    # (C, b, k) by all that is common to the rivals, in its size; errors common to all poses have
    # columns of their own, which poses ahead share
    common: Array
    of_effects: dict[Effect, Array]  # (C, b, q) by the parameters of each effect
    factors: dict[Effect, Array]  # (q, q) of the prior of each effect


def _by_parameters(
    problem: EvidenceProblem, found: EvidenceFit, effects: tuple[Effect, ...]
) -> _ByParameters:
    """Return the rows of a problem's poses, torques after the components of poses.

    An effect of a quantity that is not known of the poses has rows of zero: they cannot show it.
    """
    lin, pose = linearise(problem, found, effects), problem.pose

    def scaled(channel: NoiseModel, variance: float, rows: Array) -> Array:
        """Return rows divided by their noise with the error that all readings of a pose share."""
        divided = rows / np.sqrt(1.0 + variance * channel.shared.variance)[:, None]
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
    common, *of_effects = rows
    known = [part if np.all(np.isfinite(part)) else np.zeros_like(part) for part in of_effects]
    factors = (block.factor for block in lin.blocks)
    return _ByParameters(
        common=common,
        of_effects=dict(zip(effects, known, strict=True)),
        factors=dict(zip(effects, factors, strict=True)),
    )
