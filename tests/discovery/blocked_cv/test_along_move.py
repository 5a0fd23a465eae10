"""A log of joints and readings that are not of one instant: the arm was read a little elsewhere."""

import numpy as np
import pytest

from made_up_survey import Hidden, observe
from pa10cal_lab.cell.effects.joint import (
    SimulatedAlongMove,
    SimulatedBacklash,
    SimulatedMoveSettling,
)

#: How far the joint that goes furthest is ahead of its log [rad].
AHEAD_RAD = -2e-4


def hidden(effect, place):
    return Hidden(turn=effect.at(place).added)


@pytest.fixture(scope="module")
def late():
    return observe(hidden(SimulatedAlongMove(c=AHEAD_RAD), "arm")).discovery


@pytest.mark.slow
def test_it_is_named_with_its_amount_and_no_lost_motion(late):
    assert late.verdict == "named"
    (finding,) = late.effects
    assert (finding.id, finding.of, finding.alternatives) == ("along_move", "arm", ())
    std_rad = np.sqrt(finding.covariance).item()
    assert abs(finding.x.item() - AHEAD_RAD) < 4.0 * std_rad
    assert std_rad < 0.1 * abs(AHEAD_RAD)
    assert late.holdout.after.mean_mm < 0.5 * late.holdout.before.mean_mm


@pytest.mark.slow
def test_it_moves_no_robot_in_predictions(late):
    q_rad = np.random.default_rng(1).uniform(-1.0, 1.0, (5, 6))
    (finding,) = late.effects
    rest = [term for term in late.model.model.terms if term is not finding.effect]
    assert len(rest) == len(late.model.model.terms) - 1
    for arrival in (-1.0, 0.0, 1.0):
        found = late.model.predict(q_rad, arrival=arrival).T
        np.testing.assert_array_equal(found, late.model.predict(q_rad).T)


@pytest.mark.slow
def test_an_arm_that_arrives_so_is_within_what_is_promised(late):
    states = late.holdout.poses.states
    moved = [states.q_rad + sign * AHEAD_RAD * states.move_share for sign in (0.0, 1.0)]
    off_mm = 1e3 * np.linalg.norm(np.subtract(*[late.model.predict(q).T for q in moved])[:, :3, 3])
    off_mm /= np.sqrt(len(states))
    assert np.mean(late.model.predict(states.q_rad).u_mm) > 0.9 * off_mm


@pytest.mark.slow
def test_lost_motion_of_a_joint_is_not_called_so():
    found = observe(hidden(SimulatedBacklash(b=3e-4), "joint 2")).discovery
    assert [(each.id, each.of) for each in found.effects] == [("backlash", "joint 2")]


@pytest.mark.slow
def test_what_goes_with_the_speed_of_the_end_is_told_from_what_does_not():
    found = observe(hidden(SimulatedMoveSettling(c=6e-4), "arm")).discovery
    (finding,) = found.effects
    assert (found.verdict, finding.id, finding.alternatives) == ("named", "move_settling", ())
    assert abs(finding.x.item() - 6e-4) < max(4.0 * np.sqrt(finding.covariance).item(), 2e-5)
    assert found.holdout.after.mean_mm < 0.5 * found.holdout.before.mean_mm
