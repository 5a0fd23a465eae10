"""Parameters in pictures and tables: of the general model, the paper's, each campaign's."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pa10cal.arrays import Array
from pa10cal.figures.registry import NothingToShowError, picture
from pa10cal.figures.results import COMBINED, Results, incompleteness, scatter_by_load
from pa10cal.figures.style import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    PAPER,
    VERMILLION,
    name_rows,
    new_figure,
    panel,
    plain_log,
    write_beside,
    write_text_at,
)
from pa10cal.figures.table import (
    K_CUB,
    K_LIN,
    KINDS,
    LINKS,
    Kind,
    Row,
    Shown,
    Table,
    figures,
    frame_of,
    joints_of,
    shown,
    std_of,
    written,
    written_load,
)
from pa10cal.results.calibration import (
    CalibratedParameter,
    GeneralCalibrationRecord,
    PaperCalibrationRecord,
    Redundant,
)

_HEADER = (
    "parameter",
    "unit",
    "value",
    "std",
    "tolerance",
    "identifiable",
    "at_bound",
    "redundant",
    "replaced_by",
)
_SHOWN_HEADER = ("parameter", "value", "std", "unit", "tolerance", "remark")
#: Units to show: their name, by how much a value is multiplied, and how it is written.
_UNITS = {
    "m": ("mm", 1e3, ".4f"),
    "rad": ("mrad", 1e3, ".4f"),
    "N m/rad": ("kN m/rad", 1e-3, ".2f"),
}
_GROUPS = (
    ("Links: departures from the description", "delta_"),
    ("Springs of the joints", "K_"),
    ("Target or tool, in the end-effector frame", "t"),
    ("Base frame: the instrument's origin p in it, and rotations γ to the instrument's axes", ""),
)
_TORQUES = {
    "logged": "Joint springs use the logged torques.",
    "masses": "No torques were logged: joint springs use the torques of the described masses.",
    "none": "No torques are known, so there are no springs.",
}


@picture(
    title="Parameters of the general model",
    needs=("general",),
    caption="""
Every parameter of the general model of ``{name}`` with its standard uncertainty: departures of
the links from the description, joint stiffness, tool or targets, and base. The set is complete
and minimal: every direction that arm and instrument can identify is there, and a redundant
parameter is omitted; the last table says which parameters take its place. A parameter marked as
not identifiable could be identified by arm and instrument, but not from these poses. Values far
beyond their tolerance indicate a defective part, or an effect that the model lacks. The CSV
holds SI units.
""",
)
def tabulate_parameters_general(results: Results) -> Table:
    """Return every parameter with its uncertainty, and the replacement of each redundant one."""
    case = results.general()
    return Table(
        title="Parameters of the general model",
        data=frame_of(_HEADER, _data_rows(case)),
        shown=tuple(_shown(case)),
        notes=(
            f"Rank {case.health.rank} of {case.health.unknowns} unknowns. std is one standard "
            "uncertainty, from the scatter of the poses about the model; the CSV is in SI units.",
            "A redundant parameter has exactly the effect of others, for this arm and instrument "
            "in any pose, and is omitted. One unit of it equals the combination beside it.",
            _TORQUES[case.torques_from],
        ),
    )


def _shown(case: GeneralCalibrationRecord) -> Iterator[Shown]:
    remaining = dict(case.parameters)
    for title, begin in _GROUPS:
        group = {name: remaining.pop(name) for name in list(remaining) if name.startswith(begin)}
        if group:
            rows = [_row(name, parameter) for name, parameter in group.items()]
            yield shown(_SHOWN_HEADER, rows, title)
    if case.redundant:
        rows = [(written(entry.name), _combination(entry)) for entry in case.redundant]
        yield shown(("omitted", "the same as"), rows, "Omitted: redundant parameters")


def _row(name: str, parameter: CalibratedParameter) -> Row:
    unit, scale, digits = _UNITS.get(parameter.unit, (parameter.unit, 1.0, ".4g"))
    tolerance = "–" if parameter.tolerance is None else f"{scale * parameter.tolerance:g}"
    if parameter.at_bound:
        return (written(name), "rigid", "–", unit, tolerance, "at a bound")
    value = f"{scale * parameter.value + 0.0:{digits}}"
    if not parameter.identifiable:
        return (written(name), value, "–", unit, tolerance, "not identifiable")
    std = "–" if parameter.std is None else f"{scale * parameter.std:{digits}}"
    return (written(name), value, std, unit, tolerance, "")


def _combination(entry: Redundant) -> str:
    parts = [f"{part:.4g} × {written(name)}" for name, part in entry.replaced_by.items()]
    return " + ".join(parts).replace("+ -", "− ") or "nothing: it has no effect"


def _data_rows(case: GeneralCalibrationRecord) -> Iterator[tuple[object, ...]]:
    for name, found in case.parameters.items():
        numbers = (figures(found.value, 8), figures(found.std, 4), figures(found.tolerance, 6))
        words = (str(found.identifiable).lower(), str(found.at_bound).lower(), "false", "")
        yield (name, found.unit, *numbers, *words)
    for entry in case.redundant:
        by = "; ".join(f"{part:.6g} {name}" for name, part in entry.replaced_by.items())
        yield (entry.name, "", None, None, None, "", "", "true", by)


# Which campaign of a group determines which parameter, and whether they agree.

_UNITS_OF_BY_CAMPAIGN = {"m": ("mm", 1e3), "rad": ("mrad", 1e3)}


@picture(
    title="Parameters by campaign",
    needs=("general",),
    caption="""
