"""A controller's log of joints and a tracker's log of readings, with clocks of their own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from made_up_sightings import sighted

JOINTS = [f"A{k} [°]" for k in range(1, 7)]
PLACE = ["X [mm]", "Y [mm]", "Z [mm]"]


@dataclass
class TwoLogs:
    """Both logs as tables, and the truth."""

    joints: pd.DataFrame
    readings: pd.DataFrame
    q_rad: np.ndarray  # (P, n) of each reading
    offset_s: float  # to add to the readings' time for that of the joints
    stood_s: np.ndarray  # (P, 2) when the arm stood at each reading, on the joints' clock

    def write(self, folder: Path, **how) -> tuple[Path, Path]:
        folder.mkdir(exist_ok=True)
        paths = folder / "controller.csv", folder / "tracker.csv"
        for table, path in zip((self.joints, self.readings), paths, strict=True):
            table.to_csv(path, index=False, **how)
        return paths


def two_logs(
    tmp_path, seed, *, poses=40, dense=True, apart_s=7200.0, regular=False, noise_deg=0.001
) -> TwoLogs:
    """Draw a run: the arm goes from pose to pose, stands, and is read once while it stands.

    Dense logs hold the joints five to twenty times a second; others have one row a pose. Some
    poses are only passed, without a reading, before, between or after the others.
    """
    rng = np.random.default_rng(seed)
    raw = sighted(tmp_path, "pose", poses=poses, seed=seed, noise_mm=0.02)
    q_deg = np.degrees(raw.q)
    # Ways between, without a reading.
    order = list(range(poses))
    for _ in range(0 if regular else rng.integers(0, 6)):
        order.insert(int(rng.integers(0, len(order) + 1)), -1)
    rate_s = 1.0 / rng.uniform(5.0, 20.0)
    time_s, rows, stood, read_s = 0.0, [], np.zeros((poses, 2)), np.zeros(poses)
    here = q_deg[0] + rng.uniform(5, 20, 6)
    times = []
    for k in order:
        there = q_deg[k] if k >= 0 else q_deg[0] + rng.uniform(-40, 40, 6)
        moving_s = 4.0 if regular else float(rng.uniform(2.0, 8.0))
        standing_s = 6.0 if regular else float(rng.uniform(2.0, 12.0))
        if dense:
            steps = np.arange(0.0, moving_s, rate_s)
            part = (1 - np.cos(np.pi * steps / moving_s))[:, None] / 2
            rows += list(here + part * (there - here))
            times += list(time_s + steps)
            still = np.arange(0.0, standing_s, rate_s)
            rows += [there] * len(still)
            times += list(time_s + moving_s + still)
        elif k >= 0:
            rows.append(there)
            times.append(time_s + moving_s + 0.5 * standing_s)
        if k >= 0:
            stood[k] = time_s + moving_s, time_s + moving_s + standing_s
            read_s[k] = rng.uniform(stood[k, 0] + 0.3, stood[k, 1] - 0.3)
        time_s += moving_s + standing_s
        here = there
    joints = pd.DataFrame(np.array(rows), columns=JOINTS)
    joints += rng.normal(0, noise_deg, joints.shape)
    offset_s = float(rng.uniform(-apart_s, apart_s))
    start = pd.Timestamp("2026-03-05 09:30")
    joints.insert(0, "Zeit [s]", np.round(times, 3))
    T = raw.T_instr_target
    readings = pd.DataFrame(1e3 * T[:, :3, 3], columns=PLACE)
    angles = Rotation.from_matrix(T[:, :3, :3]).as_euler("xyz", degrees=True)
    readings[["Rx [deg]", "Ry [deg]", "Rz [deg]"]] = angles
    at = start + pd.to_timedelta(read_s - offset_s + 7300.0, unit="s")
    readings.insert(0, "Zeitstempel", [each.strftime("%d.%m.%Y %H:%M:%S.%f") for each in at])
    first = pd.Timestamp("2026-03-05 09:30") + pd.to_timedelta(7300.0, unit="s")
    # What stands in the file is from 1970 on; the joints' clock from the start of the run.
    absolute_s = (first - pd.Timestamp(0)).total_seconds()
    return TwoLogs(joints, readings, raw.q, offset_s - absolute_s, stood)
