from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import Chain, end_pose, end_pose_with_screws
from pa10cal.files.arms import load_arm


def random_arm(seed, n, convention="standard"):
    rng = np.random.default_rng(seed)
    pa10 = load_arm("pa10_6ce")
    return replace(
        pa10,
        convention=convention,
        theta_rad=rng.uniform(-3, 3, n),
        d_m=rng.uniform(-0.6, 0.6, n),
        a_m=rng.uniform(-0.6, 0.6, n),
        alpha_rad=rng.choice([0.0, np.pi / 2, -np.pi / 2, 0.3, 1e-7], n),
        hayati=np.zeros(n, bool),
        prismatic=rng.random(n) < 0.25,
        limits_rad=np.tile([-3.0, 3.0], (n, 1)),
        gear_ratio=np.ones(n),
        torque_limit_Nm=np.ones(n),
        mass_kg=None,
        com_m=None,
    )


def pinocchio_forward(arm, q):
    """Forward kinematics of the same rows, by joint placements."""
    model = pin.Model()
    parent, placement = 0, pin.SE3.Identity()
    for k in range(arm.n):
        turn = pin.SE3(Rotation.from_euler("x", arm.alpha_rad[k]).as_matrix(), np.zeros(3))
        along_x = pin.SE3(np.eye(3), np.array([arm.a_m[k], 0, 0]))
        offset = pin.SE3(
            Rotation.from_euler("z", arm.theta_rad[k]).as_matrix(), np.array([0, 0, arm.d_m[k]])
        )
        joint = pin.JointModelPZ() if arm.prismatic[k] else pin.JointModelRZ()
        if arm.convention == "modified":
            parent = model.addJoint(parent, joint, placement * turn * along_x * offset, f"j{k}")
            placement = pin.SE3.Identity()
        else:
            parent = model.addJoint(parent, joint, placement, f"j{k}")
            placement = offset * along_x * turn
    data = model.createData()
    poses = []
    for row in q:
        pin.forwardKinematics(model, data, row)
        poses.append((data.oMi[parent] * placement).homogeneous)
    return np.array(poses)


def test_pa10_stands_straight_up_at_zero():
    # contract: flange at (0, 0, 1.317) m, axes along the base's
    T = Chain.of(load_arm("pa10_6ce")).forward(np.zeros((1, 6)))[0]
    np.testing.assert_allclose(T[:3, 3], [0, 0, 1.317], atol=1e-15)
    np.testing.assert_allclose(T[:3, :3], np.eye(3), atol=1e-15)


@pytest.mark.parametrize("convention", ["standard", "modified"])
@pytest.mark.parametrize("n", [1, 4, 6, 7])
def test_forward_kinematics_equals_pinocchio(n, convention):
    for seed in range(10):
        arm = random_arm(seed, n, convention)
        q = np.random.default_rng(seed).uniform(-3, 3, (5, n))
        np.testing.assert_allclose(Chain.of(arm).forward(q), pinocchio_forward(arm, q), atol=1e-12)


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 10_000), convention=st.sampled_from(["standard", "modified"]))
def test_screws_equal_finite_differences(seed, convention):
    rng = np.random.default_rng(seed)
    chain = Chain.of(random_arm(seed, 6, convention))
    coordinates = chain.coordinates(rng.uniform(-3, 3, (2, 6)))
    coordinates += rng.normal(scale=0.3, size=coordinates.shape)  # base and tool off zero too
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


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 10_000))
def test_poses_are_rigid_motions(seed):
    q = np.random.default_rng(seed).uniform(-3, 3, (3, 6))
    T = Chain.of(random_arm(seed, 6)).forward(q)
    R = T[:, :3, :3]
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (3, 1, 1)), atol=1e-13)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-13)


def test_base_and_tool_coordinates_place_base_and_tool():
    chain = Chain.of(load_arm("pa10_6ce"))
    q = np.random.default_rng(1).uniform(-1, 1, (1, 6))
    coordinates = chain.coordinates(q)
    coordinates[:, chain.columns(("base.x", "tool.z"))] = [0.5, 0.2]
    expected = chain.forward(q)[0]
    expected[:3, 3] += np.array([0.5, 0, 0]) + 0.2 * expected[:3, 2]
    np.testing.assert_allclose(end_pose(chain, coordinates)[0], expected, atol=1e-15)
