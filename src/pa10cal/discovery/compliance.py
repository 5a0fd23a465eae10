"""Joints that give way under weights that nobody stated: named, sized and held against rivals.

The calibration of an arm whose weights are assumed has a spring in each joint that its poses show
to give way. Here each is judged in the model as the search left it: what is left without it, what
else explains the poses as well in its place, and how stiff the joint is, relative to the weights
assumed. All is linear about the model, the weights among the unknowns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TypeVar

import numpy as np

from pa10cal.arm.description import weights_known
from pa10cal.arrays import Array, Index, Mask
from pa10cal.calibration import rules as calibration_rules
from pa10cal.discovery.finding import (
    DiagnosedFault,
    Finding,
    GivesWay,
    Rival,
    fault_of,
    name_of,
)
from pa10cal.discovery.linear import (
    cluster_covariance,
    error_mm,
    residual_and_jacobian,
    rms,
    unknowns,
)
from pa10cal.discovery.noise import pose_weights
from pa10cal.discovery.preparation import MeasurementSetup
from pa10cal.discovery.rules import NAMES, SPRINGS, TORQUES
from pa10cal.discovery.together import Together
from pa10cal.discovery.verdict import Basis, Verdict, in_doubt
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import statics_of
from pa10cal.fit.problem import possible_sizes
from pa10cal.fit.weighed_arm import errors_of_logs, scatter_about, weight_sizes
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.observations import Observations
from pa10cal.results.discovery import Unexplained
from pa10cal.results.record import HALF_WIDTH_95
from pa10cal.rules import MASSES
from pa10cal.terms.effects.effect import CandidateContext
from pa10cal.terms.effects.joint import JointCompliance, most_wound_up
from pa10cal.terms.joint_spring import JointSpring, is_spring
from pa10cal.terms.weights import WeightStated, fault_candidates

S = TypeVar("S", bound=Basis)


def with_compliance(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict with the joints that give way under weights that nobody stated.

    Springs are those of the extended model. Where the weights are stated, they are part of the
    calibrated model and no finding.
    """
    known = weights_known(found.baseline.arm)
    if known.origin == "stated" or found.prepared.setup.payload is None:
        return found
    at = found.extended.at
    springs = [
        term
        for term in at.model.terms
        if is_spring(term) and at.values_of(term)[0] > SPRINGS.least_rad
    ]
    if not (springs or found.findings):
        return found
    rows = _LinearProblem.of(found)
    rivals = _rivals(found, rows)
    if found.weights_assumed and found.scorer.of_sets:
        found = replace(found, findings=tuple(_with_more(each, rivals) for each in found.findings))
    needed = float(np.log(max(found.candidates, len(springs)) / found.error_rate))
    lost = {
        spring: (rows.rigid(spring).squares - rows.squares) / rows.design_effect(spring)
        for spring in springs
    }
    nats = {spring: 0.5 * float(loss - np.log(rows.readings)) for spring, loss in lost.items()}
    shown = [s for s in springs if nats[s] >= needed and (JointCompliance.id, s.of) in rivals]
    shown.sort(key=lambda spring: -nats[spring])
    all_rigid = rows.rigid(*shown)
    held_out, judging = rows.held_out, rows.held_out or rows.poses
    all_rigid_mm, now_mm = all_rigid.errors_mm(judging), rms(rows.errors_mm(rows.poses))
    findings, unexplained = [], list(found.unexplained)
    commanded = found.context.commanded
    most_rad, too_far = most_wound_up(found.baseline.arm.reach_m, commanded=commanded)
    for spring in shown:
        rigid = rows.rigid(spring)
        stiffness, std, sag_rad, sag_std = rows.stiffness(spring)
        if sag_rad - HALF_WIDTH_95 * sag_std > most_rad:
            why = (
                f"joint_compliance of {spring.of} fits best, but is not named: it would sag by "
                f"{1e3 * sag_rad:.0f} mrad: {too_far}"
            )
            if not commanded:
                why += "; if positions were commanded and not read back, state joints: commanded"
            left_mm = found.train.after.mean_mm
            no_spring = Unexplained(
                of=spring.of, form=JointCompliance.id, shared_error_mm=left_mm, why=why
            )
            unexplained.append(no_spring)
            continue
        proof = GivesWay(
            lost_without_it_nats=nats[spring],
            needed_nats=needed,
            sag_mrad=1e3 * sag_rad,
            sag_u_mrad=1e3 * sag_std,
            rigid_mm=rms(rigid.errors_mm(rows.poses)),
            gives_way_mm=now_mm,
            held_out_rigid_mm=None if held_out is None else rms(rigid.errors_mm(held_out)),
            held_out_gives_way_mm=None if held_out is None else rms(rows.errors_mm(held_out)),
            all_rigid_mm=rms(all_rigid_mm),
            without_each_mm=rigid.errors_mm(judging),
            all_rigid_each_mm=all_rigid_mm,
            weights="logged" if found.prepared.torques == "logged" else known.origin,
        )
        effect = JointCompliance(spring.of, spring.tau_ref_Nm)
        x, covariance = np.array([stiffness]), np.array([[std**2]])
        finding = Finding(effect, x, covariance, (), proof, rivals[JointCompliance.id, spring.of])
        finding = in_doubt(found, finding)
        told = len(finding.with_likely().alternatives) <= NAMES.most_alternatives
        if told and not finding.is_unlikely:
            findings.append(finding)
    return replace(found, gives_way=tuple(findings), unexplained=tuple(unexplained))


