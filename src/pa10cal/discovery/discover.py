"""The search for missing effects: which scorer judges a campaign, and its verdict."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from typing_extensions import override

from pa10cal.arrays import Array
from pa10cal.calibration.calibrate import check_torques
from pa10cal.discovery import linear
from pa10cal.discovery.blocked_cv.survey import LEAST_FOR_BLOCKS
from pa10cal.discovery.compliance import stated_wrongly, with_compliance
from pa10cal.discovery.field import field_of, with_field
from pa10cal.discovery.gap import PairedErrors, errors_of, gap
from pa10cal.discovery.gates import fitted_instead, gated
from pa10cal.discovery.lack_of_fit import CellResiduals, lack_of_fit
from pa10cal.discovery.nameless import nameless_effects
from pa10cal.discovery.no_harm import harmed, harmless, limits, only_within
from pa10cal.discovery.noise import mean_covariance, noise_of_near_poses, repeated
from pa10cal.discovery.preparation import MeasurementSetup, Prepared, complete, context_of, prepared
from pa10cal.discovery.row_faults import influential_pose, of_wrong_row
from pa10cal.discovery.rules import CANDIDATES, FORMS, JUDGING, NOISE
from pa10cal.discovery.short_forms import FormulaProposal, choose
from pa10cal.discovery.verdict import (
    Basis,
    Predicted,
    Scorer,
    Verdict,
    is_named,
    is_sought,
    label_of,
    with_likely,
    without_names,
)
from pa10cal.errors import DiscoveryError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.weighed_arm import open_unknowns
from pa10cal.observe.observations import Observations, average_repeats, reading_groups
from pa10cal.results.analysis import LackOfFit
from pa10cal.terms.effects.effect import Effect, joint_of, turning_joints
from pa10cal.terms.effects.joint import PeriodicError
from pa10cal.terms.effects.joint_error_map import JointErrorMap, is_error_map
from pa10cal.terms.forms.catalogue import all_around, forms_at
from pa10cal.terms.forms.form import Form

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pa10cal.results.calibration import InputFinding


# The verdict on a campaign that can be calibrated, and in which effects cannot be sought.


class CannotSearch(NamedTuple):
    """Why effects cannot be sought in a campaign, and what to do about it."""

    why: str
    remedy: str


@dataclass(frozen=True, eq=False, kw_only=True)
class NotSought(Basis):
    """What judges nothing, where effects cannot be sought: the calibrated model stays as it is."""

    calibrated: FittedModel  # the calibrated model
    cov: Array  # (P, b, b) covariance of the components of the poses fitted, by noise

    @property
    @override
    def searched_from(self) -> FittedModel:
        return self.calibrated.with_bends()

    @override
    def lack_of_fit(self, found: Verdict[Any]) -> tuple[LackOfFit, LackOfFit]:
        residuals = lack_of_fit(CellResiduals.about(found.baseline, found.train.poses, self.cov))
        return residuals, residuals

    @override
    def model_with(self, effects: tuple[Effect, ...]) -> FittedModel:
        del effects  # there are none
        return self.calibrated


def not_sought(
    campaign: Prepared, calibrated: FittedModel, reason: CannotSearch
) -> Verdict[NotSought]:
    """Return the verdict on a campaign in which effects cannot be sought."""
    # Nothing was found: the extended model is the calibrated one, with a base term of zeros.
    # Weights other than described are unknowns of a search; here the model stays as it was given.
    campaign = replace(campaign, baseline=calibrated.with_bends())
    baseline, setup = campaign.baseline, campaign.setup
    readings = complete(campaign.trusted, baseline, setup)
    noise = noise_of_near_poses(readings, linear.residual(baseline, readings))
    measured, group = readings.measured, reading_groups(readings)
    cov = mean_covariance(noise.cov, measured.components_seen, group)
    poses, held_out = complete(average_repeats(readings), baseline, setup), campaign.held_out
    floor_mm = linear.mean_error_of_noise_mm(poses.measured, cov)
    compared = partial(gap, before=baseline, after=baseline, noise_floor_mm=floor_mm)
    x, covariance = np.concatenate([baseline.x, np.zeros(6)]), calibrated.covariance
    nothing = linear.ModelWithEffects(
        (), replace(baseline, model=linear.with_base_term(baseline), x=x), True
    )
    return Verdict(
        prepared=campaign,
        scorer=NotSought(
            extended=nothing,
            covariance=np.full((len(x), len(x)), np.nan) if covariance is None else covariance,
            calibrated=calibrated,
            cov=cov,
        ),
        context=context_of(poses, baseline, setup),
        noise_floor_mm=floor_mm,
        noise_floor_from=noise.origin,
        train=compared(poses),
        holdout=None if held_out is None else compared(complete(held_out, baseline, setup)),
        why=reason.why,
        remedy=reason.remedy,
    )


#: A calibration that started from a model with maps, which searches would have to fit anew.
_HAS_MAPS = CannotSearch(
    "the calibrated model has maps of joints already, of the model that it started from",
    "calibrate without the prior to search; or use the model as it is",
)


def discover(
    every: Observations,
    model: FittedModel,
    setup: MeasurementSetup,
    wrong: Sequence[InputFinding] = (),
) -> Verdict:
    """Find which effects are missing from a calibrated model.

    In a campaign with too few poses or repeats nothing is sought, and the verdict says so.

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
    campaign = prepared(every, model, setup, tuple(map(of_wrong_row, wrong)))
    found = _judged(campaign, model)
    for _ in range(JUDGING.most_carriers):
        # A map is no name: it may well show at one pose.
        carried = [one for one in found.effects if one.carrier and is_named(one.effect)]
        if not (is_sought(found) and carried):
            break
        # One pose is no evidence of what acts in all of them: it is wrong, and the rest decides.
        first, pose = carried[0], str(carried[0].carrier)
        fault = influential_pose(pose, label_of(first.effect, None), first.gain)
        campaign = campaign.without_pose(pose, fault)
        without = _judged(campaign, model)
        if without.unexplained:
            # The rest does not fit either: nothing says that this pose is worse than the others.
            reasons = {one: f"pose {one.carrier} alone carries it" for one in carried}
            found = without_names(found, reasons, found.train.after.mean_mm)
            break
        found = without
    if is_sought(found):
        found = with_lines_named(with_proposals(_likelier(found, gated(found))))
    return with_likely(with_predicted(with_compliance(found)))


