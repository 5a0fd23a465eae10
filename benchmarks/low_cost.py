"""Low-cost arms under a camera: are right models graded so, and is their promise kept?

`python -m benchmarks.low_cost [--count 60] [--seed 1]` draws arms of 3 to 6 joints as hobbyists
build them, with zeros off by up to 3 degrees and links by millimetres, and reads a tag on their
gripper with noise of 0.5 to 2 mm that is stated rightly. The forward kinematics are written here,
joint by joint, and share no code with the program. Each model is judged by the true positions of
poses that were never read: rms error over rms `u_mm`, which is to be below 1.3.
"""

from __future__ import annotations

import argparse
import tempfile
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from pa10cal.commands.command_line import limit_threads
from pa10cal.commands.data import import_arm

#: Most that a model may err over what it promises.
MOST = 1.3
_JUDGED = 200


@dataclass(frozen=True)
class Hobby:
    """An arm: joints that turn about z or y in turn, each with a link (x, y, z) after it."""

    axes: tuple[str, ...]
    links_m: np.ndarray  # (n, 3)
    zeros_rad: np.ndarray  # (n,)

    def gripper(self, q_rad: np.ndarray) -> np.ndarray:
        """Return poses (N, 4, 4) of the gripper, for joint positions (N, n)."""
        T = np.tile(np.eye(4), (len(q_rad), 1, 1))
        for j, axis in enumerate(self.axes):
            angle = q_rad[:, j] + self.zeros_rad[j]
            step = np.tile(np.eye(4), (len(q_rad), 1, 1))
            step[:, :3, :3] = Rotation.from_euler(axis, angle[:, None]).as_matrix()
            step[:, :3, 3] = Rotation.from_matrix(step[:, :3, :3]).apply(self.links_m[j])
            T = T @ step
        return T


def drawn(rng: np.random.Generator) -> tuple[Hobby, Hobby]:
    """Return an arm as designed, and as it was built."""
    n = int(rng.integers(3, 7))
    # A turntable, two or more lifting joints side by side, and the wrist.
    axes = tuple("zyyyxy"[:n]) if n != 5 else tuple("zyyyx")
    links_m = np.zeros((n, 3))
    links_m[0, 2] = rng.uniform(0.05, 0.08)
    for j in range(1, n):
        links_m[j, 0 if j > 1 else 2] = rng.uniform(0.08, 0.14)
    zeros = np.radians(rng.uniform(-3.0, 3.0, n))
    zeros[0] = 0.0  # what the base takes up
    built_m = links_m + rng.normal(0.0, 8e-4, (n, 3))
    return Hobby(axes, links_m, np.zeros(n)), Hobby(axes, built_m, zeros)


def written(folder: Path, rng: np.random.Generator) -> tuple[Hobby, float, int]:
    """Write a campaign; return the arm as built, the noise [mm] and the number of poses."""
    designed, built = drawn(rng)
    n, noise_mm = len(built.axes), float(rng.uniform(0.5, 2.0))
    poses = int(rng.integers(60, 201))
    q_rad = rng.uniform(-1.4, 1.4, (poses, n))
    T_camera_base = np.eye(4)
    T_camera_base[:3, :3] = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    T_camera_base[:3, 3] = rng.uniform(-0.5, 0.5, 3)
    T_gripper_tag = np.eye(4)
    T_gripper_tag[:3, :3] = Rotation.from_rotvec(rng.normal(0.0, 0.1, 3)).as_matrix()
    T_gripper_tag[:3, 3] = rng.uniform(-0.03, 0.03, 3)
    seen = T_camera_base @ built.gripper(q_rad) @ T_gripper_tag
    p_mm = 1e3 * seen[:, :3, 3] + rng.normal(0.0, noise_mm, (poses, 3))
    turned = Rotation.from_rotvec(rng.normal(0.0, 0.01 * noise_mm, (poses, 3)))
    quat = (turned * Rotation.from_matrix(seen[:, :3, :3])).as_quat(scalar_first=True)
    joints = [f"q{j + 1}_deg" for j in range(n)]
    columns = ["load_N", "repeat", *joints, "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz"]
    table = np.column_stack([np.zeros(poses), np.ones(poses), np.degrees(q_rad), p_mm, quat])
    write_campaign(
        folder,
        designed,
        columns,
        table,
        provenance="SYNTHETIC: low-cost arm under a camera",
        instrument={"kind": "pose", "uncertainty_mm": round(noise_mm, 3)},
    )
    return built, noise_mm, poses


