"""Made-up folders in the layouts of data sets: nobody measured anything for them."""

from __future__ import annotations

import zipfile
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


IRB120 = "3-Full Measurement/Output/Backup"
MOTOMAN = "mocap/kinematic_raw_data"


def write_irb120(folder: Path) -> Path:
    """Write ten made-up rows of the IRB 120: three reflectors, one twice not seen, three at rest.

    The reflectors on the base stand 1 m along x, y and z from (1, 2, 3) mm.
    """
    rng = np.random.default_rng(120)
    place = folder / IRB120
    place.mkdir(parents=True, exist_ok=True)
    q_deg = rng.uniform(-60, 60, (ROWS, 6)).round(5)
    _write_bare(place / "measured_joints.txt", q_deg)
    T_base_ee = Chain.of(load_arm("irb120")).forward(np.radians(q_deg))
    for k, p_ee_mm in enumerate(([60.0, 0.0, 40.0], [-30.0, 50.0, 40.0], [-30.0, -50.0, 45.0]), 1):
        p_mm = 1e3 * T_base_ee[:, :3, 3] + T_base_ee[:, :3, :3] @ p_ee_mm
        p_mm += np.array([2000.0, 300.0, -500.0])
        p_mm[3:5] *= k != 2
        _write_bare(place / f"measured_SMR_{k}.txt", p_mm)
        on_base = np.tile([1.0, 2.0, 3.0], (ROWS, 1))
        on_base[:, k - 1] += 1000.0
        on_base[6] *= k != 3
        _write_bare(place / f"measured_base_{k}.txt", on_base)
    return folder


def write_titan(folder: Path) -> Path:
    """Write two made-up rows of the titan fixed, and of the titan on its rail."""
    names = ["A1", "A2", "A3", "A4", "A5", "A6", "E"]
    names += [f"{axis}{who}{k}" for who in "an" for k in (1, 2, 3) for axis in "xyz"]
    names += [f"{name}{k}" for k in (1, 2, 3) for name in ("dx", "dy", "dz", "err")]
    lines = [",".join(names)]
    for row in (0.0, 1.0):
        axes = [10.0 + row, -20.0, 30.0, 40.0, 50.0, -60.0, 1500.0]
        measured = np.arange(9.0) * 100.0 + row
        owners = measured + np.tile([0.1, 0.2, 0.2], 3)
        lines.append(",".join(f"{x:g}" for x in (*axes, *measured, *owners, *np.zeros(12))))
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("robodata.csv", "robodata2.csv"):
        (folder / name).write_text("\n".join(lines) + "\n")
    return folder


def write_iiwa7(folder: Path) -> Path:
    """Write three made-up rows of each of the four tables of the iiwa 7, the same in all."""
    lines = ["Number, q1, and so on"]
    for row in range(3):
        q, load = 0.1 * np.arange(1, 8) + 0.01 * row, np.arange(1.0, 8.0)
        T = np.array([[0, -1, 0, 500 + row], [1, 0, 0, 600], [0, 0, 1, 700], [0, 0, 0, 1.0]])
        lines.append(", ".join(f"{x:.15f}" for x in (row + 1, *q, *load, *T.ravel())))
    for name in (
        "20161118_run_1.csv",
        "0kg/20161216_run1_0kg.csv",
        "1.25kg/20161216_run2_1.25kg.csv",
        "2.5kg/20161216_run3_2.5kg.csv",
    ):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("\n".join(lines) + "\n")
    return folder


def write_motoman(folder: Path) -> Path:
    """Write two made-up rows of both dates of the MA2010; quaternions of length two, w negative."""
    for date in ("test0516_R1", "test0801_R1"):
        place = folder / MOTOMAN / date
        place.mkdir(parents=True, exist_ok=True)
        q_rad = np.array([[0.1, 0.2, 0.3, 0.4, 0.5, 0.6], [0.2, 0.2, 0.3, 0.4, 0.5, 0.6]])
        np.savetxt(place / "robot_q_align.csv", q_rad, delimiter=",")
        pose = np.array(
            [[1000.0, 20.0, 300.0, -1.6, 1.2, 0.0, 0.0], [1001.0, 20.0, 300.0, 2, 0, 0, 0]]
        )
        np.savetxt(place / "mocap_T_align.csv", pose, delimiter=",")
    return folder


def write_justin(folder: Path) -> Path:
    """Write three made-up rows of Justin, lists as numpy prints them."""
    lines = [",q,y"]
    for row in range(3):
        q = np.concatenate([[0.5 + 0.1 * row, -0.25, 1.0], np.arange(7) * 0.1, np.arange(7) * 0.2])
        listed = " ".join(f"{x: .8f}" for x in (*q, 0.0, 0.0))
        lines.append(f'{row},[{listed}],"[[-1.5  1.25 1.5 ]\n [-3.    2.5  1e-1]]"')
    (folder / "dataset").mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(folder / "dataset/measurements.csv.zip", "w") as archive:
        archive.writestr("measurements.csv", "\n".join(lines) + "\n")
    return folder


#: What writes a made-up folder of each data set.
MADE_UP = {
    "dlr-elastic-calibration": write_justin,
    "faro-irb120": write_irb120,
    "iiwa7-robot-calibration": write_iiwa7,
    "ipa-robot-accuracy": write_ipa,
    "titan-robot-accuracy": write_titan,
    "welding-motoman": write_motoman,
}


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
