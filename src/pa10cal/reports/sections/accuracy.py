"""Errors before and after, of fitted and of held-out poses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from pa10cal.reports.blocks import Block, Callout, Folded, Paragraph, Section, count, deg, grid, mm
from pa10cal.reports.gathered import Gathered
from pa10cal.reports.pictures import FITTED, HELD_OUT, Errors, errors_drawing, errors_of, headline
from pa10cal.results.discovery import SetGap
from pa10cal.results.evaluation import HoldoutRecord


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