def _rivals(found: Verdict, rows: _LinearProblem) -> dict[tuple[str, str], tuple[Rival, ...]]:
    """Return what may stand for each that is missed of what was found, by name."""
    at = found.extended.at
    sets = Together.of(
        at, rows.poses, rows.whitener, found.context, found.prepared.setup, found.scorer.beside
    )
    rigid = [spring for spring in at.model.terms if is_spring(spring) and rows.is_rigid(spring)]
    there = sets.scored(sets.holding(term for term in at.model.terms if term not in rigid))
    missed = sets.missed(there)
    return {name: each for name, each in sets.rivals(there).items() if name in missed}


def _with_more(finding: Finding, rivals: Mapping[tuple[str, str], tuple[Rival, ...]]) -> Finding:
    """Return a finding with further rivals, by name, that its search did not try."""
    known = {name_of(each.effect) for each in finding.rivals}
    more = rivals.get((finding.id, finding.of), ())
    further = (each for each in more if name_of(each.effect) not in known)
    return replace(finding, rivals=(*finding.rivals, *further))


@dataclass(frozen=True, eq=False)
class _LinearProblem:
    """A model and its poses, linear about its point; all unknowns are fitted anew.

    Unknowns are scaled by the standard deviations thought possible, which are their prior about
    where they are; weights alone are expected about what is assumed.
    """

    at: FittedModel  # the extended model, its base's own term last
    poses: Observations  # those fitted
    held_out: Observations | None  # those held out that are trusted; None without any
    whitener: Array  # (P, b, b) of the poses fitted

    @classmethod
    def of(cls, found: Verdict) -> _LinearProblem:
        at, poses = found.extended.at, found.train.poses
        left, jacobian = residual_and_jacobian(at, poses)
        weights = pose_weights(left, float(jacobian.shape[2]), poses.measured)
        trusted_holdout = found.trusted_holdout
        held_out = None if trusted_holdout is None else trusted_holdout.poses
        return cls(at, poses, held_out, weights.whiteners())

    def rigid(self, *springs: JointSpring) -> _LinearProblem:
        """Return the problem with some joints rigid."""
        x = self.at.x.copy()
        for spring in springs:
            x[self.at.model.columns_of(spring).start] = calibration_rules.SPRINGS.rigid_rad
        return replace(self, at=replace(self.at, x=x))

    def is_rigid(self, spring: JointSpring) -> bool:
        """Return whether a joint with a spring is all but rigid."""
        return bool(self.at.values_of(spring)[0] <= SPRINGS.least_rad)

    @property
    def readings(self) -> int:
        """Return how many components were seen."""
        return int(self.poses.measured.components_seen.sum())

    @cached_property
    def sizes(self) -> Array:
        """Return the standard deviation thought possible of every unknown (k,)."""
        return possible_sizes(self.at.model, self.poses.measured)

    @cached_property
    def of_weights(self) -> Mask:
        """Return which unknowns are weights: these are expected about what is assumed."""
        targets = np.zeros(len(self.at.targets_m), dtype=bool)
        return np.concatenate([self.at.model.having("weight"), targets])

    @cached_property
    def off(self) -> Array:
        """Return how far unknowns (k,) are from what is expected of them, in sizes."""
        return np.where(self.of_weights, unknowns(self.at) / self.sizes, 0.0)

    @cached_property
    def rows(self) -> tuple[Array, Array]:
        """Return whitened columns (N, k) of the unknowns, in sizes, and what is left (N,)."""
        at = self.at
        left, jacobian = residual_and_jacobian(at, self.poses)
        for term in at.model.terms:
            # A joint that is all but rigid cannot give way the other way round: it is held.
            if is_spring(term) and self.is_rigid(term):
                jacobian[:, :, at.model.columns_of(term).start] = 0.0
        white = (self.whitener @ jacobian).reshape(-1, jacobian.shape[2])
        return white * self.sizes, (self.whitener @ left[:, :, None]).ravel()

    @cached_property
    def steps(self) -> Gaussian:
        """Return what the rows say of steps (k,) from what is expected, in sizes."""
        columns, data = self.rows
        return Gaussian.of(columns, -data).about(-self.off)

    @cached_property
    def step(self) -> Array:
        """Return the step (k,) in sizes that leaves least."""
        return self.steps.mean - self.off

    @cached_property
    def squares(self) -> float:
        """Return the squares that it leaves."""
        return self.steps.left

    def errors_mm(self, poses: Observations) -> Array:
        """Return position errors (P,) that are left of poses, to first order.

        The step may take other springs beyond their bounds: that is no model, but what is left.
        """
        left, jacobian = residual_and_jacobian(self.at, poses)
        return error_mm(poses.measured, left + jacobian @ (self.step * self.sizes))

    def design_effect(self, spring: JointSpring) -> float:
        """Return how much larger the variance of a spring is for poses that err alike.

        Poses that follow each other often stand nearly in the same place, and what the model lacks
        is the same in all of them: they count as one (the variance by stretches of time over that
        of independent poses, at least 1).
        """
        at = self.at.model.columns_of(spring).start
        independent, by_stretches = (float(cov[at, at]) for cov in self._covariances)
        return max(1.0, by_stretches / independent) if independent > 0.0 else 1.0

    @cached_property
    def _covariances(self) -> tuple[Array, Array]:
        """Return that of all unknowns if poses are independent, and by stretches of time."""
        count, (columns, data) = len(self.poses), self.rows
        order = np.argsort(np.argsort(self.poses.states.time_s, kind="stable"))
        stretches = min(SPRINGS.stretches, max(count // SPRINGS.stretch_poses, 2))
        stretch = np.repeat(order * stretches // count, self.whitener.shape[1])
        scores = columns * (data + columns @ self.step)[:, None]
        scale = np.outer(self.sizes, self.sizes)
        independent = self.steps.covariance
        return independent * scale, cluster_covariance(independent, scores, stretch) * scale

    def stiffness(self, spring: JointSpring) -> tuple[float, float, float, float]:
        """Return stiffness [N m/rad], its uncertainty, the largest sag [rad], its uncertainty.

        Poses show how far a joint sags. Its stiffness is the standard deviation over the poses of
        the torque of the assumed weights, over that of the sag: as uncertain as how heavy the arm
        is, where nothing sets the scale.
        """
        model, x = self.at.model, self.at.x
        joint, states = spring.joint - 1, self.poses.states
        at = model.columns_of(spring).start
        by_x = -model.torque_jacobian(states, x)[:, joint]
        by_x[:, ~self.of_weights[: len(x)]] = 0.0
        carried_Nm = model.with_joint_torques(states, x).tau_Nm[:, joint]
        off_Nm = carried_Nm - carried_Nm.mean()
        spread_Nm = float(np.std(carried_Nm))
        stiffness = spring.tau_ref_Nm / float(x[at]) * float(np.std(states.tau_Nm[:, joint]))
        stiffness /= spread_Nm
        slope = -stiffness * (off_Nm @ by_x) / (len(off_Nm) * spread_Nm**2)
        slope[at] = -stiffness / float(x[at])
        row = int(np.argmax(np.abs(carried_Nm)))
        sag = float(x[at]) * float(np.abs(carried_Nm[row])) / spring.tau_ref_Nm
        of_sag = float(x[at]) / spring.tau_ref_Nm * by_x[row] * np.sign(carried_Nm[row])
        of_sag[at] = sag / float(x[at])
        std, sag_std = (
            float(np.sqrt(max(by @ cov[: len(x), : len(x)] @ by for cov in self._covariances)))
            for by in (slope, of_sag)
        )
        return stiffness, float(np.hypot(std, stiffness * model.u_scale)), sag, sag_std


# Loads and tool that the log states wrongly, by logged torques alone.
#
# Where effects are judged by blocks, torques are no rows of the search: the springs take them from
# the log, and a wrong load leaves no pose off. It stands in the torques, all the same.


def stated_wrongly(
    poses: Observations, baseline: FittedModel, setup: MeasurementSetup, context: CandidateContext
) -> tuple[DiagnosedFault, ...]:
    """Return loads and tool that are stated wrongly, by logged torques."""
    faults = [each for each in fault_candidates(context) if isinstance(each, WeightStated)]
    if not faults or setup.payload is None or context.torques != "logged":
        return ()
    rows = _rows(poses, baseline, setup, faults)
    chosen: list[int] = []
    while left := [k for k in range(len(faults)) if k not in chosen]:
        best = max(left, key=lambda k: rows.gain(chosen, k))
        if not rows.needs(chosen, best):
            break
        chosen.append(best)
    found = []
    for k in chosen:
        x, covariance, gain = rows.amounts(chosen, k)
        sizes = np.diag(faults[k].prior_factor)
        if np.abs(x).max() > TORQUES.least_sizes:
            found.append(fault_of(faults[k], x * sizes, covariance * np.outer(sizes, sizes), gain))
    return tuple(found)


@dataclass(frozen=True)
class _TorqueProducts:
    """What weighed rows of the torques say: of two halves of the readings, and of both."""

    halves: tuple[Gaussian, Gaussian]
    both: Gaussian
    known: int  # how many columns any log may need; those of the faults follow
    of_faults: tuple[Index, ...]  # columns of each fault

    def gain(self, chosen: Sequence[int], fault: int, rows: Gaussian | None = None) -> float:
        """Return the squares that a further fault takes away, of all rows where none are given."""
        return self._left(chosen, rows) - self._left([*chosen, fault], rows)

    def needs(self, chosen: Sequence[int], fault: int) -> bool:
        """Return whether a further fault is there."""
        lesser = min(self.gain(chosen, fault, half) for half in self.halves)
        _, covariance, _ = self.amounts([*chosen, fault], fault)
        nats = 0.5 * (self.gain(chosen, fault) + np.linalg.slogdet(covariance)[1])
        return bool(nats > TORQUES.fault_nats and lesser > TORQUES.half_squares)

    def amounts(self, chosen: Sequence[int], fault: int) -> tuple[Array, Array, float]:
        """Return amounts of one of the chosen, in its sizes, their covariance, and its gain."""
        at, found = self._of(chosen)
        own = np.flatnonzero(np.isin(at, self.of_faults[fault]))
        without = self._left([other for other in chosen if other != fault])
        gain = (without - self._left(chosen)) / without
        return found.mean[own], found.covariance[np.ix_(own, own)], gain

    def _of(self, chosen: Sequence[int], rows: Gaussian | None = None) -> tuple[Index, Gaussian]:
        at = np.concatenate([np.arange(self.known), *(self.of_faults[k] for k in chosen)])
        return at, (rows or self.both).along(at)

    def _left(self, chosen: Sequence[int], rows: Gaussian | None = None) -> float:
        return self._of(chosen, rows)[1].left


def _rows(
    poses: Observations,
    baseline: FittedModel,
    setup: MeasurementSetup,
    faults: Sequence[WeightStated],
) -> _TorqueProducts:
    """Weigh the rows: logged torques less those of the weights, by the scatter that is left."""
    assert setup.payload is not None
    states, arm = poses.states, baseline.arm
    weights = statics_of(baseline.model, baseline.x, states, setup.payload)
    left_Nm = states.tau_Nm - weights.torque_Nm
    rated_Nm = arm.rated_Nm(np.abs(weights.torque_Nm).max(axis=0))
    by_weights = weights.static_loads.by_weights * weight_sizes(arm, setup.payload).columns(arm)
    usual = errors_of_logs(weights.torque_Nm, rated_Nm, states.arrival)
    known = np.concatenate([by_weights, usual], axis=2)
    of_faults = [fault.per_unit(states) @ fault.prior_factor for fault in faults]
    columns = np.concatenate([known, *of_faults], axis=2)
    noise_Nm, x = scatter_about(columns, left_Nm, TORQUES.reweighted, TORQUES.least_noise_Nm)
    off_Nm = np.clip(left_Nm - columns @ x, -MASSES.edge * noise_Nm, MASSES.edge * noise_Nm)
    white, data = columns / noise_Nm[:, None], (columns @ x + off_Nm) / noise_Nm
    # Loads and poses come in turn: a half by lot has its part of each.
    drawn = np.random.default_rng(0).permutation(len(poses))
    halves = [drawn[::2], drawn[1::2]]
    one, other = (Gaussian.of(white[half], data[half]) for half in halves)
    first = known.shape[2]
    stops = first + np.cumsum([0, *(own.shape[2] for own in of_faults)])
    columns_of = tuple(np.arange(*ends) for ends in pairwise(stops.tolist()))
    return _TorqueProducts((one, other), one + other, first, columns_of)
