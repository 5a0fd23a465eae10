"""Every parameter of the general model, and those left out because others say the same."""

from __future__ import annotations

from collections.abc import Iterator

from pa10cal.figures.parameter_names import written
from pa10cal.figures.registry import Picture
from pa10cal.figures.results import Results
from pa10cal.figures.table import Grid, Row, Table
from pa10cal.results.calibration import CalibratedParameter, GeneralCalibrationRecord, Redundant

PICTURE = Picture(
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

_DATA_HEADER: Row = (
    "parameter",
    "unit",
    "value",
    "std",
    "tolerance",
    "identifiable",
    "at_bound",
    "left_out",
    "said_by",
)
_SHOWN_HEADER: Row = ("parameter", "value", "std", "unit", "tolerance", "remark")
#: Units to show: their name, by how much a value is multiplied, and how it is written.
_SHOWN = {
    "m": ("mm", 1e3, ".4f"),
    "rad": ("mrad", 1e3, ".4f"),
    "N m/rad": ("kN m/rad", 1e-3, ".2f"),
}
_GROUPS = (
    ("Links: departures from the description", "delta_"),
    ("Springs of the joints", "K_"),
    ("Target or tool, in the end-effector frame", "t"),
    ("Base frame: the instrument's origin p in it, and turns γ to the instrument's axes", ""),
)
_TORQUES = {
    "logged": "Springs are under the torques logged.",
    "masses": "No torques were logged: springs are under those of the masses described.",
    "none": "No torques are known, so there are no springs.",
}


def tabulate(results: Results) -> Table:
    """Return every parameter with its uncertainty, and what each one left out repeats."""
    case = results.general()
    return Table(
        title="Parameters of the general model",
        data=Grid(_DATA_HEADER, tuple(_data_rows(case))),
        shown=tuple(_grids(case)),
        notes=tuple(_notes(case)),
    )


def _grids(case: GeneralCalibrationRecord) -> Iterator[Grid]:
    left = dict(case.parameters)
    for title, begin in _GROUPS:
        group = {name: left.pop(name) for name in list(left) if name.startswith(begin)}
        if group:
            rows = tuple(_row(name, parameter) for name, parameter in group.items())
            yield Grid(_SHOWN_HEADER, rows, title)
    if case.redundant:
        rows = tuple((written(entry.name), _said(entry)) for entry in case.redundant)
        yield Grid(("left out", "the same as"), rows, "Left out: others say the same")


def _row(name: str, parameter: CalibratedParameter) -> Row:
    unit, scale, digits = _SHOWN.get(parameter.unit, (parameter.unit, 1.0, ".4g"))
    tolerance = "–" if parameter.tolerance is None else f"{scale * parameter.tolerance:g}"
    if parameter.at_bound:
        return (written(name), "rigid", "–", unit, tolerance, "at the end of its range")
    value = f"{scale * parameter.value + 0.0:{digits}}"
    if not parameter.identifiable:
        return (written(name), value, "–", unit, tolerance, "left open")
    std = "–" if parameter.std is None else f"{scale * parameter.std:{digits}}"
    return (written(name), value, std, unit, tolerance, "")


def _said(entry: Redundant) -> str:
    parts = [f"{part:.4g} × {written(name)}" for name, part in entry.said_by.items()]
    return " + ".join(parts).replace("+ -", "− ") or "nothing: it does not show"


def _data_rows(case: GeneralCalibrationRecord) -> Iterator[Row]:
    for name, parameter in case.parameters.items():
        yield (
            name,
            parameter.unit,
            f"{parameter.value:.8g}",
            "" if parameter.std is None else f"{parameter.std:.4g}",
            "" if parameter.tolerance is None else f"{parameter.tolerance:g}",
            str(parameter.identifiable).lower(),
            str(parameter.at_bound).lower(),
            "false",
            "",
        )
    for entry in case.redundant:
        said_by = "; ".join(f"{part:.6g} {name}" for name, part in entry.said_by.items())
        yield (entry.name, "", "", "", "", "", "", "true", said_by)


def _notes(case: GeneralCalibrationRecord) -> Iterator[str]:
    health = case.health
    yield (
        f"Rank {health.rank} of {health.unknowns} unknowns. std is one standard uncertainty, from "
        "the scatter of the poses about the model; the CSV is in SI units."
    )
    yield (
        "A parameter that always does the same as others is left out: arm and instrument decide "
        "that, not the poses. For one unit of it the others change by what stands beside it."
    )
    yield _TORQUES[case.torques_from]
