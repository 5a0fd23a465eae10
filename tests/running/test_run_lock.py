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
from pa10cal.running.run_lock import HELD, RUN, SHARED, WORK_FOLDER, run_lock

HOLDS = """
import sys, time
from pathlib import Path
from pa10cal.running.run_lock import hold
hold(Path(sys.argv[1]))
print("held", flush=True)
time.sleep(100)
"""
JOB = """
import time
from pa10cal.running.run_lock import share
from pa10cal.running.run_lock import end_with_parents
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
        process.stdout.readline()
        return process

    yield start
    for process in processes:
        process.kill()
        process.wait()
        process.stdout.close()


def test_a_second_run_is_told_who_is_at_work(tmp_path, started):
    (tmp_path / "elsewhere").mkdir()
    first = started(HOLDS, tmp_path / "results", cwd=tmp_path / "elsewhere")
    with pytest.raises(OutputError, match="at work") as caught, run_lock(tmp_path / "results"):
        pytest.fail("two runs at once")
    assert f"process {first.pid} on {os.uname().nodename}" in str(caught.value)
    assert str(tmp_path / "elsewhere") in str(caught.value)
    first.kill()
    first.wait()
    with run_lock(tmp_path / "results"):
        pass


def test_a_run_holds_once_what_its_parts_hold_again(tmp_path):
    with run_lock(tmp_path) as work:
        assert os.environ[HELD] == str(work)
        with run_lock(tmp_path) as again:
            assert again == work
    assert HELD not in os.environ


def test_a_run_waits_for_the_jobs_of_a_dead_one(tmp_path, started, monkeypatch, capsys):
    with run_lock(tmp_path) as work:
        pass
    monkeypatch.setattr(module, "_SOON_S", 0.0)
    job = started(JOB, **{SHARED: str(work)})

    def end(_):
        job.kill()
        job.wait()

    monkeypatch.setattr(module.time, "sleep", end)
    with run_lock(tmp_path):
        assert job.returncode is not None
    assert capsys.readouterr().err.count("waiting for jobs of an earlier run") == 1


def test_a_job_whose_run_has_ended_does_nothing(tmp_path, started):
    def job():
        words = [sys.executable, "-m", "pa10cal", "--version"]
        return subprocess.run(words, env=env, capture_output=True, text=True)

    first, work = started(HOLDS, tmp_path), tmp_path / WORK_FOLDER
    env = {**os.environ, SHARED: str(work), RUN: (work / "lock").read_text("utf-8")}
    env |= {"PA10CAL_PARENTS": str(os.getpid())}
    assert job().returncode == 0
    first.kill()
    first.wait()
    assert job().returncode == 2
    started(HOLDS, tmp_path)
    assert "the run that this is a job of has ended" in job().stderr


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
    with run_lock(tmp_path):
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
    with pytest.raises(OutputError, match="the results cannot"), run_lock(tmp_path / "out"):
        pytest.fail("it cannot be held")
