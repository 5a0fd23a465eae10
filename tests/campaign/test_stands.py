"""Readings that were repeated while the arm stood still."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from made_up_poses import at_rest
from pa10cal.campaign.stands import standing, with_stands_averaged
from pa10cal.observe.observations import Observations
from pa10cal.observe.points import Distance, Points
from pa10cal.observe.pose import Pose

POSES, TIMES = 30, 3
STATED_M, READING_M = 2e-5, 1.25e-6


def repeated(kind="points", *, moved=False, off_m=0.0):
    """Return three readings of each of 30 poses, one after the other, or round by round."""
    rng = np.random.default_rng(2)
    q = np.repeat(rng.uniform(-1.0, 1.0, (POSES, 6)), TIMES, axis=0)
    place_m = np.repeat(rng.uniform(0.5, 1.0, (POSES, 3)), TIMES, axis=0)
    place_m += rng.normal(0.0, READING_M, place_m.shape)
    place_m[1] += off_m
    time_s = np.arange(float(POSES * TIMES))
    if moved:
        time_s = np.tile(np.arange(TIMES) * float(POSES), POSES) + np.repeat(
            np.arange(POSES), TIMES
        )
    if kind == "points":
        cov_m2 = np.broadcast_to(STATED_M**2 * np.eye(3), (len(q), 1, 3, 3))
        measured = Points(("T1",), place_m[:, None], cov_m2, None)
    elif kind == "distance":
        measured = Distance(place_m[:, 0], np.full(len(q), STATED_M))
    else:
        T = np.tile(np.eye(4), (len(q), 1, 1))
        T[:, :3, 3] = place_m
        measured = Pose.of(T, np.broadcast_to(STATED_M**2 * np.eye(6), (len(q), 6, 6)))
    labels = np.array([f"P{k // TIMES:02}" for k in range(len(q))])
    return Observations.single(labels, at_rest(q, time_s=time_s), measured)


@pytest.mark.parametrize("kind", ["points", "distance", "pose"])
def test_those_that_scatter_less_than_is_stated_count_as_one(kind):
    every = repeated(kind)
    merged, notes = with_stands_averaged(every)
    assert len(merged) == POSES
    assert merged.readings.tolist() == [1] * POSES
    expected = every.measured.places_m.reshape(POSES, TIMES, -1).mean(axis=1)
    np.testing.assert_allclose(merged.measured.places_m.reshape(POSES, -1), expected)
    variance = np.diagonal(merged.measured.stated_covariance, axis1=1, axis2=2)
    np.testing.assert_allclose(variance, STATED_M**2)
    assert "90 readings count as 30: the arm did not move" in notes[0]
    assert "0.02 mm stated" in notes[0]


def test_those_between_which_the_arm_moved_stay_as_they_are():
    every = repeated(moved=True)
    assert len(np.unique(standing(every))) == len(every)
    assert with_stands_averaged(every) == (every, ())


def test_those_that_scatter_as_stated_stay_as_they_are():
    every = repeated()
    cov_m2 = np.full_like(every.measured.cov_m2, 0.0) + (2.0 * READING_M) ** 2 * np.eye(3)
    every = replace(every, measured=replace(every.measured, cov_m2=cov_m2))
    assert with_stands_averaged(every) == (every, ())


def test_one_far_off_the_others_of_its_pose_is_left_out():
    merged, notes = with_stands_averaged(repeated(off_m=1e-3))
    right, _ = with_stands_averaged(repeated())
    off_m = merged.measured.places_m[0] - right.measured.places_m[0]
    assert np.abs(off_m).max() < 2.0 * READING_M
    assert "1 far off the others of a pose left out" in notes[0]
    kept, notes = with_stands_averaged(repeated(off_m=5.0 * READING_M))  # within what is stated
    assert "left out" not in notes[0]
    assert len(kept) == POSES
