"""`verdict.json`, `extended.json`, `analysis.json`: what both scorers' records have in common."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.calibration.base_parameters import report_base
from pa10cal.calibration.records import reported_keys
from pa10cal.discovery.gap import Gap, Paired
from pa10cal.discovery.operating_point import possible_sizes
from pa10cal.discovery.verdict import Finding, NotTestable, Unexplained, without_a_cause
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.results import discovery as parts
from pa10cal.results.accuracy import BeforeAfter, EffectParameter, Parameter
from pa10cal.results.analysis import AnalysisKeys, AnalysisRecord, GapRows, ParameterShift
from pa10cal.results.discovery import (
    EffectName,
    ExtendedKeys,
    ExtendedRecord,
    FoundEffect,
    MapForm,
    NamedEffect,
    VerdictKeys,
    VerdictRecord,
)
from pa10cal.results.record import Campaign
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.model import Model

Array = NDArray[np.float64]

#: A parameter known no better than this part of what is possible is not identified by the data.
_IDENTIFIED = 1.0 / 3.0


@dataclass(frozen=True)
class Outcome:
    """What a search comes to, whichever scorer judged.

    Attributes:
        verdict, extended, analysis: what the records hold besides whose they are.
        model: the extended model.
    """

    verdict: VerdictKeys
    extended: ExtendedKeys
    analysis: AnalysisKeys
    model: FittedModel


@dataclass(frozen=True)
class DiscoveryRecords:
    """The records of one campaign."""

    verdict: VerdictRecord
    extended: ExtendedRecord
    analysis: AnalysisRecord


def discovery_records(
    outcome: Outcome,
    campaign: Campaign,
    calibration: str,
    seconds: float,
    *,
    arrival_from_order: bool,
) -> DiscoveryRecords:
    """Return the records of a campaign.

    Args:
        outcome: what its search came to.
        campaign: the campaign.
        calibration: load case of the calibration it began with.
        seconds: time taken.
        arrival_from_order: whether directions of arrival come from the order of the poses.
    """
    name, provenance = campaign.name, campaign.provenance
    found = outcome.verdict
    return DiscoveryRecords(
        VerdictRecord(
            **dict(found),
            campaign=name,
            provenance=provenance,
            arrival_from_order=arrival_from_order,
            seconds=seconds,
        ),
        ExtendedRecord(
            **dict(outcome.extended),
            campaign=name,
            provenance=provenance,
            robot=campaign.robot,
            calibration=calibration,
            verdict=found.verdict,
            arrival_from_order=arrival_from_order,
            named=tuple(
                NamedEffect(
                    id=effect.id,
                    of=effect.of,
                    parameters=effect.parameters,
                    alternatives=effect.alternatives,
                )
                for effect in found.effects
            ),
            warnings=warnings_of(found),
        ),
        AnalysisRecord(**dict(outcome.analysis), campaign=name, provenance=provenance),
    )


def warnings_of(verdict: VerdictKeys) -> tuple[str, ...]:
    """Return what a reader should know before trusting the extended model."""
    found = []
    for effect in verdict.effects:
        rivals = ", ".join(f"{rival.id} of {rival.of}" for rival in effect.alternatives)
        if rivals:
            found.append(f"{effect.id} of {effect.of} cannot be told from {rivals}")
    if verdict.verdict == "unexplained" and verdict.unexplained is not None:
        place = verdict.unexplained.of or "unknown place"
        found.append(
            f"something without a name is missing, of {place}: uncertainties do not cover it"
        )
    held_out = verdict.gap.holdout
    if held_out is not None and held_out.reduction.interval95_mm[1] < 0.0:
        found.append(
            "held-out poses are predicted worse than before: do not use the extended model; the "
            "poses fitted are too few or too alike for the effects in it"
        )
    return tuple(found)


def summary(verdict: VerdictKeys) -> list[str]:
    """Say in a few lines what was found."""
    lines: list[str] = [verdict.verdict]
    for effect in verdict.effects:
        values = (
            ", ".join(
                f"{key} = {entry.value:.4g} ± {2.0 * entry.std:.1g} {entry.unit}"
                for key, entry in effect.parameters.items()
                if not key.startswith("knot")
            )
            or f"{len(effect.parameters)} knots a turn"
        )
        rivals = " or ".join(f"{rival.id} of {rival.of}" for rival in effect.alternatives)
        lines.append(
            f"  {effect.id} of {effect.of}: {values}"
            + (f"; cannot be told from {rivals}" if rivals else "")
        )
    lines += [
        f"  without a name, of {place.of or 'unknown place'}: {place.why}"
        for place in (verdict.unexplained.all if verdict.unexplained else ())
    ]
    for kind, gap in (("train", verdict.gap.train), ("holdout", verdict.gap.holdout)):
        lines += [] if gap is None else _gap_lines(kind, gap)
    return lines


def _gap_lines(kind: str, gap: parts.SetGap) -> list[str]:
    low, high = gap.reduction.interval95_mm
    lines = [
        f"{kind} mean {gap.before.mean_mm:.4f} -> {gap.after.mean_mm:.4f} mm, less by {low:.4f} "
        f"to {high:.4f} mm (95 %); repeatability alone {gap.noise_floor_mm:.4f} mm"
    ]
    return lines + [
        f"  {name}: {part.after.configurations} poses, rms {part.before.rms_mm:.4f} -> "
        f"{part.after.rms_mm:.4f} mm"
        for name, part in (("inside", gap.inside), ("extrapolated", gap.extrapolated))
        if part is not None
    ]


def name_of(effect: Effect) -> EffectName:
    """Return an effect's name and place."""
    return EffectName(id=effect.id, of=effect.of)


