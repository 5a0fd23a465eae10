"""Joints in one log, readings in another: joined by time, label or row, and told when shifted."""

from __future__ import annotations

import re

import numpy as np
import pytest
import yaml

from made_up_two_logs import JOINTS, two_logs
from pa10cal.__main__ import main
from pa10cal.campaign.read import read_campaign
from pa10cal.errors import Pa10calError

#: Runs joined by time, and runs shifted by a row; a few of each in the quick suite.
JOINED, SHIFTED, QUICK = range(200), range(100), 4


def some(seeds):
    """Return seeds, of which a few are quick."""
    return [pytest.param(k, marks=[pytest.mark.slow] if k >= QUICK else []) for k in seeds]


@pytest.fixture
def proposed(tmp_path, capsys):
    """Write two logs, propose a campaign.yaml for them, and read the campaign so."""

    def run(logs, **how):
        folder = tmp_path / "mine"
        paths = logs.write(folder, **how)
        assert main(["columns", *map(str, paths), "--robot", "ur10"]) == 0
        text = capsys.readouterr().out
        (folder / "campaign.yaml").write_text(text, encoding="utf-8")
        return yaml.safe_load(text), text, folder

    return run


@pytest.mark.parametrize("seed", some(JOINED))
def test_clocks_that_are_hours_apart_are_joined_by_the_motion(tmp_path, proposed, seed):
    logs = two_logs(tmp_path, seed, dense=seed % 4 != 3, regular=seed % 5 == 4)
    content, text, folder = proposed(logs, sep=";", decimal=",")
    assert content["files"] == {"joints": "controller.csv", "readings": "tracker.csv"}
    found = read_campaign(folder)
    (note,) = (each for each in found.notes if "joined by time" in each)
    offset_s = float(re.search(r"readings ([-+]\d+\.\d+) s", note)[1])
    assert note in text
    read_s = logs.stood_s.mean(axis=1)
    width_s = np.ptp(logs.stood_s, axis=1).max()
    assert abs(offset_s - logs.offset_s) < 0.5 * width_s, (offset_s, logs.offset_s, read_s[:2])
    assert len(found.observations) >= 0.95 * len(logs.q_rad)
    order = np.argsort(found.observations.states.time_s)
    q_rad = found.observations.states.q_rad[order]
    if len(q_rad) == len(logs.q_rad):
        np.testing.assert_allclose(q_rad, logs.q_rad, atol=2e-4)


@pytest.mark.parametrize("seed", some(SHIFTED))
def test_a_row_that_is_missing_is_named(tmp_path, proposed, seed):
    """Readings a row away from their joints, from the start or from a place on."""
    rng = np.random.default_rng(seed)
    logs = two_logs(tmp_path, 1000 + seed, dense=False)
    joints, readings = (
        table.drop(columns=table.columns[0]) for table in (logs.joints, logs.readings)
    )
    place = 0 if seed % 3 == 0 else int(rng.integers(4, len(readings) - 4))
    lost = joints if seed % 2 else readings
    shorter = lost.drop(index=place).reset_index(drop=True)
    logs.joints, logs.readings = (shorter, readings) if seed % 2 else (joints, shorter)
    folder = tmp_path / "mine"
    logs.write(folder)
    (folder / "campaign.yaml").write_text(yaml.safe_dump(described()))
    with pytest.raises(Pa10calError) as refused:
        read_campaign(folder)
    assert "readings fit the joints of the row" in str(refused.value)
    (line,) = re.findall(r"tracker.csv:(\d+)", str(refused.value))
    assert abs(int(line) - 2 - place) <= 1