The parameters of the robot that all campaigns of ``{name}`` share, each with its standard
uncertainty by all of them together and by each campaign alone, with base, tool and targets its
own. A parameter that one campaign leaves open may be determined by another. The second table
holds each campaign against all others: the chi-square of what they differ by, and the one
parameter that explains most of it.
""",
)
def tabulate_parameters_by_campaign(results: Results) -> Table:
    """Return where every shared parameter comes from, and each campaign against the others."""
    group = results.general().group
    if group is None:
        raise NothingToShowError("it is one campaign")
    names = tuple(group.campaigns)
    rows, cells = [], []
    for name, found in group.parameters.items():
        unit, scale = _UNITS_OF_BY_CAMPAIGN.get(found.unit, (found.unit, 1.0))
        alone = [found.std_alone[each] for each in names]
        by = ", ".join(found.determined_by) or "all together"
        rows.append((name, found.unit, figures(found.std, 4), *(figures(x, 4) for x in alone), by))
        told = [
            f"{scale * x:.4f}" if each in found.determined_by else "–"
            for each, x in zip(names, alone, strict=True)
        ]
        cells.append((written(name), unit, f"{scale * found.std:.4f}", *told, by))
    compared = []
    for name, each in group.campaigns.items():
        unit, scale = _UNITS_OF_BY_CAMPAIGN.get(each.worst.unit, (each.worst.unit, 1.0))
        off, u = scale * each.worst.value, scale * each.worst.std
        compared.append(
            (
                name,
                str(each.poses),
                f"{each.rms_mm:.3f}",
                f"{each.alone_rms_mm:.3f}",
                f"{each.chi_square:.1f} for {each.dof:.0f}",
                f"{each.p_value:.2g}",
                f"{written(each.worst.name)}: {off:.3g} ± {u:.2g} {unit}",
                "yes" if each.contradicts else "no",
            )
        )
    header = ("parameter", "unit", "std", *(f"std {name}" for name in names), "determined by")
    against = ("campaign", "poses", "rms [mm]", "alone [mm]", "χ²", "p", "most by", "contradicts")
    return Table(
        title="Parameters by campaign",
        data=frame_of(header, rows),
        shown=(shown(header, cells), shown(against, compared, "Each campaign against the others")),
        notes=(
            "std: one standard uncertainty; a dash where the campaign alone does not determine "
            "the parameter. The CSV is in SI units.",
            "Campaigns contradict each other where chance does not explain the difference and "
            "parameters of its own take away a tenth of a campaign's squared error.",
        ),
    )


# Every parameter with its uncertainty, beside Table I of the paper.

_HALF_WIDTH_95 = 1.96
_OPEN = VERMILLION
_FOUND: dict[str, Any] = {"color": BLUE, "marker": "o"}
_UNIDENTIFIABLE: dict[str, Any] = {"color": _OPEN, "marker": "s", "markerfacecolor": "white"}
_ROW_MM = 3.8
#: Room for what is said of the model below the legend.
_NOTE_MM = 8.0
_BELOW_MM = 72.0 + _NOTE_MM
_ABOVE_MM = 10.0
_TITLE = "Parameters from all loads together, with 95 % intervals, beside Table I of the paper"


@dataclass(frozen=True)
class _Row:
    """Where a link parameter is drawn, counted downward."""

    y: int
    kind: Kind
    joint: int

    @property
    def name(self) -> str:
        return self.kind.name(self.joint)


@picture(
    title="Parameters and their uncertainty",
    needs=("papers_calibration", "poses"),
    caption="""
