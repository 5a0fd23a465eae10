"""Snakemake called many times, and started once: each call is a fork of a process that imported it.

Importing Snakemake, and what the project's rules import of other packages, takes several times as
long as most plans. Of the project itself nothing is imported before a call: a call may have a
checkout of its own.
"""

from __future__ import annotations

import gc
import json
import os
import re
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

TIMEOUT_S = 300
#: What the rules import, through the project, and what Snakemake does when it is called.
_USED = (
    *("pandas", "pyarrow", "pydantic", "scipy.interpolate", "scipy.optimize", "yaml"),
    *("snakemake.profiles", "snakemake.report.html_reporter", "scipy.sparse.csgraph"),
    *("snakemake.storage", "requests", "smart_open"),
)


def planned(text: str) -> Counter[str]:
    """Read the job counts of a dry run; none when there is nothing to do."""
    table = re.search(r"^Job stats:\n.*\n-.*\n((?:\S+ +\d+\n)+)", text, re.MULTILINE)
    rows = (row.split() for row in table[1].splitlines()) if table else ()
    return Counter({name: int(count) for name, count in rows})


class Snakemake:
    """A process that has imported Snakemake and waits for calls."""

    def __init__(self, folder: Path) -> None:
        """Start it; what calls print goes through a file in the folder."""
        self._printed = folder / "printed.txt"
        clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
        # The plugin for Slurm asks a controller at its import, and waits if there is none.
        (folder / "scontrol").symlink_to("/bin/false")
        clean["PATH"] = f"{folder}{os.pathsep}{clean['PATH']}"
        self._process = subprocess.Popen(
            [sys.executable, __file__],
            env=clean,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def __call__(
        self, *words: object, cwd: Path, env: Mapping[str, str] | None = None
    ) -> tuple[int, str]:
        """Run `python -m snakemake` with words; return its exit code and all it printed."""
        call = {
            "words": [str(word) for word in words],
            "cwd": str(cwd),
            "env": {**os.environ, **(env or {})},
            "printed": str(self._printed),
        }
        asked, told = self._process.stdin, self._process.stdout
        assert asked is not None
        assert told is not None
        print(json.dumps(call), file=asked, flush=True)
        code = int(told.readline())
        return code, self._printed.read_text(encoding="utf-8")

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


def _serve() -> None:
    """Answer each line of a call with the exit code of a fork that made it."""
    from snakemake import cli

    for name in _USED:
        __import__(name)
    gc.collect()
    gc.freeze()  # else each fork looks through all that was imported
    places = sys.path[1:]
    for line in sys.stdin:
        call = json.loads(line)
        child = os.fork()
        if not child:
            _become(call, places)
            cli.main(call["words"])
            raise SystemExit(0)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


def _become(call: Mapping[str, Any], places: Sequence[str]) -> None:
    """Make this process what `python -m snakemake` would be in the folder and environment."""
    signal.alarm(TIMEOUT_S)
    printed = os.open(call["printed"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    nothing = os.open(os.devnull, os.O_RDONLY)
    for here, there in ((nothing, 0), (printed, 1), (printed, 2)):
        os.dup2(here, there)
    os.chdir(call["cwd"])
    os.environ.clear()
    os.environ.update(call["env"])
    asked = [place for place in call["env"].get("PYTHONPATH", "").split(os.pathsep) if place]
    sys.path[:] = [call["cwd"], *asked, *places]
    sys.dont_write_bytecode = bool(call["env"].get("PYTHONDONTWRITEBYTECODE"))
    sys.argv = ["snakemake", *call["words"]]


if __name__ == "__main__":
    _serve()
