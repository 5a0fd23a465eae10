"""The non-linear fit of model and effects to a survey: weighted, robust, with sparse maps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeGuard

import numpy as np
from scipy.linalg import block_diag
from scipy.linalg.lapack import dpotrf, dpotri

from pa10cal.arrays import Array, Index, Mask
from pa10cal.calibration.general.calibrate import shown
from pa10cal.discovery import linear
from pa10cal.discovery.blocked_cv.normal_equations import (
    in_map_bases,
    map_columns,
    no_wider_than,
    normal_equations_of,
)
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.noise import AS_FOUND, PoseWeights, Widening, pose_weights
from pa10cal.discovery.other_numbers import COMPUTING
from pa10cal.discovery.rules import BLOCKS
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.problem import possible_sizes
from pa10cal.fit.validity import AngleCoverage, angles_seen
from pa10cal.numerics.least_squares import Bounds, Equations, Step, minimise
from pa10cal.numerics.periodic_spline import b_splines_by_knots
from pa10cal.options import Tolerances
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import is_error_map
from pa10cal.terms.model import Model
from pa10cal.terms.term import Offsets, Term, link_departures


@dataclass(frozen=True, eq=False)
class Refit(linear.ModelWithEffects):
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
    """
    fit, baseline = _NormalFit(survey, effects), survey.baseline
    base, at = (np.zeros(6), baseline) if start_from is None else (start_from.x[-6:], start_from)
    x = np.concatenate([at.x[: len(baseline.x)], *starts, base, at.targets_m])
    bounds, counts = fit.bounds, weights.widened(widening)
    # covariance at the start of the last step; `minimise` calls `reweighted` first
    before = np.zeros((0, 0))

    def reweighted(x: Array, taken: Step) -> Equations:
        nonlocal counts, before
        before = _inverse(taken.before.normal, fit.prior, ~taken.held)
        residual = survey.net_residual(fit.model_at(x))
        found = pose_weights(residual, determined_count(before, fit.prior), survey.poses.measured)
        counts = found.widened(widening)
        return fit.equations(x, counts)

    def arrived(_: Array, taken: Step) -> bool:
        free = ~taken.held
        std = np.sqrt(np.maximum(np.diag(before)[free], np.finfo(float).tiny))
        return (
            taken.damping < COMPUTING.refit_damping
            and float(np.abs(taken.step[free] / std).max()) < COMPUTING.refit_arrived
        )

    found = minimise(
        bounds.clip(x),
        lambda x: fit.equations(x, counts),
        lambda x, step: bounds.clip(x + step),
        arrived,
        most_steps=COMPUTING.refit_steps,
        held=bounds.held,
        cost=lambda x: fit.cost(x, counts),
        reweighted=reweighted,
        no_worse=COMPUTING.refit_no_worse,
    )
    held = bounds.held(found.at, found.equations.gradient)
    covariance = fit.covariance(found.equations.normal, ~held)
    return Refit(effects, fit.model_at(found.at), found.converged, covariance, counts)


def one_step(survey: Survey, found: Refit, rows: Index) -> tuple[Array, Array]:
    """Return unknowns (k,) and their covariance by some poses alone.

    By one Gauss-Newton step from the fit to all poses.
    """
    fewer = replace(survey, poses=survey.poses.take(rows), block=survey.block[rows])
    weights = PoseWeights(found.weights.whitener[rows], found.weights.weight[rows])
    fit = _NormalFit(fewer, found.effects)
    equations = fit.equations(found.x, weights)
    held = fit.bounds.held(found.x, equations.gradient)
    covariance = fit.covariance(equations.normal, ~held)
    return found.x - covariance @ equations.gradient, covariance


def with_tilts_shown(survey: Survey, found: Refit) -> FittedModel | None:
    """Return the survey's baseline with tilts of parallel axes, if a fit with effects shows them.

    A calibration without effects may leave these tilts at zero, as an effect that it lacks hides
    them. None where the baseline has them already or they are not shown.
    """
    baseline, measured = survey.baseline, survey.poses.measured
    links = next((term for term in baseline.model.terms if _of_links(term)), None)
    if links is None:
        return None
    identified = linear.chosen_unknowns(baseline, measured).links
    roles = {
        each.name: role for each, role in zip(identified.parameters, identified.roles, strict=True)
    }
    tilts = {name for name, role in roles.items() if role == "tilt"}
    if not tilts or roles.keys() - {each.name for each in links.parameters} != tilts:
        return None
    tilted = _with_parameters(baseline, links, identified.only(tilts))
    starts = tuple(map(found.of, found.effects))
    fitted = refit(replace(survey, baseline=tilted), found.effects, starts, found.weights)
    at = [k for k, each in enumerate(tilted.model.parameters) if each.name in tilts]
    covariance = fitted.covariance[np.ix_(at, at)]
    readings = int(measured.components_seen.sum())
    return tilted if shown(fitted.x[at], covariance, readings) else None


def _of_links(term: Term) -> TypeGuard[Offsets]:
    return term.of == "links" and isinstance(term, Offsets)


