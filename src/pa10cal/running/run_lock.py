"""One run at a time works on a results folder, and none begins while jobs of a dead one live.

Both are locks of the system, which it takes off however a process ends. A run holds the one, each
of its jobs a share of the other. A job that a cluster begins after its run has ended does nothing.
"""

from __future__ import annotations

import errno
import fcntl
import math
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

from pa10cal.errors import OutputError, refusals_beside
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
_refusal = refusals_beside(__file__, OutputError)


@contextmanager
def run_lock(results: Path) -> Iterator[Path]:
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
            if not _locked(lock, _MOMENT_S):
                lock.seek(0)
                raise _refusal("at work", results, lock.read() or None)
            who = f"process {os.getpid()} on {platform.node()}, started in {Path.cwd()}"
            lock.truncate(0)
            lock.write(who)
            lock.flush()
            with (work / "jobs").open("a+") as jobs:  # of a killed run
                if not _locked(jobs, _SOON_S):
                    waited = f"jobs of an earlier run on {work.parent} to end"
                    print(f"pa10cal: waiting for {waited}", file=sys.stderr)
                    _locked(jobs, math.inf)
            remove_partials(results)
        os.environ |= {HELD: str(work), RUN: who}
        stack.callback(lambda: [os.environ.pop(name, None) for name in (HELD, RUN)])
        yield work


def _locked(file: IO[str], within_s: float) -> bool:
    """Lock a file for this process alone, within a time; as good as done where there are no locks.

    A job that looks at a run's lock holds it for a moment.
    """
    end = time.monotonic() + within_s
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > end:
                return False
            time.sleep(0.02)
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
            return True
        else:
            return True


def hold(results: Path) -> None:
    """Hold a results folder until this process ends; see `run_lock`."""
    _TO_THE_END.enter_context(run_lock(results))


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
                raise _refusal("ended", Path(work).parent, run)


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
