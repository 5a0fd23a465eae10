"""Joints and readings that both go on while the arm moves: dwells, clocks, what is set aside."""

from __future__ import annotations

import re

import numpy as np
import pytest
import yaml

import made_up_streams
from made_up_formats import TAKES
from made_up_sightings import is_read
from made_up_streams import streams
from pa10cal.campaign.read import read_campaign
from pa10cal.errors import Pa10calError

#: Pairs of rates drawn, and those of the quick suite.
PAIRS, QUICK = 60, 1


def drawn_rates(seed):
    """Return rates of the joints' log and of the readings in Hz."""
    rng = np.random.default_rng(1000 + seed)
    return np.exp(rng.uniform(np.log([10.0, 20.0]), np.log([500.0, 240.0])))


@pytest.fixture
def written(tmp_path, proposed):
    """Write both logs, and propose a campaign.yaml for them."""

    def run(logs, paths=None):
        folder = tmp_path / "mine"
        return proposed(*(paths or logs.write(folder)), folder=folder), folder

    return run


def clock_in(text):
    """Return the offset at the first reading, and twice its uncertainty."""
    found = re.search(r"clock is that of the readings ([-+]\d+\.\d+) s ± ([\d.e-]+) s", text)
    return float(found[1]), float(found[2])


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize("pairs", [QUICK, pytest.param(PAIRS, marks=pytest.mark.slow)])
@pytest.mark.parametrize("ppm", [0.0, 50.0])
def test_the_clock_is_found_within_its_uncertainty(written, ppm, pairs):
    """Of pairs of rates that are drawn, 95 of 100 clocks lie within what is stated."""
    inside = 0
    for seed in range(pairs):
        logs = streams(seed, *drawn_rates(seed), poses=20, ppm=ppm)
        text, folder = written(logs)
        offset_s, two_u_s = clock_in(text)
        assert two_u_s < 0.01
        inside += abs(offset_s - logs.offsets_s[0]) <= two_u_s
        found = read_campaign(folder)
        assert found.quarantined == ()
        assert is_read(found, logs.q_rad, logs.T_instr_target, atol_m=2e-4)
        assert len(found.observations) == len(logs.q_rad) + 1  # where it stood before the first too
        told = r"and ([-+]\d+\.\d+) s at the last: it runs (\d+) ± (\S+) ppm fast"
        last = re.search(told, text)
        assert (last is not None) == bool(ppm)
        if last is not None:
            assert abs(float(last[1]) - logs.offsets_s[1]) <= 2.0 * two_u_s
            assert abs(float(last[2]) - ppm) <= 1.0 + 1.5 * float(last[3])
    print(f"{inside} of {pairs} clocks within their 95 %, at {ppm:g} ppm")
    assert inside >= 0.95 * pairs


@pytest.mark.slow_but_one_in(6)
@pytest.mark.parametrize("stands_s", [0.5, 0.8])
@pytest.mark.parametrize("hertz", [(20.0, 20.0), (125.0, 60.0), (500.0, 240.0)])
def test_dwells_below_a_second_are_found(written, stands_s, hertz):
    logs = streams(4, *hertz, poses=20, stands_s=(stands_s, stands_s))
    text, folder = written(logs)
    offset_s, two_u_s = clock_in(text)
    assert abs(offset_s - logs.offsets_s[0]) <= two_u_s
    found = read_campaign(folder)
    assert found.quarantined == ()
    assert is_read(found, logs.q_rad, logs.T_instr_target, atol_m=2e-4)
    assert len(found.observations) == len(logs.q_rad) + 1


@pytest.mark.slow
def test_readings_in_motion_are_set_aside_and_counted(written):
    logs = streams(2, 100.0, 100.0)
    text, folder = written(logs)
    said = re.search(r"(\d+) of (\d+) readings lie in (\d+) of (\d+) steady phases", text)
    used, count, here, phases = map(int, said.groups())
    assert count == len(logs.readings)
    assert f"{count - used} are set aside" in text
    assert here == phases == len(logs.q_rad) + 1  # where it stood before the first pose too
    assert 0.3 * count < used < 0.9 * count
    assert len(read_campaign(folder).observations) == here


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize("hertz", [(20.0, 20.0), (10.0, 240.0), (500.0, 20.0)])
def test_logs_of_any_length_are_logs_of_motion(written, hertz):
    """Twelve thousand rows in both are no twelve thousand steady phases."""
    logs = streams(5, *hertz)
    text, folder = written(logs)
    assert "in 31 of 31 steady phases" in text
    assert is_read(read_campaign(folder), logs.q_rad, logs.T_instr_target, atol_m=2e-4)


