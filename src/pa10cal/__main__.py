"""`python -m pa10cal` is the command line `pa10cal`."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence

#: That of the command line.
_INTERRUPTED = 130


def start() -> int:
    """Run the command of this process, which an interrupt ends in one line at any moment."""
    former = signal.getsignal(signal.SIGINT)
    if former is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupted)
    import pa10cal.commands.command_line  # noqa: F401 -- what takes time

    signal.signal(signal.SIGINT, former)
    try:
        return main()
    except KeyboardInterrupt:  # once more, while the first was being answered
        return _INTERRUPTED


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that `argv` names and return its exit code."""
    from pa10cal.commands.command_line import main as run

    return run(argv)


def _interrupted(*_: object) -> None:
    os.write(sys.stderr.fileno(), b"pa10cal: interrupted\n")
    os._exit(_INTERRUPTED)


if __name__ == "__main__":
    sys.exit(start())
