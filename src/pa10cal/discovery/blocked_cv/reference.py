"""Rows weighed by what a model leaves that lacks nothing of the vocabulary."""

from __future__ import annotations

import numpy as np

from pa10cal.arrays import Array
from pa10cal.discovery.blocked_cv.rows import Rows, ShapedEffect
from pa10cal.discovery.blocked_cv.selection import solve
from pa10cal.discovery.blocked_cv.survey import BLOCKS, Survey
from pa10cal.discovery.linear import residual
from pa10cal.discovery.noise import Noise
from pa10cal.discovery.weights import pose_weights, unweighted
from pa10cal.terms.effects.joint_error_map import harmonic_orders
from pa10cal.terms.effects.spectrum import Fading

_REWEIGHTED = 2
#: Maps of all joints by which poses are weighed: of middle spacing and smoothness.
_KNOTS = 72
_FADING = Fading(1e-4, 10.0)
#: Part of the readings that what is fitted may take up; what is left of more says little of noise.
_MOST_TAKEN = 0.6
#: Size of a parameter that is not to be fitted.
_NONE = 1e-9


def weighted_rows(survey: Survey, shaped: tuple[ShapedEffect, ...], knots: int) -> Rows:
    """Return rows of effects and maps, weighed.

    By the scatter that all named effects and maps of all joints leave together: then no pose weighs
    less because of an effect that is still to be found. Where poses are few for that, as of an
    instrument that gives one number a pose, maps are not fitted, or no effects either.

    Args:
        survey: the campaign.
        shaped: effects.
        knots: of the maps.
    """
    measured = survey.poses.measured
    named = tuple(each for each in shaped if not (each.effect.generic or each.shape))
    rows = Rows(survey, unweighted(measured), named, _KNOTS)
    weights = pose_weights(residual(rows.place, survey.poses), float(len(rows.own)), measured)
    for _ in range(_REWEIGHTED):
        rows = Rows(survey, weights, named, _KNOTS)
        weights = pose_weights(*_left_by_everything(rows), measured)
    return Rows(survey, weights, shaped, knots)


def noise_squares(rows: Rows, noise: Noise) -> float:
    """Return the sum of squares of weighed rows that noise alone is expected to leave.

    No more than the whole scatter of a row: a stated uncertainty may be too large.
    """
    whitener = rows.weights.whitener
    noisy = np.einsum("pij,pjk,pik->pi", whitener, noise.cov, whitener, optimize=True)
    seen = rows.survey.poses.measured.components_seen
    return float(np.sum(rows.weights.weight[:, None] * seen * np.minimum(noisy, 1.0)))


def _left_by_everything(rows: Rows) -> tuple[Array, float]:
    """Return what all columns together leave, (P, b), and how many parameters that takes.

    The richest set of columns that leaves enough of the readings is taken.
    """
    total = rows.products().summed()
    harmonics = np.tile(_FADING.sizes_rad(harmonic_orders(rows.knots)[1:]), len(rows.joints))
    own, every = len(rows.own), len(total.projection)
    seen = rows.survey.poses.measured.components_seen
    for fitted in (every, every - len(harmonics), own):
        sizes = np.concatenate([np.ones(every - len(harmonics)), harmonics])
        sizes[fitted:] *= _NONE
        prior = np.diag(sizes**-2.0)
        taken = float(np.trace(solve(total.gram, total.gram, prior)))
        if taken <= _MOST_TAKEN * seen.sum():
            break
    x = solve(total.gram, total.projection, prior)
    remaining = np.empty(seen.shape)
    for b in range(BLOCKS):
        remaining[rows.survey.block == b] = rows.left_of(b, x[:, None])[:, :, 0]
    return remaining, taken
