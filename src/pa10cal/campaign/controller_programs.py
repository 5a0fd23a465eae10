"""Points in the programs of controllers as tables of joint positions: KUKA, FANUC, ABB, Yaskawa.

Each reader takes the lines of a file and yields those of a table: labels, and joint positions as
the controller has them. Points that hold a pose of the tool are counted in a note, and so is all
that looks like a point and is not read, with its first line: a number that is none wholly, for one.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from pa10cal.campaign.text_lines import TextLine, table_row
from pa10cal.errors import RawDataError

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


@dataclass(frozen=True)
class _Point:
    """A point of a program with joint positions."""

    line: int  # its first line
    labels: tuple[str, ...]  # its name, and its comment in formats that have one
    axes: dict[str, str]  # positions by the name of the axis
    whole: bool = True  # False if the file ends within it


@dataclass
class _Points:
    """What a program holds."""

    read: list[_Point] = field(default_factory=list)
    pose_count: int = 0  # points that hold a pose of the tool
    other_group_count: int = 0  # points of another motion group than the first alone
    unread: list[int] = field(default_factory=list)  # lines of what looks like a point besides
    # last line of a file that ends before the end of the program
    cut: TextLine | None = None

    def table(self, axis: str, where: str, notes: list[str]) -> Iterator[TextLine]:
        """Yield a table of the points, without external axes that are 0 in all of them.

        `axis` is an example in the refusal of a program without joint positions.
        """
        if not self.read:
            self._refuse(axis, where)
        notes += self._not_read()
        used = _axes_used(self.read)
        labelled = any(point.labels[1:] != ("",) for point in self.read if len(point.labels) > 1)
        labels = ["Point", "Comment"] if labelled else ["Point"]
        yield TextLine(1, table_row([*labels, *used]), ended=True)
        for point in self.read:
            # The row of a point within which the file ends is as short as what is left of it.
            axes = used if point.whole else [name for name in used if name in point.axes]
            values = [point.axes.get(name, "") for name in axes]
            fields = [*point.labels[: len(labels)], *values]
            yield TextLine(point.line, table_row(fields), ended=point.whole)
        if self.cut is not None and not _is_short(self.read[-1], used):
            # The file ends after its last point: points may be lost, for which its last line is
            # there, as one that is cut.
            yield TextLine(self.cut.number, self.cut.text.strip().replace("\t", " "), ended=False)

    def _refuse(self, axis: str, where: str) -> None:
        """Refuse a program without joint positions."""
        problem, remedy = "no joint positions are in the program", "export it with its points"
        if self.pose_count:
            remedy = (
                "export the joint positions: teach the points anew as joint positions, or log "
                "where the arm stood at each of them"
            )
        elif self.unread:
            problem += " in a form that is read"
            remedy = "declare its points in the file, with a number for each axis"
        raise RawDataError(
            problem,
            where=where,
            value="; ".join(self._not_read()) or "no point",
            allowed=f"points with a position for each axis, such as {axis}",
            remedy=remedy,
        )

    def _not_read(self) -> Iterator[str]:
        """Yield how many points are not read, and why."""
        if self.pose_count == 1:
            yield "1 point holds a pose of the tool and is not read"
        elif self.pose_count:
            yield f"{self.pose_count} points hold a pose of the tool and are not read"
        if self.other_group_count == 1:
            yield "1 point is not read, as it is of another motion group than the first"
        elif self.other_group_count:
            yield (
                f"{self.other_group_count} points are not read, as they are of another motion "
                "group than the first"
            )
        if len(self.unread) == 1:
            yield f"1 point is not read, as it is written otherwise, in line {self.unread[0]}"
        elif self.unread:
            yield (
                f"{len(self.unread)} points are not read, as they are written otherwise, the first "
                f"in line {min(self.unread)}"
            )


def _axes_used(points: Sequence[_Point]) -> list[str]:
    """Return the axes of points in order of appearance, without external ones that stay at 0."""
    names = list(dict.fromkeys(name for point in points for name in point.axes))
    return [
        name
        for name in names
        if name[0] != "E" or any(float(point.axes.get(name, 0.0)) != 0.0 for point in points)
    ]


def _is_short(point: _Point, used: Sequence[str]) -> bool:
    """Return whether the file ends within a point, so that it lacks some of its axes."""
    return not point.whole and not set(used) <= set(point.axes)


# KUKA: DECL E6AXIS XP1={A1 10.0,A2 -90.0,…,E1 0.0,…}

_KUKA_TYPE = r"\b(E6AXIS|AXIS|E6POS|POS|FRAME)\s+"
_KUKA_INDEX = r"\s*\[\s*\d*(?:\s*,\s*\d*)*\s*\]"
#: Names are declared with their type, arrays with their lengths; they may be assigned without it.
_KUKA_NAMES = re.compile(
    rf"{_KUKA_TYPE}(\w+(?:{_KUKA_INDEX})?(?:\s*,\s*\w+(?:{_KUKA_INDEX})?)*)", re.I
)
_KUKA_POINT = re.compile(rf"(?:{_KUKA_TYPE})?\b(\w+)({_KUKA_INDEX})?\s*=\s*\{{([^}}]*)(\}}?)", re.I)
_KUKA_AXIS = re.compile(r"\s*([AE]\d)\b(.*)", re.I)
#: The type of an aggregate, which may stand before its components.
_KUKA_OWN_TYPE = re.compile(r"^\s*\w+\s*:")
#: Components of an axis, or of a place with the configuration of the arm.
_KUKA_LIKE = re.compile(r"^\s*A1\s|^\s*X\s.*\bS\s+\d", re.I)


def kuka_points(lines: Iterable[TextLine], where: str, notes: list[str]) -> Iterator[TextLine]:
    """Yield the E6AXIS and AXIS points of a data list: A1 … A6, and axes E1 … that are used.

    Points of the inline forms are called XP1 there, and P1 by their users; elements of arrays P[1].
    """
    points, last, ended = _Points(), None, False
    declared: dict[str, str] = {}  # type by name
    for line in lines:
        last = line
        ended = ended or bool(re.match(r"\s*ENDDAT\b", line.text, re.I))
        text = line.text.partition(";")[0]
        for kind, names in _KUKA_NAMES.findall(text):
            bare = re.sub(_KUKA_INDEX, "", names)
            declared |= {name.strip().upper(): kind.upper() for name in bare.split(",")}
        for stated, name, index, inside, end in _KUKA_POINT.findall(text):
            kind = stated.upper() or declared.get(name.upper(), "")
            inside = _KUKA_OWN_TYPE.sub("", inside)
            axes = _kuka_axes(inside, whole=bool(end)) if kind in ("E6AXIS", "AXIS") else {}
            if axes:
                label = name[1:] if len(name) > 1 and name[0] in "Xx" else name
                labels = (label + "".join(index.split()),)
                points.read.append(_Point(line.number, labels, axes, bool(end)))
            elif kind in ("E6POS", "POS"):
                points.pose_count += 1
            elif kind != "FRAME" and end and _KUKA_LIKE.match(inside):
                points.unread.append(line.number)
    points.cut = None if ended else last
    yield from points.table("A1 … A6 of E6AXIS", where, notes)


def _kuka_axes(inside: str, *, whole: bool) -> dict[str, str]:
    """Return positions by axis, those of the arm with their unit; none if one is no number.

    The last one of a point that is not whole may be cut.
    """
    axes: dict[str, str] = {}
    *_, last = parts = inside.split(",")
    for part in parts:
        if (found := _KUKA_AXIS.fullmatch(part)) is None:
            continue
        axis, value = found[1].upper(), found[2].strip()
        if re.fullmatch(_NUMBER, value):
            axes[f"{axis} [deg]" if axis[0] == "A" else axis] = value
        elif whole or part is not last:
            return {}
    return axes


# FANUC: P[1:"name"]{ GP1: … J1= 10.0 deg, … }; and position registers.

_FANUC = re.compile(r'^\s*P\[(\d+)\s*(?::\s*(?:"([^"]*)"|([^"\]]*)))?\s*\]\s*\{')
_FANUC_LIKE = re.compile(r"^\s*P\[\s*\d+\b.*\{\s*$")
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
    groups: set[int] = field(default_factory=set)  # motion groups that it states


def fanuc_points(lines: Iterable[TextLine], where: str, notes: list[str]) -> Iterator[TextLine]:
    """Yield the points of a program that are taught as joint positions, by group 1."""
    every = list(lines)
    ended = any(re.match(r"\s*/END\b", line.text) for line in every)
    points = _fanuc_points(_program_blocks(every), where)
    begins = (line for line in every if _FANUC_LIKE.match(line.text))
    points.unread += [line.number for line in begins if not _FANUC.match(line.text)]
    points.cut = None if ended or not every else every[-1]
    yield from points.table("J1 … J6 in deg", where, notes)


def fanuc_registers(lines: Iterable[TextLine], where: str, notes: list[str]) -> Iterator[TextLine]:
    """Yield the position registers (POSREG.VA) that hold joint positions, by group 1."""
    every = list(lines)
    sizes = [size[1] for line in every if (size := _REGISTERS.search(line.text))]
    begun = [register[2] for line in every if (register := _REGISTER.match(line.text))]
    ended = bool(sizes) and sizes[-1] in begun  # the file holds the last register of the array
    points = _fanuc_points(_register_blocks(every, ended=ended), where)
    points.cut = None if ended or not every else every[-1]
    yield from points.table("J1 … J6 in deg", where, notes)


def _program_blocks(lines: Iterable[TextLine]) -> Iterator[_FanucBlock]:
    """Yield the points of a program, each up to its brace; one without it lacks its end."""
    block: _FanucBlock | None = None
    group = 1
    for line in lines:
        text = line.text
        if (found := _FANUC.match(text)) is not None:
            if block is not None:
                yield block
            labels = f"P{found[1]}", (found[2] or found[3] or "").strip()
            block, group = _FanucBlock(line.number, labels, whole=False), 1
            text = text[found.end() :]  # a brace in the comment ends nothing
        if (of_group := re.match(r"\s*GP(\d)\s*:", text)) is not None:
            group = int(of_group[1])
        if block is None:
            continue
        if of_group is not None:
            block.groups.add(group)
        if group == 1:
            block.lines.append(line)
        if "}" in text:
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


def _fanuc_points(blocks: Iterable[_FanucBlock], where: str) -> _Points:
    """Return the points of blocks."""
    points = _Points()
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
        if is_pose and not any(name[0] == "J" for name in axes):  # external axes at most
            points.pose_count += 1
        elif axes:
            points.read.append(_Point(block.line, block.labels, axes, block.whole))
        elif block.groups and 1 not in block.groups:
            points.other_group_count += 1
        elif block.whole:
            points.unread.append(block.line)
    return points


# ABB: CONST jointtarget p1:=[[r1,…,r6],[9E+09,…]];

_ABB_NAMED = re.compile(r"\b(jointtarget|robtarget)\s+(\w+)\s*(?:\{([^}]*)\})?\s*:=", re.I)
_ABB_MOVES = re.compile(r"\bMoveAbsJ\b", re.I)
_SIX = rf"\[\s*({_NUMBER}(?:\s*,\s*{_NUMBER}){{0,5}})\s*\]"
_ABB_JOINTS = re.compile(rf"\[\s*{_SIX}\s*,\s*{_SIX}\s*\]")
#: Two lists of six, whatever is in them: a jointtarget, and no frame.
_ABB_LIKE = re.compile(r"\[\s*\[((?:[^][,]+,){5}[^][,]+)\]\s*,\s*\[(?:[^][,]+,){5}[^][,]+\]\s*\]")
#: A place and a quaternion, with the configuration of the arm behind: a robtarget, and no frame.
_ABB_POSE = re.compile(r"\[\s*\[(?:[^][,]+,){2}[^][,]+\]\s*,\s*\[(?:[^][,]+,){3}[^][,]+\]\s*,\s*\[")
_ABB_TEXT = re.compile(r'"[^"]*"')
#: The position of an external axis that does not exist.
_ABB_NONE = 9e9


@dataclass
class _Statement:
    """A statement of a RAPID module, of one or more lines, with a space between."""

    text: str = ""
    begins: list[tuple[int, int]] = field(default_factory=list)  # offset and number of each line

    def add(self, part: str, number: int) -> None:
        """Add a part of a line."""
        self.begins.append((len(self.text), number))
        self.text += part + " "

    def line_at(self, offset: int) -> int:
        """Return the number of the line in which a letter stands."""
        return max(number for begin, number in self.begins if begin <= offset)


def abb_points(lines: Iterable[TextLine], where: str, notes: list[str]) -> Iterator[TextLine]:
    """Yield the joint targets of a RAPID module, declared, in arrays, or in MoveAbsJ itself."""
    points, last, ended, statement = _Points(), None, False, _Statement()
    for line in lines:
        last = line
        ended = ended or bool(re.match(r"\s*ENDMODULE\b", line.text, re.I))
        text = _ABB_TEXT.sub('""', line.text).partition("!")[0]
        for part in re.split(r"(?<=;)", text):
            if part.strip():
                statement.add(part, line.number)
            if part.endswith(";"):
                _add_abb_points(points, statement)
                statement = _Statement()
    if not ended:  # an array may be cut short
        _add_abb_points(points, statement)
        points.cut = last
    yield from points.table("jointtarget", where, notes)


def _add_abb_points(points: _Points, statement: _Statement) -> None:
    """Add the points of a statement."""
    text = statement.text
    poses = len(_ABB_POSE.findall(text))
    like = [(found.start(), found[1]) for found in _ABB_LIKE.finditer(text)]
    named, moves = _ABB_NAMED.search(text), _ABB_MOVES.search(text)
    if named is not None and named[1].lower() == "robtarget":
        points.pose_count += max(poses, 1)
        return
    points.pose_count += poses
    if named is not None:
        label = named[2]
    elif moves is not None:
        label = f"line{statement.line_at(moves.start())}"
    else:  # a value that is assigned to a name or handed to a routine
        points.unread += [statement.line_at(offset) for offset, _ in like]
        return
    targets = list(_ABB_JOINTS.finditer(text))
    begins = {target.start() for target in targets}
    points.unread += [statement.line_at(offset) for offset, _ in like if offset not in begins]
    # Elements of an array count, whether or not they are read.
    elements = sorted(begins.union(offset for offset, _ in like))
    index_of = _abb_indices("" if named is None else named[3] or "", len(elements))
    for target in targets:
        values = [value.strip() for value in target[1].split(",")]
        axes = {f"J{j} [deg]": value for j, value in enumerate(values, start=1)}
        for j, value in enumerate(target[2].split(","), start=1):
            if float(value) < _ABB_NONE:
                axes[f"E{j}"] = value.strip()
        labels = (label + index_of[elements.index(target.start())],)
        points.read.append(_Point(statement.line_at(target.start()), labels, axes))


def _abb_indices(lengths: str, count: int) -> list[str]:
    """Return the indices of an array's elements in braces, from its lengths, such as 2,3.

    They are numbered where the lengths are no numbers or do not agree, and "" of one alone.
    """
    if count == 1:
        return [""]
    of_each = [int(length) for length in lengths.split(",") if length.strip().isdigit()]
    if len(of_each) != lengths.count(",") + 1 or math.prod(of_each) != count:
        of_each = [count]
    indices = itertools.product(*(range(1, length + 1) for length in of_each))
    return ["{" + str(index).strip("(,)").replace(" ", "") + "}" for index in indices]


# Yaskawa: C00000=pulses of the motors.


#: What the points of a job are, by its types; ANGLE, for one, is in no manual known here.
_YASKAWA_TYPES = {
    "PULSE": "pulses of the motors",
    **dict.fromkeys(("BASE", "ROBOT", "TOOL", "USER", "MTOOL"), "poses of the tool"),
}


def yaskawa_points(lines: Iterable[TextLine], where: str, _notes: list[str]) -> Iterator[TextLine]:
    """Refuse a job: its points are pulses of the motors, poses of the tool, or of another type."""
    told = [
        (line.number, found[1].upper())
        for line in lines
        if (found := re.match(r"\s*///POSTYPE\s+(\w+)", line.text)) is not None
    ]
    kinds = list(dict.fromkeys(kind for _, kind in told))
    known = {_YASKAWA_TYPES.get(kind, f"points of the type {kind}"): None for kind in kinds}
    holds = " and ".join(known) or "pulses of the motors or poses of the tool"
    no_joints = ", and no joint positions" if set(kinds) <= set(_YASKAWA_TYPES) else ""
    by_gear = ", or the pulses divided by the pulses per degree of each axis"
    raise RawDataError(
        f"a Yaskawa job is not read: it holds {holds}{no_joints}",
        where=f"{where}:{told[0][0]}" if told else where,
        value=", ".join(f"///POSTYPE {kind}" for kind in kinds) or "no line ///POSTYPE",
        allowed="joint positions in degrees",
        remedy="export a table of the points with the axes S, L, U, R, B, T in degrees: the "
        "current position of the pendant shown as ANGLE at each point, or a log of the controller"
        + by_gear
        * ("PULSE" in kinds),
    )
