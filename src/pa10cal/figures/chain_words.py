"""How pictures of chains along curves call models and departures."""

from __future__ import annotations

#: Models as pictures call them.
MODELS = {
    "two_level": "two-level (paper)",
    "two_level_all": "two-level, all poses inside",
    "general": "general",
}
#: How individuals depart, in short.
DEPARTS = {"rows": "by its rows", "any_way": "in any way"}
