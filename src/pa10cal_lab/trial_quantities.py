"""Figures over blind trials, against the targets to reach: shares and other statistics.

`scores.csv` defines them: the table of `trial_tables`, which of its rows count, what is evaluated
in them, and the target.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Collection, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import binomtest

from pa10cal.arrays import Array
from pa10cal_lab import trial_records as results
from pa10cal_lab.trial_tables import TableName

#: Level of confidence intervals of shares.
_LEVEL = 0.95
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

    what: str
    table: TableName
    value: str  # the value of a row, an expression of columns
    where: str = ""  # which rows count, an expression of columns; empty for all
    statistic: str = "share"  # `share`, or one of `_STATISTICS`
    at_least: str = ""  # target; empty without
    at_most: str = ""  # target in the other direction; empty without
    failing: str = ""  # failing of a trial whose value counts against the target; empty for none
    by: str = ""  # column of groups, each of which has a figure of its own; empty for none
    studies: str = ""  # names of the studies that have it

    def rows(self, tables: Mapping[TableName, pd.DataFrame]) -> pd.DataFrame:
        """Return the rows that count."""
        rows = tables[self.table]
        return rows if rows.empty or not self.where else rows[_evaluated(rows, self.where)]

    def valued(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Return campaign, group and `value` of rows alone, those without a value left out."""
        if rows.empty:
            return pd.DataFrame(columns=["campaign", "value", self.by])
        value = _evaluated(rows, self.value)
        read = {name: rows[name] for name in ("campaign", self.by) if name in rows}
        table = pd.DataFrame(read | {"value": value})
        return table[table["value"].notna()]

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
    with Path(__file__).with_name("scores.csv").open(encoding="utf-8", newline="") as table:
        rows: list[dict[str, Any]] = list(csv.DictReader(table))
    return tuple(Quantity(**row) for row in rows)


def share_of(outcomes: Collection[Any]) -> dict[str, Any]:
    """Return the number and the share of true outcomes, and its exact confidence interval."""
    if not len(outcomes):
        return {"count": 0, "reached": None, "low": 0.0, "high": 1.0}
    count, total = sum(map(bool, outcomes)), len(outcomes)
    low, high = _interval(count, total)
    return {"count": count, "reached": count / total, "low": low, "high": high}


@cache
def _interval(count: int, total: int) -> tuple[float, float]:
    """Return the exact confidence interval of a share; many figures have the same counts."""
    low, high = binomtest(count, total).proportion_ci(_LEVEL, method="exact")
    return float(low), float(high)