def _likelier(found: Verdict[S], passed: Verdict[S]) -> Verdict[S]:
    """Return a verdict that has passed the gates, or that about a likelier set that passes them.

    Args:
        found: what the search came to.
        passed: the same after the gates.
    """
    ahead = found.scorer.likelier(found) if found.weights_assumed else None
    if ahead is not None:
        likelier = gated(ahead)
        falls_back = likelier.falls_back is not None and passed.falls_back is None
        if not (falls_back or likelier.verdict == "check_the_log"):
            return likelier
    return passed


def with_predicted(found: Verdict) -> Verdict:
    """Return a verdict that predicts what has no name too, where poses held out gain by it.

    Not where the log is to be checked, nor where the base moved: neither goes with the joints.
    Where effects hold nowhere it stands beside the calibrated model, to which all poses are left.
    Limits of the effects go where held-out poses beyond them are predicted no worse with it. Where
    it makes held-out poses worse it is not predicted.
    """
    if found.verdict in ("not_sought", "check_the_log"):
        return found
    if found.train.without_motion is not None:
        return found
    by_names = found.baseline
    if not found.holds_nowhere:
        by_names = found.extended.fitted(found.scorer.covariance)
    fit = field_of(by_names, found.train.poses, _without_name(found, by_names))
    if fit is None:
        return found
    model, away = with_field(by_names, fit), found.falls_back

    def after(model: FittedModel, gap: PairedErrors) -> PairedErrors:
        return replace(gap, found_after=errors_of(model, gap.poses))

    def predicting(found: Verdict) -> Verdict:
        predicted = Predicted(fit, found.train, found.holdout)
        return replace(found, predicted=predicted).with_gaps(partial(after, model))

    within = None if away is None or found.holds_nowhere else away.within
    free = found
    if within is not None:
        free = replace(found, falls_back=None).with_gaps(partial(after, by_names))
    everywhere = predicting(free)
    # Held-out poses chose nothing of it, and are predicted no worse than by the names alone.
    if harmed(everywhere.trusted_holdout, free.trusted_holdout):
        return found
    if within is None or limits(everywhere) is None:
        return everywhere
    return only_within(predicting(found), within)


