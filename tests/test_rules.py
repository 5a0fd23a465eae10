"""Every number that a grade or a verdict hangs on stands once and says what it bounds."""

import ast
import re
from dataclasses import fields
from pathlib import Path

import pytest
from field_comments import comments

import pa10cal
from pa10cal import rules as of_all
from pa10cal.calibration import rules as of_calibration
from pa10cal.discovery import rules as of_discovery
from pa10cal.discovery.rules import BLOCKS, MAPS, decisions

PACKAGE = Path(pa10cal.__path__[0])
PACKAGES = ("calibration", "discovery", "evaluation", "fit", "frame", "observe")
MODULES = [
    path
    for package in PACKAGES
    for path in sorted((PACKAGE / package).rglob("*.py"))
    # options say what they are in config.yaml, and tuning constants are on the page of rules
    if path.name not in ("rules.py", "tuning.py", "options.py")
]
PAGES = (of_all, of_calibration, of_discovery)
SECTIONS = [section for page in PAGES for section in page.SECTIONS.values()]
#: Units, counts of components and halves; any other number there bounds something.
PLAIN_NUMBERS = {0, 1, 2, 3, 4, 6, 9, 100, 0.5, 1e3, 1e6, 180, 3600, 1e-3, 32, 1.8}
#: Of a constant of a module that is no rule, how its comment ends.
NO_RULE = re.compile(r"\((?:computing|unit|format)\)\.$")
#: What a number bounds that stands in it.
BOUNDING = {"min", "max", "minimum", "maximum", "clip"}
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
    "chosen",
    "Cressie, Statistics for Spatial Data, 1993",
}


def numbers_in(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            yield node


def places_in(tree):
    """Yield numbers that are places in arrays, or the layout of a text."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Subscript):
            at = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
            for each in at:
                if isinstance(each, ast.Constant | ast.Slice | ast.UnaryOp):
                    yield from numbers_in(each)
        elif isinstance(node, ast.keyword) and node.arg in ("width", "max_rows"):
            yield node.value


def bounds_in(tree):
    """Yield numbers that bound something: on a side of a comparison, or a factor there."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
        elif isinstance(node, ast.Call):
            name = getattr(node.func, "id", getattr(node.func, "attr", ""))
            sides = node.args if name in BOUNDING else []
        else:
            continue
        while sides:
            side = sides.pop()
            if isinstance(side, ast.BinOp) and isinstance(side.op, ast.Mult | ast.Div):
                of_turns = ast.unparse(side.right) == "np.pi"
                sides += [side.left] * (not of_turns) + [side.right] * isinstance(side.op, ast.Mult)
            elif isinstance(side, ast.Constant) and (
                type(side.value) is float or (type(side.value) is int and side.value > 6)
            ):  # a pose has six components
                yield side


def no_rules_in(tree, lines):
    """Yield the numbers of constants of a module whose comments say that they are no rules."""
    for part in constants_of(tree):
        above = [line for line in lines[: part.lineno - 1] if line]
        if above and above[-1].startswith("#:") and NO_RULE.search(above[-1]):
            yield from numbers_in(part)


def constants_of(tree):
    return [part for part in tree.body if isinstance(part, ast.Assign | ast.AnnAssign)]


def rules_of(tree, lines):
    """Return the numbers of a module that should stand on a page: (line, number)."""
    exempt = {id(node) for node in (*places_in(tree), *no_rules_in(tree, lines))}
    found = {node for node in numbers_in(tree) if node.value not in PLAIN_NUMBERS}
    found |= {node for node in bounds_in(tree) if node.value not in (0.0, 1.0, 1e3)}
    # but for places in a row of parts, and for words
    for part in constants_of(tree):
        found |= {node for node in numbers_in(part) if node.value not in (0, 1, 2)}
    return sorted((node.lineno, node.value) for node in found if id(node) not in exempt)


def test_numbers_that_bound_something_stand_on_a_page():
    for path in MODULES:
        text = path.read_text("utf-8")
        assert rules_of(ast.parse(text), text.splitlines()) == [], path


@pytest.mark.parametrize(
    "line",
    [
        "FAR = 3.0",
        "FEW, MANY = 0, 30",
        "#: Far.\nFAR = 1e-9",
        "size = least if far > 0.25 else most",
        "inflate = rows / max(rows - dof, 0.5 * rows)",
        "by_chance = min(2.0 * count / rows, most)",
        "near = far[size < 1e-3 * largest]",
        "enough = len(rows) >= 10",
    ],
)
def test_a_number_that_bounds_something_is_found(line):
    assert rules_of(ast.parse(line), line.splitlines())


@pytest.mark.parametrize(
    "line",
    [
        "#: Steps\n#: of a fit (computing).\nSTEPS = 20",
        "moved[..., 0, 5] = x",
        "def half(size):\n    return 0.5 * size",
    ],
)
def test_a_number_that_is_no_rule_is_not(line):
    assert not rules_of(ast.parse(line), line.splitlines())


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
