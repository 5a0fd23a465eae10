"""One run at a time, jobs that end with it, and nothing left of the dead."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from pa10cal.errors import OutputError
from pa10cal.files.output import whole_file
from pa10cal.running import run_lock as module
from pa10cal.running.run_lock import RUN, WORK_FOLDER, hold, refuse_at_work, run_lock

HOLDS = """
import os, sys, time
from pathlib import Path
from pa10cal.running.run_lock import RUN, hold
results = Path(sys.argv[1])
hold(results, [results / name / "model/model.yaml" for name in sys.argv[2:]])
print(os.environ[RUN], flush=True)
time.sleep(100)
"""
JOB = """
import time
from pa10cal.running.child import end_with_parents
from pa10cal.running.run_lock import share
end_with_parents()
share()
print("held", flush=True)
time.sleep(100)
"""


@pytest.fixture
def started():
    """Start Python code in a process of its own, and wait for its first line."""
    processes = []

    def start(code, *words, cwd=None, **env):
        process = subprocess.Popen(
            [sys.executable, "-c", code, *map(str, words)],
            env={**os.environ, **env},
            stdout=subprocess.PIPE,
            cwd=cwd,
        )
        processes.append(process)
        process.said = process.stdout.readline().decode().strip()
        return process

    yield start
    for process in processes:
        process.kill()
        process.wait()
        process.stdout.close()


def test_a_second_run_of_a_campaign_is_told_who_is_at_work(tmp_path, started):
    (tmp_path / "elsewhere").mkdir()
    results = tmp_path / "results"
    first = started(HOLDS, results, "mine", "other", cwd=tmp_path / "elsewhere")
    with pytest.raises(OutputError, match="at work") as caught, run_lock(results, ["mine", "a"]):
        pytest.fail("two runs at once")
    assert caught.value.where == str(results / "mine")
    assert f"process {first.pid} on {os.uname().nodename}" in str(caught.value)
    assert str(tmp_path / "elsewhere") in str(caught.value)
    with pytest.raises(OutputError, match="at work"):
        refuse_at_work(results / "mine")
    with run_lock(results, ["a"]):  # which the refused one has let go
        refuse_at_work(tmp_path / "results/none")
    first.kill()
    first.wait()
    refuse_at_work(results / "mine")
    with run_lock(results, ["mine"]):
        pass


def test_runs_of_different_campaigns_of_a_folder_go_beside_each_other(tmp_path, started):
    one, two = started(HOLDS, tmp_path, "one"), started(HOLDS, tmp_path, "two", "three")
    with run_lock(tmp_path, ["four"]):
        assert one.poll() is None
        assert two.poll() is None
        assert one.said != two.said


def test_of_two_runs_that_want_the_same_campaigns_one_gets_all(tmp_path, started):
    # In one order whatever the order given: else each could hold what the other one wants.
    started(HOLDS, tmp_path, "a")
    with pytest.raises(OutputError, match="at work"), run_lock(tmp_path, ["b", "a"]):
        pytest.fail("two runs at once")
    assert [path.name for path in (tmp_path / WORK_FOLDER / "locks").iterdir()] == ["a"]


def test_a_run_holds_once_what_its_parts_hold_again(tmp_path):
    results = tmp_path / "results"
    with run_lock(results, ["mine"]) as work:
        run = os.environ[RUN]
        with run_lock(results, ["mine", "more"]) as again:
            assert again == work
            assert os.environ[RUN] == run
        with run_lock(tmp_path / "others", ["mine"]):
            assert os.environ[RUN] != run
        assert os.environ[RUN] == run
    assert RUN not in os.environ
    assert list((work / "runs").iterdir()) == []


def test_files_outside_of_the_results_are_held_by_nobody(tmp_path, started):
    def held():
        return sorted(path.name for path in (results / WORK_FOLDER / "locks").iterdir())

    results = tmp_path / "results"
    with pytest.MonkeyPatch.context() as patch, module.ExitStack() as stack:
        patch.setattr(module, "_HELD_TO_THE_END", stack)
        patch.chdir(tmp_path)
        inside = ("results/a/x.json", results / "a/y/z.json", "results/coverage.json")
        hold(results, [*inside, "raw/b/campaign.yaml", tmp_path / "c"])
        assert held() == ["a", "coverage.json"]


def test_thousands_of_campaigns_are_held_at_once(tmp_path):
    code = (
        "import resource\nfrom pathlib import Path\nfrom pa10cal.running.run_lock import run_lock\n"
        "resource.setrlimit(resource.RLIMIT_NOFILE, (256, 4096))\n"
        f"with run_lock(Path({str(tmp_path)!r}), map(str, range(2000))): print('held')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("held\n", "")


def test_a_run_waits_for_the_jobs_of_a_dead_one(tmp_path, started, monkeypatch, capsys):
    dead = started(HOLDS, tmp_path, "mine", "other")
    job = started(JOB, **{RUN: dead.said})
    dead.kill()
    dead.wait()
    monkeypatch.setattr(module, "_JOBS_END_S", 0.0)

    def end(_):
        job.kill()
        job.wait()

    with run_lock(tmp_path, ["another"]):  # that the dead run did not make
        pass
    monkeypatch.setattr(module.time, "sleep", end)
    with run_lock(tmp_path, ["mine"]) as work:
        assert job.returncode is not None
    assert capsys.readouterr().err.count("waiting for jobs of an earlier run on") == 1
    with run_lock(tmp_path, ["other"]):
        pass
    assert list((work / "runs").iterdir()) == []


def test_a_job_whose_run_has_ended_does_nothing(tmp_path, started):
    def job():
        words = [sys.executable, "-m", "pa10cal", "--version"]
        return subprocess.run(words, env=env, capture_output=True, text=True)

    first = started(HOLDS, tmp_path, "mine")
    env = {**os.environ, RUN: first.said, "PA10CAL_PARENTS": str(os.getpid())}
    assert job().returncode == 0
    first.kill()
    first.wait()
    assert job().returncode == 2
    started(HOLDS, tmp_path, "mine")
    assert "the run that this is a job of has ended" in job().stderr


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("without", [False, True], ids=["pidfd", "looking"])
def test_a_job_ends_with_each_of_its_parents(started, without):
    parent, other = (started("print('x', flush=True); import time; time.sleep(100)") for _ in "ab")
    off = "import os; del os.pidfd_open\n" if without else ""
    job = started(off + JOB, PA10CAL_PARENTS=f"{parent.pid} {other.pid}")
    time.sleep(0.3)
    assert job.poll() is None
    other.kill()
    other.wait()
    assert job.wait(timeout=20) == -signal.SIGKILL
    late = started(off + JOB, PA10CAL_PARENTS=f"{other.pid}")
    assert late.wait(timeout=20) == -signal.SIGKILL


def test_files_that_a_dead_process_left_are_removed(tmp_path, started):
    code = (
        "import sys, time\nfrom pathlib import Path\nfrom pa10cal.files.output import whole_file\n"
        "with whole_file(Path(sys.argv[1])): print('x', flush=True); time.sleep(100)"
    )
    dead = started(code, tmp_path / "a/dead.txt")
    alive = started(code, tmp_path / "a/alive.txt")
    dead.kill()
    dead.wait()
    assert len(list(tmp_path.rglob("*.partial.*"))) == 2
    with run_lock(tmp_path, ["b"]):
        assert len(list(tmp_path.rglob("*.partial.*"))) == 2
    with run_lock(tmp_path, ["a"]):
        (left,) = tmp_path.rglob("*.partial.*")
    assert left.name == f".{alive.pid}.partial.alive.txt"


def test_the_next_writer_of_a_file_removes_what_a_dead_one_left(tmp_path):
    (tmp_path / ".999.partial.a.txt").write_text("half")
    (tmp_path / ".999.partial.b.txt").write_text("half")
    with whole_file(tmp_path / "a.txt") as beside:
        beside.write_text("whole")
    assert {p.name for p in tmp_path.iterdir()} == {"a.txt", ".999.partial.b.txt"}


def test_a_folder_that_cannot_be_written_to_is_named(tmp_path):
    (tmp_path / "out").write_text("a file")
    with pytest.raises(OutputError, match="the results cannot"), run_lock(tmp_path / "out", []):
        pytest.fail("it cannot be held")
