"""Springs of an arm with bars are at its motors; simulated by formulas of its own."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.spatial.transform import Rotation

from made_up_sightings import described
from pa10cal import calibrate
from pa10cal.campaign.read import read_campaign

#: Offset, d, a and twist of each joint; a bar takes joint 3 to the base, so that it is at J3 - J2.
JOINTS = [
    (0.0, 0.8, 0.2, -90.0),
    (-90.0, 0.0, 0.9, 0.0),
    (0.0, 0.0, 0.18, -90.0),
    (0.0, 1.0, 0.0, 90.0),
    (0.0, 0.0, 0.0, -90.0),
    (0.0, 0.2, 0.0, 0.0),
]
LIMITS_DEG = [160.0, 45.0, 40.0, 140.0, 100.0, 180.0]
LINKS_KG = np.array([200.0, 110.0, 100.0, 40.0, 20.0, 8.0])
STIFFNESS = {2: 1.4e6, 3: 8.0e5}  # N m/rad, of the motors of these joints
NOISE_MM = 0.02


def turned(angles, axis):
    return Rotation.from_euler(axis, angles).as_matrix()


def posture(theta, rows):
    """Return rotations and places of the frames after every joint, of all poses (P, 6)."""
    R, p, frames = np.eye(3), np.zeros(3), []
    for angles, (offset, d, a, twist) in zip(theta.T, rows, strict=True):
        R = R @ turned((angles + offset)[:, None], "z")
        p = p + R @ [a, 0.0, d]
        R = R @ turned(twist, "x")
        frames.append((R, p))
    return frames


def height_work(theta, rows, com_m, tool_kg, tool_m):
    """Return the potential energy (P,) of an arm that stands on a floor [J]."""
    frames = posture(theta, rows)
    weighed = zip(frames, com_m, LINKS_KG, strict=True)
    heights = [(p + R @ com)[:, 2] * m for (R, p), com, m in weighed]
    R, p = frames[-1]
    return 9.81 * (sum(heights) + tool_kg * (p + R @ tool_m)[:, 2])


def of_rows(motors, mechanical):
    """Return the angles of the rows; where bars move joint 3, of motors, else as counted."""
    return motors - np.eye(6)[2] * (motors[:, 1:2] if mechanical else 0.0)


def written(folder, *, mechanical, logged, seed):
    """Write a campaign of 120 poses; the motors of joints 2 and 3 wind up under their torques.

    Torques are logged, or the masses of the links are stated.
    """
    rng = np.random.default_rng(seed)
    plain = [(np.radians(o), d, a, np.radians(t)) for o, d, a, t in JOINTS]
    off = rng.normal(0.0, [8e-4, 3e-4, 3e-4, 5e-4], (6, 4))
    off[1, 1] = 0.0
    rows = [tuple(np.add(row, more)) for row, more in zip(plain, off, strict=True)]
    com_m = rng.uniform(-0.1, 0.1, (6, 3))
    com_m[:2, 0] -= [0.1, 0.4]
    tool_kg, tool_m = 30.0, np.array([0.02, -0.01, 0.1])
    counted = np.radians(LIMITS_DEG) * rng.uniform(-1.0, 1.0, (120, 6))
    targets_m = np.array([[0.15, 0.0, 0.05], [-0.1, 0.12, 0.1], [-0.08, -0.14, 0.02]])
    # A motor winds up by the change of the energy with its own angle over its stiffness: where bars
    # move joint 3, the motor of joint 2 moves both rows; else it is the row's own.
    start = counted if mechanical else of_rows(counted, True)
    motors, step = start, 1e-5
    for _ in range(3):
        energy = [
            [
                height_work(of_rows(motors + by, mechanical), rows, com_m, tool_kg, tool_m)
                for by in (way, -way)
            ]
            for way in step * np.eye(6)
        ]
        tau_Nm = np.diff(energy, axis=1)[:, 0].T / (-2.0 * step)
        wound = np.zeros_like(start)
        for joint, K in STIFFNESS.items():
            wound[:, joint - 1] = tau_Nm[:, joint - 1] / K
        motors = start - wound
    R, p_m = posture(of_rows(motors, mechanical), rows)[-1]
    p_mm = 1e3 * (p_m[:, None] + targets_m @ np.swapaxes(R, 1, 2))
    in_room_mm = p_mm @ turned([0.3, 0.002, -0.9], "xyz").T + [2100.0, -400.0, 150.0]
    in_room_mm += rng.normal(0.0, NOISE_MM, p_mm.shape)
    columns = {f"q{k + 1}_deg": np.degrees(counted[:, k]) for k in range(6)}
    columns |= {
        f"T{b + 1}_{axis}_mm": in_room_mm[:, b, k] for b in range(3) for k, axis in enumerate("xyz")
    }
    if logged:
        columns |= {f"tau{k + 1}_Nm": tau_Nm[:, k] for k in range(6)}
    table = pd.DataFrame(
        {"pose": [f"P{k}" for k in range(120)], "load_N": 0.0, "repeat": 1} | columns
    )
    folder.mkdir()
    table.to_csv(folder / "poses.csv", index=False)
    coupling = {"joint": 3, "by": 2, "factor": -1}
    arm = {
        "name": "mine",
        "rows": [
            {
                "theta_deg": o,
                "d_m": d,
                "a_m": a,
                "alpha_deg": t,
                "limits_deg": [-limit, limit],
            }
            | ({} if logged else {"mass_kg": float(m), "com_m": com.tolist()})
            for (o, d, a, t), limit, m, com in zip(JOINTS, LIMITS_DEG, LINKS_KG, com_m, strict=True)
        ],
        "coupling": [coupling if mechanical else coupling | {"counted_only": True}],
    }
    (folder / "mine.yaml").write_text(yaml.safe_dump(arm))
    tool = {
        "mass_kg": tool_kg,
        "com_mm": (1e3 * tool_m).tolist(),
        "load_point_mm": [0, 0, 0],
        "balls_mm": {f"T{b + 1}": (1e3 * t).tolist() for b, t in enumerate(targets_m)},
    }
    instrument = {"kind": "points", "uncertainty_mm": NOISE_MM}
    about = {"name": folder.name, "robot": "mine", "tool": tool, "holdout": {"every": 5}}
    about["gravity_m_s2"] = [0.0, 0.0, -9.81]
    (folder / "campaign.yaml").write_text(yaml.safe_dump(described(**about, instrument=instrument)))


@pytest.mark.parametrize(("mechanical", "logged"), [(True, False), (True, True), (False, False)])
def test_springs_are_at_the_motors(mechanical, logged, tmp_path):
    written(tmp_path / "mine", mechanical=mechanical, logged=logged, seed=4)
    model = calibrate(read_campaign(tmp_path / "mine"))
    assert "as the noise of" in model.fitted_to.health
    table = model.parameters.set_index("parameter")
    for joint, K in STIFFNESS.items():
        found = table.loc[f"K_lin_{joint}"]
        assert abs(found["value"] - K) < 2.0 * found["std"] < 0.1 * K
