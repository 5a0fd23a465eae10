"""Trials in pictures: what was hidden and named, power, intervals, counts, targets."""

from __future__ import annotations

from itertools import cycle
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from scipy.special import ndtri

from pa10cal.arrays import Array
from pa10cal.figures import style
from pa10cal.figures.registry import NothingToShowError, picture
from pa10cal.figures.table import ResultTable, frame_of
from pa10cal.reports.theme import BLACK, BLUE, GREY, ORANGE, SEPARATOR, SKY, VERMILLION
from pa10cal.results.codec import read
from pa10cal.results.number_text import HALF_WIDTH_95
from pa10cal_lab.trial_records import JudgedTrial, ScoreRow, TrialScoresRecord

#: The file of a results folder that these are drawn of.
FROM = "scores.json"
_WITH_INTERVAL: dict[str, Any] = {"color": BLUE, "ecolor": SKY, "marker": "o", "capsize": 2.0}


def read_content(folder: Path) -> tuple[str, TrialScoresRecord]:
    """Return the footer of the pictures of a folder that `score_trials` wrote, and the scores.

    Raises:
        RecordError: when they cannot be used.
    """
    scores = read(TrialScoresRecord, folder / FROM, within=folder)
    trials = "wild trials" if scores.measured == "wild" else "blind trials"
    footer = f"{scores.trials} {trials}. Synthetic data. Provenance: {scores.provenance}."
    return footer, scores


# What was hidden in blind trials, and what was named: the confusion matrix.

#: Side of a cell, and room left of, above and below them.
_CELL_MM = 4.6
_LEFT_MM, _TOP_MM, _BOTTOM_MM = 37.0, 44.0, 16.0
#: Outcomes that are no id, in the order of the columns, and those that are no fault.
_WORDS = (
    "in the alternatives",
    "no name, right place",
    "no name, no place",
    "said to be not testable",
    "nothing found",
    "right id elsewhere",
    "no name, other place",
    "failed",
)
_HONEST = _WORDS[:5]
_RIGHT_WITHOUT_NAME = _WORDS[1]


@picture(
    title="What was hidden, and what was named",
    needs=(),
    caption="""
Simulated campaigns in which one effect was hidden, judged without knowledge of it ({name}). A
row is the effect that was hidden, a column the effect that was named. Blue: right name at the
right place. *In the alternatives*: the data cannot distinguish the truth from the name given,
and the verdict lists both. *No name, right place* is the correct answer for effects outside the
vocabulary (below the line). Red: wrong name. The hidden effects go down to a tenth of their
usual size, so *nothing found* is no fault by itself. Errors of real robots that the simulation
does not have are not tested.
""",
)
def draw_trials_confusion(scores: TrialScoresRecord) -> Figure:
    """Draw a row an effect, a column a name that was given, and columns for what is no name."""
    inside, outside = (
        {each.id: each.counts for each in scores.subjects if each.kind == kind}
        for kind in ("single", "outside")
    )
    rows = [*((name, inside[name]) for name in sorted(inside))]
    rows += [(name, outside[name]) for name in sorted(outside)]
    if not rows:
        raise NothingToShowError("no trial hid one effect")
    given = {outcome for _, counts in rows for outcome in counts}
    ids = sorted({*inside, *(given - set(_WORDS))})
    columns = [*ids, *(word for word in _WORDS if word in given)]
    width, height = _CELL_MM * (len(columns) + 1), _CELL_MM * len(rows)
    figure = style.new_figure(
        _TOP_MM + height + _BOTTOM_MM,
        "Blind trials with one hidden effect: what was hidden, and what was named",
    )
    axes = style.panel(figure, _LEFT_MM, _BOTTOM_MM, width, height)
    for y, (name, counts) in enumerate(rows):
        best, total = _RIGHT_WITHOUT_NAME if y >= len(inside) else name, sum(counts.values())
        for x, column in enumerate(columns):
            if count := counts.get(column, 0):
                color = BLUE if column == best else ORANGE if column in _HONEST else VERMILLION
                shades = LinearSegmentedColormap.from_list("shade", ["white", color])
                face = shades(0.15 + 0.6 * count / total)
                axes.add_patch(Rectangle((x - 0.5, y - 0.5), 1.0, 1.0, facecolor=face, linewidth=0))
                axes.text(x, y, str(count), ha="center", va="center")
        axes.text(len(columns), y, str(total), ha="center", va="center", color=GREY)
    style.name_rows(axes, [name for name, _ in rows], lines=False)
    style.name_columns(axes, columns, rotation=90.0)
    axes.tick_params(axis="x", top=False, labeltop=True, bottom=False, labelbottom=False)
    axes.set(xlim=(-0.5, len(columns) + 0.5), ylabel="hidden")
    for x in (len(ids), len(columns)):
        axes.axvline(x - 0.5, color=SEPARATOR, linewidth=0.8)
    if 0 < len(inside) < len(rows):
        axes.axhline(len(inside) - 0.5, color=SEPARATOR, linewidth=0.8)
    style.note(
        figure,
        "Blue: right id at the right place, or rightly without a name. Orange: not named alone, "
        "but no wrong name\neither. Red: wrong. Shade: share of the row. Last column: trials.",
    )
    return figure


