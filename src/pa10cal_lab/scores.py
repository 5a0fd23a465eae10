"""Scores of many blind trials: rates of right and wrong names, against the targets to reach.

They are figures of the tables of trials (`trial_quantities`, `trial_tables`), counts of outcomes
(`trial_outcomes`), the statistical power (`trial_power`), and the trials one by one.
"""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from pa10cal.errors import RecordError
from pa10cal_lab import trial_names
from pa10cal_lab import trial_records as results
from pa10cal_lab.blind_trial import DRIVES, OUTSIDE, TRACKED, WILD, BlindTrial
from pa10cal_lab.cell.measured_trials import MIXED, SORTED, UNSTATED
from pa10cal_lab.cell.trials import WILD_KINDS
from pa10cal_lab.trial_outcomes import outcome_counts
from pa10cal_lab.trial_power import study_power
from pa10cal_lab.trial_quantities import quantities
from pa10cal_lab.trial_tables import judged_effect, parameter_scores, tables_of

_AS_MEASURED = "arms, their lengths, weights and springs, poses, noise and hidden effects"
#: What is drawn at random in the trials of each study.
_DRAWN = {
    **dict.fromkeys(("touched", TRACKED), "robots, poses, noise and hidden effects"),
    WILD: "robots, poses, noise, stressors, faults and hidden effects",
    **dict.fromkeys(("unstated", "sorted"), _AS_MEASURED),
    "mixed": "arms, their lengths and weights, poses, noise and hidden effects",
    DRIVES: "robots, poses, noise, errors of drives and ripple",
}
#: Largest number of characters that the scores quote of a verdict.
_MOST_QUOTED = 200


def scores_record(trials: Sequence[BlindTrial]) -> results.TrialScoresRecord:
    """Return the scores of trials of one study.

    Raises:
        RecordError: when trials are of several studies or of an unknown one, or when one of them
            cannot be scored.
    """
    study = _study_of(trials)
    for trial in trials:
        _check(trial)
    tables = tables_of(trials)
    rows_of: dict[tuple[str, str], pd.DataFrame] = {}  # shared by figures of the same rows
    scores: list[results.ScoreRow] = []
    failings: dict[str, dict[str, None]] = {}
    for quantity in quantities():
        if study not in quantity.studies.split():
            continue
        selection = quantity.table, quantity.where
        if selection not in rows_of:
            rows_of[selection] = quantity.rows(tables)
        rows = quantity.valued(rows_of[selection])
        scores += quantity.scores(rows)
        if quantity.failing:
            against = rows["value"].astype(bool) == bool(quantity.at_most)
            for campaign in rows.loc[against, "campaign"]:
                failings.setdefault(campaign, {})[quantity.failing] = None
    return results.TrialScoresRecord(
        provenance=f"synthetic: virtual cell; {_DRAWN[study]} drawn at random",
        measured=trials[0].truth.measured if trials else "",
        trials=len(trials),
        bars=tuple(score for score in scores if score.limit is not None),
        rates=tuple(score for score in scores if score.limit is None),
        subjects=outcome_counts(trials, tables["trials"]),
        parameter_scores=tuple(parameter_scores(trials)),
        power=study_power(tables["effects"]),
        per_trial=tuple(
            _judged_trial(t, tuple(failings.get(t.truth.campaign, ()))) for t in trials
        ),
    )


def _study_of(trials: Sequence[BlindTrial]) -> str:
    """Return the study of trials, as `scores.csv` calls it; `touched` without trials.

    Raises:
        RecordError: when they are of several studies, or of an unknown one.
    """
    campaigns = {_study(trial): trial.truth.campaign for trial in trials} or {"touched": ""}
    known = [study for study in campaigns if study in _DRAWN]
    if len(campaigns) > 1 or not known:
        raise RecordError(
            "trials are not those of one study",
            where="truths of trials",
            value=", ".join(f"{study or 'none'}: {each}" for study, each in campaigns.items()),
            allowed=f"trials of one study, of {', '.join(_DRAWN)}",
            remedy="score the files of each study by themselves",
        )
    return known[0]


def _study(trial: BlindTrial) -> str:
    """Return the study of a trial, as `scores.csv` calls it; of an unknown one its own word."""
    measured, kind = trial.truth.measured, trial.kind
    if measured != WILD:
        return measured
    studies = {UNSTATED: "unstated", SORTED: "sorted", MIXED: MIXED}
    return studies.get(kind, measured if kind in WILD_KINDS else kind)


def _check(trial: BlindTrial) -> None:
    """Refuse a trial whose figures are not defined.

    Raises:
        RecordError: when it hides nothing though its kind is to hide an effect, when the size of an
            effect is not above 0, or when its noise is none.
    """
    hides_one = trial.truth.measured not in (WILD, DRIVES) and trial.kind in ("single", OUTSIDE)
    floor_mm = None if trial.verdict is None else trial.verdict.gap.noise_floor_mm
    faults = {
        f"a trial of kind {trial.kind} hides nothing": hides_one and not trial.hidden,
        "the size of a hidden effect is not above 0": any(not h.size > 0.0 for h in trial.hidden),
        "the noise of a trial is 0": 0.0 in (floor_mm, trial.truth.noise_mm),
    }
    for fault in (text for text, found in faults.items() if found):
        raise RecordError(
            fault,
            where=f"trial {trial.truth.campaign}",
            allowed="verdicts and truths as pa10cal blind_trials writes them",
            remedy="run these trials again",
        )


def _judged_trial(t: BlindTrial, failings: tuple[str, ...]) -> results.JudgedTrial:
    """Return the row of a trial in the scores.

    Args:
        failings: what counts against targets.
    """
    verdict = t.verdict
    failed = "refused" if t.refused else trial_names.FAILED
    return results.JudgedTrial(
        campaign=t.truth.campaign,
        kind=t.kind,
        layout=t.truth.layout,
        path=t.truth.path,
        hidden=tuple(judged_effect(t, hidden) for hidden in t.hidden),
        put_in=tuple(f"{each.id} at {', '.join(each.where)}" for each in t.put_in),
        verdict=failed if verdict is None else verdict.word,
        said=_summary(t)[:_MOST_QUOTED],
        named=tuple(effect.either for effect in t.effects),
        places=tuple(place or "unknown" for place in (() if verdict is None else verdict.places)),
        extra=trial_names.extra_count(t),
        failings=failings,
        held_out_after_mm=None if verdict is None else verdict.held_out_after_mm,
        noise_floor_mm=None if verdict is None else verdict.gap.noise_floor_mm,
        seconds=None if verdict is None else verdict.seconds,
    )


def _summary(t: BlindTrial) -> str:
    """Return verdict, grade, names and faults in words, or why there is none."""
    if t.verdict is None:
        reason = getattr(t.judgement, "failed", "")
        return f"{'refused' if t.refused else 'crashed'}: {reason}"
    names = (effect.either for effect in t.effects)
    faults = (f"{fault.kind} of {fault.where}" for fault in t.verdict.faults)
    return "; ".join([f"{t.verdict.word}, {t.verdict.grade}", *names, *faults])
