"""Trials of drives: what sensors and gears that err are called."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from pa10cal.results.record import Part, Record
from pa10cal.results.trial_bars import Bar

Outcome = Literal["right", "ambiguous", "wrong", "no_cause", "missed", "failed"]


class DriveJoint(Part):
    """A joint whose drive errs, and what it was called."""

    campaign: str = Field(description="name of the trial")
    bench: str = Field(description="arm, and number of campaigns")
    of: str = Field(description="the joint")
    errs: str = Field(description="what errs: `sensor`, `gear` or `both`")
    ratio: float = Field(description="motor turns a joint turn")
    called: tuple[str, ...] = Field(description="names of errors by its angle, likeliest first")
    outcome: Outcome = Field(
        description="`right`: that name alone, or both names where both err; `ambiguous`: it among "
        "others; `wrong`: another; `no_cause`: a map; `missed`: nothing"
    )


class DriveTrial(Part):
    """A trial of drives with its verdict."""

    campaign: str = Field(description="name of the trial")
    bench: str = Field(description="arm, and number of campaigns")
    errs: str = Field(description="what errs: `sensor`, `gear`, `both` or `neither`")
    verdict: str = Field(description="the verdict, or that the trial failed")
    false_names: tuple[str, ...] = Field(description="names where nothing of that name is hidden")
    seconds: float | None = Field(description="processor time to judge it [s]; null if it failed")


class DriveScoresRecord(Record):
    """`scores.json` of the trials of drives."""

    SCHEMA: ClassVar[str] = "pa10cal-drive-trials/1"
    FILE: ClassVar[str] = "drive_trials/scores.json"
    COMMAND: ClassVar[str] = "score_trials"

    provenance: str = Field(description="where the data come from")
    trials: int = Field(description="number of trials")
    bars: tuple[Bar, ...] = Field(description="figures to reach, and those reached")
    joints: tuple[DriveJoint, ...] = Field(description="every joint whose drive errs")
    per_trial: tuple[DriveTrial, ...] = Field(description="every trial")
