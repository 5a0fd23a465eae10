from dataclasses import replace

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.terms.model import Model


def test_a_creeping_base_carries_the_arm_along(at, arm, states):
    rate = np.array([1e-5, -2e-5, 3e-5])
    model = Model(Chain.of(arm), (at("base_drift", "base"),))
    hourly = replace(states, time_s=100.0 + 3600.0 * np.arange(len(states)))
    moved = model.predict(hourly, rate) - Chain.of(arm).forward(states.q_rad)
    np.testing.assert_allclose(moved[:, :3, 3], np.outer(np.arange(len(states)), rate), atol=1e-15)
    np.testing.assert_allclose(moved[:, :3, :3], 0.0, atol=1e-15)


def test_a_warm_arm_is_one_with_a_longer_pedestal_and_longer_links(at, arm, states):
    warm = replace(states, temperature_C=np.full(len(states), 31.0))
    grown = 1.0 + 10.0 * 2e-5 * np.array([1, 1, 0, 1, 0, 0])  # rows of pedestal, upper arm, forearm
    longer = replace(arm, d_m=arm.d_m * grown, a_m=arm.a_m * grown)
    model = Model(Chain.of(arm), (at("thermal_growth", "arm"),))
    np.testing.assert_allclose(
        model.predict(warm, np.array([2e-5])), Chain.of(longer).forward(states.q_rad), atol=1e-15
    )
