"""The whole non-linear fit with the effects found: weighed, robust, maps kept sparse."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from scipy.linalg.lapack import dpotrf, dpotri

from pa10cal.arrays import Array, Index, Mask
from pa10cal.calibration.general.calibrate import shown
from pa10cal.calibration.general.problem import choose_unknowns
from pa10cal.discovery import linear
from pa10cal.discovery.blocked_cv.family import no_wider_than, solve
from pa10cal.discovery.blocked_cv.survey import (
    BlockedRows,
    ShapedEffect,
    Survey,
    in_terms_of,
    map_columns,
    said_by,
)
from pa10cal.discovery.noise import AS_FOUND, Noise, PoseWeights, Widening, pose_weights, unweighted
from pa10cal.discovery.other_numbers import COMPUTING
from pa10cal.discovery.rules import BLOCKS, MAPS
from pa10cal.fit.angles_seen import AngleCoverage, angles_seen
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.problem import possible_sizes
from pa10cal.numerics.least_squares import Bounds, Equations, Step, minimise
from pa10cal.observe.quantities import Start
from pa10cal.options import Tolerances
from pa10cal.results import calibration as records
from pa10cal.results.record import HALF_WIDTH_95
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import (
    FadingPrior,
    b_splines,
    b_splines_by_knots,
    harmonic_orders,
    is_error_map,
)
from pa10cal.terms.model import Model
from pa10cal.terms.term import Report, Term

# Rows weighed by what a model leaves that lacks nothing of the vocabulary.

_FADING = FadingPrior(*MAPS.weighing_prior)


def weighted_rows(survey: Survey, shaped: tuple[ShapedEffect, ...], knots: int) -> BlockedRows:
    """Return rows of effects and of maps of so many knots, weighed.

    By the scatter that all named effects and maps of all joints leave together: then no pose weighs
    less because of an effect that is still to be found. Where poses are few for that, as of an
    instrument that gives one number a pose, maps are not fitted, or no effects either.
    """
    measured = survey.poses.measured
    named = tuple(each for each in shaped if not (each.effect.generic or each.shape))
    rows = BlockedRows(survey, unweighted(measured), named, MAPS.weighing_knots)
    weights = pose_weights(
        linear.residual(rows.operating_point, survey.poses),
        float(len(rows.baseline_columns)),
        measured,
    )
    for _ in range(MAPS.reweighted):
        rows = BlockedRows(survey, weights, named, MAPS.weighing_knots)
        weights = pose_weights(*_left_by_everything(rows), measured)
    return BlockedRows(survey, weights, shaped, knots)


def noise_squares(rows: BlockedRows, noise: Noise) -> float:
    """Return the sum of squares of weighed rows that noise alone is expected to leave.

    No more than the whole scatter of a row: a stated uncertainty may be too large.
    """
    whitener = rows.weights.whitener
    noisy = np.einsum("pij,pjk,pik->pi", whitener, noise.cov, whitener, optimize=True)
    seen = rows.survey.poses.measured.components_seen
    return float(np.sum(rows.weights.weight[:, None] * seen * np.minimum(noisy, 1.0)))


def _left_by_everything(rows: BlockedRows) -> tuple[Array, float]:
    """Return what the richest columns that leave enough readings leave, and their parameters."""
    total = rows.products().summed()
    harmonics = np.tile(_FADING.sizes_rad(harmonic_orders(rows.knots)[1:]), len(rows.joints))
    own, every = len(rows.baseline_columns), total.unknowns
    seen = rows.survey.poses.measured.components_seen
    for fitted in (every, every - len(harmonics), own):
        sizes = np.concatenate([np.ones(every - len(harmonics)), harmonics])
        sizes[fitted:] *= COMPUTING.not_fitted
        prior = np.diag(sizes**-2.0)
        taken = float(np.trace(solve(total.gram, total.gram, prior)))
        if taken <= MAPS.most_taken_share * seen.sum():
            break
    x = solve(total.gram, total.projection, prior)
    remaining = np.empty(seen.shape)
    for b in range(BLOCKS.blocks):
        remaining[rows.survey.block == b] = rows.block_residual(b, x[:, None])[:, :, 0]
    return remaining, taken


@dataclass(frozen=True, eq=False)
class Refit(linear.ModelWithEffects):
    """The calibrated model with effects, fitted anew."""

    covariance: Array  # (k, k) of all unknowns
    weights: PoseWeights  # what each pose counted


def refit(
    survey: Survey,
    effects: tuple[Effect, ...],
    starts: tuple[Array, ...],
    weights: PoseWeights,
    widening: Widening = AS_FOUND,
    own: FittedModel | None = None,
) -> Refit:
    """Fit the calibrated model with effects to all poses of a survey.

    From starts of each effect, and all else as calibrated, or as in a fit of its own with fewer
    effects. Poses count by weights at first; components scatter by their median, or by a widening.
    """
    fit, baseline = _NormalFit(survey, effects), survey.baseline
    base, at = (np.zeros(6), baseline) if own is None else (own.x[-6:], own)
    x = np.concatenate([at.x[: len(baseline.x)], *starts, base, at.targets_m])
    bounds, counts = fit.bounds, weights.widened(widening)
    before = np.zeros((0, 0))  # covariance where the last step began; reweighting comes first

    def reweighted(x: Array, taken: Step) -> Equations:
        nonlocal counts, before
        before = _inverse(taken.before.normal, fit.prior, ~taken.held)
        left = survey.net_residual(fit.place(x))
        found = pose_weights(left, fit.dof(before), survey.poses.measured)
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
    return Refit(effects, fit.place(found.at), found.converged, covariance, counts)


def one_step(survey: Survey, found: Refit, rows: Index) -> tuple[Array, Array]:
    """Return unknowns (k,) by some poses, one step from a fit to all, and their covariance."""
    fewer = replace(survey, poses=survey.poses.take(rows), block=survey.block[rows])
    counts = PoseWeights(found.weights.whitener[rows], found.weights.weight[rows])
    fit = _NormalFit(fewer, found.effects)
    there = fit.equations(found.x, counts)
    held = fit.bounds.held(found.x, there.gradient)
    covariance = fit.covariance(there.normal, ~held)
    return found.x - covariance @ there.gradient, covariance


# Tilts of parallel axes that a calibration left at zero. An effect that it lacks may hide them.


def with_tilts_shown(survey: Survey, found: Refit) -> FittedModel | None:
    """Return the model that a survey sets out from with tilts that a fit with effects shows.

    None where it has all that the instrument can tell, or where the tilts are not shown yet.
    """
    own, measured = survey.baseline, survey.poses.measured
    links = next((term for term in own.model.terms if term.of == "links"), None)
    if links is None:
        return None
    about = Start(own.T_instr_base, np.zeros(3), own.R_ee_target, own.targets_m)
    every = choose_unknowns(own.arm, Tolerances(), measured, about).links
    known = {parameter.name for parameter in links.parameters}
    lacking = np.array([parameter.name not in known for parameter in every.parameters])
    tilts = np.array([role == "tilt" for role in every.roles])
    if not lacking.any() or not np.array_equal(lacking, tilts):
        return None
    terms = tuple(every if term is links else term for term in own.model.terms)
    of_links = np.zeros(len(every.parameters))
    of_links[~lacking] = own.values_of(links)
    values = (of_links if term is links else own.values_of(term) for term in own.model.terms)
    model, x = Model(own.model.chain, terms), np.concatenate([*values])
    tilted = replace(own, model=model, x=x, covariance=None)
    fitted = refit(
        replace(survey, baseline=tilted),
        found.effects,
        tuple(map(found.of, found.effects)),
        found.weights,
    )
    at = fitted.model.parameter_indices(every)[tilts]
    covariance = fitted.covariance[np.ix_(at, at)]
    readings = int(measured.components_seen.sum())
    return tilted if shown(fitted.x[at], covariance, readings) else None


class _NormalFit:
    """Normal equations of the fit, in the order of the model's parameters."""

    def __init__(self, survey: Survey, effects: tuple[Effect, ...]) -> None:
        self._survey = survey
        self._model = linear.with_base_term(survey.baseline, effects)
        self._maps = [each for each in effects if is_error_map(each)]
        own, measured = survey.baseline, survey.poses.measured
        sizes = possible_sizes(self._model, measured)
        columns, first = np.arange(len(sizes)), len(self._model.parameters)
        self._dense: list[Term] = [term for term in self._model.terms if not is_error_map(term)]
        of_dense, of_maps = (
            [columns[self._model.columns_of(term)] for term in terms]
            for terms in (self._dense, self._maps)
        )
        targets = columns[first : first + len(own.targets_m)]
        self.dense_at = np.concatenate([*of_dense, targets])  # unknowns of all but maps
        self._order = np.concatenate([self.dense_at, *of_maps])
        tail = len(targets) + 6
        prior = [np.diag(sizes[: len(own.x)] ** -2.0)]
        for effect in effects:
            factor = np.linalg.inv(effect.prior_factor)
            shapes = np.zeros((len(effect.parameters) - effect.linear,) * 2)
            prior.append(block_diag(factor.T @ factor, shapes))
        self._targets = targets
        self.prior = block_diag(*prior, np.diag(sizes[-tail:] ** -2.0))
        self.middle = np.zeros(len(sizes))
        self.middle[: len(own.x)] = own.x
        self.middle[targets] = own.targets_m
        self._held_with_base = np.zeros(len(sizes), dtype=bool)
        self._held_with_base[first - 6 : first] = linear.held_of_base(survey.calibrated or own)
        # Physical range of every parameter.
        self.bounds = Bounds.of((*self._model.parameters, *measured.target_parameters))

    def place(self, x: Array) -> FittedModel:
        """Return the model at a point."""
        k = len(self._model.parameters)
        return replace(self._survey.baseline, model=self._model, x=x[:k], targets_m=x[k:])

    def columns(self, at: FittedModel, whiten: Array) -> tuple[Array, Array]:
        """Return whitened columns (P, b, d) of all but maps, and what the maps' joints do."""
        poses = self._survey.poses
        joints = linear.positions_of(at, [each.joint for each in self._maps])
        *of_terms, screws = linear.by_terms(
            at,
            poses,
            [*self._dense, joints],
            [*map(at.values_of, self._dense), np.zeros(len(self._maps))],
            whiten,
        )
        return np.concatenate([*of_terms, whiten @ linear.by_targets(at, poses)], axis=2), screws

    def equations(self, x: Array, weights: PoseWeights) -> Equations:
        """Return the problem at a point."""
        at, states, knots = self.place(x), self._survey.poses.states, [m.knots for m in self._maps]
        whiten = weights.whiteners()
        dense, screws = self.columns(at, whiten)
        q_rad = states.q_rad[:, [each.joint - 1 for each in self._maps]]
        white = (whiten @ self._survey.net_residual(at)[:, :, None]).ravel()
        d = dense.shape[2]
        said = said_by(white, dense.reshape(-1, d), map_columns(screws, q_rad, knots))
        said = in_terms_of(said, d, [b_splines_by_knots(each) for each in knots])
        found = said.along(np.argsort(self._order))
        off = x - self.middle
        cost = float(white @ white + off @ self.prior @ off)
        return Equations(cost, found.projection + self.prior @ off, found.gram + self.prior)

    def covariance(self, normal: Array, free: Mask) -> Array:
        """Return the covariance of all unknowns (k, k), zero of those that are not free.

        The base is held where the calibration held it. Coordinates of targets of which the poses
        say nothing are held one by one, as calibrations hold them as stated: where all axes are
        parallel the height of one is that of the base.
        """
        free = free & ~self._held_with_base
        covariance = _inverse(normal, self.prior, free)
        sizes2 = 1.0 / np.diag(self.prior)[self._targets]
        while len(sizes2):
            open_to = np.diag(covariance)[self._targets] / sizes2
            if open_to.max() < BLOCKS.open_share:
                break
            free[self._targets[int(open_to.argmax())]] = False
            covariance = _inverse(normal, self.prior, free)
        return covariance

    def dof(self, covariance: Array) -> float:
        """Return how many parameters the data determine, the others being as expected."""
        return float(len(covariance) - np.sum(self.prior * covariance))

    def cost(self, x: Array, weights: PoseWeights) -> float:
        """Return the sum of squares at a point."""
        white = weights.whiteners() @ self._survey.net_residual(self.place(x))[:, :, None]
        off = x - self.middle
        return float(np.sum(white**2) + off @ self.prior @ off)


