"""Errors at held-out points and loads, as Fig. 6 of the paper."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pa10cal.figures import published
from pa10cal.figures.held_out_models import MARKERS
from pa10cal.figures.registry import NothingToShowError, Picture
from pa10cal.figures.results import COMBINED, Results
from pa10cal.figures.style import (
    BLACK,
    GREY,
    MODELS,
    SEPARATOR,
    name_rows,
    new_figure,
    panel,
    plain_log,
    write_beside,
    write_text_at,
)
from pa10cal.results.evaluation import HeldOutModel, HoldoutRecord

PICTURE = Picture(
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

_TITLE = "Error at held-out points and loads, which no fit uses (compare Fig. 6 of the paper)"
_NAMES = {
    "uncalibrated": "uncalibrated",
    "linear": "linear springs",
    "cubic": "cubic springs",
    "calibrated": "calibrated",
    "extended": "with named effects",
}
#: More configurations than this are not named one by one.
_MOST_NAMES = 45


def draw(results: Results) -> Figure:
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
        axes.plot(at, errors, label=_NAMES[name], **_dots(name))
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
    name_rows(axes, [_NAMES[name] for name in names], 0.6, lines=False)
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