def write_campaign(
    folder: Path,
    arm: Hobby,
    columns: list[str],
    table: np.ndarray,
    *,
    provenance: str,
    instrument: dict[str, object],
    targets_mm: dict[str, list[float]] | None = None,
) -> None:
    """Write a campaign of an arm as designed: a row (of `columns`) for each pose of a table."""
    lines = [",".join(["pose", *columns])]
    for k, row in enumerate(table):
        lines.append(",".join([f"P{k:03d}", *(f"{each:.7g}" for each in row)]))
    folder.mkdir()
    (folder / "poses.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "hobby.urdf").write_text(urdf(arm), encoding="utf-8")
    with redirect_stdout(None):
        import_arm(folder / "hobby.urdf", out=folder / "hobby.yaml")
    tool = {"mass_kg": 0.0, "com_mm": [0, 0, 0], "load_point_mm": [0, 0, 0]}
    campaign = {
        "schema": "pa10cal-campaign/1",
        "name": folder.name,
        "provenance": provenance,
        "robot": "hobby",
        "instrument": instrument,
        "tool": tool | ({"balls_mm": targets_mm} if targets_mm else {}),
        "gravity_m_s2": [0, 0, -9.81],
        "reference_temperature_C": 20,
        "holdout": {"every": 5},
        "files": {"poses": "poses.csv"},
    }
    (folder / "campaign.yaml").write_text(yaml.safe_dump(campaign), encoding="utf-8")


def urdf(arm: Hobby) -> str:
    """Return the description of an arm as designed."""
    axis = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
    text = ['<robot name="hobby">', '<link name="link0"/>']
    origin = np.zeros(3)
    for j, about in enumerate(arm.axes):
        place = " ".join(f"{each:.6f}" for each in origin)
        text += [
            f'<link name="link{j + 1}"/>',
            f'<joint name="joint{j + 1}" type="revolute"><origin xyz="{place}" rpy="0 0 0"/>'
            f'<parent link="link{j}"/><child link="link{j + 1}"/><axis xyz="{axis[about]}"/>'
            '<limit lower="-2.0" upper="2.0" effort="1" velocity="1"/></joint>',
        ]
        origin = arm.links_m[j]
    place = " ".join(f"{each:.6f}" for each in origin)
    text += [
        '<link name="tip"/>',
        f'<joint name="tip" type="fixed"><origin xyz="{place}" rpy="0 0 0"/>'
        f'<parent link="link{len(arm.axes)}"/><child link="tip"/></joint>',
        "</robot>",
    ]
    return "\n".join(text)


def judged(folder: Path, rng: np.random.Generator) -> tuple[str, float, float, str]:
    """Return the grade, rms error of predicted flange positions, rms `u_mm`, and the sentence."""
    from pa10cal.errors import Pa10calError
    from pa10cal.interface import calibrate, read_campaign

    built, _, _ = written(folder, rng)
    try:
        model = calibrate(read_campaign(folder))
    except Pa10calError as refused:
        return "refused", np.nan, np.nan, str(refused)
    q_rad = rng.uniform(-1.4, 1.4, (_JUDGED, len(built.axes)))
    found = model.predict(q_rad, frame="tool")
    # The base and the tag are where the calibration says; what is judged is the arm between them.
    truth = built.gripper(q_rad)
    error_mm = 1e3 * best_fit(found.T, truth)
    assert model.fitted_to is not None
    return (
        model.grade,
        float(np.sqrt(np.mean(error_mm**2))),
        float(np.sqrt(np.mean(found.u_mm**2))),
        model.fitted_to.health,
    )


def best_fit(T_found: np.ndarray, T_true: np.ndarray) -> np.ndarray:
    """Return position errors (N,) [m] beside a base and a tool that fit best."""
    A, t = T_true[:, :3, :3], T_true[:, :3, 3]
    tool, error = np.zeros(3), np.zeros(len(t))
    for _ in range(50):
        p = t + A @ tool
        middle, about = T_found[:, :3, 3].mean(axis=0), p.mean(axis=0)
        turn, _ = Rotation.align_vectors(T_found[:, :3, 3] - middle, p - about)
        left = turn.inv().apply(T_found[:, :3, 3] - middle) + about - t
        columns = np.concatenate([A, np.tile(np.eye(3), (len(t), 1, 1))], axis=2).reshape(-1, 6)
        tool = np.linalg.lstsq(columns, left.ravel(), rcond=None)[0][:3]
        error = np.linalg.norm(T_found[:, :3, 3] - middle - turn.apply(p - about), axis=1)
    return error


def main() -> None:
    """Draw, judge, and print a line each and the counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    limit_threads()
    suspected, kept, told = 0, 0, 0
    with tempfile.TemporaryDirectory() as place:
        for k in range(asked.count):
            rng = np.random.default_rng([asked.seed, k])
            grade, error_mm, u_mm, line = judged(Path(place) / f"arm{k}", rng)
            suspected += grade in ("suspect_input", "refused", "not_converged")
            kept += bool(error_mm <= MOST * u_mm)
            told += "was mastered" in line
            print(f"{k}: {grade}, {error_mm:.3f} mm off with {u_mm:.3f} promised; {line}")
    print(
        f"{asked.count} arms: {suspected} suspected or refused, {kept} within {MOST} times what "
        f"is promised, {told} with a mastering told"
    )


if __name__ == "__main__":
    main()
