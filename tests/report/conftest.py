"""Results of a small campaign, through every command, to write reports of."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from made_up_records import effect, made_up_gap, names, verdict_keys
from pa10cal.commands.command_line import run_command
from pa10cal.results.codec import read, write
from pa10cal.results.discovery import Fault, VerdictRecord

NAME = "small"
PLAN = {"robot": "ur10", "without_touches": {"instrument": "pose", "poses": 40}}
ECCENTRIC = {"A": (4e-4, 2e-5), "phi": (0.77, 0.04)}
RIVAL = ("gear_ratio_error", "joint 2")


def run(command, *words):
    """Run a command that must succeed."""
    assert run_command(command, [str(word) for word in words]) == 0


@pytest.fixture(scope="session")
def small(tmp_path_factory) -> Path:
    """Results of a campaign that is too small for a search; to be read only."""
    place = tmp_path_factory.mktemp("report")
    raw, folder = place / "raw" / NAME, place / "results" / NAME
    truth = ("--truth", place / "truth.json")
    run("simulate", "--name", NAME, "--settings", json.dumps(PLAN), "--out", raw, *truth)
    poses, base_frame = folder / "ingest/poses.parquet", folder / "seed/base_frame.json"
    given = ("--campaign-dir", raw, "--poses", poses)
    quarantine = ("--quarantine", folder / "ingest/quarantine.csv")
    run("ingest", "--campaign-dir", raw, "--out", poses, *quarantine)
    run("seed", *given, "--out", base_frame)
    combined = folder / "calibration/combined.json"
    begun = ("--base-frame", base_frame, "--load", "combined", "--out", combined)
    run("calibrate", *given, *begun)
    out = {name: folder / f"discovery/{name}.json" for name in ("verdict", "analysis", "extended")}
    out["suggested"] = folder / "discovery/suggested_poses.csv"
    words = [word for name, path in out.items() for word in (f"--{name}", path)]
    calibration = ("--calibration", combined)
    run("discover", *given, *calibration, *words)
    extended = ("--extended", out["extended"])
    run("evaluate", *given, *calibration, *extended, "--out", folder / "evaluation/holdout.json")
    model = ("--model", folder / "model/model.yaml", "--urdf", folder / "model/robot.urdf")
    run("export", *calibration, *extended, *model, "--dh", folder / "model/dh.csv")
    return folder


@pytest.fixture
def copied(small, tmp_path):
    """Copy the results, to be changed."""
    folder = tmp_path / "results" / NAME
    shutil.copytree(small, folder)
    return folder


#: What discovery may say, by the word of the verdict.
_EFFECT = effect("encoder_eccentricity", "joint 2", ECCENTRIC)
VERDICTS = {
    "none": verdict_keys("none", ()),
    "named": verdict_keys("named", (_EFFECT,)),
    "ambiguous": verdict_keys(
        "ambiguous", (effect("encoder_eccentricity", "joint 2", ECCENTRIC, [RIVAL]),)
    ),
    "unexplained": verdict_keys("unexplained", (), places=("joint 3", None)),
    "check_the_log": verdict_keys("check_the_log", (_EFFECT,)).model_copy(
        update={
            "faults": (
                Fault(
                    kind="joint_sign",
                    where="q3_deg",
                    what="joint 3 counts the other way",
                    remedy="negate q3_deg",
                    gain=0.9,
                ),
            )
        }
    ),
    "not_sought": verdict_keys("not_sought", (), not_testable=names(RIVAL)).model_copy(
        update={"why": "36 poses are too few", "remedy": "measure 100", "gap": made_up_gap()}
    ),
}


@pytest.fixture(params=VERDICTS)
def judged(request, copied):
    """Results with a verdict in a word, and that word."""
    made = VerdictRecord(
        **dict(VERDICTS[request.param]),
        campaign=NAME,
        provenance="synthetic: made up",
        arrival_from_order=False,
        seconds=1.0,
    )
    write(made, copied / "discovery/verdict.json")
    read(VerdictRecord, copied / "discovery/verdict.json", NAME)
    return copied, request.param
