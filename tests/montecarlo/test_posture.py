"""Postures: at their place, pointing down, inside the limits, and all of one kind."""

import numpy as np
import pytest

from pa10cal.arm.chain import Chain
from pa10cal.errors import SettingsError
from pa10cal.montecarlo.places import follow, reference_in_plane


@pytest.fixture(scope="module")
def reference(pa10_chain):
    return reference_in_plane(pa10_chain, 0.5, (0.7, 0.7))


def spread(count, near=0.5, far=0.9):
    source = np.random.default_rng(2)
    radius = source.uniform(near, far, count)
    return radius, source.uniform(-np.pi, np.pi, count)


def assert_at(chain, q_rad, reached, radius, azimuth, height_m):
    T_base_ee = chain.forward(q_rad[reached])
    place = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth)], axis=1)[reached]
    np.testing.assert_allclose(T_base_ee[:, :2, 3], place, atol=1e-9)
    np.testing.assert_allclose(T_base_ee[:, 2, 3], height_m, atol=1e-9)
    np.testing.assert_allclose(
        T_base_ee[:, :3, 2], np.tile([0, 0, -1.0], (len(place), 1)), atol=1e-9
    )
    low, high = chain.arm.limits_rad.T
    assert ((q_rad[reached] >= low) & (q_rad[reached] <= high)).all()


def test_reached_means_there_and_pointing_down(pa10_chain, reference):
    radius, azimuth = spread(200)
    q_rad, reached = follow(pa10_chain, reference, radius, azimuth)
    assert reached.mean() > 0.95
    assert_at(pa10_chain, q_rad, reached, radius, azimuth, 0.5)


def test_posture_of_the_pa10_stays_in_the_vertical_plane_elbow_up(pa10_chain, reference):
    radius, azimuth = spread(100)
    q_rad, reached = follow(pa10_chain, reference, radius, azimuth)
    q_rad = q_rad[reached]
    np.testing.assert_allclose(q_rad[:, 0], azimuth[reached], atol=1e-9)
    np.testing.assert_allclose(q_rad[:, [3, 5]], 0, atol=1e-9)
    assert (q_rad[:, 2] > 0).all()


def test_out_of_reach_of_links_or_of_joint_1_is_told(pa10_chain, reference):
    radius = np.array([0.7, 1.2, 0.7, 0.89])
    azimuth = np.array([1.0, 0.0, np.radians(178.5), 0.0])
    _, reached = follow(pa10_chain, reference, radius, azimuth)
    assert reached.tolist() == [True, False, False, True]


def test_no_posture_where_there_is_none(pa10_chain):
    with pytest.raises(SettingsError, match=r"cannot reach this plane.*1500"):
        reference_in_plane(pa10_chain, 1.5, (0.7, 0.7))


def test_other_radii_are_tried_in_turn(pa10_chain):
    reference = reference_in_plane(pa10_chain, 0.5, (0.6, 2.2))
    assert reference.radius_m == pytest.approx(0.6)


def test_a_seven_joint_arm_with_odd_twists(make_arm):
    rows = [(0.36, 0, -90), (0, 0, 85), (0.42, 0, 95), (0, 0, -90), (0.4, 0.01, -80), (0, 0, 90)]
    chain = Chain.of(make_arm([*rows, (0.126, 0, 0)], limit_rad=2.9))
    reference = reference_in_plane(chain, 0.3, (0.55, 0.55))
    radius, azimuth = spread(60, 0.45, 0.6)
    q_rad, reached = follow(chain, reference, radius, 0.7 * azimuth)
    assert reached.mean() > 0.9
    assert_at(chain, q_rad, reached, radius, 0.7 * azimuth, 0.3)


def test_nobody_to_carry(pa10_chain, reference):
    q_rad, _ = follow(pa10_chain, reference, np.empty(0), np.empty(0))
    assert q_rad.shape == (0, 6)
