"""Sections of the page: errors of every model; accuracy and repeatability after ISO 9283."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from pa10cal.reports import formatting, pictures
from pa10cal.reports.blocks import Callout, Grid, PageBlock, Paragraph, SideBySide, folded, grid
from pa10cal.reports.errors import ALL, FITTED, HELD_OUT, ModelErrors, errors_of, model_titles
from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.results.discovery import VerdictRecord
from pa10cal.results.evaluation import Iso9283Record


def accuracy(results: ResultsBundle) -> Iterator[PageBlock]:
    """Yield the errors of every model, and by how much the effects found lower them."""
    every = errors_of(results)
    if not every:
        yield Callout("missing", results.absent["calibration"])
        return
    yield Paragraph(" ".join(_about_errors(results)))
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


def _about_errors(results: ResultsBundle) -> Iterator[str]:
    """Yield the sentences that say of what the errors are."""
    if results.words is not None:
        yield results.words.of
    yield "Repeats of a configuration are averaged."
    if results.held_out is not None and results.held_out.models:
        yield (
            "Held-out poses are in no fit; by them models are evaluated, and what the search finds "
            "is taken back where it makes them worse."
        )
    if results.verdict is not None and results.verdict.effects:
        yield "With the effects found, all parameters are fitted anew."


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
        position = ap.AP_mean_mm, ap.AP_largest_mm
        table.append((f"AP, {title}", *position, ap.AP_mean_deg, ap.AP_largest_deg))
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
