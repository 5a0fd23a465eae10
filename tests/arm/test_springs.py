import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pa10cal.arm.springs import deflect

stiffness = st.floats(1e2, 1e6)
torque = st.floats(-300, 300)


@settings(deadline=None)
@given(tau=torque, k_lin=stiffness, k_cub=st.floats(0, 1e11))
def test_deflection_solves_equation_1(tau, k_lin, k_cub):
    delta = deflect(np.array([tau]), 1 / k_lin, k_cub / k_lin).delta_rad[0]
    assert abs(k_lin * delta + k_cub * delta**3 - tau) <= 1e-14 * abs(tau) + 1e-300


@settings(deadline=None)
@given(tau=torque, k_lin=stiffness, h=st.floats(1e-12, 1e-3))
def test_vanishing_hardening_is_a_linear_spring(tau, k_lin, h):
    linear = deflect(np.array([tau]), 1 / k_lin, 0.0).delta_rad
    cubic = deflect(np.array([tau]), 1 / k_lin, h).delta_rad
    np.testing.assert_allclose(cubic, linear, rtol=2 * h * (tau / k_lin) ** 2 + 1e-14)


@settings(deadline=None)
@given(tau=st.floats(0.1, 300), k_lin=stiffness, h=st.floats(0, 1e6))
def test_spring_is_odd_and_monotone(tau, k_lin, h):
    delta = deflect(np.array([-tau, 0.0, tau, 1.01 * tau]), 1 / k_lin, h).delta_rad
    np.testing.assert_allclose(-delta[0], delta[2], rtol=1e-14)
    assert delta[1] == 0.0
    assert delta[3] > delta[2]


@settings(deadline=None)
@given(
    tau=torque, k_lin=st.floats(1e3, 1e5), h=st.floats(-3e3, 1e5).filter(lambda h: abs(h) > 0.01)
)
def test_derivatives_equal_finite_differences(tau, k_lin, h):
    tau_Nm, c = np.array([tau]), 1 / k_lin
    at = deflect(tau_Nm, c, h)
    for derivative, dc, dh in ((at.by_compliance, 1e-4 * c, 0.0), (at.by_hardening, 0.0, 1e-3)):
        step = dc or dh
        ahead = deflect(tau_Nm, c + dc, h + dh).delta_rad
        back = deflect(tau_Nm, c - dc, h - dh).delta_rad
        np.testing.assert_allclose(
            (ahead - back) / (2 * step),
            derivative,
            rtol=1e-6,
            atol=1e-9 * abs(at.delta_rad[0]) + 1e-300,
        )


def test_rigid_joint_does_not_deflect():
    assert deflect(np.array([100.0]), 0.0, 0.0).delta_rad[0] == 0.0
