"""The search for missing effects: which scorer judges a campaign, and its verdict."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pa10cal.calibration.calibrate import check_torques
from pa10cal.discovery.blocked_cv.survey import LEAST_FOR_BLOCKS, enough
from pa10cal.discovery.compliance import with_compliance
from pa10cal.discovery.finding import Unexplained
from pa10cal.discovery.formulas.one_line import with_lines_named
from pa10cal.discovery.formulas.propose import with_proposals
from pa10cal.discovery.gates import gated
from pa10cal.discovery.linear import residual
from pa10cal.discovery.noise import LEAST_DIFFERENCES, LEAST_REPEATED, repeated
from pa10cal.discovery.not_sought import TooLittle, not_sought
from pa10cal.discovery.preparation import MeasurementSetup, Prepared, prepared
from pa10cal.discovery.row_faults import carries, of_wrong_row
from pa10cal.discovery.torque_check import stated_wrongly
from pa10cal.discovery.verdict import is_named, label_of
from pa10cal.errors import DiscoveryError
from pa10cal.fit.uncertain_weights import open_unknowns
from pa10cal.terms.effects.joint_error_map import JointErrorMap

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pa10cal.campaign.findings import InputFinding
    from pa10cal.discovery.finding import Finding
    from pa10cal.discovery.verdict import Verdict
    from pa10cal.fit.fitted_model import FittedModel
    from pa10cal.observe.observations import Observations

#: Components of different poses that there must be for every unknown of the model, where repeats
#: are the judge: else the model's own parameters follow the poses wherever they are.
_ROWS_AN_UNKNOWN = 1.25
#: Attitudes that are typically off by so much are no attitudes of the arm [rad].
_NO_ATTITUDE_RAD = 0.05
#: Poses that carry a name alone and are left out, one after the other.
_MOST_CARRIERS = 3
#: A calibration that started from a model with maps, which searches would have to fit anew.
_HAS_MAPS = TooLittle(
    "the calibrated model has maps of joints already, of the model that it started from",
    "calibrate without the prior to search; or use the model as it is",
)


def discover(
    every: Observations,
    model: FittedModel,
    setup: MeasurementSetup,
    wrong: Sequence[InputFinding] = (),
) -> Verdict[object]:
    """Find which effects are missing from a calibrated model.

    Held-out poses serve nothing but the gap. In a campaign with too few poses or repeats nothing is
    sought, and the verdict says so.

    Args:
        every: single readings of a campaign, of all kinds, with the instrument's covariance.
        model: the calibrated model.
        setup: what is known of the campaign besides its readings, and the options of the search.
        wrong: configurations that are wrong, and not among the readings for that.

    Raises:
        CalibrationError: when a joint with a spring has no torque.
    """
    campaign = prepared(every, model, setup, tuple(map(of_wrong_row, wrong)))
    error_rate = setup.options.error_rate
    found = _judged(campaign, model, error_rate)
    for _ in range(_MOST_CARRIERS):
        # A map is no name: it may well show at one pose.
        carried = [each for each in found.effects if each.carrier and is_named(each.effect)]
        if not carried:
            break
        # One pose is no evidence of what acts in all of them: it is wrong, and the rest decides.
        fault = carries(str(carried[0].carrier), label_of(carried[0].effect, None), carried[0].gain)
        campaign = campaign.without_pose(str(carried[0].carrier), fault)
        without = _judged(campaign, model, error_rate)
        if without.unexplained:
            # The rest does not fit either: nothing says that this pose is worse than the others.
            return with_compliance(_with_formulas(gated(without_names(found, carried))))
        found = without
    return with_compliance(_with_formulas(gated(found)))


def _with_formulas(found: Verdict[object]) -> Verdict[object]:
    """Return a verdict with formulas proposed, and maps named that are one line."""
    return with_lines_named(with_proposals(found))


def without_names(found: Verdict[object], carried: Sequence[Finding[object]]) -> Verdict[object]:
    """Return a verdict without names that one pose carries each: they are unexplained."""
    gone = [each.effect for each in carried]
    fewer = found.with_findings([each for each in found.findings if each.effect not in gone])
    unknown = tuple(
        Unexplained(
            each.of,
            each.id,
            found.train.after.mean_mm,
            f"{label_of(each.effect, None)} fits best, and is no name: pose {each.carrier} alone "
            "carries it",
        )
        for each in carried
    )
    return replace(fewer, unexplained=(*fewer.unexplained, *unknown))


def _judged(campaign: Prepared, model: FittedModel, error_rate: float) -> Verdict[object]:
    """Return the verdict on a campaign made ready, before its gates."""
    if wrong_attitudes := attitudes_off(campaign.trusted, campaign.baseline):
        return not_sought(campaign, model, wrong_attitudes, error_rate)
    if any(isinstance(term, JointErrorMap) for term in model.model.terms):
        return not_sought(campaign, model, _HAS_MAPS, error_rate)
    if judged_by_blocks(campaign.trusted):
        from pa10cal.discovery.blocked_cv.discover import discover_by_blocks

        by_blocks = discover_by_blocks(campaign, error_rate)
        poses, context = by_blocks.survey.poses, by_blocks.context
        wrong = stated_wrongly(poses, campaign.baseline, campaign.setup, context)
        faults = (*by_blocks.faults_of_rows, *wrong)
        return replace(by_blocks, faults_of_rows=faults)
    check_torques(campaign.baseline.model, campaign.readings)
    if lacking := too_little(campaign.trusted, campaign.baseline):
        return not_sought(campaign, model, lacking, error_rate)
    from pa10cal.discovery.evidence.discover import discover_by_repeats

    try:
        return discover_by_repeats(campaign, error_rate)
    except DiscoveryError as error:  # repeats show no noise, as where readings were copied
        lacking = TooLittle(f"{error.what} ({error.value})", error.remedy or "measure them again")
        return not_sought(campaign, model, lacking, error_rate)


def attitudes_off(readings: Observations, baseline: FittedModel) -> TooLittle | None:
    """Return that attitudes are others than the arm's, as in another convention; None if not.

    Args:
        readings: single readings of the poses fitted.
        baseline: the calibrated model.
    """
    for kind, at in readings.measured.component_kinds:
        if not kind.startswith("attitude"):
            continue
        left_rad = np.abs(residual(baseline, readings)[:, at])
        typical_rad = float(np.median(left_rad[readings.measured.components_seen[:, at]]))
        if typical_rad > _NO_ATTITUDE_RAD:
            return TooLittle(
                f"the attitudes are {np.degrees(typical_rad):.0f} deg off those of the calibrated "
                "model, typically",
                "check the order and the sense of qw, qx, qy, qz, and the findings of the "
                "calibration",
            )
    return None


def judged_by_blocks(readings: Observations) -> bool:
    """Return whether effects are judged by blocks of poses held out, and not by repeats.

    Args:
        readings: single readings of the poses fitted.
    """
    repeats = repeated(readings)
    return enough(len(readings)) and repeats < max(
        LEAST_DIFFERENCES, LEAST_REPEATED * len(readings)
    )


def too_little(readings: Observations, baseline: FittedModel) -> TooLittle | None:
    """Return what a campaign lacks for a search that is judged by repeats; None for nothing.

    Args:
        readings: single readings of the poses fitted, without gross errors.
        baseline: the calibrated model.
    """
    repeats = repeated(readings)
    if repeats < LEAST_DIFFERENCES:
        return TooLittle(
            f"{len(readings)} readings of calibration poses are too few to hold out blocks of "
            f"them, and with {repeats} repeats the repeatability is not known",
            f"measure at least {LEAST_FOR_BLOCKS} calibration poses, or repeat at least "
            f"{LEAST_DIFFERENCES} readings at the same pose, load and direction of arrival",
        )
    poses = len(np.unique(readings.pose))
    unknowns = open_unknowns(baseline.model) + 6 + len(baseline.targets_m)
    components = float(readings.measured.components_seen.sum(axis=1).mean())
    needed = int(np.ceil(_ROWS_AN_UNKNOWN * unknowns / components))
    if poses < needed:
        return TooLittle(
            f"{poses} calibration poses are too few to separate an effect from the {unknowns} "
            "unknowns of the model",
            f"measure at least {needed} calibration poses, well spread over the joints' ranges",
        )
    return None
