"""Arrays in records: nested lists in the file, numpy arrays in memory."""

from __future__ import annotations

from functools import partial
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

_WORDS = {"f": "finite numbers", "i": "whole numbers", "b": "true or false", "U": "texts"}
_JSON_TYPES = {"f": "number", "i": "integer", "b": "boolean", "U": "string"}
#: Kinds of array that are taken for one of a kind: whole numbers for numbers, nothing for texts.
_TAKEN = {"f": "fiu", "i": "iu", "b": "b", "U": "U"}


class Shape:
    """Makes `Annotated[NDArray[...], Shape("poses", 3)]` a list in the file and an array in memory.

    Arrays come out of a record read-only.

    Attributes:
        sizes: a number is the size there, a name stands for any.
        missing: whether an entry of the first axis may be unknown: null in the file, nan in memory.
    """

    def __init__(self, *sizes: int | str, missing: bool = False) -> None:
        self.sizes = sizes
        self.missing = missing

    def __str__(self) -> str:
        return f"({', '.join(map(str, self.sizes))}{',' if len(self.sizes) == 1 else ''})"

    def said(self, kind: str) -> str:
        """Return in words what is allowed of an array of a kind of numpy's."""
        unknown = ", null where unknown" if self.missing else ""
        return f"{_WORDS[kind]}, shape {self}{unknown}"

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Check on the way in, write nested lists on the way out."""
        del handler
        dtype: np.dtype[Any] = np.dtype(get_args(get_args(source)[1])[0])
        return core_schema.no_info_plain_validator_function(
            partial(self._checked, dtype),
            serialization=core_schema.plain_serializer_function_ser_schema(self._plain),
            metadata={"kind": dtype.kind},
        )

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Describe it as nested lists."""
        del handler
        found: JsonSchemaValue = {"type": _JSON_TYPES[schema["metadata"]["kind"]]}
        for size in reversed(self.sizes[1:]):
            found = _list_of(found, size)
        if self.missing:
            found = {"anyOf": [found, {"type": "null"}]}
        return _list_of(found, self.sizes[0])

    def _checked(self, dtype: np.dtype[Any], value: Any) -> NDArray[Any]:
        found = self._array(dtype, value)
        wanted = [size if isinstance(size, int) else None for size in self.sizes]
        if found is None or not (
            found.ndim == len(wanted)
            and all(want in (None, size) for want, size in zip(wanted, found.shape, strict=True))
            and (dtype.kind != "f" or self.missing or bool(np.isfinite(found).all()))
        ):
            raise PydanticCustomError("array", "{said}", {"said": self.said(dtype.kind)})
        found.setflags(write=False)
        return found

    def _array(self, dtype: np.dtype[Any], value: Any) -> NDArray[Any] | None:
        """Return a copy as an array of its type; None where it cannot be one."""
        try:
            found = np.array(self._filled(value) if self.missing else value)
        except (TypeError, ValueError):
            return None
        if not found.size:
            sizes = [size if isinstance(size, int) else 0 for size in self.sizes]
            empty = 0 in sizes and found.ndim <= len(sizes)
            return np.zeros(sizes, dtype=dtype) if empty else None
        return found.astype(dtype) if found.dtype.kind in _TAKEN[dtype.kind] else None

    def _filled(self, value: Any) -> Any:
        """Return it with nan for what is null along the first axis."""
        if isinstance(value, np.ndarray) or not any(entry is None for entry in value):
            return value
        nothing = np.full([size for size in self.sizes[1:] if isinstance(size, int)], np.nan)
        return [nothing if entry is None else entry for entry in value]

    def _plain(self, value: NDArray[Any]) -> Any:
        entries = value.tolist()
        if not self.missing:
            return entries
        known = np.isfinite(value).reshape(len(value), -1).all(axis=1)
        return [entry if there else None for entry, there in zip(entries, known, strict=True)]


def _list_of(items: JsonSchemaValue, size: int | str) -> JsonSchemaValue:
    bounds = {"minItems": size, "maxItems": size} if isinstance(size, int) else {}
    return {"type": "array", "items": items, **bounds}
