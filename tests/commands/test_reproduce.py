"""`pa10cal reproduce`: the whole workflow, then one table and where the report is."""

from __future__ import annotations

from pathlib import Path

import pytest

from pa10cal.__main__ import main
from pa10cal.reports import page, summary
from pa10cal.reports.summary import CampaignSummary
from pa10cal.results.fleet import ChainRecord
from pa10cal.running import workflow


@pytest.fixture
def started(monkeypatch):
    """Take down which workflows are started, in place of running them."""
    found = []

    def run_workflow(work, display):
        found.append(work)
        display.started(1, "calibrate", "mine")
        display.finished(1)

    def summarise(results, calibration):
        about = {"grade": "good", "line": calibration, "verdict": "none", "over": "held-out poses"}
        errors = {"before_mm": 2.0, "after_mm": 0.1}
        return CampaignSummary(ChainRecord(campaign=results.name, status="done", **about, **errors))

    monkeypatch.setattr(workflow, "run_workflow", run_workflow)
    monkeypatch.setattr(summary, "summarise", summarise)
    monkeypatch.setattr(page, "write_page", lambda *paths: found.append(paths))
    return found


def test_a_line_a_stage_then_one_table_and_the_path_of_the_report(started, capsys):
    assert main(["reproduce", "--cores", "1"]) == 0
    shown = capsys.readouterr()
    assert "mine: calibrate" in shown.err
    rows = [line.split()[:3] for line in shown.out.splitlines()]
    for name in ("cell-a", "cell-null", "lightcap2008"):
        assert [name, "good", "none"] in rows
    assert "in all 0 s" in shown.out
    reports = [f"report  results/{name}/report.html" for name in ("cell-a", "cell-null")]
    assert [line for line in shown.out.splitlines() if line in reports] == reports
    assert shown.out.endswith("every picture  results/report.html\n")
    whole, report = started
    assert whole.command[whole.command.index("--cores") + 1] == "1"
    assert report == (Path("results"), Path("results/report.html"))


def test_figures_alone(started, capsys):
    assert main(["reproduce", "--figures"]) == 0
    assert "results/cell-a/figures, results/cell-a/tables" in capsys.readouterr().out
    (work,) = started
    assert work.command[-1] == "figures"


def test_other_campaigns_stand_in_a_file_of_settings(started, tmp_path, capsys):
    path = tmp_path / "mine.yaml"
    path.write_text(
        f"campaigns: [mine]\nresults_dir: {tmp_path / 'out'}\nevaluation: {{calibration: 44N}}\n"
    )
    assert main(["reproduce", "--settings", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "good: 44N" in shown
    assert "cell-a" not in shown
    assert started[0].command[started[0].command.index("--configfile") + 1] == str(path)


def test_settings_that_do_not_fit_are_refused_before_anything_runs(started, tmp_path, capsys):
    path = tmp_path / "mine.yaml"
    path.write_text("campaigns: []\n")
    assert main(["reproduce", "--settings", str(path)]) == 2
    assert "key campaigns does not fit" in capsys.readouterr().err
    assert started == []