def _with_parameters(baseline: FittedModel, links: Offsets, added: Offsets) -> FittedModel:
    """Return a model whose links have further parameters, at zero, in the order of the links.

    Its own stay, also those that the instrument does not identify, as of another one's model.
    """
    order = link_departures(baseline.arm, Tolerances()).coordinates
    own = zip(links.coordinates, links.parameters, baseline.values_of(links), strict=True)
    new = zip(added.coordinates, added.parameters, np.zeros(len(added.parameters)), strict=True)
    coordinates, parameters, values = zip(
        *sorted((*own, *new), key=lambda each: order.index(each[0])), strict=True
    )
    wider = replace(links, coordinates=coordinates, parameters=parameters)
    terms = tuple(wider if term is links else term for term in baseline.model.terms)
    x = [values if term is links else baseline.values_of(term) for term in baseline.model.terms]
    model = Model(baseline.model.chain, terms)
    return replace(baseline, model=model, x=np.concatenate(x), covariance=None)


class _NormalFit:
    """Normal equations of the fit.

    Order of the unknowns: parameters of the baseline, of each effect, the six small motions of the
    base, then the coordinates of targets.
    """

    def __init__(self, survey: Survey, effects: tuple[Effect, ...]) -> None:
        self._survey = survey
        self._model = linear.with_base_term(survey.baseline, effects)
        self._maps = [effect for effect in effects if is_error_map(effect)]
        self._dense = [term for term in self._model.terms if not is_error_map(term)]
        baseline, measured = survey.baseline, survey.poses.measured
        sizes = possible_sizes(self._model, measured)
        every, count = np.arange(len(sizes)), len(self._model.parameters)
        self._targets = every[count : count + len(baseline.targets_m)]
        of_dense = [every[self._model.columns_of(term)] for term in self._dense]
        of_maps = [every[self._model.columns_of(term)] for term in self._maps]
        self.dense_columns = np.concatenate([*of_dense, self._targets])  # of all but maps
        # the rows have dense columns first, then those of the maps
        self._row_order = np.concatenate([self.dense_columns, *of_maps])
        prior = [np.diag(sizes[: len(baseline.x)] ** -2.0)]
        for effect in effects:
            factor = np.linalg.inv(effect.prior_factor)
            shapes = np.zeros((len(effect.parameters) - effect.linear,) * 2)
            prior.append(block_diag(factor.T @ factor, shapes))
        base_and_targets = sizes[-(6 + len(self._targets)) :]
        self.prior = block_diag(*prior, np.diag(base_and_targets**-2.0))
        self.expected = np.zeros(len(sizes))  # mean of the prior
        self.expected[: len(baseline.x)] = baseline.x
        self.expected[self._targets] = baseline.targets_m
        self._shown = np.ones(len(sizes), dtype=bool)
        self._shown[count - 6 : count] = linear.base_shown(measured)
        self.bounds = linear.bounds_about(baseline, self._model, measured)

    def model_at(self, x: Array) -> FittedModel:
        """Return the model at unknowns (k,)."""
        k = len(self._model.parameters)
        return replace(self._survey.baseline, model=self._model, x=x[:k], targets_m=x[k:])

    def columns(self, at: FittedModel, whiten: Array) -> tuple[Array, Array]:
        """Return the whitened derivative by all but maps (P, b, d), and by the maps' joints."""
        poses = self._survey.poses
        joints = linear.positions_of(at, [each.joint for each in self._maps])
        terms: list[Term] = [*self._dense, joints]
        points = [*map(at.values_of, self._dense), np.zeros(len(self._maps))]
        *of_terms, by_angle = linear.by_terms(at, poses, terms, points, whiten)
        of_targets = whiten @ linear.by_targets(at, poses)
        return np.concatenate([*of_terms, of_targets], axis=2), by_angle

    def equations(self, x: Array, weights: PoseWeights) -> Equations:
        """Return cost, gradient and normal equations at unknowns (k,), the prior included."""
        at, whiten = self.model_at(x), weights.whiteners()
        knots = [each.knots for each in self._maps]
        dense, by_angle = self.columns(at, whiten)
        q_rad = self._survey.poses.states.q_rad[:, [each.joint - 1 for each in self._maps]]
        white = (whiten @ self._survey.net_residual(at)[:, :, None]).ravel()
        d = dense.shape[2]
        splines = map_columns(by_angle, q_rad, knots)
        rows = normal_equations_of(white, dense.reshape(-1, d), splines)
        rows = in_map_bases(rows, d, [b_splines_by_knots(each) for each in knots])
        rows = rows.along(np.argsort(self._row_order))
        off = x - self.expected
        cost = float(white @ white + off @ self.prior @ off)
        return Equations(cost, rows.projection + self.prior @ off, rows.gram + self.prior)

    def covariance(self, normal: Array, free: Mask) -> Array:
        """Return the covariance of all unknowns (k, k), zero of those that are not free.

        The base is held where readings do not show it. Coordinates of targets that the poses do
        not determine are held one by one, as calibrations hold them as stated.
        """
        free = free & self._shown
        covariance = _inverse(normal, self.prior, free)
        variances = 1.0 / np.diag(self.prior)[self._targets]
        while len(variances):
            share = np.diag(covariance)[self._targets] / variances
            if share.max() < BLOCKS.open_share:
                break
            free[self._targets[int(share.argmax())]] = False
            covariance = _inverse(normal, self.prior, free)
        return covariance

    def cost(self, x: Array, weights: PoseWeights) -> float:
        """Return the sum of squares at unknowns (k,), the prior included."""
        white = weights.whiteners() @ self._survey.net_residual(self.model_at(x))[:, :, None]
        off = x - self.expected
        return float(np.sum(white**2) + off @ self.prior @ off)


