"""Each effect fitted to each campaign of a group alone, and how well the campaigns agree.

The fit to one campaign is one step from the fit to all, over all parameters, with the same priors.
Errors by a joint's angle are compared over the angles that two campaigns both visited, less their
means there: a constant is the joint's zero. Errors at neighbouring angles are correlated, so the
uncertainty of the agreement is found by leaving out arcs (jackknife) that are longer than that.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import NamedTuple, TypedDict

import numpy as np
from scipy.special import ndtr, stdtrit

from pa10cal.arrays import Array, Index, Mask, rms
from pa10cal.calibration.general.contradictions import contradictions
from pa10cal.calibration.general.per_campaign import FitOfGroup, per_campaign_fits
from pa10cal.discovery.blocked_cv.refit import OneStep, Refit, one_step
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.model_with_effects import bounds_of_unknowns
from pa10cal.discovery.rules import MAPS
from pa10cal.discovery.tuning import COMPUTING
from pa10cal.fit.problem import Problem
from pa10cal.numerics.periodic_spline import b_splines, b_splines_by_knots
from pa10cal.results import calibration as records
from pa10cal.results.number_text import HALF_WIDTH_95
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import is_error_map
from pa10cal.terms.term import yields
from pa10cal.terms.weights import holds_weights

#: Angles of a turn at which errors are compared [rad].
ANGLES_RAD = np.linspace(0.0, 2.0 * np.pi, MAPS.angles_a_turn, endpoint=False)


class _Pair(TypedDict):
    """Two campaigns, and the part of a turn that both visited."""

    first: str
    second: str
    share_of_turn: float


class _FitAlone(NamedTuple):
    """Unknowns by one campaign alone, and its joint positions."""

    by: OneStep
    q_rad: Array  # (p, n)


def by_campaign(survey: Survey, found: Refit) -> tuple[records.EffectByCampaign, ...]:
    """Return every effect as each campaign of a group alone has it; none of a single campaign."""
    campaign = survey.poses.states.campaign
    if campaign is None or not found.effects:
        return ()
    fits: dict[str, _FitAlone] = {}
    for number, (name, _) in enumerate(survey.poses.measured.campaigns):
        rows = np.flatnonzero(campaign == number)
        if len(rows):
            fits[name] = _FitAlone(one_step(survey, found, rows), survey.poses.states.q_rad[rows])
    return tuple(_effect_by_campaign(effect, found, fits) for effect in found.effects)


def contradictions_left(survey: Survey, found: Refit) -> tuple[records.InputFinding, ...] | None:
    """Return which campaigns contradict each other about a model with effects; None for no group.

    A spring that is not linear, as an effect that the calibration lacks, makes campaigns with
    different tools differ as if one of these were stated wrongly, or the arm had been changed.
    """
    at, poses = found.at, survey.poses
    problem = Problem(at.model, np.arange(len(at.targets_m)), at.targets_m, at.T_instr_base, poses)
    bounds = bounds_of_unknowns(survey.baseline, at.model, poses.measured)
    at_end = (found.x <= bounds.lower) | (found.x >= bounds.upper)
    fit = FitOfGroup(
        x=found.x,
        at_bound=at_end | (np.diag(found.covariance) <= 0.0),
        covariance=found.covariance,
        residual=survey.net_residual(at),
        weights=found.weights.weight,
        whitener=found.weights.whitener,
    )
    by_masses = any(map(holds_weights, at.model.terms)) and any(map(yields, at.model.terms))
    group = per_campaign_fits(problem, fit, survey.setup.payload if by_masses else None)
    return None if group is None else contradictions(group, at.model.joint_zeros)


def _effect_by_campaign(
    effect: Effect, found: Refit, fits: dict[str, _FitAlone]
) -> records.EffectByCampaign:
    """Return the parameters of an effect in every campaign, or the curves of a map."""
    columns = found.columns_of(effect)
    if not is_error_map(effect):
        parameters = {
            name: parameters_alone(effect, fit.by, columns, found.at.model.u_scale)
            for name, fit in fits.items()
        }
        return records.EffectByCampaign(
            id=effect.id, of=effect.of, parameters=parameters, errors=None, agreement=()
        )
    by_knots = b_splines(effect.knots, ANGLES_RAD) @ b_splines_by_knots(effect.knots)
    curves = {
        name: records.JointErrorAlone(
            error_mrad=1e3 * by_knots @ fit.by.x[columns],
            visited=visited(fit.q_rad[:, effect.joint - 1]),
        )
        for name, fit in fits.items()
    }
    return records.EffectByCampaign(
        id=effect.id,
        of=effect.of,
        parameters=None,
        errors=curves,
        agreement=tuple(
            pair_of((first, curves[first]), (second, curves[second]))
            for first, second in combinations(curves, 2)
        ),
    )


def parameters_alone(
    effect: Effect, by: OneStep, columns: slice, u_scale: float
) -> dict[str, records.ParameterAlone]:
    """Return the reported parameters of an effect, of the unknowns in these columns."""
    report = effect.report(by.x[columns])
    std = np.sqrt(np.diag(report.covariance(by.covariance[columns, columns], u_scale)))
    at_end = (report.jacobian[:, by.at_end[columns]] != 0.0).any(axis=1)
    return {
        parameter.name: records.ParameterAlone(
            value=float(value), std=None if unknown else float(sigma)
        )
        for parameter, value, sigma, unknown in zip(
            report.parameters, report.values, std, at_end, strict=True
        )
    }


def visited(q_rad: Array) -> Mask:
    """Return near which of `ANGLES_RAD` there are enough joint angles (P,), modulo a turn."""
    turn_rad = 2.0 * np.pi
    sorted_rad = np.sort(np.mod(q_rad, turn_rad))
    around = np.concatenate([sorted_rad - turn_rad, sorted_rad, sorted_rad + turn_rad])
    first = np.searchsorted(around, ANGLES_RAD - np.radians(MAPS.compared_within_deg))
    last = np.searchsorted(around, ANGLES_RAD + np.radians(MAPS.compared_within_deg), side="right")
    return np.asarray(last - first >= MAPS.compared_poses)


def pair_of(
    first: tuple[str, records.JointErrorAlone], second: tuple[str, records.JointErrorAlone]
) -> records.CampaignsAgree:
    """Compare the error curves of two campaigns, each with its name.

    The slope is that of the second by the first, both being equally uncertain. Statistics have 95 %
    intervals by a jackknife over arcs; they are not known where too few arcs are common, or where
    one of the curves is constant, or they do not vary together, with an arc left out.
    """
    (first_name, first_curve), (second_name, second_curve) = first, second
    both = first_curve.visited & second_curve.visited
    pair: _Pair = {
        "first": first_name,
        "second": second_name,
        "share_of_turn": float(both.mean()),
    }
    x, y = first_curve.error_mrad[both], second_curve.error_mrad[both]
    arc = _arc_of_angles(x, y, both)
    arcs = np.unique(arc)
    # all angles, then those without each arc
    samples = [np.ones(len(arc), dtype=bool), *(arc != left_out for left_out in arcs)]
    enough = len(arcs) >= MAPS.compared_arcs
    if not (enough and all(_vary_together(x[rows], y[rows]) for rows in samples)):
        return records.CampaignsAgree.unknown(**pair)
    half_widths = float(stdtrit(len(arcs) - 1, ndtr(HALF_WIDTH_95)))

    def interval(statistic: Callable[[Array, Array], float]) -> tuple[float, float, float]:
        """Return a statistic and its 95 % interval."""
        whole, *others = (statistic(x[rows], y[rows]) for rows in samples)
        without = np.array(others)
        spread = (len(arcs) - 1) / len(arcs) * np.sum((without - without.mean()) ** 2)
        half = half_widths * float(np.sqrt(spread))
        return whole, whole - half, whole + half

    z, z_low, z_high = interval(lambda x, y: float(np.arctanh(_correlation(x, y))))
    slope, low, high = interval(_slope)
    x_off, y_off = x - x.mean(), y - y.mean()
    return records.CampaignsAgree(
        **pair,
        correlation=float(np.tanh(z)),
        correlation95=(float(np.tanh(z_low)), float(np.tanh(z_high))),
        slope=slope,
        slope95=(low, high),
        first_rms_mrad=rms(x_off),
        second_rms_mrad=rms(y_off),
        difference_rms_mrad=rms(x_off - y_off),
    )


def _arc_of_angles(x: Array, y: Array, both: Mask) -> Index:
    """Return the number of the arc of each common angle, (C,), from 0.

    Arcs have equally many common angles, those of `MAPS.compared_arc_lengths` correlation lengths.
    """
    if not _vary_together(x, y):
        return np.zeros(len(x), dtype=int)
    angles = MAPS.compared_arc_lengths * max(_correlation_length(x, y, both), 1.0)
    return np.arange(len(x)) * max(int(len(x) / angles), 1) // len(x)


def _correlation_length(x: Array, y: Array, both: Mask) -> float:
    """Return how many neighbouring angles of two independent curves count as one.

    It is sum r_x(k) r_y(k) over all lags k, with the autocorrelations r of the curves x and y at
    their common angles: the variance of their correlation over that of as many independent pairs
    (Bartlett, Journal of the Royal Statistical Society 98, 1935). Long lags, whose estimates are
    mostly noise, have less weight or none.
    """
    forward = np.arange(len(both))
    lag = np.minimum(forward, len(both) - forward)
    weight = np.maximum(1.0 - lag / (COMPUTING.correlation_lags * len(x)), 0.0)
    pairs = np.maximum(_sums_of_products(both.astype(float)), 1.0)  # of common angles, by lag
    on_turn = np.zeros((2, len(both)))
    on_turn[:, both] = x - x.mean(), y - y.mean()
    of_x, of_y = map(_sums_of_products, on_turn)
    return float(len(x) * np.sum(weight * of_x * of_y / pairs) / (of_x[0] * of_y[0]))


def _sums_of_products(on_turn: Array) -> Array:
    """Return the sum of products of values (A,) on a turn by the lag between them, (A,)."""
    return np.asarray(np.fft.ifft(np.abs(np.fft.fft(on_turn)) ** 2).real)


def _vary_together(x: Array, y: Array) -> bool:
    """Return whether correlation and slope of two curves are defined."""
    if not len(x):
        return False
    return bool(np.ptp(x) > 0.0 and np.ptp(y) > 0.0 and np.cov(x, y)[0, 1] != 0.0)


def _correlation(x: Array, y: Array) -> float:
    most = COMPUTING.most_correlation
    return float(np.clip(np.corrcoef(x, y)[0, 1], -most, most))


def _slope(x: Array, y: Array) -> float:
    """Return the slope of y by x where both are equally uncertain (Deming regression)."""
    (xx, xy), (_, yy) = np.cov(x, y)
    return float((yy - xx + np.hypot(yy - xx, 2.0 * xy)) / (2.0 * xy))