# Coverage of the intervals of named effects.

_INTERVAL_ROW_MM = 4.6
_OF_PARAMETERS = "parameter"


@picture(
    title="Coverage of the intervals of effects",
    needs=(),
    caption="""
Coverage of the intervals that a verdict gives for the parameters of an effect ({name}). Left,
the share of true values inside the interval at the usual level, by parameter. Right, the share
inside at every level, over all parameters: on the line the stated uncertainties are right,
below it they are too small. Only effects named at their place count, so the smallest of them
are those that chance made larger.
""",
)
def draw_trials_intervals(scores: TrialScoresRecord) -> Figure:
    """Draw the share inside the 95 % interval by parameter, and by level over all of them."""
    size = np.abs([score.score for score in scores.parameter_scores])
    if not len(size):
        raise NothingToShowError("no hidden effect with parameters was named")
    of_parameters = [row for row in scores.rates if row.what.startswith(_OF_PARAMETERS)]
    inside = next((row for row in of_parameters if row.share and not row.by), None)
    if inside is None:
        raise NothingToShowError("this study does not count the intervals of effects")
    rows = [row for row in of_parameters if row.by]
    height = max(50.0, _INTERVAL_ROW_MM * len(rows))
    figure = style.new_figure(
        height + 44.0, "Coverage of the intervals of named effects: blind trials"
    )
    inside_by_parameter = style.panel(figure, 50.0, 30.0, 42.0, height)
    for y, row in enumerate(rows):
        _draw_share(inside_by_parameter, y, row, across=True)
        style.write_beside(inside_by_parameter, y, f"{row.count} of {row.trials}", color=GREY)
    names = [row.by for row in rows]
    style.name_rows(inside_by_parameter, names)
    inside_by_parameter.axvline(95.0, color=BLACK, linewidth=0.8)
    inside_by_parameter.set(xlim=(0.0, 102.0), xlabel="inside, 95 % interval [%]")
    _draw_levels(style.panel(figure, 123.0, 30.0 + height - 44.0, 44.0, 44.0), size)
    style.note(
        figure,
        f"{inside.count} of {inside.trials} parameters lie inside their 95 % interval "
        f"({inside.interval});\nroot mean square of (value − truth) / std: "
        f"{np.sqrt(np.mean(size**2)):.2f}. Of trials in which the hidden effect is named at its "
        "place;\nmaps are omitted. Bars: 95 % intervals (Clopper and Pearson).",
    )
    return figure


