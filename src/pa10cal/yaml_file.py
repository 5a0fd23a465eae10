"""Reads YAML that people wrote, within bounds of depth, size and numbers, and every key once.

The parser's own limits are no protection: deep nesting ends the process, references to references
grow without end, numbers of many digits take hours to convert, and of two keys of one name the
first is dropped without a word.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from pa10cal.errors import Pa10calError
from pa10cal.input_files import read_file, reason

#: Largest file, deepest nesting, and most values once references are followed.
MAX_BYTES, MAX_DEPTH, MAX_NODES = 64 * 1024**2, 40, 200_000
#: Most keys of one mapping, and most letters of a number or a date.
MAX_KEYS, MAX_NUMBER = 10_000, 64

# The parser in C is ten times as fast, and is not in every build of the package.
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
#: Says what a value without quotes or tag becomes.
_RESOLVER: Any = yaml.resolver.Resolver()
#: Tags of values that are converted from their text.
_CONVERTED = frozenset(f"tag:yaml.org,2002:{name}" for name in ("int", "float", "timestamp"))


def read_yaml(
    path: Path,
    error: Callable[..., Pa10calError],
    *,
    what: str,
    allowed: str = "a UTF-8 YAML file",
    remedy: str = "check the path and the file's syntax",
    within: Path | None = None,
) -> Any:
    """Return the content of a YAML file.

    Args:
        path: the file.
        error: the kind of refusal to raise.
        what: what a refusal says is wrong, such as "the arm description cannot be read".
        allowed: what would have been accepted.
        remedy: what to do.
        within: folder that it must lie in; None for anywhere.

    Raises:
        Pa10calError: `error`, when the file cannot be read, is larger than 64 MiB, nests deeper
            than 40 levels, holds more than 200 000 values, or is no YAML of plain values with
            every key once.
    """
    try:
        content = read_file(path, MAX_BYTES, within)
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError as invalid:
            line = content[: invalid.start].count(b"\n") + 1
            message = f"it is not UTF-8 text, as line {line} shows: save it as UTF-8"
            raise ValueError(message) from None
        return parse_yaml(text)
    except (OSError, ValueError) as cause:
        raise error(
            what, where=str(path), value=reason(cause), allowed=allowed, remedy=remedy
        ) from None


def parse_yaml(text: str) -> Any:
    """Return the content of YAML text.

    Raises:
        ValueError: saying at which line what cannot be read.
    """
    try:
        _check_structure(text)
        return yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as error:
        message = " ".join(str(error).split())
        if re.search(r"^ *\t", text, re.MULTILINE):
            message += "; indent with spaces, not with tabs"
        raise ValueError(message) from None
    except (AttributeError, IndexError, TypeError, OverflowError) as error:
        # The package's own conversions of tagged values raise these, such as of `!!int ''`.
        raise ValueError(f"a tagged value that cannot be converted: {error}") from None


@dataclass(slots=True)
class _Collection:
    """A list or mapping that is being read."""

    anchor: str | None
    keys: dict[str, str] | None  # keys of a mapping so far, with their lines; None for a list
    expects_key: bool
    nodes: int = 1  # values in it, references followed

    def add_key(self, key: str, line: str) -> None:
        """Note a key of a mapping; refuse one that is repeated, or too many."""
        assert self.keys is not None
        if key in self.keys:
            twice = f"the key {key} stands there twice, first in {self.keys[key]}: remove one"
            raise ValueError(f"{line}: {twice}")
        self.keys[key] = line
        if len(self.keys) > MAX_KEYS:
            raise ValueError(f"{line}: more than {MAX_KEYS} keys in one mapping")


def _check_structure(text: str) -> None:
    """Refuse what cannot be read safely, by the parser's events alone and without recursion.

    Raises:
        ValueError: too deep, too many values once references are followed, a key that is repeated,
            a number that is too long, a second document.
        yaml.YAMLError: a syntax error.
    """
    open_collections: list[_Collection] = []
    nodes_of: dict[str | None, int] = {}  # by anchor
    documents = 0
    event: Any
    for event in yaml.parse(text, Loader=_Loader):
        kind, line = type(event), f"line {event.start_mark.line + 1}"
        if kind in (yaml.MappingStartEvent, yaml.SequenceStartEvent):
            mapping = kind is yaml.MappingStartEvent
            open_collections.append(_Collection(event.anchor, {} if mapping else None, mapping))
            if len(open_collections) > MAX_DEPTH:
                raise ValueError(f"{line}: nested deeper than {MAX_DEPTH} levels")
            continue
        if kind in (yaml.MappingEndEvent, yaml.SequenceEndEvent):
            closed = open_collections.pop()
            nodes = nodes_of[closed.anchor] = closed.nodes
        elif kind is yaml.ScalarEvent:
            if len(event.value) > MAX_NUMBER and _is_converted(event):
                raise ValueError(
                    f"{line}: a number of {len(event.value)} digits and signs, at most {MAX_NUMBER}"
                )
            nodes = nodes_of[event.anchor] = 1
        elif kind is yaml.AliasEvent:
            if event.anchor not in nodes_of:
                raise ValueError(f"{line}: *{event.anchor} refers to what it stands in")
            nodes = nodes_of[event.anchor]
        else:
            documents += kind is yaml.DocumentStartEvent
            if documents > 1:
                raise ValueError(f"{line}: another document begins there, and one is read")
            continue
        if not open_collections:
            continue
        parent = open_collections[-1]
        parent.nodes += nodes
        if parent.nodes > MAX_NODES:
            raise ValueError(f"{line}: more than {MAX_NODES} values once references are read")
        if parent.keys is None:
            continue
        if parent.expects_key and kind is yaml.ScalarEvent:
            parent.add_key(event.value, line)
        parent.expects_key = not parent.expects_key


def _is_converted(value: Any) -> bool:
    """Return whether a scalar event becomes a number or a date."""
    tag = value.tag
    if tag is None and value.implicit[0]:
        tag = _RESOLVER.resolve(yaml.ScalarNode, value.value, value.implicit)
    return tag in _CONVERTED
