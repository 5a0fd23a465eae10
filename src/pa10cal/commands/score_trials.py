"""Command `score_trials`. Truths are read here alone."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from pa10cal.evaluation.blind_trial import BlindTrial
    from pa10cal.results.record import CampaignRecord
    from pa10cal.results.trials import Bar, JudgedTrial

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
    from pa10cal.evaluation import drive_scores, measured_scores, trial_scores, wild_scores
    from pa10cal.evaluation.blind_trial import DRIVES, SORTED, UNSTATED, WILD
    from pa10cal.files.output import write_text
    from pa10cal.results.codec import write
    from pa10cal.results.trials import DriveTrial, JudgedTrial, WildTrial

    known = _read_trials(verdicts, truths)
    if any(trial.truth.measured == DRIVES for trial in known):
        drives = drive_scores.scores_record(known)
        write_text(trials, _table(DriveTrial.model_fields, map(dict, drives.per_trial)))
        write(drives, scores)
        bars = drives.bars
    elif any(trial.truth.measured == WILD for trial in known):
        measured = all(trial.kind in (UNSTATED, SORTED) for trial in known)
        wild = (measured_scores if measured else wild_scores).scores_record(known)
        write_text(trials, _table(WildTrial.model_fields, map(dict, wild.per_trial)))
        write(wild, scores)
        bars = (*wild.bars, *wild.proposed.bars)
    else:
        record = trial_scores.scores_record(known)
        write_text(trials, _table(JudgedTrial.model_fields, map(_blind, record.per_trial)))
        write(record, scores)
        bars = (*record.bars, *record.proposed.bars)
    for bar in bars:
        print(_said(bar))


def _read_trials(verdicts: Sequence[Path], truths: Sequence[Path]) -> list[BlindTrial]:
    """Join verdicts and truths by the name of the trial, in the order of the truths.

    Raises:
        RecordError: when a file cannot be read, or a trial has not one of each.
    """
    from pa10cal.errors import RecordError
    from pa10cal.evaluation.blind_trial import BlindTrial
    from pa10cal.results.trials import TrialTruthRecord, TrialVerdictRecord

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
    return [BlindTrial(truth, records[name]) for name, truth in hidden.items()]


def _by_name(kind: type[_R], paths: Sequence[Path]) -> dict[str, _R]:
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


def _blind(trial: JudgedTrial) -> dict[str, object]:
    hidden = (
        f"{effect.id} of {effect.of} x{effect.size:.3g}"
        + ("" if effect.ratio is None else f", {effect.ratio:.3g} floors")
        + f": {effect.outcome}"
        for effect in trial.hidden
    )
    return {**dict(trial), "hidden": tuple(hidden)}


def _table(header: Iterable[str], rows: Iterable[dict[str, object]]) -> str:
    """Return one line a trial, lists joined."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    for row in rows:
        writer.writerow(
            "; ".join(value) if isinstance(value, tuple) else "" if value is None else value
            for value in row.values()
        )
    return text.getvalue()


def _said(bar: Bar) -> str:
    limit = f"{'at least' if bar.at_least else 'at most'} {_figure(bar.limit, bar.share)}"
    if bar.reached is None:
        return f"{bar.what}: no trial counts ({limit})"
    interval = ""
    if bar.low is not None and bar.high is not None:
        interval = f" ({_figure(bar.low, True)} to {_figure(bar.high, True)})"
    return (
        f"{bar.what}: {_figure(bar.reached, bar.share)}{interval} of {bar.trials} trials, {limit}: "
        + {"yes": "met", "no": "NOT met"}.get(bar.verdict, bar.verdict)
    )


def _figure(value: float, share: bool) -> str:
    return f"{100 * value:.1f} %" if share else f"{value:.3g}"
