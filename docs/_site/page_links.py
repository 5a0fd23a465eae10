"""Pages named in the text, as `docs/raw-data.md` or decision 17, become links."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform

_PAGE = r"docs/(?P<page>[\w/-]+)\.md|(?P<beside>benchmarks/[\w-]+|CONTRIBUTING|CHANGELOG)\.md"
_IN_TEXT = re.compile(rf"\b(?:{_PAGE}|[Dd]ecisions? (?P<decision>\d+))\b")
_NO_LINKS_IN = (nodes.title, nodes.reference, pending_xref, nodes.literal, nodes.literal_block)


class PageLinks(SphinxTransform):
    """Turns names of pages into links; a page that does not exist is a warning."""

    default_priority = 5

    def apply(self, **kwargs: Any) -> None:
        """Look through the literals and the text of the page."""
        del kwargs
        for literal in list(self.document.findall(nodes.literal)):
            found = re.fullmatch(_PAGE, literal.astext())
            if found and not _within(literal.parent, _NO_LINKS_IN):
                literal.replace_self(self._linked(found, literal))
        for text in list(self.document.findall(nodes.Text)):
            if _IN_TEXT.search(text) and not _within(text.parent, _NO_LINKS_IN):
                text.parent.replace(text, list(self._parts(text)))

    def _parts(self, text: nodes.Text) -> Iterator[nodes.Node]:
        end = 0
        for found in _IN_TEXT.finditer(text):
            yield nodes.Text(text[end : found.start()])
            yield self._linked(found, text.parent)
            end = found.end()
        yield nodes.Text(text[end:])

    def _linked(self, found: re.Match[str], near: nodes.Element) -> nodes.Node:
        """Return a link to the page that is named, under its title or as the decision it is."""
        names = found.groupdict()
        page, words = names["page"] or (names["beside"] or "").lower(), ""
        if number := names.get("decision"):
            (file,) = (Path(self.env.srcdir) / "decisions").glob(f"{int(number):04d}-*.md")
            page, words = f"decisions/{file.stem}", found[0]
        if page == self.env.docname:
            return nodes.inline(found[0], words or "this page")
        return _link(page, words, self.env.docname, near)


def _link(page: str, words: str, here: str, near: nodes.Element) -> pending_xref:
    """Return a link to a page, under these words or under its title."""
    inside = nodes.inline(words, words, classes=["xref", "std", "std-doc"])
    link = pending_xref(
        "",
        inside,
        refdomain="std",
        reftype="doc",
        reftarget=f"/{page}",
        refexplicit=bool(words),
        refwarn=True,
        refdoc=here,
    )
    link.source, link.line = near.source, near.line
    return link


def _within(node: nodes.Node | None, kinds: tuple[type[nodes.Node], ...]) -> bool:
    while node is not None:
        if isinstance(node, kinds):
            return True
        node = node.parent
    return False


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the transform."""
    app.add_transform(PageLinks)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
