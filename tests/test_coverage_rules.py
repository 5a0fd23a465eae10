"""The rules of the coverage study."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
RULES = {"coverage"}


@pytest.mark.slow
def test_one_target_covers_both_models_with_the_settings_given(tmp_path, call_snakemake):
    section = json.dumps({"campaigns": 3, "random_seed": 7, "poses": 44})
    pairs = [f"raw_dir={ROOT / 'data/raw'}", f"results_dir={tmp_path}", f"coverage={section}"]
    words = ("--cores", "1", "--nocolor", "-n", "-p", "-s", ROOT / "Snakefile", "coverage")
    code, text = call_snakemake(*words, "--config", *pairs, cwd=tmp_path)
    assert code == 0, text
    jobs = re.search(r"^Job stats:\n.*\n-.*\n((?:\S+ +\d+\n)+)", text, re.MULTILINE)[1].split()
    assert set(jobs[::2]) == {*RULES, "total"}
    assert "coverage --settings" in text
    assert '"random_seed":7,"campaigns":3' in text
    assert '"poses":44' in text
