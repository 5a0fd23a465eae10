"""Stretches of angles that are held out, to judge how large waves of a map are expected to be."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pa10cal.discovery.blocked_cv import bands
from pa10cal.terms.effects.joint_error_map import TYPICAL, JointErrorMap


def off_a_turn_deg(here, there):
    """Return how far each angle is from the nearest of others, turns apart or not."""
    apart = np.abs(here[:, None] - there)
    return np.degrees(np.min(np.minimum(apart % (2 * np.pi), -apart % (2 * np.pi)), axis=1))


@pytest.mark.parametrize("most_deg", [90.0, 170.0, 270.0, 350.0])
def test_a_stretch_of_angles_is_visited_by_no_other_pose_in_any_turn(most_deg):
    angle = np.radians(np.random.default_rng(1).uniform(-most_deg, most_deg, 4000))
    stretch = bands._stretches_of_turn(angle)
    for number in range(10):
        left_out = stretch == number
        assert 0.05 < left_out.mean() < 0.15
        near = off_a_turn_deg(angle[left_out], angle[~left_out]) < 1.0
        assert near.mean() < 0.15  # those at the two ends alone


def test_poses_of_one_station_are_in_one_stretch():
    station = np.random.default_rng(2).integers(0, 12, 600)
    station[:200] = 5  # at rest for a third of the time
    angle = np.radians(25.0 * station - 140.0 + np.random.default_rng(3).uniform(-0.2, 0.2, 600))
    stretch = bands._stretches_of_turn(angle)
    for number in range(12):
        assert len(set(stretch[station == number])) == 1


@given(st.lists(st.floats(-12.0, 12.0), min_size=1, max_size=40))
def test_every_pose_is_in_one_of_ten_stretches_whole_turns_aside(angles):
    angle = np.array(angles)
    stretch = bands._stretches_of_turn(angle)
    assert stretch.min() >= 0
    assert stretch.max() < 10
    middle = np.round(np.degrees(angle))  # off the edges of cells
    np.testing.assert_array_equal(
        bands._stretches_of_turn(np.radians(middle)),
        bands._stretches_of_turn(np.radians(middle + 360.0)),
    )


def test_a_loss_in_every_stretch_is_no_chance():
    worse = np.column_stack([np.ones(20), np.full(20, 1.1)])
    worse[:, 1] += np.linspace(-0.02, 0.02, 20)
    better = worse[:, ::-1]
    assert bands._no_worse(better, better)
    assert not bands._no_worse(worse, better)
    assert not bands._no_worse(better, worse)


def test_a_single_stretch_must_not_be_worse():
    some = np.ones((2, 2))
    for worse, kept in ((0.9, True), (1.0, True), (1.1, False)):
        assert bands._no_worse(some, np.array([[1.0, worse]])) == kept


def test_a_map_without_a_spectrum_is_refused():
    waves = object.__new__(bands._WaveColumns)
    waves.orders, waves._dense_count, waves._free = np.arange(1, 5), 1, np.ones(9, dtype=bool)
    maps = [JointErrorMap("joint 1", 12, TYPICAL), JointErrorMap("joint 2", 12)]
    with pytest.raises(ValueError, match="no spectrum"):
        waves.sizes_as_found(maps, 1.0)
