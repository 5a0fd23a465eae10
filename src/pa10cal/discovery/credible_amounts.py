"""Whether the amounts of an effect, as a model was fitted with it, are credible and significant.

All numbers are those of one fit: values and covariance of the effect's parameters in the model.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.special import chdtri

from pa10cal.arm.description import weights_known
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.discovery.rules import NAMES
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.results.number_text import HALF_WIDTH_95
from pa10cal.terms.effects.effect import Effect, Limits


def reasons_against_amounts(
    effect: Effect, model: FittedModel, states: PoseStates | None = None
) -> Iterator[str]:
    """Yield why the amounts of an effect in a model rule out its name.

    Args:
        effect: a term of the model.
        model: a fit without covariance counts as certain.
        states: poses at which the rotations that it causes must be possible; None for no check.
    """
    x, covariance = _fitted(effect, model)
    if not (np.isfinite(x).all() and np.isfinite(covariance).all()):
        yield "the fit gave no numbers for its amounts, or no uncertainty of them"
        return
    limits = effect.limits_at(model.arm.reach_m)
    if limits.positive:
        yield from _negative(effect, x)
    if limits.values is not None:
        yield from _beyond(effect, x, covariance, model.model.u_scale, limits)
    if not _has_other_limits(limits, model):
        yield from _larger_than_plausible(effect, x, covariance)
    if states is not None and limits.turn_rad is not None:
        yield from _turns_too_far(effect, x, covariance, states, limits.turn_rad, limits.why)
    yield from holds_zero(effect, model)


def _fitted(effect: Effect, model: FittedModel) -> tuple[Array, Array]:
    """Return the parameters of an effect as they were solved (k,), and their covariance (k, k)."""
    x = model.values_of(effect)
    if model.covariance is None:
        return x, np.zeros((len(x), len(x)))
    columns = model.model.columns_of(effect)
    return x, model.covariance[columns, columns]


def _has_other_limits(limits: Limits, model: FittedModel) -> bool:
    """Return whether another limit applies to an effect than its plausible size.

    Compliances under weights that are not stated are as uncertain as these: their limit is the
    rotation that they cause.
    """
    by_turn = limits.turn_rad is not None and weights_known(model.arm).assumed
    return limits.values is not None or by_turn


def _negative(effect: Effect, x: Array) -> Iterator[str]:
    """Yield that linear parameters which physics keeps positive are not."""
    linear = slice(0, effect.linear)
    values = zip(effect.reported[linear], x[linear].tolist(), strict=True)
    if negative := [each.name for each, value in values if value < 0.0]:
        yield f"its {', '.join(negative)} would be negative, which is not physical"


def surely_negative(effect: Effect, model: FittedModel) -> bool:
    """Return whether an amount that physics keeps positive is surely not, in a fit that has it."""
    if not effect.limits_at(model.arm.reach_m).positive:
        return False
    x, covariance = _fitted(effect, model)
    highest = x + HALF_WIDTH_95 * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return bool((highest[: effect.linear] < 0.0).any())


def _beyond(
    effect: Effect, x: Array, covariance: Array, u_scale: float, limits: Limits
) -> Iterator[str]:
    """Yield that a linear parameter, as it is reported, is beyond its lowest or highest value."""
    assert limits.values is not None
    low, high = limits.values
    report = effect.report(x)
    variances = np.diag(report.covariance(covariance, u_scale))
    half_widths = (HALF_WIDTH_95 * np.sqrt(np.maximum(variances, 0.0))).tolist()
    reported = zip(report.parameters, report.values.tolist(), half_widths, strict=True)
    for each, value, half in list(reported)[: effect.linear]:
        if value + half < low or value - half > high:
            yield f"its {each.name} would be {value:.2g} ± {half:.1g} {each.unit}: {limits.why}"


def _larger_than_plausible(effect: Effect, x: Array, covariance: Array) -> Iterator[str]:
    """Yield that an amount, at the lower end of its 95 % interval, is many plausible sizes."""
    linear = slice(0, effect.linear)
    inverse = np.linalg.inv(effect.prior_factor)
    amounts = np.linalg.solve(effect.prior_factor, x[linear])
    variances = np.maximum(np.diag(inverse @ covariance[linear, linear] @ inverse.T), 0.0)
    if (np.abs(amounts) - HALF_WIDTH_95 * np.sqrt(variances)).max() > NAMES.most_sizes:
        yield f"it would be {effect.size(x[linear]):.0f} times as large as is plausible"


def _turns_too_far(
    effect: Effect, x: Array, covariance: Array, states: PoseStates, most_rad: float, why: str
) -> Iterator[str]:
    """Yield that, in some pose, an effect rotates a joint or link farther than is possible.

    Wrong weights are no part of the uncertainty: poses show the rotation, that is compliance times
    moment, and a moment too large by a factor has a compliance too small by it.
    """
    rotation_rad, by_x = effect.rotations(states, x)
    variances = np.maximum(np.einsum("rk,kl,rl->r", by_x, covariance, by_x), 0.0)
    least_rad = np.abs(rotation_rad) - HALF_WIDTH_95 * np.sqrt(variances)
    if least_rad.max(initial=0.0) > most_rad:
        turn_rad = float(np.abs(rotation_rad).max())
        yield f"it would turn by {1e3 * turn_rad:.0f} mrad: {why}"


def holds_zero(effect: Effect, model: FittedModel) -> Iterator[str]:
    """Yield why the amount of an effect of a model is not significantly different from zero.

    Zero is in the 95 % confidence region of its linear parameters, or in the interval of each of
    them: if only a combination is significant, the poses do not determine the amounts. The latter
    counts where each amount has a meaning by itself. A model without covariance yields nothing.
    """
    linear = slice(0, effect.linear)
    if model.covariance is None:
        return
    x, covariance = _fitted(effect, model)
    x, covariance = x[linear], covariance[linear, linear]
    scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    white = x / scale
    square = float(white @ np.linalg.pinv(covariance / np.outer(scale, scale)) @ white)
    if square < chdtri(effect.linear, 1.0 - NAMES.confidence):
        yield f"it is {np.sqrt(max(square, 0.0)):.1f} standard uncertainties from zero"
    elif effect.amounts_stand_alone and np.abs(white).max() < HALF_WIDTH_95:
        names = ", ".join(each.name for each in effect.reported[linear])
        yield f"the intervals of its {names} hold zero"
