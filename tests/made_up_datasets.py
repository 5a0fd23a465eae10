"""Made-up folders in the layouts of data sets: nobody measured anything for them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import Chain
from pa10cal.files.arms import load_arm

SERIES_A = "Series_A/measurements_grid.csv"
SERIES_C = "Series_C/measurements_random_poses.csv"
ROWS = 10
#: The sixth reading of the made-up series repeats the command of the third.
REPEATED, REPEAT = 2, 5

_GOAL = ["Goal x", "Goal y", "Goal z", "Goal roll", "Goal pitch", "Goal yaw"]
_JOINTS = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"]
_JOINTS += ["wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]
_MEASURED = ["x", "y", "z", "rx", "ry", "rz"]


def ur10_poses() -> tuple[np.ndarray, np.ndarray]:
    """Commands (10, 6) [rad] and the T-Mac's poses (10, 4, 4) [mm] in the tracker's frame."""
    q_rad = np.random.default_rng(2020).uniform(-1.5, 1.5, (ROWS, 6)).round(6)
    q_rad[REPEAT] = q_rad[REPEATED]
    T = Chain.of(load_arm("ur10")).forward(q_rad)
    T[:, :3, 3] *= 1e3
    T_tracker_base, T_flange_tmac = np.eye(4), np.eye(4)
    T_tracker_base[:3, :3] = Rotation.from_rotvec([0.01, -0.02, -0.5]).as_matrix()
    T_tracker_base[:3, 3] = [2673.0, -1531.0, -1306.0]
    T_flange_tmac[:3, :3] = Rotation.from_rotvec([0.0, 0.0, -1.57]).as_matrix()
    T_flange_tmac[:3, 3] = [0.0, 0.5, 93.0]
    return q_rad, T_tracker_base @ T @ T_flange_tmac


def write_ipa(folder: Path) -> Path:
    """Write ten made-up rows of series A and of series C."""
    q_rad, T_mm = ur10_poses()
    angles = Rotation.from_matrix(T_mm[:, :3, :3]).as_euler("XYZ", degrees=True)
    measured = np.hstack([T_mm[:, :3, 3], angles])
    goal = np.zeros((ROWS, 6))
    a = [["Timestamp", *_GOAL, *_JOINTS, "measurement_temperature"]]
    a[0] += [f"measurement_{name}" for name in _MEASURED]
    c = [a[0][:14]]
    c[0] = [*c[0], *(f"measurement_{std}{name}" for name in _MEASURED for std in ("", "std_"))]
    for k in range(ROWS):
        numbers = [*goal[k], *q_rad[k], 23.0 + 0.1 * k]
        a.append([f"202007141639{4 + 5 * k:02d}", *map(_comma, [*numbers, *measured[k]])])
        std = 0.001 * (1 + k + np.arange(6))
        pairs = np.column_stack([measured[k], std]).ravel()
        c.append(["2,02011E+13", *map(_comma, [*numbers, *pairs])])
    for file, rows in ((SERIES_A, a), (SERIES_C, c)):
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_bytes("".join(f"{';'.join(row)}\r\n" for row in rows).encode())
    return folder


def write_irb120(folder: Path) -> Path:
    """Write ten made-up rows of joint angles and of three reflectors, one twice not seen."""
    rng = np.random.default_rng(120)
    folder.mkdir(parents=True, exist_ok=True)
    q_deg = rng.uniform(-60, 60, (ROWS, 6)).round(5)
    _write_bare(folder / "joints.txt", q_deg)
    T_base_ee = Chain.of(load_arm("irb120")).forward(np.radians(q_deg))
    for k, p_ee_mm in enumerate(([60.0, 0.0, 40.0], [-30.0, 50.0, 40.0], [-30.0, -50.0, 45.0]), 1):
        p_mm = 1e3 * T_base_ee[:, :3, 3] + T_base_ee[:, :3, :3] @ p_ee_mm
        _write_bare(folder / f"reflector_{k}.txt", p_mm + np.array([2000.0, 300.0, -500.0]))
    path = folder / "reflector_2.txt"
    lines = path.read_text().splitlines()
    lines[3], lines[4] = "nan nan nan", "- - -"
    path.write_text("\n".join(lines) + "\n")
    return folder


def edit(path: Path, line: int, column: str | int, text: str, separator: str | None = ";") -> None:
    """Replace one field; lines count from 1, columns are named by the header or counted from 0."""
    lines = path.read_bytes().decode().splitlines()
    place = column if isinstance(column, int) else lines[0].split(separator).index(column)
    words = lines[line - 1].split(separator)
    words[place] = text
    lines[line - 1] = (separator or " ").join(words)
    path.write_bytes("".join(f"{each}\r\n" for each in lines).encode())


def _comma(value: float) -> str:
    return f"{value:.10g}".replace(".", ",")


def _write_bare(path: Path, numbers: np.ndarray) -> None:
    path.write_text("".join("  ".join(f"{x:.5f}" for x in row) + "\n" for row in numbers))
