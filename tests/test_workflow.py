"""The workflow itself: which jobs it plans, what it passes to commands, what a change runs again.

The planning tests use the project as it is. The running tests use a copy whose commands are
stand-ins that take the same options and write little files, so that only the workflow is on trial.
"""

import fcntl
import json
import re
import shutil
from pathlib import Path

import pytest
import yaml

from pa10cal_lab.cell.trials import trial_counts
from pa10cal_lab.options import BlindTrialsOptions
from snakemake_calls import planned
from workflow_stand_ins import stand_ins

ROOT = Path(__file__).parents[1]
SETTINGS = BlindTrialsOptions()
COMMON = ("--cores", "2", "--nocolor")
SHIPPED = ("cell-a", "cell-null", "lightcap2008")


@pytest.fixture
def raw(tmp_path):
    """Return a folder of the campaigns that are shipped; a checkout in use has others besides."""
    folder = tmp_path / "raw"
    folder.mkdir()
    for name in SHIPPED:
        (folder / name).symlink_to(ROOT / "data/raw" / name)
    return folder


@pytest.fixture
def plan(tmp_path, raw, call_snakemake):
    """Dry-run the project as it is, away from its folder."""

    def run(*words, **config):
        config = {"raw_dir": raw, "results_dir": tmp_path / "out"} | config
        pairs = [f"{key}={value}" for key, value in config.items()]
        given = ("-n", "-s", ROOT / "Snakefile", *words, "--config", *pairs)
        return call_snakemake(*COMMON, *given, cwd=tmp_path)

    return run


@pytest.fixture
def checkout(tmp_path, call_snakemake):
    """Lay out a copy of the project with stand-in commands and one campaign; return a runner."""
    place = tmp_path / "check out"
    source = place / "src"
    # With byte code, else each job compiles it anew; what is just being compiled vanishes.
    shutil.copytree(ROOT / "src", source, ignore=shutil.ignore_patterns("*.pyc.*"))
    shutil.copytree(ROOT / "workflow", place / "workflow")
    for name in ("Snakefile", "config.yaml", "README.md"):
        shutil.copy(ROOT / name, place)
    for module, text in stand_ins().items():
        (source / f"{module.replace('.', '/')}.py").write_text(text)
    (source / "pa10cal/calibration/probe.py").write_text("ANSWER = 1\n")
    campaign = place / "data/raw/c1"
    campaign.mkdir(parents=True)
    content = {
        "name": "first",
        "robot": "pa10_6ce",
        "instrument": {"kind": "touch_trigger_cmm"},
        "files": {"cmm": "cmm.csv", "resolver": "gone.csv"},
    }
    (campaign / "campaign.yaml").write_text(yaml.safe_dump(content))
    (campaign / "cmm.csv").write_text("time_s\n")

    def run(*words, config=()):
        pairs = ["campaigns=['c1']", "montecarlo={'planes_mm': [300, 500]}", *config]
        env = {"PYTHONPATH": str(source)}
        return call_snakemake(*COMMON, *words, "--config", *pairs, cwd=place, env=env)

    run.place = place
    return run


