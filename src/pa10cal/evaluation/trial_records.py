"""`scores.json` of a study of blind trials."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pa10cal.evaluation import trial_scores as scores
from pa10cal.evaluation.blind_trial import OUTSIDE, BlindTrial
from pa10cal.evaluation.formula_scores import score_formulas
from pa10cal.evaluation.trial_intervals import intervals
from pa10cal.evaluation.trial_outcomes import FAILED, confusion, outcome, study_power
from pa10cal.results.trials import (
    Confusion,
    Failure,
    JudgedEffect,
    JudgedTrial,
    Seconds,
    TrialScoresRecord,
)

_PROVENANCE = "synthetic: virtual cell, robots, poses, noise and hidden effects drawn at random"


def scores_record(trials: Sequence[BlindTrial]) -> TrialScoresRecord:
    """Return what many trials come to."""
    singles, outside = (scores.of_kinds(trials, kind) for kind in ("single", OUTSIDE))
    seconds = [t.verdict.seconds for t in trials if t.verdict is not None]
    return TrialScoresRecord(
        provenance=_PROVENANCE,
        trials=len(trials),
        failed=tuple(
            Failure(campaign=trial.campaign, kind=trial.kind, message=trial.failed)
            for trial in trials
            if trial.failed is not None
        ),
        bars=scores.bars(trials),
        nothing_hidden={
            kind: scores.score_nothing_hidden(scores.of_kinds(trials, kind))
            for kind in scores.NOTHING_HIDDEN
        },
        single=scores.score_singles(singles),
        outside=scores.score_outside(outside),
        several={
            kind: scores.score_several(scores.of_kinds(trials, kind)) for kind in scores.SEVERAL
        },
        gap=scores.score_gap(trials),
        intervals=intervals(trials),
        confusion=Confusion(
            single={name: dict(counts) for name, counts in confusion(singles).items()},
            outside={name: dict(counts) for name, counts in confusion(outside).items()},
        ),
        proposed=score_formulas(trials),
        power=study_power(singles),
        seconds=Seconds(
            median=float(np.median(seconds)) if seconds else None,
            longest=max(seconds, default=None),
        ),
        per_trial=tuple(map(_judged, trials)),
    )


def _judged(trial: BlindTrial) -> JudgedTrial:
    """Return what became of a trial."""
    verdict = trial.verdict
    return JudgedTrial(
        campaign=trial.campaign,
        kind=trial.kind,
        layout=trial.layout,
        path=trial.path,
        hidden=tuple(
            JudgedEffect(
                id=hidden.name.id,
                of=hidden.name.of,
                size=hidden.size,
                ratio=trial.ratio(hidden),
                testable=trial.is_testable(hidden),
                separable=trial.is_separable(hidden),
                moves_poses=trial.moves_poses(hidden),
                listed=trial.lists(hidden),
                outcome=outcome(trial, hidden),
            )
            for hidden in trial.hidden
        ),
        verdict=FAILED if verdict is None else verdict.word,
        named=tuple(
            " or ".join(f"{name.id} of {name.of}" for name in named.all_names)
            for named in (() if verdict is None else verdict.effects)
        ),
        places=tuple(place or "unknown" for place in (() if verdict is None else verdict.places)),
        extra=trial.extra(),
        held_out_after_mm=None if verdict is None else verdict.held_out_after_mm,
        noise_floor_mm=None if verdict is None else verdict.noise_floor_mm,
        seconds=None if verdict is None else verdict.seconds,
    )
