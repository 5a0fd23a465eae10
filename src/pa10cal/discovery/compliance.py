"""Joints that give way under weights that are not stated: evidence, rivals and stiffness.

The calibration of an arm whose weights are assumed gives a spring to each joint that its poses show
to be compliant. Here each spring is judged in the extended model: by the misfit with the joint
rigid, by the effects that explain the poses as well in its place, and by its stiffness relative to
the assumed weights. The problem is linearised about that model, weights among the unknowns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple, TypeVar

import numpy as np

from pa10cal.arm.description import weights_known
from pa10cal.arrays import Array, Mask, rms
from pa10cal.calibration import rules as calibration_rules
from pa10cal.discovery import jacobians
from pa10cal.discovery.finding import Finding, Rival, name_of
from pa10cal.discovery.model_with_effects import all_unknowns
from pa10cal.discovery.pose_scatter import pose_weights
from pa10cal.discovery.probabilities import with_unknown_cause
from pa10cal.discovery.proof import ComplianceProof, needed_nats
from pa10cal.discovery.refitted_verdict import no_name, probably_nameless, too_many_others
from pa10cal.discovery.rules import NAMES, SPRINGS
from pa10cal.discovery.together import Together
from pa10cal.discovery.verdict import Basis, Verdict
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.position_errors import position_error_mm
from pa10cal.fit.problem import possible_sizes
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.numerics.least_squares import cluster_covariance
from pa10cal.observe.observations import Observations
from pa10cal.results.number_text import HALF_WIDTH_95
from pa10cal.terms.effects.joint import JointCompliance, most_wound_up
from pa10cal.terms.joint_spring import JointSpring, is_spring

S = TypeVar("S", bound=Basis)


def with_compliance(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict with the joints that give way under weights that are not stated.

    Springs are those of the extended model. Where the weights are stated, springs are part of the
    calibrated model and not reported. A spring that the poses show and that is not named is an
    unexplained part. Effects found get further rivals here, since a spring may stand in for them.
    """
    known = weights_known(found.baseline.arm)
    if known.origin == "stated" or found.prepared.setup.payload is None:
        return found
    springs = _springs(found)
    if not (springs or found.findings):
        return found
    problem = _LinearProblem.of(found)
    rivals = _rivals(found, problem)
    found = _with_rivals_of_sets(found, rivals)
    named: list[_ShownSpring] = []
    unexplained = list(found.unexplained)
    for shown in _shown_springs(found, problem, springs, rivals):
        finding = shown.finding(found, all_rigid_mm=shown.rigid.judged_mm)
        if (why := _why_not_named(found, finding)) is None:
            named.append(shown)
        else:
            unexplained.append(no_name(finding, found.train.after.mean_mm, why))
    gives_way: tuple[Finding[ComplianceProof], ...] = ()
    if named:
        # This error depends on which joints have names, and no name depends on it.
        all_rigid_mm = problem.rigid(*(shown.spring for shown in named)).judged_mm
        gives_way = tuple(shown.finding(found, all_rigid_mm) for shown in named)
    return replace(found, gives_way=gives_way, unexplained=tuple(unexplained))


def _springs(found: Verdict) -> list[JointSpring]:
    """Return the springs of the extended model that yield enough to count."""
    at = found.extended.at
    springs = (term for term in at.model.terms if is_spring(term))
    return [spring for spring in springs if at.values_of(spring)[0] > SPRINGS.least_rad]


def _shown_springs(
    found: Verdict,
    problem: _LinearProblem,
    springs: Sequence[JointSpring],
    rivals: Mapping[tuple[str, str], tuple[Rival, ...]],
) -> list[_ShownSpring]:
    """Return the springs that the poses show, those of most evidence first.

    The set of effects is less likely without each, which then is in `rivals`.
    """
    needed = needed_nats(max(found.candidates, len(springs)), found.error_rate)
    nats = {spring: problem.nats_lost_if_rigid(spring) for spring in springs}
    return [
        _ShownSpring(spring, problem, nats[spring], needed, rivals[JointCompliance.id, spring.of])
        for spring in sorted(springs, key=lambda spring: -nats[spring])
        if nats[spring] >= needed and (JointCompliance.id, spring.of) in rivals
    ]


