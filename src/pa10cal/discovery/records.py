"""A verdict as the records of discovery: `verdict.json`, `extended.json`, `analysis.json`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields

import numpy as np
from numpy.typing import NDArray

from pa10cal.calibration.uncertainty import summarise
from pa10cal.discovery.analysis_record import (
    analysis_keys,
    by_campaign_part,
    model_parameters,
    name_of,
)
from pa10cal.discovery.blocked_cv.discover import VerdictByBlocks
from pa10cal.discovery.blocked_cv.judge import Prediction
from pa10cal.discovery.blocked_cv.search import LEAST_SHARE, STANDARD_ERRORS
from pa10cal.discovery.blocked_cv.survey import BLOCKS
from pa10cal.discovery.evidence.confirm import Confirmation
from pa10cal.discovery.evidence.discover import VerdictByRepeats
from pa10cal.discovery.evidence.judge import FLIP_RATE, shared_error_mm
from pa10cal.discovery.evidence.search import threshold
from pa10cal.discovery.explained import explained
from pa10cal.discovery.finding import Fault, Finding, GivesWay, NotTestable, Unexplained, steps_told
from pa10cal.discovery.gap import Gap, Paired, trusted
from pa10cal.discovery.next_poses.room import NextPose
from pa10cal.discovery.short_forms import Proposal
from pa10cal.discovery.verdict import Plan, Verdict, without_a_cause
from pa10cal.fit import angles_seen
from pa10cal.fit.model_file import model_to_plain
from pa10cal.results import discovery as parts
from pa10cal.results import maps
from pa10cal.results.analysis import AnalysisRecord
from pa10cal.results.discovery import (
    ExtendedKeys,
    ExtendedRecord,
    FoundEffect,
    NamedEffect,
    VerdictKeys,
    VerdictRecord,
)
from pa10cal.results.evaluation import Accuracy, BeforeAfter, EffectParameter
from pa10cal.results.explained import ProposedEvidence, ProposedFormula
from pa10cal.results.maps import (
    Agreement,
    BandOfMap,
    Bands,
    JointWitness,
    LeftOut,
    MotorRipple,
    PoseScatter,
)
from pa10cal.results.record import Campaign, EffectName
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import Band, JointErrorMap


@dataclass(frozen=True)
class DiscoveryRecords:
    """The records of one campaign."""

    verdict: VerdictRecord
    extended: ExtendedRecord
    analysis: AnalysisRecord


def discovery_records(
    found: Verdict[object], ahead: Plan, campaign: Campaign, calibration: str
) -> DiscoveryRecords:
    """Return the records of a campaign.

    Args:
        found: the verdict.
        ahead: what to measure next.
        campaign: the campaign.
        calibration: load case of the calibration it began with.
    """
    name, provenance = campaign.name, campaign.provenance
    keys, from_order = verdict_keys(found, ahead), found.prepared.arrivals_from_order
    return DiscoveryRecords(
        VerdictRecord(
            **dict(keys),
            campaign=name,
            provenance=provenance,
            arrival_from_order=from_order,
            seconds=None,
            by_campaign=by_campaign_part(found),
        ),
        ExtendedRecord(
            **dict(_extended(found)),
            campaign=name,
            provenance=provenance,
            robot=campaign.robot,
            calibration=calibration,
            verdict=keys.verdict,
            arrival_from_order=from_order,
            steps_s=steps_told(found.faults) or None,
            named=tuple(
                NamedEffect(
                    id=effect.id,
                    of=effect.of,
                    parameters=effect.parameters,
                    alternatives=effect.alternatives,
                )
                for effect in keys.effects
            ),
            warnings=warnings_of(keys),
        ),
        AnalysisRecord(**dict(analysis_keys(found)), campaign=name, provenance=provenance),
    )


def verdict_keys(found: Verdict[object], ahead: Plan | None = None) -> VerdictKeys:
    """Return the verdict on a campaign, and what to measure next."""
    by_blocks = found if isinstance(found, VerdictByBlocks) else None
    return VerdictKeys(
        verdict=found.verdict,
        why=found.why,
        remedy=found.remedy,
        method=found.method,
        explained=explained(found),
        effects=tuple(
            found_effect(finding, found) for finding in (*found.gives_way, *found.effects)
        ),
        faults=tuple(map(_fault, found.faults)),
        unexplained=all_unexplained(found.effects, found.unexplained),
        proposed=tuple(map(proposed_formula, found.proposed)) or None,
        not_testable=not_testable(found.not_testable),
        below_detection_limit=None
        if found.below_detection_limit is None
        else not_testable(found.below_detection_limit),
        indistinguishable=tuple(
            tuple(name_of(effect) for effect in group) for group in found.indistinguishable
        ),
        gap=parts.Gap(
            noise_floor_mm=found.noise_floor_mm,
            noise_floor_from=found.noise_floor_from,
            train=set_gap(found.train),
            holdout=None
            if found.holdout is None
            else set_gap(found.holdout, trusted(found.holdout, found.prepared.suspected)),
        ),
        remaining=None if by_blocks is None else _remaining(by_blocks),
        search=_search(found),
        bands=bands_part(by_blocks),
        scatter=scatter_part(by_blocks),
        angles_seen=None if found.seen is None else angles_part(found.seen),
        falls_back=None
        if found.falls_back is None
        else maps.FallsBack(within=angles_part(found.falls_back.within), why=found.falls_back.why),
        suggested_poses=() if ahead is None else tuple(map(_suggested, ahead.poses)),
        separations=None
        if ahead is None or ahead.separations is None
        else tuple(
            parts.Separation(
                pair=separation.label,
                before_nats=separation.before_nats,
                after_nats=separation.after_nats,
                possible_nats=separation.possible_nats,
                can_be_split=separation.can_be_split,
            )
            for separation in ahead.separations
        ),
    )


def _fault(fault: Fault) -> parts.Fault:
    return parts.Fault(**{key: getattr(fault, key) for key in parts.Fault.model_fields})


def angles_part(seen: angles_seen.AnglesSeen) -> tuple[maps.AnglesSeen, ...]:
    """Return the stretches that each joint's poses have seen."""
    return tuple(
        maps.AnglesSeen(turns=turns, stretches=stretches)
        for stretches, turns in zip(seen.intervals, seen.turns, strict=True)
    )


