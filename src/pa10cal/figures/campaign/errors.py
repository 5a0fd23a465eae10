"""Errors of every model, at fitted and at held-out poses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.figures import published
from pa10cal.figures.registry import NothingToShowError, picture
from pa10cal.figures.results import COMBINED, Results
from pa10cal.figures.style import (
    BLACK,
    GREY,
    MODELS,
    SEPARATOR,
    evenly,
    legend_at,
    name_rows,
    new_figure,
    panel,
    plain_log,
    write_beside,
    write_text_at,
)
from pa10cal.figures.table import Row, Table, figures, frame_of, shown
from pa10cal.results.calibration import GeneralCalibrationRecord
from pa10cal.results.evaluation import Accuracy, HeldOutModel, HeldOutRows, HoldoutRecord

#: Told apart by more than their colours.
_LINES = {"geometry": "--", "cubic": "-."}
#: Wide below the others and a larger mark, so that what coincides with it is seen beside it.
_WIDE, _LARGE = {"linear": 2.2}, {"geometry": 6.0}
MARKERS = {
    "uncalibrated": "^",
    "geometry": "D",
    "linear": "s",
    "cubic": "o",
    "calibrated": "o",
    "extended": "v",
}
_NAMES = {
    "uncalibrated": "nominal, frames fitted",
    "geometry": "geometry",
    "calibrated": "calibrated",
    "linear": "geometry and springs",
    "extended": "with discovered effects",
}


@dataclass(frozen=True)
class Judged:
    """One model on held-out poses that belong together."""

    name: str  # in the record
    title: str  # as readers see it
    where: str  # `all`, or for a model that has learnt from angles `inside` those or `extrapolated`
    error_mm: Array  # (P,) position error
    angle_deg: Array | None  # (P,) orientation error, None where no attitude was seen

    @property
    def rms_mm(self) -> float:
        """Return the root mean square position error."""
        return float(np.sqrt(np.mean(self.error_mm**2)))

    @property
    def look(self) -> dict[str, Any]:
        """Return how it is drawn; what is extrapolated is dotted and hollow."""
        beyond = self.where == "extrapolated"
        return {
            "color": MODELS[self.name],
            "linestyle": ":" if beyond else _LINES.get(self.name, "-"),
            "linewidth": _WIDE.get(self.name, 1.0),
            "marker": MARKERS[self.name],
            "markersize": _LARGE.get(self.name, 4.0),
            "markerfacecolor": "white" if beyond else MODELS[self.name],
        }


def judged(held_out: HoldoutRecord) -> list[Judged]:
    """Return every model, one that has learnt from angles in two parts where it leaves them."""
    return [
        Judged(
            name,
            f"{title(name, held_out)}{part}",
            where,
            model.rows.error_mm[rows],
            None if model.rows.rotation_deg is None else _lengths(model.rows.rotation_deg[rows]),
        )
        for name, model in held_out.models.items()
        for where, part, rows in _parts(model.rows)
        if rows.any()
    ]


def title(name: str, held_out: HoldoutRecord) -> str:
    """Return a model's name; without springs there is one calibrated model."""
    if name == "linear" and "geometry" not in held_out.models:
        return _NAMES["calibrated"]
    return _NAMES.get(name, name)


def _parts(rows: HeldOutRows) -> Iterator[tuple[str, str, NDArray[np.bool_]]]:
    if rows.extrapolated is None:
        yield "all", "", np.ones(len(rows), dtype=bool)
        return
    yield "inside", ", angles seen", ~rows.extrapolated
    yield "extrapolated", ", extrapolated", rows.extrapolated


def _lengths(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=1))


# Errors at held-out points and loads, as Fig. 6 of the paper.

_TITLE = "Error at held-out points and loads, which no fit uses (compare Fig. 6 of the paper)"
_NAMES_OF_FIG6 = {
    "uncalibrated": "uncalibrated",
    "linear": "linear springs",
    "cubic": "cubic springs",
    "calibrated": "calibrated",
    "extended": "with named effects",
}
#: More configurations than this are not named one by one.
_MOST_NAMES = 45


