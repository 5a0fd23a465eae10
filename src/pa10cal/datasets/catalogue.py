"""The data sets that can be imported, found by looking through the folder of readers."""

from __future__ import annotations

import difflib
import pkgutil
from importlib import import_module
from typing import TYPE_CHECKING

from pa10cal.datasets import readers
from pa10cal.errors import RawDataError

if TYPE_CHECKING:  # a list of names needs no pandas
    from pa10cal.datasets.dataset import DataSet


def dataset_names() -> tuple[str, ...]:
    """Return the names of all data sets: those of the readers' modules, with hyphens."""
    modules = pkgutil.iter_modules(readers.__path__)
    return tuple(sorted(module.name.replace("_", "-") for module in modules))


def dataset_named(name: str) -> DataSet:
    """Return the data set of that name.

    Raises:
        RawDataError: when there is none, naming those that there are.
    """
    known = dataset_names()
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
        raise RawDataError(
            "there is no reader of this data set",
            where="data set",
            value=name,
            allowed=", ".join(known),
            remedy=f"is {near[0]!r} meant?"
            if near
            else "correct the name, or write a reader in "
            "pa10cal/datasets/readers (docs/datasets.md)",
        )
    module = import_module(f"{readers.__name__}.{name.replace('-', '_')}")
    dataset: DataSet = module.DATASET
    return dataset
