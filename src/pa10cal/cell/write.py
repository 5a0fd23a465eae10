"""A campaign's folder under the raw-data contract, and the file of its truth elsewhere."""

from __future__ import annotations

import gzip
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from pa10cal.cell.campaign import (
    INSTRUMENT_UNCERTAINTY_MM,
    REFERENCE_TEMPERATURE_C,
    Campaign,
)
from pa10cal.cell.mechanism import GRAVITY_M_S2
from pa10cal.cell.truth import truth_record
from pa10cal.errors import SimulationError
from pa10cal.files.output import whole_file, write_json, write_text

CAMPAIGN_SCHEMA = "pa10cal-campaign/1"
DESCRIPTION_FILE = "campaign.yaml"
CMM_FILE = "cmm.csv.gz"
RESOLVER_FILE = "resolver.csv.gz"
PROVENANCE = (
    "synthetic: written by this project's own virtual cell, not measured on a robot; "
    "what effects it hides, if any, is not told here"
)
#: How many decimals a column has in its file, by the end of its name; others are written as is.
DECIMALS = {"time_s": 2, "_mm": 4, "_deg": 5, "_Nm": 3, "_C": 2}


def write_campaign(campaign: Campaign, folder: Path, truth: Path) -> None:
    """Write a campaign's folder and, elsewhere, its truth.

    The description comes last, so that a folder with a description is whole.

    Args:
        campaign: what to write.
        folder: the campaign's folder; files of a former campaign in it are replaced.
        truth: the file for what is hidden.

    Raises:
        SimulationError: when the truth would lie inside the folder, or when the folder holds
            anything that is not a campaign's.
    """
    claim_folder(folder, truth, (CMM_FILE, RESOLVER_FILE))
    write_json(truth, truth_record(campaign))
    write_table(campaign.cmm, folder / CMM_FILE)
    write_table(campaign.resolver, folder / RESOLVER_FILE)
    write_description(campaign_description(campaign), folder)


def campaign_description(campaign: Campaign) -> dict[str, Any]:
    """Return the content of campaign.yaml, as in the raw-data contract."""
    apparatus = campaign.truth.robot.apparatus
    stated_mm = campaign.settings.stated_uncertainty_mm
    balls_mm = (1e3 * apparatus.balls_measured_m).round(4).tolist()
    return {
        "schema": CAMPAIGN_SCHEMA,
        "name": campaign.name,
        "robot": campaign.truth.robot.arm.name,
        "provenance": PROVENANCE,
        "instrument": {
            "kind": "touch_trigger_cmm",
            "uncertainty_mm": INSTRUMENT_UNCERTAINTY_MM if stated_mm is None else stated_mm,
        },
        "ball_diameter_mm": round(1e3 * apparatus.ball_diameter_m, 4),
        "tool": {
            "mass_kg": apparatus.mass_kg,
            "com_mm": (1e3 * apparatus.com_m).round(4).tolist(),
            "load_point_mm": (1e3 * apparatus.load_point_m).round(4).tolist(),
            "balls_mm": dict(zip(apparatus.ball_names, balls_mm, strict=True)),
        },
        "gravity_m_s2": GRAVITY_M_S2.tolist(),
        "reference_temperature_C": REFERENCE_TEMPERATURE_C,
        "files": {"cmm": CMM_FILE, "resolver": RESOLVER_FILE},
    }


def claim_folder(folder: Path, truth: Path | None, files: Sequence[str]) -> None:
    """Make sure that a campaign may be written, and take a former description away.

    Args:
        folder: the campaign's folder.
        truth: the file for what is hidden, if there is to be one.
        files: names of the raw files.

    Raises:
        SimulationError: see `write_campaign`.
    """
    if truth is not None and truth.resolve().is_relative_to(folder.resolve()):
        raise SimulationError(
            "the truth must not lie in the campaign's folder",
            where="--truth",
            value=str(truth),
            allowed="a path outside the campaign's folder",
            remedy="name another place",
        )
    own = {DESCRIPTION_FILE, *files}
    foreign = sorted({entry.name for entry in folder.glob("*")} - own)
    if foreign or folder.is_file():
        raise SimulationError(
            "the folder holds something that is not a campaign's",
            where="--out",
            value=", ".join(foreign) or str(folder),
            allowed=f"a new folder, or one with {', '.join(sorted(own))} only",
            remedy="name another folder or move the files away",
        )
    (folder / DESCRIPTION_FILE).unlink(missing_ok=True)


def write_description(content: dict[str, Any], folder: Path) -> None:
    """Write campaign.yaml."""
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=90)
    write_text(folder / DESCRIPTION_FILE, text)


def write_table(table: pd.DataFrame, path: Path, decimals: Mapping[str, int] = DECIMALS) -> None:
    """Write a CSV, gzipped if its name says so, whose bytes depend on the table alone.

    Args:
        table: what to write; nan leaves a cell empty.
        path: where.
        decimals: how many a column has, by the end of its name; others are written as they are.
    """
    columns = [_as_text(table[name], decimals) for name in table.columns]
    lines = [",".join(table.columns), *map(",".join, zip(*columns, strict=True))]
    content = ("\n".join(lines) + "\n").encode()
    if path.suffix == ".gz":
        packed = BytesIO()
        with gzip.GzipFile(
            filename="", mode="wb", fileobj=packed, compresslevel=6, mtime=0
        ) as file:
            file.write(content)
        content = packed.getvalue()
    with whole_file(path) as beside:
        beside.write_bytes(content)


def _as_text(column: pd.Series[Any], decimals: Mapping[str, int]) -> list[str]:
    places = next(
        (count for end, count in decimals.items() if str(column.name).endswith(end)), None
    )
    if places is not None:
        form = f"%.{places}f"  # + 0.0: no minus zero
        return ["" if value != value else form % value for value in (column + 0.0).tolist()]
    if column.dtype.kind == "f":  # a load, whole newtons as a rule
        return [f"{value:g}" for value in column.tolist()]
    return [str(value) for value in column.tolist()]
