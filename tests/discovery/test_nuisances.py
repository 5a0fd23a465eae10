"""Errors beside a model, and how motion in time is reported."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pa10cal.discovery import jacobians
from pa10cal.discovery.nuisances import (
    NO_MOTION,
    AttitudeLag,
    Wander,
    between_rows,
    motion_unexplained,
)


def test_the_size_of_a_walk_is_that_along_each_axis():
    times_s = np.linspace(0.0, 3600.0, 200)
    walk = Wander(times_s, (), walk_m=3e-5)
    rng = np.random.default_rng(0)
    draws = [replace(walk, amounts=rng.normal(size=len(walk.sizes))) for _ in range(400)]
    shift_m = np.array([each.motions(times_s)[:, :3] for each in draws])
    each_axis_m = np.sqrt(np.mean(shift_m**2, axis=(0, 1)))
    np.testing.assert_allclose(each_axis_m, 3e-5, rtol=0.1)


@pytest.mark.parametrize("campaign", [None, np.array([0, 0, 1, 1])])
def test_an_attitude_lags_by_the_direction_of_a_move_in_its_own_campaign(monkeypatch, campaign):
    """Without campaigns all poses belong to the first."""
    moved = np.array([[1.0, 0.0], [-1.0, 1.0], [0.0, -1.0], [1.0, 1.0]])
    states = SimpleNamespace(campaign=campaign, move_from_previous=moved)

    class Poses(SimpleNamespace):
        def __len__(self):
            return 4

    poses = Poses(states=states, measured=SimpleNamespace(position_columns=[0, 1, 2]))
    monkeypatch.setattr(jacobians, "by_joints", lambda *_: np.ones((4, 6, 2)))
    lag = AttitudeLag((1, 2), campaigns=2, amounts=np.arange(1.0, 5.0))
    columns = lag.columns(None, poses)
    assert columns.shape == (4, 6, len(lag.sizes))
    assert not columns[:, :3].any()
    in_units = columns[:, 3] / lag.sizes
    second = np.zeros(4, dtype=bool) if campaign is None else campaign == 1
    np.testing.assert_allclose(in_units[:, :2], moved * ~second[:, None])
    np.testing.assert_allclose(in_units[:, 2:], moved * second[:, None])
    assert lag.shift(None, poses).shape == (4, 6)


def test_a_lag_of_zero_names_its_joints():
    why = AttitudeLag((1, 2), amounts=np.zeros(2)).unexplained(0.1).why
    assert "joint 1 (0 µrad) and joint 2 (0 µrad) came" in why


def test_a_large_motion_and_a_long_time_are_written_in_digits():
    walk = Wander(np.linspace(0.0, 864e3, 50), (), walk_m=1e-3, rms_mm=(1500.0, 1500.0))
    (told,) = motion_unexplained(NO_MOTION, walk, 0.1)
    assert "wandered by 1500 mm (root mean square) in 240 h" in told.why


@pytest.mark.parametrize(
    ("before_s", "after_s", "told"),
    [
        (10.0, 20.0, "between P1 at 10 s and P2 at 20 s"),
        (1.0, 5.0, "before P1 at 10 s"),
        (35.0, 40.0, "after P3 at 30 s"),
    ],
)
def test_what_happened_before_or_after_all_readings_is_told_so(before_s, after_s, told):
    states = SimpleNamespace(time_s=np.array([30.0, 10.0, 20.0]))
    readings = SimpleNamespace(states=states, pose=np.array(["P3", "P1", "P2"]))
    assert between_rows(readings, before_s, after_s) == told
