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
_CONSTRUCTOR: Any = yaml.constructor.SafeConstructor()
_TAG = "tag:yaml.org,2002:"
_NUMBERS = frozenset((f"{_TAG}int", f"{_TAG}float"))
#: Tags of values that are converted from a text of any length.
_CONVERTED = _NUMBERS | {f"{_TAG}timestamp"}
#: What a text of each tag is not where it cannot be converted.
_NOT = {
    f"{_TAG}int": "no whole number",
    f"{_TAG}float": "no number",
    f"{_TAG}timestamp": "no date",
    f"{_TAG}bool": "neither true nor false",
}
#: Keys that stand for themselves: of merged mappings, and of a default value.
_BY_TEXT = frozenset((f"{_TAG}merge", f"{_TAG}value"))
#: Numbers that YAML 1.1 reads to the base of eight or sixty, which hardly anybody means.
_OTHER_BASE = re.compile(r"[-+]?(?:0[0-7_]+|[0-9_]+(?::[0-9_]+)+(?:\.[0-9_]*)?)")


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
        return _loaded(text)
    except yaml.YAMLError as error:
        message = " ".join(str(error).split())
        mark = getattr(error, "problem_mark", None)
        if mark is not None and re.match(r" *\t", "".join(text.splitlines()[mark.line :][:1])):
            message += "; indent with spaces, not with tabs"
        raise ValueError(message) from None


def _loaded(text: str) -> Any:
    """Return the content of YAML text whose structure is checked."""
    try:
        return yaml.load(text, Loader=_Loader)
    except yaml.YAMLError:
        raise
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        # The package's own conversions raise these, and know no line: find what they cannot read.
        for event in yaml.parse(text, Loader=_Loader):
            if isinstance(event, yaml.ScalarEvent):
                _converted(event)
        raise ValueError(f"a value cannot be converted: {error}") from None


@dataclass(slots=True)
class _Collection:
    """A list or mapping that is being read."""

    anchor: str | None
    keys: dict[Any, str] | None  # keys of a mapping so far, with their lines; None for a list
    key_is_next: bool  # whether what follows in a mapping is a key, or the value of the last one
    nodes: int = 1  # values in it, references followed

    def add_key(self, scalar: Any, line: str) -> None:
        """Note a key of a mapping; refuse one whose value is repeated, or too many."""
        assert self.keys is not None
        key = _converted(scalar)
        if key in self.keys:
            first = self.keys[key]
            twice = f"the key {scalar.value} stands there twice, first in {first}: remove one"
            raise ValueError(f"{line}: {twice}")
        self.keys[key] = line
        if len(self.keys) > MAX_KEYS:
            raise ValueError(f"{line}: more than {MAX_KEYS} keys in one mapping")


def _check_structure(text: str) -> None:
    """Refuse what cannot be read safely, by the parser's events alone and without recursion.

    Raises:
        ValueError: too deep, too many values once references are followed, a reference to nothing,
            a key that is repeated, a number that is too long or to another base, a second document.
        yaml.YAMLError: a syntax error.
    """
    open_collections: list[_Collection] = []
    nodes_by_anchor: dict[str, int] = {}
    scalar_by_anchor: dict[str, Any] = {}  # events of those anchors that are no collections
    documents = 0
    event: Any
    for event in yaml.parse(text, Loader=_Loader):
        kind, line = type(event), _line_of(event)
        scalar = None
        if kind in (yaml.MappingStartEvent, yaml.SequenceStartEvent):
            mapping = kind is yaml.MappingStartEvent
            open_collections.append(_Collection(event.anchor, {} if mapping else None, mapping))
            if len(open_collections) > MAX_DEPTH:
                raise ValueError(f"{line}: nested deeper than {MAX_DEPTH} levels")
            continue
        if kind in (yaml.MappingEndEvent, yaml.SequenceEndEvent):
            closed = open_collections.pop()
            nodes = closed.nodes
            if closed.anchor is not None:
                nodes_by_anchor[closed.anchor] = nodes
        elif kind is yaml.ScalarEvent:
            _check_number(event)
            nodes, scalar = 1, event
            if event.anchor is not None:
                nodes_by_anchor[event.anchor], scalar_by_anchor[event.anchor] = nodes, event
        elif kind is yaml.AliasEvent:
            if event.anchor not in nodes_by_anchor:
                within = any(event.anchor == each.anchor for each in open_collections)
                raise ValueError(f"{line}: {_refers_to_nothing(event.anchor, within)}")
            nodes, scalar = nodes_by_anchor[event.anchor], scalar_by_anchor.get(event.anchor)
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
        if parent.key_is_next and scalar is not None:
            parent.add_key(scalar, line)
        parent.key_is_next = not parent.key_is_next


def _refers_to_nothing(anchor: str, within: bool) -> str:
    """Return what is wrong with a reference to no value, or to the one that it stands within."""
    if within:
        return f"*{anchor} refers to what it stands in"
    return f"no &{anchor} stands before *{anchor}; write it in quotes if it is text"


def _check_number(scalar: Any) -> None:
    """Refuse a scalar event that becomes a number or a date too long, or to another base."""
    text, tag = scalar.value, _tag_of(scalar)
    if len(text) > MAX_NUMBER and tag in _CONVERTED:
        long = f"a number of {len(text)} digits and signs, at most {MAX_NUMBER}"
        raise ValueError(f"{_line_of(scalar)}: {long}")
    if tag in _NUMBERS and _OTHER_BASE.fullmatch(text):
        remedy = "write a number without leading zeros and colons, and text in quotes"
        read = f"YAML reads {text} as {_converted(scalar)}"
        raise ValueError(f"{_line_of(scalar)}: {read}; {remedy}")


def _converted(scalar: Any) -> Any:
    """Return the value that a scalar event becomes.

    Raises:
        ValueError: saying at which line what cannot be converted.
        yaml.YAMLError: a tag of no plain value.
    """
    text, tag = scalar.value, _tag_of(scalar)
    if tag in _BY_TEXT:
        return text
    try:
        return _CONSTRUCTOR.construct_document(yaml.ScalarNode(tag, text, scalar.start_mark))
    except yaml.YAMLError:
        raise
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):
        what = f"{text!r} is {_NOT.get(tag, 'no such value')}; write it in quotes if it is text"
        raise ValueError(f"{_line_of(scalar)}: {what}") from None


def _tag_of(scalar: Any) -> Any:
    """Return the tag of a scalar event, stated or by what its text looks like."""
    if scalar.tag in (None, "!"):
        return _RESOLVER.resolve(yaml.ScalarNode, scalar.value, scalar.implicit)
    return scalar.tag


def _line_of(event: Any) -> str:
    """Return the line of an event, in words."""
    return f"line {event.start_mark.line + 1}"
