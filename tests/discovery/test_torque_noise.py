"""The noise of a log of torques, where nothing is repeated."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import pa10cal
from pa10cal.calibration.campaign import calibrated_record
from pa10cal.calibration.load_case import LoadCase
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.discovery import verdict_records
from pa10cal.discovery.near_poses import noise_of_near_poses
from pa10cal.discovery.noise import Noise, with_torque_noise
from pa10cal.discovery.preparation import complete, prepared, setup_of
from pa10cal.fit.joint_noise import share_that_is_noise
from pa10cal.options import DiscoveryOptions
from pa10cal_lab.cell.campaign import measure_campaign, robot_of
from pa10cal_lab.cell.options import SimulateOptions, TrackerOptions
from pa10cal_lab.simulated import as_read

FRACTION = 0.003


@pytest.mark.slow
def test_it_is_what_scatters_about_the_weights_and_moves_through_springs():
    arm = pa10cal.load_arm("ur10")
    plan = TrackerOptions(
        instrument="pose",
        poses=150,
        flexible_joints=(2, 3, 4),
        hardening=False,
        logs_torques=True,
        torque_fraction=FRACTION,
    )
    settings = SimulateOptions(random_seed=2, robot="ur10", without_touches=plan)
    read = as_read(measure_campaign("logged", settings, robot_of(arm, settings)))
    model = pa10cal.calibrate(read)
    setup = setup_of(read.description, read.arm, CalibrationOptions(), DiscoveryOptions())
    ready = prepared(read.observations, model, setup)
    poses = complete(ready.readings, ready.baseline, setup)
    residual = ready.baseline.compared(poses).residual
    stated = noise_of_near_poses(poses, residual)
    found = with_torque_noise(stated, residual, ready.baseline, poses, setup.payload)
    np.testing.assert_allclose(found.torque_Nm, FRACTION * arm.torque_limit_Nm, rtol=0.25)
    added = np.linalg.eigvalsh(found.cov - stated.cov)
    assert added.min() > -1e-15
    # 1 N m at joint 2 turns it by some 3e-5 rad, which moves the end by up to some 40 um.
    assert 0.01 < 1e3 * np.sqrt(added.max()) < 0.1
    assert found.torque_share == 1.0
    assert with_torque_noise(stated, residual, ready.baseline, poses, None) is stated


@pytest.mark.parametrize("forces", [True, False])
def test_forces_that_nobody_stated_are_told_with_the_model(forces):
    model = SimpleNamespace(T_end_shown=np.eye(4), targets_off_m=np.zeros(0))
    found = SimpleNamespace(scorer=SimpleNamespace(unstated_forces=forces), model=model)
    told = "".join(verdict_records._not_predicted(found))
    assert ("forces act that nobody stated" in told) is forces


def test_loads_that_only_the_log_shows_are_no_noise_of_a_grade():
    plan = TrackerOptions(
        instrument="points",
        poses=90,
        loads_N=(0.0, 80.0),
        flexible_joints=(2, 3, 4),
        hardening=False,
        logs_torques=True,
        torque_fraction=1e-4,
    )
    settings = SimulateOptions(random_seed=2, robot="ur10", without_touches=plan)
    read = as_read(
        measure_campaign("loaded", settings, robot_of(pa10cal.load_arm("ur10"), settings))
    )
    states = read.observations.states
    unstated = replace(states, load_N=np.zeros(len(states)))
    case = LoadCase(read.description, read.arm, read.observations.with_states(unstated))
    health = calibrated_record(case).health
    assert health.train_rms_mm < 0.2
    assert health.noise_mm < 1.5 * health.train_rms_mm  # 0.9 mm, were the loads noise


@pytest.mark.parametrize("share", [1.0, 1e-4, 0.0])
def test_what_residuals_do_not_show_of_the_scatter_is_no_noise(share):
    """Forces that only the log shows: it scatters by them, and the arm moves by them."""
    rng = np.random.default_rng(4)
    cov = np.tile(np.diag([1.0, 2.0, 1.0]) * 1e-9, (300, 1, 1))
    directions = rng.normal(size=(300, 3, 2)) * 2e-3
    by_torques = directions @ directions.swapaxes(1, 2)
    root = np.linalg.cholesky(cov + share * by_torques)
    residual = np.einsum("pij,pj->pi", root, rng.normal(size=(300, 3)))
    measured = SimpleNamespace(
        position_columns=np.arange(3), components_seen=rng.random((300, 3)) < 0.9
    )
    found = share_that_is_noise(residual, measured, cov, by_torques)
    assert found == pytest.approx(share, rel=0.3, abs=1e-5)


def test_noise_says_what_it_is_of():
    stated = Noise(np.zeros((1, 3, 3)), 0)
    assert stated.origin.startswith("the instrument's stated uncertainty: ")
    logged = replace(stated, torque_Nm=np.array([0.0, 2.0]))
    assert "stated uncertainty and the scatter of logged torques: " in logged.origin
