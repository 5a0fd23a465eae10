"""Few points that are touched again and again: a ball at the flange, put into two sockets."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.spatial.transform import Rotation

import pa10cal
from pa10cal.arm.chain import Chain
from pa10cal.errors import CalibrationError
from pa10cal.files.arms import load_arm

SOCKETS_M = np.array([[0.55, 0.1, 0.3], [0.55, 0.15, 0.3]])
BALL_M = np.array([0.01, -0.02, 0.08])
#: Zeros of joints 2 to 5 are off by so much: the nominal arm leaves millimetres.
ZEROS_RAD = np.radians([0.0, 0.4, -0.5, 0.3, -0.6, 0.0])


def ball_m(q_rad):
    """Return the places (P, 3) of the ball."""
    T = Chain.of(load_arm("ur10")).forward(q_rad)
    return T[:, :3, :3] @ BALL_M + T[:, :3, 3]


def reaching(places_m, rng):
    """Return joint positions (P, 6) that put the ball there, by shortest Newton's steps."""
    q_rad, wrong, step = (
        np.zeros((len(places_m), 6)),
        np.ones(len(places_m), bool),
        1e-6 * np.eye(6),
    )
    while wrong.any():
        found, there = rng.uniform(-2.0, 2.0, (wrong.sum(), 6)), places_m[wrong]
        for _ in range(40):
            both = [ball_m(found + h) - ball_m(found - h) for h in step]
            by_joints = np.stack(both, axis=2) / 2e-6
            moved = np.linalg.pinv(by_joints) @ (ball_m(found) - there)[:, :, None]
            found -= np.clip(moved[:, :, 0], -0.3, 0.3)
        q_rad[wrong] = found
        off_m = np.linalg.norm(ball_m(q_rad) - places_m, axis=1)
        wrong = (off_m > 1e-8) | (np.abs(q_rad).max(axis=1) > 3.0)
    return q_rad


def touched(folder, *, poses=60, order=()):
    """Write a made-up campaign of the ball in the sockets, 50 mm apart, to 0.02 mm."""
    rng = np.random.default_rng(8)
    q = reaching(SOCKETS_M[np.arange(poses) % 2], rng) - ZEROS_RAD
    q = q[:, order or range(6)]
    seen_mm = np.where(np.arange(poses)[:, None] % 2, [50.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    turn = Rotation.from_euler("xyz", [0.3, -0.2, 0.9]).as_matrix()
    seen_mm = seen_mm @ turn.T + [10.0, 20.0, 30.0] + rng.normal(0.0, 0.02, (poses, 3))
    names = [*(f"J{k}" for k in range(1, 7)), "x", "y", "z"]
    pd.DataFrame(np.hstack([q, seen_mm]), columns=names).to_csv(folder / "a.csv", index=False)
    described = {
        "schema": "pa10cal-campaign/1",
        "name": folder.name,
        "provenance": "synthetic: a test",
        "robot": "ur10",
        "instrument": {"kind": "points", "uncertainty_mm": 0.02},
        "tool": {"mass_kg": 0.0, "com_mm": [0.0] * 3, "load_point_mm": [0.0] * 3},
        "gravity_m_s2": [0.0, 0.0, -9.81],
        "reference_temperature_C": 20.0,
        "files": {"poses": "a.csv"},
        "holdout": {"every": 5},
        "columns": {
            "poses": {
                "joints": {"names": names[:6], "unit": "rad"},
                "targets": {"T1": {"names": ["x", "y", "z"]}},
            }
        },
    }
    (folder / "campaign.yaml").write_text(yaml.safe_dump(described))
    return pa10cal.read_campaign(folder)


def test_an_arm_is_calibrated_by_a_ball_in_two_sockets(tmp_path):
    campaign = touched(tmp_path)
    model = pa10cal.calibrate(campaign)
    found = model.parameters.set_index("parameter")
    for joint in (2, 3, 4, 5):
        value_rad, u_rad = found.loc[f"delta_theta_{joint}", ["value", "std"]]
        assert abs(value_rad - ZEROS_RAD[joint - 1]) < 4.0 * u_rad < 2e-3


def test_joints_of_another_order_are_refused_by_touched_points_too(tmp_path):
    campaign = touched(tmp_path, order=[1, 0, 3, 2, 5, 4])
    with pytest.raises(CalibrationError, match="does not fit the readings"):
        pa10cal.calibrate(campaign)
