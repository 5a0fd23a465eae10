"""Every figure that the paper states, and its Table I, beside the same from this campaign."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from operator import attrgetter

from pa10cal.figures import published
from pa10cal.figures.published import SOURCES, reduction_percent
from pa10cal.figures.registry import picture
from pa10cal.figures.results import COMBINED, Results, incompleteness
from pa10cal.figures.table import Table, frame_of
from pa10cal.reports.blocks import Grid, grid
from pa10cal.reports.formatting import (
    K_CUB,
    K_LIN,
    KINDS,
    Kind,
    figures,
    joints_of,
    std_of,
    written,
    written_load,
)
from pa10cal.results.calibration import PaperCalibrationRecord
from pa10cal.results.evaluation import Accuracy, HeldOutModel
from pa10cal.results.studies import PlaneRecord

NOT_MEASURED = "not measured"
NOT_COMPUTED = "not computed"
_ALONE = "calibrated at this load alone"
_TOGETHER = "one calibration of all loads"
_CALIBRATED = ("linear", "cubic")
#: Errors that the paper states: name, unit, digits of a mean over grid poses, and key.
_ERRORS = (
    ("mean position error", "mm", ".2f", attrgetter("mean_mm")),
    ("peak position error", "mm", ".2f", attrgetter("peak_mm")),
    ("mean orientation error", "deg", "g", attrgetter("orientation_deg")),
)


@dataclass(frozen=True)
class Compared:
    """One value of the paper."""

    quantity: str
    condition: str
    unit: str
    paper: str  # as printed
    ours: str  # from this campaign
    source: str  # where in the paper it stands
    remark: str = ""  # what to know before comparing
    recomputed: str = ""  # from the paper's other values, where it draws a conclusion from them


def compared(results: Results) -> Iterator[Compared]:
    """Yield a row for every value of the paper."""
    before = {load: errors.before for load, errors in results.calibration().errors.items()}
    after = {load: case.errors[load].after for load, case in results.load_cases().items()}
    return chain(
        _error_rows(results, before, after),
        _repeat_rows(results),
        _held_out_rows(results),
        _monte_carlo_rows(results),
        _parameter_rows(results),
        _apparatus_rows(results),
        _distance_rows(results, after),
        _reduction_rows(before, after),
        _peak_rows(results),
    )


def _loads(results: Results) -> list[str]:
    """Return the loads of the paper, then those that the campaign alone has."""
    stated = list(published.BEFORE)
    return stated + [load for load in results.load_cases() if load not in stated]


def _error_rows(
    results: Results, before: dict[str, Accuracy], after: dict[str, Accuracy]
) -> Iterator[Compared]:
    """Yield mean and peak position error and mean orientation error, before and after."""
    combined = results.calibration()
    together = {load: errors.after for load, errors in combined.errors.items()}
    alignment = (
        "nominal rigid model, base frame fitted once to the positions at "
        f"{min(combined.loads_fitted):g} N"
    )
    for name, unit, digits, value_of in _ERRORS:
        source = SOURCES["before_after" if unit == "mm" else "orientation"]
        for when, stated, ours, remark in (
            ("before calibration", published.BEFORE, before, alignment),
            ("after calibration", published.AFTER, after, _ALONE),
            ("after calibration", published.AFTER, together, _TOGETHER),
        ):
            for load in _loads(results):
                found, at = _measured(ours.get(load), value_of), written_load(load)
                paper = f"{value_of(stated[load]):{digits}}" if load in stated else ""
                where = source if load in stated else ""
                yield Compared(f"{name} {when}", at, unit, paper, found, where, remark)


def _repeat_rows(results: Results) -> Iterator[Compared]:
    """Yield the standard deviation within one configuration."""
    for load in _loads(results):
        bound_mm, scatter = published.REPEATABILITY_MM.get(load), results.scatter.get(load)
        if load not in results.load_cases():
            remark = "this load was not measured"
        elif scatter is None:
            remark = "no configuration was measured more than once"
        else:
            remark = (
                "along one axis, largest configuration: the paper's is that of a scalar error; "
                f"three axes together {_three_figures(scatter.largest_mm)}, mean over the "
                f"configurations {_three_figures(scatter.mean_mm)}"
            )
        quantity = "standard deviation within one configuration"
        ours = NOT_MEASURED if scatter is None else _three_figures(scatter.largest_per_axis_mm)
        paper = ("", "") if bound_mm is None else (f"≤ {bound_mm}", SOURCES["repeatability"])
        yield Compared(quantity, written_load(load), "mm", paper[0], ours, paper[1], remark)


def _held_out_rows(results: Results) -> Iterator[Compared]:
    """Yield mean, peak and orientation error of each model at the held-out points."""
    models = results.held_out().models
    for name, stated in published.HELD_OUT.items():
        model = models.get(name)
        for quantity, unit, _, value_of in _ERRORS:
            paper, ours = f"{value_of(stated):g}", _measured(model, value_of)
            remark = _twist_remark(results, model) if model and unit == "deg" else ""
            source = SOURCES["held_out"]
            yield Compared(f"{quantity}, held out", name, unit, paper, ours, source, remark)


def _twist_remark(results: Results, model: HeldOutModel) -> str:
    """Return how much of an orientation error one constant twist of the tool explains."""
    twist = model.tool_twist
    if twist is None:
        return ""
    share = _reduction(twist.before_deg, twist.after_deg)
    calibration = results.held_out().calibration
    evaluated = results.calibration(calibration)
    angles = [evaluated.errors[f"{N:g}N"].after.orientation_deg for N in evaluated.loads_fitted]
    known = [angle for angle in angles if angle is not None]
    mean = _three_figures(sum(known) / len(known)) if known else NOT_MEASURED
    return (
        f"a constant tool twist of {_three_figures(twist.angle_deg)} deg would leave "
        f"{_three_figures(twist.after_deg)} deg and so explains {share} % of it; "
        f"the evaluated calibration ({calibration}) leaves {mean} deg on its poses"
    )


def _paper_plane(results: Results) -> PlaneRecord | None:
    """Return the plane of the paper's Monte Carlo result, None where it was not run."""
    planes = {plane.plane_mm: plane for plane in results.planes()}
    return planes.get(published.MONTE_CARLO_PLANE_MM)


