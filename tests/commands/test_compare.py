"""Command `compare`: what it prints, as the docs show it, what it writes and what it refuses."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from made_up_pair import campaign, shifted
from pa10cal.commands.command_line import REFUSED, run_command
from pa10cal.fit.model_file import save_model
from pa10cal.results.codec import read
from pa10cal.results.comparison import ComparisonRecord

DOCS = Path(__file__).parents[2] / "docs/using-the-model.md"


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_model(campaign(1, "june"), tmp_path / "june.yaml")
    save_model(shifted(campaign(2, "july"), delta_theta_3=1e-3), tmp_path / "july.yaml")
    return tmp_path


def test_the_example_of_the_docs(here, capsys):
    section = DOCS.read_text(encoding="utf-8").split("## What has changed")[1]
    line, shown = re.search(
        r"```sh\n(pa10cal .*)\n```\n\n```text\n(.*?)```", section, re.S
    ).groups()
    _, command, *words = shlex.split(line)
    assert run_command(command, words) == 0
    assert capsys.readouterr().out == shown
    found = read(ComparisonRecord, here / "compare.json")
    assert found.agree is False
    assert found.first.campaign == "june"


def spoil_covariance(here):
    (here / "july.covariance.npz").write_bytes(b"PK nothing")


def not_a_model(here):
    (here / "july.yaml").write_text("schema: pa10cal-campaign/1\n", encoding="utf-8")


def no_file(here):
    (here / "july.yaml").unlink()


def another_arm(here):
    save_model(campaign(1, robot="ur10"), here / "july.yaml")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (spoil_covariance, r"july\.covariance\.npz: the covariance of the model cannot be read"),
        (not_a_model, r"july\.yaml: schema: not a model"),
        (no_file, r"july\.yaml: the model cannot be read"),
        (another_arm, r"june\.yaml \(pa10_6ce\), july\.yaml \(ur10\): models of arms of different"),
    ],
)
def test_what_is_refused(here, capsys, spoil, message):
    spoil(here)
    assert run_command("compare", ["june.yaml", "july.yaml", "--out", "c.json"]) == REFUSED
    said = capsys.readouterr()
    assert re.search(message, said.err)
    assert len(said.err.splitlines()) == 1
    assert not said.out
    assert not (here / "c.json").exists()


def test_without_a_covariance_it_says_so(here, capsys):
    (here / "july.covariance.npz").unlink()
    assert run_command("compare", ["june.yaml", "july.yaml"]) == 0
    assert "cannot be judged: the covariance is missing of july.yaml" in capsys.readouterr().out


def test_no_model_is_replaced(here, capsys):
    before = (here / "july.yaml").read_bytes()
    assert run_command("compare", ["june.yaml", "july.yaml", "--out", "july.yaml"]) == REFUSED
    assert "would replace the file of second" in capsys.readouterr().err
    assert (here / "july.yaml").read_bytes() == before


def test_a_folder_of_results_is_enough(here, capsys):
    for name in ("june", "july"):
        folder = here / "results" / name / "model"
        folder.mkdir(parents=True)
        save_model(campaign(1, name), folder / "model.yaml")
    assert run_command("compare", ["results/june", "results/july/model"]) == 0
    assert "expected to remain" in capsys.readouterr().out
    assert run_command("compare", ["results", "results/july"]) == REFUSED
    assert "results/model.yaml: the model cannot be read" in capsys.readouterr().err
