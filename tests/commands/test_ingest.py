"""Stage ingest, in process: the shipped campaigns, refusals without any output."""

from __future__ import annotations

import csv
import gzip
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from made_up_sightings import sighted
from pa10cal.campaign.description import read_description
from pa10cal.campaign.table import read_observations, read_pose_table
from pa10cal.commands.command_line import REFUSED, run_command
from pa10cal.files.arms import arm_text, load_arm
from pa10cal.observe.observations import poses_of

RAW = Path(__file__).parents[2] / "data" / "raw"


def run(folder, out, settings="{}"):
    table, listing = out / "ingest" / "poses.parquet", out / "ingest" / "quarantine.csv"
    arguments = ["--campaign-dir", folder, "--settings", settings]
    arguments += ["--out", table, "--quarantine", listing]
    return run_command("ingest", [str(argument) for argument in arguments]), table, listing


def rows_of(listing):
    with listing.open(newline="") as lines:
        return list(csv.DictReader(lines))


@pytest.fixture(scope="module")
def cell_null(tmp_path_factory):
    status, table, listing = run(RAW / "cell-null", tmp_path_factory.mktemp("cell-null"))
    assert status == 0
    every = read_observations(table, read_description(RAW / "cell-null"))
    return read_pose_table(table), rows_of(listing), every


def test_a_clean_campaign_is_taken_whole(cell_null):
    table, left_out, _ = cell_null
    assert left_out == []
    assert table.groupby("kind").size().to_dict() == {
        "grid": 810,
        "holdout": 120,
        "line_x": 11,
        "line_y": 11,
    }
    assert (table[["ballA_touches", "ballB_touches", "ballC_touches"]] == 5).to_numpy().all()
    assert (table["dwell_samples"] == 12).all()
    assert (table[[f"s{j}" for j in range(1, 7)]].abs() == 1).to_numpy().all()


def test_repeats_of_a_clean_campaign_scatter_as_its_instrument_and_arm_do(cell_null):
    every = cell_null[2]
    single = poses_of(every, average=False)
    place = 1e3 * single.measured.T_instr_target[:, :3, 3].reshape(27, 3, 10, 3)
    distance = np.linalg.norm(place - place.mean(axis=2, keepdims=True), axis=3)
    assert distance.mean() == pytest.approx(0.027, abs=0.002)
    mean = poses_of(every)
    assert len(mean) == 81
    assert (mean.readings == 10).all()
    spread = np.sqrt(np.trace(mean.measured.cov[:, :3, :3], axis1=1, axis2=2))
    pooled = np.sqrt((distance**2).sum() / (27 * 3 * 9) / 10) * 1e-3
    np.testing.assert_allclose(spread, pooled, rtol=1e-6)


def test_says_what_it_did_in_one_line(raw_campaign, tmp_path, capsys):
    raw_campaign.cmm.append(raw_campaign.cmm[-1])
    assert run(raw_campaign.write(), tmp_path)[0] == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert said.out.count("\n") == 1
    assert said.out.startswith(
        "made-up: 34 configurations; 102 balls; 1 rows quarantined; repeatab"
    )


def test_the_same_input_gives_the_same_bytes(raw_campaign, tmp_path):
    folder = raw_campaign.write()
    first, second = (run(folder, tmp_path / name) for name in ("a", "b"))
    assert first[1].read_bytes() == second[1].read_bytes()
    assert first[2].read_bytes() == second[2].read_bytes() == b"file,line,reason,value\n"


@pytest.mark.slow
def test_corrupted_rows_of_a_shipped_campaign_are_all_listed(tmp_path):
    folder = tmp_path / "spoilt"
    shutil.copytree(RAW / "cell-null", folder)
    rng = np.random.default_rng(7)
    spoilt = {}
    for name in ("cmm.csv.gz", "resolver.csv.gz"):
        lines = gzip.decompress((folder / name).read_bytes()).decode().splitlines()
        chosen = sorted(int(k) for k in rng.choice(np.arange(1, len(lines)), 40, replace=False))
        for k in chosen:
            lines[k] = lines[k].replace(".", "?", 2)
        (folder / name).write_bytes(gzip.compress("\n".join([*lines, ""]).encode()))
        spoilt[name] = {k + 1 for k in chosen}
    status, table, listing = run(folder, tmp_path)
    assert status == 0
    listed = rows_of(listing)
    for name, lines in spoilt.items():
        assert lines <= {int(row["line"]) for row in listed if row["file"] == name}
    poses = read_pose_table(table)
    used = poses[["ballA_touches", "ballB_touches", "ballC_touches"]].to_numpy().sum()
    assert used + sum(row["file"] == "cmm.csv.gz" for row in listed) == 14280


