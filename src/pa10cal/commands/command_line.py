"""The commands by name, how one is run, what it prints, and how a failure ends the process.

A command is a function without a result, whose signature and docstring give its command line
(`arguments`).
"""

from __future__ import annotations

import argparse
import ast
import ctypes
import io
import os
import select
import sys
import traceback
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from importlib import import_module
from pathlib import Path
from typing import Any, TextIO, cast, get_type_hints

from pa10cal import __version__
from pa10cal.commands.arguments import Command, parser_for, refuse_to_replace, value_of
from pa10cal.errors import (
    OutputError,
    Pa10calError,
    missing_package,
    no_memory,
    remedy_for,
    visible,
)
from pa10cal.input_files import reason

#: Exit codes: input, settings or use refused; a fault of the program itself; interrupted (Ctrl-C);
#: ended because nobody reads the output any more, as by `| head`.
REFUSED = 2
FAULT = 3
INTERRUPTED = 130
CLOSED = 141

#: Parameters of `mallopt` (malloc.h), and the step by which memory grows [bytes].
_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_MAX = -1, -2, -4
_TOP_PAD = 2**26

#: Commands by their purpose, as `--help` lists them, and the module of each. Modules are given by
#: name: some belong to packages beside this one, which import it.
GROUPS = {
    "a campaign from raw files to a model": {
        "plan": "pa10cal.commands.plan",
        "run": "pa10cal.commands.runs",
        "report": "pa10cal.commands.runs",
        "fleet": "pa10cal.commands.fleet",
        "columns": "pa10cal.commands.data",
        "doctor": "pa10cal.commands.doctor",
    },
    "a calibrated robot in use": dict.fromkeys(
        ("predict", "compensate", "compare", "drift"), "pa10cal.commands.models"
    ),
    "one step of a run": {
        "chain": "pa10cal.commands.chain",
        "ingest": "pa10cal.stages.readings",
        "join": "pa10cal.stages.readings",
        "seed": "pa10cal.stages.readings",
        "calibrate": "pa10cal.stages.calibrate",
        "montecarlo": "pa10cal.commands.montecarlo",
        "discover": "pa10cal.stages.discover",
        "evaluate": "pa10cal.stages.evaluate",
        "transfer": "pa10cal.stages.evaluate",
        "export": "pa10cal.stages.export",
        "figures": "pa10cal.commands.figures",
        "fleet_summary": "pa10cal.commands.fleet",
        "measured": "pa10cal.commands.fleet",
    },
    "arms, effects and public data": dict.fromkeys(
        ("effects", "import_arm", "fetch", "import"), "pa10cal.commands.data"
    ),
    "for maintainers: simulations and studies": {
        "reproduce": "pa10cal.commands.runs",
        "simulate": "pa10cal_lab.command_simulate",
        "coverage": "pa10cal_lab.command_studies",
        "draw_trials": "pa10cal_lab.command_simulate",
        "blind_trials": "pa10cal_lab.command_blind_trials",
        "score_trials": "pa10cal_lab.command_studies",
        "curve": "pa10cal_curve.commands",
        "curve_calibration": "pa10cal_curve.commands",
    },
}
#: The module of every command.
COMMANDS = {name: module for names in GROUPS.values() for name, module in names.items()}
#: Words that ask for help.
_HELP = ("-h", "--help")
#: Functions of commands whose name is a keyword of Python.
_FUNCTIONS = {"import": "import_data"}

