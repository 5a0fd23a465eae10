"""The refusal of a file of which too many rows are quarantined, with a remedy for the commonest."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from pa10cal.campaign.column_map import CONTRACT_COLUMNS, ColumnMap
from pa10cal.campaign.csv_rows import REPEATED
from pa10cal.campaign.raw_rows import COMMA, EXCLUDED, Quarantined
from pa10cal.campaign.times import format_of
from pa10cal.errors import RawDataError


def refuse_too_many(
    rows: Iterable[Quarantined],
    totals: Mapping[str, int],
    max_fraction: float,
    words: ColumnMap = CONTRACT_COLUMNS,
) -> None:
    """Refuse a file of which all rows, or more than allowed, are quarantined.

    Allowed is `ingest.max_quarantined_fraction` of its rows; rows that campaign.yaml excludes do
    not count. The message names the file, the commonest reason and the first line with it.
    """
    rows, totals = sorted(rows), dict(totals)
    for row in rows:
        totals[row.file] -= row.reason.startswith(EXCLUDED)
        if not totals[row.file]:
            raise RawDataError(
                "every row is excluded",
                where=row.file,
                allowed="at least some rows to calibrate with",
                remedy="correct exclude in campaign.yaml",
            )
    for name, total in totals.items():
        listed = [r for r in rows if r.file == name and not r.reason.startswith(EXCLUDED)]
        if len(listed) <= max_fraction * total and len(listed) < total:
            continue
        reason, times = Counter(row.reason for row in listed).most_common(1)[0]
        struck = [row for row in listed if row.reason == reason]
        columns = Counter(row.value.partition(" = ")[0] for row in struck if " = " in row.value)
        column, in_column = columns.most_common(1)[0] if columns else ("", 0)
        if 2 * in_column > times:
            struck = [row for row in struck if row.value.startswith(f"{column} = ")]
        raise RawDataError(
            f"{len(listed)} of {total} rows would be quarantined, {times} of them because: "
            f"{reason}",
            where=f"{name}:{struck[0].line}" + (f": {words.called(column)}" if column else ""),
            value=struck[0].value or None,
            allowed=f"at most {max_fraction:.0%} (ingest.max_quarantined_fraction)",
            remedy=_remedy_of_rows(words, reason, struck, most=2 * len(listed) > total),
        )


def _remedy_of_rows(
    words: ColumnMap, reason: str, listed: Sequence[Quarantined], *, most: bool
) -> str:
    """Return the remedy for rows `listed` that are quarantined for one reason.

    Where `most` rows of the file are quarantined the others cannot suffice.
    """
    column, key = "", ""
    if " = " in listed[0].value:
        column = listed[0].value.partition(" = ")[0]
        key = words.key_called(column)
    values = [row.value.partition(" = ")[2] for row in listed]
    if reason == REPEATED:
        return "remove the rows that stand there twice"
    if listed[0].value.endswith(COMMA):
        return (
            f"set {key.rpartition('.')[0]}.decimal: ','"
            if key
            else "export the file with decimal points, or state decimal: ',' under columns in "
            "campaign.yaml"
        )
    if key.endswith(".time"):
        texts = [value.strip("'\"") for value in values]
        if all(texts) and (how := format_of(texts)[0]):
            return f"set {key}.format: '{how}'"
    if key.endswith(".kind"):
        return f"add {', '.join(dict.fromkeys(values))} to {key}.words, as grid or as holdout"
    look = f"look at column {words.called(column)} first; " if column else ""
    if reason.startswith("beyond the limits of joint"):
        return f"{look}check robot in campaign.yaml, and the unit, order and signs of the joints"
    rest = "" if most else ", or raise the setting if the other rows suffice"
    return f"{look}correct the file{rest}"
