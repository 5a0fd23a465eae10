"""Sections of the page: how far to trust it, what is missing, what to measure next."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from typing import Any

import numpy as np

from pa10cal.arm.coupling import CoupledJoint, Coupling
from pa10cal.arrays import Array
from pa10cal.reports.blocks import (
    Callout,
    Grid,
    Items,
    PageBlock,
    Paragraph,
    SideBySide,
    folded,
    grid,
)
from pa10cal.reports.formatting import NOT_KNOWN, count, display_name, listed, mm, named, sentence
from pa10cal.reports.pictures import plane_drawings, poses_drawing
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.results import discovery
from pa10cal.results.calibration import CalibrationRecord, GeneralCalibrationRecord, PosesNeeded
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
    yield (
        "every parameter is determined",
        f"rank {health.rank} of {health.unknowns}, condition number {health.condition:.4g}",
        "yes" if health.rank == health.unknowns else "no: see what is missing",
    )
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
            f"{_number_needed(poses)} well-chosen poses reach {mm(poses.u_needed_mm)} mm",
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
    coupling = _coupling_of(fitted)
    # Limits are those of the axes that the controller counts; of one that slides in metres.
    axis_limits = np.array([row["limits_rad"] for row in rows], float)[coupling.own]
    joints = zip(fitted.get("seen") or (), rows, coupling.joint_ranges(axis_limits), strict=False)
    for number, (seen, row, limits) in enumerate(joints, start=1):
        allowed = [limits] if np.isfinite(limits).all() else []
        slides = row["prismatic"]
        yield str(number), _ranges(seen.get("intervals"), slides), _ranges(allowed, slides)


def _coupling_of(fitted: Any) -> Coupling:
    """Return how the joints of a fitted model follow from the axes that its controller counts."""
    arm = fitted["arm"]
    coupled = tuple(CoupledJoint(**joint) for joint in arm.get("coupling", ()))
    return Coupling(len(arm["rows"]), coupled)


def _ranges(intervals: Sequence[Array] | None, slides: bool) -> str | None:
    """Return intervals [m or rad] in words; None where there are none."""
    unit, scale = ("mm", 1e3) if slides else ("°", 180.0 / math.pi)
    texts = [f"{scale * low:.1f} to {scale * high:.1f} {unit}" for low, high in intervals or ()]
    return ", ".join(texts) or None


# What is missing from results and model, and what to measure next.

#: Of more suggested poses only the first are shown; all are in the file.
_MOST_POSES = 10
_JOINT = "joint "
#: More joints than this in a row are written as first to last.
_MOST_LISTED = 2
#: An aim that several joints of one pose may share.
_UNSEEN = re.compile(r"angle of joint (\d+) not seen")


def missing(results: ResultsBundle) -> Iterator[PageBlock]:
    """Yield what these data do not show."""
    yield from (Callout("missing", why) for why in results.absent.values())
    case, record = results.calibration, results.verdict
    texts, tables = [], []
    if case is not None:
        if case.health.not_identifiable:
            names = listed(map(display_name, case.health.not_identifiable))
            texts.append(f"Not identifiable from these poses: {names}.")
        if not case.health.repeats:
            texts.append("No pose is repeated often enough to estimate the scatter of readings.")
        if not case.torques_logged:
            weights = "described or assumed weights"
            texts.append(f"Joint torques were not logged: springs use those of {weights}.")
        pairs = [
            (*map(display_name, pair.parameters), f"{pair.correlation:+.3f}")
            for pair in case.health.correlated_pairs
        ]
        title = "Parameters that these poses can hardly separate"
        tables.append((grid(title, "parameter | and | correlation", pairs), "pair"))
    if record is not None:
        if record.verdict == "not_sought":
            texts.append(f"Effects were not sought. {sentence(record.remedy or '')}")
        for title, entries in (
            ("These data cannot show some effects", record.not_testable),
            (
                "Effects that were sought, but are likely to be missed at their plausible size",
                record.below_detection_limit or (),
            ),
        ):
            tables.append((grid(title, "effect | of | why", _by_effect(entries)), "effect"))
        groups = [(listed(effect.words for effect in group),) for group in record.indistinguishable]
        title = "Effects that these poses cannot separate"
        tables.append((grid(title, "group", groups), "effect"))
    yield Items(tuple(texts))
    for table, row in tables:
        yield folded(table, f"{table.caption} ({count(len(table.rows), row)})")
    if not (results.absent or texts or (record is not None and record.not_testable)):
        yield Paragraph("Nothing is missing that these data could have shown.")


def _by_effect(entries: Iterable[discovery.NotTestable]) -> Iterator[tuple[str, str, str]]:
    """Yield a row an effect: where it sits, and the reasons, each with its places."""
    by_effect: dict[str, dict[str, list[str]]] = {}  # places of an effect by reason
    for entry in entries:
        by_effect.setdefault(entry.id, {}).setdefault(entry.why, []).append(entry.of)
    for effect, by_reason in by_effect.items():
        every_place = [place for places in by_reason.values() for place in places]
        reasons = [f"{_places(places)}: {reason}" for reason, places in by_reason.items()]
        why = next(iter(by_reason)) if len(by_reason) == 1 else "; ".join(reasons)
        yield effect.replace("_", " "), _places(every_place), why


def _places(places: Sequence[str]) -> str:
    """Return places in few words: `joints 1 to 3, 5` for the joints among them."""
    joints = sorted({int(p.removeprefix(_JOINT)) for p in places if p.startswith(_JOINT)})
    others = [place.replace("_", " ") for place in places if not place.startswith(_JOINT)]
    if not joints:
        return ", ".join(others)
    # The difference of a joint's number and its index is the same for consecutive joints.
    runs = [list(run) for _, run in groupby(joints, lambda joint: joint - joints.index(joint))]
    numbers = ", ".join(
        f"{run[0]} to {run[-1]}" if len(run) > _MOST_LISTED else ", ".join(map(str, run))
        for run in runs
    )
    return ", ".join([f"joint{'s' if len(joints) > 1 else ''} {numbers}", *others])


def next_poses(results: ResultsBundle) -> Iterator[PageBlock]:
    """Yield what to measure next, and what for."""
    if results.calibration is not None:
        poses = results.calibration.health.poses
        yield Paragraph(poses_in_words(poses))
        if (drawing := poses_drawing(poses)) is not None:
            yield drawing
    if (record := results.verdict) is None:
        yield Callout("missing", results.absent["verdict"])
        return
    if not record.suggested_poses:
        yield Paragraph("No further poses are suggested to separate effects.")
        return
    fitted = None if results.calibration is None else results.calibration.fitted_model
    yield _suggested_grid(record.suggested_poses, fitted)
    hopeless = []
    for pair in record.separations or ():
        if not pair.can_be_split:
            hopeless.append(pair.pair.replace("_", " "))
        elif pair.probability is not None:
            effect, _, rival = pair.pair.replace("_", " ").partition(" or ")
            yield Paragraph(
                f"{count(len(record.suggested_poses), 'pose')} would tell {effect} "
                f"({pair.probability:.2f} between the two now) from {rival}: the "
                f"likelier of both would come to an expected {pair.expected_probability:.2f}."
            )
    if hopeless:
        names = "; ".join(hopeless)
        yield Callout("note", f"No pose of this arm and instrument shows: {names}.")


def _suggested_grid(poses: Sequence[discovery.SuggestedPose], fitted: Any) -> Grid:
    """Return a table of the first suggested poses, as positions of the controller's axes.

    Args:
        poses: the most informative first.
        fitted: the fitted model, which says which axes slide; None where none is known to.
    """
    slides = [False] * len(poses[0].q_rad)
    if fitted is not None:
        rows = fitted["arm"]["rows"]
        slides = [rows[joint]["prismatic"] for joint in _coupling_of(fitted).own]
    units = ["mm" if each else "deg" for each in slides]
    scales = [1e3 if each else 180.0 / math.pi for each in slides]
    rows = []
    for number, pose in enumerate(poses[:_MOST_POSES], start=1):
        sides = [0] * len(scales) if pose.arrive_from is None else np.sign(pose.arrive_from)
        positions = (
            f"{scale * q:.1f}{('', ' ↓', ' ↑')[int(side)]}"
            for scale, q, side in zip(scales, pose.q_rad, sides, strict=True)
        )
        rows.append((str(number), *positions, f"{pose.load_N:g}", _aim(pose)))
    joints = (f"q{number} [{unit}]" for number, unit in enumerate(units, start=1))
    return grid(
        f"The {count(len(rows), 'pose')} with most information, also in "
        "discovery/suggested_poses.csv. An arrow: the joint arrives from smaller "
        "(↑) or from larger (↓) positions.",
        ("order", *joints, "load [N]", "what for"),
        rows,
    )


def _number_needed(poses: PosesNeeded) -> str:
    """Return how many well-chosen poses reach the uncertainty needed."""
    if poses.needed is not None:
        return str(poses.needed)
    all_reach_it = poses.u_model_mm is not None and poses.u_model_mm <= poses.u_needed_mm
    return f"more than {len(poses.d_optimal_order) if all_reach_it else poses.measured}"


def poses_in_words(poses: PosesNeeded) -> str:
    """Return how uncertain predictions are, and how many poses would be enough."""
    if poses.u_model_mm is None:
        return "The uncertainty of predictions is not known."
    now = f"{poses.measured} poses give a standard uncertainty of {mm(poses.u_model_mm)} mm"
    purpose = "is wanted"
    if poses.wanted_mm is None:
        purpose = "would add hardly anything to the remaining error"
    enough = f"{mm(poses.u_needed_mm)} mm {purpose}"
    if poses.needed is None:
        return f"{now}; {enough}, which {_number_needed(poses)} well-chosen poses reach."
    best = ", ".join(list(dict.fromkeys(poses.d_optimal_order))[:_MOST_POSES])
    return (
        f"{now} of a predicted position. {enough}; "
        f"{poses.needed} well-chosen poses reach it. For a "
        f"repetition of the campaign, the most informative of those measured are, in order: {best}."
    )


def _aim(pose: discovery.SuggestedPose) -> str:
    """Return in a sentence what a pose is for; joints with an unseen angle are listed together."""
    unseen_joints, rivals = [], []
    for aim in pose.for_:
        if match := _UNSEEN.fullmatch(aim):
            unseen_joints.append(int(match[1]))
        else:
            rivals.append(aim.replace("_", " "))
    parts = []
    if rivals:
        nats = pose.separation_nats
        by_then = "" if nats is None else f" ({nats:.1f} nats expected up to this pose)"
        parts.append(f"separates {'; '.join(rivals)}{by_then}")
    if unseen_joints:
        joints = f"joint{'s' if len(unseen_joints) > 1 else ''}"
        numbers = listed(map(str, sorted(unseen_joints)))
        parts.append(f"shows an angle of {joints} {numbers} where the fit has seen no pose")
    return sentence("; ".join(parts))
