"""Reads a file that is no text from standard input, in a process of its own with limited memory.

Readers of other packages may take all memory or abort: one far cell, or a few bytes that unpack to
gigabytes, suffice. Nothing of the project is imported here. Standard output has rows,
`number<tab>cells` with tabs between cells; errors, `!kind<tab>words`; and parts that are not read,
`?<tab>words`.

python -P binary_child.py KIND NAMES BYTES SECONDS UNPACKED CELLS < file
"""

from __future__ import annotations

import json
import os
import re
import resource
import sys
import zipfile
from collections import Counter
from collections.abc import Iterable, Iterator
from datetime import date, datetime, time
from pathlib import Path
from struct import unpack
from tempfile import TemporaryDirectory
from typing import Any

_INPUT = "/dev/fd/0"
_BLOCK_BYTES = 1 << 20
#: Parts of a workbook, at most; usual are a few tens.
_MOST_PARTS = 10_000
#: The time for reading and writing is so many times that for reading.
_WRITING = 4
_CELL = re.compile(rb""" r=["']([A-Z]{1,3})([0-9]{1,7})["']""")
#: Cells in columns beyond those of any table, which are quick to search for.
_FAR_COLUMN = re.compile(rb""" r=["']([A-Z]{3})([0-9]{1,7})["']""")
#: Words that stand for no value.
_NONE = frozenset(
    ("", "#N/A", "#N/A N/A", "#NA", "-1.#IND", "-1.#QNAN", "-NaN", "-nan", "1.#IND", "1.#QNAN")
) | frozenset(("<NA>", "N/A", "NA", "NULL", "NaN", "None", "n/a", "nan", "null"))


class _UnfitError(Exception):
    """An error of a file: its kind, and the offending value."""


