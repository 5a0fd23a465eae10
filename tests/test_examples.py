"""The campaigns under examples/, one of them run as a newcomer would, and examples of the docs."""

from __future__ import annotations

import importlib.util
import io
import re
import shlex
import shutil
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pa10cal.__main__ import main
from pa10cal.campaign.read import read_campaign
from pa10cal.results.codec import read
from pa10cal.results.discovery import VerdictRecord

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
RUN = "pa10cal run examples/ur10-pose"
PAGES = [
    ROOT / "README.md",
    ROOT / "docs/tutorial.md",
    ROOT / "docs/using-the-model.md",
    ROOT / "docs/report.md",
    *sorted(ROOT.glob("docs/how-to/*.md")),
]
#: Kind of block, or its kind and caption; its content.
BLOCKS = re.compile(
    r"^```(?:(sh|python)|\{code-block\} (\w+)\n:caption: ([^\n]+))\n(.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
FIRST_LINES = "The first lines of "
FILES = {"irb120-points": ("poses.csv", ",", "."), "ur10-pose": ("tracker.txt", ";", ",")}


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """The examples as their script draws them."""
    spec = importlib.util.spec_from_file_location("draw", EXAMPLES / "draw_campaigns.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    folder = tmp_path_factory.mktemp("examples")
    script.main(folder)
    return folder


@pytest.mark.parametrize("name", FILES)
def test_what_is_shipped_is_what_the_cell_draws(drawn, name):
    file, separator, decimal = FILES[name]
    shipped, again = (
        pd.read_csv(folder / name / file, sep=separator, decimal=decimal)
        for folder in (EXAMPLES, drawn)
    )
    assert list(shipped) == list(again)
    numbers = shipped.select_dtypes("number").columns
    np.testing.assert_allclose(shipped[numbers], again[numbers], atol=2e-6)
    described = [folder / name / "campaign.yaml" for folder in (EXAMPLES, drawn)]
    assert described[0].read_text() == described[1].read_text()


@pytest.mark.parametrize(
    ("name", "fitted", "held_out"), [("irb120-points", 60, 20), ("ur10-pose", 240, 60)]
)
def test_every_row_can_be_used_and_they_are_said_to_be_synthetic(name, fitted, held_out):
    campaign = read_campaign(EXAMPLES / name)
    assert (len(campaign.calibration), len(campaign.held_out)) == (fitted, held_out)
    assert campaign.quarantined == ()
    assert campaign.warnings == ()
    assert "synthetic" in campaign.description.provenance
    size = sum(path.stat().st_size for path in (EXAMPLES / name).iterdir())
    assert size < 100_000


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """A folder with the examples, in which one of them has been run, and what that printed."""
    here = tmp_path_factory.mktemp("ran")
    shutil.copytree(EXAMPLES, here / "examples")
    out, err = io.StringIO(), io.StringIO()
    with chdir(here), redirect_stdout(out), redirect_stderr(err):
        assert main(RUN.split()[1:]) == 0
    for name in ("model", "june", "july"):  # as pages call a model
        for end in ("yaml", "covariance.npz"):
            shutil.copy(here / f"results/ur10-pose/model/model.{end}", here / f"{name}.{end}")
    return here, out.getvalue(), err.getvalue()


@pytest.mark.slow
def test_a_folder_runs_to_a_grade_a_model_and_figures(ran):
    here, printed, told = ran
    assert told == ""  # no terminal: nothing but the result
    row = next(line for line in printed.splitlines() if line.startswith("ur10-pose"))
    assert row.split()[1:3] == ["incomplete", "named"]
    assert "results/ur10-pose/model/model.yaml" in printed
    assert "results/ur10-pose/report.html" in printed
    results = here / "results/ur10-pose"
    verdict = read(VerdictRecord, results / "discovery/verdict.json")
    assert verdict.campaign == "ur10-pose"
    assert (results / "model/model.yaml").is_file()
    assert (results / "figures/gap_by_step.svg").is_file()
    folder = EXAMPLES / "ur10-pose"
    raw = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert {p.name: p.read_bytes() for p in (here / "examples/ur10-pose").iterdir()} == raw


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_examples_of_a_page_do_what_it_says(ran, page):
    """Captioned blocks are files, to write or as they are, or what the last command printed."""
    here, printed, _ = ran
    variables = {}
    for kind, captioned, caption, content in BLOCKS.findall(page.read_text("utf-8")):
        if caption == "output":
            assert shows(printed, content), (page.name, content, printed)
        elif caption.startswith(FIRST_LINES):
            assert (here / caption.removeprefix(FIRST_LINES)).read_text("utf-8").startswith(content)
        elif caption and (here / caption).is_file() and "/" in caption:
            assert shows((here / caption).read_text("utf-8"), content)
        elif caption:
            (here / caption).parent.mkdir(parents=True, exist_ok=True)
            (here / caption).write_text(content, encoding="utf-8")
        elif kind == "sh":
            commands = content.replace("\\\n", " ").splitlines()
            printed = "".join(ran[1] if line == RUN else typed(line, here) for line in commands)
        elif kind == "python":
            with chdir(here):
                exec(compile(content, str(page), "exec"), variables)
        assert not (captioned and not caption)


@pytest.mark.slow
def test_the_first_page_shows_what_the_run_prints(ran):
    """Its block has no caption, and wraps a long line."""
    after = (ROOT / "README.md").read_text("utf-8").partition(f"`{RUN}`")[2]
    shown = after.split("```\n")[1]
    assert "named: " in shown
    assert " ".join(shown.split()) in " ".join(ran[1].split())


def typed(line, here):
    """Type one line at a prompt in a folder, and return what it printed."""
    words, _, target = line.partition(" > ")
    name, *arguments = shlex.split(words, comments=True)
    out = io.StringIO()
    with chdir(here), redirect_stdout(out):
        if name == "mkdir":
            Path(arguments[-1]).mkdir(parents=True, exist_ok=True)
        elif name == "cp":
            shutil.copy(*arguments)
        else:
            assert name == "pa10cal", line
            assert main(arguments) == 0, line
        if target:
            Path(target.strip()).write_text(out.getvalue(), encoding="utf-8")
    return out.getvalue()


def shows(text, expected):
    """Say whether a text has these lines in it; `…` stands for anything."""
    pattern = ".*".join(map(re.escape, expected.split("…")))
    return re.search(pattern, text, re.DOTALL) is not None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (None, "there is no campaign.yaml"),
        ("name: .hidden", "letters, digits"),
        ("name: curve", "allowed: no folder of a study; set name: my-curve"),
        ("robot: ur11", "ur11"),
    ],
)
def test_a_folder_that_cannot_be_run_is_refused_in_one_message(tmp_path, capsys, change, message):
    folder = tmp_path / "mine"
    folder.mkdir()
    if change:
        for path in (EXAMPLES / "irb120-points").iterdir():
            (folder / path.name).write_bytes(path.read_bytes())
        key = change.partition(":")[0]
        lines = (folder / "campaign.yaml").read_text().splitlines()
        lines = [change if line.startswith(f"{key}:") else line for line in lines]
        (folder / "campaign.yaml").write_text("\n".join(lines))
    assert main(["run", str(folder), "--out", str(tmp_path / "out")]) == 2
    shown = capsys.readouterr().err
    assert message in shown
    assert shown.count("\n") == 1