def _suggested(pose: NextPose) -> parts.SuggestedPose:
    return parts.SuggestedPose(
        q_deg=np.degrees(pose.q_rad),
        q_rad=pose.q_rad,
        load_N=pose.load_N,
        arrive_from=None if pose.arrival is None else -pose.arrival,
        separation_nats=pose.separation_nats,
        for_=pose.purposes,
    )


def _search(found: Verdict[object]) -> parts.SearchByRepeats | parts.SearchByBlocks | None:
    """Return how effects were searched for; None where they were not."""
    if found.method is None:
        return None
    if isinstance(found, VerdictByBlocks):
        return parts.SearchByBlocks(
            candidates=found.candidates,
            error_rate=found.error_rate,
            blocks=BLOCKS,
            needed=parts.Needed(
                standard_errors=STANDARD_ERRORS,
                sum_of_squares=found.least_gain,
                part_of_remaining_error_over_noise=LEAST_SHARE,
            ),
            poses_down_weighted=int(np.sum(found.extended.weights.weight < 1.0)),
            refit_converged=bool(found.extended.converged),
        )
    assert isinstance(found, VerdictByRepeats)
    search = found.judgement.found
    return parts.SearchByRepeats(
        candidates=found.candidates,
        error_rate=found.error_rate,
        needed_nats=threshold(found.candidates, found.error_rate),
        shared_error_mm=parts.SharedError(
            before=shared_error_mm(found.problem, search.nothing.pose_variance),
            after=shared_error_mm(found.problem, search.score.pose_variance),
        ),
        readings_excluded=int(found.prepared.gross.sum()),
    )


def _remaining(found: VerdictByBlocks) -> parts.Remaining:
    return parts.Remaining(
        **asdict(found.remaining),
        over_floor=found.remaining.over_floor,
        tried=tuple(
            parts.Tried(
                id=entry.effect.id,
                of=entry.effect.of,
                gain=entry.gain,
                gain_std=entry.gain_std,
                helps=entry.helps,
                positions_and_attitudes_agree=entry.kinds_agree,
            )
            for entry in found.tried
        ),
    )


