"""How much the repeats of one configuration scatter: the paper's repeatability."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from pa10cal.errors import RecordError
from pa10cal.reports.results_bundle import POSES, ResultsBundle
from pa10cal.results.calibration import PaperCalibrationRecord

#: Columns of the table of poses that hold the measured position of the end-effector.
PLACE_MM = ("ee_x_mm", "ee_y_mm", "ee_z_mm")
#: A mean error up to so many times the scatter of averaged repeats may be scatter alone.
_COMPLETE_WITHIN = 3.0


@dataclass(frozen=True)
class GridScatter:
    """Standard deviation of the measured position within one grid configuration, at one load.

    That of the distance: the root of the variances along three axes together.
    """

    largest_mm: float  # over the configurations
    mean_mm: float  # over the configurations
    # that of the average of a configuration's repeats, over the configurations
    mean_of_average_mm: float

    @property
    def largest_per_axis_mm(self) -> float:
        """Return the largest along one axis, nearest to the paper's scatter of a scalar error."""
        return float(self.largest_mm / np.sqrt(3.0))


def places(results: ResultsBundle) -> pd.DataFrame:
    """Return the table of poses in order of time, with the end-effector in `PLACE_MM`.

    Raises:
        RawDataError: when it cannot be used.
        RecordError: when it is missing, or the instrument measured no end-effector.
    """
    poses = results.poses
    absent = [] if poses is None else [name for name in PLACE_MM if name not in poses]
    if poses is None or absent:
        raise RecordError(
            "the table of poses has no column" if absent else "the table of poses is missing",
            where=str(results.folder / POSES),
            value=absent[0] if absent else None,
            allowed=f"a file that pa10cal ingest wrote, with {', '.join(PLACE_MM)}",
            remedy="run pa10cal ingest first",
        )
    return poses.sort_values("time_s")


def scatter_by_load(poses: pd.DataFrame) -> dict[str, GridScatter]:
    """Return the scatter at each load with repeats, by load as `0N`, `22N`, ….

    Args:
        poses: the table of poses.
    """
    grid = poses[poses["kind"] == "grid"].groupby(["load_N", "pose"])
    count = grid.size()
    variance = grid[list(PLACE_MM)].var(ddof=1).sum(axis=1, skipna=False)
    found = pd.DataFrame({"std": np.sqrt(variance), "count": count})[count > 1]
    found["of_average"] = found["std"] / np.sqrt(found["count"])
    return {
        f"{load_N:g}N": GridScatter(
            largest_mm=float(at["std"].max()),
            mean_mm=float(at["std"].mean()),
            mean_of_average_mm=float(at["of_average"].mean()),
        )
        for load_N, at in found.groupby(level="load_N")
    }


def incompleteness(case: PaperCalibrationRecord, scatter: dict[str, GridScatter]) -> str | None:
    """Say that a calibrated model is incomplete, None where repeats do not show that it is.

    What a general model leaves is the scatter of averaged repeats, on which it was calibrated.

    Args:
        case: the calibration.
        scatter: of repeats, by load.
    """
    loads = [load for load in case.errors if load in scatter]
    if not loads:
        return None
    error_mm = np.mean([case.errors[load].after.mean_mm for load in loads])
    repeats_mm = np.mean([scatter[load].mean_of_average_mm for load in loads])
    if error_mm <= _COMPLETE_WITHIN * repeats_mm:
        return None
    times = f"{error_mm / repeats_mm:.0f}" if repeats_mm > 0.0 else "infinitely many"
    return (
        f"The remaining error is {times} times the scatter of averaged repeats: the model is "
        "incomplete, and ± does not cover the missing effect."
    )
