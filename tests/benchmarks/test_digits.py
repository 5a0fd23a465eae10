"""The machines that this one can be, for the tests of digits."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from benchmarks import digits


def test_a_test_that_compares_digits_has_the_marker(request):
    np.testing.assert_array_equal(1.0, 1.0)
    assert request.node.get_closest_marker("digits")


def test_another_kernel_is_taken_and_numpy_does_without_its_features():
    core, features = digits.ask(OPENBLAS_CORETYPE="Nehalem")
    if core != "Nehalem":
        pytest.skip("OpenBLAS has no kernels of Nehalem here")
    assert digits.ask(NPY_DISABLE_CPU_FEATURES=features)[1] == ""


@pytest.mark.slow
def test_kernels_that_this_processor_lacks_are_left_out_and_told(monkeypatch, tmp_path, capsys):
    def ask(OPENBLAS_CORETYPE):
        return OPENBLAS_CORETYPE if OPENBLAS_CORETYPE == "Sandybridge" else "Nehalem", "X86_V3"

    monkeypatch.setattr(digits, "ask", ask)
    found = digits.environments(tmp_path)
    assert [env["OPENBLAS_CORETYPE"] for _, env in found] == ["Nehalem", "Sandybridge"]
    assert found[0][1]["NPY_DISABLE_CPU_FEATURES"] == "X86_V3"
    assert found[0][1]["TZ"] == "Asia/Kolkata"
    shown = capsys.readouterr().out
    for kernel in ("Haswell", "Zen"):
        assert f"{kernel}: left out, OpenBLAS takes the kernels of Nehalem here" in shown


def test_a_language_that_cannot_be_made_is_left_out_and_told(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(digits, "ask", lambda **env: (env["OPENBLAS_CORETYPE"], ""))
    monkeypatch.setattr(shutil, "which", lambda name: None)
    found = digits.environments(tmp_path)
    assert len(found) == len(digits.OTHERS)
    assert "LC_ALL" not in found[0][1]
    assert "de_DE: left out, no such locale and no localedef" in capsys.readouterr().out
