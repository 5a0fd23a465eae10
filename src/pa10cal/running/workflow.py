"""Runs the workflow in a process of its own, and follows its jobs."""

from __future__ import annotations

import fcntl
import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

import pa10cal
from pa10cal.errors import OutputError, Pa10calError, last_message
from pa10cal.extras import MissingPackageError
from pa10cal.files.output import writing_into

#: Beside a results folder: Snakemake's own files, and what it and the commands print.
WORK_FOLDER = ".pa10cal"
PRINTED = "printed.log"
#: So often a display is told that time has passed [s].
_TICK_S = 0.5


class Display(Protocol):
    """Shows how far a run is."""

    def started(self, job: int, rule: str, campaign: str) -> None:
        """Show that a job has begun."""

    def finished(self, job: int) -> None:
        """Show that a job has ended."""

    def progress(self, done: int, total: int) -> None:
        """Show how many jobs are done."""

    def tick(self) -> None:
        """Show that time has passed."""


@dataclass(frozen=True)
class Workflow:
    """A run of the workflow.

    Attributes:
        file: Snakefile, inside the folder of the workflow.
        targets: rules or files; none for the default.
        config: settings, each as YAML on one line.
        folder: working folder; gets `WORK_FOLDER`.
        cores: how many to use; 0 for all.
        settings: file of settings, over the shipped ones.
        more: further options of Snakemake.
    """

    file: str
    config: Mapping[str, str]
    folder: Path
    cores: int = 0
    targets: Sequence[str] = ()
    settings: Path | None = None
    more: Sequence[str] = field(default=())

    @property
    def command(self) -> list[str]:
        """Return the command that runs it."""
        words = [sys.executable, "-m", "snakemake", "--snakefile"]
        words += [str(workflow_folder() / self.file), "--directory", str(self.folder)]
        words += ["--cores", str(self.cores or len(os.sched_getaffinity(0)))]
        words += ["--rerun-incomplete", "--nolock", "--nocolor", *self.more]
        # An empty profile in place of one that stands beside the Snakefile.
        words += ["--workflow-profile", "none"]
        if self.settings is not None:
            words += ["--configfile", str(self.settings.absolute())]
        pairs = [f"{name}={value}" for name, value in self.config.items()]
        return [*words, *(["--config", *pairs] if pairs else []), "--", *self.targets]


class StageError(Pa10calError):
    """A command of the workflow refused; its own message says why."""

    def __init__(self, message: str) -> None:
        Exception.__init__(self, message)
        self.what, self.where, self.value, self.allowed, self.remedy = message, "", None, "", ""


def workflow_folder() -> Path:
    """Return the folder of Snakefile and config.yaml: of the checkout, or inside the package.

    Raises:
        OutputError: when the package was installed without them.
    """
    package = Path(pa10cal.__file__).parent
    for folder in (package.parents[1], package / "workflow"):
        if (folder / "Snakefile").is_file() and (folder / "config.yaml").is_file():
            return folder
    raise OutputError(
        "the rules of the workflow are missing from the installation",
        where=str(package),
        allowed="a wheel or a checkout of the project",
        remedy="install pa10cal again",
    )


def refuse_without_snakemake() -> None:
    """Stop where Snakemake is not installed.

    Raises:
        MissingPackageError: naming it.
    """
    if find_spec("snakemake") is None:
        raise MissingPackageError("snakemake")


def run_workflow(workflow: Workflow, display: Display) -> None:
    """Run the workflow to its end, and tell a display what happens.

    What Snakemake and the commands print goes to `WORK_FOLDER/PRINTED`.

    Raises:
        StageError: when a command, or the workflow itself, refuses.
        OutputError: when another run is at work in the folder, or it cannot be written to.
        RuntimeError: when a command, or the workflow, fails.
    """
    refuse_without_snakemake()
    with (
        _alone(workflow.folder) as work,
        (work / PRINTED).open("w+", encoding="utf-8") as printed,
        _ended_as_interrupted(),
    ):
        reading, writing = os.pipe()
        child = subprocess.Popen(
            workflow.command,
            stdin=subprocess.DEVNULL,
            stdout=printed,
            stderr=subprocess.STDOUT,
            env={**os.environ, "PA10CAL_EVENTS": str(writing)},
            pass_fds=(writing,),
            start_new_session=True,  # an interrupt is passed on once, below
        )
        os.close(writing)
        failed: list[str] = []
        try:
            with os.fdopen(reading, "rb", buffering=0) as events:
                for event in _events(events.fileno(), display):
                    _tell(display, event, failed)
            code = child.wait()
        except BaseException:
            _stop(child)
            raise
        if code != 0:
            printed.seek(0)
            raise _failure(failed, workflow.folder, printed.read())


def _events(pipe: int, display: Display) -> Iterator[dict[str, Any]]:
    """Yield what the workflow tells, until it ends."""
    rest = b""
    while True:
        ready, _, _ = select.select([pipe], [], [], _TICK_S)
        if not ready:
            display.tick()
            continue
        content = os.read(pipe, 1 << 16)
        if not content:
            return
        *lines, rest = (rest + content).split(b"\n")
        yield from map(json.loads, lines)


def _tell(display: Display, event: dict[str, Any], failed: list[str]) -> None:
    kind = event["event"]
    if kind == "job_info":
        wildcards = event["wildcards"] or {}
        of = wildcards.get("campaign") or wildcards.get("study") or wildcards.get("shape") or ""
        display.started(int(event["jobid"]), str(event["rule_name"]), str(of))
    elif kind == "job_finished":
        display.finished(int(event["job_id"]))
    elif kind == "progress":
        display.progress(int(event["done"]), int(event["total"]))
    elif kind == "job_error":
        failed += event["log"] or []


def _failure(logs: Sequence[str], folder: Path, printed: str) -> Exception:
    """Return why a run failed: the message of the command, or else of the workflow itself."""
    for log in logs:
        with suppress(OSError):
            printed = (folder / log).read_text(encoding="utf-8", errors="replace")
            break
    told = last_message(printed)
    if told is None:
        last = [line for line in printed.splitlines() if line.strip()][-8:]
        return RuntimeError("the workflow failed: " + " | ".join(last))
    words, message = told
    stage = words.removeprefix("pa10cal").strip()
    if "internal fault" in message:
        return RuntimeError(f"{stage}: {message}")
    return StageError(f"{stage}: {message}" if stage else message)


def _stop(child: subprocess.Popen[bytes]) -> None:
    """Let the workflow and its jobs end, as they do when interrupted at a keyboard."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        with suppress(ProcessLookupError):
            os.killpg(child.pid, number)
        with suppress(subprocess.TimeoutExpired):
            child.wait(timeout=10)
            return


@contextmanager
def _ended_as_interrupted() -> Iterator[None]:
    """Take a request to end as an interrupt, so that the workflow, in its own session, ends too."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    former = {
        number: signal.signal(number, interrupt) for number in (signal.SIGTERM, signal.SIGHUP)
    }
    try:
        yield
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)


@contextmanager
def _alone(folder: Path) -> Iterator[Path]:
    """Hold a working folder for this run; the system lets go of it however the run ends.

    Raises:
        OutputError: when it cannot be written to, or another run holds it.
    """
    work = folder / WORK_FOLDER
    with writing_into(folder, "the results", "give another one with --out"):
        work.mkdir(parents=True, exist_ok=True)
        lock = (work / "lock").open("w")
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OutputError(
                "another run is at work in this folder",
                where=str(folder),
                allowed="one run at a time",
                remedy="wait for it to end, or give another folder with --out",
            ) from None
        yield work
