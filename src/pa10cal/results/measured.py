"""`measured/measured.json`: the campaigns of real robots that are at hand, in one table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from pa10cal.results.fleet import ChainStatus
from pa10cal.results.record import Key, Part, Record, optional

#: Models of the table, each with what the one before lacks.
MeasuredModel = Literal["nominal", "geometry", "springs", "effects"]


class HeldOutError(Part):
    """Position error over held-out poses."""

    mean_mm: float = Field(description="mean [mm]")
    rms_mm: float = Field(description="root mean square [mm]")


ErrorsByModel = Mapping[Annotated[MeasuredModel, Key("model")], HeldOutError]


class Carried(Part):
    """A model of another campaign in this one, where base and tool alone are fitted."""

    source: str = Field(description="campaign that the model is of")
    message: str | None = optional("why it was not carried over")
    errors: ErrorsByModel = Field(description="errors by model; empty where it was not")


class MeasuredRobot(Part):
    """One campaign of a real robot, or several of one as a group."""

    campaign: str = Field(description="name of its folder, or of the group")
    members: tuple[str, ...] | None = optional("campaigns of the group")
    robot: str | None = optional("what the arm is called")
    instrument: str | None = optional("what measured it")
    status: ChainStatus = Field(description="what became of it, as in `chain.json`")
    message: str | None = optional("stage and message, where it was refused or failed")
    poses: int | None = optional("configurations fitted and held out")
    held_out: int | None = optional("configurations held out")
    grade: str | None = optional("of the calibration")
    verdict: str | None = optional("of the search for missing effects")
    names: tuple[str, ...] = Field(description="effects named, each with its alternatives")
    faults: tuple[str, ...] = Field(description="faults of the log, kind and place")
    errors: ErrorsByModel = Field(
        description="held-out errors by model: `nominal`, base and tool fitted; `geometry`; "
        "`springs` too; `effects` too. One that does not apply is absent"
    )
    carried: tuple[Carried, ...] = Field(description="models of other campaigns in this one")
    published: str | None = optional(
        "what the owner or somebody else reports of these data, with its source"
    )


class MeasuredRobotsRecord(Record):
    """`measured/measured.json`."""

    SCHEMA: ClassVar[str] = "pa10cal-measured-robots/1"
    FILE: ClassVar[str] = "measured/measured.json"
    COMMAND: ClassVar[str] = "measured"

    robots: tuple[MeasuredRobot, ...] = Field(description="every campaign and group at hand")
