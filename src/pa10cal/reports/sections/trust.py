"""How far to trust it: what the verdict stands on, limits, warnings, where it extrapolates."""

from __future__ import annotations

import math
from collections.abc import Iterator

from pa10cal.reports.blocks import (
    NOT_KNOWN,
    Block,
    Callout,
    Items,
    Section,
    grid,
    mm,
    named,
    sentence,
)
from pa10cal.reports.gathered import Gathered
from pa10cal.results.calibration import GeneralCalibrationRecord
from pa10cal.results.discovery import EvidenceByBlocks, EvidenceOfSag, FoundEffect
from pa10cal.results.health import Health


def trust(found: Gathered) -> Section:
    """Return what to check before the model is relied on."""
    return Section("trust", "How far to trust it", tuple(_blocks(found)))


def _blocks(found: Gathered) -> Iterator[Block]:
    if found.calibration is None:
        yield Callout("missing", found.why_absent(f"calibration/{found.load_case}.json"))
        return
    yield grid(
        "What the grade of the calibration stands on", ("check", "found", "passes"), _checks(found)
    )
    warnings = dict.fromkeys(found.calibration.warnings)
    if found.extended is not None and found.extended.named:
        warnings |= dict.fromkeys(f"with the effects: {each}" for each in found.extended.warnings)
    for warning in warnings:
        if warning != found.calibration.health.line:
            yield Callout("warning", sentence(warning))
    record = found.verdict
    if record is not None and record.effects:
        yield grid(
            "What decided about the effects",
            ("effect", "evidence"),
            [(named(each), _evidence(each)) for each in record.effects],
        )
    if record is not None and record.falls_back is not None:
        yield Callout("warning", sentence(f"limits of the effects: {record.falls_back.why}"))
    yield Items(tuple(_limits(found)))
    seen = tuple(_seen(found))
    if seen:
        yield grid("Joint positions that the fit has seen", ("joint", "seen", "allowed"), seen)


def _checks(found: Gathered) -> Iterator[tuple[str, str, str]]:
    assert found.calibration is not None
    health = found.calibration.health
    yield "the fit converged", health.reason, _passes(health.converged)
    bounds = len(health.at_bounds)
    yield "no parameter at the end of its range", str(bounds), _passes(not bounds)
    full = health.rank == health.unknowns
    yield (
        "every parameter is determined",
        f"rank {health.rank} of {health.unknowns}",
        _passes(full) if full else "no: see what is missing",
    )
    ratio = health.error_over_noise
    yield (
        "remaining error agrees with the noise",
        NOT_KNOWN if ratio is None else f"{ratio:.1f} times the noise",
        NOT_KNOWN if ratio is None else _passes(health.grade in ("good", "few_poses")),
    )
    yield "held-out poses agree with what the fit promises", *_held_out(health)
    for each in health.repeats:
        unit, scale = ("mrad", 1e3) if each.kind.startswith("attitude") else ("mm", 1e3)
        agree = 1.0 / 3.0 <= each.found / each.stated <= 3.0 if each.stated else False
        yield (
            f"scatter of repeats agrees with the stated uncertainty, {each.kind}",
            f"{scale * each.found:.4f} {unit}, stated {scale * each.stated:.4f} {unit}",
            _passes(agree),
        )
    if isinstance(found.calibration, GeneralCalibrationRecord):
        outliers = found.calibration.suspected_outliers
        names = ", ".join(each.pose for each in outliers[:6])
        yield "no suspected outlier", names or "none", _passes(not outliers)
    agree_on = f"{found.calibration.starts_agreeing} of {found.calibration.starts}"
    yield "starts that end in the same minimum", agree_on, ""


def _held_out(health: Health) -> tuple[str, str]:
    if health.held_out_rms_mm is None:
        return "nothing was held out", "not tested"
    told = f"{mm(health.held_out_rms_mm)} mm rms; fitted {mm(health.train_rms_mm)} mm"
    return told, _passes(health.held_out_over_expected is None)


def _passes(well: bool) -> str:
    return "yes" if well else "no"


def _evidence(effect: FoundEffect) -> str:
    found = effect.evidence
    if isinstance(found, EvidenceOfSag):
        return found.words
    if isinstance(found, EvidenceByBlocks):
        blocks = found.cross_validation_over_blocks
        return (
            f"blocks of poses left out are predicted with {blocks.rms_with_mm:.3f} mm rms, without "
            f"it with {blocks.rms_without_mm:.3f} mm; better in {blocks.improved} of "
            f"{blocks.blocks} blocks"
        )
    share = 100.0 * found.cross_validation_over_poses.explained
    return (
        f"log evidence {found.lost_without_it_nats:.3g} nats, {found.needed_nats:.3g} needed; "
        f"explains {share:.0f} % of the error of poses left out; by chance at most "
        f"{found.p_sign_flips_max_t:.2g}"
    )


def _limits(found: Gathered) -> Iterator[str]:
    assert found.calibration is not None
    if found.synthetic:
        yield "The data are synthetic: nothing here was measured on a real robot."
    yield (
        "Intervals hold the noise of the measurement, not effects that the model lacks; held-out "
        "errors show how large those are."
    )
    loads = found.calibration.loads_fitted
    if max(loads, default=0.0) > 0.0:
        yield f"The heaviest load of the fit is {max(loads):g} N: beyond it is extrapolation."
    else:
        yield "The fit has seen no external load: any is extrapolation."
    yield (
        "Outside the joint positions of the table below a prediction is an extrapolation; the "
        "column inside of pa10cal predict says so row by row."
    )


def _seen(found: Gathered) -> Iterator[tuple[str, str, str]]:
    model = found.calibration if found.extended is None else found.extended
    assert model is not None
    seen, arm = model.fitted_model.get("seen"), model.fitted_model.get("arm")
    rows = arm.get("rows") if isinstance(arm, dict) else None
    if not isinstance(seen, list) or not isinstance(rows, list):
        return
    for number, (joint, row) in enumerate(zip(seen, rows, strict=True), start=1):
        if not isinstance(joint, dict) or not isinstance(row, dict):
            continue
        slides = bool(row.get("prismatic"))
        unit, scale = ("mm", 1e3) if slides else ("°", 180.0 / math.pi)
        limits = row.get("limits_m" if slides else "limits_rad")
        yield (
            str(number),
            _stretches(joint.get("intervals"), scale, unit),
            NOT_KNOWN if limits is None else _stretches([limits], scale, unit),
        )


def _stretches(intervals: object, scale: float, unit: str) -> str:
    if not isinstance(intervals, list):
        return NOT_KNOWN
    return ", ".join(f"{scale * low:.1f} to {scale * high:.1f} {unit}" for low, high in intervals)
