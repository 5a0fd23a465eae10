"""What the command `curve` wrote, read for the pictures drawn from it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from pa10cal.arrays import Array
from pa10cal.errors import RecordError
from pa10cal.results.codec import read
from pa10cal.results.studies import CurveRecord

#: Why a gait has nothing to show.
ONE_SHAPE = "one shape does not move"
_PLACE_M = ["x_m", "y_m", "z_m"]


@dataclass(frozen=True)
class CurveResults:
    """A chain of n links in T shapes."""

    record: CurveRecord  # its links, statuses and limits
    time_s: Array  # (T,) when
    p_m: Array  # (T, n + 1, 3) where links join
    z_axis: Array  # (T, n, 3) z axes of the links
    curve_m: Array  # (T, k, 3) places along the curve
    # a_deg and b_deg: (T, n - 1) joint angles
    a_deg: Array
    b_deg: Array

    @property
    def moves(self) -> bool:
        """Whether there are several shapes."""
        return len(self.time_s) > 1

    @property
    def limits_deg(self) -> list[float]:
        """The limits of the joints; none where none are set."""
        limits = self.record.settings.get("limits")
        if not isinstance(limits, dict):
            return []
        return [float(str(end)) for ends in limits.values() for end in _entries(ends)]


def read_curve(folder: Path) -> CurveResults:
    """Read a folder that the command `curve` wrote.

    Raises:
        RecordError: when a file is missing or is none of that command.
    """
    record = read(CurveRecord, folder / "curve.json")
    shapes = len(record.shapes)

    def columns(name: str, names: list[str]) -> Array:
        path = folder / f"{name}.csv"
        try:
            found = pd.read_csv(path)[names].to_numpy(dtype=np.float64)
            return found.reshape(shapes, len(found) // shapes, len(names))
        except (OSError, ValueError, KeyError) as error:
            raise RecordError(
                "a table of the curve cannot be used",
                where=str(path),
                value=str(error).splitlines()[0],
                allowed="the tables that were written with curve.json",
                remedy="run pa10cal curve again",
            ) from None

    angles_deg = np.degrees(columns("angles", ["a_rad", "b_rad"]))
    return CurveResults(
        record=record,
        time_s=columns("points", ["time_s"])[:, 0, 0],
        p_m=columns("points", _PLACE_M),
        z_axis=columns("links", ["z_x", "z_y", "z_z"]),
        curve_m=columns("shape", _PLACE_M),
        a_deg=angles_deg[..., 0],
        b_deg=angles_deg[..., 1],
    )


def _entries(value: object) -> list[object]:
    return list(value) if isinstance(value, list | tuple) else []
