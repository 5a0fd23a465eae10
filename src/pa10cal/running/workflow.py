"""Runs the workflow in a process of its own, follows its jobs, and shows how far they are."""

from __future__ import annotations

import errno
import getpass
import json
import os
import re
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import pa10cal
from pa10cal import errors
from pa10cal.files.output import writing_into
from pa10cal.running.run_lock import PARENTS, run_lock

if TYPE_CHECKING:
    from pa10cal.settings import Settings

#: So often a display is told that time has passed [s].
_TICK_S = 0.5
#: With less room than this on the disk nothing can be written [bytes].
_LEAST_FREE = 1 << 16


@dataclass(frozen=True)
class Workflow:
    """A run of the workflow."""

    file: str  # Snakefile, inside the folder of the workflow
    config: Mapping[str, str]  # settings, each as YAML on one line
    folder: Path  # working folder; gets Snakemake's own files
    results: Path  # folder of results; gets the work folder
    # what the caller makes in it, a folder or a file; the rules hold what they make themselves
    name: str
    cores: int = 0  # how many to use; 0 for all
    targets: Sequence[str] = ()  # rules or files; none for the default
    settings: Path | None = None  # file of settings, over the shipped ones
    # further options of Snakemake; by default its progress goes to the display
    more: Sequence[str] = (
        *("--quiet", "rules", "reason", "host"),  # the display needs what "progress" is
        *("--logger", "pa10cal"),
    )
    # folder of a profile of Snakemake, such as for a cluster, or the name of one of
    # `workflow/profiles`
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
        """Return the command that runs it."""
        words = [sys.executable, "-m", "snakemake", "--snakefile"]
        words += [str(workflow_folder() / self.file), "--directory", str(self.folder)]
        words += ["--cores", str(self.cores or len(os.sched_getaffinity(0)))]
        words += ["--scheduler", "greedy", "--rerun-incomplete", "--nolock", "--nocolor"]
        words += self.more
        # Without one, an empty profile in place of one that stands beside the Snakefile.
        words += ["--workflow-profile", "none" if self.profile is None else self.profile]
        if self.settings is not None:
            words += ["--configfile", str(self.settings.absolute())]
        pairs = [f"{name}={value}" for name, value in self.config.items()]
        return [*words, *(["--config", *pairs] if pairs else []), "--", *self.targets]


# How far a run is: a line a job, and on a terminal what is at work now.

#: What rules do, for a reader; the name of a rule that is not here.
_WORDS = {
    "ingest": "read the raw files",
    "base_frame": "locate base and targets",
    "calibrate": "calibrate",
    "calibrate_baseline": "calibrate without effects",
    "montecarlo": "Monte Carlo of the joint sensors",
    "discover": "look for missing effects",
    "evaluate": "judge held-out poses",
    "export": "write the model",
    "pictures": "draw figures and tables",
    "page": "write the report",
    "chain": "raw files to model",
    "fleet": "summarise the fleet",
    "judge_trials": "blind trials",
    "score_trials": "score blind trials",
    "trial_pictures": "draw blind trials",
}
#: Rules that only gather what others made.
_SILENT = {"all", "campaigns", "figures"}


class RunDisplay:
    """Shows a run on standard error.

    Args:
        lines: whether every job gets a line; else nothing is shown but on a terminal.
        out: where to.
    """

    def __init__(self, *, lines: bool, out: TextIO | None = None) -> None:
        self._out = sys.stderr if out is None else out
        self._live = self._out.isatty()
        self._lines = lines or self._live
        self._began = time.monotonic()
        self._running: dict[int, tuple[str, str, float]] = {}
        self._done, self._total = 0, 0

    @property
    def seconds(self) -> float:
        """Return how long the run has taken."""
        return time.monotonic() - self._began

    def started(self, job: int, rule: str, campaign: str) -> None:
        """Note that a job has begun."""
        self._running[job] = (rule, campaign, time.monotonic())
        self.tick()

    def finished(self, job: int) -> None:
        """Show that a job has ended, and how long it took."""
        rule, campaign, began = self._running.pop(job, ("", "", 0.0))
        if not self._lines or not rule or rule in _SILENT:
            return
        self.close()
        title = f"{campaign}: {_WORDS.get(rule, rule)}".removeprefix(": ")
        print(f"  {title:<48} {time.monotonic() - began:7.1f} s", file=self._out, flush=True)
        self.tick()

    def progress(self, done: int, total: int) -> None:
        """Note how many jobs are done."""
        self._done, self._total = done, total

    def tick(self) -> None:
        """Show on a terminal what is at work."""
        if not self._live:
            return
        now = time.monotonic()
        jobs = [
            f"{_WORDS.get(rule, rule)} {now - began:.0f} s"
            for rule, _, began in self._running.values()
            if rule not in _SILENT
        ]
        counted = f"{self._done} of {self._total}: " if self._total else ""
        text = f"  {counted}{', '.join(jobs) or 'planning'} …"
        self.close()
        self._out.write(text[: shutil.get_terminal_size().columns - 1])
        self._out.flush()

    def close(self) -> None:
        """Take what is at work off the terminal."""
        if self._live:
            terminal: TextIO = getattr(self._out, "terminal", self._out)
            terminal.write("\r\x1b[K")
            terminal.flush()


