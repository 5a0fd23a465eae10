"""What each name is worth: the errors left as the named effects join the model one by one."""

from __future__ import annotations

from dataclasses import dataclass

from pa10cal.calibration.accuracy import Accuracy
from pa10cal.discovery.discover import compare
from pa10cal.discovery.evidence.fit import Fit, fit
from pa10cal.discovery.evidence.problem import Problem
from pa10cal.discovery.gap import Gap
from pa10cal.terms.effects.effect import Effect


@dataclass(frozen=True)
class Named:
    """The model with the first few of the effects.

    Attributes:
        effects: those that are in it, in the order found.
        train, holdout: its errors; None without held-out poses.
    """

    effects: tuple[Effect, ...]
    train: Accuracy
    holdout: Accuracy | None


def errors_by_name(
    problem: Problem, extended: Fit, train: Gap, holdout: Gap | None
) -> tuple[Named, ...]:
    """Return the errors of the calibrated baseline, and as each effect is added, all refitted.

    Args:
        problem: the campaign.
        extended: the model with all effects.
        train, holdout: the gap on averaged poses, before and with all effects.
    """
    variances = (extended.pose_variance, extended.torque_variance)
    steps = [Named((), train.before, None if holdout is None else holdout.before)]
    for count in range(1, len(extended.effects)):
        effects = extended.effects[:count]
        partial = fit(problem, effects, extended.sizes[:count], variances, extended)
        steps.append(
            Named(
                effects,
                compare(problem, partial, train.poses).after,
                None if holdout is None else compare(problem, partial, holdout.poses).after,
            )
        )
    if extended.effects:
        after = None if holdout is None else holdout.after
        steps.append(Named(extended.effects, train.after, after))
    return tuple(steps)
