"""Text tables, as data sets publish them: numbers by column, unusable rows listed.

A row with a field too many or too few, or with a field that is no number, is omitted and listed
with its line. Decimal commas throughout stop with one message. A table whose columns need no change
is read as it is, by `columns` of campaign.yaml.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from pathlib import Path

import numpy as np
import pandas as pd

from pa10cal.campaign.own_columns import refuse_too_many
from pa10cal.campaign.raw_rows import RawRows, quarantined
from pa10cal.errors import RawDataError
from pa10cal.yaml_file import refusals_beside

_refusal = refusals_beside(__file__, RawDataError)


def read_bare_table(
    folder: Path,
    file: str,
    names: Sequence[str],
    *,
    separator: str | None = None,
    header: bool = False,
) -> RawRows:
    """Read a table of numbers with decimal points, a file of a data set's folder.

    Every line is a row, a blank one too: tables of one campaign belong together line by line. The
    columns are called by `names`; those of a header are not read. Without a separator blanks stand
    between the fields.

    Raises:
        RawDataError: when the file as a whole cannot be used.
    """
    path, width = folder / file, len(names)
    lines = path.read_bytes().decode("utf-8-sig", errors="replace").rstrip().splitlines()
    if not lines:
        raise _refusal("empty", f"{path}:1")
    line = np.arange(1, len(lines) + 1)[int(header) :]
    rows = [text.split(separator) for text in lines[int(header) :]]
    widths = np.array([len(row) for row in rows], dtype=np.int64)
    fits = widths == width
    words = np.array([row for row in rows if len(row) == width], dtype=object).reshape(-1, width)
    commas = np.array(["," in word for word in words.ravel()], dtype=bool).reshape(words.shape)
    if 2 * commas.any(axis=1).sum() > len(words):
        first = int(np.argmax(commas.any(axis=1)))
        raise _refusal("commas", f"{path}:{line[fits][first]}", words[first][commas[first]][0])
    columns, odd = {}, {}
    for name, fields in zip(names, words.T, strict=True):
        columns[name] = np.array(pd.to_numeric(fields, errors="coerce"), dtype=float)
        unread = np.flatnonzero(~np.isfinite(columns[name]))
        odd[name] = {int(line[fits][k]): str(fields[k]) for k in unread}
    wrong_width = f"the number of fields is not {width}"
    listed = quarantined(file, line[~fits], wrong_width, widths[~fits])
    return RawRows(file, columns, line[fits], {file: len(rows)}, (), listed, odd).finite(names)


def same_rows(tables: Sequence[RawRows], max_fraction: float) -> list[RawRows]:
    """Return the rows that can be used in every one of some tables, which belong together by line.

    Raises:
        RawDataError: when they have different numbers of rows, or too many of one cannot be used.
    """
    totals = {table.file: table.totals[table.file] for table in tables}
    if len(set(totals.values())) > 1:
        counts = ", ".join(f"{file} {total}" for file, total in totals.items())
        raise _refusal("rows", tables[0].file, counts)
    for table in tables:
        refuse_too_many(table.quarantined, table.totals, max_fraction)
    line = reduce(np.intersect1d, [table.line for table in tables])
    return [table.at(np.flatnonzero(np.isin(table.line, line))) for table in tables]
