"""What was measured: arm, instrument, poses, repeats, loads."""

from __future__ import annotations

import re
from collections.abc import Iterator
from textwrap import shorten

import numpy as np
import pandas as pd

from pa10cal.campaign.description import CampaignDescription
from pa10cal.reports.blocks import (
    Block,
    Callout,
    Facts,
    Folded,
    Paragraph,
    Section,
    count,
    grid,
    listed,
    mm,
    sentence,
)
from pa10cal.reports.gathered import POSES, Gathered

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


def measured(found: Gathered) -> Section:
    """Return what was measured, and where the data come from."""
    return Section("measured", "What was measured", tuple(_blocks(found)))


def _blocks(found: Gathered) -> Iterator[Block]:
    yield Facts(tuple(_facts(found)))
    words = _provenance(found)
    if words is not None and _in_one_line(words) != words:
        told = (Paragraph(sentence(words)),)
        yield Folded("Where the data come from, in the campaign's own words", told)
    if found.poses is None:
        yield Callout("missing", found.why_absent(POSES))
        return
    yield grid(
        "Measured configurations. A configuration is a pose at a load.",
        ("used", "load [N]", "poses", "readings", "readings of a configuration"),
        _counts(found.poses),
        numbers=(1, 2, 3),
    )
    if found.quarantined:
        reasons = listed(f"{number} × {reason}" for reason, number in found.quarantined.items())
        total = count(sum(found.quarantined.values()), "raw row")
        yield Callout("note", f"{total} not used, see ingest/quarantine.csv: {reasons}.")


def _facts(found: Gathered) -> Iterator[tuple[str, str]]:
    yield "Campaign", found.campaign
    words = _provenance(found)
    if words is not None:
        kind = "Synthetic data. " if found.synthetic else ""
        told = f"{kind}In the campaign's own words: {_in_one_line(words)}"
        yield "Where the data come from", told if told.endswith((".", "…")) else f"{told}."
    yield "Arm", _arm(found)
    yield "Instrument", _instrument(found)
    if found.poses is not None:
        yield "Duration", _duration(found.poses, found.description)
        if "motion_x_mm" in found.poses:
            yield "Targets on the base", _base_motion(found.poses)
        warm = found.poses["temperature_C"].dropna()
        if len(warm):
            yield "Temperature", f"{warm.min():.1f} to {warm.max():.1f} °C"
    if (frame := found.base_frame) is not None:
        scatter = f"positions scatter by {frame.origin_scatter_mm:.3f} mm about it"
        yield "Base frame found from", f"{_FRAMES.get(frame.method, frame.method)}; {scatter}"


def _provenance(found: Gathered) -> str | None:
    return None if found.provenance is None else " ".join(found.provenance.split())


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
    return _long(poses["time_s"].dropna())


def _long(times_s: pd.Series) -> str:
    seconds = float(times_s.max() - times_s.min()) if len(times_s) else 0.0
    long = f"{seconds / 3600.0:.1f} h" if seconds >= 3600.0 else f"{seconds / 60.0:.0f} min"
    return f"{long} from the first reading to the last" if seconds else ""


def _arm(found: Gathered) -> str:
    if found.calibration is None:
        return "not known" if found.description is None else found.description.robot
    arm = found.calibration.fitted_model.get("arm")
    title = arm.get("title") if isinstance(arm, dict) else None
    name = found.calibration.robot
    return f"{title} ({name})" if title and title != name else name


def _instrument(found: Gathered) -> str:
    stated = ""
    if found.description is not None:
        uncertainty = found.description.instrument.uncertainty_mm
        stated = f"; stated standard uncertainty {uncertainty:g} mm along each axis"
    elif found.calibration is not None:
        told = [
            each
            for each in found.calibration.health.repeats
            if not each.kind.startswith("attitude")
        ]
        if told:
            stated = f"; stated standard uncertainty of a reading {mm(1e3 * told[0].stated)} mm"
    return f"{'not known' if found.words is None else found.words.instrument}{stated}"


def _counts(poses: pd.DataFrame) -> Iterator[tuple[str, ...]]:
    for kind, words in _KINDS.items():
        for load_N, at in poses[poses["kind"] == kind].groupby("load_N"):
            repeats = at.groupby("pose").size()
            least, most = repeats.min(), repeats.max()
            span = str(most) if least == most else f"{least} to {most}"
            yield words, f"{load_N:g}", str(len(repeats)), str(len(at)), span
