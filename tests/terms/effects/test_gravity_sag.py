"""Sag under weights that are not known: the base parameters follow any masses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pa10cal.arm.chain import Chain
from pa10cal.arm.state import PoseStates
from pa10cal.arm.statics import Payload, statics, torque_by_mass
from pa10cal.errors import CalibrationError
from pa10cal.files.arms import load_arm
from pa10cal.terms.effects.effect import CandidateContext
from pa10cal.terms.effects.gravity_sag import GravitySag

GRAVITY_M_S2 = np.array([0.0, 0.0, -9.81])


def context(arm, gravity_m_s2=GRAVITY_M_S2):
    return CandidateContext(
        arm=arm,
        flexible_joints=(),
        reference_temperature_C=20.0,
        tau_span_Nm=np.full(arm.n, np.nan),
        T_instr_base=np.eye(4),
        p_instr_middle_m=np.zeros(3),
        q_span_rad=np.tile([-2.0, 2.0], (arm.n, 1)),
        time_span_s=(0.0, 1.0),
        gravity_m_s2=gravity_m_s2,
    )


def without_masses(name):
    return replace(load_arm(name), mass_kg=None, com_m=None)


@pytest.mark.parametrize("name", ["ur10", "iiwa14"])
def test_the_sag_of_any_masses_is_followed(name):
    known = load_arm(name)
    chain, rng = Chain.of(known), np.random.default_rng(3)
    q_rad = rng.uniform(-2.0, 2.0, (150, known.n))
    payload = Payload(2.0, np.array([0.05, -0.02, 0.1]), np.zeros(3), GRAVITY_M_S2)
    zero, nan = np.zeros(len(q_rad)), np.full(q_rad.shape, np.nan)
    coordinates = chain.coordinates(q_rad)
    torque_Nm = statics(chain, coordinates, zero, payload).torque_Nm
    by_mass = torque_by_mass(chain, coordinates, GRAVITY_M_S2)
    states = PoseStates(q_rad, nan, nan, zero, zero, zero, torque_by_mass=by_mass)
    rivals = GravitySag.everywhere(context(without_masses(name)))
    assert [rival.joint for rival in rivals] == list(range(2, known.n + 1))
    for rival in rivals:
        columns = rival.derivative(states, np.zeros(len(rival.parameters)))[:, 0]
        # A constant belongs to the joint's zero.
        free = np.column_stack([columns, np.ones(len(columns))])
        sag = torque_Nm[:, rival.joint - 1]
        left = sag - free @ np.linalg.lstsq(free, sag, rcond=None)[0]
        assert np.std(left) < 0.01 * np.std(sag)
        usual = rng.standard_normal((columns.shape[1], 400))
        assert np.sqrt(np.mean((columns @ usual) ** 2)) == pytest.approx(3e-4, rel=0.5)


def test_it_is_sought_where_masses_are_not_known_and_gravity_is():
    assert GravitySag.everywhere(context(load_arm("ur10"))) == ()
    assert GravitySag.everywhere(context(without_masses("ur10"), None)) == ()
    (first, *_) = GravitySag.everywhere(context(without_masses("ur10")))
    zero = np.zeros((1, 6))
    states = PoseStates(zero, zero, zero, zero[:, 0], zero[:, 0], zero[:, 0])
    with pytest.raises(CalibrationError, match="direction of gravity"):
        first.derivative(states, np.zeros(len(first.parameters)))
