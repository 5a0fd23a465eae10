"""The words of the instruments as a type of settings, checked by the registry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema


@dataclass(frozen=True)
class _Registered:
    """A word of the registry, which is read when a value is checked and not before.

    Attributes:
        trackers: whether instruments whose raw data are touches are excluded.
    """

    trackers: bool

    def words(self) -> list[str]:
        from pa10cal.observe.registry import instruments  # late: it brings numpy and scipy

        return [
            word
            for word, found in instruments().items()
            if not (self.trackers and found.from_touches)
        ]

    def check(self, word: str) -> str:
        words = self.words()
        if word not in words:
            raise ValueError(f"should be one of {', '.join(words)}")
        return word

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        check: Callable[[str], str] = self.check
        return core_schema.no_info_after_validator_function(check, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return handler(schema) | {"enum": self.words()}


#: A kind of instrument, and one that gives its measurements in `files.poses`.
InstrumentKind = Annotated[str, _Registered(trackers=False)]
TrackerKind = Annotated[str, _Registered(trackers=True)]
