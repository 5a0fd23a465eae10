"""Commands that take results of another campaign read them as they are, and change none of them."""

from __future__ import annotations

import inspect
import json
import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path
from typing import get_type_hints

import pytest

from built_once import built_once
from pa10cal.commands.command_line import COMMANDS, command_named, main
from pa10cal.datasets import known_campaigns
from pa10cal.files.output import write_text
from pa10cal.running.workflow import Workflow
from snakemake_calls import planned

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples/irb120-points"
#: Commands that take results of another campaign: the parameters that name them, and a call. Those
#: of campaign A are in {a}; what is written goes to {out}.
TAKE = {
    # Single steps.
    "export": (
        "poses calibration extended",
        "export --campaign-dir {raw}/a --poses {a}/ingest/poses.parquet --calibration "
        "{a}/calibration/combined.json --extended {a}/discovery/extended.json --model "
        "{out}/model.yaml --urdf {out}/robot.urdf",
    ),
    "calibrate": (
        "poses base_frame named prior settings",
        "calibrate --campaign-dir {raw}/b --poses {b}/ingest/poses.parquet --base-frame "
        "{b}/seed/base_frame.json --prior {a} --out {out}",
    ),
    "transfer": (
        "calibration extended poses",
        "transfer --calibration {a}/calibration/combined.json --extended "
        "{a}/discovery/extended.json --campaign-dir {raw}/b --poses {b}/ingest/poses.parquet "
        "--out {out}/transfer.json",
    ),
    "join": (
        "poses base_frame",
        "join --name g --campaign-dir {raw}/a {raw}/b --poses {a}/ingest/poses.parquet "
        "{b}/ingest/poses.parquet --base-frame {a}/seed/base_frame.json "
        "{b}/seed/base_frame.json --out-dir {out}",
    ),
    "seed": (
        "poses",
        "seed --campaign-dir {raw}/a --poses {a}/ingest/poses.parquet --out {out}/seed",
    ),
    "discover": (
        "poses calibration",
        "discover --campaign-dir {raw}/a --poses {a}/ingest/poses.parquet --calibration "
        "{a}/calibration/combined.json --verdict {out}/verdict.json --analysis "
        "{out}/analysis.json --extended {out}/extended.json --suggested {out}/suggested.csv",
    ),
    "evaluate": (
        "poses calibration extended",
        "evaluate --campaign-dir {raw}/a --poses {a}/ingest/poses.parquet --calibration "
        "{a}/calibration/combined.json --extended {a}/discovery/extended.json --out "
        "{out}/holdout.json",
    ),
    "montecarlo": (
        "same_arm",
        "montecarlo --campaign b --robot pa10_6ce --same-arm {a}/montecarlo --settings {few} "
        "--out {out}",
    ),
    "figures": (
        "results settings",
        "figures --results {a} --campaign-dir {raw}/a --out-dir {out} --figure where_joints",
    ),
    # A model in use.
    "predict": ("model", "predict --model {a} --joints {joints} --out {out}/poses.csv"),
    "compensate": ("model", "compensate --model {a} --targets {targets} --out {out}/q.csv"),
    "compare": ("first second", "compare {a} {b} --out {out}/compare.json"),
    "drift": ("models", "drift {a} {b} --out {out}/drift.json --figures {out}"),
    # Whole runs.
    "run": ("prior settings", "run {raw}/b --out {results} --prior {a}"),
    "run, a group": ("", "run {raw}/a {raw}/b --group g --out {results}"),
    "fleet": ("settings", "fleet b --raw-dir {raw} --out {results} --settings {settings}"),
    "chain": ("settings", "chain --campaign-dir {raw}/b --results {out}/b --settings {settings}"),
    "chain, a group": ("", "chain --campaign-dir {raw}/a {raw}/b --results {out}"),
    "report": ("results", "report {a} --out {out}/report.html"),
    "report, of all": ("results", "report {results} --out {out}/report.html"),
    "fleet_summary": (
        "results",
        "fleet_summary --campaigns * --raw-dir {raw} --results {results} --out {out}",
    ),
    "measured": (
        "results",
        "measured --campaign-dir {raw}/a {raw}/b --results {results} --out {out}",
    ),
}
#: Parameters that name no results of another campaign, of every command or of one: raw files,
#: outputs, lists, settings without a prior.
OTHERS = {
    "": "folders campaign_dir raw_dir arms out out_dir source joints targets figures urdf keep_out "
    "files truth folder points",
    "discover": "verdict analysis extended suggested settings",
    "export": "model dh",
    "evaluate": "iso9283",
    "calibrate": "discovery",
    "ingest": "quarantine settings",
    "seed": "settings",
    "montecarlo": "settings",
    "plan": "settings options",
    "chain": "results",
    "import": "settings",
    "import_arm": "file",
    # The settings of the project's own runs and studies, whose campaigns it makes itself.
    "reproduce": "settings",
    "simulate": "settings",
    "coverage": "settings calibration table",
    "curve": "settings",
    "curve_calibration": "settings calibration",
    "draw_trials": "raw truths",
    "blind_trials": "settings verdicts truths",
    "score_trials": "verdicts truths scores trials",
}
BY_WORKFLOW = ("run", "run, a group", "fleet")
FEW = '{"planes_mm": [500], "cycles": 9, "positions": 3}'


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """Results of two campaigns of one arm, one a few poses shorter; and planes of another arm."""

    def build(folder):
        for name, seed in (("a", 0), ("b", 3)):
            raw = shutil.copytree(EXAMPLE, folder / "raw" / name)
            text = (raw / "campaign.yaml").read_text("utf-8")
            text = text.replace("name: irb120-points", f"name: {name}")
            (raw / "campaign.yaml").write_text(text, "utf-8")
            lines = (raw / "poses.csv").read_text("utf-8").splitlines(keepends=True)
            del lines[1 : 1 + seed]
            (raw / "poses.csv").write_text("".join(lines), "utf-8")
            results = folder / "results" / name
            assert main(["chain", "--campaign-dir", str(raw), "--results", str(results)]) == 0
        report = [
            "report",
            str(folder / "results/a"),
            "--out",
            str(folder / "results/a/report.html"),
        ]
        assert main(report) == 0
        words = ["montecarlo", "--campaign", "a", "--robot", "pa10_6ce", "--settings", FEW]
        assert main([*words, "--out", str(folder / "results/a/montecarlo")]) == 0
        return folder

    return built_once(tmp_path_factory, "two_campaigns", build)


