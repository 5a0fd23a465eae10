"""Exports of motion capture and measuring software that are no plain tables, made into tables.

Each reader takes the lines of a file and yields those of a table: labels, times in seconds, and
what was measured.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain, pairwise
from typing import NamedTuple

from pa10cal.campaign.column_names import canonical_unit
from pa10cal.campaign.text_lines import TextLine, comma_fields, table_row
from pa10cal.errors import RawDataError

#: Units of lengths by their words in headers.
_UNITS = {
    **{"meters": "m", "metres": "m", "millimeters": "mm", "millimetres": "mm"},
    **{"centimeters": "cm", "centimetres": "cm", "inches": "in"},
}


def _wrong_header(what: str, where: str, value: str, allowed: str) -> RawDataError:
    """Return the refusal of a take with a wrong header."""
    return RawDataError(
        what,
        where=where,
        value=value,
        allowed=allowed,
        remedy="export the take again as CSV with its header, or write columns for the file by "
        "hand: header states the line of the names",
    )


def _rate_hz(fields: Sequence[str]) -> float:
    """Return the frames per second in the first field; 0 where it is no number."""
    try:
        return float(fields[0])
    except (IndexError, ValueError):
        return 0.0


# OptiTrack Motive.

#: Columns of a body's orientation, by the axis.
_QUATERNION = {"X": "qx", "Y": "qy", "Z": "qz", "W": "qw"}
#: Columns of the frame and the time.
_BEFORE_BODIES = 2
#: Lines of a header of Motive, at most.
_MOTIVE_LINES = 20


def motive_table(lines: Iterator[TextLine], where: str, notes: list[str]) -> Iterator[TextLine]:
    """Yield a table of rigid bodies (position, orientation) and markers (position)."""
    first = next(lines, TextLine(1, "", ended=True))
    stated = comma_fields(first.text)
    about = {key.lower(): value for key, value in zip(stated[::2], stated[1::2], strict=False)}
    above: list[list[str]] = []
    last = first
    for last in lines:
        fields = comma_fields(last.text)
        if fields[0].lower() == "frame":
            break
        above.append(fields)
        if len(above) > _MOTIVE_LINES:
            break
    axes = comma_fields(last.text)
    version = about.get("format version", "")
    if axes[0].lower() != "frame" or not above:
        raise _wrong_header(
            "the header of the take lacks the line with Frame and Time",
            f"{where}:{last.number}",
            f"format version {version}",
            "lines of Type, Name, ID, then Rotation and Position, then Frame, Time and X, Y, Z",
        )
    words = about.get("length units", "").lower()
    if words not in _UNITS:
        raise _wrong_header(
            "the unit of lengths is not known",
            f"{where}:{first.number}: Length Units",
            words or "nothing",
            ", ".join(_UNITS),
        )
    by_title = {row[1].lower(): row for row in above if len(row) > 1 and row[1]}
    header = _MotiveHeader(
        by_title.get("type", []),
        by_title.get("name", above[0]),
        above[-1],
        axes,
        _UNITS[words],
        about.get("rotation type", "Quaternion").lower() == "quaternion",
    )
    titles = [header.title(k) for k in range(len(axes))]
    if any(" solved " in title for title in titles):
        notes.append("markers where the bodies have them (Rigid Body Marker) are not read")
    yield TextLine(last.number, table_row(titles), ended=True)
    for line in lines:
        yield TextLine(line.number, table_row(comma_fields(line.text)), line.ended)


class _MotiveHeader(NamedTuple):
    """The lines of a header of Motive that name its columns, field by field."""

    kinds: Sequence[str]  # what a column is of, such as a rigid body or a marker
    names: Sequence[str]  # the name of that
    parts: Sequence[str]  # position or rotation
    axes: Sequence[str]  # Frame, Time, X, Y, …
    unit: str  # of lengths
    quaternion: bool  # whether rotations are quaternions

    def title(self, k: int) -> str:
        """Return a name for column k, from 0, with its unit."""
        kind, name, part = (
            row[k] if k < len(row) else "" for row in (self.kinds, self.names, self.parts)
        )
        axis = self.axes[k]
        if k < _BEFORE_BODIES and axis.lower().startswith("time"):
            return "Time [s]"
        if k < _BEFORE_BODIES or not name:
            return axis
        if kind.lower() == "rigid body marker" and axis in _QUATERNION:
            return f"{name} solved {'XYZW'.index(axis) + 1}"  # from the body, not measured
        if part == "Position" and axis in ("X", "Y", "Z"):
            return f"{name} {axis.lower()} [{self.unit}]"
        if part == "Rotation" and self.quaternion and axis in _QUATERNION:
            return f"{name} {_QUATERNION[axis]}"
        if part == "Rotation":
            return f"{name} r{axis.lower()} [deg]"
        return " ".join(word for word in (name, part, axis) if word)


# Vicon: sections with a name, a rate, names of bodies or markers, axes, units, rows.

_VICON_AXES = {
    **{"X": "x", "Y": "y", "Z": "z", "TX": "x", "TY": "y", "TZ": "z"},
    **{"RX": "rx", "RY": "ry", "RZ": "rz"},
}
_VICON_SECTIONS = ("trajectories", "segments", "objects", "bodies", "global angles")
_VICON_HEADER = 4  # lines below the name of a section
_NUMBER = re.compile(r"[-+]?\d+\.?\d*(e[-+]?\d+)?", re.I)


@dataclass
class _Section:
    """A section of an export of Vicon."""

    title: TextLine
    head: list[TextLine]

    def columns(self, where: str) -> tuple[float, list[str]]:
        """Return the rate in Hz, and a name for every column."""
        if len(self.head) < _VICON_HEADER or not comma_fields(self.head[2].text)[0].startswith(
            "Frame"
        ):
            raise _wrong_header(
                f"the section {self.title.text.strip(', ')} lacks a part of its header",
                f"{where}:{self.title.number}",
                self.head[-1].text.strip(", ") if self.head else "nothing",
                "a line each with the rate, the names, Frame and Sub Frame and axes, and units",
            )
        rate, names, axes, units = (comma_fields(line.text) for line in self.head[:_VICON_HEADER])
        rate_hz = _rate_hz(rate)
        if any(_NUMBER.fullmatch(each) for each in units):
            raise _wrong_header(
                f"the section {self.title.text.strip(', ')} lacks the line of units",
                f"{where}:{self.head[-1].number}",
                ", ".join(units),
                "a line such as ,,mm,mm,mm below the axes",
            )
        if rate_hz <= 0.0:
            raise _wrong_header(
                "the rate is not a number",
                f"{where}:{self.head[0].number}",
                rate[0],
                "frames a second, such as 100",
            )
        turns, titles, name = "RW" in axes, [], ""
        for k, axis in enumerate(axes):
            name = names[k] if k < len(names) and names[k] else name
            unit = units[k] if k < len(units) else ""
            word = _VICON_AXES.get(axis.upper(), axis)
            if axis.upper() in ("RX", "RY", "RZ", "RW") and turns:
                word, unit = f"q{axis[1].lower()}", ""
            bare = name.rpartition(":")[2] or name
            titles.append(f"{bare} {word} [{unit}]" if unit else f"{bare} {word}".strip())
        return rate_hz, ["Frame", "Sub Frame", "Time [s]", *titles[2:]]


def vicon_table(lines: Iterator[TextLine], where: str, notes: list[str]) -> Iterator[TextLine]:
    """Yield a table of the first section with bodies or markers; other sections are noted."""
    section: _Section | None = None
    rate_hz, done = 0.0, False
    for line in lines:
        fields = comma_fields(line.text)
        if not fields[0][:1].isdigit() and fields[0].lower() in _VICON_SECTIONS:
            done = section is not None
            if done:
                notes.append(f"the section {fields[0]} is not read")
            else:
                section = _Section(line, [])
            continue
        if section is None or done:
            continue
        if len(section.head) < _VICON_HEADER:
            section.head.append(line)
            if len(section.head) == _VICON_HEADER:
                rate_hz, names = section.columns(where)
                yield TextLine(line.number, table_row(names), ended=True)
            continue
        if not fields[0].isdigit():  # the name of a section that is not known
            notes.append(f"the section {fields[0]} is not read")
            done = True
            continue
        time_s = f"{int(fields[0]) / rate_hz:.6f}"
        yield TextLine(line.number, table_row([*fields[:2], time_s, *fields[2:]]), line.ended)
    if section is None or len(section.head) < _VICON_HEADER:
        (section or _Section(TextLine(1, "", ended=True), [])).columns(where)


# Qualisys: lines of a word and values, then rows; of bodies 16 numbers each.

#: Elements of the rotation matrix in the order in which a row has them: column by column.
_ROT = tuple(f"r{row}{column}" for column in (1, 2, 3) for row in (1, 2, 3))
_OF_A_BODY = ("X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{k}]" for k in range(9)))


def qualisys_table(lines: Iterator[TextLine], where: str, notes: list[str]) -> Iterator[TextLine]:
    """Yield a table of bodies (position, matrix) or of markers; zeros where one was not seen."""
    about: dict[str, list[str]] = {}
    last = TextLine(1, "", ended=True)
    row: list[str] = []
    for last in lines:
        row = [field.strip() for field in last.text.split("\t")]
        if re.fullmatch(r"[-+\d.,eE]+", row[0]):
            break
        if re.fullmatch(r"[A-Z0-9_]{4,}", row[0]):
            about[row[0]] = row[1:]
    bodies = [name for name in about.get("BODY_NAMES", []) if name]
    markers = [name for name in about.get("MARKER_NAMES", []) if name]
    of_each = _OF_A_BODY if bodies else ("X", "Y", "Z")
    names = bodies or markers
    before = len(row) - len(of_each) * len(names) - (row[-1:] == [""])
    if not names or before not in (0, 1, 2) or not row[0][:1].strip("-+").isdigit():
        raise _wrong_header(
            "the rows do not have the columns that the header names",
            f"{where}:{last.number}",
            f"{len(row)} fields, {len(names)} names",
            f"{len(of_each)} numbers for each name of BODY_NAMES or MARKER_NAMES, with Frame and "
            "Time before them or without",
        )
    rate_hz = _rate_hz(about.get("FREQUENCY", ()))
    if before < 2 and rate_hz <= 0.0:
        raise _wrong_header(
            "neither a time nor the rate is in the file",
            where,
            "FREQUENCY is missing",
            "a column Time, or the line FREQUENCY",
        )
    words: tuple[str, ...] = ("x [mm]", "y [mm]", "z [mm]")
    if bodies:
        notes.append("Roll, Pitch and Yaw are not read, but the matrix")
        words = (*words, "turn 1", "turn 2", "turn 3", "residual [mm]", *_ROT)
    titles = [f"{name} {word}" for name in names for word in words]
    yield TextLine(last.number, table_row(["Frame", "Time [s]", *titles]), ended=True)
    for frame, line in enumerate(chain([last], lines)):
        values = [field.strip() for field in line.text.split("\t")]
        start = values[:before]
        number = start[0] if start else str(frame + 1)
        time_s = start[1] if before == 2 and len(start) == 2 else f"{frame / rate_hz:.6f}"
        body = values[before:]
        body = body[:-1] if len(body) == len(titles) + 1 and body[-1] == "" else body
        for k in range(0, len(body), len(of_each)):
            if all(_is_zero(value) for value in body[k : k + 3]):
                body[k : k + 3] = [""] * len(body[k : k + 3])
        yield TextLine(line.number, table_row([number, time_s, *body]), line.ended)


def _is_zero(value: str) -> bool:
    return value == "" or not value.strip("-+0.,")


# Blocks of named values, as T-Scan writes them.

_BLOCK = re.compile(r"\s*\D{0,20}\b(?P<label>\d+)\s*:?\s*", re.ASCII)
_VALUE = re.compile(r"(?P<name>[A-Za-z]\w*)\s*=\s*(?P<value>[^\s=]+)")
#: Named values in a line of a block, at least.
_LEAST_VALUES = 3


def begins_blocks(head: Sequence[str]) -> bool:
    """Return whether a number of a position is followed by a line of named values."""
    return any(
        _BLOCK.fullmatch(one) and len(_VALUE.findall(two)) >= _LEAST_VALUES
        for one, two in pairwise(head)
    )


def block_table(lines: Iterator[TextLine], where: str, notes: list[str]) -> Iterator[TextLine]:
    """Yield a table of named values, a row for each line, with the number of their block."""
    names: list[str] = []
    label, others = "", 0
    for line in lines:
        values = _VALUE.findall(line.text)
        block = _BLOCK.fullmatch(line.text)
        if block is not None:
            label = block["label"]
        if len(values) < _LEAST_VALUES:
            others += block is None
            continue
        if not names:
            names = [name for name, _ in values]
            yield TextLine(line.number, table_row(["Position", *names]), ended=True)
        of_line = dict(values)
        fields = [label, *(of_line.get(name, "") for name in names)]
        yield TextLine(line.number, table_row(fields), ended=line.ended)
    if others:
        notes.append(f"{others} lines of {where} hold no named values")


# Reports of points: SpatialAnalyzer, PolyWorks, FARO CAM2.

_AXES = ("x", "y", "z")


@dataclass
class _Point:
    """A point of a report."""

    line: int  # its first line
    labels: tuple[str, ...]
    places: dict[str, str] = field(default_factory=dict)  # coordinates as written, by axis

    @property
    def whole(self) -> bool:
        """Return whether it has three coordinates."""
        return len(self.places) == len(_AXES)


@dataclass
class _Report:
    """The points of a report, as far as the file goes.

    Its last line may be torn. Then the last point is cut: its coordinates may be missing, or lack
    digits. It is yielded as a line without its end, which is told where the table is read.
    """

    called: str  # title of the labels
    unit: str = ""  # unit of the coordinates; empty where none is stated
    points: list[_Point] = field(default_factory=list)
    last: TextLine = field(default_factory=lambda: TextLine(1, "", ended=True))  # of the file
    torn: bool = False  # whether that line is known to be incomplete

    def table(self, where: str, notes: list[str]) -> Iterator[TextLine]:
        """Yield the points that have three coordinates, and note how many have not."""
        points = list(self.points)
        if self.torn and points and points[-1].whole:  # the torn line is of the next point
            points.append(_Point(self.last.number, (self.last.text.strip(),)))
        whole = [point for point in points if point.whole]
        if not whole:
            raise RawDataError(
                "no point with a measured x, y and z is in the report",
                where=where,
                value=f"{len(points)} objects" if points else "no object",
                allowed="points, circles or spheres with three measured coordinates each",
                remedy="add x, y and z of each point to the report, or export the points as text",
            )
        end = points[-1]
        begun = bool(end.places) and not (self.last.ended and end.whole)
        cut = end if self.torn or begun else None
        others = sum(not point.whole and point is not cut for point in points)
        if others:
            notes.append(f"{others} objects without a measured x, y and z are not read")
        in_unit = f" [{self.unit}]" if self.unit else ""
        header = [self.called, *(f"{axis.upper()}{in_unit}" for axis in _AXES)]
        yield TextLine(1, table_row(header), ended=True)
        for point in (*(each for each in whole if each is not cut), *([cut] if cut else [])):
            places = (point.places[axis] for axis in _AXES if axis in point.places)
            fields = table_row([*point.labels, *places])
            yield TextLine(point.line, fields, ended=point is not cut)


# SpatialAnalyzer: comments, the last of which names the fields of the rows.

_COMMENT = "//"
_XYZ = re.compile(r"^//.*,\s*x\s*,\s*y\s*,\s*z\s*(,|$)", re.I)


def begins_named_points(head: Sequence[str]) -> bool:
    """Return whether a comment names the fields of the rows, including x, y and z."""
    return any(map(_XYZ.match, head))


def named_points(lines: Iterator[TextLine], _: str, __: list[str]) -> Iterator[TextLine]:
    """Yield the rows below the comments, under the names in the comment."""
    named = False
    for line in lines:
        comment = line.text.startswith(_COMMENT)
        if (not comment and named) or (not named and _XYZ.match(line.text)):
            named = True
            fields = line.text.removeprefix(_COMMENT).split(",")
            yield TextLine(line.number, table_row(each.strip() for each in fields), line.ended)


# PolyWorks: a row for each control of an object.

_CONTROLS = ("object name", "control", "meas")


def _row(text: str) -> list[str]:
    """Return the fields of a line, with tabs between them or else commas."""
    if "\t" in text:
        return [each.strip(' "') for each in text.split("\t")]
    return comma_fields(text)


def begins_controls(head: Sequence[str]) -> bool:
    """Return whether a line names columns of objects, their controls and what was measured."""
    return any(set(_CONTROLS) <= set(_row(line)) for line in head)


def control_table(lines: Iterator[TextLine], where: str, notes: list[str]) -> Iterator[TextLine]:
    """Yield the measured X, Y and Z of each object, a row for each."""
    report, at, width = _Report("Object Name"), list[int](), 0  # `at`: places of `_CONTROLS`
    points, fields = report.points, list[str]()
    for line in lines:
        report.last, fields = line, _row(line.text)
        if not at:
            words, width = [each.lower() for each in fields], len(fields)
            if words[:1] == ["units"]:
                stated = fields[1] if len(fields) > 1 else ""
                report.unit = _length_unit(stated, f"{where}:{line.number}")
            if set(_CONTROLS) <= set(words):
                at = [words.index(each) for each in _CONTROLS]
            continue
        name, control, measured = (fields[k] if k < len(fields) else "" for k in at)
        axis = control.lower()
        if not points or points[-1].labels != (name,) or axis in points[-1].places:
            points.append(_Point(line.number, (name,)))
        whole = line.ended or len(fields) >= min(width, at[-1] + 2)
        if axis in _AXES and measured and whole:
            points[-1].places[axis] = measured
    report.torn = not report.last.ended and len(fields) < width
    yield from report.table(where, notes)


def _length_unit(stated: str, where: str) -> str:
    unit = canonical_unit(stated)
    if unit not in ("mm", "cm", "m", "um", "in"):
        raise RawDataError(
            "the unit of lengths is not known",
            where=where,
            value=stated or "nothing",
            allowed="millimeters, centimeters, meters, microns or inches",
            remedy="export the report again in millimeters",
        )
    return unit


# FARO CAM2: a block for each feature, with a row for each of its properties.

_ACTUAL = re.compile(r"\tactual\s*\tnominal\b", re.I)
_PROPERTY = re.compile(r"(?:\w+\.)?([xyz])", re.I)
_WITH_UNIT = re.compile(r"([-+]?[\d.,]+)\s*([^\W\d]*)")


def begins_features(head: Sequence[str]) -> bool:
    """Return whether a line names columns of actual and nominal values."""
    return any(map(_ACTUAL.search, head))


def feature_table(lines: Iterator[TextLine], where: str, notes: list[str]) -> Iterator[TextLine]:
    """Yield the actual centre of each feature, a row for each."""
    report, actual = _Report("Feature"), 2  # `actual`: which column has the actual values
    points = report.points
    for line in lines:
        report.last, fields = line, [each.strip() for each in line.text.split("\t")]
        if _ACTUAL.search(line.text):
            actual = [each.lower() for each in fields].index("actual")
        elif fields[0] == "" and len(fields) > 1 and fields[1]:
            points.append(_Point(line.number, (fields[1],)))
        elif points and (axis := _PROPERTY.fullmatch(fields[0])) is not None:
            value = _WITH_UNIT.fullmatch(fields[actual] if actual < len(fields) else "")
            if value is None or (not line.ended and not value[2]):
                continue
            place, before = f"{where}:{line.number}", report.unit
            report.unit = _length_unit(value[2], place) if value[2] else before
            if before and report.unit != before:
                raise RawDataError(
                    f"{points[-1].labels[0]} is in another unit than the features before",
                    where=place,
                    value=f"{value[1]} {report.unit}",
                    allowed=f"{before}, as before",
                    remedy="export the report again with one unit of lengths",
                )
            points[-1].places.setdefault(axis[1].lower(), value[1])
    report.torn = not report.last.ended
    yield from report.table(where, notes)
