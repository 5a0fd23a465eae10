"""Loads and tool stated wrongly, told by logged torques alone."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_poses import at_rest, measured_poses
from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import Payload, statics
from pa10cal.discovery.preparation import MeasurementSetup, complete, context_of
from pa10cal.discovery.torque_faults import stated_wrongly
from pa10cal.files.arms import load_arm
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.terms.model import Model

ARM = load_arm("pa10_6ce")
TOOL = Payload(2.4, np.array([0.0, 0, 0.19]), np.array([0, 0, 0.03]), np.array([0, 0, -9.80665]))
STATED_N = np.resize([0.0, 22.0, 40.0], 240)
NOISE_NM = 0.1


def told(load_N=STATED_N, tool=TOOL, gains=1.0, stated=TOOL, seed=3, noise_Nm=NOISE_NM):
    """Return the faults of a campaign whose joints hold other weights than it states."""
    rng = np.random.default_rng(seed)
    q_rad = rng.uniform(-1.5, 1.5, (len(STATED_N), ARM.n))
    at = Chain.of(ARM).coordinates(q_rad)
    tau_Nm = gains * statics(Chain.of(ARM), at, load_N, tool).joint_Nm
    tau_Nm += noise_Nm * rng.standard_normal(tau_Nm.shape)
    arrival, time_s = rng.choice([-1.0, 1.0], q_rad.shape), np.arange(len(q_rad)) * 1.0
    states = at_rest(q_rad, tau_Nm=tau_Nm, arrival=arrival, load_N=STATED_N, time_s=time_s)
    poses = measured_poses(
        pose=np.array([f"P{k}" for k in range(len(q_rad))]),
        states=states,
        T_instr_ee=Chain.of(ARM).forward(q_rad),
        cov=np.tile(1e-10 * np.eye(6), (len(q_rad), 1, 1)),
    )
    model = FittedModel(Model(Chain.of(ARM), ()), np.zeros(0), np.eye(4), payload=stated)
    setup = MeasurementSetup(stated, np.zeros((0, 3)), 20.0)
    poses = complete(poses, model, setup)
    return stated_wrongly(poses, model, setup, context_of(poses, model, setup))


@pytest.mark.parametrize("seed", range(4))
def test_right_weights_are_not_accused_whatever_scale_and_masses(seed):
    gains = 1.0 + 0.03 * np.random.default_rng(seed).standard_normal(ARM.n)
    assert told(gains=gains, seed=seed) == ()


def test_torques_exactly_as_calculated_accuse_nothing():
    assert told(noise_Nm=0.0) == ()


def test_one_load_of_three_is_told():
    (fault,) = told(load_N=np.where(STATED_N == 40.0, 44.0, STATED_N))
    assert (fault.kind, fault.where) == ("load", "load_N = 40")
    assert "seems to be 4" in fault.what


def test_a_tool_far_from_what_is_stated_is_told_and_one_of_unknown_mass_is_not():
    heavy = replace(TOOL, mass_kg=4.8, com_m=TOOL.com_m + np.array([0.1, 0.0, 0.0]))
    (fault,) = told(tool=heavy)
    assert fault.kind == "payload"
    assert told(tool=heavy, stated=replace(TOOL, mass_kg=0.0, known=False)) == ()