def state(folder):
    """Return when everything in a folder was changed, and its bytes."""
    return {
        path: (path.stat().st_mtime_ns, path.stat().st_ino, path.is_file() and path.read_bytes())
        for path in (folder, *folder.rglob("*"))
    }


def test_every_parameter_that_may_name_results_of_another_campaign_is_tried():
    untried = {}
    for name in COMMANDS:
        command = command_named(name)
        hints = get_type_hints(command)
        given = {
            parameter
            for parameter in inspect.signature(command).parameters
            if "Path" in str(hints[parameter]) or "Options" in str(hints[parameter])
        }
        taken = {
            each
            for row, (of, _) in TAKE.items()
            if row.split(",")[0] == name
            for each in of.split()
        }
        given -= taken | set(f"{OTHERS['']} {OTHERS.get(name, '')}".split())
        untried |= {name: given} if given else {}
    assert not untried


def taken_as_made(raw, results, monkeypatch):
    """Let the workflow note of results of A how it made them, as if it had: nothing is computed."""
    (results / raw.name / "chain.json").unlink()
    shutil.rmtree(results / raw.name / "montecarlo")  # of another arm
    drawn = ["figures", "--results", str(results / raw.name), "--campaign-dir", str(raw)]
    assert main(drawn) == 0
    command = Workflow.command

    def noting(workflow):
        python, option, module, *words = command.fget(workflow)
        return [python, option, module, "--touch", *words]

    with monkeypatch.context() as patch:
        patch.setattr(Workflow, "command", property(noting))
        assert main(["run", str(raw), "--out", str(results)]) == 0


