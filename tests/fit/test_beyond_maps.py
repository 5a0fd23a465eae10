"""By how much a map of a joint may be off beyond the angles at which the joint was seen."""

import numpy as np
import pytest

from pa10cal.fit.validity import AngleCoverage
from pa10cal.terms.effects.joint_error_map import JointErrorMap

SEEN = AngleCoverage((np.array([[-3.0, 3.0]]), np.array([[-2.0, 1.0], [1.5, 2.0]])), (False, False))


def test_positions_are_as_far_from_those_seen_as_the_nearest_end():
    asked = np.array([-2.4, -2.0, 0.3, 1.1, 1.4, 1.7, 2.6])
    assert SEEN.beyond(1, asked) == pytest.approx([-0.4, 0.0, 0.0, 0.1, -0.1, 0.0, 0.6])
    turning = AngleCoverage((np.array([[0.0, 1.0], [6.0, 2.0 * np.pi]]),), (True,))
    assert turning.beyond(0, np.array([-0.4, 7.0, 1.2, 0.5])) == pytest.approx(
        [2.0 * np.pi - 0.4 - 6.0, 0.0, 0.2, 0.0], abs=1e-12
    )
    assert AngleCoverage((np.zeros((0, 2)),), (False,)).beyond(0, asked).tolist() == [0.0] * 7


def test_beyond_the_angles_seen_a_map_may_change_as_it_does_where_seen():
    x = 1e-3 * np.sin(2.0 * np.pi * np.arange(12) / 12)  # one wave a turn
    found = JointErrorMap(of="joint 2", knots=12).most_change(
        x, SEEN.intervals[1], np.array([0.0, 0.2, 0.6, 3.0])
    )
    steepest = 2e-3 * np.sin(0.5 * np.array([0.2, 0.6]))  # about zero
    every = 1e-3 * (np.sin(1.0) + 1.0)  # all that it changes
    assert found == pytest.approx([0.0, *steepest, every], rel=0.02)
