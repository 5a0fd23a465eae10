"""A campaign in a folder of its own, taken through the commands of a run one by one.

Beside its raw files in `raw` come poses.parquet, base.json, combined.json, and what discovery
writes.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pa10cal.commands.command_line import run_command

#: What discovery writes, by its option.
DISCOVERED = {
    "verdict": "verdict.json",
    "analysis": "analysis.json",
    "extended": "extended.json",
    "suggested": "suggested.csv",
}


def called(command: str, *words: object, **options: Any) -> int:
    """Run a command, a mapping given as JSON, True as a switch, None not; return its exit code."""
    given = [str(word) for word in words]
    for name, value in options.items():
        text = json.dumps(value) if isinstance(value, dict) else str(value)
        if value is not None:
            given += [f"--{name.replace('_', '-')}", *([] if value is True else [text])]
    return run_command(command, given)


def table_of(folder: Path) -> dict[str, Path]:
    """Return the options that say which campaign."""
    return {"campaign_dir": folder / "raw", "poses": folder / "poses.parquet"}


def simulated(folder: Path, name: str, settings: dict[str, Any]) -> Path:
    """Write a campaign of the virtual cell into a folder, and return that folder."""
    made = {"out": folder / "raw", "truth": folder / "truth.json", "settings": settings}
    assert called("simulate", name=name, **made) == 0
    return folder


def located(folder: Path) -> Path:
    """Take raw files to a table of poses and the base frame."""
    raw, poses = folder / "raw", folder / "poses.parquet"
    quarantine = folder / "quarantine.csv"
    assert called("ingest", campaign_dir=raw, out=poses, quarantine=quarantine) == 0
    assert called("seed", **table_of(folder), out=folder / "base.json") == 0
    return folder


def calibrated(folder: Path, *loads: str, **settings: Any) -> Path:
    """Take raw files to calibrations, that of all loads where none is named."""
    located(folder)
    for load in loads or ("combined",):
        assert calibrate(folder, folder / f"{load}.json", load=load, settings=settings) == 0
    return folder


def calibrate(folder: Path, out: Path, **options: Any) -> int:
    """Calibrate a campaign that was located."""
    given = {"base_frame": folder / "base.json", "load": "combined", "out": out}
    return called("calibrate", **table_of(folder), **given | options)


def discover(folder: Path, out: Path | None = None, **options: Any) -> int:
    """Search a calibrated campaign; results go beside it, or into another folder."""
    written = {name: (out or folder) / file for name, file in DISCOVERED.items()}
    given = table_of(folder) | {"calibration": folder / "combined.json"} | written
    return called("discover", **given | options)


def evaluate(folder: Path, out: Path, **options: Any) -> int:
    """Judge the model of a campaign that was searched; `extended=None`: that was calibrated."""
    given = {"calibration": folder / "combined.json", "extended": folder / "extended.json"}
    return called("evaluate", **table_of(folder), **given | options, out=out)


def export(folder: Path, out: Path, **options: Any) -> int:
    """Write the model of a campaign that was searched; `extended=None`: that was calibrated."""
    given = {"calibration": folder / "combined.json", "extended": folder / "extended.json"}
    files = {"model": out / "model.yaml", "urdf": out / "robot.urdf"}
    return called("export", **given | options, **files)


def read_json(path: Path) -> Any:
    """Read JSON, without room for numbers that are not finite."""

    def refuse(word: str) -> None:
        raise ValueError(f"{word} in {path}")

    return json.loads(path.read_text("utf-8"), parse_constant=refuse)
