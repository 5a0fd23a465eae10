"""Array types, homogeneous transforms, size and scatter of values, and choices of rows."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.intp]
Rows = Index | Mask | slice
Record = TypeVar("Record")

#: Factor from the median absolute normal error to its standard deviation, 1 / Φ⁻¹(3/4).
MEDIAN_TO_SIGMA = 1.4826


def homogeneous(R: Array, p: Array) -> Array:
    """Return the transforms (..., 4, 4) of rotations (..., 3, 3) and positions (..., 3)."""
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], p.shape[:-1]), 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, p, 1.0
    return T


def nearest_rotation(matrix: Array) -> Array:
    """Return the proper rotations (..., 3, 3) nearest to matrices in the Frobenius norm."""
    U, _, Vt = np.linalg.svd(matrix)
    U[..., 2] *= np.linalg.det(U @ Vt)[..., None]
    return np.asarray(U @ Vt)


def spread(count: int, most: int) -> Index:
    """Return at most `most` of `count` row numbers, evenly spread, rising.

    For rows in an order that has to be covered, such as that of time; else see `drawn`.
    """
    return np.linspace(0, count - 1, min(count, most)).astype(np.intp)


def drawn(count: int, most: int) -> Index:
    """Return at most `most` of `count` row numbers, drawn with a fixed seed, rising.

    For a fit or a scatter: rows may alternate between two kinds of pose, and every n-th would then
    be of one kind.
    """
    return np.sort(np.random.default_rng(0).permutation(count)[:most])


def rms(values: Array) -> float:
    """Return the root mean square of values of any shape."""
    return float(np.sqrt(np.mean(values**2)))


def standard_error_of_sum(values: Array) -> float:
    """Return the standard error of the sum of independent values (N,), by their scatter."""
    return float(np.sqrt(len(values)) * values.std(ddof=1))


def take_rows(record: Record, rows: Rows, *of_all: str) -> Record:
    """Return the record with only these rows of every per-pose field.

    Args:
        record: a dataclass. A field is an array of one entry a pose, a record of such arrays, an
            object with a method `take(rows)`, or None, which stays None.
        of_all: names of fields that belong to all poses together and stay as they are. Every
            field that is a number or a text must be among them. They are not passed on to
            records within.

    Raises:
        TypeError: when a field is none of these.
    """
    known: Any = record
    chosen = {}
    for field in fields(known):
        value = getattr(known, field.name)
        if value is None or field.name in of_all:
            continue
        if not _has_rows(value):
            raise TypeError(
                f"{field.name} of {type(record).__name__} has no rows: name it in `of_all`"
            )
        if isinstance(value, np.ndarray):
            chosen[field.name] = value[rows]
        elif hasattr(value, "take"):
            chosen[field.name] = value.take(rows)
        else:
            chosen[field.name] = take_rows(value, rows)
    result: Record = replace(known, **chosen)
    return result


def _has_rows(value: object) -> bool:
    """Return whether a value of a field has an entry a pose; numbers and texts have not."""
    if isinstance(value, np.ndarray | np.generic):
        return value.ndim > 0
    return hasattr(value, "take") or is_dataclass(value)
