"""Logs of torques that are not those of the weights: what predictions lose, and gains of joints."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_poses import at_rest, measured_poses
from pa10cal.arm.chain import Chain
from pa10cal.arm.description import weights_known
from pa10cal.arm.statics import Payload
from pa10cal.calibration.general.as_model import fitted, with_discrepancy
from pa10cal.calibration.general.calibrate import calibrate_general, find_start
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.files.arms import load_arm
from pa10cal.fit.loads import with_torques
from pa10cal.fit.logged_torques import (
    is_fitted_to_log,
    lost_without_log_mm,
    without_torque_errors,
)
from pa10cal.fit.weighed_arm import weighed_arm, weighed_model
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.term import yields

ARM, POSES, NOISE_M = load_arm("ur10"), 120, 3e-5
TOOL = Payload(1.0, np.array([0.0, 0, 0.04]), np.zeros(3), np.array([0.0, 0.0, -9.81]))
WINDUP_RAD = {2: 5e-3, 3: 7e-3}  # under 100 N m


def truth(q_rad, load_N=0.0):
    """Return states with the torques of the weights, and the poses of an arm with soft joints."""
    model = Model(Chain.of(ARM), tuple(JointSpring(j, 100.0, cubic=False) for j in WINDUP_RAD))
    x = np.array(list(WINDUP_RAD.values()))
    loaded = np.broadcast_to(load_N, len(q_rad)).copy()
    states = at_rest(q_rad, tau_Nm=np.full_like(q_rad, np.nan), load_N=loaded)
    states, _ = with_torques(model, x, states, TOOL)
    return replace(states, static_loads=None), model.predict(states, x)


def calibrated(gain, noise_Nm, loads_N=(0.0,), stated=1.0, repeats=1):
    """Return a model fitted to a log with gains of joints, (n,) or one of joint 2, and its poses.

    Loads come in turn; stated is what is stated of them over what they are.
    """
    rng = np.random.default_rng(5)
    pose = np.arange(POSES) // repeats
    q_rad = rng.uniform(-1.8, 1.8, (POSES, 6))[pose]
    states, T = truth(q_rad, np.resize(loads_N, POSES)[pose])
    logged = states.tau_Nm + noise_Nm * rng.standard_normal(states.tau_Nm.shape)
    logged *= gain if np.ndim(gain) else np.where(np.arange(6) == 1, gain, 1.0)
    states = replace(states, load_N=stated * states.load_N)
    states = replace(states, tau_Nm=logged, time_s=60.0 * np.arange(POSES))
    T[:, :3, 3] += NOISE_M * rng.standard_normal((POSES, 3))
    cov = np.tile(np.diag(np.repeat([NOISE_M**2, 1e-10], 3)), (POSES, 1, 1))
    every = measured_poses(np.array([f"P{k:03}" for k in pose]), states, T, cov)
    arm = weighed_arm(ARM, every, lambda arm: TOOL)
    every = without_torque_errors(every, arm)
    options = CalibrationOptions().with_springs(tuple(WINDUP_RAD))
    found = calibrate_general(arm, every, find_start(arm, every), TOOL, options)
    poses = found.problem.observations
    model = with_discrepancy(found, None, weighed_model(fitted(found), poses))
    return model, poses


@pytest.mark.parametrize(("gain", "noise_Nm"), [(1.0, 0.05), (1.0, 1.0), (1.12, 0.05)])
def test_u_mm_holds_what_is_lost_without_the_log(gain, noise_Nm):
    model, poses = calibrated(gain, noise_Nm)
    assert is_fitted_to_log(model)
    lost_mm = lost_without_log_mm(model, poses)
    assert (lost_mm > 0.0) is (gain != 1.0)
    q_rad = np.random.default_rng(7).uniform(-1.8, 1.8, (80, 6))
    _, T = truth(q_rad)
    made = model.predict(q_rad, frame="tool")
    off_m = (model.T_instr_base @ made.T)[:, :3, 3] - T[:, :3, 3]
    error_mm = 1e3 * np.linalg.norm(off_m, axis=1)
    assert np.mean(error_mm < 2.0 * made.u_mm) > 0.85
    # Noise of the log moves the poses fitted, by 0.07 mm for 1 N m, and no prediction.
    assert np.sqrt(np.mean(made.u_mm**2)) < 2.0 * np.sqrt(np.mean(error_mm**2))
    if gain != 1.0:
        assert lost_mm == pytest.approx(np.sqrt(np.mean(error_mm**2)), rel=0.3)


def test_nothing_is_lost_where_torques_are_those_of_the_weights():
    model, poses = calibrated(1.12, 0.05)
    known = replace(model.arm.weights_known, by_log=None)
    chain = Chain.of(replace(model.arm, weights_known=known))
    assert (
        lost_without_log_mm(replace(model, model=replace(model.model, chain=chain)), poses) == 0.0
    )


def gains_of(model):
    return weights_known(model.arm).by_log.gain


@pytest.mark.parametrize("gain", [1.12, 0.9])
def test_a_gain_that_stated_loads_show_is_taken_out_before_the_fit(gain):
    model, poses = calibrated(gain, 0.3, (0.0, 50.0))
    np.testing.assert_allclose(gains_of(model), [0.0, gain - 1.0, 0, 0, 0, 0], atol=0.01)
    said = weights_known(model.arm).by_log.said
    assert "times those of the loads and weights stated at joint 2" in said
    assert lost_without_log_mm(model, poses) == 0.0
    springs = [model.reported(term)[0] for term in model.model.terms if yields(term)]
    stiffness = [spring.values[0] for spring in springs]
    np.testing.assert_allclose(stiffness, [100.0 / rad for rad in WINDUP_RAD.values()], rtol=0.015)


@pytest.mark.parametrize(
    ("gain", "loads_N", "stated", "repeats"),
    [
        (1.0, (0.0, 50.0), 1.0, 1),  # nothing is wrong
        (1.0, (0.0, 50.0), 0.85, 1),  # a load is stated wrongly, by which all joints are off
        (np.full(6, 1.12), (0.0, 50.0), 1.0, 1),  # looks the same
        (1.12, (0.0,), 1.0, 1),  # no load: weights of the links may be as wrong
        (1.12, (0.0, 50.0), 1.0, 2),  # poses are repeated: a search finds it
    ],
)
def test_what_else_may_be_wrong_is_no_gain_of_a_joint(gain, loads_N, stated, repeats):
    model, _ = calibrated(gain, 0.3, loads_N, stated, repeats)
    assert not len(gains_of(model))