class StageError(errors.Pa10calError):
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
    raise errors.OutputError(
        "the rules of the workflow are missing from the installation",
        where=str(package),
        allowed="a wheel or a checkout of the project",
        remedy="install pa10cal again",
    )


def refuse_without_snakemake(profile: str | None = None) -> None:
    """Stop where Snakemake is not installed, or the plugin that a profile needs.

    Raises:
        MissingPackageError: naming it.
    """
    needed = ["snakemake"]
    if profile is not None:
        text = Path(profile, "config.yaml").read_text(encoding="utf-8")
        plugins = re.findall(r"^executor: *(\w+)", text, re.MULTILINE)
        needed += [f"snakemake_executor_plugin_{each}" for each in plugins]
    for module in needed:
        if module in errors.EXTRAS and find_spec(module) is None:
            raise errors.MissingPackageError(module)


def run_workflow(workflow: Workflow, display: RunDisplay) -> None:
    """Run the workflow to its end, and tell a display what happens.

    What Snakemake and the commands print goes to a file of the run's name in the work folder.

    Raises:
        StageError: when a command, or the workflow itself, refuses.
        OutputError: when another run makes the same results, or they cannot be written.
        RuntimeError: when a command, or the workflow, fails.
    """
    refuse_without_snakemake(workflow.profile)
    with run_lock(workflow.results, [workflow.name]) as work, ExitStack() as stack:
        with writing_into(workflow.folder, "Snakemake's own files", "run it in another folder"):
            # Two runs that make Snakemake's folder at once: one takes the other's for an old form.
            (workflow.folder / ".snakemake/incomplete").mkdir(parents=True, exist_ok=True)
        with writing_into(workflow.results, "the results", "give another folder"):
            said = work / f"{workflow.name}.log"
            printed = stack.enter_context(said.open("w+", encoding="utf-8", errors="replace"))
        stack.enter_context(_ended_as_interrupted())
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
            start_new_session=True,  # an interrupt is passed on once, below
        )
        os.close(writing)
        try:
            with os.fdopen(reading, "rb", buffering=0) as events:
                failed = _followed(events.fileno(), display)
            code = child.wait()
        except BaseException:
            _stop(child)
            raise
        finally:
            _kill(child.pid, signal.SIGKILL)  # jobs of a workflow that was killed itself
        if code != 0:
            printed.seek(0)
            raise _failure(code, failed, workflow, printed.read())


def _caches(work: Path) -> dict[str, str]:
    """Return the environment that keeps caches among the results where the usual cannot be written.

    As where a user has no home, or one that is full: Snakemake would end, and matplotlib warn.
    """
    caches = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache")
    settings = Path(os.environ.get("XDG_CONFIG_HOME") or "~/.config")
    named, own = os.environ.get("MPLCONFIGDIR"), dict[str, str]()
    try:
        Path.home()
        getpass.getuser()
    except (RuntimeError, KeyError, OSError):  # of a user whom the system does not know
        own |= {"HOME": str(work / "cache"), "LOGNAME": str(os.getuid())}
    if not _writable(caches / "snakemake"):
        own["XDG_CACHE_HOME"] = str(work / "cache")
    pictures = [Path(named)] if named else [caches / "matplotlib", settings / "matplotlib"]
    if not all(map(_writable, pictures)):
        own["MPLCONFIGDIR"] = str(work / "cache/matplotlib")
    return own


def _writable(folder: Path) -> bool:
    """Return whether a file can be written in a folder that is there or can be made."""
    try:
        folder = folder.expanduser()
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"any")
    except (OSError, RuntimeError):  # the latter of a user without a home
        return False
    return folder.is_absolute()


def _followed(pipe: int, display: RunDisplay) -> list[str]:
    """Show what the workflow does until it ends, and return the logs of jobs that failed."""
    rest, failed = b"", list[str]()
    while True:
        ready, _, _ = select.select([pipe], [], [], _TICK_S)
        if not ready:
            display.tick()
            continue
        content = os.read(pipe, 1 << 16)
        if not content:
            return failed
        *lines, rest = (rest + content).split(b"\n")
        for event in map(json.loads, lines):
            if event["event"] == "job_info":
                known = event["wildcards"] or {}
                of = known.get("campaign") or known.get("study") or known.get("shape") or ""
                display.started(int(event["jobid"]), str(event["rule_name"]), str(of))
            elif event["event"] == "job_finished":
                display.finished(int(event["job_id"]))
            elif event["event"] == "progress":
                display.progress(int(event["done"]), int(event["total"]))
            elif event["event"] == "job_error":
                failed += event["log"] or []