def _monte_carlo_rows(results: Results) -> Iterator[Compared]:
    """Yield what resolver uncertainty alone does to the position."""
    plane, source = _paper_plane(results), SOURCES["monte_carlo"]
    at = f"z = {published.MONTE_CARLO_PLANE_MM} mm"
    mean, std, between = [NOT_COMPUTED, NOT_COMPUTED, ""]
    if plane is not None:
        mean, std = _three_figures(plane.mean_mm), _three_figures(plane.std_mm)
        between = f"within a position; between positions {_three_figures(plane.std_between_mm)}"
    for quantity, paper, ours, remark in (
        ("mean position error", published.MONTE_CARLO_MEAN_MM, mean, _systematic_remark(results)),
        ("standard deviation", published.MONTE_CARLO_STD_MM, std, between),
    ):
        yield Compared(f"Monte Carlo {quantity}", at, "mm", f"{paper}", ours, source, remark)
    others = {other.plane_mm: other for other in results.planes()}
    for z_mm in published.MONTE_CARLO_PARALLEL_PLANES_MM:
        ours, remark = NOT_COMPUTED, ""
        if plane is not None and (other := others.get(z_mm)) is not None:
            ours = f"{abs(other.mean_mm - plane.mean_mm):.4f}"
            remark = _difference_remark(plane, other)
        quantity = "Monte Carlo mean, difference of a parallel plane"
        paper_mm = f"< {published.MONTE_CARLO_PLANES_DIFFER_MM}"
        yield Compared(quantity, f"z = {z_mm} mm", "mm", paper_mm, ours, source, remark)


def _difference_remark(plane: PlaneRecord, other: PlaneRecord) -> str:
    """Return whether two parallel planes differ as little as the paper says, and why not."""
    text = (
        "95 % interval of each mean for the choice of positions: "
        f"± {other.half_width95_positions_mm:.4f}"
    )
    if abs(other.mean_mm - plane.mean_mm) < published.MONTE_CARLO_PLANES_DIFFER_MM:
        return text
    reason = ""
    if other.rejected_positions != plane.rejected_positions:
        reason = (
            "the ring of positions is cut where the arm does not reach: "
            f"{other.rejected_positions} positions were drawn again in this plane, "
            f"{plane.rejected_positions} in that at {plane.plane_mm} mm; "
        )
    return f"does not reproduce: {reason}{text}"


