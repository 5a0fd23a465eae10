"""Every picture: drawn from real records, legible, and the same bytes each time."""

import os
import pickle
import re
import subprocess
import sys
from itertools import combinations

import pytest
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.text import Text

from made_up_results import elsewhere
from pa10cal.figures.draw import of_campaign
from pa10cal.figures.registry import entries
from pa10cal.figures.style import WIDTH_MM, looks, write_figure

FIGURES = {name: entry for name, entry in entries("campaign").items() if entry.kind == "figure"}
#: Pictures of discovery are drawn where it named something as well.
CASES = [
    *(("nothing", name) for name in FIGURES),
    *(("named", name) for name in FIGURES if "analysis" in FIGURES[name].needs),
]
#: One of every kind of drawing: in space, with an image of thousands of points, plain.
KINDS = ("fig4_test_path", "where_joints", "montecarlo_planes")
DPI = 80
LEAST_POINTS = 8.0

DRAW_ALL = """
import pickle, sys
from pathlib import Path
from pa10cal.figures.draw import of_campaign
from pa10cal.figures.registry import entries
from pa10cal.figures.style import looks, write_figure
results = pickle.loads(bytes.fromhex(sys.argv[1]))
for name in sys.argv[4:]:
    with looks():
        figure = entries("campaign")[name].make(results)
        write_figure(figure, of_campaign(results).footer, Path(sys.argv[2]), name, int(sys.argv[3]))
"""


@pytest.fixture(scope="module")
def drawn(results, named, tmp_path_factory):
    """Write every figure; return the folder, and each one's texts with the boxes they fill."""
    place = tmp_path_factory.mktemp("drawn")
    texts = {case: {} for case in CASES}
    sources = {"nothing": results, "named": named}
    draw_text = Text.draw
    with pytest.MonkeyPatch.context() as patch:
        for case in CASES:
            source, name = case

            def draw(text, renderer, *rest, seen=texts[case], **more):
                draw_text(text, renderer, *rest, **more)
                if isinstance(renderer, RendererAgg) and text.get_visible() and text.get_text():
                    seen[text] = (text.get_window_extent(renderer), renderer)

            patch.setattr(Text, "draw", draw)
            with looks():
                figure = FIGURES[name].make(sources[source])
                write_figure(figure, of_campaign(sources[source]).footer, place / source, name, DPI)
    return place, texts


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids="-".join)
def test_is_written_in_three_formats(drawn, case):
    place, _ = drawn
    starts = {"svg": b"<?xml", "pdf": b"%PDF", "png": b"\x89PNG"}
    for ending, start in starts.items():
        assert (place / case[0] / f"{case[1]}.{ending}").read_bytes().startswith(start)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids="-".join)
def test_texts_are_large_enough_inside_the_picture_and_clear_of_each_other(drawn, case):
    texts = drawn[1][case]
    assert len(texts) > 10
    for text, (box, renderer) in texts.items():
        assert text.get_fontsize() >= LEAST_POINTS, text
        assert renderer.width <= DPI * WIDTH_MM / 25.4 + 1
        assert box.x0 >= -1, text
        assert box.y0 >= -1, text
        assert box.x1 <= renderer.width + 1, text
        assert box.y1 <= renderer.height + 1, text
    # The box of a slanted text, on an axis in space, is larger than the text.
    straight = [text for text in texts if text.get_rotation() % 90 == 0]
    overlapping = [
        (first.get_text(), second.get_text())
        for first, second in combinations(straight, 2)
        if texts[first][0].padded(-1).overlaps(texts[second][0].padded(-1))
    ]
    assert not overlapping


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids="-".join)
def test_says_what_it_was_drawn_from(drawn, case):
    texts = [text.get_text() for text in drawn[1][case]]
    provenance = "virtual cell, independent of this project."
    begin = f"Campaign cell-null. Synthetic data. Provenance: {provenance}"
    assert any(text.startswith(begin) for text in texts)
    assert any(
        re.search(r"\[(mm|%|µrad|mrad|mrad; mm|N m|h|°C|K)\]|tolerance", text) for text in texts
    )


@pytest.mark.slow
def test_another_process_writes_the_same_bytes(drawn, results, tmp_path):
    place, _ = drawn
    words = [pickle.dumps(elsewhere(results)).hex(), str(tmp_path), str(DPI), *KINDS]
    env = {**os.environ, "PYTHONHASHSEED": "7", "TZ": "Asia/Tokyo", "SOURCE_DATE_EPOCH": "1"}
    subprocess.run([sys.executable, "-c", DRAW_ALL, *words], check=True, env=env, timeout=120)
    written = sorted(tmp_path.iterdir())
    assert len(written) == 3 * len(KINDS)
    for path in written:
        assert (place / "nothing" / path.name).read_bytes() == path.read_bytes(), path.name
