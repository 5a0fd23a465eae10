"""Columns of dates and times: in which format they are, and which unit numbers have."""

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
#: A date alone, and a time of day alone, which together are a time.
_DAY = re.compile(r"\d{1,4}[./-]\d{1,2}[./-]\d{1,4}")
_CLOCK = re.compile(r"\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?( ?[AP]M)?", re.I)
#: Numbers of days since 1900, as workbooks count time, between 1982 and 2064.
_SERIAL_DAYS = (30_000.0, 60_000.0)


def time_columns(
    sniffed: Sniffed, name: str, others: Sequence[str], stated: str | None
) -> tuple[dict[str, Any], str]:
    """Return what `columns` says of the time, and what is to be checked of it; empty for nothing.

    Args:
        sniffed: the file.
        name: column of times.
        others: every column that may hold a date or a time of day.
        stated: unit of the column, where its name says it.
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
        return {}, f"time: {name} is the same in all rows, so rows are numbered instead"
    digits = pd.Series(words[:JUDGED]).str.fullmatch(r"\d{14}").mean() > 0.9
    if np.isfinite(numbers).mean() > 0.9 and not digits:
        unit, check = (stated, "") if stated else _unit_of_time(name, numbers)
        return {"time": {"names": name} | ({} if unit == "s" else {"unit": unit})}, check
    how, alike = format_of(words)
    if how is None:
        return {}, f"time: the format of {name} was not recognised ({words[0]!r})"
    check = f"time.format: {how}; {words[0]} may be {alike[0]} as well" if alike else ""
    return {"time": {"names": names, "format": how}}, check


def _unit_of_time(name: str, numbers: Array) -> tuple[str, str]:
    """Return the unit of times by their size: since 1970, days of a workbook, or since any."""
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


# Formats of dates and times.

#: Parts of the formats of dates and times that are tried, the commonest first.
_DATES = ("%Y-%m-%d", "%d.%m.%Y", "%m/%d/%Y", "%d/%m/%Y", "%d-%m-%Y", "%Y/%m/%d", "%d.%m.%y")
_CLOCKS = ("%H:%M:%S", "%H:%M:%S.%f", "%H:%M:%S,%f", "%I:%M:%S %p", "%H:%M", "%H.%M.%S")
_BETWEEN = (" ", "T", ", ", "  ")
_ZONES = ("", "%z", " %z")
#: Rows that formats and conventions are judged by.
JUDGED = 200


def format_of(words: Sequence[str]) -> tuple[str | None, tuple[str, ...]]:
    """Return the format of dates and times, for `time.format`, and others that fit as well.

    Where day and month may be exchanged, that in which the times lie closest together is taken.
    None where no format fits.
    """
    fits: dict[str, float] = {}
    for how in _formats(words[0]):
        moments = moments_of(words[:JUDGED], how)
        if moments.notna().mean() > 0.9:
            fits[how] = float((moments.max() - moments.min()).total_seconds())
    if not fits:
        return None, ()
    shortest = min(fits.values())
    best, *others = [how for how, lasts in fits.items() if lasts <= 1.001 * shortest + 1.0]
    order = [
        how
        for how in others
        if how.find("%m") < how.find("%d") != (best.find("%m") < best.find("%d"))
    ]
    return best, tuple(order)


def moments_of(words: Sequence[str], how: str) -> pd.Series[pd.Timestamp]:
    """Return dates and times read in a format of `time.format`; NaT of those that are none."""
    form = "ISO8601" if how == ISO else how
    some = pd.Series([word if len(word) <= MOST_LETTERS else "" for word in words], dtype=object)
    return pd.to_datetime(some, format=form, errors="coerce", utc=True)


def _formats(word: str) -> Iterator[str]:
    """Yield the formats that a date or time may have: those that read its first row."""
    if len(word) > MOST_LETTERS:
        return
    every = itertools.chain(
        (ISO, "%Y%m%d%H%M%S", "%Y%m%d_%H%M%S", "%Y%m%dT%H%M%S"),
        map("".join, itertools.product(_DATES, _BETWEEN, _CLOCKS, _ZONES)),
        _CLOCKS,
    )
    shape = _shape(word)
    for how in dict.fromkeys(every):
        # To compare shapes is quicker than to read.
        if (how == ISO or _shape(how) == shape) and moments_of([word], how).notna().all():
            yield how


def _shape(moment: str) -> str:
    """Return what stands between the numbers of a date or time, or of its format."""
    bare = re.sub(r"\s*([-+]\d\d:?\d\d(:?\d\d(\.\d+)?)?|Z|%Z)$", "", moment.strip().upper())
    return re.sub(r"\s+", " ", re.sub(r"(%[A-OQ-Z]|\d)+", "0", re.sub("%P|[AP]M", "AM", bare)))
