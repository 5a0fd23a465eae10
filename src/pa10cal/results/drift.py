"""What `pa10cal drift` writes: the parameters of one arm over campaigns, in order of time."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from pa10cal.results.comparison import WhatMoved
from pa10cal.results.record import Column, LabelColumn, Part, Record, Table


class DriftRows(Table):
    """Every parameter of the arm in every campaign that has it."""

    campaign: LabelColumn = Field(description="the campaign")
    term: LabelColumn = Field(description="term of the parameter")
    of: LabelColumn = Field(description="where the term sits")
    parameter: LabelColumn = Field(description="name of the parameter")
    unit: LabelColumn = Field(description="unit of value and interval")
    value: Column = Field(description="value")
    std: Column = Field(description="its standard uncertainty")
    low: Column = Field(description="lower end of its 95 % interval")
    high: Column = Field(description="upper end of it")


class DriftStep(Part):
    """What moved from one campaign to the next."""

    first: str = Field(description="the campaign before")
    second: str = Field(description="the campaign after")
    what_moved: WhatMoved = Field(description="what moved in between")


class DriftRecord(Record):
    """`drift.json`."""

    SCHEMA: ClassVar[str] = "pa10cal-drift/1"
    FILE: ClassVar[str] = "drift.json"
    COMMAND: ClassVar[str] = "drift"

    robot: str = Field(description="the arm")
    campaigns: tuple[str, ...] = Field(description="campaigns, in order of time as they were given")
    parameters: DriftRows = Field(description="links, springs and effects of the arm")
    steps: tuple[DriftStep, ...] = Field(description="from each campaign to the next")
    line: str = Field(description="what moved and when, in one sentence")
