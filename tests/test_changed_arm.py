"""The arm that changes between two campaigns of a test."""

from __future__ import annotations

import numpy as np
import pytest

from changed_arm import Change, draw_changed
from pa10cal.files.arms import load_arm
from pa10cal_lab.cell.options import TrackerOptions
from pa10cal_lab.simulated import exact_observations


def test_a_zero_that_moved_moves_the_arm_by_as_much():
    plan = TrackerOptions(poses=10, holdout_share=0.0)
    change = Change(zero_rad=((1, 1e-3),))
    before, after = draw_changed(load_arm("ur10"), plan, change, np.random.default_rng(1))
    one, other = (
        exact_observations(robot, plan, 10, 2).measured.places_m for robot in (before, after)
    )
    base = before.T_instr_base
    axis = base[:3, :3] @ before.mechanism.placements[0][:3, 2]
    origin = base[:3, :3] @ before.mechanism.placements[0][:3, 3] + base[:3, 3]
    lever = np.cross(axis, one[:, 0] - origin)
    assert other[:, 0] - one[:, 0] == pytest.approx(1e-3 * lever, abs=2e-6)
