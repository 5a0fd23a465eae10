"""What predictions lose that have no torque log, where the log is not that of the weights."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_poses import at_rest, measured_poses
from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import Payload
from pa10cal.calibration.general.calibrate import calibrate_general, find_start
from pa10cal.calibration.general.case import fitted, with_discrepancy
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.files.arms import load_arm
from pa10cal.fit.loads import with_torques
from pa10cal.fit.logged_torques import is_fitted_to_log, lost_without_log_mm
from pa10cal.fit.weighed_arm import weighed_arm, weighed_model
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model

ARM, POSES, NOISE_M = load_arm("ur10"), 120, 3e-5
TOOL = Payload(1.0, np.array([0.0, 0, 0.04]), np.zeros(3), np.array([0.0, 0.0, -9.81]))
WINDUP_RAD = {2: 5e-3, 3: 7e-3}  # under 100 N m


def truth(q_rad):
    """Return states with the torques of the weights, and the poses of an arm with soft joints."""
    model = Model(Chain.of(ARM), tuple(JointSpring(j, 100.0, cubic=False) for j in WINDUP_RAD))
    x = np.array(list(WINDUP_RAD.values()))
    states, _ = with_torques(model, x, at_rest(q_rad, tau_Nm=np.full_like(q_rad, np.nan)), TOOL)
    return replace(states, static_loads=None), model.predict(states, x)


def calibrated(gain, noise_Nm):
    """Return a model fitted to a log whose joint 2 has a gain, its poses, and unseen poses."""
    rng = np.random.default_rng(5)
    states, T = truth(rng.uniform(-1.8, 1.8, (POSES, 6)))
    logged = states.tau_Nm + noise_Nm * rng.standard_normal(states.tau_Nm.shape)
    logged[:, 1] *= gain
    states = replace(states, tau_Nm=logged, time_s=60.0 * np.arange(POSES))
    T[:, :3, 3] += NOISE_M * rng.standard_normal((POSES, 3))
    cov = np.tile(np.diag(np.repeat([NOISE_M**2, 1e-10], 3)), (POSES, 1, 1))
    every = measured_poses(np.array([f"P{k:03}" for k in range(POSES)]), states, T, cov)
    arm = weighed_arm(ARM, every, lambda arm: TOOL)
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
    if gain != 1.0:
        assert lost_mm == pytest.approx(np.sqrt(np.mean(error_mm**2)), rel=0.3)


def test_nothing_is_lost_where_torques_are_those_of_the_weights():
    model, poses = calibrated(1.12, 0.05)
    known = replace(model.arm.weights_known, by_log=None)
    chain = Chain.of(replace(model.arm, weights_known=known))
    assert (
        lost_without_log_mm(replace(model, model=replace(model.model, chain=chain)), poses) == 0.0
    )
