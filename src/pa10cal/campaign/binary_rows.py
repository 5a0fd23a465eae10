"""Rows of files that are no text, read in a child process whose death is a refusal.

See `binary_child`. Its limits of memory and time hold whatever a file promises. A table of a
million rows of ten numbers is within them.
"""

from __future__ import annotations

import importlib.util
import json
import re
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO

from pa10cal.errors import MissingPackageError, RawDataError

#: Limits of the child: memory [bytes], time on the processor [s].
MOST_BYTES, MOST_S = 1_025_000_000, 18
#: Largest file, unpacked [bytes], and largest sheet of a workbook [cells].
MOST_UNPACKED, MOST_CELLS = 1_000_000_000, 20_000_000

#: Bags of ROS 1, and of ROS 2 in its two ways to store them.
BAGS = ("bag", "db3", "mcap")
#: Bytes at the beginning of a file by which its kind is recognised.
HEAD_BYTES = 1024
#: Beginnings of files, by kind; of archives (.xlsx, .ods), and of older workbooks (.xls).
_BEGINNINGS = (
    (b"\xd0\xcf\x11\xe0", "workbook"),
    (b"MATLAB 7.3 MAT-file", "hdf5"),
    (b"\x89HDF\r\n\x1a\n", "hdf5"),
    (b"MATLAB 5.0 MAT-file", "mat"),
    (b"PAR1", "parquet"),
    (b"\x93NUMPY", "npz"),
    (b"#ROSBAG V2.0", "bag"),
    (b"SQLite format 3\x00", "db3"),
    (b"\x89MCAP0\r\n", "mcap"),
)
#: C3D: the first byte is the block of the parameters, the second is 0x50.
_C3D = re.compile(rb"[\x01-\x08]\x50", re.DOTALL)
_ARCHIVE = b"PK\x03\x04"
_JSON = re.compile(rb'(?:\xef\xbb\xbf)?\s*(?:\[\s*)?\{\s*(?:"|\})')
#: Optional packages by the kind that they read.
_BAG = "rosbags"
_PACKAGES = {"workbook": "python_calamine", "c3d": "ezc3d"} | dict.fromkeys(BAGS, _BAG)
_TITLES = {
    "workbook": "the workbook",
    "mat": "the MATLAB file",
    "npz": "the NumPy file",
    "json": "the JSON file",
    "parquet": "the Parquet file",
    "c3d": "the C3D file",
} | dict.fromkeys(BAGS, "the bag")


def kind_of_bytes(head: bytes, suffix: str) -> str:
    """Return the kind of a file that is read as arrays or cells; empty for text."""
    for beginning, kind in _BEGINNINGS:
        if head.startswith(beginning):
            return kind
    if head.startswith(_ARCHIVE) and suffix != ".zip":
        return "npz" if suffix == ".npz" else "workbook"
    if suffix == ".mat" and b"\x00" in head:  # version 4 has no words at its beginning
        return "mat"
    if _C3D.match(head):
        return "c3d"
    return "json" if _JSON.match(head) else ""


