"""Pictures and tables find themselves: every function of some modules that says what it shows.

`@picture` says it; the function's name says what it makes and what the files are called:
`draw_where_joints` returns the figure `where_joints`, `tabulate_` a table, `film_` writes a film.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from typing import Any, Literal, TypeVar

import pa10cal.figures

Kind = Literal["figure", "table", "film"]
F = TypeVar("F", bound=Callable[..., Any])

#: Modules of pictures in packages beside this one, which import it, by what the pictures are of.
ELSEWHERE = {
    "trials": "pa10cal_lab.pictures",
    "curve": "pa10cal_curve.pictures",
    "chain": "pa10cal_curve.study_pictures",
}
#: What pictures are of: those of a campaign stand in a package here.
FOLDERS = ("campaign", *ELSEWHERE)
_KINDS: dict[str, Kind] = {"draw": "figure", "tabulate": "table", "film": "film"}

_COMBINED, _VERDICT = "calibration/combined.json", "discovery/verdict.json"
#: Results of a campaign by the names that pictures need them by: the file that has to be there,
#: then what else is read with it. The verdict says whether effects were sought, the calibration
#: whether it converged.
NEEDS: dict[str, tuple[str, ...]] = {
    "papers_calibration": (_COMBINED,),
    "general": (_COMBINED,),
    "poses": ("ingest/poses.parquet",),
    "base_frame": ("seed/base_frame.json",),
    "planes": ("montecarlo",),
    "evaluation": ("evaluation/holdout.json", _COMBINED, _VERDICT),
    "held_out": ("evaluation/holdout.json", _COMBINED, _VERDICT),
    "analysis": ("discovery/analysis.json", _COMBINED, _VERDICT),
    "verdict": (_VERDICT, _COMBINED),
}


@dataclass(frozen=True)
class Picture:
    """A picture or table: what the report says of it, and the function that makes it."""

    name: str  # of the files
    kind: Kind  # what it makes
    title: str  # what pages call it
    # what it is drawn from, of `NEEDS`; a picture is left out where one of them is not there
    needs: tuple[str, ...]
    caption: str  # plain text that pages show below it; `{name}` stands for the campaign or study
    section: str  # of a campaign's page that shows it
    make: Callable[..., Any]


class NothingToShowError(Exception):
    """Results are all there, and hold nothing that a picture could show; says why."""


def picture(
    *, title: str, needs: tuple[str, ...], caption: str, section: str = ""
) -> Callable[[F], F]:
    """Say of a function what it shows; see `Picture`.

    Raises:
        TypeError: when its name does not say what it makes.
    """

    def mark(function: F) -> F:
        kind, _, name = function.__name__.partition("_")
        if kind not in _KINDS:
            raise TypeError(f"{function.__name__} must begin with {', '.join(_KINDS)}")
        text = " ".join(re.sub(r"``|\*", "", caption).split())
        function.__dict__["picture"] = Picture(
            name, _KINDS[kind], title, needs, text, section, function
        )
        return function

    return mark


@cache
def entries(folder: str) -> dict[str, Picture]:
    """Return the pictures and tables of one of `FOLDERS` by name, in alphabetical order."""
    package = import_module(ELSEWHERE.get(folder, f"{pa10cal.figures.__name__}.{folder}"))
    within = [info.name for info in iter_modules(getattr(package, "__path__", ()))]
    found = {
        function.picture.name: function.picture
        for module in (package, *(import_module(f"{package.__name__}.{name}") for name in within))
        for function in vars(module).values()
        if isinstance(getattr(function, "picture", None), Picture)
        and function.__module__ == module.__name__
    }
    return dict(sorted(found.items()))
