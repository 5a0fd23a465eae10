"""Joints and readings that both go on while the arm moves: dwells, clocks, what is set aside."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np
import pytest
import yaml

import made_up_streams
from made_up_formats import TAKES
from made_up_sightings import is_read
from made_up_streams import streams
from pa10cal.campaign.read import read_campaign
from pa10cal.campaign.sampling import goes_on, is_of_motion
from pa10cal.campaign.streams import clock_by_edges, reading_dwells
from pa10cal.errors import Pa10calError

pytestmark = pytest.mark.usefixtures("tried")

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


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize("hertz", [(20.0, 20.0), (10.0, 240.0), (500.0, 20.0)])
def test_logs_of_any_length_are_logs_of_motion(written, hertz):
    """Twelve thousand rows in both are no twelve thousand steady phases."""
    logs = streams(5, *hertz, poses=30)
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
    text, folder = written(streams(8, 50.0, 100.0, poses=30, stands_s=(stands_s, stands_s)))
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


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("hertz", [(4.0, 2.0), (50.0, 1.0)])
def test_an_instrument_that_runs_freely_is_a_stream_however_slow(written, hertz):
    """Its readings at the arm's stands are averaged; those on the way are no configurations."""
    logs = streams(12, *hertz, poses=20, stands_s=(5.0, 12.0))
    text, folder = written(logs)
    # Before the first pose it stood for a second only.
    assert re.search("in 2[01] of 21 steady phases and are averaged", text)
    offset_s, two_u_s = clock_in(text)
    assert abs(offset_s - logs.offsets_s[0]) <= max(two_u_s, 0.003)
    found = read_campaign(folder)
    assert found.quarantined == ()
    assert is_read(found, logs.q_rad, logs.T_instr_target, atol_m=2e-4)