def test_stamps_that_are_rounded_make_the_clock_uncertain(written, monkeypatch):
    monkeypatch.setattr(made_up_streams, "DECIMALS", 1)
    logs = streams(6, 120.0, 60.0)
    offset_s, two_u_s = clock_in(written(logs)[0])
    assert 0.05 < two_u_s < 0.07
    assert abs(offset_s - logs.offsets_s[0]) <= two_u_s


@pytest.mark.slow
def test_a_take_with_frames_lost_is_read_as_a_stream(tmp_path, written):
    logs = streams(7, 125.0, 120.0)
    folder = tmp_path / "mine"
    paths = logs.write(folder)
    rng = np.random.default_rng(0)
    lost = set(rng.choice(len(logs.readings), len(logs.readings) // 3, replace=False).tolist())
    time_s = logs.readings["Time [s]"].to_numpy()
    (folder / "take.csv").write_text(TAKES["motive"][0](time_s, logs.T_read, lost=lost))
    text, folder = written(logs, [paths[0], str(folder / "take.csv")])
    assert text.startswith("# take.csv: OptiTrack Motive")
    assert f"without the target in sight ({len(lost)})" in text
    assert yaml.safe_load(text)["instrument"]["kind"] == "pose"
    found = read_campaign(folder)
    assert found.quarantined == ()
    offset_s, two_u_s = clock_in(text)
    assert abs(offset_s - logs.offsets_s[0]) <= two_u_s
    T = found.observations.measured.T_instr_target
    for q, expected in zip(logs.q_rad, logs.T_instr_target, strict=True):
        k = int(np.argmin(np.abs(found.observations.states.q_rad - q).max(axis=1)))
        np.testing.assert_allclose(T[k, :3, :3], expected[:3, :3], atol=1e-5)
        np.testing.assert_allclose(T[k, :3, 3], expected[:3, 3], atol=1e-4)


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("stands_s", [0.0, 0.1])
def test_streams_without_a_dwell_are_refused(tmp_path, written, stands_s):
    told = "hardly stands still|never stands|never at rest"
    text, folder = written(streams(8, 50.0, 100.0, stands_s=(stands_s, stands_s)))
    with pytest.raises(Pa10calError, match=told) as refused:
        read_campaign(folder)
    assert re.search(r"(tracker|controller)\.csv", refused.value.where)
    assert "stand still at every pose" in refused.value.remedy
    assert "it is refused" in text


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("which", ["joints", "readings"])
def test_a_log_that_never_rests_is_named(tmp_path, written, which):
    """One of the logs goes on as from another run, without a rest."""
    logs, moving = streams(9, 50.0, 100.0), streams(10, 50.0, 100.0, stands_s=(0.0, 0.0))
    time_s = np.arange(len(moving.joints)) / 50.0
    if which == "joints":
        swing = 30.0 * np.sin(np.outer(time_s, 0.3 + 0.1 * np.arange(6)) + np.arange(6))
        logs.joints = logs.joints.iloc[: len(time_s)].copy()
        logs.joints.iloc[:, 1:] = swing[: len(logs.joints)]
    else:
        at_s = np.arange(len(logs.readings)) / 100.0
        swing = 300.0 * np.sin(np.outer(at_s, [0.5, 0.7, 0.9]))
        logs.readings.iloc[:, 1:] = swing
    _, folder = written(logs)
    with pytest.raises(Pa10calError) as refused:
        read_campaign(folder)
    assert refused.value.remedy


def test_a_clock_that_is_stated_is_taken(written):
    logs = streams(11, 60.0, 60.0)
    text, folder = written(logs)
    content = yaml.safe_load(text)
    content["join"] = {"by": "time", "clock_offset_s": logs.offsets_s[0]}
    (folder / "campaign.yaml").write_text(yaml.safe_dump(content))
    found = read_campaign(folder)
    assert any(f"{logs.offsets_s[0]:+.2f} s;" in note for note in found.notes)
    assert is_read(found, logs.q_rad, logs.T_instr_target, atol_m=2e-4)