def _evidence(
    proof: object, found: Verdict[object]
) -> parts.EvidenceByRepeats | parts.EvidenceByBlocks | parts.EvidenceOfSag:
    if isinstance(proof, GivesWay):
        return parts.EvidenceOfSag(
            lost_without_it_nats=proof.nats,
            needed_nats=proof.needed_nats,
            sag_mrad=1e3 * proof.sag_rad,
            sag_u_mrad=1e3 * proof.sag_std_rad,
            rigid_mm=proof.without_mm,
            gives_way_mm=proof.with_mm,
            held_out_rigid_mm=proof.held_out_without_mm,
            held_out_gives_way_mm=proof.held_out_with_mm,
            all_rigid_mm=proof.all_rigid_mm,
        )
    if isinstance(proof, Prediction):
        # A name that one pose carries is none: the carrier of one that stands is not told.
        told = {key: value for key, value in asdict(proof).items() if key != "carrier"}
        return parts.EvidenceByBlocks(
            cross_validation_over_blocks=parts.BlockedCrossValidation(**told, z=proof.z)
        )
    assert isinstance(proof, Confirmation)
    over_loads = proof.loads
    return parts.EvidenceByRepeats(
        lost_without_it_nats=proof.loss,
        needed_nats=threshold(found.candidates, found.error_rate),
        p_sign_flips_max_t=proof.p_flips,
        p_needed=FLIP_RATE,
        cross_validation_over_poses=parts.CrossValidation(**asdict(proof.poses)),
        cross_validation_over_loads=None
        if over_loads is None
        else parts.CrossValidation(**asdict(over_loads)),
    )


def _extended(found: Verdict[object]) -> ExtendedKeys:
    """Return the extended model, and its parameters with uncertainties."""
    return ExtendedKeys(
        parameters=model_parameters(found),
        T_instr_base=found.model.T_instr_base,
        fitted_model=model_to_plain(found.model),
        angles_seen=None if found.seen is None else angles_part(found.seen),
    )


def warnings_of(verdict: VerdictKeys) -> tuple[str, ...]:
    """Return what a reader should know before trusting the extended model."""
    found = []
    for effect in verdict.effects:
        rivals = ", ".join(f"{rival.id} of {rival.of}" for rival in effect.alternatives)
        if rivals:
            found.append(f"{effect.id} of {effect.of} is indistinguishable from {rivals}")
    if verdict.verdict == "unexplained" and verdict.unexplained is not None:
        place = verdict.unexplained.of or "unknown place"
        found.append(f"an unidentified effect of {place} is missing: uncertainties do not cover it")
    found += [f"{fault.where}: {fault.what}; {fault.remedy}" for fault in verdict.faults]
    if verdict.falls_back is not None:
        found.append(verdict.falls_back.why)
    search = verdict.search
    if isinstance(search, parts.SearchByRepeats) and search.readings_excluded:
        many = "s are" if search.readings_excluded > 1 else " is"
        found.append(
            f"{search.readings_excluded} reading{many} excluded, far from the model and from all "
            "others of the pose: a gross error"
        )
    return tuple(found)


def summary(verdict: VerdictKeys) -> list[str]:
    """Return the verdict in a few lines; in one where effects were not sought."""
    told = [f"  {fault.where}: {fault.what}; {fault.remedy}" for fault in verdict.faults]
    if verdict.verdict == "not_sought":
        return [f"effects were not sought: {verdict.why}; {verdict.remedy}", *told]
    word, lead = verdict.verdict, verdict.explained
    lines = [word if lead is None else f"{lead.headline} (verdict: {word})", *told]
    lines += [] if lead is None else [f"  {each}" for each in lead.sentences]
    for effect in verdict.effects_by_share:
        values = sized(effect.parameters) or f"{len(effect.parameters)} knots a turn"
        rivals = " or ".join(f"{rival.id} of {rival.of}" for rival in effect.alternatives)
        lines.append(
            f"  {effect.id} of {effect.of}: {values}"
            + (f"; indistinguishable from {rivals}" if rivals else "")
            + ("" if effect.witness is None else ripple_words(effect.witness))
        )
    lines += [
        f"  without a name, of {place.of or 'unknown place'}: {place.why}"
        for place in (verdict.unexplained.all if verdict.unexplained else ())
    ]
    lines += [
        f"  proposed for {each.of}, no name: {each.formula}, {sized(each.parameters)}"
        for each in verdict.proposed or ()
    ]
    for kind, gap in (("train", verdict.gap.train), ("holdout", verdict.gap.holdout)):
        lines += [] if gap is None else _gap_lines(kind, gap)
    return lines


