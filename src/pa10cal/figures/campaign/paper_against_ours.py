"""Every figure that the paper states, and its Table I, beside the same from this campaign."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator, Mapping
from typing import NamedTuple

import pandas as pd

from pa10cal.figures import published
from pa10cal.figures.campaign.paper_figures import places, scatter_by_load
from pa10cal.figures.published import SOURCES, is_of_papers_arm, reduction_percent
from pa10cal.figures.registry import NothingToShowError, picture
from pa10cal.figures.table import ResultTable, figures, frame_of
from pa10cal.reports.blocks import Grid, grid
from pa10cal.reports.formatting import KINDS, ParameterKind, display_name, written_load
from pa10cal.reports.results_bundle import COMBINED, ResultsBundle
from pa10cal.results.calibration import CalibratedParameter, PaperCalibrationRecord
from pa10cal.results.evaluation import Accuracy, HeldOutModel

NOT_MEASURED = "not measured"
NOT_COMPUTED = "not computed"
_COLUMNS = ("quantity", "condition", "unit", "paper", "recomputed", "ours", "source", "remark")
_NOTES = (
    "recomputed: what the paper's own values give, where it draws a conclusion from them.",
    "ours: from this campaign alone; the arm of a synthetic campaign is not the one that the "
    "authors measured.",
)


class _Error(NamedTuple):
    """An error that the paper states."""

    name: str
    unit: str
    digits: str  # format of the paper's value over grid poses
    key: str  # of records
    source: str  # where in the paper it stands over grid poses, by its key in `SOURCES`


_ERRORS = (
    _Error("mean position error", "mm", ".2f", "mean_mm", "before_after"),
    _Error("peak position error", "mm", ".2f", "peak_mm", "before_after"),
    _Error("mean orientation error", "deg", "g", "orientation_deg", "orientation"),
)


class _Row(NamedTuple):
    """One value of the paper beside ours."""

    quantity: str
    condition: str
    unit: str
    paper: object  # as printed
    ours: str  # from this campaign
    source: str  # where in the paper it stands, by its key in `SOURCES`
    remark: str = ""  # what to know before comparing
    recomputed: str = ""  # from the paper's other values, where it draws a conclusion from them


@picture(
    title="Paper against ours",
    needs=("papers_calibration", "evaluation", "planes", "poses"),
    caption="""
