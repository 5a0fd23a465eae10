"""Commands for whole runs: `run`, `reproduce`, `chain`, `fleet`."""

from __future__ import annotations

import csv
import errno
import faulthandler
import os
import re
import select
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks.broken_fleet import BROKEN, broken_fleet

from pa10cal.commands import runs
from pa10cal.commands.command_line import INTERRUPTED, REFUSED, main, run_command
from pa10cal.files.output import write_text, writing_into
from pa10cal.fit.model_reading import load_model
from pa10cal.fleet.arm_status import forget_ended
from pa10cal.fleet.campaigns import ListedCampaign
from pa10cal.reports import page, summary
from pa10cal.reports.summary import CampaignSummary
from pa10cal.results.calibration import BaseFrameRecord, CalibrationRecord
from pa10cal.results.codec import read, write
from pa10cal.results.outcomes import ChainRecord, FleetRecord
from pa10cal.running import workflow
from pa10cal.running.failure import StageError
from pa10cal.running.run_lock import RUN, run_lock
from pa10cal.stages import readings
from pa10cal.stages.pipeline import stages

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
        (("tracker.txt", "tracker.csv"), "the file is not there (got 'tracker.csv')"),
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


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("cell 7", "name: results cannot be called so (got 'cell 7'); allowed: a name of at most"),
        ("cell 7", "set name: cell-7, and call the folder so"),
        ("fleet", "allowed: no folder of a study; set name: my-fleet, and call the folder so"),
    ],
)
def test_a_name_that_results_cannot_have_is_refused_with_another(
    campaign, tmp_path, capsys, name, message
):
    folder = campaign(name)
    assert run_command("run", [str(folder), "--out", str(tmp_path / "out")]) == REFUSED
    assert message in capsys.readouterr().err


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


# `pa10cal reproduce`: the whole workflow, then one table and where the report is.


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


# Campaigns in one process each, and a fleet of them.


EXAMPLE = Path(__file__).parents[2] / "examples/irb120-points"


