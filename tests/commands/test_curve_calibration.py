"""The commands `curve_calibration` and `figures`, called in process."""

import csv
import json

import numpy as np
import pytest

from pa10cal.commands.command_line import REFUSED, run_command

FEW = {"individuals": 1, "postures": 80, "random_seed": 3}
STARTS = {"starts": 2}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    out = tmp_path_factory.mktemp("chain") / "calibration.json"
    argv = ["--settings", json.dumps(FEW), "--calibration", json.dumps(STARTS)]
    assert run_command("curve_calibration", [*argv, "--out", str(out)]) == 0
    return out


@pytest.fixture
def found(path):
    record = json.loads(path.read_text("utf-8"))
    assert record["provenance"].startswith("synthetic")
    return {(each["departs"], each["model"]): each for each in record["summaries"]}, record


@pytest.mark.slow
def test_errors_come_down_to_the_noise(found):
    summaries, record = found
    assert record["noise_floor_mm"] == pytest.approx(np.sqrt(8 / np.pi) * 0.05)
    for departs in ("rows", "any_way"):
        general = summaries[departs, "general"]
        assert general["converged"] == 1
        assert general["fitted"]["largest"] < 1.1
        assert general["held_out"]["largest"] < 1.5
    for model in ("two_level", "two_level_all"):
        assert summaries["rows", model]["fitted"]["largest"] < 1.5
    for individual in record["individuals"]:
        assert individual["errors"]["nominal"]["fitted"]["mean_mm"] > 0.4
        assert sum(individual["poses"]["held_out"]) == 20
    assert 0.7 < summaries["rows", "two_level"]["rms_score"] < 1.4


@pytest.mark.slow
def test_rank_and_what_no_pose_tells(found):
    summaries, record = found
    general, paper = summaries["rows", "general"], summaries["rows", "two_level"]
    assert (general["rank"], general["unknowns"]) == (54, 54)
    assert general["null_directions"] == []
    assert (paper["rank"], paper["unknowns"]) == (52, 54)
    open_pairs = {frozenset(direction) for direction in paper["null_directions"]}
    assert open_pairs == {
        frozenset({"delta_d_1", "base_z"}),
        frozenset({"delta_theta_1", "base_rz"}),
    }
    redundant = record["individuals"][0]["models"]["general"]["redundant"]
    assert {"delta_d_1", "delta_theta_1", "delta_a_12", "delta_alpha_12"} <= set(redundant)


@pytest.mark.slow
def test_a_flange_that_departs_in_any_way_is_beyond_the_two_level_model(found):
    summaries, _ = found
    lacking = summaries["any_way", "two_level_all"]["held_out_true"]["mean"]
    assert lacking > 1.2 * summaries["any_way", "general"]["held_out_true"]["mean"]


@pytest.mark.slow
def test_figure_and_table_are_drawn(path, tmp_path):
    assert run_command("figures", ["--results", str(path.parent), "--out-dir", str(tmp_path)]) == 0
    drawn = {file.suffix for file in (tmp_path / "figures").iterdir()}
    assert drawn == {".svg", ".pdf", ".png"}
    folder = tmp_path / "tables"
    with (folder / "curve_calibration_summary.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["rank"] for row in rows] == ["52", "52", "54"] * 2
    said = (folder / "curve_calibration_summary.md").read_text("utf-8")
    assert "| two-level (paper) | δd₁ − base z |" in said
    assert "Synthetic data" in said


@pytest.mark.slow
def test_what_cannot_be_is_refused(tmp_path, path, capsys):
    out = tmp_path / "c.json"
    argv = ["--settings", '{"postures": 8}', "--out", str(out)]
    assert run_command("curve_calibration", argv) == REFUSED
    assert "fewer equations than unknowns" in capsys.readouterr().err
    argv = ["--settings", '{"holdout_share": 0.001}', "--out", str(out)]
    assert run_command("curve_calibration", argv) == REFUSED
    assert "a holdout_share that holds out one posture or more" in capsys.readouterr().err
    argv = ["--figure", "curve", "--results", str(path.parent), "--out-dir", str(tmp_path)]
    assert run_command("figures", argv) == REFUSED
    assert "no such figure or table" in capsys.readouterr().err
    (tmp_path / "calibration.json").write_text("{}")
    assert run_command("figures", ["--results", str(tmp_path)]) == REFUSED
    assert "give a file that pa10cal curve_calibration wrote" in capsys.readouterr().err