#: Errors of the system that are faults of the program: of files and pipes that it chose itself.
_OWN_FAULTS = (FileNotFoundError, BrokenPipeError)
_USE = "usage: pa10cal COMMAND [options]\n       pa10cal COMMAND --help | pa10cal --version"
_EXAMPLES = """\
examples:
  pa10cal columns export.csv --robot ur10 > campaign.yaml    how to read a file as it is
  pa10cal run FOLDER                                         raw files to grade, model, figures
  pa10cal run --help                                         its arguments and more examples"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that `argv` names and return the exit code of the process.

    A failure ends at one of two levels. `run_command` tells those of a command under its name;
    `_main` those before a command runs (an import takes long enough to be interrupted), and of the
    output, which is flushed last.

    Args:
        argv: arguments without the program's name; None for the process's own.

    Raises:
        SystemExit: as by `run_command`.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    with Path(os.devnull).open("w", encoding="utf-8") as nowhere:
        out = _SafeStream.of(sys.stdout or nowhere, required=True)
        err = _SafeStream.of(sys.stderr or nowhere, required=False)
        with redirect_stdout(out), redirect_stderr(err):
            return _main(words)


class _SafeStream:
    """A standard stream that prints all text as `errors.visible` returns it.

    Where it cannot be written, as on a full disk, standard output refuses that; messages on
    standard error are lost, as there is no other place to tell it. What follows is discarded.
    Sequences that move the cursor are written to its attribute `terminal`.
    """

    def __init__(self, terminal: TextIO, *, required: bool) -> None:
        self.terminal, self._required = terminal, required

    @classmethod
    def of(cls, stream: TextIO, *, required: bool) -> TextIO:
        """Return a stream so; letters that its encoding lacks are written by their numbers."""
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
        return cast("TextIO", cls(stream, required=required))

    def write(self, text: str) -> int:
        with self._guarded():
            self.terminal.write(visible(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        with self._guarded():
            self.terminal.flush()

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        """Refuse what cannot be written, or lose it.

        Raises:
            BrokenPipeError: when nobody reads standard output, which is no mistake.
            OutputError: when that cannot be written for another reason.
        """
        try:
            yield
        except OSError as error:
            if self._required and isinstance(error, BrokenPipeError):
                raise
            _discard(self.terminal)
            if self._required:
                raise OutputError(
                    f"what is printed cannot be written: {reason(error)}",
                    where="standard output",
                    allowed="a terminal, a pipe, or a file on a disk with space",
                    remedy="make space, or send it elsewhere",
                ) from error

    def __getattr__(self, name: str) -> Any:
        return getattr(self.terminal, name)


def _main(words: list[str]) -> int:
    try:
        try:
            if "PA10CAL_PARENTS" in os.environ:  # this process is a job of a run of the workflow
                from pa10cal.running.child import end_with_parents
                from pa10cal.running.run_lock import share

                end_with_parents()
                share()
            return _run(words)
        finally:
            sys.stdout.flush()
    except OutputError as error:
        # Of the output that is flushed last, of a run of the workflow that has ended before this
        # job of it began, or of a working folder that was removed.
        print(f"pa10cal: {error}", file=sys.stderr)
        return REFUSED
    except BrokenPipeError:
        _discard(sys.stdout)
        return CLOSED
    except KeyboardInterrupt:
        print("pa10cal: interrupted", file=sys.stderr)
        return INTERRUPTED


def _run(words: list[str]) -> int:
    """Run a command, or print what an option in its place asks for; return the exit code."""
    first, second = [*words, "", ""][:2]
    if first == "--version":
        print(f"pa10cal {__version__}")
        return 0
    if first in _HELP:
        if not second or second.startswith("-"):
            print(_usage())
            return 0
        words, first = [*words[1:], "--help"], second
    if first not in COMMANDS:
        if words:
            what = "no such command"
            remedy = remedy_for(first, COMMANDS, "see the list of pa10cal --help")
            if first.startswith("-"):
                what, remedy = "no option of pa10cal itself", "give options after the command"
            print(f"{_USE}\npa10cal: {what} (got {first!r}); {remedy}", file=sys.stderr)
        else:
            print(_usage(), file=sys.stderr)
        return REFUSED
    _refuse_a_lost_folder()
    limit_threads()
    keep_memory()
    return run_command(first, words[1:])


def _refuse_a_lost_folder() -> None:
    """Refuse to work in a folder that does not exist any more.

    Raises:
        OutputError: naming what to do.
    """
    try:
        Path.cwd()
    except FileNotFoundError as error:
        raise OutputError(
            "it has been removed",
            where="the working folder",
            allowed="a folder that exists",
            remedy="change to another one, and call the command again",
        ) from error


def limit_threads() -> None:
    """Limit BLAS to one thread in each process, whatever the environment says.

    Several threads add in another order, so the last digits of results would depend on the machine.
    It has an effect only before numpy is first imported; commands import it late.
    """
    for library in ("OPENBLAS", "OMP", "MKL", "BLIS", "NUMEXPR"):
        os.environ[f"{library}_NUM_THREADS"] = "1"
    os.environ["VECLIB_MAXIMUM_THREADS"] = "1"


def keep_memory() -> None:
    """Keep the memory of freed arrays for new ones, instead of returning it to the system.

    The system zeroes returned memory page by page, and large arrays come and go all the time:
    without this a search of many poses spends a third of its time there. It has an effect only with
    the C library of GNU (`malloc.h`).
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_MMAP_MAX, 0)
        mallopt(_M_TRIM_THRESHOLD, 2**31 - 1)
        mallopt(_M_TOP_PAD, _TOP_PAD)


