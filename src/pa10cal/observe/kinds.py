"""Words of the instruments as a type of settings, checked by the registry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema


@dataclass(frozen=True)
class _OneOf:
    """A word of a list that is made when a value is checked, and not before."""

    words: Callable[[], list[str]]  # makes the list

    def _check(self, word: str) -> str:
        words = self.words()
        if word not in words:
            raise ValueError(f"should be one of {', '.join(words)}")
        return word

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self._check, handler(source))


def _kinds() -> list[str]:
    from pa10cal.observe.registry import instruments  # late: it brings numpy and scipy

    return list(instruments())


def _trackers() -> list[str]:
    from pa10cal.observe.registry import instruments

    return [kind for kind, found in instruments().items() if not found.from_touches]


def sees_several(kind: str) -> bool:
    """Return whether an instrument measures several targets on the end-effector."""
    from pa10cal.observe.registry import instruments

    return instruments()[kind].several_targets


#: A kind of instrument, and one that gives its measurements in `files.poses`.
InstrumentKind = Annotated[str, _OneOf(_kinds)]
TrackerKind = Annotated[str, _OneOf(_trackers)]
