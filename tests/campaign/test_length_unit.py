"""The unit of lengths, whatever instrument and target."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import Chain
from pa10cal.campaign.length_unit import (
    refuse_wrong_length_unit,
    scale_of_distances,
    scale_of_points,
)
from pa10cal.errors import RawDataError
from pa10cal.files.arms import load_arm

seeds = st.integers(0, 2**32 - 1)
units = st.sampled_from([1.0, 1e-3, 0.1, 1 / 25.4, 1e3])


def measured(rng, robot, count=60):
    """Return nominal poses, places of a target somewhere in any frame [mm], and distances [mm]."""
    arm = load_arm(robot)
    low, high = np.clip(arm.limits_rad.T / 2, -1.5, 1.5)
    T_base_ee = Chain.of(arm).forward(rng.uniform(low, high, (count, arm.n)))
    R, p_ee_m = Rotation.random(random_state=rng).as_matrix(), rng.uniform(-0.2, 0.2, 3)
    p_base_m = T_base_ee[:, :3, :3] @ p_ee_m + T_base_ee[:, :3, 3]
    p_mm = 1e3 * (p_base_m @ R.T + rng.uniform(-2, 2, 3)) + rng.normal(0, 3.0, (count, 3))
    point_m = rng.uniform(0.7, 1.5, 3)
    d_mm = 1e3 * np.linalg.norm(p_base_m - point_m, axis=1) + rng.normal(0, 3.0, count)
    return T_base_ee, p_mm, d_mm


@settings(deadline=None, max_examples=40)
@given(seeds, units, st.sampled_from(["ur10", "pa10_6ce", "gx4_351s"]))
def test_the_scale_is_that_of_the_unit(seed, unit, robot):
    T_base_ee, p_mm, d_mm = measured(np.random.default_rng(seed), robot)
    assert scale_of_points(unit * p_mm, T_base_ee) == pytest.approx(1 / unit, rel=0.2)
    scale = scale_of_distances(unit * d_mm, T_base_ee)
    assert scale is None or scale == pytest.approx(1 / unit, rel=0.6)


def test_a_target_that_only_the_wrist_moves_does_not_tell():
    rng = np.random.default_rng(1)
    q = np.zeros((40, 6))
    q[:, 3:] = rng.uniform(-1, 1, (40, 3))
    T_base_ee = Chain.of(load_arm("pa10_6ce")).forward(q)
    p_mm = 1e3 * (T_base_ee[:, :3, :3] @ [0.0, 0.0, 0.4] + T_base_ee[:, :3, 3])
    assert scale_of_points(p_mm, T_base_ee) is None


def test_what_does_not_follow_the_joints_does_not_tell():
    rng = np.random.default_rng(2)
    T_base_ee, p_mm, d_mm = measured(rng, "ur10")
    assert scale_of_points(rng.permutation(p_mm), T_base_ee) is None
    assert scale_of_distances(rng.permutation(d_mm), T_base_ee) is None
    assert scale_of_points(p_mm[:7], T_base_ee[:7]) is None
    assert scale_of_distances(d_mm[:7], T_base_ee[:7]) is None


@pytest.mark.parametrize("scale", [None, 0.3, 1.0, 4.0])
def test_a_scale_near_one_passes(scale):
    refuse_wrong_length_unit(scale, "positions", "poses.csv: x_mm")


@pytest.mark.parametrize(
    ("scale", "message"),
    [
        (1020.0, r"poses.csv: d_mm: the distances look like metres .*one measured millimetre is"),
        (24.0, "look like inches"),
        (9.5, "look like centimetres"),
        (1.1e-3, "look like micrometres"),
        (100.0, "do not fit the joint motion.*check the unit"),
    ],
)
def test_another_unit_is_named(scale, message):
    with pytest.raises(RawDataError, match=message):
        refuse_wrong_length_unit(scale, "distances", "poses.csv: d_mm")


def test_positions_along_one_line_do_not_tell():
    rng = np.random.default_rng(3)
    T_base_ee, p_mm, _ = measured(rng, "ur10")
    along = p_mm[:, :1] * [0.6, 0.0, 0.8] + rng.normal(0, 3.0, p_mm.shape)
    T_base_ee[:, :3, 3] = 1e-3 * along
    assert scale_of_points(along, T_base_ee) is None
    assert scale_of_points(p_mm, measured(np.random.default_rng(3), "ur10")[0]) is not None
