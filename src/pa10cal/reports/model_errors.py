"""Errors of every model over fitted and held-out poses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from pa10cal.reports.gathered import Gathered
from pa10cal.results.accuracy import Accuracy
from pa10cal.results.calibration import CalibrationRecord, GeneralErrors

UNCALIBRATED, CALIBRATED, EXTENDED = "not calibrated", "calibrated", "with the effects found"
FITTED, HELD_OUT = "fitted", "held out"
_SPRINGS = {
    "geometry": "calibrated, geometry alone",
    "linear": "calibrated, linear springs",
    "cubic": "calibrated, cubic springs",
}


@dataclass(frozen=True)
class Errors:
    """Errors of one model over some configurations."""

    poses: str  # `fitted` or `held out`
    load: str  # `all`, or a load such as `22N`
    model: str  # as readers see it
    # rms_mm, peak_mm and mean_mm: position error
    rms_mm: float
    peak_mm: float
    mean_mm: float
    orientation_deg: float | None  # mean orientation error; None where no attitude is measured
    configurations: int  # how many

    @property
    def kind(self) -> str:
        """Return which poses they are of, as it stands before a noun."""
        return self.poses.replace(" ", "-")


def errors_of(found: Gathered) -> list[Errors]:
    """Return the errors of every model, over all loads first, then load by load."""
    every = [*_fitted(found), *_held_out(found)]
    return [each for each in every if each.load == "all"] + [
        each for each in every if each.load != "all"
    ]


def headline(found: Gathered) -> tuple[Errors, Errors] | None:
    """Return the errors before and after that count: held out where there are such poses."""
    every = [each for each in errors_of(found) if each.load == "all"]
    for poses in (HELD_OUT, FITTED):
        of = [each for each in every if each.poses == poses]
        if of:
            return of[0], of[-1]
    return None


def model_title(name: str, found: Gathered, beside: Iterable[str]) -> str | None:
    """Return what readers call a model; None of one that is the calibrated one once more.

    Args:
        name: in the records.
        found: what was gathered.
        beside: names of the models that it is compared with.
    """
    if name == "extended":
        return EXTENDED if found.verdict is None or found.verdict.effects else None
    if name == "uncalibrated":
        return UNCALIBRATED
    return _SPRINGS.get(name, name) if {"geometry", "cubic"} & set(beside) else CALIBRATED


def _fitted(found: Gathered) -> Iterator[Errors]:
    if (record := found.calibration) is None:
        return
    yield from _over(FITTED, UNCALIBRATED, {k: e.before for k, e in record.errors.items()})
    geometry = {k: e.geometry for k, e in record.errors.items() if isinstance(e, GeneralErrors)}
    if geometry and _has_springs(record):
        yield from _over(FITTED, _SPRINGS["geometry"], geometry)
    yield from _over(FITTED, _last_title(record), {k: e.after for k, e in record.errors.items()})
    if found.verdict is not None and found.verdict.effects:
        gap = found.verdict.gap.train
        yield _errors(FITTED, "all", EXTENDED, gap.after)
        for load, part in gap.per_load.items():
            yield _errors(FITTED, load, EXTENDED, part.after)


def _held_out(found: Gathered) -> Iterator[Errors]:
    if found.held_out is None:
        return
    for name, model in found.held_out.models.items():
        title = model_title(name, found, found.held_out.models)
        if title is None:
            continue
        yield _errors(HELD_OUT, "all", title, model)
        for load, part in model.per_load.items():
            yield _errors(HELD_OUT, load, title, part)


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


def _over(poses: str, model: str, by_load: Mapping[str, Accuracy]) -> Iterator[Errors]:
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
