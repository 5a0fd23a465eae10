"""Arrays as fields of records: nested lists in the file, read-only numpy arrays in memory.

A field states its array as `Annotated[NDArray[np.float64], Shape("poses", 3)]`; the arrays that
many records have are named at the end.
"""

from __future__ import annotations

from functools import partial
from itertools import chain
from typing import Annotated, Any, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

#: Entries of an array in the words of a refusal, by numpy's letter for its kind of type.
_ENTRIES = {"f": "finite numbers", "i": "whole numbers", "b": "true or false", "U": "texts"}
#: Kinds of type that are converted to a kind: whole numbers are numbers, too.
_CONVERTED = {"f": "fiu", "i": "iu", "b": "b", "U": "U"}
#: Most characters of an array of texts in memory (computing).
_MOST_CHARACTERS = 50_000_000


class Shape:
    """The shape of an array, as an annotation by which pydantic reads, checks and writes it.

    Attributes:
        sizes: of each axis; a number is the size itself, a name stands for any size.
        missing: whether an entry of the first axis may be unknown: null in the file, nan in memory.
    """

    def __init__(self, *sizes: int | str, missing: bool = False) -> None:
        self.sizes = sizes
        self.missing = missing

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Return how pydantic validates and writes a field of type `source`, `NDArray[...]`."""
        del handler
        dtype = entry_dtype(source)
        return core_schema.no_info_plain_validator_function(
            partial(self._validated, dtype),
            serialization=core_schema.plain_serializer_function_ser_schema(self._as_lists),
            metadata={"shape": self, "kind": dtype.kind},  # for the JSON schema in the docs
        )

    def _validated(self, dtype: np.dtype[Any], value: Any) -> NDArray[Any]:
        """Return a read-only copy of nested lists or of an array; refuse others."""
        if _is_too_long(value):
            raise PydanticCustomError("array", "texts of usual lengths")
        try:
            array = np.array(self._without_nulls(value))
        except (TypeError, ValueError):  # lists of several lengths, or no lists at all
            array = np.array(object())  # has no axis, and is refused below
        any_size = [None if isinstance(size, str) else size for size in self.sizes]
        if not array.size and None in any_size and array.ndim <= len(any_size):
            # An empty list does not show the sizes of the axes within it, nor its type.
            array = np.zeros([size or 0 for size in any_size], dtype=dtype)
        if not self._is_of_shape(array) or not self._has_entries_of(dtype, array):
            raise PydanticCustomError("array", "{said}", {"said": self._description(dtype)})
        array = array.astype(dtype)
        array.setflags(write=False)
        return array

    def _without_nulls(self, value: Any) -> Any:
        """Return nested lists in which entries that may be unknown, and are, are nan."""
        if not self.missing or not isinstance(value, list | tuple):
            return value
        unknown = np.full([size for size in self.sizes[1:] if isinstance(size, int)], np.nan)
        return [unknown if entry is None else entry for entry in value]

    def _is_of_shape(self, array: NDArray[Any]) -> bool:
        return array.ndim == len(self.sizes) and all(
            isinstance(stated, str) or stated == size
            for stated, size in zip(self.sizes, array.shape, strict=True)
        )

    def _has_entries_of(self, dtype: np.dtype[Any], array: NDArray[Any]) -> bool:
        if array.dtype.kind not in _CONVERTED[dtype.kind]:
            return False
        return dtype.kind != "f" or self.missing or bool(np.isfinite(array).all())

    def _description(self, dtype: np.dtype[Any]) -> str:
        """Return what is allowed, in words: `finite numbers, shape (poses, 3)`."""
        comma = "," if len(self.sizes) == 1 else ""
        shape = f"({', '.join(map(str, self.sizes))}{comma})"
        unknown = ", null where unknown" if self.missing else ""
        return f"{_ENTRIES[dtype.kind]}, shape {shape}{unknown}"

    def _as_lists(self, array: NDArray[Any]) -> Any:
        """Return an array as nested lists, None where an entry of the first axis is unknown."""
        entries = array.tolist()
        if not self.missing:
            return entries
        known = np.isfinite(array).reshape(len(array), -1).all(axis=1)
        return [entry if is_known else None for entry, is_known in zip(entries, known, strict=True)]


def _is_too_long(value: Any) -> bool:
    """Return whether texts in nested lists take too much memory as an array.

    In an array each text takes the room of the longest, so one long text among many is enough.
    """
    if type(value) is not list:
        return False
    types = set(map(type, value))
    while types == {list}:
        value = list(chain.from_iterable(value))
        types = set(map(type, value))
    longest = max((len(entry) for entry in value if type(entry) is str), default=0)
    return longest * len(value) > _MOST_CHARACTERS


def entry_dtype(annotation: Any) -> np.dtype[Any]:
    """Return the type of the entries of `NDArray[...]`.

    Its last argument is the type itself from numpy 2.5 on, and `dtype[type]` before.
    """
    last = get_args(annotation)[-1]
    entries: np.dtype[Any] = np.dtype(next(iter(get_args(last)), last))
    return entries


Vector3 = Annotated[NDArray[np.float64], Shape(3)]
Matrix3 = Annotated[NDArray[np.float64], Shape(3, 3)]
PoseMatrix = Annotated[NDArray[np.float64], Shape(4, 4)]
Numbers = Annotated[NDArray[np.float64], Shape("k")]
#: Columns of a table, and columns of which some entries are not known.
Column = Annotated[NDArray[np.float64], Shape("rows")]
GappyColumn = Annotated[NDArray[np.float64], Shape("rows", missing=True)]
VectorColumn = Annotated[NDArray[np.float64], Shape("rows", 3)]
LabelColumn = Annotated[NDArray[np.str_], Shape("rows")]
CountColumn = Annotated[NDArray[np.int64], Shape("rows")]
FlagColumn = Annotated[NDArray[np.bool_], Shape("rows")]