def command_named(name: str) -> Command:
    """Return the function of one of `COMMANDS`."""
    module = import_module(COMMANDS[name])
    command: Command = getattr(module, _FUNCTIONS.get(name, name))
    return command


def parser_of(name: str) -> argparse.ArgumentParser:
    """Return the parser of one of `COMMANDS`, from which its help and its reference are made."""
    command = command_named(name)
    return parser_for(name, command, get_type_hints(command))


def run_command(name: str, argv: Sequence[str], command: Command | None = None) -> int:
    """Parse `argv`, call the command, and turn an error into one message and an exit code.

    Args:
        name: one of `COMMANDS`, shown in usage and in front of messages.
        argv: arguments after the command's name.
        command: the function; None for that of `name`.

    Returns:
        0, `REFUSED`, `FAULT`, `INTERRUPTED` or `CLOSED`.

    Raises:
        SystemExit: by argparse: with code 0 after help was printed, with `REFUSED` after wrong use.
    """
    try:
        command = command or command_named(name)
    except ImportError as error:
        return _report(name, error, debug="--debug" in argv)
    types = get_type_hints(command)
    given = vars(parser_for(name, command, types).parse_args(argv))
    debug: bool = given.pop("debug")
    try:
        refuse_to_replace(name, given, types)
        values = {key: value_of(types[key], value, key) for key, value in given.items()}
        command(**values)
    except KeyboardInterrupt:
        print(f"pa10cal {name}: interrupted", file=sys.stderr)
        return INTERRUPTED
    except Exception as error:
        # A pipe to another process than the reader of the output may be the broken one, as well.
        if isinstance(error, BrokenPipeError) and _nobody_reads():
            _discard(sys.stdout)
            return CLOSED
        return _report(name, error, debug=debug)
    return 0


def _report(name: str, error: Exception, *, debug: bool) -> int:
    """Print the message of an error that is being handled, and return the exit code."""
    if debug:
        traceback.print_exc()
    message, code = _message(error)
    print(f"pa10cal {name}: {message}", file=sys.stderr)
    return code


def _message(error: Exception) -> tuple[str, int]:
    """Return what is said of an error, and the exit code that goes with it."""
    refusal = error if isinstance(error, Pa10calError) else missing_package(error)
    if refusal is not None:
        return str(refusal), REFUSED
    if isinstance(error, MemoryError):
        return no_memory(error), REFUSED
    if isinstance(error, OSError) and error.strerror and not isinstance(error, _OWN_FAULTS):
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}a file cannot be read or written: {error.strerror}", REFUSED
    what = f"internal fault: {type(error).__name__}: {error}"
    return f"{what}; run again with --debug and report it", FAULT


def _nobody_reads() -> bool:
    """Return whether standard output is a pipe whose other end is closed."""
    poll = select.poll()
    try:
        poll.register(sys.stdout.fileno(), 0)
    except OSError:  # not a file at all
        return False
    return any(event & select.POLLERR for _, event in poll.poll(0))


def _discard(stream: TextIO) -> None:
    """Discard the rest of an output, which would fail again when the process ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _usage() -> str:
    """Return how to call the program, with a line for every command."""
    width = max(map(len, COMMANDS))
    groups = []
    for title, names in GROUPS.items():
        lines = [f"  {name:<{width}}  {_summary(name)}" for name in names]
        groups.append("\n".join((f"{title}:", *lines)))
    return "\n\n".join((_USE, *groups, _EXAMPLES))


def _summary(name: str) -> str:
    """Return the first paragraph of a command's docstring, without its full stop.

    It is read from the source, so that a list of the commands does not import them all.
    """
    function = _FUNCTIONS.get(name, name)
    path = Path(__file__).parents[2] / f"{COMMANDS[name].replace('.', '/')}.py"
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef) and node.name == function:
            first, _, _ = (ast.get_docstring(node) or "").partition("\n\n")
            return " ".join(first.split()).rstrip(".")
    raise LookupError(f"{path} has no {function}")
