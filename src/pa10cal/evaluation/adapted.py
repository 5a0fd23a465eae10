"""A model adapted to the first poses of another campaign, and judged on those held out there."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload
from pa10cal.calibration.general.calibrate import calibrate_general, find_start
from pa10cal.calibration.general.case import fitted
from pa10cal.calibration.general.prior import calibrate_from, prior_of
from pa10cal.calibration.general.transfer import refit_frames, with_tool_of
from pa10cal.calibration.uncertainty import summarise
from pa10cal.errors import CalibrationError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations, average_repeats
from pa10cal.observe.order import with_arrivals
from pa10cal.results.comparison import AdaptedStep
from pa10cal.results.evaluation import Accuracy


def adapted_steps(
    model: FittedModel,
    arm: Arm,
    every: Observations,
    payload: Payload | None,
    shares: Sequence[float],
    say: Callable[[str], None],
) -> tuple[AdaptedStep, ...]:
    """Adapt a model to the first configurations of a campaign, more and more of them.

    Args:
        model: fitted to another campaign of the arm, with its covariance.
        arm: the nominal arm.
        every: single readings of the campaign, of all kinds.
        payload: what the arm carries there; None where it is not known.
        shares: parts of all configurations.
        say: takes one line for each part.

    Raises:
        CalibrationError: when the model is of another arm, its covariance is not known, or the
            poses do not determine base and tool.
    """
    every, _ = with_arrivals(every)
    fitted_poses, away = average_repeats(every.of_kind("grid")), _held_out(every)
    in_time = fitted_poses.take(np.argsort(fitted_poses.states.time_s, kind="stable"))
    total = len(fitted_poses) + len(away)
    logged = bool(np.isfinite(every.states.tau_Nm).all())

    def judged(found: FittedModel) -> Accuracy:
        return summarise(found.deviations(away.with_states(found.as_modelled(away).states)))

    steps = []
    for share in shares:
        some = in_time.take(slice(max(3, round(share * total))))
        start = find_start(arm, some)
        general = calibrate_from(prior_of(model, arm, payload), arm, some, start, payload)
        frames = alone = None
        try:
            there = with_tool_of(model, payload, logged=logged)
            frames = judged(refit_frames(there, there.as_modelled(some)))
            alone = judged(fitted(calibrate_general(arm, some, start, payload)))
        except CalibrationError:
            pass  # too few poses for these; a prior needs fewer
        assert general.prior is not None
        steps.append(
            AdaptedStep(
                share=share,
                configurations=len(some),
                prior=judged(fitted(general)),
                frames=frames,
                alone=alone,
                line=general.prior.line,
            )
        )
        last = steps[-1]
        beside = ", ".join(
            f"{name} {each.rms_mm:.3f}"
            for name, each in (("base and tool alone", frames), ("without the prior", alone))
            if each is not None
        )
        say(
            f"{last.configurations} configurations: {last.prior.rms_mm:.3f} mm rms held out"
            + (f" ({beside})" if beside else "")
        )
    return tuple(steps)


def _held_out(every: Observations) -> Observations:
    """Return the configurations held out.

    Raises:
        CalibrationError: when there are none.
    """
    single = every.of_kind("holdout")
    if not len(single):
        raise CalibrationError(
            "nothing is held out to judge by",
            where="rows of kind holdout",
            allowed="at least one",
            remedy="mark some configurations as holdout in the raw files",
        )
    return average_repeats(single)
