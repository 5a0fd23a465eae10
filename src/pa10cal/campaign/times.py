"""Columns of dates and times: their format, or the unit of their numbers."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from pa10cal.arrays import Array
from pa10cal.campaign.recognise import MOST_LETTERS
from pa10cal.campaign.sniffing import Sniffed

#: The format of times as ISO 8601 has them.
ISO = "iso"
#: A date, and a time of day.
_DAY = re.compile(r"\d{1,4}[./-]\d{1,2}[./-]\d{1,4}")
_CLOCK = re.compile(r"\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?( ?[AP]M)?", re.I)
#: Directives of a format that states a time of day alone.
_OF_DAY = frozenset("HIMSfpzTRX")
#: Days since 1900, as workbooks count time: from 1982 to 2064.
_SERIAL_DAYS = (30_000.0, 60_000.0)


def time_columns(
    sniffed: Sniffed, name: str, others: Sequence[str], stated: str | None
) -> tuple[dict[str, Any], str]:
    """Return `time` of `columns` in campaign.yaml, and what to check; both may be empty.

    Args:
        sniffed: the file.
        name: column of times.
        others: all columns that may hold a date or a time of day.
        stated: unit of the column, where its name states it.
    """
    words, numbers = sniffed.words(name), sniffed.column(name)
    names: str | list[str] = name
    first = {other: sniffed.words(other)[0] for other in others}
    days = [other for other, word in first.items() if _DAY.fullmatch(word)]
    clocks = [other for other, word in first.items() if _CLOCK.fullmatch(word)]
    if days and clocks:
        names = [days[0], clocks[0]]
        words = [" ".join(row) for row in zip(*map(sniffed.words, names), strict=True)]
        numbers = np.full(len(words), np.nan)
    if len(set(words)) <= 1 or len(set(words)) < 0.01 * len(words):
        rows = "all" if len(set(words)) <= 1 else "many"
        return {}, f"time: {name} is the same in {rows} rows, so rows are numbered instead"
    digits = pd.Series(words[:JUDGED]).str.fullmatch(r"\d{14}").mean() > 0.9
    if np.isfinite(numbers).mean() > 0.9 and not digits:
        unit, check = (stated, "") if stated else _unit_of_time(name, numbers)
        return {"time": {"names": name} | ({} if unit == "s" else {"unit": unit})}, check
    form, others_possible = format_of(words)
    if form is None:
        return {}, f"time: the format of {name} was not recognised ({words[0]!r})"
    check = ""
    if others_possible:
        check = f"time.format: {form}; {words[0]} may be {others_possible[0]} as well"
    return {"time": {"names": names, "format": form}}, check


def _unit_of_time(name: str, numbers: Array) -> tuple[str, str]:
    """Return the unit of times by their size, and what to check.

    Large numbers are since 1970; others are days of a workbook, or seconds.
    """
    finite = numbers[np.isfinite(numbers)]
    least, most = finite.min(), finite.max()
    if most > 1e11:
        return "ns" if most > 1e17 else "us" if most > 1e14 else "ms", ""
    parts = np.mod(finite, 1.0)
    if _SERIAL_DAYS[0] < least and most < _SERIAL_DAYS[1] and (parts > 1e-9).mean() > 0.5:
        if most - least < 60.0:  # of days, such as a campaign takes
            return "d", ""
        return "s", f"time.unit: s, by the size of the numbers of {name}"
    return "s", ""


#: Parts of the formats of dates and times that are tried, the commonest first.
_DATES = ("%Y-%m-%d", "%d.%m.%Y", "%m/%d/%Y", "%d/%m/%Y", "%d-%m-%Y", "%Y/%m/%d", "%d.%m.%y")
_CLOCKS = ("%H:%M:%S", "%H:%M:%S.%f", "%H:%M:%S,%f", "%I:%M:%S %p", "%H:%M", "%H.%M.%S")
_BETWEEN = (" ", "T", ", ", "  ")
_ZONES = ("", "%z", " %z")
#: Rows that formats and conventions are judged by.
JUDGED = 200


def format_of(words: Sequence[str]) -> tuple[str | None, tuple[str, ...]]:
    """Return the format of dates and times, for `time.format`, and others that the user may mean.

    The format in which the times span the shortest period is taken; None where no format fits.
    """
    duration_s: dict[str, float] = {}
    for form in _formats(next(filter(None, words), "")):
        moments = moments_of(words[:JUDGED], form)
        if moments.notna().mean() > 0.9:
            duration_s[form] = float((moments.max() - moments.min()).total_seconds())
    if not duration_s:
        return None, ()
    longest_s = 1.001 * min(duration_s.values()) + 1.0
    best, *others = [form for form, period_s in duration_s.items() if period_s <= longest_s]
    # Days and months exchanged are another meaning; other blanks between date and time are none.
    meant = [form for form in others if _is_month_first(form) != _is_month_first(best)]
    return best, tuple(meant[:1])


def _is_month_first(form: str) -> bool:
    return form == ISO or form.find("%m") < form.find("%d")


def moments_of(words: Sequence[str], how: str) -> pd.Series[pd.Timestamp]:
    """Return dates and times read in a format of `time.format`; NaT where a word does not fit."""
    form = "ISO8601" if how == ISO else how
    some = pd.Series([word if len(word) <= MOST_LETTERS else "" for word in words], dtype=object)
    return pd.to_datetime(some, format=form, errors="coerce", utc=True)


def seconds_of(words: Sequence[str], how: str) -> Array:
    """Return dates and times as seconds since 1970, nan where a word does not fit.

    Times of day alone are those of one day, or of days that follow each other: from word to word
    less than half a day passes.
    """
    since_1970 = moments_of(words, how) - pd.Timestamp(0, tz="UTC")
    seconds: Array = np.array(since_1970.dt.total_seconds(), dtype=np.float64)
    if how != ISO and _OF_DAY.issuperset(re.findall(r"%(\w)", how)):
        known = np.isfinite(seconds)
        seconds[known] = np.unwrap(seconds[known], period=86400.0)
    return seconds


def _formats(word: str) -> Iterator[str]:
    """Yield the formats that read a date or time."""
    if len(word) > MOST_LETTERS:
        return
    candidates = itertools.chain(
        (ISO, "%Y%m%d%H%M%S", "%Y%m%d_%H%M%S", "%Y%m%dT%H%M%S"),
        map("".join, itertools.product(_DATES, _BETWEEN, _CLOCKS, _ZONES)),
        _CLOCKS,
    )
    shape = _shape(word)
    for form in dict.fromkeys(candidates):
        # To compare shapes is quicker than to read.
        if (form == ISO or _shape(form) == shape) and moments_of([word], form).notna().all():
            yield form


def _shape(moment: str) -> str:
    """Return the signs between the numbers of a date or time, or of a format, numbers as 0."""
    bare = re.sub(r"\s*([-+]\d\d:?\d\d(:?\d\d(\.\d+)?)?|Z|%Z)$", "", moment.strip().upper())
    return re.sub(r"\s+", " ", re.sub(r"(%[A-OQ-Z]|\d)+", "0", re.sub("%P|[AP]M", "AM", bare)))
