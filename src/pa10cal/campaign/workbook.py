"""Rows of workbooks, read in a process of its own, whose death is a refusal.

See `workbook_child`. Limits of memory and time hold what the archive promises nobody; a table of a
million rows of ten numbers is within them.
"""

from __future__ import annotations

import importlib
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from pa10cal.errors import RawDataError

#: What the child may use: memory [bytes], time on the processor [s].
MOST_BYTES, MOST_S = 1_025_000_000, 18
#: A workbook of more than this, unpacked [bytes], or of a sheet of more cells, is refused.
MOST_UNPACKED, MOST_CELLS = 1_000_000_000, 20_000_000


def rows_of_workbook(path: Path, file: IO[bytes]) -> Iterator[tuple[int, str]]:
    """Yield the rows of the sheet with the most cells: numbers from 1, tabs between the cells.

    Args:
        path: what messages name.
        file: the workbook, open; nothing of it has been read.

    Raises:
        RawDataError: when it cannot be read, or not within limits of memory and time.
    """
    importlib.import_module("python_calamine")  # said by its name where it is missing
    limits = (MOST_BYTES, MOST_S, MOST_UNPACKED, MOST_CELLS)
    child = subprocess.Popen(
        [sys.executable, "-P", str(Path(__file__).with_name("workbook_child.py"))]
        + [str(limit) for limit in limits],
        stdin=file,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        encoding="utf-8",
    )
    assert child.stdout is not None
    try:
        for line in child.stdout:
            number, _, text = line.removesuffix("\n").partition("\t")
            if number.startswith("!"):
                raise _refused(path, number[1:], text)
            yield int(number), text
        if child.wait():
            slow = -child.returncode in (signal.SIGXCPU, signal.SIGKILL)
            raise _refused(path, "time" if slow else "memory", "")
    finally:
        child.kill()
        child.stdout.close()
        child.wait()


def _refused(path: Path, kind: str, said: str) -> RawDataError:
    if kind == "unreadable":
        return RawDataError(
            "the workbook cannot be read",
            where=str(path),
            value=said,
            allowed="a workbook without a password (.xlsx, .ods or .xls)",
            remedy="save it again, or export the sheet as text",
        )
    if kind == "cell":
        return RawDataError(
            "a cell stands far from the others",
            where=str(path),
            value=said,
            allowed=f"a sheet of at most {MOST_CELLS} cells, counted from A1 to the last one",
            remedy="delete the rows and columns beyond the table, or save the sheet as CSV",
        )
    if kind == "unpacked":
        return RawDataError(
            "the workbook, unpacked, is larger than is read",
            where=str(path),
            value=said,
            allowed=f"at most {MOST_UNPACKED / 1e6:.0f} MB",
            remedy="save the sheet as CSV, without what is not needed",
        )
    return RawDataError(
        "the workbook needs more memory or time than tables of readings do",
        where=str(path),
        value=f"more {kind}",
        allowed=f"at most {MOST_BYTES / 1e6:.0f} MB and {MOST_S} s",
        remedy="save the sheet as CSV",
    )
