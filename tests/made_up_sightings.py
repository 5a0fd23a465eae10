"""Made-up campaigns as raw lines that a test may spoil, and one that touches nothing."""

from __future__ import annotations

import gzip
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import Chain
from pa10cal.files.arms import load_arm

UNCERTAINTY_MM = 0.02


@dataclass(kw_only=True)
class RawFolder:
    """Raw files as lists of lines (the header first)."""

    folder: Path
    description: dict[str, Any]
    poses: list[str]
    line_end: str = "\n"
    extra: dict[str, bytes] = field(default_factory=dict)

    def write(self) -> Path:
        """Write the folder; a name that ends in .gz is compressed."""
        self.folder.mkdir(exist_ok=True)
        (self.folder / "campaign.yaml").write_text(yaml.safe_dump(self.description))
        for key in ("cmm", "resolver", "poses"):
            if name := self.description["files"].get(key):
                lines = getattr(self, key, ())
                content = "".join(line + self.line_end for line in lines).encode()
                packed = gzip.compress(content) if name.endswith(".gz") else content
                (self.folder / name).write_bytes(packed)
        for name, content in self.extra.items():
            (self.folder / name).write_bytes(content)
        return self.folder


@dataclass(kw_only=True)
class Sighted(RawFolder):
    """Raw file of an instrument that touches nothing, with the truth it was made from."""

    q: np.ndarray
    T_instr_base: np.ndarray
    T_ee_target: np.ndarray
    T_instr_target: np.ndarray
    p_ee_m: np.ndarray
    p_instr_m: np.ndarray
    p_base_point_m: np.ndarray
    d_m: np.ndarray

    def column(self, name: str) -> int:
        return self.poses[0].split(",").index(name)