Every value that the paper states, with its place there, beside the same quantity from
``{name}``. Where the paper draws a conclusion from its own values, the column *recomputed*
has the value that follows from them. *Remark* states how our value was obtained and what limits
the comparison; a quantity that the campaign does not state is called not measured. Agreement
shows that the method is implemented as published; it says nothing about the robot of the authors.
""",
)
def tabulate_paper_against_ours(results: ResultsBundle) -> ResultTable:
    """Return the paper's values with ours, in `_COLUMNS`.

    Raises:
        RecordError: when the calibration is not of the paper's model.
        NothingToShowError: when the arm is not the paper's.
    """
    results.paper_calibration()  # of another model there is none
    if not is_of_papers_arm(results):
        raise NothingToShowError("the arm is not the paper's")
    scatter = scatter_by_load(places(results))
    rows = [
        *_grid_rows(results, scatter),
        *_held_out_rows(results),
        *_monte_carlo_rows(results, scatter),
        *_parameter_rows(results),
        *_conclusion_rows(results),
    ]
    data = pd.DataFrame(row._replace(source=SOURCES[row.source]) for row in rows).astype(str)
    notes = (*_NOTES, *_incompleteness(results))
    return ResultTable("The paper's values beside ours", data[list(_COLUMNS)], notes=notes)


def _grid_rows(results: ResultsBundle, scatter: pd.DataFrame) -> Iterator[_Row]:
    """Yield errors before and after, and the scatter within one configuration, at each load."""
    combined, cases = results.paper_calibration(), results.load_cases()
    before = {load: errors.before for load, errors in combined.errors.items()}
    alone = {load: case.errors[load].after for load, case in cases.items()}
    together = {load: errors.after for load, errors in combined.errors.items()}
    alignment = (
        "nominal rigid model, base frame fitted once to the positions at "
        f"{min(combined.loads_fitted):g} N"
    )
    for error in _ERRORS:
        for when, stated, ours, remark in (
            ("before calibration", published.BEFORE, before, alignment),
            ("after calibration", published.AFTER, alone, "calibrated at this load alone"),
            ("after calibration", published.AFTER, together, "one calibration of all loads"),
        ):
            for load, of in stated.items():
                found = _measured(ours.get(load), error.key)
                if load in together and load not in ours:  # too few poses for a fit of their own
                    found = NOT_COMPUTED
                yield _Row(
                    quantity=f"{error.name} {when}",
                    condition=written_load(load),
                    unit=error.unit,
                    paper=f"{getattr(of, error.key):{error.digits}}",
                    ours=found,
                    source=error.source,
                    remark=remark,
                )
    scatter_mm = scatter.to_dict("index")
    for load in published.REPEATABILITY_MM:
        yield _scatter_row(load, scatter_mm.get(load), measured=load in together)


def _scatter_row(load: str, scatter_mm: Mapping[Hashable, float] | None, *, measured: bool) -> _Row:
    """Return the row of the scatter within one configuration at a load; None for no repeats."""
    found, remark = NOT_MEASURED, "no configuration was measured more than once"
    if not measured:
        remark = "this load was not measured"
    elif scatter_mm is not None:
        found = _three_figures(scatter_mm["largest_per_axis"])
        remark = (
            "along one axis, largest configuration: the paper's is that of a scalar error; "
            f"three axes together {_three_figures(scatter_mm['largest'])}, "
            f"mean over the configurations {_three_figures(scatter_mm['mean'])}"
        )
    return _Row(
        quantity="standard deviation within one configuration",
        condition=written_load(load),
        unit="mm",
        paper=f"≤ {published.REPEATABILITY_MM[load]}",
        ours=found,
        source="repeatability",
        remark=remark,
    )


def _held_out_rows(results: ResultsBundle) -> Iterator[_Row]:
    """Yield mean, peak and orientation error of each model at the held-out points."""
    held_out = results.sound_held_out()
    for name, stated in published.HELD_OUT.items():
        model = held_out.models.get(name)
        for error in _ERRORS:
            yield _Row(
                quantity=f"{error.name}, held out",
                condition=name,
                unit=error.unit,
                paper=f"{getattr(stated, error.key):g}",
                ours=_measured(model, error.key),
                source="held_out",
                remark=_twist_remark(results, model) if model and error.unit == "deg" else "",
            )


def _twist_remark(results: ResultsBundle, model: HeldOutModel) -> str:
    """Return how much of an orientation error one constant twist of the tool explains."""
    twist = model.tool_twist
    if twist is None:
        return ""
    calibration = results.sound_held_out().calibration
    evaluated = results.paper_calibration(calibration)
    angles = [evaluated.errors[f"{N:g}N"].after.orientation_deg for N in evaluated.loads_fitted]
    known = [angle for angle in angles if angle is not None]
    mean = _three_figures(sum(known) / len(known)) if known else NOT_MEASURED
    return (
        f"a constant tool twist of {_three_figures(twist.angle_deg)} deg would leave "
        f"{_three_figures(twist.after_deg)} deg and so explains "
        f"{reduction_percent(twist.before_deg, twist.after_deg):.0f} % of it; "
        f"the evaluated calibration ({calibration}) leaves {mean} deg on its poses"
    )


def _monte_carlo_rows(results: ResultsBundle, scatter: pd.DataFrame) -> Iterator[_Row]:
    """Yield what resolver uncertainty alone does to the position."""
    planes = {of.plane_mm: of for of in results.planes_of_settings()}
    plane = planes.get(published.MONTE_CARLO_PLANE_MM)
    at, source = f"z = {published.MONTE_CARLO_PLANE_MM} mm", "monte_carlo"
    mean, std, between = NOT_COMPUTED, NOT_COMPUTED, ""
    systematic = (
        "resolver error repeats with the joint angles, so it is systematic and in principle "
        "calibratable: a lower bound only in the paper's sense"
    )
    if plane is not None:
        mean, std = _three_figures(plane.mean_mm), _three_figures(plane.std_mm)
        between = f"within a position; between positions {_three_figures(plane.std_between_mm)}"
        if len(scatter):
            scatter_mm = scatter["mean"].max()
            systematic += f"; repeats scatter by {_three_figures(scatter_mm)} mm on average"
            if 0.0 < scatter_mm < plane.mean_mm:
                systematic += f", {_three_figures(plane.mean_mm / scatter_mm)} times less"
    paper_mm = published.MONTE_CARLO_MEAN_MM, published.MONTE_CARLO_STD_MM
    quantity = "Monte Carlo mean position error"
    yield _Row(quantity, at, "mm", paper_mm[0], mean, source, systematic)
    yield _Row("Monte Carlo standard deviation", at, "mm", paper_mm[1], std, source, between)
    for z_mm in published.MONTE_CARLO_PARALLEL_PLANES_MM:
        ours, remark = NOT_COMPUTED, ""
        if plane is not None and (other := planes.get(z_mm)) is not None:
            apart_mm = abs(other.mean_mm - plane.mean_mm)
            ours = f"{apart_mm:.4f}"
            by_choice_mm = math.hypot(
                other.half_width95_positions_mm, plane.half_width95_positions_mm
            )
            remark = (
                f"95 % interval of the difference for the choice of positions: ± {by_choice_mm:.4f}"
            )
            if apart_mm >= max(published.MONTE_CARLO_PLANES_DIFFER_MM, by_choice_mm):
                reason = ""
                if other.rejected_positions != plane.rejected_positions:
                    reason = (
                        "the ring of positions is cut where the arm does not reach: "
                        f"{other.rejected_positions} positions were drawn again in this plane, "
                        f"{plane.rejected_positions} in that at {plane.plane_mm} mm; "
                    )
                remark = f"does not reproduce: {reason}{remark}"
        quantity = "Monte Carlo mean, difference of a parallel plane"
        differ = f"< {published.MONTE_CARLO_PLANES_DIFFER_MM}"
        yield _Row(quantity, f"z = {z_mm} mm", "mm", differ, ours, source, remark)


def _parameter_rows(results: ResultsBundle) -> Iterator[_Row]:
    """Yield the number of unknowns, the stiffnesses, and what limits the measurement itself."""
    assert results.description is not None
    case, reading = results.paper_calibration(), results.settings.kcub_reading
    remark = (
        "the paper counts 24 link parameters with 6 stiffnesses, then with 6 of the base frame; "
        "together they are 36"
    )
    ours = f"{case.unknowns}, of which {case.rank} identifiable"
    yield _Row("unknowns", "all loads together", "", 30, ours, "unknowns", remark)
    for kind, unit, stated, source in (
        ("K_lin", "N m/rad", published.K_LIN, "k_lin"),
        ("K_cub", "N m/rad³", published.K_CUB[reading], reading),
    ):
        for joint, value in stated.items():
            parameter = case.parameters.get(f"{kind}_{joint}")
            ours, remark = "not estimated", "held rigid"
            if parameter is not None:
                ours = _with_power(parameter.value, parameter.std)
                remark = "" if parameter.std is None else "± one standard uncertainty; "
                remark += "all loads together"
                remark += "; at its bound" if parameter.at_bound else ""
                remark += "" if parameter.identifiable else "; not identifiable from the poses"
            paper = f"{value:.2e}".replace("e+0", "e")
            yield _Row(kind, f"joint {joint}", unit, paper, ours, source, remark)
    quantity, at = "uncertainty of the coordinate measuring machine", "one measured centre"
    uncertainties = (
        published.CMM_UNCERTAINTY_MM,
        f"{results.description.instrument.uncertainty_mm:g}",
    )
    yield _Row(quantity, at, "mm", *uncertainties, "cmm", "ours: as the campaign states it")
    for quantity, paper in (
        ("sag of the apparatus under its own weight", f"{published.APPARATUS_SAG_MM:.3f}"),
        ("deflection by the touch of the probe", f"< {published.TOUCH_DEFLECTION_MM}"),
    ):
        yield _Row(quantity, "largest", "mm", paper, NOT_MEASURED, "apparatus")


def _with_power(value: float, std: float | None) -> str:
    """Return a value and its standard uncertainty, if known, with a common power of ten."""
    largest = max(abs(value), std or 0.0)
    power = math.floor(math.log10(largest)) if largest > 0.0 else 0
    number = f"{value / 10.0**power:.3f}"
    return f"{number}e{power}" if std is None else f"({number} ± {std / 10.0**power:.3f})e{power}"


def _conclusion_rows(results: ResultsBundle) -> Iterator[_Row]:
    """Yield distance from the Monte Carlo mean, reductions of mean and of held-out peak errors."""
    after = {load: case.errors[load].after.mean_mm for load, case in results.load_cases().items()}
    measured = results.paper_calibration().errors
    planes = {of.plane_mm: of for of in results.planes_of_settings()}
    plane = planes.get(published.MONTE_CARLO_PLANE_MM)
    for load, stated in published.AFTER.items():
        ours, remark = (NOT_COMPUTED if load in measured else NOT_MEASURED), ""
        if load in after and plane is not None:
            distance_mm = after[load] - plane.mean_mm
            ours = f"{distance_mm:.2f}"
            if distance_mm < 0.0:
                remark = (
                    "below the Monte Carlo mean: these data hold less resolver error than it "
                    "assumes, or the calibration has absorbed it"
                )
        yield _Row(
            quantity="mean error after calibration less the Monte Carlo mean",
            condition=written_load(load),
            unit="mm",
            paper=f"< {published.CLAIMED_DISTANCE_FROM_MINIMUM_MM}",
            ours=ours,
            source="conclusion",
            remark=remark,
            recomputed=f"{stated.mean_mm - published.MONTE_CARLO_MEAN_MM:.2f}",
        )
    before = {
        load: errors.before.mean_mm for load, errors in results.paper_calibration().errors.items()
    }
    low, high = published.CLAIMED_REDUCTIONS_PERCENT
    for load, stated in published.AFTER.items():
        yield _Row(
            quantity="reduction of the mean position error",
            condition=written_load(load),
            unit="%",
            paper=f"{low} to {high}",
            ours=_reduction(before.get(load), after.get(load)),
            source="conclusion",
            recomputed=_reduction(published.BEFORE[load].mean_mm, stated.mean_mm),
        )
    peaks_mm = {name: model.peak_mm for name, model in results.sound_held_out().models.items()}
    stated_peaks_mm = {name: of.peak_mm for name, of in published.HELD_OUT.items()}
    for name in ("linear", "cubic"):
        yield _Row(
            quantity="reduction of the peak position error, held out",
            condition=name,
            unit="%",
            paper=f"≥ {published.CLAIMED_PEAK_REDUCTION_PERCENT}",
            ours=_reduction(peaks_mm.get("uncalibrated"), peaks_mm.get(name)),
            source="held_out",
            recomputed=_reduction(stated_peaks_mm["uncalibrated"], stated_peaks_mm[name]),
        )


def _reduction(before_mm: float | None, after_mm: float | None) -> str:
    """Return by how many percent an error fell; None before: not measured; after: not computed."""
    if before_mm is None:
        return NOT_MEASURED
    if after_mm is None:
        return NOT_COMPUTED
    return f"{reduction_percent(before_mm, after_mm):.0f}"


def _incompleteness(results: ResultsBundle) -> Iterator[str]:
    """Yield that ± does not cover what the model lacks, where it is graded so."""
    if results.paper_calibration().health.grade == "incomplete":
        yield "The calibration is graded incomplete: ± does not cover the effect that it lacks."


def _measured(errors: Accuracy | None, key: str) -> str:
    """Return a value of errors with three significant figures, or that it was not measured."""
    value = getattr(errors, key, None)
    return NOT_MEASURED if value is None else _three_figures(value)


def _three_figures(value: float) -> str:
    return f"{value:#.3g}".rstrip(".")


# Table I of the paper beside what was found, all loads together and load by load.

_NOT_IDENTIFIABLE = "†"
_AT_BOUND = "‡"
_RIGID = "∞"
_NONE = "n/a"
_HEADER_OF_TABLE1 = (
    *("calibration", "parameter", "joint", "unit", "value", "std", "paper", "tolerance"),
    *("identifiable", "at_bound"),
)


@picture(
    title="Table I: parameters",
    needs=("papers_calibration", "poses"),
    caption="""
