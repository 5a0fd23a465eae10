"""Why a drift of the base cannot be named: what else looks the same in the course of time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from pa10cal.discovery import jacobians
from pa10cal.discovery.finding import Finding
from pa10cal.discovery.preparation import Prepared, complete, why_unknown
from pa10cal.discovery.rules import MOTION
from pa10cal.discovery.target_wander import rows_in_time, wander_instead_of
from pa10cal.discovery.verdict import Verdict
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.observe.time_order import (
    covariates,
    measured_again,
    slow_joints,
    spread_over_time,
)
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.over_time import BaseDrift, ThermalGrowth


def reasons_against_drift(found: Verdict, finding: Finding) -> Iterator[str]:
    """Yield why a drift that was found cannot be named; nothing for other effects."""
    if finding.id != BaseDrift.id:
        return
    campaign, model = found.prepared, found.model
    yield from _confounded_with_order(campaign)
    if finding.effect in model.model.terms:
        readings = complete(campaign.trusted, campaign.baseline, campaign.setup, model)
        yield from _of_single_targets(finding.effect, model, readings)
        yield from _of_a_growing_arm(finding.effect, found.context, model, readings)


def _confounded_with_order(campaign: Prepared) -> Iterator[str]:
    """Yield why a drift cannot be named: the poses came in the order of a joint or a rail."""
    states, slides = campaign.readings.states, campaign.baseline.arm.prismatic
    if measured_again(campaign.readings):
        return
    slow = slow_joints(states)
    along = [str(by) for by in covariates(states, slides) if by.joint and slow[by.joint - 1]]
    if along:
        joints = " and ".join(along)
        yield f"the order of the poses follows {joints}, whose error may look the same"


def _of_single_targets(effect: Effect, model: FittedModel, readings: Observations) -> Iterator[str]:
    """Yield why a drift cannot be named: targets wander as much, each by itself.

    Args:
        model: the model with the effect.
        readings: complete single readings.
    """
    residual = model.compared(readings).residual
    if (found := wander_instead_of(effect, model, readings, residual)) is not None:
        yield (
            f"readings of single targets wander in time by {found.rms_mm:.2g} mm, each by itself, "
            "as much as it moves all of them together"
        )


def _of_a_growing_arm(
    effect: Effect, context: CandidateContext, model: FittedModel, readings: Observations
) -> Iterator[str]:
    """Yield why a drift cannot be named: an arm that grows fits as well, no temperature known."""
    growths = ThermalGrowth.everywhere(context)
    if any(grows_instead(effect, each, model, readings) for each in growths):
        yield (
            "an arm that grows as it warms up explains as much or more, and no temperature was "
            "logged; log it"
        )


def grows_instead(
    drift: Effect, growth: ThermalGrowth, model: FittedModel, poses: Observations
) -> bool:
    """Return whether an arm that grows steadily in time leaves no more than a drift of the base.

    Never where temperatures were logged in all rows: then growth is sought itself. Of squared
    errors over the stated noise, beside all else in the model, whose parameters are fitted again.

    Args:
        drift: a term of the model.
        growth: of the arm, in proportion to a temperature that rises by one kelvin an hour here.
        model: the model with the drift.
        poses: P complete single readings.
    """
    if why_unknown(growth, poses.states, logged=False, weights=False) is None:
        return False
    poses = poses.take(spread_over_time(poses, MOTION.most_readings))
    others = [term for term in model.model.terms if term != drift]
    at = replace(model, covariance=None).only(*others)
    rows = rows_in_time(at, poses, at.compared(poses).residual)
    states = rows.poses.states
    hours = (states.time_s - states.time_s.min()) / 3600.0
    temperature_C = growth.reference_temperature_C + hours
    warming = rows.poses.with_states(replace(states, temperature_C=temperature_C))
    whitener = rows.whitener
    own = jacobians.by_scaled_terms(at, rows.poses, others, whitener)
    own = [*own, whitener @ jacobians.by_base(at, rows.poses), rows.by_targets]

    def left_by(effect: Effect) -> float:
        added = jacobians.by_scaled_effects(at, warming, [effect], [effect.starts[0]], whitener)
        columns = np.concatenate([*own, *added], axis=2).reshape(rows.data.size, -1)
        data = rows.data.ravel()
        return float(np.sum((data - columns @ np.linalg.lstsq(columns, data)[0]) ** 2))

    return left_by(growth) <= left_by(drift)
