"""Closed forms of inverse kinematics, held against the chain's forward kinematics."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from drawn_examples import examples
from pa10cal.arm.branches import branches_of
from pa10cal.arm.chain import Chain
from pa10cal.files.arms import load_arm

WITH_BRANCHES = ["pa10_6ce", "irb120", "ur10"]


def apart(q, other):
    """Largest difference of any joint, whole turns aside."""
    return np.abs(np.remainder(q - other + np.pi, 2 * np.pi) - np.pi).max(axis=-1)


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("name", WITH_BRANCHES)
@examples(15)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_posture_itself_is_among_the_branches_and_all_that_are_in_reach_are_right(name, seed):
    arm = load_arm(name)
    chain, q = Chain.of(arm), np.random.default_rng(seed).uniform(-np.pi, np.pi, (20, 6))
    T = chain.forward(q)
    found = branches_of(arm)(T)
    assert found.shape == (20, 8, 6)
    off = np.abs(chain.forward(found.reshape(-1, 6)).reshape(20, 8, 4, 4) - T[:, None])
    off = off.max(axis=(2, 3))
    solved = off < 1e-8
    near = apart(found, q[:, None]).min(axis=1)
    clear = np.abs(np.linalg.det(chain.forward_with_screws(q).screws[:, :, chain.joint_columns]))
    regular = clear > 1e-2
    assume(regular.sum() > 5)
    assert (near[regular] < 1e-6).all()
    # In a singularity joints may be anywhere along a line: there the pose alone is reached.
    assert (off.min(axis=1) < 0.02).all()
    # Another branch of the same pose may be near a singularity, or out of reach (UR10).
    assert solved[regular].mean() > (0.6 if name == "ur10" else 0.95)


@pytest.mark.parametrize("name", WITH_BRANCHES)
def test_branches_of_a_pose_differ(name):
    arm = load_arm(name)
    q = np.array([[0.3, 0.5, 1.2, 0.4, 0.9, -0.6]])
    found = branches_of(arm)(Chain.of(arm).forward(q))[0]
    apart_by = [apart(a, b) for k, a in enumerate(found) for b in found[:k]]
    assert min(apart_by) > 0.01


def test_base_tool_and_offsets_of_joints_count():
    arm = load_arm("irb120")
    turned = np.array([[0.0, -1, 0, 0.4], [1, 0, 0, -0.2], [0, 0, 1, 0.7], [0, 0, 0, 1]])
    arm = replace(arm, T_base_row1=turned, T_row_n_ee=turned, theta_rad=arm.theta_rad + 0.2)
    q = np.array([[0.3, 0.5, 0.2, 0.4, 0.9, -0.6]])
    found = branches_of(arm)(Chain.of(arm).forward(q))[0]
    assert apart(found, q).min() < 1e-9


@pytest.mark.parametrize("name", ["iiwa14", "gx4_351s"])
def test_other_arms_have_none(name):
    assert branches_of(load_arm(name)) is None


def test_axes_that_do_not_meet_have_none():
    arm = load_arm("irb120")
    a_m = arm.a_m.copy()
    a_m[4] = 0.05
    assert branches_of(replace(arm, a_m=a_m)) is None
    alpha = load_arm("ur10").alpha_rad.copy()
    alpha[1] = 0.3
    assert branches_of(replace(load_arm("ur10"), alpha_rad=alpha)) is None


@pytest.mark.parametrize("name", WITH_BRANCHES)
def test_no_pose_has_no_branches(name):
    assert branches_of(load_arm(name))(np.zeros((0, 4, 4))).shape == (0, 8, 6)


def test_a_first_axis_parallel_to_the_second_has_none():
    arm = load_arm("irb120")
    alpha = arm.alpha_rad.copy()
    alpha[0] = 0.0
    assert branches_of(replace(arm, alpha_rad=alpha)) is None


def test_a_fifth_axis_parallel_to_those_before_it_has_none():
    arm = load_arm("ur10")
    alpha = arm.alpha_rad.copy()
    alpha[3] = 0.0
    assert branches_of(replace(arm, alpha_rad=alpha)) is None


@pytest.mark.parametrize(("name", "row"), [("irb120", 1), ("ur10", 1), ("ur10", 2)])
def test_a_joint_that_moves_nothing_by_itself_has_none(name, row):
    """Of two axes in one the arm has no branches, but lines of postures."""
    arm = load_arm(name)
    a_m = arm.a_m.copy()
    a_m[row] = 0.0
    assert branches_of(replace(arm, a_m=a_m)) is None


def test_a_wrist_on_the_third_axis_has_none():
    arm = load_arm("irb120")
    a_m, d_m = arm.a_m.copy(), arm.d_m.copy()
    a_m[2] = d_m[3] = 0.0
    assert branches_of(replace(arm, a_m=a_m, d_m=d_m)) is None


def test_rows_of_branches_that_do_not_exist_miss_the_pose():
    """As the description says of an arm with three parallel axes."""
    arm = load_arm("ur10")
    chain, q = Chain.of(arm), np.random.default_rng(2).uniform(-np.pi, np.pi, (300, 6))
    T = chain.forward(q)
    found = branches_of(arm)(T)
    off_m = np.linalg.norm(
        chain.forward(found.reshape(-1, 6)).reshape(-1, 8, 4, 4)[:, :, :3, 3] - T[:, None, :3, 3],
        axis=2,
    )
    missed = off_m > 1e-3
    assert 0.1 < missed.any(axis=1).mean() < 0.3
    assert 0.1 < off_m.max() < 0.4
