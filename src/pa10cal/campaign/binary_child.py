"""Reads a file that is no text from standard input, in a process of its own with limited memory.

Readers of other packages may take all memory or abort: one far cell, or a few bytes that unpack to
gigabytes, suffice. Nothing of the project is imported here. Lines of standard output are a row,
`number<tab>cells` with tabs between the cells; an error, `!kind<tab>words`; or parts of the file
that are not read, `?<tab>words`. NAMES is JSON: names of the columns of an array, by its name.

python -P binary_child.py KIND NAMES BYTES SECONDS UNPACKED CELLS < file
"""

from __future__ import annotations

import json
import math
import os
import re
import resource
import sys
import zipfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from datetime import date, datetime, time
from functools import partial
from pathlib import Path
from struct import unpack
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

_INPUT = "/dev/fd/0"
_BLOCK_BYTES = 1 << 20
#: Parts of a workbook, at most; usual are a few tens.
_MOST_PARTS = 10_000
#: Time for reading and writing, in units of the time for reading.
_TIME_FACTOR = 4
#: Address of a cell in the XML of a sheet: column and row.
_CELL = re.compile(rb""" r=["']([A-Z]{1,3})([0-9]{1,7})["']""")
#: Bytes kept of a block, so that an address that is cut by its end is found in the next.
_LONGEST_ADDRESS = 40
#: Addresses in columns beyond those of any table, which are quick to search for.
_FAR_COLUMN = re.compile(rb""" r=["']([A-Z]{3})([0-9]{1,7})["']""")
#: Words that stand for no value.
_NO_VALUE = frozenset(
    ("", "#N/A", "#N/A N/A", "#NA", "-1.#IND", "-1.#QNAN", "-NaN", "-nan", "1.#IND", "1.#QNAN")
) | frozenset(("<NA>", "N/A", "NA", "NULL", "NaN", "None", "n/a", "nan", "null"))


class _UnfitError(Exception):
    """What is wrong with a file: its kind, as the parent process knows it, and the value."""


