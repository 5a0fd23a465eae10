"""Runs part of a command in a child process, and ends processes together with their parents.

Whatever ends the child spares the command. The child is a fork, so modules that are imported
already are not imported again.
"""

from __future__ import annotations

import json
import os
import re
import select
import signal
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

#: Environment variable: numbers of the processes with which this one ends.
PARENTS = "PA10CAL_PARENTS"
#: Period at which they are looked for on a machine without pidfd [s].
_PERIOD_S = 0.2
#: Exit code of a child that was interrupted.
_INTERRUPTED = 130

#: What most often sends each signal.
_USUAL_CAUSES = {
    "SIGKILL": ", as where there is not enough memory: use fewer cores, or a machine with more",
    "SIGABRT": ", as by a library that needs more memory than there is, or that fails",
    "SIGSEGV": ", a fault of a library",
    "SIGBUS": ", a fault of a library, or of a disk",
    "SIGXCPU": ", a limit on time that this machine sets",
}

#: Finds the number of the signal in `Child.why`.
KILLED_BY = re.compile(r"killed by signal (\d+)")

#: Sends the parent a mapping that JSON can hold; keys sent again overwrite the earlier ones.
Send = Callable[[Mapping[str, Any]], None]


@dataclass(frozen=True)
class Child:
    """How a child ended."""

    sent: Mapping[str, Any]  # all that it sent, merged; see `Send`
    code: int  # its exit code; minus the number of the signal that ended it

    @property
    def why(self) -> str:
        """Return in words what ended a child that did not succeed."""
        if self.code >= 0:
            return f"its process ended with exit code {self.code} before it could say why"
        killed, name = f"its process was killed by signal {-self.code}", signal_name(-self.code)
        if not name.startswith("SIG"):
            return killed
        return f"{killed} ({name}){_USUAL_CAUSES.get(name, '')}"


def signal_name(number: int) -> str:
    """Return the name of a signal, or its number in words: real-time signals have no names."""
    names = {each.value: each.name for each in signal.Signals}
    return names.get(number, f"signal {number}")


def in_child(work: Callable[[Send], None]) -> Child:
    """Do some work in a child process, which ends with this one, and return how the child ended.

    Fork copies locks that other threads hold: call this while no library runs any. numpy starts
    none where BLAS is limited to one thread, as in every command (`limit_threads`).

    Args:
        work: gets the function by which it sends mappings to the parent.

    Raises:
        KeyboardInterrupt: when the child, or this process, was interrupted.
    """
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    reading, writing = os.pipe()
    parent = os.getpid()
    with warnings.catch_warnings():
        # Python warns of other threads; the one of `end_with_parents` holds no locks.
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if not child:
        os.close(reading)
        os.environ[PARENTS] = str(parent)
        _run_and_exit(work, writing)
    os.close(writing)
    try:
        with os.fdopen(reading, "rb") as pipe:
            lines = pipe.read().split(b"\n")
        _, status = os.waitpid(child, 0)
    except BaseException:
        _stop(child)
        raise
    code = os.waitstatus_to_exitcode(status)
    if code in (_INTERRUPTED, -signal.SIGINT):
        raise KeyboardInterrupt
    sent: dict[str, Any] = {}
    for line in lines[:-1]:  # after the last newline: nothing, or a line the child did not finish
        sent |= json.loads(line)
    return Child(sent, code)


def _run_and_exit(work: Callable[[Send], None], writing: int) -> None:
    """Do the work in the child, then end this process."""
    code = 1
    try:
        end_with_parents()
        pipe = os.fdopen(writing, "wb")

        def send(content: Mapping[str, Any]) -> None:
            pipe.write(json.dumps(dict(content)).encode() + b"\n")
            pipe.flush()

        work(send)
        code = 0
    except KeyboardInterrupt:
        code = _INTERRUPTED
    except BaseException:
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError):
                stream.flush()
        os._exit(code)


def _stop(child: int) -> None:
    """Interrupt a child and wait for its end; kill it if this process is interrupted meanwhile."""
    try:
        with suppress(ProcessLookupError, ChildProcessError):
            os.kill(child, signal.SIGINT)
            os.waitpid(child, 0)
    except BaseException:
        with suppress(ProcessLookupError):  # it has just ended
            os.kill(child, signal.SIGKILL)
        raise


def end_with_parents() -> None:
    """Kill this process as soon as one of those that `PARENTS` names has ended.

    A job hangs below a shell, which lives on when Snakemake is killed: a signal at a parent's death
    would not reach the job. What the job leaves half-written is removed by the next run.
    """
    words = os.environ.pop(PARENTS, "").split()
    parents = [int(word) for word in words if word.isdecimal()]
    if parents:
        threading.Thread(target=_die_with, args=(parents,), daemon=True).start()


def _die_with(parents: list[int]) -> None:
    """Wait until the first of some processes has ended, then kill this one."""
    with suppress(ProcessLookupError):  # one has ended already
        try:
            poll = select.poll()
            for parent in parents:
                poll.register(os.pidfd_open(parent), select.POLLIN)
            poll.poll()
        except ProcessLookupError:
            raise
        except (AttributeError, OSError):  # a system without pidfd
            while True:
                for parent in parents:
                    os.kill(parent, 0)
                time.sleep(_PERIOD_S)
    os.kill(os.getpid(), signal.SIGKILL)
