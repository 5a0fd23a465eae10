"""Joint positions and places in files that are no text: MATLAB, NumPy, lerobot, C3D, bags of ROS.

MATLAB's files are written byte by byte after the published description of its format (level 5,
and 7, which packs each variable), C3D and bags after theirs; tables of lerobot after its data sets.
"""

from __future__ import annotations

import io
import json
import sqlite3
import struct
import zlib
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.spatial.transform import Rotation

_INT8, _INT32, _UINT32, _DOUBLE, _MATRIX, _COMPRESSED = 1, 5, 6, 9, 14, 15
_OF_DOUBLES, _OF_FIELDS = 6, 2


def _element(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def _begin(kind: int, size: tuple[int, ...], name: str) -> bytes:
    flags = _element(_UINT32, struct.pack("<II", kind, 0))
    dimensions = _element(_INT32, struct.pack(f"<{len(size)}i", *size))
    return flags + dimensions + _element(_INT8, name.encode())


def _variable(name: str, value: np.ndarray | dict[str, np.ndarray]) -> bytes:
    if isinstance(value, dict):
        longest = 32
        names = b"".join(key.encode().ljust(longest, b"\0") for key in value)
        content = _begin(_OF_FIELDS, (1, 1), name)
        content += struct.pack("<HHi", _INT32, 4, longest) + _element(_INT8, names)
        return _element(_MATRIX, content + b"".join(_variable("", part) for part in value.values()))
    size = value.shape if value.ndim > 1 else (len(value), 1)
    numbers = value.astype("<f8").tobytes(order="F")
    content = _begin(_OF_DOUBLES, size, name) + _element(_DOUBLE, numbers)
    return _element(_MATRIX, content)


def mat_file(variables: dict[str, np.ndarray | dict[str, np.ndarray]], *, packed: bool) -> bytes:
    """Return a MAT-file of level 5, each variable packed as MATLAB 7 does it or not."""
    about = b"MATLAB 5.0 MAT-file, Platform: PCWIN64, Created on: Mon Jul 15 12:49:31 2024"
    content = about.ljust(116) + bytes(8) + struct.pack("<H", 0x0100) + b"IM"
    for name, value in variables.items():
        variable = _variable(name, value)
        if packed:
            squeezed = zlib.compress(variable)
            variable = struct.pack("<II", _COMPRESSED, len(squeezed)) + squeezed
        content += variable
    return content


def _npz(**arrays: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def _npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def _records(q_deg: np.ndarray, T: np.ndarray) -> list[dict[str, object]]:
    rows = zip(np.radians(q_deg).tolist(), (1e3 * T[:, :3, 3]).tolist(), strict=True)
    return [{"joints": q, "point": {"xyz": p}, "note": "ok"} for q, p in rows]


#: Files with joints in degrees (N, 6) and a target at (N, 4, 4), by name.
ARRAYS: dict[str, Callable[[np.ndarray, np.ndarray], bytes]] = {
    "level 5.mat": lambda q, T: mat_file(
        {"q_meas": q, "p_meas": 1e3 * T[:, :3, 3], "L": np.array([815.0])}, packed=False
    ),
    "packed.mat": lambda q, T: mat_file(
        {"theta": np.radians(q), "T": np.moveaxis(T, 0, -1)}, packed=True
    ),
    "struct.mat": lambda q, T: mat_file(
        {"data": {"q": q.T, "pos": T[:, :3, 3].T}, "fs": np.array([10.0])}, packed=True
    ),
    "named.npz": lambda q, T: _npz(joint_angles=np.radians(q), tcp=T[:, :3, 3]),
    "plain.npy": lambda q, T: _npy(np.column_stack([1e3 * T[:, :3, 3], q])),
    "records.json": lambda q, T: json.dumps(_records(q, T), indent=1).encode(),
    "lines.jsonl": lambda q, T: "\n".join(map(json.dumps, _records(q, T))).encode(),
    "lists.json": lambda q, T: json.dumps(
        {"rate": 5, "q": q.tolist(), "p_mm": (1e3 * T[:, :3, 3]).tolist()}
    ).encode(),
}

#: What lerobot calls the motors of an arm with six joints.
MOTORS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_1", "wrist_2", "wrist_3")


def lerobot_table(
    time_s: np.ndarray, state: np.ndarray, episode: np.ndarray | None = None
) -> bytes:
    """Return a table of an episode: state and action of the motors (N, k), of single precision."""
    count, motors = state.shape

    def vectors(values: np.ndarray) -> pa.Array:
        return pa.FixedSizeListArray.from_arrays(
            pa.array(values.astype(np.float32).ravel()), motors
        )

    episode = np.zeros(count, dtype=np.int64) if episode is None else episode
    columns = {
        "action": vectors(state + 0.4),
        "observation.state": vectors(state),
        "timestamp": pa.array(time_s.astype(np.float32)),
        "frame_index": pa.array(np.arange(count)),
        "episode_index": pa.array(episode),
        "index": pa.array(np.arange(count)),
        "task_index": pa.array(np.zeros(count, dtype=np.int64)),
    }
    file = io.BytesIO()
    pq.write_table(pa.table(columns), file)
    return file.getvalue()


def lerobot_info(names: object) -> str:
    """Return what a data set says of itself."""
    feature = {"dtype": "float32", "shape": [6], "names": names}
    features = {
        "action": feature,
        "observation.state": feature,
        "timestamp": {"dtype": "float32", "shape": [1], "names": None},
    }
    about = {"codebase_version": "v3.0", "robot_type": "so101_follower", "fps": 30}
    return json.dumps({**about, "features": features})


# C3D, byte by byte: header, parameters, and frames of four numbers a marker.

_BLOCK = 512


def _parameter(group: int, name: str, kind: int, size: tuple[int, ...], content: bytes) -> bytes:
    rest = struct.pack("<bB", kind, len(size)) + bytes(size) + content + b"\0"
    return (
        struct.pack("<bb", len(name), group)
        + name.encode()
        + struct.pack("<h", len(rest) + 2)
        + rest
    )


def c3d_file(markers: dict[str, np.ndarray], rate_hz: float, unit: str = "mm") -> bytes:
    """Return a take of markers (F, 3), numbers of single precision; nan where one is not seen."""
    frames = len(next(iter(markers.values())))
    longest = max(map(len, markers))
    labels = "".join(name.ljust(longest) for name in markers).encode()
    group = struct.pack("<bb", 5, -1) + b"POINT" + struct.pack("<h", 3) + b"\0"
    parameters = [
        group,
        _parameter(1, "USED", 2, (), struct.pack("<h", len(markers))),
        _parameter(1, "FRAMES", 2, (), struct.pack("<H", frames)),
        _parameter(1, "SCALE", 4, (), struct.pack("<f", -1.0)),
        _parameter(1, "RATE", 4, (), struct.pack("<f", rate_hz)),
        _parameter(1, "DATA_START", 2, (), struct.pack("<h", 5)),
        _parameter(1, "LABELS", -1, (longest, len(markers)), labels),
        _parameter(1, "UNITS", -1, (len(unit),), unit.encode()),
    ]
    described = b"\x01\x50\x03\x54" + b"".join(parameters) + b"\0\0"
    header = struct.pack(
        "<BBHHHHHfHHf", 2, 0x50, len(markers), 0, 1, frames, 10, -1.0, 5, 0, rate_hz
    )
    rows = []
    for k in range(frames):
        for p in markers.values():
            lost = bool(np.isnan(p[k]).any())
            rows.append(struct.pack("<4f", *([0.0] * 3 if lost else p[k]), -1.0 if lost else 0.3))
    return header.ljust(_BLOCK, b"\0") + described.ljust(3 * _BLOCK, b"\0") + b"".join(rows)


# A bag of ROS 2 in SQLite, its messages in CDR with the low byte first.


def _cdr(*parts: object) -> bytes:
    """Return a message: whole numbers, text, lists of text, and arrays of double precision."""
    body = b""

    def aligned(to: int) -> None:
        nonlocal body
        body += bytes(-len(body) % to)

    for part in parts:
        aligned(4)
        if isinstance(part, int):
            body += struct.pack("<I", part)
        elif isinstance(part, str):
            body += struct.pack("<I", len(part) + 1) + part.encode() + b"\0"
        elif isinstance(part, list):
            body += struct.pack("<I", len(part))
            for text in part:
                aligned(4)
                body += struct.pack("<I", len(text) + 1) + text.encode() + b"\0"
        elif isinstance(part, tuple):  # of a number that is known
            aligned(8)
            body += struct.pack(f"<{len(part)}d", *part)
        else:
            body += struct.pack("<I", len(part))
            aligned(8 if len(part) else 4)
            body += np.asarray(part, dtype="<f8").tobytes()
    return b"\x00\x01\x00\x00" + body


def _stamp(time_s: float) -> tuple[int, int]:
    return int(time_s), round(1e9 * (time_s % 1.0))


def joint_state(time_s: float, names: list[str], q: np.ndarray) -> bytes:
    """Return a message of sensor_msgs/msg/JointState."""
    none = np.zeros(0)
    return _cdr(*_stamp(time_s), "", names, q, none, none)


def pose_stamped(time_s: float, T: np.ndarray) -> bytes:
    """Return a message of geometry_msgs/msg/PoseStamped."""
    turn = Rotation.from_matrix(T[:3, :3]).as_quat()
    return _cdr(*_stamp(time_s), "world", (*T[:3, 3], *turn))


def write_bag(path: Path, topics: dict[str, tuple[str, list[tuple[float, bytes]]]]) -> None:
    """Write a bag: the type of each topic, and its messages with the time at which they came."""
    with closing(sqlite3.connect(path)) as file, file:
        file.execute("CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT)")
        file.execute("INSERT INTO schema VALUES (3, 'humble')")
        file.execute(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
            "serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL)"
        )
        file.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, "
            "timestamp INTEGER NOT NULL, data BLOB NOT NULL)"
        )
        for k, (name, (kind, messages)) in enumerate(topics.items(), start=1):
            file.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", (k, name, kind))
            file.executemany(
                "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)",
                [(k, round(1e9 * time_s), content) for time_s, content in messages],
            )
