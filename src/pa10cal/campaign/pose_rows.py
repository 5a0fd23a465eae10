"""Rows of `files.poses`: configurations as an instrument without touches gives them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.campaign.csv_rows import RawRows, choices, in_range, numbers, read_rows
from pa10cal.campaign.logs import (
    KINDS,
    LARGEST_MM,
    TOO_LARGE,
    FileRead,
    Readings,
    in_time,
    readings_of,
)

Array = NDArray[np.float64]

NOT_UNCERTAIN = "the stated uncertainty is not above zero"


@dataclass(frozen=True)
class MeasuredColumns:
    """The columns that hold what one instrument measured.

    Attributes:
        names: their names.
        lengths: those of them that are lengths [mm].
        may_be_blank: whether an empty field says that nothing was seen, rather than nothing.
        checked: leaves out rows whose fields, all of them numbers or blank, are no measurement.
    """

    names: tuple[str, ...]
    lengths: tuple[str, ...]
    may_be_blank: bool
    checked: Callable[[RawRows], RawRows]


@dataclass(frozen=True)
class PoseRows(Readings):
    """Configurations of an arm with n joints, and k numbers measured in each.

    Attributes:
        q: (N, n) joint positions [deg]; [mm] of a joint that slides.
        q_u: (N, n) their standard uncertainties, nan where not stated.
        tau_Nm: (N, n) torques (forces [N] of joints that slide), nan where not logged.
        tau_u_Nm: (N, n) their standard uncertainties, nan where not stated.
        temperature_C: (N,) temperature, nan where not logged.
        measured: (N, k) what was measured, nan where left blank.
        measured_u: (N, k) its standard uncertainties, nan where not stated.
    """

    q: Array
    q_u: Array
    tau_Nm: Array
    tau_u_Nm: Array
    temperature_C: Array
    measured: Array
    measured_u: Array


def position_columns(slides: NDArray[np.bool_]) -> list[str]:
    """Return the raw columns of joint positions: q1_deg …, or q1_mm of a joint that slides."""
    units = np.where(slides, "mm", "deg")
    return [f"q{joint}_{unit}" for joint, unit in enumerate(units, start=1)]


def read_pose_rows(
    path: Path, slides: NDArray[np.bool_], measured: MeasuredColumns, *, kind_stated: bool
) -> tuple[PoseRows, FileRead]:
    """Read the configurations of an instrument that touches nothing.

    Args:
        path: the file named by `files.poses`.
        slides: (n,) which joints slide; torques are logged for all joints or for none.
        measured: the columns of what was measured.
        kind_stated: whether the rows must say their kind; else all are of the grid.

    Raises:
        RawDataError: when the file as a whole cannot be used.
    """
    q = position_columns(slides)
    tau = [f"tau{joint}_Nm" for joint in range(1, len(q) + 1)]
    seen = list(measured.names)
    labels = ["pose", "load_N", "repeat", *(["kind"] if kind_stated else [])]
    stated_u = [f"u_{name}" for name in (*q, *tau, *seen)]
    optional = ["temperature_C", *stated_u]
    raw = read_rows(path, ["time_s", *labels, *q, *seen], ["kind", *optional], tau)
    if "kind" not in raw.columns:
        raw.columns["kind"] = np.full(len(raw.line), "grid", dtype=object)
    raw = choices(raw, "kind", KINDS)
    logged = [name for name in tau if name in raw.columns]
    raw, _ = numbers(raw, ["time_s", "load_N", *q, *logged])
    raw, _ = numbers(raw, seen, may_be_blank=measured.may_be_blank)
    raw = in_range(raw, measured.lengths, TOO_LARGE, -LARGEST_MM, LARGEST_MM)
    given = [name for name in optional if name in raw.columns]
    raw, _ = numbers(raw, given, may_be_blank=True)
    above_zero = float(np.nextafter(0.0, 1.0))
    raw = in_range(raw, [name for name in stated_u if name in given], NOT_UNCERTAIN, above_zero)
    raw = measured.checked(raw)
    raw, shared = readings_of(raw)
    given += [*logged, *q, *seen]
    columns = dict(zip(given, numbers(raw, given, may_be_blank=True)[1].T, strict=True))
    unknown = np.full(len(raw.line), np.nan)

    def read(names: Sequence[str]) -> Array:
        return np.column_stack([columns.get(name, unknown) for name in names])

    def uncertain(names: Sequence[str]) -> Array:
        return read([f"u_{name}" for name in names])

    rows = PoseRows(
        **shared,
        q=read(q),
        q_u=uncertain(q),
        tau_Nm=read(tau),
        tau_u_Nm=uncertain(tau),
        temperature_C=read(["temperature_C"])[:, 0],
        measured=read(seen),
        measured_u=uncertain(seen),
    )
    return in_time(rows, raw)
