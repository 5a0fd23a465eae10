"""One run at a time works on a results folder, and none begins while jobs of a dead one live.

Both are locks of the system, which it takes off however a process ends. A run holds the one, each
of its jobs a share of the other. A job that a cluster begins after its run has ended does nothing.
"""

from __future__ import annotations

import errno
import fcntl
import os
import platform
import select
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO

from pa10cal.errors import OutputError
from pa10cal.files.output import remove_partials, writing_into

#: Among the results: locks, what a run prints, and Snakemake's own files of `pa10cal run`.
WORK_FOLDER = ".pa10cal"
#: Environment: the work folder that this process, or the one that started it, holds; and the one
#: that the jobs of a workflow share.
HELD, SHARED = "PA10CAL_HELD", "PA10CAL_SHARED"
#: Environment: who this job works for, as that run's lock says it.
RUN = "PA10CAL_RUN"
#: Jobs end with their run within this time, so that nothing is told of them [s].
_SOON_S = 3.0
_MOMENT_S = 0.3
#: What file systems without locks answer.
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS)

_TO_THE_END = ExitStack()


@contextmanager
def alone(results: Path) -> Iterator[Path]:
    """Hold a results folder, and yield its work folder; at once where this run holds it already.

    Waits for jobs of a killed run, and removes what they left half-written.

    Raises:
        OutputError: when it cannot be written to, or another run holds it.
    """
    work = results.resolve() / WORK_FOLDER
    if os.environ.get(HELD) == str(work):
        yield work
        return
    with ExitStack() as stack:
        with writing_into(results, "the results", "give another folder"):
            work.mkdir(parents=True, exist_ok=True)
            lock = stack.enter_context((work / "lock").open("a+", encoding="utf-8"))
            _take(lock, results)
            who = f"process {os.getpid()} on {platform.node()}, started in {Path.cwd()}"
            lock.truncate(0)
            lock.write(who)
            lock.flush()
            _wait_for_jobs(work)
            remove_partials(results)
        os.environ |= {HELD: str(work), RUN: who}
        stack.callback(lambda: [os.environ.pop(name, None) for name in (HELD, RUN)])
        yield work


def hold(results: Path) -> None:
    """Hold a results folder until this process ends; see `alone`."""
    _TO_THE_END.enter_context(alone(results))


def share() -> None:
    """Let no new run begin before this process, a job of a run, has ended.

    Raises:
        OutputError: when that run has ended already.
    """
    work, run = os.environ.get(SHARED), os.environ.get(RUN)
    if work:
        with suppress(OSError):  # a folder that cannot be written to is told of by the outputs
            jobs = os.open(Path(work, "jobs"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
            fcntl.flock(jobs, fcntl.LOCK_SH)  # until the process ends
            if run and not _works(Path(work, "lock"), run):
                raise OutputError(
                    "the run that this is a job of has ended",
                    where=str(Path(work).parent),
                    value=run,
                    allowed="jobs of a run that is at work",
                    remedy="call the run again",
                )


def _works(lock: Path, run: str) -> bool:
    """Return whether a run holds its lock; so, where there are no locks, which nobody can tell."""
    with lock.open("r+", encoding="utf-8") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return file.read() == run
        except OSError:
            return True
    return False


def _take(lock: IO[str], results: Path) -> None:
    try:
        _lock(lock)
    except BlockingIOError:
        lock.seek(0)
        raise OutputError(
            "another run is at work on these results",
            where=str(results),
            value=lock.read() or None,
            allowed="one run at a time",
            remedy="wait for it to end, or give another folder",
        ) from None
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise


def _lock(lock: IO[str]) -> None:
    """Lock a file; a job that looks at it holds it for a moment."""
    end = time.monotonic() + _MOMENT_S
    while True:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > end:
                raise
            time.sleep(0.02)
        else:
            return


def _wait_for_jobs(work: Path) -> None:
    """Return when no job of a killed run is at work any more."""
    began, told = time.monotonic(), False
    with (work / "jobs").open("a+") as jobs:
        while True:
            try:
                fcntl.flock(jobs, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if not told and time.monotonic() - began > _SOON_S:
                    told = True
                    print(
                        f"pa10cal: waiting for jobs of an earlier run on {work.parent} to end",
                        file=sys.stderr,
                    )
                time.sleep(0.05)
                continue
            except OSError as error:
                if error.errno not in _NO_LOCKS:
                    raise
            return


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
    with suppress(ProcessLookupError):  # one had ended already
        _wait(parents)
    os.kill(os.getpid(), signal.SIGKILL)


def _wait(parents: list[int]) -> None:
    """Return when one of these processes has ended.

    Raises:
        ProcessLookupError: when one is not there.
    """
    ended = select.poll()
    try:
        for parent in parents:
            ended.register(os.pidfd_open(parent), select.POLLIN)
    except ProcessLookupError:
        raise
    except (AttributeError, OSError):  # a system without it
        while True:
            for parent in parents:
                os.kill(parent, 0)
            time.sleep(_PERIOD_S)
    ended.poll()
