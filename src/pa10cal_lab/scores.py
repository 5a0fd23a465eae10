"""Scores of many blind trials: rates of right and wrong names, against the targets to reach.

Trials become tables with a row for each trial, hidden effect, fault, reported parameter, or claimed
probability. `scores.csv` defines the figures: the table, which rows count, what is evaluated in
them, and the target. In trials like measured robots (`cell.measured_trials`) the residual by a
hidden effect is that of the truth, after the geometry is fitted again, since springs of a
calibrated model may absorb the effect.
"""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import ndtri
from scipy.stats import binomtest

from pa10cal.arrays import Array
from pa10cal_lab import trial_faults, trial_names
from pa10cal_lab import trial_records as results
from pa10cal_lab.blind_trial import (
    DETECTABLE_RATIO,
    DRIVES,
    LARGE_RATIO,
    MAP,
    OUTSIDE,
    TRACKED,
    WILD,
    BlindTrial,
)
from pa10cal_lab.cell.measured_trials import MIXED, SORTED, SUBJECTS, UNSTATED

#: Level of confidence intervals, and of the power at which an effect counts as found surely.
LEVEL = 0.95
_AS_MEASURED = "arms, their lengths, weights and springs, poses, noise and hidden effects"
#: What is drawn at random in the trials of each study.
_DRAWN = {
    **dict.fromkeys(("touched", TRACKED), "robots, poses, noise and hidden effects"),
    WILD: "robots, poses, noise, stressors, faults and hidden effects",
    **dict.fromkeys(("unstated", "sorted"), _AS_MEASURED),
    "mixed": "arms, their lengths and weights, poses, noise and hidden effects",
    DRIVES: "robots, poses, noise, errors of drives and ripple",
}

TableName = Literal["trials", "effects", "faults", "parameters", "claims"]
#: Edges of the bins in which claimed probabilities are compared with observed shares.
CLAIM_EDGES = (0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 1.0)
#: Least probability whose logarithm is scored.
_LEAST_PROBABILITY = 1e-4


