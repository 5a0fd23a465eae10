import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pa10cal.arm.statics import deflection_rad, unit_deflection

stiffness = st.floats(1e2, 1e6)
torque = st.floats(-300, 300)
share = st.floats(0, 0.95)


@settings(deadline=None)
@given(tau=torque, k_lin=stiffness, k_cub=st.floats(0, 1e11))
def test_deflection_solves_equation_1(tau, k_lin, k_cub):
    delta = deflection_rad(np.array([tau]), k_lin, k_cub)[0]
    assert abs(k_lin * delta + k_cub * delta**3 - tau) <= 1e-14 * abs(tau) + 1e-300


@settings(deadline=None)
@given(t=st.floats(-4, 4), s=share)
def test_unit_deflection_solves_the_cubic(t, s):
    x = unit_deflection(np.array([t]), s).x[0]
    assert abs((1 - s) * x + s * x**3 - t) <= 4e-15 * abs(t) + 1e-300


@settings(deadline=None)
@given(s=share)
def test_at_the_reference_torque_every_spring_deflects_alike(s):
    np.testing.assert_allclose(
        unit_deflection(np.array([-1.0, 0.0, 1.0]), s).x, [-1, 0, 1], atol=1e-15
    )


@settings(deadline=None)
@given(t=st.floats(-4, 4), s=st.floats(1e-14, 1e-8))
def test_vanishing_share_is_a_linear_spring(t, s):
    linear, cubic = unit_deflection(np.array([t]), 0.0).x, unit_deflection(np.array([t]), s).x
    np.testing.assert_allclose(cubic, linear, rtol=20 * s + 1e-14, atol=1e-300)


@settings(deadline=None)
@given(tau=st.floats(0.1, 300), k_lin=stiffness, k_cub=st.floats(0, 1e10))
def test_spring_is_odd_and_monotone(tau, k_lin, k_cub):
    delta = deflection_rad(np.array([-tau, 0.0, tau, 1.01 * tau]), k_lin, k_cub)
    np.testing.assert_allclose(-delta[0], delta[2], rtol=1e-14)
    assert delta[1] == 0.0
    assert delta[3] > delta[2]


@settings(deadline=None)
@given(t=st.floats(-4, 4), s=st.floats(1e-3, 0.9))
def test_derivative_equals_finite_differences(t, s):
    step, at = 1e-5, unit_deflection(np.array([t]), s)
    ahead, back = (unit_deflection(np.array([t]), s + sign * step).x for sign in (1, -1))
    np.testing.assert_allclose((ahead - back) / (2 * step), at.by_share, rtol=1e-5, atol=1e-9)


def test_share_zero_has_the_derivative_of_its_neighbours():
    at = unit_deflection(np.array([0.7]), 0.0)
    np.testing.assert_allclose(at.by_share, [0.7 - 0.7**3], rtol=1e-14)
    assert at.x[0] == 0.7
