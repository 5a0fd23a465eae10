"""Blind trials: what each hides, the verdict on it, and the rates over many of them."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, JsonValue

from pa10cal.results.discovery import VerdictKeys
from pa10cal.results.effect_name import EffectName
from pa10cal.results.formula_scores import FormulaScores
from pa10cal.results.health import Grade
from pa10cal.results.record import CampaignRecord, Key, Part, Record, optional
from pa10cal.results.trial_bars import Bar, Rate

_Id = Annotated[str, Key("id")]
_Kind = Annotated[str, Key("kind")]
_Outcome = Annotated[str, Key("outcome")]


class HiddenEffect(EffectName):
    """An effect that a trial hides."""

    parameters: Mapping[Annotated[str, Key("parameter")], JsonValue] = Field(
        description="its parameters, as the virtual cell has them"
    )
    size: float = Field(description="factor of its reference size")
    moved_mm: float | None = Field(
        description="root mean square by which it moves the residual of the calibrated model [mm]; "
        "null where the trial failed"
    )
    apart_mm: float | None = optional(
        "the same once the sizes of all else that is hidden are fitted, too; of trials whose "
        "`moved_mm` is worked out from the truth (`unstated_masses`, `sorted_rows`)"
    )


class PutIn(Part):
    """A stressor or a fault that a wild trial puts into the raw files."""

    id: str = Field(description="id of the disturbance")
    where: tuple[str, ...] = Field(description="where: poses, joints, loads or keys")
    stressor: bool = Field(description="whether ordinary logs have it; else it must be told")
    kinds: tuple[str, ...] = Field(description="kinds of fault of a verdict that tell it")
    moved_mm: float | None = Field(
        description="root mean square by which it moves the residual of the calibrated model [mm]; "
        "null where that does not measure it, or the trial failed"
    )
    measured: bool = Field(description="whether that measures it; else it is far above the noise")


class TrialTruthRecord(CampaignRecord):
    """A line of `trials/<...>.truths.jsonl`: what a trial hides, and how it was measured."""

    SCHEMA: ClassVar[str] = "pa10cal-trial-truth/1"
    FILE: ClassVar[str] = "trials/<kind>_<first>_<count>.truths.jsonl"
    COMMAND: ClassVar[str] = "blind_trials"

    kind: str = Field(description="what the trial hides: `null`, `single`, `pair`, ...")
    measured: str = Field(
        description="`touched`: balls, poses repeated; `tracked`: none repeated; `wild`: any"
    )
    layout: str = Field(description="layout of the poses, or arm and instrument")
    path: str = Field(description="path between the poses; empty where none is repeated")
    temperature_drift_C: float = Field(description="change of temperature [K]")
    flexible_joints: tuple[int, ...] = Field(description="joints with a spring, from 1")
    hidden_effects: tuple[HiddenEffect, ...] = Field(description="effects that it hides")
    put_in: tuple[PutIn, ...] = Field(
        (), description="stressors and faults in its raw files; of wild trials alone"
    )
    stated_uncertainty_mm: float | None = Field(
        description="uncertainty stated in place of the true one [mm]; null where it is true"
    )
    mass_factor: tuple[float, ...] = Field(description="factors of the masses that are stated")
    seconds_twin: float = Field(description="processor time to find `moved_mm` [s]")
    noise_mm: float | None = optional(
        "what noise alone leaves of positions [mm], root mean square, averaged over repeats; where "
        "`moved_mm` is worked out from the truth"
    )


class TrialVerdictRecord(CampaignRecord):
    """A line of `trials/<...>.verdicts.jsonl`: the verdict on a trial, or why it has none."""

    SCHEMA: ClassVar[str] = "pa10cal-verdict/1"
    FILE: ClassVar[str] = "trials/<kind>_<first>_<count>.verdicts.jsonl"
    COMMAND: ClassVar[str] = "blind_trials"

    @classmethod
    def kinds(cls) -> tuple[type[Record], ...]:
        """Return the two kinds of line."""
        return (JudgedTrialRecord, FailedTrialRecord) if cls is TrialVerdictRecord else (cls,)

    @classmethod
    def kind_of(cls, content: dict[str, Any]) -> type[Record]:
        """Return which of the two it is."""
        if cls is not TrialVerdictRecord:
            return cls
        return FailedTrialRecord if "failed" in content else JudgedTrialRecord

    @property
    @abstractmethod
    def word(self) -> str:
        """Return the verdict in a word, or what went wrong."""


class TrialHealth(Part):
    """What the calibration of a trial says of its input."""

    grade: Grade = Field(description="its grade")
    findings: tuple[str, ...] = Field(description="what is probably wrong in the input, and where")
    left_out: tuple[str, ...] = Field(
        description="poses with quarantined rows, or that are suspected outliers"
    )


class JudgedTrialRecord(VerdictKeys, TrialVerdictRecord):
    """The verdict on a trial."""

    springs: tuple[int, ...] = Field(description="joints with a spring in the judged model, from 1")
    health: TrialHealth | None = optional("what the calibration says of its input; of wild trials")
    seconds: float = Field(description="processor time to judge the campaign [s]")
    seconds_simulating: float = Field(description="processor time to simulate the campaign [s]")

    @property
    def word(self) -> str:
        """Return the verdict in a word."""
        return self.verdict


class FailedTrialRecord(TrialVerdictRecord):
    """Why a trial has no verdict."""

    failed: str = Field(description="what went wrong")
    refused: bool = Field(
        False, description="whether a command refused the campaign, and said why; of wild trials"
    )

    @property
    def word(self) -> str:
        """Return what went wrong."""
        return f"{'refused' if self.refused else 'failed'}: {self.failed}"


class Failure(Part):
    """A trial without a verdict."""

    campaign: str = Field(description="name of the trial")
    kind: str = Field(description="what it hides")
    message: str = Field(description="what went wrong")


class NothingHidden(Part):
    """Trials that hide no effect."""

    named: Rate = Field(description="verdicts with a name in them; a failed trial counts as one")
    unexplained: Rate = Field(description="verdicts of something without a name")


class Singles(Part):
    """Trials that hide one effect of the vocabulary."""

    large: Rate = Field(
        description="of those that move the residual far above the noise and are separable, those "
        "named at their place"
    )
    large_alone: Rate = Field(
        description="of the same, those named without alternatives and with nothing else"
    )
    above: Rate = Field(
        description="of those above their detection limit, those named or among the alternatives"
    )
    found: Rate = Field(
        description="of all where anything was found, those named or among the alternatives"
    )
    torque_alone: Rate = Field(
        description="of testable effects that only the torque shows, those named or among the "
        "alternatives"
    )
    testable: Rate = Field(description="of all testable, those named or among the alternatives")
    detected: Rate = Field(description="of all testable, those where anything was found")
    confidently_wrong: Rate = Field(
        description="of all, those with a single name that is not what is hidden"
    )
    wrong: Rate = Field(description="of all, those with a finding that matches no hidden effect")
    alternatives: float | None = Field(
        description="mean number of alternatives where the truth is listed; null of none"
    )
    not_testable: int = Field(description="trials whose effect the verdict calls not testable")


class Outside(Part):
    """Trials that hide what no name covers."""

    confidently_wrong: Rate = Field(description="a single name, of another place or nature")
    right_place: Rate = Field(description="found without a name where it is")
    silent: Rate = Field(description="nothing found")


class Several(Part):
    """Trials that hide two or three effects."""

    all_listed: Rate = Field(description="each named or among the alternatives of its own finding")
    nothing_extra: Rate = Field(description="every finding matches a hidden effect")
    above_listed: Rate = Field(
        description="of those with effects above their detection limit, these all listed"
    )


class GapScore(Part):
    """Held-out error after naming, over the mean of campaigns without missing effect."""

    mean: float = Field(description="mean of the ratio over trials with a name")
    median: float = Field(description="its median")
    high: float = Field(description="its 95 % quantile")
    null_high: float = Field(description="the same quantile of campaigns without missing effect")
    trials: int = Field(description="trials with a name")


class ParameterRate(Rate):
    """How often the interval of one parameter holds the truth."""

    id: str = Field(description="id of the effect")
    parameter: str = Field(description="the parameter")


class ParameterScore(Part):
    """One parameter of one finding."""

    id: str = Field(description="id of the effect")
    parameter: str = Field(description="the parameter")
    score: float = Field(description="value minus truth, in standard uncertainties")


class Intervals(Part):
    """How often reported intervals hold the truth."""

    inside: Rate = Field(description="parameters inside their 95 % interval")
    rms: float | None = Field(description="root mean square score; null of none")
    by_parameter: tuple[ParameterRate, ...] = Field(description="the same for each parameter")
    scores: tuple[ParameterScore, ...] = Field(description="every parameter of every finding")


class Confusion(Part):
    """What became of each hidden effect."""

    single: Mapping[_Id, Mapping[_Outcome, int]] = Field(
        description="number of trials by hidden effect and outcome"
    )
    outside: Mapping[_Id, Mapping[_Outcome, int]] = Field(
        description="the same of effects outside the vocabulary"
    )


class PowerCurve(Part):
    """How the chance to be found grows with size: log odds = intercept + slope ln(size)."""

    intercept: float = Field(description="intercept")
    slope: float = Field(description="slope")
    half: float | None = Field(
        description="size found in half of the trials; null beyond those tried"
    )
    most: float | None = Field(description="size found in 95 %; null likewise")

    def at(self, size: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the chance at some sizes."""
        odds = self.intercept + self.slope * np.log(size)
        return np.asarray(1.0 / (1.0 + np.exp(-odds)))


