"""Rows of the raw files of a campaign, in order of time, with what is quarantined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.campaign.base_motion import base_columns, base_target_names, base_targets
from pa10cal.campaign.bounds import Bounds, within_bounds
from pa10cal.campaign.raw_file import PoseFile, RawFile
from pa10cal.campaign.raw_rows import (
    Exclusions,
    Quarantined,
    RawRows,
    choices,
    finite,
    numbers,
)
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import KINDS, JointLog, Observations
from pa10cal.observe.quantities import RawColumns, Stated

Rows = Index | NDArray[np.bool_]

_T = TypeVar("_T", bound="_Columns")


@dataclass(frozen=True)
class _Columns:
    """Arrays of equal length, one entry a row of a file."""

    line: NDArray[np.int64]  # (N,) physical line in the file
    time_s: Array  # (N,) time, ascending

    def __len__(self) -> int:
        return len(self.line)

    def take(self: _T, rows: Rows) -> _T:
        """Return some of the rows."""
        return type(self)(*(_some(getattr(self, field.name), rows) for field in fields(self)))


@dataclass(frozen=True)
class Touches(_Columns):
    """Probe touches on tooling balls."""

    kind: NDArray[np.str_]  # (N,) one of `KINDS`
    pose: NDArray[np.str_]  # (N,) label
    load_N: Array  # (N,) external load
    repeat: NDArray[np.int64]  # (N,) number of the repeat
    ball: NDArray[np.int64]  # (N,) index of the ball
    p_instr_mm: Array  # (N, 3) touched point, probe radius compensated

    @property
    def configurations(self) -> Index:
        """Return the number of each touch's configuration, in the order of their appearance."""
        return _configurations(self.kind, self.pose, self.load_N, self.repeat)


@dataclass(frozen=True)
class Samples(_Columns):
    """Samples of the resolver and torque log of an arm with n joints."""

    q_deg: Array  # (N, n) motor-side joint positions after the gear ratio
    tau_Nm: Array  # (N, n) torques that hold the arm
    temperature_C: Array  # (N,) temperature


@dataclass(frozen=True)
class PoseRows(_Columns):
    """Configurations as `files.poses` holds them."""

    observations: Observations  # (N,) their content

    @property
    def configurations(self) -> Index:
        """Return the number of each row's configuration, in the order of their appearance."""
        found = self.observations
        return _configurations(found.kind, found.pose, found.states.load_N, found.repeat)


@dataclass(frozen=True)
class FileRead:
    """How the reading of one file went."""

    file: str  # its name
    total: int  # rows in it
    # rows whose time was earlier than that of a row before them; they were sorted in and are used
    out_of_order: int
    unused: tuple[str, ...]  # columns that nothing is read from
    quarantined: tuple[Quarantined, ...]  # rows that are not used

    @property
    def notes(self) -> tuple[str, ...]:
        """What the reader should know of it."""
        late = f"rows of {self.file} out of order: {self.out_of_order}"
        unused = (f"column {name} of {self.file} is not used" for name in self.unused)
        return (*((late,) if self.out_of_order else ()), *unused)


def read_touches(
    file: RawFile, ball_names: Sequence[str], bounds: Bounds, exclusions: Exclusions
) -> tuple[Touches, FileRead]:
    """Read the touches of a touch-trigger instrument.

    Args:
        file: the file of touches.
        ball_names: names of the tool's balls.
        bounds: of the columns.
        exclusions: rows that campaign.yaml excludes.

    Raises:
        RawDataError: when the file as a whole cannot be used.
    """
    places = ["x_mm", "y_mm", "z_mm"]
    raw = file.read(["time_s", "kind", "pose", "load_N", "repeat", "ball", "touch", *places])
    raw = exclusions.labels(exclusions.lines(raw))
    raw = choices(choices(raw, "kind", KINDS), "ball", ball_names)
    raw = finite(raw, ["time_s", "load_N", *places])
    raw = within_bounds(raw, ["time_s", *places], bounds)
    raw, _ = _whole(raw, "touch", bounds)
    raw, labelled = _labelled(raw, bounds)
    _, p_instr_mm = numbers(raw, places)
    names = raw.text_of("ball")
    ball = np.argmax(names[:, None] == np.array(ball_names), axis=1)
    return _in_time(Touches(**labelled, ball=ball, p_instr_mm=p_instr_mm), raw)