def middles_of_stands(logs):
    """Return the reading in the middle of every stand."""
    step_m = np.linalg.norm(np.diff(logs.T_read[:, :3, 3], axis=0), axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], step_m < 5e-4, [0]])))
    stands = [(a, b) for a, b in edges.reshape(-1, 2).tolist() if b - a > 20]
    return np.array([(a + b) // 2 for a, b in stands])


def test_readings_triggered_some_times_a_stand_are_no_stream(written):
    """Three of each stand, a tenth of a second apart, are repeats of its pose."""
    logs = streams(13, 50.0, 20.0, poses=40)
    rows = (middles_of_stands(logs)[:, None] + [-2, 0, 2]).ravel()
    logs.readings = logs.readings.iloc[rows]
    text, folder = written(logs)
    assert f"{len(rows)} of {len(rows)} readings lie in" in text
    found = read_campaign(folder)
    assert found.quarantined == ()
    assert is_read(found, logs.q_rad, logs.T_instr_target, atol_m=2e-4)


@pytest.mark.parametrize("which", ["joints", "readings"])
def test_times_that_cannot_be_seconds_are_asked_about(written, which):
    """A log in milliseconds under a header without a unit would be of an arm that creeps."""
    logs = streams(14, 50.0, 20.0, poses=12)
    table, name = getattr(logs, which), {"joints": "t [s]", "readings": "Time [s]"}[which]
    table[name] = (1e3 * table[name]).round()
    setattr(logs, which, table.rename(columns={name: "time"}))
    text, folder = written(logs)
    assert "cannot be in the unit" in text
    with pytest.raises(Pa10calError, match="cannot be in the unit") as refused:
        read_campaign(folder)
    assert f"columns.{which}.time" in refused.value.remedy
    assert "ms" in refused.value.remedy
    description = folder / "campaign.yaml"
    content = yaml.safe_load(description.read_text())
    content["columns"][which]["time"]["unit"] = "ms"
    description.write_text(yaml.safe_dump(content))
    assert is_read(read_campaign(folder), logs.q_rad, logs.T_instr_target, atol_m=2e-4)


def test_a_stand_is_used_when_the_first_of_two_targets_is_hidden_there(written):
    logs = streams(15, 50.0, 20.0, poses=20)
    table = logs.readings
    second = 1e3 * (logs.T_read[:, :3, 3] + logs.T_read[:, :3, 0] * 0.1)
    table.columns = ["Time [s]", *(f"T1_{axis} [mm]" for axis in "XYZ")]
    for k, axis in enumerate("XYZ"):
        table[f"T2_{axis} [mm]"] = second[:, k]
    middles = middles_of_stands(logs)
    hidden = slice(middles[6] - 15, middles[8] + 15)
    table.iloc[hidden, 1:4] = np.nan
    table.iloc[middles[12] : middles[14], 4:] = np.nan
    text, folder = written(logs)
    assert "in 21 of 21 steady phases" in text
    assert len(read_campaign(folder).observations) == 21


def test_stands_that_are_too_short_for_the_readings_are_told(written):
    """What is left of them is read; that most are lost is a warning, not only a number."""
    logs = streams(16, 50.0, 4.0, poses=60, stands_s=(0.3, 0.9))
    _, folder = written(logs)
    found = read_campaign(folder)
    assert len(found.observations) < 0.8 * len(logs.q_rad)
    (told,) = [text for text in found.warnings if "at which the arm stood are lost" in text]
    assert "readings are 0.25 s apart" in told
    assert is_read_where_it_is(found, logs)


def is_read_where_it_is(found, logs):
    """Return whether all that is read belongs to the pose that it is read at."""
    q_rad = found.observations.states.q_rad
    k = np.abs(q_rad[:, None] - logs.q_rad).max(axis=2).argmin(axis=1)
    known = np.abs(q_rad - logs.q_rad[k]).max(axis=1) < 1e-4  # not where it stood before the first
    off_m = found.observations.measured.places_m[:, 0] - logs.T_instr_target[k, :3, 3]
    return bool(np.linalg.norm(off_m[known], axis=1).max() < 3e-4)


def test_a_clock_by_edges_is_as_uncertain_as_sampling_at_one_rate():
    """Both logs are sampled at the same instants of a quarter of a second, but for a shift."""
    begin_s = np.cumsum(np.full(30, 3.5))
    instants_s = np.arange(0.0, 110.0, 0.25)

    def dwells(shift_s):
        at_s = instants_s + shift_s
        part = np.clip(at_s[:, None] - begin_s, 0.0, 1.0)  # of each move of a second
        place_mm = 50.0 * part.sum(axis=1, keepdims=True)
        return reading_dwells(instants_s, np.repeat(place_mm, 3, axis=1))

    for shift_s in (0.05, 0.11, 0.2):
        of_readings, of_arm = dwells(shift_s), dwells(0.0)
        station = np.arange(len(of_readings))
        assert len(of_readings) == len(of_arm)
        offset_s, u_s = clock_by_edges(of_readings, of_arm, station, (0.25, 0.25))
        assert abs(offset_s - shift_s) < 2.0 * u_s < 0.3


def test_a_list_at_regular_times_is_no_stream():
    """A programme takes as long for every reading; each second pose is read twice."""
    rng = np.random.default_rng(3)
    q_deg = rng.uniform(-60.0, 60.0, (100, 6))
    rows = np.sort(np.concatenate([np.arange(100), np.arange(0, 100, 2)]))
    listed = q_deg[rows] + rng.normal(0.0, 1e-3, (len(rows), 6))
    time_s = 4.0 * np.arange(len(rows))
    assert not is_of_motion(time_s, listed)
    assert not goes_on(time_s, listed)
    on_the_way = np.repeat(np.linspace(0.0, 1.0, 4)[1:], 6).reshape(3, 6)
    moved = [q + on_the_way * (after - q) for q, after in pairwise(q_deg)]
    of_motion = np.vstack([np.vstack([way, way[-1:], way[-1:]]) for way in moved])
    assert goes_on(0.5 * np.arange(len(of_motion)), of_motion)


def test_a_stream_with_one_reading_a_stand_is_refused_for_that(written):
    """Neither units nor runs are wrong: the arm stands too briefly for these readings."""
    text, folder = written(streams(17, 50.0, 0.5, poses=80, stands_s=(1.0, 2.0)))
    assert "it is refused" in text
    with pytest.raises(Pa10calError, match="go on while the arm moves") as refused:
        read_campaign(folder)
    assert "stand longer" in refused.value.remedy
    assert "readings 2 s apart" in str(refused.value)


def test_dwells_of_which_the_log_of_joints_shows_no_stand_are_told(written):
    logs = streams(18, 50.0, 20.0)
    logs.joints = logs.joints.iloc[: int(0.65 * len(logs.joints))]
    _, folder = written(logs)
    (told,) = [text for text in read_campaign(folder).warnings if "the target was at rest" in text]
    assert "controller.csv shows no stand of the arm then" in told
