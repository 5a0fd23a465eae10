"""The full non-linear fit of the model with some effects, weighed as the evidence weighs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pa10cal.arrays import Array
from pa10cal.discovery.evidence.likelihood import SIZES
from pa10cal.discovery.evidence.problem import Problem
from pa10cal.discovery.linear import (
    ModelWithEffects,
    at_unknowns,
    possible_sizes,
    residual_and_jacobian,
    residual_then_jacobian,
    unknowns,
    with_base_term,
)
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.numerics.least_squares import Bounds, Equations, minimise
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.model import Model
from pa10cal.terms.term import shows_torque

#: A step that lowers the sum of squares by less than this part is the last.
_PRECISION = 1e-8
_MOST_STEPS = 50
_FIRST_DAMPING = 1e-6


@dataclass(frozen=True, eq=False)
class Fit(ModelWithEffects):
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
    problem: Problem,
    effects: tuple[Effect, ...],
    sizes: tuple[int, ...],
    variances: tuple[float, float],
    start: Fit | None = None,
) -> Fit:
    """Fit the model with some effects; from several shapes where an effect has them, the best.

    Args:
        problem: the campaign.
        effects: what to add to the baseline.
        sizes: index of the size expected of each.
        variances: of the shared errors of poses and of torques.
        start: a fit to set out from; the baseline where None.
    """
    # An effect that the start has keeps its shape: only those that join have shapes to try.
    joining = [effect for effect in effects if start is None or effect not in start.effects]
    tried = [
        _fit_from(problem, effects, sizes, variances, start, shape)
        for shape in range(max((len(effect.starts) for effect in joining), default=1))
    ]
    return min(tried, key=lambda found: found[1])[0]


def _fit_from(
    problem: Problem,
    effects: tuple[Effect, ...],
    sizes: tuple[int, ...],
    variances: tuple[float, float],
    start: Fit | None,
    shape: int,
) -> tuple[Fit, float]:
    model = replace(with_base_term(problem.baseline, effects), kept=problem.kept)
    x_start = _start(problem, effects, start, shape)
    at = at_unknowns(
        replace(problem.baseline, model=model, x=np.zeros(len(model.parameters))), x_start
    )
    weighed = _Weighed(problem, effects, sizes, variances, at)
    targets = problem.cells.measured.target_parameters[: len(problem.baseline.targets_m)]
    bounds = Bounds.of((*model.parameters, *targets))
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
    fitted = Fit(effects, at_unknowns(at, found.at), found.converged, sizes, *variances)
    return fitted, found.equations.cost


def covariance_of(problem: Problem, found: Fit) -> Array:
    """Return the covariance (k, k) that data and expected sizes leave of all parameters."""
    weighed = _Weighed(problem, found.effects, found.sizes, found.variances, found.at)
    information = weighed.equations(found.x).normal
    size = 1.0 / np.sqrt(np.diag(information))
    inverse: Array = np.linalg.inv(information * np.outer(size, size)) * np.outer(size, size)
    return inverse


def apparatus_m(problem: Problem, found: Fit) -> Array:
    """Return the fitted positions of the targets on the apparatus, (a,) [m].

    They are integrated out in the fit, and are known best once it is done: the error of their
    places that the poses all share.
    """
    u_m = problem.setup.apparatus_m
    scale = problem.pose.whitening(found.pose_variance).scale[:, None]
    common = scale * problem.pose.common
    left = scale * problem.pose.rows(pose_rows(problem, found.at)[:, :, :1])
    information = common.T @ common + np.eye(common.shape[1])
    units = np.linalg.solve(information, common.T @ left)[:, 0]
    stated = problem.cells.measured.by_stated_targets.shape[2]  # what else is common follows
    return np.asarray(-u_m * units[:stated], dtype=np.float64)


def _start(problem: Problem, effects: tuple[Effect, ...], start: Fit | None, shape: int) -> Array:
    """Return where to set out: what is known of shared parameters, else zero in some shape."""
    baseline = problem.baseline
    own = (
        np.concatenate([baseline.x, np.zeros(6), baseline.targets_m])
        if start is None
        else (start.x[start.own_columns()])
    )
    parts = []
    for effect in effects:
        if start is not None and effect in start.effects:
            parts.append(start.of(effect))
        else:
            parts.append(effect.starts[min(shape, len(effect.starts) - 1)])
    first = len(baseline.x)
    return np.concatenate([own[:first], *parts, own[first:]])


class _Left(NamedTuple):
    """A model, what it leaves of the poses (C, b), and what gives the derivative of that."""

    at: FittedModel
    pose: Array
    jacobian: Callable[[], Array]


class _Weighed:
    """Rows of the fit: weighed poses and torques, and what is expected of every parameter."""

    def __init__(
        self,
        problem: Problem,
        effects: tuple[Effect, ...],
        sizes: tuple[int, ...],
        variances: tuple[float, float],
        at: FittedModel,
    ) -> None:
        self._problem, self._at = problem, at
        self._pose = problem.pose.whitening(variances[0])
        shows = any(shows_torque(effect) for effect in effects)
        self._torque = (
            problem.torque.whitening(variances[1]) if problem.torque is not None and shows else None
        )
        possible = possible_sizes(at.model, problem.cells.measured)
        rows = np.diag(1.0 / possible)
        # Zero of an effect does not determine its shape: zero, the middle of what is expected
        # of all else, would draw the shape to the end of its range at the first step.
        x_start, middle = unknowns(at), expected_middle(problem, at.model)
        for effect, size in zip(effects, sizes, strict=True):
            at_effect = at.model.columns_of(effect)
            linear = slice(at_effect.start, at_effect.start + effect.linear)
            rows[linear, linear] = np.linalg.inv(SIZES[size] * effect.prior_factor)
            middle[linear.stop : at_effect.stop] = x_start[linear.stop : at_effect.stop]
        self._expected, self._middle = rows, middle
        self._looked_at: tuple[Array, _Left] | None = None

    def cost(self, x: Array) -> float:
        """Return the sum of squares at parameters (k,): all that a step uphill needs."""
        left = self._left_at(x)
        rows = [self._pose(self._problem.pose.rows(left.pose[:, :, None]))]
        if self._problem.torque is not None and self._torque is not None:
            torque = torque_left(self._problem, left.at)
            rows.append(self._torque(self._problem.torque.rows(torque[:, :, None])))
        rows.append(self._expected @ (x - self._middle)[:, None])
        return float(sum(np.sum(part**2) for part in rows))

    def equations(self, x: Array) -> Equations:
        """Return the problem at parameters (k,)."""
        return Equations.of(*self._rows(x))

    def _rows(self, x: Array) -> tuple[Array, Array]:
        """Return rows (R,) and their derivative (R, k)."""
        problem, left = self._problem, self._left_at(x)
        at, of_pose = left.at, np.concatenate([left.pose[:, :, None], left.jacobian()], axis=2)
        weighed = [self._pose(problem.pose.rows(of_pose))]
        if problem.torque is not None and self._torque is not None:
            weighed.append(self._torque(problem.torque.rows(torque_rows(problem, at))))
        off = self._expected @ (x - self._middle)
        own = np.concatenate([off[:, None], self._expected], axis=1)
        everything = np.concatenate([*weighed, own])
        return everything[:, 0], everything[:, 1:]

    def _left_at(self, x: Array) -> _Left:
        """Return what the model leaves at parameters, kept for the next question of the same."""
        if self._looked_at is None or self._looked_at[0] is not x:
            at = at_unknowns(self._at, x)
            self._looked_at = x, _Left(at, *residual_then_jacobian(at, self._problem.cells))
        return self._looked_at[1]


def pose_rows(problem: Problem, at: FittedModel) -> Array:
    """Return predicted minus measured and its derivative side by side, (C, b, 1 + k + t)."""
    left, jacobian = residual_and_jacobian(at, problem.cells)
    return np.concatenate([left[:, :, None], jacobian], axis=2)


def torque_rows(problem: Problem, at: FittedModel) -> Array:
    """Return predicted minus logged torque and its derivative side by side, (C, n, 1 + k + t)."""
    states, model = problem.cells.states, at.model
    left = torque_left(problem, at)
    by_targets = np.zeros((*left.shape, len(at.targets_m)))
    return np.concatenate(
        [left[:, :, None], model.torque_jacobian(states, at.x), by_targets], axis=2
    )


def torque_left(problem: Problem, at: FittedModel) -> Array:
    """Return predicted minus logged torque, (C, n)."""
    return at.model.torque_Nm(problem.cells.states, at.x) - problem.torque_left_Nm


def expected_middle(problem: Problem, model: Model) -> Array:
    """Return what is expected of every unknown, (k + t,): tool and targets are about as calibrated.

    All else is expected to be about zero.
    """
    baseline = problem.baseline
    middle = np.zeros(len(model.parameters))
    for k, parameter in enumerate(baseline.model.parameters):
        if parameter.name.startswith("tool"):
            middle[k] = baseline.x[k]
    return np.concatenate([middle, baseline.targets_m])
