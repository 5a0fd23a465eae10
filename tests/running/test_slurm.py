"""Campaigns on a real Slurm: the bytes of a run without it, whatever happens to workers.

`.ci/slurm start` sets up a Slurm of two workers on this machine, as root.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import pytest

from pa10cal.errors import MissingPackageError, OutputError
from pa10cal.running import workflow as running
from pa10cal.running.workflow import Workflow, refuse_without_snakemake, workflow_folder

ROOT = Path(__file__).parents[2]
NAMES = ("c1", "c2", "c3")
BREAKS = "five minutes of waiting for Slurm: make test-slurm, with the Slurm of .ci/slurm"


def said(*words):
    """Run a program of Slurm, and return what it says; nothing where it is not there."""
    if shutil.which(words[0]) is None:
        return ""
    return subprocess.run(words, capture_output=True, text=True, timeout=30).stdout


def why_not():
    """Say why there is no Slurm to try."""
    if shutil.which("sbatch") is None:
        return "sbatch is not installed"
    if find_spec("snakemake_executor_plugin_slurm") is None:
        return "snakemake-executor-plugin-slurm is not installed"
    return "" if said("sinfo", "--noheader") else "no controller of Slurm answers"


def our_own():
    """Return whether this Slurm is the one that .ci/slurm starts, and may be broken."""
    return "= pa10cal\n" in said("scontrol", "show", "config")


@pytest.fixture(scope="module")
def controller():
    """A Slurm that answers; asked by tests alone, for one that is away takes half a minute."""
    if reason := why_not():
        pytest.skip(reason)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with the same small campaign under three names, and its results without Slurm."""
    folder = tmp_path_factory.mktemp("cluster")
    for name in NAMES:
        raw = shutil.copytree(ROOT / "examples/irb120-points", folder / "raw" / name)
        text = (raw / "campaign.yaml").read_text("utf-8")
        text = text.replace("name: irb120-points", f"name: {name}")
        (raw / "campaign.yaml").write_text(text, "utf-8")
    assert started(folder, "local", "--cores", "1").wait(timeout=300) == 0
    return folder


def started(folder, out, *more):
    """Start a run of the campaigns."""
    words = [sys.executable, "-m", "pa10cal", "fleet", "*", "--raw-dir", "raw", "--out", out]
    with (folder / f"{out}.txt").open("w") as printed:
        return subprocess.Popen([*words, *more], cwd=folder, stdout=printed, stderr=printed)


def contents(results):
    """Return the bytes of all results by their paths; logs and what is Snakemake's are none."""
    places = [results / name for name in (*NAMES, "fleet")]
    paths = [path for place in places for path in place.rglob("*") if path.is_file()]
    return {
        str(path.relative_to(results)): path.read_bytes()
        for path in paths
        if "logs" not in path.parts and path.suffix != ".log"
    }


def until(found, seconds=180.0):
    """Wait until a function finds something, and return that."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if result := found():
            return result
        time.sleep(0.2)
    raise AssertionError("it did not come about in time")


@pytest.mark.slow
@pytest.mark.usefixtures("controller")
def test_results_are_those_without_slurm(place):
    assert started(place, "slurm", "--profile", "slurm").wait(timeout=600) == 0
    assert contents(place / "slurm") == contents(place / "local")


@pytest.mark.slow
@pytest.mark.skipif(not os.environ.get("PA10CAL_BREAK_SLURM"), reason=BREAKS)
@pytest.mark.usefixtures("controller")
def test_a_dead_worker_a_job_out_of_time_and_a_new_controller_lose_nothing(place):
    if not our_own():
        pytest.skip(BREAKS)

    def slurm(*words):
        subprocess.run([ROOT / ".ci/slurm", *words], check=True)

    def running_on(worker):
        return said("squeue", "-h", "-t", "R", "-w", worker, "-o", "%A").split()

    run = started(place, "broken", "--profile", "slurm")
    try:
        until(lambda: running_on("worker1"))
        slow = until(lambda: running_on("worker2"))
        slurm("kill", "worker1")
        slurm("hang", "worker2")
        for job in slow:
            said("scontrol", "update", f"jobid={job}", "TimeLimit=1")
        time.sleep(8)  # a controller saves its state every five seconds
        slurm("restart")
        until(lambda: "TIMEOUT" in said("squeue", "-h", "-t", "all", "-j", slow[0], "-o", "%T"))
        assert run.wait(timeout=900) == 0
    finally:
        run.kill()
        slurm("revive", "worker1")
    assert contents(place / "broken") == contents(place / "local")


def test_a_profile_is_a_folder_or_one_that_is_shipped(tmp_path):
    shipped = Workflow("Snakefile", {}, tmp_path, tmp_path, "mine", profile="slurm")
    folder = str(workflow_folder() / "workflow/profiles/slurm")
    assert shipped.profile == folder
    assert shipped.command[shipped.command.index("--workflow-profile") + 1] == folder
    assert Workflow("Snakefile", {}, tmp_path, tmp_path, "mine", profile=folder).profile == folder
    with pytest.raises(OutputError, match=r"--profile: there is no such profile \(got 'slrum'\)"):
        Workflow("Snakefile", {}, tmp_path, tmp_path, "mine", profile="slrum")


def test_a_profile_without_its_plugin_names_the_extra(monkeypatch):
    there = {"snakemake": True}
    monkeypatch.setattr(running, "find_spec", there.get)
    profile = str(workflow_folder() / "workflow/profiles/slurm")
    with pytest.raises(MissingPackageError, match=r"'\.\[slurm\]'"):
        refuse_without_snakemake(profile)
