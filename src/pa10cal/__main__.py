"""`python -m pa10cal` is the command line `pa10cal`."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence

#: Exit code of an interrupted command, as the command line has it.
_INTERRUPTED = 130


def start() -> int:
    """Run the command of this process; an interrupt ends it with one line at any moment."""
    takes_interrupts = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if takes_interrupts:
        signal.signal(signal.SIGINT, _exit_interrupted)
    import pa10cal.commands.command_line  # noqa: F401 -- takes most of the time

    if takes_interrupts:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return main()
    except KeyboardInterrupt:  # a second one, while the first was handled
        return _INTERRUPTED


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that `argv` names and return its exit code."""
    from pa10cal.commands.command_line import main as run

    return run(argv)


def _exit_interrupted(*_: object) -> None:
    os.write(sys.stderr.fileno(), b"pa10cal: interrupted\n")
    os._exit(_INTERRUPTED)


if __name__ == "__main__":
    sys.exit(start())
