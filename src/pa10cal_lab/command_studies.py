"""Commands that hold verdicts and intervals against a truth: `score_trials`, `coverage`.

Truths of trials are read here alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from pa10cal.calibration.options import CalibrationOptions
from pa10cal_lab.options import CoverageOptions

if TYPE_CHECKING:
    from pa10cal.results.record import CampaignRecord
    from pa10cal_lab.trial_records import JudgedEffect, JudgedTrial, ScoreRow

_R = TypeVar("_R", bound="CampaignRecord")


def score_trials(
    *, verdicts: tuple[Path, ...], truths: tuple[Path, ...], scores: Path, trials: Path
) -> None:
    """Compare verdicts on blind trials with what was hidden.

    Args:
        verdicts: verdicts, one a trial (JSON lines).
        truths: what the trials hide, one a trial (JSON lines).
        scores: scores to write (.json).
        trials: table of trials to write (.csv).

    Examples:
        pa10cal score_trials --verdicts v.jsonl --truths t.jsonl --scores scores.json \\
          --trials trials.csv
    """
    from pa10cal.errors import RecordError
    from pa10cal.files.output import write_text
    from pa10cal.results.codec import write
    from pa10cal_lab.blind_trial import BlindTrial
    from pa10cal_lab.scores import scores_record
    from pa10cal_lab.trial_records import TrialTruthRecord, TrialVerdictRecord

    # Reading makes one of its kinds, none of which is abstract.
    records = _by_name(TrialVerdictRecord, verdicts)  # type: ignore[type-abstract]
    hidden = _by_name(TrialTruthRecord, truths)
    if odd := sorted(set(records) ^ set(hidden)):
        raise RecordError(
            "a trial has a verdict or a truth, but not both",
            where=", ".join(map(str, (*verdicts, *truths))),
            value=odd[0],
            allowed="verdicts and truths of the same trials",
            remedy="give all files that pa10cal blind_trials wrote",
        )
    record = scores_record([BlindTrial(truth, records[name]) for name, truth in hidden.items()])
    write_text(trials, _table(record.per_trial))
    write(record, scores)
    for bar in record.bars:
        print(_line(bar))


def coverage(
    *,
    out: Path,
    table: Path,
    settings: CoverageOptions = CoverageOptions(),
    calibration: CalibrationOptions = CalibrationOptions(),
) -> None:
    """Count how often intervals hold the truth of simulated campaigns.

    Args:
        out: record to write (.json).
        table: the same in brief, to write (.csv).
        settings: section coverage.
        calibration: section calibration.

    Examples:
        pa10cal coverage --out coverage.json --table coverage.csv
    """
    from functools import partial

    from pa10cal.files.output import write_text
    from pa10cal.results.codec import write
    from pa10cal_lab.coverage import coverage_study, coverage_table

    record = coverage_study(settings, calibration, partial(print, flush=True))
    write_text(table, coverage_table(record))
    write(record, out)


def _by_name(kind: type[_R], paths: Sequence[Path]) -> dict[str, _R]:
    """Return records by the name of the trial; a file that cannot be read is refused."""
    from pa10cal.errors import RecordError
    from pa10cal.results.codec import read_lines

    records: dict[str, _R] = {}
    for path in paths:
        for number, record in enumerate(read_lines(kind, path), start=1):
            if record.campaign in records:
                raise RecordError(
                    "a trial occurs twice",
                    where=f"{path}:{number}",
                    value=record.campaign,
                    allowed=f"one line of schema {kind.SCHEMA} a trial",
                    remedy="run pa10cal blind_trials again",
                )
            records[record.campaign] = record
    return records


def _table(trials: Sequence[JudgedTrial]) -> str:
    """Return one line a trial, lists joined."""
    from pa10cal.files.table_cells import csv_text
    from pa10cal_lab.trial_records import JudgedTrial

    rows = [
        ["; ".join(map(_words, value)) if isinstance(value, tuple) else value for _, value in trial]
        for trial in trials
    ]
    return csv_text(JudgedTrial.model_fields, rows)


def _words(entry: str | JudgedEffect) -> str:
    """Return an entry of a list; of a hidden effect what became of it."""
    if isinstance(entry, str):
        return entry
    floors = "" if entry.ratio is None else f", {entry.ratio:.3g} floors"
    return f"{entry.id} of {entry.of} x{entry.size:.3g}{floors}: {entry.outcome}"


def _line(bar: ScoreRow) -> str:
    """Return a figure to reach, and the one reached, in one line."""
    if bar.reached is None:
        return f"{bar.what}: no trial counts ({bar.target})"
    interval = f" ({bar.interval})" if bar.interval else ""
    verdict = {"yes": "met", "no": "NOT met"}.get(bar.verdict, bar.verdict)
    reached = f"{bar.formatted(bar.reached)}{interval}"
    return f"{bar.what}: {reached} of {bar.trials} trials, {bar.target}: {verdict}"
