"""Which parameters are unknowns does not hang on where the turn of a joint is counted from."""

from dataclasses import replace

import numpy as np
import pytest

from pa10cal.calibration.general import unknowns
from pa10cal.files.arms import load_arm
from pa10cal.observe.quantities import Start
from pa10cal.options import Tolerances

UR10 = load_arm("ur10")


def with_elbow(low_deg, high_deg):
    limits_rad = UR10.limits_rad.copy()
    limits_rad[2] = np.radians([low_deg, high_deg])
    return replace(UR10, limits_rad=limits_rad)


def chosen(arm, see, kind="pose"):
    observations = see(UR10, kind)
    targets_m = np.zeros(len(observations.measured.target_parameters))
    start = Start(np.eye(4), np.zeros(3), np.eye(3), targets_m)
    return unknowns.choose_unknowns(arm, Tolerances(), observations.measured, start)


@pytest.mark.parametrize("limits_deg", [(180.0, 360.0), (190.0, 359.0), (-350.0, -200.0)])
def test_a_joint_beyond_half_a_turn_moves_as_one_a_turn_from_it(see, limits_deg):
    low, high = limits_deg
    shift = 360.0 if high < 0.0 else -360.0
    beyond, usual = (
        chosen(with_elbow(*each), see) for each in ((low, high), (low + shift, high + shift))
    )
    assert beyond.links == usual.links
    assert [each.name for each in beyond.redundant] == [each.name for each in usual.redundant]


def test_limits_of_a_turn_about_zero_are_that_turn_and_others_the_one_about_their_middle():
    def range_of(arm):
        q_deg = np.degrees(unknowns._random_states(arm, 500).q_rad[:, 2])
        return q_deg.min(), q_deg.max()

    assert range_of(with_elbow(-350.0, 200.0)) == pytest.approx((-180.0, 180.0), abs=3.0)
    assert range_of(with_elbow(-100.0, 320.0)) == pytest.approx((-70.0, 290.0), abs=3.0)
    assert range_of(with_elbow(-100.0, 60.0)) == pytest.approx((-100.0, 60.0), abs=3.0)


def test_a_long_arm_has_as_many_unknowns_under_distances_as_it_should(see):
    iiwa = load_arm("iiwa14")
    rows = ("theta_rad", "d_m", "a_m", "alpha_rad", "hayati", "prismatic", "limits_rad")
    rows = (*rows, "gear_ratio", "torque_limit_Nm", "beta_rad")
    twice = {name: np.concatenate([getattr(iiwa, name)] * 3) for name in rows}
    snake = replace(iiwa, **twice, mass_kg=None, com_m=None)
    found = chosen(snake, see, "distance")
    # Four a joint; where one arm ends and the next begins, two axes are one.
    kept = len(found.links.parameters) + len(found.base.parameters) + len(found.targets_kept)
    assert kept == 4 * snake.n - 2 * 4
