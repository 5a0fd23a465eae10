"""Equal campaigns and settings give equal bytes: over runs, cores, folders and environments."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from benchmarks.digits import ask

EXAMPLE = Path(__file__).parents[2] / "examples/irb120-points"
#: What must not matter: language, time zone, order of sets and dictionaries, threads.
OTHER = {
    "LC_ALL": "tr_TR.UTF-8",
    "LANG": "de_DE.UTF-8",
    "TZ": "Asia/Kathmandu",
    "PYTHONHASHSEED": "77",
    "OPENBLAS_NUM_THREADS": "2",
    "OMP_NUM_THREADS": "2",
}
#: How far kernels may lead parameters from each other, in their standard uncertainties.
WITHIN_U = 1e-7


def run(folder, cores, umask, **env):
    """Run the smallest campaign in a folder, and return its results by their paths."""
    shutil.copytree(EXAMPLE, folder / "raw")
    words = [sys.executable, "-m", "pa10cal", "run", "raw", "--out", "out", "--cores", str(cores)]
    done = subprocess.run(
        words, cwd=folder, env={**os.environ, **env}, umask=umask, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    results = folder / "out/irb120-points"
    paths = (path for path in results.rglob("*") if path.is_file())
    # Logs name the folder and say how long it took.
    found = {path.relative_to(results): path.read_bytes() for path in paths}
    return {path: content for path, content in found.items() if path.parts[0] != "logs"}


@pytest.mark.slow
@pytest.mark.digits
def test_results_depend_on_nothing_but_campaign_and_settings(tmp_path):
    (tmp_path / "one").mkdir()
    (tmp_path / "an öther folder").mkdir()
    one = run(tmp_path / "one", 1, 0o022, PYTHONHASHSEED="1", TZ="UTC", LC_ALL="C")
    other = run(tmp_path / "an öther folder", 2, 0o077, **OTHER)
    assert set(one) == set(other)
    assert not [str(path) for path, content in one.items() if other[path] != content]


@pytest.mark.slow
def test_kernels_of_sse_avx_and_avx2_agree_but_for_the_last_digits(tmp_path):
    """The bound that docs/how-to/cluster.md promises of processors of different kinds."""
    _, features = ask()
    found = {}
    for kernel in ("Nehalem", "Sandybridge", "Haswell"):
        env = {"OPENBLAS_CORETYPE": kernel}
        if kernel != "Haswell":
            env["NPY_DISABLE_CPU_FEATURES"] = features
        if ask(**env)[0] != kernel:
            continue  # a processor without them
        words = ["chain", "--campaign-dir", str(EXAMPLE), "--results", str(tmp_path / kernel)]
        words = [sys.executable, "-m", "pa10cal", *words]
        subprocess.run(words, env={**os.environ, **env}, check=True, capture_output=True)
        found[kernel] = json.loads((tmp_path / kernel / "calibration/combined.json").read_text())
    if len(found) < 2:
        pytest.skip("this processor has one kind of kernels")
    first, *others = (each["parameters"] for each in found.values())
    for other in others:
        assert list(first) == list(other)
        for name, one in first.items():
            assert abs(one["value"] - other[name]["value"]) <= WITHIN_U * one["std"], name
