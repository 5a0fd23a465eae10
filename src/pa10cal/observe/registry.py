"""Kinds of instruments by their word: every class of this package that names one."""

from __future__ import annotations

import inspect
import pkgutil
from functools import cache
from importlib import import_module

import pa10cal.observe
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.joined import Joined


@cache
def instruments() -> dict[str, type[Instrument]]:
    """Return the class of every kind of instrument, by the word of `instrument.kind`."""
    found = {}
    for entry in pkgutil.iter_modules(pa10cal.observe.__path__):
        module = import_module(f"pa10cal.observe.{entry.name}")
        for _, each in inspect.getmembers(module, inspect.isclass):
            if issubclass(each, Instrument) and not inspect.isabstract(each) and each.kind:
                found[each.kind] = each
    return dict(sorted(found.items()))


def instrument_of(words: str) -> type[Instrument] | None:
    """Return the class of a kind, or of the several of a group; None where a word is not known.

    Args:
        words: as `instrument_kinds` of a campaign's description gives them.
    """
    kinds = words.split(" and ")
    if not set(kinds) <= set(instruments()):
        return None
    return instruments()[words] if len(kinds) == 1 else Joined
