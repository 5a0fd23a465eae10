"""Blind trials: what each hides, the verdict on it, and the scores over many of them."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import JsonValue

from pa10cal.results import arrays, record
from pa10cal.results.calibration import Grade
from pa10cal.results.discovery import VerdictKeys

_Rows = Annotated[NDArray[np.float64], arrays.Shape("rows", "joints")]


# `<campaign>.truth.json`: all that a simulated campaign hides. No estimate reads it.


class TrueParameter(record.Part):
    """A parameter as the simulated arm has it."""

    value: float  # value, in `unit`
    unit: str  # its unit


class TrueTool(record.Part):
    """The tool as it is."""

    mass_kg: float  # mass [kg]
    com_m: arrays.Vector3  # centre of mass in the end-effector frame [m]
    load_point_m: arrays.Vector3  # where loads act, in the end-effector frame [m]
    # places of the targets in the end-effector frame [m]
    targets_m: Mapping[Annotated[str, record.Key("target")], arrays.Vector3]


class TrueEffect(record.EffectName):
    """An effect that is hidden."""

    # its parameters, as the virtual cell has them
    parameters: Mapping[Annotated[str, record.Key("parameter")], JsonValue]


class TrueDisturbance(record.Part):
    """A change of the raw files: a stressor, or a fault of the log."""

    id: str  # id of the disturbance
    where: tuple[str, ...]  # where: poses, joints, loads or keys


@record.filed("pa10cal-truth/1", "<campaign>.truth.json", by="simulate")
class TruthRecord(record.CampaignRecord):
    """What a simulated campaign hides."""

    robot: str  # name of the arm
    random_seed: int  # seed of everything drawn
    kcub_reading: str  # where the stiffness of the joints comes from
    # departures of the rows and stiffness; of an arm that departs in any way stiffness alone
    parameters: Mapping[record.ParameterKey, TrueParameter]
    T_instr_base_m: arrays.PoseMatrix  # base frame in the instrument's frame [m]
    # frame of each joint in that of the joint before it [m]
    joint_placements_m: Annotated[NDArray[np.float64], arrays.Shape("joints", 4, 4)]
    T_last_joint_ee_m: arrays.PoseMatrix  # end-effector frame in that of the last joint [m]
    T_ee_target_m: arrays.PoseMatrix  # target in the end-effector frame [m]
    mass_kg: Annotated[NDArray[np.float64], arrays.Shape("links")]  # mass of each link [kg]
    # centre of mass of each link in its joint's frame [m]
    com_in_joint_frame_m: Annotated[NDArray[np.float64], arrays.Shape("links", 3)]
    tool: TrueTool  # the tool
    hidden_effects: tuple[TrueEffect, ...]  # effects hidden
    # what was changed in the raw files before they were written
    disturbances: tuple[TrueDisturbance, ...] = ()
    settings: Mapping[
        Annotated[str, record.Key("option")], JsonValue
    ]  # settings it was simulated with
    # commanded joint positions by purpose; empty where they were given
    poses_rad_or_m: Mapping[Annotated[str, record.Key("kind")], _Rows]
    q_motor_rad_or_m: _Rows  # motor positions of every row measured


# Trials: what each hides, and the verdict on it.


class HiddenEffect(record.EffectName):
    """An effect that a trial hides."""

    # its parameters, as the virtual cell has them
    parameters: Mapping[Annotated[str, record.Key("parameter")], JsonValue]
    size: float  # factor of its reference size
    # root mean square by which it moves the residual of the calibrated model [mm]; null where the
    # trial failed
    moved_mm: float | None
    # the same once the sizes of all else that is hidden are fitted, too; of trials whose `moved_mm`
    # is worked out from the truth (`unstated_masses`, `sorted_rows`, `mixed`)
    apart_mm: float | None = record.optional()
    # whether it is in the background, outside the vocabulary; of `mixed` trials alone
    outside: bool | None = record.optional()


class TrialDisturbance(record.Part):
    """A stressor or a fault that a wild trial puts into the raw files."""

    id: str  # id of the disturbance
    where: tuple[str, ...]  # where: poses, joints, loads or keys
    stressor: bool  # whether ordinary logs have it; else it must be told
    kinds: tuple[str, ...]  # kinds of fault of a verdict that tell it
    # root mean square by which it moves the residual of the calibrated model [mm]; null where that
    # does not measure it, or the trial failed
    moved_mm: float | None
    measured: bool  # whether that measures it; else it is far above the noise


@record.filed(
    "pa10cal-trial-truth/1", "trials/<kind>_<first>_<count>.truths.jsonl", by="blind_trials"
)
class TrialTruthRecord(record.CampaignRecord):
    """A line of `trials/<...>.truths.jsonl`: what a trial hides, and how it was measured."""

    kind: str  # what the trial hides: `null`, `single`, `pair`, ...
    measured: str  # `touched`: balls, poses repeated; `tracked`: none repeated; `wild`: any
    layout: str  # layout of the poses, or arm and instrument
    path: str  # path between the poses; empty where none is repeated
    temperature_drift_C: float  # change of temperature [K]
    flexible_joints: tuple[int, ...]  # joints with a spring, from 1
    hidden_effects: tuple[HiddenEffect, ...]  # effects that it hides
    put_in: tuple[
        TrialDisturbance, ...
    ] = ()  # stressors and faults in its raw files; of wild trials alone
    # uncertainty stated in place of the true one [mm]; null where it is true
    stated_uncertainty_mm: float | None
    mass_factor: tuple[float, ...]  # factors of the masses that are stated
    seconds_twin: float  # processor time to find `moved_mm` [s]
    # what noise alone leaves of positions [mm], root mean square, averaged over repeats; where
    # `moved_mm` is worked out from the truth
    noise_mm: float | None = record.optional()


@record.filed(
    "pa10cal-verdict/1", "trials/<kind>_<first>_<count>.verdicts.jsonl", by="blind_trials"
)
class TrialVerdictRecord(record.CampaignRecord):
    """A line of `trials/<...>.verdicts.jsonl`: the verdict on a trial, or why it has none."""

    @classmethod
    def kinds(cls) -> tuple[type[record.Record], ...]:
        """Return the two kinds of line."""
        return (JudgedTrialRecord, FailedTrialRecord) if cls is TrialVerdictRecord else (cls,)

    @classmethod
    def kind_of(cls, content: dict[str, Any]) -> type[record.Record]:
        """Return which of the two it is."""
        if cls is not TrialVerdictRecord:
            return cls
        return FailedTrialRecord if "failed" in content else JudgedTrialRecord

    @property
    @abstractmethod
    def word(self) -> str:
        """Return the verdict in a word, or what went wrong."""


class TrialHealth(record.Part):
    """What the calibration of a trial says of its input."""

    grade: Grade  # its grade
    findings: tuple[str, ...]  # what is probably wrong in the input, and where
    # joints, and other parameters, far from nominal as held-out poses confirm
    departures: tuple[str, ...] = ()
    left_out: tuple[str, ...]  # poses with quarantined rows, or that are suspected outliers


class JudgedTrialRecord(VerdictKeys, TrialVerdictRecord):
    """The verdict on a trial."""

    springs: tuple[int, ...]  # joints with a spring in the judged model, from 1
    health: TrialHealth | None = record.optional()  # what the calibration says of its input
    seconds: float  # processor time to judge the campaign [s]
    seconds_simulating: float  # processor time to simulate the campaign [s]

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
    def not_shown(self) -> frozenset[record.Name]:
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
    def departures(self) -> tuple[str, ...]:
        """Joints, and other parameters, far from nominal, as held-out poses confirm."""
        return () if self.health is None else self.health.departures

    @property
    def left_out(self) -> tuple[str, ...]:
        """Poses with quarantined rows, or that are suspected outliers."""
        return () if self.health is None else self.health.left_out


class FailedTrialRecord(TrialVerdictRecord):
    """Why a trial has no verdict."""

    failed: str  # what went wrong
    refused: bool = False  # whether a command refused the campaign, and said why

    @property
    def word(self) -> str:
        """Return what went wrong."""
        return f"{'refused' if self.refused else 'failed'}: {self.failed}"


# Scores over many trials: rates and other figures, with the one to reach where there is one.

#: Where no trial at all may go wrong, so many are needed as for one in a hundred.
_LEAST_ROOM, _ROUNDING = 0.01, 1e-9


class ScoreRow(record.Part):
    """A share of trials or another figure over them, and the one to reach."""

    what: str  # the quantity
    by: str  # the group of trials or effects; empty of all of them
    at_least: bool | None  # whether it must be at least `limit`, or at most; null without a limit
    limit: float | None  # the figure to reach; null where there is none
    reached: float | None  # the one reached; null where no trial shows it
    count: int | None  # of a share: how many; null of another figure
    low: float | None  # lower end of its 95 % interval; null if it is no share
    high: float | None  # upper end of it (Clopper-Pearson)
    trials: int  # trials, effects or parameters that show it
    share: bool  # whether it is a share of these
    met: bool | None  # whether it is reached; null where that is not known

    @property
    def trials_needed(self) -> int:
        """Return the fewest trials that can judge it: one among them may go wrong.

        With fewer, a single trial weighs more than the figure to reach leaves.
        """
        if not self.share or self.limit is None:
            return 1
        room = 1.0 - self.limit if self.at_least else self.limit
        return math.ceil(1.0 / max(room, _LEAST_ROOM) - _ROUNDING)

    @property
    def verdict(self) -> str:
        """Return whether it is reached, in a word, or why that is not known."""
        if self.reached is None:
            return "no trial"
        if self.limit is None:
            return ""
        inside = self.low is None or self.high is None or self.low <= self.limit <= self.high
        if self.trials < self.trials_needed and inside:
            return f"too few to judge ({self.trials_needed} needed)"
        return "yes" if self.met else "no"

    def formatted(self, value: float) -> str:
        """Return a figure as readers see it: a share in per cent."""
        return f"{100.0 * value:.1f} %" if self.share else f"{value:.3g}"

    @property
    def target(self) -> str:
        """Return the figure to reach in words; empty where there is none."""
        if self.limit is None:
            return ""
        return f"{'at least' if self.at_least else 'at most'} {self.formatted(self.limit)}"

    @property
    def interval(self) -> str:
        """Return its 95 % interval in words; empty where it has none."""
        if self.low is None or self.high is None:
            return ""
        return f"{self.formatted(self.low)} to {self.formatted(self.high)}"


class OutcomeCounts(record.Part):
    """What became of trials that hide, or put in, the same."""

    kind: str  # kind of the trials: `single`, `fault`, `sensor`, ...
    id: str  # effect or disturbance; of drives `joint`
    trials: int  # trials; of drives joints
    # of wild trials, those that `crashed` or were `refused`, with a `false_name` (a confident one
    # where a fault or an effect without a name is in them), `false_comfort`, held-out errors made
    # `worse`, `unexplained` or `suspected`; faults `above_noise` and `told`; effects `found`. Of
    # the others, what each hidden effect was called
    counts: Mapping[Annotated[str, record.Key("outcome")], int]


class ParameterScore(record.Part):
    """One parameter of one finding that is what was hidden, at its place."""

    id: str  # id of the effect
    parameter: str  # the parameter
    score: float  # value minus truth, in standard uncertainties


class PowerCurve(record.Part):
    """How the chance to be found grows with size: log odds = intercept + slope ln(size)."""

    intercept: float  # intercept
    slope: float  # slope
    half: float | None  # size found in half of the trials; null beyond those tried
    most: float | None  # size found in 95 %; null likewise

    def at(self, size: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the chance at some sizes."""
        odds = self.intercept + self.slope * np.log(size)
        return np.asarray(1.0 / (1.0 + np.exp(-odds)))


