"""Sections of the page: what was measured, and how to use the model."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Any

import numpy as np

from pa10cal.campaign.description import CampaignDescription
from pa10cal.campaign.table import read_base_motion
from pa10cal.reports import blocks
from pa10cal.reports.formatting import count, first_sentences, listed, mm, sentence
from pa10cal.reports.pictures import motion_drawing
from pa10cal.reports.results_bundle import MODEL, OUTPUTS, POSES, ResultsBundle

if TYPE_CHECKING:
    import pandas as pd

#: Characters that a line of a fact holds.
_ONE_LINE = 90
#: Kinds of poses, and what each is used for.
_KINDS = {
    "grid": "to fit",
    "holdout": "held out",
    "line_x": "straight move along x",
    "line_y": "straight move along y",
}
#: Methods by which the base frame was found, in words.
_FRAMES = {
    "straight_lines": "two straight moves along the base's axes",
    "rigid_fit_nominal": "a rigid fit of the nominal arm",
    "hand_eye_poses": "all measured poses at once (hand-eye)",
    "hand_eye_points": "all measured points at once (hand-eye)",
    "ranging": "all measured distances at once",
    "nominal_arm": "the nominal arm",
}
#: Ends the sentence on the duration where rows have an order and no time.
_NOT_SOUGHT = "; rows give an order alone, and no step, drift or wander is sought"


def measurement_section(results: ResultsBundle) -> Iterator[blocks.PageBlock]:
    """Yield what was measured, and where the data come from."""
    poses, frame = results.poses, results.base_frame
    facts = [("Campaign", results.campaign)]
    provenance = " ".join((results.provenance or "").split())
    line = _one_line(provenance)
    if provenance:
        kind = "Synthetic data. " if results.synthetic else ""
        end = "" if line.endswith((".", "…")) else "."
        origin = f"{kind}In the campaign's own words: {line}{end}"
        facts.append(("Where the data come from", origin))
    facts += [("Arm", _arm(results)), ("Instrument", _instrument(results))]
    moved = poses is not None and "motion_x_mm" in poses
    if poses is not None:
        facts.append(("Duration", _duration(poses, results.description)))
        if moved:
            facts.append(("Targets on the base", _base_motion(poses)))
        known_C = poses["temperature_C"].dropna()
        if len(known_C):
            facts.append(("Temperature", f"{known_C.min():.1f} to {known_C.max():.1f} °C"))
    if frame is not None:
        scattered = "distances" if frame.method == "ranging" else "positions"
        scatter = f"{scattered} scatter by {frame.origin_scatter_mm:.3f} mm about it"
        method = _FRAMES.get(frame.method, frame.method)
        names = () if poses is None else _campaigns(poses)
        whose = f" of the first campaign, {names[0]}" if names else ""
        facts.append(("Base frame found from", f"{method}{whose}; {scatter}"))
    yield blocks.Facts(tuple(facts))
    title = "Where the data come from, in the campaign's own words"
    whole = (blocks.Paragraph(sentence(provenance)),) if line != provenance else ()
    yield blocks.Folded(title, whole)
    if poses is None:
        yield blocks.Callout("missing", results.absent["poses"])
        return
    yield _configurations(poses)
    motion = read_base_motion(results.folder / POSES, results.folder) if moved else None
    if motion is not None:
        knocks_s = [knock.time_s for knock in motion.knocked]
        kinds = ("shift", "turn") if motion.turns else ("shift",)
        yield blocks.SideBySide(tuple(motion_drawing(poses, kind, knocks_s) for kind in kinds))
        yield blocks.Items(tuple(sentence(str(knock)) for knock in motion.knocked))
    if results.quarantined:
        reasons = listed(f"{number} × {reason}" for reason, number in results.quarantined.items())
        total = count(sum(results.quarantined.values()), "raw row")
        yield blocks.Callout("note", f"{total} not used, see ingest/quarantine.csv: {reasons}.")


def _one_line(text: str) -> str:
    """Return a text that fits on a line: its first sentences, or its beginning."""
    line = first_sentences(text, _ONE_LINE)
    # One short sentence alone says too little: then the line is filled.
    if text and not _ONE_LINE / 2 < len(line) <= _ONE_LINE:
        return shorten(text, _ONE_LINE, placeholder=" …")
    return line


def _configurations(poses: pd.DataFrame) -> blocks.Grid:
    """Return a table of poses and readings by what they are used for and by load."""
    rows: list[tuple[Any, ...]] = []
    for kind, used_for in _KINDS.items():
        for load_N, readings in poses[poses["kind"] == kind].groupby("load_N"):
            repeats = readings.groupby("pose").size()
            least, most = repeats.min(), repeats.max()
            span = str(most) if least == most else f"{least} to {most}"
            rows.append((used_for, load_N, len(repeats), len(readings), span))
    return blocks.grid(
        "Measured configurations. A configuration is a pose at a load.",
        "used | load [N] | poses | readings | readings of a configuration",
        rows,
    )


def _base_motion(poses: pd.DataFrame) -> str:
    """Return how far the targets on the base moved, in words."""
    shift, turn = (
        np.linalg.norm(poses[[f"motion_{name}" for name in names]], axis=1).max()
        for names in (("x_mm", "y_mm", "z_mm"), ("rx_rad", "ry_rad", "rz_rad"))
    )
    if not shift:
        return "stand still"
    turned = f" and {1e3 * turn:.3f} mrad" if turn else ""
    return (
        f"move together by up to {shift:.3f} mm{turned} about their mean, as the instrument sees "
        "them; taken out of all readings"
    )


def _duration(poses: pd.DataFrame, description: CampaignDescription | None) -> str:
    """Return how long the campaign took; empty where all readings have one time."""
    columns = None if description is None else description.columns
    no_column = columns is not None and columns.poses is not None and columns.poses.time is None
    if no_column or (description is not None and not description.time_recorded):
        return f"not known: time was not recorded{_NOT_SOUGHT}"
    if "tells_time" in poses and not poses["tells_time"].all():
        return f"time was not recorded, or rows follow a joint, a rail or the load{_NOT_SOUGHT}"
    if names := _campaigns(poses):
        # Readings of a group do not tell what time passed between its campaigns.
        seconds = sum(_seconds(poses[poses["campaign"] == name]) for name in names)
        total = f"{_long(seconds)} in {count(len(names), 'campaign')}"
        return f"{total}, each from its first reading to its last" if seconds else ""
    seconds = _seconds(poses)
    return f"{_long(seconds)} from the first reading to the last" if seconds else ""


def _campaigns(poses: pd.DataFrame) -> tuple[str, ...]:
    """Return the campaigns of a group, in its order; none of a campaign."""
    return tuple(poses["campaign"].unique()) if "campaign" in poses else ()


def _seconds(poses: pd.DataFrame) -> float:
    """Return the time from the first of some readings to the last [s]; 0 where none is known."""
    times_s = poses["time_s"].dropna()
    return float(times_s.max() - times_s.min()) if len(times_s) else 0.0


def _long(seconds: float) -> str:
    return f"{seconds / 3600.0:.1f} h" if seconds >= 3600.0 else f"{seconds / 60.0:.0f} min"


def _arm(results: ResultsBundle) -> str:
    if results.calibration is None:
        return "not known" if results.description is None else results.description.robot
    arm = results.calibration.fitted_model.get("arm")
    title = arm.get("title") if isinstance(arm, dict) else None
    name = results.calibration.robot
    return f"{title} ({name})" if title and title != name else name


def _instrument(results: ResultsBundle) -> str:
    stated = ""
    if results.description is not None:
        instrument = results.description.instrument
        stated = f"; stated standard uncertainty {instrument.uncertainty_mm:g} mm"
        stated += "" if instrument.kind == "distance" else " along each axis"
    elif results.calibration is not None:
        repeats = results.calibration.health.repeats
        stated_m = [each.stated for each in repeats if not each.is_of_attitude]
        if stated_m:
            stated = f"; stated standard uncertainty of a reading {mm(1e3 * stated_m[0])} mm"
    return f"{'not known' if results.words is None else results.words.instrument}{stated}"


def use(results: ResultsBundle) -> Iterator[blocks.PageBlock]:
    """Yield what to type to predict and to compensate, and which files there are."""
    if results.model is None:
        yield blocks.Callout("missing", results.absent["model"])
    else:
        yield from _commands(results.folder)
    there = [file for file in OUTPUTS if file.holds and file.has_content(results.folder)]
    rows = [(file.path, file.holds) for file in there]
    yield blocks.grid("Files of this campaign", "file | holds", rows)


def _commands(folder: Path) -> Iterator[blocks.PageBlock]:
    yield blocks.Paragraph(
        f"Run the commands in the folder of these results, {folder.absolute().name}: "
        "the paths below begin there. Poses are in the robot's base frame. Angles are in "
        "degrees."
    )
    yield blocks.Code(
        "Where is the tool at these joint positions?",
        f"pa10cal predict --model {MODEL} \\\n  --joints joints.csv --out poses.csv --frame tool",
    )
    yield blocks.Code(
        "Which joint positions bring the tool to these poses?",
        f"pa10cal compensate --model {MODEL} \\\n"
        "  --targets targets.csv --out commands.csv --frame tool",
    )
    yield blocks.Code(
        "From Python",
        "import pa10cal\n\n"
        f'model = pa10cal.load_model("{MODEL}")\n'
        'found = model.predict(q_rad, frame="tool")  # found.T [m], found.u_mm, found.inside',
    )
    yield blocks.Items(
        (
            "joints.csv: id,q1_deg,…,load_N; a row for each pose to predict.",
            "targets.csv: id,x_mm,y_mm,z_mm,qw,qx,qy,qz; a row for each pose to reach.",
            "--frame flange gives the arm's last frame in place of the tool.",
        )
    )
