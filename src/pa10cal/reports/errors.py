"""Errors of every model over fitted and held-out poses, as page and summaries give them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from pa10cal.reports.results_bundle import ResultsBundle
from pa10cal.results.evaluation import Accuracy, flagged

UNCALIBRATED, CALIBRATED, EXTENDED = "not calibrated", "calibrated", "with the effects found"
FITTED, HELD_OUT, ALL = "fitted", "held out", "all"
PARTS = {
    "inside": "angles seen in the fit",
    "extrapolated": "extrapolated",
    "trusted": "without readings flagged as wrong",
}
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
    name: str  # of the model in the records
    model: str  # as readers see it
    of: Accuracy  # the errors
    # of a model with effects `inside` the angles fitted or `extrapolated`; or `trusted`: without
    # configurations that have a reading flagged as wrong
    part: str = ALL
    trusted: Accuracy | None = None  # of `all` parts, those of `trusted`; None where all are

    @property
    def kind(self) -> str:
        """Return which poses they are of, as it stands before a noun."""
        return self.poses.replace(" ", "-")

    @property
    def counted(self) -> Accuracy:
        """Return the errors that a headline gives: without readings flagged as wrong."""
        return self.trusted or self.of

    def with_flagged(self, key: str) -> str:
        """Return what a headline adds: the error with flagged readings; nothing without any.

        Args:
            key: `rms_mm` or `mean_mm`.
        """
        if self.trusted is None:
            return ""
        count = self.of.configurations - self.trusted.configurations
        return f"with {flagged(count)} {getattr(self.of, key):.3f} mm"


def errors_of(results: ResultsBundle) -> list[Errors]:
    """Return the errors of every model, over all loads first, then load by load."""
    every = [*_fitted(results), *_held_out(results)]
    return sorted(every, key=lambda errors: errors.load != ALL)


def headline(results: ResultsBundle) -> tuple[Errors, Errors] | None:
    """Return the errors before and after that count: held out where there are such poses."""
    whole = [errors for errors in errors_of(results) if errors.load == errors.part == ALL]
    counted = [errors for errors in whole if errors.poses == HELD_OUT] or whole
    return (counted[0], counted[-1]) if counted else None


def model_title(name: str, results: ResultsBundle, beside: Iterable[str]) -> str | None:
    """Return what readers call a model; None of one that is the calibrated one once more.

    Args:
        name: in the records.
        results: of the campaign.
        beside: names of the models that it is compared with.
    """
    if name == "extended":
        return EXTENDED if results.verdict is None or results.verdict.effects else None
    if name == "uncalibrated":
        return UNCALIBRATED
    return _SPRINGS.get(name, name) if {"geometry", "cubic"} & set(beside) else CALIBRATED


def _fitted(results: ResultsBundle) -> Iterator[Errors]:
    if (record := results.calibration) is None:
        return
    sprung = bool(getattr(record, "springs", True))
    last = "cubic" if record.model == "paper" else "linear"
    for key, name, title in (
        ("before", "uncalibrated", UNCALIBRATED),
        *([("geometry", "geometry", _SPRINGS["geometry"])] if sprung else []),
        ("after", last, _SPRINGS[last] if sprung else CALIBRATED),
    ):
        by_load = {load: getattr(of, key, None) for load, of in record.errors.items()}
        known = {load: of for load, of in by_load.items() if of is not None}
        if known:
            less = {load: getattr(record.errors[load].trusted, key, None) for load in known}
            trusted = _together([less[load] or of for load, of in known.items()])
            parts = {"trusted": trusted} if any(less.values()) else {}
            yield from _model(FITTED, name, title, _together([*known.values()]), known, parts)
    if results.verdict is not None and results.verdict.effects:
        gap = results.verdict.gap.train
        regions = {"inside": gap.inside, "extrapolated": gap.outside}
        after = {region: of.after for region, of in regions.items() if of is not None}
        per_load = {load: part.after for load, part in gap.per_load.items()}
        yield from _model(FITTED, "extended", EXTENDED, gap.after, per_load, after)


def _held_out(results: ResultsBundle) -> Iterator[Errors]:
    models = {} if results.held_out is None else results.held_out.models
    for name, model in models.items():
        title = model_title(name, results, models)
        if title is not None:
            parts = {"inside": model.inside, "extrapolated": model.outside}
            parts |= {"trusted": model.trusted}
            known = {part: of for part, of in parts.items() if of is not None}
            yield from _model(HELD_OUT, name, title, model, model.per_load, known)


def _model(
    poses: str,
    name: str,
    title: str,
    of: Accuracy,
    per_load: Mapping[str, Accuracy],
    parts: Mapping[str, Accuracy],
) -> Iterator[Errors]:
    """Yield errors over all configurations, over parts of them and at each load."""
    yield Errors(poses, ALL, name, title, of, trusted=parts.get("trusted"))
    for part, within in parts.items():
        yield Errors(poses, ALL, name, f"{title}, {PARTS[part]}", within, part)
    for load, at_load in per_load.items():
        yield Errors(poses, load, name, title, at_load)


def _together(parts: list[Accuracy]) -> Accuracy:
    """Return errors over several sets of configurations as over all of them."""
    count = np.array([part.configurations for part in parts])
    share = count / count.sum()
    angles = [part.orientation_deg for part in parts if part.orientation_deg is not None]
    return Accuracy(
        mean_mm=float(share @ [part.mean_mm for part in parts]),
        rms_mm=float(np.sqrt(share @ [part.rms_mm**2 for part in parts])),
        peak_mm=max(part.peak_mm for part in parts),
        orientation_deg=float(share @ angles) if len(angles) == len(parts) else None,
        configurations=int(count.sum()),
    )
