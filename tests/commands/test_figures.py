"""The command: what it writes, what it refuses, and that it leaves nothing half done."""

import json
import re
from pathlib import Path

import pytest

from pa10cal.commands.command_line import FAULT, REFUSED, run_command

CAMPAIGN = Path(__file__).parents[2] / "data/raw/cell-null"
SETTINGS = {"figures": {"png_dpi": 60}, "montecarlo": {"planes_mm": [500]}}


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Results that hold one Monte Carlo plane and nothing else."""
    folder = tmp_path_factory.mktemp("results") / "cell-null"
    words = ["--campaign", "cell-null", "--robot", "pa10_6ce", "--plane-mm", "500"]
    little = '{"cycles": 50, "positions": 5, "map_spacing_mm": 300}'
    out = folder / "montecarlo/z500.json"
    assert run_command("montecarlo", [*words, "--settings", little, "--out", str(out)]) == 0
    return folder


@pytest.fixture
def run(results, tmp_path):
    """Run the command; return its exit code and what it wrote, empty where it wrote nothing."""

    def stage(figure, settings=SETTINGS, campaign=CAMPAIGN, folder=results):
        words = ["--figure", figure] if figure else []
        words += ["--campaign-dir", str(campaign)] if campaign else []
        words += ["--results", str(folder), "--settings", json.dumps(settings)]
        code = run_command("figures", [*words, "--out-dir", str(tmp_path / "out")])
        return code, sorted(path.name for path in tmp_path.rglob("*.*"))

    return stage


def test_writes_a_figure_in_three_formats(run, capsys):
    code, written = run("montecarlo_planes")
    assert code == 0
    assert written == [f"montecarlo_planes.{ending}" for ending in ("pdf", "png", "svg")]
    assert capsys.readouterr().out == "cell-null: montecarlo_planes\n"


def test_writes_everything_that_there_is_and_says_what_was_omitted(run, tmp_path, capsys):
    code, written = run(None)
    assert code == 0
    names = ("montecarlo_planes",)
    files = [f"{name}.{ending}" for name in names for ending in ("pdf", "png", "svg")]
    assert written == sorted([*files, "pictures.json"])
    said = capsys.readouterr().out
    assert "cell-null: where_joints: omitted, there is no discovery/analysis.json\n" in said
    assert f"cell-null: 1 drawn: {', '.join(names)}\n" in said
    record = json.loads((tmp_path / "out/pictures.json").read_text("utf-8"))
    assert record["drawn"] == list(names)
    assert record["omitted"]["fig4_test_path"] == "there is no calibration/combined.json"


def test_refuses_results_of_nothing_that_it_knows(run, capsys):
    code, written = run(None, campaign=None)
    assert (code, written) == (REFUSED, [])
    assert "give --campaign-dir as well" in capsys.readouterr().err


def test_refuses_a_name_that_is_none(run, capsys):
    code, written = run("fig7")
    message = capsys.readouterr().err
    assert (code, written) == (REFUSED, [])
    assert "no such figure or table (got 'fig7')" in message
    assert "fig6_holdout" in message


@pytest.mark.parametrize(
    ("figure", "missing", "stage"),
    [
        ("fig4_test_path", "ingest/poses.parquet", "ingest"),
        ("fig6_holdout", "evaluation/holdout.json", "evaluate"),
        ("table1_parameters", "calibration/combined.json", "calibrate"),
    ],
)
def test_refuses_when_a_result_is_missing(run, capsys, figure, missing, stage):
    code, written = run(figure)
    message = capsys.readouterr().err
    assert (code, written) == (REFUSED, [])
    assert missing in message
    assert f"run pa10cal {stage} first" in message
    assert "Traceback" not in message


def test_refuses_a_plane_that_was_not_run(run, capsys):
    code, written = run("montecarlo_planes", {"montecarlo": {"planes_mm": [400, 500]}})
    assert (code, written) == (REFUSED, [])
    assert "z400.json" in capsys.readouterr().err


def test_refuses_the_results_of_another_campaign(run, capsys):
    code, written = run("montecarlo_planes", campaign=CAMPAIGN.with_name("cell-a"))
    assert (code, written) == (REFUSED, [])
    assert "another campaign (got 'cell-null'); allowed: cell-a" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"figures": {"dpi": 60}}, "unknown key figures.dpi.*did you mean 'png_dpi'"),
        ({"figures": {"png_dpi": 5}}, "key figures.png_dpi does not fit.*got 5"),
        ({"kcub_reading": "e9"}, "key kcub_reading does not fit"),
        ({"calibration": {}}, "unknown key calibration"),
    ],
)
def test_refuses_wrong_settings(run, capsys, settings, message):
    code, written = run("montecarlo_planes", settings)
    assert (code, written) == (REFUSED, [])
    assert re.search(message, capsys.readouterr().err)


def test_a_fault_leaves_nothing_behind(run, monkeypatch, capsys):
    def fail(*arguments):
        raise OSError("disk full")

    monkeypatch.setattr("pa10cal.figures.draw.write_figure", fail)
    code, written = run("montecarlo_planes")
    assert (code, written) == (FAULT, [])
    assert "internal fault: OSError: disk full" in capsys.readouterr().err
