"""A file of every known format, with what stands beside it, and what becomes of such files."""

from __future__ import annotations

import io
import re
from collections import Counter
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from made_up_arrays import ARRAYS, c3d_file, joint_state, write_bag
from made_up_formats import PROGRAMS, TAKES, YASKAWA
from made_up_reports import REPORTS
from made_up_sightings import Sighted
from pa10cal.__main__ import main
from pa10cal.campaign.read import read_campaign
from pa10cal.errors import Pa10calError

TIME_S = 10.0 * np.arange(40)
#: Times of messages; joints in the order of the alphabet, as /joint_states has them.
STAMPS_S = 1.7e9 + TIME_S
JOINT_NAMES = ["elbow_joint", "shoulder_lift_joint", "shoulder_pan_joint"]
JOINT_NAMES += [f"wrist_{k}_joint" for k in (1, 2, 3)]
ORDER = [2, 1, 0, 3, 4, 5]


def places_mm(raw: Sighted) -> np.ndarray:
    """Return where the target was, (40, 3)."""
    return 1e3 * raw.T_instr_target[:, :3, 3]


def numbered(raw: Sighted) -> list[tuple[int, tuple[float, float, float]]]:
    """Return places with their numbers from 1."""
    return [(k, tuple(place)) for k, place in enumerate(places_mm(raw).tolist(), start=1)]


def table(columns: dict[str, np.ndarray], separator: str = ";") -> str:
    """Return columns as text."""
    rows = [separator.join(columns)]
    rows += [
        separator.join(f"{value:.9f}" for value in row)
        for row in zip(*columns.values(), strict=True)
    ]
    return "\n".join([*rows, ""])


def joints(raw: Sighted, called: str = "J{} [deg]") -> dict[str, np.ndarray]:
    """Return columns of the joints."""
    return {called.format(k): q for k, q in enumerate(np.degrees(raw.q.T), start=1)}


def targets(raw: Sighted) -> dict[str, np.ndarray]:
    """Return columns of the target's place."""
    return {f"{axis} [mm]": values for axis, values in zip("xyz", places_mm(raw).T, strict=True)}


def _blocks(raw: Sighted) -> str:
    lines = []
    for k, place in numbered(raw):
        named = zip("XYZ", place, strict=True)
        lines += [f"Pos {k}", " ".join(f"{axis}= {value:.6f}" for axis, value in named)]
    return "\n".join([*lines, ""])


def _points(raw: Sighted) -> str:
    return "".join(f"P{k}, {x:.6f}, {y:.6f}, {z:.6f}\n" for k, (x, y, z) in numbered(raw))


def _polar(raw: Sighted) -> str:
    p_m = raw.T_instr_target[:, :3, 3]
    d_m = np.linalg.norm(p_m, axis=1)
    hz = -np.degrees(np.arctan2(p_m[:, 1], p_m[:, 0])) % 360
    down = np.degrees(np.arccos(p_m[:, 2] / d_m))
    return table(joints(raw) | {"Hz [deg]": hz, "V [deg]": down, "D [m]": d_m})


def _parquet(raw: Sighted) -> bytes:
    file = io.BytesIO()
    pq.write_table(pa.table({**joints(raw), **targets(raw)}), file)
    return file.getvalue()


def states(raw: Sighted) -> list[tuple[float, bytes]]:
    """Return messages of /joint_states."""
    every = zip(STAMPS_S.tolist(), raw.q, strict=True)
    return [(t, joint_state(t, JOINT_NAMES, q[ORDER])) for t, q in every]


def _db3(raw: Sighted) -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.db3"
        write_bag(path, {"/joint_states": ("sensor_msgs/msg/JointState", states(raw))})
        return path.read_bytes()


def _mcap(raw: Sighted) -> bytes:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store, kind = get_typestore(Stores.ROS2_HUMBLE), "sensor_msgs/msg/JointState"
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a"
        with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
            of = bag.add_connection("/joint_states", kind, typestore=store)
            for time_s, message in states(raw):
                bag.write(of, round(1e9 * time_s), message)
        return next(path.glob("*.mcap")).read_bytes()


