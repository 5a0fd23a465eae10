"""Commands run on files made to do harm: each in a process of its own, limited and watched.

`attack` of `conftest` calls one. It says how the command ended, how long it took, how much memory
it had, which files outside the folder of the attack it read, and which it wrote anywhere.

    def test_a_link_leads_nowhere(attack):
        (attack.inside / "poses.csv").symlink_to(attack.outside / "secret.csv")
        attack("ingest", campaign_dir=attack.inside, ...).refused(r"poses.csv: .*link")

A process that has imported the program waits for calls, and forks for each: that costs 20 ms in
place of two seconds.
"""

from __future__ import annotations

import gc
import json
import os
import re
import resource
import select
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pa10cal.errors import visible

#: What a command may use before it refuses: most take a hundredth.
MOST_S, MOST_MB = 20.0, 1000.0
#: What it can use before it is ended.
LIMIT_MB = 3000
#: What stands in files that are none of the attacker's.
SECRET = "Geheimnis-7391"
#: A table of what was attacked is appended to this file, where the environment names one.
TABLE = "PA10CAL_ATTACKS"
_REFUSED = 2


@dataclass(frozen=True)
class Attacked:
    """What became of a command."""

    words: tuple[str, ...]  # its command line
    code: int  # its exit code; the negative number of the signal that ended it
    said: str  # on standard error
    printed: str  # on standard output
    seconds: float
    peak_mb: float
    read_outside: tuple[str, ...]  # files outside the folder that were opened, or read
    written: tuple[str, ...]  # files that were made, changed or removed, inside and outside

    def refused(self, message: str, where: str = "") -> None:
        """Check that it was refused in one line, at once, with nothing read outside or written."""
        text = f"{' '.join(self.words)}\n{self.said}{self.printed}"
        assert self.code == _REFUSED, f"exit code {self.code}\n{text}"
        assert self.said.count("\n") == 1, text
        assert self.said.startswith(f"pa10cal {self.words[0]}: "), text
        assert re.search(message, self.said), text
        assert where in self.said, text
        assert not self.printed, text
        assert not self.written, self.written
        self.harmless()

    def harmless(self) -> None:
        """Check that it came to a regular end in time and memory, and saw nothing outside."""
        text = f"{' '.join(self.words)}\n{self.said}{self.printed}"
        assert self.code in (0, _REFUSED), f"exit code {self.code}\n{text}"
        assert not self.read_outside, f"{self.read_outside}\n{text}"
        assert SECRET not in text, text
        assert visible(text) == text, "a terminal would obey what is printed"
        assert self.seconds < MOST_S, f"{self.seconds:.1f} s\n{text}"
        assert self.peak_mb < MOST_MB, f"{self.peak_mb:.0f} MB\n{text}"


@dataclass
class Attack:
    """A folder for what an attacker sends, one beside it for what is not theirs, and commands."""

    process: Forking
    inside: Path  # made empty: what was sent
    outside: Path  # holds secrets
    name: str  # what the table calls it
    reads: tuple[Path, ...] = field(default=())  # further folders in which nothing may be read

    def __post_init__(self) -> None:
        self.inside.mkdir()
        self.outside.mkdir()
        for file in ("secret.txt", "secret.csv", "secret.yaml", "secret.urdf", "secret.json"):
            (self.outside / file).write_text(f"{SECRET}\n" * 3, encoding="utf-8")

    def __call__(
        self, command: str, *words: object, seconds: float = 2 * MOST_S, **options: Any
    ) -> Attacked:
        """Run a command, its options as `by_commands.called` has them; or -c and Python code."""
        given = [command, *map(str, words)]
        for name, value in options.items():
            text = json.dumps(value) if isinstance(value, dict) else str(value)
            if value is not None:
                given += [f"--{name.replace('_', '-')}", *([] if value is True else [text])]
        hidden = [self.outside, *self.reads]
        for path in _files(*hidden):
            os.utime(path, (0, path.stat().st_mtime), follow_symlinks=False)
        before = _seen(self.inside, *hidden)
        found = self.process(given, cwd=self.inside.parent, seconds=seconds)
        after = _seen(self.inside, *hidden)
        written = {
            path for path in before.keys() | after.keys() if before.get(path) != after.get(path)
        }
        # A file system may note when a file was read last, which tells of reading in C++ too.
        read = {str(path) for path in _files(*hidden) if path.lstat().st_atime > 0.0}
        read |= {
            path
            for path in found["opened"]
            if any(Path(path).is_relative_to(each) for each in hidden)
        }
        outcome = Attacked(
            tuple(given),
            found["code"],
            found["said"],
            found["printed"],
            found["seconds"],
            found["peak_mb"],
            tuple(sorted(read)),
            tuple(sorted(written)),
        )
        if table := os.environ.get(TABLE):
            cells = (self.name, outcome.code, f"{outcome.seconds:.2f}", f"{outcome.peak_mb:.0f}")
            with open(table, "a", encoding="utf-8") as rows:
                print(*cells, outcome.said.strip()[:200], sep="\t", file=rows)
        return outcome


