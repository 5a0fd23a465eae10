"""Errors before and after calibration at each load, as Fig. 5 of the paper."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pa10cal.figures import published
from pa10cal.figures.parameter_names import written_load
from pa10cal.figures.registry import Picture
from pa10cal.figures.repeats import Scatter, scatter_by_load
from pa10cal.figures.results import Results
from pa10cal.figures.style import (
    AFTER,
    AFTER_COMBINED,
    BEFORE,
    BLACK,
    SEPARATOR,
    height_of,
    new_figure,
    panel,
    plain_log,
)
from pa10cal.results.accuracy import Accuracy
from pa10cal.results.calibration import PaperCalibrationRecord

PICTURE = Picture(
    title="Fig. 5: error before and after calibration",
    needs=("papers_calibration", "poses"),
    caption="""
Position error (above) and orientation error (below) at each external load in ``{name}`` (Fig. 5
of the paper). A marker is the mean over the calibration poses, and the bar above it ends at the
largest error; both values are written beside it. Filled markers: this campaign; hollow markers:
values stated in the paper. *Before*: nominal rigid model, its base frame fitted once to the
positions at the smallest load. *After*: calibrated model, for each load alone and for all loads
together. No model can fall below the scatter of repeated measurements. The axes are
logarithmic. Agreement of a synthetic campaign with the paper says nothing about the robot that
the authors measured.
""",
)

_TITLE = "Error before and after calibration, at each load (compare Fig. 5 of the paper)"
#: Where a load's columns stand about its middle.
_SLOTS = {"before": -0.28, "after": -0.01, "combined": 0.10, "repeats": 0.38}
_PAPER_ASIDE = -0.11
#: What the panel of orientations adds to the height.
_ORIENTATION_MM = 42.0
_COLOURS = {"before": BEFORE, "after": AFTER, "combined": AFTER_COMBINED, "repeats": BLACK}

Errors = Accuracy | published.PublishedError


@dataclass(frozen=True)
class _Column:
    """What stands in one column: a mean, a peak where there is one, and whose figures they are."""

    load: int
    slot: str
    mean: float
    peak: float | None
    is_paper: bool

    @property
    def x(self) -> float:
        return self.load + _SLOTS[self.slot] + (_PAPER_ASIDE if self.is_paper else 0.0)


def draw(results: Results) -> Figure:
    """Draw mean and peak position error, and mean orientation error, on logarithmic axes."""
    combined, cases = results.calibration(), results.load_cases()
    scatter = scatter_by_load(results.places())
    angles = _columns(results, combined, cases, lambda e: (e.orientation_deg, None))
    seen = any(not column.is_paper for column in angles)
    raised = _ORIENTATION_MM if seen else 0.0
    figure = new_figure(108.0 + raised, _TITLE)
    lowest = position = panel(figure, 23.0, 26.0 + raised, 145.0, 73.0)
    columns = _columns(results, combined, cases, lambda e: (e.mean_mm, e.peak_mm))
    columns += _scatter_columns(results, list(cases), scatter)
    _draw_columns(position, columns, list(cases), room=(3.0, 3.0))
    position.set_ylabel("position error [mm]")
    if seen:
        lowest = panel(figure, 23.0, 26.0, 145.0, 32.0)
        _draw_columns(lowest, angles, list(cases), room=(2.5, 6.0))
        lowest.set_ylabel("orientation\nerror [deg]")
    lowest.set_xlabel("external load")
    figure.legend(
        handles=_legend(results.is_paper_arm),
        loc="lower left",
        bbox_to_anchor=(0.012, 6.75 / height_of(figure)),
        ncols=3,
        columnspacing=1.2,
    )
    return figure


def _columns(
    results: Results,
    combined: PaperCalibrationRecord,
    cases: dict[str, PaperCalibrationRecord],
    figures_of: Callable[[Errors], tuple[float | None, float | None]],
) -> list[_Column]:
    """Return a column a load and model, without those whose figure was not measured."""
    found: list[tuple[int, str, Errors, bool]] = []
    for k, (load, case) in enumerate(cases.items()):
        found.append((k, "before", case.errors[load].before, False))
        found.append((k, "after", case.errors[load].after, False))
        found.append((k, "combined", combined.errors[load].after, False))
        for slot, stated in (("before", published.BEFORE), ("after", published.AFTER)):
            if results.is_paper_arm and load in stated:
                found.append((k, slot, stated[load], True))
    return [
        _Column(k, slot, mean, peak, is_paper)
        for k, slot, errors, is_paper in found
        for mean, peak in (figures_of(errors),)
        if mean is not None
    ]


def _scatter_columns(
    results: Results, loads: list[str], scatter: dict[str, Scatter]
) -> list[_Column]:
    ours = [
        _Column(k, "repeats", scatter[load].largest_per_axis_mm, None, is_paper=False)
        for k, load in enumerate(loads)
        if load in scatter
    ]
    return ours + [
        _Column(k, "repeats", published.REPEATABILITY_MM[load], None, is_paper=True)
        for k, load in enumerate(loads)
        if results.is_paper_arm and load in published.REPEATABILITY_MM
    ]


def _draw_columns(
    axes: Axes, columns: list[_Column], loads: list[str], room: tuple[float, float]
) -> None:
    """Draw columns with their figures above them, those before calibration below.

    Args:
        axes: logarithmic in height.
        columns: to draw.
        loads: names of the places along the axis.
        room: factors by which the axis reaches beyond the figures, below and above.
    """
    for column in columns:
        colour = _COLOURS[column.slot]
        face = "white" if column.is_paper else colour
        if column.peak is not None:
            axes.plot([column.x, column.x], [column.mean, column.peak], color=colour, linewidth=1.4)
            axes.plot(column.x, column.peak, color=colour, marker="_", markersize=7.0)
        axes.plot(
            column.x,
            column.mean,
            color=colour,
            marker="D" if column.is_paper else "o",
            markersize=5.0,
            markerfacecolor=face,
        )
        below = column.slot == "before"
        axes.annotate(
            _text(column),
            (column.x, column.mean if below else column.peak or column.mean),
            (0.0, -5.0 if below else 5.0),
            textcoords="offset points",
            rotation=90.0,
            ha="center",
            va="top" if below else "bottom",
        )
    low = min(column.mean for column in columns)
    high = max(column.peak or column.mean for column in columns)
    plain_log(axes, "y", low / room[0], high * room[1])
    axes.set_xlim(-0.5, len(loads) - 0.5)
    axes.set_xticks(range(len(loads)), [written_load(load) for load in loads])
    axes.tick_params(axis="x", length=0.0)
    axes.grid(visible=False, axis="x")
    for k in range(1, len(loads)):
        axes.axvline(k - 0.5, color=SEPARATOR, linewidth=0.6)


def _text(column: _Column) -> str:
    values = [column.mean] + ([column.peak] if column.peak is not None else [])
    digits = ".2f" if column.mean >= 0.1 else ".3f"
    if column.is_paper and column.peak is None:
        digits = "g"  # as it prints them
    return " / ".join(f"{value:{digits}}" for value in values)


def _legend(with_paper: bool) -> list[Line2D]:
    entries = [
        ("o", BEFORE, BEFORE, "before: nominal rigid model"),
        ("o", AFTER, AFTER, "after, calibrated at this load"),
        ("o", AFTER_COMBINED, AFTER_COMBINED, "after, all loads together"),
        ("o", BLACK, BLACK, "repeats, one axis (largest)"),
    ]
    if with_paper:
        entries.append(("D", BLACK, "white", "the paper's figures, same colours"))
    handles = [
        Line2D(
            [], [], color=edge, marker=marker, markerfacecolor=face, linestyle="none", label=text
        )
        for marker, edge, face, text in entries
    ]
    bar = Line2D(
        [],
        [],
        color=BLACK,
        marker="|",
        markersize=9.0,
        linestyle="none",
        label="mean / peak, as written",
    )
    return [*handles, bar]
