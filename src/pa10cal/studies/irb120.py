"""A made-up campaign of an IRB 120 in the layout of a public one, which is not at hand.

What is published of the measured campaign sets the sizes: 1000 configurations, three reflectors on
the flange that agree to 0.006 mm and three on the base, a tracker that drifts by 0.05 mm, 0.33 mm
left by the geometry without some 50 configurations that are far off, backlash of joint 1, an error
of joint 2 that goes with its angle. All of it is synthetic.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from pa10cal.cell.campaign import simulate_campaign
from pa10cal.cell.disturbances.disturbance import disturb
from pa10cal.cell.options import SimulateOptions
from pa10cal.cell.raw_log import RawLog
from pa10cal.cell.write import campaign_description, truth_record
from pa10cal.files.arms import load_arm
from pa10cal.files.output import write_text
from pa10cal.results.codec import write
from pa10cal.settings_reading import parse_section

NAME = "irb120"
ROBOT = "irb120"
TARGETS, BASE_TARGETS = 3, 3
PROVENANCE = (
    "Synthetic: made up by this project's own virtual cell, in the layout and with errors of the "
    "size of a measured IRB 120, and not measured on any robot."
)
#: Share of the configurations that are far off, and how far: evenly in the logarithm [mm].
FAR_SHARE, FAR_MM = 0.07, (1.0, 3.0)
#: Knots of joint 2's error a turn, and the size of its orders [rad].
_KNOTS = 36
_ORDERS = {1: 2.0e-4, 2: 2.8e-4, 3: 2.0e-4, 5: 2.0e-4, 7: 1.4e-4}
_BACKLASH_RAD = 3.0e-4
#: Links about their motors: what no log shows of a robot that small [rad].
_UNSEEN_RAD = 3.2e-4
_DRIFT_MM, _TURN_MRAD = 0.05, 0.01
_NOISE_MM = 0.004


def settings(random_seed: int, poses: int = 1000) -> SimulateOptions:
    """Return what the virtual cell is to do."""
    rng = np.random.default_rng([random_seed, 1])
    angle = 2.0 * np.pi * np.arange(_KNOTS) / _KNOTS
    waves = [
        size * np.cos(order * angle + rng.uniform(-np.pi, np.pi)) for order, size in _ORDERS.items()
    ]
    knots = np.sum(waves, axis=0).tolist()
    raw = {
        "random_seed": random_seed,
        "robot": ROBOT,
        "without_touches": {
            "instrument": "points",
            "poses": poses,
            "holdout_share": 0.0,
            "targets": TARGETS,
            "base_targets": BASE_TARGETS,
            "unseen_share": 0.01,
            "position_mm": _NOISE_MM,
            "unseen_rad": _UNSEEN_RAD,
            "seconds_a_pose": 20.0,
        },
        "hidden_effects": [
            {"id": "joint_error_map", "of": "joint 2", "parameters": {"knots": knots}},
            {"id": "backlash", "of": "joint 1", "parameters": {"b": _BACKLASH_RAD}},
        ],
        "disturbances": [
            {"id": "random_walk", "parameters": {"size_mm": _DRIFT_MM, "turn_mrad": _TURN_MRAD}}
        ],
    }
    return parse_section(SimulateOptions, raw, where=NAME)


def write_tables(folder: Path, truth: Path, random_seed: int, poses: int = 1000) -> None:
    """Write the tables of `datasets/readers/faro_irb120.py`, and what is hidden in them apart.

    Args:
        folder: gets `joints.txt`, a table for each reflector, and `provenance.txt`.
        truth: file for what is hidden.
        random_seed: draws arm, poses and noise.
        poses: configurations.
    """
    asked = settings(random_seed, poses)
    made = simulate_campaign(NAME, load_arm(ROBOT), asked)
    log = RawLog.of(campaign_description(made), made.tables, made.truth.robot.arm)
    places = disturb(log, asked.disturbances, asked.random_seed)
    rng = np.random.default_rng([random_seed, 2])
    far = rng.random(poses) < FAR_SHARE
    direction = rng.standard_normal((poses, 3))
    least, most = np.log(FAR_MM)
    size_mm = far * np.exp(rng.uniform(least, most, poses))
    shift_mm = size_mm[:, None] * direction / np.linalg.norm(direction, axis=1)[:, None]
    log.move(shift_mm, base=False)
    readings = log.readings
    _write(folder / "joints.txt", readings[[f"q{joint}_deg" for joint in range(1, 7)]], 6)
    for k in range(1, TARGETS + 1):
        _write(folder / f"reflector_{k}.txt", readings[[f"T{k}_{axis}_mm" for axis in "xyz"]], 4)
    for k in range(1, BASE_TARGETS + 1):
        _write(folder / f"base_{k}.txt", readings[[f"base{k}_{axis}_mm" for axis in "xyz"]], 4)
    write_text(folder / "provenance.txt", f"{PROVENANCE}\n")
    write(truth_record(made, places), truth)


def _write(path: Path, table: pd.DataFrame, decimals: int) -> None:
    """Write a table of numbers between blanks; nan is one that was not seen."""
    rows = table.round(decimals).to_numpy()
    lines = (" ".join(f"{value:.{decimals}f}" for value in row) for row in rows)
    write_text(path, "\n".join(lines) + "\n")
