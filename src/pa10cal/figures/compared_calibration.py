"""Rows on the calibration: errors, repeats, orientation, stiffness, apparatus."""

from __future__ import annotations

from collections.abc import Callable

from pa10cal.figures import published
from pa10cal.figures.compared import (
    NOT_MEASURED,
    Compared,
    Found,
    measured,
    three_figures,
    with_uncertainty,
)
from pa10cal.figures.parameter_names import std_of, written_load
from pa10cal.figures.published import PublishedError
from pa10cal.results.accuracy import Accuracy

_ALONE = "calibrated at this load alone"
_TOGETHER = "one calibration of all loads"

Errors = Accuracy | PublishedError


def error_rows(found: Found) -> list[Compared]:
    """Return mean and peak position error and mean orientation error, before and after."""
    return [
        row
        for name, unit, digits, figure_of in _FIGURES
        for when, stated, ours_of, remark in (
            ("before calibration", published.BEFORE, found.before, found.alignment),
            ("after calibration", published.AFTER, found.after, _ALONE),
            ("after calibration", published.AFTER, found.after_combined, _TOGETHER),
        )
        for row in (
            Compared(
                quantity=f"{name} {when}",
                condition=written_load(load),
                unit=unit,
                paper=f"{figure_of(stated[load]):{digits}}" if load in stated else "",
                ours=_or_not_measured(ours_of(load), figure_of),
                source=published.SOURCES["before_after" if unit == "mm" else "orientation"]
                if load in stated
                else "",
                remark=remark,
            )
            for load in found.loads
        )
    ]


_FIGURES: tuple[tuple[str, str, str, Callable[[Errors], float | None]], ...] = (
    ("mean position error", "mm", ".2f", lambda errors: errors.mean_mm),
    ("peak position error", "mm", ".2f", lambda errors: errors.peak_mm),
    ("mean orientation error", "deg", "g", lambda errors: errors.orientation_deg),
)


def repeat_rows(found: Found) -> list[Compared]:
    """Return the standard deviation within one configuration."""
    rows = []
    for load in found.loads:
        bound_mm = published.REPEATABILITY_MM.get(load)
        scatter = found.scatter.get(load)
        if load not in found.cases:
            remark = "this load was not measured"
        elif scatter is None:
            remark = "no configuration was measured more than once"
        else:
            remark = (
                "along one axis, largest configuration: the paper's is that of a scalar error; "
                f"three axes together {three_figures(scatter.largest_mm)}, mean over the "
                f"configurations {three_figures(scatter.mean_mm)}"
            )
        rows.append(
            Compared(
                quantity="standard deviation within one configuration",
                condition=written_load(load),
                unit="mm",
                paper="" if bound_mm is None else f"≤ {bound_mm}",
                ours=NOT_MEASURED
                if scatter is None
                else three_figures(scatter.largest_per_axis_mm),
                source="" if bound_mm is None else published.SOURCES["repeatability"],
                remark=remark,
            )
        )
    return rows


def parameter_rows(found: Found) -> list[Compared]:
    """Return the number of unknowns and the stiffness coefficients."""
    case = found.combined
    rows = [
        Compared(
            quantity="unknowns",
            condition="all loads together",
            unit="",
            paper="30",
            ours=f"{case.unknowns}, of which {case.rank} identifiable",
            source=published.SOURCES["unknowns"],
            remark="the paper counts 24 link parameters with 6 stiffnesses, then with 6 of the "
            "base frame; together they are 36",
        )
    ]
    stiffness = (
        ("K_lin", "N m/rad", published.K_LIN, published.SOURCES["k_lin"]),
        (
            "K_cub",
            "N m/rad³",
            published.K_CUB[found.kcub_reading],
            published.SOURCES[found.kcub_reading],
        ),
    )
    for kind, unit, stated, source in stiffness:
        for joint, value in stated.items():
            parameter = case.parameters.get(f"{kind}_{joint}")
            ours, remark = "not estimated", "held rigid"
            if parameter is not None:
                ours = with_uncertainty(parameter.value, std_of(parameter))
                remark = "± one standard uncertainty; all loads together"
                if parameter.at_bound:
                    remark += "; at the end of the physical range"
            rows.append(
                Compared(
                    quantity=kind,
                    condition=f"joint {joint}",
                    unit=unit,
                    paper=f"{value:.2e}".replace("e+0", "e"),
                    ours=ours,
                    source=source,
                    remark=remark,
                )
            )
    return rows


def apparatus_rows(found: Found) -> list[Compared]:
    """Return what limits the measurement itself."""
    source = published.SOURCES["apparatus"]
    return [
        Compared(
            quantity="uncertainty of the coordinate measuring machine",
            condition="one measured centre",
            unit="mm",
            paper=f"{published.CMM_UNCERTAINTY_MM}",
            ours=f"{found.instrument_uncertainty_mm:g}",
            source=published.SOURCES["cmm"],
            remark="ours: as the campaign states it",
        ),
        Compared(
            quantity="sag of the apparatus under its own weight",
            condition="largest",
            unit="mm",
            paper=f"{published.APPARATUS_SAG_MM:.3f}",
            ours=NOT_MEASURED,
            source=source,
        ),
        Compared(
            quantity="deflection by the touch of the probe",
            condition="largest",
            unit="mm",
            paper=f"< {published.TOUCH_DEFLECTION_MM}",
            ours=NOT_MEASURED,
            source=source,
        ),
    ]


def _or_not_measured(errors: Accuracy | None, figure_of: Callable[[Errors], float | None]) -> str:
    return measured(None if errors is None else figure_of(errors))