class MovedBin(Part):
    """Trials whose residual is moved by so much, over the noise floor."""

    low: float = Field(description="from")
    high: float | None = Field(description="to; null without end")
    listed: Rate = Field(description="named or among the alternatives")


class PowerStudy(Part):
    """How the chance to be named or listed grows with size."""

    by_id: Mapping[_Id, PowerCurve | None] = Field(
        description="by an effect's size; null where it was always or never listed"
    )
    by_moved: PowerCurve | None = Field(
        description="by how far the residual is moved, over the noise floor; null likewise"
    )
    bins: tuple[MovedBin, ...] = Field(description="the same in shares")


class Seconds(Part):
    """Time to judge a campaign."""

    median: float | None = Field(description="median [s]; null where every trial failed")
    longest: float | None = Field(description="longest [s]; null likewise")


class JudgedEffect(EffectName):
    """What a trial hides, and what became of it."""

    size: float = Field(description="factor of its reference size")
    ratio: float | None = Field(
        description="residual with the effect over that of noise alone; null where not known"
    )
    testable: bool = Field(description="whether the verdict does not call it not testable")
    separable: bool = Field(description="whether the verdict does not call it inseparable")
    moves_poses: bool = Field(description="whether it shows in poses, not in torques alone")
    listed: bool = Field(description="whether it is named or among the alternatives")
    outcome: str = Field(description="what became of it, in words")


