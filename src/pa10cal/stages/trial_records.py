"""Verdicts on blind trials and their truths: two files of JSON lines, one line a trial."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pa10cal.cell.trials import Trial
from pa10cal.errors import RecordError
from pa10cal.evaluation.blind_trial import BlindTrial, Hidden, Name, Named, Verdict
from pa10cal.files.schemas import TRIAL_TRUTH, VERDICT


def truth_record(trial: Trial, moved_mm: Sequence[float | None], seconds: float) -> dict[str, Any]:
    """Return what a trial hides, how it was measured, and how far that moves the residual.

    Args:
        trial: what was drawn.
        moved_mm: how far, one a hidden effect; None where the trial failed.
        seconds: what finding that out took.
    """
    settings = trial.settings
    return {
        "schema": TRIAL_TRUTH,
        "campaign": trial.name,
        "kind": trial.kind,
        "layout": trial.bench,
        "path": settings.path,
        "temperature_drift_C": settings.temperature_drift_C,
        "flexible_joints": list(settings.flexible_joints),
        "hidden_effects": [
            {**effect.model_dump(), "size": size, "moved_mm": moved}
            for effect, size, moved in zip(
                settings.hidden_effects, trial.sizes, moved_mm, strict=True
            )
        ],
        "stated_uncertainty_mm": settings.stated_uncertainty_mm,
        "mass_factor": list(settings.mass_factor),
        "seconds_twin": seconds,
    }


def json_line(record: Mapping[str, Any]) -> str:
    """Return a record as one line of JSON.

    Raises:
        ValueError: when a number is not finite.
    """
    return json.dumps(record, ensure_ascii=False, allow_nan=False) + "\n"


def read_trials(verdicts: Sequence[Path], truths: Sequence[Path]) -> list[BlindTrial]:
    """Join verdicts and truths by the name of the trial, in the order of the truths.

    Raises:
        RecordError: when a file cannot be read, or a trial has not one of each.
    """
    said = _by_name(verdicts, VERDICT)
    hidden = _by_name(truths, TRIAL_TRUTH)
    if odd := sorted(set(said) ^ set(hidden)):
        raise RecordError(
            "a trial has a verdict or a truth, but not both",
            where=", ".join(map(str, (*verdicts, *truths))),
            value=odd[0],
            allowed="verdicts and truths of the same trials",
            remedy="give all files that the blind_trials stage wrote",
        )
    trials = []
    for name, truth in hidden.items():
        try:
            trials.append(_trial(said[name], truth))
        except (KeyError, TypeError, ValueError) as error:
            raise RecordError(
                "the verdict on a trial cannot be read",
                where=name,
                value=f"{type(error).__name__}: {error}",
                allowed="what the blind_trials stage writes",
                remedy="run the trials again",
            ) from None
    return trials


def _by_name(paths: Sequence[Path], schema: str) -> dict[str, dict[str, Any]]:
    records: dict[str, dict[str, Any]] = {}
    for path in paths:
        try:
            lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
        except (OSError, ValueError) as error:
            raise _unreadable(path, str(error), schema) from None
        for number, line in enumerate(lines, start=1):
            where = f"{path}:{number}"
            if not isinstance(line, dict) or line.get("schema") != schema:
                raise _unreadable(where, "another kind of record", schema)
            if line["campaign"] in records:
                raise _unreadable(where, f"{line['campaign']} a second time", schema)
            records[line["campaign"]] = line
    return records


def _unreadable(where: object, value: str, schema: str) -> RecordError:
    return RecordError(
        "the trials cannot be read",
        where=str(where),
        value=value,
        allowed=f"one line of schema {schema} a trial",
        remedy="run the blind_trials stage again",
    )


def _trial(said: dict[str, Any], truth: dict[str, Any]) -> BlindTrial:
    return BlindTrial(
        campaign=truth["campaign"],
        kind=truth["kind"],
        layout=truth["layout"],
        path=truth["path"],
        flexible_joints=tuple(truth["flexible_joints"]),
        hidden=tuple(
            Hidden(_name(entry), float(entry["size"]), entry["parameters"], entry["moved_mm"])
            for entry in truth["hidden_effects"]
        ),
        seconds_twin=float(truth["seconds_twin"]),
        verdict=None if "failed" in said else _verdict(said),
        failed=said.get("failed"),
    )


def _verdict(said: dict[str, Any]) -> Verdict:
    gap = said["gap"]
    held_out = gap["holdout"]
    return Verdict(
        word=said["verdict"],
        effects=tuple(
            Named(
                _name(entry),
                tuple(_name(rival) for rival in entry["alternatives"]),
                {
                    name: (float(value["value"]), float(value["std"]))
                    for name, value in entry["parameters"].items()
                },
            )
            for entry in said["effects"]
        ),
        places=_places(said),
        not_testable=frozenset(_name(entry) for entry in said["not_testable"]),
        alike=tuple(frozenset(map(_name, group)) for group in said["not_told_apart"]),
        noise_floor_mm=float(gap["noise_floor_mm"]),
        held_out_after_mm=None if held_out is None else float(held_out["after"]["mean_mm"]),
        seconds=float(said["seconds"]),
        seconds_simulating=float(said["seconds_simulating"]),
    )


def _places(said: dict[str, Any]) -> tuple[str | None, ...]:
    """Return where something without a name sits; of a map, the verdict's effects tell."""
    if said["verdict"] != "unexplained":
        return ()
    return tuple(entry["of"] for entry in said["unexplained"]["all"])


def _name(entry: Mapping[str, Any]) -> Name:
    return Name(entry["id"], entry["of"])
