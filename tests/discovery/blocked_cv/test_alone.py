"""Effects of a group as each campaign alone has them: equal curves agree, others do not."""

from __future__ import annotations

import numpy as np
import pytest

from pa10cal.discovery.blocked_cv.by_campaign import ANGLES_RAD, pair_of, visited
from pa10cal.results.calibration import JointErrorAlone

EVERYWHERE = np.ones(len(ANGLES_RAD), dtype=bool)


def curve(error_rad, seen):
    return JointErrorAlone(error_mrad=1e3 * error_rad, visited=seen)


def wave(seed, least=5, most=25):
    rng = np.random.default_rng(seed)
    orders = np.arange(least, most)
    phases = rng.uniform(0.0, 2.0 * np.pi, len(orders))
    return np.cos(ANGLES_RAD[:, None] * orders + phases).sum(axis=1)


def test_the_same_error_agrees_whatever_its_mean():
    error = 1e-4 * wave(1)
    noise = 1e-5 * np.random.default_rng(2).normal(size=(2, len(error)))
    half = np.arange(len(error)) < 200
    found = pair_of(
        ("a", curve(error + noise[0] + 3e-3, EVERYWHERE)), ("b", curve(error + noise[1], half))
    )
    assert found.correlation > 0.99
    assert found.correlation95[0] < found.correlation < found.correlation95[1] <= 1.0
    assert found.slope95[0] < 1.0 < found.slope95[1]
    assert found.share_of_turn == pytest.approx(200 / 360)
    assert found.difference_rms_mrad == pytest.approx(np.sqrt(2.0) * 1e-2, rel=0.2)
    assert found.first_rms_mrad == pytest.approx(found.second_rms_mrad, rel=0.05)


@pytest.mark.parametrize(("orders", "seen"), [((5, 25), 360), ((1, 40), 360), ((5, 25), 240)])
def test_other_errors_seldom_seem_to_agree(orders, seen):
    """A 95 % interval that is right leaves out zero once in twenty times."""
    visited = np.arange(len(ANGLES_RAD)) < seen
    pairs = [
        pair_of(
            ("a", curve(wave(k, *orders), visited)), ("b", curve(wave(k + 1, *orders), visited))
        )
        for k in range(0, 160, 2)
    ]
    known = [pair.correlation95 for pair in pairs if pair.correlation95 is not None]
    assert len(known) > 40
    assert np.mean([low > 0.0 or high < 0.0 for low, high in known]) < 0.16


def test_errors_of_few_waves_a_turn_say_nothing_of_each_other():
    found = pair_of(
        ("a", curve(wave(1, 1, 3), EVERYWHERE)), ("b", curve(wave(2, 1, 3), EVERYWHERE))
    )
    assert found.correlation95 is None


def test_three_common_angles_say_nothing():
    three = np.isin(np.arange(len(ANGLES_RAD)), [10, 120, 250])
    found = pair_of(("a", curve(wave(1), three)), ("b", curve(wave(2), three)))
    assert (found.correlation, found.slope) == (None, None)


def test_the_slope_is_of_the_second_by_the_first():
    error = wave(3)
    found = pair_of(("a", curve(error, EVERYWHERE)), ("b", curve(2.0 * error, EVERYWHERE)))
    assert found.slope == pytest.approx(2.0)
    assert found.correlation == pytest.approx(1.0)


def test_few_angles_in_common_say_nothing():
    few = np.arange(len(ANGLES_RAD)) < 14
    found = pair_of(("a", curve(wave(1), few)), ("b", curve(wave(1), EVERYWHERE)))
    assert found.correlation is None
    assert found.share_of_turn == pytest.approx(14 / 360)


def test_a_curve_that_varies_in_one_arc_alone_says_nothing():
    one_arc = np.where(np.arange(len(ANGLES_RAD)) < 7, wave(1), 0.0)
    for a, b in ((one_arc, wave(2)), (wave(2), one_arc)):
        found = pair_of(("a", curve(a, EVERYWHERE)), ("b", curve(b, EVERYWHERE)))
        assert found.slope is None
        assert found.correlation95 is None
        assert found.share_of_turn == 1.0


def test_angles_are_visited_by_the_turn():
    q_rad = np.radians([0.1, -0.2, 359.0 + 360.0, 0.0, 90.0, 90.4, 90.1, 180.0])
    found = visited(np.concatenate([np.repeat(q_rad[:-1], 4), q_rad[-1:]]))
    assert found[[0, 1, 359, 90, 91]].all()
    assert not found[[45, 180, 270]].any()
