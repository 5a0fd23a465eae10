"""The table that a run ends with."""

from __future__ import annotations

from pa10cal.running.summary import CampaignSummary, paths, table

GOOD = CampaignSummary(
    "mine", "good", "none", 2.76, 0.013, "held-out poses", ("good: at the noise",)
)
FAULTY = CampaignSummary(
    "other",
    "suspect_input",
    "check_the_log",
    None,
    1.5,
    "fitted poses",
    ("suspect_input: joint 2 reversed", "the log: joint 2: its sign is reversed; negate q2_deg"),
)


def test_one_row_a_campaign_and_under_it_what_to_know():
    lines = table([GOOD, FAULTY]).splitlines()
    assert " ".join(lines[0].split()) == "campaign grade verdict before after mean error over"
    assert " ".join(lines[2].split()) == "mine good none 2.760 mm 0.013 mm held-out poses"
    assert " ".join(lines[3].split()) == "other suspect_input check_the_log — 1.500 mm fitted poses"
    assert lines[5:] == [
        "mine: good: at the noise",
        "other: suspect_input: joint 2 reversed",
        "other: the log: joint 2: its sign is reversed; negate q2_deg",
    ]
    assert table([GOOD]).splitlines()[-1] == "good: at the noise"


def test_paths_are_those_that_are_there_from_the_working_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    results = tmp_path / "results/mine"
    (results / "model").mkdir(parents=True)
    (results / "model/model.yaml").touch()
    (results / "report.html").touch()
    assert paths(results).splitlines() == [
        "report  results/mine/report.html",
        "model   results/mine/model/model.yaml",
    ]
