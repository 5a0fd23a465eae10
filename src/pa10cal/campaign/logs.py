"""The raw files of a campaign as arrays, in order of time, with what was left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pa10cal.campaign.csv_rows import (
    RawRows,
    choices,
    in_range,
    numbers,
    read_rows,
    whole_numbers,
)
from pa10cal.campaign.quarantine import LeftOut

Array = NDArray[np.float64]
Rows = NDArray[np.intp] | NDArray[np.bool_]

KINDS = ("line_x", "line_y", "grid", "holdout")
#: No instrument of this kind measures further than this.
LARGEST_MM = 1e6
TOO_LARGE = "a coordinate beyond any measuring volume"

_T = TypeVar("_T", bound="_Columns")


@dataclass(frozen=True)
class _Columns:
    """Arrays of equal length, one entry a row of a file.

    Attributes:
        line: (N,) physical line in the file.
        time_s: (N,) time, ascending.
    """

    line: NDArray[np.int64]
    time_s: Array

    def __len__(self) -> int:
        return len(self.line)

    def take(self: _T, rows: Rows) -> _T:
        """Return some of the rows."""
        return type(self)(*(getattr(self, field.name)[rows] for field in fields(self)))


@dataclass(frozen=True)
class Readings(_Columns):
    """What every measured row says of its configuration.

    Attributes:
        kind: (N,) one of `KINDS`.
        pose: (N,) label.
        load_N: (N,) external load.
        repeat: (N,) number of the repeat.
    """

    kind: NDArray[np.str_]
    pose: NDArray[np.str_]
    load_N: Array
    repeat: NDArray[np.int64]


@dataclass(frozen=True)
class Touches(Readings):
    """Probe touches on tooling balls.

    Attributes:
        ball: (N,) index of the ball.
        p_instr_mm: (N, 3) touched point, probe radius compensated.
    """

    ball: NDArray[np.int64]
    p_instr_mm: Array


@dataclass(frozen=True)
class Samples(_Columns):
    """Samples of the resolver and torque log of an arm with n joints.

    Attributes:
        q_deg: (N, n) motor-side joint positions after the gear ratio.
        tau_Nm: (N, n) torques that hold the arm.
        temperature_C: (N,) temperature.
    """

    q_deg: Array
    tau_Nm: Array
    temperature_C: Array


@dataclass(frozen=True)
class FileRead:
    """How the reading of one file went.

    Attributes:
        file: its name.
        total: rows in it.
        out_of_order: rows whose time was earlier than that of a row before them; they were sorted
            in and are used.
        unused: columns that nothing is read from.
        left_out: rows left out.
    """

    file: str
    total: int
    out_of_order: int
    unused: tuple[str, ...]
    left_out: tuple[LeftOut, ...]

    @property
    def notes(self) -> tuple[str, ...]:
        """What the reader should know of it."""
        late = f"rows of {self.file} out of order: {self.out_of_order}"
        unused = (f"column {name} of {self.file} is not used" for name in self.unused)
        return (*((late,) if self.out_of_order else ()), *unused)


def read_touches(path: Path, ball_names: Sequence[str]) -> tuple[Touches, FileRead]:
    """Read the touches of a touch-trigger instrument.

    Args:
        path: cmm.csv or cmm.csv.gz.
        ball_names: names of the tool's balls.

    Raises:
        RawDataError: when the file as a whole cannot be used.
    """
    places = ["x_mm", "y_mm", "z_mm"]
    labels = ["kind", "pose", "load_N", "repeat", "ball", "touch"]
    raw = read_rows(path, ["time_s", *labels, *places])
    raw = choices(choices(raw, "kind", KINDS), "ball", ball_names)
    raw, _ = numbers(raw, ["time_s", "load_N", *places])
    raw, _ = whole_numbers(raw, "touch")
    raw = in_range(raw, places, TOO_LARGE, -LARGEST_MM, LARGEST_MM)
    raw, shared = readings_of(raw)
    _, p_instr_mm = numbers(raw, places)
    names = raw.columns["ball"].astype(str)
    ball = np.argmax(names[:, None] == np.array(ball_names), axis=1)
    return in_time(Touches(**shared, ball=ball, p_instr_mm=p_instr_mm), raw)


def read_samples(path: Path, joints: int) -> tuple[Samples, FileRead]:
    """Read the resolver and torque log of an arm with the given number of joints.

    Samples at the time of an earlier one are left out and listed.

    Raises:
        RawDataError: when the file as a whole cannot be used.
    """
    q = [f"q{j}_deg" for j in range(1, joints + 1)]
    tau = [f"tau{j}_Nm" for j in range(1, joints + 1)]
    raw = read_rows(path, ["time_s", *q, *tau, "temperature_C"])
    raw, table = numbers(raw, ["time_s", *q, *tau, "temperature_C"])
    time_s = table[:, 0]
    order = np.argsort(time_s, kind="stable")
    first = np.ones(len(time_s), dtype=bool)
    first[order[1:]] = np.diff(time_s[order]) > 0.0
    raw = raw.take(first, "another sample has this time", [f"{t:g} s" for t in time_s[~first]])
    table = table[first]
    samples = Samples(
        raw.line, table[:, 0], table[:, 1 : joints + 1], table[:, joints + 1 : -1], table[:, -1]
    )
    return in_time(samples, raw)


def readings_of(raw: RawRows) -> tuple[RawRows, dict[str, Any]]:
    """Read what every row says of its configuration; rows that do not say it are left out.

    Returns:
        The remaining rows and the fields of `Readings`.
    """
    raw = in_range(raw, ["load_N"], "negative load", 0.0)
    raw, repeat = whole_numbers(raw, "repeat")
    named = raw.columns["pose"] != ""
    raw = raw.take(named, "the pose has no label", [""] * int((~named).sum()))
    _, table = numbers(raw, ["time_s", "load_N"])
    kind, pose = raw.columns["kind"].astype(str), raw.columns["pose"].astype(str)
    return raw, {
        "line": raw.line,
        "time_s": table[:, 0],
        "kind": kind,
        "pose": pose,
        "load_N": table[:, 1],
        "repeat": repeat[named],
    }


def in_time(rows: _T, raw: RawRows) -> tuple[_T, FileRead]:
    """Sort the rows by time and say how many were out of order."""
    time_s = rows.time_s
    late = time_s[1:] < np.maximum.accumulate(time_s)[:-1] if len(time_s) else np.zeros(0, bool)
    done = FileRead(raw.file, raw.total, int(late.sum()), raw.unused, raw.left_out)
    return rows.take(np.argsort(time_s, kind="stable")), done
