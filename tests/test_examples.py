"""The campaigns under examples/: what they are, and one of them run as a newcomer would."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pa10cal.__main__ import main
from pa10cal.campaign.read import read_campaign
from pa10cal.results.codec import read
from pa10cal.results.discovery import VerdictRecord

EXAMPLES = Path(__file__).parents[1] / "examples"
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


def test_a_folder_runs_to_a_grade_a_model_and_figures(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    folder = EXAMPLES / "irb120-points"
    before = {path: path.read_bytes() for path in folder.iterdir()}
    assert main(["run", str(folder)]) == 0
    shown = capsys.readouterr()
    assert shown.err == ""  # no terminal: nothing but the result
    row = next(line for line in shown.out.splitlines() if line.startswith("irb120-points"))
    assert row.split()[1:3] == ["good", "not_sought"]
    assert "results/irb120-points/model/model.yaml" in shown.out
    results = tmp_path / "results/irb120-points"
    verdict = read(VerdictRecord, results / "discovery/verdict.json")
    assert verdict.campaign == "irb120-points"
    assert (results / "model/model.yaml").is_file()
    assert (results / "figures/health.svg").is_file()
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (None, "there is no campaign.yaml"),
        ("name: .hidden", "letters, digits"),
        ("name: curve", "none of blind_trials"),
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


def test_results_do_not_go_among_the_raw_files(tmp_path, capsys):
    folder = tmp_path / "mine"
    folder.mkdir()
    for path in (EXAMPLES / "irb120-points").iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    assert main(["run", str(folder), "--out", str(folder / "results")]) == 2
    assert "among the raw files" in capsys.readouterr().err
