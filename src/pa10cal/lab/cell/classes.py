"""The classes of a kind that the modules of a folder hold, by their id.

It stands beside these folders, for what looks through folders needs all modules beside it
(`planning.code`).
"""

from __future__ import annotations

import pkgutil
from importlib import import_module
from types import ModuleType
from typing import Any


def classes_in(package: ModuleType, kind: Any, key: str = "id") -> dict[str, Any]:
    """Return every class of a kind that has an id of its own, or another key.

    They come module by module by name, each in the order of its file: random draws go by it.
    """
    found = {}
    for name in sorted(module.name for module in pkgutil.iter_modules(package.__path__)):
        module = import_module(f"{package.__name__}.{name}")
        for each in vars(module).values():
            if (
                isinstance(each, type)
                and issubclass(each, kind)
                and each.__module__ == module.__name__
                and key in vars(each)
            ):
                found[vars(each)[key]] = each
    return found
