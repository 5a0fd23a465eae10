"""Files of the command `curve`: points of a curve read; what it writes, and read again to draw."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from pa10cal.arrays import Array
from pa10cal.errors import RawDataError, RecordError, SettingsError
from pa10cal.files.arms import arm_text, parse_arm
from pa10cal.files.output import whole_files
from pa10cal.files.table_cells import csv_text
from pa10cal.input_files import open_file, read_csv, reason
from pa10cal.results.codec import read, write
from pa10cal_curve.curve import polyline, spline_through
from pa10cal_curve.gait import arm_of, laid, shape_of
from pa10cal_curve.options import CurveOptions
from pa10cal_curve.records import CurveRecord

#: A curve of a hundred thousand points has a third of it [bytes].
_MOST_BYTES = 16_000_000
_UNITS_M = {"m": 1.0, "mm": 1e-3}
_PLACE_M = ["x_m", "y_m", "z_m"]


def write_curve(options: CurveOptions, points: Path | None, out_dir: Path) -> CurveRecord:
    """Lay links along a curve, by points in a file or by name, and write all of it or nothing.

    Raises:
        SettingsError: when the curve is given twice or not at all.
        RawDataError, CurveError: when its points cannot be used, or the links not be laid.
        ArmError: when the chain is longer than an arm may be, or its limits are none of an arm.
    """
    if points is not None and options.curve is None:
        points_m, straight = read_curve_points(points), options.through == "straight"
        closed = options.through == "closed_spline"
        curve = polyline(points_m) if straight else spline_through(points_m, closed)
    elif points is None and options.curve is not None:
        curve = shape_of(options.curve)
    else:
        raise SettingsError(
            "the curve is given twice or not at all",
            where="--points, curve",
            allowed="points, or a shape by name",
            remedy="give one of them",
        )
    record, tables = laid(curve, options)
    texts = {}
    for name, columns in tables.items():
        rows = zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True)
        texts[out_dir / f"{name}.csv"] = csv_text(columns, rows)
    if options.arm is not None:
        text = arm_text(arm_of(options, record))
        parse_arm(
            yaml.safe_load(text), where=f"arm {options.arm}"
        )  # what cannot be read is refused
        texts[out_dir / "arms" / f"{options.arm}.yaml"] = text
    with whole_files(*texts, out_dir / "curve.json") as (*besides, record_beside):
        for beside, text in zip(besides, texts.values(), strict=True):
            beside.write_text(text, encoding="utf-8", newline="\n")
        write(record, record_beside)
    return record


def read_curve_points(path: Path) -> Array:
    """Read points (N, 3) [m], one a row under the header x_m,y_m,z_m or x_mm,y_mm,z_mm.

    Other columns and empty lines are ignored.

    Raises:
        RawDataError: when the file cannot be read, lacks a column, or holds what is no finite
            number, with its line.
    """

    def refusal(line: int, what: str, value: str, allowed: str) -> RawDataError:
        remedy = "correct the file, or remove the row"
        where = f"{path}:{line}"
        return RawDataError(what, where=where, value=value, allowed=allowed, remedy=remedy)

    try:
        rows = list(read_csv(path, _MOST_BYTES))
    except (OSError, ValueError) as error:
        raise refusal(1, "the points cannot be read", reason(error), "UTF-8 CSV") from None
    header = [name.strip() for name in rows[0][1]] if rows else []
    units = [unit for unit in _UNITS_M if f"x_{unit}" in header]
    allowed = "columns x_m, y_m, z_m or x_mm, y_mm, z_mm"
    if len(units) > 1:
        raise refusal(1, "the points stand there twice", ", ".join(header), allowed)
    unit = units[0] if units else "m"
    names = [f"{axis}_{unit}" for axis in "xyz"]
    if not set(names) <= set(header):
        raise refusal(1, "a coordinate has no column", ", ".join(header), allowed)
    points = np.empty((len(rows) - 1, 3))
    for k, (line, row) in enumerate(rows[1:]):
        for axis, name in enumerate(names):
            column = header.index(name)
            text = row[column] if column < len(row) else ""
            try:
                points[k, axis] = float(text)
            except ValueError:
                points[k, axis] = math.nan
            if not math.isfinite(points[k, axis]):
                what = f"{name} is not a finite number"
                raise refusal(line, what, text, "a number with a decimal point")
    return np.asarray(_UNITS_M[unit] * points)


@dataclass(frozen=True)
class CurveResults:
    """A chain of n links in T shapes, as a folder holds it."""

    record: CurveRecord  # its links, statuses and limits
    time_s: Array  # (T,) when
    p_m: Array  # (T, n + 1, 3) where links join
    z_axis: Array  # (T, n, 3) z axes of the links
    curve_m: Array  # (T, k, 3) places along the curve
    a_deg: Array  # (T, n - 1) joint angles about z
    b_deg: Array  # (T, n - 1) joint angles about y

    @property
    def limits_deg(self) -> list[float]:
        """The limits of the joints; none where none are set."""
        limits: Any = self.record.settings.get("limits")
        every = limits.values() if isinstance(limits, dict) else ()
        return [float(end) for ends in every if isinstance(ends, list | tuple) for end in ends]


def read_curve(folder: Path) -> CurveResults:
    """Read a folder that `write_curve` wrote.

    Raises:
        RecordError: when a file is missing or is none of that command.
    """
    record = read(CurveRecord, folder / "curve.json", within=folder)

    def columns(name: str, names: list[str]) -> Array:
        path = folder / f"{name}.csv"
        try:
            with open_file(path, folder) as file:
                table = pd.read_csv(file)[names].to_numpy(dtype=np.float64)
            return table.reshape(len(record.shapes), -1, len(names))
        except (OSError, ValueError, KeyError) as error:
            raise RecordError(
                "a table of the curve cannot be used",
                where=str(path),
                value=reason(error) if isinstance(error, OSError) else str(error).splitlines()[0],
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
