"""Joint positions and places in files of arrays, as MATLAB, NumPy and lerobot write them.

MATLAB's files are written byte by byte after the published description of its format (level 5,
and 7, which packs each variable); tables of lerobot after its data sets.
"""

from __future__ import annotations

import io
import json
import struct
import zlib
from collections.abc import Callable

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

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
