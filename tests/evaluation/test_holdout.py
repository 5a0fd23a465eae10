import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from made_up_poses import measured_poses
from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import PoseStates
from pa10cal.evaluation.holdout import constant_tool_twist, held_out_errors
from pa10cal.files.arms import load_arm
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.terms.model import Model


@settings(deadline=None, max_examples=20)
@given(angle=st.floats(1e-4, 0.1), seed=st.integers(0, 100))
def test_a_constant_twist_of_the_tool_explains_all(angle, seed):
    rng = np.random.default_rng(seed)
    R = Rotation.random(12, rng=rng)
    axis = rng.normal(size=3)
    twist = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis))
    found = constant_tool_twist(R.as_matrix(), (R * twist).as_matrix())
    assert found.angle_deg == pytest.approx(np.degrees(angle), rel=1e-6)
    assert found.before_deg == pytest.approx(np.degrees(angle), rel=1e-6)
    assert found.after_deg < 1e-5
    np.testing.assert_allclose(np.radians(found.rotation_deg), twist.as_rotvec(), atol=1e-9)


def test_scattered_differences_are_not_explained_by_a_twist():
    rng = np.random.default_rng(1)
    R = Rotation.random(200, rng=rng)
    scatter = Rotation.from_rotvec(rng.normal(scale=0.01, size=(200, 3)))
    found = constant_tool_twist(R.as_matrix(), (R * scatter).as_matrix())
    assert found.after_deg > 0.95 * found.before_deg


def test_judges_by_load_and_by_point():
    arm = load_arm("pa10_6ce")
    model = FittedModel(Model(Chain.of(arm), ()), np.zeros(0), np.eye(4))
    q_rad = np.random.default_rng(2).uniform(-1.0, 1.0, (4, 6))
    T = Chain.of(arm).forward(q_rad)
    T[:, 0, 3] -= [1e-3, 2e-3, 3e-3, 6e-3]
    load = np.array([22.0, 90.0, 22.0, 90.0])
    zeros = np.zeros((4, 6))
    states = PoseStates(q_rad, zeros, zeros, load, np.zeros(4), np.zeros(4))
    labels = np.array(["H01", "H01", "H02", "H02"])
    found = held_out_errors(model, measured_poses(labels, states, T, np.zeros((4, 6, 6))))
    assert found.mean_mm == pytest.approx(3.0)
    assert found.peak_mm == pytest.approx(6.0)
    assert found.per_load["90N"].mean_mm == pytest.approx(4.0)
    assert found.per_point["H01"].mean_mm == pytest.approx(1.5)
    assert found.orientation_deg == pytest.approx(0.0, abs=1e-9)
    assert found.inside is found.outside is None
    assert found.tool_twist.angle_deg == pytest.approx(0.0, abs=1e-6)


def test_poses_beyond_what_was_learnt_are_judged_apart():
    arm = load_arm("pa10_6ce")
    model = FittedModel(Model(Chain.of(arm), ()), np.zeros(0), np.eye(4))
    q_rad = np.random.default_rng(3).uniform(-1.0, 1.0, (4, 6))
    T = Chain.of(arm).forward(q_rad)
    T[:, 2, 3] += [1e-3, 1e-3, 1e-3, 5e-3]
    zeros, zero = np.zeros((4, 6)), np.zeros(4)
    states = PoseStates(q_rad, zeros, zeros, zero, zero, zero)
    poses = measured_poses(np.array(["H1", "H2", "H3", "H4"]), states, T, np.zeros((4, 6, 6)))
    found = held_out_errors(model, poses, np.array([False, False, False, True]))
    assert found.inside.rms_mm == pytest.approx(1.0)
    assert found.outside.rms_mm == pytest.approx(5.0)
