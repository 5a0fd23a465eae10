"""Pose accuracy and repeatability after ISO 9283, before and after calibration."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pa10cal.reports.blocks import (
    NOT_KNOWN,
    Block,
    Callout,
    Folded,
    Paragraph,
    Section,
    count,
    deg,
    grid,
    listed,
    mm,
)
from pa10cal.reports.gathered import Gathered
from pa10cal.reports.pictures import UNCALIBRATED, model_title
from pa10cal.results.evaluation import Iso9283Record, RepeatabilityRows

#: What the standard asks for.
_STANDARD_REPEATS = 30
#: Of more configurations the first are shown.
_MOST_ROWS = 120


def repeats(found: Gathered) -> Section:
    """Return accuracy and repeatability of the poses that were repeated."""
    return Section("iso9283", "Pose accuracy and repeatability (ISO 9283)", tuple(_blocks(found)))


def _blocks(found: Gathered) -> Iterator[Block]:
    record = found.iso9283
    if record is None:
        yield Callout("missing", found.why_absent(Iso9283Record.FILE))
        return
    rows = record.repeatability
    if rows is None or record.accuracy is None:
        yield Callout("missing", f"Not known: {record.note}.")
        return
    yield Paragraph(
        "Accuracy (AP) is how far the mean attained pose is from the commanded one, where the "
        "controller commands with the model of the row. Repeatability (RP) is the mean distance "
        "of the attained positions from their mean, and three standard deviations; of an angle, "
        "three standard deviations. It does not depend on the model, and holds the noise of the "
        "instrument too."
    )
    yield grid(
        f"Over {_which(rows)} with {_span(rows.repeats)} readings each",
        ("quantity", "mean position [mm]", "largest [mm]", "mean angle [deg]", "largest [deg]"),
        [*_accuracy(found, record), _repeatability(rows)],
        range(1, 5),
    )
    yield from _conditions(rows)
    yield Folded("Every configuration", (_every(record, rows),))


def _accuracy(found: Gathered, record: Iso9283Record) -> Iterator[tuple[str, ...]]:
    for name, of in (record.accuracy or {}).items():
        title = model_title(name, found, record.accuracy or {})
        if title is None:
            continue
        command = "nominal model" if title == UNCALIBRATED else f"model {title}"
        yield (
            f"AP, {command}",
            mm(of.AP_mean_mm),
            mm(of.AP_largest_mm),
            deg(of.AP_mean_deg),
            deg(of.AP_largest_deg),
        )


def _repeatability(rows: RepeatabilityRows) -> tuple[str, ...]:
    turned = [NOT_KNOWN, NOT_KNOWN]
    if rows.RP_deg is not None:
        worst = rows.RP_deg.max(axis=1)
        turned = [deg(float(worst.mean())), deg(float(worst.max()))]
    return "RP", mm(float(rows.RP_mm.mean())), mm(float(rows.RP_mm.max())), *turned


def _conditions(rows: RepeatabilityRows) -> Iterator[Block]:
    """Say where the measurement departs from the standard."""
    departs = []
    if rows.repeats.min() < _STANDARD_REPEATS:
        departs.append(f"it has {_STANDARD_REPEATS} repeats")
    mixed = int((~rows.one_direction).sum())
    if mixed:
        departs.append(
            "every pose is approached from one side, while here joints arrived from either side in "
            f"{count(mixed, 'configuration')}, so RP holds lost motion as well"
        )
    departs.append("its five poses lie in a cube, at the rated load and speed")
    yield Callout("note", f"The conditions are not those of the standard: {'; '.join(departs)}.")


def _every(record: Iso9283Record, rows: RepeatabilityRows) -> Block:
    models = list((record.accuracy or {}).values())
    first, last = models[0].rows, models[-1].rows
    table = [
        (
            str(rows.pose[k]),
            f"{rows.load_N[k]:g}",
            str(rows.repeats[k]),
            mm(float(first.AP_mm[k])),
            mm(float(last.AP_mm[k])),
            mm(float(rows.RP_mm[k])),
            _angles(None if first.AP_deg is None else first.AP_deg[k]),
            _angles(None if last.AP_deg is None else last.AP_deg[k]),
            _angles(None if rows.RP_deg is None else rows.RP_deg[k]),
        )
        for k in range(min(len(rows), _MOST_ROWS))
    ]
    more = f"; the first {_MOST_ROWS} of {len(rows)}" if len(rows) > _MOST_ROWS else ""
    header = ("pose", "load [N]", "readings", "AP before", "AP after", "RP")
    angles = ("AP abc before", "AP abc after", "RP abc")
    caption = f"Positions [mm]; angles about x, y and z [deg]{more}. All are in {record.FILE}."
    return grid(caption, (*header, *angles), table, range(1, 9))


def _angles(abc: NDArray[np.float64] | None) -> str:
    return NOT_KNOWN if abc is None else ", ".join(f"{angle:.3f}" for angle in abc)


def _which(rows: RepeatabilityRows) -> str:
    """Say how many configurations they are, and what they are used for."""
    fitted = int((rows.kind == "grid").sum())
    parts = [(fitted, "used for the fit"), (len(rows) - fitted, "held out")]
    return listed(f"{count(k, 'configuration')} {what}" for k, what in parts if k)


def _span(repeats: NDArray[np.int64]) -> str:
    least, most = int(repeats.min()), int(repeats.max())
    return str(least) if least == most else f"{least} to {most}"
