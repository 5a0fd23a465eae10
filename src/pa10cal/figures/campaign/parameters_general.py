"""Every parameter of the general model, and those omitted because they are redundant."""

from __future__ import annotations

from collections.abc import Iterator

from pa10cal.figures.parameter_names import written
from pa10cal.figures.registry import Picture
from pa10cal.figures.results import Results
from pa10cal.figures.table import Row, Shown, Table, figures, frame_of, shown
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


def tabulate(results: Results) -> Table:
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
