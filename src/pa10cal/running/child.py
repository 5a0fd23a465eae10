"""A part of a command in a process of its own, so that what ends it does not end the command.

The child is a fork: what is imported already is imported once. It ends with its parent.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from pa10cal.running.run_lock import PARENTS, end_with_parents

#: Exit code of a child that was interrupted.
_INTERRUPTED = 130

Say = Callable[[Mapping[str, Any]], None]


@dataclass(frozen=True)
class Child:
    """How a child ended."""

    said: Mapping[str, Any]  # what it said, the later over the earlier
    code: int  # its exit code; of a signal the negative number

    @property
    def why(self) -> str:
        """Return what ended it, in words."""
        if self.code >= 0:
            return f"its process ended with exit code {self.code} before it could say why"
        with suppress(ValueError):
            name = signal.Signals(-self.code).name
            return f"its process was killed by signal {-self.code} ({name}){_AS.get(name, '')}"
        return f"its process was killed by signal {-self.code}"


#: What most often sends a signal.
_AS = {
    "SIGKILL": ", as where there is not enough memory: use fewer cores, or a machine with more",
    "SIGABRT": ", as by a library that needs more memory than there is, or that fails",
    "SIGSEGV": ", a fault of a library",
    "SIGBUS": ", a fault of a library, or of a disk",
    "SIGXCPU": ", a limit on time that this machine sets",
}


def in_child(work: Callable[[Say], None]) -> Child:
    """Do some work in a child, and return how that ended.

    Args:
        work: takes a function by which it says things to the parent.

    Raises:
        KeyboardInterrupt: when the child, or this process, was interrupted.
    """
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    reading, writing = os.pipe()
    me = os.getpid()
    with warnings.catch_warnings():
        # Python warns of other threads: that of `end_with_parents` holds no locks.
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if not child:
        os.close(reading)
        os.environ[PARENTS] = str(me)
        _become(work, writing)
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
    said: dict[str, Any] = {}
    for line in lines[:-1]:  # the last has no end: there is none, or it was cut
        said |= json.loads(line)
    return Child(said, code)


def _become(work: Callable[[Say], None], writing: int) -> None:
    """Do the work, and end this process."""
    code = 1
    try:
        end_with_parents()
        work(lambda said: _write(writing, json.dumps(dict(said)).encode() + b"\n"))
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


def _write(file: int, content: bytes) -> None:
    while content:
        content = content[os.write(file, content) :]


def _stop(child: int) -> None:
    """End a child as an interrupt does; at once where that takes too long for somebody."""
    try:
        with suppress(ProcessLookupError, ChildProcessError):
            os.kill(child, signal.SIGINT)
            os.waitpid(child, 0)
    except BaseException:
        os.kill(child, signal.SIGKILL)
        raise
