"""Reading a section of the settings, and messages for one that does not fit."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from datetime import date
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from pa10cal.errors import SettingsError, remedy_for
from pa10cal.yaml_file import read_yaml

_S = TypeVar("_S", bound=BaseModel)


def parse_section(section: type[_S], raw: object, *, where: str) -> _S:
    """Check a mapping against a section.

    Args:
        section: what it should be.
        raw: what YAML or the command line gave.
        where: the file or option it came from, for the message.

    Raises:
        SettingsError: naming the first offending key, its value and the nearest right name.
    """
    _refuse_bool_for_number(section, raw, where)
    try:
        return section.model_validate(raw)
    except ValidationError as error:
        raise _refusal(section, error, where) from None


def read_settings_argument(section: type[_S], argument: str, *, where: str = "--settings") -> _S:
    """Read a section from the command line: a JSON object, or the path of a YAML file.

    Args:
        section: what to read.
        argument: what was given.
        where: the option it was given with.

    Raises:
        SettingsError: when it is neither, or its content does not fit `section`.
    """
    what, remedy = "settings cannot be read", "check the path and its syntax"
    allowed = "a JSON object or the path of a YAML file"
    if argument.lstrip().startswith("{"):
        try:
            raw = json.loads(argument)
        except (ValueError, RecursionError) as error:
            raise SettingsError(
                what, where=where, value=str(error), allowed=allowed, remedy=remedy
            ) from None
    else:
        where = argument
        raw = read_yaml(Path(where), SettingsError, what=what, allowed=allowed, remedy=remedy)
    return parse_section(section, raw, where=where)


def _refusal(section: type[BaseModel], error: ValidationError, where: str) -> SettingsError:
    """Turn one of pydantic's findings, an unknown key first, into one message of the project."""
    findings = error.errors()
    first = min(findings, key=lambda finding: finding["type"] != "extra_forbidden")
    kind, value = first["type"], first.get("input")
    *within, last = ("the whole", *map(str, first["loc"]))
    # Where a value may be of several types, pydantic puts the type it tried into the place; the
    # last part of an unknown key is the key as it was written.
    path = tuple(part for part in within[1:] if "[" not in part)
    if within and (kind == "extra_forbidden" or "[" not in last):
        path = (*path, last)
    key = ".".join(path) or "the whole"
    around = _section_at(section, path[:-1]).model_fields
    if kind == "extra_forbidden":
        places = [place for place in _places_of(section, last) if place != path]
        remedy = remedy_for(last, list(around), "remove it")
        if places:
            above = ".".join(places[0][:-1]) or "the top level"
            remedy = f"it belongs under {above}: {'.'.join(places[0])}"
        allowed = ", ".join(sorted(around))
        return SettingsError(f"unknown key {key}", where=where, allowed=allowed, remedy=remedy)
    if kind == "missing":
        field = around.get(last)
        allowed = (field and field.description) or "a value"
        return SettingsError(
            f"missing key {key}", where=where, allowed=allowed, remedy=f"set {key}"
        )
    of_text = any(each["type"] == "string_type" and each["input"] is value for each in findings)
    if (kind == "invalid_key" or of_text) and (surprise := _misread_by_yaml(value)):
        what, instead = surprise
        return SettingsError(
            f"key {key} does not fit: {what}",
            where=where,
            value=value if value is None or isinstance(value, int | float) else str(value),
            allowed="a text",
            remedy=f"write {instead}",
        )
    allowed = first["msg"]
    for own, plain in (("Value error, ", ""), ("Input should be ", ""), ("valid tuple", "list")):
        allowed = allowed.replace(own, plain)
    # For a value of several possible types, its meaning is more useful than the rule of one.
    if kind != "value_error" and len(path) < len(first["loc"]):
        fields = (
            _section_at(section, path[: end - 1]).model_fields.get(path[end - 1])
            for end in range(len(path), 0, -1)
        )
        field = next(filter(None, fields), None)
        allowed = (field and field.description) or allowed
    return SettingsError(
        f"key {key} does not fit",
        where=where,
        value=value,
        allowed=allowed,
        remedy=f"set {key} accordingly",
    )