Table I of the paper beside the parameters of ``{name}``, from all loads together and from each
load alone, with standard uncertainties. The CSV holds SI units, one row a parameter; Markdown
and HTML have the paper's layout. A parameter that is not identifiable is determined by its
tolerance alone and says nothing about the arm. A parameter at its bound is a stiffness that the
data would make negative, as happens when the model lacks an effect, or cannot tell from that.
The paper gives its cubic stiffness twice, a power of ten apart; the setting ``kcub_reading``
selects the value shown. The paper's values belong to the arm that its authors measured. The arm
of the shipped campaign lightcap2008 is simulated with Table I, so a difference there is an
estimation error.
""",
)
def tabulate_table1_parameters(results: ResultsBundle) -> ResultTable:
    """Return every link and spring parameter of every calibration, the paper's beside the first."""
    combined, of_papers_arm = results.paper_calibration(), is_of_papers_arm(results)
    cases = {COMBINED: combined} | results.load_cases()
    stated: dict[str, float | None] = {}
    if of_papers_arm:
        reading = results.settings.kcub_reading
        stated = {name: published.parameter(name, reading) for name in combined.parameters}
    rows: list[tuple[object, ...]] = []
    for load, case in cases.items():
        for _, joint, name in _names(case):
            found = case.parameters[name]
            values = (found.value, found.std, stated.get(name), found.tolerance)
            numbers = [figures(value, 6) for value in values]
            flags = found.identifiable, found.at_bound
            rows.append((load, name, joint, found.unit, *numbers, *flags))
    together = (" with ".join(map(display_name, names)) for names in combined.null_directions)
    directions = "; ".join(together)
    notes = [
        "± is one standard uncertainty.",
        f"{_NOT_IDENTIFIABLE} not identifiable from the poses: the tolerance terms alone determine "
        f"it. Null directions, all loads together: {directions or 'none'}.",
        f"{_AT_BOUND} at its bound: the stiffness that fits the data best is not positive, or "
        "cannot be told from that.",
        f"{_RIGID} rigid joint; {_NONE} the row has no such parameter.",
    ]
    if of_papers_arm:
        place = {"text_e7": "its Section III.B (1e7)", "table_e8": "its Table I (1e8)"}
        notes += [
            "The paper's K_cub is given twice, a power of ten apart; here it is that of "
            f"{place[results.settings.kcub_reading]}.",
            "The paper's values belong to the arm that its authors measured; the arm of a "
            "synthetic campaign need not share them.",
        ]
    return ResultTable(
        title="Parameters beside Table I of the paper",
        data=frame_of(_HEADER_OF_TABLE1, rows),
        shown=tuple(
            _layout(load, case, stated if of_papers_arm and load == COMBINED else None)
            for load, case in cases.items()
        ),
        notes=(*notes, *_incompleteness(results)),
    )