def _draw_share(axes: Axes, at: float, row: ScoreRow, *, across: bool = False) -> None:
    """Draw a share with its interval upwards over a place, or in per cent across a row."""
    scale = 100.0 if across else 1.0
    share, low, high = (scale * (each or 0.0) for each in (row.reached, row.low, row.high))
    off = [[share - low], [high - share]]
    if across:
        axes.errorbar(share, at, xerr=off, **_WITH_INTERVAL)
    else:
        axes.errorbar(at, share, yerr=off, **_WITH_INTERVAL)


def _draw_levels(axes: Axes, size: Array) -> None:
    level = np.linspace(0.0, 0.995, 200)
    half_width = ndtri(0.5 + level / 2.0)
    share = (size[:, None] <= half_width).mean(axis=0)
    band = HALF_WIDTH_95 * np.sqrt(level * (1.0 - level) / len(size))
    axes.fill_between(
        100.0 * level, 100.0 * (level - band), 100.0 * (level + band), color=GREY, alpha=0.25, lw=0
    )
    axes.plot([0.0, 100.0], [0.0, 100.0], color=BLACK, linewidth=0.8)
    axes.plot(100.0 * level, 100.0 * share, color=BLUE)
    axes.set(xlim=(0.0, 100.0), ylim=(0.0, 100.0))
    axes.set(xlabel="level of the interval [%]", ylabel="parameters inside [%]")
    axes.set_title("every level (grey: chance)")


# How large an effect must be to be found: blind trials by size and by residual.

_POWER_ROW_MM = 4.8
#: Markers of layouts, in order of their names, and what they are called.
_MARKERS = {
    "o": "dots",
    "s": "squares",
    "^": "triangles up",
    "v": "triangles down",
    "D": "diamonds",
    "P": "crosses",
}
#: How far the rows of the first and of the last layout are apart.
_SPREAD = {1: 0.0, 2: 0.34}
_WIDEST_SPREAD = 0.6
#: Characters of a line below the panels.
_LINE = 96
_LOWEST, _HIGHEST = 0.03, 60.0
#: Where the residual is so many times the floor.
_RATIOS = {1.5: "right", 3.0: "left"}


