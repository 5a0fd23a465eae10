"""Orders that measured angles tell apart: as many as there are angles for."""

import numpy as np
import pytest

from pa10cal.figures.campaign.by_joint import highest_told

ORDERS = np.arange(0.5, 300.0, 0.5)


@pytest.mark.parametrize(("count", "turns"), [(21, 0.25), (101, 0.25), (101, 0.8)])
def test_two_angles_an_order_are_needed(count, turns):
    q_rad = 2.0 * np.pi * np.linspace(0.0, turns, count)
    cycles = turns * highest_told(ORDERS, q_rad)
    assert (count - 1) / 2 <= cycles < (count + 1) / 2


def test_repeats_of_an_angle_add_nothing():
    q_rad = 2.0 * np.pi * np.linspace(0.0, 0.25, 21)
    again = np.concatenate([q_rad, q_rad + 1e-6, q_rad - 1e-6])
    assert highest_told(ORDERS, again) == pytest.approx(highest_told(ORDERS, q_rad), abs=4.0)


def test_two_angles_tell_nothing():
    assert highest_told(ORDERS, np.array([0.0, 3.0])) < 4.0
