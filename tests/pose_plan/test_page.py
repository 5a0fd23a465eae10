"""The page docs/plan.md: its example runs as it stands there."""

from __future__ import annotations

import csv
import re
import shlex
from pathlib import Path

from pa10cal.__main__ import main

PAGE = (Path(__file__).parents[2] / "docs/plan.md").read_text(encoding="utf-8")


def block(language):
    return re.search(rf"^```{language}\n(.*?)^```$", PAGE, re.M | re.S).group(1)


def test_the_command_of_the_page_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("box.yaml").write_text(block("yaml"), encoding="utf-8")
    program, *words = shlex.split(block("sh").replace("\\\n", ""))
    assert program == "pa10cal"
    assert main([*words, "--options", '{"candidates": 150, "effects": 0}']) == 0
    rows = list(csv.DictReader(Path("plan.csv").read_text(encoding="utf-8").splitlines()))
    assert len(rows) == 40
    assert Path("plan.json").exists()


def test_the_lines_of_python_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(block("python"), "docs/plan.md", "exec"), {})
    assert Path("plan.csv").exists()
