"""Logs joined by time of which a clock goes back or jumps once."""

from __future__ import annotations

import re

import numpy as np
import pytest

from made_up_sightings import is_read
from made_up_streams import streams
from made_up_two_logs import two_logs
from pa10cal.campaign.read import read_campaign
from pa10cal.errors import Pa10calError


@pytest.fixture
def read_of(tmp_path, proposed):
    """Write logs, and read the campaign that is proposed for them."""

    def run(logs):
        folder = tmp_path / "mine"
        paths = [str(path) for path in logs.write(folder)]
        proposed(*paths, folder=folder)
        return read_campaign(folder)

    return run


def jump_in(found):
    """Return file, signed size and line of the jump that is told; None for none."""
    told = r"the clock of (\S+) jumps (ahead|back) by (\d+\.\d+) s at line (\d+)"
    matches = [match for note in found.notes if (match := re.search(told, note))]
    if not matches:
        return None
    (match,) = matches
    return match[1], float(match[3]) * (1 if match[2] == "ahead" else -1), int(match[4])


def set_by(table, later, seconds):
    """Set the clock of a log, in its first column, from row `later` on."""
    name = table.columns[0]
    table[name] += np.where(np.arange(len(table)) >= later, seconds, 0.0)


@pytest.mark.parametrize(
    ("which", "seconds"),
    [
        ("joints", -3600.0),
        ("readings", 2.2),
        *(
            pytest.param(which, seconds, marks=pytest.mark.slow)
            for which, seconds in [
                ("joints", -25.0),
                ("joints", 2.2),
                ("readings", -3600.0),
                ("readings", -25.0),
            ]
        ),
    ],
)
def test_streams_are_joined_on_both_sides_of_a_jump(read_of, which, seconds):
    """Summer time ends, a controller starts anew, a clock is set: all stands are read."""
    logs = streams(21, 50.0, 20.0, poses=14)
    table = getattr(logs, which)
    later = int(0.45 * len(table))
    set_by(table, later, seconds)
    found = read_of(logs)
    file, size_s, line = jump_in(found)
    assert file == {"joints": "controller.csv", "readings": "tracker.csv"}[which]
    assert abs(size_s - seconds) < 0.03
    assert line == later + 2
    assert len(found.observations) == len(logs.q_rad) + 1
    assert is_read(found, logs.q_rad, logs.T_instr_target, atol_m=2e-4)


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("seconds", [-3600.0, 40.0])
def test_single_readings_are_joined_on_both_sides_of_a_jump(tmp_path, read_of, seconds):
    logs = two_logs(tmp_path, 3)
    later = len(logs.joints) // 2
    set_by(logs.joints, later, seconds)
    found = read_of(logs)
    file, size_s, line = jump_in(found)
    assert (file, line) == ("controller.csv", later + 2)
    assert abs(size_s - seconds) < 3.0  # less than half a stand
    order = np.argsort(found.observations.states.time_s)
    assert len(order) >= 0.95 * len(logs.q_rad)
    if len(order) == len(logs.q_rad):
        q_rad = found.observations.states.q_rad[order]
        np.testing.assert_allclose(q_rad, logs.q_rad, atol=2e-4)


def test_traces_put_together_in_the_wrong_order_are_no_jump(read_of):
    logs = streams(22, 50.0, 20.0, poses=14)
    half = len(logs.joints) // 2
    logs.joints = logs.joints.iloc[np.r_[half : len(logs.joints), :half]]
    found = read_of(logs)
    assert jump_in(found) is None
    assert len(found.observations) == len(logs.q_rad) + 1


def test_a_log_that_goes_back_and_is_of_another_run_is_told_where(read_of):
    logs = streams(23, 50.0, 20.0, poses=20, stands_s=(0.1, 0.1))
    set_by(logs.joints, 900, -10.0)
    with pytest.raises(Pa10calError, match=r"the clock of controller\.csv jumps back") as refused:
        read_of(logs)
    assert refused.value.where.endswith("controller.csv:902")
