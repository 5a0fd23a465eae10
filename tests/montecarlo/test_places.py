"""Places: uniform by area over what can be reached; rejections counted; refusals explained."""

import numpy as np
import pytest
from scipy.stats import kstest

from pa10cal.errors import SettingsError
from pa10cal.montecarlo.places import draw_places, grid_places, reference_in_plane
from pa10cal.montecarlo.plane import stream

REACH = (0.5, 0.85)


@pytest.fixture(scope="module")
def reference(pa10_chain):
    return reference_in_plane(pa10_chain, 0.3, REACH)


def test_uniform_by_area(pa10_chain, reference):
    places = draw_places(pa10_chain, reference, REACH, 900, stream(1, 300, None))
    radius = np.hypot(*places.p_base_m.T)
    azimuth = np.arctan2(*places.p_base_m.T[::-1])
    near, far = np.square(REACH)
    edge = np.radians(177)
    assert kstest(radius**2, "uniform", args=(near, far - near)).pvalue > 1e-3
    assert kstest(azimuth, "uniform", args=(-edge, 2 * edge)).pvalue > 1e-3


def test_rejected_places_are_counted(pa10_chain, reference):
    """Joint 1 cannot turn to the last three degrees on either side of the negative x axis."""
    places = draw_places(pa10_chain, reference, REACH, 900, stream(1, 300, None))
    parts = stream(1, 300, None).random((1000, 2))
    can_be_reached = np.abs(2 * parts[:, 1] - 1) < 177 / 180
    drawn = np.flatnonzero(can_be_reached)[899] + 1
    assert places.rejected == drawn - 900 > 0


def test_places_are_where_the_joints_put_the_flange(pa10_chain, reference):
    places = draw_places(pa10_chain, reference, REACH, 40, stream(1, 300, None))
    ends = pa10_chain.forward(places.q_rad)[:, :3, 3]
    np.testing.assert_allclose(ends[:, :2], places.p_base_m, atol=1e-9)
    assert places.p_base_m.shape == (40, 2)


def test_fewer_places_are_the_first_of_more(pa10_chain, reference):
    few, many = (
        draw_places(pa10_chain, reference, REACH, count, stream(1, 300, None))
        for count in (30, 510)
    )
    np.testing.assert_allclose(few.p_base_m, many.p_base_m[:30], rtol=0, atol=0)


def test_grid_holds_every_reachable_point(pa10_chain, reference):
    grid = grid_places(pa10_chain, reference, REACH, 0.1)
    along = 0.1 * np.arange(-8, 9)
    x, y = (axis.ravel() for axis in np.meshgrid(along, along))
    inside = (np.hypot(x, y) >= REACH[0]) & (np.hypot(x, y) <= REACH[1])
    assert len(grid.p_base_m) + grid.rejected == inside.sum()
    assert grid.rejected == 4  # on the negative x axis, behind joint 1's limits: 0.5 to 0.8 m
    assert len({tuple(point) for point in grid.p_base_m.round(6)}) == len(grid.p_base_m)


def test_grid_without_points(pa10_chain, reference):
    assert grid_places(pa10_chain, reference, REACH, 3.0).p_base_m.shape == (0, 2)


def test_too_fine_a_grid_is_refused(pa10_chain, reference):
    with pytest.raises(SettingsError, match=r"map_spacing_mm.*too fine.*at least 12\.1 at"):
        grid_places(pa10_chain, reference, REACH, 1e-3)
    assert grid_places(pa10_chain, reference, (0.849, 0.85), 12.1e-3).rejected >= 0


def test_plane_out_of_reach_is_refused(pa10_chain):
    with pytest.raises(SettingsError, match=r"cannot reach this plane.*got 1500.*0\.5 to 0\.85 m"):
        reference_in_plane(pa10_chain, 1.5, REACH)


def test_hardly_reachable_plane_is_refused(pa10_chain):
    reach = (0.7, 6.0)
    reference = reference_in_plane(pa10_chain, 0.5, reach)
    with pytest.raises(SettingsError, match=r"reach_m.*hardly any position.*0\.7, 6\.0"):
        draw_places(pa10_chain, reference, reach, 20, stream(1, 500, None))
