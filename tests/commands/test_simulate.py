"""`pa10cal simulate` on the command line."""

import json

import pytest
import yaml

from pa10cal.commands.command_line import REFUSED, run_command
from pa10cal.files.arms import arm_text
from pa10cal.files.output import write_text
from pa10cal_curve.angles import chain_arm

SHORT = {"repeats": 1, "loads_N": [0], "holdout_points": 2, "holdout_repeats": 1}


def run(folder, settings, *more):
    text = json.dumps(settings) if isinstance(settings, dict) else settings
    words = ["--name", "c1", "--settings", text, "--out", str(folder / "raw/c1")]
    return run_command("simulate", [*words, "--truth", str(folder / "c1.json"), *more])


def hiding(id_, of, **parameters):
    return {**SHORT, "hidden_effects": [{"id": id_, "of": of, "parameters": parameters}]}


def test_writes_a_campaign_and_its_truth_elsewhere(tmp_path, capsys):
    assert run(tmp_path, hiding("backlash", "joint 2", b=1e-4)) == 0
    assert sorted(path.name for path in (tmp_path / "raw/c1").iterdir()) == [
        "campaign.yaml",
        "cmm.csv.gz",
        "resolver.csv.gz",
    ]
    assert yaml.safe_load((tmp_path / "raw/c1/campaign.yaml").read_text())["name"] == "c1"
    truth = json.loads((tmp_path / "c1.json").read_text())
    assert truth["hidden_effects"][0]["id"] == "backlash"
    assert truth["kcub_reading"] == "text_e7"
    shown = capsys.readouterr()
    assert shown.err == ""
    assert shown.out.startswith("c1: ")
    assert len(shown.out.splitlines()) == 1


def test_the_cubic_stiffness_has_two_readings(tmp_path):
    assert run(tmp_path, SHORT, "--kcub-reading", "table_e8") == 0
    truth = json.loads((tmp_path / "c1.json").read_text())
    assert truth["kcub_reading"] == "table_e8"
    assert truth["parameters"]["K_cub_2"]["value"] == 3.35e8


def test_reads_settings_from_a_yaml_file(tmp_path):
    path = tmp_path / "settings.yaml"
    path.write_text(yaml.safe_dump({**SHORT, "random_seed": 5}))
    assert run(tmp_path, str(path)) == 0
    assert json.loads((tmp_path / "c1.json").read_text())["random_seed"] == 5


def test_an_arm_of_ones_own_is_read_from_its_description(tmp_path):
    path = tmp_path / "mine.yaml"
    write_text(path, arm_text(chain_arm("mine", 3, 0.2, 1.0)))
    asked = {"robot": str(path), "without_touches": {"poses": 4}}
    assert run(tmp_path, asked) == 0
    assert (tmp_path / "raw/c1/mine.yaml").read_text() == path.read_text()
    assert yaml.safe_load((tmp_path / "raw/c1/campaign.yaml").read_text())["robot"] == "mine"
    assert run(tmp_path, {**asked, "robot": str(tmp_path / "other.yaml")}) == REFUSED


def test_refuses_a_campaign_without_a_name(tmp_path, capsys):
    assert run(tmp_path, SHORT, "--name", "") == REFUSED
    assert "--name" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_benches_may_have_spaces_about_their_commas(tmp_path, capsys):
    words = [
        "--kind",
        "right",
        "--count",
        "2",
        "--random-seed",
        "1",
        "--raw",
        str(tmp_path / "raw"),
    ]
    words += ["--truths", str(tmp_path / "truths"), "--benches", "ur10-pose, irb120-pose"]
    assert run_command("draw_trials", words) == 0
    shown = capsys.readouterr().out.splitlines()
    assert ["irb120-pose" in line for line in shown] == [False, True]


BAD = [
    ({"seed": 1}, ["unknown key seed", "'random_seed'"]),
    ({"random_seed": -1}, ["random_seed", "-1", "greater than or equal to 0"]),
    ({"repeats": -3}, ["repeats", "-3", "greater than or equal to 1"]),
    ({"loads_N": []}, ["loads_N", "at least 1"]),
    ({"loads_N": [-22]}, ["loads_N.0", "-22"]),
    ({"noise": {"touch_mm": -0.1}}, ["noise.touch_mm", "-0.1"]),
    ({"noise": {"touch": 0.1}}, ["noise.touch", "'touch_mm'"]),
    ({"path": "zigzag"}, ["path", "zigzag", "alternating"]),
    ({"built": "table_2"}, ["built", "table_2", "drawn"]),
    ({"robot": "pa10"}, ["robot", "pa10_6ce"]),
    ({"poses": {"spacing_m": [0, 0.1, 0.1]}}, ["poses.spacing_m.0", "greater than 0"]),
    ({"poses": {"spacing_m": [0.5, 0.5, 0.5]}}, ["cannot be taken", "poses.spacing_m"]),
    ({"poses": {"centre_deg": [0, 0]}}, ["poses.centre_deg", "6 angles"]),
    ({**SHORT, "without_touches": {}}, ["without_touches", "loads_N is for touches"]),
    ({"without_touches": {"stand_off_m": [2.0, 1.0]}}, ["stand_off_m", "least distance first"]),
    ({"poses": {"tilt_seed": -1}}, ["tilt_seed", "0"]),
    ({"without_touches": {"poses": 0}}, ["without_touches.poses", "greater than or equal to 1"]),
    (
        {"without_touches": {"flexible_joints": [7]}},
        ["flexible_joints", "revolute joints of pa10_6ce"],
    ),
    (hiding("backslash", "joint 1", b=1e-4), ["unknown effect", "'backlash'"]),
    (hiding("thermal_growth", "arm", alpha=2e-5), ["temperature_drift_C"]),
    (hiding("joint_compliance", "joint 4", K=2.0), ["finds no rest", "hidden compliance"]),
    ({"hidden_effects": [{"id": "backlash"}]}, ["hidden_effects.0.of"]),
    ("{not json", ["settings"]),
    ("nowhere.yaml", ["nowhere.yaml"]),
]


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize(("settings", "words"), BAD)
def test_refuses_bad_settings_with_one_message_and_leaves_nothing(
    tmp_path, capsys, settings, words
):
    assert run(tmp_path, settings) == REFUSED
    message = capsys.readouterr().err
    assert len(message.strip().splitlines()) == 1
    for word in words:
        assert word in message
    assert list(tmp_path.iterdir()) == []
