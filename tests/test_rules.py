"""Every number that a grade or a verdict hangs on stands once and says what it bounds."""

import ast
import re
from dataclasses import fields
from pathlib import Path

import pytest
from field_comments import comments

import pa10cal
from pa10cal.calibration import rules as of_calibration
from pa10cal.discovery import rules as of_discovery
from pa10cal.discovery.rules import BLOCKS, MAPS, decisions

PACKAGE = Path(pa10cal.__path__[0])
MODULES = [
    path
    for package in ("calibration", "discovery")
    for path in sorted((PACKAGE / package).rglob("*.py"))
    # options say what they are in config.yaml, and other numbers are on the page of rules
    if path.name not in ("rules.py", "other_numbers.py", "options.py")
]
SECTIONS = [*of_calibration.SECTIONS.values(), *of_discovery.SECTIONS.values()]
#: Units, counts of components and halves; any other number there bounds something.
PLAIN_NUMBERS = {0, 1, 2, 3, 4, 6, 9, 10, 50, 100, 0.5, 1e3, 1e6, 3600, 1e-3, 32, 1.8}
SOURCES = {
    "level",
    "statistics",
    "size",
    "trials",
    "vocabulary",
    "safety",
    "told",
    "computing",
    "measured",
    "Cressie, Statistics for Spatial Data, 1993",
}


def numbers_in(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            yield node


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_numbers_that_bound_something_stand_on_one_page(path):
    tree = ast.parse(path.read_text("utf-8"))
    found = [(node.lineno, node.value) for node in numbers_in(tree)]
    assert [each for each in found if each[1] not in PLAIN_NUMBERS] == []
    constants = [part for part in tree.body if isinstance(part, ast.Assign | ast.AnnAssign)]
    alone = [part.lineno for part in constants if isinstance(part.value, ast.Constant)]
    # but for places in a row of parts, and for words
    assert [number for number in found if number[0] in alone and number[1] not in (0, 1, 2)] == []


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: type(section).__qualname__)
def test_every_number_says_what_it_bounds_and_where_it_is_from(section):
    of = type(section)
    for number in fields(of):
        found = re.search(r"\(([^()]*)\)$", comments(of)[number.name])
        assert found, number.name
        assert found[1] in SOURCES, number.name


def test_a_verdict_carries_those_that_decide():
    carried = decisions()
    assert set(carried) == set(of_discovery.SECTIONS) - {"computing"}
    assert carried["blocks"]["least_share"] == BLOCKS.least_share
    assert carried["maps"]["spacings"] == [list(pair) for pair in MAPS.spacings]