def sized(parameters: Mapping[str, EffectParameter]) -> str:
    """Return parameters with their 95 % intervals in a line; knots of maps are left out."""
    return ", ".join(
        f"{key} = {entry.value:.4g} ± {2.0 * entry.std:.1g} {entry.unit}"
        for key, entry in parameters.items()
        if not key.startswith("knot")
    )


def _gap_lines(kind: str, gap: parts.SetGap) -> list[str]:
    low, high = gap.reduction.interval95_mm
    lines = [
        f"{kind} mean {gap.before.mean_mm:.4f} -> {gap.after.mean_mm:.4f} mm, less by {low:.4f} "
        f"to {high:.4f} mm (95 %); noise floor {gap.noise_floor_mm:.4f} mm"
    ]
    return lines + [
        f"  {name}: {part.after.configurations} poses, rms {part.before.rms_mm:.4f} -> "
        f"{part.after.rms_mm:.4f} mm"
        for name, part in (("inside", gap.inside), ("outside", gap.outside))
        if part is not None
    ]


def found_effect(finding: Finding[object], found: Verdict[object]) -> FoundEffect:
    """Return a finding with the statistics that decided."""
    return FoundEffect(
        id=finding.id,
        of=finding.of,
        form=form_of(finding.effect),
        parameters={
            name: EffectParameter(value=each.value, std=each.std, unit=each.unit)
            for name, each in finding.parameters.items()
        },
        alternatives=tuple(name_of(other) for other in finding.alternatives),
        evidence=_evidence(finding.proof, found),
        witness=witness_of(finding.effect, found),
        weights=finding.proof.weights if isinstance(finding.proof, GivesWay) else None,
    )


def form_of(effect: Effect) -> maps.MapForm | None:
    """Return spacing and spectrum of a map that has its own; None for every other effect."""
    if not isinstance(effect, JointErrorMap) or effect.spectrum is None:
        return None
    expected = asdict(effect.spectrum)
    if isinstance(effect.spectrum, Band):
        return maps.MapForm(knots=effect.knots, band=maps.Band(**expected))
    return maps.MapForm(knots=effect.knots, fading=maps.Fading(**expected))


def not_testable(entries: Iterable[NotTestable]) -> tuple[parts.NotTestable, ...]:
    """Return the effects with a name that the data cannot show."""
    return tuple(
        parts.NotTestable(id=entry.effect.id, of=entry.effect.of, why=entry.why)
        for entry in entries
        if not entry.effect.generic
    )


def all_unexplained(
    findings: Sequence[Finding[object]], unexplained: Sequence[Unexplained]
) -> parts.AllUnexplained | None:
    """Return where something without a name sits: the largest first, all of them in a list."""
    places = tuple(
        parts.Unexplained(
            of=entry.of, form=entry.form, shared_error_mm=entry.error_mm, why=entry.why
        )
        for entry in without_a_cause(findings, unexplained)
    )
    return parts.AllUnexplained(**dict(places[0]), all=places) if places else None


# Bands of maps and the scatter of single poses as parts of a verdict's record.


def bands_part(found: VerdictByBlocks | None) -> Bands | None:
    """Return the bands of the maps; None where no map has one."""
    if found is None or found.bands is None:
        return None
    of_maps = [
        member.effect.of
        for member in found.bands.level.members
        if isinstance(member.effect, JointErrorMap)
    ]
    names = [field.name for field in fields(Band)]
    return Bands(
        shared=found.bands.found.shared,
        scatter=found.bands.found.scatter,
        maps=tuple(
            BandOfMap(of=of, log_std=dict(zip(names, std.tolist(), strict=True)))
            for of, std in zip(of_maps, found.bands.found.log_std, strict=True)
        ),
        of_time=_left_out(found.bands.of_time),
        of_angles=_left_out(found.bands.of_angles),
    )


def scatter_part(found: VerdictByBlocks | None) -> PoseScatter | None:
    """Return what single poses scatter by; None where no map has a band."""
    if found is None or found.bands is None or found.scatter is None:
        return None
    train, holdout = found.inside95
    return PoseScatter(
        joints=tuple(found.scatter.joints.tolist()),
        kinds=dict(found.scatter.kinds),
        inside95_train=train,
        inside95_holdout=holdout,
    )


