"""Kinds of instruments by their word: every class of this package that names one."""

from __future__ import annotations

import inspect
import pkgutil
from functools import cache
from importlib import import_module

import pa10cal.observe
from pa10cal.observe.instrument import Instrument


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