def _files(*folders: Path) -> list[Path]:
    """Return regular files; links are not followed."""
    every = (
        Path(place, name) for each in folders for place, _, names in os.walk(each) for name in names
    )
    return [path for path in every if path.is_file() and not path.is_symlink()]


def _seen(*folders: Path) -> dict[str, tuple[int, ...]]:
    """Return what is in folders, with what changes when it is written."""
    every = (
        Path(place, name)
        for each in folders
        for place, names, files in os.walk(each)
        for name in (*names, *files)
    )
    known = ((str(path), path.lstat()) for path in every)
    return {
        path: (of.st_ino, of.st_size, of.st_mtime_ns) if not os.path.isdir(path) else (of.st_ino,)
        for path, of in known
    }


class Forking:
    """A process that has imported the program and waits for calls."""

    def __init__(self, folder: Path) -> None:
        """Start it; what calls print goes through files in the folder."""
        self._folder = folder
        self._process = subprocess.Popen(
            [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def __call__(self, words: list[str], cwd: Path, seconds: float) -> dict[str, Any]:
        """Run `pa10cal` with words, or the code after -c; return its end, and all it printed."""
        call = {"words": words, "cwd": str(cwd), "seconds": seconds}
        files = {name: self._folder / f"{name}.txt" for name in ("said", "printed", "opened")}
        call |= {name: str(path) for name, path in files.items()}
        asked, told = self._process.stdin, self._process.stdout
        assert asked is not None
        assert told is not None
        print(json.dumps(call), file=asked, flush=True)
        found = json.loads(told.readline())
        texts = {name: path.read_text("utf-8", errors="replace") for name, path in files.items()}
        return found | texts | {"opened": texts["opened"].splitlines()}

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


def _serve() -> None:
    """Answer each line of a call with how a fork that made it ended, and what that took."""
    from importlib import import_module

    from pa10cal.commands.command_line import COMMANDS, limit_threads

    limit_threads()
    for module in ("pandas", "pyarrow.parquet", "scipy.optimize", *_modules(COMMANDS)):
        import_module(module)
    gc.collect()
    gc.freeze()  # else each fork looks through all that was imported
    for line in sys.stdin:
        call = json.loads(line)
        began = time.monotonic()
        child = os.fork()
        if not child:
            _become(call)
            os._exit(_code(call["words"]))
        watch = os.pidfd_open(child)
        if not select.select([watch], [], [], call["seconds"])[0]:
            os.killpg(child, signal.SIGKILL)
        _, status, used = os.wait4(child, 0)
        os.close(watch)
        found = {
            "code": os.waitstatus_to_exitcode(status),
            "seconds": time.monotonic() - began,
            "peak_mb": used.ru_maxrss / 1e3,
        }
        print(json.dumps(found), flush=True)


def _modules(commands: Mapping[str, str]) -> list[str]:
    """Return the modules of commands, and what they import when they are called."""
    later = ("campaign.read", "files.arms", "reports.page", "results.codec", "interface")
    return [*dict.fromkeys(commands.values()), *(f"pa10cal.{name}" for name in later)]


def _code(words: list[str]) -> int:
    from pa10cal.commands.command_line import main

    code = 1
    try:
        if words[0] == "-c":
            exec(words[1], {})
            return 0
        code = main(words)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
    return code


def _become(call: Mapping[str, Any]) -> None:
    """Make this process one of its own, limited, that writes down which files it opens."""
    os.setpgid(0, 0)
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
    printed, said = (os.open(call[name], flags, 0o644) for name in ("printed", "said"))
    nothing = os.open(os.devnull, os.O_RDONLY)
    opened = os.open(call["opened"], flags | os.O_APPEND, 0o644)
    for here, there in ((nothing, 0), (printed, 1), (said, 2)):
        os.dup2(here, there)
    os.chdir(call["cwd"])
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (LIMIT_MB * 10**6,) * 2)

    def note(event: str, given: tuple[Any, ...]) -> None:
        if event == "open" and isinstance(given[0], str | bytes):
            folder = given[2] & (os.O_DIRECTORY | os.O_PATH) if isinstance(given[2], int) else 0
            if not folder:
                os.write(opened, os.fsencode(os.path.realpath(given[0])) + b"\n")

    sys.addaudithook(note)


if __name__ == "__main__":
    _serve()
