"""Campaigns too small for a search, through every command: calibrated, and nothing is named."""

import csv
import json

import numpy as np
import pytest
import yaml

from pa10cal.commands.command_line import REFUSED, run_command
from pa10cal.results.codec import read
from pa10cal.results.discovery import ExtendedRecord, VerdictRecord

NAME = "small"
PLAN = {"poses": 48, "departs": "rows"}
EFFECT = {"id": "encoder_eccentricity", "of": "joint 3"}


def run(command, *words):
    return run_command(command, [str(word) for word in words])


@pytest.fixture(scope="module", params=["pose", "points", "distance"])
def work(request, tmp_path_factory):
    """A campaign of 36 calibration poses, none repeated, through discovery."""
    folder = tmp_path_factory.mktemp(request.param)
    plan = {"robot": "ur10", "without_touches": {"instrument": request.param, **PLAN}}
    made = ("--out", folder / "raw", "--truth", folder / "truth.json")
    assert run("simulate", "--name", NAME, "--settings", json.dumps(plan), *made) == 0
    logs = ("--campaign-dir", folder / "raw", "--quarantine", folder / "quarantine.csv")
    assert run("ingest", *logs, "--out", folder / "poses.parquet") == 0
    assert run("seed", *table(folder), "--out", folder / "base.json") == 0
    assert calibrate(folder, folder / "combined.json") == 0
    words = [f"--{key}={folder / name}" for key, name in OUTPUTS.items()]
    calibration = ("--calibration", folder / "combined.json")
    assert run("discover", *table(folder), *calibration, *words) == 0
    return folder


OUTPUTS = {
    "verdict": "verdict.json",
    "analysis": "analysis.json",
    "extended": "extended.json",
    "suggested": "suggested.csv",
}


def table(folder):
    return ("--campaign-dir", folder / "raw", "--poses", folder / "poses.parquet")


def calibrate(folder, out, effects=(), named=()):
    begun = ("--base-frame", folder / "base.json", "--load", "combined", "--out", out)
    settings = ("--settings", json.dumps({"effects": effects or []}))
    return run("calibrate", *table(folder), *begun, *settings, *named)


def test_the_verdict_says_why_and_what_would_do(work):
    found = read(VerdictRecord, work / "verdict.json", NAME)
    assert found.verdict == "not_sought"
    assert found.why.startswith("36 readings of calibration poses are too few")
    assert "0 repeats" in found.why
    assert "at least 100 calibration poses, or repeat at least 20 readings" in found.remedy
    assert found.method is found.search is found.unexplained is found.remaining is None
    assert found.effects == found.not_testable == found.suggested_poses == ()
    for gap in (found.gap.train, found.gap.holdout):
        assert gap.before == gap.after
        assert gap.reduction.mean_mm == 0.0
    assert found.gap.holdout.before.configurations == 12
    assert found.gap.noise_floor_from.startswith("the instrument's stated uncertainty")
    assert 0.3 < found.gap.train.before.mean_mm / found.gap.noise_floor_mm < 1.2
    with (work / "suggested.csv").open(encoding="utf-8", newline="") as suggested:
        header, *rows = csv.reader(suggested)
    assert header[:2] == ["order", "q1_deg"]
    assert rows == []


def test_the_command_says_so_in_one_line(work, tmp_path, capsys):
    words = [f"--{key}={tmp_path / name}" for key, name in OUTPUTS.items()]
    capsys.readouterr()
    code = run("discover", *table(work), "--calibration", work / "combined.json", *words)
    line, seconds = capsys.readouterr().out.splitlines()
    assert code == 0
    assert seconds.startswith(f"{NAME}: ")
    assert seconds.endswith(" s")
    assert line.startswith(f"{NAME}: effects were not sought: 36 readings")
    assert "; measure at least 100 calibration poses" in line


