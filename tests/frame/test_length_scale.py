"""The scale of measured lengths, whatever instrument and target."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import Chain
from pa10cal.files.arms import load_arm
from pa10cal.frame.rigid_fit import scale_of_distances, scale_of_points

seeds = st.integers(0, 2**32 - 1)
units = st.sampled_from([1.0, 1e-3, 0.1, 1 / 25.4, 1e3])


def measured(rng, robot, count=60):
    """Return nominal poses, places of a target somewhere in any frame [m], and distances [m]."""
    arm = load_arm(robot)
    low, high = np.clip(arm.limits_rad.T / 2, -1.5, 1.5)
    T_base_ee = Chain.of(arm).forward(rng.uniform(low, high, (count, arm.n)))
    R, p_ee_m = Rotation.random(random_state=rng).as_matrix(), rng.uniform(-0.2, 0.2, 3)
    p_base_m = T_base_ee[:, :3, :3] @ p_ee_m + T_base_ee[:, :3, 3]
    p_m = p_base_m @ R.T + rng.uniform(-2, 2, 3) + rng.normal(0, 3e-3, (count, 3))
    point_m = rng.uniform(0.7, 1.5, 3)
    d_m = np.linalg.norm(p_base_m - point_m, axis=1) + rng.normal(0, 3e-3, count)
    return T_base_ee, p_m, d_m


@settings(deadline=None, max_examples=40)
@given(seeds, units, st.sampled_from(["ur10", "pa10_6ce", "gx4_351s"]))
def test_the_scale_is_that_of_the_unit(seed, unit, robot):
    T_base_ee, p_m, d_m = measured(np.random.default_rng(seed), robot)
    assert scale_of_points(unit * p_m, T_base_ee) == pytest.approx(1 / unit, rel=0.2)
    scale = scale_of_distances(unit * d_m, T_base_ee)
    assert scale is None or scale == pytest.approx(1 / unit, rel=0.6)


def test_a_target_that_only_the_wrist_moves_does_not_tell():
    rng = np.random.default_rng(1)
    q = np.zeros((40, 6))
    q[:, 3:] = rng.uniform(-1, 1, (40, 3))
    T_base_ee = Chain.of(load_arm("pa10_6ce")).forward(q)
    p_m = T_base_ee[:, :3, :3] @ [0.0, 0.0, 0.4] + T_base_ee[:, :3, 3]
    assert scale_of_points(p_m, T_base_ee) is None


def test_what_does_not_follow_the_joints_does_not_tell():
    rng = np.random.default_rng(2)
    T_base_ee, p_m, d_m = measured(rng, "ur10")
    assert scale_of_points(rng.permutation(p_m), T_base_ee) is None
    assert scale_of_distances(rng.permutation(d_m), T_base_ee) is None
    assert scale_of_points(p_m[:7], T_base_ee[:7]) is None
    assert scale_of_distances(d_m[:7], T_base_ee[:7]) is None


def test_positions_along_one_line_do_not_tell():
    rng = np.random.default_rng(3)
    T_base_ee, p_m, _ = measured(rng, "ur10")
    along = p_m[:, :1] * [0.6, 0.0, 0.8] + rng.normal(0, 3e-3, p_m.shape)
    T_base_ee[:, :3, 3] = along
    assert scale_of_points(along, T_base_ee) is None
    assert scale_of_points(p_m, measured(np.random.default_rng(3), "ur10")[0]) is not None
