"""The report in a real browser: drawn, readable, quiet, within its size."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from PIL import Image

from pa10cal.commands.command_line import run_command
from pa10cal.reports.theme import BLUE
from pa10cal.results.codec import write
from pa10cal.results.outcomes import Caption, PicturesRecord

SIZES = {"wide": (1280, 900, False), "dark": (1280, 900, True), "narrow": (380, 800, False)}
MOST_BYTES = 5e6
NOTICE = "Synthetic data: simulated, no robot was measured."
#: The largest contrast of a colour to its ground, after WCAG 2; the least for text is 4.5.
CONTRAST = """
(() => {
  const light = rgb => { const [r, g, b] = rgb.match(/[\\d.]+/g).slice(0, 3).map(v => v / 255)
    .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const ground = light(getComputedStyle(document.body).backgroundColor);
  const ratio = value => { const [a, b] = [value, ground].sort((a, b) => b - a);
    return (a + 0.05) / (b + 0.05); };
  const texts = [...document.querySelectorAll('main p:not(.callout), td, th, .plot svg text')];
  return Math.min(...texts.map(t => ratio(light(t instanceof SVGElement
    ? getComputedStyle(t).fill : getComputedStyle(t).color))));
})()
"""
#: How many figures there are, and how many are drawn.
FIGURES = """
(() => {
  const plots = [...document.querySelectorAll('.plot')];
  return {
    all: plots.length,
    drawn: plots.filter(p => p.querySelector('.main-svg')).length,
    traced: plots.filter(p => p.querySelector('.scatterlayer .trace, canvas')).length,
  };
})()
"""
#: Where a figure in space is, once it has been scrolled to and drawn again.
TURNED_TO = """
new Promise(done => {{
  const plot = document.querySelectorAll('.in-space .plot')[{number}];
  plot.scrollIntoView({{block: 'center'}});
  setTimeout(() => {{ const box = plot.getBoundingClientRect();
    done([box.left, box.top, box.right, box.bottom]); }}, 500);
}})
"""
MARKS_RGB = tuple(bytes.fromhex(BLUE.removeprefix("#")))


@pytest.fixture(scope="module", params=SIZES)
def tab(request, browser, page):
    width, height, dark = SIZES[request.param]
    return browser.open(page, width, height, dark=dark)


def test_nothing_is_complained_of_and_nothing_fetched(tab, page):
    assert tab.complaints == []
    assert tab.fetched == [page.absolute().as_uri()]


def test_every_figure_is_drawn(tab):
    found = tab.evaluate(FIGURES)
    assert found["all"] >= 4
    assert found["drawn"] == found["traced"] == found["all"]


def test_figures_in_space_show_their_marks(tab, tmp_path):
    assert tab.evaluate("document.querySelectorAll('.in-space').length") == 2
    for number in range(2):
        box = tab.evaluate(TURNED_TO.format(number=number))
        tab.screenshot(tmp_path / "seen.png")
        seen = np.asarray(Image.open(tmp_path / "seen.png").convert("RGB"), dtype=float)
        left, top, right, bottom = (round(value) for value in box)
        inside = seen[max(top, 0) : bottom, max(left, 0) : right]
        blue = np.abs(inside - MARKS_RGB).sum(axis=2) < 60
        assert blue.sum() > 100


def test_what_the_data_are_is_in_view_at_once_and_stays_there(tab):
    place = (
        "(() => { const box = document.querySelector('.synthetic').getBoundingClientRect();"
        "return [box.top, box.bottom, box.left, box.right, innerHeight, innerWidth]; })()"
    )
    for scroll in ("0", "document.body.scrollHeight"):
        tab.evaluate(f"window.scrollTo(0, {scroll})")
        top, bottom, left, right, height, width = tab.evaluate(place)
        assert 0 <= top < bottom <= height / 4
        assert left >= 0
        assert right <= width
    assert tab.evaluate("document.querySelector('.synthetic').innerText") == NOTICE
    tab.evaluate("window.scrollTo(0, 0)")
    heading = tab.evaluate("document.querySelector('h1').getBoundingClientRect().bottom")
    assert heading < 400


def test_the_page_is_no_wider_than_the_screen(tab):
    assert tab.evaluate("document.documentElement.scrollWidth <= innerWidth")
    beyond = (
        "[...document.querySelectorAll('main p, main figure, main .scroll, main dl, main pre')]"
    )
    assert (
        tab.evaluate(
            f"{beyond}.filter(e => e.getBoundingClientRect().right > innerWidth + 1).length"
        )
        == 0
    )


def test_text_stands_out_from_its_ground(tab):
    assert tab.evaluate(CONTRAST) >= 4.5


def test_it_is_small(browser, page):
    """How soon it is there is printed and not asserted: that depends on the machine.

    `pytest tests/browser -rP -k small` shows it.
    """
    assert page.stat().st_size <= MOST_BYTES
    seconds = min(browser.open(page, 1280, 900).seconds for _ in range(3))
    print(f"{page.stat().st_size / 1e6:.2f} MB, there after {seconds:.1f} s of the processor")


@pytest.mark.parametrize("size", SIZES)
def test_by_keyboard_the_first_step_skips_to_the_report(browser, page, size):
    # In a tab of its own: where a page was scrolled to is where the next step begins.
    width, height, dark = SIZES[size]
    tab = browser.open(page, width, height, dark=dark)
    for kind in ("keyDown", "keyUp"):
        tab.send(
            "Input.dispatchKeyEvent", type=kind, key="Tab", code="Tab", windowsVirtualKeyCode=9
        )
    assert tab.evaluate("document.activeElement.getAttribute('href')") == "#main"
    visible = "document.activeElement.getBoundingClientRect()"
    assert tab.evaluate(f"{visible}.left") >= 0


def test_prints(tab, tmp_path):
    tab.pdf(tmp_path / "report.pdf")
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF")


def test_tables_and_figures_can_be_saved_offline(tab, page):
    csv = tab.evaluate("asCsv(document.querySelector('figure.table table'))")
    assert csv.splitlines()[0] == "used,load [N],poses,readings,readings of a configuration"
    assert csv.splitlines()[1].startswith("to fit,0,")
    saved = """
    new Promise(done => {
      HTMLAnchorElement.prototype.click = function() { done([this.download, this.href]); };
      document.querySelector('.plot').closest('figure').querySelector('[data-save="KIND"]').click();
    })
    """
    for kind, begins in (("png", "data:image/png"), ("svg", "data:image/svg+xml")):
        name, href = tab.evaluate(saved.replace("KIND", kind))
        assert name.endswith(f".{kind}")
        assert href.startswith(begins)
    assert tab.fetched == [page.absolute().as_uri()]


def test_pictures_among_the_results_stand_in_the_page(browser, page, tmp_path):
    results = shutil.copytree(page.parent, tmp_path / page.parent.name)
    (results / "figures").mkdir()
    svg = '<svg xmlns="http://www.w3.org/2000/svg" width="40" height="20"></svg>'
    (results / "figures/gap_by_step.svg").write_text(svg)
    said = {"title": "The gap", "text": "Step by step.", "section": "accuracy"}
    write(
        PicturesRecord(
            drawn=("gap_by_step",), omitted={}, captions={"gap_by_step": Caption(**said)}
        ),
        results / PicturesRecord.FILE,
    )
    assert run_command("report", [str(results), "--out", str(results / "report.html")]) == 0
    tab = browser.open(results / "report.html", 1280, 900)
    shown = "document.querySelector('#accuracy .image img')"
    assert tab.evaluate(f"[{shown}.naturalWidth, {shown}.alt]") == [40, "The gap"]
    assert tab.evaluate(f"asPng({shown})").startswith("data:image/png")
    assert tab.complaints == []