@picture(
    title="Fig. 6: error at held-out points and loads",
    needs=("papers_calibration", "held_out"),
    caption="""
Errors of ``{name}`` at poses and loads that no fit uses (Fig. 6 of the paper): poses outside
the calibrated volume, and loads up to about twice the calibrated ones. Above, every
configuration, by load; below, mean and peak over all of them, with the paper's values as hollow
markers. *Uncalibrated* is the nominal rigid model; *linear* and *cubic* are the calibrated
models without and with a cubic stiffness term. An error that is larger here than in Fig. 5 is
the cost of extrapolation. Where linear and cubic springs do equally well, the data do not need
the cubic term.
""",
)
def draw_fig6_holdout(results: Results) -> Figure:
    """Draw every configuration by load, and mean and peak of each model beside the paper's."""
    held_out = results.held_out()
    case = results.calibration(held_out.calibration)  # refuses another model than the paper's
    if not held_out.models:
        raise NothingToShowError("no held-out configuration was measured")
    said = "Linear and cubic springs: as calibrated"
    if not case.has_springs:  # one model: what has no springs has no linear or cubic ones
        held_out = _of_rigid_joints(held_out)
        said = "All joints were held rigid; calibrated"
    figure = new_figure(146.0, _TITLE)
    single = panel(figure, 16.0, 81.0, 152.0, 53.0)
    _draw_configurations(single, held_out)
    load = held_out.calibration
    fitted = "all loads together" if load == COMBINED else f"{load} alone"
    write_text_at(figure, 2.0, 7.0, f"{said} with {fitted}.")
    figure.legend(
        *single.get_legend_handles_labels(), loc="center", bbox_to_anchor=(0.5, 0.446), ncols=4
    )
    summary = panel(figure, 30.0, 22.0, 66.0, 32.0)
    _draw_summary(summary, held_out, results.is_paper_arm)
    return figure


def _of_rigid_joints(held_out: HoldoutRecord) -> HoldoutRecord:
    """Return the models of an arm whose joints were held rigid: one is calibrated."""
    names = {"linear": "", "cubic": "calibrated"}
    models = {names.get(name, name): model for name, model in held_out.models.items()}
    models.pop("", None)
    return held_out.model_copy(update={"models": models})


def _draw_configurations(axes: Axes, held_out: HoldoutRecord) -> None:
    # Every model is judged on the same configurations, in the same order.
    first = next(iter(held_out.models.values())).rows
    order = np.lexsort((first.pose, first.load_N))
    loads, poses = first.load_N[order], first.pose[order]
    aside = np.linspace(-0.2, 0.2, len(held_out.models))
    errors_mm = {
        name: np.linalg.norm(model.rows.position_mm[order], axis=1)
        for name, model in held_out.models.items()
    }
    for shift, (name, errors) in zip(aside, errors_mm.items(), strict=True):
        at = np.arange(len(errors)) + shift
        axes.plot(at, errors, label=_NAMES_OF_FIG6[name], **_dots(name))
        extrapolated = held_out.models[name].rows.extrapolated
        if extrapolated is not None and extrapolated.any():
            beyond = extrapolated[order]
            hollow = _dots(name) | {"markerfacecolor": "white"}
            axes.plot(at[beyond], errors[beyond], label="extrapolated", **hollow)
    lowest = min(errors.min() for errors in errors_mm.values())
    highest = max(errors.max() for errors in errors_mm.values())
    plain_log(axes, "y", lowest / 1.5, highest * 1.5)
    axes.set_xlim(-0.7, len(poses) - 0.3)
    axes.set_ylabel("position error [mm]")
    axes.set_xlabel("held-out configuration: pose, grouped by load")
    axes.grid(visible=False, axis="x")
    named = len(poses) <= _MOST_NAMES
    axes.set_xticks(range(len(poses)), poses.tolist(), rotation=90.0)
    axes.tick_params(axis="x", length=0.0, labelbottom=named)
    for load in np.unique(loads):
        at = np.flatnonzero(loads == load)
        axes.text(at.mean(), 1.02, f"{load:g} N", transform=axes.get_xaxis_transform(), ha="center")
        if at[0]:
            axes.axvline(at[0] - 0.5, color=SEPARATOR, linewidth=0.6)


