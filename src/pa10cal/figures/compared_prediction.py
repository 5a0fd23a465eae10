"""Rows on what the model is good for: held-out points, Monte Carlo, the paper's conclusions."""

from __future__ import annotations

from collections.abc import Callable

from pa10cal.figures import published
from pa10cal.figures.compared import (
    NOT_COMPUTED,
    NOT_MEASURED,
    Compared,
    Found,
    measured,
    three_figures,
)
from pa10cal.figures.parameter_names import written_load
from pa10cal.figures.published import PublishedError, reduction_percent
from pa10cal.results.evaluation import HeldOutModel
from pa10cal.results.montecarlo import PlaneRecord

_CALIBRATED = ("linear", "cubic")
_FIGURES: tuple[tuple[str, str, Callable[[HeldOutModel | PublishedError], float | None]], ...] = (
    ("mean position error, held out", "mm", lambda errors: errors.mean_mm),
    ("peak position error, held out", "mm", lambda errors: errors.peak_mm),
    ("mean orientation error, held out", "deg", lambda errors: errors.orientation_deg),
)


def held_out_rows(found: Found) -> list[Compared]:
    """Return mean, peak and orientation error of each model on the held-out points."""
    rows = []
    for name, stated in published.HELD_OUT.items():
        model = found.held_out.models.get(name)
        for quantity, unit, figure_of in _FIGURES:
            is_orientation = unit == "deg"
            rows.append(
                Compared(
                    quantity=quantity,
                    condition=name,
                    unit=unit,
                    paper=f"{figure_of(stated):g}",
                    ours=measured(None if model is None else figure_of(model)),
                    source=published.SOURCES["held_out"],
                    remark=_twist_remark(found, model) if model and is_orientation else "",
                )
            )
    return rows


def _twist_remark(found: Found, model: HeldOutModel) -> str:
    """Say how much of an orientation error one constant twist of the tool explains."""
    twist = model.tool_twist
    if twist is None:
        return ""
    share = reduction_percent(twist.before_deg, twist.after_deg)
    evaluated = found.evaluated
    left_deg = [
        evaluated.errors[f"{load:g}N"].after.orientation_deg for load in evaluated.loads_fitted
    ]
    calibrated = [angle for angle in left_deg if angle is not None]
    mean_deg = sum(calibrated) / len(calibrated) if calibrated else None
    return (
        f"a constant tool twist of {three_figures(twist.angle_deg)} deg would leave "
        f"{three_figures(twist.after_deg)} deg and so explains {share:.0f} % of it; "
        f"the evaluated calibration ({found.held_out.calibration}) leaves "
        f"{measured(mean_deg)} deg on its poses"
    )


def monte_carlo_rows(found: Found) -> list[Compared]:
    """Return what resolver uncertainty alone does to the position."""
    plane = found.paper_plane
    condition = f"z = {published.MONTE_CARLO_PLANE_MM} mm"
    source = published.SOURCES["monte_carlo"]
    rows = [
        Compared(
            quantity="Monte Carlo mean position error",
            condition=condition,
            unit="mm",
            paper=f"{published.MONTE_CARLO_MEAN_MM}",
            ours=NOT_COMPUTED if plane is None else three_figures(plane.mean_mm),
            source=source,
            remark=_systematic_remark(found),
        ),
        Compared(
            quantity="Monte Carlo standard deviation",
            condition=condition,
            unit="mm",
            paper=f"{published.MONTE_CARLO_STD_MM}",
            ours=NOT_COMPUTED if plane is None else three_figures(plane.std_mm),
            source=source,
            remark=""
            if plane is None
            else f"within a position; between positions {three_figures(plane.std_between_mm)}",
        ),
    ]
    for z_mm in published.MONTE_CARLO_PARALLEL_PLANES_MM:
        other = found.planes.get(z_mm)
        ours, remark = NOT_COMPUTED, ""
        if plane is not None and other is not None:
            ours = f"{abs(other.mean_mm - plane.mean_mm):.4f}"
            remark = _difference_remark(plane, other)
        rows.append(
            Compared(
                quantity="Monte Carlo mean, difference of a parallel plane",
                condition=f"z = {z_mm} mm",
                unit="mm",
                paper=f"< {published.MONTE_CARLO_PLANES_DIFFER_MM}",
                ours=ours,
                source=source,
                remark=remark,
            )
        )
    return rows


