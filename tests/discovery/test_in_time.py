"""What moved between readings is found, and called by what it is."""

import re
from dataclasses import replace

import numpy as np
import pytest

from made_up_arm import TARGET_NOISE_M
from made_up_poses import shifted
from made_up_survey import POSITION_M, observe
from pa10cal.discovery import in_time
from pa10cal.discovery.blocked_cv.by_blocks import discover_by_blocks
from pa10cal.discovery.gross_errors import moved_between_repeats
from pa10cal.discovery.in_time import in_time_of
from pa10cal.discovery.model_with_effects import with_base_motion
from pa10cal.discovery.nuisances import NO_MOTION, Wander, motion_unexplained
from pa10cal.discovery.pose_scatter import unweighted
from pa10cal.discovery.preparation import Prepared
from pa10cal.discovery.repeats import same_circumstances
from pa10cal.terms.effects.vocabulary import candidates

# Where poses are repeated.


def halfway(time_s, size_m):
    """Return a shift along x at the middle reading, and the times on either side."""
    order = np.sort(time_s)
    middle = len(order) // 2
    return np.outer(time_s >= order[middle], [size_m, 0.0, 0.0]), order[middle - 1 : middle + 1]


@pytest.fixture(scope="module")
def jumped(null):
    jump_m, _ = halfway(null.readings.states.time_s, 6 * TARGET_NOISE_M)
    return null.discovered(readings=shifted(null.readings, jump_m))


def test_nothing_moves_where_nothing_moved(null):
    assert null.discovery.scorer.problem.in_time.wander is None
    assert null.discovery.faults == ()


@pytest.mark.slow
def test_a_jump_is_a_fault_of_the_log_with_its_time_and_no_noise(null, jumped):
    (fault,) = jumped.faults
    times_s = halfway(null.readings.states.time_s, 1.0)[1]
    assert jumped.verdict == "check_the_log"
    assert jumped.effects == ()
    assert fault.kind == "step_in_time"
    assert all(f"at {time_s:g} s" in fault.where for time_s in times_s)
    (size_mm,) = re.findall(r"moved by (\S+) mm", fault.what)
    assert float(size_mm) == pytest.approx(6e3 * TARGET_NOISE_M, rel=0.15)
    assert jumped.noise_floor_mm == pytest.approx(null.discovery.noise_floor_mm, rel=0.1)


@pytest.mark.slow
def test_what_the_motion_takes_away_stands_apart_from_the_gap(null, jumped):
    still = jumped.train.without_motion
    assert still.after.mean_mm == pytest.approx(null.discovery.train.after.mean_mm, rel=0.1)
    # The model that is written does not know when the base stood where.
    assert jumped.train.after.mean_mm > 1.1 * still.after.mean_mm
    assert null.discovery.train.without_motion is None


@pytest.mark.slow
def test_a_wander_is_unexplained(null):
    steps = np.random.default_rng(3).standard_normal((len(null.readings), 3))
    walk_m = TARGET_NOISE_M * np.cumsum(steps, axis=0)
    rank = np.argsort(np.argsort(null.readings.states.time_s))
    found = null.discovered(readings=shifted(null.readings, walk_m[rank]))
    assert found.verdict == "unexplained"
    assert found.faults == ()
    assert found.effects == ()
    assert any("wandered by" in each.why for each in found.unexplained)


def between_repeats(null, by_m):
    readings = null.readings
    left = null.baseline.compared(readings).residual
    left[:, :3] += by_m
    return moved_between_repeats(readings, left, same_circumstances(readings))


def test_single_readings_far_off_are_no_motion_between_repeats(null):
    assert not between_repeats(null, 0.0).any()
    off_m = np.zeros((len(null.readings), 3))
    off_m[::40] = 8e-3
    assert not between_repeats(null, off_m).any()


def test_a_jump_is_one(null):
    time_s = null.readings.states.time_s
    late = time_s >= np.median(time_s)
    found = between_repeats(null, np.outer(late, [20 * TARGET_NOISE_M, 0.0, 0.0]))[:, 0]
    apart_m = np.median(found[late]) - np.median(found[~late])
    assert 0.5 < apart_m / (20 * TARGET_NOISE_M) < 1.1  # medians of few repeats take a part


# Poses read once, beside what goes with place.

POSES = 120


@pytest.fixture(scope="module")
def small():
    return observe(poses=POSES, held_out=10)


def in_order(readings, shift_m):
    """Return readings in order of time, each shifted by (P, 3)."""
    return shifted(readings.take(np.argsort(readings.states.time_s)), shift_m)


