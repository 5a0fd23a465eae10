"""Parts of pages that are made from the code: `<!-- generated: commands -->` gets the tables."""

from __future__ import annotations

import argparse
import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from field_comments import comments
from sphinx.application import Sphinx

#: Of more parameters only the first and the last are listed.
_MOST_NAMES = 4


def commands() -> str:
    """Return a section for every command, from its signature and docstring."""
    from pa10cal.commands.command_line import GROUPS, parser_of

    parts = []
    for title, names in GROUPS.items():
        parts.append(f"## {title[0].upper()}{title[1:]}")
        parts += [_command(parser_of(name), name) for name in names]
    return "\n\n".join(parts)


def _command(parser: argparse.ArgumentParser, name: str) -> str:
    """Return what a command does, its arguments as a table, and examples."""
    head = "| argument | what |\n| --- | --- |"
    lines = [f"### `pa10cal {name}`", parser.description or "", head]
    for action in parser._actions:
        if action.dest in ("help", "debug"):
            continue
        word = action.option_strings[0] if action.option_strings else action.dest
        value = "" if action.nargs == 0 or not action.option_strings else f" {_value(action)}"
        needed = "" if not action.required else " (needed)"
        meaning = (action.help or "").replace("%%", "%").replace("|", "\\|").replace("<", "\\<")
        lines[-1] += f"\n| `{word}{value}` | {meaning}{needed} |"
    if lines[-1] == head:
        lines[-1] = "It takes no arguments."
    if parser.epilog:
        examples = parser.epilog.partition("\n")[2]
        lines.append(f"```sh\n{inspect.cleandoc('  ' + examples.strip())}\n```")
    return "\n\n".join(lines)


def _value(action: argparse.Action) -> str:
    if action.choices:
        return "{" + ",".join(map(str, action.choices)) + "}"
    return str(action.metavar or action.dest.upper())


def effects() -> str:
    """Return a section for every effect that can be named, from its class."""
    from pa10cal.files.arms import load_arm
    from pa10cal.terms.effects.vocabulary import vocabulary_of

    return "\n\n".join(_effect(places) for places in vocabulary_of(load_arm("pa10_6ce")))


def _effect(places: tuple[Any, ...]) -> str:
    first = places[0]
    reported = first.report(first.starts[0]).parameters
    shown = [f"`{each.name}` [{each.unit}]" for each in reported]
    if len(shown) > _MOST_NAMES:
        shown[1:-1] = ["…"]
    size = first.parameters[0]
    rows = {
        "sits at": ", ".join(each.of for each in places).replace(", joint ", ", "),
        f"formula, at {first.of}": f"`{first.formula}`",
        "moves": ", ".join(f"`{each}`" for each in first.coordinates) or "the logged torque alone",
        "parameters": ", ".join(shown),
        "sign": _sign(first, [each.name for each in reported]),
        "expected size": f"{size.plausible:.2g} {size.unit}".removesuffix(" 1"),
    }
    if first.depends_on:
        rows["goes with"] = "time or temperature: the campaign must have lasted, or warmed up"
    table = "\n".join(f"| {what} | {value} |" for what, value in rows.items())
    return f"## `{first.id}`\n\n{_text(type(first))}\n\n| | |\n| --- | --- |\n{table}"


def _sign(effect: Any, reported: list[str]) -> str:
    """Return which signs its amount may have."""
    if effect.limits.positive:
        return "never negative"
    return "by the phase" if {"A", "phi"} <= set(reported) else "either"


def rivals() -> str:
    """Return a table of the effects without a name."""
    from pa10cal.terms.effects.vocabulary import every_effect

    rows = [
        f"| `{kind.id}` | {_text(kind).splitlines()[0].removesuffix('.')} |"
        for kind in every_effect()
        if kind.generic
    ]
    return "\n".join(["| id | meaning |", "| --- | --- |", *rows])


def formats() -> str:
    """Return a table of the known formats of files."""
    from pa10cal.campaign.formats import FORMATS

    head = ["| `format` | file | told by | what is read |", "| --- | --- | --- | --- |"]
    rows = [f"| `{each.name}` | {each.title} | {each.told_by} | {each.holds} |" for each in FORMATS]
    return "\n".join([*head, *rows])


#: How a comment on a number of `rules.py` is read: what it bounds [unit] (where it is from).
RULE = re.compile(r"(?P<what>.*?)(?: \[(?P<unit>[^]]*)\])? \((?P<source>[^()]*)\)")


def rules() -> str:
    """Return a table of the numbers of every part of `discovery/rules.py`."""
    from pa10cal.discovery.rules import SECTIONS

    return _sections(SECTIONS)


def calibration_rules() -> str:
    """Return the same of `calibration/rules.py`."""
    from pa10cal.calibration.rules import SECTIONS

    return _sections(SECTIONS)


def shared_rules() -> str:
    """Return the same of `rules.py`."""
    from pa10cal.rules import SECTIONS

    return _sections(SECTIONS)


def _sections(sections: Mapping[str, Any]) -> str:
    parts = []
    for name, of in sections.items():
        said = comments(type(of))
        head = ["| number | value | what it bounds | from |", "| --- | --- | --- | --- |"]
        rows = [_rule(each.name, getattr(of, each.name), said[each.name]) for each in fields(of)]
        parts.append("\n".join([f"### {name}\n\n{_text(type(of))}\n", *head, *rows]))
    return "\n\n".join(parts)


def _rule(name: str, value: Any, said: str) -> str:
    found = RULE.fullmatch(said)
    assert found is not None, f"{name}: {said}"
    numbers = np.ravel(np.array(value, dtype=object)).tolist()
    shown = ", ".join(f"{number:.4g}" if number < 1e6 else str(number) for number in numbers)
    unit = f" {found['unit']}" if found["unit"] else ""
    return f"| `{name}` | {shown}{unit} | {found['what']} | {found['source']} |"


def _text(kind: type) -> str:
    """Return a docstring without its list of attributes."""
    return inspect.cleandoc(kind.__doc__ or "").partition("\n\nAttributes:")[0]


PARTS: dict[str, Callable[[], str]] = {
    "commands": commands,
    "effects": effects,
    "rivals": rivals,
    "formats": formats,
    "rules": rules,
    "calibration_rules": calibration_rules,
    "shared_rules": shared_rules,
}
_MARK = re.compile(r"<!-- generated: (\w+) -->")


def _fill(app: Sphinx, page: str, content: list[str]) -> None:
    """Put the generated parts in place of their marks."""
    del app, page
    content[0] = _MARK.sub(lambda found: PARTS[found[1]](), content[0])


def setup(app: Sphinx) -> dict[str, Any]:
    """Fill in pages as they are read."""
    app.connect("source-read", _fill)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
