"""Points in the programs of controllers as tables of joint positions: KUKA, FANUC, ABB, Yaskawa.

Each reader takes the lines of a file and yields those of a table: labels, and joint positions as
the controller has them. Points that hold a pose of the tool are only counted.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from pa10cal.campaign.text_lines import TextLine, table_row
from pa10cal.errors import RawDataError

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
#: What to do where a program holds poses of the tool alone.
_LOG_JOINTS = (
    "export the joint positions: teach the points anew as joint positions, or log where the arm "
    "stood at each of them"
)


@dataclass(frozen=True)
class _Point:
    """A point of a program."""

    line: int  # its first line
    labels: tuple[str, ...]  # its name, and its comment in formats that have one
    axes: dict[str, str]  # positions by the name of the axis; empty for a pose of the tool
    whole: bool = True  # False if the file ends within it


def _table(
    points: Sequence[_Point], axis: str, cut: TextLine | None, where: str, notes: list[str]
) -> Iterator[TextLine]:
    """Yield a table of points, without external axes that are 0 in all of them.

    `axis` is an example in messages; `cut` is the last line of a program whose end is missing.
    """
    placed = [point for point in points if point.axes]
    if not placed:
        raise RawDataError(
            "no joint positions are in the program",
            where=where,
            value=f"{len(points)} points with a pose of the tool" if points else "no point",
            allowed=f"points with a position for each axis, such as {axis}",
            remedy=_LOG_JOINTS if points else "export the program with its points",
        )
    if len(placed) < len(points):
        notes.append(f"{len(points) - len(placed)} points hold a pose of the tool and are not read")
    names = list(dict.fromkeys(name for point in placed for name in point.axes))
    extra = [name for name in names if name[0] == "E"]
    used = [name for name in names if name not in extra or _moves(name, placed)]
    labelled = any(point.labels[1:] != ("",) for point in placed if len(point.labels) > 1)
    labels = ["Point", "Comment"] if labelled else ["Point"]
    yield TextLine(1, table_row([*labels, *used]), ended=True)
    for point in placed:
        values = [point.axes.get(name, "") for name in used if point.whole or name in point.axes]
        fields = [*point.labels[: len(labels)], *values]
        yield TextLine(point.line, table_row(fields), ended=point.whole)
    if cut is not None and (placed[-1].whole or set(used) <= set(placed[-1].axes)):
        yield TextLine(cut.number, cut.text.strip().replace("\t", " "), ended=False)


def _moves(name: str, points: Iterable[_Point]) -> bool:
    return any(float(point.axes.get(name, 0.0)) != 0.0 for point in points)


# KUKA: DECL E6AXIS XP1={A1 10.0,A2 -90.0,…,E1 0.0,…}

_KUKA_TYPES = r"\b(E6AXIS|AXIS|E6POS|POS|FRAME)\s+(\w+)"
#: An array is declared with its type and length; its elements are assigned without the type.
_KUKA_ARRAY = re.compile(rf"{_KUKA_TYPES}\s*\[\s*\d*\s*\]", re.I)
_KUKA_POINT = re.compile(
    rf"(?:{_KUKA_TYPES}|\b(\w+))(\s*\[\s*\d*\s*\])?\s*=\s*\{{([^}}]*)(\}}?)", re.I
)
_KUKA_AXIS = re.compile(rf"\b([AE]\d)\s+({_NUMBER})", re.I)


def kuka_points(lines: Iterable[TextLine], where: str, notes: list[str]) -> Iterator[TextLine]:
    """Yield the E6AXIS and AXIS points of a data list: A1 … A6, and axes E1 … that are used.

    Points of the inline forms are called XP1 there, and P1 by their users; elements of arrays P[1].
    """
    points, last, ended = [], None, False
    arrays: dict[str, str] = {}  # type by the name of an array
    for line in lines:
        last = line
        ended = ended or bool(re.match(r"\s*ENDDAT\b", line.text, re.I))
        text = line.text.partition(";")[0]
        arrays |= {name.upper(): kind for kind, name in _KUKA_ARRAY.findall(text)}
        for stated, typed, untyped, index, inside, end in _KUKA_POINT.findall(text):
            name = typed or untyped
            kind = stated or (arrays.get(name.upper(), "") if index else "")
            if kind.upper() in ("", "FRAME"):
                continue
            label = name[1:] if len(name) > 1 and name[0] in "Xx" else name
            label += "".join(index.split())
            axes = {}
            if kind.upper().endswith("AXIS"):
                for axis, value in _KUKA_AXIS.findall(inside):
                    axes[f"{axis.upper()} [deg]" if axis[0] in "Aa" else axis.upper()] = value
            points.append(_Point(line.number, (label,), axes, bool(end)))
    yield from _table(points, "A1 … A6 of E6AXIS", None if ended else last, where, notes)


# FANUC: P[1:"name"]{ GP1: … J1= 10.0 deg, … }; and position registers.

_FANUC = re.compile(r'^\s*P\[(\d+)\s*(?::\s*"?([^"\]]*)"?\s*)?\]\s*\{')
_REGISTER = re.compile(r"^\s*\[(\d+),(\d+)\]\s*=\s*'([^']*)'(\s*Uninitialized)?")
_REGISTERS = re.compile(r"\$POSREG\b.*ARRAY\[\d+,(\d+)\]")
_FANUC_AXIS = re.compile(rf"\b([JE]|EXT)(\d)\s*[=:]\s*({_NUMBER})\s*(deg|mm|rad)\b")
_POSE = re.compile(r"\bX\s*[=:]")


@dataclass
class _FanucBlock:
    """The lines of a point, those of motion group 1 alone."""

    line: int  # its first line
    labels: tuple[str, str]  # its name and its comment
    whole: bool  # False if its end is missing
    lines: list[TextLine] = field(default_factory=list)


def fanuc_points(lines: Iterable[TextLine], where: str, notes: list[str]) -> Iterator[TextLine]:
    """Yield the points of a program that are taught as joint positions, by group 1."""
    every = list(lines)
    ended = any(re.match(r"\s*/END\b", line.text) for line in every)
    points = _fanuc_points(_program_blocks(every), where)
    cut = None if ended or not every else every[-1]
    yield from _table(points, "J1 … J6 in deg", cut, where, notes)


def fanuc_registers(lines: Iterable[TextLine], where: str, notes: list[str]) -> Iterator[TextLine]:
    """Yield the position registers (POSREG.VA) that hold joint positions, by group 1."""
    every = list(lines)
    sizes = [size[1] for line in every if (size := _REGISTERS.search(line.text))]
    begun = [register[2] for line in every if (register := _REGISTER.match(line.text))]
    ended = bool(sizes) and sizes[-1] in begun  # the file holds the last register of the array
    points = _fanuc_points(_register_blocks(every, ended=ended), where)
    cut = None if ended or not every else every[-1]
    yield from _table(points, "J1 … J6 in deg", cut, where, notes)


def _program_blocks(lines: Iterable[TextLine]) -> Iterator[_FanucBlock]:
    """Yield the points of a program, each up to its brace; one without it lacks its end."""
    block: _FanucBlock | None = None
    group = 1
    for line in lines:
        if (found := _FANUC.match(line.text)) is not None:
            if block is not None:
                yield block
            labels = f"P{found[1]}", (found[2] or "").strip()
            block, group = _FanucBlock(line.number, labels, whole=False), 1
        if (of_group := re.match(r"\s*GP(\d)\s*:", line.text)) is not None:
            group = int(of_group[1])
        if block is None:
            continue
        if group == 1:
            block.lines.append(line)
        if "}" in line.text:
            block.whole = True
            yield block
            block = None
    if block is not None:
        yield block


def _register_blocks(lines: Iterable[TextLine], *, ended: bool) -> Iterator[_FanucBlock]:
    """Yield the registers of group 1, each up to the next one; the last is whole if all are there.

    `ended` says whether the file holds the last register of the array.
    """
    block: _FanucBlock | None = None
    for line in lines:
        if (found := _REGISTER.match(line.text)) is not None:
            if block is not None:
                yield block
            labels = f"PR{found[2]}", found[3].strip()
            used = int(found[1]) == 1 and not found[4]  # of group 1, and initialized
            block = _FanucBlock(line.number, labels, whole=True) if used else None
        if block is not None:
            block.lines.append(line)
    if block is not None:
        block.whole = ended
        yield block


def _fanuc_points(blocks: Iterable[_FanucBlock], where: str) -> list[_Point]:
    """Return the points that hold joint positions or a pose of the tool."""
    points = []
    units: dict[str, str] = {}  # unit by axis, the same in all points
    for block in blocks:
        axes: dict[str, str] = {}
        for line in block.lines:
            for letter, number, value, unit in _FANUC_AXIS.findall(line.text):
                axis = f"{letter[0]}{number}"
                if units.setdefault(axis, unit) != unit:
                    raise RawDataError(
                        f"{axis} is in two units",
                        where=f"{where}:{line.number}",
                        value=f"{value} {unit}",
                        allowed=f"{units[axis]}, as in the points before",
                        remedy="export points of one motion group, all in the same units",
                    )
                axes[f"{axis} [{unit}]"] = value
        is_pose = any(map(_POSE.search, (line.text for line in block.lines)))
        if is_pose and not any(name[0] == "J" for name in axes):
            axes = {}  # external axes of a pose alone
        if axes or is_pose:
            points.append(_Point(block.line, block.labels, axes, block.whole))
    return points


# ABB: CONST jointtarget p1:=[[r1,…,r6],[9E+09,…]];

_ABB_NAMED = re.compile(r"\b(jointtarget|robtarget)\s+(\w+)\s*(?:\{[^}]*\})?\s*:=", re.I)
_SIX = rf"\[\s*({_NUMBER}(?:\s*,\s*{_NUMBER}){{0,5}})\s*\]"
_ABB_JOINTS = re.compile(rf"\[\s*{_SIX}\s*,\s*{_SIX}\s*\]")
#: The position of an external axis that does not exist.
_ABB_NONE = 9e9


def abb_points(lines: Iterable[TextLine], where: str, notes: list[str]) -> Iterator[TextLine]:
    """Yield the joint targets of a RAPID module, declared, in arrays, or in MoveAbsJ itself."""
    points: list[_Point] = []
    last, ended, begins, statement = None, False, 0, ""
    for line in lines:
        last = line
        ended = ended or bool(re.match(r"\s*ENDMODULE\b", line.text, re.I))
        for part in re.split(r"(?<=;)", line.text.partition("!")[0]):
            if not part.strip():
                continue
            begins, statement = (begins if statement else line.number), statement + part
            if part.endswith(";"):
                points += _abb_statement(statement, begins)
                statement = ""
    if not ended:  # an array may be cut short
        points += _abb_statement(statement, begins)
    yield from _table(points, "jointtarget", None if ended else last, where, notes)


def _abb_statement(statement: str, line: int) -> Iterator[_Point]:
    named = _ABB_NAMED.search(statement)
    if named is None and not re.search(r"\bMoveAbsJ\b", statement, re.I):
        return
    label = f"line{line}" if named is None else named[2]
    if named is not None and named[1].lower() == "robtarget":
        yield _Point(line, (label,), {})
        return
    targets = _ABB_JOINTS.findall(statement)
    for k, (robot, external) in enumerate(targets, start=1):
        values = [value.strip() for value in robot.split(",")]
        axes = {f"J{j} [deg]": value for j, value in enumerate(values, start=1)}
        for j, value in enumerate(external.split(","), start=1):
            if float(value) < _ABB_NONE:
                axes[f"E{j}"] = value.strip()
        yield _Point(line, (label if len(targets) == 1 else f"{label}{{{k}}}",), axes)


# Yaskawa: C00000=pulses of the motors.


def yaskawa_points(lines: Iterable[TextLine], where: str, notes: list[str]) -> Iterator[TextLine]:
    """Refuse a job: its points are pulses of the motors, or poses of the tool."""
    for line in lines:
        if (kind := re.match(r"\s*///POSTYPE\s+(\w+)", line.text)) is not None:
            pulses = kind[1] == "PULSE"
            raise RawDataError(
                "a Yaskawa job holds "
                + ("pulses of the motors" if pulses else "poses of the tool")
                + ", and no joint positions",
                where=f"{where}:{line.number}",
                value=line.text.strip(),
                allowed="joint positions in degrees",
                remedy="export a table of the points with the axes S, L, U, R, B, T in degrees: "
                "the current position of the pendant shown as ANGLE at each point, or a log of the "
                "controller"
                + (
                    ", or the pulses divided by the pulses per degree of each axis"
                    if pulses
                    else ""
                ),
            )
    yield from _table([], "S, L, U, R, B, T in deg", None, where, notes)
