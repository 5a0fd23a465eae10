"""The arguments of a command: their parser, their values, and outputs that would replace inputs.

Positional parameters of a command's function are positional arguments, keyword parameters are
options, one without a default is required, and a `bool` is a switch. The docstring gives the help:
its text stands above the arguments, its `Args:` section beside each of them, its `Examples:`
section below. A parameter whose type is a section of the settings takes a JSON object or the path
of a YAML file.
"""

from __future__ import annotations

import argparse
import inspect
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, NoReturn, Union, get_args, get_origin

from pa10cal.errors import OutputError, remedy_for
from pa10cal.input_files import is_file

#: Parameters of what a command writes, files or folders of them; of all other commands `out`.
_OUTPUTS = {
    "curve": ("out_dir",),
    "join": ("out_dir",),
    "ingest": ("out", "quarantine"),
    "discover": ("verdict", "analysis", "extended", "suggested"),
    "evaluate": ("out", "iso9283"),
    "export": ("model", "urdf", "dh"),
    "simulate": ("out", "truth"),
    "coverage": ("out", "table"),
    "blind_trials": ("verdicts", "truths"),
    "score_trials": ("scores", "trials"),
}
_OF_A_CURVE = ("angles", "points", "links", "shape", "joints")
#: Files, as patterns of names, that a command writes into a folder that is one of its outputs.
_IN_FOLDER = {
    "calibrate": ("*N.json", "combined.json", "general.json"),
    "curve": ("curve.json", *(f"{name}.csv" for name in _OF_A_CURVE), "arms/*.yaml"),
    "fleet_summary": ("fleet.*",),
    "join": ("poses.parquet", "quarantine.csv", "*.yaml", "*.urdf"),  # with the arm's description
    "measured": ("measured.csv", "measured.json"),
    "montecarlo": ("z*.json",),
}
#: Endings of files that a command writes beside `out`, under the same name, without asking whether
#: they are there.
_BESIDE = {"plan": (".json",)}

#: Defaults of parameters that say nothing to a reader of the help.
_NO_DEFAULT = (None, "", ())


Command = Callable[..., None]


def parser_for(name: str, command: Command, types: Mapping[str, Any]) -> argparse.ArgumentParser:
    """Return the parser of a command's arguments.

    Args:
        name: of the command, shown in usage.
        command: its function.
        types: of the parameters of the function.
    """
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
        super().__init__(**options, allow_abbrev=False)
        self._words: list[str] = []
        # Before Python 3.14 argparse takes a negative number with an exponent for an option.
        self._negative_number_matcher = re.compile(r"-(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        self._words = list(args or [])
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Refuse wrong use, with the nearest option where one is unknown.

        The unknown one may be the cause where argparse only says that another is required.
        """
        options = [option for action in self._actions for option in action.option_strings]
        words = [word.partition("=")[0] for word in self._words]
        for word in words:
            remedy = remedy_for(word, options, "") if word.startswith("--") else ""
            if remedy and word not in options:
                named = "" if word in message else f"{word} is unknown: "
                message = f"{message}; {named}{remedy}"
                break
        super().error(message)


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


def value_of(hint: Any, value: Any, name: str) -> Any:
    """Return the value of a parameter: text of settings is parsed, and a list becomes a tuple.

    Args:
        hint: type of the parameter.
        value: as argparse returns it.
        name: of the parameter.

    Raises:
        Pa10calError: when a section of the settings is refused.
    """
    kind = _without_none(hint)
    if _is_section(kind) and isinstance(value, str):
        from pa10cal.settings_reading import read_settings_argument

        return read_settings_argument(kind, value, where="--" + name.replace("_", "-"))
    return tuple(value) if isinstance(value, list) else value


def _without_none(hint: Any) -> Any:
    """Return the type of a parameter, of which it has one beside None."""
    if get_origin(hint) in (Union, UnionType):
        (hint,) = (member for member in get_args(hint) if member is not NoneType)
    return hint


def _is_section(kind: Any) -> bool:
    """Return whether a type is a section of the settings; pydantic is not imported here."""
    return isinstance(kind, type) and hasattr(kind, "model_validate")


def refuse_to_replace(command: str, given: Mapping[str, Any], types: Mapping[str, Any]) -> None:
    """Refuse an output that would replace a file that the command reads.

    Args:
        command: its name.
        given: its arguments as they were given: a section of the settings may be a path, too.
        types: of its parameters.

    Raises:
        OutputError: naming the option.
    """
    of_outputs = _OUTPUTS.get(command, ("out",))
    outputs = []
    for option in of_outputs:
        outputs += [(option, path) for path in _replaced(command, option, given.get(option))]
    if not outputs:
        return
    for name, value in given.items():
        inputs = [] if name in of_outputs else _read_by(_paths_in(value, types[name]))
        for option, output in outputs:
            if any(map(output.samefile, inputs)):
                raise OutputError(
                    f"the output would replace the file of {name.replace('_', ' ')}",
                    where="--" + option.replace("_", "-"),
                    value=str(output),
                    allowed="a path of its own",
                    remedy="give another one",
                )


def _replaced(command: str, option: str, output: object) -> list[Path]:
    """Return the files that exist where a command will write: its output, in it, and beside it."""
    if not isinstance(output, Path):
        return []
    if _is_folder(output):
        paths = [path for names in _IN_FOLDER.get(command, ()) for path in output.glob(names)]
    else:
        paths = [output]
        if option == "out" and output.name:
            paths += [output.with_suffix(ending) for ending in _BESIDE.get(command, ())]
    return [path for path in paths if is_file(path)]


def _paths_in(value: Any, hint: Any) -> list[Path]:
    """Return the paths in the value of a parameter.

    Text may be a path: where a section of the settings is expected, or where it has an ending or a
    folder, as `arm.yaml` where an arm may have a name. A name alone is no path.
    """
    several = value if isinstance(value, list | tuple) else (value,)
    section = _is_section(_without_none(hint))

    def may_be_path(each: Any) -> bool:
        if not isinstance(each, str):
            return isinstance(each, Path)
        return section or bool(Path(each).suffix) or Path(each).name != each

    return [Path(each) for each in several if may_be_path(each)]


def _read_by(paths: list[Path]) -> list[Path]:
    """Return the files that are read where paths are given.

    They are the paths themselves, the files of models, which a folder of results may stand for, and
    those of a campaign, which its folder stands for; of other results, which lie in a folder
    together with outputs, none.
    """
    from pa10cal.fit.covariance_file import covariance_path  # late: with numpy
    from pa10cal.fit.model_reading import model_file
    from pa10cal.planning.campaign import arm_files, raw_files

    folders = [path for path in paths if _is_folder(path)]
    there = [path for path in paths if path in folders or is_file(path)]
    models = [model_file(path) for path in there]  # a model may have any ending
    files = [*there, *models, *map(covariance_path, models)]
    for folder in folders:
        files += [folder / "campaign.yaml", *raw_files(folder), *arm_files(folder)]
    return [path for path in files if is_file(path)]


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError:  # as of settings in JSON, which are longer than a name can be
        return False
