"""XML of a URDF as robots have it: prefixes need no declaration, and comments may be kept."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree
from xml.parsers import expat

from pa10cal.arm.attitude import roll_pitch_yaw
from pa10cal.arrays import Array


@dataclass(frozen=True)
class UrdfText:
    """A URDF as elements."""

    robot: ElementTree.Element  # the outermost element
    before: tuple[str, ...]  # comments that stand before it, such as a licence

    def text(self, *comments: str) -> str:
        """Return the file, further comments first."""
        lines = [f"<!--{as_comment(comment)}-->" for comment in (*comments, *self.before)]
        body = ElementTree.tostring(self.robot, encoding="unicode")
        return "\n".join(['<?xml version="1.0"?>', *lines, body]) + "\n"


def parse_urdf(text: str, *, comments: bool = False) -> UrdfText:
    """Read a URDF.

    Args:
        text: the file's content.
        comments: whether comments stay where they are.

    Raises:
        ValueError: when it is not XML, saying where.
    """
    builder = ElementTree.TreeBuilder(insert_comments=comments)
    before: list[str] = []
    depth = [0]
    parser = expat.ParserCreate()
    parser.ordered_attributes = False
    parser.buffer_text = True

    def start(tag: str, attributes: dict[str, str]) -> None:
        depth[0] += 1
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        depth[0] -= 1
        builder.end(tag)

    def comment(content: str) -> None:
        if depth[0]:
            builder.comment(content)
        else:
            before.append(content)

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler, parser.CommentHandler = builder.data, comment
    try:
        parser.Parse(text.encode("utf-8"), True)
    except expat.ExpatError as error:
        raise ValueError(str(error)) from None
    return UrdfText(builder.close(), tuple(before))


def origin_of(T: Array) -> dict[str, str]:
    """Return the attributes of an origin at a pose (4, 4), to the last digit."""
    return {"xyz": words(T[:3, 3]), "rpy": words(roll_pitch_yaw(T[:3, :3]))}


def words(values: Array) -> str:
    """Return numbers as text, to the last digit."""
    return " ".join(repr(float(value)) for value in values)


def as_comment(text: str) -> str:
    """Return a text as the content of a comment, which has no two hyphens in a row."""
    while "--" in text:
        text = text.replace("--", "- -")
    return f" {text} " if text[:1].strip() else text
