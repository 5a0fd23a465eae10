"""What the stage `curve` wrote, read and checked for the pictures drawn from it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.errors import RecordError
from pa10cal.figures.records import Record
from pa10cal.files.schemas import CURVE

Array = NDArray[np.float64]

#: Why a gait has nothing to show.
ONE_SHAPE = "one shape does not move"


class ShapeRecord(Record):
    """One shape of the chain."""

    ending_is: str
    roll_deg: float
    largest_angle_deg: float


class Limits(Record):
    """Limits of the joints."""

    a_deg: tuple[float, float]
    b_deg: tuple[float, float]


class AskedFor(Record):
    """The part of the settings that pictures show."""

    limits: Limits | None


class CurveRecord(Record):
    """The part of `curve.json` that pictures show."""

    link_m: float
    links: int
    order: str
    shapes: tuple[ShapeRecord, ...]
    settings: AskedFor


@dataclass(frozen=True)
class CurveResults:
    """A chain of n links in T shapes.

    Attributes:
        name: of its folder.
        record: its links, statuses and limits.
        time_s: (T,) when.
        p_m: (T, n + 1, 3) where links join.
        z_axis: (T, n, 3) z axes of the links.
        curve_m: (T, k, 3) places along the curve.
        a_deg, b_deg: (T, n - 1) joint angles.
    """

    name: str
    record: CurveRecord
    time_s: Array
    p_m: Array
    z_axis: Array
    curve_m: Array
    a_deg: Array
    b_deg: Array

    @property
    def moves(self) -> bool:
        """Whether there are several shapes."""
        return len(self.time_s) > 1

    @property
    def footer(self) -> str:
        """What the picture shows, in a line."""
        first = self.record.shapes[0]
        return (
            f"{self.record.links} links of {self.record.link_m:.4g} m on a continuous curve: "
            f"{first.ending_is}. Synthetic data."
        )


def read_curve(folder: Path) -> CurveResults:
    """Read a folder that the stage `curve` wrote.

    Raises:
        RecordError: when a file is missing or is none of that stage.
    """
    path = folder / "curve.json"
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content.get("schema") != CURVE:
            raise ValueError(f"schema {content.get('schema')!r}")
        record = CurveRecord.model_validate(content)
        tables = {}
        for name in ("angles", "points", "links", "shape"):
            path = folder / f"{name}.csv"
            tables[name] = pd.read_csv(path)

        def columns(name: str, wanted: list[str]) -> Array:
            found = tables[name][wanted].to_numpy(dtype=np.float64)
            return found.reshape(len(record.shapes), len(found) // len(record.shapes), len(wanted))

        place_m = ["x_m", "y_m", "z_m"]
        angles_deg = np.degrees(columns("angles", ["a_rad", "b_rad"]))
        return CurveResults(
            name=folder.name,
            record=record,
            time_s=columns("points", ["time_s"])[:, 0, 0],
            p_m=columns("points", place_m),
            z_axis=columns("links", ["z_x", "z_y", "z_z"]),
            curve_m=columns("shape", place_m),
            a_deg=angles_deg[..., 0],
            b_deg=angles_deg[..., 1],
        )
    except (OSError, ValueError, KeyError, AttributeError) as error:
        raise RecordError(
            "a result of the curve stage cannot be used",
            where=str(path),
            value=str(error).splitlines()[0],
            allowed=f"curve.json ({CURVE}) and the tables of one run",
            remedy="run the curve stage again",
        ) from None
