"""Campaigns of the virtual cell whose files a test may mend: faults are put in by hand."""

from __future__ import annotations

import csv
import gzip
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from pa10cal.calibration.input_checks import check_input
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.read import read_campaign
from pa10cal.files.arms import load_arm
from pa10cal.settings_reading import parse_section
from pa10cal_lab.cell.campaign import simulate_campaign
from pa10cal_lab.cell.options import SimulateOptions
from pa10cal_lab.cell.write import write_campaign

QUATERNION = ["qw", "qx", "qy", "qz"]
SOFT = {"ur10": [2, 3], "iiwa14": [2, 4], "pa10_6ce": [2, 3]}


@dataclass
class Table:
    """A CSV file of a campaign, as text."""

    path: Path
    header: list[str]
    rows: list[list[str]]

    @classmethod
    def of(cls, path: Path) -> Table:
        content = path.read_bytes()
        text = gzip.decompress(content) if path.suffix == ".gz" else content
        header, *rows = csv.reader(io.StringIO(text.decode()))
        return cls(path, header, rows)

    def numbers(self, names: list[str]) -> np.ndarray:
        at = [self.header.index(name) for name in names]
        return np.array([[float(row[k]) for k in at] for row in self.rows])

    def put(self, names: list[str], values: np.ndarray) -> None:
        for row, of_row in zip(self.rows, values, strict=True):
            for name, value in zip(names, of_row, strict=True):
                row[self.header.index(name)] = repr(float(value))

    def fill(self, name: str, text: str, rows: slice = slice(None)) -> None:
        if name not in self.header:
            self.header.append(name)
            for row in self.rows:
                row.append("")
        for row in self.rows[rows]:
            row[self.header.index(name)] = text

    def write(self) -> None:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.header)
        writer.writerows(self.rows)
        content = text.getvalue().encode()
        self.path.write_bytes(gzip.compress(content) if self.path.suffix == ".gz" else content)


def simulated(folder: Path, robot: str, instrument: str, seed: int = 5, **plan) -> Path:
    """Write a right campaign of an arm under an instrument; `touches` are of the PA10."""
    raw = {"random_seed": seed, "robot": robot}
    if instrument == "touches":
        raw |= {"repeats": 3, "loads_N": [0.0, 44.0], **plan}
    else:
        usual = {"poses": 100 if instrument == "distance" else 60, "unseen_share": 0.0}
        usual |= {"flexible_joints": SOFT[robot]} if robot in SOFT else {}
        raw["without_touches"] = {"instrument": instrument, **usual, **plan}
    return write_simulated(folder, raw, folder.name, folder.parent / f"{folder.name}.truth.json")


def write_simulated(
    folder: Path,
    asked: SimulateOptions | dict[str, Any],
    name: str = "c",
    truth: Path | None = None,
) -> Path:
    """Simulate a campaign as asked, and write its raw files, and maybe its truth."""
    if isinstance(asked, dict):
        asked = parse_section(SimulateOptions, asked, where="test")
    write_campaign(simulate_campaign(name, load_arm(asked.robot), asked), folder, truth)
    return folder


def mend(folder: Path, name: str, change) -> None:
    """Change a table of a campaign."""
    table = Table.of(folder / name)
    change(table)
    table.write()


def describe(folder: Path, key: str, value) -> None:
    """Change a key of the description; `value` may be a function of what stands there."""
    path = folder / "campaign.yaml"
    content = yaml.safe_load(path.read_text())
    *above, last = key.split(".")
    place = content
    for part in above:
        place = place[part]
    place[last] = value(place[last]) if callable(value) else value
    path.write_text(yaml.safe_dump(content))


def findings(folder: Path):
    """Return what the checks of the input find in a campaign."""
    campaign = read_campaign(folder)
    options = CalibrationOptions()
    return check_input(campaign.description, campaign.arm, campaign.observations, options)
