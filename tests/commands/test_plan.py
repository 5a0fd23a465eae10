"""`pa10cal plan`: poses to measure, as a file, and refusals."""

from __future__ import annotations

import csv
import json

import pytest

from pa10cal.commands.command_line import REFUSED, run_command
from pa10cal.results.codec import read
from pa10cal.results.plan import PlanRecord

FEW = json.dumps({"candidates": 120, "effects": 0.1})


def command(tmp_path, *more, robot="irb120", poses="16"):
    out = tmp_path / "plan.csv"
    words = ["--robot", robot, "--instrument", "pose", "--poses", poses, "--out", str(out)]
    return run_command("plan", [*words, "--options", FEW, *more]), out


def test_poses_and_what_to_expect_of_them_are_written(tmp_path, capsys):
    boxes = tmp_path / "box.yaml"
    boxes.write_text("- {min_mm: [300, -50, 0], max_mm: [500, 50, 200], name: table}\n")
    more = ["--keep-out", str(boxes), "--workspace-mm", "-600", "-600", "0", "600", "600", "900"]
    code, out = command(tmp_path, *more, "--instrument-at-mm", "2000", "0", "500")
    assert code == 0
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert [row["id"] for row in rows] == [f"P{k}" for k in range(1, 17)]
    assert list(rows[0]) == [
        "id", *(f"q{k}_deg" for k in range(1, 7)), "x_mm", "y_mm", "z_mm", "u_tool_mm"
    ]  # fmt: skip
    record = read(PlanRecord, out.with_suffix(".json"))
    assert record.instrument == "pose"
    assert [pose.q[0] for pose in record.poses] == pytest.approx([float(r["q1_deg"]) for r in rows])
    assert record.effects
    assert record.options["keep_out"][0]["name"] == "table"
    told = capsys.readouterr().out
    assert "16 poses of irb120" in told
    assert "expected standard uncertainty" in told
    assert "keep-out 1 (table)" in told


@pytest.mark.parametrize(
    ("boxes", "words"),
    [
        ("- {min_mm: [0, 0, 0], max_mm: [1, 0, 1], name: flat}\n", "a volume"),
        ("min_mm: [0, 0, 0]\n", "no list of boxes"),
        ("- {min: [0, 0, 0], max_mm: [1, 1, 1]}\n", "min_mm"),
        ("- [\n", "cannot be read"),
    ],
)
def test_boxes_that_are_none_are_refused(tmp_path, capsys, boxes, words):
    path = tmp_path / "box.yaml"
    path.write_text(boxes)
    code, out = command(tmp_path, "--keep-out", str(path))
    assert code == REFUSED
    message = capsys.readouterr().err
    assert str(path) in message
    assert words in message
    assert not out.exists()


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--workspace-mm", "0", "1"], "six numbers"),
        (["--instrument-at-mm", "0", "1"], "instrument_at_mm does not fit (got '2 values'); "),
        (["--instrument-at-mm", "0"], "allowed: 3 values: where the instrument is"),
        (["--out", "x.json"], "give x.csv"),
        (["--facing-deg", "30"], "instrument_at_mm"),
        (["--workspace-mm", "0", "0", "0", "500", "0", "500"], "a volume"),
        (["--uncertainty-mm", "-1"], "uncertainty_mm"),
        (["--poses", "3"], "at least 5 poses"),
        (["--robot", "ur100"], "unknown robot"),
    ],
)
def test_other_slips_are_refused(tmp_path, capsys, more, words):
    code, out = command(tmp_path, *more)
    assert code == REFUSED
    assert words in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize(
    ("option", "given", "out"),
    [
        ("--options", "plan.json", "plan.csv"),  # plan.json is written beside plan.csv
        ("--options", "opt.yaml", "opt.yaml"),
        ("--keep-out", "plan.json", "plan.csv"),
    ],
)
def test_no_input_is_replaced(tmp_path, capsys, option, given, out):
    path = tmp_path / given
    path.write_text("[]" if option == "--keep-out" else FEW)
    before = path.read_bytes()
    code, _ = command(tmp_path, option, str(path), "--out", str(tmp_path / out))
    assert code == REFUSED
    of = option[2:].replace("-", " ")
    assert f"--out: the output would replace the file of {of} (got" in capsys.readouterr().err
    assert path.read_bytes() == before


def test_long_settings_are_no_path(tmp_path):
    (tmp_path / "plan.csv").touch()
    long = json.dumps(json.loads(FEW) | {"targets_mm": [[0.0, 0.0, 100.0]] * 40})
    assert command(tmp_path, "--options", long)[0] == 0


def test_options_of_their_own_complete_the_settings(tmp_path):
    settings = json.dumps(json.loads(FEW) | {"facing_deg": 120, "uncertainty_mm": 0.2})
    more = ["--options", settings, "--instrument-at-mm", "2500", "0", "1200"]
    code, out = command(tmp_path, *more, "--uncertainty-mm", "0.1")
    assert code == 0
    options = read(PlanRecord, out.with_suffix(".json")).options
    assert (options["facing_deg"], options["uncertainty_mm"]) == (120, 0.1)


def test_where_an_instrument_of_distances_is_taken_to_be_is_said(tmp_path, capsys):
    code, _ = command(tmp_path, "--instrument", "distance", poses="40")
    assert code == 0
    assert "instrument taken to be at" in capsys.readouterr().out
