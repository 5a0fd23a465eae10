import csv
import json

import pytest

from pa10cal.commands.command_line import run_command

CASES = [
    {"robot": "gx4_351s", "instrument": "points"},
    {"robot": "ur10", "instrument": "pose", "flexible_joints": [2, 3, 4, 5]},
]


@pytest.mark.slow
def test_a_few_campaigns_are_covered(tmp_path):
    """Hundreds of every case are a target of the workflow; a few would show a gross fault."""
    settings = json.dumps({"campaigns": 5, "general_campaigns": 10, "cases": CASES})
    calibration = json.dumps({"starts": 1})
    out, table = tmp_path / "coverage.json", tmp_path / "coverage.csv"
    argv = ["--settings", settings, "--calibration", calibration]
    assert run_command("coverage", [*argv, "--out", str(out), "--table", str(table)]) == 0
    found = json.loads(out.read_text())
    paper = found["paper"]
    assert paper["campaigns"] == 5
    assert len(paper["parameters"]) == 28
    assert 0.85 < paper["inside"] < 1.0
    assert 0.75 < paper["rms"] < 1.3
    assert [case["case"] for case in found["cases"]] == [
        "gx4_351s, 1 target",
        "ur10, pose, springs",
    ]
    for case in found["cases"]:
        assert case["converged"] == case["departing_in_any_way"]["converged"] == 1.0
        for share in (
            case["parameters"],
            case["predictions"],
            case["departing_in_any_way"]["predictions"],
        ):
            assert 0.88 < share["inside"] < 0.995
            assert 0.75 < share["rms"] < 1.3
    scara, ur10 = found["cases"]
    assert scara["unknowns"] == len(scara["parameters"]["by_parameter"]) == 17
    assert scara["redundant"]["target_T1_z"] == {"base_z": pytest.approx(1.0)}
    assert set(ur10["parameters"]["by_class"]) == {"lengths", "angles", "base", "tool", "springs"}
    with table.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 1 + 2 * 3 + 4 + 5
    assert rows[0]["inside_percent"] == f"{100 * paper['inside']:.1f}"
    assert rows[1]["inside_percent"] == f"{100 * scara['parameters']['inside']:.1f}"


def test_an_unknown_robot_is_refused(tmp_path, capsys):
    settings = json.dumps({"campaigns": 1, "cases": [{"robot": "scara", "instrument": "pose"}]})
    calibration = json.dumps({"starts": 1})
    argv = ["--settings", settings, "--calibration", calibration]
    argv += ["--out", str(tmp_path / "c.json"), "--table", str(tmp_path / "c.csv")]
    assert run_command("coverage", argv) == 2
    assert "unknown robot" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