def in_this_process(call_snakemake, run):
    """Return a stand-in for a run of the workflow: commands as it plans them, none as a process."""

    def run_workflow(workflow, display):
        assert workflow.file == "workflow/run.smk"
        words = replace(workflow, more=("--dry-run", "--printshellcmds")).command[3:]
        code, text = call_snakemake(*words, cwd=workflow.results)
        assert code == 0, text
        for line in re.findall(r"python -m pa10cal (.*) 2>&1 \| tee", text):
            run.append(shlex.split(line))
            assert main(run[-1]) == 0

    return run_workflow


def test_a_run_with_a_prior_leaves_it_as_it_was(made, tmp_path, monkeypatch, call_snakemake):
    run = []
    monkeypatch.setattr(
        "pa10cal.running.workflow.run_workflow", in_this_process(call_snakemake, run)
    )
    results = tmp_path / "results"
    a = shutil.copytree(made / "results/a", results / "a")
    before = state(a)
    words = ["run", str(made / "raw/b"), "--out", str(results), "--prior", str(a)]
    assert main(words) == 0
    assert {"ingest", "seed", "calibrate", "discover", "evaluate", "export", "figures"} <= {
        command for command, *_ in run
    }
    assert (results / "b/report.html").is_file()
    assert state(a) == before


@pytest.mark.slow_but_one_in(16)
@pytest.mark.parametrize("row", TAKE)
def test_results_of_another_campaign_are_as_they_were(made, tmp_path, monkeypatch, row):
    shutil.copytree(made / "results", tmp_path / "results")
    write_text(
        tmp_path / "joints.csv", "id,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\nP,1,2,3,4,5,6\n"
    )
    write_text(tmp_path / "targets.csv", "id,x_mm,y_mm,z_mm,qw,qx,qy,qz\nP,300,0,400,0,0,1,0\n")
    results = tmp_path / "results"
    a, b = results / "a", results / "b"
    write_text(tmp_path / "settings.yaml", f"calibration:\n  prior: {a}\n")
    places = {"a": a, "b": b, "results": results, "raw": made / "raw", "out": tmp_path / "out"}
    places |= {"joints": tmp_path / "joints.csv", "targets": tmp_path / "targets.csv"}
    places |= {"settings": tmp_path / "settings.yaml", "few": FEW}
    words = [word.format(**places) for word in TAKE[row][1].split()]
    monkeypatch.setattr(known_campaigns, "CARRIED", (("a", "b"), ("b", "a")))
    if row in BY_WORKFLOW:
        shutil.rmtree(b)
        taken_as_made(made / "raw/a", results, monkeypatch)
    before = [state(place) for place in (a, b) if place.exists()]
    assert main(words) == 0
    assert [state(place) for place in (a, b)[: len(before)]] == before


#: Plans that could make results of A, whose own raw files are there: targets among the results, and
#: settings.
PLANS = [
    ("b/report.html", {"calibration": {"prior": "{a}"}}),
    ("b/report.html", {"calibration": {"prior": "{a}/model/model.yaml", "effects": "named"}}),
    ("b/chain.json", {"calibration": {"prior": "{a}/model"}}),
    ("b/calibration/0N.json", {"calibration": {"prior": "{a}"}}),
    ("g/report.html", {"groups": {"g": ["a", "b"]}}),
]


@pytest.mark.slow_but_one_in(5)
@pytest.mark.parametrize("file", ["Snakefile", "workflow/run.smk"])
@pytest.mark.parametrize(("target", "settings"), PLANS)
def test_no_plan_makes_results_of_another_campaign(made, call_snakemake, file, target, settings):
    results = made / "results"
    settings = json.loads(json.dumps(settings).replace("{a}", str(results / "a")))
    config = {"campaigns": ["b"], "raw_dir": str(made / "raw"), "results_dir": str(results)}
    pairs = [f"{key}={json.dumps(value)}" for key, value in (config | settings).items()]
    given = ("--cores", "1", "-n", "-s", ROOT / file, "--workflow-profile", "none")
    # Whatever there is of A is older than its raw files.
    code, text = call_snakemake(
        *given, results / target, "--forceall", "--config", *pairs, cwd=made
    )
    assert code == 0, text
    assert planned(text)["total"] >= 1
    outputs = [line for line in text.splitlines() if line.strip().startswith(("output:", "log:"))]
    assert outputs
    assert not [line for line in outputs if f"{results}/a/" in line]


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize(
    ("config", "expected"),
    [
        ({"campaigns": ["a", "b"]}, "a campaign is not its own prior"),
        ({"groups": {"g": ["a", "b"]}}, "a campaign is not its own prior"),
        ({"calibration": {"prior": "results/c"}}, "run the campaign of the prior first"),
    ],
)
def test_a_prior_of_the_campaign_itself_or_that_is_not_there_is_refused(
    made, call_snakemake, config, expected
):
    given = {"campaigns": ["b"], "raw_dir": "raw", "results_dir": "results"}
    given |= {"calibration": {"prior": "results/a"}} | config
    pairs = [f"{key}={json.dumps(value)}" for key, value in given.items()]
    words = ("--cores", "1", "-n", "-s", ROOT / "workflow/run.smk", "campaigns", "--config", *pairs)
    code, text = call_snakemake(*words, cwd=made)
    assert code == 2
    (line,) = (line for line in text.splitlines() if line.startswith("pa10cal"))
    assert expected in line


