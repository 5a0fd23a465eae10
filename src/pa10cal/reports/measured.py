"""Sections of the page: what was measured, and how to use the model."""

from __future__ import annotations

import re
from collections.abc import Iterator
from textwrap import shorten

import numpy as np
import pandas as pd

from pa10cal.campaign.description import CampaignDescription
from pa10cal.reports import blocks
from pa10cal.reports.formatting import count, listed, mm, sentence
from pa10cal.reports.pictures import motion_drawing
from pa10cal.reports.results_bundle import MODEL, POSES, ResultsBundle
from pa10cal.results.health import UNRESERVED

#: Characters that a line of a fact holds.
_ONE_LINE = 90
#: Where a sentence ends: not after an initial, nor within `Fig. 4` or a name of a file.
_SENTENCE = re.compile(r"(?<=[a-z\d)\]][a-z\d)\]][.;])\s+(?=[A-Z])")
_KINDS = {
    "grid": "to fit",
    "holdout": "held out",
    "line_x": "straight move along x",
    "line_y": "straight move along y",
}
_FRAMES = {
    "straight_lines": "two straight moves along the base's axes",
    "rigid_fit_nominal": "a rigid fit of the nominal arm",
    "hand_eye_poses": "all measured poses at once (hand-eye)",
    "hand_eye_points": "all measured points at once (hand-eye)",
    "ranging": "all measured distances at once",
    "nominal_arm": "the nominal arm",
}
#: What follows where rows give an order and no time.
_NOT_SOUGHT = "; rows give an order alone, and no step, drift or wander is sought"


def measured(results: ResultsBundle) -> Iterator[blocks.Block]:
    """Yield what was measured, and where the data come from."""
    yield blocks.Facts(tuple(_facts(results)))
    words = _provenance(results)
    if words is not None and _in_one_line(words) != words:
        told = (blocks.Paragraph(sentence(words)),)
        yield blocks.Folded("Where the data come from, in the campaign's own words", told)
    if results.poses is None:
        yield blocks.Callout("missing", results.why_absent(POSES))
        return
    yield blocks.grid(
        "Measured configurations. A configuration is a pose at a load.",
        ("used", "load [N]", "poses", "readings", "readings of a configuration"),
        _counts(results.poses),
        numbers=(1, 2, 3),
    )
    if "motion_x_mm" in results.poses and results.motion is not None:
        kinds = ("shift", "turn") if results.motion.turns else ("shift",)
        knocks_s = [each.time_s for each in results.motion.knocked]
        yield blocks.Beside(tuple(motion_drawing(results.poses, word, knocks_s) for word in kinds))
        if knocks_s:
            yield blocks.Items(tuple(sentence(str(each)) for each in results.motion.knocked))
    if results.quarantined:
        reasons = listed(f"{number} × {reason}" for reason, number in results.quarantined.items())
        total = count(sum(results.quarantined.values()), "raw row")
        yield blocks.Callout("note", f"{total} not used, see ingest/quarantine.csv: {reasons}.")


def _facts(results: ResultsBundle) -> Iterator[tuple[str, str]]:
    yield "Campaign", results.campaign
    words = _provenance(results)
    if words is not None:
        kind = "Synthetic data. " if results.synthetic else ""
        told = f"{kind}In the campaign's own words: {_in_one_line(words)}"
        yield "Where the data come from", told if told.endswith((".", "…")) else f"{told}."
    yield "Arm", _arm(results)
    yield "Instrument", _instrument(results)
    if results.poses is not None:
        yield "Duration", _duration(results.poses, results.description)
        if "motion_x_mm" in results.poses:
            yield "Targets on the base", _base_motion(results.poses)
        warm = results.poses["temperature_C"].dropna()
        if len(warm):
            yield "Temperature", f"{warm.min():.1f} to {warm.max():.1f} °C"
    if (frame := results.base_frame) is not None:
        scatter = f"positions scatter by {frame.origin_scatter_mm:.3f} mm about it"
        yield "Base frame found from", f"{_FRAMES.get(frame.method, frame.method)}; {scatter}"


def _provenance(results: ResultsBundle) -> str | None:
    return None if results.provenance is None else " ".join(results.provenance.split())