def determined_count(covariance: Array, prior: Array) -> float:
    """Return how many unknowns the data determine: the others are as expected, or held.

    By the covariance (k, k) of all unknowns, zero of those held, and the inverse (k, k) of the
    covariance expected.
    """
    free = np.count_nonzero(np.diag(covariance))
    return float(free - np.sum(prior * covariance))


def _inverse(normal: Array, prior: Array, free: Mask) -> Array:
    """Return the inverse of the normal equations of free parameters, zero for the others."""
    # the shape of an effect whose amount is zero has no information
    free = free & (np.diag(normal) > 0.0)
    at = np.ix_(free, free)
    found = np.zeros_like(normal)
    scale = 1.0 / np.sqrt(np.diag(normal)[free])
    factor, failed = dpotrf((normal[at] * np.outer(scale, scale)).T, overwrite_a=1)
    if failed:
        found[at] = no_wider_than(normal[at], prior[at])
        return found
    upper, _ = dpotri(factor, overwrite_c=1)  # zero below its diagonal
    upper *= np.outer(scale, scale)
    found[at] = upper + upper.T - np.diag(np.diag(upper))
    return found


def seen_by_maps(campaign: Survey, effects: tuple[Effect, ...]) -> AngleCoverage | None:
    """Return the joint positions from which maps were estimated; None without a map."""
    order = np.zeros(campaign.context.arm.n)
    for effect in effects:
        if is_error_map(effect):
            order[effect.joint - 1] = max(order[effect.joint - 1], effect.finest_order)
    return angles_seen(campaign.poses.states.q_rad, order) if order.any() else None


class PartialFits:
    """The model with some of its effects: maps as they are, all else fitted again.

    Removing effects moves the model by millimetres, over which its derivative changes by a
    thousandth: the derivative at the model with all effects serves every step of every fit.
    """

    def __init__(self, campaign: Survey, extended: Refit) -> None:
        """Take the model with all effects, and linearise it in all but its maps."""
        self._campaign, self._extended = campaign, extended
        self._fit = _NormalFit(campaign, extended.effects)
        self._whiten = extended.weights.whiteners()
        white, _ = self._fit.columns(extended.at, self._whiten)
        towards = np.swapaxes(self._whiten, 1, 2) @ white
        flat = white.reshape(-1, white.shape[2])
        self._towards = towards.reshape(-1, white.shape[2])  # gradient = residual @ towards
        self._gram = flat.T @ flat

    def model_with(self, some: tuple[Effect, ...]) -> FittedModel:
        """Return the model with some of its effects."""
        extended, fit, x = self._extended, self._fit, self._extended.x.copy()
        fitted = np.ones(len(x), dtype=bool)
        for effect in extended.effects:
            columns = extended.columns_of(effect)
            shapes = columns.start + effect.linear
            if effect not in some:
                x[columns.start : shapes] = 0.0
            known = effect in some and not is_error_map(effect)
            fitted[shapes if known else columns.start : columns.stop] = False
        there = np.flatnonzero(fitted[fit.dense_columns])
        free, at_free = fit.dense_columns[there], np.ix_(there, there)
        bounds = Bounds(fit.bounds.lower[free], fit.bounds.upper[free])
        prior, expected = fit.prior[np.ix_(free, free)], fit.expected[free]
        normal = self._gram[at_free] + prior

        def at(values: Array) -> FittedModel:
            x[free] = values
            return linear.at_unknowns(extended.at, x)

        def equations(values: Array) -> Equations:
            residual, off = self._campaign.net_residual(at(values)), values - expected
            white = self._whiten @ residual[:, :, None]
            cost = float(np.sum(white**2) + off @ prior @ off)
            gradient = (residual.ravel() @ self._towards)[there] + prior @ off
            return Equations(cost, gradient, normal)

        found = minimise(
            bounds.clip(x[free]),
            equations,
            lambda values, step: bounds.clip(values + step),
            lambda _, taken: taken.gained <= COMPUTING.nearby_settled * taken.before.cost,
            most_steps=COMPUTING.nearby_steps,
            held=bounds.held,
            beyond=bounds.beyond,
        )
        return replace(extended, at=at(found.at)).fitted()
