"""The workflow run from the command line: progress, refusals, interrupts, one run a folder."""

from __future__ import annotations

import fcntl
import io
import logging
import os
import signal
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import pytest

from pa10cal.errors import OutputError, SettingsError
from pa10cal.running import workflow as running
from pa10cal.running.display import RunDisplay
from pa10cal.running.failure import StageError
from pa10cal.running.workflow import Workflow, run_workflow, settings_of
from snakemake_logger_plugin_pa10cal import LogHandler

SNAKEFILE = """
rule ingest:
    output:
        "{campaign}/poses.txt",
    log:
        "{campaign}/ingest.log",
    shell:
        "CODE"
"""


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run a workflow of one rule with some shell code; return what was shown."""
    rules = tmp_path / "rules"
    rules.mkdir()
    monkeypatch.setattr(running, "workflow_folder", lambda: rules)

    def start(code="touch {output}", *, text=SNAKEFILE, shown=None, lines=True):
        (rules / "Snakefile").write_text(text.replace("CODE", code))
        out = io.StringIO()
        out_dir, targets = tmp_path / "out", ("mine/poses.txt",)
        work = Workflow("Snakefile", {}, out_dir, out_dir, "mine", 1, targets)
        run_workflow(work, shown or RunDisplay(lines=lines, out=out))
        return out.getvalue()

    return start


def test_events_go_to_the_pipe_or_nowhere(monkeypatch, capsys):
    reading, writing = os.pipe()
    done = logging.makeLogRecord({"event": "job_finished", "job_id": 7, "other": "unread"})
    monkeypatch.setenv("PA10CAL_EVENTS", str(writing))
    handler = LogHandler(None, None)
    handler.emit(done)
    handler.emit(logging.makeLogRecord({"event": "other"}))
    assert os.read(reading, 99) == b'{"event": "job_finished", "job_id": 7}\n'
    os.close(reading)
    handler.emit(done)  # nobody reads any more
    assert "BrokenPipeError" in capsys.readouterr().err
    os.close(writing)
    monkeypatch.delenv("PA10CAL_EVENTS")
    LogHandler(None, None).emit(done)  # Snakemake called by hand


@pytest.mark.slow
def test_every_stage_is_a_line_where_lines_are_wanted(run, tmp_path):
    shown = run("echo read; touch {output}")
    assert "mine: read the raw files" in shown
    assert shown.count("\n") == 1
    assert (tmp_path / "out/mine/poses.txt").exists()
    (tmp_path / "out/mine/poses.txt").unlink()
    assert run("touch {output}", lines=False) == ""


def test_on_a_terminal_what_is_at_work_is_shown():
    out = io.StringIO()
    out.isatty = lambda: True
    display = RunDisplay(lines=False, out=out)
    display.started(1, "calibrate", "mine")
    display.progress(2, 9)
    display.tick()
    assert "2 of 9: calibrate 0 s …" in out.getvalue()
    display.finished(1)
    display.close()
    assert "  mine: calibrate " in out.getvalue()
    assert out.getvalue().endswith("\r\x1b[K")


@pytest.mark.slow
def test_a_stage_that_refuses_gives_its_one_message(run):
    code = "echo pa10cal ingest: cmm.csv:7: broken, mend it | tee {log}; exit 2"
    with pytest.raises(StageError) as caught:
        run(code)
    assert str(caught.value) == "ingest: cmm.csv:7: broken, mend it"


@pytest.mark.slow
def test_a_fault_of_a_stage_is_one_here(run):
    code = "echo pa10cal ingest: internal fault, KeyError | tee {log}; exit 3"
    with pytest.raises(RuntimeError, match="ingest: internal fault"):
        run(code)


@pytest.mark.slow
def test_a_workflow_that_refuses_its_settings_is_a_refusal(run):
    text = "import sys\nprint('pa10cal: key campaigns does not fit', file=sys.stderr)\nsys.exit(2)"
    with pytest.raises(StageError, match=r"^key campaigns does not fit$"):
        run("", text=text)


def test_a_handler_that_python_did_not_install_does_not_end_a_run_in_a_fault(monkeypatch):
    installed = []

    def install(number, handler):
        assert handler is not None, "signal.signal raises TypeError"
        installed.append((number, handler))

    monkeypatch.setattr(signal, "signal", install)
    with running._termination_as_interrupt():
        pass
    ends = (signal.SIGTERM, signal.SIGHUP)
    assert installed[2:] == [(number, signal.SIG_DFL) for number in ends]


@pytest.mark.slow
def test_an_interrupt_ends_the_workflow_and_its_jobs(run, tmp_path):
    class Interrupting(RunDisplay):
        def started(self, job, rule, campaign):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run("echo $$ > pid; sleep 100", shown=Interrupting(lines=False, out=io.StringIO()))
    pid = tmp_path / "out/pid"
    if pid.exists():
        with pytest.raises(ProcessLookupError):
            os.kill(int(pid.read_text()), 0)
    assert not (tmp_path / "out/mine/poses.txt").exists()


class Killing(RunDisplay):
    """Kills Snakemake as soon as a job is at work."""

    def tick(self):
        for place in Path("/proc").glob("[0-9]*/cmdline"):
            with suppress(OSError):
                if self.mark in place.read_bytes() and b"snakemake" in place.read_bytes():
                    os.kill(int(place.parent.name), signal.SIGKILL)


@pytest.mark.slow
def test_a_workflow_that_is_killed_takes_its_jobs_along_and_goes_on(run, tmp_path):
    shown = Killing(lines=False, out=io.StringIO())
    shown.mark = str(tmp_path).encode()
    with pytest.raises(StageError, match=r"ended by signal 9.*the same command again"):
        run("echo $$ > pid; sleep 100; touch {output}", shown=shown)
    if (tmp_path / "out/pid").exists():
        pid = int((tmp_path / "out/pid").read_text())
        stat = Path(f"/proc/{pid}/stat")
        assert not stat.exists() or ") Z " in stat.read_text()
    assert "read the raw files" in run("touch {output}")


@pytest.mark.slow
@pytest.mark.parametrize(
    "code",
    [
        "kill -9 $$",
        "bash -c 'kill -9 $$' | tee {log}",
        "echo pa10cal ingest: internal fault: MemoryError: 9 GB | tee {log}; exit 3",
        "echo ImportError: a.so: failed to map segment from shared object; exit 1",
    ],
)
def test_a_job_that_is_killed_is_told(run, code):
    with pytest.raises(OutputError, match=r"killed .* not enough memory.*--cores 1.*goes on"):
        run(code)


@pytest.mark.slow
def test_a_command_that_is_not_there_is_told(run):
    with pytest.raises(RuntimeError, match=r"nosuchprogram.*exit status 127"):
        run("nosuchprogram")


@pytest.mark.slow
def test_a_full_disk_is_told_where_no_command_can(run, tmp_path, monkeypatch):
    monkeypatch.setattr("shutil.disk_usage", lambda place: SimpleNamespace(free=0))
    with pytest.raises(OutputError, match=r"out: the results cannot be written \(got 'No space"):
        run("exit 1")


@pytest.mark.slow
def test_one_run_at_a_time_makes_the_results_of_a_campaign(run, tmp_path):
    locks = tmp_path / "out/.pa10cal/locks"
    locks.mkdir(parents=True)
    with (locks / "mine").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(OutputError, match="another run is at work"):
            run("touch {output}")
    assert "read the raw files" in run("touch {output}")


def test_a_folder_that_cannot_be_written_to_is_refused(run, tmp_path):
    (tmp_path / "out").write_text("a file")
    with pytest.raises(OutputError, match="cannot be written"):
        run("touch {output}")


# Machines: no home, no place for temporary files, a full disk, a folder that is only read.

#: A folder that cannot be made, whoever asks.
NOWHERE = "/proc/nowhere"


@pytest.mark.parametrize("usual", [True, False])
def test_caches_lie_among_the_results_where_the_usual_place_cannot_be_written(
    tmp_path, monkeypatch, usual
):
    home = tmp_path / "home"
    for name in ("XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(home) if usual else NOWHERE)
    found = running._caches(tmp_path / "work")
    assert found == (
        {}
        if usual
        else {
            "XDG_CACHE_HOME": str(tmp_path / "work/cache"),
            "MPLCONFIGDIR": str(tmp_path / "work/cache/matplotlib"),
        }
    )
    monkeypatch.setenv("MPLCONFIGDIR", str(tmp_path / "mine"))
    assert "MPLCONFIGDIR" not in running._caches(tmp_path / "work")


def test_a_user_without_any_home_has_caches_too(tmp_path, monkeypatch):
    for name in ("HOME", "LOGNAME", "USER", "LNAME", "USERNAME"):
        monkeypatch.delenv(name, raising=False)
    for name in ("XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pwd.getpwuid", {}.__getitem__)
    assert running._caches(tmp_path) == {
        "HOME": str(tmp_path / "cache"),
        "LOGNAME": str(os.getuid()),
        "XDG_CACHE_HOME": str(tmp_path / "cache"),
        "MPLCONFIGDIR": str(tmp_path / "cache/matplotlib"),
    }


@pytest.mark.slow
def test_a_run_needs_no_home(run, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", NOWHERE)
    assert "read the raw files" in run()
    monkeypatch.setattr(running, "_caches", lambda work: {})
    (tmp_path / "out/mine/poses.txt").unlink()
    with pytest.raises(OutputError, match=r"nowhere.*(Permission denied|No such file)"):
        run()


@pytest.mark.slow
def test_no_place_for_temporary_files_is_told_as_that(run, monkeypatch):
    code = "import tempfile; tempfile._candidate_tempdir_list = lambda: ['/proc/nowhere']\n"
    with pytest.raises(OutputError, match=r"machine.*No usable temporary directory"):
        run(text=code + "tempfile.tempdir = None; tempfile.TemporaryDirectory()\n" + SNAKEFILE)


# Settings of a run: files, the later over the earlier, key by key.


def test_later_files_go_over_earlier_ones_at_every_depth(tmp_path):
    first, second = tmp_path / "a.yaml", tmp_path / "b.yaml"
    first.write_text("campaigns: [x]\ncalibration: {starts: 3, inner_poses: 5}\n")
    second.write_text("calibration: {starts: 2}\n")
    used = settings_of([first, second], {"campaigns": ["mine"]}, "here")
    assert used.campaigns == ("mine",)
    assert (used.calibration.starts, used.calibration.inner_poses) == (2, 5)
    assert settings_of([], {"campaigns": ["mine"]}, "here").results_dir == "results"


@pytest.mark.parametrize("text", ["- a list\n", "a: [\n", None])
def test_a_file_that_is_none_of_settings_is_refused(tmp_path, text):
    path = tmp_path / "s.yaml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(SettingsError, match=r"s\.yaml: the settings cannot be read"):
        settings_of([path], {"campaigns": ["mine"]}, "here")


def test_a_wrong_key_is_named(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text("calibraton: {}\n")
    with pytest.raises(SettingsError, match="did you mean 'calibration'"):
        settings_of([path], {"campaigns": ["mine"]}, "here")