class JudgedTrial(Part):
    """A trial with its verdict."""

    campaign: str = Field(description="name of the trial")
    kind: str = Field(description="what it hides")
    layout: str = Field(description="layout of the poses")
    path: str = Field(description="path between the poses")
    hidden: tuple[JudgedEffect, ...] = Field(description="effects that it hides")
    verdict: str = Field(description="the verdict, or that the trial failed")
    named: tuple[str, ...] = Field(description="effects named, with their alternatives")
    places: tuple[str, ...] = Field(description="where something without a name sits")
    extra: int = Field(description="findings that match no hidden effect")
    held_out_after_mm: float | None = Field(
        description="mean held-out position error with the effects [mm]; null if there is none"
    )
    noise_floor_mm: float | None = Field(
        description="mean position error that repeatability leaves [mm]; null where it failed"
    )
    seconds: float | None = Field(description="time to judge it [s]; null where it failed")


class TrialScoresRecord(Record):
    """`scores.json` of a study of blind trials."""

    SCHEMA: ClassVar[str] = "pa10cal-trials/1"
    FILE: ClassVar[str] = "blind_trials/scores.json"
    COMMAND: ClassVar[str] = "score_trials"

    provenance: str = Field(description="where the data come from")
    trials: int = Field(description="number of trials")
    failed: tuple[Failure, ...] = Field(description="trials without a verdict")
    bars: tuple[Bar, ...] = Field(description="figures to reach, and those reached")
    nothing_hidden: Mapping[_Kind, NothingHidden] = Field(description="trials without an effect")
    single: Singles = Field(description="trials with one effect of the vocabulary")
    outside: Outside = Field(description="trials with an effect outside the vocabulary")
    several: Mapping[_Kind, Several] = Field(description="trials with two or three effects")
    gap: GapScore | None = Field(description="held-out error after naming; null without any")
    intervals: Intervals = Field(description="how often reported intervals hold the truth")
    confusion: Confusion = Field(description="what became of each hidden effect")
    proposed: FormulaScores = Field(
        FormulaScores(), description="formulas proposed for what has no name"
    )
    power: PowerStudy = Field(description="how the chance to be found grows with size")
    seconds: Seconds = Field(description="time to judge a campaign")
    per_trial: tuple[JudgedTrial, ...] = Field(description="every trial")