class MovedBin(record.Part):
    """Trials whose residual is moved by so much, over the noise floor."""

    low: float  # from
    high: float | None  # to; null without end
    listed: ScoreRow  # named or among the alternatives


class PowerStudy(record.Part):
    """How the chance to be named or listed grows with size, of trials that hide one effect."""

    # by an effect's size; null where it was always or never listed
    by_id: Mapping[Annotated[str, record.Key("id")], PowerCurve | None]
    # by how far the residual is moved, over the noise floor; null likewise
    by_moved: PowerCurve | None
    bins: tuple[MovedBin, ...]  # the same in shares


class JudgedEffect(record.EffectName):
    """What a trial hides, and what became of it."""

    size: float  # factor of its reference size
    ratio: float | None  # residual with the effect over that of noise alone; null where not known
    testable: bool  # whether the verdict does not call it not testable
    separable: bool  # whether the verdict does not call it inseparable
    moves_poses: bool  # whether it shows in poses, not in torques alone
    listed: bool  # whether it is named or among the alternatives
    # what became of it: an id, or in words; of drives `right`: its name alone, or both where sensor
    # and gear err; `ambiguous`: it among others; `wrong`: another; `no_cause`: a map; `missed`:
    # nothing; `failed`
    outcome: str


class JudgedTrial(record.Part):
    """A trial, what was said of it, and where that fails."""

    campaign: str  # name of the trial
    kind: str  # what it hides; of drives what errs
    layout: str  # layout of the poses, or arm and instrument
    path: str  # path between the poses; empty where none is repeated
    hidden: tuple[JudgedEffect, ...]  # effects that it hides
    put_in: tuple[str, ...]  # stressors and faults in it, and where
    verdict: str  # the verdict, or that the trial `failed` or was `refused`
    said: str  # verdict, grade, names and faults; or why there is none
    named: tuple[str, ...]  # effects named, with their alternatives
    places: tuple[str, ...]  # where something without a name sits
    extra: int  # findings that match no hidden effect
    failings: tuple[str, ...]  # figures to reach that it counts against
    # mean held-out position error with the effects [mm]; null if there is none
    held_out_after_mm: float | None
    # mean position error that repeatability leaves [mm]; null where it failed
    noise_floor_mm: float | None
    seconds: float | None  # time to judge it [s]; null where it failed


@record.filed("pa10cal-trials/2", "blind_trials/scores.json", by="score_trials")
class TrialScoresRecord(record.Record):
    """`scores.json` of a study of trials of any kind."""

    provenance: str  # where the data come from
    measured: str  # `touched`, `tracked`, `wild` or `drives`
    trials: int  # number of trials
    bars: tuple[ScoreRow, ...]  # figures to reach, and those reached
    rates: tuple[ScoreRow, ...]  # further figures, some of them by groups
    subjects: tuple[OutcomeCounts, ...]  # counts by what was put in or hidden
    parameter_scores: tuple[ParameterScore, ...]  # parameters of findings that are what was hidden
    power: PowerStudy  # how the chance to be found grows with size
    per_trial: tuple[JudgedTrial, ...]  # every trial