def _inverse(information: Array, prior: Array, free: Mask) -> Array:
    """Return the inverse of the normal equations of free parameters, zero for the others."""
    free = free & (np.diag(information) > 0.0)  # the shape of an effect of no amount is not
    own = np.ix_(free, free)
    found = np.zeros_like(information)
    scale = 1.0 / np.sqrt(np.diag(information)[free])
    factor, wrong = dpotrf((information[own] * np.outer(scale, scale)).T, overwrite_a=1)
    if wrong:
        found[own] = no_wider_than(information[own], prior[own])
        return found
    upper, _ = dpotri(factor, overwrite_c=1)  # of zeros below its diagonal
    upper *= np.outer(scale, scale)
    found[own] = upper + upper.T - np.diag(np.diag(upper))
    return found


# The joint positions that maps have learnt from, and the model with some of its effects.


def seen_by_maps(campaign: Survey, effects: tuple[Effect, ...]) -> AngleCoverage | None:
    """Return the joint positions from which maps have learnt an error; None without a map."""
    order = np.zeros(campaign.context.arm.n)
    for effect in effects:
        if is_error_map(effect):
            order[effect.joint - 1] = max(order[effect.joint - 1], effect.finest_order)
    return angles_seen(campaign.poses.states.q_rad, order) if order.any() else None