FULL, REDUCED, TRACKED, REFLECTORS, UNSTATED, SORTED, MIXED = (
    sum(-(-count // SETTINGS.trials_a_job) for count in trial_counts(counts).values())
    for counts in (
        *(SETTINGS.full, SETTINGS.reduced, SETTINGS.tracked, SETTINGS.reflectors),
        *(SETTINGS.unstated, SETTINGS.sorted_by_joint, SETTINGS.mixed),
    )
)
ONE = {"campaigns": '["cell-null"]'}
GROUP = {"campaigns": '["cell-a"]', "groups": '{"arm": ["cell-a", "cell-null"]}'}
#: Targets (those with a folder are results), settings, and how often some jobs are planned.
PLANS = [
    ("", ONE, "ingest 1, base_frame 1, evaluate 1, montecarlo 1, calibrate 1"),
    ("", {}, "judge_trials 0, montecarlo 3"),
    ("cell-a/calibration/44N.json", {}, "ingest 1, base_frame 1, calibrate_one 1, total 3"),
    (
        "arm/report.html arm/evaluation/holdout.json",
        GROUP,
        "ingest 2, base_frame 3, join 1, montecarlo 0, calibrate 1, discover 1, evaluate 1, page 1",
    ),
    # All load cases in one job, and one of them alone beside what follows from all.
    (
        "cell-null/calibration/combined.json cell-null/discovery/verdict.json",
        ONE,
        "calibrate 1, discover 1",
    ),
    (
        "cell-null/calibration/44N.json cell-null/discovery/verdict.json",
        ONE,
        "calibrate_one 1, discover 1",
    ),
    # Effects of the verdict are sought before they are calibrated with.
    (
        "cell-a/calibration/combined.json",
        {"calibration": "{effects: named}"},
        "calibrate 1, calibrate_baseline 1, discover 1",
    ),
    ("blind_trials_reduced", {}, f"judge_trials {REDUCED}"),
    ("blind_trials_tracked", {}, f"judge_trials {TRACKED}"),
    (
        "simulate",  # the campaign of config.yaml too
        {"simulate": "{s1: {without_touches: {instrument: points}}, t1: {}}"},
        "simulate_tracked 1, simulate_campaign 2",
    ),
    (
        "blind_trials_reflectors",
        {},
        f"judge_trials {3 * REFLECTORS}, score_trials 3, trial_pictures 3",
    ),
    ("blind_trials_unstated", {}, f"judge_trials {UNSTATED}, score_trials 1, trial_pictures 1"),
    ("blind_trials", {}, f"judge_trials {FULL + TRACKED}, score_trials 2, trial_pictures 2"),
    ("blind_trials_sorted", {}, f"judge_trials {SORTED}, score_trials 1, trial_pictures 1"),
    ("blind_trials_mixed", {}, f"judge_trials {MIXED}, score_trials 1, trial_pictures 1"),
]


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize(("targets", "config", "jobs"), PLANS)
def test_plans(plan, tmp_path, targets, config, jobs):
    given = [tmp_path / "out" / each if "/" in each else each for each in targets.split()]
    code, text = plan(*given, **config)
    assert code == 0, text
    wanted = {job: int(count) for job, count in map(str.split, jobs.split(", "))}
    found = planned(text)
    assert {job: found[job] for job in wanted} == wanted
    if "total" in wanted:
        assert set(found) == set(wanted)
    if targets == "simulate":
        assert str(tmp_path / "out/simulated/s1/poses.csv") in text


@pytest.mark.slow
def test_one_target_covers_both_models_with_the_settings_given(plan):
    section = json.dumps({"campaigns": 3, "random_seed": 7, "poses": 44})
    code, text = plan("-p", "coverage", coverage=section)
    assert code == 0, text
    assert set(planned(text)) == {"coverage", "total"}
    assert "coverage --settings" in text
    assert '"random_seed":7,"campaigns":3' in text
    assert '"poses":44' in text


def test_full_trials_are_many_and_reduced_ones_no_more():
    full, reduced, tracked = map(trial_counts, (SETTINGS.full, SETTINGS.reduced, SETTINGS.tracked))
    assert full["null"] >= 200
    assert tracked["null"] >= 150
    assert all(few <= full[kind] for kind, few in reduced.items())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("config", "expected"),
    [
        ({"calibraton": 1}, "unknown key calibraton.*did you mean 'calibration'"),
        ({"montecarlo": '{"cycle": 5}'}, "unknown key montecarlo.cycle.*'cycles'"),
        ({"campaigns": "[]"}, "key campaigns does not fit"),
        ({"campaigns": '["../cell-a"]'}, "key campaigns.0 does not fit.*letters, digits"),
        ({"groups": '{"arm": ["cell-a"]}'}, "key groups does not fit.*two or more campaigns"),
        ({"groups": '{"arm": ["cell-a", "cell-b"]}'}, "no such campaign.*cell-b"),
        (
            {"calibration": '{"prior": "gone.yaml"}'},
            "calibration.prior: the file is not there.*gone.yaml",
        ),
        ({"campaigns": '["nope"]'}, f"^pa10cal:.*allowed: {', '.join(SHIPPED)};"),
        (
            {"campaigns": '["cell-a"]', "groups": '{"cell-null": ["cell-a", "lightcap2008"]}'},
            "a group is called like a campaign.*cell-null",
        ),
    ],
)
def test_refuses_a_wrong_configuration_in_one_message(plan, config, expected):
    code, text = plan(**config)
    assert code == 2
    assert re.search(expected, text, re.MULTILINE)
    assert len([line for line in text.splitlines() if line.startswith("pa10cal:")]) <= 1
    assert "Traceback" not in text


@pytest.mark.slow
def test_names_a_campaign_that_is_not_there(plan, tmp_path):
    code, text = plan(tmp_path / "out/celll/ingest/poses.parquet")
    assert code != 0
    assert "celll/campaign.yaml" in text
    assert "Traceback" not in text


def test_runs_to_the_end_and_then_only_what_a_change_touches(checkout):
    code, text = checkout()
    assert code == 0, text
    results = checkout.place / "results/c1"
    calibrations = {path.stem for path in (results / "calibration").glob("*.json")}
    assert calibrations == {"0N", "22.5N", "combined"}
    assert {path.stem for path in (results / "montecarlo").iterdir()} == {"z300", "z500"}
    drawn = json.loads((results / "figures/drawn.svg").read_text())
    assert set(drawn) == {"figures", "kcub_reading", "montecarlo", "evaluation"}
    assert "seed at work" in text
    assert (results / "logs/base_frame.log").read_text() == "seed at work\n"
    passed = json.loads((results / "montecarlo/z300.json").read_text())
    assert (passed["campaign"], passed["robot"]) == ("first", "pa10_6ce")

    assert "Nothing to be done" in checkout("-n")[1]

    probe = checkout.place / "src/pa10cal/calibration/probe.py"
    probe.write_text("ANSWER = 2\n")
    jobs = planned(checkout("-n")[1])
    assert jobs["calibrate"] == 1
    assert not {"ingest", "base_frame", "montecarlo"} & set(jobs)


@pytest.mark.slow
def test_what_was_removed_is_made_again(checkout):
    code, text = checkout()
    assert code == 0, text
    results = checkout.place / "results/c1"
    removed = [results / name for name in ("model/dh.csv", "discovery/suggested_poses.csv")]
    for path in removed:
        path.unlink()
    jobs = planned(checkout("-n")[1])
    assert jobs["export"] == jobs["discover"] == 1
    assert "calibrate" not in jobs
    code, text = checkout()
    assert code == 0, text
    assert all(path.is_file() for path in removed)
    assert "Nothing to be done" in checkout("-n")[1]


@pytest.mark.slow
def test_settings_figures_and_the_robot_are_inputs_and_words_are_none(checkout):
    code, text = checkout()
    assert code == 0, text
    assert "Nothing to be done" in checkout()[1]
    (checkout.place / "README.md").write_text("other words")
    assert "Nothing to be done" in checkout("-n")[1]

    other_starts = ["calibration={'starts': 2}"]
    jobs = planned(checkout("-n", config=other_starts)[1])
    assert jobs["calibrate"] == 1
    assert jobs["evaluate"] == jobs["pictures"] == 1
    assert not {"ingest", "base_frame", "montecarlo"} & set(jobs)

    (checkout.place / "src/pa10cal/figures/campaign/residuals.py").write_text("LINE = 1\n")
    assert set(planned(checkout("-n", "figures")[1])) == {"pictures", "figures", "total"}

    # The campaign's own description of its robot is an input once it is there.
    (checkout.place / "data/raw/c1/pa10_6ce.yaml").write_text("name: pa10_6ce\n")
    assert {"ingest", "base_frame", "montecarlo"} <= set(planned(checkout("-n")[1]))


@pytest.mark.slow
def test_snakemake_by_hand_holds_the_campaigns_that_it_makes(checkout):
    """One that another run holds is refused, what else there is in the results is not looked at."""
    locks = checkout.place / "results/.pa10cal/locks"
    locks.mkdir(parents=True)
    shutil.copytree(checkout.place / "data/raw/c1", checkout.place / "data/raw/c2")
    targets = [f"results/{name}/calibration/combined.json" for name in ("c1", "c2")]
    with (locks / "c1").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        for target in targets[:1], targets:
            code, text = checkout(*target)
            assert code == 2
            assert "results/c1: another run is at work on these results" in text
        assert not (checkout.place / "results/c2").exists()
        code, text = checkout(targets[1])
        assert code == 0, text
    code, text = checkout(*targets)
    assert code == 0, text
    assert {path.name for path in locks.iterdir()} == {"c1", "c2"}
    assert list((locks.parent / "runs").iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["pose", "points", "distance"])
def test_pictures_wait_for_what_a_campaign_has(checkout, kind):
    description = checkout.place / "data/raw/c1/campaign.yaml"
    content = yaml.safe_load(description.read_text()) | {"instrument": {"kind": kind}}
    description.write_text(yaml.safe_dump(content))
    code, text = checkout("figures")
    assert code == 0, text
    results = checkout.place / "results/c1"
    assert (results / "pictures.json").exists()
    assert (results / "discovery/verdict.json").exists()
    assert not (results / "montecarlo").exists()


@pytest.mark.slow
def test_one_picture_is_drawn_by_its_path_from_what_it_needs(checkout):
    path = "results/c1/figures/fig4_test_path.svg"
    code, text = checkout(path, "results/c1/tables/suspected_outliers.csv")
    assert code == 0, text
    results = checkout.place / "results/c1"
    assert {path.suffix for path in (results / "figures").glob("fig4_test_path.*")} == {
        ".svg",
        ".pdf",
        ".png",
    }
    assert (results / "tables/suspected_outliers.md").exists()
    assert not (results / "evaluation").exists()
    assert planned(checkout("-n", "figures")[1])["pictures"] == 1


@pytest.mark.slow
def test_blind_trials_are_divided_into_jobs_and_scored_together(checkout):
    counts = {**dict.fromkeys(dict(SETTINGS.full), 0), "null": 3, "pair": 2}
    few = [f"blind_trials={{'trials_a_job': 2, 'reduced': {counts}}}"]
    code, text = checkout("blind_trials_reduced", config=few)
    assert code == 0, text
    results = checkout.place / "results/blind_trials_reduced"
    assert (results / "scores.json").read_text() == "null 0 2; null 2 1; pair 0 2"
    assert (results / "figures/drawn.svg").exists()
    assert (results / "tables/drawn.md").exists()
    assert not (checkout.place / "results/c1").exists()


@pytest.mark.slow
def test_curves_are_laid_drawn_and_the_chain_is_calibrated(checkout):
    code, text = checkout("curve", config=["curve={'individuals': 1}"])
    assert code == 0, text
    results = checkout.place / "results/curve"
    assert (results / "tables/drawn.md").exists()
    moving = (results / "rolling_helix/figures/drawn.svg").read_text()
    assert json.loads(moving)["gait"]["moves"] == "roll"
    for still in ("helix", "serpenoid"):
        drawn = results / still / "figures/drawn.svg"
        assert json.loads(drawn.read_text())["curve"]["shape"] == still
    passed = json.loads((results / "calibration.json").read_text())
    assert json.loads(passed["settings"])["individuals"] == 1
    assert json.loads(passed["calibration"])["starts"] == 8
    jobs = planned(checkout("-n", "curve", config=["curve={'individuals': 2}"])[1])
    assert set(jobs) == {"calibrate_chain", "draw_chain", "curve", "total"}


@pytest.mark.slow
def test_shows_and_keeps_the_message_of_a_command_that_refuses(checkout):
    campaign = checkout.place / "data/raw/c1/campaign.yaml"
    campaign.write_text(campaign.read_text() + "refuse: true\n")
    code, text = checkout("results/c1/ingest/poses.parquet")
    message = "pa10cal ingest: cmm.csv:7: broken; allowed: sense; mend it\n"
    assert code != 0
    assert message in text
    assert "exit status 2" in text
    assert "Traceback" not in text
    results = checkout.place / "results/c1"
    assert (results / "logs/ingest.log").read_text().endswith(message)
    assert not (results / "ingest/poses.parquet").exists()


@pytest.mark.slow
def test_simulates_beside_the_results_and_never_over_raw_data(checkout, tmp_path):
    before = sorted((checkout.place / "data").rglob("*"))
    elsewhere = tmp_path / "else where"
    code, text = checkout("simulate", config=[f"results_dir={elsewhere}"])
    assert code == 0, text
    folder = elsewhere / "simulated/lightcap2008"
    assert {path.name for path in folder.iterdir()} == {
        "campaign.yaml",
        "cmm.csv.gz",
        "resolver.csv.gz",
    }
    assert (elsewhere / "simulated/lightcap2008.truth.json").read_text() == "text_e7"
    assert sorted((checkout.place / "data").rglob("*")) == before