def _names(case: PaperCalibrationRecord) -> list[tuple[str, int, str]]:
    """Return kind, joint and name of every parameter of a joint, kind by kind."""
    parts = [(*name.rpartition("_")[::2], name) for name in case.parameters]
    order = list(KINDS)
    of_joints = [(key, int(joint), name) for key, joint, name in parts if key in KINDS]
    return sorted(of_joints, key=lambda part: (order.index(part[0]), part[1]))


def _layout(
    load: str, case: PaperCalibrationRecord, stated: Mapping[str, float | None] | None
) -> Grid:
    """Lay the parameters out as Table I does: a row a joint, ours and the paper's beside it."""
    joints = sorted({joint for _, joint, _ in _names(case)})
    header, columns = ["joint"], [[str(joint) for joint in joints]]
    for key, kind in KINDS.items():
        absent = _RIGID if key in ("K_lin", "K_cub") else _NONE
        header.append(f"{kind.symbol} [{kind.unit}]")
        columns.append([absent] * len(joints))
        for k, joint in enumerate(joints):
            if (parameter := case.parameters.get(f"{key}_{joint}")) is not None:
                columns[-1][k] = _cell(parameter, kind)
        if stated is not None:
            values = [stated.get(f"{key}_{joint}") for joint in joints]
            header.append("paper")
            columns.append([absent if v is None else f"{kind.scale * v:.4g}" for v in values])
    caption = "All loads together" if load == COMBINED else f"{written_load(load)} alone"
    return grid(caption, header, zip(*columns, strict=True))


def _cell(parameter: CalibratedParameter, kind: ParameterKind) -> str:
    """Return a value in the unit of its kind, with its standard uncertainty or a mark."""
    value = f"{kind.scale * parameter.value:{kind.digits}}"
    value = value.lstrip("-") if float(value) == 0.0 else value
    if not parameter.identifiable:
        return f"{value} {_NOT_IDENTIFIABLE}"
    std = parameter.std
    uncertainty = "" if std is None else f" ± {kind.scale * std:{kind.digits}}"
    return f"{value}{uncertainty}{f' {_AT_BOUND}' if parameter.at_bound else ''}"