def test_the_extended_model_is_the_calibrated_one(work, tmp_path):
    out = tmp_path / "holdout.json"
    given = ("--calibration", work / "combined.json", "--extended", work / "extended.json")
    assert run("evaluate", *table(work), *given, "--out", out) == 0
    models = json.loads(out.read_text("utf-8"))["models"]
    assert models["extended"] == models["linear"]
    verdict = json.loads((work / "verdict.json").read_text("utf-8"))
    for key in ("mean_mm", "rms_mm", "peak_mm"):
        after = verdict["gap"]["holdout"]["after"][key]
        assert models["extended"][key] == pytest.approx(after, rel=1e-9)
    exported = ("--model", tmp_path / "model.yaml", "--urdf", tmp_path / "robot.urdf")
    assert run("export", *given, *exported) == 0
    model = yaml.safe_load((tmp_path / "model.yaml").read_text("utf-8"))
    calibrated = json.loads((work / "combined.json").read_text("utf-8"))
    assert [term["x"] for term in model["terms"]] == [
        term["x"] for term in calibrated["fitted_model"]["terms"]
    ]
    extended = read(ExtendedRecord, work / "extended.json", NAME)
    assert extended.named == extended.warnings == ()
    shared = calibrated["parameters"].keys() & extended.parameters.keys()
    assert len(shared) > 20
    for name in shared:
        parameter, stated = extended.parameters[name], calibrated["parameters"][name]
        assert parameter.value == pytest.approx(stated["value"], rel=1e-9, abs=1e-15)
        if stated["std"] is not None:
            assert parameter.std == pytest.approx(stated["std"], rel=1e-4, abs=1e-15)


def test_it_names_nothing_to_calibrate_with(work, tmp_path, capsys):
    out = tmp_path / "combined.json"
    capsys.readouterr()
    assert calibrate(work, out, "named", ("--named", work / "extended.json")) == 0
    said = capsys.readouterr().out
    assert f"{NAME} combined: the verdict not_sought names no effects to calibrate with" in said
    found, plain = (json.loads(path.read_text("utf-8")) for path in (out, work / "combined.json"))
    np.testing.assert_allclose(
        found["covariance"]["matrix"], plain["covariance"]["matrix"], rtol=1e-12
    )


def test_a_model_judged_in_another_place_goes_on(work, tmp_path):
    out = tmp_path / "transfer.json"
    given = ("--calibration", work / "combined.json", "--extended", work / "extended.json")
    assert run("transfer", *table(work), *given, "--out", out) == 0
    models = json.loads(out.read_text("utf-8"))["models"]
    assert models["extended"] == models["linear"]


def test_effects_that_are_listed_all_the_same_are_refused(work, tmp_path, capsys):
    assert calibrate(work, tmp_path / "combined.json", [EFFECT]) == REFUSED
    assert "too few repeats to determine the repeatability" in capsys.readouterr().err


@pytest.fixture(scope="module")
def touched(tmp_path_factory):
    """Touched balls, every pose once at each load: two models, calibrated and searched."""
    folder = tmp_path_factory.mktemp("touched")
    plan = json.dumps({"repeats": 1, "loads_N": [0.0, 44.0], "holdout_points": 4})
    made = ("--out", folder / "raw", "--truth", folder / "truth.json")
    assert run("simulate", "--name", NAME, "--settings", plan, *made) == 0
    logs = ("--campaign-dir", folder / "raw", "--quarantine", folder / "quarantine.csv")
    assert run("ingest", *logs, "--out", folder / "poses.parquet") == 0
    assert run("seed", *table(folder), "--out", folder / "base.json") == 0
    quick = ("--settings", json.dumps({"starts": 1}))
    for load in ("combined", "general"):
        begun = ("--base-frame", folder / "base.json", "--out", folder / f"{load}.json")
        assert run("calibrate", *table(folder), *begun, "--load", load, *quick) == 0
    words = [f"--{key}={folder / name}" for key, name in OUTPUTS.items()]
    calibration = ("--calibration", folder / "combined.json")
    assert run("discover", *table(folder), *calibration, *words) == 0
    return folder


def test_touched_balls_without_repeats_keep_the_papers_model(touched, tmp_path):
    found = read(VerdictRecord, touched / "verdict.json", NAME)
    assert found.verdict == "not_sought"
    assert found.why.startswith("54 readings of calibration poses are too few")
    given = ("--calibration", touched / "combined.json", "--extended", touched / "extended.json")
    out = tmp_path / "holdout.json"
    assert run("evaluate", *table(touched), *given, "--out", out) == 0
    models = json.loads(out.read_text("utf-8"))["models"]
    assert models["extended"]["rms_mm"] == pytest.approx(models["cubic"]["rms_mm"], rel=1e-9)


def test_the_general_model_beside_it_converges(touched):
    """The scatter found about a fit, and that about the next, once took turns for ever."""
    found = json.loads((touched / "general.json").read_text("utf-8"))
    assert found["status"] == "converged"
    assert found["health"]["iterations"] < 60
