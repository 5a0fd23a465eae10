"""The full non-linear fit of the model with some effects, weighed as the evidence weighs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arrays import Array
from pa10cal.discovery.evidence.likelihood import SIZES
from pa10cal.discovery.evidence.problem import EvidenceProblem
from pa10cal.discovery.linear import (
    ModelWithEffects,
    at_unknowns,
    possible_sizes,
    residual,
    residual_and_jacobian,
    residual_then_jacobian,
    unknowns,
    with_base_term,
)
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.numerics.least_squares import Bounds, Equations, minimise
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.term import shows_torque

#: A step that lowers the sum of squares by less than this part is the last.
_PRECISION = 1e-8
_MOST_STEPS = 50
_FIRST_DAMPING = 1e-6


@dataclass(frozen=True, eq=False)
class EvidenceFit(ModelWithEffects):
    """The calibrated model with effects, fitted as the evidence weighs."""

    sizes: tuple[int, ...]  # index in `likelihood.SIZES` of the size expected of each effect
    # pose_variance and torque_variance: shared errors by which it was weighed
    pose_variance: float
    torque_variance: float

    @property
    def size_of(self) -> dict[Effect, int]:
        """Return the index of the size expected of each effect."""
        return dict(zip(self.effects, self.sizes, strict=True))

    @property
    def variances(self) -> tuple[float, float]:
        """Return both variances."""
        return self.pose_variance, self.torque_variance


def fit(
    problem: EvidenceProblem,
    effects: tuple[Effect, ...],
    sizes: tuple[int, ...],
    variances: tuple[float, float],
    start: EvidenceFit | None = None,
) -> EvidenceFit:
    """Fit the model with some effects; from several shapes where an effect has them, the best.

    Each effect has the index of the size expected of it; variances are those of the shared errors
    of poses and of torques. It sets out from another fit, or from the baseline.
    """
    baseline, first = problem.baseline, len(problem.baseline.x)
    model = replace(with_base_term(baseline, effects), kept=problem.kept)
    targets = problem.cells.measured.target_parameters[: len(baseline.targets_m)]
    bounds = Bounds.of((*model.parameters, *targets))
    own = np.concatenate([baseline.x, np.zeros(6), baseline.targets_m])
    known: dict[Effect, Array] = {}
    if start is not None:
        own, known = start.x[start.own_columns()], {e: start.of(e) for e in start.effects}
    # An effect that the start has keeps its shape: only those that join have shapes to try.
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
        weighed = _Weighed(problem, effects, sizes, variances, at)
        found = minimise(
            bounds.clip(x_start),
            weighed.equations,
            lambda x, step: bounds.clip(x + step),
            lambda _, taken: taken.gained <= _PRECISION * (1.0 + taken.before.cost - taken.gained),
            most_steps=_MOST_STEPS,
            held=bounds.held,
            beyond=bounds.beyond,
            cost=weighed.cost,
            first_damping=_FIRST_DAMPING,
        )
        if best is None or found.equations.cost < best[0]:
            fitted = EvidenceFit(
                effects, at_unknowns(at, found.at), found.converged, sizes, *variances
            )
            best = found.equations.cost, fitted
    assert best is not None
    return best[1]


def covariance_of(problem: EvidenceProblem, found: EvidenceFit) -> Array:
    """Return the covariance (k, k) that data and expected sizes leave of all parameters."""
    weighed = _Weighed(problem, found.effects, found.sizes, found.variances, found.at)
    information = weighed.equations(found.x).normal
    size = 1.0 / np.sqrt(np.diag(information))
    inverse: Array = np.linalg.inv(information * np.outer(size, size)) * np.outer(size, size)
    return inverse


def apparatus_m(problem: EvidenceProblem, found: EvidenceFit) -> Array:
    """Return the fitted positions of the targets on the apparatus, (a,) [m].

    They are integrated out in the fit, and are known best once it is done: the error of their
    places that the poses all share.
    """
    left = problem.pose.rows(residual(found.at, problem.cells)[:, :, None])
    units = problem.pose.common_amounts(left, found.pose_variance)[:, 0]
    stated = problem.cells.measured.by_stated_targets.shape[2]  # what else is common follows
    return np.asarray(-problem.setup.apparatus_m * units[:stated], dtype=np.float64)


class _Weighed:
    """Rows of the fit: weighed poses and torques, and what is expected of every parameter."""

    def __init__(
        self,
        problem: EvidenceProblem,
        effects: tuple[Effect, ...],
        sizes: tuple[int, ...],
        variances: tuple[float, float],
        at: FittedModel,
    ) -> None:
        self._problem, self._at, self._variances = problem, at, variances
        self._torque = problem.torque if any(map(shows_torque, effects)) else None
        possible = possible_sizes(at.model, problem.cells.measured)
        rows = np.diag(1.0 / possible)
        # Zero of an effect does not determine its shape: zero, the middle of what is expected
        # of all else, would draw the shape to the end of its range at the first step.
        # Tool and targets are about as calibrated, all else about zero.
        x_start, baseline = unknowns(at), problem.baseline
        of_tool = [p.name.startswith("tool") for p in baseline.model.parameters]
        middle = np.zeros(len(x_start))
        middle[: len(of_tool)] = np.where(of_tool, baseline.x, 0.0)
        middle[len(at.x) :] = baseline.targets_m
        for effect, size in zip(effects, sizes, strict=True):
            at_effect = at.model.columns_of(effect)
            linear = slice(at_effect.start, at_effect.start + effect.linear)
            rows[linear, linear] = np.linalg.inv(SIZES[size] * effect.prior_factor)
            middle[linear.stop : at_effect.stop] = x_start[linear.stop : at_effect.stop]
        self._expected, self._middle = rows, middle
        self._last_x: Array | None = None

    def _look_at(self, x: Array) -> None:
        """Find what the model leaves of poses at parameters, once for cost and equations."""
        if self._last_x is not x:
            self._last_x, self._at = x, at_unknowns(self._at, x)
            self._left, self._jacobian = residual_then_jacobian(self._at, self._problem.cells)

    def cost(self, x: Array) -> float:
        """Return the sum of squares at parameters (k,): all that a step uphill needs."""
        self._look_at(x)
        problem, off = self._problem, self._expected @ (x - self._middle)[:, None]
        rows = [problem.pose.weighed(self._left[:, :, None], self._variances[0])]
        if self._torque is not None:
            left_Nm = torque_left(problem, self._at)
            rows.append(self._torque.weighed(left_Nm[:, :, None], self._variances[1]))
        return float(sum(np.sum(part**2) for part in (*rows, off)))

    def equations(self, x: Array) -> Equations:
        """Return the problem at parameters (k,): rows (R,) and their derivative (R, k)."""
        self._look_at(x)
        problem, off = self._problem, self._expected @ (x - self._middle)
        of_pose = np.concatenate([self._left[:, :, None], self._jacobian()], axis=2)
        rows = [problem.pose.weighed(of_pose, self._variances[0])]
        if self._torque is not None:
            rows.append(self._torque.weighed(torque_rows(problem, self._at), self._variances[1]))
        rows.append(np.concatenate([off[:, None], self._expected], axis=1))
        everything = np.concatenate(rows)
        return Equations.of(everything[:, 0], everything[:, 1:])


def pose_rows(problem: EvidenceProblem, at: FittedModel) -> Array:
    """Return predicted minus measured and its derivative side by side, (C, b, 1 + k + t)."""
    left, jacobian = residual_and_jacobian(at, problem.cells)
    return np.concatenate([left[:, :, None], jacobian], axis=2)


def torque_rows(problem: EvidenceProblem, at: FittedModel) -> Array:
    """Return predicted minus logged torque and its derivative side by side, (C, n, 1 + k + t)."""
    states, model = problem.cells.states, at.model
    left = torque_left(problem, at)
    by_targets = np.zeros((*left.shape, len(at.targets_m)))
    return np.concatenate(
        [left[:, :, None], model.torque_jacobian(states, at.x), by_targets], axis=2
    )


def torque_left(problem: EvidenceProblem, at: FittedModel) -> Array:
    """Return predicted minus logged torque, (C, n)."""
    return at.model.torque_Nm(problem.cells.states, at.x) - problem.torque_left_Nm
