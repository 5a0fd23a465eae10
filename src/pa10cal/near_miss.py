"""The word that was probably meant, where one of those known is near enough to say so."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

#: Part of the letters in common from which a known word counts as meant.
LIKENESS = 0.6


def remedy_for(word: str, known: Iterable[str], otherwise: str) -> str:
    """Return a remedy for an unknown word: the nearest known one, or else what to do instead.

    Args:
        word: what was written.
        known: what could have been meant.
        otherwise: the remedy where none of them is near.
    """
    near = difflib.get_close_matches(word, list(known), n=1, cutoff=LIKENESS)
    return f"did you mean {near[0]!r}?" if near else otherwise