def _difference_remark(plane: PlaneRecord, other: PlaneRecord) -> str:
    """Say whether two parallel planes differ as little as the paper says, and why not."""
    said = (
        "95 % interval of each mean for the choice of positions: "
        f"± {other.half_width95_positions_mm:.4f}"
    )
    if abs(other.mean_mm - plane.mean_mm) < published.MONTE_CARLO_PLANES_DIFFER_MM:
        return said
    reason = ""
    if other.rejected_positions != plane.rejected_positions:
        reason = (
            "the ring of positions is cut where the arm does not reach: "
            f"{other.rejected_positions} positions were drawn anew in this plane, "
            f"{plane.rejected_positions} in that at {plane.plane_mm} mm; "
        )
    return f"does not reproduce: {reason}{said}"


def _systematic_remark(found: Found) -> str:
    """Say why the Monte Carlo is a lower bound in the paper's sense only."""
    said = (
        "resolver error repeats with the joint angles, so it is systematic and in principle "
        "calibratable: a lower bound only in the paper's sense"
    )
    plane = found.paper_plane
    if plane is None or not found.scatter:
        return said
    scatter_mm = max(scatter.mean_mm for scatter in found.scatter.values())
    return (
        f"{said}; repeats scatter by {three_figures(scatter_mm)} mm on average, "
        f"{three_figures(plane.mean_mm / scatter_mm)} times less"
    )


def claim_rows(found: Found) -> list[Compared]:
    """Return the paper's conclusions, recomputed from its own figures and from ours."""
    return [*_distance_rows(found), *_reduction_rows(found), *_peak_rows(found)]


def _distance_rows(found: Found) -> list[Compared]:
    rows = []
    plane = found.paper_plane
    for load, stated in published.AFTER.items():
        after = found.after(load)
        ours, remark = (NOT_MEASURED if after is None else NOT_COMPUTED), ""
        if after is not None and plane is not None:
            distance_mm = after.mean_mm - plane.mean_mm
            ours = f"{distance_mm:.2f}"
            if distance_mm < 0.0:
                remark = (
                    "below the Monte Carlo mean: these data hold less resolver error than it "
                    "assumes, or the calibration has taken it up"
                )
        rows.append(
            Compared(
                quantity="mean error after calibration less the Monte Carlo mean",
                condition=written_load(load),
                unit="mm",
                paper=f"< {published.CLAIMED_DISTANCE_FROM_MINIMUM_MM}",
                recomputed=f"{stated.mean_mm - published.MONTE_CARLO_MEAN_MM:.2f}",
                ours=ours,
                source=published.SOURCES["conclusion"],
                remark=remark,
            )
        )
    return rows


def _reduction_rows(found: Found) -> list[Compared]:
    low, high = published.CLAIMED_REDUCTIONS_PERCENT
    rows = []
    for load, stated in published.AFTER.items():
        stated_before = published.BEFORE[load]
        recomputed = reduction_percent(stated_before.mean_mm, stated.mean_mm)
        before, after = found.before(load), found.after(load)
        ours = NOT_MEASURED
        if before is not None and after is not None:
            ours = f"{reduction_percent(before.mean_mm, after.mean_mm):.0f}"
        rows.append(
            Compared(
                quantity="reduction of the mean position error",
                condition=written_load(load),
                unit="%",
                paper=f"{low} to {high}",
                recomputed=f"{recomputed:.0f}",
                ours=ours,
                source=published.SOURCES["conclusion"],
            )
        )
    return rows


def _peak_rows(found: Found) -> list[Compared]:
    stated, models = published.HELD_OUT, found.held_out.models
    rows = []
    for name in _CALIBRATED:
        ours = NOT_MEASURED
        if "uncalibrated" in models and name in models:
            percent = reduction_percent(models["uncalibrated"].peak_mm, models[name].peak_mm)
            ours = f"{percent:.0f}"
        recomputed = reduction_percent(stated["uncalibrated"].peak_mm, stated[name].peak_mm)
        rows.append(
            Compared(
                quantity="reduction of the peak position error, held out",
                condition=name,
                unit="%",
                paper=f"≥ {published.CLAIMED_PEAK_REDUCTION_PERCENT}",
                recomputed=f"{recomputed:.0f}",
                ours=ours,
                source=published.SOURCES["held_out"],
            )
        )
    return rows
