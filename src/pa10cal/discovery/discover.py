"""The search for missing effects, from a campaign to its verdict: scorer, checks, field.

A campaign in which effects cannot be sought gets a verdict that says why.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, TypeVar

from pa10cal.calibration.noisy_campaign import noisy_campaign
from pa10cal.calibration.two_level_fit import check_torques
from pa10cal.discovery.blocked_cv.survey import judged_by_blocks
from pa10cal.discovery.compliance import with_compliance
from pa10cal.discovery.field import FieldFit, field_of, with_field
from pa10cal.discovery.finding import Finding, is_named, label_of
from pa10cal.discovery.gap import Gaps, PairedErrors, errors_of
from pa10cal.discovery.gates import gated
from pa10cal.discovery.joint_steps import JointSteps
from pa10cal.discovery.log_faults import (
    DiagnosedFault,
    fault_of_influential_pose,
    fault_of_quarantined,
    faults_of_input,
)
from pa10cal.discovery.loose_targets import knocked_targets, loose_targets
from pa10cal.discovery.nameless import nameless_effects
from pa10cal.discovery.no_harm import limits, only_within, worse_than
from pa10cal.discovery.not_sought import (
    HAS_MAPS,
    CannotSearch,
    not_sought,
    orientations_off,
    too_few_poses,
)
from pa10cal.discovery.other_explanations import with_doubt, with_other_readings
from pa10cal.discovery.preparation import MeasurementSetup, Prepared, complete, prepared
from pa10cal.discovery.probabilities import with_likely_alternatives
from pa10cal.discovery.proposals import with_lines_named, with_proposals
from pa10cal.discovery.refitted_verdict import without_names
from pa10cal.discovery.repeats import repeated
from pa10cal.discovery.rules import JUDGING, NOISE
from pa10cal.discovery.sessions import (
    changed_between_repeats,
    is_moved_in_order,
    moved_in_order,
)
from pa10cal.discovery.torque_faults import stated_wrongly, with_errors_of_log
from pa10cal.discovery.verdict import (
    Predicted,
    Scorer,
    Verdict,
    is_sought,
)
from pa10cal.errors import CalibrationError, DiscoveryError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.observe.time_order import measured_again
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import is_error_map

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from pa10cal.results.calibration import InputFinding

S = TypeVar("S", bound=Scorer)


def discover(
    every: Observations,
    model: FittedModel,
    setup: MeasurementSetup,
    wrong: Sequence[InputFinding] = (),
) -> Verdict:
    """Find which effects are missing from a calibrated model.

    With too few poses or repeats, effects are not sought, and the verdict says why.

    Args:
        every: single readings of all kinds, with the covariance that the instrument states;
            held-out ones are used for the gap alone.
        model: the calibrated model.
        setup: what is known of the campaign besides the readings.
        wrong: findings about configurations that ingest quarantined, which are not in `every`; they
            become faults of the verdict.

    Raises:
        CalibrationError: when a joint with a spring has no torque.
    """
    faults = tuple(map(fault_of_quarantined, wrong))
    campaign = prepared(every, model, setup, faults)
    campaign = _without_joint_steps(campaign, every, model, faults)
    found = _since_joint_steps(_judged(campaign, model), every, model, faults)
    found = _without_influential_poses(found, model)
    if is_sought(found):
        found = with_lines_named(with_proposals(_likelier(found, gated(found))))
        found = _with_campaigns_compared(found)
    found = with_likely_alternatives(with_predicted(with_compliance(found)))
    return with_errors_of_log(with_doubt(with_other_readings(found)))


def _without_joint_steps(
    campaign: Prepared,
    every: Observations,
    model: FittedModel,
    faults: Sequence[DiagnosedFault],
) -> Prepared:
    """Return a campaign of repeats as since the last of the steps in the zeros of its joints.

    Repeats before and after a step differ: as their noise it would hide what the model lacks, and
    right readings would count as gross errors.
    """
    readings = campaign.readings
    few = repeated(readings) < NOISE.least_differences and not measured_again(readings)
    if few or judged_by_blocks(campaign.trusted):
        return campaign
    from pa10cal.discovery.evidence.by_repeats import joint_steps_between_repeats

    def corrected(steps: JointSteps, found: Sequence[DiagnosedFault] = ()) -> Prepared:
        return prepared(every, model, campaign.setup, (*faults, *found), steps.moved)

    try:
        steps = joint_steps_between_repeats(campaign, corrected)
    except (CalibrationError, DiscoveryError):  # too few poses, or torques that a spring lacks
        return campaign
    if steps is None:
        return campaign
    return corrected(steps, steps.faults(campaign.baseline, campaign.readings))


def _since_joint_steps(
    found: Verdict, every: Observations, model: FittedModel, faults: Sequence[DiagnosedFault]
) -> Verdict:
    """Return the verdict of blocks on the arm as it is since the last step of a joint's zero.

    The search took up the steps beside the model, which is that of the arm before them; a campaign
    that is corrected by them is judged anew. That of repeats was before its search.
    """
    if (moved := found.scorer.moved) is None:
        return found
    steps = tuple(fault for fault in found.faults_of_rows if fault.remedy_if_corrected)
    return _judged(prepared(every, model, found.prepared.setup, (*faults, *steps), moved), model)


def _without_influential_poses(found: Verdict, model: FittedModel) -> Verdict:
    """Return the verdict without poses on each of which alone the evidence of a name rests.

    An effect acts in all poses, so such a pose has a fault, and the campaign is judged again
    without it. If the effect is then named by the other poses, there is evidence without this one,
    and nothing is wrong with it: it may be the pose that was suggested to show the effect. If an
    unexplained error then remains, the other poses do not fit either, and nothing
    shows that this pose is worse: it stays, and the names are withdrawn instead. So they are where
    the other poses are too few to be judged, and names that rest on one pose after the most poses
    that may be left out.
    """
    shown: set[Effect] = set()  # effects that the other poses show as well
    for _ in range(JUDGING.most_carriers):
        pose_of = _carried_by_one_pose(found, shown)
        if not pose_of:
            return found
        first, pose = next(iter(pose_of.items()))
        fault = fault_of_influential_pose(pose, label_of(first.effect, None), first.proof.explains)
        without = _judged(found.prepared.without_pose(pose, fault), model)
        others = [one.effect for one in without.effects if one.proof.influential_pose is None]
        if first.effect in others:
            shown.add(first.effect)
            continue
        if without.unexplained or not is_sought(without):
            break
        found = without
    pose_of = _carried_by_one_pose(found, shown)
    reasons = {one: f"pose {pose} alone carries it" for one, pose in pose_of.items()}
    return without_names(found, reasons) if is_sought(found) and reasons else found


def _carried_by_one_pose(found: Verdict, shown: Collection[Effect]) -> dict[Finding, str]:
    """Return the names whose evidence rests on one pose, and that pose; none without a search.

    Args:
        shown: effects that are named without that pose, too.
    """
    # A map states no cause, and may be shown by a single pose.
    return {
        one: one.proof.influential_pose
        for one in found.effects
        if one.proof.influential_pose is not None
        and is_named(one.effect)
        and one.effect not in shown
    }


def _with_campaigns_compared(found: Verdict) -> Verdict:
    """Return a verdict in which campaigns contradict each other only as the effects found leave it.

    Without any the calibration's own comparison stands.
    """
    of_input = found.prepared.faults
    if not found.findings or not any(fault.between_campaigns for fault in of_input):
        return found
    left = found.scorer.contradictions()
    if left is None:
        return found
    others = (fault for fault in of_input if not fault.between_campaigns)
    faults = (*others, *faults_of_input(left))
    prepared = replace(found.prepared, faults=faults)
    return replace(found, prepared=prepared, campaigns_agree=not left)


def _likelier(found: Verdict[S], passed: Verdict[S]) -> Verdict[S]:
    """Return the verdict of a search with a likelier set of effects if that passes the gates.

    Else `passed`, the verdict itself after the gates.
    """
    candidate = found.scorer.likelier(found) if found.weights_assumed else None
    if candidate is not None:
        likelier = gated(candidate)
        falls_back = likelier.falls_back is not None and passed.falls_back is None
        if not (falls_back or likelier.verdict == "check_the_log"):
            return likelier
    return passed


def with_predicted(found: Verdict) -> Verdict:
    """Return a verdict that also predicts errors without a name, by a field of the poses fitted.

    Not where the log is to be checked or the base moved: such errors do not depend on the joints.
    Where the effects hold nowhere, the field is added to the calibrated model.
    """
    if found.verdict in ("not_sought", "check_the_log"):
        return found
    if found.train.without_motion is not None or any(map(is_moved_in_order, found.unexplained)):
        return found
    by_names = found.baseline if found.holds_nowhere else found.extended.fitted()
    fit = field_of(by_names, found.train.poses, _nameless(found, by_names))
    return found if fit is None else _with_field_if_no_worse(found, by_names, fit)


def _with_field_if_no_worse(found: Verdict, by_names: FittedModel, fit: FieldFit) -> Verdict:
    """Return the verdict with a field if held-out poses are predicted no worse by it.

    The field was chosen by the poses fitted, so that others have to judge it. Limits within which
    the effects hold are lifted if the poses beyond them are predicted no worse with the field.
    """
    falls_back = found.falls_back
    within = None if falls_back is None or found.holds_nowhere else falls_back.within
    unlimited = found if within is None else _unlimited(found, by_names)
    everywhere = _predicting(unlimited, by_names, fit)
    if worse_than(everywhere.trusted_holdout, unlimited.trusted_holdout):
        return found
    if within is None or limits(everywhere) is None:
        return everywhere
    return only_within(_predicting(found, by_names, fit), within)


def _unlimited(found: Verdict, by_names: FittedModel) -> Verdict:
    """Return the verdict with the model of its names in all poses, whatever its limits."""
    return replace(found, falls_back=None).with_gaps(partial(_found_by, by_names))


def _predicting(found: Verdict, by_names: FittedModel, fit: FieldFit) -> Verdict:
    """Return the verdict with the errors that its names and the field leave."""
    predicted = Predicted(fit, Gaps(found.train, found.holdout))
    falls_back = found.falls_back
    if falls_back is not None and found.holds_nowhere:
        why = f"{falls_back.why}, with what has no name predicted beside it"
        falls_back = replace(falls_back, why=why)
    found = replace(found, predicted=predicted, falls_back=falls_back)
    return found.with_gaps(partial(_found_by, with_field(by_names, fit)))


def _found_by(model: FittedModel, errors: PairedErrors) -> PairedErrors:
    """Return errors before and after, those after being of another model."""
    return replace(errors, found_after=errors_of(model, errors.poses))


def _nameless(found: Verdict, model: FittedModel) -> tuple[Effect, ...]:
    """Return the effects that may predict errors without a name.

    None where poses are repeated: all readings of an apparatus share its errors, held-out ones
    included, so that held-out poses cannot judge such effects.
    """
    if not judged_by_blocks(found.prepared.trusted):
        return ()
    logged, held = found.prepared.torques == "logged", model.model.terms
    without_name = (*found.without_name, *(each.effect for each in found.effects))
    arriving = {each.arriving[0] for each in without_name if len(each.arriving) == 1}
    return nameless_effects(found.context, found.states, held, logged=logged, arriving=arriving)


def _judged(campaign: Prepared, model: FittedModel) -> Verdict:
    """Return the verdict of the scorer that suits a campaign, before its gates.

    What is unexplained is attributed to knocked targets, else to loose ones, else to a motion in
    the order of rows without times or a noisy campaign of a group.
    """
    found, readings = _by_scorer(campaign, model), campaign.trusted
    slipped = any(fault.kind == "step_in_time" for fault in found.faults_of_rows)
    if slipped and judged_by_blocks(readings):
        # Blocks tell a step of the base from a target that slipped once.
        return _attributed_to_order(_attributed_to_noisy_campaign(found))
    if knocked := knocked_targets(readings):
        # Its step looks like errors of other places, so that it stands for all of them.
        return replace(found, unexplained=knocked)
    if slipped:
        # One step is no target that is loose all the time.
        return _attributed_to_order(_attributed_to_noisy_campaign(found))
    if loose := loose_targets(readings):
        # It stands for what is unexplained at no place.
        placed = tuple(each for each in found.unexplained if each.of is not None)
        return replace(found, unexplained=(*loose, *placed))
    return _attributed_to_order(_attributed_to_noisy_campaign(found))


def _attributed_to_order(found: Verdict) -> Verdict:
    """Return the verdict, what is unexplained being a motion in the order of the rows, if it is.

    What names and formulas those rows suggest together is not told.
    """
    if found.verdict == "check_the_log":
        return found
    prepared, at = found.prepared, found.extended.fitted()
    readings = complete(prepared.trusted, prepared.baseline, prepared.setup, at)
    # Where times are known, all that was sought includes changes in time, or had too few readings.
    open_to_time = not readings.states.tells_time or not is_sought(found)
    between = changed_between_repeats(at, readings) if open_to_time else None
    if between is not None:
        return replace(found, unexplained=(between, *found.unexplained), nameless=())
    if not found.unexplained:
        return found
    moved = moved_in_order(found.extended.fitted(), found.train.poses)
    return found if moved is None else replace(found, unexplained=(moved,), nameless=())


def _attributed_to_noisy_campaign(found: Verdict) -> Verdict:
    """Return the verdict, what is unexplained at no place being of a campaign that is noisy.

    Not where the log is to be checked: that may be why a campaign is.
    """
    poses, error_mm = found.train.poses, found.train.found_after.distance_mm
    noisy = noisy_campaign(poses, error_mm, poses.measured.stated_covariance)
    if noisy is None or found.verdict == "check_the_log":
        return found
    of = f"campaign {noisy.name}"
    parts = (
        each.model_copy(update={"of": of, "why": f"{each.why}; {noisy}"})
        if each.of is None
        else each
        for each in found.unexplained
    )
    return replace(found, unexplained=tuple(parts))


def _by_scorer(campaign: Prepared, model: FittedModel) -> Verdict:
    readings = complete(campaign.trusted, campaign.baseline, campaign.setup)
    if wrong_convention := orientations_off(readings, campaign.baseline):
        return not_sought(campaign, model, wrong_convention)
    if any(is_error_map(term) for term in model.model.terms):
        return not_sought(campaign, model, HAS_MAPS)
    if judged_by_blocks(campaign.trusted):
        from pa10cal.discovery.blocked_cv.by_blocks import discover_by_blocks

        found = discover_by_blocks(campaign)
        poses = found.scorer.survey.poses
        faults = stated_wrongly(poses, campaign.baseline, campaign.setup, found.context)
        return replace(found, faults_of_rows=(*found.faults_of_rows, *faults))
    check_torques(campaign.baseline.model, campaign.readings)
    if lacking := too_few_poses(campaign.trusted, campaign.baseline):
        return not_sought(campaign, model, lacking)
    from pa10cal.discovery.evidence.by_repeats import discover_by_repeats

    try:
        return discover_by_repeats(campaign)
    except DiscoveryError as error:  # repeats show no noise, as where readings were copied
        reason = CannotSearch(f"{error.what} ({error.value})", error.remedy)
        return not_sought(campaign, model, reason)
