"""Scores of blind trials, as far as pictures are drawn from them."""

from __future__ import annotations

from pathlib import Path

from pa10cal.figures.record_files import read_study
from pa10cal.figures.records import Record
from pa10cal.files.schemas import TRIALS


class Rate(Record):
    """How many of some trials, with the 95 % interval of their share."""

    count: int
    of: int
    low: float
    high: float
    share: float | None


class Bar(Record):
    """A figure to reach, and the one reached."""

    what: str
    at_least: bool
    limit: float
    reached: float | None
    low: float | None
    high: float | None
    trials: int
    share: bool
    met: bool | None


class NothingHidden(Record):
    """Trials that hide no effect."""

    named: Rate
    unexplained: Rate


class Singles(Record):
    """Trials that hide one effect of the vocabulary."""

    wrong: Rate
    detected: Rate
    alternatives: float | None
    not_testable: int


class Outside(Record):
    """Trials that hide what no name covers."""

    confidently_wrong: Rate
    right_place: Rate
    silent: Rate


class Several(Record):
    """Trials that hide two or three effects."""

    all_listed: Rate
    nothing_extra: Rate


class Gap(Record):
    """Held-out error after naming, over the mean where nothing is missing."""

    mean: float
    median: float
    high: float
    null_high: float
    trials: int


class OfParameter(Rate):
    """How often the interval of one parameter holds the truth."""

    id: str
    parameter: str


class Score(Record):
    """(Value - truth) / standard uncertainty of one parameter."""

    id: str
    parameter: str
    score: float


class Intervals(Record):
    """How reported intervals of effects do."""

    inside: Rate
    rms: float | None
    by_parameter: tuple[OfParameter, ...]
    scores: tuple[Score, ...]


class Confusion(Record):
    """What became of each hidden id: outcome and count."""

    single: dict[str, dict[str, int]]
    outside: dict[str, dict[str, int]]


class Curve(Record):
    """A power curve: log odds = intercept + slope ln(size)."""

    intercept: float
    slope: float
    half: float | None
    most: float | None


class Bin(Record):
    """Trials whose residual is moved by so much, over the floor."""

    low: float
    high: float | None
    listed: Rate


class PowerStudy(Record):
    """How the chance to be listed grows with size."""

    by_id: dict[str, Curve | None]
    by_moved: Curve | None
    bins: tuple[Bin, ...]


class HiddenEffect(Record):
    """What a trial hid, and what became of it."""

    id: str
    of: str
    size: float
    testable: bool
    moves_poses: bool
    listed: bool
    outcome: str


class OneTrial(Record):
    """A trial with its verdict."""

    kind: str
    layout: str
    hidden: tuple[HiddenEffect, ...]
    verdict: str


class Scores(Record):
    """`scores.json` of a study of blind trials."""

    provenance: str
    trials: int
    bars: tuple[Bar, ...]
    nothing_hidden: dict[str, NothingHidden]
    single: Singles
    outside: Outside
    several: dict[str, Several]
    gap: Gap | None
    intervals: Intervals
    confusion: Confusion
    power: PowerStudy
    per_trial: tuple[OneTrial, ...]

    @property
    def name(self) -> str:
        """What messages call it."""
        return "blind trials"

    @property
    def footer(self) -> str:
        """What a picture was drawn from."""
        return f"{self.trials} blind trials. Synthetic data. Provenance: {self.provenance}."


def read_scores(path: Path) -> Scores:
    """Read the scores of a study.

    Raises:
        RecordError: when the file is missing or is no such record.
    """
    return read_study(path, Scores, TRIALS, "scores of blind trials", "score_trials")