Parameters of ``{name}`` from all loads together, beside Table I of the paper (diamonds). Above
left, departures of the links from nominal in units of their manufacturing tolerance. Above
right, half the 95 % interval (blue), and how much the estimate changes with the choice of the
poses that determine the base frame (orange). Where orange is much larger than blue, the model
lacks an effect and the interval is too small. Parameters in red are not identifiable: they
cannot be separated from the base frame, and their tolerance alone determines them. Below,
stiffness and base frame. The paper's values belong to the arm that its authors measured. The
arm of the shipped campaign lightcap2008 is simulated with Table I, so a difference there is an
estimation error.
""",
)
def draw_parameter_uncertainty(results: Results) -> Figure:
    """Draw departures in units of their tolerance, stiffness, and the base frame."""
    case = results.calibration()
    headings, rows = _lay_out(list(case.parameters))
    height = _ROW_MM * (len(headings) + len(rows) + 0.5)
    total = _BELOW_MM + height + _ABOVE_MM
    figure = new_figure(total, _TITLE)
    values = panel(figure, 14.0, _BELOW_MM, 82.0, height)
    widths = panel(figure, 106.0, _BELOW_MM, 61.0, height)
    _draw_values(values, headings, rows, case, results)
    _draw_widths(widths, rows, case)
    for axes in (values, widths):
        axes.set_ylim(len(headings) + len(rows) - 0.5, -0.7)
        axes.set_yticks([row.y for row in rows], [row.kind.written(row.joint) for row in rows])
        axes.tick_params(axis="y", length=0.0)
    widths.tick_params(labelleft=False)
    for label, row in zip(values.yaxis.get_ticklabels(), rows, strict=True):
        label.set_color(BLACK if case.parameters[row.name].identifiable else _OPEN)
    bottom, tall = 29.0 + _NOTE_MM, 25.0
    _draw_stiffness(panel(figure, 22.0, bottom, 40.0, tall), K_LIN, case, results)
    _draw_stiffness(panel(figure, 76.0, bottom, 40.0, tall), K_CUB, case, results)
    _draw_base(panel(figure, 137.0, bottom, 30.0, tall), case)
    figure.legend(
        handles=_legend(case, results),
        loc="lower left",
        bbox_to_anchor=(0.012, (6.0 + _NOTE_MM) / total),
        ncols=2,
    )
    lacking = incompleteness(case, scatter_by_load(results.places()))
    if lacking is not None:
        write_text_at(figure, 2.0, 6.0, lacking.replace(": ", ":\n"))
    return figure


def _lay_out(names: list[str]) -> tuple[dict[int, Kind], list[_Row]]:
    """Return the places of the headings, one a kind of link parameter, and of the parameters."""
    headings: dict[int, Kind] = {}
    rows: list[_Row] = []
    for kind in LINKS:
        joints = joints_of(kind, names)
        top = len(headings) + len(rows)
        if joints:
            headings[top] = kind
        rows += [_Row(top + k, kind, joint) for k, joint in enumerate(joints, start=1)]
    return headings, rows


def _draw_values(
    axes: Axes,
    headings: dict[int, Kind],
    rows: list[_Row],
    case: PaperCalibrationRecord,
    results: Results,
) -> None:
    _draw_parameters(
        axes,
        [row.name for row in rows],
        np.array([row.y for row in rows]),
        np.array([_tolerance(case, row) for row in rows]),
        case,
        results,
    )
    for y, kind in headings.items():
        first = next(row for row in rows if row.kind is kind)
        tolerance = kind.scale * _tolerance(case, first)
        said = f"{kind.title} {kind.symbol}, tolerance {tolerance:g} {kind.unit}"
        bare = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}
        write_beside(axes, y + 0.1, said, 0.01, color=GREY, bbox=bare)
    axes.axvline(0.0, color=GREY, linewidth=0.6)
    axes.set_xlabel("departure from nominal / tolerance")


def _draw_widths(axes: Axes, rows: list[_Row], case: PaperCalibrationRecord) -> None:
    known = [row for row in rows if case.parameters[row.name].identifiable]
    y = [row.y for row in known]
    per_tolerance = _HALF_WIDTH_95 / np.array([_tolerance(case, row) for row in known])
    half = per_tolerance * [std_of(case.parameters[row.name]) for row in known]
    spread = per_tolerance * [case.inner_dependence.std[row.name] for row in known]
    axes.plot(spread, y, color=ORANGE, marker="^", linestyle="none")
    axes.plot(half, y, color=BLUE, marker="o", linestyle="none")
    for row in rows:
        if row not in known:
            write_beside(axes, row.y, "not identifiable: set by the tolerance", 0.03, color=_OPEN)
    shown = np.concatenate([half, spread])
    shown = shown[shown > 0.0]
    if len(shown):
        plain_log(axes, "x", shown.min() / 1.5, shown.max() * 1.5)
    axes.set_xlabel("half width of the 95 % interval / tolerance")


def _tolerance(case: PaperCalibrationRecord, row: _Row) -> float:
    """Return the tolerance of a link parameter; every one has one."""
    return case.parameters[row.name].tolerance or 1.0


def _draw_parameters(
    axes: Axes,
    names: list[str],
    y: Array,
    unit: Array,
    case: PaperCalibrationRecord,
    results: Results,
) -> None:
    """Draw values with their intervals, and the paper's values behind them.

    Args:
        axes: to draw into.
        names: of n parameters.
        y: (n,) where each is drawn.
        unit: (n,) what each is measured in.
        case: the calibration.
        results: gives the paper's values.
    """
    parameters = [case.parameters[name] for name in names]
    value = np.array([parameter.value for parameter in parameters]) / unit
    half = _HALF_WIDTH_95 * np.array([std_of(parameter) for parameter in parameters]) / unit
    is_open = np.array([not parameter.identifiable for parameter in parameters], dtype=bool)
    at_bound = np.array([parameter.at_bound for parameter in parameters], dtype=bool) & ~is_open
    for rows, look in (
        (~is_open & ~at_bound, _FOUND),
        (at_bound, _FOUND | {"markerfacecolor": "white"}),
        (is_open, _UNIDENTIFIABLE),
    ):
        if rows.any():
            axes.errorbar(
                value[rows], y[rows], xerr=half[rows], linestyle="none", capsize=2.0, **look
            )
    stated = np.array([results.published(name) for name in names], dtype=float)
    axes.plot(stated / unit, y, linestyle="none", zorder=1.9, **PAPER)


def _draw_stiffness(axes: Axes, kind: Kind, case: PaperCalibrationRecord, results: Results) -> None:
    joints = joints_of(kind, list(case.parameters))
    axes.set_title(kind.title)
    if not joints:
        axes.text(0.5, 0.5, "all joints held rigid", transform=axes.transAxes, ha="center")
        axes.set(xticks=[], yticks=[])
        return
    names = [kind.name(joint) for joint in joints]
    y = np.arange(len(joints), dtype=float)
    _draw_parameters(axes, names, y, np.full(len(joints), 1.0 / kind.scale), case, results)
    for name, at in zip(names, y, strict=True):
        spread = _HALF_WIDTH_95 * case.inner_dependence.std[name]
        # A stiffness is not negative, whatever its spread.
        ends = np.maximum(case.parameters[name].value + np.array([-spread, spread]), 0.0)
        axes.plot(kind.scale * ends, [at + 0.3, at + 0.3], color=ORANGE, linewidth=2.0)
    labels = [
        f"joint {joint}" + ("\nat bound" if case.parameters[kind.name(joint)].at_bound else "")
        for joint in joints
    ]
    name_rows(axes, labels, 0.6)
    axes.set_xlabel(f"{kind.symbol} [{kind.unit}]")


def _draw_base(axes: Axes, case: PaperCalibrationRecord) -> None:
    """Draw the half widths of the base frame's intervals; the paper states no values."""
    shown = {
        "x [µm]": "base_p_cmm_x",
        "y [µm]": "base_p_cmm_y",
        "z [µm]": "base_p_cmm_z",
        "γx [µrad]": "gamma_x",
        "γy [µrad]": "gamma_y",
        "γz [µrad]": "gamma_z",
    }
    half = [1e6 * _HALF_WIDTH_95 * std_of(case.parameters[name]) for name in shown.values()]
    axes.plot(half, range(len(shown)), color=BLUE, marker="o", linestyle="none")
    name_rows(axes, list(shown))
    axes.set_xlim(0.0, 1.15 * max(half))
    axes.set_title("base frame")
    axes.set_xlabel("half width of interval")


