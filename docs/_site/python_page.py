"""Writes the reference page of the Python interface, from its docstrings.

python docs/_site/python_page.py docs/python.md
"""

from __future__ import annotations

import dataclasses
import inspect
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from field_comments import comments

import pa10cal

_HEAD = """# From Python

This page is generated from the docstrings (`make schema`).
`python examples/calibrate_and_discover.py data/raw/cell-a model.yaml` uses all of it.

```python
import pa10cal

campaign = pa10cal.read_campaign("data/raw/cell-a")
model = pa10cal.calibrate(campaign)  # base, tool, geometry, springs
model.parameters  # a table: value, standard uncertainty, unit
model.predict([0.1, 0.4, 0.9, 0.0, 0.5, 0.2]).T  # the flange in the robot's base frame

verdict = pa10cal.discover(campaign, model)  # what the model lacks
verdict.verdict, [(finding.id, finding.of) for finding in verdict.effects]
verdict.model.save("model.yaml")
pa10cal.load_model("model.yaml")
```
"""

#: Characters in a line of prose.
_LINE = 120


def reference() -> str:
    """Return the page as Markdown."""
    parts = [_HEAD]
    for name in pa10cal.__all__:
        thing = getattr(pa10cal, name)
        if inspect.isclass(thing):
            parts += [f"## `pa10cal.{name}`\n", _text(thing), *_keys(thing)]
            parts += [
                f"{_heading(f'{name}.{member}', _signature(of))}\n\n{_text(of)}"
                for member, of in _members(thing).items()
                if not member.startswith("_") and _documented(of)
            ]
        else:
            parts += [f"## `pa10cal.{name}{_signature(thing)}`\n", _text(thing)]
    return "\n".join(part.rstrip() + "\n" for part in parts)


def _heading(name: str, signature: str) -> str:
    """Return the heading of a member; a long signature stands in a block below it."""
    line = f"### `{name}{signature}`"
    if len(line) <= _LINE:
        return line
    arguments = ",\n    ".join(signature[1:-1].split(", "))
    return f"### `{name}`\n\n```python\n{name}(\n    {arguments},\n)\n```"


def _keys(thing: Any) -> list[str]:
    """Return the keys of a section of settings, each with its default and meaning."""
    fields = getattr(thing, "model_fields", {})
    lines = [
        f"| `{name}` | `{field.get_default()!r}` | {field.description} |"
        for name, field in fields.items()
    ]
    return ["\n".join(["| key | default | meaning |", "| --- | --- | --- |", *lines])] * bool(lines)


def _documented(member: Any) -> bool:
    return bool(_docstring(member)) and not inspect.isclass(member)


def _docstring(thing: Any) -> str:
    if thing is None or isinstance(thing, str | int | float | tuple | dict):
        return ""
    return inspect.getdoc(getattr(thing, "__func__", thing)) or ""


def _members(thing: type) -> dict[str, Any]:
    """Return what a class and the classes of this package below it define."""
    return {name: of for part in reversed(_own(thing)) for name, of in vars(part).items()}


def _own(thing: type) -> list[type]:
    return [part for part in thing.__mro__ if part.__module__.startswith("pa10cal.")]


def _fields(thing: Any) -> list[str]:
    """Return the fields of a class with their comments, which stand behind or above them."""
    if not dataclasses.is_dataclass(thing) or not isinstance(thing, type):
        return []
    return ["", "Attributes:", *(line for part in reversed(_own(thing)) for line in _said(part))]


def _said(part: type) -> Iterator[str]:
    for name, said in comments(part).items():
        yield from textwrap.wrap(
            f"{name}: {said}".removesuffix(": "),
            _LINE - 20,
            initial_indent="    ",
            subsequent_indent="        ",
        )


def _signature(thing: Any) -> str:
    function = getattr(thing, "__func__", thing)
    if not inspect.isfunction(function):
        return ""
    names = [
        parameter.replace(annotation=inspect.Parameter.empty)
        for parameter in inspect.signature(function).parameters.values()
        if parameter.name not in ("self", "cls")
    ]
    return str(inspect.Signature(names))


def _text(thing: Any) -> str:
    """Return a docstring, its sections as they are typed, and the fields of a class."""
    lines = _docstring(thing).splitlines()
    summary, rest = lines[:1], lines[1:]
    body = "\n".join([*rest, *_fields(thing)]).strip()
    return "\n".join([*summary, *([f"\n```text\n{body}\n```"] if body else [])]) + "\n"


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(reference(), encoding="utf-8")
