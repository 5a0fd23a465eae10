"""Joint positions logged as counts of an encoder."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from made_up_sightings import sighted
from mended import mend
from pa10cal.__main__ import main
from pa10cal.campaign.joint_positions import looks_like_counts, scale_of_counts
from pa10cal.campaign.read import read_campaign
from pa10cal.errors import Pa10calError
from pa10cal.files.arms import load_arm

Q = [f"q{j}_deg" for j in range(1, 7)]
OWN = [f"servo{j}" for j in range(1, 7)]


def logged(raw, per_turn, zero, signs=1.0):
    """Return joint positions of a campaign as whole counts."""
    return np.round(signs * np.degrees(raw.q) * per_turn / 360.0 + zero)


@pytest.fixture
def counted(tmp_path):
    """Write a campaign whose joints are counts."""

    def write(per_turn, zero, signs=1.0, names=OWN):
        raw = sighted(tmp_path, "points", robot="irb120", targets=1)
        folder = raw.write()

        def count(table):
            table.put(Q, logged(raw, per_turn, zero, signs))
            table.header = [dict(zip(Q, names, strict=True)).get(n, n) for n in table.header]
            for row in table.rows:
                row[:] = [text.removesuffix(".0") for text in row]

        mend(folder, "poses.csv", count)
        return raw, folder

    return write


@pytest.mark.slow
@pytest.mark.parametrize(
    ("per_turn", "zero", "signs"),
    [
        (4096.0, 2048.0, 1.0),
        (65536.0, 0.0, [1, -1, 1, 1, -1, 1]),
        (36000.0, 0.0, 1.0),
        (1228.8, 512.0, 1.0),  # 1024 over 300 degrees
        (4000.0, 1500.0, 1.0),  # microseconds of a pulse
    ],
)
def test_counts_are_proposed_with_the_scale_that_the_arm_shows(
    tmp_path, counted, capsys, per_turn, zero, signs
):
    raw, folder = counted(per_turn, zero, np.array(signs))
    (folder / "campaign.yaml").unlink()
    assert main(["columns", str(folder / "poses.csv"), "--robot", "irb120"]) == 0
    text = capsys.readouterr().out
    (folder / "campaign.yaml").write_text(text, encoding="utf-8")
    content = yaml.safe_load(text)
    joints = content["columns"]["poses"]["joints"]
    assert (joints["unit"], joints["counts_per_turn"], joints["zero_count"]) == (
        "counts",
        per_turn,
        zero,
    )
    assert content.get("joint_signs", 1.0) == signs
    assert f"# check joints.counts_per_turn: {per_turn:g} counts" in text
    every = read_campaign(folder).observations
    order = np.argsort(every.states.time_s)
    half_rad = np.pi / per_turn
    np.testing.assert_allclose(every.states.q_rad[order], raw.q, atol=1.01 * half_rad)


def test_without_the_arm_the_numbers_alone_give_a_scale():
    counts = np.array([[100.0, 3900.0], [2000.0, 2100.0]])
    scale = scale_of_counts(counts, None, None)
    assert (scale.per_turn, scale.zero) == (4096.0, 2048.0)
    assert scale_of_counts(counts - 2048.0, None, None).zero == 0.0
    arm = load_arm("gx4_351s")
    nowhere = scale_of_counts(np.tile(counts, 2), arm, np.full((2, 3), np.nan))
    assert (nowhere.per_turn, nowhere.misfit_m) == (4096.0, np.inf)


@pytest.mark.parametrize(
    ("values", "counts"),
    [([[0, 359]], False), ([[0.5, 4000]], False), ([[np.nan, 4000]], True), ([[np.nan]], False)],
)
def test_counts_are_whole_and_large(values, counts):
    assert looks_like_counts(np.array(values, dtype=float)) == counts


JOINTS = {"names": OWN, "unit": "counts", "counts_per_turn": 4096, "zero_count": 2048}


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({}, None),
        ({"counts_per_turn": [4096] * 6, "zero_count": [2048] * 6}, None),
        ({"counts_per_turn": None}, "counts_per_turn"),
        ({"counts_per_turn": 0}, "counts_per_turn"),
        ({"counts_per_turn": -4096}, "counts_per_turn"),
        ({"counts_per_turn": "many"}, "counts_per_turn"),
        ({"counts_per_turn": [4096, 4096]}, "one for each joint"),
        ({"zero_count": [0] * 7}, "one for each joint"),
        ({"zero_count": float("inf")}, "zero_count"),
        ({"unit": "deg"}, "counts_per_turn with unit: counts"),
        ({"counts_per_turn": 256}, "beyond the limits of joint"),
    ],
)
def test_a_scale_is_stated_once_or_for_each_joint(counted, changed, says):
    raw, folder = counted(4096.0, 2048.0)
    stated = {key: value for key, value in (JOINTS | changed).items() if value is not None}
    path = folder / "campaign.yaml"
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    places = {"T1": {"names": [f"T1_{axis}_mm" for axis in "xyz"]}}
    labels = {"pose": "pose", "repeat": "repeat", "kind": {"names": "kind"}}
    time = {"time": {"names": "time_s"}, "load": {"names": "load_N"}}
    content["columns"] = {"poses": {"joints": stated, "targets": places, **labels, **time}}
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    if says is not None:
        with pytest.raises(Pa10calError, match=says):
            read_campaign(folder)
        return
    every = read_campaign(folder).observations
    order = np.argsort(every.states.time_s)
    np.testing.assert_allclose(every.states.q_rad[order], raw.q, atol=1.01 * np.pi / 4096.0)
