"""Wild trials: what campaigns with stressors and faults come to."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from pa10cal.results.formula_scores import FormulaScores
from pa10cal.results.record import Part, Record
from pa10cal.results.trial_bars import Bar


class WildSubject(Part):
    """Trials that put in the same: counts."""

    kind: str = Field(description="kind of the trials: `right`, `stressed`, `effect`, ...")
    id: str = Field(description="disturbance or effect that they put in")
    trials: int = Field(description="trials")
    crashed: int = Field(description="of these, those in which a command failed")
    refused: int = Field(description="those refused before they were calibrated")
    false_names: int = Field(
        description="those with a name that is not hidden; a confident one where a fault, or an "
        "effect outside the vocabulary, is in them"
    )
    above_noise: int = Field(
        description="faults in them above three times the noise; of `unstated_masses` and "
        "`sorted_rows`, effects with which the residual is 1.5 times the noise or more"
    )
    told: int = Field(
        description="of these faults, those told, refused or suspected; of these effects, those "
        "named or among the alternatives"
    )
    found: int = Field(description="hidden effects named or among the alternatives")
    false_comfort: int = Field(description="trials with `none` where something is wrong, untold")
    worse: int = Field(description="trials whose held-out error the effects found make worse")
    unexplained: int = Field(description="trials with `unexplained`")
    suspected: int = Field(description="trials refused, `check_the_log` or `suspect_input`")


class WildTrial(Part):
    """A trial, what was said of it, and where that fails."""

    campaign: str = Field(description="name of the trial")
    kind: str = Field(description="its kind")
    bench: str = Field(description="arm and instrument")
    put_in: tuple[str, ...] = Field(description="effects, stressors and faults in it, and where")
    said: str = Field(description="verdict, grade, names and faults; or why there is none")
    failings: tuple[str, ...] = Field(description="bars that it counts against")
    seconds: float | None = Field(
        description="time of the processor to judge it [s]; null without a verdict"
    )


class WildScoresRecord(Record):
    """`scores.json` of the wild trials."""

    SCHEMA: ClassVar[str] = "pa10cal-wild-trials/1"
    FILE: ClassVar[str] = "wild_trials/scores.json"
    COMMAND: ClassVar[str] = "score_trials"

    provenance: str = Field(description="where the data come from")
    trials: int = Field(description="number of trials")
    bars: tuple[Bar, ...] = Field(description="figures to reach, and those reached")
    subjects: tuple[WildSubject, ...] = Field(description="counts by what was put in")
    proposed: FormulaScores = Field(
        FormulaScores(), description="formulas proposed for what has no name"
    )
    per_trial: tuple[WildTrial, ...] = Field(description="every trial")