class PartialFits:
    """The model with some of its effects: maps as they are, all else fitted again.

    Taking effects out moves the model by millimetres, over which its derivative is the same to a
    thousandth: the one at the model with all of them serves every step of every fit.
    """

    def __init__(self, campaign: Survey, extended: Refit) -> None:
        """Take the model with all effects, and linearise it in all but its maps."""
        self._campaign, self._extended = campaign, extended
        self._fit = _NormalFit(campaign, extended.effects)
        self._whiten = extended.weights.whiteners()
        white, _ = self._fit.columns(extended.at, self._whiten)
        towards = np.swapaxes(self._whiten, 1, 2) @ white
        self._towards, white = (each.reshape(-1, white.shape[2]) for each in (towards, white))
        self._gram = white.T @ white

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
        there = np.flatnonzero(fitted[fit.dense_at])
        free, own = fit.dense_at[there], np.ix_(there, there)
        bounds = Bounds(fit.bounds.lower[free], fit.bounds.upper[free])
        prior, middle = fit.prior[np.ix_(free, free)], fit.middle[free]
        normal = self._gram[own] + prior

        def at(values: Array) -> FittedModel:
            x[free] = values
            return linear.at_unknowns(extended.at, x)

        def equations(values: Array) -> Equations:
            left, off = self._campaign.net_residual(at(values)), values - middle
            white = self._whiten @ left[:, :, None]
            cost = float(np.sum(white**2) + off @ prior @ off)
            return Equations(cost, (left.ravel() @ self._towards)[there] + prior @ off, normal)

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


