"""Results of a small campaign, through every command, and what discovery may say of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from made_up_records import effect, made_up_gap, names, verdict_keys
from pa10cal.commands.command_line import run_command
from pa10cal.results.codec import read, write
from pa10cal.results.discovery import Fault, ProposedEvidence, ProposedFormula, VerdictRecord
from pa10cal.results.evaluation import EffectParameter
from pa10cal.results.outcomes import ChainRecord

NAME = "small"
PLAN = {"robot": "ur10", "without_touches": {"instrument": "pose", "poses": 40}}
ECCENTRIC = {"A": (4e-4, 2e-5), "phi": (0.77, 0.04)}
RIVAL = ("gear_ratio_error", "joint 2")


def _run(command, *words):
    assert run_command(command, [str(word) for word in words]) == 0


def taken_to_a_model(raw: Path, results: Path, **settings) -> Path:
    """Take a campaign through every stage, and return its results."""
    words = ("--results", results, "--settings", json.dumps(settings))
    _run("chain", "--campaign-dir", raw, *words)
    assert read(ChainRecord, results / ChainRecord.FILE).status == "done"
    return results


def small_results(place: Path, name: str = NAME, plan=PLAN) -> Path:
    """Return the results of a simulated campaign that is too small for a search."""
    raw, truth = place / "raw" / name, ("--truth", place / f"{name}.json")
    _run("simulate", "--name", name, "--settings", json.dumps(plan), "--out", raw, *truth)
    return taken_to_a_model(raw, place / "results" / name)


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
