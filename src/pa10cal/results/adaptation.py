"""What `pa10cal adapt` writes: how many poses of another campaign a model needs."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from pa10cal.results.accuracy import Accuracy
from pa10cal.results.record import MeasuredRecord, Part, optional


class AdaptedStep(Part):
    """A model adapted to the first configurations of a campaign."""

    share: float = Field(description="part of all configurations, the first in order of time")
    configurations: int = Field(description="configurations fitted")
    prior: Accuracy = Field(description="held-out errors, the arm started from the model")
    frames: Accuracy | None = optional(
        "held-out errors, base and tool alone fitted; not given where they could not be"
    )
    alone: Accuracy | None = optional(
        "held-out errors of the general model fitted without a prior; not given with too few poses"
    )
    line: str = Field(description="what was found to have moved since, in one sentence")


class AdaptationRecord(MeasuredRecord):
    """`evaluation/adapted_<source>.json`."""

    SCHEMA: ClassVar[str] = "pa10cal-adaptation/1"
    FILE: ClassVar[str] = "evaluation/adapted_<source>.json"
    COMMAND: ClassVar[str] = "adapt"

    from_: str | None = Field(alias="from", description="campaign that the model was fitted to")
    held_out: int = Field(description="configurations held out, on which all are judged")
    steps: tuple[AdaptedStep, ...] = Field(description="by configurations fitted")
