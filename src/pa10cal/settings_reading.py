"""Reading a section of the settings, and messages for one that does not fit."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from datetime import date
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

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
        raise _refusal(section, raw, error, where) from None


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
            raw = json.loads(argument, object_pairs_hook=_with_each_key_once)
        except (ValueError, RecursionError) as error:
            raise SettingsError(
                what, where=where, value=str(error), allowed=allowed, remedy=remedy
            ) from None
    else:
        where = argument
        raw = read_yaml(Path(where), SettingsError, what=what, allowed=allowed, remedy=remedy)
    return parse_section(section, raw, where=where)


def _with_each_key_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return a JSON object; refuse a key that stands there twice, of which one would be dropped.

    Raises:
        ValueError: naming the key.
    """
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(f"the key {key} stands there twice: remove one")
        found[key] = value
    return found


# Messages for what pydantic refuses. The first finding is told, an unknown key before others.


def _refusal(
    section: type[BaseModel], raw: object, error: ValidationError, where: str
) -> SettingsError:
    """Turn what pydantic found into one message of the project."""
    findings = error.errors()
    first = min(findings, key=lambda finding: finding["type"] != "extra_forbidden")
    path, kind, value = _path_of(section, raw, first["loc"]), first["type"], first.get("input")
    if kind == "extra_forbidden":
        return _unknown_key(section, path, where)
    if kind.startswith("union_tag"):
        return _not_one_of(path, first, where)
    if kind == "missing" and path and path[-1].isdigit():
        return _too_few(section, path, findings, where)
    if kind == "missing":
        return _missing_key(section, path, where)
    if kind == "model_type" and value is None:
        return _empty_section(section, path, where)
    wants_text = kind == "invalid_key" or any(
        each["type"] == "string_type" and _path_of(section, raw, each["loc"]) == path
        for each in findings
    )
    if wants_text and (misread := _misread_by_yaml(value)):
        return _no_text(path, value, misread, where)
    # A value of many types has a finding for each of them.
    places = [_path_of(section, raw, each["loc"]) for each in findings if each is not first]
    many = any(place and place[: len(path)] == path[: len(place)] for place in places)
    return _misfit(section, path, first, where, many=many)


def _path_of(section: type[BaseModel], raw: object, loc: tuple[int | str, ...]) -> tuple[str, ...]:
    """Return the keys and places in lists that lead to a finding.

    Pydantic also puts there which of several types it tried: that is left out, as it neither stands
    in what was given nor is a key of a section.
    """
    path: tuple[str, ...] = ()
    within: Any = raw
    for part in loc:
        inside: dict[str, Any] = {}
        if isinstance(within, dict):
            inside = {str(key): value for key, value in within.items()}
        elif isinstance(within, list | tuple):
            inside = {str(place): value for place, value in enumerate(within)}
        name, in_list = str(part), isinstance(part, int) and isinstance(within, list | tuple)
        if in_list or name in inside or name in _section_at(section, path).model_fields:
            path, within = (*path, name), inside.get(name)
    return path


def _key(path: tuple[str, ...]) -> str:
    """Return a key in words, with those above it."""
    return ".".join(path) or "the whole"


def _unknown_key(section: type[BaseModel], path: tuple[str, ...], where: str) -> SettingsError:
    """Say which keys there are in its place, and the nearest, or where there is one of its name."""
    around = _section_at(section, path[:-1]).model_fields
    remedy = remedy_for(path[-1], list(around), "")
    elsewhere = [place for place in _places_of(section, path[-1]) if place != path[: len(place)]]
    if not remedy and elsewhere:
        place = elsewhere[0]
        remedy = f"it belongs under {'.'.join(place[:-1]) or 'the top level'}: {'.'.join(place)}"
    return SettingsError(
        f"unknown key {_key(path)}",
        where=where,
        allowed=", ".join(sorted(around)),
        remedy=remedy or "remove it",
    )


