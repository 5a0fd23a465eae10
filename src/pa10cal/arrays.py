"""Arrays by what they hold."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.intp]


def homogeneous(R: Array, p: Array) -> Array:
    """Return the poses (..., 4, 4) of rotations (..., 3, 3) and places (..., 3)."""
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], p.shape[:-1]), 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, p, 1.0
    return T


def nearest_rotation(matrix: Array) -> Array:
    """Return the proper rotations (..., 3, 3) nearest to matrices."""
    U, _, Vt = np.linalg.svd(matrix)
    U[..., 2] *= np.linalg.det(U @ Vt)[..., None]
    return np.asarray(U @ Vt)


def spread(count: int, most: int) -> Index:
    """Return so many of `count` rows at most, spread over all of them."""
    return np.linspace(0, count - 1, min(count, most)).astype(np.intp)


def drawn(count: int, most: int) -> Index:
    """Return so many of `count` rows at most, drawn at random, the same each time, rising.

    Not every n-th: rows may alternate.
    """
    return np.sort(np.random.default_rng(0).permutation(count)[:most])


Rows = Index | Mask | slice
R = TypeVar("R")

#: Median of the size of a normal error to its standard deviation, 1 / Φ⁻¹(3/4).
MEDIAN_TO_SIGMA = 1.4826


def taken(record: R, rows: Rows, *of_all: str) -> R:
    """Return a record of what has one entry a pose, with some of the poses.

    Args:
        record: a dataclass of arrays, of records of such, or of what can `take` rows itself.
        of_all: names of fields that belong to all poses together, and stay.
    """
    known: Any = record
    some = {}
    for field in fields(known):
        value = getattr(known, field.name)
        if value is None or field.name in of_all:
            continue
        if isinstance(value, np.ndarray):
            some[field.name] = value[rows]
        else:
            some[field.name] = value.take(rows) if hasattr(value, "take") else taken(value, rows)
    whole: R = replace(known, **some)
    return whole
