"""Known formats of files: how the content shows each, what it holds, and how it is read."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path

import numpy as np

from pa10cal.arrays import Array
from pa10cal.campaign.controller_programs import (
    abb_points,
    fanuc_points,
    fanuc_registers,
    kuka_points,
    yaskawa_points,
)
from pa10cal.campaign.instrument_exports import (
    begins_blocks,
    begins_controls,
    begins_features,
    begins_named_points,
    block_table,
    control_table,
    feature_table,
    motive_table,
    named_points,
    qualisys_table,
    vicon_table,
)
from pa10cal.campaign.matrices import matrix_columns
from pa10cal.campaign.recognise import polar_columns, roles_of
from pa10cal.campaign.text_lines import BAGS, TextLine, binary_kind, lines_of
from pa10cal.errors import RawDataError

#: Lines at the beginning of a file by which its format is recognised.
HEAD = 60
#: Makes a table with tabs of the lines of a file: its arguments are the lines, the file's name in
#: messages, and a list of notes to which parts that are not in the table are added.
TableOf = Callable[[Iterator[TextLine], str, list[str]], Iterator[TextLine]]


@dataclass(frozen=True)
class Format:
    """A format of files: programs of controllers, exports of instruments."""

    name: str  # in campaign.yaml
    title: str  # in messages and docs
    told_by: str  # content that shows it, in words
    holds: str  # what it holds, in words
    # whether the first lines, in lower case, show it
    begins: Callable[[Sequence[str]], bool] = lambda _: False
    # whether names and numbers (N, k) of the columns of a plain table show it
    columns: Callable[[Sequence[str], Array], bool] = lambda *_: False
    table: TableOf | None = None  # makes the table; None of a plain table
    kind: str = ""  # the kind of a file that is no text, see `binary_kind`
    measured: bool | None = None  # True for readings, False for joint positions, None for either


_XYZ = "xyz"
_RTDE = re.compile(r"(actual|target)_q_?\[?[05]\]?")
_RAPID = re.compile(
    r"\s*module \w+\s*(\(.*)?$|\s*((local|task) )?(const|pers|var) (joint|rob)target "
)


def _some_line(*beginnings: str) -> Callable[[Sequence[str]], bool]:
    """Return a test whether any line has one of these beginnings."""
    return lambda head: any(line.lstrip(" \t&").startswith(beginnings) for line in head)


def _first_line(beginning: str) -> Callable[[Sequence[str]], bool]:
    """Return a test whether the first line has this beginning."""
    return lambda head: head[0].lstrip('" ').startswith(beginning)


_ARRAYS = (
    "arrays with a row (or a column) for each configuration, by their names; three columns are x, "
    "y, z unless joints are called so; matrices of 4 by 4"
)

FORMATS = (
    Format(
        "motive",
        "OptiTrack Motive",
        "`Format Version` at the beginning of the first line",
        "rigid bodies (position, quaternion) and markers in the take's own unit and axes (Y up or "
        "Z up is the same: the base is found), time",
        _first_line("format version,"),
        table=motive_table,
        measured=True,
    ),
    Format(
        "vicon",
        "Vicon Nexus or Tracker",
        "a section `Trajectories`, `Segments` or `Objects`, and its line `Frame,Sub Frame`",
        "markers, or bodies with their orientation; time by the frame and the rate",
        lambda head: any(line.startswith("frame,sub frame") for line in head),
        table=vicon_table,
        measured=True,
    ),
    Format(
        "qualisys",
        "Qualisys QTM, TSV",
        "the line `NO_OF_FRAMES`",
        "markers, or bodies with their matrix; zeros are targets that were not seen",
        _some_line("no_of_frames\t"),
        table=qualisys_table,
        measured=True,
    ),
    Format(
        "blocks",
        "blocks of named values, as T-Scan writes them",
        "`Pos 1`, then lines such as `X= 1.0 Y= 2.0 Z= 3.0`",
        "a row for each line, under the number of its block; rows of one number are repeats",
        begins_blocks,
        table=block_table,
        measured=True,
    ),
    Format(
        "spatialanalyzer",
        "SpatialAnalyzer, points as text",
        "a comment `//` that names the fields of the rows, X, Y and Z among them",
        "labels (collection, group, point) and positions; without that comment as points without "
        "names, below",
        begins_named_points,
        table=named_points,
        measured=True,
    ),
    Format(
        "polyworks",
        "PolyWorks Inspector, control view",
        "columns `Object Name`, `Control` and `Meas`",
        "measured X, Y and Z of each object, in the unit that the report states",
        begins_controls,
        table=control_table,
        measured=True,
    ),
    Format(
        "faro",
        "FARO CAM2, tabular report",
        "columns `actual` and `nominal`",
        "the actual centre of each feature; single readings of a feature are not read",
        begins_features,
        table=feature_table,
        measured=True,
    ),
    Format(
        "kuka",
        "KUKA data list (`.dat`)",
        "the line `DEFDAT`",
        "points of E6AXIS and AXIS; XP1 is called P1",
        _some_line("defdat "),
        table=kuka_points,
        measured=False,
    ),
    Format(
        "fanuc_ls",
        "FANUC program (`.ls`)",
        "the line `/PROG`",
        "points taught as joint positions, of group 1",
        _some_line("/prog"),
        table=fanuc_points,
        measured=False,
    ),
    Format(
        "fanuc_posreg",
        "FANUC position registers (`posreg.va`)",
        "`$POSREG` in the first lines",
        "registers with joint positions, of group 1, called PR1, PR2, …",
        lambda head: any("]$posreg" in line for line in head[:3]),
        table=fanuc_registers,
        measured=False,
    ),
    Format(
        "abb",
        "ABB RAPID module (`.mod`)",
        "the line `MODULE`, or a `jointtarget` or `robtarget`",
        "jointtargets, declared, in arrays or in MoveAbsJ; robtargets are poses of the tool and "
        "are not read",
        lambda head: any(map(_RAPID.match, head)),
        table=abb_points,
        measured=False,
    ),
    Format(
        "yaskawa",
        "Yaskawa job (`.jbi`)",
        "the line `/JOB`",
        "pulses of the motors, or poses of the tool: refused, with what to export",
        _first_line("/job"),
        table=yaskawa_points,
        measured=False,
    ),
    Format(
        "mat",
        "MATLAB file (`.mat`)",
        "its first letters; version 7.3 (HDF5) is refused, with what to save",
        f"{_ARRAYS}; structs within structs too",
        kind="mat",
    ),
    Format("npz", "NumPy file (`.npz`, `.npy`)", "its first letters", _ARRAYS, kind="npz"),
    Format(
        "parquet",
        "Parquet table, as lerobot writes it",
        "its first letters",
        "columns, lists of numbers as several; those of `observation.state` by the names in "
        "`meta/info.json` or `info.json` beside the file",
        kind="parquet",
    ),
    Format(
        "json",
        "JSON",
        "a record at the beginning",
        "a list of records, a record a line, or lists by name, as of Parquet",
        kind="json",
    ),
    Format(
        "c3d",
        "C3D",
        "its first bytes; needs the extra `c3d`",
        "markers with their unit, time by the frame and the rate; analog channels are not read",
        kind="c3d",
        measured=True,
    ),
    *(
        Format(
            kind,
            f"bag of {title} (`.{kind}`)",
            "its first bytes; needs the extra `bags`",
            "of the topic with most messages the joints of JointState, else a target's place and "
            "orientation (PoseStamped, PointStamped, TransformStamped, tf), at the time of their "
            "stamps; other topics are named",
            kind=kind,
        )
        for kind, title in zip(BAGS, ("ROS 1", "ROS 2", "ROS 2"), strict=True)
    ),
    Format(
        "rtde",
        "Universal Robots RTDE log",
        "columns `actual_q_0` or `target_q_0` …",
        "joint positions in rad, times; `actual_TCP_pose` is what the controller computes and no "
        "measurement",
        columns=lambda names, _: any(_RTDE.fullmatch(name) for name in names),
        measured=False,
    ),
    Format(
        "matrix",
        "matrices of 4 by 4",
        "16 numbers a row that are a rotation and a place, row by row or column by column (the "
        "zeros tell which), or 12 without the last row",
        "position and orientation; of several the first that moves and is not commanded",
        columns=lambda names, numbers: bool(matrix_columns(names, numbers)),
    ),
    Format(
        "points",
        "points as text without names (SpatialAnalyzer, PolyWorks, Leica, FARO)",
        "no line of names; three numbers a row, after words, below lines of comments",
        "labels and positions; what the columns of a file without names are is found by the "
        "nominal arm",
        columns=lambda names, numbers: (
            names == tuple(map(str, range(1, len(names) + 1)))
            and np.isfinite(numbers).all(axis=0).sum() == len(_XYZ)
            and np.isnan(numbers).all(axis=0).sum() == len(names) - len(_XYZ)
        ),
        measured=True,
    ),
    Format(
        "polar",
        "polar readings",
        "columns such as `Hz`, `V`, `D` and none of x, y, z; deg, gon or rad",
        "positions; how the angles count is found by the nominal arm",
        columns=lambda names, _: (
            polar_columns(names) is not None and not roles_of(names, None).positions
        ),
    ),
)
#: Formats whose table is made of their files, by name.
BY_NAME = {each.name: each for each in FORMATS if each.table is not None}


def format_of_file(path: Path, within: Path | None = None) -> Format | None:
    """Return the known format of a file, None for none; see `lines_of`."""
    if kind := binary_kind(path, within):
        return next((each for each in FORMATS if each.kind == kind), None)
    head = [line.text.lower() for line in islice(lines_of(path, within), HEAD)]
    return next((each for each in FORMATS if head and each.begins(head)), None)


def format_of_columns(names: Sequence[str], numbers: Array) -> Format | None:
    """Return the known format of a plain table with columns (N, k) of numbers; None for none."""
    return next((each for each in FORMATS if each.columns(names, numbers)), None)


def table_lines(
    path: Path, name: str | None = None, within: Path | None = None, notes: list[str] | None = None
) -> Iterator[TextLine]:
    """Yield the lines of a file, or of the table that a file of a known format holds.

    Raises:
        RawDataError: as `lines_of`, and when the file is none of that format.
    """
    notes = [] if notes is None else notes
    lines = lines_of(path, within, notes)
    if not name:
        yield from lines
        return
    known, head = BY_NAME[name], list(islice(lines, HEAD))
    if not head or not known.begins([line.text.lower() for line in head]):
        raise RawDataError(
            f"the file is no {known.title}",
            where=f"{path}:{head[0].number if head else 1}",
            value=head[0].text[:80] if head else "an empty file",
            allowed=known.told_by,
            remedy="give the file that was described, or propose anew: "
            f"pa10cal columns {path.name}",
        )
    assert known.table is not None
    yield from known.table(chain(head, lines), str(path), notes)
