"""What poses read once show of time, beside what goes with place."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_survey import POSITION_M, observe
from pa10cal.discovery.blocked_cv.by_blocks import discover_by_blocks
from pa10cal.discovery.in_time import in_time_of, motion_unexplained
from pa10cal.discovery.linear import with_base_term
from pa10cal.discovery.noise import unweighted
from pa10cal.discovery.preparation import Prepared
from pa10cal.terms.effects.effect import candidates

POSES = 120


@pytest.fixture(scope="module")
def small():
    return observe(poses=POSES, held_out=10)


def shifted(surveyed, shift_m):
    """Return the readings, in order of time, each shifted by (P, 3)."""
    readings = surveyed.readings
    readings = readings.take(np.argsort(readings.states.time_s))
    T = readings.measured.T_instr_target.copy()
    T[:, :3, 3] += shift_m
    return replace(surveyed, readings=readings.with_measured(T_instr_target=T))


def shown(surveyed, poses=None):
    at, poses = surveyed.baseline, surveyed.survey.poses if poses is None else poses
    return in_time_of(
        replace(at, model=with_base_term(at), x=np.concatenate([at.x, np.zeros(6)])),
        poses,
        unweighted(poses.measured).whitener,
        candidates(surveyed.survey.context),
        logged=False,
        weights=True,
    )


def test_nothing_moves_where_nothing_moved(small):
    assert shown(small).wander is None


@pytest.mark.slow
def test_a_jump_of_three_times_the_noise_is_a_fault_and_no_drift(small):
    jump_m = np.outer(np.arange(POSES) >= 70, [0.0, 3.5 * POSITION_M, 0.0])
    moved = shifted(small, jump_m)
    given = Prepared(moved.readings, None, moved.baseline, moved.setup, "masses", False)
    found = discover_by_blocks(given)
    (fault,) = found.faults
    first, last = (found.survey.wander.jumps[0].before_s, found.survey.wander.jumps[0].after_s)
    assert found.verdict == "check_the_log"
    assert found.effects == ()
    assert fault.kind == "step_in_time"
    assert first <= moved.readings.states.time_s[70] <= last


def test_a_steady_drift_is_neither_a_jump_nor_a_wander(small):
    found = shown(shifted(small, np.outer(np.linspace(0.0, 5.0, POSES), [POSITION_M, 0.0, 0.0])))
    assert found.wander is None
    assert found.drifts


def test_nothing_is_said_where_time_goes_with_place(small):
    order = np.argsort(small.readings.states.q_rad.sum(axis=1))
    readings = small.readings.take(order)
    ramp = np.linspace(-1.0, 1.0, POSES)[:, None] * np.ones(6)
    states = replace(readings.states, q_rad=ramp, time_s=np.sort(readings.states.time_s))
    moved = shifted(
        replace(small, readings=readings.with_states(states)),
        np.outer(np.arange(POSES) >= 70, [0.0, 10 * POSITION_M, 0.0]),
    )
    assert shown(moved).wander is None


def in_order_of(surveyed, key):
    """Return the poses of a survey, measured in the order of a key (P,)."""
    poses = surveyed.survey.poses
    rank = np.argsort(np.argsort(key, kind="stable"), kind="stable")
    states = replace(poses.states, time_s=np.sort(poses.states.time_s)[rank])
    return poses.with_states(states)


def seen_of_time(surveyed, poses, shift_m):
    """Return what poses show of time, each shifted by (P, 3)."""
    T = poses.measured.T_instr_target.copy()
    T[:, :3, 3] += shift_m
    poses = poses.with_measured(T_instr_target=T)
    return shown(surveyed, poses)


@pytest.mark.parametrize("order", ["random", "one side, then the other"])
def test_a_jump_is_told_of_time_only_where_no_joint_goes_with_it(small, order):
    states = small.survey.poses.states
    key = states.time_s if order == "random" else states.time_s - 1e9 * (states.q_rad[:, 1] < 0.0)
    poses = in_order_of(small, key)
    first = np.sum(poses.states.q_rad[:, 1] < 0.0) if order != "random" else 70
    later = np.argsort(np.argsort(poses.states.time_s)) >= first
    found = seen_of_time(small, poses, np.outer(later, [0.0, 10.0 * POSITION_M, 0.0]))
    if order == "random":
        assert len(found.wander.jumps) == 1
        assert found.rivals == ()
    else:
        assert found.wander is None
        assert found.rivals == ("joint 2",)
        (told,) = motion_unexplained(found, None, 0.0)
        assert "joint 2" in told.why
        assert "in random order" in told.why


def test_nothing_moves_where_time_was_not_recorded(small):
    poses = small.survey.poses
    unknown = replace(poses.states, timed=np.zeros(POSES, dtype=bool))
    poses = poses.with_states(unknown)
    later = np.arange(POSES) >= 70
    found = seen_of_time(small, poses, np.outer(later, [0.0, 10.0 * POSITION_M, 0.0]))
    assert found.wander is None
    assert found.rivals == ()
