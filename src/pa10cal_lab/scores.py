"""What many blind trials come to: rates of right and wrong names, and the figures to reach.

Trials become tables: a row a trial, a hidden effect, a fault put in, a parameter reported. What is
counted stands in `scores.csv`: which table, which of its rows count, what counts of them, and the
figure to reach. Of trials as measured robots come (`cell.measured_trials`) the truth itself
says how far a hidden effect moves the readings once the geometry is fitted again, and what noise
does: a calibrated model may hold springs, and follow.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import ndtri
from scipy.stats import binomtest

from pa10cal.arrays import Array
from pa10cal_lab import blind_trial
from pa10cal_lab import trial_records as results
from pa10cal_lab.cell.measured_trials import MIXED, SORTED, SUBJECTS, UNSTATED

LEVEL = 0.95
_AS_MEASURED = "arms, their lengths, weights and springs, poses, noise and hidden effects"
#: What is drawn of the trials of each study.
_DRAWN = {
    **dict.fromkeys(("touched", blind_trial.TRACKED), "robots, poses, noise and hidden effects"),
    blind_trial.WILD: "robots, poses, noise, stressors, faults and hidden effects",
    **dict.fromkeys(("unstated", "sorted"), _AS_MEASURED),
    "mixed": "arms, their lengths and weights, poses, noise and hidden effects",
    blind_trial.DRIVES: "robots, poses, noise, errors of drives and ripple",
}

# The tables: a row a trial, a hidden effect, a fault, a parameter.

TableName = Literal["trials", "effects", "faults", "parameters", "claims"]


def tables_of(trials: Sequence[blind_trial.BlindTrial]) -> dict[TableName, pd.DataFrame]:
    """Return trials as tables; `held_over_null` is relative to campaigns that hide nothing."""
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
            dict(each, name=f"{each.id} {each.parameter}", inside=abs(each.score) <= inside)
            for each in parameter_scores(trials)
        ),
    }


def _trial_row(t: blind_trial.BlindTrial) -> dict[str, Any]:
    verdict, own, named = t.verdict, t.without_springs(), t.without_background()
    above = [hidden for hidden in t.to_be_named if t.is_above(hidden)]
    hidden = {each.name for each in t.hidden}
    row: dict[str, Any] = {
        "campaign": t.truth.campaign,
        "kind": t.kind,
        "layout": t.truth.layout,
        "judged": verdict is not None,
        "crashed": verdict is None and not t.refused,
        "refused": t.refused,
        "unexplained": verdict is not None and verdict.word == "unexplained",
        "word": t.said.word if verdict is not None else "",
        "names": len(t.effects),
        "hides": len(t.hidden),
        "first": t.hidden[0].id if t.hidden else "",
        "extra": t.extra(),
        "confidently_wrong": t.is_confidently_wrong(),
        "right_place": t.kind == blind_trial.OUTSIDE and t.has_right_place(),
        "all_listed": t.matched(t.to_be_named) == len(t.to_be_named),
        "all_testable": all(map(t.is_testable, t.to_be_named)),
        "has_above": bool(above),
        "above_listed": t.matched(above) == len(above),
        "outside": t.is_outside(),
        "right_formula": t.proposes(right=True),
        "wrong_formula": t.proposes(right=False),
        "has_fault": t.has_fault(),
        "undisturbed": not any(each.kinds or each.measured for each in t.put_in),
        "disturbed": t.hides_much() or any(map(t.matters, t.put_in)),
        "false_name": own.extra() > 0,
        "confident_false_name": own.is_confidently_wrong(blind_trial.CHECK),
        "wrong_name": t.has_wrong_name(),
        "among": "a background" if any(each.outside for each in t.hidden) else "nothing else",
        "named_beside": named.extra(),
        "wrong_name_alone": named.has_wrong_name_alone(),
        "false_drive_name": any(
            each.id != blind_trial.MAP and not hidden & set(each.all_names) for each in t.effects
        ),
        "false_comfort": t.has_false_comfort(),
        "worse": t.is_worse(),
        "accused": t.is_accused(),
        "motion_as_fact": bool(t.motions_as_facts()),
        **dict.fromkeys(("says_something", "nameless"), False),
        **dict.fromkeys(("held_out_mm", "seconds", "whole_seconds"), np.nan),
    }
    if verdict is not None:
        row |= {
            "says_something": verdict.says_something,
            "nameless": bool(verdict.places)
            or any(e.id in (blind_trial.MAP, blind_trial.LINE) for e in t.effects),
            "held_out_mm": verdict.held_out_after_mm or np.nan,
            "seconds": verdict.seconds,
            "whole_seconds": verdict.seconds + verdict.seconds_simulating + t.truth.seconds_twin,
        }
    return row


def _effect_rows(t: blind_trial.BlindTrial) -> Iterator[dict[str, Any]]:
    for k, hidden in enumerate(t.hidden):
        named, beside, nan = t.names(hidden), t.alternatives(hidden), float("nan")
        yield dict(t.judged_effect(hidden)) | {
            "campaign": t.truth.campaign,
            "kind": t.kind,
            "to_be_named": not hidden.outside,
            "judged": t.verdict is not None,
            "says_something": t.verdict is not None and t.verdict.says_something,
            "first_at_place": all(other.of != hidden.of for other in t.hidden[:k]),
            "ratio": t.ratio(hidden) or nan,
            "apart": t.ratio(hidden, partial=True) or nan,
            "moved": t.moved_over_floor(hidden) or 0.0,
            "named": named,
            "place_told": t.tells_place(hidden),
            "alternatives": nan if beside is None else beside,
            "alone": named and beside == 0 and not t.extra(),
        }


def _fault_rows(t: blind_trial.BlindTrial) -> Iterator[dict[str, Any]]:
    for each in t.put_in:
        about = {"campaign": t.truth.campaign, "has_fault": t.has_fault()}
        yield about | {"matters": t.matters(each), "told": t.is_told(each)}


#: Edges of the bins in which probabilities are held against what comes true.
CLAIM_EDGES = (0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 1.0)


def _claim_rows(t: blind_trial.BlindTrial) -> Iterator[dict[str, Any]]:
    """Yield what a trial claims with a probability, and whether it is true."""
    for each in t.claims():
        k = min(max(int(np.searchsorted(CLAIM_EDGES, each.probability, "right")), 1), 6)
        off = 1.0 - each.probability if each.right else each.probability
        yield {
            "campaign": t.truth.campaign,
            "kind": t.kind,
            "of": each.of,
            "probability": each.probability,
            "right": each.right,
            "bin": f"{CLAIM_EDGES[k - 1]:.2f} to {CLAIM_EDGES[k]:.2f}",
            "brier": off**2,
            "log_score": float(np.log(max(1.0 - off, 1e-4))),
        }


# What is counted, and the figures to reach: `scores.csv` beside this module, a row a figure.

_STATISTICS: dict[str, Callable[[Array], Any]] = {
    "mean": np.mean,
    "median": np.median,
    "largest": np.max,
    "quantile_95": lambda x: np.quantile(x, 0.95),
    "rms": lambda x: np.sqrt(np.mean(x**2)),
    "per_hour": lambda seconds: 2.0 * 3600.0 / np.mean(seconds),  # on two cores
}


class Quantity(NamedTuple):
    """A share of some rows of a table, or another figure of them; a row of `scores.csv`."""

    studies: str  # of which trials it is a figure
    what: str
    table: TableName
    where: str  # which rows count, as in `DataFrame.query`; all where empty
    value: str  # what counts of them, or their number
    statistic: str  # `share`, or of `_STATISTICS`
    at_least: str  # figure to reach; empty of none
    at_most: str  # or not to exceed
    failing: str  # what is said of a trial that counts against it
    by: str  # column of the groups of which each is a figure of its own

    def rows(self, tables: Mapping[TableName, pd.DataFrame]) -> pd.DataFrame:
        """Return the rows that count."""
        rows = tables[self.table]
        return rows if rows.empty or not self.where else rows[_of(rows, self.where)]

    def valued(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Return those of the rows that count of which something counts, that as `value`."""
        if rows.empty:
            return pd.DataFrame(columns=["campaign", "value", self.by])
        return rows.assign(value=_of(rows, self.value)).dropna(subset=["value"])

    def score(self, values: Array, by: str = "") -> results.ScoreRow:
        """Return the figure of some values, against the one to reach."""
        found: dict[str, Any] = dict.fromkeys(("count", "reached", "low", "high"))
        if self.statistic == "share":
            found = share_of(values)
        elif len(values):
            found["reached"] = float(_STATISTICS[self.statistic](values.astype(float)))
        at_least = bool(self.at_least) if self.at_least or self.at_most else None
        limit, met = None if at_least is None else float(self.at_least or self.at_most), None
        if limit is not None and found["reached"] is not None:
            met = found["reached"] >= limit if at_least else found["reached"] <= limit
        return results.ScoreRow(
            what=self.what,
            by=by,
            at_least=at_least,
            limit=limit,
            trials=len(values),
            share=self.statistic == "share",
            met=met,
            **found,
        )

    def scores(self, rows: pd.DataFrame) -> list[results.ScoreRow]:
        """Return the figure of the rows that count, or that of each group."""
        if not self.by:
            return [self.score(rows["value"].to_numpy())]
        groups = rows.groupby(self.by)["value"]
        return [self.score(values.to_numpy(), str(by)) for by, values in groups]


