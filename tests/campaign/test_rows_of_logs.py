"""Rows of logs: none while the arm stands, several under one stamp, or twice."""

from __future__ import annotations

import numpy as np
import pytest

from made_up_sightings import is_read
from made_up_streams import streams
from pa10cal.campaign.read import read_campaign


@pytest.fixture
def written(tmp_path, proposed):
    """Write both logs, propose a campaign.yaml for them, and return its folder."""

    def run(logs):
        folder = tmp_path / "mine"
        proposed(*logs.write(folder), folder=folder)
        return folder

    return run


def test_a_log_that_is_written_on_change_holds_its_last_row(written):
    """While the arm stands no row is written: the last one is where it stands."""
    logs = streams(12, 50.0, 20.0, poses=20)
    names = logs.joints.columns[1:]
    logs.joints[names] = logs.joints[names].rolling(25, center=True, min_periods=1).mean().round(4)
    moved = (logs.joints[names].diff().abs() > 2e-4).any(axis=1)
    moved.iloc[0] = True
    logs.joints = logs.joints[moved]
    folder = written(logs)
    campaign = read_campaign(folder)
    assert any("has rows only where a joint changed" in note for note in campaign.notes)
    found = campaign.observations
    assert len(found) == len(logs.q_rad)  # where it stood before the first, and not at the last
    off_rad = np.abs(found.states.q_rad[:, None] - logs.q_rad[:-1]).max(axis=2).min(axis=0)
    assert off_rad.max() < 2e-5


def test_equal_samples_under_a_rounded_stamp_are_no_repeated_rows(written):
    """An arm at rest, logged in few digits with stamps in whole seconds."""
    logs = streams(13, 10.0, 10.0, poses=20, stands_s=(4.0, 6.0))
    logs.joints = logs.joints.round(3)
    for table in (logs.joints, logs.readings):
        table.iloc[:, 0] = np.floor(table.iloc[:, 0])
    folder = written(logs)
    found = read_campaign(folder)
    assert found.quarantined == ()
    assert is_read(found, logs.q_rad, logs.T_instr_target, atol_m=1e-3)


def test_rows_that_stand_there_twice_are_left_out_whatever_they_are(written):
    logs = streams(13, 10.0, 10.0, poses=20)
    twice = np.sort(np.r_[np.arange(len(logs.joints)), np.arange(0, len(logs.joints), 9)])
    logs.joints = logs.joints.iloc[twice]
    folder = written(logs)
    lines = [row for row in read_campaign(folder).quarantined if row.file == "controller.csv"]
    assert len(lines) == len(twice) - len(np.unique(twice))
