"""Places: uniform by area over what can be reached, in one posture; refusals explained."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from pa10cal.arm.chain import Chain
from pa10cal.errors import SettingsError
from pa10cal.montecarlo.places import draw_places, follow, grid_places, reference_in_plane
from pa10cal.montecarlo.plane import stream

REACH = (0.5, 0.85)
HEIGHT_M = 0.3


@pytest.fixture(scope="module")
def reference(pa10_chain):
    return reference_in_plane(pa10_chain, HEIGHT_M, REACH)


@pytest.fixture(scope="module")
def places(pa10_chain, reference):
    return draw_places(pa10_chain, reference, REACH, 900, stream(1, 300, None))


def test_uniform_by_area_and_fewer_places_are_the_first_of_more(pa10_chain, reference, places):
    radius = np.hypot(*places.place_base_m.T)
    azimuth = np.arctan2(*places.place_base_m.T[::-1])
    near, far = np.square(REACH)
    edge = np.radians(177)
    assert kstest(radius**2, "uniform", args=(near, far - near)).pvalue > 1e-3
    assert kstest(azimuth, "uniform", args=(-edge, 2 * edge)).pvalue > 1e-3
    few = draw_places(pa10_chain, reference, REACH, 30, stream(1, 300, None))
    np.testing.assert_array_equal(few.place_base_m, places.place_base_m[:30])


def test_rejected_places_are_counted(places):
    """Joint 1 cannot turn to the last three degrees on either side of the negative x axis."""
    parts = stream(1, 300, None).random((1000, 2))
    can_be_reached = np.abs(2 * parts[:, 1] - 1) < 177 / 180
    drawn = np.flatnonzero(can_be_reached)[899] + 1
    assert places.rejected == drawn - 900 > 0


def test_grid_holds_every_reachable_point(pa10_chain, reference):
    grid = grid_places(pa10_chain, reference, REACH, 0.1)
    along = 0.1 * np.arange(-8, 9)
    radius = np.hypot(*np.meshgrid(along, along))
    inside = (radius >= REACH[0]) & (radius <= REACH[1])
    assert len(grid.place_base_m) + grid.rejected == inside.sum()
    assert grid.rejected == 4  # on the negative x axis, behind joint 1's limits: 0.5 to 0.8 m
    assert len({tuple(point) for point in grid.place_base_m.round(6)}) == len(grid.place_base_m)
    assert grid_places(pa10_chain, reference, REACH, 3.0).place_base_m.shape == (0, 2)


def test_what_cannot_be_drawn_is_refused(pa10_chain, reference):
    with pytest.raises(SettingsError, match=r"map_spacing_mm.*too fine.*at least 12\.1 at"):
        grid_places(pa10_chain, reference, REACH, 1e-3)
    assert grid_places(pa10_chain, reference, (0.849, 0.85), 12.1e-3).rejected >= 0
    with pytest.raises(SettingsError, match=r"cannot reach this plane.*got 1500.*0\.5 to 0\.85 m"):
        reference_in_plane(pa10_chain, 1.5, REACH)
    reach = (0.7, 6.0)
    wide = reference_in_plane(pa10_chain, 0.5, reach)
    with pytest.raises(SettingsError, match=r"reach_m.*hardly any position.*0\.7, 6\.0"):
        draw_places(pa10_chain, wide, reach, 20, stream(1, 500, None))


def test_other_radii_are_tried_in_turn(pa10_chain):
    found = reference_in_plane(pa10_chain, 0.5, (0.6, 2.2))
    assert found.radius_m == pytest.approx(0.6)


def test_a_flange_that_cannot_turn_down_points_up(make_arm):
    """Two links in a horizontal plane: the flange's axis is upright in every posture."""
    arm = make_arm([(0.4, 0.45, 0), (0.0, 0.45, 0), (0.0, 0.0, 0)], limit_rad=2.9)
    found = reference_in_plane(Chain.of(arm), 0.4, (0.5, 0.9))
    assert found.R_base_ee[2, 2] == 1.0
    q_rad, reached = follow(Chain.of(arm), found, np.array([0.6]), np.array([0.3]))
    assert reached.all()
    assert Chain.of(arm).forward(q_rad)[0, 2, 2] == pytest.approx(1.0, abs=1e-9)


def test_joints_without_limits_are_searched_over_a_turn(pa10_chain, reference):
    arm = pa10_chain.arm
    limits_rad = arm.limits_rad.copy()
    limits_rad[0], limits_rad[5, 1] = (-np.inf, np.inf), np.inf
    found = reference_in_plane(Chain.of(replace(arm, limits_rad=limits_rad)), HEIGHT_M, REACH)
    assert found.radius_m == pytest.approx(reference.radius_m)


# Postures: at their place, pointing down, inside the limits, and all of one kind.


def assert_followed(chain, reference, radius, azimuth, least):
    """Follow to places, of which so many at least are reached; return those."""
    q_rad, reached = follow(chain, reference, radius, azimuth)
    assert reached.mean() > least
    q_rad, azimuth, T = q_rad[reached], azimuth[reached], chain.forward(q_rad[reached])
    place = radius[reached, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    np.testing.assert_allclose(T[:, :2, 3], place, atol=1e-9)
    np.testing.assert_allclose(T[:, 2, 3], reference.height_m, atol=1e-9)
    np.testing.assert_allclose(T[:, :3, 2], np.tile([0, 0, -1.0], (len(T), 1)), atol=1e-9)
    low, high = chain.arm.limits_rad.T
    assert ((q_rad >= low) & (q_rad <= high)).all()
    return q_rad, azimuth


def spread(count, near, far):
    source = np.random.default_rng(2)
    return source.uniform(near, far, count), source.uniform(-np.pi, np.pi, count)


def test_posture_of_the_pa10_stays_in_the_vertical_plane_elbow_up(pa10_chain, reference):
    q_rad, azimuth = assert_followed(pa10_chain, reference, *spread(200, 0.5, 0.9), 0.95)
    np.testing.assert_allclose(q_rad[:, 0], azimuth, atol=1e-9)
    np.testing.assert_allclose(q_rad[:, [3, 5]], 0, atol=1e-9)
    assert (q_rad[:, 2] > 0).all()


def test_a_seven_joint_arm_with_odd_twists(make_arm):
    rows = [(0.36, 0, -90), (0, 0, 85), (0.42, 0, 95), (0, 0, -90), (0.4, 0.01, -80), (0, 0, 90)]
    chain = Chain.of(make_arm([*rows, (0.126, 0, 0)], limit_rad=2.9))
    reference = reference_in_plane(chain, 0.3, (0.55, 0.55))
    radius, azimuth = spread(60, 0.45, 0.6)
    assert_followed(chain, reference, radius, 0.7 * azimuth, 0.9)


def test_out_of_reach_of_links_or_of_joint_1_is_told(pa10_chain, reference):
    radius = np.array([0.7, 1.2, 0.7, 0.89])
    azimuth = np.array([1.0, 0.0, np.radians(178.5), 0.0])
    _, reached = follow(pa10_chain, reference, radius, azimuth)
    assert reached.tolist() == [True, False, False, True]
    q_rad, _ = follow(pa10_chain, reference, np.empty(0), np.empty(0))
    assert q_rad.shape == (0, 6)
