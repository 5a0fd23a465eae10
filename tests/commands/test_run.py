"""`pa10cal run` refuses folders before anything is started, and takes several as a group."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from pa10cal.commands.command_line import REFUSED, run_command

SHIPPED = Path(__file__).parents[2] / "examples/ur10-pose"


@pytest.fixture(name="campaign")
def _campaign(tmp_path, monkeypatch):
    def never(*_):
        raise AssertionError("the workflow was started")

    monkeypatch.setattr("pa10cal.running.workflow.run_workflow", never)

    def campaign(name, *changes):
        folder = tmp_path / name
        shutil.copytree(SHIPPED, folder)
        text = (folder / "campaign.yaml").read_text(encoding="utf-8")
        for old, new in (("name: ur10-pose", f"name: {name}"), *changes):
            assert old in text
            text = text.replace(old, new)
        (folder / "campaign.yaml").write_text(text, encoding="utf-8")
        return folder

    return campaign


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("robot: ur10", "robott: ur10"), "did you mean 'robot'"),
        (("robot: ur10", "robot: kr10"), "unknown robot"),
        (("pa10cal-campaign/1", "pa10cal-campaign/9"), "another schema"),
        (("tracker.txt", "tracker.csv"), "the file is not there (got 'tracker.csv')"),
        (("robot: ur10", "robot: ur10\njoint_signs: [1, 1]"), "6, one for each joint"),
        (("name: mine", "name: no"), "YAML reads no, off, false without quotes as false"),
    ],
)
def test_a_folder_is_refused_before_anything_is_started(
    campaign, tmp_path, capsys, change, message
):
    folder = campaign("mine", change)
    assert run_command("run", [str(folder), "--out", str(tmp_path / "out")]) == REFUSED
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_file_that_cannot_be_read_is_refused_before_anything_is_started(
    campaign, tmp_path, capsys
):
    folder = campaign("mine")
    text = (folder / "tracker.txt").read_text(encoding="utf-8")
    assert "X [m]" in text
    (folder / "tracker.txt").write_text(text.replace("X [m]", "East"), encoding="utf-8")
    assert run_command("run", [str(folder), "--out", str(tmp_path / "out")]) == REFUSED
    assert "X [m]" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_several_folders_are_a_group_with_a_name_of_its_own(campaign, tmp_path, capsys):
    one, two = str(campaign("one")), str(campaign("two"))
    out = ["--out", str(tmp_path / "out")]
    for words, message in (
        ([one, two], "without the name of their group"),
        ([one, two, "--group", "one"], "called like one of its campaigns"),
        ([one, one, "--group", "both"], "stands in a group twice"),
        ([one, "--group", "both"], "fewer than two campaigns"),
        ([one, two, "--group", "a/b"], "letters"),
    ):
        assert run_command("run", [*words, *out]) == REFUSED
        assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
