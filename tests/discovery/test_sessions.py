"""Two sessions in one file without times."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_survey import observe
from pa10cal.discovery import jacobians
from pa10cal.discovery.sessions import of_sessions, two_sessions

POSES, FIRST = 120, 50  # poses, of which so many are of the first session


@pytest.fixture(scope="module")
def given():
    return observe(poses=POSES, held_out=10)


def untimed(poses):
    return poses.with_states(replace(poses.states, timed=np.zeros(len(poses), dtype=bool)))


def moved(poses, off_m):
    """Move readings (P, 3) [m]."""
    T = poses.measured.T_instr_target.copy()
    T[:, :3, 3] += off_m
    return poses.with_measured(T_instr_target=T)


def of_two_sessions(poses, size_m=2e-4):
    """Rows of a second session, whose instrument stood elsewhere, below those of a first."""
    in_time = np.argsort(np.argsort(poses.states.time_s, kind="stable"))
    return moved(poses, np.where(in_time >= FIRST, size_m, 0.0)[:, None] * [1.0, -0.5, 0.3])


def test_rows_without_times_are_found_to_be_of_two_sessions(given):
    at, poses = given.baseline, untimed(given.readings)
    assert two_sessions(at, poses) is None
    both = of_two_sessions(poses)
    found = two_sessions(at, both)
    first = both.pose[np.argsort(both.states.time_s, kind="stable")[FIRST]]
    assert found.of == f"the rows from pose {first} on"
    assert "two sessions? join them as a group" in found.why
    assert of_sessions(found)
    # Where times were recorded a motion is sought in time.
    assert two_sessions(at, of_two_sessions(given.readings)) is None


def test_an_error_of_a_joint_is_no_session_where_rows_follow_it(given):
    at, poses = given.baseline, untimed(given.readings)
    q_rad = poses.states.q_rad[:, 1]
    by_joint = jacobians.by_joints(at, poses, [2])[:, :3, 0]
    off_m = by_joint * np.where(q_rad > np.quantile(q_rad, 0.4), 3e-4, -3e-4)[:, None]
    follows = poses.with_states(replace(poses.states, time_s=np.argsort(np.argsort(q_rad)) * 1.0))
    assert two_sessions(at, moved(follows, off_m)) is None
    # Nor where they do not.
    assert two_sessions(at, moved(poses, off_m)) is None