def _legend(case: PaperCalibrationRecord, results: Results) -> list[Line2D]:
    choices = case.inner_dependence.choices
    entries: list[tuple[str, dict[str, Any]]] = [
        ("found, with 95 % interval", _FOUND | {"linestyle": "-"}),
        ("not identifiable from the poses", _UNIDENTIFIABLE | {"linestyle": "-"}),
        (
            f"1.96 × spread over {choices} choices of inner poses",
            {"color": ORANGE, "marker": "^", "linestyle": "-"},
        ),
    ]
    if results.is_paper_arm:
        entries.append(("the paper's arm (Table I)", PAPER | {"linestyle": "none"}))
    return [Line2D([], [], label=label, **look) for label, look in entries]


# Table I of the paper beside what was found, all loads together and load by load.

_NOT_IDENTIFIABLE = "†"
_AT_BOUND = "‡"
_RIGID = "∞"
_NONE = "n/a"
_HEADER_OF_TABLE1 = (
    "calibration",
    "parameter",
    "joint",
    "unit",
    "value",
    "std",
    "paper",
    "tolerance",
    "identifiable",
    "at_bound",
)


@picture(
    title="Table I: parameters",
    needs=("papers_calibration", "poses"),
    caption="""
Table I of the paper beside the parameters of ``{name}``, from all loads together and from each
load alone, with standard uncertainties. The CSV holds SI units, one row a parameter; Markdown
and HTML have the paper's layout. A parameter that is not identifiable is determined by its
tolerance alone and says nothing about the arm. A parameter at its bound is a stiffness that the
data would make negative, as happens when the model lacks an effect. The paper gives its cubic
stiffness twice, a power of ten apart; the setting ``kcub_reading`` selects the value shown. The
paper's values belong to the arm that its authors measured. The arm of the shipped campaign
lightcap2008 is simulated with Table I, so a difference there is an estimation error.
""",
)
def tabulate_table1_parameters(results: Results) -> Table:
    """Return every link and spring parameter of every calibration, the paper's beside the first."""
    combined = results.calibration()
    cases = {COMBINED: combined} | results.load_cases()
    return Table(
        title="Parameters beside Table I of the paper",
        data=frame_of(
            _HEADER_OF_TABLE1,
            [row for load, case in cases.items() for row in _rows(load, case, results)],
        ),
        shown=tuple(_layout(load, case, results) for load, case in cases.items()),
        notes=_notes(combined, results),
    )


