"""Sections of the page: errors before and after, parameters, ISO 9283."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from pa10cal.reports import pictures
from pa10cal.reports.blocks import Beside, Callout, Grid, PageBlock, Paragraph, folded, grid
from pa10cal.reports.errors import (
    ALL,
    FITTED,
    HELD_OUT,
    PARTS,
    UNCALIBRATED,
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
from pa10cal.results.calibration import GeneralCalibrationRecord, GroupOfCampaigns
from pa10cal.results.discovery import VerdictRecord
from pa10cal.results.evaluation import (
    Accuracy,
    HoldoutRecord,
    Iso9283Record,
    Parameter,
    RepeatabilityRows,
)


def accuracy(results: ResultsBundle) -> Iterator[PageBlock]:
    """Yield what calibration and effects gained."""
    ends = headline(results)
    if ends is None:
        yield Callout("missing", results.why_absent(f"calibration/{results.load_case}.json"))
        return
    before, after = ends
    flagged = after.with_flagged("rms_mm")
    yield Paragraph(
        f"Over the {before.kind} poses the position error fell from "
        f"{mm(before.counted.rms_mm)} mm to {mm(after.counted.rms_mm)} mm rms, its peak from "
        f"{mm(before.counted.peak_mm)} mm to {mm(after.counted.peak_mm)} mm"
        f"{'; ' * bool(flagged)}{flagged}.",
        lead=True,
    )
    yield Paragraph(
        f"{'' if results.words is None else f'{results.words.of} '}"
        "Repeats of a configuration are averaged. Held-out poses are used "
        "for evaluation only."
    )
    title = "Position error [mm] and orientation error [deg]"
    header = (
        *("poses", "load", "model", "rms", "peak", "mean"),
        *("orientation, mean", "configurations"),
    )
    whole: list[tuple[str, ...]] = []
    parts: list[tuple[str, ...]] = []
    for errors in errors_of(results):
        of = errors.of
        (whole if errors.load == ALL else parts).append(
            (
                *(errors.poses, errors.load, errors.model, mm(of.rms_mm), mm(of.peak_mm)),
                *(mm(of.mean_mm), deg(of.orientation_deg), str(of.configurations)),
            )
        )
    yield grid(title, header, whole, range(3, 8))
    if len({row[1] for row in parts}) > 1:
        by_load = grid(f"{title}, load by load", header, parts, range(3, 8))
        yield folded(by_load)
    if results.held_out is None:
        yield Callout("missing", results.why_absent(HoldoutRecord.FILE))
    elif not results.held_out.models:
        yield Callout(
            "missing",
            f"Nothing was held out ({results.held_out.note or 'no such rows'}): the error at new "
            "poses is not known. Measure some more poses and mark them as held out.",
        )
    else:
        models = results.held_out.models
        titles = {name: model_title(name, results, models) for name in models}
        shown = {name: title for name, title in titles.items() if title is not None}
        shares = [pictures.shares_drawing(results.held_out, shown, unit) for unit in ("mm", "deg")]
        yield Beside(tuple(drawing for drawing in shares if drawing is not None))
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


def gap_grid(record: VerdictRecord) -> Grid:
    """Return the errors without and with the effects of a verdict, over parts of the poses too."""
    sought = record.verdict != "not_sought"
    rows: list[list[str]] = []

    def add(poses: str, load: str, before: Accuracy, after: Accuracy) -> None:
        models = (before, after)[: 1 + sought]
        errors = [(of.mean_mm, of.rms_mm, of.peak_mm) for of in models]
        rows.append(
            [poses, load, *(f"{error:.4f}" for by in zip(*errors, strict=True) for error in by)]
        )

    for poses, gap in ((FITTED, record.gap.train), (HELD_OUT, record.gap.holdout)):
        if gap is None:
            continue
        for load, of in {ALL: gap, **(gap.per_load if len(gap.per_load) > 1 else {})}.items():
            add(poses, load, of.before, of.after)
            if sought and of.reduction is not None:
                low, high = (f"{end:.4f}" for end in of.reduction.interval95_mm)
                rows[-1].append(f"{low} to {high} ({count(of.reduction.poses, 'pose')})")
        both = gap.inside is not None and gap.outside is not None
        for part, within in (
            (PARTS["inside"], gap.inside if both else None),
            (PARTS["extrapolated"], gap.outside if both else None),
            ("the motion of the base taken out", gap.without_motion),
        ):
            if within is not None:
                add(f"{poses}, {part}", ALL, within.before, within.after)
        if gap.with_rivals is not None:
            name = f"{poses}, with rivals without a name, not written"
            add(name, ALL, gap.before, gap.with_rivals)
    header = ["poses", "load"]
    for error in ("mean", "rms", "peak"):
        header += [f"{error} before", "after"] if sought else [error]
    header += ["mean falls by, 95 % interval"] if sought else []
    return grid(
        f"Position error [mm]; {record.gap.floor_is} alone leaves a mean of "
        f"{record.gap.noise_floor_mm:.4f} mm in the poses fitted",
        header,
        [row + [NOT_KNOWN] * (len(header) - len(row)) for row in rows],
        range(2, len(header)),
    )


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


def parameters(results: ResultsBundle) -> Iterator[PageBlock]:
    """Yield the parameters of the model that is exported."""
    case = results.calibration
    if case is None:
        yield Callout("missing", results.why_absent(f"calibration/{results.load_case}.json"))
        return
    shown: Mapping[str, Parameter] = case.parameters
    of = "calibrated model"
    if results.extended is not None and results.extended.named:
        shown, of = results.extended.parameters, "model with the effects found"
    yield Paragraph(
        f"Parameters of the {of}, with 95 % intervals. An interval includes the noise of the "
        "measurement, but no effect that the model lacks. A tolerance is the deviation expected of "
        "a maker."
    )
    shifts = []
    if results.analysis is not None and results.analysis.effects:
        for name, after in shown.items():
            # Weights are unknowns of the search alone: without it they are as described.
            before = case.parameters[name].value if name in case.parameters else 0.0
            if after.identifiable and after.std and before != after.value:
                shifts.append((abs(after.value - before) / after.std, name, before, after))
        shifts.sort(key=lambda shift: -shift[0])
    drawing = pictures.tolerances_drawing(shown, {name: before for _, name, before, _ in shifts})
    if drawing is not None:
        yield drawing
    weights = [n for n, each in shown.items() if _WEIGHTS in n and not each.identifiable]
    if len(weights) > _MOST_WEIGHTS:
        shown = {name: each for name, each in shown.items() if name not in weights}
        yield Paragraph(
            f"Weights: {len(weights)} departures of masses, of their moments and of the "
            "base's level stay near the described values, within the usual error of a description. "
            "The fitted poses do not identify them."
        )
    remaining = dict(shown)
    header: tuple[str, ...] = ("parameter", "value, 95 % interval", "unit", "tolerance", "remark")
    for title, begins in _GROUPS:
        names = [name for name in remaining if name.startswith(begins)]
        rows = [_parameter_row(name, remaining.pop(name)) for name in names]
        if rows:
            yield grid(title, header, rows, (1, 3))
    if isinstance(case, GeneralCalibrationRecord):
        redundant = []
        for entry in case.redundant:
            parts = [f"{part:.4g} × {written(name)}" for name, part in entry.replaced_by.items()]
            same = " + ".join(parts).replace("+ -", "− ")
            redundant.append((written(entry.name), same or "nothing: it has no effect"))
        if redundant:
            header = ("omitted", "the same as")
            yield folded(grid("Omitted: redundant parameters", header, redundant))
        if case.group is not None:
            yield from _campaign_grids(case.group)
    rows = []
    for _, name, before, after in shifts:
        unit, scale = shown_in(after.unit, after.value)
        change = (after.value - before) / (after.tolerance or abs(before) or 1.0)
        by = f"{change:+.2f} tolerances" if after.tolerance else f"{100 * change:+.1f} %"
        value = with_interval(scale * after.value, scale * (after.std or 0.0))
        rows.append((written(name), f"{scale * before:.4g}", value, unit, by))
    if rows:
        title = "Parameters that had absorbed part of the effects"
        header = ("parameter", "without the effects", "with them, 95 % interval", "unit", "change")
        yield folded(grid(title, header, rows, (1, 2, 4)))


def _parameter_row(name: str, found: Parameter) -> tuple[str, ...]:
    unit, scale = shown_in(found.unit, found.value)
    tolerance = NOT_KNOWN if found.tolerance is None else f"{scale * found.tolerance:g}"
    std = None if found.std is None else scale * found.std
    value, remark = with_interval(scale * found.value, std), ""
    if not found.identifiable:
        value, remark = NOT_KNOWN, "not identifiable from these poses"
    elif getattr(found, "at_bound", False):
        value = "rigid" if name.startswith("K_lin") else f"{scale * found.value:.4g}"
        remark = "at the end of its physical range"
    elif found.std == 0.0:
        remark = "not fitted"
    elif found.tolerance and abs(found.value) > 3.0 * found.tolerance:
        remark = f"{abs(found.value) / found.tolerance:.0f} tolerances"
    return written(name), value, unit, tolerance, remark


def _campaign_grids(group: GroupOfCampaigns) -> Iterator[Grid]:
    """Yield where every shared parameter comes from, and each campaign against the others."""
    names = tuple(group.campaigns)
    rows: list[tuple[str, ...]] = []
    for name, found in group.parameters.items():
        unit, scale = shown_in(found.unit)
        alone = [
            f"{scale * found.std_alone[of]:.4f}" if of in found.determined_by else NOT_KNOWN
            for of in names
        ]
        by = ", ".join(found.determined_by) or "all together"
        rows.append((written(name), unit, f"{scale * found.std:.4f}", *alone, by))
    yield grid(
        "Standard uncertainty of shared parameters, by all campaigns and by each alone",
        ("parameter", "unit", "std", *(f"std {name}" for name in names), "determined by"),
        rows,
        range(2, 3 + len(names)),
    )
    rows = []
    for name, of in group.campaigns.items():
        unit, scale = shown_in(of.worst.unit)
        worst = f"{scale * of.worst.value:.3g} ± {scale * of.worst.std:.2g} {unit}"
        rows.append(
            (
                *(name, str(of.poses), mm(of.rms_mm), mm(of.alone_rms_mm)),
                *(f"{of.chi_square:.1f} for {of.dof:.0f}", f"{of.p_value:.2g}"),
                *(f"{written(of.worst.name)}: {worst}", "yes" if of.contradicts else "no"),
            )
        )
    yield grid(
        "Each campaign against the others: they contradict each other where chance does not "
        "explain the difference and separate parameters remove a tenth of the squared error",
        ("campaign", "poses", "rms [mm]", "alone [mm]", "χ²", "p", "most by", "contradicts"),
        rows,
        (1, 2, 3),
    )


# Pose accuracy and repeatability after ISO 9283, before and after calibration.

#: What the standard asks for.
_STANDARD_REPEATS = 30
#: Of more configurations the first are shown.
_MOST_ROWS = 120


def repeats(results: ResultsBundle) -> Iterator[PageBlock]:
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
    table = []
    for name, of in record.accuracy.items():
        title = model_title(name, results, record.accuracy)
        if title is not None:
            command = "nominal model" if title == UNCALIBRATED else f"model {title}"
            position = mm(of.AP_mean_mm), mm(of.AP_largest_mm)
            angle = deg(of.AP_mean_deg), deg(of.AP_largest_deg)
            table.append((f"AP, {command}", *position, *angle))
    worst = None if rows.RP_deg is None else rows.RP_deg.max(axis=1)
    angle = (
        deg(None if worst is None else worst.mean()),
        deg(None if worst is None else worst.max()),
    )
    table.append(("RP", mm(rows.RP_mm.mean()), mm(rows.RP_mm.max()), *angle))
    fitted = int((rows.kind == "grid").sum())
    parts = [(fitted, "used for the fit"), (len(rows) - fitted, "held out")]
    which = listed(f"{count(k, 'configuration')} {what}" for k, what in parts if k)
    least, most = int(rows.repeats.min()), int(rows.repeats.max())
    span = str(least) if least == most else f"{least} to {most}"
    yield grid(
        f"Over {which} with {span} readings each",
        ("quantity", "mean position [mm]", "largest [mm]", "mean angle [deg]", "largest [deg]"),
        table,
        range(1, 5),
    )
    departs = []
    if least < _STANDARD_REPEATS:
        departs.append(f"it has {_STANDARD_REPEATS} repeats")
    if mixed := int((~rows.one_direction).sum()):
        departs.append(
            "every pose is approached from one side, while here joints arrived from either side in "
            f"{count(mixed, 'configuration')}, so RP holds lost motion as well"
        )
    departs.append("its five poses lie in a cube, at the rated load and speed")
    yield Callout("note", f"The conditions are not those of the standard: {'; '.join(departs)}.")
    yield folded(_every_configuration(record, rows), "Every configuration")


def _every_configuration(record: Iso9283Record, rows: RepeatabilityRows) -> Grid:
    models = list((record.accuracy or {}).values())
    first, last = models[0].rows, models[-1].rows
    positions, angles = (
        (first.AP_mm, last.AP_mm, rows.RP_mm),
        (first.AP_deg, last.AP_deg, rows.RP_deg),
    )
    table = [
        (
            *(str(rows.pose[k]), f"{rows.load_N[k]:g}", str(rows.repeats[k])),
            *(mm(values[k]) for values in positions),
            *(
                NOT_KNOWN if abc is None else ", ".join(f"{angle:.3f}" for angle in abc[k])
                for abc in angles
            ),
        )
        for k in range(min(len(rows), _MOST_ROWS))
    ]
    more = f"; the first {_MOST_ROWS} of {len(rows)}" if len(rows) > _MOST_ROWS else ""
    return grid(
        f"Positions [mm]; angles about x, y and z [deg]{more}. All are in {record.FILE}.",
        (
            *("pose", "load [N]", "readings", "AP before", "AP after", "RP"),
            *("AP abc before", "AP abc after", "RP abc"),
        ),
        table,
        range(1, 9),
    )
