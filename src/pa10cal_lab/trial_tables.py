"""Blind trials as tables: a row for each trial, hidden effect, fault, parameter or claim.

`trial_quantities` evaluates figures in them. In trials like measured robots
(`cell.measured_trials`) the residual by a hidden effect is that of the truth, after the geometry is
fitted again, since springs of a calibrated model may absorb the effect.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal, TypeGuard

import numpy as np
import pandas as pd
from scipy.special import ndtri

from pa10cal_lab import trial_faults, trial_names
from pa10cal_lab import trial_records as results
from pa10cal_lab.blind_trial import MAP, OUTSIDE, BlindTrial

TableName = Literal["trials", "effects", "faults", "parameters", "claims"]
#: Level of the intervals of reported parameters.
_LEVEL = 0.95
#: Edges of the bins in which claimed probabilities are compared with observed shares.
CLAIM_EDGES = (0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 1.0)
#: Least probability whose logarithm is scored.
_LEAST_PROBABILITY = 1e-4


def tables_of(trials: Sequence[BlindTrial]) -> dict[TableName, pd.DataFrame]:
    """Return trials as tables.

    `held_over_null` is the held-out error over the mean of trials of the layout that hide nothing;
    nan where none does, as `without_null` tells.
    """
    by_trial = pd.DataFrame([_trial_row(t) for t in trials])
    if len(by_trial):
        null = by_trial[by_trial["kind"] == "null"].groupby("layout")["held_out_mm"].mean()
        null_mm = by_trial["layout"].map(null)
        by_trial["held_over_null"] = by_trial["held_out_mm"] / null_mm
        by_trial["without_null"] = null_mm.isna()
    inside = ndtri(0.5 + _LEVEL / 2.0)
    return {
        "trials": by_trial,
        "effects": pd.DataFrame([row for t in trials for row in _effect_rows(t)]),
        "claims": pd.DataFrame([row for t in trials for row in _claim_rows(t)]),
        "faults": pd.DataFrame([row for t in trials for row in _fault_rows(t)]),
        "parameters": pd.DataFrame(
            dict(score, name=f"{score.id} {score.parameter}", inside=abs(score.score) <= inside)
            for score in parameter_scores(trials)
        ),
    }


def _trial_row(t: BlindTrial) -> dict[str, Any]:
    """Return the row of a trial in the table of trials."""
    return _about(t) | _names_row(t) | _wrong_names_row(t) | _faults_row(t) | _predicted_row(t)


def _about(t: BlindTrial) -> dict[str, Any]:
    """Return what a trial is, and whether it has a verdict."""
    verdict = t.verdict
    return {
        "campaign": t.truth.campaign,
        "kind": t.kind,
        "layout": t.truth.layout,
        "judged": verdict is not None,
        "crashed": verdict is None and not t.refused,
        "refused": t.refused,
        "unexplained": verdict is not None and verdict.word == "unexplained",
        "word": t.judgement.word if verdict is not None else "",
        "hides": len(t.hidden),
        "first": t.hidden[0].id if t.hidden else "",
    }


def _names_row(t: BlindTrial) -> dict[str, Any]:
    """Return how names and formulas of a trial compare with what it hides."""
    above_limit = [hidden for hidden in t.to_be_named if t.is_above(hidden)]
    return {
        "names": len(t.effects),
        "right_place": t.kind == OUTSIDE and trial_names.has_right_place(t),
        "all_listed": trial_names.matched_count(t, t.to_be_named) == len(t.to_be_named),
        "all_testable": all(map(t.is_testable, t.to_be_named)),
        "has_above": bool(above_limit),
        "above_listed": trial_names.matched_count(t, above_limit) == len(above_limit),
        "outside": trial_names.hides_only_nameless(t),
        "nothing_outside": trial_names.hides_only_named(t),
        "right_formula": trial_names.proposes(t, right=True),
        "wrong_formula": trial_names.proposes(t, right=False),
        "among": "a background" if any(each.outside for each in t.hidden) else "nothing else",
    }


def _wrong_names_row(t: BlindTrial) -> dict[str, Any]:
    """Return what is named that a trial does not hide; each column counts something else as wrong.

    A finding is right where its name or one of its alternatives is hidden; a sure name, of a
    probability of 0.95 or more, where the name itself is.
    """
    hidden_names = {hidden.name for hidden in t.hidden}
    no_springs, no_background = trial_names.without_springs(t), trial_names.without_background(t)
    confidently_wrong = trial_names.is_confidently_wrong
    return {
        # Number of findings beyond those that can be paired with hidden effects.
        "extra": trial_names.extra_count(t),
        # The same without findings that describe the background.
        "named_beside": trial_names.extra_count(no_background),
        # Whether any is left without springs that the arm has.
        "false_name": trial_names.extra_count(no_springs) > 0,
        # Whether a finding is wrong, be it a pair of another with a hidden effect or not.
        "wrong_name": trial_names.has_finding_of_nothing(t),
        # Whether a finding other than a map is wrong.
        "false_drive_name": any(
            effect.id != MAP and hidden_names.isdisjoint(effect.all_names) for effect in t.effects
        ),
        # Whether a sure name is wrong in a verdict `named`; a map of a true error is not.
        "confidently_wrong": confidently_wrong(t),
        # The same in a verdict `named` or `check_the_log`, without springs that the arm has.
        "confident_false_name": confidently_wrong(no_springs, trial_faults.CHECK),
        # Whether a sure name is wrong, whatever the verdict, without findings of the background.
        "wrong_name_alone": trial_names.has_sure_wrong_name(no_background),
    }


def _faults_row(t: BlindTrial) -> dict[str, Any]:
    """Return what was put into the log of a trial, and what is said of the log."""
    return {
        "has_fault": trial_faults.has_fault(t),
        "undisturbed": not any(each.kinds or each.measured for each in t.put_in),
        "disturbed": trial_faults.hides_much(t)
        or any(trial_faults.matters(t, each) for each in t.put_in),
        "false_comfort": trial_faults.has_false_comfort(t),
        "worse": t.predicts_worse,
        "accused": trial_faults.suspects_data(t),
        "motion_as_fact": bool(trial_faults.motions_as_facts(t)),
    }


def _predicted_row(t: BlindTrial) -> dict[str, Any]:
    """Return what a verdict says without names, its held-out error, and the time it took."""
    verdict = t.verdict
    if verdict is None:
        row: dict[str, Any] = dict.fromkeys(("says_something", "nameless"), False)
        return row | dict.fromkeys(("held_out_mm", "seconds", "whole_seconds"), np.nan)
    maps = any(effect.id in (MAP, trial_names.LINE) for effect in t.effects)
    return {
        "says_something": verdict.says_something,
        "nameless": bool(verdict.places) or maps,
        "held_out_mm": verdict.held_out_after_mm or np.nan,
        "seconds": verdict.seconds,
        "whole_seconds": verdict.seconds + verdict.seconds_simulating + t.truth.seconds_twin,
    }


def _effect_rows(t: BlindTrial) -> Iterator[dict[str, Any]]:
    """Yield the rows of a trial in the table of hidden effects."""
    for k, hidden in enumerate(t.hidden):
        named = trial_names.is_named(t, hidden)
        alternatives = trial_names.alternative_count(t, hidden)
        yield dict(judged_effect(t, hidden)) | {
            "campaign": t.truth.campaign,
            "kind": t.kind,
            "to_be_named": not hidden.outside,
            "judged": t.verdict is not None,
            "says_something": t.verdict is not None and t.verdict.says_something,
            "first_at_place": all(other.of != hidden.of for other in t.hidden[:k]),
            "ratio": t.ratio(hidden) or np.nan,
            "apart": t.ratio(hidden, partial=True) or np.nan,
            "moved": t.moved_over_floor(hidden) or 0.0,
            "named": named,
            "place_told": trial_names.is_place_found(t, hidden),
            "alternatives": np.nan if alternatives is None else alternatives,
            "alone": named and alternatives == 0 and not trial_names.extra_count(t),
        }


def _fault_rows(t: BlindTrial) -> Iterator[dict[str, Any]]:
    """Yield the rows of a trial in the table of stressors and faults."""
    for put_in in t.put_in:
        yield {
            "campaign": t.truth.campaign,
            "has_fault": trial_faults.has_fault(t),
            "matters": trial_faults.matters(t, put_in),
            "told": trial_faults.is_reported(t, put_in),
        }


def _claim_rows(t: BlindTrial) -> Iterator[dict[str, Any]]:
    """Yield the rows of a trial in the table of claimed probabilities."""
    for claim in trial_names.claims(t):
        above = int(np.searchsorted(CLAIM_EDGES, claim.probability, "right"))
        above = min(max(above, 1), len(CLAIM_EDGES) - 1)
        off = 1.0 - claim.probability if claim.right else claim.probability
        yield {
            "campaign": t.truth.campaign,
            "kind": t.kind,
            "of": claim.of,
            "probability": claim.probability,
            "right": claim.right,
            "bin": f"{CLAIM_EDGES[above - 1]:.2f} to {CLAIM_EDGES[above]:.2f}",
            "brier": off**2,
            "log_score": float(np.log(max(1.0 - off, _LEAST_PROBABILITY))),
        }


def judged_effect(t: BlindTrial, hidden: results.HiddenEffect) -> results.JudgedEffect:
    """Return the record of how a hidden effect was judged."""
    return results.JudgedEffect(
        id=hidden.id,
        of=hidden.of,
        size=hidden.size,
        ratio=t.ratio(hidden),
        testable=t.is_testable(hidden),
        separable=t.is_separable(hidden),
        moves_poses=t.moves_poses(hidden),
        listed=trial_names.is_listed(t, hidden),
        outcome=trial_names.outcome(t, hidden),
    )


# Reported parameters of effects compared with those hidden.

_AXES = "xyz"


def parameter_scores(trials: Iterable[BlindTrial]) -> Iterator[results.ParameterScore]:
    """Yield the errors, over their standard uncertainties, of parameters of rightly named effects.

    Phases differ modulo a turn, for amplitudes of the same sign. Maps are omitted: cell and
    estimator have different knots, and calibration absorbs their mean.
    """
    for trial in trials:
        for hidden, named in itertools.product(trial.hidden, trial.effects):
            if named.name != hidden.name or hidden.id == MAP:
                continue
            truth = true_parameters(hidden)
            for name, reported in named.parameters.items():
                if name in truth and reported.std > 0.0:
                    error = reported.value - truth[name]
                    error = float(np.angle(np.exp(1j * error))) if name == "phi" else error
                    score = error / reported.std
                    yield results.ParameterScore(id=named.id, parameter=name, score=score)


def true_parameters(hidden: results.HiddenEffect) -> dict[str, float]:
    """Return parameters of a hidden effect by their names in a verdict, amplitudes positive."""
    flat: dict[str, float] = {}
    known: Mapping[str, object] = hidden.parameters
    for name, value in known.items():
        if _is_number(value):
            flat[name] = float(value)
        elif isinstance(value, Sequence) and len(value) == len(_AXES):
            axes = zip(_AXES, value, strict=True)
            flat |= {f"{name}_{axis}": float(v) for axis, v in axes if _is_number(v)}
    if "phi" in flat and flat.get("A", 0.0) < 0.0:
        flat |= {"A": -flat["A"], "phi": flat["phi"] + np.pi}
    return flat


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool)
