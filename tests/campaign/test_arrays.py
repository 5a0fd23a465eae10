"""Files of arrays: MATLAB, NumPy, JSON, and the tables of lerobot."""

from __future__ import annotations

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from made_up_arrays import ARRAYS, MOTORS, lerobot_info, lerobot_table, mat_file
from made_up_sightings import rows_of, sighted
from pa10cal.campaign.read import read_campaign
from pa10cal.campaign.text_lines import lines_of
from pa10cal.errors import Pa10calError


def places(raw):
    """Return a list of places in mm."""
    return rows_of(1e3 * raw.T_instr_target[:, :3, 3], names="X,Y,Z", sep=",")


@pytest.mark.slow_but_one_in(100)
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (k % 3 > 0)) for k, name in enumerate(ARRAYS)],
)
def test_arrays_are_read_as_columns(tmp_path, proposed, name):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    (tmp_path / name).write_bytes(ARRAYS[name](np.degrees(raw.q), raw.T_instr_target))
    out = proposed(name)
    first = {"m": "MATLAB file", "n": "NumPy file", "j": "JSON"}[name.rpartition(".")[2][0]]
    assert out.startswith(f"# {name}: {first}")
    found = read_campaign(tmp_path)
    assert found.quarantined == ()
    observations = found.observations
    order = np.argsort(observations.states.time_s)
    np.testing.assert_allclose(observations.states.q_rad[order], raw.q, atol=1e-9)
    turned = yaml.safe_load(out)["instrument"]["kind"] == "pose"
    places = observations.measured.T_instr_target if turned else observations.measured.places_m
    places = places[order, :3, 3] if turned else places[order, 0]
    np.testing.assert_allclose(places, raw.T_instr_target[:, :3, 3], atol=1e-9)


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize(
    ("beside", "names"),
    [("meta/info.json", list), ("info.json", lambda motors: {"motors": list(motors)})],
)
def test_tables_of_lerobot_have_the_names_that_stand_beside_them(tmp_path, proposed, beside, names):
    """Motors in the order of the alphabet, single precision, joined with a tracker by the time."""
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    time_s = 10.0 * np.arange(len(raw.q))
    order = np.argsort(MOTORS)
    state = np.degrees(raw.q)[:, order]
    (tmp_path / "episode_000000.parquet").write_bytes(lerobot_table(time_s, state))
    (tmp_path / "meta").mkdir()
    called = names([f"{MOTORS[k]}.pos" for k in order])
    (tmp_path / beside).write_text(lerobot_info(called))
    places_mm = 1e3 * raw.T_instr_target[:, :3, 3]
    tracker = rows_of(time_s, places_mm, names="t [s];X [mm];Y [mm];Z [mm]", sep=";")
    (tmp_path / "tracker.csv").write_text(tracker)
    out = proposed("episode_000000.parquet", "tracker.csv")
    assert "Parquet table, as lerobot writes it" in out
    joints = yaml.safe_load(out)["columns"]["joints"]["joints"]
    assert joints == {"names": [f"{name}.pos" for name in MOTORS], "unit": "deg"}
    states = read_campaign(tmp_path).observations.states
    np.testing.assert_allclose(states.q_rad[np.argsort(states.time_s)], raw.q, atol=1e-6)


def test_states_of_lerobot_without_names_are_joints_in_order(tmp_path, proposed):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    (tmp_path / "a.parquet").write_bytes(lerobot_table(np.arange(40.0), np.degrees(raw.q)))
    (tmp_path / "b.csv").write_text(places(raw))
    out = proposed("a.parquet", "b.csv")
    names = [f"observation.state_{k}" for k in range(1, 7)]
    assert yaml.safe_load(out)["columns"]["joints"]["joints"]["names"] == names


def test_time_that_begins_anew_in_each_episode_is_none(tmp_path, proposed):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    time_s = np.tile(np.arange(20.0), 2)
    table = lerobot_table(time_s, np.degrees(raw.q), np.repeat([0, 1], 20))
    (tmp_path / "a.parquet").write_bytes(table)
    (tmp_path / "b.csv").write_text(places(raw))
    out = proposed("a.parquet", "b.csv")
    assert "timestamp (it begins anew in each of 2 episodes) not read" in out
    assert "time" not in yaml.safe_load(out)["columns"]["joints"]
    assert len(read_campaign(tmp_path).observations) == 40


