"""What moved between readings of a pose is found, and called by what it is."""

import re

import numpy as np
import pytest

from made_up_arm import TARGET_NOISE_M
from pa10cal.discovery.gap import beside_motion
from pa10cal.discovery.linear import residual
from pa10cal.discovery.noise import same_circumstances
from pa10cal.discovery.row_faults import moved_between_repeats


def moved(measured, by_m):
    """Return the readings with the instrument shifted by (P, 3), of the readings' times."""
    T = measured.readings.measured.T_instr_target.copy()
    T[:, :3, 3] += by_m(measured.readings.states.time_s)
    return measured.readings.with_measured(T_instr_target=T)


def halfway(time_s, size_m):
    """Return a shift along x at the middle reading, and the times on either side."""
    order = np.sort(time_s)
    middle = len(order) // 2
    return np.outer(time_s >= order[middle], [size_m, 0.0, 0.0]), order[middle - 1 : middle + 1]


@pytest.fixture(scope="module")
def jumped(null):
    return null.discovered(readings=moved(null, lambda s: halfway(s, 6 * TARGET_NOISE_M)[0]))


def test_nothing_moves_where_nothing_moved(null):
    assert null.discovery.problem.in_time.wander is None
    assert null.discovery.faults == ()


@pytest.mark.slow
def test_a_jump_is_a_fault_of_the_log_with_its_time(null, jumped):
    (fault,) = jumped.faults
    times_s = halfway(null.readings.states.time_s, 1.0)[1]
    assert jumped.verdict == "check_the_log"
    assert jumped.effects == ()
    assert fault.kind == "step_in_time"
    assert all(f"at {time_s:g} s" in fault.where for time_s in times_s)
    (size_mm,) = re.findall(r"moved by (\S+) mm", fault.what)
    assert float(size_mm) == pytest.approx(6e3 * TARGET_NOISE_M, rel=0.15)


@pytest.mark.slow
def test_a_jump_is_no_noise(null, jumped):
    assert jumped.noise_floor_mm == pytest.approx(null.discovery.noise_floor_mm, rel=0.1)


@pytest.mark.slow
def test_what_the_motion_takes_away_stands_apart_from_the_gap(null, jumped):
    still = beside_motion(jumped.train)
    assert still.after.mean_mm == pytest.approx(null.discovery.train.after.mean_mm, rel=0.1)
    # The model that is written does not know when the base stood where.
    assert jumped.train.after.mean_mm > 1.1 * still.after.mean_mm
    assert null.discovery.train.without_motion is None


@pytest.mark.slow
def test_a_wander_is_unexplained(null):
    steps = np.random.default_rng(3).standard_normal((len(null.readings), 3))
    walk_m = TARGET_NOISE_M * np.cumsum(steps, axis=0)

    def wandering(time_s):
        return walk_m[np.argsort(np.argsort(time_s))]

    found = null.discovered(readings=moved(null, wandering))
    assert found.verdict == "unexplained"
    assert found.faults == ()
    assert found.effects == ()
    assert any("wandered by" in each.why for each in found.unexplained)


# What moved between repeats, whatever single readings are far off.


def between_repeats(null, by_m):
    readings = null.readings
    left = residual(null.baseline, readings)
    left[:, :3] += by_m
    return moved_between_repeats(readings, left, same_circumstances(readings))


def test_nothing_moves_between_repeats_where_nothing_moved(null):
    assert not between_repeats(null, 0.0).any()


def test_single_readings_far_off_are_no_motion(null):
    off_m = np.zeros((len(null.readings), 3))
    off_m[::40] = 8e-3
    assert not between_repeats(null, off_m).any()


def test_a_jump_is_one(null):
    time_s = null.readings.states.time_s
    late = time_s >= np.median(time_s)
    found = between_repeats(null, np.outer(late, [20 * TARGET_NOISE_M, 0.0, 0.0]))[:, 0]
    apart_m = np.median(found[late]) - np.median(found[~late])
    assert 0.5 < apart_m / (20 * TARGET_NOISE_M) < 1.1  # medians of few repeats take a part