def read_samples(file: RawFile, bounds: Bounds) -> tuple[Samples, FileRead]:
    """Read the resolver and torque log of the arm whose bounds are given.

    Samples at the time of an earlier one are quarantined.

    Raises:
        RawDataError: when the file as a whole cannot be used.
    """
    joints = bounds.arm.n
    q = [f"q{j}_deg" for j in range(1, joints + 1)]
    names = ["time_s", *q, *(f"tau{j}_Nm" for j in range(1, joints + 1)), "temperature_C"]
    raw = within_bounds(finite(file.read(names), names), names, bounds)
    _, table = numbers(raw, names)
    raw, time_s = replace(raw, columns={}), table[:, 0]
    order = np.argsort(time_s, kind="stable")
    first = np.ones(len(time_s), dtype=bool)
    first[order[1:]] = np.diff(time_s[order]) > 0.0
    raw = raw.take(first, "another sample has this time", [f"{t:g} s" for t in time_s[~first]])
    if not first.all():
        table = table[first]
    samples = Samples(
        raw.line, table[:, 0], table[:, 1 : joints + 1], table[:, joints + 1 : -1], table[:, -1]
    )
    return _in_time(samples, raw)


def read_pose_rows(
    file: PoseFile,
    bounds: Bounds,
    instrument: type[Instrument],
    stated: Stated,
    exclusions: Exclusions,
    *,
    kind_stated: bool,
    same_deg: float,
) -> tuple[PoseRows, FileRead, RawColumns]:
    """Read the configurations of an instrument that touches nothing.

    Args:
        file: the file named by `files.poses`; torques are logged for all joints or for none.
        bounds: of the columns.
        instrument: the class of the instrument.
        stated: what the campaign's description states of it.
        exclusions: rows that campaign.yaml excludes.
        kind_stated: whether the rows must state their kind; else all are of the grid.
        same_deg: `repeat_tolerance_deg`.

    Returns:
        The rows: no approach (arrivals are 0) and no dwell, what was not logged is nan; how the
        reading went; and the columns that hold what was measured.

    Raises:
        RawDataError: when the file as a whole cannot be used.
    """
    watched = base_target_names(file.names)
    on_base = base_columns(watched)
    own = [name for name in file.names if base_target_names([name]) == ()]
    measured = instrument.raw_columns(own)
    prismatic = bounds.arm.prismatic
    q = position_columns(prismatic)
    tau = [f"tau{joint}_Nm" for joint in range(1, len(q) + 1)]
    labelling = ["pose", "load_N", "repeat", *(["kind"] if kind_stated else [])]
    stated_u = [f"u_{name}" for name in (*q, *tau, *measured.names, *on_base)]
    optional = ["temperature_C", *stated_u]
    lengths = [*measured.names, *on_base]
    raw = file.read(["time_s", *labelling, *q, *lengths], ["kind", *optional], tau)
    raw = exclusions.lines(raw)
    if "kind" not in raw.columns:
        raw.columns["kind"] = np.full(len(raw.line), "grid", dtype=object)
    raw = choices(raw, "kind", KINDS)
    logged = [name for name in tau if name in raw.columns]
    raw = finite(raw, ["time_s", "load_N", *q, *logged])
    raw = finite(raw, measured.names, may_be_blank=measured.may_be_blank)
    raw = finite(raw, on_base, may_be_blank=True)
    given = [name for name in optional if name in raw.columns]
    raw = finite(raw, given, may_be_blank=True)
    raw = within_bounds(raw, ["time_s", *q, *logged, *lengths, *given], bounds)
    _, values = numbers(raw, measured.names, may_be_blank=measured.may_be_blank)
    remaining = np.ones(len(raw.line), dtype=bool)
    for off in instrument.unusable(measured, values):
        shown = list(map(file.words.text, off.values))
        raw = raw.take(~off.rows[remaining], off.reason, shown)
        remaining &= ~off.rows
    raw = _with_labels(raw, q, same_deg)
    raw = exclusions.labels(raw)
    raw, labelled = _labelled(raw, bounds)
    arrivals = [f"arrival{joint}" for joint in range(1, len(q) + 1)]
    given += [*logged, *q, *lengths, *(name for name in arrivals if name in raw.columns)]
    columns = dict(zip(given, numbers(raw, given, may_be_blank=True)[1].T, strict=True))
    unknown = np.full(len(raw.line), np.nan)

    def read(names: Sequence[str]) -> Array:
        return np.column_stack([columns.get(name, unknown) for name in names])

    def uncertain(names: Sequence[str]) -> Array:
        return read([f"u_{name}" for name in names])

    count = len(raw.line)
    states = PoseStates(
        q_rad=in_radians(read(q), prismatic),
        tau_Nm=read(tau),
        arrival=np.nan_to_num(read(arrivals)),  # 0 where the file says nothing of it
        load_N=labelled["load_N"],
        temperature_C=read(["temperature_C"])[:, 0],
        time_s=labelled["time_s"],
    )
    seen = instrument.from_raw(measured, read(measured.names), uncertain(measured.names), stated)
    samples = np.zeros(count, dtype=np.int64)
    found = Observations(
        pose=labelled["pose"],
        states=states,
        measured=seen,
        kind=labelled["kind"],
        repeat=labelled["repeat"],
        readings=np.ones(count, dtype=np.int64),
        log=JointLog(in_radians(uncertain(q), prismatic), uncertain(tau), samples),
        base=base_targets(watched, read(on_base), uncertain(on_base), stated.uncertainty_m)
        if watched
        else None,
    )
    rows, done = _in_time(PoseRows(raw.line, labelled["time_s"], found), raw)
    return rows, done, measured


