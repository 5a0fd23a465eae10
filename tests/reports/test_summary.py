"""The table that a run ends with."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

from made_up_records import accuracy, effect, verdict_keys
from pa10cal.reports.summary import CampaignSummary, notes, paths, table
from pa10cal.results.evaluation import mean_and_peak
from pa10cal.results.number_text import shown_probability
from pa10cal.results.outcomes import ChainRecord

GOOD = CampaignSummary(
    ChainRecord(
        campaign="mine",
        status="done",
        grade="good",
        line="at the noise",
        verdict="none",
        before_mm=2.76,
        after_mm=0.013,
        over="held-out poses",
    )
)
FAULTY = CampaignSummary(
    ChainRecord(
        campaign="other",
        status="done",
        grade="suspect_input",
        line="joint 2 reversed",
        verdict="check_the_log",
        notes=("the log: joint 2: its sign is reversed; negate q2_deg",),
        after_mm=1.5,
        over="fitted poses",
    )
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


def test_what_is_far_from_the_model_stands_apart():
    held_out = replace(
        GOOD,
        trusted=(2.41, 0.018),
        with_flagged="with 1 reading far from the model 1.752 mm",
    )
    row = " ".join(table([held_out]).splitlines()[2].split())
    said = "held-out poses; with 1 reading far from the model 1.752 mm"
    assert row == f"mine good none 2.410 mm 0.018 mm {said}"
    whole, trusted = accuracy(1.7516, 10.0), accuracy(0.018, 0.04, configurations=43)
    said = "1.752/10.000 mm; without 2 readings far from the model 0.018/0.040 mm"
    assert mean_and_peak(whole, trusted) == said
    assert mean_and_peak(whole, None) == "1.752/10.000 mm"


def test_paths_are_those_that_are_there_from_the_working_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    results = tmp_path / "results/mine"
    (results / "model").mkdir(parents=True)
    (results / "model/model.yaml").touch()
    (results / "report.html").touch()
    (results / "ingest").mkdir()
    (results / "ingest/quarantine.csv").write_text("file,line,reason\n", encoding="utf-8")
    (results / "figures").mkdir()
    (results / "figures/.snakemake_timestamp").touch()
    assert paths(results).splitlines() == [
        "report  results/mine/report.html",
        "model   results/mine/model/model.yaml",
    ]
    with (results / "ingest/quarantine.csv").open("a", encoding="utf-8") as file:
        file.write("poses.csv,3,a blank angle\n")
    (results / "figures/errors.svg").touch()
    found = paths(results).splitlines()
    assert all(any(name in line for line in found) for name in ("quarantine.csv", "figures"))


def test_a_verdict_says_what_is_open_beside_its_word():
    sure = effect("backlash", "joint 2", {"b": (1e-4, 1e-6)}, [("hysteresis", "joint 2")])
    found = notes(verdict_keys("ambiguous", (sure,), places=("joint 5", None)))
    assert found == (
        "ambiguous: backlash of joint 2 (0.49) or hysteresis of joint 2 (0.49)",
        "unexplained: joint 5: made up",
        "unexplained: place not known: made up",
    )
    unsought = verdict_keys("not_sought", ()).model_copy(
        update={"why": "45 poses are too few", "remedy": "measure 100"}
    )
    assert notes(unsought) == ("not_sought: 45 poses are too few; measure 100",)
    assert notes(verdict_keys("none", ())) == ()


def test_what_is_not_yet_sure_is_not_rounded_to_it():
    shown = [shown_probability(value) for value in (0.9439, 0.9491, 0.95, 0.989999, 0.0)]
    assert shown == ["0.94", "0.94", "0.95", "0.99", "0.00"]


def test_faults_of_the_same_kind_are_one_line():
    held = {"kind": "row", "what": "repeats the row before", "remedy": "measure it again"}
    other = {"kind": "row", "where": "P20", "what": "is far off", "remedy": "look at it"}
    faults = [SimpleNamespace(where=f"P{k}", **held) for k in range(3)]
    faults.append(SimpleNamespace(**other))
    keys = verdict_keys("check_the_log", ()).model_copy(update={"faults": faults})
    assert notes(keys) == (
        "the log: P0 and 2 more: repeats the row before; measure it again",
        "the log: P20: is far off; look at it",
    )
