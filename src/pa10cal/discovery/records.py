"""The records of discovery, `verdict.json`, `extended.json`, `analysis.json`, and their words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pa10cal.arrays import Array
from pa10cal.calibration.levels import report_base
from pa10cal.calibration.uncertainty import reported_keys
from pa10cal.discovery.finding import Finding, name_of, sized, steps_told, with_a_name
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
from pa10cal.results.explained import Explained, ExplainedEffect
from pa10cal.results.maps import FallsBack
from pa10cal.results.record import CampaignIdentity, EffectName


@dataclass(frozen=True)
class DiscoveryRecords:
    """The records of one campaign."""

    verdict: VerdictRecord
    extended: ExtendedRecord
    analysis: AnalysisRecord


def discovery_records(
    found: Verdict[object], ahead: Plan, campaign: CampaignIdentity, calibration: str
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


# How much of the error beyond noise is explained, and by what.
#
# The share of all effects is what the mean square error over held-out poses falls by, from the
# calibrated model to the one that is exported, as part of what it had beyond noise. It is divided
# among them by what the exported model loses without each, all else fitted again: joining one by
# one, an effect may be masked by another. Shares sum to the whole. Errors without one are told as
# no larger than those without any.

#: Without an effect found, errors so many times as large as those of noise, root mean squares, are
#: more than noise.
_MORE_THAN_NOISE = 1.15


@dataclass(frozen=True)
class Joining:
    """An effect that joins a model."""

    ids: tuple[str, ...]  # of the effect, then of its alternatives at the same place
    of: str  # where it sits
    # before_mm and after_mm: (P,) position errors without it and with it, over the same poses
    before_mm: Array
    after_mm: Array
    elsewhere: tuple[EffectName, ...] = ()  # alternatives at other places
    # `assumed` where its size is relative to weights that nobody stated
    weights: Literal["assumed"] | None = None


def explained_by(
    joining: Sequence[Joining],
    before_mm: Array,
    noise_rms_mm: float,
    over: Literal["held-out poses", "fitted poses"] = "held-out poses",
) -> Explained | None:
    """Return what effects take away; None where there is no more than noise to explain.

    Args:
        joining: the effects; the last of them ends at the model with all.
        before_mm: (P,) position errors of the model without any.
        noise_rms_mm: root mean square error that noise alone would leave.
        over: what the poses are.
    """
    noise = noise_rms_mm**2
    first = _squared(before_mm)
    beyond = first - noise
    least = 1.0 if joining else _MORE_THAN_NOISE**2
    if not beyond > (least - 1.0) * noise or not first > 0.0:
        return None
    last = _squared(joining[-1].after_mm) if joining else first
    share = float(np.clip((first - last) / beyond, 0.0, 1.0))
    taken = np.array(
        [max(_squared(one.before_mm) - _squared(one.after_mm), 0.0) for one in joining]
    )
    shares = taken * (share / taken.sum()) if taken.sum() > 0.0 else np.zeros(len(joining))
    entries = [
        ExplainedEffect(
            ids=effect.ids,
            of=effect.of,
            elsewhere=effect.elsewhere,
            weights=effect.weights,
            share=float(own),
            before_mm=min(_squared(effect.before_mm), first) ** 0.5,
            after_mm=_squared(effect.after_mm) ** 0.5,
        )
        for effect, own in zip(joining, shares, strict=True)
    ]
    return Explained(
        share=share,
        of=tuple(sorted(entries, key=lambda entry: -entry.share)),
        without_a_name=1.0 - share,
        over=over,
        before_mm=first**0.5,
        after_mm=last**0.5,
        noise_mm=noise_rms_mm,
    )


def explained(found: Verdict[object]) -> Explained | None:
    """Return what the effects of a verdict take away; None where not sought, or nothing is missing.

    Held-out poses with a suspected reading do not count; without held-out poses it is counted over
    those fitted. Joints that give way under weights that nobody stated joined the geometry in the
    calibration already: errors before are those of the geometry alone.
    """
    calibrated = found.gives_way
    if (found.method is None or found.verdict == "none") and not calibrated:
        return None
    over: Literal["held-out poses", "fitted poses"] = "held-out poses"
    gap, suspected = found.holdout, found.prepared.suspected
    if gap is None:
        gap, suspected, over = found.train, None, "fitted poses"
    rows = np.ones(len(gap.poses), dtype=bool) if suspected is None else ~suspected
    if not rows.any():
        return None
    joining = []

    def join(
        finding: Finding[object],
        before_mm: Array,
        after_mm: Array,
        weights: Literal["assumed"] | None = None,
    ) -> None:
        others = finding.alternatives
        ids = dict.fromkeys((finding.id, *(one.id for one in others if one.of == finding.of)))
        elsewhere = tuple(name_of(one) for one in others if one.of != finding.of)
        joining.append(Joining(tuple(ids), finding.of, before_mm, after_mm, elsewhere, weights))

    before_mm = gap.found_before.distance_mm[rows]
    for spring in found.gives_way:
        proof = spring.proof
        weights: Literal["assumed"] | None = (
            "assumed" if proof.weights in ("assumed", "total") else None
        )
        join(spring, proof.without_each_mm, gap.found_after.distance_mm[rows], weights)
        # Rigid joints have the effects found in them: without these it is no less.
        before_mm = max(before_mm, proof.all_rigid_each_mm, key=_squared)
    findings, last = {finding.effect: finding for finding in found.findings}, found.naming[-1]
    for effect, without in zip(last.effects, last.without, strict=True):
        join(findings[effect], without.judging.distance_mm[rows], last.judging.distance_mm[rows])
    return explained_by(joining, before_mm, gap.noise_rms_mm, over)


def _squared(errors_mm: Array) -> float:
    return float(np.mean(errors_mm**2))
