"""Table I of the paper beside what was found, all loads together and load by load."""

from __future__ import annotations

from collections.abc import Iterator

from pa10cal.figures.parameter_names import (
    K_CUB,
    K_LIN,
    KINDS,
    Kind,
    joints_of,
    std_of,
    written,
    written_load,
)
from pa10cal.figures.registry import Picture
from pa10cal.figures.repeats import incompleteness, scatter_by_load
from pa10cal.figures.results import COMBINED, Results
from pa10cal.figures.table import Shown, Table, figures, frame_of, shown
from pa10cal.results.calibration import PaperCalibrationRecord

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
_RIGID = "∞"
_NONE = "n/a"
_HEADER = (
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
    return Table(
        title="Parameters beside Table I of the paper",
        data=frame_of(
            _HEADER, [row for load, case in cases.items() for row in _rows(load, case, results)]
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
