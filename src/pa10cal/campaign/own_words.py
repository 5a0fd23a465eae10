"""Messages in the words of the user's file: its columns beside ours, keys with values to set.

One rule for all of them: a column is called as the file calls it, and beside it as the contract
does, `A6 [°]` (`q6`); a remedy is a key of campaign.yaml and what to set it to.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from pa10cal.campaign.csv_rows import REPEATED
from pa10cal.campaign.own_columns import ANGLES, FORCES, LENGTHS, TIMES, TORQUES
from pa10cal.campaign.raw_rows import COMMA, EXCLUDED, OwnColumn, Quarantined
from pa10cal.campaign.recognise import format_of, unit_of
from pa10cal.errors import RawDataError

_QUATERNION = ("qw", "qx", "qy", "qz")
_JOINT = re.compile(r"(q\d+)_(?:deg|mm)")
#: Units that may stand for each other.
_FAMILIES = (LENGTHS, ANGLES, TORQUES, TIMES, FORCES, {"C": 1.0, "K": 1.0, "F": 1.0})
#: Words of units, for sentences.
UNIT_WORDS = {
    "um": "micrometres",
    "mm": "millimetres",
    "cm": "centimetres",
    "in": "inches",
    "m": "metres",
    "deg": "degrees",
    "rad": "radians",
    "mrad": "milliradians",
}


@dataclass(frozen=True)
class OwnWords:
    """What a file calls its columns; empty of one that follows the contract."""

    sources: Mapping[str, OwnColumn] = field(default_factory=dict)  # by the contract's names

    def column(self, name: str) -> str:
        """Return a column of the contract as the file calls it, ours beside it; without it ours."""
        joint = _JOINT.fullmatch(name)
        ours = joint[1] if joint else "qw … qz" if name in _QUATERNION else name
        own = self.sources.get(name)
        if own is None:
            return name
        return f"{', '.join(f'`{each}`' for each in own.name.split(', '))} (`{ours}`)"

    def joint(self, number: int) -> str:
        """Return the column of a joint, from 1."""
        return next(
            (self.column(name) for name in (f"q{number}_deg", f"q{number}_mm") if name in self),
            f"q{number}",
        )

    def __contains__(self, name: str) -> bool:
        return name in self.sources

    def text(self, text: str) -> str:
        """Return a text in which the file's own names stand beside those of the contract."""
        return re.sub(r"\w+", lambda match: self.column(match[0]), text)

    def called(self, own: str) -> str:
        """Return a column by the file's own name, ours beside it."""
        ours = [name for name, each in self.sources.items() if each.name == own]
        quoted = self.key_called(own) and f"`{own}`"
        return self.column(ours[0]) if ours else quoted or own

    def key(self, name: str) -> str:
        """Return the key of campaign.yaml that maps a column of the contract; nothing for none."""
        own = self.sources.get(name)
        return "" if own is None else own.key

    def key_called(self, own: str) -> str:
        """Return the key that maps a column by the file's own name; nothing for none."""
        keys = (each.key for each in self.sources.values() if own in each.name.split(", "))
        return next(keys, "")

    def set_unit(self, name: str, unit: str, right: str) -> str:
        """Return the remedy for a column whose numbers are in another unit than is stated.

        Args:
            name: of the contract.
            unit: in which they are, as campaign.yaml calls it.
            right: that of the contract, in words.
        """
        if key := self.key(name):
            slides = key.endswith(".joints") and name.endswith("_mm")
            return f"set {key}.{'stroke_unit' if slides else 'unit'}: {unit}"
        return (
            f"convert the columns to {right}, or state their unit under columns in campaign.yaml: "
            f"unit: {unit}"
        )

    def set_names(self, names: Sequence[str]) -> str:
        """Return the remedy for columns that hold each other's numbers.

        Args:
            names: of the contract, in the order in which the file's columns should be named.
        """
        own = ", ".join(self.sources[name].name for name in names if name in self)
        return f"set {self.key(names[0])}.names: [{own}]"

    def contradicted_units(self, file: str) -> Iterator[str]:
        """Yield where a header says another unit than the column is read in, once a key."""
        said: set[str] = set()
        for name, own in self.sources.items():
            header = unit_of(own.name)
            known = any({header, own.unit} <= family.keys() for family in _FAMILIES)
            if not known or header == own.unit or own.key in said:
                continue
            said.add(own.key)
            yield (
                f"{file}: {self.column(name)}: its header says {header}, and it is read in "
                f"{own.unit}; {self.set_unit(name, header, own.unit)} if the header is right"
            )

    def remedy_of_rows(self, reason: str, listed: Sequence[Quarantined], *, most: bool) -> str:
        """Return what to do where too many rows are quarantined for a reason.

        Args:
            reason: the commonest.
            listed: the rows that it struck.
            most: whether it struck most rows, so that the others do not suffice.
        """
        column, _, _ = listed[0].value.partition(" = ")
        key, called = self.key_called(column), self.called(column)
        file = key.rpartition(".")[0]
        if reason == REPEATED:
            return "remove the rows that stand there twice"
        if listed[0].value.endswith(COMMA):
            return (
                f"set {file}.decimal: ','"
                if key
                else "export the file with decimal points, or state decimal: ',' under columns in "
                "campaign.yaml"
            )
        if key.endswith(".time") and (found := _format([row.value for row in listed])):
            return f"set {key}.format: '{found}'"
        if key.endswith(".kind"):
            words = dict.fromkeys(row.value.partition(" = ")[2] for row in listed)
            return f"add {', '.join(words)} to {key}.words, as grid or as holdout"
        look = f"look at column {called} first; " if called else ""
        if reason.startswith("beyond the limits of joint"):
            return (
                f"{look}check robot in campaign.yaml, and the unit, order and signs of the joints"
            )
        rest = "" if most else ", or raise the setting if the other rows suffice"
        return f"{look}correct the file{rest}"