def _without_name(found: Verdict, model: FittedModel) -> tuple[Effect, ...]:
    """Return the effects that may stand for what has no name.

    None where poses are repeated: readings of one apparatus err alike, at held-out poses too.
    """
    if not judged_by_blocks(found.prepared.trusted):
        return ()
    logged, held = found.prepared.torques == "logged", model.model.terms
    return nameless_effects(found.context, found.states, held, logged=logged)


def _judged(campaign: Prepared, model: FittedModel) -> Verdict:
    """Return the verdict on a campaign made ready, before its gates."""
    readings = complete(campaign.trusted, campaign.baseline, campaign.setup)
    if wrong_attitudes := attitudes_off(readings, campaign.baseline):
        return not_sought(campaign, model, wrong_attitudes)
    if any(is_error_map(term) for term in model.model.terms):
        return not_sought(campaign, model, _HAS_MAPS)
    if judged_by_blocks(campaign.trusted):
        from pa10cal.discovery.blocked_cv.by_blocks import discover_by_blocks

        found = discover_by_blocks(campaign)
        poses = found.scorer.survey.poses
        wrong = stated_wrongly(poses, campaign.baseline, campaign.setup, found.context)
        return replace(found, faults_of_rows=(*found.faults_of_rows, *wrong))
    check_torques(campaign.baseline.model, campaign.readings)
    if lacking := too_little(campaign.trusted, campaign.baseline):
        return not_sought(campaign, model, lacking)
    from pa10cal.discovery.evidence.by_repeats import discover_by_repeats

    try:
        return discover_by_repeats(campaign)
    except DiscoveryError as error:  # repeats show no noise, as where readings were copied
        lacking = CannotSearch(
            f"{error.what} ({error.value})", error.remedy or "measure them again"
        )
        return not_sought(campaign, model, lacking)


def attitudes_off(readings: Observations, baseline: FittedModel) -> CannotSearch | None:
    """Return that orientations are others than the arm's, as in another convention; None if not."""
    for kind, at in readings.measured.component_kinds:
        if not kind.startswith("attitude"):
            continue
        left_rad = np.abs(linear.residual(baseline, readings)[:, at])
        seen = readings.measured.components_seen[:, at]
        typical_rad = float(np.median(left_rad[seen]))
        variance = np.diagonal(readings.measured.stated_covariance, axis1=1, axis2=2)[:, at]
        stated_rad = float(np.sqrt(np.median(variance[seen])))
        if typical_rad > max(JUDGING.no_attitude_rad, stated_rad):
            return CannotSearch(
                f"the orientations are {np.degrees(typical_rad):.0f} deg off those of the "
                "calibrated model, typically",
                "check the order and the sense of qw, qx, qy, qz, and the findings of the "
                "calibration",
            )
    return None


def judged_by_blocks(readings: Observations) -> bool:
    """Return whether effects are judged by blocks of poses held out, and not by repeats."""
    repeats = repeated(readings)
    least = max(NOISE.least_differences, NOISE.least_repeated_share * len(readings))
    return len(readings) >= LEAST_FOR_BLOCKS and repeats < least


def too_little(readings: Observations, baseline: FittedModel) -> CannotSearch | None:
    """Return what a campaign lacks for a search that is judged by repeats; None for nothing."""
    repeats = repeated(readings)
    if repeats < NOISE.least_differences:
        return CannotSearch(
            f"{len(readings)} readings of calibration poses are too few to hold out blocks of "
            f"them, and with {repeats} repeats the repeatability is not known",
            f"measure at least {LEAST_FOR_BLOCKS} calibration poses, or repeat at least "
            f"{NOISE.least_differences} readings at the same pose, load and direction of "
            "arrival",
        )
    poses = len(np.unique(readings.pose))
    unknowns = open_unknowns(baseline.model) + 6 + len(baseline.targets_m)
    components = float(readings.measured.components_seen.sum(axis=1).mean())
    needed = int(np.ceil(JUDGING.rows_an_unknown * unknowns / components))
    if poses < needed:
        return CannotSearch(
            f"{poses} calibration poses are too few to separate an effect from the {unknowns} "
            "unknowns of the model",
            f"measure at least {needed} calibration poses, well spread over the joints' ranges",
        )
    return None


