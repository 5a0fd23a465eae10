"""Repeats of one command and the columns that say when and where."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pa10cal.datasets.commands import command_columns, same_commands


def test_the_same_command_is_another_repeat_of_the_same_pose():
    q = np.array([[0.1, 0.2], [0.3, 0.4], [0.1, 0.2 + 5e-7], [0.1, 0.2 + 3e-6], [0.1, 0.2]])
    table = command_columns(np.arange(5.0), q)
    assert list(table["pose"]) == ["P00001", "P00002", "P00001", "P00003", "P00001"]
    assert list(table["repeat"]) == [1, 1, 2, 1, 3]
    assert list(table.columns[:5]) == ["time_s", "kind", "pose", "load_N", "repeat"]
    np.testing.assert_allclose(table["q2_deg"][0], np.degrees(0.2))
    assert set(table["kind"]) == {"grid"}


def test_labels_sort_as_text_in_order_of_time():
    q = 3.0 - 5e-5 * np.arange(100_001.0)[:, None]
    labels = list(command_columns(np.arange(len(q)) * 1.0, q)["pose"])
    assert labels == sorted(labels)
    assert labels[::100_000] == ["P000001", "P100001"]


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
