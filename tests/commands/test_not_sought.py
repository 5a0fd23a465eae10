"""Campaigns too small for a search, through every command: calibrated, and nothing is named."""

import csv
import json

import numpy as np
import pytest
import yaml

from by_commands import (
    calibrate,
    calibrated,
    called,
    discover,
    evaluate,
    export,
    simulated,
    table_of,
)
from pa10cal.commands.command_line import REFUSED
from pa10cal.results.codec import read
from pa10cal.results.discovery import ExtendedRecord, VerdictRecord

NAME = "small"
PLAN = {"poses": 48, "departs": "rows"}
EFFECT = {"id": "encoder_eccentricity", "of": "joint 3"}


@pytest.fixture(
    scope="module",
    params=["pose", *(pytest.param(k, marks=pytest.mark.slow) for k in ("points", "distance"))],
)
def work(request, tmp_path_factory):
    """A campaign of 36 calibration poses, none repeated, through discovery."""
    plan = {"robot": "ur10", "without_touches": {"instrument": request.param, **PLAN}}
    folder = calibrated(simulated(tmp_path_factory.mktemp(request.param), NAME, plan))
    assert discover(folder) == 0
    return folder


def least_poses(work):
    """Return how many poses would do: three targets in each tell more of one."""
    return 70 if work.name.startswith("points") else 100


def test_the_verdict_says_why_and_what_would_do(work):
    found = read(VerdictRecord, work / "verdict.json", NAME)
    assert found.verdict == "not_sought"
    assert found.why.startswith("36 readings of calibration poses are too few")
    assert "0 repeats" in found.why
    poses = least_poses(work)
    assert f"at least {poses} calibration poses, or repeat at least 20 readings" in found.remedy
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
    capsys.readouterr()
    code = discover(work, tmp_path)
    line, seconds = capsys.readouterr().out.splitlines()
    assert code == 0
    assert seconds.startswith(f"{NAME}: ")
    assert seconds.endswith(" s")
    assert line.startswith(f"{NAME}: effects were not sought: 36 readings")
    assert f"; measure at least {least_poses(work)} calibration poses" in line


def test_the_extended_model_is_the_calibrated_one(work, tmp_path):
    out = tmp_path / "holdout.json"
    assert evaluate(work, out) == 0
    models = json.loads(out.read_text("utf-8"))["models"]
    assert models["extended"] == models["linear"]
    verdict = json.loads((work / "verdict.json").read_text("utf-8"))
    for key in ("mean_mm", "rms_mm", "peak_mm"):
        after = verdict["gap"]["holdout"]["after"][key]
        assert models["extended"][key] == pytest.approx(after, rel=1e-9)
    assert export(work, tmp_path) == 0
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
    named = work / "extended.json"
    assert calibrate(work, out, settings={"effects": "named"}, named=named) == 0
    said = capsys.readouterr().out
    assert f"{NAME} combined: the verdict not_sought names no effects to calibrate with" in said
    found, plain = (json.loads(path.read_text("utf-8")) for path in (out, work / "combined.json"))
    np.testing.assert_allclose(
        found["covariance"]["matrix"], plain["covariance"]["matrix"], rtol=1e-12
    )


def test_a_model_judged_in_another_place_goes_on(work, tmp_path):
    out = tmp_path / "transfer.json"
    given = {"calibration": work / "combined.json", "extended": work / "extended.json"}
    assert called("transfer", **table_of(work), **given, out=out) == 0
    models = json.loads(out.read_text("utf-8"))["models"]
    assert models["extended"] == models["linear"]


def test_effects_that_are_listed_all_the_same_are_refused(work, tmp_path, capsys):
    out = tmp_path / "combined.json"
    assert calibrate(work, out, settings={"effects": [EFFECT]}) == REFUSED
    assert "too few repeats to determine the repeatability" in capsys.readouterr().err


@pytest.fixture(scope="module")
def touched(tmp_path_factory):
    """Touched balls, every pose once at each load: two models, calibrated and searched."""
    plan = {"repeats": 1, "loads_N": [0.0, 44.0], "holdout_points": 4}
    folder = simulated(tmp_path_factory.mktemp("touched"), NAME, plan)
    calibrated(folder, "combined", "general", starts=1)
    assert discover(folder) == 0
    return folder


@pytest.mark.slow
def test_touched_balls_without_repeats_keep_the_papers_model(touched, tmp_path):
    found = read(VerdictRecord, touched / "verdict.json", NAME)
    assert found.verdict == "not_sought"
    assert found.why.startswith("54 readings of calibration poses are too few")
    out = tmp_path / "holdout.json"
    assert evaluate(touched, out) == 0
    models = json.loads(out.read_text("utf-8"))["models"]
    assert models["extended"]["rms_mm"] == pytest.approx(models["cubic"]["rms_mm"], rel=1e-9)


def test_the_general_model_beside_it_converges(touched):
    """The scatter found about a fit, and that about the next, once took turns for ever."""
    found = json.loads((touched / "general.json").read_text("utf-8"))
    assert found["status"] == "converged"
    assert found["health"]["iterations"] < 60