def _of(rows: pd.DataFrame, expression: str) -> Any:
    """Evaluate an expression of columns; the others are left away, each costs time."""
    if expression in rows:  # most are one column: to read an expression takes milliseconds
        return rows[expression]
    words = set(re.findall(r"\w+", expression))
    return rows[[name for name in rows if name in words]].eval(expression)


@cache
def quantities() -> tuple[Quantity, ...]:
    """Return every figure that is counted, in the order of the scores."""
    table = pd.read_csv(Path(__file__).with_name("scores.csv"), dtype=str, keep_default_na=False)
    return tuple(Quantity(*row) for row in table.itertuples(index=False))


def share_of(outcomes: Collection[Any]) -> dict[str, Any]:
    """Return how many of some outcomes are true, their share and its exact 95 % interval."""
    if not len(outcomes):
        return {"count": 0, "reached": None, "low": 0.0, "high": 1.0}
    count, of = sum(map(bool, outcomes)), len(outcomes)
    low, high = binomtest(count, of).proportion_ci(LEVEL, method="exact")
    return {"count": count, "reached": count / of, "low": float(low), "high": float(high)}


def _study(trial: blind_trial.BlindTrial) -> str:
    """Return which figures a trial counts in."""
    studies = {UNSTATED: "unstated", SORTED: "sorted", MIXED: MIXED}
    return studies.get(trial.kind, trial.truth.measured)


