"""Reports of measuring software as tables of points: SpatialAnalyzer, PolyWorks, FARO CAM2.

Each reader takes the lines of a file and yields those of a table: labels, and what was measured.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from pa10cal.campaign.recognise import canonical_unit
from pa10cal.campaign.text_lines import TextLine, comma_fields, table_row
from pa10cal.errors import RawDataError

_AXES = ("x", "y", "z")


@dataclass
class _Point:
    """A point of a report."""

    line: int  # where it begins
    labels: tuple[str, ...]
    places: dict[str, str] = field(default_factory=dict)  # as they are written, by the axis


def _table(
    points: list[_Point],
    called: str,
    unit: str,
    where: str,
    notes: list[str],
    last: TextLine,
    *,
    torn: bool,
) -> Iterator[TextLine]:
    """Yield a table of the points that have three coordinates.

    The file may end with the end of its last line, and else that may be `torn`.
    """
    ended = last.ended
    if torn and points and len(points[-1].places) == len(_AXES):  # in what follows that point
        points.append(_Point(last.number, (last.text.strip(),)))
    whole = [point for point in points if len(point.places) == len(_AXES)]
    cut = [
        point for point in points[-1:] if torn or (point.places and not (ended and point in whole))
    ]
    if not whole:
        raise RawDataError(
            "no point with a measured x, y and z is in the report",
            where=where,
            value=f"{len(points)} objects" if points else "no object",
            allowed="points, circles or spheres with three measured coordinates each",
            remedy="add x, y and z of each point to the report, or export the points as text",
        )
    others = len(points) - len(whole) - len([point for point in cut if point not in whole])
    if others:
        notes.append(f"{others} objects without a measured x, y and z are not read")
    in_unit = f" [{unit}]" if unit else ""
    header = [called, *(f"{axis.upper()}{in_unit}" for axis in _AXES)]
    yield TextLine(1, table_row(header), ended=True)
    for point in (*(each for each in whole if each not in cut), *cut):
        fields = [*point.labels, *(point.places[axis] for axis in _AXES if axis in point.places)]
        yield TextLine(point.line, table_row(fields), ended=point not in cut)


# SpatialAnalyzer: comments, the last of which names the fields of the rows.

_COMMENT = "//"
_XYZ = re.compile(r"^//.*,\s*x\s*,\s*y\s*,\s*z\s*(,|$)", re.I)


def begins_named_points(head: Sequence[str]) -> bool:
    """Return whether a comment names the fields of the rows, x, y and z among them."""
    return any(map(_XYZ.match, head))


def named_points(lines: Iterator[TextLine], _: str, __: list[str]) -> Iterator[TextLine]:
    """Yield the rows below the comments, under the names that the comment has."""
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
    unit, at, points, width = "", list[int](), list[_Point](), 0
    last, fields = TextLine(1, "", ended=True), list[str]()
    for last in lines:
        fields = _row(last.text)
        if not at:
            words, width = [each.lower() for each in fields], len(fields)
            if words[:1] == ["units"]:
                unit = _length_unit(fields[1] if len(fields) > 1 else "", f"{where}:{last.number}")
            if set(_CONTROLS) <= set(words):
                at = [words.index(each) for each in _CONTROLS]
            continue
        name, control, measured = (fields[k] if k < len(fields) else "" for k in at)
        axis = control.lower()
        if not points or points[-1].labels != (name,) or axis in points[-1].places:
            points.append(_Point(last.number, (name,)))
        whole = last.ended or len(fields) >= min(width, at[-1] + 2)
        if axis in _AXES and measured and whole:
            points[-1].places[axis] = measured
    torn = not last.ended and len(fields) < width
    yield from _table(points, "Object Name", unit, where, notes, last, torn=torn)


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
    actual, unit, points = 2, "", list[_Point]()
    last = TextLine(1, "", ended=True)
    for last in lines:
        fields = [each.strip() for each in last.text.split("\t")]
        if _ACTUAL.search(last.text):
            actual = [each.lower() for each in fields].index("actual")
        elif fields[0] == "" and len(fields) > 1 and fields[1]:
            points.append(_Point(last.number, (fields[1],)))
        elif points and (axis := _PROPERTY.fullmatch(fields[0])) is not None:
            value = _WITH_UNIT.fullmatch(fields[actual] if actual < len(fields) else "")
            if value is None or (not last.ended and not value[2]):
                continue
            found = _length_unit(value[2], f"{where}:{last.number}") if value[2] else unit
            if unit and found != unit:
                raise RawDataError(
                    f"{points[-1].labels[0]} is in another unit than the features before",
                    where=f"{where}:{last.number}",
                    value=f"{value[1]} {found}",
                    allowed=f"{unit}, as before",
                    remedy="export the report again with one unit of lengths",
                )
            unit = found
            points[-1].places.setdefault(axis[1].lower(), value[1])
    yield from _table(points, "Feature", unit, where, notes, last, torn=not last.ended)
