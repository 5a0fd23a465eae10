"""Every picture: drawn from real records, legible, and the same bytes each time."""

import os
import pickle
import re
import subprocess
import sys

import pytest

from made_up_results import elsewhere
from pa10cal.figures.draw import of_campaign
from pa10cal.figures.registry import entries
from pa10cal.figures.style import write_figure

FIGURES = {name: entry for name, entry in entries("campaign").items() if entry.kind == "figure"}
#: Pictures of discovery are drawn where it named something as well.
CASES = [
    *(("results", name) for name in FIGURES),
    *(("named", name) for name in FIGURES if "analysis" in FIGURES[name].needs),
]
#: One of every kind of drawing: in space, with an image of thousands of points, plain.
KINDS = ("fig4_test_path", "where_joints", "montecarlo_planes")
STARTS = {"svg": b"<?xml", "pdf": b"%PDF", "png": b"\x89PNG"}
UNITS = re.compile(r"\[(mm|%|µrad|mrad|mrad; mm|N m|h|°C|K)\]|tolerance")
BEGIN = "Campaign cell-null. Synthetic data. Provenance: virtual cell, independent of this project."

DRAW_ALL = """
import pickle, sys
from pathlib import Path
from pa10cal.figures.draw import of_campaign
from pa10cal.figures.registry import entries
from pa10cal.figures.style import theme, write_figure
results = pickle.loads(bytes.fromhex(sys.argv[1]))
for name in sys.argv[3:]:
    with theme():
        figure = entries("campaign")[name].make(results)
        write_figure(figure, of_campaign(results).footer, Path(sys.argv[2]), name, 80)
"""


@pytest.mark.slow
@pytest.mark.parametrize(("source", "name"), CASES)
def test_is_legible_in_three_formats_and_says_what_it_was_drawn_from(
    request, tmp_path, written_legibly, source, name
):
    results = request.getfixturevalue(source)
    footer = of_campaign(results).footer
    texts = written_legibly(FIGURES[name].make(results), footer, tmp_path, name)
    for ending, start in STARTS.items():
        assert (tmp_path / f"{name}.{ending}").read_bytes().startswith(start)
    assert any(text.startswith(BEGIN) for text in texts)
    assert any(map(UNITS.search, texts))


@pytest.mark.slow
def test_another_process_writes_the_same_bytes(results, tmp_path, project_looks):
    here, there = tmp_path / "here", tmp_path / "there"
    for name in KINDS:
        write_figure(FIGURES[name].make(results), of_campaign(results).footer, here, name, 80)
    words = [pickle.dumps(elsewhere(results)).hex(), str(there), *KINDS]
    env = {**os.environ, "PYTHONHASHSEED": "7", "TZ": "Asia/Tokyo", "SOURCE_DATE_EPOCH": "1"}
    subprocess.run([sys.executable, "-c", DRAW_ALL, *words], check=True, env=env, timeout=120)
    written = sorted(there.iterdir())
    assert len(written) == 3 * len(KINDS)
    for path in written:
        assert (here / path.name).read_bytes() == path.read_bytes(), path.name
