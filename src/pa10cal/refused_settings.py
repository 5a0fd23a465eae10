"""What a user is told of settings that do not fit: the key, and the nearest right one."""

from __future__ import annotations

import difflib
from typing import Any

from pydantic import BaseModel, ValidationError

from pa10cal.errors import SettingsError


def refusal(section: type[BaseModel], error: ValidationError, where: str) -> SettingsError:
    """Turn one of pydantic's findings, an unknown key first, into one message of the project.

    Args:
        section: what was to be read.
        error: what pydantic found.
        where: the file or option it came from.
    """
    first = min(error.errors(), key=lambda finding: finding["type"] != "extra_forbidden")
    location = tuple(str(part) for part in first["loc"])
    key = ".".join(location) or "the whole"
    if first["type"] == "extra_forbidden":
        known = _known_keys(section, location[:-1])
        near = difflib.get_close_matches(location[-1], known, n=1, cutoff=0.0)
        return SettingsError(
            f"unknown key {key}",
            where=where,
            allowed=", ".join(sorted(known)),
            remedy=f"did you mean {near[0]!r}?" if near else "remove it",
        )
    if first["type"] == "missing":
        return SettingsError(
            f"missing key {key}", where=where, allowed="a value", remedy=f"set {key}"
        )
    return SettingsError(
        f"key {key} does not fit",
        where=where,
        value=first.get("input"),
        allowed=first["msg"].removeprefix("Value error, "),
        remedy=f"set {key} accordingly",
    )


def _known_keys(section: type[BaseModel], path: tuple[str, ...]) -> list[str]:
    """Return the field names of the (sub)section at `path`."""
    current: Any = section
    for part in path:
        field = current.model_fields.get(part)
        if field is None:  # the key of a mapping, such as a campaign's name
            continue
        annotation = field.annotation
        current = next(
            (
                kind
                for kind in (annotation, *getattr(annotation, "__args__", ()))
                if isinstance(kind, type) and issubclass(kind, BaseModel)
            ),
            current,
        )
    return list(current.model_fields)
