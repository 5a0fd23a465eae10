"""Errors before and after, of fitted and of held-out poses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from pa10cal.report.blocks import Block, Callout, Folded, Paragraph, Section, grid
from pa10cal.report.gathered import Gathered
from pa10cal.report.written import count, deg, mm
from pa10cal.results.accuracy import Accuracy
from pa10cal.results.calibration import CalibrationRecord, GeneralErrors
from pa10cal.results.discovery import SetGap
from pa10cal.results.evaluation import HoldoutRecord

UNCALIBRATED, CALIBRATED, EXTENDED = "not calibrated", "calibrated", "with the effects found"
_FITTED, _HELD_OUT = "fitted", "held out"
_SPRINGS = {
    "geometry": "calibrated, geometry alone",
    "linear": "calibrated, linear springs",
    "cubic": "calibrated, cubic springs",
}


@dataclass(frozen=True)
class Errors:
    """Errors of one model over some configurations.

    Attributes:
        poses: `fitted` or `held out`.
        load: `all`, or a load such as `22N`.
        model: as readers see it.
        rms_mm, peak_mm, mean_mm: position error.
        orientation_deg: mean orientation error; None where no attitude is measured.
        configurations: how many.
    """

    poses: str
    load: str
    model: str
    rms_mm: float
    peak_mm: float
    mean_mm: float
    orientation_deg: float | None
    configurations: int


def errors_of(found: Gathered) -> list[Errors]:
    """Return the errors of every model, over all loads first, then load by load."""
    every = [*_fitted(found), *_held_out(found)]
    return [each for each in every if each.load == "all"] + [
        each for each in every if each.load != "all"
    ]


def headline(found: Gathered) -> tuple[Errors, Errors] | None:
    """Return the errors before and after that count: held out where there are such poses."""
    every = [each for each in errors_of(found) if each.load == "all"]
    for poses in (_HELD_OUT, _FITTED):
        of = [each for each in every if each.poses == poses]
        if of:
            return of[0], of[-1]
    return None


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
            f"Over the {before.poses} poses the position error fell from {mm(before.rms_mm)} mm "
            f"to {mm(after.rms_mm)} mm rms, its peak from {mm(before.peak_mm)} mm to "
            f"{mm(after.peak_mm)} mm.",
            lead=True,
        )
    yield Paragraph(
        "Errors are distances between predicted and measured positions of the end-effector, "
        "repeats of a configuration averaged. Held-out poses are only used "
        "to judge."
    )
    whole = [each for each in every if each.load == "all"]
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
    sets: dict[str, SetGap | None] = {_FITTED: gap.train, _HELD_OUT: gap.holdout}
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


def _fitted(found: Gathered) -> Iterator[Errors]:
    if (record := found.calibration) is None:
        return
    yield from _over(_FITTED, UNCALIBRATED, {k: e.before for k, e in record.errors.items()})
    geometry = {k: e.geometry for k, e in record.errors.items() if isinstance(e, GeneralErrors)}
    if geometry and _has_springs(record):
        yield from _over(_FITTED, _SPRINGS["geometry"], geometry)
    yield from _over(_FITTED, _last_title(record), {k: e.after for k, e in record.errors.items()})
    if found.verdict is not None and found.verdict.effects:
        gap = found.verdict.gap.train
        yield _errors(_FITTED, "all", EXTENDED, gap.after)
        for load, part in gap.per_load.items():
            yield _errors(_FITTED, load, EXTENDED, part.after)


def _held_out(found: Gathered) -> Iterator[Errors]:
    if found.held_out is None:
        return
    with_effects = found.verdict is None or bool(found.verdict.effects)
    for name, model in found.held_out.models.items():
        if name == "extended" and not with_effects:
            continue
        title = {"uncalibrated": UNCALIBRATED, "extended": EXTENDED}.get(name)
        if title is None:
            springs = "geometry" in found.held_out.models or "cubic" in found.held_out.models
            title = _SPRINGS.get(name, name) if springs else CALIBRATED
        yield _errors(_HELD_OUT, "all", title, model)
        for load, part in model.per_load.items():
            yield _errors(_HELD_OUT, load, title, part)


def _has_springs(record: CalibrationRecord) -> bool:
    return bool(getattr(record, "springs", True))


def _last_title(record: CalibrationRecord) -> str:
    if record.model == "paper":
        return _SPRINGS["cubic"]
    return _SPRINGS["linear"] if _has_springs(record) else CALIBRATED


def _errors(poses: str, load: str, model: str, of: Accuracy) -> Errors:
    return Errors(
        poses,
        load,
        model,
        of.rms_mm,
        of.peak_mm,
        of.mean_mm,
        of.orientation_deg,
        of.configurations,
    )


def _over(poses: str, model: str, by_load: dict[str, Accuracy]) -> Iterator[Errors]:
    """Yield errors over all loads together, then at each."""
    parts = list(by_load.values())
    count_of = sum(part.configurations for part in parts)

    def mean(values: Iterable[float]) -> float:
        pairs = zip(values, parts, strict=True)
        return sum(value * part.configurations for value, part in pairs) / count_of

    if count_of:
        angles = [part.orientation_deg for part in parts if part.orientation_deg is not None]
        yield Errors(
            poses,
            "all",
            model,
            mean(part.rms_mm**2 for part in parts) ** 0.5,
            max(part.peak_mm for part in parts),
            mean(part.mean_mm for part in parts),
            mean(angles) if len(angles) == len(parts) else None,
            count_of,
        )
    for load, part in by_load.items():
        yield _errors(poses, load, model, part)
