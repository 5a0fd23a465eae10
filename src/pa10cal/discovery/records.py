"""The records of discovery, `verdict.json`, `extended.json`, `analysis.json`, and their words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.calibration.levels import report_base
from pa10cal.calibration.uncertainty import reported_keys
from pa10cal.discovery.explained import explained
from pa10cal.discovery.finding import name_of, sized, steps_told, with_a_name
from pa10cal.discovery.linear import possible_sizes
from pa10cal.discovery.verdict import MAP, Plan, Verdict
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.model_file import model_to_plain
from pa10cal.results.analysis import AnalysisRecord, GapField, ParameterShift
from pa10cal.results.discovery import (
    AllUnexplained,
    ExtendedRecord,
    Gap,
    SearchByRepeats,
    Unexplained,
    VerdictKeys,
    VerdictRecord,
)
from pa10cal.results.evaluation import Parameter
from pa10cal.results.maps import FallsBack
from pa10cal.results.record import Campaign


@dataclass(frozen=True)
class DiscoveryRecords:
    """The records of one campaign."""

    verdict: VerdictRecord
    extended: ExtendedRecord
    analysis: AnalysisRecord


def discovery_records(
    found: Verdict[object], ahead: Plan, campaign: Campaign, calibration: str
) -> DiscoveryRecords:
    """Return the records of a campaign: its verdict, and what to measure next.

    It began with a calibration of the load case `calibration`.
    """
    name, provenance = campaign.name, campaign.provenance
    keys, from_order = verdict_keys(found, ahead), found.prepared.arrivals_from_order
    parameters, (before, after) = model_parameters(found), found.lack_of_fit()
    baseline = found.baseline
    return DiscoveryRecords(
        VerdictRecord(
            **dict(keys),
            campaign=name,
            provenance=provenance,
            arrival_from_order=from_order,
            seconds=None,
            by_campaign=found.by_campaign(),
        ),
        ExtendedRecord(
            campaign=name,
            provenance=provenance,
            parameters=parameters,
            T_instr_base=found.model.T_instr_base,
            fitted_model=model_to_plain(found.model),
            angles_seen=keys.angles_seen,
            robot=campaign.robot,
            calibration=calibration,
            verdict=keys.verdict,
            arrival_from_order=from_order,
            steps_s=steps_told(found.faults) or None,
            named=keys.effects,
            warnings=warnings_of(keys),
        ),
        AnalysisRecord(
            campaign=name,
            provenance=provenance,
            before=before,
            after=after,
            naming=tuple(step.record for step in found.naming),
            parameter_shifts=parameter_shifts(baseline, parameters),
            gap=GapField(
                train=found.train.rows(baseline),
                holdout=None if found.holdout is None else found.holdout.rows(baseline),
            ),
            noise_floor_mm=found.noise_floor_mm,
        ),
    )


def verdict_keys(found: Verdict[object], ahead: Plan | None = None) -> VerdictKeys:
    """Return the verdict on a campaign, and what to measure next."""
    # Maps say where an error is, and not why: they are what has no name, where nothing else is.
    places = found.unexplained or tuple(
        Unexplained(of=each.of, form=MAP, shared_error_mm=None, why="cause not known")
        for each in found.effects
        if each.id == MAP
    )
    limits, below = found.falls_back, found.below_detection_limit
    return VerdictKeys(
        verdict=found.verdict,
        why=found.why,
        remedy=found.remedy,
        method=found.method,
        explained=explained(found),
        effects=tuple(
            finding.record(found.witness(finding.effect))
            for finding in (*found.gives_way, *found.effects)
        ),
        faults=found.faults,
        unexplained=AllUnexplained(**dict(places[0]), all=places) if places else None,
        proposed=tuple(proposal.record for proposal in found.proposed) or None,
        not_testable=with_a_name(found.not_testable),
        below_detection_limit=None if below is None else with_a_name(below),
        indistinguishable=tuple(tuple(map(name_of, group)) for group in found.indistinguishable),
        gap=Gap(
            noise_floor_mm=found.noise_floor_mm,
            noise_floor_from=found.noise_floor_from,
            train=found.train.record(),
            holdout=None
            if found.holdout is None
            else found.holdout.record(found.prepared.suspected),
        ),
        **found.of_its_method(),
        angles_seen=None if found.seen is None else found.seen.record,
        falls_back=None
        if limits is None
        else FallsBack(within=limits.within.record, why=limits.why),
        suggested_poses=() if ahead is None else ahead.poses,
        separations=None if ahead is None else ahead.separations,
    )


def warnings_of(verdict: VerdictKeys) -> tuple[str, ...]:
    """Return what a reader should know before trusting the extended model."""
    found = []
    for effect in verdict.effects:
        if effect.alternatives:
            rivals = ", ".join(f"{rival.id} of {rival.of}" for rival in effect.alternatives)
            found.append(f"{effect.id} of {effect.of} is indistinguishable from {rivals}")
    if verdict.verdict == "unexplained" and verdict.unexplained is not None:
        place = verdict.unexplained.of or "unknown place"
        found.append(f"an unidentified effect of {place} is missing: uncertainties do not cover it")
    found += map(str, verdict.faults)
    if verdict.falls_back is not None:
        found.append(verdict.falls_back.why)
    search = verdict.search
    if isinstance(search, SearchByRepeats) and search.readings_excluded:
        many = "s are" if search.readings_excluded > 1 else " is"
        found.append(
            f"{search.readings_excluded} reading{many} excluded, far from the model and from all "
            "others of the pose: a gross error"
        )
    return tuple(found)


def summary(verdict: VerdictKeys) -> list[str]:
    """Return the verdict in a few lines; in one where effects were not sought."""
    told = [f"  {fault}" for fault in verdict.faults]
    if verdict.verdict == "not_sought":
        return [f"effects were not sought: {verdict.why}; {verdict.remedy}", *told]
    word, lead = verdict.verdict, verdict.explained
    lines = [word if lead is None else f"{lead.headline} (verdict: {word})", *told]
    lines += [] if lead is None else [f"  {each}" for each in lead.sentences]
    for effect in verdict.effects_by_share:
        values = sized(effect.parameters) or f"{len(effect.parameters)} knots a turn"
        line = f"  {effect.id} of {effect.of}: {values}"
        if effect.alternatives:
            rivals = " or ".join(f"{rival.id} of {rival.of}" for rival in effect.alternatives)
            line += f"; indistinguishable from {rivals}"
        if effect.witness is not None and (ripple := effect.witness.ripple) is not None:
            low, high = ripple.interval95
            line += (
                f"; its motor followed {ripple.alpha:.2f} of it ({low:.2f} to {high:.2f}), by "
                f"lines at {', '.join(map(str, ripple.orders))} times {ripple.ratio:g}"
            )
        lines.append(line)
    lines += [
        f"  without a name, of {place.of or 'unknown place'}: {place.why}"
        for place in (verdict.unexplained.all if verdict.unexplained else ())
    ]
    lines += [
        f"  proposed for {each.of}, no name: {each.formula}, {sized(each.parameters)}"
        for each in verdict.proposed or ()
    ]
    for kind, gap in (("train", verdict.gap.train), ("holdout", verdict.gap.holdout)):
        if gap is None:
            continue
        low, high = gap.reduction.interval95_mm
        lines.append(
            f"{kind} mean {gap.before.mean_mm:.4f} -> {gap.after.mean_mm:.4f} mm, less by "
            f"{low:.4f} to {high:.4f} mm (95 %); noise floor {gap.noise_floor_mm:.4f} mm"
        )
        parts = {
            "inside": gap.inside,
            "outside": gap.outside,
            "without readings flagged as wrong": gap.trusted,
        }
        lines += [
            f"  {name}: {part.after.configurations} poses, rms {part.before.rms_mm:.4f} -> "
            f"{part.after.rms_mm:.4f} mm"
            for name, part in parts.items()
            if part is not None
        ]
    return lines


# All that the figures of discovery show.

#: A parameter known no better than this part of what is possible is not identified by the data.
_IDENTIFIED = 1.0 / 3.0


def model_parameters(found: Verdict[object]) -> dict[str, Parameter]:
    """Return every parameter of the calibrated model as it is with the effects, and the base."""
    baseline, covariance = found.baseline, found.covariance
    own, base = np.arange(len(baseline.x)), len(found.extended.at.x) - np.arange(6, 0, -1)
    report = baseline.model.report(found.model.x[own])
    known = np.sqrt(np.diag(covariance))[own] < _IDENTIFIED * possible_sizes(baseline.model)
    # Small motions of the base are along its own axes, its origin along the instrument's.
    along = np.eye(6)
    along[:3, :3] = baseline.T_instr_base[:3, :3]
    of_base = along @ covariance[np.ix_(base, base)] @ along.T
    of_own = reported_keys(report, covariance[np.ix_(own, own)])
    of_frame = reported_keys(report_base(found.model.T_instr_base), of_base)
    return {
        name: Parameter(**keys, identifiable=bool(np.all(known[row])))
        for (name, keys), row in zip(of_own.items(), report.jacobian != 0.0, strict=True)
    } | {name: Parameter(**keys, identifiable=True) for name, keys in of_frame.items()}


def parameter_shifts(
    baseline: FittedModel, after: dict[str, Parameter]
) -> tuple[ParameterShift, ...]:
    """Return every parameter of the calibrated model, and once the effects joined it."""
    reports = (baseline.model.report(baseline.x), report_base(baseline.T_instr_base))
    before = {
        parameter.name: float(value)
        for report in reports
        for parameter, value in zip(report.parameters, report.values, strict=True)
    }
    return tuple(
        ParameterShift(
            name=name,
            unit=parameter.unit,
            before=before[name],
            after=parameter.value,
            std=parameter.std or 0.0,
            tolerance=parameter.tolerance,
            identifiable=parameter.identifiable,
        )
        for name, parameter in after.items()
    )