# Each effect fitted to each campaign of a group alone, and how well campaigns agree.
#
# A step of the fit by the poses of one campaign, from what all of them give: other parameters of
# the model, and what is expected of effects, are as in the fit itself. Errors by a joint's angle
# are compared over the angles that two campaigns both visited, less their means there: a constant
# is the joint's zero. Neighbouring angles go together, so uncertainties are by leaving out arcs.

#: Angles of a turn at which errors are compared.
ANGLES_RAD = np.radians(np.arange(float(MAPS.angles_a_turn)))


def by_campaign(survey: Survey, found: Refit) -> tuple[records.EffectByCampaign, ...]:
    """Return every effect as each campaign of a group alone has it; none of a single campaign."""
    campaign = survey.poses.states.campaign
    if campaign is None or not found.effects:
        return ()
    rows = {
        name: np.flatnonzero(campaign == number)
        for number, (name, _) in enumerate(survey.poses.measured.campaigns)
        if np.any(campaign == number)
    }
    alone = {name: one_step(survey, found, own) for name, own in rows.items()}
    u_scale = found.at.model.u_scale
    each = []
    for effect in found.effects:
        at = found.columns_of(effect)
        curves: dict[str, records.JointErrorAlone] = {}
        if is_error_map(effect):
            unit = b_splines(effect.knots, ANGLES_RAD) @ b_splines_by_knots(effect.knots)
            for name, (x, _) in alone.items():
                q_rad = survey.poses.states.q_rad[rows[name], effect.joint - 1]
                curves[name] = records.JointErrorAlone(
                    error_mrad=1e3 * unit @ x[at], visited=visited(q_rad)
                )
        each.append(
            records.EffectByCampaign(
                id=effect.id,
                of=effect.of,
                parameters=None
                if curves
                else {
                    name: _parameters(effect.report(x[at]), covariance[at, at], u_scale)
                    for name, (x, covariance) in alone.items()
                },
                errors=curves or None,
                agreement=tuple(
                    pair_of((first, curves[first]), (second, curves[second]))
                    for first, second in combinations(curves, 2)
                ),
            )
        )
    return tuple(each)


