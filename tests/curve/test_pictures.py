"""What the pictures of a chain along a curve show."""

from dataclasses import replace

import numpy as np
import pytest

from pa10cal.figures.style import theme
from pa10cal_curve.pictures import draw_curve_gait, draw_curve_shape
from pa10cal_curve.records import CurveRecord, CurveShape
from pa10cal_curve.tables import CurveResults


@pytest.fixture
def results():
    """Three links that bend more in each of five shapes."""
    time_s = np.linspace(0.0, 1.0, 5)
    heading = time_s[:, None] * np.array([0.0, 0.3, 0.9])
    steps = np.stack([np.cos(heading), np.sin(heading), 0 * heading], axis=2)
    p_m = np.concatenate([np.zeros((5, 1, 3)), np.cumsum(0.1 * steps, axis=1)], axis=1)
    shape = CurveShape(
        time_s=0.0,
        ending="complete",
        ending_is="exact",
        left_m=0.0,
        gap_m=0.0,
        deviation_m=0.0,
        touches=(),
        open_joints=(),
        roll_deg=12.34,
        largest_angle_deg=34.38,
        chord_error=0.0,
        forward_kinematics_error_m=0.0,
    )
    record = CurveRecord(
        link_m=0.1,
        links=3,
        order="zy",
        largest_angle_deg=34.38,
        largest_move_deg=8.0,
        feasible_rolls_deg=None,
        shapes=(shape,) * 5,
        settings={"limits": {"a_deg": [-40.0, 45.0], "b_deg": [-500.0, 500.0]}},
    )
    return CurveResults(
        record=record,
        time_s=time_s,
        p_m=p_m,
        z_axis=np.tile([0.0, 0.0, 1.0], (5, 3, 1)),
        curve_m=p_m,
        a_deg=np.degrees(np.diff(heading, axis=1)),
        b_deg=np.zeros((5, 2)),
    )


def test_a_shape_is_drawn_with_its_angles_and_near_limits(results):
    with theme():
        figure = draw_curve_shape(replace(results, time_s=results.time_s[:1]))
    space, angles = figure.axes
    named = {line.get_label(): line for line in (*space.lines, *angles.lines)}
    np.testing.assert_array_equal(np.array(named["links"].get_data_3d()).T, results.p_m[0])
    ends = np.array(named["their z"].get_data_3d()).T.reshape(3, 3, 3)
    np.testing.assert_allclose(ends[:, 1, 2] - ends[:, 0, 2], 0.045)
    np.testing.assert_array_equal(named["a, about z"].get_ydata(), results.a_deg[0])
    limits = {line.get_ydata()[0] for line in angles.lines if line.get_linestyle() == "--"}
    assert limits == {-40.0, 45.0}
    assert "12.3" in angles.get_title(loc="left")


def test_a_gait_is_drawn_with_angles_over_time_and_moves(results):
    with theme():
        figure = draw_curve_gait(results)
    images = [image for axes in figure.axes for image in axes.get_images()]
    np.testing.assert_array_equal(images[0].get_array(), results.a_deg.T)
    np.testing.assert_array_equal(images[1].get_array(), results.b_deg.T)
    moves = next(axes for axes in figure.axes if "largest move" in axes.get_title(loc="left"))
    np.testing.assert_allclose(moves.lines[0].get_ydata(), np.degrees(0.6) / 4.0)
