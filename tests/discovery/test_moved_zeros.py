"""Readings corrected by steps of joints, and what the model is uncertain by of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pa10cal.discovery import jacobians
from pa10cal.discovery.nuisances import MovedZeros
from pa10cal.discovery.preparation import complete, prepared

STEPS = MovedZeros(
    joints=(3, 3, 1),
    times_s=(3600.0, 5400.0, 5400.0),
    between_s=np.array([[3500.0, 3700.0], [5390.0, 5410.0], [5390.0, 5410.0]]),
    moved=np.array([3e-4, -1e-4, 2e-4]),
    covariance=np.diag([4e-10, 1e-10, 1e-10]),
)


def test_readings_are_as_they_would_be_since_the_last_step(null):
    readings = null.readings
    time_s = readings.states.time_s
    off = STEPS.corrected(readings).states.q_rad - readings.states.q_rad
    expected = np.zeros_like(off)
    expected[time_s <= 5400.0, 2] = 1e-4
    expected[time_s <= 3600.0, 2] -= 3e-4
    expected[time_s <= 5400.0, 0] = -2e-4
    assert off == pytest.approx(expected, abs=1e-12)
    assert 0 < np.count_nonzero(expected[:, 2]) < len(off)


def test_they_stand_in_a_record_but_for_their_covariance():
    again = MovedZeros.of_record(STEPS.record)
    assert (again.joints, again.times_s) == (STEPS.joints, STEPS.times_s)
    np.testing.assert_array_equal(again.moved, STEPS.moved)
    np.testing.assert_array_equal(again.between_s, STEPS.between_s)


def test_a_reading_between_the_last_before_and_the_first_after_is_of_either_side(null):
    time_s = null.readings.states.time_s
    here = ((time_s > 3500.0) & (time_s < 3700.0)) | ((time_s > 5390.0) & (time_s < 5410.0))
    np.testing.assert_array_equal(STEPS.of_unknown_side(null.readings), here)
    kind = np.where(null.readings.pose == null.readings.pose[0], "holdout", "grid")
    every = replace(null.readings, kind=kind)
    wide = replace(STEPS, between_s=np.array([[-1.0, 1e6]] * 3))
    judging = prepared(every, null.baseline, null.setup, moved=wide).suspected
    assert judging is not None
    assert judging.all()


def test_the_fit_is_as_uncertain_as_one_that_has_the_steps_as_unknowns(null):
    """Of all unknowns and amounts together, by one inverse: no formula of the module."""
    at = null.baseline
    poses = complete(null.readings, at, null.setup)
    by_unknowns = jacobians.residual_and_jacobian(at, poses)[1]
    before = poses.states.time_s[:, None] <= np.array(STEPS.times_s)
    by_moved = -jacobians.by_joints(at, poses, STEPS.joints) * before[:, None, :]
    precision = np.linalg.inv(poses.measured.stated_covariance)
    count, by_all = by_unknowns.shape[2], np.concatenate([by_unknowns, by_moved], axis=2)
    size = np.abs(by_all).max(axis=(0, 1))
    size = np.where(size > 0.0, size, 1.0)
    columns = by_all / size
    information = np.einsum("pbi,pbc,pcj->ij", columns, precision, columns)
    information[:count, :count] += 1e2 * np.eye(count)  # a prior that holds what is not seen
    together = np.linalg.inv(information) / np.outer(size, size)
    alone = np.linalg.inv(information[:count, :count]) / np.outer(size[:count], size[:count])
    steps = replace(STEPS, covariance=together[count:, count:])
    found = alone + steps.covariance_of_fit(at, poses, alone)
    std, expected = np.sqrt(np.diag(found)), np.sqrt(np.diag(together)[:count])
    grown = expected > 1.05 * np.sqrt(np.diag(alone))
    assert grown.any()
    np.testing.assert_allclose(std, expected, rtol=0.02)