def described():
    return {
        "schema": "pa10cal-campaign/1",
        "name": "mine",
        "provenance": "synthetic",
        "robot": "ur10",
        "instrument": {"kind": "pose", "uncertainty_mm": 0.02},
        "tool": {"mass_kg": 0, "com_mm": [0, 0, 0], "load_point_mm": [0, 0, 0]},
        "gravity_m_s2": [0, 0, -9.81],
        "reference_temperature_C": 20,
        "files": {"joints": "controller.csv", "readings": "tracker.csv"},
        "holdout": {"every": 5},
        "columns": {
            "joints": {"joints": {"names": JOINTS}},
            "readings": {
                "position": {"names": ["X [mm]", "Y [mm]", "Z [mm]"]},
                "rotation": {"names": ["Rx [deg]", "Ry [deg]", "Rz [deg]"], "convention": "rpy"},
            },
        },
    }


def test_rows_that_belong_together_are_joined_by_row(tmp_path):
    logs = two_logs(tmp_path, 5, dense=False)
    logs.joints, logs.readings = (
        table.drop(columns=table.columns[0]) for table in (logs.joints, logs.readings)
    )
    folder = tmp_path / "mine"
    logs.write(folder)
    (folder / "campaign.yaml").write_text(yaml.safe_dump(described()))
    found = read_campaign(folder)
    assert any("joined by row" in note for note in found.notes)
    np.testing.assert_allclose(found.observations.states.q_rad, logs.q_rad, atol=2e-4)


def test_labels_join_whatever_the_order(tmp_path, proposed):
    logs = two_logs(tmp_path, 6, dense=False)
    names = [f"P{k:03d}" for k in range(len(logs.q_rad))]
    logs.joints, logs.readings = (
        table.drop(columns=table.columns[0]) for table in (logs.joints, logs.readings)
    )
    logs.joints.insert(0, "Punkt", names)
    logs.readings.insert(0, "Messpunkt", names)
    logs.joints = logs.joints.sample(frac=1.0, random_state=1)
    logs.readings = logs.readings.drop(index=[3, 17])
    _, text, folder = proposed(logs)
    assert "joined by label" in text
    found = read_campaign(folder).observations
    assert len(found) == len(names) - 2
    expected = dict(zip(names, logs.q_rad, strict=True))
    for pose, q_rad in zip(found.pose, found.states.q_rad, strict=True):
        np.testing.assert_allclose(q_rad, expected[pose], atol=2e-4)


def test_readings_while_the_arm_moved_are_left_out(tmp_path, proposed):
    logs = two_logs(tmp_path, 7, apart_s=0.0)
    at = logs.readings.columns[0]
    between = logs.stood_s[11, 0] - 0.8 - logs.stood_s[10, 1] + 0.4
    logs.readings.loc[10, at] = logs.readings.loc[11, at]  # of a dwell whose joints are others
    _, _, folder = proposed(logs)
    found = read_campaign(folder)
    assert between > 0.0
    assert len(found.observations) + len(found.quarantined) == len(logs.q_rad)


def test_directions_of_arrival_come_from_a_dense_log(tmp_path, proposed):
    logs = two_logs(tmp_path, 8)
    arrival = read_campaign(proposed(logs)[2]).observations.states.arrival
    assert np.abs(arrival).mean() > 0.9


def test_logs_of_two_runs_are_refused(tmp_path):
    logs, other = two_logs(tmp_path, 9), two_logs(tmp_path / "other", 10, apart_s=0.0)
    logs.readings = other.readings.iloc[::2].copy()
    rng = np.random.default_rng(1)
    stamps = logs.readings.columns[0]
    logs.readings[stamps] = rng.permutation(logs.readings[stamps].to_numpy())
    folder = tmp_path / "mine"
    logs.write(folder)
    content = described()
    content["columns"]["joints"]["time"] = {"names": "Zeit [s]"}
    content["columns"]["readings"]["time"] = {"names": stamps, "format": "%d.%m.%Y %H:%M:%S.%f"}
    (folder / "campaign.yaml").write_text(yaml.safe_dump(content))
    try:
        found = read_campaign(folder)
    except Pa10calError:
        return
    assert any("off in the median" in warning for warning in found.warnings)
