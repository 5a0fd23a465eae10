"""Command `score_trials`. Truths are read here alone."""

from __future__ import annotations

import csv
import io
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pa10cal.evaluation.blind_trial import BlindTrial
    from pa10cal.evaluation.trial_scores import Bar

_PROVENANCE = "synthetic: virtual cell, robots, poses, noise and hidden effects drawn at random"


def score_trials(
    *, verdicts: tuple[Path, ...], truths: tuple[Path, ...], scores: Path, trials: Path
) -> None:
    """Compare verdicts on blind trials with what was hidden.

    Args:
        verdicts: verdicts, one a trial (JSON lines).
        truths: what the trials hide, one a trial (JSON lines).
        scores: scores to write (.json).
        trials: table of trials to write (.csv).
    """
    from pa10cal.evaluation.trial_scores import bars
    from pa10cal.files.output import write_json, write_text
    from pa10cal.files.schemas import TRIALS
    from pa10cal.stages.trial_records import read_trials

    scored = read_trials(verdicts, truths)
    reached = bars(scored)
    rows = [_row(trial) for trial in scored]
    write_text(trials, _table(rows))
    write_json(
        scores,
        {
            "schema": TRIALS,
            "provenance": _PROVENANCE,
            "trials": len(scored),
            "failed": [
                {"campaign": trial.campaign, "kind": trial.kind, "message": trial.failed}
                for trial in scored
                if trial.failed is not None
            ],
            "bars": [{**asdict(bar), "met": bar.met} for bar in reached],
            **_scores(scored),
            "per_trial": rows,
        },
    )
    for bar in reached:
        print(_said(bar))


def _scores(trials: list[BlindTrial]) -> dict[str, Any]:
    import numpy as np

    from pa10cal.evaluation import trial_scores as scores
    from pa10cal.evaluation.blind_trial import OUTSIDE
    from pa10cal.evaluation.trial_intervals import intervals
    from pa10cal.evaluation.trial_outcomes import confusion, study_power

    singles, outside = (scores.of_kinds(trials, kind) for kind in ("single", OUTSIDE))
    gap = scores.score_gap(trials)
    calibration = intervals(trials)
    study = study_power(singles)
    seconds = [t.verdict.seconds for t in trials if t.verdict is not None]
    return {
        "nothing_hidden": {
            kind: _plain(scores.score_nothing_hidden(scores.of_kinds(trials, kind)))
            for kind in scores.NOTHING_HIDDEN
        },
        "single": _plain(scores.score_singles(singles)),
        "outside": _plain(scores.score_outside(outside)),
        "several": {
            kind: _plain(scores.score_several(scores.of_kinds(trials, kind)))
            for kind in scores.SEVERAL
        },
        "gap": None if gap is None else asdict(gap),
        "intervals": {
            "inside": _plain(calibration.inside),
            "rms": calibration.rms,
            "by_parameter": [
                {"id": effect, "parameter": parameter, **_plain(found)}
                for (effect, parameter), found in calibration.by_parameter.items()
            ],
            "scores": [asdict(score) for score in calibration.scores],
        },
        "confusion": {
            "single": {name: dict(counts) for name, counts in confusion(singles).items()},
            "outside": {name: dict(counts) for name, counts in confusion(outside).items()},
        },
        "power": {
            "by_id": {
                name: None if curve is None else asdict(curve)
                for name, curve in study.by_id.items()
            },
            "by_moved": None if study.by_moved is None else asdict(study.by_moved),
            "bins": [_plain(entry) for entry in study.bins],
        },
        "seconds": {
            "median": float(np.median(seconds)) if seconds else None,
            "longest": max(seconds, default=None),
        },
    }


def _plain(found: Any) -> dict[str, Any]:
    """Return a result as a mapping, every rate with its share."""
    from dataclasses import fields

    from pa10cal.evaluation.trial_rates import Rate

    if isinstance(found, Rate):
        return {**asdict(found), "share": found.share}
    plain = {}
    for field in fields(found):
        value = getattr(found, field.name)
        plain[field.name] = _plain(value) if isinstance(value, Rate) else value
    return plain


def _row(trial: BlindTrial) -> dict[str, Any]:
    from pa10cal.evaluation.trial_outcomes import FAILED, outcome

    verdict = trial.verdict
    return {
        "campaign": trial.campaign,
        "kind": trial.kind,
        "layout": trial.layout,
        "path": trial.path,
        "hidden": [
            {
                "id": hidden.name.id,
                "of": hidden.name.of,
                "size": hidden.size,
                "ratio": trial.ratio(hidden),
                "testable": trial.is_testable(hidden),
                "separable": trial.is_separable(hidden),
                "moves_poses": trial.moves_poses(hidden),
                "listed": trial.lists(hidden),
                "outcome": outcome(trial, hidden),
            }
            for hidden in trial.hidden
        ],
        "verdict": FAILED if verdict is None else verdict.word,
        "named": [
            " or ".join(f"{name.id} of {name.of}" for name in named.all_names)
            for named in (() if verdict is None else verdict.effects)
        ],
        "places": [place or "unknown" for place in (() if verdict is None else verdict.places)],
        "extra": trial.extra(),
        "held_out_after_mm": None if verdict is None else verdict.held_out_after_mm,
        "noise_floor_mm": None if verdict is None else verdict.noise_floor_mm,
        "seconds": None if verdict is None else verdict.seconds,
    }


def _table(rows: list[dict[str, Any]]) -> str:
    """Return one line a trial, lists joined."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(rows[0])
    for row in rows:
        hidden = "; ".join(
            f"{entry['id']} of {entry['of']} x{entry['size']:.3g}"
            + ("" if entry["ratio"] is None else f", {entry['ratio']:.3g} floors")
            + f": {entry['outcome']}"
            for entry in row["hidden"]
        )
        flat = {**row, "hidden": hidden}
        writer.writerow(
            "; ".join(value) if isinstance(value, list) else "" if value is None else value
            for value in flat.values()
        )
    return text.getvalue()


def _said(bar: Bar) -> str:
    """Return a bar in one line."""
    limit = f"{'at least' if bar.at_least else 'at most'} {_figure(bar.limit, bar.share)}"
    if bar.reached is None:
        return f"{bar.what}: no trial tells ({limit})"
    interval = ""
    if bar.low is not None and bar.high is not None:
        interval = f" ({_figure(bar.low, True)} to {_figure(bar.high, True)})"
    return (
        f"{bar.what}: {_figure(bar.reached, bar.share)}{interval} of {bar.trials} trials, {limit}: "
        + ("met" if bar.met else "NOT met")
    )


def _figure(value: float, share: bool) -> str:
    return f"{100 * value:.1f} %" if share else f"{value:.3g}"
