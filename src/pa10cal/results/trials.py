"""Blind trials: what each hides, the verdict on it, and the rates over many of them."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, JsonValue

from pa10cal.results.discovery import VerdictKeys
from pa10cal.results.health import Grade
from pa10cal.results.record import (
    CampaignRecord,
    EffectName,
    Key,
    Name,
    Part,
    Record,
    filed,
    optional,
)

# Shares of trials with their intervals, and figures to reach.

#: Where no trial at all may go wrong, so many are needed as for one in a hundred.
_LEAST_ROOM, _ROUNDING = 0.01, 1e-9


class Rate(Part):
    """How many of some trials."""

    count: int = Field(description="how many")
    of: int = Field(description="out of these")
    low: float = Field(description="lower end of the share's 95 % interval (Clopper-Pearson)")
    high: float = Field(description="upper end of it")
    share: float | None = Field(description="the share; null of no trial")


class Bar(Part):
    """A figure to reach, and the one reached."""

    what: str = Field(description="the quantity")
    at_least: bool = Field(description="whether it must be at least `limit`; else at most")
    limit: float = Field(description="the figure to reach")
    reached: float | None = Field(description="the one reached; null where no trial shows it")
    low: float | None = Field(description="lower end of its 95 % interval; null if it is no share")
    high: float | None = Field(description="upper end of it")
    trials: int = Field(description="trials that show it")
    share: bool = Field(description="whether it is a share of trials")
    met: bool | None = Field(description="whether it is reached; null where no trial shows it")

    @property
    def trials_needed(self) -> int:
        """Return the fewest trials that can judge it: one among them may go wrong.

        With fewer, a single trial weighs more than the figure to reach leaves.
        """
        if not self.share:
            return 1
        room = 1.0 - self.limit if self.at_least else self.limit
        return math.ceil(1.0 / max(room, _LEAST_ROOM) - _ROUNDING)

    @property
    def verdict(self) -> str:
        """Return whether it is reached, in a word, or why that is not known."""
        if self.met is None:
            return "no trial"
        inside = self.low is None or self.high is None or self.low <= self.limit <= self.high
        if self.trials < self.trials_needed and inside:
            return f"too few to judge ({self.trials_needed} needed)"
        return "yes" if self.met else "no"

    def written(self, value: float) -> str:
        """Return a figure as readers see it: a share in per cent."""
        return f"{100.0 * value:.1f} %" if self.share else f"{value:.3g}"

    @property
    def interval(self) -> str:
        """Return its 95 % interval in words; empty where it has none."""
        if self.low is None or self.high is None:
            return ""
        return f"{self.written(self.low)} to {self.written(self.high)}"


# What proposed formulas come to over many trials.

_NONE = Rate(count=0, of=0, low=0.0, high=1.0, share=None)


class FormulaScores(Part):
    """Formulas proposed in blind trials, against what was hidden."""

    right: Rate = Field(
        _NONE,
        description="of trials that hide what no name covers, those whose proposal is that "
        "formula: form, order and place",
    )
    right_of_nameless: Rate = Field(
        _NONE, description="of these, those in which something without a name was found"
    )
    wrong: Rate = Field(_NONE, description="of the same trials, those with another formula")
    elsewhere: Rate = Field(
        _NONE,
        description="of trials that hide nothing, or what has a name, those with a formula that is "
        "not hidden",
    )
    by_id: Mapping[Annotated[str, Key("id")], Rate] = Field(
        {}, description="`right` by what is hidden"
    )
    bars: tuple[Bar, ...] = Field((), description="figures to reach, and those reached")


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


@filed("pa10cal-trial-truth/1", "trials/<kind>_<first>_<count>.truths.jsonl", by="blind_trials")
class TrialTruthRecord(CampaignRecord):
    """A line of `trials/<...>.truths.jsonl`: what a trial hides, and how it was measured."""

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


@filed("pa10cal-verdict/1", "trials/<kind>_<first>_<count>.verdicts.jsonl", by="blind_trials")
class TrialVerdictRecord(CampaignRecord):
    """A line of `trials/<...>.verdicts.jsonl`: the verdict on a trial, or why it has none."""

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
    health: TrialHealth | None = optional("what the calibration says of its input")
    seconds: float = Field(description="processor time to judge the campaign [s]")
    seconds_simulating: float = Field(description="processor time to simulate the campaign [s]")

    @property
    def word(self) -> str:
        """Return the verdict in a word."""
        return self.verdict

    @property
    def says_something(self) -> bool:
        """Whether anything was found, with a name or without."""
        return self.verdict not in ("none", "not_sought") or bool(self.effects)

    @property
    def places(self) -> tuple[str | None, ...]:
        """Where something without a name sits; those of maps follow from the effects."""
        if self.verdict != "unexplained" or self.unexplained is None:
            return ()
        return tuple(place.of for place in self.unexplained.all)

    @property
    def not_shown(self) -> frozenset[Name]:
        """What the data cannot show, or not surely at its plausible size."""
        every = (*self.not_testable, *(self.below_detection_limit or ()))
        return frozenset(effect.name for effect in every)

    @property
    def held_out_after_mm(self) -> float | None:
        """Mean position error of the extended model at held-out poses; None without any."""
        return None if self.gap.holdout is None else self.gap.holdout.after.mean_mm

    @property
    def grade(self) -> str:
        """Grade of the calibration; empty where it is not known."""
        return "" if self.health is None else self.health.grade

    @property
    def left_out(self) -> tuple[str, ...]:
        """Poses with quarantined rows, or that are suspected outliers."""
        return () if self.health is None else self.health.left_out


class FailedTrialRecord(TrialVerdictRecord):
    """Why a trial has no verdict."""

    failed: str = Field(description="what went wrong")
    refused: bool = Field(False, description="whether a command refused the campaign, and said why")

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


@filed("pa10cal-trials/1", "blind_trials/scores.json", by="score_trials")
class TrialScoresRecord(Record):
    """`scores.json` of a study of blind trials."""

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


# Wild trials: what campaigns with stressors and faults come to.


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


@filed("pa10cal-wild-trials/1", "wild_trials/scores.json", by="score_trials")
class WildScoresRecord(Record):
    """`scores.json` of the wild trials."""

    provenance: str = Field(description="where the data come from")
    trials: int = Field(description="number of trials")
    bars: tuple[Bar, ...] = Field(description="figures to reach, and those reached")
    subjects: tuple[WildSubject, ...] = Field(description="counts by what was put in")
    proposed: FormulaScores = Field(
        FormulaScores(), description="formulas proposed for what has no name"
    )
    per_trial: tuple[WildTrial, ...] = Field(description="every trial")


# Trials of drives: what sensors and gears that err are called.

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


@filed("pa10cal-drive-trials/1", "drive_trials/scores.json", by="score_trials")
class DriveScoresRecord(Record):
    """`scores.json` of the trials of drives."""

    provenance: str = Field(description="where the data come from")
    trials: int = Field(description="number of trials")
    bars: tuple[Bar, ...] = Field(description="figures to reach, and those reached")
    joints: tuple[DriveJoint, ...] = Field(description="every joint whose drive errs")
    per_trial: tuple[DriveTrial, ...] = Field(description="every trial")
