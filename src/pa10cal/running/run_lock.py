"""Locks by which one run at a time makes a folder of results, and waits for jobs of a dead run.

They are locks of the operating system, which end with the process that holds them: one for each
folder of results (of a campaign, a group or a study), one for the run, and one that the jobs of the
run share. A job that a cluster begins after its run has ended is refused.
"""

from __future__ import annotations

import atexit
import errno
import fcntl
import math
import os
import platform
import re
import resource
import secrets
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO

from pa10cal.errors import OutputError
from pa10cal.files.output import remove_partials, writing_into

#: Folder among the results: locks, what runs print, and links to what `pa10cal run` reads.
WORK_FOLDER = ".pa10cal"
#: Folders in it. `locks` has a file for each folder of results: who makes it, and the name of that
#: run. `runs` has two files for each run at work: its own, and with the ending `.jobs` its jobs'.
_LOCKS, _RUNS, _JOBS = "locks", "runs", ".jobs"
#: Environment variable: the file of the run that this process is a part of.
RUN = "PA10CAL_RUN"
#: Jobs of a dead run that take longer than this to end are waited for with a message [s].
_JOBS_END_S = 3.0
#: A lock is tried for this time: another run that is refused a lock gives up all others [s].
_RETRY_S = 0.3
#: Period at which a lock that another process holds is tried [s].
_POLL_S = 0.02
#: Errors of file systems that have no locks.
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS)
#: Number of files that a process opens besides its locks, at most.
_OTHER_FILES = 200

#: Locks that this process holds until it ends.
_HELD_TO_THE_END = ExitStack()
atexit.register(_HELD_TO_THE_END.close)


@contextmanager
def run_lock(results: Path, names: Iterable[str]) -> Iterator[Path]:
    """Lock folders of results for this run, and yield the work folder.

    Folders that this run has locked already stay locked when the block ends. Waits for the jobs of
    a killed run that made one of the folders, and removes what they left half-written.

    Args:
        results: folder of all results.
        names: names in it, of folders or of files.

    Raises:
        OutputError: when they cannot be written to, or another run has locked one of them.
    """
    work = results.resolve() / WORK_FOLDER
    sorted_names = sorted(set(names))
    with ExitStack() as stack:
        with writing_into(results, "the results", "give another folder"):
            for part in (_LOCKS, _RUNS):
                (work / part).mkdir(parents=True, exist_ok=True)
            _allow_files(len(sorted_names) + _OTHER_FILES)
            run = stack.enter_context(_this_run(work / _RUNS))
            for name in sorted_names:  # in one order, so that one of two runs gets all locks
                lock = stack.enter_context((work / _LOCKS / name).open("ab+", buffering=0))
                _take(lock, run, results / name)
        yield work


@contextmanager
def _this_run(runs: Path) -> Iterator[Path]:
    """Yield the file of the run that this process is a part of, else of a new run."""
    former = os.environ.get(RUN, "")
    if former and Path(former).parent == runs:
        yield Path(former)
        return
    run = runs / secrets.token_hex(8)
    with run.open("xb") as run_file:
        run.with_suffix(_JOBS).touch()
        _try_lock(run_file, 0.0)
        os.environ[RUN] = str(run)
        try:
            yield run
        finally:
            os.environ[RUN] = former
            if not former:
                del os.environ[RUN]
            run.unlink(missing_ok=True)
            _remove_if_free(run.with_suffix(_JOBS))


def _take(lock: IO[bytes], run: Path, folder: Path) -> None:
    """Lock a folder of results by its lock file, unless this run has done so."""
    if not _try_lock(lock, 0.0):
        holder, holding_run = _content(lock)
        if holding_run == run.name:
            return
        if not _try_lock(lock, _RETRY_S):
            raise _at_work(folder, holder)
    _, former_run = _content(lock)
    if former_run != run.name and re.fullmatch("[0-9a-f]+", former_run):
        _await_jobs(run.with_name(former_run + _JOBS), folder)
        _remove_if_free(run.with_name(former_run))
    lock.truncate(0)
    holder = f"process {os.getpid()} on {platform.node()}, started in {Path.cwd()}"
    lock.write(f"{holder}\n{run.name}".encode())
    remove_partials(folder)


