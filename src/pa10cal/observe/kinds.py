"""Kinds of instruments by the word of `instrument.kind`, found in this package, as settings."""

from __future__ import annotations

import inspect
import pkgutil
from functools import cache, partial
from importlib import import_module
from typing import TYPE_CHECKING, Annotated

from pydantic import AfterValidator

if TYPE_CHECKING:
    from pa10cal.observe.instrument import Instrument


@cache
def instruments() -> dict[str, type[Instrument]]:
    """Return the class of every kind of instrument, by the word of `instrument.kind`."""
    import pa10cal.observe
    from pa10cal.observe.instrument import Instrument  # late: it brings numpy and scipy

    kinds = {}
    for entry in pkgutil.iter_modules(pa10cal.observe.__path__):
        module = import_module(f"pa10cal.observe.{entry.name}")
        for _, each in inspect.getmembers(module, inspect.isclass):
            if issubclass(each, Instrument) and not inspect.isabstract(each) and each.kind:
                kinds[each.kind] = each
    return dict(sorted(kinds.items()))


def instrument_of(words: str) -> type[Instrument] | None:
    """Return the class of a kind, or of the several of a group; None where a word is not known.

    Args:
        words: as `instrument_kinds` of a campaign's description gives them.
    """
    from pa10cal.observe.joined import Joined

    kinds = words.split(" and ")
    if not set(kinds) <= set(instruments()):
        return None
    return instruments()[words] if len(kinds) == 1 else Joined


def _known(word: str, *, touches: bool = True) -> str:
    """Return a known kind, with `touches=False` not one of touches; refuse others (ValueError)."""
    words = [kind for kind, of_kind in instruments().items() if touches or not of_kind.from_touches]
    if word not in words:
        raise ValueError(f"should be one of {', '.join(words)}")
    return word


def sees_several(kind: str) -> bool:
    """Return whether an instrument measures several targets on the end-effector."""
    return instruments()[kind].several_targets


#: A kind of instrument, and one that gives its measurements in `files.poses`.
InstrumentKind = Annotated[str, AfterValidator(_known)]
TrackerKind = Annotated[str, AfterValidator(partial(_known, touches=False))]