def _refuse_bool_for_number(
    kind: Any, value: object, where: str, path: tuple[str, ...] = (), meaning: str | None = None
) -> None:
    """Refuse true and false for a number, which YAML makes of yes, on, no and off.

    Args:
        kind: the type of the value.
        value: what was given, with all that it holds.
        where: the file or option it came from, for the message.
        path: keys and places of the value in it.
        meaning: description of the key that holds the value.
    """
    kinds = list(_within(kind))
    if isinstance(value, bool):
        if bool not in kinds and (int in kinds or float in kinds):
            what, instead = _misread_by_yaml(value) or ("", "")
            raise SettingsError(
                f"key {'.'.join(path)} does not fit: {what}",
                where=where,
                value=value,
                allowed=meaning or "a number" + " or a text" * (str in kinds),
                remedy=f"write a number, or {instead}" if str in kinds else "write a number",
            )
    elif isinstance(value, list):
        for place, each in enumerate(value):
            _refuse_bool_for_number(kind, each, where, (*path, str(place)), meaning)
    elif isinstance(value, dict):
        for part in kinds:
            for key, of_key, meant in _kinds_of_values(part, value, meaning):
                _refuse_bool_for_number(of_key, value[key], where, (*path, str(key)), meant)


def _kinds_of_values(
    kind: Any, value: Mapping[Any, object], meaning: str | None
) -> Iterator[tuple[Any, Any, str | None]]:
    """Yield the keys of a section or a mapping, each with the type and the meaning of its value."""
    origin = get_origin(kind)
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        for name, field in kind.model_fields.items():
            if name in value:
                yield name, field.annotation, field.description
    elif isinstance(origin, type) and issubclass(origin, Mapping):
        for key in value:
            yield key, get_args(kind)[1], meaning


def _within(kind: Any) -> Iterator[Any]:
    """Yield a type and all that it is made of."""
    yield kind
    for part in get_args(kind):
        yield from _within(part)


def _misread_by_yaml(value: object) -> tuple[str, str] | None:
    """Say what YAML made of a text without quotes, and what to write instead."""
    if value is None:
        return "nothing is stated (null, ~ or nothing at all)", 'a text; "null", in quotes, is one'
    if isinstance(value, bool):
        words = ("yes", "on", "true") if value else ("no", "off", "false")
        read = f"YAML reads {', '.join(words)} without quotes as {str(value).lower()}"
        return read, f'it in quotes, as "{words[0]}" or "{words[1]}"'
    kind = "number" if isinstance(value, int | float) else "date"
    if isinstance(value, int | float | date):
        # `value` is no guide: YAML makes 20240115 of 2024_01_15, and 750 of 12:30.
        read = f"YAML reads it as a {kind} where it has no quotes"
        return read, "it in quotes, just as it stands in the file"
    return None


def _places_of(
    section: type[BaseModel], key: str, above: tuple[str, ...] = ()
) -> Iterator[tuple[str, ...]]:
    """Yield where a section has a key of this name, in itself or in the sections below it."""
    if key in section.model_fields:
        yield (*above, key)
    for name, field in section.model_fields.items():
        for inner in _sections_in(field.annotation):
            if get_origin(field.annotation) in (None, UnionType, Union):
                yield from _places_of(inner, key, (*above, name))


def _section_at(section: type[BaseModel], path: tuple[str, ...]) -> type[BaseModel]:
    """Return the section at `path`, or the one that holds it."""
    current = section
    for part in path:
        field = current.model_fields.get(part)
        if field is not None:  # else the key of a mapping or the place in a list
            current = next(_sections_in(field.annotation), current)
    return current


def _sections_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the sections that a value of this type may be or hold."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _sections_in(inner)
