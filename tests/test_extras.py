"""What needs none of the extras runs without them; what needs one says which."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pandas as pd
import pytest

from pa10cal.errors import EXTRAS
from pa10cal.results.calibration import CalibrationRecord
from pa10cal.results.codec import read
from pa10cal.results.discovery import VerdictRecord

ROOT = Path(__file__).parents[1]
BLOCKED = f"""
import sys
for name in {[*EXTRAS]}:
    sys.modules[name] = None
from pa10cal.__main__ import main
for command in sys.stdin.read().splitlines():
    code = main(command.split())
    if code:
        sys.exit(code)
"""
#: Raw files to a model, and the model in use, as the stages are called one by one.
STAGES = """
doctor
ingest --campaign-dir RAW --out poses.parquet --quarantine quarantine.csv
seed --campaign-dir RAW --poses poses.parquet --out base_frame.json
calibrate --campaign-dir RAW --poses poses.parquet --base-frame base_frame.json --out calibration
discover --campaign-dir RAW --poses poses.parquet --calibration calibration/combined.json FOUND
export --calibration calibration/combined.json --model model.yaml --urdf robot.urdf --dh dh.csv
predict --model model.yaml --joints joints.csv --out poses.csv --frame tool
compensate --model model.yaml --targets targets.csv --out commands.csv --frame tool
"""
FOUND = "--verdict verdict.json --analysis a.json --extended extended.json --suggested s.csv"


def without_extras(folder, commands):
    raw = str(ROOT / "examples/irb120-points")
    return subprocess.run(
        [sys.executable, "-c", BLOCKED],
        input=commands.strip().replace("RAW", raw).replace("FOUND", FOUND),
        cwd=folder,
        capture_output=True,
        text=True,
    )


@pytest.mark.slow
def test_raw_files_become_a_model_in_use_without_any_extra(tmp_path):
    (tmp_path / "joints.csv").write_text(
        "id,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\nP,1,2,3,4,50,6\n"
    )
    target = "id,x_mm,y_mm,z_mm,qw,qx,qy,qz\nT,350,50,500,0.5,0.5,0.5,0.5\n"
    (tmp_path / "targets.csv").write_text(target)
    done = without_extras(tmp_path, STAGES)
    assert done.returncode == 0, done.stderr
    graded = read(CalibrationRecord, tmp_path / "calibration/combined.json")
    assert graded.health.grade == "good"
    assert read(VerdictRecord, tmp_path / "verdict.json").verdict == "not_sought"
    assert pd.read_csv(tmp_path / "poses.csv").u_mm[0] < 0.1
    assert pd.read_csv(tmp_path / "commands.csv").status[0] == "ok"
    for extra in ("figures", "report", "workflow", "urdf"):
        assert f"pip install '.[{extra}]'" in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "module"),
    [
        ("run RAW", "snakemake"),
        ("figures --results results/mine --campaign-dir RAW --out-dir out", "matplotlib"),
        ("import_arm robot.urdf --out arm.yaml", "pinocchio"),
    ],
)
def test_what_needs_an_extra_names_it_in_one_message(tmp_path, command, module):
    done = without_extras(tmp_path, command)
    assert done.returncode == 2
    assert f"the package {module} is not installed" in done.stderr
    assert f"pip install '.[{EXTRAS[module]}]'" in done.stderr
    assert done.stderr.count("\n") == 1


def test_every_extra_is_one_of_the_project():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    distributions = {"pinocchio": "pin"}
    for module, extra in EXTRAS.items():
        name = distributions.get(module, module.replace("_", "-"))
        assert name in project["optional-dependencies"][extra]
        assert name not in project["dependencies"]