def bag_of_ros1(raw: Sighted) -> bytes:
    """Return a bag of /joint_states."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store, kind = get_typestore(Stores.ROS1_NOETIC), "sensor_msgs/msg/JointState"
    types, none = store.types, np.zeros(0)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.bag"
        with Writer(path) as bag:
            of = bag.add_connection("/joint_states", kind, typestore=store)
            for k, (time_s, q) in enumerate(zip(STAMPS_S.tolist(), raw.q, strict=True)):
                stamp = types["builtin_interfaces/msg/Time"](sec=int(time_s), nanosec=0)
                header = types["std_msgs/msg/Header"](seq=k, stamp=stamp, frame_id="")
                message = types[kind](header, JOINT_NAMES, q[ORDER], none, none)
                bag.write(of, round(1e9 * time_s), store.serialize_ros1(message, kind))
        return path.read_bytes()


@dataclass(frozen=True)
class Known:
    """A file of a known format, and what stands beside it."""

    file: str
    text: Callable[[Sighted], str | bytes]
    beside: str  # a key of BESIDE; empty where the file holds both
    label: str = "P{}"  # what it calls the points
    package: str = ""  # that reads it, where it is an extra

    def write(self, raw: Sighted) -> bytes:
        """Return its content."""
        content = self.text(raw)
        return content if isinstance(content, bytes) else content.encode()


def _of_arrays(name: str) -> Callable[[Sighted], bytes]:
    return lambda raw: ARRAYS[name](np.degrees(raw.q), raw.T_instr_target)


def _take(name: str) -> Callable[[Sighted], str]:
    return lambda raw: TAKES[name][0](TIME_S, raw.T_instr_target)


def _report(name: str) -> Callable[[Sighted], str]:
    return lambda raw: REPORTS[name](numbered(raw))


def _program(name: str, file: str) -> Known:
    write, label = PROGRAMS[name]
    return Known(file, lambda raw: write(np.degrees(raw.q)), "tracker", label)


#: A file of each, by the name of the format and what is drawn.
KNOWN = {
    "motive": Known("take.csv", _take("motive"), "log"),
    "vicon": Known("take.csv", _take("vicon"), "log"),
    "vicon markers": Known("take.csv", _take("vicon markers"), "log"),
    "qualisys": Known("take.tsv", _take("qualisys"), "log"),
    "blocks": Known("tscan.txt", _blocks, "list", "{}"),
    "spatialanalyzer": Known("points.txt", _report("spatialanalyzer"), "list"),
    "polyworks": Known("report.txt", _report("polyworks"), "list"),
    "faro": Known("report.txt", _report("faro"), "list"),
    "kuka": _program("kuka", "points.dat"),
    "fanuc_ls": _program("fanuc_ls", "points.ls"),
    "fanuc_posreg": _program("fanuc_posreg", "posreg.va"),
    "abb": _program("abb", "points.mod"),
    "yaskawa": Known("job.jbi", lambda _: YASKAWA, "tracker", "C0000{}"),
    "mat": Known("a.mat", _of_arrays("level 5.mat"), ""),
    "mat packed": Known("a.mat", _of_arrays("packed.mat"), ""),
    "npz": Known("a.npz", _of_arrays("named.npz"), ""),
    "npz alone": Known("a.npy", _of_arrays("plain.npy"), ""),
    "parquet": Known("a.parquet", _parquet, ""),
    "json": Known("a.json", _of_arrays("records.json"), ""),
    "json a line": Known("a.jsonl", _of_arrays("lines.jsonl"), ""),
    "c3d": Known(
        "a.c3d", lambda raw: c3d_file({"Flange": places_mm(raw)}, 0.1), "log", package="ezc3d"
    ),
    "bag": Known("a.bag", bag_of_ros1, "stamped", package="rosbags"),
    "db3": Known("a.db3", _db3, "stamped", package="rosbags"),
    "mcap": Known("a.mcap", _mcap, "stamped", package="rosbags"),
    "rtde": Known(
        "robot.txt",
        lambda raw: table(
            {"timestamp": TIME_S} | {f"actual_q_{k}": q for k, q in enumerate(raw.q.T)}, " "
        ),
        "stamped",
    ),
    "matrix": Known(
        "readings.csv",
        lambda raw: table(
            joints(raw)
            | {f"m{k}": values for k, values in enumerate(raw.T_instr_target.reshape(-1, 16).T)}
        ),
        "",
    ),
    "points": Known("points.txt", _points, "list"),
    "polar": Known("readings.csv", _polar, ""),
}
#: The other log: its name, and its text by what the points are called.
BESIDE: dict[str, tuple[str, Callable[[Sighted, str], str]]] = {
    "log": ("joints.csv", lambda raw, _: table({"t [s]": TIME_S} | joints(raw, "A{} [deg]"))),
    "list": (
        "joints.csv",
        lambda raw, label: "\n".join(
            ["Point;A1;A2;A3;A4;A5;A6"]
            + [
                f"{label.format(k)};" + ";".join(f"{value:.9f}" for value in q)
                for k, q in enumerate(np.degrees(raw.q), start=1)
            ]
            + [""]
        ),
    ),
    "tracker": (
        "tracker.csv",
        lambda raw, label: "\n".join(
            ["Name,X [mm],Y [mm],Z [mm]"]
            + [f"{label.format(k)},{x:.6f},{y:.6f},{z:.6f}" for k, (x, y, z) in numbered(raw)]
            + [""]
        ),
    ),
    "stamped": ("tracker.csv", lambda raw, _: table({"t [s]": STAMPS_S} | targets(raw))),
}
#: Commands say what is wrong, the place, what is allowed and what to do, in a line.
REFUSAL = re.compile(r"(pa10cal columns: )?\S*\.\w+(:\d+)?[^\n]*: [^\n]+; allowed: [^\n]+; [^\n]+")


def judged(folder: Path, raw: Sighted, name: str, content: bytes, file: str = "") -> str:
    """Return what is said of a known file with this content, under another name if one is given.

    It is refused with one line, and nothing is written; or what is read of it is right, and what is
    said counts the rows that are, and those that are not.
    """
    known = KNOWN[name]
    files = {file or known.file: content}
    if known.beside:
        beside, text = BESIDE[known.beside]
        files[beside] = text(raw, known.label).encode()
    for each, written in files.items():
        (folder / each).write_bytes(written)
    out, said = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(said):
        code = main(["columns", *(str(folder / each) for each in files), "--robot", "ur10"])
    assert {path.name for path in folder.iterdir()} == set(files)
    text = said.getvalue().strip().replace(f"{folder}/", "")
    if code:
        assert code == 2
        assert REFUSAL.fullmatch(text), text
        return f"refused: {text}"
    (folder / "campaign.yaml").write_text(out.getvalue(), encoding="utf-8")
    try:
        found = read_campaign(folder)
    except Pa10calError as error:
        text = str(error).replace(f"{folder}/", "")
        assert REFUSAL.fullmatch(text), text
        return f"refused: {text}"
    observations = found.observations
    for q, p_m in zip(observations.states.q_rad, observations.measured.places_m[:, 0], strict=True):
        k = int(np.argmin(np.abs(raw.q - q).max(axis=1)))
        np.testing.assert_allclose(q, raw.q[k], atol=2e-5)
        np.testing.assert_allclose(p_m, raw.T_instr_target[k, :3, 3], atol=2e-5)
    counts = Counter(row.reason for row in found.quarantined).items()
    return "; ".join(
        [f"{len(observations)} read", *(f"{count} {reason}" for reason, count in counts)]
    )
