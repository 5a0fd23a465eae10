"""Renders sections of blocks as one HTML page, with everything in it that the page needs."""

from __future__ import annotations

import os
from base64 import b64encode
from collections.abc import Iterable, Iterator, Sequence
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from pa10cal.errors import RecordError
from pa10cal.input_files import read_file, reason
from pa10cal.reports.blocks import Callout, Drawing, Folded, Image, PageBlock, SideBySide
from pa10cal.reports.theme import packed_figure, packed_library
from pa10cal.results.outcomes import PicturesRecord

#: Larger files are no pictures that were drawn here [bytes].
_MOST_PICTURE_BYTES = 64_000_000
_SYNTHETIC = "Synthetic data: simulated, no robot was measured."


class PageSection(NamedTuple):
    """A section of a page; the template shows no empty block, and a page no section of such."""

    id: str  # of its element in the page
    title: str  # its heading
    blocks: tuple[PageBlock, ...]  # in the order of reading


class Glance(NamedTuple):
    """One of the answers at the top of the page."""

    question: str  # what it answers
    answer: str  # in a word or a number
    more: str  # one sentence


def rendered(
    title: str,
    glances: Sequence[Glance],
    sections: Sequence[PageSection],
    synthetic: bool,
    heading: str = "Calibration report",
) -> str:
    """Return a page as HTML.

    Args:
        title: the campaign, or whatever else the page is about.
        glances: the answers at its top.
        sections: in the order of reading.
        synthetic: whether what it shows was simulated.
        heading: the kind of page, which stands above the title.
    """
    sections = [section for section in sections if not all(block.empty for block in section.blocks)]
    environment = Environment(
        loader=PackageLoader("pa10cal.reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    style, script = (
        Markup(files("pa10cal.reports").joinpath(f"templates/page.{ending}").read_text("utf-8"))
        for ending in ("css", "js")
    )
    with_figures = any(_has_figures(section.blocks) for section in sections)
    text: str = environment.get_template("page.html.j2").render(
        campaign=title,
        over=heading,
        synthetic=_SYNTHETIC if synthetic else None,
        glances=glances,
        sections=sections,
        style=style,
        script=script,
        library=packed_library() if with_figures else None,
        packed_figure=packed_figure,
        version=version("pa10cal"),
    )
    return text


def _has_figures(blocks: Iterable[PageBlock]) -> bool:
    """Return whether plotly has to draw one of some blocks, folded ones included."""
    return any(
        (isinstance(block, Drawing | SideBySide) and not block.empty)
        or (isinstance(block, Folded) and _has_figures(block.blocks))
        for block in blocks
    )


def images(
    pictures: PicturesRecord | None, folder: Path, section: str
) -> Iterator[Image | Callout]:
    """Yield the figures and films of a results folder that belong to one section.

    One that was drawn and cannot be shown, as it is gone or a film that pages do not play, is told.

    Raises:
        RecordError: when one of them cannot be read.
    """
    captions = (pictures and pictures.captions) or {}
    for name, caption in captions.items():
        if caption.section != section:
            continue
        id_ = name
        for kind, endings in (("svg+xml", ("svg", "png")), ("gif", ("gif",))):
            path = folder / f"figures/{name}.{endings[0]}"
            if os.path.lexists(path):
                content = b64encode(_picture(path, folder)).decode()
                source = f"data:image/{kind};base64,{content}"
                yield Image(source, caption.title, caption.text, id_, endings)
                id_ = f"{name}-film"  # a figure has the name alone
        if id_ == name and not any(folder.glob(f"tables/{name}.*")):
            yield _not_shown(caption.title, name, folder)


def _not_shown(title: str, name: str, folder: Path) -> Callout:
    """Return why a picture that was drawn is not on the page."""
    if os.path.lexists(folder / f"figures/{name}.mp4"):
        return Callout("note", f"{title}: the film is figures/{name}.mp4, which pages do not show.")
    return Callout(
        "missing", f"{title}: figures/{name} was drawn and is there no more; draw it again."
    )


def _picture(path: Path, folder: Path) -> bytes:
    try:
        return read_file(path, _MOST_PICTURE_BYTES, folder)
    except OSError as error:
        raise RecordError(
            f"a picture cannot be read: {reason(error)}",
            where=str(path),
            allowed="a file that pa10cal figures drew, in the results",
            remedy="draw it again",
        ) from None
