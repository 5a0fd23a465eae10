"""What a page shows of its blocks."""

import pytest

from pa10cal.reports.blocks import Callout, Facts, Folded, Grid, Items, Paragraph, SideBySide
from pa10cal.reports.render import PageSection, images, rendered
from pa10cal.results.outcomes import Caption, PicturesRecord

SVG = "<svg xmlns='http://www.w3.org/2000/svg'/>"


@pytest.mark.parametrize(
    "block",
    [
        Folded("more", (Items(()), Grid("c", ("h",), ()))),
        Facts((("x", ""),)),
        Folded("more", (SideBySide(()),)),
        Folded("more", (Folded("within", ()),)),
    ],
    ids=["folded", "facts", "figures", "nested"],
)
def test_what_is_empty_is_not_shown(block):
    page = rendered("c", [], [PageSection("only", "Only this", (block,))], synthetic=False)
    assert "Only this" not in page
    assert 'id="library"' not in page
    beside = PageSection("only", "Only this", (Paragraph("text"), Folded("more", (block,))))
    page = rendered("c", [], [beside], synthetic=False)
    assert "Only this" in page
    assert not any(f"<{tag}>" in page for tag in ("details", "dl"))
    assert 'id="library"' not in page


def record(*names):
    captions = {name: Caption(title=name, text="to see", section="s") for name in names}
    return PicturesRecord(drawn=names, omitted={}, captions=captions)


def test_pictures_that_cannot_be_shown_are_told(tmp_path):
    (tmp_path / "figures").mkdir()
    (tmp_path / "tables").mkdir()
    for name in ("here.svg", "film.mp4", "both.svg", "both.gif"):
        (tmp_path / "figures" / name).write_text(SVG)
    (tmp_path / "tables/rows.csv").write_text("a\n")
    found = list(images(record("here", "gone", "film", "both", "rows"), tmp_path, "s"))
    told = {each.text.partition(":")[0]: each.word for each in found if isinstance(each, Callout)}
    assert told == {"gone": "missing", "film": "note"}
    shown = [each.id for each in found if not isinstance(each, Callout)]
    assert shown == ["here", "both", "both-film"]


def test_pictures_of_synthetic_data_say_so(tmp_path):
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures/here.svg").write_text(SVG)
    section = PageSection("s", "S", tuple(images(record("here"), tmp_path, "s")))
    assert "to see Synthetic data." in rendered("c", [], [section], synthetic=True)