def _systematic_remark(results: Results) -> str:
    """Say why the Monte Carlo is a lower bound in the paper's sense only."""
    text = (
        "resolver error repeats with the joint angles, so it is systematic and in principle "
        "calibratable: a lower bound only in the paper's sense"
    )
    plane = _paper_plane(results)
    if plane is None or not results.scatter:
        return text
    scatter_mm = max(scatter.mean_mm for scatter in results.scatter.values())
    return (
        f"{text}; repeats scatter by {_three_figures(scatter_mm)} mm on average, "
        f"{_three_figures(plane.mean_mm / scatter_mm)} times less"
    )


def _parameter_rows(results: Results) -> Iterator[Compared]:
    """Yield the number of unknowns and the stiffness coefficients."""
    case, reading = results.calibration(), results.settings.kcub_reading
    remark = (
        "the paper counts 24 link parameters with 6 stiffnesses, then with 6 of the base frame; "
        "together they are 36"
    )
    ours = f"{case.unknowns}, of which {case.rank} identifiable"
    yield Compared("unknowns", "all loads together", "", "30", ours, SOURCES["unknowns"], remark)
    for kind, unit, stated, source in (
        ("K_lin", "N m/rad", published.K_LIN, SOURCES["k_lin"]),
        ("K_cub", "N m/rad³", published.K_CUB[reading], SOURCES[reading]),
    ):
        for joint, value in stated.items():
            parameter = case.parameters.get(f"{kind}_{joint}")
            ours, remark = "not estimated", "held rigid"
            if parameter is not None:
                ours = _with_uncertainty(parameter.value, std_of(parameter))
                remark = "± one standard uncertainty; all loads together"
                remark += "; at its bound" if parameter.at_bound else ""
            paper = f"{value:.2e}".replace("e+0", "e")
            yield Compared(kind, f"joint {joint}", unit, paper, ours, source, remark)


def _apparatus_rows(results: Results) -> Iterator[Compared]:
    """Yield what limits the measurement itself."""
    quantity, at = "uncertainty of the coordinate measuring machine", "one measured centre"
    ours = f"{results.description.instrument.uncertainty_mm:g}"
    paper, remark = f"{published.CMM_UNCERTAINTY_MM}", "ours: as the campaign states it"
    yield Compared(quantity, at, "mm", paper, ours, SOURCES["cmm"], remark)
    for quantity, paper in (
        ("sag of the apparatus under its own weight", f"{published.APPARATUS_SAG_MM:.3f}"),
        ("deflection by the touch of the probe", f"< {published.TOUCH_DEFLECTION_MM}"),
    ):
        yield Compared(quantity, "largest", "mm", paper, NOT_MEASURED, SOURCES["apparatus"])


def _distance_rows(results: Results, after: dict[str, Accuracy]) -> Iterator[Compared]:
    """Yield how far errors after calibration are from the Monte Carlo mean."""
    plane = _paper_plane(results)
    for load, stated in published.AFTER.items():
        ours, remark = (NOT_MEASURED if load not in after else NOT_COMPUTED), ""
        if load in after and plane is not None:
            distance_mm = after[load].mean_mm - plane.mean_mm
            ours = f"{distance_mm:.2f}"
            if distance_mm < 0.0:
                remark = (
                    "below the Monte Carlo mean: these data hold less resolver error than it "
                    "assumes, or the calibration has absorbed it"
                )
        quantity = "mean error after calibration less the Monte Carlo mean"
        paper = f"< {published.CLAIMED_DISTANCE_FROM_MINIMUM_MM}"
        recomputed = f"{stated.mean_mm - published.MONTE_CARLO_MEAN_MM:.2f}"
        at, source = written_load(load), SOURCES["conclusion"]
        yield Compared(quantity, at, "mm", paper, ours, source, remark, recomputed)


