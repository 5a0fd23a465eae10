"""Weights of a campaign stated wrongly: told by what springs do, without logged torques."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from made_up_poses import at_rest, measured_poses
from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import Payload
from pa10cal.calibration.general.as_model import fitted
from pa10cal.calibration.general.calibrate import calibrate_general, find_start
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.discovery.discover import discover
from pa10cal.discovery.preparation import MeasurementSetup
from pa10cal.discovery.verdict_records import verdict_keys
from pa10cal.files.arms import load_arm
from pa10cal.fit.loads import with_torques
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.term import yields

ARM = load_arm("ur10")
STATED = Payload(0.5, np.array([0.0, 0, 0.04]), np.zeros(3), np.array([0.0, 0.0, -9.81]))
POSES, NOISE_M, NOISE_RAD = 130, 3e-5, 3e-5
#: Springs of joints, by their windup under 100 N m [rad].
WINDUP_RAD = {2: 5e-3, 3: 7e-3}


def truth(q_rad, true, load_N):
    """Return states and poses of the arm under a payload and loads (P,)."""
    model = Model(Chain.of(ARM), tuple(JointSpring(j, 100.0, cubic=False) for j in WINDUP_RAD))
    x = np.array(list(WINDUP_RAD.values()))
    count = len(q_rad)
    known = {"time_s": 60.0 * np.arange(count), "tau_Nm": np.full((count, 6), np.nan)}
    states = at_rest(q_rad, **known, load_N=load_N)
    return states, model.predict(with_torques(model, x, states, true)[0], x)


def verdict(true, stated_N=(0.0,), load_N=None):
    """Return the verdict on a campaign with another payload, or other loads, than stated."""
    rng = np.random.default_rng(5)
    q_rad = rng.uniform(-1.8, 1.8, (POSES, 6))
    states, T = truth(q_rad, true, np.resize(load_N or stated_N, POSES))
    states = replace(states, load_N=np.resize(stated_N, POSES))
    T[:, :3, 3] += NOISE_M * rng.standard_normal((POSES, 3))
    turn = Rotation.from_rotvec(NOISE_RAD * rng.standard_normal((POSES, 3)))
    T[:, :3, :3] = T[:, :3, :3] @ turn.as_matrix()
    names, cov = (
        np.array([f"P{k:03}" for k in range(POSES)]),
        np.diag(np.repeat([NOISE_M**2, NOISE_RAD**2], 3)),
    )
    every = measured_poses(names, states, T, np.tile(cov, (POSES, 1, 1)))
    options = CalibrationOptions().with_springs(tuple(WINDUP_RAD))
    model = fitted(calibrate_general(ARM, every, find_start(ARM, every), STATED, options))
    return discover(every, model, MeasurementSetup(STATED, np.zeros((0, 3)), 20.0))


def test_right_statements_are_not_accused():
    found = verdict(STATED)
    assert (found.verdict, found.faults) == ("none", ())


def test_springs_are_those_under_the_load_that_is_carried():
    found = verdict(STATED, stated_N=(0.0, 40.0, 80.0), load_N=(0.0, 40.0, 96.0))
    (fault,) = found.faults
    assert "the load stated as 80 N seems to be 96." in fault.what
    assert verdict_keys(found).fits_weights
    q_rad = np.random.default_rng(9).uniform(-1.8, 1.8, (60, 6))
    load_N = np.resize([0.0, 60.0, 80.0, 120.0], 60)
    _, T = truth(q_rad, STATED, np.where(load_N == 80.0, 96.0, load_N))

    def error_mm(model):
        made = model.predict(q_rad, frame="tool", load_N=load_N, extrapolate=True)
        off_m = (model.T_instr_base @ made.T)[:, :3, 3] - T[:, :3, 3]
        return 1e3 * np.linalg.norm(off_m, axis=1), made.u_mm

    error, u_mm = error_mm(found.model)
    assert np.mean(error < 2.0 * u_mm) > 0.9
    assert np.sqrt(np.mean(error**2)) < 0.3 * np.sqrt(np.mean(error_mm(found.baseline)[0] ** 2))
    model = found.model
    for term in filter(yields, model.model.terms):
        columns = model.model.columns_of(term)
        stiffness = term.report(model.x[columns])
        std = np.sqrt(stiffness.covariance(model.covariance[columns, columns], 0.0)[0, 0])
        assert abs(stiffness.values[0] - 100.0 / WINDUP_RAD[term.joint]) < 3.0 * std


@pytest.mark.parametrize(
    ("change", "kind", "told"),
    [
        pytest.param(
            {"gravity_m_s2": np.array([0.0, 1.949, -9.614])},
            "gravity",
            "1.9",
            marks=pytest.mark.slow,
            id="gravity",
        ),
        pytest.param(
            {"mass_kg": 3.0, "com_m": np.array([0.0, 0.0, 0.12])},
            "payload",
            "stated as 0.5 kg",
            id="tool",
        ),
    ],
)
def test_the_statement_that_is_wrong_is_told_and_no_effect_is_named(change, kind, told):
    found = verdict(replace(STATED, **change))
    assert (found.verdict, found.effects) == ("check_the_log", ())
    (fault,) = found.faults
    assert fault.kind == kind
    assert told in fault.what + fault.remedy
