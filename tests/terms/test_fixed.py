"""Terms whose parameters are settled do what they did, and have nothing left to find."""

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import PoseStates
from pa10cal.files.arms import load_arm
from pa10cal.terms.effects.joint import FrictionTorque
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.term import FixedTorque, fixed, shows_torque


def test_springs_give_way_to_what_joints_carry_all_the_same():
    rng = np.random.default_rng(1)
    q_rad, tau_Nm = rng.uniform(-2.0, 2.0, (2, 20, 6))
    zero = np.zeros(20)
    states = PoseStates(q_rad, 50.0 * tau_Nm, np.sign(tau_Nm), zero, zero, zero)
    chain = Chain.of(load_arm("ur10"))
    spring, gain = JointSpring(2, 100.0, cubic=False), FrictionTorque("joint 2", 100.0)
    x_spring, x_gain = np.full(len(spring.parameters), 1e-3), np.array([8.0])
    known = Model(chain, (fixed(spring, x_spring), fixed(gain, x_gain)))
    free = Model(chain, (spring, gain))
    x = np.concatenate([x_spring, x_gain])
    np.testing.assert_array_equal(known.predict(states, np.zeros(0)), free.predict(states, x))
    np.testing.assert_array_equal(known.torque_Nm(states, np.zeros(0)), free.torque_Nm(states, x))
    assert known.predict_with_jacobian(states, np.zeros(0)).jacobian.shape == (20, 6, 0)
    assert isinstance(fixed(gain, x_gain), FixedTorque)
    assert not shows_torque(fixed(spring, x_spring))
    assert not np.allclose(
        known.predict(states, np.zeros(0)), Model(chain, ()).predict(states, x[:0])
    )