def found_effect(
    finding: Finding[object], evidence: parts.EvidenceByRepeats | parts.EvidenceByBlocks
) -> FoundEffect:
    """Return a finding with the statistics that decided."""
    effect = finding.effect
    known = effect.report(np.zeros(len(effect.parameters))).parameters
    std = np.sqrt(np.diag(finding.covariance))
    return FoundEffect(
        id=effect.id,
        of=effect.of,
        form=form_of(effect),
        parameters={
            parameter.name: EffectParameter(
                value=float(value), std=float(sigma), unit=parameter.unit
            )
            for parameter, value, sigma in zip(known, finding.x, std, strict=True)
        },
        alternatives=tuple(name_of(other) for other in finding.alternatives),
        evidence=evidence,
    )


def form_of(effect: Effect) -> MapForm | None:
    """Return spacing and smoothness of a map that has its own; None for every other effect."""
    if not isinstance(effect, JointErrorMap) or effect.fading is None:
        return None
    fading = parts.Fading(size_rad=effect.fading.size_rad, half_order=effect.fading.half_order)
    return MapForm(knots=effect.knots, fading=fading)


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


def set_gap(
    found: Gap,
    inside: BeforeAfter | None = None,
    extrapolated: BeforeAfter | None = None,
) -> parts.SetGap:
    """Return the gap before and after, over all loads and load by load.

    Args:
        found: the gap.
        inside, extrapolated: over poses inside the angles that the fit has seen, and beyond them;
            None where that is not known, or there are none.
    """
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
        inside=inside,
        extrapolated=extrapolated,
    )


def _reduction(paired: Paired) -> parts.Reduction:
    return parts.Reduction(
        mean_mm=paired.mean_mm,
        interval95_mm=(paired.low_mm, paired.high_mm),
        poses=paired.poses,
    )


def model_parameters(
    model: Model, x: Array, covariance: Array, T_instr_base: Array, base_covariance: Array
) -> dict[str, Parameter]:
    """Return every parameter of the calibrated model as it is with the effects, and the base.

    Args:
        model: the calibrated model, without the effects.
        x, covariance: (k,) and (k, k) its parameters in the extended model.
        T_instr_base: (4, 4) base frame.
        base_covariance: (6, 6) of its origin along the instrument's axes and its small turns.
    """
    report = model.report(x)
    identified = np.sqrt(np.diag(covariance)) < _IDENTIFIED * possible_sizes(model)
    own = reported_keys(report, covariance)
    base = reported_keys(report_base(T_instr_base), base_covariance)
    return {
        name: Parameter(**keys, identifiable=bool(np.all(identified[row])))
        for (name, keys), row in zip(own.items(), report.jacobian != 0.0, strict=True)
    } | {name: Parameter(**keys, identifiable=True) for name, keys in base.items()}


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


def gap_rows(
    gap: Gap, T_instr_base: Array, extrapolated: NDArray[np.bool_] | None = None
) -> GapRows:
    """Return every configuration with its residuals before and after, along base axes.

    Args:
        gap: P configurations.
        T_instr_base: (4, 4) base frame that their places are given in.
        extrapolated: (P,) which of them leave the angles that the fit has seen; None where that is
            not known.
    """
    poses = gap.poses
    p_instr_m = poses.measured.T_instr_target[:, :3, 3]
    return GapRows(
        pose=poses.pose,
        load_N=poses.states.load_N,
        place_mm=1e3 * (p_instr_m - T_instr_base[:3, 3]) @ T_instr_base[:3, :3],
        before_mm=gap.found_before.position_mm,
        after_mm=gap.found_after.position_mm,
        extrapolated=extrapolated,
    )