# Formulas proposed for what a verdict has no name for; the verdict stays as it is.

S = TypeVar("S", bound=Scorer)


def with_proposals(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict with a formula for each map and rival that a short form does as well as."""
    if found.verdict == "check_the_log":
        return found
    return replace(found, proposed=tuple(_proposals(found)))


def _proposals(found: Verdict[Scorer]) -> Iterator[FormulaProposal]:
    """Yield one formula for everything without a name; else one for each place, where there is."""
    nameless = found.without_name
    if not nameless and not found.over_noise:
        return
    places = sorted({effect.of for effect in nameless})
    others = (*(f"joint {joint}" for joint in turning_joints(found.context)), "base", "instrument")
    forms = {of: forms_at(of, found.context, found.states) for of in (*places, *others)}
    elsewhere = [of for of in forms if of not in places]
    everything = found.everything if found.unexplained else nameless
    joints = [of for of in elsewhere if of.startswith("joint")]
    attempts = [  # where it shows, before anywhere else
        (nameless, places),
        (nameless, [of for of in elsewhere if of not in joints]),
        (nameless, joints),
    ]
    if everything != nameless:  # names may stand in for parts of what has none
        attempts.append((everything, list(forms)))
    for held, tried in attempts:
        one = _chosen(found, held, [form for of in tried for form in forms[of]])
        if one is not None:
            yield one
            return
    for place in places if len(places) > 1 else ():
        held = tuple(effect for effect in nameless if effect.of == place)
        proposal = _chosen(found, held, list(forms[place]))
        if proposal is not None:
            yield proposal


def _chosen(
    found: Verdict[Scorer], held: tuple[Effect, ...], forms: list[Form]
) -> FormulaProposal | None:
    """Return the shortest form that does as well as some effects without a name."""
    if not forms or sum(effect.linear for effect in held) > FORMS.most_parameters:
        return None
    few = found.scorer.comparison(held, FORMS.few_poses)
    many = len(few.states) < len(found.states)
    whole = partial(found.scorer.comparison, held) if many else None
    return choose(few, forms, held, found.error_rate, whole)


# A map that is one line gets a name: `periodic_error`, where the joint was seen all around.


def with_lines_named(found: Verdict[S]) -> Verdict[S]:
    """Return a verdict in which maps that are one line each have the name of that line.

    A window of part of a turn cannot tell orders apart, however well one of them fits: there the
    formula is proposed, and the map stays.
    """
    for proposal in found.proposed:
        named = _named(found, proposal)
        if named is not None:
            rest = tuple(each for each in found.proposed if each is not proposal)
            found = replace(named, proposed=rest)
    return found


def _named(found: Verdict[S], proposal: FormulaProposal) -> Verdict[S] | None:
    """Return the verdict with a line in its map's place; None where it has no name."""
    order, held, form = proposal.form.order, proposal.instead, proposal.form
    of_one_map = len(held) == 1 and held[0].id == JointErrorMap.id and held[0].of == form.of
    if form.form != "harmonic" or not of_one_map or found.falls_back is not None:
        return None
    if (
        order is None
        or order <= CANDIDATES.named_orders
        or proposal.record.orders != (order, order)
    ):
        return None
    joint = joint_of(form.of)
    gear = 2.0 * float(found.context.arm.gear_ratio[joint - 1])
    if abs(order - gear) < CANDIDATES.near_order or not all_around(
        found.states.q_rad[:, joint - 1]
    ):
        return None
    line = PeriodicError(form.of, float(order))
    (of_map,) = (each for each in found.findings if each.effect == held[0])
    tried = fitted_instead(found, of_map, replace(of_map, effect=line))
    return None if tried is None else harmless(tried)
