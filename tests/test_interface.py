"""The public Python interface, used as its documentation says."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from python_page import reference

import pa10cal
from made_up_model import fitted
from pa10cal.calibration import campaign as calibration_of
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.errors import ArmError, CalibrationError, DiscoveryError, ModelError
from pa10cal.results.calibration import InputFinding

ROOT = Path(__file__).parents[1]
RAW = ROOT / "data/raw/cell-a"


def test_the_reference_page_is_up_to_date():
    page = (ROOT / "docs/python.md").read_text(encoding="utf-8")
    assert page == reference(), "run make schema"


def test_every_public_name_is_there_and_documented():
    for name in pa10cal.__all__:
        assert getattr(pa10cal, name).__doc__
    assert set(pa10cal.__all__) <= set(dir(pa10cal))
    with pytest.raises(AttributeError, match="no attribute 'calibrat'"):
        _ = pa10cal.calibrat


def test_importing_the_package_imports_nothing_heavy():
    code = "import sys, pa10cal; print(sorted({'numpy', 'pandas', 'scipy'} & set(sys.modules)))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    """Run the example once; its model and what it prints."""
    out = tmp_path_factory.mktemp("example") / "model.yaml"
    code = ROOT / "examples/calibrate_and_discover.py"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [str(code), str(RAW), str(out)])
        lines: list[str] = []
        patch.setattr("builtins.print", lambda *words: lines.append(" ".join(map(str, words))))
        runpy.run_path(str(code), run_name="__main__")
    return lines, out


def test_the_example_names_what_is_hidden(printed):
    lines, _ = printed
    assert "verdict: named" in lines
    assert "  transmission_error of joint 2" in lines
    assert any(line.startswith("held out:") for line in lines)


def test_the_example_without_its_arguments_says_how_it_is_called(monkeypatch):
    code = ROOT / "examples/calibrate_and_discover.py"
    monkeypatch.setattr(sys, "argv", [str(code)])
    with pytest.raises(SystemExit, match=r"calibrate_and_discover\.py data/raw"):
        runpy.run_path(str(code), run_name="__main__")


def test_its_model_is_enough_by_itself(printed):
    _, out = printed
    model = pa10cal.load_model(out)
    assert {"friction_torque", "transmission_error"} <= set(model.parameters["term"])
    found = model.predict(np.zeros(6))
    assert isinstance(found, pa10cal.Prediction)
    assert 0.0 < found.u_mm[0] < 0.1
    # Straight up the nominal flange is at (0, 0, 1.317) m, and calibration moves it little.
    np.testing.assert_allclose(found.T[0, :3, 3], [0.0, 0.0, 1.317], atol=0.02)


@pytest.fixture(scope="module")
def points():
    """Return a campaign of targets, as the examples have it."""
    return pa10cal.read_campaign(ROOT / "examples/irb120-points")


@pytest.fixture
def uncalibrated(monkeypatch):
    """Fail where a calibration is begun."""

    def begun(*_):
        raise AssertionError("a calibration was begun")

    monkeypatch.setattr(calibration_of, "calibrated_record", begun)


@pytest.mark.parametrize(
    ("robot", "words"),
    [("ur10", "it is a model of another arm"), ("irb120", "it has other targets")],
)
def test_a_model_that_is_not_of_the_campaign_is_not_searched(points, robot, words):
    with pytest.raises(CalibrationError, match=f"model: {words}"):
        pa10cal.discover(points, fitted(robot, 1))


def test_effects_of_a_verdict_are_refused_before_anything_is_fitted(points, uncalibrated):
    with pytest.raises(CalibrationError, match=r"got 'named'.*; list the effects"):
        pa10cal.calibrate(points, CalibrationOptions(effects="named"))


@pytest.mark.parametrize("kind", [str, Path])
def test_a_prior_may_be_a_file(points, uncalibrated, kind, tmp_path):
    with pytest.raises(ModelError, match=r"model\.yaml"):
        pa10cal.calibrate(points, prior=kind(tmp_path / "model.yaml"))
    path = tmp_path / "model.yaml"
    fitted("irb120", 1).save(path)
    with pytest.raises(AssertionError, match="a calibration was begun"):
        pa10cal.calibrate(points, prior=kind(path))


def test_a_load_that_was_not_measured_is_refused(points):
    with pytest.raises(CalibrationError, match=r"load case: no grid pose .*'44 N'"):
        pa10cal.calibrate(points, load="44 N")


def test_too_few_poses_for_effects_are_explained_by_the_findings(points, monkeypatch):
    def refuse(*_):
        raise DiscoveryError("too few", where="poses", allowed="more", remedy="measure more")

    found = InputFinding(what="it is off", where="q2_deg", remedy="mend it", kind="joint_zero")
    monkeypatch.setattr(calibration_of, "calibrated_record", refuse)
    monkeypatch.setattr("pa10cal.calibration.input_checks.check_input", lambda *_: (found,))
    with pytest.raises(DiscoveryError, match=r"too few.*check the input: .*q2_deg"):
        pa10cal.calibrate(points)


def test_a_plan_is_for_an_arm_of_a_file_too(tmp_path):
    with pytest.raises(ArmError, match=r"/ur10\.yaml"):
        pa10cal.plan(str(tmp_path / "ur10.yaml"), "pose", 30)
    with pytest.raises(ArmError, match=r"such as ur11\.yaml$"):
        pa10cal.load_arm("ur11.yaml")


def test_what_is_refused_is_one_kind_of_error(tmp_path):
    with pytest.raises(pa10cal.Pa10calError, match=r"campaign\.yaml"):
        pa10cal.read_campaign(tmp_path)
    with pytest.raises(pa10cal.Pa10calError, match="unknown robot"):
        pa10cal.load_arm("pa11")
