"""`montecarlo/z<mm>.json`: position error from resolver uncertainty in a horizontal plane."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pa10cal.montecarlo.plane import PlaneErrors, convergence, summarise
from pa10cal.results.studies import Convergence, Places, PlaneMap, PlaneRecord

if TYPE_CHECKING:
    from pa10cal.options import MonteCarloOptions

_ATTITUDE = (
    "flange axis straight down, turned about the base axis with the azimuth of its place; "
    "one posture throughout, the one nearest the middle of the joint ranges"
)
_REACH = "distance of the flange from the base z axis, in the plane"
_STD = "within a position: root mean square of the standard deviations of the positions"


def plane_record(
    errors: PlaneErrors, settings: MonteCarloOptions, campaign: str, robot: str, plane_mm: int
) -> PlaneRecord:
    """Return the results in millimetres; `std_mm` is the spread within a place, as the paper's.

    Args:
        errors: what the draws gave.
        settings: what was drawn.
        campaign: whose result it is.
        robot: name of the arm.
        plane_mm: height of the plane.
    """
    statistics = summarise(errors.sums)
    trace = convergence(errors.sums)
    expected_mean_m = float(errors.expected.mean_m.mean())
    expected_std_m = float(np.sqrt(np.mean(errors.expected.std_m**2)))
    places_m = np.column_stack(
        [
            errors.places.p_base_m,
            statistics.place_mean_m,
            statistics.place_std_m,
            errors.expected.mean_m,
        ]
    )
    grid_m = np.column_stack([errors.map_places.p_base_m, errors.map_expected.mean_m])
    return PlaneRecord(
        campaign=campaign,
        robot=robot,
        plane_mm=plane_mm,
        reach_m=settings.reach_m,
        reach_is=_REACH,
        attitude=_ATTITUDE,
        sigma_deg=settings.sigma_deg,
        random_seed=settings.random_seed,
        cycles=settings.cycles,
        positions=settings.positions,
        rejected_positions=errors.places.rejected,
        mean_mm=_mm(statistics.mean_m),
        std_mm=_mm(statistics.std_within_m),
        std_is=_STD,
        std_between_mm=_mm(statistics.std_between_m),
        std_total_mm=_mm(statistics.std_total_m),
        half_width95_cycles_mm=_mm(statistics.half_width_m),
        half_width95_positions_mm=_mm(statistics.places_half_width_m),
        closed_form_mean_mm=_mm(expected_mean_m),
        closed_form_std_mm=_mm(expected_std_m),
        closed_form_relative_difference=float(f"{statistics.mean_m / expected_mean_m - 1:.6g}"),
        convergence=Convergence(
            cycles=trace.cycles,
            mean_mm=_mm_each(trace.mean_m),
            half_width95_mm=_mm_each(trace.half_width_m),
        ),
        per_position=Places(
            columns=("x_mm", "y_mm", "mean_mm", "std_mm", "closed_form_mean_mm"),
            rows=_mm_each(places_m),
        ),
        map=PlaneMap(
            spacing_mm=settings.map_spacing_mm,
            unreachable_points=errors.map_places.rejected,
            columns=("x_mm", "y_mm", "closed_form_mean_mm"),
            rows=_mm_each(grid_m),
        ),
    )


def _mm(value_m: float) -> float:
    return float(_mm_each(value_m))


def _mm_each(value_m: Any) -> NDArray[np.float64]:
    """Return metres as millimetres, rounded far below the resolution of the draws."""
    return np.round(1e3 * np.asarray(value_m), 9)
