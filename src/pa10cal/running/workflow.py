"""Runs the workflow in a process of its own, and reads the settings that it runs with."""

from __future__ import annotations

import getpass
import json
import os
import re
import select
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pa10cal
from pa10cal import errors
from pa10cal.files.output import writing_into
from pa10cal.running.child import PARENTS
from pa10cal.running.display import RunDisplay
from pa10cal.running.failure import failure
from pa10cal.running.run_lock import run_lock

if TYPE_CHECKING:
    from pa10cal.settings import Settings

#: Period at which the display is brought up to date while nothing happens [s].
_TICK_S = 0.5
#: Time that the workflow has to end after each signal [s].
_STOP_S = 10.0
#: Largest number of bytes that are read of the events at a time.
_BLOCK_BYTES = 1 << 16


@dataclass(frozen=True)
class Workflow:
    """A run of the workflow."""

    file: str  # Snakefile, inside the folder of the workflow
    config: Mapping[str, str]  # settings by their keys, each value as YAML on one line
    folder: Path  # working folder, in which Snakemake writes its own files
    results: Path  # folder of results, in which the work folder is made
    # the folder or file of `results` that the caller itself makes and locks; jobs lock their own
    name: str
    cores: int = 0  # number of cores to use; 0 for all
    targets: Sequence[str] = ()  # rules or files to make; none for the default target
    settings: Path | None = None  # file of settings that override the shipped ones
    # further options of Snakemake; by default its events go to the display
    more: Sequence[str] = (
        *("--quiet", "rules", "reason", "host"),  # not "progress", which the display needs
        *("--logger", "pa10cal"),
    )
    # profile of Snakemake, as for a cluster: its folder, or a name in `workflow/profiles`
    profile: str | None = None

    def __post_init__(self) -> None:
        if self.profile is None:
            return
        shipped = workflow_folder() / "workflow/profiles"
        for place in (Path(self.profile).absolute(), shipped / self.profile):
            if (place / "config.yaml").is_file():
                object.__setattr__(self, "profile", str(place))
                return
        raise errors.OutputError(
            "there is no such profile",
            where="--profile",
            value=self.profile,
            allowed=f"a folder with config.yaml, or one of {shipped}",
            remedy="give such a folder, or slurm",
        )

    @property
    def command(self) -> list[str]:
        """Return the command line of Snakemake."""
        words = [sys.executable, "-m", "snakemake", "--snakefile"]
        words += [str(workflow_folder() / self.file), "--directory", str(self.folder)]
        words += ["--cores", str(self.cores or len(os.sched_getaffinity(0)))]
        words += ["--scheduler", "greedy", "--rerun-incomplete", "--nolock", "--nocolor"]
        words += self.more
        # "none" keeps Snakemake from using a profile that lies beside the Snakefile.
        words += ["--workflow-profile", "none" if self.profile is None else self.profile]
        if self.settings is not None:
            words += ["--configfile", str(self.settings.absolute())]
        pairs = [f"{name}={value}" for name, value in self.config.items()]
        return [*words, *(["--config", *pairs] if pairs else []), "--", *self.targets]


def workflow_folder() -> Path:
    """Return the folder of Snakefile and config.yaml: of the checkout, or inside the package.

    Raises:
        OutputError: when the package was installed without them.
    """
    package = Path(pa10cal.__file__).parent
    for folder in (package.parents[1], package / "workflow"):
        if (folder / "Snakefile").is_file() and (folder / "config.yaml").is_file():
            return folder
    raise errors.OutputError(
        "the rules of the workflow are missing from the installation",
        where=str(package),
        allowed="a wheel or a checkout of the project",
        remedy="install pa10cal again",
    )


def refuse_without_snakemake(profile: str | None = None) -> None:
    """Refuse to run where Snakemake, or the plugin that a profile needs, is not installed.

    Raises:
        MissingPackageError: naming the package.
    """
    needed = ["snakemake"]
    if profile is not None:
        text = Path(profile, "config.yaml").read_text(encoding="utf-8")
        plugins = re.findall(r"^executor: *(\w+)", text, re.MULTILINE)
        needed += [f"snakemake_executor_plugin_{plugin}" for plugin in plugins]
    for module in needed:
        if module in errors.EXTRAS and find_spec(module) is None:
            raise errors.MissingPackageError(module)


def run_workflow(workflow: Workflow, display: RunDisplay) -> None:
    """Run the workflow to its end, and show its progress on a display.

    What Snakemake and the commands print goes to a file of the run's name in the work folder.

    Raises:
        StageError: when a command, or the workflow itself, refuses.
        OutputError: when another run makes the same results, or they cannot be written.
        RuntimeError: when a command, or the workflow, fails.
    """
    refuse_without_snakemake(workflow.profile)
    with run_lock(workflow.results, [workflow.name]) as work, ExitStack() as stack:
        with writing_into(workflow.folder, "Snakemake's own files", "run it in another folder"):
            # If two runs create this folder at once, one takes it for that of an old version.
            (workflow.folder / ".snakemake/incomplete").mkdir(parents=True, exist_ok=True)
        with writing_into(workflow.results, "the results", "give another folder"):
            log = work / f"{workflow.name}.log"
            printed = stack.enter_context(log.open("w+", encoding="utf-8", errors="replace"))
        stack.enter_context(_termination_as_interrupt())
        reading, writing = os.pipe()
        child = subprocess.Popen(
            workflow.command,
            stdin=subprocess.DEVNULL,
            stdout=printed,
            stderr=subprocess.STDOUT,
            env={
                **os.environ,
                **_caches(work),
                "PA10CAL_EVENTS": str(writing),
                PARENTS: str(os.getpid()),
            },
            pass_fds=(writing,),
            start_new_session=True,  # so that an interrupt reaches it once, by `_stop`
        )
        os.close(writing)
        try:
            with os.fdopen(reading, "rb", buffering=0) as events:
                logs = _follow(events.fileno(), display)
            code = child.wait()
        except BaseException:
            _stop(child)
            raise
        finally:
            _signal_group(child.pid, signal.SIGKILL)  # jobs that outlived a killed workflow
        if code != 0:
            printed.seek(0)
            logs_of_failed = [workflow.folder / name for name in logs]
            raise failure(code, printed.read(), logs_of_failed, workflow.results)


