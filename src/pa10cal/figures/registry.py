"""Pictures and tables find themselves: every module of a folder of this package is one of them.

A module states what it is in `PICTURE` and holds one function: `draw` returns a figure,
`tabulate` a table, `film` writes a film. Its name is that of the files written.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType
from typing import Literal

import pa10cal.figures

Kind = Literal["figure", "table", "film"]

#: Folders of this package that hold pictures, by what the pictures are of.
FOLDERS = ("campaign", "trials", "wild", "curve", "chain")
_FUNCTIONS: dict[str, Kind] = {"draw": "figure", "tabulate": "table", "film": "film"}


@dataclass(frozen=True)
class Picture:
    """What a picture or table is."""

    title: str  # what the report calls it
    # what it is drawn from, in the names of the results it belongs to; a picture is left out where
    # one of them is not there
    needs: tuple[str, ...]
    # reStructuredText below it in the report; `{name}` stands for the campaign or study
    caption: str


@dataclass(frozen=True)
class Entry:
    """A picture with its module."""

    name: str  # of the module and of the files
    kind: Kind  # what it makes
    picture: Picture  # as its module states it
    module: ModuleType  # holds the function that makes it


class NothingToShowError(Exception):
    """Results are all there, and hold nothing that a picture could show; says why."""


@cache
def entries(folder: str) -> dict[str, Entry]:
    """Return the pictures and tables of a folder by name, in alphabetical order."""
    return {entry.name: entry for entry in _found(folder)}


def _found(folder: str) -> Iterator[Entry]:
    package = import_module(f"{pa10cal.figures.__name__}.{folder}")
    for info in iter_modules(package.__path__):
        module = import_module(f"{package.__name__}.{info.name}")
        kinds = [kind for name, kind in _FUNCTIONS.items() if hasattr(module, name)]
        if len(kinds) != 1 or not isinstance(getattr(module, "PICTURE", None), Picture):
            raise TypeError(
                f"{module.__name__} must state PICTURE and hold one of {', '.join(_FUNCTIONS)}"
            )
        yield Entry(info.name, kinds[0], module.PICTURE, module)
