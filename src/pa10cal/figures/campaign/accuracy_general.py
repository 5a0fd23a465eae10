"""Errors of every model on the poses fitted and on those held out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pa10cal.figures.held_out_models import title
from pa10cal.figures.registry import Picture
from pa10cal.figures.results import Results
from pa10cal.figures.table import Grid, Row, Table
from pa10cal.results.accuracy import Accuracy
from pa10cal.results.calibration import GeneralCalibrationRecord
from pa10cal.results.evaluation import HoldoutRecord

PICTURE = Picture(
    title="Accuracy of the general model",
    needs=("general_calibration", "evaluation"),
    caption="""
Errors of each model of ``{name}`` at the fitted and at the held-out poses: mean, root mean
square and peak, and the mean orientation error where the instrument measures orientation.
*Nominal* is the described arm with its base and its tool or targets fitted. The model with the
discovered effects is judged separately inside the joint angles of the fitted poses and beyond
them, where it extrapolates and its accuracy is not assured.
""",
)

_ALL = "all"
_DATA_HEADER: Row = (
    "poses",
    "model",
    "load",
    "part",
    "mean_mm",
    "rms_mm",
    "peak_mm",
    "orientation_deg",
    "configurations",
)
_SHOWN_HEADER: Row = (
    "model",
    "load",
    "mean [mm]",
    "rms [mm]",
    "peak [mm]",
    "orientation [deg]",
    "poses",
)
#: Models as the errors of the poses fitted name them.
_FITTED = {"before": "uncalibrated", "geometry": "geometry", "after": "linear"}
_PARTS = {_ALL: "", "inside": ", angles seen in training", "extrapolated": ", extrapolated"}


@dataclass(frozen=True)
class _Entry:
    """Errors of one model: over which poses, at which load, and over which part of them."""

    poses: str
    model: str
    load: str
    part: str
    mean_mm: float
    rms_mm: float
    peak_mm: float
    orientation_deg: float | None
    configurations: int | None


def tabulate(results: Results) -> Table:
    """Return mean, rms and peak error and attitude, of the poses fitted and held out."""
    case, held_out = results.general(), results.held_out()
    entries = [*_fitted(case), *_extended(results, held_out), *_held_out(held_out)]
    grids = []
    for poses, caption in (("fitted", "Poses fitted"), ("held out", "Poses held out")):
        rows = tuple(_shown(entry, held_out) for entry in entries if entry.poses == poses)
        grids.append(Grid(_SHOWN_HEADER, rows or (("none", *["–"] * 6),), caption))
    return Table(
        title="Accuracy of the general model",
        data=Grid(_DATA_HEADER, tuple(_data(entry) for entry in entries)),
        shown=tuple(grids),
        notes=(
            results.words.of,
            "The nominal arm has its base and its tool or targets fitted to the same poses.",
            "Extrapolated: poses with a joint at an angle that hardly any of the poses fitted come "
            "near, so that an error learnt by angle is guessed there.",
        ),
    )


def _fitted(case: GeneralCalibrationRecord) -> Iterator[_Entry]:
    for key, model in _FITTED.items():
        if model == "geometry" and not case.springs:
            continue  # the same as the calibrated model
        by_load = {load: getattr(errors, key) for load, errors in case.errors.items()}
        yield _entry("fitted", model, _ALL, _ALL, _together(list(by_load.values())))
        if len(by_load) > 1:
            for load, accuracy in by_load.items():
                yield _entry("fitted", model, load, _ALL, accuracy)


def _extended(results: Results, held_out: HoldoutRecord) -> Iterator[_Entry]:
    """Yield what discovery says of the poses it was fitted to."""
    if "extended" not in held_out.models:
        return
    train = results.verdict().gap.train
    yield _entry("fitted", "extended", _ALL, _ALL, train.after)
    for part, gap in (("inside", train.inside), ("extrapolated", train.extrapolated)):
        if gap is not None:
            yield _entry("fitted", "extended", _ALL, part, gap.after)


def _held_out(held_out: HoldoutRecord) -> Iterator[_Entry]:
    for name, model in held_out.models.items():
        yield _entry("held out", name, _ALL, _ALL, model)
        for part, accuracy in (("inside", model.inside), ("extrapolated", model.extrapolated)):
            if accuracy is not None:
                yield _entry("held out", name, _ALL, part, accuracy)


def _entry(poses: str, model: str, load: str, part: str, accuracy: Accuracy) -> _Entry:
    return _Entry(
        poses,
        model,
        load,
        part,
        accuracy.mean_mm,
        accuracy.rms_mm,
        accuracy.peak_mm,
        accuracy.orientation_deg,
        accuracy.configurations,
    )


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


def _shown(entry: _Entry, held_out: HoldoutRecord) -> Row:
    angle = entry.orientation_deg
    return (
        f"{title(entry.model, held_out)}{_PARTS[entry.part]}",
        entry.load,
        f"{entry.mean_mm:.4f}",
        f"{entry.rms_mm:.4f}",
        f"{entry.peak_mm:.4f}",
        "–" if angle is None else f"{angle:.4f}",
        "–" if entry.configurations is None else str(entry.configurations),
    )


def _data(entry: _Entry) -> Row:
    angle, count = entry.orientation_deg, entry.configurations
    return (
        entry.poses,
        entry.model,
        entry.load,
        entry.part,
        f"{entry.mean_mm:.6g}",
        f"{entry.rms_mm:.6g}",
        f"{entry.peak_mm:.6g}",
        "" if angle is None else f"{angle:.6g}",
        "" if count is None else str(count),
    )
