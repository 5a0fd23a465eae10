"""The settings of a run, as Snakemake puts them together: files, the later over the earlier."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pa10cal.errors import SettingsError
from pa10cal.settings import Settings, parse_settings
from pa10cal.yaml_file import read_yaml


def settings_of(files: list[Path], over: Mapping[str, Any], where: str) -> Settings:
    """Return the settings of files, with some more over them.

    Args:
        files: YAML files, the later over the earlier.
        over: what goes over all of them.
        where: what a message is to name.

    Raises:
        SettingsError: when a file cannot be read, or a setting does not fit.
    """
    content: dict[str, Any] = {}
    for file in files:
        found = read_yaml(file, SettingsError, what="the settings cannot be read") or {}
        if not isinstance(found, dict):
            raise SettingsError(
                "the settings cannot be read",
                where=str(file),
                value=f"a file of {type(found).__name__}",
                allowed="keys and values, as in config.yaml",
                remedy="check the path and its syntax",
            )
        content = _merged(content, found)
    return parse_settings(_merged(content, over), where=where)


def _merged(content: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Return a mapping with another over it, key by key at every depth."""
    both = dict(content)
    for key, value in over.items():
        inner = both.get(key)
        if isinstance(inner, dict) and isinstance(value, dict):
            value = _merged(inner, value)
        both[key] = value
    return both
