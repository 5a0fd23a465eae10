"""Sections of the page: what is missing from results and model, what to measure next."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from typing import Any

import numpy as np

from pa10cal.arm.coupling import CoupledJoint, Coupling
from pa10cal.reports.blocks import Callout, Grid, Items, PageBlock, Paragraph, folded, grid
from pa10cal.reports.formatting import count, display_name, listed, mm, sentence
from pa10cal.reports.pictures import poses_drawing
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.results import discovery
from pa10cal.results.calibration import GeneralCalibrationRecord, PosesNeeded

#: Of more suggested poses only the first are shown; all are in the file.
_MOST_POSES = 10
_JOINT = "joint "
#: More joints than this in a row are written as first to last.
_MOST_LISTED = 2
#: Aims that several joints of one pose may share, and how they are told.
_SHARED = {
    re.compile(r"angle of joint (\d+) not seen"): "where the fit has seen no pose",
    re.compile(r"few poses near the angle of joint (\d+)"): "near which the fit has seen few poses",
}


def missing(results: ResultsBundle) -> Iterator[PageBlock]:
    """Yield what these data do not show."""
    yield from (Callout("missing", why) for why in results.absent.values())
    case, record = results.calibration, results.verdict
    texts, tables = [], []
    if case is not None:
        if case.health.not_identifiable:
            open_ = case.health.not_identifiable
            of_weights = [name for name in open_ if name.startswith("weight_")]
            names = [display_name(name) for name in open_ if name not in of_weights]
            if many := len(of_weights):
                names.append(count(many, "departure of weights", "departures of weights"))
            texts.append(f"Not identifiable from these poses: {listed(names)}.")
        if not case.health.repeats:
            texts.append("No pose is repeated often enough to estimate the scatter of readings.")
        if isinstance(case, GeneralCalibrationRecord) and case.torques_from == "none":
            texts.append("Joint torques are not known, as without gravity: springs are not fitted.")
        elif not case.torques_logged:
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
    if record.no_separating_poses is not None:
        why = sentence(record.no_separating_poses)
        yield Paragraph(f"No further poses are suggested to separate effects. {why}")
    if not record.suggested_poses:
        if record.no_separating_poses is None:
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
        slides = [rows[joint]["prismatic"] for joint in coupling_of(fitted).own]
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


def coupling_of(fitted: Any) -> Coupling:
    """Return how the joints of a fitted model follow from the axes that its controller counts."""
    arm = fitted["arm"]
    coupled = tuple(CoupledJoint(**joint) for joint in arm.get("coupling", ()))
    return Coupling(len(arm["rows"]), coupled)


def number_needed(poses: PosesNeeded) -> str:
    """Return how many well-chosen poses reach the uncertainty needed."""
    if poses.needed is not None:
        return str(poses.needed)
    all_reach_it = poses.u_model_mm is not None and poses.u_model_mm <= poses.u_needed_mm
    return f"more than {len(poses.d_optimal_order) if all_reach_it else poses.measured}"


def poses_in_words(poses: PosesNeeded) -> str:
    """Return how uncertain predictions are, and how many poses would be enough."""
    if poses.u_model_mm is None:
        return "The uncertainty of predictions is not known."
    now = (
        f"{poses.measured} poses give a standard uncertainty of {mm(poses.u_model_mm)} mm of "
        "positions predicted near them"
    )
    purpose = "is wanted"
    if poses.wanted_mm is None:
        purpose = "would add hardly anything to the remaining error"
    enough = f"{mm(poses.u_needed_mm)} mm {purpose}"
    if poses.needed is None:
        return f"{now}; {enough}, which {number_needed(poses)} well-chosen poses reach."
    best = ", ".join(list(dict.fromkeys(poses.d_optimal_order))[:_MOST_POSES])
    return (
        f"{now}. {enough}; "
        f"{poses.needed} well-chosen poses reach it. For a "
        f"repetition of the campaign, the most informative of those measured are, in order: {best}."
    )


def _aim(pose: discovery.SuggestedPose) -> str:
    """Return in a sentence what a pose is for; joints with such an angle are listed together."""
    by_joint = {aim: joints for aim in _SHARED if (joints := _joints_of(aim, pose.for_))}
    shared = [each for each in pose.for_ if any(aim.fullmatch(each) for aim in _SHARED)]
    rivals = [each.replace("_", " ") for each in pose.for_ if each not in shared]
    parts = []
    if rivals:
        nats = pose.separation_nats
        by_then = "" if nats is None else f" ({nats:.1f} nats expected up to this pose)"
        parts.append(f"separates {'; '.join(rivals)}{by_then}")
    for aim, joints in by_joint.items():
        of = f"joint{'s' if len(joints) > 1 else ''}"
        parts.append(f"shows an angle of {of} {listed(map(str, joints))} {_SHARED[aim]}")
    return sentence("; ".join(parts))


def _joints_of(aim: re.Pattern[str], aims: Iterable[str]) -> list[int]:
    """Return the joints that an aim is stated for, in ascending order."""
    return sorted(int(match[1]) for each in aims if (match := aim.fullmatch(each)))