def rows_of_binary(
    kind: str, path: Path, file: IO[bytes], names: Mapping[str, Sequence[str]], notes: list[str]
) -> Iterator[tuple[int, str]]:
    """Yield the rows of a file: numbers from 1, tabs between the cells.

    Of a workbook they are those of the sheet with the most cells; of arrays those of the length
    that most columns have, below a row of names.

    Args:
        kind: what the file is, see `kind_of_bytes`.
        path: what messages name.
        file: the file, open at its beginning.
        names: names of the columns of arrays, by the name of the array.
        notes: a list to which parts that are not read are added.

    Raises:
        RawDataError: when it cannot be read, or not within limits of memory and time.
    """
    if kind == "hdf5":
        raise RawDataError(
            "the file is HDF5, as MATLAB writes it with -v7.3",
            where=str(path),
            allowed="a MATLAB file of version 7 or before, or text",
            remedy="in MATLAB save it as version 7, save('name.mat', '-v7'), or write a table: "
            "writematrix([q p], 'name.csv')",
        )
    package = _PACKAGES.get(kind)
    if package is not None and importlib.util.find_spec(package) is None:
        raise MissingPackageError(package)
    limits = (MOST_BYTES, MOST_S, MOST_UNPACKED, MOST_CELLS)
    child = subprocess.Popen(
        [sys.executable, "-P", str(Path(__file__).with_name("binary_child.py"))]
        + [kind, json.dumps({name: list(of) for name, of in names.items()})]
        + [str(limit) for limit in limits],
        stdin=file,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        encoding="utf-8",
    )
    assert child.stdout is not None
    try:
        for line in child.stdout:
            number, _, text = line.removesuffix("\n").partition("\t")
            if number.startswith("!"):
                raise _refused(path, kind, number[1:], text)
            if number == "?":
                notes.append(text)
            else:
                yield int(number), text
        if child.wait():
            slow = -child.returncode in (signal.SIGXCPU, signal.SIGKILL)
            raise _refused(path, kind, "time" if slow else "memory", "")
    finally:
        child.kill()
        child.stdout.close()
        child.wait()


#: Refusals (message, what is allowed, remedy) by the reason of the child, and by the kind of
#: file where that matters.
_REFUSALS = {
    "unreadable": (
        "{title} cannot be read",
        "a whole file, as it was written",
        "copy or save it again, or export the rows as text",
    ),
    "unreadable workbook": (
        "{title} cannot be read",
        "a workbook without a password (.xlsx, .ods or .xls)",
        "save it again, or export the sheet as text",
    ),
    "json": (
        "{title} is cut short or damaged",
        "a whole document, or a whole record in each line",
        "copy or save it again",
    ),
    "objects": (
        "{title} holds no arrays",
        "matrices, or structs of them",
        "in MATLAB write it as text: writetable(T, 'name.csv')",
    ),
    "topics": (
        "{title} holds neither joints nor a target",
        "messages of sensor_msgs/JointState, or of geometry_msgs: PoseStamped, PointStamped, "
        "TransformStamped; tf",
        "record the topic of the joints' states, or that of the target",
    ),
    "arrays": (
        "{title} holds no arrays with a row for each configuration",
        "arrays of as many rows: joint positions, and what was measured",
        "save both with a row for each configuration, or export them as text",
    ),
    "cell": (
        "a cell stands far from the others",
        "a sheet of at most {cells} cells, counted from A1 to the last one",
        "delete the rows and columns beyond the table, or save the sheet as CSV",
    ),
    "unpacked": (
        "{title}, unpacked, is larger than is read",
        "at most {unpacked_mb:.0f} MB",
        "save what is needed as CSV",
    ),
    "unpacked workbook": (
        "{title}, unpacked, is larger than is read",
        "at most {unpacked_mb:.0f} MB",
        "save the sheet as CSV, without what is not needed",
    ),
}


def _refused(path: Path, kind: str, why: str, said: str) -> RawDataError:
    limits = {"cells": MOST_CELLS, "unpacked_mb": MOST_UNPACKED / 1e6}
    where, value = str(path), said
    if why in ("memory", "time"):
        what = "{title} needs more memory or time than tables of readings do"
        allowed = f"at most {MOST_BYTES / 1e6:.0f} MB and {MOST_S} s"
        remedy = f"save {'the sheet' if kind == 'workbook' else 'what is needed'} as CSV"
        value = f"more {why}"
    else:
        what, allowed, remedy = _REFUSALS.get(f"{why} {kind}") or _REFUSALS[why]
    if why == "json":
        line, _, value = said.partition("\t")
        where = f"{path}:{line}"
    return RawDataError(
        what.format(title=_TITLES[kind]),
        where=where,
        value=value,
        allowed=allowed.format(**limits),
        remedy=remedy,
    )
