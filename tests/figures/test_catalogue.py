"""What is drawn, what the workflow asks for and what the report explains are the same."""

import re
from pathlib import Path

import pytest

from pa10cal.figures.catalogue import (
    CURVE_DRAWINGS,
    CURVE_FIGURES,
    CURVE_TABLES,
    FIGURES,
    TABLES,
    TRIAL_FIGURES,
    TRIAL_TABLES,
)

ROOT = Path(__file__).parents[2]
CAPTIONS = ROOT / "workflow/report"
CURVE = (*CURVE_DRAWINGS, *CURVE_FIGURES, *CURVE_TABLES)
NAMES = (*FIGURES, *TABLES, *TRIAL_FIGURES, *TRIAL_TABLES, *CURVE)


def test_the_workflow_draws_every_picture():
    rules = (ROOT / "workflow/rules/figures.smk").read_text("utf-8")
    figures, tables = rules.split("TABLES = {")
    assert tuple(re.findall(r'^    "(\w+)": \{', figures, re.MULTILINE)) == FIGURES
    assert tuple(re.findall(r'^    "(\w+)": \{', tables, re.MULTILINE)) == TABLES


def test_the_workflow_draws_every_picture_of_blind_trials():
    rules = (ROOT / "workflow/rules/blind_trials.smk").read_text("utf-8")
    named = re.findall(r'"(trials_\w+)": "', rules)
    assert tuple(named) == (*TRIAL_FIGURES, *TRIAL_TABLES)


def test_every_picture_has_a_module_and_a_caption():
    folder = ROOT / "src/pa10cal/figures"
    assert {path.stem for path in CAPTIONS.glob("*.rst")} == {*NAMES, "workflow"}
    assert set(NAMES) <= {path.stem for path in folder.glob("*.py")}


@pytest.mark.parametrize("name", NAMES)
def test_captions_are_short_say_that_data_are_synthetic_and_state_no_result(name):
    text = (CAPTIONS / f"{name}.rst").read_text("utf-8")
    assert 5 <= len(text.splitlines()) <= 10
    assert "synthetic data" in " ".join(text.split())
    assert not re.search(r"\d\.\d", text), "a number that a run could change"
