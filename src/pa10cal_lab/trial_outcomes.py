"""Counts of outcomes of blind trials, by what these hide or put in."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import pandas as pd

from pa10cal_lab import trial_faults, trial_names
from pa10cal_lab import trial_records as results
from pa10cal_lab.blind_trial import DRIVES, OUTSIDE, WILD, BlindTrial
from pa10cal_lab.cell.measured_trials import MIXED, SORTED, SUBJECTS, UNSTATED

#: Columns of the table of trials that are counted for wild trials.
_COUNTED = ("crashed", "refused", "false_comfort", "worse", "unexplained")
#: Column of the table of trials that counts as a false name, by kind of wild trial: a confident one
#: where a fault or an effect outside the vocabulary may be taken for another effect.
_FALSE_NAME = {
    **dict.fromkeys(("effect", "right", "stressed"), "false_name"),
    **dict.fromkeys(("fault", "beyond"), "confident_false_name"),
    **dict.fromkeys((UNSTATED, SORTED), "wrong_name"),
    MIXED: "wrong_name_alone",
}
#: Kinds of trials whose hidden effects count; of other wild ones what is put in.
_HIDING_ONE, _HIDING = ("single", OUTSIDE), ("effect", "beyond")

#: An id under which a trial counts, and its outcomes.
_Counts = tuple[str, dict[str, int]]


def outcome_counts(
    trials: Sequence[BlindTrial], by_trial: pd.DataFrame
) -> tuple[results.OutcomeCounts, ...]:
    """Return counts of outcomes of what trials hide or put in, by kind of trial and id.

    Args:
        trials: trials of one study.
        by_trial: their table `trials`.
    """
    trial_count: Counter[tuple[str, str]] = Counter()
    counts: dict[tuple[str, str], Counter[str]] = {}
    for trial, row in zip(trials, by_trial.to_dict("records"), strict=True):
        for id, outcome in _outcomes(trial, row):
            trial_count[trial.kind, id] += 1
            counts.setdefault((trial.kind, id), Counter()).update(outcome)
    return tuple(
        results.OutcomeCounts(
            kind=kind, id=id, trials=trial_count[kind, id], counts=counts[kind, id]
        )
        for kind, id in sorted(counts)
    )


def _outcomes(t: BlindTrial, row: Mapping[Any, Any]) -> Iterator[_Counts]:
    """Yield the ids under which a trial counts, each with its outcomes; see `OutcomeCounts`."""
    if t.truth.measured == DRIVES:
        yield from _of_drives(t)
    elif t.truth.measured != WILD:
        if t.kind in _HIDING_ONE:
            yield t.hidden[0].id, {trial_names.outcome(t, t.hidden[0]): 1}
    else:
        counted = {name: row[name] for name in _COUNTED}
        counted |= {"false_name": row[_FALSE_NAME[t.kind]], "suspected": row["accused"]}
        of_kind = _of_hidden_effects if t.kind in SUBJECTS else _of_disturbances
        for id, further in of_kind(t):
            yield id, counted | further


def _of_drives(t: BlindTrial) -> Iterator[_Counts]:
    """Yield the outcome for each joint whose sensor or gear errs."""
    erroneous = () if t.kind == "neither" else t.hidden
    for joint in dict.fromkeys(hidden.of for hidden in erroneous):
        yield "joint", {trial_names.drive_outcome(t, joint): 1}


def _of_hidden_effects(t: BlindTrial) -> Iterator[_Counts]:
    """Yield, for each id that a trial hides, how many of its effects are told and found.

    In trials like measured robots an effect is told if it is listed, of those above the noise.
    """
    for id in _ids(t.hidden):
        hidden = [each for each in t.hidden if each.id == id]
        above = [each for each in hidden if t.is_detectable(each)]
        yield id, _told_and_found(t, [trial_names.is_listed(t, each) for each in above], hidden)


def _of_disturbances(t: BlindTrial) -> Iterator[_Counts]:
    """Yield, for each id that counts, how many faults are told and how many effects found.

    The ids are those of hidden effects, or else of what is put into the log. Faults are told if
    they are reported, of those that matter; each id has those of the whole trial.
    """
    told = [trial_faults.is_reported(t, each) for each in t.put_in if trial_faults.matters(t, each)]
    for id in _ids(t.hidden if t.kind in _HIDING else t.put_in):
        yield id, _told_and_found(t, told, t.hidden)


def _ids(entries: Iterable[results.HiddenEffect | results.TrialDisturbance]) -> list[str]:
    """Return the ids of effects or disturbances, each once; `nothing` where there are none."""
    return list(dict.fromkeys(each.id for each in entries)) or ["nothing"]


def _told_and_found(
    t: BlindTrial, told: Sequence[bool], hidden: Iterable[results.HiddenEffect]
) -> dict[str, int]:
    """Return how many are above the noise, how many of these told, and how many effects found."""
    found = sum(trial_names.is_listed(t, each) for each in hidden)
    return {"above_noise": len(told), "told": sum(told), "found": found}
