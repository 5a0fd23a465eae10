"""Sections of the page: errors before and after, parameters, ISO 9283."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from pa10cal.reports import formatting, pictures
from pa10cal.reports.blocks import Beside, Callout, Grid, PageBlock, Paragraph, folded, grid
from pa10cal.reports.errors import ALL, FITTED, HELD_OUT, errors_of, model_titles
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.results.calibration import (
    CalibrationRecord,
    GeneralCalibrationRecord,
    GroupOfCampaigns,
)
from pa10cal.results.discovery import VerdictRecord
from pa10cal.results.evaluation import Iso9283Record, Parameter


def accuracy(results: ResultsBundle) -> Iterator[PageBlock]:
    """Yield what calibration and effects gained."""
    every = errors_of(results)
    if not every:
        yield Callout("missing", results.absent["calibration"])
        return
    yield Paragraph(
        f"{'' if results.words is None else f'{results.words.of} '}"
        "Repeats of a configuration are averaged. Held-out poses are used for evaluation only. "
        "With the effects found, all parameters are fitted anew."
    )
    head = (
        "poses | load | model | rms [mm] | peak [mm] | mean [mm] | orientation, mean [deg] | "
        "configurations"
    )
    whole, parts = (
        [
            (
                *(each.poses, each.load, each.model, each.of.rms_mm, each.of.peak_mm),
                *(each.of.mean_mm, each.of.orientation_deg, each.of.configurations),
            )
            for each in every
            if (each.load == ALL) is all_loads
        ]
        for all_loads in (True, False)
    )
    title = "Errors of every model"
    yield grid(title, head, whole)
    if len({row[1] for row in parts}) > 1:
        yield folded(grid(f"{title}, load by load", head, parts))
    if results.held_out is None:
        yield Callout("missing", results.absent["held_out"])
    elif not results.held_out.models:
        yield Callout(
            "missing",
            f"Nothing was held out ({results.held_out.note or 'no such rows'}): the error at new "
            "poses is not known. Measure some more poses and mark them as held out.",
        )
    else:
        shown = model_titles(results, results.held_out.models)
        shares = (pictures.shares_drawing(results.held_out, shown, unit) for unit in ("mm", "deg"))
        yield Beside(tuple(filter(None, shares)))
    if (record := results.verdict) is not None:
        yield reductions_grid(record)
        yield Paragraph(
            f"{formatting.floor_is(record.gap).capitalize()} alone would leave a mean error of "
            f"{formatting.mm(record.gap.noise_floor_mm)} mm in the poses fitted."
        )


def reductions_grid(record: VerdictRecord) -> Grid:
    """Return by how much the effects of a verdict lower the mean error, empty without any."""
    gaps = {FITTED: record.gap.train, HELD_OUT: record.gap.holdout} if record.effects else {}
    return grid(
        "What the effects found remove of the mean position error: a pose counts once, with all "
        "its loads and repeats",
        "poses | load | falls by [mm] | 95 % interval [mm] | number of poses",
        (
            (poses, load, of.mean_mm, "{:.4f} to {:.4f}".format(*of.interval95_mm), of.poses)
            for poses, gap in gaps.items()
            if gap is not None
            for load, within in {
                ALL: gap,
                **(gap.per_load if len(gap.per_load) > 1 else {}),
            }.items()
            for of in [within.reduction]
        ),
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


def parameters(results: ResultsBundle, case: CalibrationRecord) -> Iterator[PageBlock]:
    """Yield the parameters of the model that is exported."""
    shown: Mapping[str, Parameter] = case.parameters
    of = "calibrated model"
    if results.extended is not None and results.extended.named:
        shown, of = results.extended.parameters, "model with the effects found"
    yield Paragraph(
        f"Parameters of the {of}, with 95 % intervals. An interval includes the noise of the "
        "measurement, but no effect that the model lacks. A tolerance is the deviation expected of "
        "a maker."
    )
    weights = [n for n, each in shown.items() if _WEIGHTS in n and not each.identifiable]
    if len(weights) > _MOST_WEIGHTS:
        shown = {name: each for name, each in shown.items() if name not in weights}
        yield Paragraph(
            f"Weights: {len(weights)} departures of masses, of their moments and of the "
            "base's level stay near the described values, within the usual error of a description. "
            "The fitted poses do not identify them."
        )
    remaining = dict(shown)
    for title, begins in _GROUPS:
        names = [name for name in remaining if name.startswith(begins)]
        yield grid(
            title,
            "parameter | value, 95 % interval | unit | tolerance | remark",
            [_parameter_row(name, remaining.pop(name)) for name in names],
        )
    if isinstance(case, GeneralCalibrationRecord):
        redundant = []
        for entry in case.redundant:
            parts = [
                f"{part:.4g} × {formatting.display_name(name)}"
                for name, part in entry.replaced_by.items()
            ]
            same = " + ".join(parts).replace("+ -", "− ")
            omitted = formatting.display_name(entry.name)
            redundant.append((omitted, same or "nothing: it has no effect"))
        yield folded(grid("Omitted: redundant parameters", "omitted | the same as", redundant))
        if case.group is not None:
            yield from _campaign_grids(case.group)
    rows = []
    shifts = []
    if results.analysis is not None and results.analysis.effects:
        for name, after in shown.items():
            # Weights are unknowns of the search alone: without it they are as described.
            before = case.parameters[name].value if name in case.parameters else 0.0
            if after.identifiable and after.std and before != after.value:
                shifts.append((abs(after.value - before) / after.std, name, before, after))
    for _, name, before, after in sorted(shifts, key=lambda shift: -shift[0]):
        unit, scale = formatting.shown_in(after.unit, after.value)
        change = (after.value - before) / (after.tolerance or abs(before) or 1.0)
        by = f"{change:+.2f} tolerances" if after.tolerance else f"{100 * change:+.1f} %"
        value = formatting.with_interval(scale * after.value, scale * (after.std or 0.0))
        rows.append((formatting.display_name(name), f"{scale * before:.4g}", value, unit, by))
    title = "Parameters that had absorbed part of the effects"
    head = "parameter | without the effects | with them, 95 % interval | unit | change"
    yield folded(grid(title, head, rows))


def _parameter_row(name: str, found: Parameter) -> tuple[str, ...]:
    unit, scale = formatting.shown_in(found.unit, found.value)
    tolerance = formatting.NOT_KNOWN if found.tolerance is None else f"{scale * found.tolerance:g}"
    std = None if found.std is None else scale * found.std
    value, remark = formatting.with_interval(scale * found.value, std), ""
    if not found.identifiable:
        value, remark = formatting.NOT_KNOWN, "not identifiable from these poses"
    elif getattr(found, "at_bound", False):
        value = "rigid" if name.startswith("K_lin") else f"{scale * found.value:.4g}"
        remark = "at the end of its physical range"
    elif found.std == 0.0:
        remark = "not fitted"
    elif found.tolerance and abs(found.value) > 3.0 * found.tolerance:
        remark = f"{abs(found.value) / found.tolerance:.0f} tolerances"
    return formatting.display_name(name), value, unit, tolerance, remark


def _campaign_grids(group: GroupOfCampaigns) -> Iterator[Grid]:
    """Yield where every shared parameter comes from, and each campaign against the others."""
    rows: list[tuple[str | float | None, ...]] = []
    for name, found in group.parameters.items():
        unit, scale = formatting.shown_in(found.unit)
        alone = (
            f"{scale * found.std_alone[of]:.4f}" if of in found.determined_by else None
            for of in group.campaigns
        )
        by = ", ".join(found.determined_by) or "all together"
        rows.append((formatting.display_name(name), unit, f"{scale * found.std:.4f}", *alone, by))
    yield grid(
        "Standard uncertainty of shared parameters, by all campaigns and by each alone",
        ("parameter", "unit", "std", *(f"std {of}" for of in group.campaigns), "determined by"),
        rows,
    )
    rows = []
    for name, of in group.campaigns.items():
        unit, scale = formatting.shown_in(of.worst.unit)
        worst = f"{scale * of.worst.value:.3g} ± {scale * of.worst.std:.2g} {unit}"
        rows.append(
            (
                *(name, of.poses, of.rms_mm, of.alone_rms_mm),
                *(f"{of.chi_square:.1f} for {of.dof:.0f}", f"{of.p_value:.2g}"),
                *(f"{formatting.display_name(of.worst.name)}: {worst}", of.contradicts),
            )
        )
    yield grid(
        "Each campaign against the others: they contradict each other where chance does not "
        "explain the difference and separate parameters remove a tenth of the squared error",
        "campaign | poses | rms [mm] | alone [mm] | χ² | p | most by | contradicts",
        rows,
    )


# Pose accuracy and repeatability after ISO 9283, before and after calibration.

#: What the standard asks for.
_STANDARD_REPEATS = 30


def repeats(results: ResultsBundle, record: Iso9283Record) -> Iterator[PageBlock]:
    """Yield accuracy and repeatability of the poses that were repeated."""
    rows = record.repeatability
    if rows is None or record.accuracy is None:
        yield Callout("missing", f"Not known: {record.note}.")
        return
    yield Paragraph(
        "Accuracy (AP) is how far the mean attained pose is from the commanded one, where the "
        "controller commands with the model of the row. Repeatability (RP) is the mean distance "
        "of the attained positions from their mean, and three standard deviations; of an angle, "
        "three standard deviations. It does not depend on the model, and holds the noise of the "
        f"instrument too. {record.FILE} has both for every configuration."
    )
    table: list[tuple[str | float | None, ...]] = []
    for name, title in model_titles(results, record.accuracy).items():
        of, command = record.accuracy[name], f"model {title}"
        command = "nominal model" if name == "uncalibrated" else command
        position = of.AP_mean_mm, of.AP_largest_mm
        table.append((f"AP, {command}", *position, of.AP_mean_deg, of.AP_largest_deg))
    worst = None if rows.RP_deg is None else rows.RP_deg.max(axis=1)
    angle = (None, None) if worst is None else (worst.mean(), worst.max())
    table.append(("RP", rows.RP_mm.mean(), rows.RP_mm.max(), *angle))
    fitted = int((rows.kind == "grid").sum())
    parts = [(fitted, "used for the fit"), (len(rows) - fitted, "held out")]
    which = formatting.listed(
        f"{formatting.count(k, 'configuration')} {what}" for k, what in parts if k
    )
    least, most = int(rows.repeats.min()), int(rows.repeats.max())
    span = str(least) if least == most else f"{least} to {most}"
    yield grid(
        f"Over {which} with {span} readings each",
        "quantity | mean position [mm] | largest [mm] | mean angle [deg] | largest [deg]",
        table,
    )
    departs = []
    if least < _STANDARD_REPEATS:
        departs.append(f"it has {_STANDARD_REPEATS} repeats")
    if mixed := int((~rows.one_direction).sum()):
        departs.append(
            "every pose is approached from one side, while here joints arrived from either side in "
            f"{formatting.count(mixed, 'configuration')}, so RP holds lost motion as well"
        )
    departs.append("its five poses lie in a cube, at the rated load and speed")
    yield Callout("note", f"The conditions are not those of the standard: {'; '.join(departs)}.")
