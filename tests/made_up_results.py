"""Results of a small campaign, through every command, and what discovery may say of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from made_up_records import effect, made_up_gap, names, verdict_keys
from pa10cal.commands.command_line import run_command
from pa10cal.results.codec import write
from pa10cal.results.discovery import Fault, VerdictRecord
from pa10cal.results.evaluation import EffectParameter
from pa10cal.results.explained import ProposedEvidence, ProposedFormula

NAME = "small"
PLAN = {"robot": "ur10", "without_touches": {"instrument": "pose", "poses": 40}}
ECCENTRIC = {"A": (4e-4, 2e-5), "phi": (0.77, 0.04)}
RIVAL = ("gear_ratio_error", "joint 2")


def _run(command, *words):
    assert run_command(command, [str(word) for word in words]) == 0


def small_results(place: Path) -> Path:
    """Return the results of a campaign that is too small for a search."""
    raw, folder = place / "raw" / NAME, place / "results" / NAME
    truth = ("--truth", place / "truth.json")
    _run("simulate", "--name", NAME, "--settings", json.dumps(PLAN), "--out", raw, *truth)
    poses, base_frame = folder / "ingest/poses.parquet", folder / "seed/base_frame.json"
    given = ("--campaign-dir", raw, "--poses", poses)
    quarantine = ("--quarantine", folder / "ingest/quarantine.csv")
    _run("ingest", "--campaign-dir", raw, "--out", poses, *quarantine)
    _run("seed", *given, "--out", base_frame)
    combined = folder / "calibration/combined.json"
    begun = ("--base-frame", base_frame, "--load", "combined", "--out", combined)
    _run("calibrate", *given, *begun)
    out = {name: folder / f"discovery/{name}.json" for name in ("verdict", "analysis", "extended")}
    out["suggested"] = folder / "discovery/suggested_poses.csv"
    words = [word for name, path in out.items() for word in (f"--{name}", path)]
    calibration = ("--calibration", combined)
    _run("discover", *given, *calibration, *words)
    extended = ("--extended", out["extended"])
    iso9283 = ("--iso9283", folder / "evaluation/iso9283.json")
    held_out = ("--out", folder / "evaluation/holdout.json")
    _run("evaluate", *given, *calibration, *extended, *held_out, *iso9283)
    model = ("--model", folder / "model/model.yaml", "--urdf", folder / "model/robot.urdf")
    _run("export", *calibration, *extended, *model, "--dh", folder / "model/dh.csv")
    return folder


#: A formula for what has no name.
PROPOSED = ProposedFormula(
    formula="theta_3 += h s_3 |tau_3|",
    of="joint 3",
    form="arrival_by_torque",
    numbers=(),
    parameters={"h": EffectParameter(value=2.7e-6, std=4e-8, unit="rad/(N m)")},
    gain=0.9,
    does_as_well_as=names(("direction_map", "joint 3")),
    others=(),
    evidence=ProposedEvidence(
        blocks=9,
        rows=2916,
        squared_error_without=130790.0,
        squared_error_with=2774.0,
        squared_error_held=2791.0,
        gain_std=0.01,
    ),
)
#: What discovery may say, by the word of the verdict.
_EFFECT = effect("encoder_eccentricity", "joint 2", ECCENTRIC)
VERDICTS = {
    "none": verdict_keys("none", ()),
    "named": verdict_keys("named", (_EFFECT,)),
    "ambiguous": verdict_keys(
        "ambiguous", (effect("encoder_eccentricity", "joint 2", ECCENTRIC, [RIVAL]),)
    ),
    "unexplained": verdict_keys("unexplained", (), places=("joint 3", None)).model_copy(
        update={"proposed": (PROPOSED,)}
    ),
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


def with_verdict(folder: Path, word: str) -> Path:
    """Give results a verdict."""
    made = VerdictRecord(
        **dict(VERDICTS[word]),
        campaign=NAME,
        provenance="synthetic: made up",
        arrival_from_order=False,
        seconds=None,
    )
    write(made, folder / "discovery/verdict.json")
    return folder


def elsewhere(results, folder=None, **described):
    """The same results in another folder, or of a campaign that is described otherwise."""
    description = results.description.model_copy(update=described)
    folder = results.folder if folder is None else folder
    return replace(results, folder=folder, description=description)
