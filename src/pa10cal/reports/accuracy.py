"""Sections of the page: errors before and after, parameters, ISO 9283."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from pa10cal.figures.table import written
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
    shown_in,
    with_interval,
)
from pa10cal.reports.gathered import Gathered
from pa10cal.reports.pictures import (
    FITTED,
    HELD_OUT,
    UNCALIBRATED,
    Errors,
    errors_drawing,
    errors_of,
    headline,
    model_title,
    tolerances_drawing,
)
from pa10cal.results.discovery import SetGap
from pa10cal.results.evaluation import HoldoutRecord, Iso9283Record, Parameter, RepeatabilityRows


def accuracy(found: Gathered) -> Section:
    """Return what calibration and effects gained."""
    return Section("accuracy", "Before and after", tuple(_blocks(found)))


def _blocks(found: Gathered) -> Iterator[Block]:
    every = errors_of(found)
    if not every:
        yield Callout("missing", found.why_absent(f"calibration/{found.load_case}.json"))
        return
    ends = headline(found)
    if ends is not None:
        before, after = ends
        yield Paragraph(
            f"Over the {before.kind} poses the position error fell from {mm(before.rms_mm)} mm "
            f"to {mm(after.rms_mm)} mm rms, its peak from {mm(before.peak_mm)} mm to "
            f"{mm(after.peak_mm)} mm.",
            lead=True,
        )
    yield Paragraph(
        f"{'' if found.words is None else f'{found.words.of} '}"
        "Repeats of a configuration are averaged. Held-out poses are only used "
        "to judge."
    )
    whole = [each for each in every if each.load == "all"]
    yield errors_drawing(whole, _noise_mm(found))
    yield grid("Position error [mm] and orientation error [deg]", *_table(whole), range(2, 7))
    parts = [each for each in every if each.load != "all"]
    if len({each.load for each in parts}) > 1:
        title = "The same load by load"
        yield Folded(title, (grid(title, *_table(parts, with_load=True), range(3, 8)),))
    if found.held_out is None:
        yield Callout("missing", found.why_absent(HoldoutRecord.FILE))
    elif not found.held_out.models:
        yield Callout(
            "missing",
            f"Nothing was held out ({found.held_out.note or 'no such rows'}): how well the model "
            "predicts new poses is not tested. Measure some poses more and mark them as held out.",
        )
    if found.verdict is not None:
        yield from _gains(found)


def _noise_mm(found: Gathered) -> dict[str, float]:
    """Return the mean error that noise alone leaves, of fitted and of held-out poses."""
    if found.verdict is None:
        return {}
    gap = found.verdict.gap
    sets = {FITTED: gap.train, HELD_OUT: gap.holdout}
    return {poses: of.noise_floor_mm for poses, of in sets.items() if of is not None}


def _table(
    every: Iterable[Errors], *, with_load: bool = False
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    header = ("poses", *(["load"] * with_load), "model", "rms", "peak", "mean")
    rows = [
        (
            each.poses,
            *([each.load] * with_load),
            each.model,
            mm(each.rms_mm),
            mm(each.peak_mm),
            mm(each.mean_mm),
            deg(each.orientation_deg),
            str(each.configurations),
        )
        for each in every
    ]
    return (*header, "orientation, mean", "configurations"), rows


def _gains(found: Gathered) -> Iterator[Block]:
    assert found.verdict is not None
    gap = found.verdict.gap
    sets: dict[str, SetGap | None] = {FITTED: gap.train, HELD_OUT: gap.holdout}
    rows = []
    for poses, of in sets.items():
        if of is None or not found.verdict.effects:
            continue
        low, high = of.reduction.interval95_mm
        span = f"{mm(low)} to {mm(high)}"
        told = count(of.reduction.poses, "pose")
        rows.append((poses, mm(of.reduction.mean_mm), span, told, mm(of.noise_floor_mm)))
    if rows:
        yield grid(
            "How far the effects found lower the mean position error [mm]",
            ("poses", "lower by", "95 % interval", "unit of evidence", "noise alone leaves"),
            rows,
            (1, 2, 4),
        )
    else:
        yield Paragraph(f"Noise alone would leave a mean error of {mm(gap.noise_floor_mm)} mm.")


# Parameters of the final model, with intervals.

#: Departures of what loads the springs, and how many that poses do not identify are listed.
_WEIGHTS, _MOST_WEIGHTS = "weight_", 4

_GROUPS = (
    ("Links: departures from the arm's description", ("delta_",)),
    ("Springs of the joints", ("K_", "compliance_", "cubic_share_", "windup_")),
    ("Tool or targets, in the end-effector frame", ("tool_", "target_")),
    ("Base frame in the instrument's frame", ("base_", "gamma_")),
    ("Others", ("",)),
)


def parameters(found: Gathered) -> Section:
    """Return the parameters of the model that is exported."""
    return Section("parameters", "Parameters", tuple(_blocks_of_parameters(found)))


def _blocks_of_parameters(found: Gathered) -> Iterator[Block]:
    if found.calibration is None:
        yield Callout("missing", found.why_absent(f"calibration/{found.load_case}.json"))
        return
    shown: Mapping[str, Parameter] = found.calibration.parameters
    of = "calibrated model"
    if found.extended is not None and found.extended.named:
        shown, of = found.extended.parameters, "model with the effects found"
    yield Paragraph(
        f"Parameters of the {of}, with 95 % intervals. An interval holds what the noise of the "
        "measurement leaves open; it holds no effect that the model lacks. A tolerance is what a "
        "maker is expected to keep."
    )
    drawing = tolerances_drawing(shown)
    if drawing is not None:
        yield drawing
    remaining = dict(shown)
    for title, begins in _GROUPS:
        names = [name for name in remaining if name.startswith(begins)]
        group = {name: remaining.pop(name) for name in names}
        weights = [n for n, each in group.items() if _WEIGHTS in n and not each.identifiable]
        if len(weights) > _MOST_WEIGHTS:
            group = {name: each for name, each in group.items() if name not in weights}
            yield Paragraph(
                f"Weights: {len(weights)} departures of masses, of their moments and of the "
                "base's level stay near the values described, within what a description is "
                "usually off. The poses fitted do not identify them."
            )
        if group:
            header = ("parameter", "value, 95 % interval", "unit", "tolerance", "remark")
            rows = [_row(name, each) for name, each in group.items()]
            yield grid(title, header, rows, (1, 3))


def _row(name: str, found: Parameter) -> tuple[str, ...]:
    unit, scale = shown_in(found.unit, found.value)
    tolerance = NOT_KNOWN if found.tolerance is None else f"{scale * found.tolerance:g}"
    if not found.identifiable:
        return written(name), NOT_KNOWN, unit, tolerance, "not identifiable from these poses"
    std = None if found.std is None else scale * found.std
    remark = "at the end of its physical range" if getattr(found, "at_bound", False) else ""
    if not remark and found.std == 0.0:
        remark = "not fitted"
    if not remark and found.tolerance and abs(found.value) > 3.0 * found.tolerance:
        remark = f"{abs(found.value) / found.tolerance:.0f} tolerances"
    return written(name), with_interval(scale * found.value, std), unit, tolerance, remark


# Pose accuracy and repeatability after ISO 9283, before and after calibration.

#: What the standard asks for.
_STANDARD_REPEATS = 30
#: Of more configurations the first are shown.
_MOST_ROWS = 120


def repeats(found: Gathered) -> Section:
    """Return accuracy and repeatability of the poses that were repeated."""
    return Section(
        "iso9283", "Pose accuracy and repeatability (ISO 9283)", tuple(_blocks_of_repeats(found))
    )


def _blocks_of_repeats(found: Gathered) -> Iterator[Block]:
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
