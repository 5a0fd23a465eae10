"""Every number that a verdict hangs on stands once, says what it bounds, and goes with it."""

import ast
import re
from dataclasses import fields
from pathlib import Path

import pytest
from field_comments import comments

import pa10cal.discovery
from pa10cal.discovery.rules import BLOCKS, MAPS, SECTIONS, decisions

DISCOVERY = Path(pa10cal.discovery.__path__[0])
MODULES = [path for path in sorted(DISCOVERY.rglob("*.py")) if path.name != "rules.py"]
#: Units, counts of components and halves; any other number of discovery bounds something.
PLAIN_NUMBERS = {0, 1, 2, 3, 4, 6, 10, 100, 0.5, 1e3, 1e6, 3600}
SOURCES = {
    "level",
    "statistics",
    "size",
    "trials",
    "vocabulary",
    "safety",
    "told",
    "computing",
    "Cressie, Statistics for Spatial Data, 1993",
}


def numbers_in(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            yield node


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(DISCOVERY)))
def test_numbers_that_bound_something_stand_on_one_page(path):
    tree = ast.parse(path.read_text("utf-8"))
    found = [(node.lineno, node.value) for node in numbers_in(tree)]
    assert [each for each in found if each[1] not in PLAIN_NUMBERS] == []
    constants = [part for part in tree.body if isinstance(part, ast.Assign | ast.AnnAssign)]
    alone = [part.lineno for part in constants if isinstance(part.value, ast.Constant)]
    # but for places in a row of parts, and for words
    assert [number for number in found if number[0] in alone and number[1] not in (0, 1, 2)] == []


@pytest.mark.parametrize("section", SECTIONS)
def test_every_number_says_what_it_bounds_and_where_it_is_from(section):
    of = type(SECTIONS[section])
    for number in fields(of):
        found = re.search(r"\(([^()]*)\)$", comments(of)[number.name])
        assert found, number.name
        assert found[1] in SOURCES, number.name


def test_a_verdict_carries_those_that_decide():
    carried = decisions()
    assert set(carried) == set(SECTIONS) - {"computing"}
    assert carried["blocks"]["least_share"] == BLOCKS.least_share
    assert carried["maps"]["spacings"] == [list(pair) for pair in MAPS.spacings]
