"""`pictures.json`: which pictures and tables were drawn, and why the others were not."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar

from pydantic import Field

from pa10cal.results.record import Key, Record, optional


class PicturesRecord(Record):
    """`pictures.json` of a campaign or study."""

    SCHEMA: ClassVar[str] = "pa10cal-pictures/1"
    FILE: ClassVar[str] = "pictures.json"
    COMMAND: ClassVar[str] = "figures"

    campaign: str | None = optional("name of the campaign, where they are of one")
    drawn: tuple[str, ...] = Field(description="names of the pictures and tables drawn")
    omitted: Mapping[Annotated[str, Key("name")], str] = Field(
        description="why each of the others was not drawn"
    )