def take(raw, results):
    return main(["chain", "--campaign-dir", str(raw), "--results", str(results)])


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Results of two campaigns of one arm, the second of them the same as the first."""
    place = tmp_path_factory.mktemp("fleet")
    for name in ("first", "second"):
        shutil.copytree(EXAMPLE, place / "raw" / name)
        assert take(place / "raw" / name, place / "results" / name) == 0
    return place


def test_one_process_makes_what_the_single_stages_make(done, tmp_path):
    results = done / "results/first"
    found = read(ChainRecord, results / "chain.json", "first")
    assert (found.status, found.grade, found.verdict) == ("done", "good", "not_sought")
    assert found.after_mm < found.before_mm
    raw, poses = str(done / "raw/first"), str(tmp_path / "poses.parquet")
    quarantine = str(tmp_path / "quarantine.csv")
    words = ["ingest", "--campaign-dir", raw, "--out", poses, "--quarantine", quarantine]
    assert main(words) == 0
    assert Path(poses).read_bytes() == (results / "ingest/poses.parquet").read_bytes()
    parts = {path.name for path in results.iterdir()}
    assert parts == {
        *("chain.json", "ingest", "seed", "calibration", "discovery", "evaluation", "model")
    }


def test_where_a_load_case_was_removed_all_are_calibrated_again(done, tmp_path):
    results, raw = tmp_path / "results", done / "raw/first"
    shutil.copytree(done / "results/first", results)
    whole = results / "calibration/combined.json"
    runs._forget_incomplete(results, raw)
    assert whole.is_file()
    others = [path for path in whole.parent.glob("*.json") if path != whole]
    others[0].unlink()
    runs._forget_incomplete(results, raw)
    assert not whole.exists()
    runs._forget_incomplete(results, raw)
    shutil.rmtree(results / "ingest")
    runs._forget_incomplete(results, raw)


def under_loads(folder, load_of):
    """Write the example with other loads, of the number of each row from 0; return its folder."""
    shutil.copytree(EXAMPLE, folder)
    with (folder / "poses.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    rows = [row | {"load_N": load_of(number)} for number, row in enumerate(rows)]
    rows = [row for row in rows if row["load_N"] is not None]
    with (folder / "poses.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return folder


def test_a_load_with_too_few_poses_has_no_fit_of_its_own(tmp_path, capfd):
    results = tmp_path / "results"
    raw = under_loads(tmp_path / "two", lambda row: 0 if row < 1 else 10)
    assert take(raw, results) == 0
    why = "fewer equations than unknowns (1 poses with 9 readings, 33 unknowns); needed: at least 4"
    assert f"combined: note: no fit of 0N alone: {why}" in capfd.readouterr().err
    made = {path.name for path in (results / "calibration").iterdir()}
    assert made == {"10N.json", "combined.json"}
    whole = read(CalibrationRecord, results / "calibration/combined.json", "irb120-points")
    assert whole.loads_fitted == (0.0, 10.0)
    assert set(whole.loads_left_out) == {"0N"}
    seed = read(BaseFrameRecord, results / "seed/base_frame.json", "irb120-points")
    assert seed.origin_from == "grid poses at every load"
    runs._forget_incomplete(results, raw)
    assert (results / "calibration/combined.json").is_file()
    (results / "calibration/10N.json").unlink()
    runs._forget_incomplete(results, raw)
    assert not (results / "calibration/combined.json").exists()


def test_where_no_load_has_enough_poses_all_together_may(tmp_path, capfd):
    results = tmp_path / "results"
    raw = under_loads(tmp_path / "few", lambda row: row % 4 if row < 10 else None)
    assert take(raw, results) == 0
    assert [path.name for path in (results / "calibration").iterdir()] == ["combined.json"]
    raw = under_loads(tmp_path / "fewer", lambda row: row % 2 if row < 3 else None)
    assert take(raw, results) == REFUSED
    assert "load case combined: grid poses: fewer equations" in capfd.readouterr().err
    assert not (results / "calibration").exists()


def test_a_campaign_that_is_refused_leaves_nothing_that_looks_like_a_result(done, tmp_path, capsys):
    raw, results = tmp_path / "bad", tmp_path / "results"
    shutil.copytree(EXAMPLE, raw)
    assert take(raw, results) == 0
    assert (results / "model/model.yaml").is_file()
    text = (raw / "poses.csv").read_text("utf-8").replace("q3_deg", "q9_deg")
    (raw / "poses.csv").write_text(text, "utf-8")
    assert take(raw, results) == REFUSED
    found = read(ChainRecord, results / "chain.json")
    assert (found.status, found.stage) == ("refused", "ingest")
    assert "q3" in found.message
    assert [path.name for path in results.iterdir()] == ["chain.json"]
    assert "pa10cal chain: bad: ingest: " in capsys.readouterr().err


def test_a_second_run_that_is_refused_leaves_no_results_of_the_first_after_that_stage(
    done, tmp_path, capsys, monkeypatch
):
    results = shutil.copytree(done / "results/first", tmp_path / "out/irb120-points")
    write_text(results / "report.html", "good")

    def refused(*_):
        (results / "calibration/combined.json").unlink()
        message = "pa10cal calibrate: the prior is a model of another arm\n"
        write_text(results / "logs/calibrate.log", message)
        raise StageError("calibrate: the prior is a model of another arm")

    monkeypatch.setattr(workflow, "run_workflow", refused)
    assert main(["run", str(EXAMPLE), "--out", str(tmp_path / "out")]) == REFUSED
    assert f"report so far: {results / 'report.html'}" in capsys.readouterr().err
    assert "the prior is a model of another arm" in (results / "report.html").read_text("utf-8")
    left = {path.name for path in results.iterdir()}
    assert left == {"ingest", "seed", "logs", "report.html"}


def test_a_prior_of_another_arm_is_refused_before_anything_is_started(campaign, done, capsys):
    words = [str(campaign("mine")), "--prior", str(done / "results/first")]
    assert run_command("run", [*words, "--out", str(done / "out")]) == REFUSED
    assert "the prior is a model of another arm (got 'irb120')" in capsys.readouterr().err
    assert not (done / "out").exists()


def test_a_run_that_is_refused_before_any_stage_changes_nothing(done, tmp_path, monkeypatch):
    results = shutil.copytree(done / "results/first", tmp_path / "out/irb120-points")
    for name in ("figures", "tables", "pictures.json", "report.html"):
        write_text(results / name, "of the first run")
    before = sorted(results.rglob("*"))

    def refused(*_):
        raise StageError("another run is at work")

    monkeypatch.setattr(workflow, "run_workflow", refused)
    assert main(["run", str(EXAMPLE), "--out", str(tmp_path / "out")]) == REFUSED
    assert sorted(results.rglob("*")) == before


@pytest.mark.parametrize("below", ["", "results"])
def test_results_among_raw_files_are_refused_before_anything_is_removed(tmp_path, capsys, below):
    raw = shutil.copytree(EXAMPLE, tmp_path / "raw")
    (raw / "model").mkdir()
    (raw / "model/notes.txt").touch()
    assert take(raw, raw / below) == REFUSED
    assert "--results: the results would be written among the raw" in capsys.readouterr().err
    assert (raw / "model/notes.txt").exists()


def test_a_campaign_is_called_by_its_folder_though_that_is_the_working_one(tmp_path, monkeypatch):
    monkeypatch.setattr(readings, "ingest", lambda **_: os._exit(7))
    monkeypatch.chdir(EXAMPLE)
    assert take(".", tmp_path) == REFUSED
    assert read(ChainRecord, tmp_path / "chain.json").campaign == EXAMPLE.name


def test_members_of_a_group_whose_folders_have_one_name_are_kept_apart(tmp_path):
    folders = tmp_path / "may/cell", tmp_path / "june/cell"
    of_group = [stage for stage in stages(folders, tmp_path / "both") if stage.name == "ingest"]
    assert of_group[0].writes["poses"] != of_group[1].writes["poses"]


def test_a_fault_of_the_program_ends_one_campaign_alone(tmp_path, monkeypatch):
    def broken(**_):
        raise ZeroDivisionError("oh")

    monkeypatch.setattr(readings, "ingest", broken)
    assert take(EXAMPLE, tmp_path) == REFUSED
    found = read(ChainRecord, tmp_path / "chain.json")
    assert (found.status, found.message) == ("fault", "internal fault: ZeroDivisionError: oh")


FULL = OSError(errno.ENOSPC, "No space left on device")


def _refused_as_full():
    with writing_into(Path("here"), "the output", "remove it"):
        raise FULL


def _raise(error):
    raise error


@pytest.mark.parametrize("full", [_refused_as_full, lambda: _raise(FULL)])
def test_a_full_disk_is_no_verdict_on_a_campaign(tmp_path, monkeypatch, capsys, full):
    monkeypatch.setattr(readings, "ingest", lambda **_: full())
    assert take(EXAMPLE, tmp_path) == REFUSED
    assert "No space left on device" in capsys.readouterr().err
    assert not (tmp_path / "chain.json").exists()


@pytest.mark.parametrize("name", ["calibration", "model/raw", "members"])
def test_raw_files_in_a_folder_that_a_run_removes_are_refused(tmp_path, capsys, name):
    results = tmp_path / "cell"
    raw = shutil.copytree(EXAMPLE, results / name)
    text = (raw / "campaign.yaml").read_text("utf-8")
    (raw / "campaign.yaml").write_text(text.replace("name: irb120-points", "name: cell"), "utf-8")
    before = sorted(tmp_path.rglob("*"))
    assert take(raw, results) == REFUSED
    assert main(["run", str(raw), "--out", str(tmp_path)]) == REFUSED
    source = ["--dataset", "titan-robot-accuracy", "--source", str(raw)]
    words = ["--campaign-dir", str(tmp_path / "titan-rail"), "--results", str(results)]
    assert main(["chain", *words, *source]) == REFUSED
    folder = name.partition("/")[0]
    assert capsys.readouterr().err.count(f"lie in the folder {folder} of the results") == 3
    assert sorted(tmp_path.rglob("*")) == before


OTHERS = ("model/cad.txt", "model/robot.urdf", "calibration/camera.json", "model", "chain.json")


@pytest.mark.parametrize("name", OTHERS)
def test_files_that_no_run_made_are_not_removed(tmp_path, capsys, name):
    results = tmp_path / EXAMPLE.name
    (results / name).parent.mkdir(parents=True)
    (results / name).write_text("mine", "utf-8")
    assert take(EXAMPLE, results) == REFUSED
    assert main(["run", str(EXAMPLE), "--out", str(tmp_path)]) == REFUSED
    assert capsys.readouterr().err.count(f"{name}: a file that no run made") == 2
    assert (results / name).read_text("utf-8") == "mine"


def test_results_stay_where_the_campaign_is_mistyped_or_a_run_is_at_work(tmp_path, capsys):
    results = tmp_path / "results"
    assert take(EXAMPLE, results) == 0
    assert take(EXAMPLE.with_name("irb120-point"), results) == REFUSED
    assert "irb120-points" in capsys.readouterr().err
    assert take(EXAMPLE.parent, results) == REFUSED
    assert "there is no campaign.yaml" in capsys.readouterr().err
    with run_lock(tmp_path, ["results"]) as work:
        monkey = {key: value for key, value in os.environ.items() if key != RUN}
        words = ["chain", "--campaign-dir", str(EXAMPLE), "--results", str(results)]
        command = [sys.executable, "-m", "pa10cal", *words]
        made = subprocess.run(command, env=monkey, capture_output=True, text=True, check=False)
    assert made.returncode == REFUSED
    assert "another run is at work on these results" in made.stderr
    assert work.is_dir()
    assert (results / "model/model.yaml").is_file()
    assert take(EXAMPLE, results) == 0  # anew, in place of its own


ENDS = {
    "abort": (
        lambda: (faulthandler.disable(), os.abort()),
        r"killed by signal 6 \(SIGABRT\), as by a library that needs more memory",
    ),
    "kill": (lambda: os.kill(os.getpid(), signal.SIGKILL), r"signal 9 .*not enough memory"),
    "exit": (lambda: os._exit(7), "ended with exit code 7"),
    "memory": (lambda: np.empty(2**61, "u1"), "^not enough memory .*EiB.*; close other programs"),
    "file": (lambda: Path("/gone/x").read_text(), "^FileNotFoundError: .*'/gone/x'"),
    "output": (
        lambda: write_text(Path("/dev/null/x"), ""),
        "^/dev/null/x: the output cannot be written .*File exists",
    ),
}


@pytest.mark.parametrize("way", ENDS)
def test_what_the_machine_ends_leaves_its_reason(tmp_path, monkeypatch, capsys, way):
    end, message = ENDS[way]
    monkeypatch.setattr(readings, "ingest", lambda **_: end())
    assert take(EXAMPLE, tmp_path) == REFUSED
    found = read(ChainRecord, tmp_path / "chain.json")
    assert (found.campaign, found.status, found.stage) == (EXAMPLE.name, "ended", "ingest")
    assert re.search(message, found.message), found.message
    assert f"pa10cal chain: {EXAMPLE.name}: ingest: {found.message}" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["chain.json"]


def test_an_interrupt_of_the_child_is_one_of_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(readings, "ingest", lambda **_: _raise(KeyboardInterrupt))
    assert take(EXAMPLE, tmp_path) == INTERRUPTED
    assert "pa10cal chain: interrupted" in capsys.readouterr().err
    assert not (tmp_path / "chain.json").exists()


def test_the_child_ends_with_its_parent(tmp_path):
    """However that is killed."""
    code = (
        "import os, sys, time; from pathlib import Path\n"
        "from pa10cal.running.child import in_child\n"
        "def work(send):\n"
        "    Path(sys.argv[1]).write_text(str(os.getpid())); time.sleep(60)\n"
        "in_child(work)"
    )
    told = tmp_path / "child"
    parent = subprocess.Popen([sys.executable, "-c", code, str(told)])
    while not (told.exists() and told.read_text()):
        time.sleep(0.02)
    child = os.pidfd_open(int(told.read_text()))
    parent.kill()
    parent.wait()
    assert select.select([child], [], [], 10.0)[0]
    os.close(child)


def test_too_little_memory_is_told_as_that(capsys):
    code = run_command("predict", [], lambda: np.empty(2**61, "u1"))
    said = capsys.readouterr().err
    assert code == REFUSED
    assert said.startswith("pa10cal predict: not enough memory (Unable to allocate 2.00 EiB")
    assert "use fewer cores" in said
    assert said.count("\n") == 1


def test_what_the_machine_ended_is_begun_anew(tmp_path):
    for name, status in (("a", "ended"), ("b", "refused"), ("c", "done")):
        (tmp_path / name).mkdir()
        write(ChainRecord(campaign=name, status=status), tmp_path / name / "chain.json")
    (tmp_path / "d").mkdir()
    (tmp_path / "d/chain.json").write_text("[")
    forget_ended([ListedCampaign(name, name) for name in "abcde"], tmp_path)
    assert [path.parent.name for path in sorted(tmp_path.glob("*/chain.json"))] == ["b", "c", "d"]


def test_a_fleet_is_summarised_and_its_campaigns_are_compared(done, capsys):
    table = done / "arms.csv"
    table.write_text("campaign,arm,measured\nsecond,left,2026-02\nfirst,left,2026-01\n", "utf-8")
    words = ["fleet_summary", "--campaigns", str(table), "--raw-dir", str(done / "raw")]
    assert main([*words, "--results", str(done / "results"), "--out", str(done / "fleet")]) == 0
    found = read(FleetRecord, done / "fleet/fleet.json")
    assert [each.campaign for each in found.campaigns] == ["second", "first"]
    assert found.campaigns[0].agrees is True
    assert found.campaigns[1].agrees is None
    assert (found.arms[0].campaigns, found.arms[0].last) == (2, "second")
    with (done / "fleet/fleet.csv").open(encoding="utf-8") as file:
        assert [row["agrees_with_previous"] for row in csv.DictReader(file)] == ["yes", ""]
    assert "2 campaigns of 1 arm: 2 good" in capsys.readouterr().out


def test_a_joint_zero_that_moved_between_campaigns_is_told(done, tmp_path):
    results = shutil.copytree(done / "results", tmp_path / "results")
    model = load_model(results / "second/model/model.yaml")
    x, names = model.x.copy(), [each.name for each in model.model.parameters]
    x[names.index("delta_theta_3")] += 2e-3
    replace(model, x=x).save(results / "second/model/model.yaml")
    table = tmp_path / "arms.csv"
    table.write_text("campaign,arm,measured\nsecond,left,2026-02\nfirst,left,2026-01\n", "utf-8")
    words = ["fleet_summary", "--campaigns", str(table), "--raw-dir", str(done / "raw")]
    assert main([*words, "--results", str(results), "--out", str(tmp_path / "fleet")]) == 0
    (left,) = read(FleetRecord, tmp_path / "fleet/fleet.json").arms
    assert left.attention == "moved"
    assert "joint zero moved: the zero of joint 3 by +2 mrad" in left.why
    with (tmp_path / "fleet/fleet.csv").open(encoding="utf-8") as file:
        assert "the zero of joint 3" in next(csv.DictReader(file))["moved"]


@pytest.mark.slow
def test_the_whole_way_is_one_command(tmp_path, capsys):
    shutil.copytree(EXAMPLE, tmp_path / "raw/good-one")
    (tmp_path / "raw/bad-one").mkdir()
    (tmp_path / "raw/bad-one/campaign.yaml").write_text("nothing", "utf-8")
    out = tmp_path / "results"
    assert main(["fleet", "*", "--raw-dir", str(tmp_path / "raw"), "--out", str(out)]) == REFUSED
    shown = capsys.readouterr()
    assert "bad-one: no_result: bad-one: ingest: " in shown.out
    assert "2 campaigns of 2 arms: 1 good, 1 refused" in shown.out
    assert "pa10cal fleet: 1 of 2 campaigns gave no model: bad-one" in shown.err
    assert (out / "fleet/fleet.html").is_file()


@pytest.mark.slow
def test_campaigns_broken_in_ten_ways_stop_no_other(tmp_path):
    """The figure of two hundred is that of `python -m benchmarks.broken_fleet`."""
    found = broken_fleet(tmp_path, 3 + len(BROKEN))
    assert found.code == REFUSED
    assert found.done == 3
    assert found.wrong == {}


@pytest.mark.parametrize(
    ("count", "told"),
    [
        (0, "fleet: 1 campaign of 1 arm: 1 good\n"),
        (1, "1 arm needs attention: c-0\n"),
        (2, "2 arms need attention: c-0, c-1\n"),
        (11, "11 arms need attention: c-0, c-1, c-10, c-2, c-3, c-4, c-5, c-6, c-7, c-8, …\n"),
    ],
)
def test_arms_that_need_attention_are_named_until_they_are_many(tmp_path, capsys, count, told):
    for name in [f"c-{k}" for k in range(count)] or ["good"]:
        (tmp_path / name).mkdir()
        (tmp_path / name / "campaign.yaml").touch()
    if not count:
        good = ChainRecord(campaign="good", status="done", grade="good", line="", verdict="none")
        write(good, tmp_path / "good/chain.json")
    words = ["fleet_summary", "--campaigns", "*", "--raw-dir", str(tmp_path)]
    assert main([*words, "--results", str(tmp_path), "--out", str(tmp_path / "fleet")]) == 0
    assert capsys.readouterr().out.endswith(told)


def test_a_fleet_of_nothing_is_refused(tmp_path, capsys):
    assert main(["fleet", "gone.csv", "--raw-dir", str(tmp_path)]) == 2
    assert "the table of campaigns cannot be read" in capsys.readouterr().err