def _parameters(
    report: Report, covariance: Array, u_scale: float
) -> dict[str, records.ParameterAlone]:
    std = np.sqrt(np.diag(report.covariance(covariance, u_scale)))
    return {
        parameter.name: records.ParameterAlone(value=float(value), std=float(sigma))
        for parameter, value, sigma in zip(report.parameters, report.values, std, strict=True)
    }


def visited(q_rad: Array) -> Mask:
    """Return at which of `ANGLES_RAD` there are enough joint angles (P,), by the turn."""
    turn = 2.0 * np.pi
    sorted_rad = np.sort(np.mod(q_rad, turn))
    around = np.concatenate([sorted_rad - turn, sorted_rad, sorted_rad + turn])
    first = np.searchsorted(around, ANGLES_RAD - np.radians(MAPS.compared_within_deg))
    last = np.searchsorted(around, ANGLES_RAD + np.radians(MAPS.compared_within_deg), side="right")
    return np.asarray(last - first >= MAPS.compared_poses)


def pair_of(
    first: tuple[str, records.JointErrorAlone], second: tuple[str, records.JointErrorAlone]
) -> records.CampaignsAgree:
    """Compare the curves of two campaigns; slopes are of the second, both uncertain alike."""
    (one, a), (two, b) = first, second
    both = a.visited & b.visited
    x, y = a.error_mrad[both], b.error_mrad[both]
    arc = (ANGLES_RAD[both] // np.radians(MAPS.compared_arc_deg)).astype(int)
    arcs = np.unique(arc)
    named: dict[str, Any] = {"first": one, "second": two, "share_of_turn": float(both.mean())}
    if len(arcs) < MAPS.compared_arcs or not (np.ptp(x) > 0.0 and np.ptp(y) > 0.0):
        return records.CampaignsAgree(
            **(dict.fromkeys(records.CampaignsAgree.model_fields) | named)
        )

    def interval(of: Callable[[Array, Array], float]) -> tuple[float, float, float]:
        """Return a quantity and its interval, by leaving out arc by arc (jackknife)."""
        whole = of(x, y)
        without = np.array([of(x[arc != k], y[arc != k]) for k in arcs])
        spread = (len(arcs) - 1) / len(arcs) * np.sum((without - without.mean()) ** 2)
        half = HALF_WIDTH_95 * float(np.sqrt(spread))
        return whole, whole - half, whole + half

    z, z_low, z_high = interval(lambda x, y: float(np.arctanh(_correlation(x, y))))
    slope, low, high = interval(_slope)
    x, y = x - x.mean(), y - y.mean()
    return records.CampaignsAgree(
        **named,
        correlation=float(np.tanh(z)),
        correlation95=(float(np.tanh(z_low)), float(np.tanh(z_high))),
        slope=slope,
        slope95=(low, high),
        first_rms_mrad=linear.rms(x),
        second_rms_mrad=linear.rms(y),
        difference_rms_mrad=linear.rms(x - y),
    )


def _correlation(x: Array, y: Array) -> float:
    return float(
        np.clip(np.corrcoef(x, y)[0, 1], -COMPUTING.most_correlation, COMPUTING.most_correlation)
    )


def _slope(x: Array, y: Array) -> float:
    """Return the slope of y by x where both are uncertain alike (Deming)."""
    (xx, xy), (_, yy) = np.cov(x, y)
    return float((yy - xx + np.hypot(yy - xx, 2.0 * xy)) / (2.0 * xy)) if xy else np.nan