def _missing_key(section: type[BaseModel], path: tuple[str, ...], where: str) -> SettingsError:
    """Say what the key means."""
    field = _section_at(section, path[:-1]).model_fields.get(path[-1])
    return SettingsError(
        f"missing key {_key(path)}",
        where=where,
        allowed=(field and field.description) or "a value",
        remedy=f"set {_key(path)}",
    )


def _too_few(
    section: type[BaseModel], path: tuple[str, ...], findings: list[ErrorDetails], where: str
) -> SettingsError:
    """Say how many values a list should have whose last ones are missing, from `path` on."""
    of_list = path[:-1]
    count = 1 + max(
        int(each["loc"][-1])
        for each in findings
        if each["type"] == "missing" and str(each["loc"][-1]).isdigit()
    )
    meaning = _meaning_of(section, of_list)
    return SettingsError(
        f"key {_key(of_list)} does not fit",
        where=where,
        value=f"{path[-1]} values",
        allowed=f"{count} values: {meaning}" if meaning else f"{count} values",
        remedy=f"give all {count}",
    )


def _not_one_of(path: tuple[str, ...], finding: ErrorDetails, where: str) -> SettingsError:
    """Say which words the key may have that decides what other keys there are."""
    stated = finding.get("ctx", {})
    key = _key((*path, stated["discriminator"].strip("'")))
    if "tag" not in stated:
        return SettingsError(
            f"missing key {key}", where=where, allowed="a word", remedy=f"set {key}"
        )
    words, tag = stated["expected_tags"], str(stated["tag"])
    return SettingsError(
        f"key {key} does not fit",
        where=where,
        value=tag,
        allowed=words,
        remedy=remedy_for(tag, words.replace("'", "").split(", "), f"set {key} accordingly"),
    )


def _empty_section(section: type[BaseModel], path: tuple[str, ...], where: str) -> SettingsError:
    """Say which keys there are."""
    return SettingsError(
        f"key {_key(path)} does not fit: nothing is stated under it",
        where=where,
        allowed=", ".join(sorted(_section_at(section, path).model_fields)),
        remedy="write its keys below it, indented, or remove it" if path else "write its keys",
    )


def _no_text(
    path: tuple[str, ...], value: object, misread: tuple[str, str], where: str
) -> SettingsError:
    """Say what YAML made of a text, and how to write it."""
    what, instead = misread
    return SettingsError(
        f"key {_key(path)} does not fit: {what}",
        where=where,
        value=value if value is None or isinstance(value, int | float) else str(value),
        allowed="a text",
        remedy=f"write {instead}",
    )


def _misfit(
    section: type[BaseModel],
    path: tuple[str, ...],
    finding: ErrorDetails,
    where: str,
    *,
    many: bool,
) -> SettingsError:
    """Say what a value should be: by its rule, or by its meaning where it may be of many types."""
    allowed = finding["msg"]
    for own, plain in (("Value error, ", ""), ("Input should be ", ""), ("valid tuple", "list")):
        allowed = allowed.replace(own, plain)
    if finding["type"] != "value_error" and many:
        allowed = _meaning_of(section, path) or allowed
    return SettingsError(
        f"key {_key(path)} does not fit",
        where=where,
        value=finding.get("input"),
        allowed=allowed,
        remedy=f"set {_key(path)} accordingly",
    )


def _meaning_of(section: type[BaseModel], path: tuple[str, ...]) -> str | None:
    """Return the description of the innermost key of a section that leads to a value."""
    for end in range(len(path), 0, -1):
        field = _section_at(section, path[: end - 1]).model_fields.get(path[end - 1])
        if field is not None:
            return field.description
    return None


# What YAML makes of words without quotes.


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
    kinds = list(_types_in(kind))
    if isinstance(value, bool):
        if bool not in kinds and (int in kinds or float in kinds):
            what, instead = _misread_by_yaml(value) or ("", "")
            raise SettingsError(
                f"key {_key(path)} does not fit: {what}",
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


def _types_in(kind: Any) -> Iterator[Any]:
    """Yield a type and all that it is made of."""
    yield kind
    for part in get_args(kind):
        yield from _types_in(part)


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


# Where keys stand in sections.


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