def _reduction_rows(before: dict[str, Accuracy], after: dict[str, Accuracy]) -> Iterator[Compared]:
    """Yield by how much calibration reduced the mean errors."""
    low, high = published.CLAIMED_REDUCTIONS_PERCENT
    for load, stated in published.AFTER.items():
        ours = NOT_MEASURED
        if load in before and load in after:
            ours = _reduction(before[load].mean_mm, after[load].mean_mm)
        yield Compared(
            *("reduction of the mean position error", written_load(load), "%"),
            *(f"{low} to {high}", ours, SOURCES["conclusion"]),
            recomputed=_reduction(published.BEFORE[load].mean_mm, stated.mean_mm),
        )


def _peak_rows(results: Results) -> Iterator[Compared]:
    """Yield by how much calibration reduced the held-out peak errors."""
    stated, models = published.HELD_OUT, results.held_out().models
    for name in _CALIBRATED:
        ours = NOT_MEASURED
        if "uncalibrated" in models and name in models:
            ours = _reduction(models["uncalibrated"].peak_mm, models[name].peak_mm)
        yield Compared(
            *("reduction of the peak position error, held out", name, "%"),
            *(f"≥ {published.CLAIMED_PEAK_REDUCTION_PERCENT}", ours, SOURCES["held_out"]),
            recomputed=_reduction(stated["uncalibrated"].peak_mm, stated[name].peak_mm),
        )


def _reduction(before: float, after: float) -> str:
    """Return by how much an error fell, in percent of what it was."""
    return f"{reduction_percent(before, after):.0f}"


def _measured(errors: Accuracy | None, value_of: attrgetter[float | None]) -> str:
    """Return a value of errors with three significant figures, or that it was not measured."""
    value = None if errors is None else value_of(errors)
    return NOT_MEASURED if value is None else _three_figures(value)


def _three_figures(value: float) -> str:
    return f"{value:#.3g}".rstrip(".")


def _with_uncertainty(value: float, std: float) -> str:
    """Return a large number and its standard uncertainty with one power of ten."""
    power = math.floor(math.log10(max(abs(value), std)))
    return f"({value / 10.0**power:.3f} ± {std / 10.0**power:.3f})e{power}"


_COLUMNS = ("quantity", "condition", "unit", "paper", "recomputed", "ours", "source", "remark")
_NOTES = (
    "recomputed: what the paper's own values give, where it draws a conclusion from them.",
    "ours: from this campaign alone; the arm of a synthetic campaign is not the one that the "
    "authors measured.",
)


@picture(
    title="Paper against ours",
    needs=("papers_calibration", "evaluation", "planes", "poses"),
    caption="""
Every value that the paper states, with its place there, beside the same quantity from
``{name}``. Where the paper draws a conclusion from its own values, the column *recomputed*
holds what they give. *Remark* says how our value was obtained and what limits the comparison; a
quantity that the campaign does not state is called not measured. Loads that the paper does not
have stand below those it has. Agreement shows that the method is implemented as published; it
says nothing about the robot of the authors.
""",
)
def tabulate_paper_against_ours(results: Results) -> Table:
    """Return the paper's values with ours."""
    data = frame_of(_COLUMNS, map(attrgetter(*_COLUMNS), compared(results)))
    lacking = incompleteness(results.calibration(), results.scatter)
    notes = _NOTES if lacking is None else (*_NOTES, lacking)
    return Table("The paper's values beside ours", data, notes=notes)


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
            [row for load, case in cases.items() for row in _table1_rows(load, case, results)],
        ),
        shown=tuple(_layout(load, case, results) for load, case in cases.items()),
        notes=_table1_notes(combined, results),
    )


def _table1_rows(
    load: str, case: PaperCalibrationRecord, results: Results
) -> Iterator[tuple[object, ...]]:
    for kind in KINDS:
        for joint in joints_of(kind, list(case.parameters)):
            name = kind.name(joint)
            found = case.parameters[name]
            values = (found.value, found.std, results.published(name), found.tolerance)
            numbers = [figures(value, 6) for value in values]
            yield (load, name, joint, found.unit, *numbers, found.identifiable, found.at_bound)


def _layout(load: str, case: PaperCalibrationRecord, results: Results) -> Grid:
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
    return grid(caption, header, zip(*columns, strict=True))


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


def _table1_notes(case: PaperCalibrationRecord, results: Results) -> tuple[str, ...]:
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
    lacking = incompleteness(case, results.scatter)
    return tuple(notes) if lacking is None else (*notes, lacking)