#: Of a file that follows the contract.
CONTRACT_WORDS = OwnWords()


def _format(values: Sequence[str]) -> str | None:
    """Return the format of the times that values such as `Zeit = '05.03.2026'` name."""
    words = [value.partition(" = ")[2].strip("'\"") for value in values]
    return format_of(words)[0] if all(words) else None


def refuse_too_many(
    rows: Iterable[Quarantined],
    totals: Mapping[str, int],
    max_fraction: float,
    words: OwnWords = CONTRACT_WORDS,
) -> None:
    """Stop when more of a file's rows are quarantined than the settings allow, or all of them.

    Rows that campaign.yaml excludes do not count. The message names the file, the commonest reason
    and the first line it struck.

    Args:
        rows: rows quarantined.
        totals: rows in each file.
        max_fraction: `ingest.max_quarantined_fraction`.
        words: what the files call their columns.
    """
    by_file: dict[str, list[Quarantined]] = {name: [] for name in totals}
    totals = dict(totals)
    for row in sorted(rows):
        if row.reason.startswith(EXCLUDED):
            totals[row.file] -= 1  # as its user wants it
        else:
            by_file[row.file].append(row)
    for name, listed in by_file.items():
        if len(listed) <= max_fraction * totals[name] and len(listed) < totals[name]:
            continue
        reason, times = Counter(row.reason for row in listed).most_common(1)[0]
        struck = [row for row in listed if row.reason == reason]
        columns = Counter(row.value.partition(" = ")[0] for row in struck if " = " in row.value)
        column, in_column = columns.most_common(1)[0] if columns else ("", 0)
        if 2 * in_column > times:
            struck = [row for row in struck if row.value.startswith(f"{column} = ")]
        shown = struck[0].value
        raise RawDataError(
            f"{len(listed)} of {totals[name]} rows would be quarantined, "
            f"{times} of them because: {reason}",
            where=f"{name}:{struck[0].line}" + (f": {words.called(column)}" if column else ""),
            value=shown or None,
            allowed=f"at most {max_fraction:.0%} (ingest.max_quarantined_fraction)",
            remedy=words.remedy_of_rows(reason, struck, most=2 * len(listed) > totals[name]),
        )