def _draw_summary(axes: Axes, held_out: HoldoutRecord, with_paper: bool) -> None:
    """Draw mean and peak of each model, ours above the paper's."""
    names = list(held_out.models)
    for k, name in enumerate(names):
        model = held_out.models[name]
        _draw_range(
            axes, k - 0.17, name, model, _text(model, ".2f" if model.mean_mm > 0.1 else ".3f")
        )
        if with_paper and name in published.HELD_OUT:
            stated = published.HELD_OUT[name]
            _draw_range(axes, k + 0.2, name, stated, "paper: " + _text(stated, "g"), face="white")
    shown = [*held_out.models.values(), *(published.HELD_OUT.values() if with_paper else ())]
    lowest, highest = min(e.mean_mm for e in shown), max(e.peak_mm for e in shown)
    plain_log(axes, "x", lowest / 1.5, highest * 1.5)
    name_rows(axes, [_NAMES_OF_FIG6[name] for name in names], 0.6, lines=False)
    axes.set_title(
        "Mean and peak over all held-out configurations: ours filled, the paper's hollow"
    )
    axes.set_xlabel("position error [mm], mean to peak")


def _draw_range(
    axes: Axes,
    y: float,
    name: str,
    errors: HeldOutModel | published.PublishedError,
    text: str,
    face: str | None = None,
) -> None:
    style = _dots(name) | ({"markerfacecolor": face, "marker": "D"} if face else {})
    axes.plot([errors.mean_mm, errors.peak_mm], [y, y], color=MODELS[name], linewidth=1.4)
    axes.plot(errors.peak_mm, y, color=MODELS[name], marker="|", markersize=7.0)
    axes.plot(errors.mean_mm, y, **style)
    write_beside(axes, y, text, 1.03, color=GREY if face else BLACK)


def _dots(name: str) -> dict[str, Any]:
    return {"color": MODELS[name], "marker": MARKERS[name], "linestyle": "none"}


def _text(errors: HeldOutModel | published.PublishedError, digits: str) -> str:
    position = f"{errors.mean_mm:{digits}} / {errors.peak_mm:{digits}} mm"
    if errors.orientation_deg is None:
        return position
    return f"{position}, orientation {errors.orientation_deg:{digits}}°"


# Errors of every model at the poses fitted and at those held out.

_ALL = "all"
_ERRORS = ("mean_mm", "rms_mm", "peak_mm", "orientation_deg")
_SHOWN = ("model", "load", "mean [mm]", "rms [mm]", "peak [mm]", "orientation [deg]", "poses")
#: Models as the errors of the fitted poses name them.
_FITTED = {"before": "uncalibrated", "geometry": "geometry", "after": "linear"}
_PARTS = {_ALL: "", "inside": ", angles seen in the fit", "extrapolated": ", extrapolated"}

#: Errors of one model: over which poses, at which load, and over which part of them.
_Entry = tuple[str, str, str, str, Accuracy]