def _content(lock: IO[bytes]) -> tuple[str, str]:
    """Return what a lock file holds: the process in words, and the name of its run's file."""
    lock.seek(0)
    holder, _, run_name = lock.read().decode("utf-8", "replace").partition("\n")
    return holder, run_name


def _await_jobs(jobs: Path, folder: Path) -> None:
    """Wait until the jobs of a run that was killed have ended."""
    with suppress(FileNotFoundError), jobs.open("rb+") as file:
        if not _try_lock(file, _JOBS_END_S):
            awaited = f"jobs of an earlier run on {folder} to end"
            print(f"pa10cal: warning: waiting for {awaited}", file=sys.stderr)
            _try_lock(file, math.inf)
        jobs.unlink(missing_ok=True)


def _remove_if_free(path: Path) -> None:
    """Remove a file of a run unless a process has locked it."""
    with suppress(OSError), path.open("rb+") as file:
        if _try_lock(file, 0.0):
            path.unlink()


def _try_lock(file: IO[bytes], within_s: float) -> bool:
    """Lock a file for this process alone, and return whether that succeeded within a time.

    On a file system without locks it counts as locked.
    """
    end_s = time.monotonic() + within_s
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() >= end_s:
                return False
            time.sleep(_POLL_S)
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
            return True
        else:
            return True


def _allow_files(count: int) -> None:
    """Raise the number of files that this process may open, as far as the system lets it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != resource.RLIM_INFINITY and soft < count:
        allowed = count if hard == resource.RLIM_INFINITY else min(count, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (allowed, hard))


def hold(results: Path, outputs: Iterable[str | Path]) -> None:
    """Lock the folders of results in which outputs lie until this process ends; see `run_lock`.

    Outputs that do not lie in `results` are not locked.
    """
    parts_of = [Path(os.path.relpath(path, results)).parts for path in outputs]
    names = [parts[0] for parts in parts_of if parts and parts[0] != os.pardir]
    _HELD_TO_THE_END.enter_context(run_lock(results, names))


def refuse_at_work(folder: Path) -> None:
    """Refuse a folder of results that a run is making at this moment.

    Raises:
        OutputError: naming the run.
    """
    lock = folder.resolve().parent / WORK_FOLDER / _LOCKS / folder.name
    with suppress(FileNotFoundError, PermissionError), lock.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            raise _at_work(folder, _content(file)[0]) from None
        except OSError:
            return  # without locks it is not known


def _at_work(folder: Path, holder: str) -> OutputError:
    return OutputError(
        "another run is at work on these results",
        where=str(folder),
        value=holder or None,
        allowed="one run of a campaign at a time",
        remedy="wait for it to end, or give another folder",
    )


def share() -> None:
    """Share the lock of this run's jobs, so that no new run makes these results before they end.

    Raises:
        OutputError: when this process is a job of a run that has ended already.
    """
    run = os.environ.get(RUN)
    if not run:
        return
    try:
        jobs = os.open(f"{run}{_JOBS}", os.O_RDWR | os.O_CLOEXEC)
        fcntl.flock(jobs, fcntl.LOCK_SH)  # until the process ends
        lives = _lives(Path(run))
    except FileNotFoundError:
        lives = False
    except OSError:  # a folder that cannot be written to: writing the outputs reports it
        return
    if not lives:
        raise OutputError(
            "the run that this is a job of has ended",
            where=str(Path(run).parents[2]),
            allowed="jobs of a run that is at work",
            remedy="call the run again",
        )


def _lives(run: Path) -> bool:
    """Return whether a run has its file locked; true where there are no locks."""
    with run.open("rb+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return True
    return False