def _left_out(squares: NDArray[np.float64]) -> LeftOut:
    before, after = squares.sum(axis=0).tolist()
    return LeftOut(before=before, after=after)


# What is known of the cause of a map, as a record.


def witness_of(effect: Effect, found: Verdict[object]) -> JointWitness | None:
    """Return what says whose error an error by a joint's angle is; None where nothing does."""
    if not (isinstance(found, VerdictByBlocks) and isinstance(effect, JointErrorMap)):
        return None
    for each in found.causes:
        if each.joint == effect.joint and (each.witness or each.agreement):
            return JointWitness(
                ripple=None if each.witness is None else _ripple(asdict(each.witness)),
                agreement=None if each.agreement is None else Agreement(**asdict(each.agreement)),
            )
    return None


def ripple_words(witness: JointWitness) -> str:
    """Return what the ripple says in words that follow others; nothing where there is none."""
    ripple = witness.ripple
    if ripple is None:
        return ""
    low, high = ripple.interval95
    return (
        f"; its motor followed {ripple.alpha:.2f} of it ({low:.2f} to {high:.2f}), by lines at "
        f"{', '.join(map(str, ripple.orders))} times {ripple.ratio:g}"
    )


def _ripple(told: dict[str, object]) -> MotorRipple:
    """Return a witness as a record; the joint is that of the effect."""
    return MotorRipple(**{name: value for name, value in told.items() if name != "joint"})


# The gap between model and measurement as a record.


def set_gap(found: Gap, without: Gap | None = None) -> parts.SetGap:
    """Return the gap before and after: over all loads, load by load, and by what the fit saw.

    Args:
        found: the gap.
        without: the same without configurations that have a suspected reading.
    """
    seen = found.parts
    less = None if without is None or without is found else without
    return parts.SetGap(
        before=found.before,
        after=found.after,
        noise_floor_mm=found.noise_floor_mm,
        reduction=_reduction(found.reduction),
        per_load={
            f"{load:g}N": parts.LoadGap(
                before=before,
                after=after,
                reduction=_reduction(found.reduction_by_load[load]),
            )
            for load, (before, after) in found.by_load.items()
        },
        inside=None if seen is None else _pair(seen.before_inside, seen.after_inside),
        outside=None if seen is None else _pair(seen.before_beyond, seen.after_beyond),
        trusted=None if less is None else _pair(less.before, less.after),
        without_motion=None
        if found.without_motion is None
        else _pair(*map(summarise, found.without_motion)),
        with_rivals=None if found.with_rivals is None else summarise(found.with_rivals),
    )


def _pair(before: Accuracy | None, after: Accuracy | None) -> BeforeAfter | None:
    if before is None or after is None:
        return None
    return BeforeAfter(before=before, after=after)


def _reduction(paired: Paired) -> parts.Reduction:
    return parts.Reduction(
        mean_mm=paired.mean_mm,
        interval95_mm=(paired.low_mm, paired.high_mm),
        poses=paired.poses,
    )


# A proposed formula as a part of the verdict's record.


def proposed_formula(found: Proposal) -> ProposedFormula:
    """Return a proposal as `verdict.json` holds it."""
    without, held, with_it = found.squares
    form = found.form
    known = form.report(np.zeros(len(form.parameters))).parameters
    std = np.sqrt(np.diag(found.covariance))
    return ProposedFormula(
        formula=form.formula,
        of=form.of,
        form=form.form,
        numbers=form.numbers,
        orders=found.orders,
        parameters={
            parameter.name: EffectParameter(value=value, std=sigma, unit=parameter.unit)
            for parameter, value, sigma in zip(known, found.x.tolist(), std.tolist(), strict=True)
        },
        gain=found.gain,
        does_as_well_as=tuple(EffectName(id=each.id, of=each.of) for each in found.instead),
        others=tuple(other.formula for other in found.others),
        evidence=ProposedEvidence(
            blocks=found.blocks,
            rows=found.rows,
            squared_error_without=without,
            squared_error_with=with_it,
            squared_error_held=held,
            gain_std=found.gain_std,
        ),
    )
