"""A verdict as it is written: `verdict.json`, `extended.json` and `analysis.json`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pa10cal.calibration.two_level_problem import report_base
from pa10cal.calibration.uncertainty import reported_keys
from pa10cal.discovery.finding import name_of, not_testable
from pa10cal.discovery.log_faults import steps_told
from pa10cal.discovery.nuisances import MovedZeros
from pa10cal.discovery.rules import JUDGING, decisions
from pa10cal.discovery.sessions import is_moved_in_order
from pa10cal.discovery.verdict import NOTHING_PLANNED, Plan, Verdict, is_sought
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.model_writing import model_to_plain
from pa10cal.fit.problem import possible_sizes
from pa10cal.fit.validity import AngleCoverage
from pa10cal.results.analysis import AnalysisRecord, GapField
from pa10cal.results.discovery import (
    AllUnexplained,
    ExtendedRecord,
    Gap,
    Unexplained,
    VerdictKeys,
    VerdictRecord,
)
from pa10cal.results.evaluation import Parameter
from pa10cal.results.maps import FallsBack
from pa10cal.results.number_text import shown_probability
from pa10cal.results.record import CampaignIdentity
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.statement_faults import is_fault
from pa10cal.terms.term import Report, yields
from pa10cal.terms.wording import fault_text


@dataclass(frozen=True, eq=False)
class Extended:
    """The calibrated model with the effects that a verdict found missing, as it was written."""

    model: FittedModel
    seen: AngleCoverage | None = None  # joint angles that its maps were fitted to; None without any
    # times of sudden motions of instrument or base by the verdict [s], the most certain first
    steps_s: tuple[float, ...] = ()
    moved: MovedZeros | None = None  # by which readings are corrected; None for none


def verdict_keys(found: Verdict, ahead: Plan = NOTHING_PLANNED) -> VerdictKeys:
    """Return the verdict as it is written, and what to measure next."""
    # Maps say where an error is, and not why: they are what has no name, where nothing else is.
    places = found.unexplained or tuple(
        Unexplained(of=each.of, form=JointErrorMap.id, shared_error_mm=None, why="cause not known")
        for each in found.effects
        if each.id == JointErrorMap.id
    )
    scorer = found.scorer
    away, below, holdout = found.falls_back, found.below_detection_limit, found.holdout
    return VerdictKeys(
        verdict=found.verdict,
        why=found.why,
        remedy=found.remedy,
        fits_weights=_fits_weights(found) or None,
        method=found.method,
        explained=found.explained,
        effects=tuple(
            finding.record(scorer.witness(finding.effect))
            for finding in (*found.gives_way, *found.in_log, *found.effects)
        ),
        faults=found.faults,
        suspected_readings=found.prepared.suspected_readings or None,
        unexplained=AllUnexplained(**dict(places[0]), all=places) if places else None,
        proposed=tuple(proposal.record for proposal in found.proposed) or None,
        not_testable=not_testable(found.not_testable),
        below_detection_limit=None if below is None else not_testable(below),
        indistinguishable=tuple(tuple(map(name_of, group)) for group in found.indistinguishable),
        gap=Gap(
            noise_floor_mm=found.noise_floor_mm,
            noise_floor_from=found.noise_floor_from,
            readings_wander=found.readings_wander,
            train=found.train.record(),
            holdout=None if holdout is None else holdout.record(found.prepared.suspected),
        ),
        **scorer.record_keys(found),
        angles_seen=None if scorer.seen is None else scorer.seen.record,
        falls_back=None if away is None else FallsBack(within=away.within.record, why=away.why),
        suggested_poses=ahead.poses,
        separations=ahead.separations,
        no_separating_poses=ahead.why_none,
    )


def _fits_weights(found: Verdict) -> bool:
    """Return whether the model has weights that the poses show, beside which springs are right.

    Springs that were fitted under stated weights alone are wrong by the error of these, and their
    uncertainty does not hold it. Where rows have another load than logged, or the base moved,
    weights would stand for that.
    """
    if not is_sought(found) or found.prepared.torques != "masses":
        return False
    if any(is_fault(finding.effect) for finding in found.findings):
        return True
    moved = any(map(is_moved_in_order, found.unexplained))
    if moved or found.weights_assumed or any(fault.decides for fault in found.faults):
        return False
    return any(map(yields, found.baseline.model.terms))


def verdict_record(
    found: Verdict, campaign: CampaignIdentity, ahead: Plan = NOTHING_PLANNED
) -> VerdictRecord:
    """Return `verdict.json` of a campaign, with what to measure next."""
    return VerdictRecord(
        **dict(verdict_keys(found, ahead)),
        campaign=campaign.name,
        provenance=campaign.provenance,
        arrival_from_order=found.prepared.arrivals_from_order,
        seconds=None,
        by_campaign=found.scorer.by_campaign(),
        rules=decisions(),
    )


def extended_record(
    found: Verdict, verdict: VerdictRecord, robot: str, load: str
) -> ExtendedRecord:
    """Return `extended.json`, by `verdict.json`, the arm, and the load case it began with."""
    return ExtendedRecord(
        campaign=verdict.campaign,
        provenance=verdict.provenance,
        parameters=extended_parameters(found),
        T_instr_base=found.model.T_instr_base,
        fitted_model=model_to_plain(found.model),
        angles_seen=verdict.angles_seen,
        robot=robot,
        calibration=load,
        verdict=verdict.verdict,
        arrival_from_order=verdict.arrival_from_order,
        steps_s=steps_told(found.faults) or None,
        moved_zeros=None if found.since is None else found.since.record,
        named=verdict.effects,
        fits_weights=verdict.fits_weights,
        warnings=(*warnings_of(verdict), *_confirmed(found), *_not_predicted(found)),
    )


def _not_predicted(found: Verdict) -> Iterator[str]:
    """Yield what was measured and predictions are without, or otherwise than the rows have it."""
    if found.scorer.unstated_forces:
        yield (
            "logged torques differ from those of the weights by far more than their noise, and the "
            "arm moved by them: forces act that nobody stated, or weights are others; predictions "
            "are by the weights"
        )
    shown, off_m = found.model.T_end_shown[:3, 3], found.model.targets_off_m
    if np.array_equal(found.model.T_end_shown, np.eye(4)):
        return
    x, y, z = 1e3 * shown
    yield (
        f"the balls would be up to {1e3 * np.abs(off_m).max():.3f} mm off their stated places, "
        f"which are known to {1e3 * found.prepared.setup.apparatus_m:.3f} mm: the end is elsewhere "
        f"than the arm's rows have it, by ({x:.3f}, {y:.3f}, {z:.3f}) mm along its axes; the tool "
        "is predicted there, the flange is not"
    )


def _confirmed(found: Verdict) -> Iterator[str]:
    """Yield what was suspected of the input, where the effects found confirm it."""
    before, after = found.baseline.fitted_to, found.model.fitted_to
    if after is not None and after != before:
        yield after.health


def analysis_record(found: Verdict, campaign: CampaignIdentity) -> AnalysisRecord:
    """Return `analysis.json` of a campaign: what the figures show."""
    before, after = found.lack_of_fit()
    rows = {name: gap and gap.rows(found.baseline) for name, gap in found.gap.items()}
    return AnalysisRecord(
        campaign=campaign.name,
        provenance=campaign.provenance,
        before=before,
        after=after,
        naming=found.errors_by_name.steps,
        gap=GapField(**rows),
    )


def extended_parameters(found: Verdict) -> dict[str, Parameter]:
    """Return the parameters of the calibrated model as they are with the effects."""
    baseline, covariance = found.scorer.searched_from, found.covariance
    k = len(found.extended.at.x)
    own, base = slice(len(baseline.x)), slice(k - 6, k)
    report = baseline.model.report(found.model.x[own])
    possible = JUDGING.identified_share * possible_sizes(baseline.model)
    known = np.sqrt(np.diag(covariance))[own] < possible
    # Small motions of the base are along its own axes, its origin along the instrument's.
    along = np.eye(6)
    along[:3, :3] = baseline.T_instr_base[:3, :3]
    of_base = along @ covariance[base, base] @ along.T
    of_own = reported_keys(report, covariance[own, own], baseline.model.u_scale)
    of_frame = reported_keys(report_base(found.model.T_instr_base), of_base)
    told = [*(known[row].all() for row in report.jacobian != 0.0), *[True] * len(of_frame)]
    return {
        name: Parameter(**keys, identifiable=bool(identifiable))
        for (name, keys), identifiable in zip((of_own | of_frame).items(), told, strict=True)
    } | _places(found)


def _places(found: Verdict) -> dict[str, Parameter]:
    """Return the coordinates of targets that were fitted; none where no search fitted any."""
    baseline, covariance = found.scorer.searched_from, found.covariance
    measured, k = found.prepared.readings.measured, len(found.extended.at.x)
    if len(covariance) == k:
        return {}
    std = np.sqrt(np.diag(covariance))[k:]  # zero of those that the fit holds
    fitted = np.flatnonzero(std)
    possible = possible_sizes(baseline.model, measured)[len(baseline.x) :]
    known = (std < JUDGING.identified_share * possible)[fitted]
    coordinates = tuple(measured.target_parameters[j] for j in fitted)
    report = Report(coordinates, found.model.targets_m[fitted], np.eye(len(fitted)))
    of_places = reported_keys(report, covariance[np.ix_(k + fitted, k + fitted)])
    return {
        name: Parameter(**keys, identifiable=bool(identifiable))
        for (name, keys), identifiable in zip(of_places.items(), known, strict=True)
    }


def warnings_of(verdict: VerdictKeys) -> tuple[str, ...]:
    """Return what a reader should know before trusting the extended model."""
    found = [
        f"{effect.id} of {effect.of} has a probability of "
        f"{shown_probability(effect.probability)}; else it is "
        f"{' or '.join(effect.rivals)}"
        for effect in verdict.effects
        if effect.likely
    ]
    if verdict.verdict == "unexplained" and verdict.unexplained is not None:
        place = verdict.unexplained.of or "unknown place"
        found.append(f"an unidentified effect of {place} is missing: uncertainties do not cover it")
    if verdict.gap.readings_wander is not None:
        found.append(verdict.gap.readings_wander)
    found += map(fault_text, verdict.faults)
    if verdict.falls_back is not None:
        found.append(verdict.falls_back.why)
    if verdict.search is not None and (count := verdict.search.excluded):
        suspected = [f"{each.where}, {each.what}" for each in verdict.suspected_readings or ()]
        found.append(
            f"{count} reading{'s are' if count > 1 else ' is'} excluded, far from the others of "
            "the pose, or from the model where it has no others: gross errors, or what the model "
            f"lacks there{'; only suspected: ' * bool(suspected)}{'; '.join(suspected)}"
        )
    return tuple(found)
