"""Points of a curve as a CSV file: x, y, z in metres or millimetres."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from pa10cal.arrays import Array
from pa10cal.errors import RawDataError

_UNITS_M = {"m": 1.0, "mm": 1e-3}
_AXES = "xyz"


def read_curve_points(path: Path) -> Array:
    """Read points (N, 3) [m], one a row under the header x_m,y_m,z_m or x_mm,y_mm,z_mm.

    Other columns and empty lines are ignored.

    Raises:
        RawDataError: when the file cannot be read, lacks a column, or holds what is no finite
            number, with its line.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = [(k, row) for k, row in enumerate(csv.reader(file), start=1) if row]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise _refusal(path, 1, "the points cannot be read", str(error), "UTF-8 CSV") from None
    header = [name.strip() for name in rows[0][1]] if rows else []
    unit = next((unit for unit in _UNITS_M if f"x_{unit}" in header), None)
    names = [f"{axis}_{unit}" for axis in _AXES]
    if unit is None or not set(names) <= set(header):
        allowed = "columns x_m, y_m, z_m or x_mm, y_mm, z_mm"
        raise _refusal(path, 1, "a coordinate has no column", ", ".join(header), allowed)
    columns = [header.index(name) for name in names]
    points = np.empty((len(rows) - 1, 3))
    for k, (line, row) in enumerate(rows[1:]):
        for axis, column in enumerate(columns):
            text = row[column] if column < len(row) else ""
            points[k, axis] = _number(path, line, names[axis], text)
    return np.asarray(_UNITS_M[unit] * points)


def _number(path: Path, line: int, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise _refusal(
            path, line, f"{name} is not a finite number", text, "a number with a decimal point"
        )
    return value


def _refusal(path: Path, line: int, what: str, value: str, allowed: str) -> RawDataError:
    return RawDataError(
        what,
        where=f"{path}:{line}",
        value=value,
        allowed=allowed,
        remedy="correct the file, or remove the row",
    )
