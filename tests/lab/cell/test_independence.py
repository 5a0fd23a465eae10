"""The cell shares no formula with the estimator."""

import ast
from pathlib import Path

import pytest

import pa10cal_lab.cell

PACKAGE = Path(pa10cal_lab.cell.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))
ALLOWED = (
    "pa10cal_lab.cell",
    "pa10cal.errors",
    "pa10cal.files",
    "pa10cal.settings_reading",
    "pa10cal.options",
)
#: The described arm, the words of the instruments, how a truth is written: no formula among them.
WORDS = {
    "pa10cal.arm.description",
    "pa10cal.arrays",
    "pa10cal.options",
    "pa10cal.observe.kinds",
    "pa10cal.results.codec",
    "pa10cal_lab.trial_records",
}


def imports(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative imports are not used here"
            yield node.module


@pytest.mark.parametrize("path", MODULES, ids=[str(path.relative_to(PACKAGE)) for path in MODULES])
def test_imports_nothing_of_the_estimator(path):
    own = [name for name in imports(path) if name.split(".")[0].startswith("pa10cal")]
    beyond = [name for name in own if not name.startswith(ALLOWED)]
    assert set(beyond) <= WORDS