@dataclass(frozen=True, eq=False)
class _ShownSpring:
    """A spring of the extended model that the poses show."""

    spring: JointSpring
    problem: _LinearProblem  # that of the extended model
    nats: float  # log evidence lost with its joint rigid
    needed: float  # that which a name needs
    rivals: tuple[Rival, ...]

    @cached_property
    def rigid(self) -> _LinearProblem:
        """Return the problem with this joint rigid."""
        return self.problem.rigid(self.spring)

    @cached_property
    def stiffness(self) -> _Stiffness:
        """Return its stiffness and largest sag."""
        return self.problem.stiffness(self.spring)

    def finding(self, found: Verdict, all_rigid_mm: Array) -> Finding[ComplianceProof]:
        """Return the finding of the joint in a verdict.

        Args:
            found: the verdict.
            all_rigid_mm: (P,) errors of the poses judged if all joints are rigid that have names.
        """
        proof = ComplianceProof(
            lost_without_it_nats=self.nats,
            needed_nats=self.needed,
            sag_mrad=1e3 * self.stiffness.sag_rad,
            sag_u_mrad=1e3 * self.stiffness.sag_u_rad,
            rigid_mm=rms(self.rigid.fitted_mm),
            gives_way_mm=rms(self.problem.fitted_mm),
            held_out_rigid_mm=self.rigid.held_out_rms_mm,
            held_out_gives_way_mm=self.problem.held_out_rms_mm,
            all_rigid_mm=rms(all_rigid_mm),
            without_each_mm=self.rigid.judged_mm,
            all_rigid_each_mm=all_rigid_mm,
            weights=_relative_to(found),
        )
        finding = Finding(
            effect=JointCompliance(self.spring.of, self.spring.tau_ref_Nm),
            x=np.array([self.stiffness.Nm_rad]),
            covariance=np.array([[self.stiffness.u_Nm_rad**2]]),
            alternatives=(),
            proof=proof,
            rivals=self.rivals,
        )
        return with_unknown_cause(found, finding)


def _relative_to(found: Verdict) -> Literal["assumed", "total", "logged"] | None:
    """Return the weights that stiffness is known relative to; None where loads set its scale."""
    if found.prepared.torques == "logged":
        return "logged"
    if not found.extended.model.u_scale:
        return None
    return "total" if weights_known(found.baseline.arm).origin == "total" else "assumed"


def _why_not_named(found: Verdict, finding: Finding[ComplianceProof]) -> str | None:
    """Return why a spring that the poses show is not named, in words; None if it is."""
    commanded, proof = found.context.commanded, finding.proof
    most_rad, why = most_wound_up(found.baseline.arm.reach_m, commanded=commanded)
    if proof.sag_mrad - HALF_WIDTH_95 * proof.sag_u_mrad > 1e3 * most_rad:
        text = f"it would sag by {proof.sag_mrad:.0f} mrad: {why}"
        if not commanded:
            text += "; if positions were commanded and not read back, state joints: commanded"
        return text
    others = len(finding.with_likely_alternatives().alternatives)
    if others > NAMES.most_alternatives:
        return too_many_others(others)
    return probably_nameless(finding) if finding.is_probably_nameless else None


def _rivals(found: Verdict, problem: _LinearProblem) -> dict[tuple[str, str], tuple[Rival, ...]]:
    """Return the rivals of springs and effects by id and place.

    Only springs and effects that the set misses, which is less likely without them, have an entry.
    """
    at, setup = found.extended.at, found.prepared.setup
    sets = Together.of(
        at, problem.poses, problem.whitener, found.context, setup, found.scorer.nuisances
    )
    rigid = [term for term in at.model.terms if is_spring(term) and problem.is_rigid(term)]
    there = sets.scored(sets.holding(term for term in at.model.terms if term not in rigid))
    missed = sets.missed(there)
    return {name: rivals for name, rivals in sets.rivals(there).items() if name in missed}


def _with_rivals_of_sets(
    found: Verdict[S], rivals: Mapping[tuple[str, str], tuple[Rival, ...]]
) -> Verdict[S]:
    """Return a verdict whose findings have rivals by sets, too, where weights are assumed."""
    if not (found.weights_assumed and found.scorer.adds_rivals_of_sets):
        return found
    return replace(found, findings=tuple(_with_more(each, rivals) for each in found.findings))


