"""Loads and tool that the log states wrongly, found by logged torques; errors that these have.

Where effects are judged by blocks of poses, logged torques are no rows of the search: springs take
them from the log as they are, and a wrong load moves no pose. It shows in the torques alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from typing_extensions import override

from pa10cal.arm.description import weights_known
from pa10cal.arrays import Array, Index
from pa10cal.discovery.finding import Finding
from pa10cal.discovery.log_faults import DiagnosedFault, fault_of
from pa10cal.discovery.preparation import MeasurementSetup
from pa10cal.discovery.proof import Proof
from pa10cal.discovery.rules import NAMES, TORQUES
from pa10cal.discovery.verdict import Verdict, is_sought
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.loads import statics_of
from pa10cal.fit.logged_torques import errors_of_logs, robust_fit
from pa10cal.fit.uncertain_weights import weight_sizes
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.observations import Observations
from pa10cal.results.discovery import EvidenceByTorques
from pa10cal.rules import MASSES
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.joint import FalseTorque, FrictionTorque, TorqueGain
from pa10cal.terms.statement_faults import WeightStated, fault_candidates


def stated_wrongly(
    poses: Observations, baseline: FittedModel, setup: MeasurementSetup, context: CandidateContext
) -> tuple[DiagnosedFault, ...]:
    """Return the loads and tool that are stated wrongly, by forward selection."""
    faults = fault_candidates(context)
    if not faults or setup.payload is None or context.torques != "logged":
        return ()
    torques = _TorqueRows.of(poses, baseline, setup, faults)
    chosen: list[int] = []
    while others := [k for k in range(len(faults)) if k not in chosen]:
        best = max(others, key=lambda k: torques.gain(chosen, k, torques.both))
        if not torques.needs(chosen, best):
            break
        chosen.append(best)
    found = []
    for k in chosen:
        x, covariance, gain = torques.amounts(chosen, k)
        sizes, std = np.diag(faults[k].prior_factor), np.sqrt(np.diag(covariance))
        is_sure = np.any(np.abs(x) >= NAMES.statement_errors * std)
        if is_sure and np.abs(x).max() > TORQUES.least_sizes:
            found.append(fault_of(faults[k], x * sizes, covariance * np.outer(sizes, sizes), gain))
    return tuple(found)


class InTorques(EvidenceByTorques, Proof):
    """The statistics that decided about gain or friction of a log."""

    @property
    @override
    def evidence(self) -> EvidenceByTorques:
        return self


def with_errors_of_log(found: Verdict) -> Verdict:
    """Return a verdict that tells gains and friction which were taken out of its logged torques."""
    arm = found.baseline.arm
    by_log = weights_known(arm).by_log
    if not is_sought(found) or by_log is None:
        return found
    rated_Nm = arm.rated_Nm(np.abs(found.train.poses.states.tau_Nm).max(axis=0))
    findings = []
    for joint in np.flatnonzero(by_log.gain).tolist():
        gain, u_gain = float(by_log.gain[joint]), float(by_log.u_gain[joint])
        findings.append(_in_log(TorqueGain(f"joint {joint + 1}"), gain, u_gain, abs(gain)))
    for joint in np.flatnonzero(by_log.friction_Nm).tolist():
        tau_Nm, u_Nm = float(by_log.friction_Nm[joint]), float(by_log.u_friction_Nm[joint])
        effect = FrictionTorque(f"joint {joint + 1}", float(rated_Nm[joint]))
        findings.append(_in_log(effect, tau_Nm, u_Nm, tau_Nm / float(rated_Nm[joint])))
    return replace(found, in_log=tuple(findings)) if findings else found


def _in_log(effect: FalseTorque, amount: float, u_amount: float, of_rated: float) -> Finding:
    """Return an error of a log, of an amount with its standard uncertainty, as a finding."""
    proof = InTorques(standard_uncertainties=abs(amount) / u_amount, of_rated=of_rated)
    return Finding(
        effect=effect,
        x=np.array([amount]),
        covariance=np.array([[u_amount**2]]),
        alternatives=(),
        proof=proof,
    )


@dataclass(frozen=True)
class _TorqueRows:
    """Whitened rows of logged torques less those of the weights, as normal equations."""

    halves: tuple[Gaussian, Gaussian]  # of two random halves of the readings
    both: Gaussian
    nuisances: int  # number of columns for errors that any log may have; faults follow them
    columns_of: tuple[Index, ...]  # columns of each fault

    @classmethod
    def of(
        cls,
        poses: Observations,
        baseline: FittedModel,
        setup: MeasurementSetup,
        faults: Sequence[WeightStated],
    ) -> _TorqueRows:
        """Return the rows of poses, weighted by the scatter about a fit of all columns."""
        assert setup.payload is not None
        states, arm = poses.states, baseline.arm
        weights = statics_of(baseline.model, baseline.x, states, setup.payload)
        residual_Nm = states.tau_Nm - weights.joint_Nm
        rated_Nm = arm.rated_Nm(np.abs(weights.joint_Nm).max(axis=0))
        sizes = weight_sizes(arm, setup.payload).columns(arm)
        by_weights = weights.by_weights * sizes
        of_logs = errors_of_logs(weights.joint_Nm, rated_Nm, states.arrival)
        nuisances = np.concatenate([by_weights, of_logs], axis=2)
        of_faults = [fault.per_unit(states) @ fault.prior_factor for fault in faults]
        columns = np.concatenate([nuisances, *of_faults], axis=2)
        noise_Nm, x = robust_fit(columns, residual_Nm, TORQUES.reweighted, TORQUES.least_noise_Nm)
        # Residuals beyond the edge count as at the edge (Huber).
        edge_Nm = MASSES.edge * noise_Nm
        off_Nm = np.clip(residual_Nm - columns @ x, -edge_Nm, edge_Nm)
        white, data = columns / noise_Nm[:, None], (columns @ x + off_Nm) / noise_Nm
        # Loads and poses come in turn: random halves have a part of each.
        shuffled = np.random.default_rng(0).permutation(len(poses))
        first, second = (
            Gaussian.of(white[half], data[half]) for half in (shuffled[::2], shuffled[1::2])
        )
        count = nuisances.shape[2]
        stops = count + np.cumsum([0, *(own.shape[2] for own in of_faults)])
        columns_of = tuple(np.arange(*ends) for ends in pairwise(stops.tolist()))
        return cls((first, second), first + second, count, columns_of)

    def gain(self, chosen: Sequence[int], fault: int, rows: Gaussian) -> float:
        """Return the decrease of the sum of squares of some rows by a further fault."""
        return self._squares(chosen, rows) - self._squares([*chosen, fault], rows)

    def needs(self, chosen: Sequence[int], fault: int) -> bool:
        """Return whether the log evidence needs a further fault, and either half shows it."""
        lesser = min(self.gain(chosen, fault, half) for half in self.halves)
        _, covariance, _ = self.amounts([*chosen, fault], fault)
        nats = 0.5 * (self.gain(chosen, fault, self.both) + np.linalg.slogdet(covariance)[1])
        return bool(nats > TORQUES.fault_nats and lesser > TORQUES.half_squares)

    def amounts(self, chosen: Sequence[int], fault: int) -> tuple[Array, Array, float]:
        """Return a fault's amounts in its sizes, their covariance, and its share of the squares."""
        columns = self._columns(chosen)
        fitted, own = self.both.along(columns), np.isin(columns, self.columns_of[fault])
        without = self._squares([other for other in chosen if other != fault], self.both)
        # Logged torques may be exactly those calculated: nothing is left to explain.
        share = (without - fitted.residual_squares) / without if without > 0.0 else 0.0
        return fitted.mean[own], fitted.covariance[np.ix_(own, own)], share

    def _columns(self, chosen: Sequence[int]) -> Index:
        """Return the columns of nuisances and chosen faults."""
        return np.concatenate([np.arange(self.nuisances), *(self.columns_of[k] for k in chosen)])

    def _squares(self, chosen: Sequence[int], rows: Gaussian) -> float:
        """Return the sum of squares that chosen faults leave of some rows."""
        return rows.along(self._columns(chosen)).residual_squares
