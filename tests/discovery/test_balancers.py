"""Balancers and wrong weights at the joint that lifts, told beside sensors that err alike."""

from dataclasses import replace

import numpy as np

from made_up_poses import at_rest
from made_up_survey import ARM, Hidden, observe
from made_up_weights import G_M_S2, K_NM_RAD, holding_Nm, sagging
from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import Payload
from pa10cal.discovery.gates import gated
from pa10cal.fit.loads import statics_of
from pa10cal.fit.uncertain_weights import link_ends, with_uncertain_weights
from pa10cal.terms.effects.structure import Balancer
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model

#: A counterweight of link 2 behind its joint: mass [kg] and place in the frame of its row [m].
COUNTERWEIGHT_KG = 25.0
NEAR_M, FAR_M = (ends[1] for ends in link_ends(ARM))
BEHIND_M = NEAR_M + 0.3 * (NEAR_M - FAR_M) / np.linalg.norm(NEAR_M - FAR_M)


def test_a_counterweight_moves_the_arm_as_a_balancer_of_its_angle_alone():
    q_rad = np.random.default_rng(0).uniform(-2.0, 2.0, (40, ARM.n))
    more_Nm = holding_Nm(q_rad, [(COUNTERWEIGHT_KG, 1, BEHIND_M)])
    spring, balancer = JointSpring(2, 100.0, cubic=False), Balancer("joint 2", (5.0, -80.0))
    model = Model(Chain.of(ARM), (spring, balancer))
    payload = Payload(0.0, np.zeros(3), np.zeros(3), np.array([0.0, 0.0, -G_M_S2]))
    bare = Model(Chain.of(ARM), ())
    states = at_rest(q_rad)
    torque_Nm = statics_of(bare, np.zeros(0), states, payload).joint_Nm
    waves = -balancer.per_unit(states)
    amounts = np.linalg.lstsq(waves, more_Nm, rcond=None)[0]
    np.testing.assert_allclose(amounts[2:], 0.0, atol=1e-3)
    windup = spring.solved(K_NM_RAD, 0.0)
    with_term = model.predict(replace(states, tau_Nm=torque_Nm), np.concatenate([windup, amounts]))
    torque_Nm[:, 1] += more_Nm
    heavier = Model(Chain.of(ARM), (spring,)).predict(replace(states, tau_Nm=torque_Nm), windup)
    np.testing.assert_allclose(with_term, heavier, atol=1e-8)


def told_of_joint_2(further_rad=0.0, masses=()):
    """Return how likely each name of joint 2 is, of a UR10 on a spring there, by its id.

    Args:
        further_rad: the sensor's error, times the sine of the joint's angle.
        masses: what the description lacks; see `potential_J`.
    """

    turn = sagging(masses, lambda q_rad: further_rad * np.sin(q_rad))
    made = observe(Hidden(turn=turn), poses=160, held_out=40, springs=True)
    baseline = with_uncertain_weights(made.baseline, made.setup.payload)
    found = gated(replace(made, baseline=baseline).discovery)
    of_joint = [each for each in found.findings if each.of == "joint 2"]
    assert len(of_joint) == 1
    return {effect.id: p for effect, p in of_joint[0].explanations.named if effect.of == "joint 2"}


def test_a_counterweight_is_no_sensor_off_its_centre():
    likely = told_of_joint_2(masses=[(COUNTERWEIGHT_KG, 1, BEHIND_M)])
    assert likely["balancer"] > 0.9
    assert likely.get("encoder_eccentricity", 0.0) < 0.05


def test_a_sensor_off_its_centre_stays_likelier_than_a_balancer_of_a_small_arm():
    likely = told_of_joint_2(further_rad=5e-4)  # a quarter of a turn from gravity's phase
    assert likely["encoder_eccentricity"] > 0.5
    assert likely["balancer"] < 0.1
