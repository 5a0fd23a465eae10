"""How far models are from measured poses: inside the angles seen and beyond, name by name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.calibration.accuracy import Accuracy, deviations, summarise
from pa10cal.discovery.blocked_cv.finest import Level
from pa10cal.discovery.blocked_cv.refit import Refit
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.gap import Gap, gap
from pa10cal.discovery.naming import Named
from pa10cal.discovery.operating_point import moved_base, possible_sizes
from pa10cal.discovery.preparation import complete_about
from pa10cal.fit.angles_seen import AnglesSeen
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PartedGap:
    """The gap on P poses: over all, and over those that keep to the angles seen in the fit.

    Attributes:
        whole: over all of them.
        inside: (P,) which keep to the angles seen; what holds for the others is extrapolated.
        before_inside, after_inside: accuracies over these; None where there is none.
        before_beyond, after_beyond: over the others.
    """

    whole: Gap
    inside: NDArray[np.bool_]
    before_inside: Accuracy | None
    after_inside: Accuracy | None
    before_beyond: Accuracy | None
    after_beyond: Accuracy | None


def compare(
    campaign: Survey,
    extended: Refit,
    seen: AnglesSeen,
    poses: Observations[Pose],
    noise_floor_mm: float,
) -> PartedGap:
    """Return the gap of calibrated and extended model on some poses.

    Args:
        campaign: whose model it is.
        extended: the model with effects.
        seen: angles that its fit has seen.
        poses: measured poses, attitudes and torques as the model has them.
        noise_floor_mm: mean error that noise alone would leave.
    """
    baseline = campaign.baseline
    about = FittedModel(extended.model, extended.x, extended.T_instr_base)
    poses = complete_about(poses, baseline, about, campaign.setup)
    found = gap(
        poses,
        (baseline.model.predict(poses.states, baseline.x), baseline.T_instr_base),
        (extended.model.predict(poses.states, extended.x), extended.T_instr_base),
        noise_floor_mm,
    )
    inside = seen.inside(poses.states.q_rad)
    parts = [
        summarise(deviations_, rows) if rows.any() else None
        for rows in (inside, ~inside)
        for deviations_ in (found.found_before, found.found_after)
    ]
    return PartedGap(found, inside, *parts)


def errors_by_name(
    campaign: Survey, level: Level, train: PartedGap, holdout: PartedGap | None
) -> tuple[Named, ...]:
    """Return the errors of the calibrated model, and as each effect joins it.

    Between the first and the last, which are the fits themselves, parameters are by linear least
    squares.

    Args:
        campaign: whose model it is.
        level: the effects, in the order found.
        train, holdout: the gap before and with all effects.
    """
    every = [train.whole] if holdout is None else [train.whole, holdout.whole]
    baseline = campaign.baseline
    sizes = possible_sizes(campaign.model())
    steps = [_named((), [found.before for found in every])]
    for count in range(1, len(level.members)):
        own, amounts = level.fit(count)
        small = sizes * own
        effects = tuple(member.effect for member in level.members[:count])
        model = Model(baseline.model.chain, (*baseline.model.terms, *effects))
        x = np.concatenate([baseline.x + small[:-6], *amounts])
        T_instr_base = moved_base(baseline.T_instr_base, small[-6:])
        errors = [
            summarise(deviations(model.predict(found.poses.states, x), T_instr_base, found.poses))
            for found in every
        ]
        steps.append(_named(effects, errors))
    if level.members:
        effects = tuple(member.effect for member in level.members)
        steps.append(_named(effects, [found.after for found in every]))
    return tuple(steps)


def _named(effects: tuple[Effect, ...], errors: list[Accuracy]) -> Named:
    return Named(effects, errors[0], errors[1] if len(errors) > 1 else None)
