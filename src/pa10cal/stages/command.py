"""What all stages share on the command line: messages, exit codes, --debug."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence

from pa10cal.errors import Pa10calError

#: Exit codes: refused input, and a fault of the program itself.
REFUSED = 2
FAULT = 3


def limit_threads() -> None:
    """Keep BLAS on one thread a job, unless the user has said otherwise.

    Works only before numpy is first imported, so stages import numpy late.
    """
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def run_stage(
    name: str,
    describe: Callable[[argparse.ArgumentParser], None],
    run: Callable[[argparse.Namespace], None],
    argv: Sequence[str] | None,
) -> int:
    """Parse `argv`, run the stage and turn a refusal into one message and an exit code.

    Args:
        name: stage name, shown in usage and in front of messages.
        describe: adds the stage's own arguments.
        run: does the work; raises `Pa10calError` to refuse.
        argv: arguments without the program's name; None for the process's own.

    Returns:
        0, or `REFUSED`, or `FAULT`.
    """
    parser = argparse.ArgumentParser(prog=f"pa10cal {name}")
    describe(parser)
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    arguments = parser.parse_args(argv)
    try:
        run(arguments)
    except Pa10calError as error:
        if arguments.debug:
            raise
        print(f"pa10cal {name}: {error}", file=sys.stderr)
        return REFUSED
    except Exception as error:
        if arguments.debug:
            raise
        print(
            f"pa10cal {name}: internal fault: {type(error).__name__}: {error}; "
            "run again with --debug and report it",
            file=sys.stderr,
        )
        return FAULT
    return 0