def _main(
    kind: str, names: str, most_bytes: int, most_s: int, most_unpacked: int, most_cells: int
) -> None:
    """Print the rows of a file within limits of memory, time and size."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (most_bytes, most_bytes))
    resource.setrlimit(resource.RLIMIT_CPU, (most_s, _TIME_FACTOR * most_s))
    # Every thread takes memory of its own.
    os.environ |= {"OPENBLAS_NUM_THREADS": "1", "ARROW_DEFAULT_MEMORY_POOL": "system"}
    if kind == "workbook":
        _print_workbook(most_s, most_unpacked, most_cells)
        return
    column_names: dict[str, list[str]] = json.loads(names)
    readers: dict[str, Callable[[], dict[str, Any]]] = {
        "mat": partial(_mat, most_unpacked),
        "npz": partial(_npz, most_unpacked),
        "json": _json,
        "parquet": _parquet,
        "c3d": partial(_c3d, column_names),
        **dict.fromkeys(_BAGS, partial(_bag, kind, column_names)),
    }
    _print_arrays(readers[kind](), column_names, most_s)


def _allow_writing(most_s: int) -> None:
    """Limit the time for reading and writing together from here on: the file is read."""
    resource.setrlimit(resource.RLIMIT_CPU, (_TIME_FACTOR * most_s, _TIME_FACTOR * most_s))


def _refuse_large_archive(archive: zipfile.ZipFile, most_unpacked: int) -> None:
    unpacked = sum(part.file_size for part in archive.infolist())
    if unpacked > most_unpacked:
        raise _UnfitError("unpacked", f"{unpacked / 1e6:.0f} MB")


# Workbooks.


def _print_workbook(most_s: int, most_unpacked: int, most_cells: int) -> None:
    """Print the rows of the sheet with the most cells."""
    if zipfile.is_zipfile(_INPUT):
        with zipfile.ZipFile(_INPUT) as archive:
            parts = archive.namelist()
            if len(parts) > _MOST_PARTS:
                raise _UnfitError("unreadable", f"{len(parts)} parts")
            _refuse_large_archive(archive, most_unpacked)
            for name in parts:
                if name.startswith("xl/worksheets/"):
                    _refuse_far_cells(archive, name, most_cells)

    from python_calamine import SheetTypeEnum, load_workbook

    book = load_workbook(_INPUT)
    names = [each.name for each in book.sheets_metadata if each.typ == SheetTypeEnum.WorkSheet]
    if not names:
        return
    if len(names) == 1:
        sheet = book.get_sheet_by_name(names[0])
    else:
        sheet = max(map(book.get_sheet_by_name, names), key=_cell_count)
    if sheet.start is None:
        return
    _allow_writing(most_s)
    left_of_table = "\t" * sheet.start[1]
    for number, row in enumerate(sheet.iter_rows(), start=1):
        text = "\t".join(map(_text, row))
        if text.strip("\t"):
            sys.stdout.write(f"{number}\t{left_of_table}{text}\n")


def _cell_count(sheet: Any) -> int:
    """Return how many cells of a sheet hold something."""
    return sum(len(row) - row.count("") for row in sheet.iter_rows())


def _refuse_far_cells(archive: zipfile.ZipFile, name: str, most_cells: int) -> None:
    """Refuse a sheet with a cell whose address would make the sheet too large.

    In each block the first address with three letters and the last of all are looked at: rows
    stand in their order.
    """
    rest = b""
    with archive.open(name) as file:
        while block := file.read(_BLOCK_BYTES):
            block = rest + block
            rest = block[-_LONGEST_ADDRESS:]
            last = block.rfind(b" r=", 0, -20)
            for cell in (_FAR_COLUMN.search(block), last >= 0 and _CELL.search(block, last)):
                if cell and _column(cell[1]) * int(cell[2]) > most_cells:
                    raise _UnfitError("cell", (cell[1] + cell[2]).decode())


def _column(letters: bytes) -> int:
    """Return the number of a column, `A` being 1."""
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
    return "" if text in _NO_VALUE else " ".join(text.split())


# Arrays by name: MATLAB, NumPy, JSON, Parquet.

#: Columns of a data set of lerobot: episode of a row, and time since the beginning of the episode.
_EPISODE, _EPISODE_TIME = "episode_index", "timestamp"
#: Names of vectors that are joints, not places.
_JOINTS = re.compile(
    r"(?:.*[^a-z])?(?:q|th|theta|thetas|j|joint|joints|jnt|axis|axes|angles?)\d*", re.I
)
#: Keys that name each of several records of a row, and how many names there are at most.
_NAMES_OF_RECORDS = ("tag_id", "marker_id", "id", "name", "label", "child_frame_id")
_MOST_RECORDS = 100
#: Vectors of this length are x, y, z; arrays of these shapes are matrices.
_XYZ, _MATRICES = 3, ((4, 4), (3, 4), (3, 3))


def _mat(most_unpacked: int) -> dict[str, Any]:
    import scipy.io

    cells = sum(math.prod(shape) for _, shape, _ in scipy.io.whosmat(_INPUT))
    if 8 * cells > most_unpacked:
        raise _UnfitError("unpacked", f"{8e-6 * cells:.0f} MB")
    content = scipy.io.loadmat(_INPUT, simplify_cells=True)
    arrays = {name: value for name, value in content.items() if name and name[:2] != "__"}
    if not arrays and "__function_workspace__" in content:
        raise _UnfitError("objects", "a table, timeseries or object of MATLAB alone")
    return arrays


def _npz(most_unpacked: int) -> dict[str, Any]:
    import numpy as np

    if zipfile.is_zipfile(_INPUT):
        with zipfile.ZipFile(_INPUT) as archive:
            _refuse_large_archive(archive, most_unpacked)
    content = np.load(_INPUT, allow_pickle=False)
    if isinstance(content, np.ndarray):
        fields = content.dtype.names
        return {"": content} if fields is None else {name: content[name] for name in fields}
    return dict(content)


def _json() -> dict[str, Any]:
    """Return the content of a document, or of all lines of a file with a record in each."""
    text = Path(_INPUT).read_text(encoding="utf-8-sig")
    try:
        content = json.loads(text)
    except json.JSONDecodeError as error:
        if error.msg != "Extra data":
            raise _UnfitError("json", f"{error.lineno}\t{error.msg}") from None
        lines = enumerate(text.splitlines(), start=1)
        content = [_record(number, line) for number, line in lines if line.strip()]
    return content if isinstance(content, dict) else {"": content}


def _record(number: int, line: str) -> Any:
    try:
        return json.loads(line)
    except json.JSONDecodeError as error:
        raise _UnfitError("json", f"{number}\t{error.msg}") from None


def _parquet() -> dict[str, Any]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    file = pq.ParquetFile(_INPUT)

    def has_numbers(kind: pa.DataType) -> bool:
        if pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind):
            kind = kind.value_type
        nested = pa.types.is_nested(kind) or pa.types.is_binary(kind)
        return not nested and not pa.types.is_large_binary(kind)

    columns = {column.name: has_numbers(column.type) for column in file.schema_arrow}
    read = [name for name, numbers in columns.items() if numbers]
    table = file.read(columns=read, use_threads=False)
    _print_unread([name for name, numbers in columns.items() if not numbers])
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


def _c3d(column_names: dict[str, list[str]]) -> dict[str, Any]:
    """Return frames, times and the places of the markers, whose columns are named."""
    import ezc3d
    import numpy as np

    file = ezc3d.c3d(_INPUT)
    point = file["parameters"]["POINT"]
    places = file["data"]["points"][:3]  # (3, markers, frames)
    frame_count = places.shape[2]
    head = Path(_INPUT).read_bytes()[6:10]  # first and last frame, in either order of the bytes
    promised = min(last - first + 1 for first, last in (unpack("<HH", head), unpack(">HH", head)))
    if frame_count < promised:
        raise _UnfitError("unreadable", f"{frame_count} of {promised} frames are there")
    unseen = (file["data"]["meta_points"]["residuals"][0] < 0.0) | (places == 0.0).all(axis=0)
    places = np.where(unseen, np.nan, places)
    unit = (point["UNITS"]["value"] or ["mm"])[0].strip() or "mm"
    frames = np.arange(frame_count)
    times_s = np.round(frames / float(point["RATE"]["value"][0]), 6)
    arrays: dict[str, Any] = {"Frame": frames + 1, "Time [s]": times_s}
    for k, label in enumerate(point["LABELS"]["value"][: places.shape[1]]):
        name = label.rpartition(":")[2].strip() or f"marker {k + 1}"
        arrays[name] = places[:, k].T
        column_names[name] = [f"{name} {axis} [{unit}]" for axis in "xyz"]
    return arrays


class _Row(NamedTuple):
    """What one message of a bag holds."""

    time_s: float
    values: dict[str, list[float]]  # by the name of each joint or target


def _bag(kind: str, column_names: dict[str, list[str]]) -> dict[str, Any]:
    """Return the joints of the topic with most joint states; without any, the targets."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with Path(_INPUT).open("rb") as file:
        head, size = file.read(32), os.fstat(file.fileno()).st_size
    pages, page = int.from_bytes(head[28:32]), int.from_bytes(head[16:18])  # of SQLite
    if kind == "db3" and size < pages * page:
        raise _UnfitError("unreadable", f"{size} of {pages * page} bytes are there")
    with TemporaryDirectory() as folder:
        link = Path(folder) / f"bag.{kind}"  # its ending says how it is read
        link.symlink_to(_INPUT)
        with AnyReader([link], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
            usable = [each for each in bag.connections if each.msgtype in (_JOINT_STATE, *_PLACES)]
            if not usable:
                topics = ", ".join(f"{each.topic} ({each.msgtype})" for each in bag.connections)
                raise _UnfitError("topics", topics or "no topic")
            most = max(usable, key=lambda each: (each.msgtype == _JOINT_STATE, each.msgcount))
            read = [each for each in usable if each.topic == most.topic]
            topics_of_bag = dict.fromkeys(each.topic for each in bag.connections)
            _print_unread([topic for topic in topics_of_bag if topic != most.topic])
            rows: list[_Row] = []
            for connection, logged_ns, raw in bag.messages(connections=read):
                message = bag.deserialize(raw, connection.msgtype)
                rows += _rows_of_message(message, connection.msgtype, 1e-9 * logged_ns)
    return _arrays_of_rows(rows, column_names, joints=read[0].msgtype == _JOINT_STATE)


def _rows_of_message(message: Any, kind: str, logged_s: float) -> list[_Row]:
    """Return what a message holds; several rows where it has several targets."""

    def time_of(stamped: Any) -> float:
        stamp = stamped.header.stamp
        return float(stamp.sec + 1e-9 * stamp.nanosec) or logged_s

    if kind == _JOINT_STATE:
        joints = zip(message.name, message.position, strict=False)
        return [_Row(time_of(message), {name: [float(value)] for name, value in joints})]
    if kind.endswith("TFMessage"):
        return [
            _Row(time_of(each), {each.child_frame_id: _place(each.transform)})
            for each in message.transforms
        ]
    place = message
    for attribute in _PLACES[kind].split("."):
        place = getattr(place, attribute)
    target = getattr(message, "child_frame_id", "") or "target"
    return [_Row(time_of(message), {target: _place(place)})]


def _place(pose: Any) -> list[float]:
    """Return x, y, z, and qx, qy, qz, qw if there is an orientation."""
    position = getattr(pose, "position", None) or getattr(pose, "translation", None) or pose
    values = [position.x, position.y, position.z]
    orientation = getattr(pose, "orientation", None) or getattr(pose, "rotation", None)
    if orientation is not None:
        values += [orientation.x, orientation.y, orientation.z, orientation.w]
    return [float(value) for value in values]


def _arrays_of_rows(
    rows: list[_Row], column_names: dict[str, list[str]], *, joints: bool
) -> dict[str, Any]:
    """Return an array for each joint or target, nan where a row lacks it; columns are named."""
    import numpy as np

    widths = {name: len(values) for row in rows for name, values in row.values.items()}
    components = [f"{axis} [m]" for axis in "xyz"] + ["qx", "qy", "qz", "qw"]
    arrays: dict[str, Any] = {"Time [s]": np.array([row.time_s for row in rows])}
    for name, width in widths.items():
        missing = [np.nan] * width
        arrays[name] = np.array([row.values.get(name, missing) for row in rows])
        column_names[name] = [f"{name} {component}" for component in components[:width]]
        if joints:
            column_names[name] = [f"{name} [rad]"]
    return arrays


def _print_unread(parts: Iterable[str]) -> None:
    """Print which parts of the file are not read, if any."""
    if text := ", ".join(parts):
        print(f"?\t{' '.join(text.split())} not read")


def _flattened(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the arrays in nested fields and in lists of records, each with its dotted name."""
    import numpy as np

    if isinstance(value, np.ndarray) and value.dtype == object:
        value = value.tolist()
    if isinstance(value, list) and _are_all(value, list):
        records = [record for row in value for record in row or ()]
        value = _by_their_names(value, records) if _are_all(records, dict) else value
    if isinstance(value, list) and _are_all(value, dict):
        keys = dict.fromkeys(key for record in value for key in record or ())
        value = {key: [(record or {}).get(key) for record in value] for key in keys}
    if isinstance(value, dict):
        for key, part in value.items():
            yield from _flattened(f"{name}.{key}" if name else str(key), part)
        return
    try:
        array = np.asarray(_filled(value) if isinstance(value, list) else value)
    except ValueError:  # rows of several lengths
        return
    if array.dtype == object:
        filled = [np.nan if each is None else each for each in array.ravel().tolist()]
        try:
            array = np.array(filled, dtype=float).reshape(array.shape)
        except (TypeError, ValueError):
            array = np.array([_text("" if each is None else each) for each in array.tolist()])
    yield name, array


def _are_all(values: list[Any], kind: type) -> bool:
    """Return whether values are of a kind, or missing; not all of them may be missing."""
    given = [value for value in values if value is not None]
    return bool(given) and all(isinstance(value, kind) for value in given)


def _by_their_names(rows: list[Any], records: list[dict[str, Any]]) -> list[Any]:
    """Return a record for each row, of rows that are lists of records, such as detected tags.

    Where rows have several, or of several names, a record has those of the row by their names, else
    by their numbers. Of very many nothing is read.
    """
    key = next((each for each in _NAMES_OF_RECORDS if all(each in of for of in records)), None)
    named: list[dict[str, Any]] = []
    for row in rows:
        named.append({})
        for number, record in enumerate(row or (), start=1):
            named[-1].setdefault(str(record[key] if key else number), record)
    names = dict.fromkeys(each for row in named for each in row)
    if len(names) == 1:
        return [next(iter(row.values()), None) for row in named]
    return named if len(names) <= _MOST_RECORDS else []


def _filled(rows: list[Any]) -> list[Any]:
    """Return rows in which arrays that are missing are blank."""
    import numpy as np

    shapes = {np.shape(row) for row in rows if isinstance(row, list)}
    if len(shapes) != 1 or not any(row is None for row in rows):
        return rows
    blank = np.full(shapes.pop(), np.nan).tolist()
    return [blank if row is None else row for row in rows]


def _print_arrays(content: dict[str, Any], column_names: dict[str, list[str]], most_s: int) -> None:
    """Print the arrays with the commonest number of rows, each column with a name."""
    import numpy as np

    flat = [pair for name, value in content.items() for pair in _flattened(name, value)]
    arrays = {name: np.squeeze(array) for name, array in flat}
    arrays = {name: array for name, array in arrays.items() if 0 < array.ndim <= 3}
    episodes = len(set(arrays.get(_EPISODE, np.zeros(1)).tolist()))
    if episodes > 1 and arrays.pop(_EPISODE_TIME, None) is not None:
        _print_unread([f"{_EPISODE_TIME} (it begins anew in each of {episodes} episodes)"])
    numbers: Counter[int] = Counter()  # in all arrays that have a side of each length
    for array in arrays.values():
        for length in {array.shape[0], array.shape[-1]}:
            numbers[length] += array.size // max(length, 1)
    # The length with most numbers; a matrix is longer than wide.
    row_count = max(numbers, key=lambda n: (n > 1, numbers[n] * min(n, 1000)), default=0)
    names: list[str] = []
    columns: list[Any] = []
    unread = []
    for name, array in arrays.items():
        if row_count not in (array.shape[0], array.shape[-1]) or row_count < 2:
            unread.append(name)
            continue
        by_row = array if array.shape[0] == row_count else np.moveaxis(array, -1, 0)
        names += _names_of_columns(name, by_row, column_names.get(name))
        columns += list(by_row.reshape(row_count, -1).T)
    _print_unread(unread)
    if not columns:
        raise _UnfitError("arrays", ", ".join(arrays) or "no array")
    _allow_writing(most_s)
    first_row = 1
    if any(names):
        sys.stdout.write("1\t" + "\t".join(" ".join(name.split()) for name in names) + "\n")
        first_row = 2
    texts = map(_texts, columns)
    for number, row in enumerate(zip(*texts, strict=True), start=first_row):
        sys.stdout.write(f"{number}\t" + "\t".join(row) + "\n")


def _names_of_columns(name: str, array: Any, given: list[str] | None) -> list[str]:
    """Return a name for each column of an array (N, …); empty ones for an array without a name."""
    width = array.size // len(array)
    if given is not None and len(given) == width:
        return given
    if array.ndim == 1 or not name:
        return [name] * width
    if array.shape[1:] in _MATRICES:
        lines, across = array.shape[1:]
        return [f"{name}_{k}{j}" for k in range(1, lines + 1) for j in range(1, across + 1)]
    if width == _XYZ and not _JOINTS.fullmatch(name):
        return [f"{name} {axis}" for axis in "xyz"]
    return [f"{name}_{k}" for k in range(1, width + 1)]


def _texts(values: Any) -> list[str]:
    """Return a column as text: numbers in full, times as ISO 8601, blanks for missing values."""
    if values.dtype.kind == "f":
        return ["" if text == "nan" else text for text in values.astype(str).tolist()]
    return [_text(value) for value in values.tolist()]


if __name__ == "__main__":
    sys.stdout.reconfigure(encoding="utf-8", errors="replace", newline="\n")  # type: ignore[union-attr]
    kind, names, *limits = sys.argv[1:]
    try:
        _main(kind, names, *map(int, limits))
    except _UnfitError as error:
        print(f"!{error.args[0]}\t{error.args[1]}")
    except MemoryError:
        print("!memory\t")
    except BrokenPipeError:  # the reader has seen enough
        pass
    except Exception as error:  # any error of another package's reader
        message = re.sub(r"/\S*/bag\.\w+", "the bag", str(error))  # not the path of our link
        print(f"!unreadable\t{' '.join(message.split())}")
