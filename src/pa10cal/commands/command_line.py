"""The command line of every command, built from its function's signature and docstring.

A command is a function without a result: positional parameters are positional arguments, keyword
parameters are options, one without a default is required, and a `bool` is a switch. The docstring
gives the help: its text stands above the arguments, its `Args:` section beside each of them, its
`Examples:` section below. A parameter whose type is a section of the settings takes a JSON object
or the path of a YAML file.
"""

from __future__ import annotations

import argparse
import ast
import ctypes
import inspect
import io
import os
import re
import select
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from importlib import import_module
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, NoReturn, TextIO, Union, cast, get_args, get_origin, get_type_hints

from pa10cal import __version__
from pa10cal.errors import (
    OutputError,
    Pa10calError,
    missing_package,
    no_memory,
    remedy_for,
    visible,
)
from pa10cal.input_files import is_file, reason

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
#: Functions of commands whose name is a keyword of Python.
_FUNCTIONS = {"import": "import_data"}

#: Parameters of files that a command writes; of all other commands `out`.
_OUTPUTS = {
    "ingest": ("out", "quarantine"),
    "discover": ("verdict", "analysis", "extended", "suggested"),
    "evaluate": ("out", "iso9283"),
    "export": ("model", "urdf", "dh"),
    "simulate": ("out", "truth"),
    "coverage": ("out", "table"),
    "blind_trials": ("verdicts", "truths"),
    "score_trials": ("scores", "trials"),
}
#: Endings of files that a command writes beside `out`, under the same name, and that it does not
#: guard itself (`_refuse_to_replace`).
_BESIDE = {"plan": (".json",)}

#: Errors of the system that are faults of the program: of files and pipes that it chose itself.
_OWN_FAULTS = (FileNotFoundError, BrokenPipeError)
#: Defaults of parameters that say nothing to a reader of the help.
_NO_DEFAULT = (None, "", ())

_USE = "usage: pa10cal COMMAND [options]\n       pa10cal COMMAND --help | pa10cal --version"
_EXAMPLES = """\
examples:
  pa10cal columns export.csv --robot ur10 > campaign.yaml    how to read a file as it is
  pa10cal run FOLDER                                         raw files to grade, model, figures
  pa10cal run --help                                         its arguments and more examples"""

Command = Callable[..., None]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that `argv` names and return the exit code of the process.

    A failure ends at one of two levels. `run_command` tells those of a command under its name;
    `_main` those before a command runs (an import takes long enough to be interrupted), and of the
    output, which is flushed last.

    Args:
        argv: arguments without the program's name; None for the process's own.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    with Path(os.devnull).open("w", encoding="utf-8") as nowhere:
        out, err = (_Visible.of(stream or nowhere) for stream in (sys.stdout, sys.stderr))
        with redirect_stdout(out), redirect_stderr(err):
            return _main(words)