def tables_of(trials: Sequence[BlindTrial]) -> dict[TableName, pd.DataFrame]:
    """Return trials as tables.

    `held_over_null` is the held-out error over the mean of trials of the layout that hide nothing.
    """
    by_trial = pd.DataFrame([_trial_row(t) for t in trials])
    if len(by_trial):
        null = by_trial[by_trial["kind"] == "null"].groupby("layout")["held_out_mm"].mean()
        by_trial["held_over_null"] = by_trial["held_out_mm"] / by_trial["layout"].map(null)
    inside = ndtri(0.5 + LEVEL / 2.0)
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
    return _about(t) | _names_row(t) | _faults_row(t) | _predicted_row(t)


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
    without_springs = trial_names.without_springs(t)
    without_background = trial_names.without_background(t)
    above_limit = [hidden for hidden in t.to_be_named if t.is_above(hidden)]
    hidden_names = {hidden.name for hidden in t.hidden}
    return {
        "names": len(t.effects),
        "extra": trial_names.extra_count(t),
        "confidently_wrong": trial_names.is_confidently_wrong(t),
        "right_place": t.kind == OUTSIDE and trial_names.has_right_place(t),
        "all_listed": trial_names.matched_count(t, t.to_be_named) == len(t.to_be_named),
        "all_testable": all(map(t.is_testable, t.to_be_named)),
        "has_above": bool(above_limit),
        "above_listed": trial_names.matched_count(t, above_limit) == len(above_limit),
        "outside": trial_names.is_outside(t),
        "right_formula": trial_names.proposes(t, right=True),
        "wrong_formula": trial_names.proposes(t, right=False),
        "false_name": trial_names.extra_count(without_springs) > 0,
        "confident_false_name": trial_names.is_confidently_wrong(
            without_springs, trial_faults.CHECK
        ),
        "wrong_name": trial_names.has_wrong_name(t),
        "among": "a background" if any(each.outside for each in t.hidden) else "nothing else",
        "named_beside": trial_names.extra_count(without_background),
        "wrong_name_alone": trial_names.has_wrong_name_alone(without_background),
        "false_drive_name": any(
            effect.id != MAP and hidden_names.isdisjoint(effect.all_names) for effect in t.effects
        ),
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
        yield dict(_judged_effect(t, hidden)) | {
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


_STATISTICS: dict[str, Callable[[Array], Any]] = {
    "mean": np.mean,
    "median": np.median,
    "largest": np.max,
    "quantile_95": lambda x: np.quantile(x, 0.95),
    "rms": lambda x: np.sqrt(np.mean(x**2)),
    "per_hour": lambda seconds: 2.0 * 3600.0 / np.mean(seconds),  # on two cores
}


class Quantity(NamedTuple):
    """A figure of a table, a share or another statistic; a row of `scores.csv`."""

    studies: str  # names of the studies that have it
    what: str
    table: TableName
    where: str  # which rows count, an expression of columns; empty for all
    value: str  # the value of a row, an expression of columns
    statistic: str  # `share`, or one of `_STATISTICS`
    at_least: str  # target; empty without
    at_most: str  # target in the other direction; empty without
    failing: str  # failing of a trial whose value counts against the target; empty for none
    by: str  # column of groups, each of which has a figure of its own; empty for none

    def rows(self, tables: Mapping[TableName, pd.DataFrame]) -> pd.DataFrame:
        """Return the rows that count."""
        rows = tables[self.table]
        return rows if rows.empty or not self.where else rows[_evaluated(rows, self.where)]

    def valued(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Return the rows with a column `value`, those without a value left out."""
        if rows.empty:
            return pd.DataFrame(columns=["campaign", "value", self.by])
        return rows.assign(value=_evaluated(rows, self.value)).dropna(subset=["value"])

    def score(self, values: Array, by: str = "") -> results.ScoreRow:
        """Return the figure of values, compared with the target."""
        figure: dict[str, Any] = dict.fromkeys(("count", "reached", "low", "high"))
        if self.statistic == "share":
            figure = share_of(values)
        elif len(values):
            figure["reached"] = float(_STATISTICS[self.statistic](values.astype(float)))
        at_least, limit, met = None, None, None
        if self.at_least or self.at_most:
            at_least, limit = bool(self.at_least), float(self.at_least or self.at_most)
            if figure["reached"] is not None:
                met = figure["reached"] >= limit if at_least else figure["reached"] <= limit
        return results.ScoreRow(
            what=self.what,
            by=by,
            at_least=at_least,
            limit=limit,
            trials=len(values),
            share=self.statistic == "share",
            met=met,
            **figure,
        )

    def scores(self, rows: pd.DataFrame) -> list[results.ScoreRow]:
        """Return the figure of rows with values, or one for each group."""
        if not self.by:
            return [self.score(rows["value"].to_numpy())]
        groups = rows.groupby(self.by)["value"]
        return [self.score(values.to_numpy(), str(by)) for by, values in groups]


def _evaluated(rows: pd.DataFrame, expression: str) -> Any:
    """Return an expression of columns; without the other columns it is evaluated faster."""
    if expression in rows:  # most are one column: to read an expression takes milliseconds
        return rows[expression]
    words = set(re.findall(r"\w+", expression))
    return rows[[name for name in rows if name in words]].eval(expression)


@cache
def quantities() -> tuple[Quantity, ...]:
    """Return all figures, in the order of `scores.csv`."""
    table = pd.read_csv(Path(__file__).with_name("scores.csv"), dtype=str, keep_default_na=False)
    return tuple(Quantity(*row) for row in table.itertuples(index=False))


def share_of(outcomes: Collection[Any]) -> dict[str, Any]:
    """Return the number and the share of true outcomes, and its exact confidence interval."""
    if not len(outcomes):
        return {"count": 0, "reached": None, "low": 0.0, "high": 1.0}
    count, total = sum(map(bool, outcomes)), len(outcomes)
    low, high = binomtest(count, total).proportion_ci(LEVEL, method="exact")
    return {"count": count, "reached": count / total, "low": float(low), "high": float(high)}


def _study(trial: BlindTrial) -> str:
    """Return the study of a trial, as `scores.csv` calls it."""
    studies = {UNSTATED: "unstated", SORTED: "sorted", MIXED: MIXED}
    return studies.get(trial.kind, trial.truth.measured)


def scores_record(trials: Sequence[BlindTrial]) -> results.TrialScoresRecord:
    """Return the scores of trials of one study."""
    tables = tables_of(trials)
    studies = {_study(trial) for trial in trials} or {"touched"}
    rows_of: dict[tuple[str, str], pd.DataFrame] = {}  # shared by figures of the same rows
    scores: list[results.ScoreRow] = []
    failings: dict[str, dict[str, None]] = {}
    for quantity in quantities():
        if studies.isdisjoint(quantity.studies.split()):
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
        provenance=f"synthetic: virtual cell; {_DRAWN[max(studies)]} drawn at random",
        measured=trials[0].truth.measured if trials else "",
        trials=len(trials),
        bars=tuple(score for score in scores if score.limit is not None),
        rates=tuple(score for score in scores if score.limit is None),
        subjects=_subjects(trials, tables["trials"]),
        parameter_scores=tuple(parameter_scores(trials)),
        power=study_power(tables["effects"]),
        per_trial=tuple(
            _judged_trial(t, tuple(failings.get(t.truth.campaign, ()))) for t in trials
        ),
    )


# Each trial and its hidden effects, as the record of scores has them.

#: Largest number of characters that the scores quote of a verdict.
_MOST_QUOTED = 200


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
        hidden=tuple(_judged_effect(t, hidden) for hidden in t.hidden),
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


def _judged_effect(t: BlindTrial, hidden: results.HiddenEffect) -> results.JudgedEffect:
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


def _summary(t: BlindTrial) -> str:
    """Return verdict, grade, names and faults in words, or why there is none."""
    if t.verdict is None:
        reason = getattr(t.judgement, "failed", "")
        return f"{'refused' if t.refused else 'crashed'}: {reason}"
    names = (effect.either for effect in t.effects)
    faults = (f"{fault.kind} of {fault.where}" for fault in t.verdict.faults)
    return "; ".join([f"{t.verdict.word}, {t.verdict.grade}", *names, *faults])


# Counts of outcomes by what trials hide or put in.

#: Columns of the table of trials that are counted for wild trials.
_COUNTED = ("crashed", "refused", "false_comfort", "worse", "unexplained")


def _subjects(
    trials: Sequence[BlindTrial], by_trial: pd.DataFrame
) -> tuple[results.OutcomeCounts, ...]:
    """Return counts of outcomes of what trials hide or put in, by kind of trial and id."""
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


def _outcomes(t: BlindTrial, row: Mapping[Any, Any]) -> Iterator[tuple[str, Mapping[str, int]]]:
    """Yield the ids under which a trial counts, each with its outcomes; see `OutcomeCounts`."""
    if t.truth.measured == DRIVES:
        erroneous = () if t.kind == "neither" else t.hidden
        for joint in dict.fromkeys(hidden.of for hidden in erroneous):
            yield "joint", {trial_names.drive_outcome(t, joint): 1}
        return
    if t.truth.measured != WILD:
        if t.kind in ("single", OUTSIDE):
            yield t.hidden[0].id, {trial_names.outcome(t, t.hidden[0]): 1}
        return
    as_measured = t.kind in SUBJECTS
    if t.kind == MIXED:
        false_name = "wrong_name_alone"
    elif as_measured:
        false_name = "wrong_name"
    elif t.kind in ("effect", "right", "stressed"):
        false_name = "false_name"
    else:
        false_name = "confident_false_name"
    counted = {name: row[name] for name in _COUNTED}
    counted |= {"false_name": row[false_name], "suspected": row["accused"]}
    by_effect = as_measured or t.kind in ("effect", "beyond")
    ids = [each.id for each in (t.hidden if by_effect else t.put_in)]
    for id in dict.fromkeys(ids or ["nothing"]):
        hidden = [each for each in t.hidden if not as_measured or each.id == id]
        told = [
            trial_faults.is_reported(t, each) for each in t.put_in if trial_faults.matters(t, each)
        ]
        if as_measured:
            told = [trial_names.is_listed(t, each) for each in hidden if t.is_detectable(each)]
        found = sum(trial_names.is_listed(t, each) for each in hidden)
        yield id, counted | {"above_noise": len(told), "told": sum(told), "found": found}


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
        if isinstance(value, Sequence) and len(value) == len(_AXES):
            flat |= {f"{name}_{axis}": float(v) for axis, v in zip(_AXES, value, strict=True)}
        elif isinstance(value, int | float):
            flat[name] = float(value)
    if "phi" in flat and flat.get("A", 0.0) < 0.0:
        flat |= {"A": -flat["A"], "phi": flat["phi"] + np.pi}
    return flat


# Statistical power: probability that an effect is found, by its size.

#: Prior standard deviation of the slope of a power curve, which keeps it finite where all trials
#: below some size fail and all above succeed.
_STEEP = 5.0
#: Edges of bins of an effect's part of the residual over the noise floor. At two of them the whole
#: residual is `DETECTABLE_RATIO` and `LARGE_RATIO` times the floor.
MOVED_EDGES = (
    *(0.0, 0.1, 0.2, 0.4),
    *(float(np.sqrt(ratio**2 - 1.0)) for ratio in (DETECTABLE_RATIO, LARGE_RATIO)),
    *(8.0, np.inf),
)
#: Least part of the residual over the noise floor, whose logarithm is finite.
_LEAST_MOVED = 0.03
_FOUND = Quantity(
    "", "named or among the alternatives", "effects", "", "listed", "share", *[""] * 4
)


def study_power(effects: pd.DataFrame) -> results.PowerStudy:
    """Return power curves of trials that hide one effect and were judged."""
    columns = ["id", "size", "moved", "moves_poses", "listed"]
    known = effects.query("kind == 'single' and judged") if len(effects) else effects
    known = known.reindex(columns=columns)
    moving = known[known["moves_poses"].astype(bool)]
    moved, listed = moving["moved"].to_numpy(float), moving["listed"].to_numpy(bool)
    return results.PowerStudy(
        by_id={
            str(name): power(rows["size"].to_numpy(float), rows["listed"].to_numpy(bool))
            for name, rows in known.groupby("id")
        },
        by_moved=power(np.maximum(moved, _LEAST_MOVED), listed),
        bins=tuple(
            results.MovedBin(
                low=low,
                high=high if np.isfinite(high) else None,
                listed=_FOUND.score(listed[(moved >= low) & (moved < high)]),
            )
            for low, high in itertools.pairwise(MOVED_EDGES)
        ),
    )


def power(size: Array, found: NDArray[np.bool_]) -> results.PowerCurve | None:
    """Fit a power curve: logistic in the logarithm of the size, with a prior of its slope.

    Args:
        size: (T,) positive sizes.
        found: (T,) whether the effect was found.

    Returns:
        The curve; None where all effects were found, or none.
    """
    if not len(size) or found.all() or not found.any():
        return None
    log_size = np.log(size)
    mean = log_size.mean()

    def minus_log_posterior(x: Array) -> float:
        log_odds = x[0] + x[1] * (log_size - mean)
        minus_log_likelihood = np.sum(np.logaddexp(0.0, np.where(found, -log_odds, log_odds)))
        return float(minus_log_likelihood) + 0.5 * float((x[1] / _STEEP) ** 2)

    best = minimize(minus_log_posterior, np.array([0.0, 1.0]), bounds=[(None, None), (0.0, None)])
    at_mean, slope = float(best.x[0]), float(best.x[1])
    intercept = at_mean - slope * float(mean)

    def size_at(probability: float) -> float | None:
        if slope <= 0.0:
            return None
        at = (np.log(probability / (1.0 - probability)) - intercept) / slope
        return float(np.exp(at)) if log_size.min() <= at <= log_size.max() else None

    return results.PowerCurve(
        intercept=intercept, slope=slope, half=size_at(0.5), most=size_at(LEVEL)
    )
