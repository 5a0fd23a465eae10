"""How far models are from measured poses: what a fit has seen, and name by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from pa10cal.arrays import Array
from pa10cal.discovery.blocked_cv.refit import Refit
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.gap import Gap, Named, gap, in_order, left_by
from pa10cal.discovery.in_time.wander import moved_frames
from pa10cal.discovery.linear import by_targets, by_terms, possible_sizes
from pa10cal.discovery.preparation import complete_about
from pa10cal.discovery.with_effects import at_unknowns
from pa10cal.fit.angles_seen import AnglesSeen
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.least_squares import Bounds
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import JointErrorMap

#: Steps of a fit that sets out nearby.
_STEPS = 3


def compare(
    campaign: Survey,
    extended: FittedModel,
    seen: AnglesSeen | None,
    poses: Observations,
    noise_floor_mm: float,
) -> Gap:
    """Return the gap of calibrated and extended model on some poses.

    Args:
        campaign: whose model it is.
        extended: the model with effects.
        seen: joint positions that its maps have learnt from; None without a map.
        poses: measured poses, attitudes and torques as the model has them.
        noise_floor_mm: mean error that noise alone would leave.
    """
    poses = complete_about(poses, campaign.baseline, extended, campaign.setup)
    T_moved = _moved(campaign, poses)
    return gap(poses, campaign.baseline, extended, noise_floor_mm, seen, T_moved)


def _moved(campaign: Survey, poses: Observations) -> Array | None:
    """Return how the base had moved at poses, (P, 4, 4); None where it had not."""
    if campaign.wander is None:
        return None
    return moved_frames(campaign.wander.motions(poses.states.time_s))


def errors_by_name(
    campaign: Survey, extended: Refit, train: Gap, holdout: Gap | None
) -> tuple[Named, ...]:
    """Return the errors of the calibrated model, and as each effect joins it.

    What all together would miss most joins first. Between first and last, which are the fits
    themselves, maps are as the extended model has them, and all else is fitted again.

    Args:
        campaign: whose model it is.
        extended: the model with all effects.
        train, holdout: the gap before and with all effects.
    """

    def with_only(some: tuple[Effect, ...]) -> Named:
        model = _with_only(campaign, extended, some)
        held_out = None if holdout is None else left_by(model, holdout.poses)
        return Named(some, left_by(model, train.poses), held_out)

    return in_order(train, holdout, extended.effects, with_only)


def _with_only(campaign: Survey, extended: Refit, some: tuple[Effect, ...]) -> FittedModel:
    """Return the model with some of its effects, maps as they are, all else fitted again."""
    poses, own = campaign.poses, extended.own_columns()
    x = extended.x.copy()
    for effect in extended.effects:
        if effect not in some:
            first = extended.columns_of(effect).start
            x[first : first + effect.linear] = 0.0
    # Maps stay as they are; an effect of few parameters takes other amounts beside others.
    joined = [each for each in some if not isinstance(each, JointErrorMap)]
    terms = [term for term in extended.model.terms if term not in extended.effects]
    places = [
        np.arange(first, first + each.linear)
        for each in joined
        for first in [extended.columns_of(each).start]
    ]
    baseline, measured = campaign.baseline, poses.measured
    expected = np.diag(possible_sizes(campaign.model(), measured))
    middle = np.zeros(len(own) + sum(map(len, places)))
    middle[: len(baseline.x)] = baseline.x
    middle[len(own) - len(baseline.targets_m) : len(own)] = baseline.targets_m
    sizes = block_diag(expected, *(each.prior_factor for each in joined))
    free = np.concatenate([own, *places])
    whiten = extended.weights.whiteners(np.arange(len(poses)))
    bounds = Bounds.of((*extended.model.parameters, *measured.target_parameters))
    for _ in range(_STEPS):
        at = at_unknowns(extended.at, x)
        points = [at.x[at.model.columns_of(term)] for term in (*terms, *joined)]
        found = by_terms(at, poses, (*terms, *joined), points)
        amounts = [
            columns[:, :, : each.linear]
            for columns, each in zip(found[len(terms) :], joined, strict=True)
        ]
        columns = [*found[: len(terms)], by_targets(at, poses), *amounts]
        rows = (whiten @ np.concatenate(columns, axis=2)).reshape(-1, len(free)) @ sizes
        left = (whiten @ campaign.left_by(at)[:, :, None]).ravel()
        off = np.linalg.solve(sizes, x[free] - middle)
        step = np.linalg.solve(rows.T @ rows + np.eye(len(free)), rows.T @ left + off)
        x[free] -= sizes @ step
        x = bounds.clip(x)
    return replace(extended, at=at_unknowns(extended.at, x)).fitted()
