"""Sections of the page: how far to trust it, what is missing, what to measure next."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence

from pa10cal.reports.blocks import Block, Callout, Folded, Grid, Items, Paragraph, grid
from pa10cal.reports.formatting import (
    NOT_KNOWN,
    count,
    listed,
    mm,
    named,
    parameters,
    sentence,
    written,
)
from pa10cal.reports.pictures import poses_drawing
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.results import discovery
from pa10cal.results.calibration import CalibrationRecord, GeneralCalibrationRecord
from pa10cal.results.health import Health


def trust(results: ResultsBundle) -> Iterator[Block]:
    """Yield what to check before the model is relied on."""
    if results.calibration is None:
        yield Callout("missing", results.why_absent(f"calibration/{results.load_case}.json"))
        return
    yield checks_grid(results.calibration, "calibration")
    if isinstance(results.calibration, GeneralCalibrationRecord):
        if results.calibration.prior:
            yield Callout("note", sentence(results.calibration.prior.line))
        if results.calibration.suspected_outliers:
            yield outliers_grid(results.calibration)
    warnings = dict.fromkeys(results.calibration.warnings)
    if results.extended is not None and results.extended.named:
        warnings |= dict.fromkeys(f"with the effects: {each}" for each in results.extended.warnings)
    for warning in warnings:
        if warning != results.calibration.health.line:
            yield Callout("warning", sentence(warning))
    record = results.verdict
    if record is not None and record.effects:
        yield evidence_grid(record)
    if record is not None and record.falls_back is not None:
        yield Callout("warning", sentence(f"limits of the effects: {record.falls_back.why}"))
    yield Items(tuple(_limits(results)))
    seen = tuple(_seen(results))
    if seen:
        yield grid("Joint positions that the fit has seen", ("joint", "seen", "allowed"), seen)


def checks_grid(case: CalibrationRecord, what: str) -> Grid:
    """Return what the grade of a calibration stands on.

    Args:
        case: the calibration.
        what: how the caption calls it.
    """
    title = f"What the grade of the {what} stands on: {case.health.grade.replace('_', ' ')}"
    return grid(title, ("check", "found", "passes"), _checks(case))


def outliers_grid(case: GeneralCalibrationRecord) -> Grid:
    """Return poses far outside the scatter of the others; distances in units of the scatter."""
    rows = [
        (each.pose, f"{each.load_N:g}", f"{each.distance:.2f}", f"{each.weight:.3f}", each.why)
        for each in case.suspected_outliers
    ]
    header = ("pose", "load [N]", "distance", "weight", "why")
    return grid("Suspected outliers, in the fit with less weight", header, rows, (1, 2, 3))


def evidence_grid(record: discovery.VerdictRecord) -> Grid:
    """Return the statistics that decided about each effect."""
    rows = [(named(each), _evidence(each)) for each in record.effects]
    return grid("What decided about the effects", ("effect", "evidence"), rows)


def _checks(case: CalibrationRecord) -> Iterator[tuple[str, str, str]]:
    health = case.health
    yield "the fit converged", health.ending, _passes(health.converged)
    bounds = len(health.at_bounds)
    at_bounds = parameters(health.at_bounds)
    yield "no parameter at the end of its range", at_bounds, _passes(not bounds)
    full = health.rank == health.unknowns
    yield (
        "every parameter is determined",
        f"rank {health.rank} of {health.unknowns}, condition number {health.condition:.4g}",
        _passes(full) if full else "no: see what is missing",
    )
    ratio = health.error_over_noise
    yield (
        "remaining error agrees with the noise",
        NOT_KNOWN
        if ratio is None
        else f"{mm(health.train_rms_mm)} mm rms, {ratio:.1f} times the {case.noise_is}",
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
    poses = health.poses
    if poses.u_model_mm is not None:
        needed = f"more than {len(poses.d_optimal_order)}" if poses.needed is None else poses.needed
        asked_mm = health.train_rms_mm if poses.wanted_mm is None else poses.wanted_mm
        yield (
            "expected uncertainty of a prediction is no larger than "
            + ("the remaining error" if poses.wanted_mm is None else "wanted"),
            f"{mm(poses.u_model_mm)} mm with {poses.measured} poses; {needed} well-chosen poses "
            f"reach {mm(poses.u_needed_mm)} mm",
            _passes(poses.u_model_mm <= asked_mm),
        )
    if isinstance(case, GeneralCalibrationRecord):
        outliers = case.suspected_outliers
        names = ", ".join(each.pose for each in outliers[:6])
        yield "no suspected outlier", names or "none", _passes(not outliers)
    agree_on = f"{case.starts_agreeing} of {case.starts}"
    yield "starts that end in the same minimum", agree_on, ""


def _held_out(health: Health) -> tuple[str, str]:
    if health.held_out_rms_mm is None:
        return "nothing was held out", "not tested"
    told = f"{mm(health.held_out_rms_mm)} mm rms; fitted {mm(health.train_rms_mm)} mm"
    return told, _passes(health.held_out_over_expected is None)


def _passes(well: bool) -> str:
    return "yes" if well else "no"


def _evidence(effect: discovery.FoundEffect) -> str:
    """Describe what decided about an effect, in words."""
    found = effect.evidence
    if isinstance(found, discovery.EvidenceOfSag):
        return found.words
    if isinstance(found, discovery.EvidenceByBlocks):
        blocks = found.cross_validation_over_blocks
        return (
            f"cross-validation over blocks: rms {blocks.rms_without_mm:.3f} mm without, "
            f"{blocks.rms_with_mm:.3f} mm with it; better in {blocks.improved} of "
            f"{blocks.blocks} blocks, z {blocks.z:.1f}"
        )
    shares = [("poses", found.cross_validation_over_poses)]
    if found.cross_validation_over_loads is not None:
        shares.append(("loads", found.cross_validation_over_loads))
    held_out = ", ".join(f"{100.0 * of.explained:.0f} % over {name}" for name, of in shares)
    return (
        f"{found.lost_without_it_nats:.3g} nats lost without it, {found.needed_nats:.3g} needed; "
        f"sign flips p {found.p_sign_flips_max_t:.2g}, at most {found.p_needed:.2g}; "
        f"cross-validation explains {held_out}"
    )


def _limits(results: ResultsBundle) -> Iterator[str]:
    assert results.calibration is not None
    if results.synthetic:
        yield "The data are synthetic: nothing here was measured on a real robot."
    yield (
        "Intervals hold the noise of the measurement, not effects that the model lacks; held-out "
        "errors show how large those are."
    )
    loads = results.calibration.loads_fitted
    if max(loads, default=0.0) > 0.0:
        yield f"The heaviest load of the fit is {max(loads):g} N: beyond it is extrapolation."
    else:
        yield "The fit has seen no external load: any is extrapolation."
    yield (
        "Outside the joint positions of the table below a prediction is an extrapolation; the "
        "column inside of pa10cal predict says so row by row."
    )


def _seen(results: ResultsBundle) -> Iterator[tuple[str, str, str]]:
    model = results.calibration if results.extended is None else results.extended
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


# What is missing from results and model, and what to measure next.

#: Of more suggested poses only the first are shown; all are in the file.
_MOST_POSES = 10
_JOINT = "joint "
#: More joints than this in a row are written as first to last.
_MOST_LISTED = 2
#: An aim that several joints of one pose may share.
_UNSEEN = re.compile(r"angle of joint (\d+) not seen")
_OF_JOINT = re.compile(r"\bjoint (\d+)")


def missing(results: ResultsBundle) -> Iterator[Block]:
    """Yield what these data do not show."""
    for why in results.absent.values():
        yield Callout("missing", why)
    told = tuple(_told(results))
    if told:
        yield Items(told)
    if results.calibration is not None and results.calibration.health.correlated_pairs:
        yield _folded(pairs_grid(results.calibration.health), "pair")
    record = results.verdict
    if record is not None:
        yield from (_folded(each, "effect") for each in hidden_grids(record))
    if not (results.absent or told or (record is not None and record.not_testable)):
        yield Paragraph("Nothing is missing that these data could have shown.")


def _told(results: ResultsBundle) -> Iterator[str]:
    if results.calibration is not None:
        health = results.calibration.health
        if health.not_identifiable:
            names = parameters(health.not_identifiable)
            yield f"Not identifiable from these poses: {names}."
        if not health.repeats:
            yield "No pose is repeated often enough to know how readings scatter."
        if not results.calibration.torques_logged:
            yield "Joint torques were not logged: springs use those of the described masses."
    if results.verdict is not None and results.verdict.verdict == "not_sought":
        yield f"Effects were not sought. {sentence(results.verdict.remedy or '')}"


def _folded(table: Grid, row: str) -> Folded:
    return Folded(f"{table.caption} ({count(len(table.rows), row)})", (table,))


def pairs_grid(health: Health) -> Grid:
    """Return pairs of parameters that the poses can hardly separate."""
    pairs = health.correlated_pairs
    return grid(
        "Parameters that these poses can hardly separate",
        ("parameter", "and", "correlation"),
        [(*map(written, each.parameters), f"{each.correlation:+.3f}") for each in pairs],
        (2,),
    )


def hidden_grids(record: discovery.VerdictRecord) -> Iterator[Grid]:
    """Yield the effects that the data cannot show, are likely to miss, or cannot separate."""
    sets = (
        ("These data cannot show some effects", record.not_testable),
        (
            "Effects that were sought, but are likely to be missed at their plausible size",
            record.below_detection_limit or (),
        ),
    )
    for title, entries in sets:
        if entries:
            yield grid(title, ("effect", "of", "why"), _by_effect(entries))
    if record.indistinguishable:
        groups = [(listed(each.words for each in group),) for group in record.indistinguishable]
        yield grid("Effects that these poses cannot separate", ("group",), groups)


def _by_effect(entries: Iterable[discovery.NotTestable]) -> Iterator[tuple[str, str, str]]:
    """Yield a row an effect: where it sits, and the reasons, each with its places."""
    places: dict[str, dict[str, list[str]]] = {}
    for entry in entries:
        places.setdefault(entry.id, {}).setdefault(entry.why, []).append(entry.of)
    for effect, by_reason in places.items():
        everywhere = _places([of for each in by_reason.values() for of in each])
        reasons = [f"{_places(each)}: {why}" for why, each in by_reason.items()]
        why = next(iter(by_reason)) if len(by_reason) == 1 else "; ".join(reasons)
        yield effect.replace("_", " "), everywhere, why


def _places(places: Sequence[str]) -> str:
    """Return places in few words: `joints 1 to 3, 5` for the joints among them."""
    joints = sorted(int(of.removeprefix(_JOINT)) for of in places if of.startswith(_JOINT))
    others = [of.replace("_", " ") for of in places if not of.startswith(_JOINT)]
    runs: list[list[int]] = []
    for joint in joints:
        if runs and joint == runs[-1][-1] + 1:
            runs[-1].append(joint)
        else:
            runs.append([joint])
    told = ", ".join(
        f"{run[0]} to {run[-1]}" if len(run) > _MOST_LISTED else ", ".join(map(str, run))
        for run in runs
    )
    return ", ".join([f"joint{'s' * (len(joints) > 1)} {told}"] * bool(joints) + others)


def next_poses(results: ResultsBundle) -> Iterator[Block]:
    """Yield what to measure next, and what for."""
    if results.calibration is not None:
        poses = results.calibration.health.poses
        enough = (
            "would add hardly anything to the remaining error"
            if poses.wanted_mm is None
            else "is wanted"
        )
        now = f"{poses.measured} poses give a standard uncertainty of {mm(poses.u_model_mm)} mm"
        if poses.u_model_mm is None:
            yield Paragraph("How uncertain predictions are is not known.")
        elif poses.needed is None:
            yield Paragraph(
                f"{now}; {mm(poses.u_needed_mm)} mm {enough}, and no number of such poses "
                "reaches it."
            )
        else:
            yield Paragraph(
                f"{now} of a predicted position. {mm(poses.u_needed_mm)} mm {enough}; "
                f"{poses.needed} well-chosen poses reach it. For a "
                "repetition of the campaign, the most informative of those measured are, in order: "
                f"{', '.join(list(dict.fromkeys(poses.d_optimal_order))[:_MOST_POSES])}."
            )
        drawing = poses_drawing(poses)
        if drawing is not None:
            yield drawing
    record = results.verdict
    if record is None:
        yield Callout("missing", results.why_absent(discovery.VerdictRecord.FILE))
        return
    if not record.suggested_poses:
        yield Paragraph("No further poses are suggested to tell effects apart.")
        return
    joints = len(record.suggested_poses[0].q_deg)
    yield grid(
        f"The {count(min(len(record.suggested_poses), _MOST_POSES), 'pose')} that tell most, in "
        "discovery/suggested_poses.csv too. An arrow says whether the joint arrives from smaller "
        "(↑) or from larger (↓) angles.",
        ("order", *(f"q{j} [deg]" for j in range(1, joints + 1)), "load [N]", "what for"),
        [
            (str(k), *_angles(each.q_deg, each.arrive_from), f"{each.load_N:g}", _aim(each))
            for k, each in enumerate(record.suggested_poses[:_MOST_POSES], start=1)
        ],
        range(joints + 2),
    )
    hopeless = [each.pair for each in record.separations or () if not each.can_be_split]
    if hopeless:
        names = "; ".join(each.replace("_", " ") for each in hopeless)
        yield Callout("note", f"No pose of this arm and instrument shows: {names}.")


def _angles(q_deg: object, arrive_from: object) -> Iterator[str]:
    sides = [""] * len(q_deg) if arrive_from is None else arrive_from  # type: ignore[arg-type]
    for angle, side in zip(q_deg, sides, strict=True):  # type: ignore[call-overload]
        yield f"{angle:.1f}{'' if side == '' else ' ↑' if side < 0 else ' ↓'}"


def _aim(pose: discovery.SuggestedPose) -> str:
    """Say in a sentence what a pose is for, with the joints that matter and where they stand."""
    unseen = [int(found[1]) for name in pose.for_ if (found := _UNSEEN.fullmatch(name))]
    rivals = [name.replace("_", " ") for name in pose.for_ if not _UNSEEN.fullmatch(name)]
    parts = []
    if rivals:
        joints = sorted({int(joint) for name in rivals for joint in _OF_JOINT.findall(name)})
        where = f" with {_standing(pose, joints)}" if joints else ""
        nats = pose.separation_nats
        by_then = "" if nats is None else f" ({nats:.1f} nats expected up to this pose)"
        parts.append(f"separates {'; '.join(rivals)}{where}{by_then}")
    if unseen:
        parts.append(f"shows {_standing(pose, unseen)}, where the fit has seen no pose")
    return sentence("; ".join(parts)) if parts else ""


def _standing(pose: discovery.SuggestedPose, joints: Sequence[int]) -> str:
    return listed(f"joint {joint} at {pose.q_deg[joint - 1]:.1f}°" for joint in joints)