def _rows(
    load: str, case: PaperCalibrationRecord, results: Results
) -> Iterator[tuple[object, ...]]:
    for kind in KINDS:
        for joint in joints_of(kind, list(case.parameters)):
            name = kind.name(joint)
            found = case.parameters[name]
            numbers = (found.value, found.std, results.published(name), found.tolerance)
            yield (
                load,
                name,
                joint,
                found.unit,
                *(figures(number, 6) for number in numbers),
                found.identifiable,
                found.at_bound,
            )


def _layout(load: str, case: PaperCalibrationRecord, results: Results) -> Shown:
    """Lay the parameters out as Table I does: a row a joint, ours and the paper's beside it."""
    with_paper = results.is_paper_arm and load == COMBINED
    names = list(case.parameters)
    joints = sorted({joint for kind in KINDS for joint in joints_of(kind, names)})
    header, columns = ["joint"], [[str(joint) for joint in joints]]
    for kind in KINDS:
        header.append(f"{kind.symbol} [{kind.unit}]")
        columns.append([_cell(kind, joint, case) for joint in joints])
        if with_paper:
            header.append("paper")
            columns.append([_paper_cell(kind, joint, results) for joint in joints])
    caption = "All loads together" if load == COMBINED else f"{written_load(load)} alone"
    return shown(header, zip(*columns, strict=True), caption)


