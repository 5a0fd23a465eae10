"""Stage seed, in process: lines, the fall-back on the nominal model, refusals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from made_up_sightings import sighted
from pa10cal.commands.command_line import REFUSED, run_command
from pa10cal.observe import seed

RAW = Path(__file__).parents[2] / "data" / "raw"


def run(folder, out, settings="{}"):
    """Ingest, then seed; return the exit code and the path of the base frame."""
    table, seed = out / "poses.parquet", out / "base_frame.json"
    shared = ["--campaign-dir", str(folder)]
    status = run_command(
        "ingest", [*shared, "--out", str(table), "--quarantine", str(out / "quarantine.csv")]
    )
    assert status == 0
    given = ["--poses", str(table), "--settings", settings, "--out", str(seed)]
    return run_command("seed", [*shared, *given]), seed


def read(path):
    return json.loads(path.read_text(encoding="utf-8"))


def apart(T_instr_base, record):
    """Angle [rad] and distance [m] between a frame and the recorded one."""
    found = np.array(record["T_instr_base"])
    turn = Rotation.from_matrix(T_instr_base[:3, :3].T @ found[:3, :3]).magnitude()
    return turn, np.linalg.norm(T_instr_base[:3, 3] - found[:3, 3])


def test_straight_moves_give_the_frame_the_campaign_was_made_with(raw_campaign, tmp_path, capsys):
    status, path = run(raw_campaign.write(), tmp_path)
    assert status == 0
    record = read(path)
    assert record["schema"] == "pa10cal-base-frame/1"
    assert record["campaign"] == "made-up"
    assert record["method"] == "straight_lines"
    angle, distance = apart(raw_campaign.T_instr_base, record)
    assert angle < 4e-4
    assert distance < 3e-4
    assert record["line_x"]["length_mm"] == pytest.approx(150.0, abs=0.1)
    assert record["line_y"]["bend_rms_mm"] < 0.03
    assert 0 < record["x_direction_u_rad"] < 4e-4
    assert record["angle_between_lines_deg"] == pytest.approx(90.0, abs=0.05)
    R = np.array(record["R_instr_base"])
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
    np.testing.assert_array_equal(R, np.array(record["T_instr_base"])[:3, :3])
    assert "base frame by straight_lines" in capsys.readouterr().out


def test_without_straight_moves_the_nominal_model_is_fitted(raw_campaign, tmp_path):
    raw_campaign.cmm[1:] = [line for line in raw_campaign.cmm[1:] if ",line_" not in line]
    status, path = run(raw_campaign.write(), tmp_path)
    assert status == 0
    record = read(path)
    assert record["method"] == "rigid_fit_nominal"
    angle, distance = apart(raw_campaign.T_instr_base, record)
    assert angle < 2e-4
    assert distance < 2e-4
    assert record["origin_poses"] == 6


def test_a_tracked_campaign_without_balls_or_torques_has_a_seed_too(raw_campaign, tmp_path):
    raw_campaign.description["instrument"]["kind"] = "pose"
    raw_campaign.description["files"] = {"poses": "poses.csv"}
    status, path = run(raw_campaign.write(), tmp_path)
    assert status == 0
    angle, distance = apart(raw_campaign.T_instr_base, read(path))
    assert angle < 1e-6
    assert distance < 1e-6


def test_the_shipped_campaign_agrees_with_a_fit_of_the_nominal_model(tmp_path):
    status, path = run(RAW / "cell-null", tmp_path)
    assert status == 0
    record = read(path)
    # The model's own errors, a few mrad, bend and turn the moves; the instrument does not.
    assert record["origin_poses"] == 22 + 27
    assert record["line_x"]["points"] == record["line_y"]["points"] == 11
    assert 190 < record["line_x"]["length_mm"] < 210
    assert record["line_x"]["bend_rms_mm"] < 0.1
    assert record["origin_scatter_mm"] < 3.0
    assert np.linalg.det(np.array(record["R_instr_base"])) == pytest.approx(1.0)


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ('{"min_length_mm": 500}', r"line_x: the straight move is too short"),
        ('{"max_bend_mm": 1e-6}', r"line_x: the straight move is bent"),
        ('{"min_angle_deg": 89.9999}', r"too close to parallel"),
        ('{"min_length": 50}', r"did you mean 'min_length_mm'"),
    ],
)
def test_refuses_with_one_message_and_no_output(raw_campaign, tmp_path, capsys, settings, message):
    status, path = run(raw_campaign.write(), tmp_path, settings)
    assert status == REFUSED
    assert not path.exists()
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert message in said


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize(("there", "absent"), [("line_x", "line_y"), ("line_y", "line_x")])
def test_one_move_alone_is_refused(raw_campaign, tmp_path, capsys, there, absent):
    raw_campaign.cmm[1:] = [line for line in raw_campaign.cmm[1:] if f",{absent}," not in line]
    status, _ = run(raw_campaign.write(), tmp_path)
    assert status == REFUSED
    said = capsys.readouterr().err
    assert f"poses.parquet: there are {there} rows, but no {absent} rows" in said
    assert f"or remove its {there} rows too" in said


def test_a_reversed_joint_is_told_where_straight_moves_seem_to_go_another_way(
    raw_campaign, tmp_path, capsys
):
    first, *lines = raw_campaign.resolver
    column = first.split(",").index("q2_deg")
    for k, line in enumerate(lines, 1):
        row = line.split(",")
        row[column] = f"{-float(row[column]):.5f}"
        raw_campaign.resolver[k] = ",".join(row)
    status, path = run(raw_campaign.write(), tmp_path)
    assert status == REFUSED
    assert not path.exists()
    said = capsys.readouterr().err
    assert "line_x: the straight move is not along x of the base" in said
    assert "the sign of joint 2 is reversed" in said
    assert "set joint_signs: [1, -1, 1, 1, 1, 1]" in said
    assert "check the labels" not in said


def test_the_poses_of_another_campaign_are_refused(raw_campaign, tmp_path, capsys):
    folder = raw_campaign.write()
    _, path = run(folder, tmp_path)
    path.unlink()
    raw_campaign.description["name"] = "another"
    raw_campaign.write()
    given = ["--poses", tmp_path / "poses.parquet", "--out", path]
    assert (
        run_command("seed", [str(word) for word in ["--campaign-dir", folder, *given]]) == REFUSED
    )
    said = capsys.readouterr().err
    assert "got 'made-up'" in said
    assert "campaign 'another'" in said
    assert not path.exists()


def test_straight_moves_of_a_tracker_come_with_its_target(raw_campaign, tmp_path):
    raw_campaign.description["instrument"]["kind"] = "pose"
    raw_campaign.description["files"] = {"poses": "poses.csv"}
    _, path = run(raw_campaign.write(), tmp_path)
    record = read(path)
    assert record["method"] == "straight_lines"
    np.testing.assert_allclose(record["T_ee_target"], np.eye(4), atol=1e-5)


def test_any_base_and_any_tool_are_found_from_poses(tmp_path, capsys):
    raw = sighted(tmp_path, "pose", noise_mm=0.02)
    status, path = run(raw.write(), tmp_path)
    assert status == 0
    record = read(path)
    assert record["method"] == "hand_eye_poses"
    angle, distance = apart(raw.T_instr_base, record)
    assert angle < 2e-5
    assert distance < 5e-5
    np.testing.assert_allclose(record["T_ee_target"], raw.T_ee_target, atol=5e-5)
    assert record["held_as_stated"] == []
    assert record["origin_poses"] == 32
    assert 0.02 < record["origin_scatter_mm"] < 0.05
    assert 0.0 < record["x_direction_u_rad"] < 2e-5
    np.testing.assert_array_equal(record["R_instr_base"], np.array(record["T_instr_base"])[:3, :3])
    assert "base frame by hand_eye_poses, directions known to" in capsys.readouterr().out


def test_places_of_targets_are_found_with_the_base(tmp_path):
    raw = sighted(tmp_path, "points", noise_mm=0.02)
    _, path = run(raw.write(), tmp_path)
    record = read(path)
    assert record["method"] == "hand_eye_points"
    angle, distance = apart(raw.T_instr_base, record)
    assert angle < 5e-5
    assert distance < 5e-5
    places = [record["p_ee_targets_m"][name] for name in ("T1", "T2", "T3")]
    np.testing.assert_allclose(places, raw.p_ee_m, atol=5e-5)


def test_what_a_scara_leaves_open_is_held_as_stated_and_said(tmp_path, capsys):
    raw = sighted(tmp_path, "points", robot="gx4_351s", targets=1)
    raw.description["tool"]["balls_mm"] = {"T1": (1e3 * raw.p_ee_m[0]).tolist()}
    _, path = run(raw.write(), tmp_path)
    record = read(path)
    np.testing.assert_allclose(record["p_ee_targets_m"]["T1"], raw.p_ee_m[0], atol=1e-6)
    assert apart(raw.T_instr_base, record)[1] < 1e-6
    held = "target T1 along (0.00, 0.00, 1.00)"
    assert record["held_as_stated"] == [held]
    assert f"held as stated: {held}" in capsys.readouterr().out


def test_a_target_that_is_held_in_all_directions_is_told_once():
    held = [f"target T1 along {axis}" for axis in ("(1, 0, 0)", "(0, 1, 0)", "(0, 0, 1)")]
    assert seed._directions_held(held) == "target T1 in all directions"
    assert seed._directions_held([held[0], "target T2 along (1, 0, 0)"]).count("along") == 2


def test_what_nobody_stated_is_not_said_to_be_stated(tmp_path, capsys):
    run(sighted(tmp_path, "points", robot="gx4_351s", targets=1).write(), tmp_path)
    said = capsys.readouterr().out
    assert "held where it started: target T1 along" in said
    assert "stated" not in said


def test_a_target_of_a_tool_for_a_load_is_located_by_poses_under_that_load(tmp_path):
    raw = sighted(tmp_path, "points", poses=80)
    load, last = raw.column("load_N"), raw.column("T3_x_mm")
    for at, line in enumerate(raw.poses[1:], start=1):
        cells = line.split(",")
        cells[load] = ("0", "20", "30", "40")[at % 4]
        if at % 4 < 2:  # the lower loads are carried by a tool without the third target
            cells[last : last + 3] = [""] * 3
        raw.poses[at] = ",".join(cells)
    _, path = run(raw.write(), tmp_path)
    record = read(path)
    places = [record["p_ee_targets_m"][name] for name in ("T1", "T2", "T3")]
    np.testing.assert_allclose(places, raw.p_ee_m, atol=1e-6)
    assert record["origin_from"] == "grid poses at the lowest load of every target"
    of_a_load = 16  # of 80 poses, one in five held out
    assert of_a_load < record["origin_poses"] <= 2 * of_a_load


@pytest.mark.slow
@pytest.mark.parametrize("stated", [False, True])
def test_the_fixed_point_of_distances_is_found(tmp_path, capsys, stated):
    raw = sighted(tmp_path, "distance", noise_mm=0.02)
    if stated:
        raw.description["tool"]["balls_mm"] = {"S": (1e3 * raw.T_ee_target[:3, 3]).tolist()}
    _, path = run(raw.write(), tmp_path)
    record = read(path)
    assert record["method"] == "ranging"
    np.testing.assert_allclose(record["p_base_point_m"], raw.p_base_point_m, atol=5e-4)
    place = record["p_ee_targets_m"]["S" if stated else "target"]
    np.testing.assert_allclose(place, raw.T_ee_target[:3, 3], atol=5e-4)
    np.testing.assert_allclose(record["origin_instr_m"], -np.array(record["p_base_point_m"]))
    assert "x_direction_u_rad" not in record
    assert "fixed point at (" in capsys.readouterr().out


def test_too_few_distances_are_refused(tmp_path, capsys):
    raw = sighted(tmp_path, "distance", poses=3)
    status, path = run(raw.write(), tmp_path)
    assert status == REFUSED
    assert not path.exists()
    assert "too few distances to find the fixed point" in capsys.readouterr().err