def position_columns(prismatic: NDArray[np.bool_]) -> list[str]:
    """Return the raw columns of joint positions: q1_deg …, or q1_mm of a prismatic joint."""
    units = np.where(prismatic, "mm", "deg")
    return [f"q{joint}_{unit}" for joint, unit in enumerate(units, start=1)]


def in_radians(q: Array, prismatic: NDArray[np.bool_]) -> Array:
    """Return logged joint positions (N, n) in radians; in metres of prismatic joints."""
    return np.asarray(np.where(prismatic, 1e-3 * q, np.radians(q)))


def _with_labels(raw: RawRows, q: Sequence[str], same_deg: float) -> RawRows:
    """Label rows whose own file does not: equal joint positions are one pose, its repeats counted.

    Poses and repeats are numbered in order of time.
    """
    if {"pose", "repeat"} <= set(raw.columns):
        return raw
    _, table = numbers(raw, ["time_s", "load_N", *q])
    order = np.argsort(table[:, 0], kind="stable")
    if "pose" not in raw.columns:
        pose = np.empty(len(order), dtype=object)
        pose[order] = labels(same_commands(table[order, 2:], same_deg))
        raw.columns["pose"] = pose
    if "repeat" not in raw.columns:
        keys = pd.DataFrame({"pose": raw.text_of("pose"), "load": table[:, 1]}).iloc[order]
        counted = keys.groupby(["pose", "load"], sort=False).cumcount().to_numpy() + 1.0
        raw.columns["repeat"] = np.empty(len(order))
        raw.columns["repeat"][order] = counted
    return raw