def _with_more(finding: Finding, rivals: Mapping[tuple[str, str], tuple[Rival, ...]]) -> Finding:
    """Return a finding with those rivals of its name that its search did not try."""
    known = {name_of(rival.effect) for rival in finding.rivals}
    of_name = rivals.get((finding.id, finding.of), ())
    further = (rival for rival in of_name if name_of(rival.effect) not in known)
    return replace(finding, rivals=(*finding.rivals, *further))


class _Stiffness(NamedTuple):
    """How stiff a joint is, and how far it sags at most, with standard uncertainties."""

    Nm_rad: float  # stiffness [N m/rad]
    u_Nm_rad: float
    sag_rad: float  # largest sag over the poses
    sag_u_rad: float


class _Covariances(NamedTuple):
    """Covariances (k, k) of the same estimates."""

    independent: Array  # with the errors of all poses independent
    by_stretches: Array  # with those of a stretch of time correlated


@dataclass(frozen=True, eq=False)
class _LinearProblem:
    """Least squares of all unknowns of a model, linearised about it.

    Each unknown is scaled by its prior standard deviation. The prior mean of weights is what is
    assumed of them; that of all others is the value in the model. With d (k,) how far the model is
    from the prior means (`off_prior`) and s the step from the model (`step`), d + s has a standard
    normal prior and is the unknown of `posterior`: s = posterior mean - d.
    """

    at: FittedModel  # the extended model, its base's own term last
    poses: Observations  # P poses fitted
    held_out: Observations | None  # trusted held-out poses; None without any
    whitener: Array  # (P, b, b) of the poses fitted

    @classmethod
    def of(cls, found: Verdict) -> _LinearProblem:
        """Return the problem of a verdict's extended model and of the poses it was fitted to."""
        at, poses = found.extended.at, found.train.poses
        residual, jacobian = jacobians.residual_and_jacobian(at, poses)
        weights = pose_weights(residual, float(jacobian.shape[2]), poses.measured)
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
        """Return whether the spring of a joint yields too little to count."""
        return bool(self.at.values_of(spring)[0] <= SPRINGS.least_rad)

    def nats_lost_if_rigid(self, spring: JointSpring) -> float:
        """Return the log evidence lost with a joint rigid, less the cost of its one parameter."""
        loss = (self.rigid(spring).squares - self.squares) / self.design_effect(spring)
        readings = int(self.poses.measured.components_seen.sum())
        return 0.5 * float(loss - np.log(readings))

    @cached_property
    def prior_std(self) -> Array:
        """Return the prior standard deviation of every unknown, (k,)."""
        return possible_sizes(self.at.model, self.poses.measured)

    @cached_property
    def is_weight(self) -> Mask:
        """Return which unknowns (k,) are weights of the arm."""
        targets = np.zeros(len(self.at.targets_m), dtype=bool)
        return np.concatenate([self.at.model.having("weight"), targets])

    @cached_property
    def off_prior(self) -> Array:
        """Return how far unknowns (k,) are from their prior means, in prior standard deviations."""
        return np.where(self.is_weight, all_unknowns(self.at) / self.prior_std, 0.0)

    @cached_property
    def rows(self) -> tuple[Array, Array]:
        """Return the whitened design matrix (N, k), unknowns scaled, and residual (N,)."""
        at = self.at
        residual, jacobian = jacobians.residual_and_jacobian(at, self.poses)
        for term in at.model.terms:
            # A joint that is all but rigid is held: it cannot have a negative compliance.
            if is_spring(term) and self.is_rigid(term):
                jacobian[:, :, at.model.columns_of(term).start] = 0.0
        white = (self.whitener @ jacobian).reshape(-1, jacobian.shape[2])
        return white * self.prior_std, (self.whitener @ residual[:, :, None]).ravel()

    @cached_property
    def posterior(self) -> Gaussian:
        """Return the posterior of d + s, (k,): how far unknowns are from their prior means."""
        columns, residual = self.rows
        return Gaussian.of(columns, -residual).about(-self.off_prior)

    @cached_property
    def step(self) -> Array:
        """Return the most likely step (k,) from the model, scaled."""
        return self.posterior.mean - self.off_prior

    @cached_property
    def squares(self) -> float:
        """Return the weighted sum of squares at that step, priors included."""
        return self.posterior.residual_squares

    @cached_property
    def fitted_mm(self) -> Array:
        """Return the position errors (P,) that remain at the poses fitted after the step."""
        return self._errors_mm(self.poses)

    @cached_property
    def judged_mm(self) -> Array:
        """Return the same at the held-out poses, or without any at those fitted."""
        return self.fitted_mm if self.held_out is None else self._errors_mm(self.held_out)

    @property
    def held_out_rms_mm(self) -> float | None:
        """Return the root mean square error of held-out poses; None without any."""
        return None if self.held_out is None else rms(self.judged_mm)

    def _errors_mm(self, poses: Observations) -> Array:
        """Return the position errors (P,) that remain in poses after the step, to first order.

        The step may take springs beyond their bounds: only the remaining errors are used.
        """
        residual, jacobian = jacobians.residual_and_jacobian(self.at, poses)
        return position_error_mm(poses.measured, residual + jacobian @ (self.step * self.prior_std))

    def design_effect(self, spring: JointSpring) -> float:
        """Return the variance of a spring for correlated poses over that for independent ones.

        Poses that follow each other often stand nearly in the same place and share the error of the
        model, so stretches of time are clusters. The result is at least 1.
        """
        column = self.at.model.columns_of(spring).start
        independent, by_stretches = (float(cov[column, column]) for cov in self._covariances)
        return max(1.0, by_stretches / independent) if independent > 0.0 else 1.0

    @cached_property
    def _covariances(self) -> _Covariances:
        """Return the covariances of all unknowns, unscaled."""
        count, (columns, residual) = len(self.poses), self.rows
        order = np.argsort(np.argsort(self.poses.states.time_s, kind="stable"))
        stretches = min(SPRINGS.stretches, max(count // SPRINGS.stretch_poses, 2))
        stretch = np.repeat(order * stretches // count, self.whitener.shape[1])
        scores = columns * (residual + columns @ self.step)[:, None]
        scale = np.outer(self.prior_std, self.prior_std)
        independent = self.posterior.covariance
        by_stretches = cluster_covariance(independent, scores, stretch)
        return _Covariances(independent * scale, by_stretches * scale)

    def stiffness(self, spring: JointSpring) -> _Stiffness:
        """Return the stiffness of a joint and its largest sag.

        Poses determine the sag. The stiffness is the standard deviation over the poses of the
        torque by the assumed weights, divided by that of the sag, and as uncertain as the arm's
        total weight. Where a load of known size sets the scale, it is that of the model.
        """
        model, x = self.at.model, self.at.x
        joint, states = spring.joint - 1, self.poses.states
        column = model.columns_of(spring).start
        yielding = float(x[column])  # sag [rad] at the torque tau_ref_Nm
        # The states' torques are of the described weights; what these are too heavy by, joints do
        # not carry (`with_joint_torques` subtracts it, hence the sign).
        torque_by_x = -model.torque_jacobian(states, x)[:, joint]
        torque_by_x[:, ~self.is_weight[: len(x)]] = 0.0
        torque_Nm = model.with_joint_torques(states, x).tau_Nm[:, joint]
        centred_Nm = torque_Nm - torque_Nm.mean()
        spread_Nm = float(np.std(torque_Nm))
        stiffness = spring.tau_ref_Nm / yielding
        stiffness_by_x = np.zeros_like(torque_by_x[0])
        if model.u_scale:
            stiffness *= float(np.std(states.tau_Nm[:, joint])) / spread_Nm
            stiffness_by_x = -stiffness * (centred_Nm @ torque_by_x)
            stiffness_by_x /= len(centred_Nm) * spread_Nm**2
        stiffness_by_x[column] = -stiffness / yielding
        row = int(np.argmax(np.abs(torque_Nm)))
        sag_rad = yielding * float(np.abs(torque_Nm[row])) / spring.tau_ref_Nm
        sag_by_x = yielding / spring.tau_ref_Nm * torque_by_x[row] * np.sign(torque_Nm[row])
        sag_by_x[column] = sag_rad / yielding
        return _Stiffness(
            Nm_rad=stiffness,
            u_Nm_rad=float(np.hypot(self._u(stiffness_by_x), stiffness * model.u_scale)),
            sag_rad=sag_rad,
            sag_u_rad=self._u(sag_by_x),
        )

    def _u(self, by_x: Array) -> float:
        """Return the standard uncertainty of what follows the parameters by a gradient (k,).

        It is the larger of those for independent poses and by stretches of time.
        """
        k = len(by_x)
        return float(np.sqrt(max(by_x @ cov[:k, :k] @ by_x for cov in self._covariances)))
