"""Discovery by blocks of poses left out as a command, on a made-up tracker's campaign."""

import csv

import pytest
import yaml

from by_commands import calibrated, called, discover, evaluate, export
from by_commands import read_json as read
from made_up_survey import Hidden, measured, rough
from pa10cal.results.analysis import AnalysisRecord
from pa10cal.results.codec import read as read_record
from pa10cal_lab.cell.write import write_campaign

NAME = "made-up"


def evaluated(folder):
    assert evaluate(folder, folder / "holdout.json") == 0
    return read(folder / "holdout.json")["models"]


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A campaign with an error of joint 3 that has no name, through discovery."""
    folder = tmp_path_factory.mktemp("work")
    write_campaign(measured(Hidden(turn=rough(3)), poses=600, held_out=200), folder / "raw")
    calibrated(folder)
    assert discover(folder, settings={"suggestions": 3}) == 0
    return folder


@pytest.fixture(scope="module")
def verdict(work):
    return read(work / "verdict.json")


@pytest.mark.slow
def test_the_verdict_names_the_joint_and_says_that_the_cause_is_not_known(verdict):
    assert (verdict["schema"], verdict["campaign"]) == ("pa10cal-verdict/1", NAME)
    assert verdict["verdict"] == "named"
    assert verdict["method"] == "cross-validation over blocks"
    (effect,) = verdict["effects"]
    assert (effect["id"], effect["of"], effect["alternatives"]) == (
        "joint_error_map",
        "joint 3",
        [],
    )
    assert len(effect["parameters"]) == effect["form"]["knots"] > 12
    assert {entry["unit"] for entry in effect["parameters"].values()} == {"rad"}
    proof = effect["evidence"]["cross_validation_over_blocks"]
    assert proof["improved"] == proof["blocks"] == 10
    assert proof["z"] == pytest.approx(proof["gain"] / proof["gain_std"])
    assert proof["rms_with_mm"] < 0.8 * proof["rms_without_mm"]
    assert (verdict["unexplained"]["of"], verdict["unexplained"]["why"]) == (
        "joint 3",
        "cause not known",
    )


@pytest.mark.slow
def test_it_says_what_was_assumed_and_what_cannot_be_told(verdict):
    assert verdict["arrival_from_order"] is True
    why = {(entry["id"], entry["of"]): entry["why"] for entry in verdict["not_testable"]}
    assert why["friction_torque", "joint 2"] == "the torques were not logged"
    assert "the instrument's stated uncertainty" in verdict["gap"]["noise_floor_from"]
    tried = {(entry["id"], entry["of"]) for entry in verdict["remaining"]["tried"]}
    assert {("place_map", "instrument"), ("drift_map", "base")} <= tried


@pytest.mark.slow
def test_the_gap_is_parted_into_angles_seen_and_beyond(verdict):
    for kind, poses in (("train", 600), ("holdout", 200)):
        gap = verdict["gap"][kind]
        parts = [gap[part]["after"] for part in ("inside", "outside") if gap[part] is not None]
        assert sum(part["configurations"] for part in parts) == poses
        assert gap["after"]["configurations"] == poses
        assert gap["after"]["rms_mm"] < 0.7 * gap["before"]["rms_mm"]
        # One joint has a map, and it went everywhere: nearly all poses keep to what it has seen.
        assert gap["inside"]["after"]["configurations"] >= 0.95 * poses


@pytest.mark.slow
def test_the_extended_model_evaluates_as_the_verdict_says(work, verdict):
    found, gap = evaluated(work)["extended"], verdict["gap"]["holdout"]
    for key in ("mean_mm", "rms_mm", "peak_mm"):
        assert found[key] == pytest.approx(gap["after"][key], rel=1e-6)
        assert found["inside"][key] == pytest.approx(gap["inside"]["after"][key], rel=1e-6)
    marked = [row["extrapolated"] for row in found["rows"]]
    assert len(marked) - sum(marked) == gap["inside"]["after"]["configurations"]


@pytest.mark.slow
def test_the_extended_model_is_exported(work, verdict):
    assert export(work, work) == 0
    content = yaml.safe_load((work / "model.yaml").read_text("utf-8"))
    effect, stated = content["terms"][-1], verdict["effects"][0]
    assert (effect["id"], effect["of"]) == (stated["id"], stated["of"])
    for name, entry in stated["parameters"].items():
        assert effect["parameters"][name]["value"] == pytest.approx(entry["value"], rel=1e-9)


@pytest.mark.slow
def test_poses_are_suggested_that_show_other_angles(work, verdict):
    assert len(verdict["suggested_poses"]) == 3
    for pose in verdict["suggested_poses"]:
        assert len(pose["q_deg"]) == 6
        assert all("not seen" in text for text in pose["for"])
    with (work / "suggested.csv").open(encoding="utf-8", newline="") as table:
        rows = list(csv.DictReader(table))
    assert [row["order"] for row in rows] == ["1", "2", "3"]
    assert float(rows[0]["q3_deg"]) == pytest.approx(
        verdict["suggested_poses"][0]["q_deg"][2], abs=1e-4
    )


@pytest.mark.slow
def test_the_analysis_has_what_the_figures_show(work):
    analysis = read_record(AnalysisRecord, work / "analysis.json", NAME)
    assert [len(step.effects) for step in analysis.naming] == [0, 1]
    assert len(analysis.gap.train) == 600
    before, after = (fit.by_joint[2].rms_rad for fit in (analysis.before, analysis.after))
    assert after < before


@pytest.mark.slow
def test_the_model_holds_the_angles_seen(work):
    record = read(work / "extended.json")
    seen = record["fitted_model"]["seen"]
    assert [entry["turns"] for entry in seen] == [e["turns"] for e in record["angles_seen"]]
    assert [e["intervals"] for e in seen] == [e["stretches"] for e in record["angles_seen"]]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("series", "whole_mm", "inside_mm"), [("ur10-a", 0.15, 0.10), ("ur10-c", 0.09, 0.085)]
)
def test_the_measured_ur10_comes_below_what_geometry_and_springs_leave(
    series, whole_mm, inside_mm, ipa_data, tmp_path
):
    assert called("import", "ipa-robot-accuracy", ipa_data, out=tmp_path / "data") == 0
    (tmp_path / "raw").symlink_to(tmp_path / "data" / series)
    calibrated(tmp_path)
    assert discover(tmp_path, settings={"suggestions": 3}) == 0
    found = evaluated(tmp_path)
    assert found["extended"]["rms_mm"] < whole_mm < found["linear"]["rms_mm"]
    assert found["extended"]["inside"]["rms_mm"] < inside_mm
    effects = read(tmp_path / "verdict.json")["effects"]
    # Under the name of its cause where the motor's ripple says it.
    names = ("joint_error_map", "sensor_error")
    maps = [effect["of"] for effect in effects if effect["id"] in names]
    assert sorted(maps) == [f"joint {joint}" for joint in range(1, 7)]
    sensors = {effect["of"] for effect in effects if effect["id"] == "sensor_error"}
    assert sensors >= {"joint 1", "joint 2"}