def jump(first, size):
    """Return a shift along y of so many times the noise from one reading on."""
    return np.outer(np.arange(POSES) >= first, [0.0, size * POSITION_M, 0.0])


def shown(surveyed, poses):
    at = surveyed.baseline
    return in_time_of(
        replace(at, model=with_base_motion(at), x=np.concatenate([at.x, np.zeros(6)])),
        poses,
        unweighted(poses.measured).whitener,
        candidates(surveyed.survey.context),
        logged=False,
        weights=True,
    )


@pytest.mark.slow
def test_a_jump_of_three_times_the_noise_is_a_fault_and_no_drift(small):
    readings = in_order(small.readings, jump(70, 3.5))
    given = Prepared(readings, None, small.baseline, small.setup, "masses", False)
    found = discover_by_blocks(given)
    (fault,) = found.faults
    (first,) = found.scorer.survey.wander.jumps[:1]
    assert found.verdict == "check_the_log"
    assert found.effects == ()
    assert fault.kind == "step_in_time"
    assert first.before_s <= readings.states.time_s[70] <= first.after_s


def test_a_steady_drift_is_neither_a_jump_nor_a_wander(small):
    assert shown(small, small.survey.poses).wander is None
    drift_m = np.outer(np.linspace(0.0, 5.0, POSES), [POSITION_M, 0.0, 0.0])
    found = shown(small, replace(small, readings=in_order(small.readings, drift_m)).survey.poses)
    assert found.wander is None
    assert found.has_drift


@pytest.mark.slow
def test_a_step_over_a_night_is_neither_a_drift_nor_growth(small):
    readings = in_order(small.readings, jump(60, 6.0))
    late = np.arange(POSES) >= 60
    states = readings.states
    states = replace(
        states,
        time_s=states.time_s + 43_200.0 * late,
        temperature_C=states.temperature_C + 1.0 * late,
    )
    given = Prepared(
        readings.with_states(states), None, small.baseline, small.setup, "masses", False
    )
    found = discover_by_blocks(given)
    (fault,) = found.faults
    assert found.effects == ()
    assert found.scorer.survey.wander.jumps[0].pause
    assert "in a pause of 12 h, at once or in the course of it" in fault.what


def test_few_repeats_leave_the_noise_what_the_parameters_leave(small, monkeypatch):
    poses = small.survey.poses
    pose, arrival = poses.pose.copy(), poses.states.arrival.copy()
    pose[1], arrival[1] = pose[0], arrival[0]  # else no error that readings share is tried
    poses = replace(poses.with_states(replace(poses.states, arrival=arrival)), pose=pose)
    noise = []

    def estimated(rows, *, walks):
        del walks
        noise.append(rows.about(Wander(rows.times_s, ())).noise_scale)
        return NO_MOTION

    monkeypatch.setattr(in_time, "_motion_in", estimated)
    shown(small, poses)
    assert noise == pytest.approx([1.0], abs=0.1)


@pytest.mark.parametrize("why", ["time goes with place", "time was not recorded"])
def test_nothing_is_said_of_time_where_there_is_none(small, why):
    poses = in_order(small.survey.poses, jump(70, 10.0))
    if why == "time goes with place":
        states = replace(poses.states, q_rad=np.linspace(-1.0, 1.0, POSES)[:, None] * np.ones(6))
    else:
        states = replace(poses.states, timed=np.zeros(POSES, dtype=bool))
    found = shown(small, poses.with_states(states))
    assert found.wander is None
    assert found.rivals == ()


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("order", ["random", "one side, then the other"])
def test_a_jump_is_told_of_time_only_where_no_joint_goes_with_it(small, order):
    poses = small.survey.poses
    states, first = poses.states, 70
    key = states.time_s
    if order != "random":
        there = states.q_rad[:, 1] < 0.0
        key, first = key - 1e9 * there, np.sum(there)
    rank = np.argsort(np.argsort(key, kind="stable"), kind="stable")
    poses = poses.with_states(replace(states, time_s=np.sort(states.time_s)[rank]))
    found = shown(small, shifted(poses, jump(first, 10.0)[rank]))
    if order == "random":
        assert len(found.wander.jumps) == 1
        assert found.rivals == ()
    else:
        assert found.wander is None
        assert found.rivals == ("joint 2",)
        (told,) = motion_unexplained(found, None, 0.0)
        assert "joint 2" in told.why
        assert "in random order" in told.why