def _cell(kind: Kind, joint: int, case: PaperCalibrationRecord) -> str:
    parameter = case.parameters.get(kind.name(joint))
    if parameter is None:
        return _absent(kind)
    value = _number(kind.scale * parameter.value, kind.digits)
    if not parameter.identifiable:
        return f"{value} {_NOT_IDENTIFIABLE}"
    text = f"{value} ± {_number(kind.scale * std_of(parameter), kind.digits)}"
    return f"{text} {_AT_BOUND}" if parameter.at_bound else text


def _paper_cell(kind: Kind, joint: int, results: Results) -> str:
    published = results.published(kind.name(joint))
    return _absent(kind) if published is None else f"{kind.scale * published:.4g}"


def _absent(kind: Kind) -> str:
    return _RIGID if kind in (K_LIN, K_CUB) else _NONE


def _number(value: float, digits: str) -> str:
    text = f"{value:{digits}}"
    return text.lstrip("-") if float(text) == 0.0 else text


def _notes(case: PaperCalibrationRecord, results: Results) -> tuple[str, ...]:
    unidentified_directions = "; ".join(
        " with ".join(map(written, names)) for names in case.null_directions
    )
    notes = [
        "± is one standard uncertainty.",
        f"{_NOT_IDENTIFIABLE} not identifiable from the poses: the tolerance terms alone determine "
        f"it. Null directions, all loads together: {unidentified_directions or 'none'}.",
        f"{_AT_BOUND} at its bound: the stiffness that fits the data best is not positive.",
        f"{_RIGID} rigid joint; {_NONE} the row has no such parameter.",
    ]
    if results.is_paper_arm:
        place = {"text_e7": "its Section III.B (1e7)", "table_e8": "its Table I (1e8)"}
        notes += [
            "The paper's K_cub is given twice, a power of ten apart; here it is that of "
            f"{place[results.settings.kcub_reading]}.",
            "The paper's values belong to the arm that its authors measured; the arm of a "
            "synthetic campaign need not share them.",
        ]
    lacking = incompleteness(case, scatter_by_load(results.places()))
    return tuple(notes) if lacking is None else (*notes, lacking)