def test_results_are_not_removed_for_a_campaign_that_is_its_own_prior(made, tmp_path, capsys):
    a = shutil.copytree(made / "results/a", tmp_path / "a")
    before, prior = state(a), json.dumps({"calibration": {"prior": str(a)}})
    words = ["chain", "--campaign-dir", str(made / "raw/a"), "--results", str(a)]
    assert main([*words, "--settings", prior]) == 2
    assert "a campaign is not its own prior" in capsys.readouterr().err
    assert state(a) == before


def test_readings_do_not_count_twice_from_another_place_either(made, tmp_path, capsys):
    for prior, folders, name in (("a", ["a"], "a"), ("a", ["a", "b"], "g")):
        settings = json.dumps({"calibration": {"prior": str(made / "results" / prior)}})
        raw = [str(made / "raw" / folder) for folder in folders]
        words = ["chain", "--campaign-dir", *raw, "--results", str(tmp_path / name)]
        assert main([*words, "--settings", settings]) == 2
        assert "the same readings would count twice" in capsys.readouterr().err


def test_the_same_readings_under_another_name_do_not_count_twice(made, tmp_path, capsys):
    raw = shutil.copytree(made / "raw/a", tmp_path / "copy")
    text = (raw / "campaign.yaml").read_text("utf-8")
    write_text(raw / "campaign.yaml", text.replace("name: a", "name: copy"))
    old = shutil.copytree(made / "results/a/model", tmp_path / "old")
    model = (old / "model.yaml").read_text("utf-8")
    write_text(old / "model.yaml", re.sub(r"\n  readings: .*", "", model))
    for number, prior in enumerate((made / "results/a", old)):
        settings = json.dumps({"calibration": {"prior": str(prior)}})
        words = ["chain", "--campaign-dir", str(raw), "--results", str(tmp_path / str(number))]
        assert main([*words, "--settings", settings]) == 2
        assert "the same readings would count twice (got 'a')" in capsys.readouterr().err


def test_a_changed_prior_is_calibrated_from_anew(made, tmp_path):
    from pa10cal.planning.campaign import prior_digest

    a = shutil.copytree(made / "results/a", tmp_path / "a")
    found = [prior_digest(str(a)), prior_digest(str(a / "model/model.yaml"))]
    (a / "model/model.covariance.npz").write_bytes(b"other")
    assert found[0] == found[1] != prior_digest(str(a))
    assert prior_digest(None) == ""


@pytest.mark.slow
def test_results_of_a_fleet_are_made_anew_with_a_prior(made, tmp_path):
    """The workflow does not know with which settings a fleet made them."""
    b = shutil.copytree(made / "results/b", tmp_path / "b")
    words = ["run", str(made / "raw/b"), "--out", str(tmp_path)]
    assert main([*words, "--prior", str(made / "results/a")]) == 0
    found = json.loads((b / "calibration/combined.json").read_text("utf-8"))
    assert found["prior"]["campaign"] == "a"
    assert not (b / "chain.json").exists()
    before = state(b)
    assert main([*words, "--prior", str(made / "results/a")]) == 0
    assert state(b) == before
    assert main(words) == 0
    assert "prior" not in json.loads((b / "calibration/combined.json").read_text("utf-8"))