def _in_one_line(words: str) -> str:
    """Return the sentences that fill one line; where they do not, the beginning of the text."""
    first, *others = _SENTENCE.split(words)
    for each in others:
        if len(first) + len(each) >= _ONE_LINE:
            break
        first = f"{first} {each}"
    whole = _ONE_LINE / 2 < len(first) <= _ONE_LINE
    return first if whole else shorten(words, _ONE_LINE, placeholder=" …")


def _base_motion(poses: pd.DataFrame) -> str:
    shift, turn = (
        np.linalg.norm(poses[[f"motion_{name}" for name in names]].to_numpy(), axis=1).max()
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
    own = None if description is None else description.columns
    no_column = own is not None and own.poses is not None and own.poses.time is None
    if no_column or (description is not None and not description.time_recorded):
        return f"not known: time was not recorded{_NOT_SOUGHT}"
    if "tells_time" in poses and not poses["tells_time"].all():
        return f"time was not recorded, or rows follow a joint, a rail or the load{_NOT_SOUGHT}"
    times_s = poses["time_s"].dropna()
    seconds = float(times_s.max() - times_s.min()) if len(times_s) else 0.0
    long = f"{seconds / 3600.0:.1f} h" if seconds >= 3600.0 else f"{seconds / 60.0:.0f} min"
    return f"{long} from the first reading to the last" if seconds else ""


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
        uncertainty = results.description.instrument.uncertainty_mm
        stated = f"; stated standard uncertainty {uncertainty:g} mm along each axis"
    elif results.calibration is not None:
        repeats = results.calibration.health.repeats
        stated_m = [each.stated for each in repeats if not each.kind.startswith("attitude")]
        if stated_m:
            stated = f"; stated standard uncertainty of a reading {mm(1e3 * stated_m[0])} mm"
    return f"{'not known' if results.words is None else results.words.instrument}{stated}"


def _counts(poses: pd.DataFrame) -> Iterator[tuple[str, ...]]:
    for kind, words in _KINDS.items():
        for load_N, at in poses[poses["kind"] == kind].groupby("load_N"):
            repeats = at.groupby("pose").size()
            least, most = repeats.min(), repeats.max()
            span = str(most) if least == most else f"{least} to {most}"
            yield words, f"{load_N:g}", str(len(repeats)), str(len(at)), span


# How to use the model: where it is, and what to type.

_FILES = {
    MODEL: "the whole model, with effects and formulas; read by the commands below",
    "model/model.covariance.npz": "how uncertain its parameters are",
    "model/robot.urdf": "the rigid part, for simulators and planners",
    "model/robot_rigid_fit.urdf": "the best rigid model: geometry alone, fitted for it",
    "model/dh.csv": "link parameters, nominal and calibrated",
    "model/ur_kinematics.yaml": "the rigid part for the UR driver for ROS 2",
    "discovery/suggested_poses.csv": "poses to measure next",
    "ingest/quarantine.csv": "raw rows that are not used, with the reason",
    "figures": "figures as SVG, PDF and PNG",
    "tables": "tables as CSV, Markdown and HTML",
}


def use(results: ResultsBundle) -> Iterator[blocks.Block]:
    """Yield what to type to predict and to compensate."""
    if results.model is None:
        yield blocks.Callout("missing", results.why_absent(MODEL))
    else:
        grade = None if results.calibration is None else results.calibration.health.grade
        doubtful = grade is not None and grade not in UNRESERVED
        if doubtful:
            yield blocks.Callout(
                "warning",
                f"The calibration is graded {grade}. The commands refuse its model without "
                "--force: mend the input first.",
            )
        yield blocks.Paragraph(
            f"Run the commands in the folder of these results, {results.folder.absolute().name}: "
            "the paths below begin there. Poses are in the robot's base frame. Angles are in "
            "degrees."
        )
        yield blocks.Code("Where is the tool at these joint positions?", _command("predict"))
        yield blocks.Code(
            "Which joint positions bring the tool to these poses?", _command("compensate")
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
    rows = [(file, what) for file, what in _FILES.items() if (results.folder / file).exists()]
    if rows:
        yield blocks.grid("Files of this campaign", ("file", "holds"), rows)


def _command(name: str) -> str:
    given, out = {"predict": ("joints", "poses"), "compensate": ("targets", "commands")}[name]
    return (
        f"pa10cal {name} --model {MODEL} \\\n  --{given} {given}.csv --out {out}.csv --frame tool"
    )
