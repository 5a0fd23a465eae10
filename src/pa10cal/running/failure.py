"""Finds out why a run of the workflow failed, from its exit code, its logs and its output."""

from __future__ import annotations

import errno
import os
import re
import shutil
from collections.abc import Iterable
from pathlib import Path

from pa10cal.errors import OutputError, Pa10calError, last_message

#: With less room than this on the disk nothing can be written [bytes].
_LEAST_FREE = 1 << 16
#: What shells, Snakemake, Slurm, Python, numpy and the loader of libraries print when memory runs
#: out: the system kills a process that takes too much.
_NO_MEMORY = re.compile(
    r"\bKilled\b|SIGKILL|exit status 137|OUT_OF_MEMORY|MemoryError|Cannot allocate memory"
    r"|Unable to allocate|failed to map segment"
)
#: How Python prints an error of the system, and the file that it is about.
_SYSTEM_ERROR = re.compile(
    r"^(?:\w+: )?\[Errno \d+\] (?P<what>[^:\n]+)(?:: '(?P<where>.+)')?$", re.MULTILINE
)
#: So many lines at the end of what was printed are shown where nothing else says what is wrong.
_LAST_LINES = 8


class StageError(Pa10calError):
    """A command of the workflow refused; its own message says why."""

    def __init__(self, message: str) -> None:
        Exception.__init__(self, message)
        self.what, self.where, self.value, self.allowed, self.remedy = message, "", None, "", ""


def failure(code: int, printed: str, logs: Iterable[Path], results: Path) -> Exception:
    """Return the error that says why a run failed.

    The message of a command is preferred; without one, what the system or Snakemake printed.

    Args:
        code: exit code of Snakemake; minus the number of the signal that ended it.
        printed: what Snakemake and the commands printed.
        logs: logs of the jobs that failed; the first that can be read is used.
        results: folder of results.
    """
    for text in (_first_readable(logs), printed):
        if (message := last_message(text)) is not None:
            return _of_command(*message, results)
    what, where = "", None
    if system_errors := list(_SYSTEM_ERROR.finditer(printed)):
        what, where = system_errors[-1].group("what", "where")
    full = os.strerror(errno.ENOSPC)
    if what == full or full in printed or shutil.disk_usage(results).free < _LEAST_FREE:
        return OutputError(
            "the results cannot be written",
            where=str(where or results),
            value=full,
            allowed="a folder with room in it",
            remedy="make room on the disk, then run the same command again",
        )
    if code < 0:
        return StageError(
            f"the workflow was ended by signal {-code}; "
            "run the same command again: it goes on from there"
        )
    if _NO_MEMORY.search(printed):
        return _killed(results)
    if what:
        return OutputError(
            "the workflow cannot use a file or folder of this machine",
            where=where or "the workflow",
            value=what,
            allowed="one that may be written to, with room in it",
            remedy="let it be written to, or name another one",
        )
    last_lines = [line for line in printed.splitlines() if line.strip()][-_LAST_LINES:]
    return RuntimeError("the workflow failed: " + " | ".join(last_lines))


def _first_readable(logs: Iterable[Path]) -> str:
    """Return the text of the first log that can be read; empty if there is none."""
    for log in logs:
        try:
            return log.read_text(encoding="utf-8", errors="replace")
        except OSError:
            continue
    return ""


def _of_command(command: str, message: str, results: Path) -> Exception:
    """Return the error for the last message of a command, such as `pa10cal ingest`."""
    stage = command.removeprefix("pa10cal").strip()
    if "internal fault" not in message:
        return StageError(f"{stage}: {message}" if stage else message)
    if _NO_MEMORY.search(message):
        return _killed(results)
    return RuntimeError(f"{stage}: {message}")


def _killed(results: Path) -> OutputError:
    return OutputError(
        "a stage was killed before it could say why, as where there is not enough memory",
        where=str(results),
        allowed="enough memory for every stage that runs at once",
        remedy="run the same command with --cores 1, on a machine with more memory, or with fewer "
        "poses; it goes on from there",
    )