def test_what_is_not_read_is_named(tmp_path, proposed):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    variables = {"q": raw.q, "p": raw.T_instr_target[:, :3, 3], "other": np.zeros((7, 5))}
    (tmp_path / "a.mat").write_bytes(mat_file(variables, packed=True))
    assert "; other not read" in proposed("a.mat").splitlines()[0]


@pytest.mark.slow_but_one_in(7)
@pytest.mark.parametrize("name", [*ARRAYS, "a.parquet"])
@pytest.mark.parametrize("share", [0.3, pytest.param(0.9, marks=pytest.mark.slow)])
def test_a_file_of_arrays_that_was_cut_is_refused(tmp_path, name, share):
    raw = sighted(tmp_path, "pose")
    if name == "a.parquet":
        whole = lerobot_table(np.arange(40.0), np.degrees(raw.q))
    else:
        whole = ARRAYS[name](np.degrees(raw.q), raw.T_instr_target)
    (tmp_path / name).write_bytes(whole[: max(int(share * len(whole)), 140)])
    with pytest.raises(Pa10calError, match=rf"{name}.*(cannot be read|cut short).*; allowed: "):
        list(lines_of(tmp_path / name))


HDF5 = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n" + bytes(600)
UNFIT = {
    "a.mat": (HDF5, r"a\.mat: the file is HDF5.*save\('name\.mat', '-v7'\)"),
    "a.h5": (HDF5[512:], r"a\.h5: the file is HDF5"),
    "b.mat": (mat_file({}, packed=False), r"b\.mat: the MATLAB file holds no arrays"),
    "c.mat": (mat_file({"a": np.eye(3)}, packed=True)[:-9], r"c\.mat: the MATLAB file cannot be"),
    "pickled.npy": (b"\x93NUMPY\x01\x00" + b"junk" * 40, r"pickled\.npy: the NumPy file cannot be"),
    "a.parquet": (b"PAR1" + bytes(300) + b"PAR1", r"a\.parquet: the Parquet file cannot be read"),
    "a.json": (b'{"q": [[1, 2],\n[3, 4]', r"a\.json:2: the JSON file is cut short"),
    "b.jsonl": (b'{"q": [1, 2]}\n{"q": [3', r"b\.jsonl:2: the JSON file is cut short"),
    "b.json": (
        json.dumps({"about": "nothing"}).encode(),
        r"b\.json: the JSON file holds no arrays",
    ),
}


@pytest.mark.slow_but_one_in(5)
@pytest.mark.parametrize("name", UNFIT)
def test_what_holds_no_arrays_is_refused_with_what_to_do(tmp_path, name):
    content, told = UNFIT[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(Pa10calError, match=told):
        list(lines_of(tmp_path / name))


def test_ticks_of_motors_are_counts(tmp_path, proposed):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    ticks = np.round(2048 + raw.q / (2.0 * np.pi) * 4096)
    (tmp_path / "a.parquet").write_bytes(lerobot_table(np.arange(40.0), ticks))
    (tmp_path / "info.json").write_text(lerobot_info(list(MOTORS)))
    (tmp_path / "b.csv").write_text(places(raw))
    out = proposed("a.parquet", "b.csv")
    joints = yaml.safe_load(out)["columns"]["joints"]["joints"]
    assert joints["names"] == list(MOTORS)
    assert (joints["unit"], joints["counts_per_turn"], joints["zero_count"]) == (
        "counts",
        4096,
        2048,
    )


@pytest.mark.slow
def test_a_few_bytes_that_unpack_to_gigabytes_are_refused(tmp_path):
    with pq.ParquetWriter(tmp_path / "a.parquet", pa.schema([("x", pa.float64())])) as file:
        part = pa.table({"x": np.zeros(5_000_000)})
        for _ in range(40):
            file.write_table(part)
    assert (tmp_path / "a.parquet").stat().st_size < 1e6
    (tmp_path / "deep.json").write_text('{"a":' * 100_000)
    with pytest.raises(Pa10calError, match="needs more memory"):
        list(lines_of(tmp_path / "a.parquet"))
    with pytest.raises(Pa10calError, match="cannot be read"):
        list(lines_of(tmp_path / "deep.json"))
