"""Angle errors and orders of the joints are drawn as the records have them."""

from functools import partial

import numpy as np
import pytest
from matplotlib.text import Text

from pa10cal.figures.campaign import by_joint

pytestmark = pytest.mark.usefixtures("project_looks")


def texts_of(figure):
    return [text.get_text() for text in figure.findobj(Text)]


@pytest.fixture
def changed(named, changed_from):
    """Copy the results with changes to the JSON of one of them."""
    return partial(changed_from, named)


class TestJoints:
    def test_the_marked_order_of_the_joint_stands_out(self, named):
        orders = by_joint.draw_where_joints(named).axes[6:]
        marked = [axes.lines[1].get_ydata() for axes in orders]
        assert np.unravel_index(np.argmax(marked), (6, 4)) == (1, 3)
        assert [label.get_text() for label in orders[1].get_xticklabels()] == [
            "1",
            "2",
            "N",
            "\n2N",
        ]
        assert list(orders[1].lines[1].get_xdata()) == [1.0, 2.0, 50.0, 100.0]

    def test_orders_that_the_poses_cannot_tell_are_shaded_and_not_drawn(self, named):
        axes = by_joint.draw_where_joints(named).axes[7]
        shaded = axes.patches[0].get_extents().transformed(axes.transData.inverted())
        assert max(axes.lines[0].get_xdata()) <= shaded.x0 * (1.0 + 1e-9)
        assert shaded.x0 < 100.0  # 27 poses

    def test_without_a_gear_ratio_there_is_no_axis_of_it(self, changed):
        def ungeared(record):
            for fit in ("before", "after"):
                for joint in record[fit]["by_joint"]:
                    if joint["periodogram"]:
                        for key in ("marked", "marked_rad"):
                            joint["periodogram"][key] = joint["periodogram"][key][:2]

        figure = by_joint.draw_where_joints(changed("discovery/analysis.json", ungeared))
        assert not any("gear" in text for text in texts_of(figure))
        axes = figure.axes[7]
        assert [label.get_text() for label in axes.get_xticklabels()] == ["1", "2"]
        assert axes.get_xlim()[1] <= 30.0

    def test_a_point_a_cell_over_the_joints_own_angle(self, named):
        points = by_joint.draw_where_joints(named).axes[1]
        joint = named.analysis.before.cells.joints[1]
        before = points.lines[1]
        np.testing.assert_allclose(before.get_xdata(), np.degrees(joint.q_rad))
        np.testing.assert_allclose(before.get_ydata(), 1e6 * np.array(joint.error_rad))

    def test_a_joint_that_hardly_turned_has_no_periodogram(self, changed):
        def still(record):
            for fit in ("before", "after"):
                record[fit]["by_joint"][0]["periodogram"] = None

        texts = texts_of(by_joint.draw_where_joints(changed("discovery/analysis.json", still)))
        assert texts.count("hardly\nturned") == 1

    def test_an_arm_of_which_no_joint_turned_is_drawn(self, changed):
        def still(record):
            for fit in ("before", "after"):
                for joint in record[fit]["by_joint"]:
                    joint["periodogram"] = None

        texts = texts_of(by_joint.draw_where_joints(changed("discovery/analysis.json", still)))
        assert texts.count("hardly\nturned") == 6