def scores_record(trials: Sequence[blind_trial.BlindTrial]) -> results.TrialScoresRecord:
    """Return what trials of one study come to."""
    tables = tables_of(trials)
    studies = {_study(trial) for trial in trials} or {"touched"}
    chosen = [each for each in quantities() if studies & set(each.studies.split())]
    alike = {(each.table, each.where): each for each in chosen}
    rows_of = {of: each.rows(tables) for of, each in alike.items()}
    counted = {each: each.valued(rows_of[each.table, each.where]) for each in chosen}
    scores = [score for each, rows in counted.items() for score in each.scores(rows)]
    failings: dict[str, dict[str, None]] = {}
    for quantity, rows in counted.items():
        if not quantity.failing:
            continue
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
        per_trial=tuple(t.score_row(tuple(failings.get(t.truth.campaign, ()))) for t in trials),
    )


# Counts by what was put in or hidden.

#: What is counted of every wild trial, of its row.
_COUNTED = ("crashed", "refused", "false_comfort", "worse", "unexplained")


def _subjects(
    trials: Sequence[blind_trial.BlindTrial], by_trial: pd.DataFrame
) -> tuple[results.OutcomeCounts, ...]:
    """Return what became of all that trials hide or put in, by kind of trial and id."""
    number: Counter[tuple[str, str]] = Counter()
    counts: dict[tuple[str, str], Counter[str]] = {}
    for trial, row in zip(trials, by_trial.to_dict("records"), strict=True):
        for id, outcome in _outcomes(trial, row):
            number[trial.kind, id] += 1
            counts.setdefault((trial.kind, id), Counter()).update(outcome)
    return tuple(
        results.OutcomeCounts(kind=kind, id=id, trials=number[kind, id], counts=counts[kind, id])
        for kind, id in sorted(counts)
    )


def _outcomes(
    t: blind_trial.BlindTrial, row: Mapping[Any, Any]
) -> Iterator[tuple[str, Mapping[str, int]]]:
    """Yield what a trial counts under, and as what; see `OutcomeCounts`."""
    if t.truth.measured == blind_trial.DRIVES:
        erring = () if t.kind == "neither" else t.hidden
        for of in dict.fromkeys(hidden.of for hidden in erring):
            yield "joint", {t.drive_outcome(of): 1}
        return
    if t.truth.measured != blind_trial.WILD:
        if t.kind in ("single", blind_trial.OUTSIDE):
            yield t.hidden[0].id, {t.outcome(t.hidden[0]): 1}
        return
    as_measured = t.kind in SUBJECTS
    false_name = "confident_false_name"
    if as_measured or t.kind in ("effect", "right", "stressed"):
        false_name = "wrong_name" if as_measured else "false_name"
    if t.kind == MIXED:
        false_name = "wrong_name_alone"
    counted = {name: row[name] for name in _COUNTED}
    counted |= {"false_name": row[false_name], "suspected": row["accused"]}
    by_effect = as_measured or t.kind in ("effect", "beyond")
    ids = [each.id for each in (t.hidden if by_effect else t.put_in)]
    for id in dict.fromkeys(ids or ["nothing"]):
        hidden = [each for each in t.hidden if not as_measured or each.id == id]
        told = [t.is_told(each) for each in t.put_in if t.matters(each)]
        if as_measured:
            told = [t.lists(each) for each in hidden if (t.ratio(each) or 0.0) >= blind_trial.LIMIT]
        found = sum(map(t.lists, hidden))
        yield id, counted | {"above_noise": len(told), "told": sum(told), "found": found}


