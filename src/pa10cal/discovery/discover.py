"""The whole search on one campaign: from single readings to a verdict and an extended model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.calibration.calibrate import check_torques
from pa10cal.discovery.contest import Pair
from pa10cal.discovery.evidence.candidates import testable
from pa10cal.discovery.evidence.fit import Fit, apparatus_m, as_read, fit
from pa10cal.discovery.evidence.judge import Judgement, floor_mm, judge
from pa10cal.discovery.evidence.problem import Problem, prepare
from pa10cal.discovery.evidence.search import Found, search
from pa10cal.discovery.gap import Gap, gap
from pa10cal.discovery.preparation import MeasurementSetup, complete_about
from pa10cal.discovery.verdict import NotTestable
from pa10cal.errors import DiscoveryError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.averages import average_repeats
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.family import candidates

Array = NDArray[np.float64]

#: Components of different poses that there must be for every unknown of the model.
_ROWS_AN_UNKNOWN = 1.25
#: Pairs for which configurations are chosen, the found ones first.
_MOST_PAIRS = 8


@dataclass(frozen=True)
class Discovery:
    """What became of a campaign.

    Attributes:
        problem: the campaign as it was weighed.
        start: the baseline, fitted as everything else is.
        family: candidates that these data can show.
        not_testable: those that they cannot.
        alike: groups of named candidates that these poses cannot tell apart.
        judgement: the verdict and what it rests on.
        extended: the model with the effects found, and nothing generic in it.
        noise_floor_mm: mean position error that repeatability alone would leave.
        train, holdout: the gap before and after; None without held-out poses.
    """

    problem: Problem
    start: Fit
    family: tuple[Effect, ...]
    not_testable: tuple[NotTestable, ...]
    alike: tuple[tuple[Effect, ...], ...]
    judgement: Judgement
    extended: Fit
    noise_floor_mm: float
    train: Gap
    holdout: Gap | None


def discover(
    readings: Observations[Pose],
    held_out: Observations[Pose] | None,
    baseline: FittedModel,
    setup: MeasurementSetup,
    error_rate: float,
) -> Discovery:
    """Search a campaign for missing effects.

    Args:
        readings: single readings of the grid poses, with the instrument's covariance.
        held_out: averaged held-out poses, used for nothing but the gap; None where there are none.
        baseline: the calibrated model; its chain has the bends of the long links.
        setup: what is known besides the poses.
        error_rate: probability allowed of naming anything where nothing is missing.

    Raises:
        DiscoveryError: when there are too few poses, or too little is repeated.
        CalibrationError: when a joint with a spring has no torque.
    """
    _check_enough(readings, baseline)
    check_torques(baseline.model, readings)
    problem = prepare(readings, baseline, setup)
    start = fit(problem, (), (), (0.0, 0.0))
    family, refused = testable(problem, start, candidates(problem.context))
    judgement = judge(search(problem, family, error_rate, start))
    problem = judgement.found.problem
    extended = _extended(problem, judgement)
    grid = average_repeats(readings)
    return Discovery(
        problem=problem,
        start=start,
        family=family,
        not_testable=refused,
        alike=_groups(judgement.found),
        judgement=judgement,
        extended=extended,
        noise_floor_mm=floor_mm(problem),
        train=compare(problem, extended, grid),
        holdout=None
        if held_out is None or not len(held_out)
        else compare(problem, extended, held_out),
    )


def _check_enough(readings: Observations[Pose], baseline: FittedModel) -> None:
    """Refuse poses that the model's own parameters could follow wherever they are."""
    poses = len(np.unique(readings.pose))
    unknowns = len(baseline.model.parameters) + 6
    needed = int(np.ceil(_ROWS_AN_UNKNOWN * unknowns / 6))
    if poses < needed:
        raise DiscoveryError(
            "too few poses to tell an effect from the model's own parameters",
            where="grid poses",
            value=poses,
            allowed=f"at least {needed} poses for {unknowns} unknowns",
            remedy="measure more poses, well spread over the joints' ranges",
        )


def unresolved(found: Discovery) -> tuple[Pair, ...]:
    """Return what other poses might tell: each finding against its alternatives, the not testable.

    An effect that is not testable has no rival but the model's own parameters.
    """
    rivals = [
        (finding.effect, other)
        for finding in found.judgement.findings
        for other in finding.alternatives
    ]
    alone: list[Pair] = [
        (entry.effect, None)
        for entry in found.not_testable
        if entry.by_these_poses and not entry.effect.generic
    ]
    return (*rivals, *alone)[:_MOST_PAIRS]


def compare(problem: Problem, extended: Fit, poses: Observations[Pose]) -> Gap:
    """Return the gap of baseline and extended model on averaged poses."""
    baseline = problem.baseline
    about = FittedModel(extended.model, extended.x, extended.level.T_instr_base)
    poses = complete_about(poses, baseline, about, problem.setup)
    return gap(
        poses,
        (baseline.model.predict(poses.states, baseline.x), baseline.T_instr_base),
        (
            as_read(
                extended.model.predict(poses.states, extended.x),
                extended.level.T_instr_base,
                poses,
                apparatus_m(problem, extended),
            ),
            extended.level.T_instr_base,
        ),
        floor_mm(problem, poses.readings),
    )


def _extended(problem: Problem, judgement: Judgement) -> Fit:
    """Return the model with the named effects alone, recalibrated where that changes it."""
    found = judgement.found
    named = tuple(finding.effect for finding in judgement.findings)
    if named == found.fit.effects:
        return found.fit
    sizes = dict(zip(found.fit.effects, found.fit.sizes, strict=True))
    variances = (found.score.pose_variance, found.score.torque_variance)
    return fit(problem, named, tuple(sizes[effect] for effect in named), variances, found.fit)


def _groups(found: Found) -> tuple[tuple[Effect, ...], ...]:
    """Return groups of effects that look the same in these poses, whatever was measured."""
    groups = {tuple(np.flatnonzero(row).tolist()) for row in found.same}
    return tuple(
        tuple(found.family[k] for k in group) for group in sorted(groups) if len(group) > 1
    )
