"""Section of the page: how far to trust a model."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from pa10cal.arrays import Array
from pa10cal.reports.blocks import Callout, Grid, Items, PageBlock, Paragraph, SideBySide, grid
from pa10cal.reports.formatting import NOT_KNOWN, display_name, listed, mm, named, sentence
from pa10cal.reports.missing import coupling_of, number_needed
from pa10cal.reports.pictures import plane_drawings
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.results import discovery
from pa10cal.results.calibration import (
    ASSUMED,
    CalibrationRecord,
    GeneralCalibrationRecord,
)
from pa10cal.terms.wording import sag_text

#: Of more suspected outliers a check names only the first; their table has all.
_MOST_OUTLIERS = 6


def trust(results: ResultsBundle, case: CalibrationRecord) -> Iterator[PageBlock]:
    """Yield what to check before the model is relied on."""
    title = f"Basis of the grade of the calibration: {case.health.grade.replace('_', ' ')}"
    yield grid(title, "check | found | passes", _checks(case))
    if isinstance(case, GeneralCalibrationRecord):
        if case.prior:
            yield Callout("note", sentence(case.prior.line))
        yield outliers_grid(case)
    warnings = dict.fromkeys(case.warnings)
    if results.extended is not None and results.extended.named:
        warnings |= dict.fromkeys(f"with the effects: {text}" for text in results.extended.warnings)
    warnings.pop(case.health.line, None)
    yield from (Callout("warning", sentence(text)) for text in warnings)
    effects = results.verdict.effects if results.verdict else ()
    rows = [(named(effect), _evidence(effect)) for effect in effects]
    yield grid("What decided about the effects", "effect | evidence", rows)
    heaviest_N = max(case.loads_fitted, default=0.0)
    yield Items(
        (
            "Intervals hold the noise of the measurement, not effects that the model lacks; "
            "held-out errors show how large those are.",
            f"The heaviest load of the fit is {heaviest_N:g} N: beyond it is extrapolation."
            if heaviest_N > 0.0
            else "The fit has seen no external load: any load is extrapolation.",
            "Outside the joint positions of the table below a prediction is an extrapolation; the "
            "column inside of pa10cal predict shows it for each row.",
        )
    )
    yield grid(
        "Joint positions that the fit has seen",
        "joint | seen | allowed",
        _positions_seen(case if results.extended is None else results.extended),
    )
    if results.planes:
        yield Paragraph(
            "Expected position error that resolver uncertainty causes in the nominal arm, over "
            "each plane of the Monte Carlo, from the closed form. Means are over the grid of the "
            "map; the picture below draws positions at random, so the two differ a little."
        )
        yield SideBySide(tuple(plane_drawings(results.planes)))
    for plane in results.planes_not_studied:
        yield Paragraph(f"No Monte Carlo of the plane at z = {plane.plane_mm} mm: {plane.why}.")


def outliers_grid(case: GeneralCalibrationRecord) -> Grid:
    """Return poses far outside the scatter of the others; distances in units of the scatter."""
    rows = [
        (each.pose, each.load_N, f"{each.distance:.2f}", f"{each.weight:.3f}", each.why)
        for each in case.suspected_outliers
    ]
    title = "Suspected outliers, in the fit with less weight"
    return grid(title, "pose | load [N] | distance | weight | why", rows)


def _checks(case: CalibrationRecord) -> Iterator[tuple[str | bool, ...]]:
    """Yield the checks that the grade is based on: check, what was found, whether it passes."""
    health, poses = case.health, case.health.poses
    yield "the fit converged", health.ending, health.converged
    at_bounds = listed(map(display_name, health.at_bounds))
    yield "no parameter at the end of its range", at_bounds, not len(health.at_bounds)
    rank = f"rank {health.rank} of {health.unknowns}, condition number {health.condition:.4g}"
    determined = "yes" if health.rank == health.unknowns else "no: see what is missing"
    open_ = health.not_identifiable
    if case.weights_from in ASSUMED and open_ and all(each.startswith("weight_") for each in open_):
        rank += "; no poses determine weights that nobody stated"
        determined = "yes, but for these"
    yield "every parameter is determined", rank, determined
    fitted = f"{mm(health.train_rms_mm)} mm"
    check = "remaining error agrees with the noise"
    if health.error_over_noise is None:
        yield check, NOT_KNOWN, NOT_KNOWN
    else:
        error = f"{fitted} rms, {health.error_over_noise:.1f} times the {case.noise_is}"
        yield check, error, health.grade in ("good", "few_poses")
    check = "held-out poses agree with what the fit promises"
    if health.held_out_rms_mm is None:
        yield check, "nothing was held out", "not tested"
    else:
        error = f"{mm(health.held_out_rms_mm)} mm rms; fitted {fitted}"
        yield check, error, health.held_out_over_expected is None
    for scatter in health.repeats:
        unit = "mrad" if scatter.is_of_attitude else "mm"
        yield (
            f"scatter of repeats agrees with the stated uncertainty, {scatter.kind}",
            f"{1e3 * scatter.found:.4f} {unit}, stated {1e3 * scatter.stated:.4f} {unit}",
            bool(scatter.stated) and 1.0 / 3.0 <= scatter.ratio <= 3.0,
        )
    if poses.u_model_mm is not None:
        limit, limit_mm = "wanted", poses.wanted_mm
        if limit_mm is None:
            limit, limit_mm = "the remaining error", health.train_rms_mm
        yield (
            f"expected uncertainty of a prediction is no larger than {limit}",
            f"{mm(poses.u_model_mm)} mm with {poses.measured} poses; "
            f"{number_needed(poses)} well-chosen poses reach {mm(poses.u_needed_mm)} mm",
            poses.u_model_mm <= limit_mm,
        )
    if isinstance(case, GeneralCalibrationRecord):
        names = [outlier.pose for outlier in case.suspected_outliers]
        listing = f"{', '.join(names[:_MOST_OUTLIERS])}{' …' * (len(names) > _MOST_OUTLIERS)}"
        yield "no suspected outlier", listing or "none", not names
    yield "starts that end in the same minimum", f"{case.starts_agreeing} of {case.starts}", ""


def _evidence(effect: discovery.FoundEffect) -> str:
    """Describe what decided about an effect, in words."""
    evidence = effect.evidence
    if isinstance(evidence, discovery.EvidenceOfSag):
        rigid_mm, elastic_mm, which = evidence.rigid_mm, evidence.gives_way_mm, "poses fitted"
        if evidence.held_out_rigid_mm is not None and evidence.held_out_gives_way_mm is not None:
            rigid_mm, elastic_mm = evidence.held_out_rigid_mm, evidence.held_out_gives_way_mm
            which = "held-out poses"
        return (
            f"{sag_text(evidence)} under the arm's weight; held rigid it leaves {rigid_mm:.3f} mm "
            f"rms of {which}, as it is {elastic_mm:.3f} mm; log evidence "
            f"{evidence.lost_without_it_nats:.3g} nats, {evidence.needed_nats:.3g} needed"
        )
    if isinstance(evidence, discovery.EvidenceByTorques):
        return (
            f"logged torques show {100.0 * evidence.of_rated:.1f} % of the rated torque, "
            f"{evidence.standard_uncertainties:.0f} standard uncertainties; it is taken out of them"
        )
    if isinstance(evidence, discovery.EvidenceByBlocks):
        blocks = evidence.cross_validation_over_blocks
        return (
            f"cross-validation over blocks: rms {blocks.rms_without_mm:.3f} mm without, "
            f"{blocks.rms_with_mm:.3f} mm with it; better in {blocks.improved} of "
            f"{blocks.blocks} blocks, z {blocks.z:.1f}"
        )
    held_out = f"{100.0 * evidence.cross_validation_over_poses.explained:.0f} % over poses"
    if (over_loads := evidence.cross_validation_over_loads) is not None:
        held_out += f", {100.0 * over_loads.explained:.0f} % over loads"
    return (
        f"{evidence.lost_without_it_nats:.3g} nats lost without it, "
        f"{evidence.needed_nats:.3g} needed; "
        f"sign flips p {evidence.p_sign_flips_max_t:.2g}, at most {evidence.p_needed:.2g}; "
        f"cross-validation explains {held_out}"
    )


def _positions_seen(
    model: CalibrationRecord | discovery.ExtendedRecord,
) -> Iterator[tuple[str, str | None, str | None]]:
    """Yield joint, positions that the fit has seen, and those within its limits."""
    fitted: Any = model.fitted_model
    rows = fitted["arm"]["rows"]
    coupling = coupling_of(fitted)
    # Limits are those of the axes that the controller counts; of one that slides in metres.
    axis_limits = np.array([row["limits_rad"] for row in rows], float)[coupling.own]
    joints = zip(fitted.get("seen") or (), rows, coupling.joint_ranges(axis_limits), strict=False)
    for number, (seen, row, limits) in enumerate(joints, start=1):
        allowed = [limits] if np.isfinite(limits).all() else []
        slides = row["prismatic"]
        yield str(number), _ranges(seen.get("intervals"), slides), _ranges(allowed, slides)


def _ranges(intervals: Sequence[Array] | None, slides: bool) -> str | None:
    """Return intervals [m or rad] in words; None where there are none."""
    unit, scale = ("mm", 1e3) if slides else ("°", 180.0 / math.pi)
    texts = [f"{scale * low:.1f} to {scale * high:.1f} {unit}" for low, high in intervals or ()]
    return ", ".join(texts) or None
