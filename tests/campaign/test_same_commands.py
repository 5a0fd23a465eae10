"""Readings of the same joint positions are repeats of one pose."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pa10cal.campaign.rows import labels, same_commands


def test_labels_sort_as_text_in_order_of_their_numbers():
    found = labels(np.arange(100_001))
    assert found == sorted(found)
    assert found[::100_000] == ["P000001", "P100001"]


@settings(deadline=None, max_examples=50)
@given(st.lists(st.integers(0, 5), min_size=1, max_size=30))
def test_commands_are_numbered_as_they_first_appear(which):
    commands = np.random.default_rng(7).uniform(-3, 3, (6, 6))
    order = list(dict.fromkeys(which))
    expected = [order.index(k) for k in which]
    assert same_commands(commands[which]).tolist() == expected


@pytest.mark.parametrize("apart_rad", [0.9e-6, 1.1e-6])
def test_a_millionth_of_a_radian_is_the_limit(apart_rad):
    q = np.array([[0.5e-6, 1.0], [0.5e-6 + apart_rad, 1.0]])
    assert same_commands(q).tolist() == [0, int(apart_rad > 1e-6)]
