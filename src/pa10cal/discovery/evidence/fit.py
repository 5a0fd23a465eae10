"""The non-linear fit of the model with some effects, under the noise models of the evidence."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arrays import Array, Mask
from pa10cal.discovery import jacobians
from pa10cal.discovery.evidence.noise_model import SharedVariances
from pa10cal.discovery.evidence.problem import EvidenceProblem
from pa10cal.discovery.model_with_effects import (
    ModelWithEffects,
    all_unknowns,
    bounds_of_unknowns,
    held_unknowns,
    sizes_of_unknowns,
    with_base_motion,
    with_open_targets_held,
    with_unknowns,
)
from pa10cal.discovery.rules import EVIDENCE
from pa10cal.discovery.tuning import COMPUTING
from pa10cal.fit.fitted import departures_hardly_known
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.numerics.least_squares import Equations, minimise
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.term import shows_torque


@dataclass(frozen=True, eq=False)
class EvidenceFit(ModelWithEffects):
    """The calibrated model with effects, fitted under the noise models of the evidence."""

    sizes: tuple[int, ...]  # index in `EVIDENCE.sizes` of the size expected of each effect
    variances: SharedVariances  # as assumed in the fit

    @property
    def size_of(self) -> dict[Effect, int]:
        """Return the index in `EVIDENCE.sizes` of the size expected of each effect."""
        return dict(zip(self.effects, self.sizes, strict=True))


def fit(
    problem: EvidenceProblem,
    effects: tuple[Effect, ...],
    sizes: tuple[int, ...],
    variances: SharedVariances,
    start: EvidenceFit | None = None,
    most_steps: int = COMPUTING.fit_steps,
) -> EvidenceFit:
    """Fit the model with some effects, from every shape of those that have several.

    Args:
        problem: the campaign.
        effects: what is added to the calibrated model.
        sizes: index in `EVIDENCE.sizes` of the size expected of each effect.
        variances: those of the shared errors.
        start: the fit at which this one starts; None for the baseline.
        most_steps: largest number of steps.

    Returns:
        The fit with the least cost.
    """
    baseline, first = problem.baseline, len(problem.baseline.x)
    model = replace(with_base_motion(baseline, effects), derivative_cache=problem.derivative_cache)
    bounds = bounds_of_unknowns(baseline, model, problem.cells.measured)
    own = np.concatenate([baseline.x, np.zeros(6), baseline.targets_m])
    known: dict[Effect, Array] = {}
    if start is not None:
        own = start.x[start.baseline_columns()]
        known = {effect: start.at.values_of(effect) for effect in start.effects}
    # An effect of the start keeps its shape: only those that join have several.
    shapes = max((len(effect.starts) for effect in effects if effect not in known), default=1)
    best: tuple[float, EvidenceFit] | None = None
    for shape in range(shapes):
        parts = [
            known[effect] if effect in known else effect.starts[min(shape, len(effect.starts) - 1)]
            for effect in effects
        ]
        x_start = np.concatenate([own[:first], *parts, own[first:]])
        x, targets_m = np.split(x_start, [len(model.parameters)])
        at = replace(baseline, model=model, x=x, targets_m=targets_m)
        rows = _FitRows(problem, effects, sizes, variances, at)
        found = minimise(
            bounds.clip(x_start),
            rows.equations,
            lambda x, step: bounds.clip(x + step),
            lambda _, taken: (
                taken.gained <= COMPUTING.fit_precision * (1.0 + taken.before.cost - taken.gained)
            ),
            most_steps=most_steps,
            held=bounds.held,
            beyond=bounds.beyond,
            cost=rows.cost,
            first_damping=COMPUTING.fit_damping,
        )
        if best is None or found.equations.cost < best[0]:
            fitted = EvidenceFit(
                effects=effects,
                at=with_unknowns(at, found.at),
                converged=found.converged,
                iterations=found.iterations,
                sizes=sizes,
                variances=variances,
            )
            best = found.equations.cost, fitted
    assert best is not None
    return best[1]


def covariance_of(problem: EvidenceProblem, found: EvidenceFit) -> Array:
    """Return the covariance (k, k) of all parameters, by the data and the expected sizes.

    Zero of the base where readings do not show it, and of what fits hold.
    """
    rows = _FitRows(problem, found.effects, found.sizes, found.variances, found.at)
    measured = problem.cells.measured
    free = ~held_unknowns(problem.baseline, found.at.model, measured)
    information = rows.equations(found.x).normal
    size = 1.0 / np.sqrt(np.diag(information))
    scales = np.outer(size, size)

    def covariance_by(free: Mask) -> Array:
        of_free = np.ix_(free, free)
        covariance = np.zeros((len(free), len(free)))
        covariance[of_free] = np.linalg.inv((information * scales)[of_free]) * scales[of_free]
        return covariance

    sizes = sizes_of_unknowns(problem.baseline, found.at.model, measured)
    return with_open_targets_held(covariance_by, free, sizes[len(found.at.x) :] ** 2)


def targets_off_m(problem: EvidenceProblem, found: EvidenceFit) -> Array:
    """Return the errors of the targets' stated places on the apparatus, (a,) [m].

    They are common to all poses. The fit integrates them out; here they are estimated from its
    residuals.
    """
    rows = problem.pose.noise_whitened(found.at.compared(problem.cells).residual[:, :, None])
    units = problem.pose.common_amounts(rows, found.variances.pose)[:, 0]
    stated = problem.cells.measured.by_stated_targets.shape[2]  # other common errors follow
    return np.asarray(-problem.setup.apparatus_m * units[:stated], dtype=np.float64)


class _FitRows:
    """Rows of the fit: whitened poses and torques, and the prior of every parameter."""

    def __init__(
        self,
        problem: EvidenceProblem,
        effects: tuple[Effect, ...],
        sizes: tuple[int, ...],
        variances: SharedVariances,
        at: FittedModel,
    ) -> None:
        self._problem, self._at, self._variances = problem, at, variances
        self._torque = problem.torque if any(map(shows_torque, effects)) else None
        possible = sizes_of_unknowns(problem.baseline, at.model, problem.cells.measured)
        prior_rows = np.diag(1.0 / possible)
        # The prior mean is that of tool and targets as calibrated, of the shape of an effect where
        # it starts (with an amount of zero the data do not determine it, and its first step would
        # end at a bound), and zero of all else.
        x_start, baseline = all_unknowns(at), problem.baseline
        of_tool = baseline.model.having("tool")
        mean = np.zeros(len(x_start))
        mean[: len(of_tool)] = np.where(of_tool, baseline.x, 0.0)
        mean[len(at.x) :] = baseline.targets_m
        for effect, size in zip(effects, sizes, strict=True):
            at_effect = at.model.columns_of(effect)
            amounts = slice(at_effect.start, at_effect.start + effect.linear)
            prior_rows[amounts, amounts] = np.linalg.inv(EVIDENCE.sizes[size] * effect.prior_factor)
            mean[amounts.stop : at_effect.stop] = x_start[amounts.stop : at_effect.stop]
        departures = departures_hardly_known(baseline)
        unusual = np.zeros((len(departures), len(mean)))
        unusual[:, : len(baseline.x)] = departures
        self._prior_rows, self._prior_mean = np.concatenate([prior_rows, unusual]), mean
        self._last_x: Array | None = None

    def _evaluate(self, x: Array) -> None:
        """Compute the residuals of poses at parameters, once for cost and equations."""
        if self._last_x is not x:
            self._last_x, self._at = x, with_unknowns(self._at, x)
            self._residual, self._jacobian = jacobians.residual_and_lazy_jacobian(
                self._at, self._problem.cells
            )

    def cost(self, x: Array) -> float:
        """Return the sum of squares at parameters (k,), without derivatives."""
        self._evaluate(x)
        problem, off = self._problem, self._prior_rows @ (x - self._prior_mean)[:, None]
        rows = [problem.pose.whitened(self._residual[:, :, None], self._variances.pose)]
        if self._torque is not None:
            torque_Nm = torque_residual_Nm(problem, self._at)
            rows.append(self._torque.whitened(torque_Nm[:, :, None], self._variances.torque))
        return float(sum(np.sum(part**2) for part in (*rows, off)))

    def equations(self, x: Array) -> Equations:
        """Return cost, gradient and normal equations at parameters (k,)."""
        self._evaluate(x)
        problem, off = self._problem, self._prior_rows @ (x - self._prior_mean)
        of_pose = np.concatenate([self._residual[:, :, None], self._jacobian()], axis=2)
        rows = [problem.pose.whitened(of_pose, self._variances.pose)]
        if self._torque is not None:
            rows.append(
                self._torque.whitened(torque_rows(problem, self._at), self._variances.torque)
            )
        rows.append(np.concatenate([off[:, None], self._prior_rows], axis=1))
        every = np.concatenate(rows)
        return Equations.of(every[:, 0], every[:, 1:])


def pose_rows(problem: EvidenceProblem, at: FittedModel) -> Array:
    """Return predicted minus measured and its derivative side by side, (C, b, 1 + k + t)."""
    difference, jacobian = jacobians.residual_and_jacobian(at, problem.cells)
    return np.concatenate([difference[:, :, None], jacobian], axis=2)


def torque_rows(problem: EvidenceProblem, at: FittedModel) -> Array:
    """Return predicted minus logged torque and its derivative side by side, (C, n, 1 + k + t)."""
    states, model = problem.cells.states, at.model
    difference_Nm = torque_residual_Nm(problem, at)
    by_targets = np.zeros((*difference_Nm.shape, len(at.targets_m)))
    return np.concatenate(
        [difference_Nm[:, :, None], model.torque_jacobian(states, at.x), by_targets], axis=2
    )


def torque_residual_Nm(problem: EvidenceProblem, at: FittedModel) -> Array:
    """Return predicted minus logged torque, (C, n)."""
    return at.model.torque_Nm(problem.cells.states, at.x) - problem.torque_without_weights_Nm
