"""Section of the page: how far to trust a model."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from pa10cal.arrays import Array
from pa10cal.reports.blocks import Callout, Grid, Items, PageBlock, Paragraph, SideBySide, grid
from pa10cal.reports.formatting import named, sentence
from pa10cal.reports.missing import coupling_of
from pa10cal.reports.pictures import plane_drawings
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.results import discovery
from pa10cal.results.calibration import CalibrationRecord, GeneralCalibrationRecord
from pa10cal.terms.wording import sag_text

#: Of more poses with suspected outliers a check names only the first; their table has all.
_MOST_OUTLIERS = 6
#: Angles between which those of a joint without limits are shown [rad].
_ONE_TURN = np.array([-math.pi, math.pi])


def trust(results: ResultsBundle, case: CalibrationRecord) -> Iterator[PageBlock]:
    """Yield what to check before the model is relied on."""
    yield _basis_of_grade(case)
    if isinstance(case, GeneralCalibrationRecord):
        if case.prior:
            yield Callout("note", sentence(case.prior.line))
        yield outliers_grid(case)
    yield from _warnings(results, case)
    effects = results.verdict.effects if results.verdict else ()
    rows = [(named(effect), _evidence_text(effect)) for effect in effects]
    yield grid("What decided about the effects", "effect | evidence", rows)
    seen = list(_positions_seen(case if results.extended is None else results.extended))
    yield _limits_of_predictions(case, seen_listed=bool(seen))
    yield grid("Joint positions that the fit has seen", "joint | seen | allowed", seen)
    yield from _of_resolvers(results)


def _basis_of_grade(case: CalibrationRecord) -> Grid:
    """Return the checks that the record holds, and two that stand beside the grade."""
    checks = [(each.check, each.found, each.limit, each.passes) for each in case.health.checks]
    if not checks:
        checks = [("the checks of the grade", "not in results of an earlier version", "", None)]
    starts = f"{case.starts_agreeing} of {case.starts}"
    beside: list[tuple[str, str, str, bool | None]] = [
        ("starts that end in the same minimum", starts, "", None)
    ]
    if isinstance(case, GeneralCalibrationRecord):
        poses = list(dict.fromkeys(outlier.pose for outlier in case.suspected_outliers))
        names = f"{', '.join(poses[:_MOST_OUTLIERS])}{' …' * (len(poses) > _MOST_OUTLIERS)}"
        beside.insert(0, ("no suspected outlier", names or "none", "", not poses))
    title = f"Basis of the grade of the calibration: {case.health.grade.replace('_', ' ')}"
    return grid(title, "check | found | limit | passes", [*checks, *beside])


def outliers_grid(case: GeneralCalibrationRecord) -> Grid:
    """Return poses far outside the scatter of the others; distances in units of the scatter."""
    rows = [
        (each.pose, each.load_N, f"{each.distance:.2f}", f"{each.weight:.3f}", each.why)
        for each in case.suspected_outliers
    ]
    title = "Suspected outliers, with their weight in the fit"
    return grid(title, "pose | load [N] | distance | weight | why", rows)


def _warnings(results: ResultsBundle, case: CalibrationRecord) -> Iterator[Callout]:
    """Yield the warnings of the models, each once; the sentence of the grade stands elsewhere."""
    left_out = (case.loads_left_out or {}).items()
    texts = [*case.warnings, *(f"no fit of {load} alone: {why}" for load, why in left_out)]
    extended = results.extended
    if extended is not None:
        about = "with the effects" if extended.named else "by the search for effects"
        texts += [f"{about}: {text}" for text in extended.warnings]
    for text in dict.fromkeys(texts):
        if text != case.health.line:
            yield Callout("warning", sentence(text))


def _limits_of_predictions(case: CalibrationRecord, *, seen_listed: bool) -> Items:
    """Return in words what intervals do not hold, and where predictions extrapolate.

    Args:
        seen_listed: whether a table of the joint positions seen follows.
    """
    beyond = "Outside the joint positions of the table below, or f" if seen_listed else "F"
    heaviest_N = max(case.loads_fitted, default=0.0)
    return Items(
        (
            "Intervals hold the noise of the measurement, not effects that the model lacks; "
            "held-out errors show how large those are.",
            f"The heaviest load of the fit is {heaviest_N:g} N: beyond it is extrapolation."
            if heaviest_N > 0.0
            else "The fit has seen no external load: any load is extrapolation.",
            f"{beyond}ar from all poses of the fit, a prediction is an extrapolation; the column "
            "inside of pa10cal predict shows which rows are near these poses.",
        )
    )


def _of_resolvers(results: ResultsBundle) -> Iterator[PageBlock]:
    """Yield what resolver uncertainty makes of positions in each plane of the Monte Carlo."""
    if results.planes:
        yield Paragraph(
            "Expected position error that resolver uncertainty causes in the nominal arm, over "
            "each plane of the Monte Carlo, from the closed form. Means are over the grid of the "
            "map; the picture below draws positions at random, so the two differ a little."
        )
        yield SideBySide(tuple(plane_drawings(results.planes)))
    for plane in results.planes_not_studied:
        yield Paragraph(f"No Monte Carlo of the plane at z = {plane.plane_mm} mm: {plane.why}.")


def _evidence_text(effect: discovery.FoundEffect) -> str:
    """Return what decided about an effect, in words.

    An effect that took the place of the one found, being likelier, stands on that one's evidence.
    """
    text = _statistics_text(effect.evidence)
    if (other := effect.evidence_of) is None:
        return text
    return f"of {named(other)}, in whose place it stands: {text}"


def _statistics_text(evidence: discovery.Evidence) -> str:
    """Return the statistics that decided about an effect, in words, by the search that found it."""
    match evidence:
        case discovery.EvidenceOfSag():
            return _sag_evidence_text(evidence)
        case discovery.EvidenceByTorques():
            return (
                f"logged torques show {100.0 * evidence.of_rated:.1f} % of the rated torque, "
                f"{evidence.standard_uncertainties:.0f} standard uncertainties; the fit subtracts "
                "this torque from the logged ones"
            )
        case discovery.EvidenceByBlocks(cross_validation_over_blocks=blocks):
            return (
                f"cross-validation over blocks: rms {blocks.rms_without_mm:.3f} mm without, "
                f"{blocks.rms_with_mm:.3f} mm with it; better in {blocks.improved} of "
                f"{blocks.blocks} blocks, z {blocks.z:.1f}"
            )
        case discovery.EvidenceByRepeats():
            return _repeats_evidence_text(evidence)


def _sag_evidence_text(evidence: discovery.EvidenceOfSag) -> str:
    """Return what a joint that gives way explains: of held-out poses, where there are any."""
    rigid_mm, elastic_mm, which = evidence.rigid_mm, evidence.gives_way_mm, "poses fitted"
    if evidence.held_out_rigid_mm is not None and evidence.held_out_gives_way_mm is not None:
        rigid_mm, elastic_mm = evidence.held_out_rigid_mm, evidence.held_out_gives_way_mm
        which = "held-out poses"
    return (
        f"{sag_text(evidence)} under the arm's weight; held rigid it leaves {rigid_mm:.3f} mm "
        f"rms of {which}, as it is {elastic_mm:.3f} mm; log evidence "
        f"{evidence.lost_without_it_nats:.3g} nats, {evidence.needed_nats:.3g} needed"
    )


def _repeats_evidence_text(evidence: discovery.EvidenceByRepeats) -> str:
    """Return evidence, sign flips and cross-validation of an effect, in words."""
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
    if fitted.get("seen") is None:
        return
    rows = fitted["arm"]["rows"]
    coupling = coupling_of(fitted)
    # Limits are those of the axes that the controller counts; of one that slides in metres.
    axis_limits = np.array([row["limits_rad"] for row in rows], float)[coupling.own]
    joints = zip(fitted["seen"], rows, coupling.joint_ranges(axis_limits), strict=True)
    for number, (seen, row, limits) in enumerate(joints, start=1):
        allowed = [limits] if np.isfinite(limits).all() else []
        intervals = seen["intervals"]
        if seen["turns"]:
            intervals = _turn_by_turn(np.reshape(intervals, (-1, 2)), *(allowed or [_ONE_TURN]))
        yield str(number), _ranges(intervals, row["prismatic"]), _ranges(allowed, row["prismatic"])


def _turn_by_turn(intervals: Array, limits: Array) -> list[Array]:
    """Return intervals (m, 2) of angles modulo a turn, in [0, 2 pi], between limits (2,) [rad].

    Those that touch, as at the end of a turn, become one.
    """
    joined: list[Array] = []
    for turn in range(math.floor(limits[0] / math.tau), math.floor(limits[1] / math.tau) + 1):
        for low, high in np.clip(intervals + turn * math.tau, *limits):
            if joined and math.isclose(joined[-1][1], low, abs_tol=1e-9):
                joined[-1] = np.array([joined[-1][0], high])
            elif low < high:
                joined.append(np.array([low, high]))
    return joined


def _ranges(intervals: Iterable[Array], slides: bool) -> str | None:
    """Return intervals [m or rad] in words; None where there are none."""
    unit, scale = ("mm", 1e3) if slides else ("°", 180.0 / math.pi)
    texts = [f"{scale * low:.1f} to {scale * high:.1f} {unit}" for low, high in intervals]
    return ", ".join(texts) or None
