"""The word that was probably meant, where one of those known is near enough to say so."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

#: Part of the letters in common from which a known word counts as meant.
LIKENESS = 0.65


def remedy_for(word: str, known: Iterable[str], otherwise: str) -> str:
    """Return a remedy for an unknown word: the nearest known one, or else what to do instead.

    One of the words that a known name is made of is near it too.

    Args:
        word: what was written.
        known: what could have been meant.
        otherwise: the remedy where none of them is near.
    """
    names = list(known)
    near = difflib.get_close_matches(word, names, n=1, cutoff=LIKENESS)
    near = near or [name for name in names if word in name.split("_")]
    return f"did you mean {near[0]!r}?" if near else otherwise
