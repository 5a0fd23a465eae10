"""Each effect fitted to each campaign of a group alone, and how well campaigns agree.

A step of the fit by the poses of one campaign, from what all of them give: other parameters of the
model, and what is expected of effects, are as in the fit itself. Errors by a joint's angle are
compared over the angles that two campaigns both visited, less their means there: a constant is the
joint's zero. Neighbouring angles go together, so uncertainties are by leaving out arcs of the turn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.discovery.blocked_cv.refit import Refit, one_step
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.results.calibration import (
    CampaignsAgree,
    EffectByCampaign,
    JointErrorAlone,
    ParameterAlone,
)
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.of_campaign import OfCampaign
from pa10cal.terms.term import Report

#: Angles of a turn at which errors are compared.
ANGLES_RAD = np.radians(np.arange(360.0))
#: An angle was visited by a campaign with so many poses within so much of it.
_LEAST_POSES, _WITHIN_RAD = 10, np.radians(1.5)
#: Arc that is left out at a time, and arcs without which no interval is given.
_ARC_RAD = np.radians(7.5)
_LEAST_ARCS = 3
#: Correlations are kept from one, where their transform has no end.
_MOST = 1.0 - 1e-9
_HALF_WIDTH_95 = 1.96


@dataclass(frozen=True)
class Curve:
    """The error of a joint by its angle, as one campaign has it."""

    error_rad: Array  # (A,) at `ANGLES_RAD`
    visited: NDArray[np.bool_]  # (A,) whether the campaign has poses there


def by_campaign(survey: Survey, found: Refit) -> tuple[EffectByCampaign, ...]:
    """Return every effect as each campaign of a group alone has it; none of a single campaign."""
    campaign = survey.poses.states.campaign
    shared = [each for each in found.effects if not isinstance(each, OfCampaign)]
    if campaign is None or not shared:
        return ()
    names = [name for name, _ in survey.poses.measured.campaigns]
    alone = {
        name: one_step(survey, found, np.flatnonzero(campaign == number))
        for number, name in enumerate(names)
        if np.any(campaign == number)
    }
    each = []
    for effect in shared:
        at = found.columns_of(effect)
        curves = {}
        if isinstance(effect, JointErrorMap):
            for name, (x, _) in alone.items():
                q_rad = survey.poses.states.q_rad[campaign == names.index(name), effect.joint - 1]
                curves[name] = Curve(_error_rad(effect, x[at]), visited(q_rad))
        each.append(
            EffectByCampaign(
                id=effect.id,
                of=effect.of,
                parameters=None
                if curves
                else {
                    name: _parameters(effect.report(x[at]), covariance[at, at])
                    for name, (x, covariance) in alone.items()
                },
                errors={
                    name: JointErrorAlone(error_mrad=1e3 * curve.error_rad, visited=curve.visited)
                    for name, curve in curves.items()
                }
                or None,
                agreement=tuple(
                    pair_of((first, curves[first]), (second, curves[second]))
                    for first, second in combinations(curves, 2)
                ),
            )
        )
    return tuple(each)


def _parameters(report: Report, covariance: Array) -> dict[str, ParameterAlone]:
    std = np.sqrt(np.diag(report.jacobian @ covariance @ report.jacobian.T))
    return {
        parameter.name: ParameterAlone(value=float(value), std=float(sigma))
        for parameter, value, sigma in zip(report.parameters, report.values, std, strict=True)
    }


def visited(q_rad: Array) -> NDArray[np.bool_]:
    """Return at which of `ANGLES_RAD` there are enough joint angles (P,), by the turn."""
    turn = 2.0 * np.pi
    sorted_rad = np.sort(np.mod(q_rad, turn))
    around = np.concatenate([sorted_rad - turn, sorted_rad, sorted_rad + turn])
    first = np.searchsorted(around, ANGLES_RAD - _WITHIN_RAD)
    last = np.searchsorted(around, ANGLES_RAD + _WITHIN_RAD, side="right")
    return np.asarray(last - first >= _LEAST_POSES)


def pair_of(first: tuple[str, Curve], second: tuple[str, Curve]) -> CampaignsAgree:
    """Compare the curves of two campaigns, each given with its name.

    Slopes are of the second by the first, both uncertain alike.
    """
    (one, a), (two, b) = first, second
    both = a.visited & b.visited
    x, y = a.error_rad[both], b.error_rad[both]
    arc = (ANGLES_RAD[both] // _ARC_RAD).astype(int)
    arcs = np.unique(arc)
    if len(arcs) < _LEAST_ARCS or not (np.ptp(x) > 0.0 and np.ptp(y) > 0.0):
        nothing = dict.fromkeys(CampaignsAgree.model_fields)
        named = {"first": one, "second": two, "share_of_turn": float(both.mean())}
        return CampaignsAgree(**(nothing | named))

    def interval(of: Callable[[Array, Array], float]) -> tuple[float, float, float]:
        """Return a quantity and its interval, by leaving out arc by arc (jackknife)."""
        whole = of(x, y)
        without = np.array([of(x[arc != k], y[arc != k]) for k in arcs])
        spread = (len(arcs) - 1) / len(arcs) * np.sum((without - without.mean()) ** 2)
        half = _HALF_WIDTH_95 * float(np.sqrt(spread))
        return whole, whole - half, whole + half

    z, z_low, z_high = interval(lambda x, y: float(np.arctanh(_correlation(x, y))))
    slope, low, high = interval(_slope)
    x, y = x - x.mean(), y - y.mean()
    return CampaignsAgree(
        first=one,
        second=two,
        correlation=float(np.tanh(z)),
        correlation95=(float(np.tanh(z_low)), float(np.tanh(z_high))),
        slope=slope,
        slope95=(low, high),
        first_rms_mrad=1e3 * _rms(x),
        second_rms_mrad=1e3 * _rms(y),
        difference_rms_mrad=1e3 * _rms(x - y),
        share_of_turn=float(both.mean()),
    )


def _error_rad(effect: JointErrorMap, x: Array) -> Array:
    """Return the error at `ANGLES_RAD`."""
    q_rad = np.zeros((len(ANGLES_RAD), effect.joint))
    q_rad[:, -1] = ANGLES_RAD
    zeros, zero = np.zeros_like(q_rad), np.zeros(len(q_rad))
    return effect.shift(PoseStates(q_rad, zeros, zeros, zero, zero, zero), x)[:, 0]


def _correlation(x: Array, y: Array) -> float:
    return float(np.clip(np.corrcoef(x, y)[0, 1], -_MOST, _MOST))


def _slope(x: Array, y: Array) -> float:
    """Return the slope of y by x where both are uncertain alike (Deming)."""
    (xx, xy), (_, yy) = np.cov(x, y)
    return float((yy - xx + np.hypot(yy - xx, 2.0 * xy)) / (2.0 * xy)) if xy else np.nan


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))