@picture(
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
def tabulate_accuracy_general(results: Results) -> Table:
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


# Distribution of the errors of held-out poses.

_TITLE_OF_HELD_OUT = (
    "Error of held-out poses, which no fit uses: share of poses with a smaller error"
)
#: Of more poses only so many are drawn: more would not be seen.
_MOST_STEPS = 400
#: Wide lines lie under the others, and marks on all of them.
_UNDER, _OVER, _MARK = 2.0, 2.1, 2.2
_BELOW_MM, _PANEL_MM, _ABOVE_MM, _ROW_MM = 25.0, 62.0, 12.0, 4.6


@picture(
    title="Error of held-out poses",
    needs=("general_calibration", "held_out"),
    caption="""
Errors of ``{name}`` at poses that no fit uses: the share of poses with a smaller error, for
each model; left the error of the measured target or distance, right the orientation error where
the instrument measures orientation. *Nominal* is the described arm with base and tool or
targets fitted; *geometry* has calibrated links; *geometry and springs* also has calibrated
joint stiffness (an arm without springs has one model, *calibrated*); the last model includes the
discovered effects. An error learnt as a function
of a joint angle is known only at the angles of the fitted poses: poses beyond them are
extrapolated and drawn apart, dotted.
""",
)
def draw_held_out_errors(results: Results) -> Figure:
    """Draw the distribution of each model's errors, of position and of orientation."""
    held_out = results.held_out()
    if not held_out.models:
        raise NothingToShowError("no held-out configuration was measured")
    models = judged(held_out)
    legend_mm = _ROW_MM * len(models)
    bottom = _BELOW_MM + legend_mm
    figure = new_figure(bottom + _PANEL_MM + _ABOVE_MM, _TITLE_OF_HELD_OUT)
    angles = [(model, model.angle_deg) for model in models if model.angle_deg is not None]
    wide = 72.0 if angles else 152.0
    position = panel(figure, 15.0, bottom, wide, _PANEL_MM)
    _draw_shares(position, [(model, model.error_mm) for model in models])
    words = results.words
    position.set(xlabel=f"{words.error} [mm]", ylabel="share of the poses [%]")
    if angles:
        orientation = panel(figure, 96.0, bottom, wide, _PANEL_MM)
        _draw_shares(orientation, angles)
        orientation.set_xlabel("orientation error [deg]")
        orientation.tick_params(labelleft=False)
    handles = [Line2D([], [], label=_said(model), **model.look) for model in models]
    legend_at(figure, 4.0, 14.0, handles, handlelength=4.0)
    for k, line in enumerate((words.of, _fitted_of_held_out(held_out))):
        write_text_at(figure, 2.0, 10.0 - 4.0 * k, line, color=GREY)
    return figure


def _draw_shares(axes: Axes, drawn: list[tuple[Judged, Array]]) -> None:
    for model, errors in drawn:
        at, count = np.sort(errors), len(errors)
        rms = float(np.sqrt(np.mean(errors**2)))
        below = max(int(np.searchsorted(at, rms, side="right")), 1)
        rank = np.union1d(evenly(count, _MOST_STEPS) + 1, below)  # the step that holds the mark
        line = {key: model.look[key] for key in ("color", "linestyle", "linewidth")}
        axes.plot(
            at[rank - 1],
            100.0 * rank / count,
            drawstyle="steps-post",
            zorder=_UNDER if line["linewidth"] > 1.0 else _OVER,
            **line,
        )
        axes.plot(rms, 100.0 * below / count, zorder=_MARK, **model.look)
    every = np.concatenate([errors for _, errors in drawn])
    low = float(np.quantile(every, 0.002))
    plain_log(axes, "x", max(low, 1e-3 * every.max()) / 1.2, float(every.max()) * 1.2)
    axes.set_ylim(0.0, 102.0)


def _said(model: Judged) -> str:
    text = f"{model.title}: rms {model.rms_mm:.3f}, peak {model.error_mm.max():.3f} mm"
    if model.angle_deg is not None:
        text += f"; {np.sqrt(np.mean(model.angle_deg**2)):.4f}°"
    return f"{text} ({len(model.error_mm)} poses)"


def _fitted_of_held_out(held_out: HoldoutRecord) -> str:
    load = held_out.calibration
    fitted = "all loads together" if load == COMBINED else f"{load} alone"
    return f"Marks on the lines: rms. Calibrated with {fitted}."