@picture(
    title="How large an effect must be to be found",
    needs=(),
    caption="""
Size at which an effect is named or among the alternatives ({name}). Left, every trial by the
size of its hidden effect, in units of the usual size in robots of this kind; hollow markers
were missed. Right, the same trials by the effect on the poses: the difference between the
residual of the calibrated model and that of the same campaign without the effect, relative to
the residual that noise alone leaves. Effects that only the logged torque shows are omitted
there.
""",
)
def draw_trials_power(scores: TrialScoresRecord) -> Figure:
    """Draw every trial by its effect and size, and the share found by what it does to poses."""
    trials = [trial for trial in scores.per_trial if trial.kind == "single"]
    if not trials:
        raise NothingToShowError("no trial hid one effect of the vocabulary")
    names = sorted({trial.hidden[0].id for trial in trials})
    markers = dict(zip(sorted({trial.layout for trial in trials}), cycle(_MARKERS), strict=False))
    height, below = _POWER_ROW_MM * len(names), 32.0 + 3.5 * ((len(markers) + 2) // 3)
    figure = style.new_figure(
        height + below + 15.0, "How large an effect must be: blind trials with one hidden effect"
    )
    by_size = style.panel(figure, 37.0, below, 60.0, height)
    _draw_sizes(by_size, trials, names, markers)
    for k, name in enumerate(names):
        curve = scores.power.by_id.get(name)
        if curve is not None and curve.most is not None:
            by_size.plot(curve.most, k, color=BLACK, marker="|", markersize=9.0, linestyle="none")
    _draw_moved(style.panel(figure, 112.0, below, 55.0, height), scores)
    layouts = "; ".join(f"{_MARKERS[marker]}: {layout}" for layout, marker in markers.items())
    layouts = fill(f"{layouts[0].upper()}{layouts[1:]}.", _LINE)
    style.note(
        figure,
        "Filled blue: named or in the alternatives; hollow red: neither; hollow grey: declared "
        f"not testable.\n{layouts}\n"
        "Upright dash: size found in 95 of 100. Right: effects that move poses, by how far the "
        "residual of the\ncalibrated baseline differs from that with nothing hidden (numbers: "
        "trials; bars: 95 % intervals; line: logistic;\ndotted: the residual is so many times "
        "the floor).",
    )
    return figure


def _draw_sizes(
    axes: Axes, trials: list[JudgedTrial], names: list[str], markers: dict[str, str]
) -> None:
    half = 0.5 * _SPREAD.get(len(markers), _WIDEST_SPREAD)
    offsets = dict(zip(markers, np.linspace(-half, half, len(markers)), strict=True))
    for trial in trials:
        hidden = trial.hidden[0]
        color = BLUE if hidden.listed else VERMILLION if hidden.testable else GREY
        axes.plot(
            hidden.size,
            names.index(hidden.id) + offsets[trial.layout],
            marker=markers[trial.layout],
            color=color,
            markerfacecolor=color if hidden.listed else "white",
            markersize=2.8,
            markeredgewidth=0.7,
        )
    style.plain_log(axes, "x", 0.085, 3.5)
    style.name_rows(axes, names)
    axes.set(xlabel="size, in the reference size of the effect", title="every trial")


def _draw_moved(axes: Axes, scores: TrialScoresRecord) -> None:
    for entry in scores.power.bins:
        if entry.listed.trials:
            x = np.sqrt(max(entry.low, _LOWEST) * (entry.high or _HIGHEST))
            _draw_share(axes, x, entry.listed)
            axes.text(x, -0.06, str(entry.listed.trials), ha="center", color=GREY)
    curve = scores.power.by_moved
    if curve is not None:
        moved = np.geomspace(_LOWEST, _HIGHEST, 200)
        axes.plot(moved, curve.at(moved), color=BLACK, linewidth=0.8)
    for ratio, side in _RATIOS.items():
        x = np.sqrt(ratio**2 - 1.0)
        axes.axvline(x, color=GREY, linewidth=0.8, linestyle=":")
        axes.text(x, 1.06, f" {ratio:g} × ", ha=side, color=GREY)
    style.plain_log(axes, "x", _LOWEST, _HIGHEST)
    axes.set_ylim(-0.1, 1.12)
    axes.set_yticks(np.linspace(0.0, 1.0, 6))
    axes.set_xlabel("residual moved, over the noise floor")
    axes.set_title("share named or in the alternatives")


# What became of what was put in, and the figures to reach.

#: Columns of the table of subjects, and the counts that they show.
_COLUMNS = {
    "crashed": "crashed",
    "refused": "refused",
    "false name": "false_name",
    "above the noise": "above_noise",
    "told": "told",
    "found": "found",
    "false comfort": "false_comfort",
    "worse held out": "worse",
    "unexplained": "unexplained",
    "suspect": "suspected",
}
#: Kinds of trials whose residuals are computed from the truth: those like measured robots.
_AS_MEASURED = ("unstated_masses", "sorted_rows", "mixed")
#: Kinds of trials that hide effects.
_HIDE_EFFECTS = ("effect", "beyond", *_AS_MEASURED)


@picture(
    title="Outcome for each stressor, fault and effect",
    needs=(),
    caption="""
Synthetic wild trials by what was put into their raw files ({name}): how many there are and crashed,
were refused before calibration, were given a false name (a confident one where a fault or an effect
outside the vocabulary is in them), had the fault reported or the effect named, got *none* although
an error above three times the noise is in them, predict held-out poses worse than before, were left
unexplained, or were called suspect. For unstated masses, sorted rows and mixed effects, effects
count as above the noise if they add half of it to the residual, and as told if named or listed.
""",
)
def tabulate_trials_subjects(scores: TrialScoresRecord) -> ResultTable:
    """Return a row a disturbance or an effect of wild trials."""
    if scores.measured != "wild":
        raise NothingToShowError("no trial disturbed its raw files")
    rows = []
    for subject in scores.subjects:
        counts: dict[str, int | str] = dict(subject.counts)
        if subject.kind not in _HIDE_EFFECTS:
            counts["found"] = ""
        what = subject.id.replace("_", " ")
        rows.append([subject.kind, what, subject.trials, *(counts[c] for c in _COLUMNS.values())])
    notes = []
    for trial in scores.per_trial:
        if trial.failings:
            hidden = [f"{hidden.id} of {hidden.of}" for hidden in trial.hidden]
            inside = "; ".join((*hidden, *trial.put_in)) or "nothing"
            failed = ", ".join(trial.failings)
            notes.append(f"{trial.campaign} ({trial.layout}, {inside}): {failed}: {trial.said}")
    data = frame_of(("kind", "put in", "trials", *_COLUMNS), rows)
    return ResultTable("Wild trials: outcomes", data, notes=tuple(notes))


_TOO_FEW = (
    "Too few to judge: one trial alone weighs more than the target leaves, and the interval holds "
    "the target."
)
_NOTES = (
    "Ratio: remaining position error of the calibrated model over that of noise alone, from the "
    "difference to the same campaign without the effect. A rotation about the last axis, a gain of "
    "the logged torque and friction at a rigid joint do not change it.",
    "Separable: distinguishable from every other name by the geometry of the poses alone. A map of "
    "a joint's error can represent any named error of that joint and is no alternative to one.",
    "A trial that failed counts against every target it belongs to.",
)
_NOTES_WILD = (
    "A fault is above the noise where it moves the residual of the calibrated model by more than "
    "three times what repeatability leaves, against the same campaign without it; faults of single "
    "rows, signs, zeros and units always are.",
    "Told: reported by kind and place in the faults of the verdict, by suspect_input, by a refusal "
    "before calibration, or, of a single reading, by quarantine or among the suspected outliers.",
    "A refusal after calibration counts as a crash.",
)
_NOTES_AS_MEASURED = (
    "The residual of an effect is computed from the truth: the readings without noise, with the "
    "effect and without it, less all motions of base, joint frames and tool; together with the "
    "noise it gives the ratio of residual to noise.",
    "Listed: as the name of an effect of the verdict, or among its alternatives. A name is wrong "
    "where neither it nor one of its alternatives is hidden.",
    "A motion is a fact where no joint, rail, load or order of the rows is named as another cause.",
)


@picture(
    title="Targets, and values reached",
    needs=(),
    caption="""
Targets in simulated trials, and the values reached ({name}); figures without a target follow. Each
trial is a simulated campaign with robot, poses, noise and hidden effects drawn at random; in wild
ones stressors of ordinary logs or faults are put into the raw files, or masses are not stated, or
rows are sorted. The verdict uses the raw files only and is compared with the truth afterwards. The
interval is that of a share of so many trials. A target that is missed is reported like any other.
The data are synthetic: rates hold for errors that the simulation can produce.
""",
)
def tabulate_trials_summary(scores: TrialScoresRecord) -> ResultTable:
    """Return a row a figure."""
    notes = _NOTES
    if scores.measured == "wild":
        kinds = {trial.kind for trial in scores.per_trial}
        notes = _NOTES_AS_MEASURED if kinds <= set(_AS_MEASURED) else _NOTES_WILD
    signs = {True: "≥ ", False: "≤ ", None: ""}
    data = frame_of(
        ("quantity", "of", "to reach", "reached", "95 % interval", "trials", "met"),
        [
            (
                row.what,
                row.by,
                signs[row.at_least] + ("" if row.limit is None else row.formatted(row.limit)),
                "" if row.reached is None else row.formatted(row.reached),
                row.interval if row.trials else "",
                row.trials,
                row.verdict,
            )
            for row in (*scores.bars, *scores.rates)
            if not row.what.startswith(_OF_PARAMETERS) or not row.by
        ],
    )
    return ResultTable("Trials: targets, and values reached", data, notes=(_TOO_FEW, *notes))
