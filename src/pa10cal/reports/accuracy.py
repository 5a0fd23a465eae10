"""Sections of the page: errors before and after, parameters, ISO 9283."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from pa10cal.reports import formatting, pictures
from pa10cal.reports.blocks import Callout, Grid, PageBlock, Paragraph, SideBySide, folded, grid
from pa10cal.reports.errors import ALL, FITTED, HELD_OUT, ModelErrors, errors_of, model_titles
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.results.calibration import (
    ASSUMED,
    CalibrationRecord,
    GeneralCalibrationRecord,
    GroupOfCampaigns,
)
from pa10cal.results.discovery import VerdictRecord
from pa10cal.results.evaluation import Iso9283Record, Parameter


def accuracy(results: ResultsBundle) -> Iterator[PageBlock]:
    """Yield the errors of every model, and by how much the effects found lower them."""
    every = errors_of(results)
    if not every:
        yield Callout("missing", results.absent["calibration"])
        return
    yield Paragraph(
        f"{'' if results.words is None else f'{results.words.of} '}"
        "Repeats of a configuration are averaged. Held-out poses are used for evaluation only. "
        "With the effects found, all parameters are fitted anew."
    )
    title = "Errors of every model"
    yield _errors_grid(title, [errors for errors in every if errors.load == ALL])
    by_load = [errors for errors in every if errors.load != ALL]
    if len({errors.load for errors in by_load}) > 1:
        yield folded(_errors_grid(f"{title}, load by load", by_load))
    if results.held_out is None:
        yield Callout("missing", results.absent["held_out"])
    elif not results.held_out.models:
        yield Callout(
            "missing",
            f"Nothing was held out ({results.held_out.note or 'no such rows'}): the error at new "
            "poses is not known. Measure some more poses and mark them as held out.",
        )
    else:
        titles = model_titles(results, results.held_out.models)
        drawings = [
            pictures.shares_drawing(results.held_out, titles, unit) for unit in ("mm", "deg")
        ]
        yield SideBySide(tuple(drawing for drawing in drawings if drawing is not None))
    if (record := results.verdict) is not None:
        yield reductions_grid(record)
        yield Paragraph(
            f"{formatting.floor_is(record.gap).capitalize()} alone would leave a mean error of "
            f"{formatting.mm(record.gap.noise_floor_mm)} mm in the poses fitted."
        )


def _errors_grid(title: str, every: Iterable[ModelErrors]) -> Grid:
    """Return a table of errors, a row for each model and set of configurations."""
    return grid(
        title,
        "poses | load | model | rms [mm] | peak [mm] | mean [mm] | orientation, mean [deg] | "
        "configurations",
        (
            (
                *(errors.poses, errors.load, errors.title),
                *(errors.accuracy.rms_mm, errors.accuracy.peak_mm, errors.accuracy.mean_mm),
                *(errors.accuracy.orientation_deg, errors.accuracy.configurations),
            )
            for errors in every
        ),
    )


def reductions_grid(record: VerdictRecord) -> Grid:
    """Return a table of how much the effects of a verdict lower the mean error; empty without any.

    Over all loads, and load by load where there are several.
    """
    rows: list[tuple[str | float, ...]] = []
    gaps = {FITTED: record.gap.train, HELD_OUT: record.gap.holdout} if record.effects else {}
    for poses, gap in gaps.items():
        if gap is None:
            continue
        reductions = {ALL: gap.reduction}
        if len(gap.per_load) > 1:
            reductions |= {load: at_load.reduction for load, at_load in gap.per_load.items()}
        for load, reduction in reductions.items():
            low_mm, high_mm = reduction.interval95_mm
            interval = f"{low_mm:.4f} to {high_mm:.4f}"
            rows.append((poses, load, reduction.mean_mm, interval, reduction.poses))
    return grid(
        "What the effects found remove of the mean position error: a pose counts once, with all "
        "its loads and repeats",
        "poses | load | falls by [mm] | 95 % interval [mm] | number of poses",
        rows,
    )


# Parameters of the final model, with intervals.

#: Part of a weight's name; of more weights that are not identifiable only the number is shown.
_WEIGHTS, _MOST_WEIGHTS = "weight_", 4
#: Tables of parameters: title, and how the names of its parameters begin.
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
    model = "calibrated model"
    if results.extended is not None and results.extended.adds_parameters:
        shown = results.extended.parameters
        model = (
            "model with the effects found" if results.extended.named else "model with the weights"
        )
    yield Paragraph(
        f"Parameters of the {model}, with 95 % intervals. An interval includes the noise of the "
        "measurement, but no effect that the model lacks. A tolerance is the deviation expected of "
        "a maker."
    )
    weights = [name for name, of in shown.items() if _WEIGHTS in name and not of.identifiable]
    if len(weights) > _MOST_WEIGHTS:
        shown = {name: parameter for name, parameter in shown.items() if name not in weights}
        near = "the described values, within the usual error of a description"
        if (origin := case.weights_from) in ASSUMED:
            near = f"those assumed from {ASSUMED[origin]}, as nobody stated them"
        yield Paragraph(
            f"Weights: {len(weights)} departures of masses, of their moments and of the "
            f"base's level stay near {near}. The fitted poses do not identify them."
        )
    remaining = dict(shown)
    for title, beginnings in _GROUPS:
        names = [name for name in remaining if name.startswith(beginnings)]
        yield grid(
            title,
            "parameter | value, 95 % interval | unit | tolerance | remark",
            [_parameter_row(name, remaining.pop(name)) for name in names],
        )
    if isinstance(case, GeneralCalibrationRecord):
        yield folded(_redundant_grid(case))
        if case.group is not None:
            yield from _campaign_grids(case.group)
    with_effects = results.analysis is not None and bool(results.analysis.effects)
    yield folded(_shifts_grid(case, shown if with_effects else {}))


def _redundant_grid(case: GeneralCalibrationRecord) -> Grid:
    """Return a table of the redundant parameters, and of those that stand for each."""
    rows = []
    for entry in case.redundant:
        parts = [
            f"{factor:.4g} × {formatting.display_name(name)}"
            for name, factor in entry.replaced_by.items()
        ]
        same = " + ".join(parts).replace("+ -", "− ")
        rows.append((formatting.display_name(entry.name), same or "nothing: it has no effect"))
    return grid("Omitted: redundant parameters", "omitted | the same as", rows)


def _shifts_grid(case: CalibrationRecord, with_effects: Mapping[str, Parameter]) -> Grid:
    """Return a table of the parameters that effects have shifted, by most uncertainties first."""
    shifts = []
    for name, after in with_effects.items():
        # Weights are unknowns of the search alone: without it they are as described.
        before = case.parameters[name].value if name in case.parameters else 0.0
        if not (after.identifiable and after.std and before != after.value):
            continue
        unit, scale = formatting.shown_in(after.unit, after.value)
        if name.startswith("K_") and after.std > abs(after.value):
            continue  # the joint may as well be rigid
        change = (after.value - before) / (after.tolerance or abs(before) or 1.0)
        by = f"{change:+.2f} tolerances" if after.tolerance else f"{100 * change:+.1f} %"
        value = formatting.parameter_with_interval(name, scale * after.value, scale * after.std)
        row = (formatting.display_name(name), f"{scale * before:.4g}", value, unit, by)
        shifts.append((abs(after.value - before) / after.std, row))
    shifts.sort(key=lambda shift: -shift[0])
    return grid(
        "Parameters that had absorbed part of the effects",
        "parameter | without the effects | with them, 95 % interval | unit | change",
        [row for _, row in shifts],
    )


def _parameter_row(name: str, parameter: Parameter) -> tuple[str, ...]:
    unit, scale = formatting.shown_in(parameter.unit, parameter.value)
    tolerance, std = formatting.NOT_KNOWN, None
    if parameter.tolerance is not None:
        tolerance = f"{scale * parameter.tolerance:g}"
    if parameter.std is not None:
        std = scale * parameter.std
    value, remark = formatting.parameter_with_interval(name, scale * parameter.value, std), ""
    if not parameter.identifiable:
        value, remark = formatting.NOT_KNOWN, "not identifiable from these poses"
    elif getattr(parameter, "at_bound", False):
        value = "rigid" if name.startswith("K_lin") else f"{scale * parameter.value:.4g}"
        remark = "at the end of its physical range"
    elif parameter.std == 0.0:
        remark = "not fitted"
    elif parameter.tolerance and abs(parameter.value) > 3.0 * parameter.tolerance:
        remark = f"{abs(parameter.value) / parameter.tolerance:.0f} tolerances"
    return formatting.display_name(name), value, unit, tolerance, remark


def _campaign_grids(group: GroupOfCampaigns) -> Iterator[Grid]:
    """Yield where every shared parameter comes from, and each campaign against the others."""
    rows: list[tuple[str | float | None, ...]] = []
    for name, parameter in group.parameters.items():
        unit, scale = formatting.shown_in(parameter.unit)
        alone = (
            f"{scale * parameter.std_alone[campaign]:.4f}"
            if campaign in parameter.determined_by
            else None
            for campaign in group.campaigns
        )
        by = ", ".join(parameter.determined_by) or "all together"
        std = f"{scale * parameter.std:.4f}"
        rows.append((formatting.display_name(name), unit, std, *alone, by))
    stds = (f"std {campaign}" for campaign in group.campaigns)
    yield grid(
        "Standard uncertainty of shared parameters, by all campaigns and by each alone",
        ("parameter", "unit", "std", *stds, "determined by"),
        rows,
    )
    rows = []
    for name, campaign in group.campaigns.items():
        worst = campaign.worst
        unit, scale = formatting.shown_in(worst.unit)
        difference = f"{scale * worst.value:.3g} ± {scale * worst.std:.2g} {unit}"
        rows.append(
            (
                *(name, campaign.poses, campaign.rms_mm, campaign.alone_rms_mm),
                f"{campaign.chi_square:.1f} for {campaign.dof:.0f}",
                f"{campaign.p_value:.2g}",
                f"{formatting.display_name(worst.name)}: {difference}",
                campaign.contradicts,
            )
        )
    yield grid(
        "Each campaign against the others: they contradict each other where chance does not "
        "explain the difference and separate parameters remove a tenth of the squared error",
        "campaign | poses | rms [mm] | alone [mm] | χ² | p | most by | contradicts",
        rows,
    )


# Pose accuracy and repeatability after ISO 9283, before and after calibration.

#: Repeats of a pose that the standard asks for.
_STANDARD_REPEATS = 30


def repeats(results: ResultsBundle, record: Iso9283Record) -> Iterator[PageBlock]:
    """Yield accuracy and repeatability of the poses that were repeated."""
    repeated = record.repeatability
    if repeated is None or record.accuracy is None:
        yield Callout("missing", f"Not known: {record.note}.")
        return
    yield Paragraph(
        "Accuracy (AP) is how far the mean attained pose is from the commanded one, where the "
        "controller commands with the model of the row. Repeatability (RP) is the mean distance "
        "of the attained positions from their mean, and three standard deviations; of an angle, "
        "three standard deviations. It does not depend on the model, and holds the noise of the "
        "instrument too. Of several targets, the position is the mean of those seen in all "
        f"repeats. {record.FILE} has both for every configuration."
    )
    table: list[tuple[str | float | None, ...]] = []
    for name, title in model_titles(results, record.accuracy).items():
        ap = record.accuracy[name]
        command = "nominal model" if name == "uncalibrated" else f"model {title}"
        position = ap.AP_mean_mm, ap.AP_largest_mm
        table.append((f"AP, {command}", *position, ap.AP_mean_deg, ap.AP_largest_deg))
    angle: tuple[float | None, float | None] = (None, None)
    if repeated.RP_deg is not None:
        largest_deg = repeated.RP_deg.max(axis=1)  # of the three axes
        angle = largest_deg.mean(), largest_deg.max()
    table.append(("RP", repeated.RP_mm.mean(), repeated.RP_mm.max(), *angle))
    fitted = int((repeated.kind == "grid").sum())
    uses = {"used for the fit": fitted, "held out": len(repeated) - fitted}
    configurations = formatting.listed(
        f"{formatting.count(number, 'configuration')} {use}"
        for use, number in uses.items()
        if number
    )
    least, most = int(repeated.repeats.min()), int(repeated.repeats.max())
    span = str(least) if least == most else f"{least} to {most}"
    yield grid(
        f"Over {configurations} with {span} readings each",
        "quantity | mean position [mm] | largest [mm] | mean angle [deg] | largest [deg]",
        table,
    )
    differences = []
    if least < _STANDARD_REPEATS:
        differences.append(f"it has {_STANDARD_REPEATS} repeats")
    if repeated.one_direction is None:
        differences.append(
            "every pose is approached from one side, while here it is not known from which side "
            "joints arrived"
        )
    elif mixed := int((~repeated.one_direction).sum()):
        differences.append(
            "every pose is approached from one side, while here joints arrived from either side in "
            f"{formatting.count(mixed, 'configuration')}, so RP holds lost motion as well"
        )
    differences.append("its five poses lie in a cube, at the rated load and speed")
    conditions = "; ".join(differences)
    yield Callout("note", f"The conditions are not those of the standard: {conditions}.")