#: What shells, Snakemake, Slurm, Python, numpy and the loader of libraries say where memory runs
#: out: the system kills one that takes too much.
_NO_MEMORY = re.compile(
    r"\bKilled\b|SIGKILL|exit status 137|OUT_OF_MEMORY|MemoryError|Cannot allocate memory"
    r"|Unable to allocate|failed to map segment"
)
#: What an exception of the system says last, and the file that it names.
_OF_THE_SYSTEM = re.compile(
    r"^(?:\w+: )?\[Errno \d+\] (?P<what>[^:\n]+)(?:: '(?P<where>.+)')?$", re.MULTILINE
)


def _failure(code: int, logs: Sequence[str], workflow: Workflow, printed: str) -> Exception:
    """Return why a run failed: the message of the command, or else of the workflow itself."""
    texts = [printed]
    for log in logs:
        with suppress(OSError):
            texts.insert(0, (workflow.folder / log).read_text(encoding="utf-8", errors="replace"))
            break
    if said := next(filter(None, map(errors.last_message, texts)), None):
        stage, message = said[0].removeprefix("pa10cal").strip(), said[1]
        if "internal fault" in message:
            if _NO_MEMORY.search(message):
                return _killed(workflow.results)
            return RuntimeError(f"{stage}: {message}")
        return StageError(f"{stage}: {message}" if stage else message)
    full, told = os.strerror(errno.ENOSPC), [*_OF_THE_SYSTEM.finditer(printed)]
    what, where = (told[-1]["what"], told[-1]["where"]) if told else ("", None)
    if what == full or full in printed or shutil.disk_usage(workflow.results).free < _LEAST_FREE:
        return errors.OutputError(
            "the results cannot be written",
            where=str(where or workflow.results),
            value=full,
            allowed="a folder with room in it",
            remedy="make room on the disk, then run the same command again",
        )
    again = "run the same command again: it goes on from there"
    if code < 0:
        return StageError(f"the workflow was ended by signal {-code}; {again}")
    if _NO_MEMORY.search(printed):
        return _killed(workflow.results)
    if what:
        return errors.OutputError(
            "the workflow cannot use a file or folder of this machine",
            where=where or "the workflow",
            value=what,
            allowed="one that may be written to, with room in it",
            remedy="let it be written to, or name another one",
        )
    last = [line for line in printed.splitlines() if line.strip()][-8:]
    return RuntimeError("the workflow failed: " + " | ".join(last))


def _killed(results: Path) -> errors.OutputError:
    return errors.OutputError(
        "a stage was killed before it could say why, as where there is not enough memory",
        where=str(results),
        allowed="enough memory for every stage that runs at once",
        remedy="run the same command with --cores 1, on a machine with more memory, or with fewer "
        "poses; it goes on from there",
    )


def _stop(child: subprocess.Popen[bytes]) -> None:
    """Let the workflow and its jobs end, as they do when interrupted at a keyboard.

    Another interrupt while they do so makes it quicker.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        _kill(child.pid, number)
        with suppress(subprocess.TimeoutExpired, KeyboardInterrupt):
            child.wait(timeout=10)
            return


def _kill(group: int, number: signal.Signals) -> None:
    with suppress(ProcessLookupError):
        os.killpg(group, number)


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


# The settings of a run, as Snakemake puts them together: files, the later over the earlier.


def settings_of(files: list[Path], over: Mapping[str, Any], where: str) -> Settings:
    """Return the settings of files, with some more over them.

    Args:
        files: YAML files, the later over the earlier.
        over: what goes over all of them.
        where: what a message is to name.

    Raises:
        SettingsError: when a file cannot be read, or a setting does not fit.
    """
    from pa10cal.settings import parse_settings  # late: `doctor` runs where little is installed
    from pa10cal.yaml_file import read_yaml

    content: dict[str, Any] = {}
    for file in files:
        found = read_yaml(file, errors.SettingsError, what="the settings cannot be read") or {}
        if not isinstance(found, dict):
            raise errors.SettingsError(
                "the settings cannot be read",
                where=str(file),
                value=f"a file of {type(found).__name__}",
                allowed="keys and values, as in config.yaml",
                remedy="check the path and its syntax",
            )
        content = _merged(content, found)
    return parse_settings(_merged(content, over), where=where)


def _merged(content: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Return a mapping with another over it, key by key at every depth."""
    both = dict(content)
    for key, value in over.items():
        inner = both.get(key)
        if isinstance(inner, dict) and isinstance(value, dict):
            value = _merged(inner, value)
        both[key] = value
    return both
