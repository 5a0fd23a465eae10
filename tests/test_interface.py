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


def test_its_model_is_enough_by_itself(printed):
    _, out = printed
    model = pa10cal.load_model(out)
    assert {"friction_torque", "transmission_error"} <= set(model.parameters["term"])
    found = model.predict(np.zeros(6))
    assert isinstance(found, pa10cal.Prediction)
    assert 0.0 < found.u_mm[0] < 0.1
    # Straight up the nominal flange is at (0, 0, 1.317) m, and calibration moves it little.
    np.testing.assert_allclose(found.T[0, :3, 3], [0.0, 0.0, 1.317], atol=0.02)


def test_what_is_refused_is_one_kind_of_error(tmp_path):
    with pytest.raises(pa10cal.Pa10calError, match=r"campaign\.yaml"):
        pa10cal.read_campaign(tmp_path)
    with pytest.raises(pa10cal.Pa10calError, match="unknown robot"):
        pa10cal.load_arm("pa11")
