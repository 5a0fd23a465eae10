"""One run at a time makes a folder of results, and none begins while jobs of a dead one live.

All are locks of the system, which go with a process however it ends: one for each folder of
results, that of a campaign, a group or a study, one of the run, and one that its jobs share. A job
that a cluster begins after its run has ended does nothing.
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
import select
import signal
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO

from pa10cal.errors import OutputError
from pa10cal.files.output import remove_partials, writing_into

#: Among the results: locks, what runs print, and links to what `pa10cal run` reads.
WORK_FOLDER = ".pa10cal"
#: In it: a file for each folder of results, which says who makes it; and two for each run that
#: lives, the one of its jobs with this ending.
_LOCKS, _RUNS, _JOBS = "locks", "runs", ".jobs"
#: Environment: the file of the run that this process is a part of.
RUN = "PA10CAL_RUN"
#: Jobs end with their run within this time, so that nothing is told of them [s].
_SOON_S = 3.0
_MOMENT_S = 0.3
#: What file systems without locks answer.
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS)
#: Files that a process opens besides its locks.
_OTHER_FILES = 200

_TO_THE_END = ExitStack()
atexit.register(_TO_THE_END.close)


@contextmanager
def run_lock(results: Path, names: Iterable[str]) -> Iterator[Path]:
    """Hold folders of results, and yield the work folder; those that this run holds stay held.

    Waits for jobs of a killed run that made one of them, and removes what they left half-written.

    Args:
        results: folder that they are in.
        names: of the folders, or of files that lie beside them.

    Raises:
        OutputError: when they cannot be written to, or another run holds one of them.
    """
    work, sorted_names = results.resolve() / WORK_FOLDER, sorted(set(names))
    with ExitStack() as stack:
        with writing_into(results, "the results", "give another folder"):
            for part in (_LOCKS, _RUNS):
                (work / part).mkdir(parents=True, exist_ok=True)
            _allow_files(len(sorted_names) + _OTHER_FILES)
            run = stack.enter_context(_this_run(work / _RUNS))
            for name in sorted_names:  # so that of two runs one gets all that both want
                lock = stack.enter_context((work / _LOCKS / name).open("ab+", buffering=0))
                _take(lock, run, results / name)
        yield work


@contextmanager
def _this_run(runs: Path) -> Iterator[Path]:
    """Yield the file of the run that this process is a part of, or that it begins."""
    former = os.environ.get(RUN, "")
    if former and Path(former).parent == runs:
        yield Path(former)
        return
    run = runs / secrets.token_hex(8)
    with run.open("xb") as alive:
        run.with_suffix(_JOBS).touch()
        _locked(alive, 0.0)
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
    """Lock a folder of results, unless this run has done so."""
    if not _locked(lock, 0.0):
        who, holder = _text_of(lock)
        if holder == run.name:
            return
        # One that takes several, and is refused another, holds the first for a moment.
        if not _locked(lock, _MOMENT_S):
            raise _at_work(folder, who)
    _, former = _text_of(lock)
    if former != run.name and re.fullmatch("[0-9a-f]+", former):
        _await_jobs(run.with_name(former + _JOBS), folder)
        _remove_if_free(run.with_name(former))
    lock.truncate(0)
    me = f"process {os.getpid()} on {platform.node()}, started in {Path.cwd()}"
    lock.write(f"{me}\n{run.name}".encode())
    remove_partials(folder)


def _text_of(lock: IO[bytes]) -> tuple[str, str]:
    """Return what the lock of a folder says: who makes it, and the name of that run's file."""
    lock.seek(0)
    who, _, run = lock.read().decode("utf-8", "replace").partition("\n")
    return who, run


def _await_jobs(jobs: Path, folder: Path) -> None:
    """Wait until the jobs of a run that was killed have ended."""
    with suppress(FileNotFoundError), jobs.open("rb+") as file:
        if not _locked(file, _SOON_S):
            waited = f"jobs of an earlier run on {folder} to end"
            print(f"pa10cal: warning: waiting for {waited}", file=sys.stderr)
            _locked(file, math.inf)
        jobs.unlink(missing_ok=True)


def _remove_if_free(path: Path) -> None:
    """Remove a file of a run that nobody holds any more."""
    with suppress(OSError), path.open("rb+") as file:
        if _locked(file, 0.0):
            path.unlink()


def _locked(file: IO[bytes], within_s: float) -> bool:
    """Lock a file for this process alone, within a time; as good as done without any locks."""
    end = time.monotonic() + within_s
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() >= end:
                return False
            time.sleep(0.02)
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
            return True
        else:
            return True


def _allow_files(count: int) -> None:
    """Let this process have so many files open, as far as the system lets it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != resource.RLIM_INFINITY and soft < count:
        most = count if hard == resource.RLIM_INFINITY else min(count, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


def hold(results: Path, outputs: Iterable[str | Path]) -> None:
    """Hold the folders of results that files lie in until this process ends; see `run_lock`.

    Files elsewhere are held by nobody.
    """
    below = [Path(os.path.relpath(path, results)).parts for path in outputs]
    names = [first for first, *_ in filter(None, below) if first != os.pardir]
    _TO_THE_END.enter_context(run_lock(results, names))


def refuse_at_work(folder: Path) -> None:
    """Refuse a folder of results that a run makes at this moment.

    Raises:
        OutputError: when one does, naming it.
    """
    lock = folder.resolve().parent / WORK_FOLDER / _LOCKS / folder.name
    with suppress(FileNotFoundError, PermissionError), lock.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            raise _at_work(folder, _text_of(file)[0]) from None
        except OSError:
            return  # no locks, and so nobody can tell


def _at_work(folder: Path, who: str) -> OutputError:
    return OutputError(
        "another run is at work on these results",
        where=str(folder),
        value=who or None,
        allowed="one run of a campaign at a time",
        remedy="wait for it to end, or give another folder",
    )


def share() -> None:
    """Let no new run make the same results before this process, a job of a run, has ended.

    Raises:
        OutputError: when that run has ended already.
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
    except OSError:  # a folder that cannot be written to is told of by the outputs
        return
    if not lives:
        raise OutputError(
            "the run that this is a job of has ended",
            where=str(Path(run).parents[2]),
            allowed="jobs of a run that is at work",
            remedy="call the run again",
        )


def _lives(run: Path) -> bool:
    """Return whether a run holds its file; so, where there are no locks, which nobody can tell."""
    with run.open("rb+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return True
    return False


# Jobs end with the run that started them, however that ended.

#: Environment: processes with which this one ends, by their numbers.
PARENTS = "PA10CAL_PARENTS"
#: How often a machine without pidfd is looked at for them [s].
_PERIOD_S = 0.2


def end_with_parents() -> None:
    """Kill this process as soon as one of those that `PARENTS` names has ended.

    A job hangs below a shell, which lives on when Snakemake is killed: a signal at a parent's death
    would not reach the job. What it leaves half-written is removed by the next run.
    """
    parents = [int(word) for word in os.environ.pop(PARENTS, "").split()]
    if parents:
        threading.Thread(target=_watch, args=(parents,), daemon=True).start()


def _watch(parents: list[int]) -> None:
    ended = select.poll()
    with suppress(ProcessLookupError):  # one had ended already
        try:
            for parent in parents:
                ended.register(os.pidfd_open(parent), select.POLLIN)
            ended.poll()
        except ProcessLookupError:
            pass
        except (AttributeError, OSError):  # a system without it
            while True:
                for parent in parents:
                    os.kill(parent, 0)
                time.sleep(_PERIOD_S)
    os.kill(os.getpid(), signal.SIGKILL)