@pytest.mark.slow
def test_where_a_stage_refuses_the_report_says_so(tmp_path, capsys):
    folder = tmp_path / "mine"
    shutil.copytree(EXAMPLES / "irb120-points", folder)
    lines = (folder / "poses.csv").read_text().splitlines(keepends=True)
    (folder / "poses.csv").write_text("".join(lines[:4]))
    assert main(["run", str(folder), "--out", str(tmp_path / "out")]) == 2
    shown = capsys.readouterr().err
    page = tmp_path / "out/irb120-points/report.html"
    assert shown.count("\n") == 1
    assert f"report so far: {page}" in shown
    told = page.read_text("utf-8")
    assert "refused:" in told
    assert "Synthetic data" in told


@pytest.mark.slow
def test_a_run_in_the_folder_of_raw_files_writes_beside_it(tmp_path, capsys, monkeypatch):
    folder = tmp_path / "irb120-points"
    shutil.copytree(EXAMPLES / "irb120-points", folder)
    lines = (folder / "poses.csv").read_text().splitlines(keepends=True)
    (folder / "poses.csv").write_text("".join(lines[:4]))  # so few that `calibrate` refuses them
    monkeypatch.chdir(folder)
    before = sorted(folder.iterdir())
    assert main(["run", "."]) == 2
    shown = capsys.readouterr().err
    assert f"results go to {tmp_path / 'results'}, beside the raw files" in shown
    assert (tmp_path / "results/irb120-points/report.html").exists()
    assert sorted(folder.iterdir()) == before


def test_results_do_not_go_among_the_raw_files(tmp_path, capsys):
    folder = tmp_path / "mine"
    folder.mkdir()
    for path in (EXAMPLES / "irb120-points").iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    assert main(["run", str(folder), "--out", str(folder / "results")]) == 2
    assert "among the raw files" in capsys.readouterr().err
