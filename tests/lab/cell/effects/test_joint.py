"""Effects of joints, each against its form written out."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drawn_examples import examples
from pa10cal.errors import SimulationError
from pa10cal_lab.cell.effects import joint
from pa10cal_lab.cell.effects.effect import JointState

RNG = np.random.default_rng(3)
Q = RNG.uniform(-3.0, 3.0, (40, 6))
S = RNG.choice([-1.0, 0.0, 1.0], (40, 6))
GEARS = np.array([50.0, 50.0, 100.0, 50.0, 50.0, 50.0])
MOTION = JointState(Q, S, GEARS)
A, PHI = 3e-4, 0.7

FORMS = [
    (joint.SimulatedTransmissionError(A=A, phi=PHI), 2, lambda q, s: A * np.sin(200 * q + PHI)),
    (joint.SimulatedTransmissionError(A=A, phi=PHI), 1, lambda q, s: A * np.sin(100 * q + PHI)),
    (joint.SimulatedEncoderEccentricity(A=A, phi=PHI), 0, lambda q, s: A * np.sin(q + PHI)),
    (joint.SimulatedEncoderEllipticity(A=A, phi=PHI), 4, lambda q, s: A * np.sin(2 * q + PHI)),
    (joint.SimulatedGearRatioError(eps=1e-4), 3, lambda q, s: 1e-4 * q),
    (joint.SimulatedBacklash(b=1e-4), 1, lambda q, s: -1e-4 * s),
]


@pytest.mark.parametrize(("effect", "j", "form"), FORMS, ids=lambda part: getattr(part, "id", ""))
def test_turns_its_own_joint_by_its_form(effect, j, form):
    turn = effect.at(f"joint {j + 1}").added(MOTION)
    assert turn[:, j] == pytest.approx(form(Q[:, j], S[:, j]), abs=1e-17)
    assert np.abs(np.delete(turn, j, axis=1)).max() == 0.0


@examples(30)
@given(q=st.floats(-3.0, 3.0), turns=st.integers(-3, 3))
def test_transmission_error_repeats_twice_a_turn_of_the_wave_generator(q, turns):
    effect = joint.SimulatedTransmissionError(A=A, phi=PHI).at("joint 1")
    later = q + turns * np.pi / GEARS[0]
    both = JointState(np.array([[q] * 6, [later] * 6]), S[:2], GEARS)
    assert effect.added(both)[0, 0] == pytest.approx(effect.added(both)[1, 0], abs=1e-12)


def test_a_transmission_error_needs_the_gear_ratio():
    motion = JointState(Q, S, np.where(np.arange(6) == 1, np.nan, GEARS))
    effect = joint.SimulatedTransmissionError(A=A, phi=PHI)
    assert np.isfinite(effect.at("joint 1").added(motion)).all()
    with pytest.raises(SimulationError, match=r"transmission_error of joint 2: the gear ratio"):
        effect.at("joint 2").added(motion)


def test_wrist_coupling_turns_the_last_joint_with_the_one_before():
    turn = joint.SimulatedWristCoupling(c=2e-4).at("wrist").added(MOTION)
    assert turn[:, 5] == pytest.approx(2e-4 * Q[:, 4], abs=1e-17)
    assert np.abs(turn[:, :5]).max() == 0.0


@examples(40)
@given(joint_=st.integers(1, 6), by=st.integers(0, 7), c=st.floats(-1e-2, 1e-2))
def test_a_coupling_moves_its_joint_with_another_and_that_alone(joint_, by, c):
    coupling = joint.SimulatedJointCoupling(c=c, by=by).at(f"joint {joint_}")
    turns = by or joint_ - 1
    if turns == joint_ or not 1 <= turns <= 6:
        with pytest.raises(SimulationError, match="no other joint turns there"):
            coupling.added(MOTION)
        return
    moved = coupling.added(MOTION)
    assert moved[:, joint_ - 1] == pytest.approx(c * Q[:, turns - 1], abs=1e-17)
    assert not np.delete(moved, joint_ - 1, axis=1).any()


def test_joint_error_map_goes_through_its_knots_and_is_smooth_across_the_turn():
    knots = tuple(1e-4 * RNG.standard_normal(9))
    effect = joint.SimulatedJointErrorMap(knots=knots).at("joint 1")

    def value(q):
        return effect.added(JointState(np.outer(q, np.ones(6)), np.zeros((len(q), 6)), GEARS))[:, 0]

    at_knots = np.arange(9) * 2 * np.pi / 9
    assert value(at_knots) == pytest.approx(knots, abs=1e-16)
    assert value(at_knots - 2 * np.pi) == pytest.approx(knots, abs=1e-16)
    h = 1e-4
    for order in (1, 2):  # of the derivative, across the turn
        after, before = (
            np.diff(value(2 * np.pi + side * h * np.arange(3)), n=order)[0] * side**order / h**order
            for side in (1, -1)
        )
        assert after == pytest.approx(before, abs=2e-2 * max(map(abs, knots)))
    assert np.ptp(value(np.linspace(0, 2 * np.pi, 200))) > np.ptp(knots) * 0.99


TAU = RNG.normal(0.0, 40.0, 6)


def under(tau_Nm):
    """One posture, all joints at 0, under these torques."""
    return JointState(np.zeros((1, 6)), np.zeros((1, 6)), GEARS, np.array([tau_Nm]))


def test_joint_compliance_yields_in_proportion():
    deflection = joint.SimulatedJointCompliance(K=2e4).at("joint 4").added(under(TAU))[0]
    assert deflection[3] == -TAU[3] / 2e4
    assert np.count_nonzero(deflection) == 1


def test_soft_windup_is_softer_near_zero_and_then_full():
    effect = joint.SimulatedSoftWindup(A=1e-4, tau0=5.0).at("joint 2")

    def at(tau):
        return -effect.added(under([1.0, tau, 1, 1, 1, 1]))[0]

    assert at(0.01)[1] == pytest.approx(1e-4 * 0.01 / 5.0, rel=1e-5)
    assert at(500.0)[1] == pytest.approx(1e-4)
    assert at(-500.0)[1] == pytest.approx(-1e-4)
    assert at(5.0)[1] == pytest.approx(1e-4 * np.tanh(1.0))
    assert np.count_nonzero(at(5.0)) == 1


def test_friction_and_gain_touch_the_log_of_their_joint_alone():
    tau = RNG.normal(0.0, 40.0, (40, 6))
    motion = JointState(Q, S, GEARS, tau)
    friction = joint.SimulatedFrictionTorque(tau_c=4.0).at("joint 2").added(motion)
    gain = joint.SimulatedTorqueGain(g=0.05).at("joint 3").added(motion)
    assert friction[:, 1] == pytest.approx(4.0 * S[:, 1])
    assert gain[:, 2] == pytest.approx(0.05 * tau[:, 2])
    assert np.abs(np.delete(friction, 1, axis=1)).max() == 0.0
    assert np.abs(np.delete(gain, 2, axis=1)).max() == 0.0