def _caches(work: Path) -> dict[str, str]:
    """Return environment variables that put caches into the work folder where needed.

    They are needed where the user has no home, or one that cannot be written to: Snakemake would
    end, and matplotlib warn.
    """
    caches = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache")
    settings = Path(os.environ.get("XDG_CONFIG_HOME") or "~/.config")
    of_matplotlib = os.environ.get("MPLCONFIGDIR")
    environment: dict[str, str] = {}
    try:
        Path.home()
        getpass.getuser()
    except (RuntimeError, KeyError, OSError):  # a user whom the system does not know
        environment |= {"HOME": str(work / "cache"), "LOGNAME": str(os.getuid())}
    if not _writable(caches / "snakemake"):
        environment["XDG_CACHE_HOME"] = str(work / "cache")
    pictures = [caches / "matplotlib", settings / "matplotlib"]
    if of_matplotlib:
        pictures = [Path(of_matplotlib)]
    if not all(map(_writable, pictures)):
        environment["MPLCONFIGDIR"] = str(work / "cache/matplotlib")
    return environment


def _writable(folder: Path) -> bool:
    """Return whether a folder exists or can be made, and a file can be written in it."""
    try:
        folder = folder.expanduser()
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"any")
    except (OSError, RuntimeError):  # RuntimeError: a user without a home
        return False
    return folder.is_absolute()


def _follow(pipe: int, display: RunDisplay) -> list[str]:
    """Show the events of the workflow until it ends, and return the logs of jobs that failed."""
    unfinished_line, failed_logs = b"", list[str]()
    while True:
        ready, _, _ = select.select([pipe], [], [], _TICK_S)
        if not ready:
            display.tick()
            continue
        content = os.read(pipe, _BLOCK_BYTES)
        if not content:
            return failed_logs
        *lines, unfinished_line = (unfinished_line + content).split(b"\n")
        for event in map(json.loads, lines):
            if event["event"] == "job_info":
                wildcards = event["wildcards"] or {}
                values = [wildcards.get(name) for name in ("campaign", "study", "shape")]
                subject = next(filter(None, values), "")
                display.started(int(event["jobid"]), str(event["rule_name"]), str(subject))
            elif event["event"] == "job_finished":
                display.finished(int(event["job_id"]))
            elif event["event"] == "progress":
                display.progress(int(event["done"]), int(event["total"]))
            elif event["event"] == "job_error":
                failed_logs += event["log"] or []


def _stop(child: subprocess.Popen[bytes]) -> None:
    """Interrupt the workflow and its jobs, as from a keyboard; terminate, then kill them if needed.

    Another interrupt of this process while it waits goes on to the next signal at once.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        _signal_group(child.pid, number)
        with suppress(subprocess.TimeoutExpired, KeyboardInterrupt):
            child.wait(timeout=_STOP_S)
            return


def _signal_group(group: int, number: signal.Signals) -> None:
    with suppress(ProcessLookupError):
        os.killpg(group, number)


@contextmanager
def _termination_as_interrupt() -> Iterator[None]:
    """Raise KeyboardInterrupt on SIGTERM and SIGHUP, so that the workflow is stopped too."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    numbers = (signal.SIGTERM, signal.SIGHUP)
    former_handlers = {number: signal.signal(number, interrupt) for number in numbers}
    try:
        yield
    finally:
        for number, handler in former_handlers.items():
            # None: a handler that Python did not install, and cannot install again.
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


def settings_of(files: list[Path], over: Mapping[str, Any], where: str) -> Settings:
    """Return the settings of files and of a mapping, put together as Snakemake does.

    Args:
        files: YAML files; each overrides those before it.
        over: overrides all files.
        where: the place that a message about a setting names.

    Raises:
        SettingsError: when a file cannot be read, or a setting does not fit.
    """
    from pa10cal.settings import parse_settings  # late: `doctor` runs where little is installed
    from pa10cal.yaml_file import read_yaml

    content: dict[str, Any] = {}
    for file in files:
        of_file = read_yaml(file, errors.SettingsError, what="the settings cannot be read") or {}
        if not isinstance(of_file, dict):
            raise errors.SettingsError(
                "the settings cannot be read",
                where=str(file),
                value=f"a file of {type(of_file).__name__}",
                allowed="keys and values, as in config.yaml",
                remedy="check the path and its syntax",
            )
        content = _merged(content, of_file)
    return parse_settings(_merged(content, over), where=where)


def _merged(content: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Return a mapping whose keys, at every depth, are overridden by those of another."""
    merged = dict(content)
    for key, value in over.items():
        inner = merged.get(key)
        if isinstance(inner, dict) and isinstance(value, dict):
            value = _merged(inner, value)
        merged[key] = value
    return merged
