"""Errors of every model at the poses fitted and at those held out."""

from __future__ import annotations

from collections.abc import Iterator
from operator import attrgetter

import numpy as np

from pa10cal.figures.held_out_models import title
from pa10cal.figures.registry import Picture
from pa10cal.figures.results import Results
from pa10cal.figures.table import Row, Table, figures, frame_of, shown
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
_ERRORS = ("mean_mm", "rms_mm", "peak_mm", "orientation_deg")
_SHOWN = ("model", "load", "mean [mm]", "rms [mm]", "peak [mm]", "orientation [deg]", "poses")
#: Models as the errors of the fitted poses name them.
_FITTED = {"before": "uncalibrated", "geometry": "geometry", "after": "linear"}
_PARTS = {_ALL: "", "inside": ", angles seen in the fit", "extrapolated": ", extrapolated"}

#: Errors of one model: over which poses, at which load, and over which part of them.
_Entry = tuple[str, str, str, str, Accuracy]


def tabulate(results: Results) -> Table:
    """Return mean, rms and peak error and attitude, of the poses fitted and held out."""
    case, held_out = results.general(), results.held_out()
    entries = [*_fitted(case), *_extended(results, held_out), *_held_out(held_out)]
    return Table(
        title="Accuracy of the general model",
        data=frame_of(
            ("poses", "model", "load", "part", *_ERRORS, "configurations"),
            [
                (
                    *of,
                    *(figures(number, 6) for number in attrgetter(*_ERRORS)(errors)),
                    errors.configurations,
                )
                for *of, errors in entries
            ],
        ),
        shown=tuple(
            shown(_SHOWN, [_row(e, held_out) for e in entries if e[0] == poses], caption)
            for poses, caption in (("fitted", "Poses fitted"), ("held out", "Poses held out"))
        ),
        notes=(
            results.words.of,
            "The nominal arm has its base and its tool or targets fitted to the same poses.",
            "Extrapolated: poses with a joint at an angle far from those of the fitted poses, so "
            "that an error learnt by angle is not known there.",
        ),
    )


def _row(entry: _Entry, held_out: HoldoutRecord) -> Row:
    _, model, load, part, errors = entry
    angle = errors.orientation_deg
    return (
        f"{title(model, held_out)}{_PARTS[part]}",
        load,
        *(f"{value:.4f}" for value in (errors.mean_mm, errors.rms_mm, errors.peak_mm)),
        "–" if angle is None else f"{angle:.4f}",
        str(errors.configurations),
    )


def _fitted(case: GeneralCalibrationRecord) -> Iterator[_Entry]:
    for key, model in _FITTED.items():
        if model == "geometry" and not case.springs:
            continue  # the same as the calibrated model
        by_load = {load: getattr(errors, key) for load, errors in case.errors.items()}
        yield "fitted", model, _ALL, _ALL, _together(list(by_load.values()))
        if len(by_load) > 1:
            for load, accuracy in by_load.items():
                yield "fitted", model, load, _ALL, accuracy


def _extended(results: Results, held_out: HoldoutRecord) -> Iterator[_Entry]:
    """Yield what discovery says of the poses it was fitted to."""
    if "extended" not in held_out.models:
        return
    train = results.verdict().gap.train
    yield "fitted", "extended", _ALL, _ALL, train.after
    for part, gap in (("inside", train.inside), ("extrapolated", train.outside)):
        if gap is not None:
            yield "fitted", "extended", _ALL, part, gap.after


def _held_out(held_out: HoldoutRecord) -> Iterator[_Entry]:
    for name, model in held_out.models.items():
        yield "held out", name, _ALL, _ALL, model
        for part, accuracy in (("inside", model.inside), ("extrapolated", model.outside)):
            if accuracy is not None:
                yield "held out", name, _ALL, part, accuracy


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
