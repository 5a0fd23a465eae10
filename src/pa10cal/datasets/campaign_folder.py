"""Imported campaigns as folders under the raw-data contract: whole or not at all."""

from __future__ import annotations

import gzip
import re
import shutil
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from pa10cal.campaign.description import DESCRIPTION_FILE, SCHEMA, read_description
from pa10cal.campaign.raw_rows import quarantine_csv
from pa10cal.datasets.importing import AsItIs, ImportedCampaign
from pa10cal.errors import OutputError
from pa10cal.files.output import FORMER, folder_beside, writing_into
from pa10cal.yaml_file import refusals_beside

_refusal = refusals_beside(__file__, OutputError)

POSES_FILE = "poses.csv.gz"
LEFT_OUT_FILE = "left_out.csv"
OWN_FILES = frozenset({DESCRIPTION_FILE, POSES_FILE, LEFT_OUT_FILE})
#: What a target is called whose place stands in columns of its own.
_TARGET = re.compile(r"(\w+)_x_mm")
#: Gravity in the base frame of an arm that stands upright.
UPRIGHT_GRAVITY_M_S2 = (0.0, 0.0, -9.81)
#: How a column's numbers are written, by how its name begins or ends; the first that fits.
_STARTS = {"u_": "%.6g", "time_s": "%.1f"}
_ENDS = {"_deg": "%.8f", "_mm": "%.6f", "_C": "%.3f", "_N": "%g", "_Nm": "%.6f"}
_QUATERNION = "%.10f"


def write_campaigns(campaigns: Sequence[ImportedCampaign], folder: Path) -> list[Path]:
    """Write each campaign into a folder of its name, whole or not at all.

    A campaign's folder that is there already is replaced, once all campaigns are written beside
    their places. The same campaigns give the same bytes.

    Returns:
        The campaigns' folders.

    Raises:
        OutputError: when a place holds anything but a campaign, or cannot be written to.
        RawDataError: when a description is not one that the contract's own reader accepts.
    """
    places = [folder / campaign.name for campaign in campaigns]
    for place, campaign in zip(places, campaigns, strict=True):
        arm = {f"{campaign.robot}.yaml"} if campaign.arm else set()
        _refuse_foreign(place, OWN_FILES | {_file(campaign), *arm})
    with ExitStack() as stack:
        remedy = "give another folder, or remove what is in the way"
        with writing_into(folder, "the campaign", remedy):
            besides = [stack.enter_context(folder_beside(place)) for place in places]
            for campaign, beside in zip(campaigns, besides, strict=True):
                _write(campaign, beside)
            for place, beside in zip(places, besides, strict=True):
                _replace(beside, place)
    return places


def description(campaign: ImportedCampaign) -> dict[str, Any]:
    """Return the content of campaign.yaml, as in the raw-data contract."""
    return {
        "schema": SCHEMA,
        "name": campaign.name,
        "provenance": campaign.provenance,
        "robot": campaign.robot,
        "instrument": {
            "kind": campaign.instrument,
            "uncertainty_mm": campaign.uncertainty_mm,
        },
        "tool": {
            "mass_kg": campaign.tool_mass_kg,
            "com_mm": [0.0, 0.0, 0.0],
            "load_point_mm": [0.0, 0.0, 0.0],
        },
        "gravity_m_s2": list(UPRIGHT_GRAVITY_M_S2),
        "reference_temperature_C": campaign.reference_temperature_C,
        "files": {"poses": _file(campaign)},
        "holdout": dict(campaign.holdout),
        **({} if campaign.joints == "logged" else {"joints": campaign.joints}),
        **({"columns": {"poses": columns}} if (columns := _columns(campaign)) else {}),
    }


def _columns(campaign: ImportedCampaign) -> dict[str, Any]:
    """Return `columns.poses`: of a file as it is, and of a table that states no time."""
    if isinstance(campaign.readings, AsItIs):
        return dict(campaign.readings.columns)
    names = list(campaign.readings.columns)
    if "time_s" in names:
        return {}
    found: dict[str, Any] = {
        "joints": {"names": [name for name in names if re.fullmatch(r"q\d+_(deg|mm)", name)]}
    }
    if torques := [name for name in names if re.fullmatch(r"tau\d+_Nm", name)]:
        found["torques"] = {"names": torques}
    if "x_mm" in names:
        found["position"] = {"names": ["x_mm", "y_mm", "z_mm"]}
    if "qw" in names:
        rotation = {"names": ["qw", "qx", "qy", "qz"], "convention": "quaternion_wxyz"}
        found["rotation"] = rotation
    targets = [match[1] for name in names if (match := _TARGET.fullmatch(name))]
    if targets:
        found["targets"] = {
            target: {"names": [f"{target}_{axis}_mm" for axis in "xyz"]} for target in targets
        }
    return found


def _file(campaign: ImportedCampaign) -> str:
    """Return the name of the file of readings."""
    readings = campaign.readings
    return readings.path.name if isinstance(readings, AsItIs) else POSES_FILE


def table_bytes(table: pd.DataFrame) -> bytes:
    """Return a gzipped CSV whose bytes depend on the table alone; nan is an empty field."""
    columns = [_as_text(table[name]) for name in table.columns]
    lines = [",".join(table.columns), *map(",".join, zip(*columns, strict=True))]
    return gzip.compress(("\n".join(lines) + "\n").encode(), compresslevel=6, mtime=0)


def _as_text(column: pd.Series[Any]) -> list[str]:
    if column.dtype.kind != "f":
        return [str(value) for value in column.tolist()]
    name = str(column.name)
    starts = [form for start, form in _STARTS.items() if name.startswith(start)]
    ends = [form for end, form in _ENDS.items() if name.endswith(end)]
    form = [*starts, *ends, _QUATERNION][0]
    values = (column + 0.0).tolist()  # + 0.0: no minus zero
    return ["" if value != value else form % value for value in values]


def _refuse_foreign(place: Path, own: frozenset[str]) -> None:
    foreign = sorted({entry.name for entry in place.glob("*")} - own)
    if foreign or place.is_file():
        raise _refusal("foreign", place, ", ".join(foreign) or place.name, ", ".join(sorted(own)))


def _write(campaign: ImportedCampaign, folder: Path) -> None:
    readings = campaign.readings
    content = readings.path.read_bytes() if isinstance(readings, AsItIs) else table_bytes(readings)
    (folder / _file(campaign)).write_bytes(content)
    listing = quarantine_csv(campaign.left_out)
    (folder / LEFT_OUT_FILE).write_text(listing, encoding="utf-8", newline="\n")
    text = yaml.safe_dump(
        description(campaign),
        sort_keys=False,
        default_flow_style=None,
        width=90,
        allow_unicode=True,
    )
    (folder / DESCRIPTION_FILE).write_text(text, encoding="utf-8", newline="\n")
    if campaign.arm is not None:
        shutil.copyfile(campaign.arm, folder / f"{campaign.robot}.yaml")
    read_description(folder)


def _replace(beside: Path, place: Path) -> None:
    """Put the new folder in the place of a former one, which stays until that is done."""
    former = beside.with_name(beside.name + FORMER)
    if place.is_dir():
        place.rename(former)
    try:
        beside.rename(place)
    except OSError:
        if former.is_dir():
            former.rename(place)
        raise
    shutil.rmtree(former, ignore_errors=True)
