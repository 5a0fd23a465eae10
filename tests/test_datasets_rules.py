"""The rules that make campaigns of public data sets."""

from __future__ import annotations

import csv
import json
import re
import shutil
from pathlib import Path

import pytest

from made_up_datasets import write_titan
from pa10cal.datasets.readers import dataset_named
from snakemake_calls import planned

ROOT = Path(__file__).parents[1]
ENDS = {
    "ur10-a": ["campaign.yaml", "left_out.csv", "measurements_grid.csv"],
    "ur10-c": ["campaign.yaml", "left_out.csv", "measurements_random_poses.csv"],
}


@pytest.fixture
def snakemake(tmp_path, call_snakemake):
    """Run the project's workflow with a folder of campaigns and results of its own."""

    def run(*words, sources, more=()):
        pairs = [f"raw_dir={tmp_path / 'raw'}", f"results_dir={tmp_path / 'out'}", "campaigns=[x]"]
        pairs += [f"dataset_sources={json.dumps(sources)}", *more]
        (tmp_path / "raw/x").mkdir(parents=True, exist_ok=True)
        (tmp_path / "raw/x/campaign.yaml").write_text("name: x\n")
        common = ("--cores", "1", "--nocolor", "-s", ROOT / "Snakefile")
        return call_snakemake(*common, *words, "--config", *pairs, cwd=tmp_path)

    return run


def test_the_rules_name_every_published_file():
    text = (ROOT / "workflow/rules/datasets.smk").read_text(encoding="utf-8")
    outputs = re.findall(r'f"\{FETCHED\}/(\S+)"', text)
    assert sorted(outputs) == sorted(dataset_named("ipa-robot-accuracy").published.sha256)


@pytest.mark.slow
def test_a_campaign_of_a_data_set_is_fetched_and_imported_first(snakemake, tmp_path):
    target = tmp_path / "out/ur10-a/ingest/poses.parquet"
    code, text = snakemake("-n", target, sources={})
    assert code == 0, text
    fetched = {"fetch_ipa_robot_accuracy", "import_ipa_robot_accuracy", "ingest", "total"}
    assert set(planned(text)) == fetched


@pytest.mark.slow
def test_nothing_is_fetched_over_a_campaign_of_the_same_name(snakemake, tmp_path):
    own = tmp_path / "raw/ur10-a"
    own.mkdir(parents=True)
    (own / "campaign.yaml").write_text("name: ur10-a\nrobot: ur10\ninstrument: {kind: pose}\n")
    code, text = snakemake("-n", tmp_path / "out/ur10-a/ingest/poses.parquet", sources={})
    assert code == 0, text
    assert set(planned(text)) == {"ingest", "total"}


@pytest.mark.slow
def test_the_measured_robot_is_planned_from_the_fetch_to_the_transfer(snakemake, tmp_path):
    raw = tmp_path / "raw"
    for name in ("ur10-a", "ur10-c"):
        (raw / name).mkdir(parents=True)
        (raw / name / "campaign.yaml").write_text(
            f"name: {name}\nrobot: ur10\ninstrument: {{kind: pose}}\n"
        )
        (raw / name / "left_out.csv").write_text("file,line,reason\n")
    code, text = snakemake("-n", "ur10", sources={})
    assert code == 0, text
    assert {"calibrate", "discover", "evaluate", "export", "transfer"} <= set(planned(text))


@pytest.mark.slow
def test_measured_robots_are_planned_of_folders_and_of_data_sets_that_were_fetched(
    snakemake, tmp_path
):
    here = tmp_path / "measured"
    for name in ("ma2010-0516", "ma2010-0801", "iiwa7-free"):
        (here / name).mkdir(parents=True)
        (here / name / "campaign.yaml").write_text(f"name: {name}\nrobot: my_arm\n")
    (here / "arms").mkdir()
    (here / "arms/my_arm.yaml").write_text("")
    write_titan(here / "titan-robot-accuracy")
    code, text = snakemake("-n", "measured", sources={}, more=[f"measured_dir={here}"])
    assert code == 0, text
    assert str(here / "arms/my_arm.yaml") in text
    assert planned(text) == {"measured_campaign": 5, "measured_group": 1, "measured": 1, "total": 7}


@pytest.mark.slow
def test_what_fails_is_a_row_and_nothing_lands_among_raw_campaigns(snakemake, tmp_path):
    here = tmp_path / "measured"
    shutil.copytree(ROOT / "examples/irb120-points", here / "irb120-points")
    write_titan(here / "titan-robot-accuracy")
    code, text = snakemake("measured", sources={}, more=[f"measured_dir={here}"])
    assert code == 0, text
    with (tmp_path / "out/measured/measured.csv").open(encoding="utf-8") as file:
        rows = {row["campaign"]: row for row in csv.DictReader(file)}
    assert list(rows) == ["titan-fixed", "titan-rail", "irb120-points"]
    assert "the checksum differs" in rows["titan-fixed"]["message"]
    done = rows["irb120-points"]
    assert float(done["geometry_rms_mm"]) < float(done["nominal_rms_mm"])
    assert [path.name for path in (tmp_path / "raw").iterdir()] == ["x"]
    _, text = snakemake("measured", sources={}, more=[f"measured_dir={here}"])
    assert "Nothing to be done" in text


@pytest.mark.slow
def test_without_a_measured_campaign_one_line_says_what_to_do(snakemake, tmp_path):
    code, text = snakemake("measured", sources={}, more=[f"measured_dir={tmp_path / 'none'}"])
    assert code != 0
    (line,) = {line for line in text.splitlines() if line.startswith("pa10cal measured:")}
    assert "no measured campaign is at hand" in line
    assert "pa10cal fetch titan-robot-accuracy" in line


@pytest.mark.slow
def test_an_unknown_data_set_is_refused_in_one_line(snakemake):
    code, text = snakemake("-n", sources={"ipa-robot": "."})
    assert code != 0
    (line,) = [line for line in text.splitlines() if line.startswith("pa10cal:")]
    assert "'ipa-robot'; allowed: dlr-elastic-calibration, faro-irb120" in line
    assert "Traceback" not in text


@pytest.mark.slow
def test_imports_from_a_folder_once(snakemake, ipa_data, tmp_path):
    sources = {"ipa-robot-accuracy": str(ipa_data)}
    target = tmp_path / "raw/ur10-c/campaign.yaml"
    code, text = snakemake(target, sources=sources)
    assert code == 0, text
    for name, ends in ENDS.items():
        assert sorted(path.name for path in (tmp_path / "raw" / name).iterdir()) == ends
    _, text = snakemake(target, sources=sources)
    assert "Nothing to be done" in text