def _main(
    kind: str, names: str, most_bytes: int, most_s: int, most_unpacked: int, most_cells: int
) -> str:
    """Print the rows of a file, and return an error; empty for none."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (most_bytes, most_bytes))
    resource.setrlimit(resource.RLIMIT_CPU, (most_s, _WRITING * most_s))
    # Every thread takes memory of its own.
    os.environ |= {"OPENBLAS_NUM_THREADS": "1", "ARROW_DEFAULT_MEMORY_POOL": "system"}
    if kind == "workbook":
        return _workbook(most_s, most_unpacked, most_cells)
    called: dict[str, list[str]] = json.loads(names)
    if kind in _BAGS:
        columns = _bag(kind, called)
    else:
        readers = {"mat": _mat, "npz": _npz, "json": _json, "parquet": _parquet, "c3d": _c3d}
        columns = readers[kind](most_unpacked, called)
    _print_arrays(columns, called, most_s)
    return ""


# Workbooks.


def _workbook(most_s: int, most_unpacked: int, most_cells: int) -> str:
    """Print the rows of the sheet with the most cells, and return an error; empty for none."""
    if zipfile.is_zipfile(_INPUT):
        with zipfile.ZipFile(_INPUT) as archive:
            if len(archive.infolist()) > _MOST_PARTS:
                return f"!unreadable\t{len(archive.infolist())} parts"
            unpacked = sum(each.file_size for each in archive.infolist())
            if unpacked > most_unpacked:
                return f"!unpacked\t{unpacked / 1e6:.0f} MB"
            for name in archive.namelist():
                if name.startswith("xl/worksheets/") and (cell := _far(archive, name, most_cells)):
                    return f"!cell\t{cell}"

    from python_calamine import SheetTypeEnum, load_workbook

    book, most, best = load_workbook(_INPUT), -1, None
    sheets = [each for each in book.sheets_metadata if each.typ == SheetTypeEnum.WorkSheet]
    for each in sheets:
        sheet = book.get_sheet_by_name(each.name)
        several = len(sheets) > 1
        cells = sum(len(row) - row.count("") for row in sheet.iter_rows()) if several else 0
        if cells > most:
            most, best = cells, sheet
    if best is None or best.start is None:
        return ""
    # The book is in memory; only the time for writing is limited from here on.
    resource.setrlimit(resource.RLIMIT_CPU, (_WRITING * most_s,) * 2)
    left = "\t" * best.start[1]
    for number, row in enumerate(best.iter_rows(), start=1):
        text = "\t".join(map(_text, row))
        if text.strip("\t"):
            sys.stdout.write(f"{number}\t{left}{text}\n")
    return ""


def _far(archive: zipfile.ZipFile, name: str, most_cells: int) -> str:
    """Return a cell that makes a sheet too large; empty for none."""
    rest = b""
    with archive.open(name) as file:
        while block := file.read(_BLOCK_BYTES):
            block = rest + block
            rest = block[-40:]
            last = block.rfind(b" r=", 0, -20)
            for found in (_FAR_COLUMN.search(block), last >= 0 and _CELL.search(block, last)):
                if found and _column(found[1]) * int(found[2]) > most_cells:
                    return (found[1] + found[2]).decode()
    return ""


def _column(letters: bytes) -> int:
    number = 0
    for letter in letters:
        number = number * 26 + letter - 64
    return number


def _text(value: object) -> str:
    """Return a cell: numbers in full, times as ISO 8601."""
    if isinstance(value, float):
        if value != value:
            return ""
        return str(int(value)) if value.is_integer() else str(value)
    if isinstance(value, datetime | time):
        return value.isoformat()
    if isinstance(value, date):
        return datetime(value.year, value.month, value.day).isoformat()
    text = str(value)
    return "" if text in _NONE else " ".join(text.split())


# Arrays by name: MATLAB, NumPy, JSON, Parquet.

#: Columns of a data set of lerobot: episode of a row, and time since the beginning of the episode.
_EPISODE, _EPISODE_TIME = "episode_index", "timestamp"
#: Names of vectors that are joints, not places.
_JOINTS = re.compile(
    r"(?:.*[^a-z])?(?:q|th|theta|thetas|j|joint|joints|jnt|axis|axes|angles?)\d*", re.I
)
#: Vectors of this length are x, y, z; arrays of these shapes are matrices.
_XYZ, _MATRICES = 3, ((4, 4), (3, 4), (3, 3))


def _mat(most_unpacked: int, _: object) -> dict[str, Any]:
    import scipy.io

    sizes = scipy.io.whosmat(_INPUT)
    cells = sum(_product(shape) for _, shape, _ in sizes)
    if 8 * cells > most_unpacked:
        raise _UnfitError("unpacked", f"{8e-6 * cells:.0f} MB")
    found = scipy.io.loadmat(_INPUT, simplify_cells=True)
    if not any(name[:2] != "__" for name in found if name) and "__function_workspace__" in found:
        raise _UnfitError("objects", "a table, timeseries or object of MATLAB alone")
    return {name: value for name, value in found.items() if name and name[:2] != "__"}


def _product(shape: Iterable[int]) -> int:
    count = 1
    for size in shape:
        count *= size
    return count


def _npz(most_unpacked: int, _: object) -> dict[str, Any]:
    import numpy as np

    if zipfile.is_zipfile(_INPUT):
        with zipfile.ZipFile(_INPUT) as archive:
            unpacked = sum(each.file_size for each in archive.infolist())
        if unpacked > most_unpacked:
            raise _UnfitError("unpacked", f"{unpacked / 1e6:.0f} MB")
    found = np.load(_INPUT, allow_pickle=False)
    if isinstance(found, np.ndarray):
        fields = found.dtype.names
        return {"": found} if fields is None else {name: found[name] for name in fields}
    return dict(found)


def _json(_: int, __: object) -> dict[str, Any]:
    """Return the content of a document, or of all lines of a file with a record in each."""
    text = Path(_INPUT).read_text(encoding="utf-8-sig")
    try:
        found = json.loads(text)
    except json.JSONDecodeError as whole:
        lines = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
        if whole.msg != "Extra data":
            raise _UnfitError("json", f"{whole.lineno}\t{whole.msg}") from None
        found = []
        for k, line in lines:
            try:
                found.append(json.loads(line))
            except json.JSONDecodeError as error:
                raise _UnfitError("json", f"{k}\t{error.msg}") from None
    return found if isinstance(found, dict) else {"": found}


def _parquet(_: int, __: object) -> dict[str, Any]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    file = pq.ParquetFile(_INPUT)

    def of_numbers(kind: pa.DataType) -> bool:
        if pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind):
            kind = kind.value_type
        nested = pa.types.is_nested(kind) or pa.types.is_binary(kind)
        return not nested and not pa.types.is_large_binary(kind)

    read = [each.name for each in file.schema_arrow if of_numbers(each.type)]
    table = file.read(columns=read, use_threads=False)
    left_out = [each.name for each in file.schema_arrow if each.name not in read]
    _note(", ".join(left_out))
    return {name: table.column(name).to_pylist() for name in read}


# Motion capture (C3D) and bags of ROS: times and targets, or joints.

_BAGS = ("bag", "db3", "mcap")
_JOINT_STATE = "sensor_msgs/msg/JointState"
#: Attribute of a message that holds the target, by its type; the last holds a list of targets.
_PLACES = {
    "geometry_msgs/msg/PoseStamped": "pose",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "pose.pose",
    "geometry_msgs/msg/PointStamped": "point",
    "geometry_msgs/msg/TransformStamped": "transform",
    "nav_msgs/msg/Odometry": "pose.pose",
    "tf2_msgs/msg/TFMessage": "transforms",
}


def _c3d(_: int, called: dict[str, list[str]]) -> dict[str, Any]:
    import ezc3d
    import numpy as np

    file = ezc3d.c3d(_INPUT)
    about = file["parameters"]["POINT"]
    places = file["data"]["points"][:3]
    head = Path(_INPUT).read_bytes()[6:10]  # first and last frame, in either order of the bytes
    promised = min(last - first + 1 for first, last in (unpack("<HH", head), unpack(">HH", head)))
    if places.shape[2] < promised:
        raise _UnfitError("unreadable", f"{places.shape[2]} of {promised} frames are there")
    unseen = (file["data"]["meta_points"]["residuals"][0] < 0.0) | (places == 0.0).all(axis=0)
    places = np.where(unseen, np.nan, places)
    unit = (about["UNITS"]["value"] or ["mm"])[0].strip() or "mm"
    frames = np.arange(places.shape[2])
    columns: dict[str, Any] = {"Frame": frames + 1}
    columns["Time [s]"] = np.round(frames / float(about["RATE"]["value"][0]), 6)
    for k, label in enumerate(about["LABELS"]["value"][: places.shape[1]]):
        name = label.rpartition(":")[2].strip() or f"marker {k + 1}"
        columns[name] = places[:, k].T
        called[name] = [f"{name} {axis} [{unit}]" for axis in "xyz"]
    return columns


def _bag(kind: str, called: dict[str, list[str]]) -> dict[str, Any]:
    """Return the joints of the topic with most joint states; without any, the targets."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with Path(_INPUT).open("rb") as file:
        head, size = file.read(32), os.fstat(file.fileno()).st_size
    pages, page = int.from_bytes(head[28:32]), int.from_bytes(head[16:18])  # of SQLite
    if kind == "db3" and size < pages * page:
        raise _UnfitError("unreadable", f"{size} of {pages * page} bytes are there")
    with TemporaryDirectory() as folder:
        link = Path(folder) / f"bag.{kind}"  # its end says how it is read
        link.symlink_to(_INPUT)
        with AnyReader([link], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
            known = [each for each in bag.connections if each.msgtype in (_JOINT_STATE, *_PLACES)]
            if not known:
                topics = ", ".join(f"{each.topic} ({each.msgtype})" for each in bag.connections)
                raise _UnfitError("topics", topics or "no topic")
            topic = max(known, key=lambda each: (each.msgtype == _JOINT_STATE, each.msgcount)).topic
            read = [each for each in known if each.topic == topic]
            _note(", ".join(dict.fromkeys(c.topic for c in bag.connections if c.topic != topic)))
            rows: list[tuple[float, dict[str, list[float]]]] = []
            for connection, logged_ns, raw in bag.messages(connections=read):
                message = bag.deserialize(raw, connection.msgtype)
                rows += _row_of(message, connection.msgtype, 1e-9 * logged_ns)
    return _joined_rows(rows, called, joints=read[0].msgtype == _JOINT_STATE)


def _row_of(message: Any, kind: str, logged_s: float) -> list[tuple[float, dict[str, list[float]]]]:
    """Return time and values of a message, by the name of each joint or target."""

    def stamped(of: Any) -> float:
        stamp = of.header.stamp
        return float(stamp.sec + 1e-9 * stamp.nanosec) or logged_s

    if kind == _JOINT_STATE:
        joints = zip(message.name, message.position, strict=False)
        return [(stamped(message), {name: [float(value)] for name, value in joints})]
    if kind.endswith("TFMessage"):
        return [
            (stamped(each), {each.child_frame_id: _place(each.transform)})
            for each in message.transforms
        ]
    place = message
    for part in _PLACES[kind].split("."):
        place = getattr(place, part)
    return [(stamped(message), {getattr(message, "child_frame_id", "") or "target": _place(place)})]


def _place(of: Any) -> list[float]:
    """Return x, y, z, and qx, qy, qz, qw if there is an orientation."""
    at = getattr(of, "position", None) or getattr(of, "translation", None) or of
    turned = getattr(of, "orientation", None) or getattr(of, "rotation", None)
    turn = () if turned is None else (turned.x, turned.y, turned.z, turned.w)
    return [float(value) for value in (at.x, at.y, at.z, *turn)]


def _joined_rows(
    rows: list[tuple[float, dict[str, list[float]]]], called: dict[str, list[str]], *, joints: bool
) -> dict[str, Any]:
    """Return arrays by joint or target, of rows that each hold some of them; nan where missing."""
    import numpy as np

    width = {name: len(values) for _, row in rows for name, values in row.items()}
    words = [f"{axis} [m]" for axis in "xyz"] + ["qx", "qy", "qz", "qw"]
    columns: dict[str, Any] = {"Time [s]": np.array([time_s for time_s, _ in rows])}
    for name, count in width.items():
        none = [np.nan] * count
        columns[name] = np.array([row.get(name, none) for _, row in rows])
        called[name] = [f"{name} [rad]"] if joints else [f"{name} {word}" for word in words[:count]]
    return columns


def _note(not_read: str) -> None:
    if not_read:
        print(f"?\t{' '.join(not_read.split())} not read")


def _flat(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the arrays in nested fields and in lists of records, by dotted names."""
    import numpy as np

    if isinstance(value, np.ndarray) and value.dtype == object:
        value = value.tolist()
    if isinstance(value, list) and value and all(isinstance(each, dict) for each in value):
        keys = dict.fromkeys(key for each in value for key in each)
        value = {key: [each.get(key) for each in value] for key in keys}
    if isinstance(value, dict):
        for key, part in value.items():
            yield from _flat(f"{name}.{key}" if name else str(key), part)
        return
    try:
        array = np.asarray(value)
    except ValueError:  # rows of several lengths
        return
    if array.dtype == object:
        filled = [np.nan if each is None else each for each in array.ravel().tolist()]
        try:
            array = np.array(filled, dtype=float).reshape(array.shape)
        except (TypeError, ValueError):
            array = np.array([_text("" if each is None else each) for each in array.tolist()])
    yield name, array


def _print_arrays(columns: dict[str, Any], called: dict[str, list[str]], most_s: int) -> None:
    """Print the arrays with the commonest number of rows, each column with a name."""
    import numpy as np

    arrays = {name: np.squeeze(array) for top in columns.items() for name, array in _flat(*top)}
    arrays = {name: array for name, array in arrays.items() if 0 < array.ndim <= 3}
    episodes = len(set(arrays.get(_EPISODE, np.zeros(1)).tolist()))
    if episodes > 1 and arrays.pop(_EPISODE_TIME, None) is not None:
        _note(f"{_EPISODE_TIME} (it begins anew in each of {episodes} episodes)")
    count: Counter[int] = Counter()
    for array in arrays.values():
        for size in {array.shape[0], array.shape[-1]}:
            count[size] += array.size // max(size, 1)
    # The length with most numbers; a matrix is longer than wide.
    rows = max(count, key=lambda size: (size > 1, count[size] * min(size, 1000)), default=0)
    named, parts, left_out = [], [], []
    for name, array in arrays.items():
        if rows not in (array.shape[0], array.shape[-1]) or rows < 2:
            left_out.append(name)
            continue
        turned = array if array.shape[0] == rows else np.moveaxis(array, -1, 0)
        named += _named(name, turned, called.get(name))
        parts += list(turned.reshape(rows, -1).T)
    _note(", ".join(left_out))
    if not parts:
        raise _UnfitError("arrays", ", ".join(arrays) or "no array")
    resource.setrlimit(resource.RLIMIT_CPU, (_WRITING * most_s,) * 2)
    first = 1
    if any(named):
        sys.stdout.write("1\t" + "\t".join(" ".join(name.split()) for name in named) + "\n")
        first = 2
    fields = [_fields(part) for part in parts]
    for number, row in enumerate(zip(*fields, strict=True), start=first):
        sys.stdout.write(f"{number}\t" + "\t".join(row) + "\n")


def _named(name: str, array: Any, called: list[str] | None) -> list[str]:
    """Return a name for each column of an array (N, …); empty ones for an array without a name."""
    width = array.size // len(array)
    if called is not None and len(called) == width:
        return called
    if array.ndim == 1 or not name:
        return [name] * width
    if array.shape[1:] in _MATRICES:
        lines, across = array.shape[1:]
        return [f"{name}_{k}{j}" for k in range(1, lines + 1) for j in range(1, across + 1)]
    if width == _XYZ and not _JOINTS.fullmatch(name):
        return [f"{name} {axis}" for axis in "xyz"]
    return [f"{name}_{k}" for k in range(1, width + 1)]


def _fields(values: Any) -> list[str]:
    """Return a column as text: numbers in full, times as ISO 8601, blanks for missing values."""
    if values.dtype.kind == "f":
        return ["" if text == "nan" else text for text in values.astype(str).tolist()]
    return [_text(each) for each in values.tolist()]


if __name__ == "__main__":
    sys.stdout.reconfigure(encoding="utf-8", errors="replace", newline="\n")  # type: ignore[union-attr]
    try:
        wrong = _main(*sys.argv[1:3], *map(int, sys.argv[3:]))  # type: ignore[arg-type]
    except _UnfitError as error:
        wrong = f"!{error.args[0]}\t{error.args[1]}"
    except MemoryError:
        wrong = "!memory\t"
    except BrokenPipeError:  # whoever reads has seen enough
        wrong = ""
    except Exception as error:  # of a reader that is not ours
        said = re.sub(r"/\S*/bag\.\w+", "the bag", str(error))  # not where it was linked to
        wrong = f"!unreadable\t{' '.join(said.split())}"
    if wrong:
        print(wrong)
