from dataclasses import fields, replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drawn_examples import examples
from made_up_robot import pinocchio_of
from pa10cal.arm.chain import (
    BASE,
    TOOL,
    Chain,
    bend_coordinates,
    end_pose,
    end_pose_with_screws,
    frames,
    link_spans_m,
    long_links,
)
from pa10cal.arm.description import Arm
from pa10cal.arrays import homogeneous
from pa10cal.errors import ArmError
from pa10cal.files.arms import arm_names, load_arm

conventions = st.sampled_from(["standard", "modified"])


def first_rows(arm, n):
    """Return the arm cut off after n rows."""
    rows = {name: getattr(arm, name)[:n] for name in ROW_FIELDS}
    return replace(arm, **rows, T_row_n_ee=np.eye(4))


OF_THE_ARM = (
    *("name", "title", "convention", "T_base_row1", "T_row_n_ee", "weights_known"),
    *("coupled", "remarks", "controller", "base_moves"),
)
ROW_FIELDS = [field.name for field in fields(Arm) if field.name not in OF_THE_ARM]


def pinocchio_forward(arm, q):
    """Forward kinematics of the same rows, by joint placements."""
    model, T_last_ee = pinocchio_of(arm)
    data, poses = model.createData(), []
    for row in q:
        pin.forwardKinematics(model, data, row)
        poses.append((data.oMi[arm.n] * T_last_ee).homogeneous)
    return np.array(poses)


def test_pa10_stands_straight_up_at_zero():
    # contract: flange at (0, 0, 1.317) m, axes along the base's
    T = Chain.of(load_arm("pa10_6ce")).forward(np.zeros((1, 6)))[0]
    np.testing.assert_allclose(T[:3, 3], [0, 0, 1.317], atol=1e-15)
    np.testing.assert_allclose(T[:3, :3], np.eye(3), atol=1e-15)


@pytest.mark.parametrize("convention", ["standard", "modified"])
@pytest.mark.parametrize("n", [1, 4, 6, 7])
def test_forward_kinematics_equals_pinocchio(random_arm, n, convention):
    for seed in range(10):
        arm = random_arm(seed, n, convention)
        q = np.random.default_rng(seed).uniform(-3, 3, (5, n))
        np.testing.assert_allclose(Chain.of(arm).forward(q), pinocchio_forward(arm, q), atol=1e-12)


@examples(25)
@given(seed=st.integers(0, 10_000), convention=conventions)
def test_screws_equal_finite_differences(random_arm, seed, convention):
    rng = np.random.default_rng(seed)
    chain = Chain.of(random_arm(seed, 6, convention), bends=(1, 4))
    coordinates = chain.coordinates(rng.uniform(-3, 3, (2, 6)))
    coordinates += rng.normal(scale=0.3, size=coordinates.shape)  # base, bends and tool off zero
    screws = end_pose_with_screws(chain, coordinates).screws
    step = 1e-5
    for k in range(coordinates.shape[1]):
        shift = np.zeros(coordinates.shape[1])
        shift[k] = step
        ahead, back = end_pose(chain, coordinates + shift), end_pose(chain, coordinates - shift)
        velocity = (ahead[:, :3, 3] - back[:, :3, 3]) / (2 * step)
        turn = Rotation.from_matrix(ahead[:, :3, :3] @ back[:, :3, :3].transpose(0, 2, 1))
        rate = turn.as_rotvec() / (2 * step)
        np.testing.assert_allclose(screws[:, :3, k], velocity, atol=2e-9)
        np.testing.assert_allclose(screws[:, 3:, k], rate, atol=2e-9)


@examples(25)
@given(seed=st.integers(0, 10_000), convention=conventions)
def test_motions_of_base_and_tool_lie_outside_the_constant_frames(random_arm, seed, convention):
    rng = np.random.default_rng(seed)
    chain = Chain.of(random_arm(seed, 4, convention))
    coordinates = chain.coordinates(rng.uniform(-3, 3, (2, 4)))
    still = end_pose(chain, coordinates)
    outer, inner = rng.uniform(-1, 1, (2, 6))
    coordinates[:, chain.columns(BASE)], coordinates[:, chain.columns(TOOL)] = outer, inner

    def motion(values):
        return homogeneous(Rotation.from_euler("XYZ", values[3:]).as_matrix(), values[:3])

    wanted = motion(outer) @ still @ motion(inner)
    np.testing.assert_allclose(end_pose(chain, coordinates), wanted, atol=1e-14)


@pytest.mark.parametrize("name", arm_names())
def test_a_chain_walks_over_no_constant_frame_that_is_none(name):
    assert Chain.of(load_arm(name)).constants == {}


