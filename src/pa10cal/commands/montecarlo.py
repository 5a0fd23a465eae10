"""Command `montecarlo`."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pa10cal.settings import MonteCarloSettings

if TYPE_CHECKING:
    from pa10cal.montecarlo.plane import PlaneErrors

_ATTITUDE = (
    "flange axis straight down, turned about the base axis with the azimuth of its place; "
    "one posture throughout, the one nearest the middle of the joint ranges"
)
_REACH = "distance of the flange from the base z axis, in the plane"
_PROGRESS_LINES = 10


def montecarlo(
    *,
    campaign: str,
    robot: str,
    plane_mm: int,
    out: Path,
    campaign_dir: Path | None = None,
    settings: MonteCarloSettings = MonteCarloSettings(),
) -> None:
    """Study the position error from resolver uncertainty in one horizontal plane.

    Args:
        campaign: name, written into the result.
        robot: name of an arm description.
        plane_mm: height of the flange above the base [mm].
        out: result to write (.json).
        campaign_dir: folder that may hold a description of the arm.
        settings: section montecarlo.
    """
    import math

    from pa10cal.files.arms import load_arm
    from pa10cal.files.output import write_json
    from pa10cal.files.schemas import MONTECARLO
    from pa10cal.montecarlo.plane import PlaneTask, study_plane

    task = PlaneTask(
        plane_mm=plane_mm,
        reach_m=settings.reach_m,
        positions=settings.positions,
        cycles=settings.cycles,
        sigma_rad=math.radians(settings.sigma_deg),
        random_seed=settings.random_seed,
        map_spacing_m=1e-3 * settings.map_spacing_mm,
    )
    progress = _Progress(f"montecarlo z = {task.plane_mm} mm", task.cycles)
    errors = study_plane(load_arm(robot, campaign_dir), task, progress)
    record = _record(errors, settings)
    header = {
        "schema": MONTECARLO,
        "campaign": campaign,
        "robot": robot,
        "plane_mm": task.plane_mm,
    }
    write_json(out, {**header, **record})
    print(
        f"{campaign} z = {task.plane_mm} mm: {record['mean_mm']:.4f} ± "
        f"{record['std_mm']:.4f} mm, closed form {record['closed_form_mean_mm']:.4f} ± "
        f"{record['closed_form_std_mm']:.4f} mm"
    )


class _Progress:
    """Prints how far the draws are, how fast, and how long they will still take."""

    def __init__(self, title: str, cycles: int) -> None:
        self._title = title
        self._cycles = cycles
        self._began = 0.0
        self._printed = 0

    def __call__(self, done: int, places: int) -> None:
        if done == 0:
            self._began = time.monotonic()
        lines = done * _PROGRESS_LINES // places
        if lines == self._printed:
            return
        self._printed = lines
        seconds = max(time.monotonic() - self._began, 1e-9)
        print(
            f"{self._title}: {100 * done // places} %, {done * self._cycles / seconds:.1e} "
            f"cycles/s, {seconds * (places - done) / done:.0f} s left",
            file=sys.stderr,
            flush=True,
        )


def _record(errors: PlaneErrors, settings: MonteCarloSettings) -> dict[str, Any]:
    """Return the results in millimetres; `std_mm` is the spread within a place, as the paper's."""
    import numpy as np

    from pa10cal.montecarlo.statistics import convergence, summarise

    statistics = summarise(errors.sums)
    trace = convergence(errors.sums)
    expected_mean_m = float(errors.expected.mean_m.mean())
    expected_std_m = float(np.sqrt(np.mean(errors.expected.std_m**2)))
    places = np.column_stack(
        [
            errors.places.p_base_m,
            statistics.place_mean_m,
            statistics.place_std_m,
            errors.expected.mean_m,
        ]
    )
    grid = np.column_stack([errors.map_places.p_base_m, errors.map_expected.mean_m])
    return {
        "reach_m": list(settings.reach_m),
        "reach_is": _REACH,
        "attitude": _ATTITUDE,
        "sigma_deg": settings.sigma_deg,
        "random_seed": settings.random_seed,
        "cycles": settings.cycles,
        "positions": settings.positions,
        "rejected_positions": errors.places.rejected,
        "mean_mm": _mm(statistics.mean_m),
        "std_mm": _mm(statistics.std_within_m),
        "std_is": "within a position: root mean square of the standard deviations of the positions",
        "std_between_mm": _mm(statistics.std_between_m),
        "std_total_mm": _mm(statistics.std_total_m),
        "half_width95_cycles_mm": _mm(statistics.half_width_m),
        "half_width95_positions_mm": _mm(statistics.places_half_width_m),
        "closed_form_mean_mm": _mm(expected_mean_m),
        "closed_form_std_mm": _mm(expected_std_m),
        "closed_form_relative_difference": float(f"{statistics.mean_m / expected_mean_m - 1:.6g}"),
        "convergence": {
            "cycles": trace.cycles.tolist(),
            "mean_mm": _mm(trace.mean_m),
            "half_width95_mm": _mm(trace.half_width_m),
        },
        "per_position": {
            "columns": ["x_mm", "y_mm", "mean_mm", "std_mm", "closed_form_mean_mm"],
            "rows": _mm(places),
        },
        "map": {
            "spacing_mm": settings.map_spacing_mm,
            "unreachable_points": errors.map_places.rejected,
            "columns": ["x_mm", "y_mm", "closed_form_mean_mm"],
            "rows": _mm(grid),
        },
    }


def _mm(value_m: Any) -> Any:
    """Return metres as millimetres, rounded far below what the draws can tell."""
    import numpy as np

    return np.round(1e3 * np.asarray(value_m), 9).tolist()
