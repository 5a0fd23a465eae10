"""What moved between repeats, whatever single readings are far off."""

import numpy as np

from made_up_arm import TARGET_NOISE_M
from pa10cal.discovery.in_time.wander import moved_between_repeats
from pa10cal.discovery.linear import residual
from pa10cal.discovery.noise import same_circumstances


def moved(null, by_m):
    readings = null.readings
    left = residual(null.baseline, readings)
    left[:, :3] += by_m
    return moved_between_repeats(readings, left, same_circumstances(readings))


def test_nothing_moves_where_nothing_moved(null):
    assert not moved(null, 0.0).any()


def test_single_readings_far_off_are_no_motion(null):
    off_m = np.zeros((len(null.readings), 3))
    off_m[::40] = 8e-3
    assert not moved(null, off_m).any()


def test_a_jump_is_one(null):
    time_s = null.readings.states.time_s
    late = time_s >= np.median(time_s)
    found = moved(null, np.outer(late, [20 * TARGET_NOISE_M, 0.0, 0.0]))[:, 0]
    apart_m = np.median(found[late]) - np.median(found[~late])
    assert 0.5 < apart_m / (20 * TARGET_NOISE_M) < 1.1  # medians of few repeats take a part
