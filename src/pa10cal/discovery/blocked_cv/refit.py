"""The calibrated model with effects fitted to a survey: all parameters, to all poses or to some.

`refit` is the non-linear fit, `one_step` an estimate by some of the poses, `PartialFits` the model
with some of the effects. All three solve the same problem (`_Problem`), which differs from that of
a calibration in two ways: the nuisances of the survey are subtracted, and maps of joint errors have
up to hundreds of parameters each, whose columns are sparse.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from pa10cal.arrays import Array, Index, Mask
from pa10cal.discovery import jacobians
from pa10cal.discovery.blocked_cv.normal_equations import in_map_bases, normal_equations_of
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.finding import is_named
from pa10cal.discovery.model_with_effects import (
    ModelWithEffects,
    bounds_of_unknowns,
    identifiable_base_motions,
    sizes_of_unknowns,
    with_base_motion,
    with_open_targets_held,
    with_unknowns,
)
from pa10cal.discovery.pose_scatter import AS_FOUND, PoseWeights, Widening, pose_weights
from pa10cal.discovery.tuning import COMPUTING
from pa10cal.fit.fitted import departures_hardly_known
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.numerics.least_squares import Bounds, Equations, Step, minimise
from pa10cal.numerics.periodic_spline import b_splines_by_knots, spline_columns
from pa10cal.numerics.posterior import posterior_covariance
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import is_error_map
from pa10cal.terms.term import Term


@dataclass(frozen=True, eq=False)
class Refit(ModelWithEffects):
    """The calibrated model with effects, all parameters fitted again."""

    covariance: Array  # (k, k) of all unknowns
    weights: PoseWeights  # of each pose in the fit


def refit(
    survey: Survey,
    effects: tuple[Effect, ...],
    starts: tuple[Array, ...],
    weights: PoseWeights,
    widening: Widening = AS_FOUND,
    start_from: FittedModel | None = None,
    most_steps: int = COMPUTING.refit_steps,
) -> Refit:
    """Fit the survey's baseline with effects to all its poses.

    Args:
        survey: the poses and the baseline.
        effects: what is added to the baseline.
        starts: parameters of each effect at which the fit starts.
        weights: of the poses at first; later they follow from the residuals.
        widening: scatter of the components in units of that by the median of their residuals.
        start_from: an earlier fit, with fewer effects, at which all else starts; None for the
            baseline.
        most_steps: largest number of steps.
    """
    baseline = survey.baseline
    before, base = baseline, np.zeros(6)
    if start_from is not None:
        before, base = start_from, start_from.x[-6:]
    x_start = np.concatenate([before.x[: len(baseline.x)], *starts, base, before.targets_m])
    problem = _Problem(survey, effects).expecting(x_start)
    weighting, bounds = _Weighting(problem, weights, widening), problem.bounds
    found = minimise(
        bounds.clip(x_start),
        weighting.equations,
        lambda x, step: bounds.clip(x + step),
        weighting.arrived,
        most_steps=most_steps,
        held=bounds.held,
        cost=weighting.cost,
        reweighted=weighting.renewed,
        no_worse=COMPUTING.refit_no_worse,
    )
    covariance = weighting.problem.covariance(found.at, found.equations)
    x = weighting.problem.with_open_targets_back(found.at, found.equations, covariance)
    return Refit(
        effects=effects,
        at=problem.model_at(x),
        converged=found.converged,
        iterations=found.iterations,
        covariance=covariance,
        weights=weighting.weights,
    )


def squares_left(survey: Survey, found: Refit, weights: PoseWeights) -> float:
    """Return the sum of squares of a fit by other weights of the poses, the prior included."""
    return _Problem(survey, found.effects).cost(found.x, weights)


class OneStep(NamedTuple):
    """Unknowns by some of the poses."""

    x: Array  # (k,)
    covariance: Array  # (k, k), zero of those held
    at_end: Mask  # (k,) which are held, or at an end of their range: not known


def one_step(survey: Survey, found: Refit, rows: Index) -> OneStep:
    """Return the unknowns and their covariance by some poses alone.

    By one Gauss-Newton step from the fit to all poses, with the weights of that fit. A step that
    leaves the range of an unknown ends there.
    """
    of_rows = replace(survey, poses=survey.poses.take(rows), block=survey.block[rows])
    weights = PoseWeights(found.weights.whitener[rows], found.weights.weight[rows])
    problem = _Problem(of_rows, found.effects).expecting(found.x)
    equations = problem.equations(found.x, weights)
    covariance = problem.covariance(found.x, equations)
    step = -covariance @ equations.gradient
    at_end = (np.diag(covariance) == 0.0) | (problem.bounds.beyond(found.x, step) != 0.0)
    return OneStep(problem.bounds.clip(found.x + step), covariance, at_end)


class _Problem:
    """Least squares of a survey's poses, for k unknowns in the order of `ModelWithEffects`.

    The prior is normal. The size expected of an effect is its plausible size, or how large it is at
    the unknowns from which the fit sets out if that is more (`expecting`); that of any other
    unknown is what physics allows (`sizes_of_unknowns`). Shapes of effects have no prior.
    """

    def __init__(self, survey: Survey, effects: tuple[Effect, ...]) -> None:
        self._survey, self._effects = survey, effects
        self._model = with_base_motion(survey.baseline, effects)
        self.measured, baseline = survey.poses.measured, survey.baseline
        self._base = slice(len(self._model.parameters) - 6, len(self._model.parameters))
        self._targets = slice(self._base.stop, self._base.stop + len(baseline.targets_m))
        self.bounds = bounds_of_unknowns(baseline, self._model, self.measured)
        self._usual_prior = self._precision()  # (k, k), of effects of plausible sizes
        self.prior = self._usual_prior  # (k, k) inverse covariance
        self.expected = np.zeros(len(self.prior))  # (k,) mean
        self.expected[: len(baseline.x)] = baseline.x
        self.expected[self._targets] = baseline.targets_m
        # Columns are computed in another order than that of the unknowns: maps come last.
        every = np.arange(len(self.prior))
        self._maps = [effect for effect in effects if is_error_map(effect)]
        self._dense_terms = [term for term in self._model.terms if not is_error_map(term)]
        of_dense = [every[self._model.columns_of(term)] for term in self._dense_terms]
        of_maps = [every[self._model.columns_of(term)] for term in self._maps]
        self.dense = np.concatenate([*of_dense, every[self._targets]])  # (d,) all but maps
        self._place = np.argsort(np.concatenate([self.dense, *of_maps]))  # (k,) of each unknown
        # the prior relates unknowns within these with each other, and with no others
        self.related = [
            slice(0, len(baseline.x)),
            *map(self._model.columns_of, effects),
            slice(self._base.start, len(self.prior)),
        ]
        self._at: tuple[Array, Array] | None = None  # the last unknowns, and the residual there

    def _precision(self) -> Array:
        """Return the precision of the prior, (k, k), of effects of plausible sizes."""
        baseline = self._survey.baseline
        sizes = sizes_of_unknowns(baseline, self._model, self.measured)
        departures = departures_hardly_known(baseline)
        parts = [np.diag(sizes[: len(baseline.x)] ** -2.0) + departures.T @ departures]
        for effect in self._effects:
            whitener = np.linalg.inv(effect.prior_factor)
            shapes = np.zeros((len(effect.parameters) - effect.linear,) * 2)
            parts.append(block_diag(whitener.T @ whitener, shapes))
        return np.asarray(block_diag(*parts, np.diag(sizes[self._base.start :] ** -2.0)))

    def expecting(self, x: Array) -> _Problem:
        """Return the problem with effects expected to be at least as large as at unknowns (k,).

        A plausible size is that of the joints of industrial arms: ten times as much is usual of
        small servos. It says which effects are likely, not how large one is that the poses show,
        whose amount would be pulled toward zero. An effect within its plausible size keeps it, and
        so do maps, whose prior makes them smooth, and effects with a shape: of a wind-up that
        saturates beyond all torques only the ratio of its two numbers shows, and both would grow.
        """
        prior = self._usual_prior.copy()
        for effect in filter(is_named, self._effects):
            at = self._model.columns_of(effect)
            if effect.linear < len(effect.parameters):
                continue
            size = effect.size(x[at][: effect.linear])
            prior[at, at] /= max(1.0, size) ** 2
        problem = copy(self)
        problem.prior = prior
        return problem

    def model_at(self, x: Array) -> FittedModel:
        """Return the model at unknowns (k,)."""
        x_model, targets_m = np.split(x, [self._base.stop])
        return replace(self._survey.baseline, model=self._model, x=x_model, targets_m=targets_m)

    def residual(self, x: Array) -> Array:
        """Return predicted minus measured components (P, b) at unknowns (k,), less nuisances.

        A step asks for it three times: for its cost, its weights and its equations.
        """
        if self._at is None or not np.array_equal(self._at[0], x):
            self._at = x.copy(), self._survey.net_residual(self.model_at(x))
        return self._at[1]

    def columns(self, x: Array, whiteners: Array) -> tuple[Array, Array]:
        """Return the derivative of the whitened residual at unknowns (k,).

        Returns:
            By the unknowns of `dense` (P, b, d), and by the angle of each map's joint (P, b, m).
        """
        at, poses = self.model_at(x), self._survey.poses
        joints = jacobians.joint_positions(at, [each.joint for each in self._maps])
        terms: list[Term] = [*self._dense_terms, joints]
        points = [*map(at.values_of, self._dense_terms), np.zeros(len(self._maps))]
        *of_terms, by_angle = jacobians.by_terms(at, poses, terms, points, whiteners)
        of_targets = whiteners @ at.compared(poses).by_targets
        return np.concatenate([*of_terms, of_targets], axis=2), by_angle

    def equations(self, x: Array, weights: PoseWeights) -> Equations:
        """Return cost, gradient and normal equations at unknowns (k,), the prior included."""
        whiteners = weights.whiteners()
        dense, by_angle = self.columns(x, whiteners)
        white = (whiteners @ self.residual(x)[:, :, None]).ravel()
        knots = [each.knots for each in self._maps]
        q_rad = self._survey.poses.states.q_rad[:, [each.joint - 1 for each in self._maps]]
        d = dense.shape[2]
        in_splines = normal_equations_of(
            white, dense.reshape(-1, d), spline_columns(by_angle, q_rad, knots)
        )
        rows = in_map_bases(in_splines, d, [b_splines_by_knots(each) for each in knots])
        rows = rows.along(self._place)
        off = x - self.expected
        cost = float(white @ white + off @ self.prior @ off)
        return Equations(cost, rows.projection + self.prior @ off, rows.gram + self.prior)

    def cost(self, x: Array, weights: PoseWeights) -> float:
        """Return the sum of squares at unknowns (k,), the prior included."""
        white, off = weights.whiteners() @ self.residual(x)[:, :, None], x - self.expected
        return float(np.sum(white**2) + off @ self.prior @ off)

    def covariance(self, x: Array, equations: Equations) -> Array:
        """Return the covariance (k, k) by the equations at unknowns (k,), zero of those held.

        Held are unknowns at a bound, and the base where readings do not show it. Coordinates of
        targets that the poses do not determine are held one by one.
        """
        free = self._free(x, equations)
        prior_variances = 1.0 / np.diag(self.prior)[self._targets]
        normal, prior = equations.normal, self.prior
        return with_open_targets_held(
            lambda free: inverse_of_free(normal, prior, free), free, prior_variances
        )

    def with_open_targets_back(self, x: Array, equations: Equations, covariance: Array) -> Array:
        """Return unknowns (k,) that fit as well, targets that nothing determines where they were.

        A fit of effects slides along such a direction, by millimetres for nothing: the height of
        the base, and of a flange, would be another with every effect that is tried. `covariance`
        (k, k) is that at the unknowns.
        """
        free, is_target = self._free(x, equations), np.zeros(len(x), dtype=bool)
        is_target[self._targets] = True
        open_ = np.flatnonzero(is_target & free & (np.diag(covariance) == 0.0))
        if not len(open_):
            return x
        whole = inverse_of_free(equations.normal, self.prior, free)
        off = np.linalg.solve(whole[np.ix_(open_, open_)], (x - self.expected)[open_])
        return self.bounds.clip(x - whole[:, open_] @ off)

    def _free(self, x: Array, equations: Equations) -> Mask:
        """Return which unknowns (k,) are free at unknowns: not at a bound, and shown."""
        free = ~self.bounds.held(x, equations.gradient)
        free[self._base] &= identifiable_base_motions(self.measured)
        return free


class _Weighting:
    """A problem and weights of its poses; weights and sizes are renewed after every step."""

    def __init__(self, problem: _Problem, weights: PoseWeights, widening: Widening) -> None:
        self.problem, self._widening = problem, widening
        self.weights = weights.widened(widening)
        self._variances = np.zeros(0)  # (k,) where the last step began

    def equations(self, x: Array) -> Equations:
        """Return the equations at unknowns (k,) by the present weights."""
        return self.problem.equations(x, self.weights)

    def cost(self, x: Array) -> float:
        """Return the sum of squares at unknowns (k,) by the present weights."""
        return self.problem.cost(x, self.weights)

    def renewed(self, x: Array, taken: Step) -> Equations:
        """Renew weights and expected sizes after a step; return the equations by these."""
        problem = self.problem
        self._variances, count = known_before(taken, problem.prior, problem.related)
        weights = pose_weights(problem.residual(x), count, problem.measured)
        self.weights = weights.widened(self._widening)
        self.problem = problem.expecting(x)
        return self.equations(x)

    def arrived(self, _: Array, taken: Step) -> bool:
        """Return whether the last step was short, in standard uncertainties, and not damped."""
        free = ~taken.held
        std = np.sqrt(np.maximum(self._variances[free], np.finfo(float).tiny))
        return (
            taken.damping < COMPUTING.refit_damping
            and float(np.abs(taken.step[free] / std).max()) < COMPUTING.refit_arrived
        )


def known_before(taken: Step, prior: Array, related: Sequence[slice]) -> tuple[Array, float]:
    """Return the variances (k,) of the unknowns where a step began, zero of those held.

    And how many the data determine: the others are as expected, or held.

    Args:
        taken: the step.
        prior: (k, k) precision of the prior, which the normal equations contain.
        related: the unknowns by parts, each of which the prior relates with no other.
    """
    free = ~taken.held
    if taken.factor is None:
        covariance = inverse_of_free(taken.before.normal, prior, free)
        variances, of_prior = np.diag(covariance), float(np.sum(prior * covariance))
    else:
        root = np.zeros((len(free), np.count_nonzero(free)))
        root[free] = taken.factor.inverse_root()
        variances = np.einsum("ij,ij->i", root, root)
        of_prior = sum(float(np.sum(prior[at, at] * (root[at] @ root[at].T))) for at in related)
    return variances, np.count_nonzero(variances) - of_prior


def inverse_of_free(normal: Array, prior: Array, free: Mask) -> Array:
    """Return the inverse (k, k) of the normal equations of free unknowns, zero for the others.

    The normal equations (k, k) contain the precision (k, k) of the prior.
    """
    # the shape of an effect whose amount is zero has no information
    free = free & (np.diag(normal) > 0.0)
    if free.all():
        return posterior_covariance(normal, prior)
    at = np.ix_(free, free)
    found = np.zeros_like(normal)
    found[at] = posterior_covariance(normal[at], prior[at])
    return found


class PartialFits:
    """The model with some of its effects: maps as they are, all else fitted again.

    Removing effects moves the model by millimetres, over which its derivative changes by a
    thousandth: the derivative at the model with all effects serves every step of every fit.
    """

    def __init__(self, survey: Survey, extended: Refit) -> None:
        """Linearise the model with all effects, in all but its maps."""
        self._extended = extended
        self._problem = _Problem(survey, extended.effects).expecting(extended.x)
        self._whiteners = extended.weights.whiteners()
        white, _ = self._problem.columns(extended.x, self._whiteners)
        flat = white.reshape(-1, white.shape[2])
        twice_white = np.swapaxes(self._whiteners, 1, 2) @ white
        self._by_residual = twice_white.reshape(flat.shape)  # gradient = residual @ by_residual
        self._gram = flat.T @ flat

    def model_with(self, some: tuple[Effect, ...]) -> FittedModel:
        """Return the model with some of its effects."""
        problem, x_start = self._problem, self._extended.x.copy()
        for effect in self._extended.effects:
            if effect not in some:
                x_start[self._amounts(effect)] = 0.0
        columns = np.flatnonzero(self._is_fitted(some)[problem.dense])  # of those of `dense`
        fitted = problem.dense[columns]
        bounds = Bounds(problem.bounds.lower[fitted], problem.bounds.upper[fitted])
        prior, expected = problem.prior[np.ix_(fitted, fitted)], problem.expected[fitted]
        normal = self._gram[np.ix_(columns, columns)] + prior

        def with_fitted(values: Array) -> Array:
            x = x_start.copy()
            x[fitted] = values
            return x

        def equations(values: Array) -> Equations:
            residual, off = problem.residual(with_fitted(values)), values - expected
            white = self._whiteners @ residual[:, :, None]
            cost = float(np.sum(white**2) + off @ prior @ off)
            gradient = (residual.ravel() @ self._by_residual)[columns] + prior @ off
            return Equations(cost, gradient, normal)

        found = minimise(
            bounds.clip(x_start[fitted]),
            equations,
            lambda values, step: bounds.clip(values + step),
            lambda _, taken: taken.gained <= COMPUTING.nearby_settled * taken.before.cost,
            most_steps=COMPUTING.nearby_steps,
            held=bounds.held,
            beyond=bounds.beyond,
        )
        at = with_unknowns(self._extended.at, with_fitted(found.at))
        return replace(self._extended, at=at).fitted()

    def _amounts(self, effect: Effect) -> slice:
        """Return the columns of the linear parameters of an effect."""
        first = self._extended.columns_of(effect).start
        return slice(first, first + effect.linear)

    def _is_fitted(self, some: tuple[Effect, ...]) -> Mask:
        """Return which unknowns (k,) are fitted: no maps, no shapes, no effects but some."""
        fitted = np.ones(len(self._extended.x), dtype=bool)
        for effect in self._extended.effects:
            fitted[self._extended.columns_of(effect)] = False
            if effect in some and not is_error_map(effect):
                fitted[self._amounts(effect)] = True
        return fitted
