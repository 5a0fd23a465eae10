"""Columns of a raw file: their units, and the file's own names beside those of the contract.

All messages follow one rule: a column has the file's own name, then that of the contract in
brackets, `A6 [°]` (`q6`); a remedy is a key of campaign.yaml and the value to set.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from pa10cal.campaign.column_names import unit_of

#: Units by their size in the contract's unit: mm, degrees, N m, seconds, N, degrees Celsius.
LENGTHS = {"mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3, "in": 25.4}
ANGLES = {"deg": 1.0, "rad": 57.29577951308232, "mrad": 0.05729577951308232, "gon": 0.9}
#: Units of joint positions, which may be turns, too.
JOINT_ANGLES = ANGLES | {"turns": 360.0}
#: The unit of joint positions that are counts of an encoder.
COUNTS = "counts"
TORQUES = {"Nm": 1.0, "Nmm": 1e-3, "kNm": 1e3}
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "d": 86400.0}
FORCES = {"N": 1.0, "kg": 9.80665}
TEMPERATURES = {"C": 1.0, "K": 1.0, "F": 5.0 / 9.0}  # with `OFFSETS`
#: Numbers in a unit are multiplied by a factor, then an offset is added, for the contract's unit.
FACTORS = {
    **(LENGTHS | JOINT_ANGLES | TORQUES | TIMES | FORCES | TEMPERATURES),
    "": 1.0,
}
OFFSETS = {"K": -273.15, "F": -160.0 / 9.0}
QUATERNION = ("qw", "qx", "qy", "qz")
_JOINT = re.compile(r"(q\d+)_(?:deg|mm)")
#: A name that needs no quotes in YAML.
_PLAIN = re.compile(r"[^\W\d][\w.]*")
#: Units of one quantity each.
_FAMILIES = (LENGTHS, JOINT_ANGLES, TORQUES, TIMES, FORCES, TEMPERATURES)
#: Units in words, for messages.
UNIT_WORDS = {
    **{"um": "micrometres", "mm": "millimetres", "cm": "centimetres", "in": "inches"},
    **{"m": "metres", "deg": "degrees", "rad": "radians", "mrad": "milliradians"},
    **{"C": "degrees Celsius"},
}


@dataclass(frozen=True)
class OwnColumn:
    """The source of a column of the contract in a file with its own names of columns."""

    names: tuple[str, ...]  # the file's own column, or columns that hold it together
    unit: str = ""  # the file's own unit
    factor: float = 1.0  # the contract's number is factor * own number + offset
    offset: float = 0.0
    key: str = ""  # the key of campaign.yaml that maps it, such as columns.poses.joints
    zero: float = 0.0  # the part of the offset that `joint_offsets_deg` of campaign.yaml adds
    weights: tuple[float, ...] = (1.0,)  # of columns whose sum the number is

    @property
    def name(self) -> str:
        """Return the file's own name, or the names of all columns that hold it together."""
        return ", ".join(self.names)


@dataclass(frozen=True)
class ColumnMap:
    """The sources of the contract's columns in a file; empty if the file follows the contract."""

    sources: Mapping[str, OwnColumn] = field(default_factory=dict)  # by the contract's names
    section: str = ""  # the section of campaign.yaml that states them, such as columns.poses

    def __or__(self, other: ColumnMap) -> ColumnMap:
        """Return the columns of two files; for a column in both, the source in the other."""
        return ColumnMap({**self.sources, **other.sources})

    @property
    def own_names(self) -> list[str]:
        """Return the file's own names of the columns that are mapped."""
        names = (name for source in self.sources.values() for name in source.names)
        return list(dict.fromkeys(names))

    def column(self, name: str) -> str:
        """Return the file's own name of a column with that of the contract; if unmapped the latter.

        Joints are shortened to `q1`, components of a quaternion to `qw … qz`.
        """
        if name not in self:
            return name
        joint = _JOINT.fullmatch(name)
        short = joint[1] if joint else "qw … qz" if name in QUATERNION else name
        own = ", ".join(f"`{part}`" for part in self.sources[name].names)
        return f"{own} (`{short}`)"

    def joint(self, number: int) -> str:
        """Return the column of a joint, numbered from 1, as `column` does."""
        names = [name for name in (f"q{number}_deg", f"q{number}_mm") if name in self]
        return self.column(names[0]) if names else f"q{number}"

    def __contains__(self, name: str) -> bool:
        return name in self.sources

    def text(self, text: str) -> str:
        """Return a text with every column of the contract in it replaced as by `column`."""
        return re.sub(r"\w+", lambda match: self.column(match[0]), text)

    def key(self, name: str) -> str:
        """Return the key of campaign.yaml that maps a column of the contract; empty for none."""
        return self.sources[name].key if name in self else ""

    def key_called(self, own: str) -> str:
        """Return the key that maps the column with the file's own name; empty for none."""
        keys = (source.key for source in self.sources.values() if own in source.names)
        return next(keys, "")

    def set_unit(self, name: str, unit: str, right: str) -> str:
        """Return the remedy for a column that is in another unit than is stated.

        Args:
            name: the column of the contract.
            unit: the unit that it is in, as campaign.yaml writes it.
            right: the unit of the contract, in words.
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

        `names` are the columns of the contract in the order in which their sources should be named.
        """
        own = [self.sources[name].names[0] for name in names if name in self]
        quoted = (
            name if _PLAIN.fullmatch(name) else "'{}'".format(name.replace("'", "''"))
            for name in own
        )
        return f"set {self.key(names[0])}.names: [{', '.join(quoted)}]"

    def contradicted_units(self, file: str) -> Iterator[str]:
        """Yield a warning where a header states another unit than the column is read in.

        Of several columns under one key only the first is reported.
        """
        reported: set[str] = set()
        for name, own in self.sources.items():
            header = unit_of(own.names[0])
            known = any({header, own.unit} <= family.keys() for family in _FAMILIES)
            if known and header != own.unit and own.key not in reported:
                reported.add(own.key)
                yield (
                    f"{file}: {self.column(name)}: its header says {header}, and it is read in "
                    f"{own.unit}; {self.set_unit(name, header, own.unit)} if the header is right"
                )

    def called(self, own: str) -> str:
        """Return the column with the file's own name as `column` does."""
        names = [name for name, source in self.sources.items() if source.name == own]
        if names:
            return self.column(names[0])
        return f"`{own}`" if self.key_called(own) else own


#: The map of a file that follows the contract.
CONTRACT_COLUMNS = ColumnMap()