@examples(25)
@given(seed=st.integers(0, 10_000), convention=conventions)
def test_frames_of_rows_end_shorter_arms(random_arm, seed, convention):
    arm = random_arm(seed, 5, convention)
    q = np.random.default_rng(seed).uniform(-3, 3, (3, 5))
    chain = Chain.of(arm)
    found = frames(chain, chain.coordinates(q))
    for row in range(5):
        wanted = Chain.of(first_rows(arm, row + 1)).forward(q[:, : row + 1])
        np.testing.assert_allclose(found.T_base_rows[row], wanted, atol=1e-14)
    np.testing.assert_allclose(found.T_base_ee, chain.forward(q), atol=1e-15)


@examples(25)
@given(seed=st.integers(0, 10_000), convention=conventions)
def test_frames_of_joints_hold_their_screws(random_arm, seed, convention):
    rng = np.random.default_rng(seed)
    chain = Chain.of(random_arm(seed, 5, convention), bends=(2,))
    coordinates = chain.coordinates(rng.uniform(-3, 3, (3, 5)))
    coordinates += rng.normal(scale=0.3, size=coordinates.shape)
    found = frames(chain, coordinates)
    screws = end_pose_with_screws(chain, coordinates).screws
    for joint, column in enumerate(chain.joint_columns):
        T = found.T_base_joints[joint]
        axis, lever = T[:, :3, 2], found.T_base_ee[:, :3, 3] - T[:, :3, 3]
        wanted = np.hstack([np.cross(axis, lever), axis])
        if chain.arm.prismatic[joint]:
            wanted = np.hstack([axis, np.zeros_like(axis)])
        np.testing.assert_allclose(screws[:, :, column], wanted, atol=1e-13)


@examples(25)
@given(seed=st.integers(0, 10_000), row=st.integers(1, 4), convention=conventions)
def test_a_bend_moves_the_frame_in_which_the_next_joint_moves(random_arm, seed, row, convention):
    rng = np.random.default_rng(seed)
    arm = random_arm(seed, 5, convention)
    q, bend = rng.uniform(-3, 3, (2, 5)), rng.normal(scale=0.3, size=6)
    plain, bent = Chain.of(arm), Chain.of(arm, bends=(row,))
    np.testing.assert_array_equal(bent.forward(q), plain.forward(q))
    coordinates = bent.coordinates(q)
    coordinates[:, bent.columns(bend_coordinates(row))] = bend
    straight, found = frames(plain, plain.coordinates(q)), frames(bent, coordinates)
    motion = homogeneous(Rotation.from_euler("XYZ", bend[3:]).as_matrix(), bend[:3])
    inverse = np.linalg.inv(straight.T_base_joints[row])
    for wanted, moved in [
        (straight.T_base_joints, found.T_base_joints),
        (straight.T_base_rows, found.T_base_rows),
    ]:
        np.testing.assert_allclose(moved[:row], wanted[:row], atol=1e-15)
        turned = straight.T_base_joints[row] @ motion @ inverse @ wanted[row:]
        np.testing.assert_allclose(moved[row:], turned, atol=1e-13)


@pytest.mark.parametrize("row", [0, 6])
def test_a_link_that_no_joint_follows_does_not_bend(row):
    with pytest.raises(ArmError, match="rows 1 to 5"):
        Chain.of(load_arm("pa10_6ce"), bends=(row,))


@pytest.mark.parametrize("robot", ["gx4_351s", "irb120", "iiwa14", "pa10_6ce", "ur10"])
def test_arms_beyond_the_usual_sizes_are_larger_in_proportion(robot):
    arm = load_arm(robot)
    assert arm.size_ratio == 1.0
    sizes = [replace(arm, a_m=k * arm.a_m, d_m=k * arm.d_m).size_ratio for k in (50.0, 100.0)]
    assert sizes[0] > 1.0
    assert sizes[1] == pytest.approx(2.0 * sizes[0], rel=0.02)  # flanges and strokes stay


@examples(25)
@given(seed=st.integers(0, 10_000), convention=conventions)
def test_no_place_is_beyond_the_reach(random_arm, seed, convention):
    arm = random_arm(seed, 5, convention)
    low, high = arm.limits_rad.T
    q = np.random.default_rng(seed).uniform(low, high, (200, 5))
    p_base_ee = Chain.of(arm).forward(q)[:, :3, 3]
    assert np.linalg.norm(p_base_ee, axis=1).max() <= arm.reach_m


def test_upper_arm_and_forearm_are_the_long_links():
    arm = load_arm("pa10_6ce")
    assert long_links(arm) == (2, 4)
    assert np.linalg.norm(link_spans_m(arm), axis=1) == pytest.approx(
        [0.317, 0.45, 0, 0.48, 0, 0.07]
    )
    # 450 mm along x of the row's own frame, 480 mm along -y: alpha turns z there.
    assert link_spans_m(arm)[1] == pytest.approx([0.45, 0, 0])
    assert link_spans_m(arm)[3] == pytest.approx([0, -0.48, 0])


def test_a_short_arm_has_fewer_long_links():
    arm = load_arm("pa10_6ce")
    assert long_links(first_rows(arm, 2)) == ()
    assert long_links(first_rows(arm, 3)) == (2,)
    assert long_links(first_rows(arm, 4)) == (2,)  # link 3 has no length