def sighted(tmp_path, kind, *, robot="ur10", poses=40, repeats=1, targets=3, seed=1, noise_mm=0.0):
    """Draw poses over half of every joint's range, any base and any tool, and write what is seen.

    One pose in five is held out; of several targets one in ten is not seen, never all at once.
    """
    rng = np.random.default_rng(seed)
    arm = load_arm(robot)
    middle, half = arm.limits_rad.mean(axis=1), 0.25 * np.ptp(arm.limits_rad, axis=1)
    half = np.where(arm.prismatic, half, np.minimum(half, 1.5))
    # Written to so many decimals, the command is what is written.
    commands = (middle + half * rng.uniform(-1, 1, (poses, arm.n))).round(6)
    q = np.tile(commands, (repeats, 1))
    T_base_ee = Chain.of(arm).forward(q)
    T_instr_base, T_ee_target = np.eye(4), np.eye(4)
    T_instr_base[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    T_ee_target[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    T_instr_base[:3, 3], T_ee_target[:3, 3] = rng.uniform(-2, 2, 3), rng.uniform(-0.15, 0.15, 3)
    T_instr_target = T_instr_base @ T_base_ee @ T_ee_target
    T_instr_target[:, :3, 3] += 1e-3 * rng.normal(0, noise_mm, (len(q), 3))
    p_ee_m = rng.uniform(-0.15, 0.15, (targets, 3))
    homogeneous = np.column_stack([p_ee_m, np.ones(targets)])
    p_instr_m = np.einsum("ij,pjk,bk->pbi", T_instr_base, T_base_ee, homogeneous)[..., :3]
    p_instr_m += 1e-3 * rng.normal(0, noise_mm, p_instr_m.shape)
    if targets > 1:
        unseen = rng.random(p_instr_m.shape[:2]) < 0.1
        unseen[unseen.all(axis=1), 0] = False
        p_instr_m[unseen] = np.nan
    point = rng.uniform(0.8, 1.6, 3) * rng.choice([-1, 1], 3)
    d_m = np.linalg.norm((T_base_ee @ T_ee_target)[:, :3, 3] - point, axis=1)
    d_m += 1e-3 * rng.normal(0, noise_mm, len(q))
    measured = {
        "pose": _pose_columns(T_instr_target),
        "points": _point_columns(p_instr_m),
        "distance": {"d_mm": 1e3 * d_m},
    }[kind]
    lines = _lines(arm, q, poses, measured)
    return Sighted(
        folder=tmp_path / "sighted",
        q=q,
        T_instr_base=T_instr_base,
        T_ee_target=T_ee_target,
        T_instr_target=T_instr_target,
        p_ee_m=p_ee_m,
        p_instr_m=p_instr_m,
        p_base_point_m=point,
        d_m=d_m,
        description=described(kind, 1.0, (0, 0, 50), (0, 0, 30), name="sighted", robot=robot),
        poses=lines,
    )


def rows_of(*columns, names="", sep="\t", decimals=6):
    """Return lines of columns (N,) or (N, k), under names where there are some."""
    every = [np.asarray(each).reshape(len(columns[0]), -1).tolist() for each in columns]
    rows = [[v for each in row for v in each] for row in zip(*every, strict=True)]
    fields = [
        [f"{v:.{decimals}f}" if isinstance(v, float) else str(v) for v in row] for row in rows
    ]
    return "\n".join([*filter(None, [names]), *(sep.join(row) for row in fields), ""])


def is_read(found, q, T, atol_rad=2e-5, atol_m=2e-6):
    """Say whether every pose is among those read, with its joints and its place."""
    states, p_m = found.observations.states, found.observations.measured.places_m
    for q_rad, T_instr_target in zip(q, T, strict=True):
        k = int(np.argmin(np.abs(states.q_rad - q_rad).max(axis=1)))
        np.testing.assert_allclose(states.q_rad[k], q_rad, atol=atol_rad)
        np.testing.assert_allclose(p_m[k, 0], T_instr_target[:3, 3], atol=atol_m)
    return True


def _pose_columns(T):
    quaternion = Rotation.from_matrix(T[:, :3, :3]).as_quat(scalar_first=True)
    columns = dict(zip(("x_mm", "y_mm", "z_mm"), 1e3 * T[:, :3, 3].T, strict=True))
    return columns | dict(zip(("qw", "qx", "qy", "qz"), quaternion.T, strict=True))


def _point_columns(p_m):
    return {
        f"T{b + 1}_{axis}_mm": 1e3 * p_m[:, b, k]
        for b in range(p_m.shape[1])
        for k, axis in enumerate("xyz")
    }


def _lines(arm, q, poses, measured):
    positions = np.where(arm.prismatic, 1e3 * q, np.degrees(q))
    units = np.where(arm.prismatic, "mm", "deg")
    joints = [f"q{j}_{unit}" for j, unit in enumerate(units, start=1)]
    lines = [",".join(["time_s", "kind", "pose", "load_N", "repeat", *joints, *measured])]
    for k in range(len(q)):
        kind = "holdout" if k % poses % 5 == 4 else "grid"
        words = [f"{10 * k}", kind, f"P{k % poses:03d}", "0", f"{k // poses + 1}"]
        words += [f"{value:.9f}" for value in positions[k]]
        words += ["" if np.isnan(values[k]) else f"{values[k]:.9f}" for values in measured.values()]
        lines.append(",".join(words))
    return lines


def described(kind="pose", mass_kg=0.0, com_mm=(0, 0, 0), load_point_mm=(0, 0, 0), **more):
    """Return the content of a campaign.yaml, of a UR10 but for what is given."""
    tool = {"mass_kg": mass_kg, "com_mm": [*com_mm], "load_point_mm": [*load_point_mm]}
    return {
        "schema": "pa10cal-campaign/1",
        "name": "made-up",
        "robot": "ur10",
        "provenance": "made up by the tests",
        "instrument": {"kind": kind, "uncertainty_mm": UNCERTAINTY_MM},
        "tool": tool,
        "gravity_m_s2": [0, 0, -9.80665],
        "reference_temperature_C": 21,
        "files": {"poses": "poses.csv"},
        **more,
    }
