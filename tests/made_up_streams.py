"""Joints and readings that both go on while the arm moves, at rates of their own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import Chain
from pa10cal.files.arms import load_arm

#: Stamps are rounded to so many decimals, and jitter by so much [s].
DECIMALS, JITTER_S = 4, 2e-4


@dataclass
class Streams:
    """Both logs as tables, and the truth."""

    joints: pd.DataFrame
    readings: pd.DataFrame
    q_rad: np.ndarray  # (P, n) where the arm stood
    T_instr_target: np.ndarray  # (P, 4, 4) and the target then
    T_read: np.ndarray  # (N, 4, 4) the target at every reading
    offsets_s: tuple[float, float]  # to add to the first reading's time, and to the last one's

    def write(self, folder: Path) -> list[str]:
        """Write both; return the paths."""
        folder.mkdir(exist_ok=True)
        paths = [folder / "controller.csv", folder / "tracker.csv"]
        for table, path in zip((self.joints, self.readings), paths, strict=True):
            table.to_csv(path, index=False, float_format="%.6f")
        return [str(path) for path in paths]


def streams(
    seed,
    joints_hz,
    readings_hz,
    *,
    poses=18,
    ppm=0.0,
    noise_mm=0.03,
    stands_s=(1.5, 4.0),
    moves_s=(1.0, 3.0),
) -> Streams:
    """Draw a run of an arm whose zeros are a milliradian off, and whose readings have a scale.

    It goes from pose to pose on polynomials or with constant accelerations. The readings' clock may
    run slow by `ppm` against the joints'.
    """
    rng = np.random.default_rng(seed)
    arm = load_arm("ur10")
    middle, half = arm.limits_rad.mean(axis=1), 0.25 * np.ptp(arm.limits_rad, axis=1)
    q = middle + np.minimum(half, 1.2) * rng.uniform(-1, 1, (poses, arm.n))
    moving_s, standing_s = rng.uniform(*moves_s, poses), rng.uniform(*stands_s, poses)
    begin_s = 1.0 + np.concatenate([[0.0], np.cumsum(moving_s + standing_s)[:-1]])
    end_s, ramps = float(begin_s[-1] + moving_s[-1] + standing_s[-1] + 1.0), rng.random() < 0.5
    before = np.vstack([q[0] + rng.uniform(0.2, 0.4, arm.n), q[:-1]])

    def at(time_s):
        """Return joint positions (N, n) at times (N,)."""
        k = np.maximum(np.searchsorted(begin_s, time_s, side="right") - 1, 0)
        part = np.clip((time_s - begin_s[k]) / moving_s[k], 0.0, 1.0)
        smooth = part**3 * (10 - 15 * part + 6 * part**2)
        if ramps:  # a third each of acceleration, of even speed, and of deceleration
            ends = np.minimum(part, 1 - part)
            eased = np.where(ends < 1 / 3, 2.25 * ends**2, 0.25 + 1.5 * (ends - 1 / 3))
            smooth = np.where(part < 0.5, eased, 1 - eased)
        return before[k] + smooth[:, None] * (q[k] - before[k])

    joints_s = np.arange(0.0, end_s, 1.0 / joints_hz)
    log = np.degrees(at(joints_s)) + rng.normal(0, 5e-4, (len(joints_s), arm.n))
    joints = pd.DataFrame(log, columns=[f"A{k} [deg]" for k in range(1, 7)])
    joints.insert(0, "t [s]", np.round(joints_s, DECIMALS))
    read_s = np.arange(rng.uniform(0, 0.5), end_s, 1.0 / readings_hz)
    read_s = np.sort(read_s + rng.normal(0, JITTER_S, len(read_s)))
    off, scale = rng.normal(0, 1e-3, arm.n), 1.0 + rng.normal(0, 2e-4)
    T_instr_base, T_ee_target = np.eye(4), np.eye(4)
    T_instr_base[:3, :3], T_ee_target[:3, :3] = Rotation.random(2, random_state=rng).as_matrix()
    T_instr_base[:3, 3], T_ee_target[:3, 3] = rng.uniform(-2, 2, 3), rng.uniform(-0.1, 0.1, 3)

    def seen(q_rad):
        T = T_instr_base @ Chain.of(arm).forward(q_rad + off) @ T_ee_target
        T[:, :3, 3] *= scale
        return T

    T_read = seen(at(read_s))
    T_read[:, :3, 3] += 1e-3 * rng.normal(0, noise_mm, (len(read_s), 3))
    offset_s = float(rng.uniform(-2000.0, 2000.0))
    stamps = np.round((read_s - offset_s) / (1.0 + 1e-6 * ppm), DECIMALS)
    names = ["X [mm]", "Y [mm]", "Z [mm]"]
    readings = pd.DataFrame(1e3 * T_read[:, :3, 3], columns=names)
    readings.insert(0, "Time [s]", stamps)
    offsets_s = (float(value * 1e-6 * ppm + offset_s) for value in (stamps[0], stamps[-1]))
    return Streams(joints, readings, q, seen(q), T_read, tuple(offsets_s))
