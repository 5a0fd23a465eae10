"""An effect and where it sits, as records name it."""

from __future__ import annotations

from pydantic import Field

from pa10cal.results.record import Part


class EffectName(Part):
    """An effect and where it sits."""

    id: str = Field(description="id of the effect")
    of: str = Field(description="where it sits: `joint 2`, `forearm`, `base`, ...")

    @property
    def words(self) -> str:
        """Return it as readers see it: `transmission error, joint 2`."""
        return f"{self.id.replace('_', ' ')}, {self.of.replace('_', ' ')}"