def test_a_refusal_leaves_one_message_and_no_output(raw_campaign, tmp_path, capsys):
    raw_campaign.cmm[0] = raw_campaign.cmm[0].replace("ball", "sphere")
    status, table, listing = run(raw_campaign.write(), tmp_path / "results")
    assert status == REFUSED
    assert not table.exists()
    assert not listing.exists()
    assert list((tmp_path / "results").rglob("*.*")) == []
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert said.err.startswith("pa10cal ingest: ")
    assert "Traceback" not in said.err


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("name", ["poses.parquet", "quarantine.csv"])
def test_a_folder_in_the_place_of_an_output_is_refused_without_the_other(
    raw_campaign, tmp_path, capsys, name
):
    taken = tmp_path / "results" / "ingest" / name
    taken.mkdir(parents=True)
    assert run(raw_campaign.write(), tmp_path / "results")[0] == REFUSED
    assert list((tmp_path / "results" / "ingest").iterdir()) == [taken]
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert f"{taken}: the output cannot be written" in said


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ('{"still_speed": 1}', "did you mean 'still_speed_deg_s'"),
        ('{"max_quarantined_fraction": 1.5}', "less than or equal to 1"),
    ],
)
def test_refuses_settings_it_does_not_know(raw_campaign, tmp_path, capsys, settings, message):
    assert run(raw_campaign.write(), tmp_path, settings)[0] == REFUSED
    assert message in capsys.readouterr().err


def test_the_settings_decide_how_much_may_be_left_out(raw_campaign, tmp_path, capsys):
    raw_campaign.cmm[1:] = [line for line in raw_campaign.cmm[1:] if ",0,1,C," not in line]
    folder = raw_campaign.write()
    assert run(folder, tmp_path)[0] == REFUSED
    assert "max_quarantined_fraction" in capsys.readouterr().err
    assert run(folder, tmp_path, '{"max_quarantined_fraction": 0.5}')[0] == 0
    assert "no line_x rows" in capsys.readouterr().out


def test_a_campaign_may_bring_its_own_arm(raw_campaign, tmp_path, capsys):
    raw_campaign.description["robot"] = "mine"
    folder = raw_campaign.write()
    assert run(folder, tmp_path)[0] == REFUSED
    assert "unknown robot (got 'mine')" in capsys.readouterr().err
    arm = replace(load_arm("pa10_6ce"), name="mine")
    (folder / "mine.yaml").write_text(arm_text(arm), encoding="utf-8")
    assert run(folder, tmp_path)[0] == 0
    (folder / "mine.yaml").write_text(arm_text(arm).replace("a_m", "a_mm"), encoding="utf-8")
    assert run(folder, tmp_path)[0] == REFUSED
    assert "mine.yaml: row 2: unknown key a_mm" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["pose", "points", "distance"])
def test_says_what_an_instrument_without_balls_saw(tmp_path, capsys, kind):
    raw = sighted(tmp_path, kind, repeats=2, noise_mm=0.02)
    assert run(raw.write(), tmp_path / "out")[0] == 0
    seen = int(np.isfinite(raw.p_instr_m[..., 0]).sum())
    targets = f"; targets T1, T2, T3 seen {seen} times of 240" if kind == "points" else ""
    expected = f"sighted: 80 configurations{targets}; 0 rows quarantined; repeatability 0.0"
    told = capsys.readouterr().out
    assert told.startswith(expected)
    assert "ball" not in told


def test_touches_of_an_arm_that_slides_are_refused(raw_campaign, tmp_path, capsys):
    raw_campaign.description["robot"] = "gx4_351s"
    assert run(raw_campaign.write(), tmp_path)[0] == REFUSED
    assert "robot: the arm has prismatic joints" in capsys.readouterr().err