# Whether reported parameters of effects hold what was hidden inside their intervals.

_AXES = "xyz"


def parameter_scores(trials: Iterable[blind_trial.BlindTrial]) -> Iterator[results.ParameterScore]:
    """Score the parameters of every finding that is what was hidden, at its place.

    Of phases the difference modulo a turn counts, with the sign of an amplitude taken into the
    phase. Maps are omitted: cell and estimator have other knots, and calibration takes their
    mean.
    """
    for hidden, named in (
        (each, named) for t in trials for each in t.hidden for named in t.effects
    ):
        truth = (
            true_parameters(hidden)
            if named.name == hidden.name and hidden.id != blind_trial.MAP
            else {}
        )
        for name, found in named.parameters.items():
            if name in truth and found.std > 0.0:
                off = found.value - truth[name]
                off = float(np.angle(np.exp(1j * off))) if name == "phi" else off
                score = off / found.std
                yield results.ParameterScore(id=named.id, parameter=name, score=score)


def true_parameters(hidden: results.HiddenEffect) -> dict[str, float]:
    """Return what was hidden under the names of a verdict, amplitudes positive."""
    flat: dict[str, float] = {}
    known: Mapping[str, object] = hidden.parameters
    for name, value in known.items():
        if isinstance(value, Sequence) and len(value) == len(_AXES):
            flat |= {f"{name}_{axis}": float(v) for axis, v in zip(_AXES, value, strict=True)}
        elif isinstance(value, int | float):
            flat[name] = float(value)
    if "phi" in flat and flat["A"] < 0.0:
        flat |= {"A": -flat["A"], "phi": flat["phi"] + np.pi}
    return flat


# How sure an effect of some size is found.

#: Standard deviation expected of the slope of a power curve: none is steeper than a few of these
#: where all trials below some size fail and all above succeed.
_STEEP = 5.0
#: Edges of the bins in which shares are counted: of how far the residual moves, over the floor. Two
#: of them are where the residual is `LIMIT` and `LARGE` times the floor.
MOVED_EDGES = (
    *(0.0, 0.1, 0.2, 0.4),
    *(float(np.sqrt(ratio**2 - 1.0)) for ratio in (blind_trial.LIMIT, blind_trial.LARGE)),
    *(8.0, np.inf),
)
#: Less than this counts as this; keeps logarithms finite.
_LEAST_MOVED = 0.03


_FOUND = Quantity(
    "", "named or among the alternatives", "effects", "", "listed", "share", *[""] * 4
)


def study_power(effects: pd.DataFrame) -> results.PowerStudy:
    """Fit power curves to trials that hide one effect and did not fail."""
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
            for low, high in pairwise(MOVED_EDGES)
        ),
    )


def power(size: Array, found: NDArray[np.bool_]) -> results.PowerCurve | None:
    """Fit a power curve; None where all trials, or none, were found.

    Args:
        size: (T,) positive.
        found: (T,).
    """
    if not len(size) or found.all() or not found.any():
        return None
    logarithm = np.log(size)
    middle = logarithm.mean()

    def misfit(x: Array) -> float:
        odds = x[0] + x[1] * (logarithm - middle)
        likely = np.sum(np.logaddexp(0.0, np.where(found, -odds, odds)))
        return float(likely) + 0.5 * float((x[1] / _STEEP) ** 2)

    best = minimize(misfit, np.array([0.0, 1.0]), bounds=[(None, None), (0.0, None)])
    centre, slope = float(best.x[0]), float(best.x[1])
    intercept = centre - slope * float(middle)

    def size_at(chance: float) -> float | None:
        if slope <= 0.0:
            return None
        at = (np.log(chance / (1.0 - chance)) - intercept) / slope
        return float(np.exp(at)) if logarithm.min() <= at <= logarithm.max() else None

    return results.PowerCurve(
        intercept=intercept, slope=slope, half=size_at(0.5), most=size_at(LEVEL)
    )
