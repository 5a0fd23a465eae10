"""How far models are from measured poses: what a fit has seen, and name by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.calibration.accuracy import Accuracy, summarise
from pa10cal.discovery.blocked_cv.finest import Level
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.gap import Gap, Named, gap, left_by
from pa10cal.discovery.in_time.wander import moved_frames
from pa10cal.discovery.linear import possible_sizes
from pa10cal.discovery.preparation import complete_about
from pa10cal.discovery.with_effects import moved_base
from pa10cal.fit.angles_seen import AnglesSeen
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.model import Model

Array = NDArray[np.float64]


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
    after = left_by(extended, poses, T_moved)
    return gap(poses, campaign.baseline, after, noise_floor_mm, seen, T_moved)


def _moved(campaign: Survey, poses: Observations) -> Array | None:
    """Return how the base had moved at poses, (P, 4, 4); None where it had not."""
    if campaign.wander is None:
        return None
    return moved_frames(campaign.wander.motions(poses.states.time_s))


def errors_by_name(
    campaign: Survey,
    level: Level,
    effects: tuple[Effect, ...],
    train: Gap,
    holdout: Gap | None,
) -> tuple[Named, ...]:
    """Return the errors of the calibrated model, and as each effect joins it.

    Between the first and the last, which are the fits themselves, parameters are by linear least
    squares.

    Args:
        campaign: whose model it is.
        level: the effects, in the order found.
        effects: those of the fit itself.
        train, holdout: the gap before and with all effects.
    """
    every = [train] if holdout is None else [train, holdout]
    baseline = campaign.baseline
    sizes = possible_sizes(campaign.model(), campaign.poses.measured)
    steps = [_named((), [found.before for found in every])]
    for count in range(1, len(level.members)):
        own, amounts = level.fit(count)
        of_terms, base, targets = np.split(
            sizes * own[: len(sizes)], [len(baseline.x), len(baseline.x) + 6]
        )
        joined = tuple(member.effect for member in level.members[:count])
        model = replace(
            baseline,
            model=Model(baseline.model.chain, (*baseline.model.terms, *joined)),
            x=np.concatenate([baseline.x + of_terms, *amounts]),
            T_instr_base=moved_base(baseline.T_instr_base, base),
            targets_m=baseline.targets_m + targets,
        )
        steps.append(
            _named(
                joined,
                [
                    summarise(left_by(model, found.poses, _moved(campaign, found.poses)))
                    for found in every
                ],
            )
        )
    if effects:
        steps.append(_named(effects, [found.after for found in every]))
    return tuple(steps)


def _named(effects: tuple[Effect, ...], errors: list[Accuracy]) -> Named:
    return Named(effects, errors[0], errors[1] if len(errors) > 1 else None)
