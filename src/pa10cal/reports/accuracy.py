"""Sections of the page: errors before and after, parameters, ISO 9283."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from pa10cal.reports import pictures
from pa10cal.reports.blocks import Beside, Block, Callout, Folded, Grid, Paragraph, grid
from pa10cal.reports.errors import (
    ALL,
    FITTED,
    HELD_OUT,
    PARTS,
    UNCALIBRATED,
    Errors,
    errors_of,
    headline,
    model_title,
)
from pa10cal.reports.formatting import (
    NOT_KNOWN,
    count,
    deg,
    listed,
    mm,
    shown_in,
    with_interval,
    written,
)
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.results.analysis import ParameterShift
from pa10cal.results.calibration import GeneralCalibrationRecord, GroupOfCampaigns
from pa10cal.results.discovery import Reduction, VerdictRecord
from pa10cal.results.evaluation import (
    BeforeAfter,
    HoldoutRecord,
    Iso9283Record,
    Parameter,
    RepeatabilityRows,
)


def accuracy(results: ResultsBundle) -> Iterator[Block]:
    """Yield what calibration and effects gained."""
    every = errors_of(results)
    if not every:
        yield Callout("missing", results.why_absent(f"calibration/{results.load_case}.json"))
        return
    ends = headline(results)
    if ends is not None:
        before, after = ends
        apart = f"; {told}" if (told := after.with_flagged("rms_mm")) else ""
        yield Paragraph(
            f"Over the {before.kind} poses the position error fell from "
            f"{mm(before.counted.rms_mm)} mm to {mm(after.counted.rms_mm)} mm rms, its peak from "
            f"{mm(before.counted.peak_mm)} mm to {mm(after.counted.peak_mm)} mm"
            f"{apart}.",
            lead=True,
        )
    yield Paragraph(
        f"{'' if results.words is None else f'{results.words.of} '}"
        "Repeats of a configuration are averaged. Held-out poses are only used "
        "to judge."
    )
    first, *by_load = errors_grids(every)
    yield first
    for each in by_load:
        yield Folded(each.caption, (each,))
    if results.held_out is None:
        yield Callout("missing", results.why_absent(HoldoutRecord.FILE))
    elif not results.held_out.models:
        yield Callout(
            "missing",
            f"Nothing was held out ({results.held_out.note or 'no such rows'}): how well the model "
            "predicts new poses is not tested. Measure some poses more and mark them as held out.",
        )
    else:
        beside = results.held_out.models
        titles = {name: model_title(name, results, beside) for name in beside}
        shown = {name: title for name, title in titles.items() if title is not None}
        shares = [pictures.shares_drawing(results.held_out, shown, unit) for unit in ("mm", "deg")]
        yield Beside(tuple(each for each in shares if each is not None))
    if results.verdict is not None and results.verdict.effects:
        yield gap_grid(results.verdict)
        yield Paragraph(
            "Before: the calibrated model. After: the same with the effects found, recalibrated. "
            "Both are the models that are written. Held-out poses only leave out effects that "
            "would make them worse. In the interval a pose counts once, with all its loads and "
            "repeats. Repeatability is the scatter of successive readings from one direction; the "
            "noise in the grade is larger, of all repeats or as stated."
        )
    elif results.verdict is not None:
        floor = results.verdict.gap.noise_floor_mm
        yield Paragraph(f"Noise alone would leave a mean error of {mm(floor)} mm.")


def errors_grids(every: Iterable[Errors]) -> list[Grid]:
    """Return errors of every model over all loads and, where there are several, at each."""
    title = "Position error [mm] and orientation error [deg]"
    header = (
        *("poses", "load", "model", "rms", "peak", "mean"),
        *("orientation, mean", "configurations"),
    )
    rows = [
        (
            *(each.poses, each.load, each.model),
            *(mm(each.of.rms_mm), mm(each.of.peak_mm), mm(each.of.mean_mm)),
            deg(each.of.orientation_deg),
            str(each.of.configurations),
        )
        for each in every
    ]
    whole = [row for row in rows if row[1] == ALL]
    grids = [grid(title, header, whole, range(3, 8))]
    parts = [row for row in rows if row[1] != ALL]
    if len({row[1] for row in parts}) > 1:
        grids.append(grid(f"{title}, load by load", header, parts, range(3, 8)))
    return grids


def gap_grid(record: VerdictRecord) -> Grid:
    """Return the errors without and with the effects of a verdict, over parts of the poses too."""
    sought = record.verdict != "not_sought"
    header = ["poses", "load"]
    for name in ("mean", "rms", "peak"):
        header += [f"{name} before", "after"] if sought else [name]
    header += ["mean falls by, 95 % interval"] if sought else []
    rows = []
    for poses, load, errors, reduction in _gaps(record):
        row = [poses, load]
        for name in ("mean_mm", "rms_mm", "peak_mm"):
            row += [
                f"{getattr(of, name):.4f}" for of in (errors.before, errors.after)[: 1 + sought]
            ]
        if sought and reduction is not None:
            low, high = (f"{end:.4f}" for end in reduction.interval95_mm)
            row.append(f"{low} to {high} ({count(reduction.poses, 'pose')})")
        rows.append(row + [NOT_KNOWN] * (len(header) - len(row)))
    return grid(
        f"Position error [mm]; {record.gap.floor_is} alone leaves a mean of "
        f"{record.gap.noise_floor_mm:.4f} mm in the poses fitted",
        header,
        rows,
        range(2, len(header)),
    )


def _gaps(record: VerdictRecord) -> Iterator[tuple[str, str, BeforeAfter, Reduction | None]]:
    for poses, gap in (
        (FITTED, record.gap.train),
        (HELD_OUT, record.gap.holdout),
    ):
        if gap is None:
            continue
        yield poses, ALL, gap, gap.reduction
        for load, at_load in gap.per_load.items() if len(gap.per_load) > 1 else ():
            yield poses, load, at_load, at_load.reduction
        rivals = gap.with_rivals
        for part, within in (
            (PARTS["inside"], gap.inside if gap.outside is not None else None),
            (PARTS["extrapolated"], gap.outside if gap.inside is not None else None),
            ("the motion of the base taken out", gap.without_motion),
            (
                "with what has no name, not written",
                None if rivals is None else BeforeAfter(before=gap.before, after=rivals),
            ),
        ):
            if within is not None:
                yield f"{poses}, {part}", ALL, within, None


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


def parameters(results: ResultsBundle) -> Iterator[Block]:
    """Yield the parameters of the model that is exported."""
    if results.calibration is None:
        yield Callout("missing", results.why_absent(f"calibration/{results.load_case}.json"))
        return
    shown: Mapping[str, Parameter] = results.calibration.parameters
    of = "calibrated model"
    if results.extended is not None and results.extended.named:
        shown, of = results.extended.parameters, "model with the effects found"
    yield Paragraph(
        f"Parameters of the {of}, with 95 % intervals. An interval holds what the noise of the "
        "measurement leaves open; it holds no effect that the model lacks. A tolerance is what a "
        "maker is expected to keep."
    )
    shifts = _shifts(results)
    drawing = pictures.tolerances_drawing(shown, {each.name: each.before for each in shifts})
    if drawing is not None:
        yield drawing
    weights = [n for n, each in shown.items() if _WEIGHTS in n and not each.identifiable]
    if len(weights) > _MOST_WEIGHTS:
        shown = {name: each for name, each in shown.items() if name not in weights}
        yield Paragraph(
            f"Weights: {len(weights)} departures of masses, of their moments and of the "
            "base's level stay near the values described, within what a description is "
            "usually off. The poses fitted do not identify them."
        )
    yield from parameter_grids(shown)
    if isinstance(results.calibration, GeneralCalibrationRecord):
        if results.calibration.redundant:
            redundant = redundant_grid(results.calibration)
            yield Folded(redundant.caption, (redundant,))
        if results.calibration.group is not None:
            yield from campaign_grids(results.calibration.group)
    if shifts:
        title = "Parameters that had absorbed part of the effects"
        header = ("parameter", "without the effects", "with them, 95 % interval", "unit", "change")
        yield Folded(title, (grid(title, header, map(_shift, shifts), (1, 2, 4)),))


def parameter_grids(parameters: Mapping[str, Parameter]) -> Iterator[Grid]:
    """Yield the parameters of a model, group by group."""
    remaining = dict(parameters)
    header = ("parameter", "value, 95 % interval", "unit", "tolerance", "remark")
    for title, begins in _GROUPS:
        names = [name for name in remaining if name.startswith(begins)]
        if names:
            rows = [_row(name, remaining.pop(name)) for name in names]
            yield grid(title, header, rows, (1, 3))


def redundant_grid(case: GeneralCalibrationRecord) -> Grid:
    """Return parameters that were not fitted, and what does the same in any pose."""
    rows = []
    for entry in case.redundant:
        parts = [f"{part:.4g} × {written(name)}" for name, part in entry.replaced_by.items()]
        same = " + ".join(parts).replace("+ -", "− ")
        rows.append((written(entry.name), same or "nothing: it has no effect"))
    return grid("Omitted: redundant parameters", ("omitted", "the same as"), rows)


def campaign_grids(group: GroupOfCampaigns) -> Iterator[Grid]:
    """Yield where every shared parameter comes from, and each campaign against the others."""
    names = tuple(group.campaigns)
    cells, compared = [], []
    for name, found in group.parameters.items():
        unit, scale = shown_in(found.unit)
        alone = [
            f"{scale * found.std_alone[each]:.4f}" if each in found.determined_by else NOT_KNOWN
            for each in names
        ]
        by = ", ".join(found.determined_by) or "all together"
        cells.append((written(name), unit, f"{scale * found.std:.4f}", *alone, by))
    for name, each in group.campaigns.items():
        unit, scale = shown_in(each.worst.unit)
        off, u = scale * each.worst.value, scale * each.worst.std
        compared.append(
            (
                *(name, str(each.poses), mm(each.rms_mm), mm(each.alone_rms_mm)),
                *(f"{each.chi_square:.1f} for {each.dof:.0f}", f"{each.p_value:.2g}"),
                f"{written(each.worst.name)}: {off:.3g} ± {u:.2g} {unit}",
                "yes" if each.contradicts else "no",
            )
        )
    header = ("parameter", "unit", "std", *(f"std {name}" for name in names), "determined by")
    yield grid(
        "Standard uncertainty of shared parameters, by all campaigns and by each alone",
        header,
        cells,
        range(2, 3 + len(names)),
    )
    header = ("campaign", "poses", "rms [mm]", "alone [mm]", "χ²", "p", "most by", "contradicts")
    yield grid(
        "Each campaign against the others: they contradict each other where chance does not "
        "explain the difference and parameters of its own take away a tenth of the squared error",
        header,
        compared,
        (1, 2, 3),
    )


def _shifts(results: ResultsBundle) -> list[ParameterShift]:
    """Return what the effects changed, the largest part of its interval first."""
    if results.analysis is None or not results.analysis.effects:
        return []
    moved = [
        each
        for each in results.analysis.parameter_shifts
        if each.identifiable and each.std and each.before != each.after
    ]
    return sorted(moved, key=lambda each: -abs(each.after - each.before) / each.std)


def _shift(each: ParameterShift) -> tuple[str, ...]:
    unit, scale = shown_in(each.unit, each.after)
    change = (each.after - each.before) / (each.tolerance or abs(each.before) or 1.0)
    of = f"{change:+.2f} tolerances" if each.tolerance else f"{100 * change:+.1f} %"
    after = with_interval(scale * each.after, scale * each.std)
    return written(each.name), f"{scale * each.before:.4g}", after, unit, of


def _row(name: str, found: Parameter) -> tuple[str, ...]:
    unit, scale = shown_in(found.unit, found.value)
    tolerance = NOT_KNOWN if found.tolerance is None else f"{scale * found.tolerance:g}"
    if not found.identifiable:
        return written(name), NOT_KNOWN, unit, tolerance, "not identifiable from these poses"
    std = None if found.std is None else scale * found.std
    if getattr(found, "at_bound", False):
        value = "rigid" if name.startswith("K_lin") else f"{scale * found.value:.4g}"
        return written(name), value, unit, tolerance, "at the end of its physical range"
    remark = "not fitted" if found.std == 0.0 else ""
    if not remark and found.tolerance and abs(found.value) > 3.0 * found.tolerance:
        remark = f"{abs(found.value) / found.tolerance:.0f} tolerances"
    return written(name), with_interval(scale * found.value, std), unit, tolerance, remark


# Pose accuracy and repeatability after ISO 9283, before and after calibration.

#: What the standard asks for.
_STANDARD_REPEATS = 30
#: Of more configurations the first are shown.
_MOST_ROWS = 120


def repeats(results: ResultsBundle) -> Iterator[Block]:
    """Yield accuracy and repeatability of the poses that were repeated."""
    record = results.iso9283
    if record is None:
        yield Callout("missing", results.why_absent(Iso9283Record.FILE))
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
    fitted = int((rows.kind == "grid").sum())
    parts = [(fitted, "used for the fit"), (len(rows) - fitted, "held out")]
    which = listed(f"{count(k, 'configuration')} {what}" for k, what in parts if k)
    least, most = int(rows.repeats.min()), int(rows.repeats.max())
    span = str(least) if least == most else f"{least} to {most}"
    yield grid(
        f"Over {which} with {span} readings each",
        ("quantity", "mean position [mm]", "largest [mm]", "mean angle [deg]", "largest [deg]"),
        [*_accuracy(results, record), _repeatability(rows)],
        range(1, 5),
    )
    yield from _conditions(rows)
    yield Folded("Every configuration", (_every(record, rows),))


def _accuracy(results: ResultsBundle, record: Iso9283Record) -> Iterator[tuple[str, ...]]:
    for name, of in (record.accuracy or {}).items():
        title = model_title(name, results, record.accuracy or {})
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