def _labelled(raw: RawRows, bounds: Bounds) -> tuple[RawRows, dict[str, Any]]:
    """Read line, time and labels of every row; rows that lack one are quarantined."""
    raw = within_bounds(raw, ["load_N"], bounds)
    raw, repeat = _whole(raw, "repeat", bounds)
    named = raw.text_of("pose") != ""
    raw = raw.take(named, "the pose has no label")
    _, table = numbers(raw, ["time_s", "load_N"])
    kind, pose = raw.text_of("kind"), raw.text_of("pose")
    return raw, {
        "line": raw.line,
        "time_s": table[:, 0],
        "kind": kind,
        "pose": pose,
        "load_N": table[:, 1],
        "repeat": repeat[named],
    }


def _whole(raw: RawRows, name: str, bounds: Bounds) -> tuple[RawRows, NDArray[np.int64]]:
    """Read a column as whole numbers within its bounds."""
    raw = within_bounds(finite(raw, [name]), [name], bounds)
    column = raw.columns[name]
    keep = column == np.round(column)
    values = [f"{raw.name_of(name)} = {value:g}" for value in column[~keep]]
    return raw.take(keep, "not a whole number", values), column[keep].astype(np.int64)


def _in_time(rows: _T, raw: RawRows) -> tuple[_T, FileRead]:
    """Sort the rows by time and return how many were out of order."""
    time_s = rows.time_s
    late = time_s[1:] < np.maximum.accumulate(time_s)[:-1] if len(time_s) else np.zeros(0, bool)
    done = FileRead(raw.file, raw.total, int(late.sum()), raw.unused, raw.quarantined)
    return (rows if not late.any() else rows.take(np.argsort(time_s, kind="stable"))), done


def _configurations(
    kind: NDArray[np.str_], pose: NDArray[np.str_], load_N: Array, repeat: NDArray[np.int64]
) -> Index:
    """Number the configurations in the order in which they first appear."""
    keys = pd.DataFrame({"kind": kind, "pose": pose, "load": load_N, "repeat": repeat})
    return np.asarray(keys.groupby(list(keys), sort=False).ngroup(), dtype=np.intp)


def _some(value: Any, rows: Rows) -> Any:
    """Return some rows of an array, or of observations."""
    return value.take(rows) if isinstance(value, Observations) else value[rows]


# Readings of the same joint positions are repeats of one pose.

#: Places that a chain of neighbours joins over more than so many tolerances are told apart anew.
CHAIN = 3.0
#: Commands that differ by less are one however fine the poses lie [deg, mm].
SAME_COMMAND = 1e-4


def same_commands(q: Array, tolerance: float) -> NDArray[np.intp]:
    """Number the places (N,) of joint positions from 0 in the order in which they first appear.

    Positions within a tolerance of each other are one place: what is read back scatters. Where
    poses lie so densely that a chain of them would be one, only equal ones are.

    Args:
        q: (N, n) joint positions [deg, mm].
        tolerance: `repeat_tolerance_deg` [deg, mm].
    """
    group = _joined(q, tolerance)
    of_group = pd.DataFrame(q).groupby(group)
    spread = (of_group.max() - of_group.min()).max(axis=1)
    dense = np.isin(group, spread.index[spread > CHAIN * tolerance])
    if dense.any():
        group[dense] = group.max() + 1 + _joined(q[dense], min(SAME_COMMAND, tolerance))
    return np.asarray(pd.factorize(group)[0], dtype=np.intp)


def _joined(q: Array, tolerance: float) -> NDArray[np.intp]:
    """Number the groups of positions (N, n) that neighbours join."""
    pairs = cKDTree(q).query_pairs(tolerance, p=np.inf, output_type="ndarray")
    return groups_joined(pairs[:, 0], pairs[:, 1], len(q))


def groups_joined(one: Index, other: Index, count: int) -> Index:
    """Return the number of each of so many things' group, where each of one is joined to other."""
    graph = coo_array((np.ones(len(one), dtype=np.int8), (one, other)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.intp)


def labels(number: NDArray[np.intp]) -> list[str]:
    """Return labels of commands, which sort as text in the order of their numbers."""
    digits = max(5, len(str(number.max(initial=0) + 1)))
    return [f"P{k:0{digits}d}" for k in number + 1]