class _Visible:
    """A stream that prints all text as `errors.visible` returns it, and refuses a full disk.

    Sequences that move the cursor are written to its attribute `terminal`.
    """

    def __init__(self, terminal: TextIO) -> None:
        self.terminal = terminal

    @classmethod
    def of(cls, stream: TextIO) -> TextIO:
        """Return a stream so; letters that its encoding lacks are written by their numbers."""
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
        return cast("TextIO", cls(stream))

    def write(self, text: str) -> int:
        with self._refusing():
            self.terminal.write(visible(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        with self._refusing():
            self.terminal.flush()

    @contextmanager
    def _refusing(self) -> Iterator[None]:
        """Refuse an output that cannot be written, and discard what follows.

        Raises:
            BrokenPipeError: when nobody reads it, which is no mistake.
            OutputError: for all other reasons.
        """
        try:
            yield
        except BrokenPipeError:
            raise
        except OSError as error:
            _discard(self.terminal)
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
    except OutputError as error:  # of the last output, or of a run that has ended already
        print(f"pa10cal: {error}", file=sys.stderr)
        return REFUSED
    except BrokenPipeError:
        _discard(sys.stdout)
        return CLOSED
    except KeyboardInterrupt:
        print("pa10cal: interrupted", file=sys.stderr)
        return INTERRUPTED


def _run(words: list[str]) -> int:
    if words in (["-h"], ["--help"]):
        print(_usage())
        return 0
    if words[:1] in (["-h"], ["--help"]):
        words = [*words[1:], "--help"]
    if words == ["--version"]:
        print(f"pa10cal {__version__}")
        return 0
    if not words or words[0] not in COMMANDS:
        if words:
            what = "no such command"
            remedy = remedy_for(words[0], COMMANDS, "see the list of pa10cal --help")
            if words[0].startswith("-"):
                what, remedy = "no option of pa10cal itself", "give options after the command"
            print(f"{_USE}\npa10cal: {what} (got {words[0]!r}); {remedy}", file=sys.stderr)
        else:
            print(_usage(), file=sys.stderr)
        return REFUSED
    limit_threads()
    keep_memory()
    return run_command(words[0], words[1:])


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
    return _parser(name, command, get_type_hints(command))


def run_command(name: str, argv: Sequence[str], command: Command | None = None) -> int:
    """Parse `argv`, call the command, and turn an error into one message and an exit code.

    Args:
        name: one of `COMMANDS`, shown in usage and in front of messages.
        argv: arguments after the command's name.
        command: the function; None for that of `name`.

    Returns:
        0, `REFUSED`, `FAULT`, `INTERRUPTED` or `CLOSED`.
    """
    try:
        command = command or command_named(name)
    except ImportError as error:
        return _report(name, error, debug="--debug" in argv)
    types = get_type_hints(command)
    given = vars(_parser(name, command, types).parse_args(argv))
    debug: bool = given.pop("debug")
    try:
        _refuse_to_replace(name, given)
        values = {key: _parsed(types[key], value, key) for key, value in given.items()}
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


def _refuse_to_replace(command: str, given: Mapping[str, Any]) -> None:
    """Refuse an output that would replace a file that the command reads.

    Args:
        command: its name.
        given: its arguments as they were given: a section of the settings may be a path, too.
    """
    of_outputs = _OUTPUTS.get(command, ("out",))
    outputs = [(option, path) for option in of_outputs for path in _written(command, option, given)]
    if not outputs:
        return
    for name, value in given.items():
        inputs = [] if name in of_outputs else _read_by(value)
        for option, output in outputs:
            if any(map(output.samefile, inputs)):
                raise OutputError(
                    f"the output would replace the file of {name.replace('_', ' ')}",
                    where=f"--{option}",
                    value=str(output),
                    allowed="a path of its own",
                    remedy="give another one",
                )


def _written(command: str, option: str, given: Mapping[str, Any]) -> list[Path]:
    """Return the files that are there and that an option has written: its own, and those beside."""
    output = given.get(option)
    if not isinstance(output, Path):
        return []
    paths = [output]
    if option == "out" and output.name:
        paths += [output.with_suffix(ending) for ending in _BESIDE.get(command, ())]
    return [path for path in paths if is_file(path)]


def _read_by(value: Any) -> list[Path]:
    """Return the files that are read where a parameter has a value.

    They are the paths themselves, the files of models, which a folder of results may stand for, and
    those of a campaign, which its folder stands for.
    """
    from pa10cal.fit.covariance_file import covariance_path  # late: with numpy
    from pa10cal.fit.model_reading import model_file
    from pa10cal.planning.campaign import arm_files, raw_files

    several = value if isinstance(value, list | tuple) else (value,)
    paths = [Path(path) for path in several if isinstance(path, str | Path)]
    folders = [path for path in paths if _is_folder(path)]
    models = [model_file(path) for path in paths if path in folders or path.suffix == ".yaml"]
    files = [*paths, *models, *map(covariance_path, models)]
    for folder in folders:
        files += [folder / "campaign.yaml", *raw_files(folder), *arm_files(folder)]
    return [path for path in files if is_file(path)]


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError:  # as of settings in JSON, which are longer than a name can be
        return False


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


def _parser(name: str, command: Command, types: Mapping[str, Any]) -> argparse.ArgumentParser:
    text, meanings, examples = _parts_of(inspect.getdoc(command) or "")
    parser = _Parser(
        prog=f"pa10cal {name}",
        description=text,
        epilog=f"examples:\n{examples}" if examples else None,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    for parameter in inspect.signature(command).parameters.values():
        hint, meaning = types[parameter.name], meanings.get(parameter.name, "")
        _add_argument(parser, parameter, hint, meaning)
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    return parser


class _Parser(argparse.ArgumentParser):
    """A parser that names the option that was probably meant, and reads -1e3 as a number."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        # Before Python 3.14 argparse takes a negative number with an exponent for an option.
        self._negative_number_matcher = re.compile(r"-(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$")

    def error(self, message: str) -> NoReturn:
        """Refuse wrong use, with the nearest option where one is unknown."""
        word = re.match(r"unrecognized arguments: (--[\w-]+)", message)
        options = [option for action in self._actions for option in action.option_strings]
        remedy = remedy_for(word[1], options, "") if word else ""
        super().error(f"{message}; {remedy}" if remedy else message)


def _parts_of(docstring: str) -> tuple[str, dict[str, str], str]:
    """Return the text of a docstring, the meaning of each parameter, and the examples."""
    docstring, _, examples = docstring.partition("\n\nExamples:\n")
    text, _, rest = docstring.partition("\nArgs:\n")
    section, _, _ = rest.partition("\n\n")
    meanings: dict[str, str] = {}
    for names, meaning in re.findall(
        r"^ {4}(\w[\w, ]*): (.*(?:\n {8,}.*)*)", section, flags=re.MULTILINE
    ):
        for name in names.split(", "):
            meanings[name] = " ".join(meaning.split()).removesuffix(".")
    return text.strip(), meanings, "\n".join(f"  {line.strip()}" for line in examples.splitlines())


def _add_argument(
    parser: argparse.ArgumentParser, parameter: inspect.Parameter, hint: Any, meaning: str
) -> None:
    """Add the argument, or the option, for a parameter of a command."""
    kind, default = _without_none(hint), parameter.default
    options: dict[str, Any] = {"type": kind}
    if kind is bool:
        options = {"action": "store_true"}
    elif get_origin(kind) is Literal:
        options = {"choices": get_args(kind)}
    elif get_origin(kind) is tuple:
        options = {"type": get_args(kind)[0], "nargs": "+"}
    elif _is_section(kind):
        options = {"metavar": "SETTINGS"}
        meaning += ": a JSON object, or the path of a YAML file"
    required = default is parameter.empty
    if not required:
        options["default"] = default
        if default not in _NO_DEFAULT and kind is not bool and not _is_section(kind):
            meaning += f" (default: {default})"
    options["help"] = meaning.replace("%", "%%")
    if parameter.kind is parameter.KEYWORD_ONLY:
        option = "--" + parameter.name.replace("_", "-")
        parser.add_argument(option, dest=parameter.name, required=required, **options)
    else:
        parser.add_argument(parameter.name, **options)


def _parsed(hint: Any, value: Any, name: str) -> Any:
    """Return the value of a parameter: text of a section is parsed, and a list becomes a tuple."""
    kind = _without_none(hint)
    if _is_section(kind) and isinstance(value, str):
        from pa10cal.settings_reading import read_settings_argument

        return read_settings_argument(kind, value, where="--" + name.replace("_", "-"))
    return tuple(value) if isinstance(value, list) else value


def _without_none(hint: Any) -> Any:
    """Return the type of a parameter, without None where it may be None too."""
    if get_origin(hint) in (Union, UnionType):
        (hint,) = (member for member in get_args(hint) if member is not NoneType)
    return hint


def _is_section(kind: Any) -> bool:
    """Return whether a type is a section of the settings; pydantic is not imported here."""
    return isinstance(kind, type) and hasattr(kind, "model_validate")
