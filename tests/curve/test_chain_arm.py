"""The chain as an arm of this project."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from made_up_curves import gentle_spline
from pa10cal.arm.chain import Chain, frames
from pa10cal.arm.description import neighbouring_axes
from pa10cal.arrays import homogeneous
from pa10cal.curve.angles import arm_posture, chain_arm
from pa10cal.curve.points import lay_points
from pa10cal.errors import ArmError, CurveError

LINKS, LINK_M = 6, 0.15


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_the_arms_forward_kinematics_returns_the_points(seed):
    random = np.random.default_rng(seed)
    points = lay_points(gentle_spline(random), LINK_M, LINKS)
    T_base = homogeneous(Rotation.random(rng=random).as_matrix(), points.p_m[0])
    q_rad = arm_posture(points.p_m, T_base, LINK_M)
    chain = Chain.of(chain_arm("chain_6", LINKS, LINK_M, np.pi))
    along = frames(chain, chain.coordinates(q_rad[None]))
    laid = T_base @ along.T_base_rows[1::2, 0]
    np.testing.assert_allclose(laid[:, :3, 3], points.p_m[1:], atol=1e-12)
    np.testing.assert_allclose(laid[:, :3, 0], points.directions, atol=1e-12)


def test_a_thousand_links_are_an_arm_too():
    points = lay_points(gentle_spline(np.random.default_rng(1)), 1e-3)
    T_base = np.eye(4)
    T_base[:3, 3] = points.p_m[0]
    q_rad = arm_posture(points.p_m, T_base, 1e-3)
    chain = Chain.of(chain_arm("long", points.n, 1e-3, np.pi))
    end_m = chain.forward(q_rad[None])[0, :3, 3] + points.p_m[0]
    assert np.linalg.norm(end_m - points.p_m[-1]) <= 1e-11 * points.n * 1e-3


def test_straight_at_zero_and_without_parallel_neighbours():
    arm = chain_arm("chain_6", LINKS, LINK_M, 1.5)
    assert arm.n == 2 * LINKS
    T_straight = np.eye(4)
    T_straight[0, 3] = LINKS * LINK_M
    found = Chain.of(arm).forward(np.zeros((1, 12)))[0]
    np.testing.assert_allclose(found, T_straight, atol=1e-15)
    assert not any(axes.parallel for axes in neighbouring_axes(arm))
    assert (arm.limits_rad == [-1.5, 1.5]).all()


def test_points_that_are_no_shape_of_it_are_refused():
    points = lay_points(gentle_spline(np.random.default_rng(1)), LINK_M, LINKS)
    T_base = np.eye(4)
    T_base[:3, 3] = points.p_m[0]
    with pytest.raises(CurveError, match=r"points do not fit the arm \(got '0.05 m off'\)"):
        arm_posture(points.p_m, T_base, 0.2)
    with pytest.raises(CurveError, match="points do not fit the arm"):
        arm_posture(points.p_m + 1e-3, T_base, LINK_M)


def test_an_arm_needs_a_link_of_an_arms_length():
    with pytest.raises(CurveError, match="links: there is no link"):
        chain_arm("none", 0, LINK_M, 1.5)
    with pytest.raises(ArmError, match="longer than 10 m"):
        chain_arm("long", 2, 11.0, 1.5)
