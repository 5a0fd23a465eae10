"""Table I of the paper beside what was found, all loads together and load by load."""

from __future__ import annotations

from pa10cal.figures.parameter_names import (
    K_CUB,
    K_LIN,
    KINDS,
    Kind,
    joints_of,
    std_of,
    written_load,
)
from pa10cal.figures.registry import Picture
from pa10cal.figures.repeats import incompleteness, scatter_by_load
from pa10cal.figures.results import COMBINED, Results
from pa10cal.figures.table import Grid, Row, Table
from pa10cal.results.calibration import CalibratedParameter, PaperCalibrationRecord

PICTURE = Picture(
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

_NOT_IDENTIFIABLE = "†"
_AT_BOUND = "‡"
_TOGETHER = "All loads together"
_RIGID = "∞"
_NONE = "n/a"
_DATA_HEADER: Row = (
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


def tabulate(results: Results) -> Table:
    """Return every link and spring parameter of every calibration, the paper's beside the first."""
    combined = results.calibration()
    cases = {COMBINED: combined} | results.load_cases()
    grids = [
        _grid(
            case,
            results,
            _TOGETHER if load == COMBINED else f"{written_load(load)} alone",
        )
        for load, case in cases.items()
    ]
    return Table(
        title="Parameters beside Table I of the paper",
        data=Grid(
            header=_DATA_HEADER,
            rows=tuple(
                row for load, case in cases.items() for row in _data_rows(load, case, results)
            ),
        ),
        shown=tuple(grids),
        notes=_notes(combined, results),
    )


def _data_rows(load: str, case: PaperCalibrationRecord, results: Results) -> list[Row]:
    names = list(case.parameters)
    return [
        _data_row(load, kind.name(joint), joint, case.parameters[kind.name(joint)], results)
        for kind in KINDS
        for joint in joints_of(kind, names)
    ]


def _data_row(
    load: str, name: str, joint: int, parameter: CalibratedParameter, results: Results
) -> Row:
    published = results.published(name)
    return (
        load,
        name,
        str(joint),
        parameter.unit,
        f"{parameter.value:.6g}",
        f"{parameter.std:.6g}",
        "" if published is None else f"{published:.6g}",
        "" if parameter.tolerance is None else f"{parameter.tolerance:g}",
        str(parameter.identifiable).lower(),
        str(parameter.at_bound).lower(),
    )


def _grid(case: PaperCalibrationRecord, results: Results, caption: str) -> Grid:
    """Lay the parameters out as Table I does: a row a joint, ours and the paper's beside it."""
    with_paper = results.is_paper_arm and case.load == COMBINED
    names = list(case.parameters)
    joints = sorted({joint for kind in KINDS for joint in joints_of(kind, names)})
    header: list[str] = ["joint"]
    for kind in KINDS:
        header.append(f"{kind.symbol.rstrip(',')} [{kind.unit}]")
        if with_paper:
            header.append("paper")
    rows = []
    for joint in joints:
        row = [str(joint)]
        for kind in KINDS:
            row.append(_cell(kind, joint, case))
            if with_paper:
                row.append(_paper_cell(kind, joint, results))
        rows.append(tuple(row))
    return Grid(tuple(header), tuple(rows), caption)


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
    unidentified_directions = "; ".join(" with ".join(names) for names in case.null_directions)
    notes = [
        "± is one standard uncertainty.",
        f"{_NOT_IDENTIFIABLE} the poses cannot tell this parameter from others; the tolerance "
        f"terms alone settle it. Directions left open, all loads together: "
        f"{unidentified_directions or 'none'}.",
        f"{_AT_BOUND} at the end of the physical range: the data ask for a stiffness that is not "
        "positive.",
        f"{_RIGID} joints held rigid; {_NONE} the row has no such parameter.",
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
