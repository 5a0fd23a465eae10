"""A data set's folder imported as campaigns, and these written whole or not at all."""

from __future__ import annotations

import gzip
import os
import re
import shutil
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from pa10cal.campaign.description import DESCRIPTION_FILE, SCHEMA, read_description
from pa10cal.campaign.raw_rows import quarantine_csv
from pa10cal.campaign.text_lines import LARGEST_BYTES
from pa10cal.datasets.data_set import AsItIs, DataSet, ImportedCampaign
from pa10cal.datasets.fetching import differing_files, refusal_of, unreadable
from pa10cal.errors import OutputError, RawDataError
from pa10cal.files.output import FORMER, folder_beside, writing_into
from pa10cal.files.table_cells import csv_text
from pa10cal.input_files import read_file

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


def import_campaigns(
    dataset: DataSet, folder: Path, *, max_left_out: float, any_version: bool
) -> tuple[ImportedCampaign, ...]:
    """Read the campaigns of a data set.

    The content is read before wrong checksums are refused: a message about a line says more than
    one about a file.

    Args:
        dataset: to read.
        folder: its files.
        max_left_out: largest fraction of a file's rows that may be omitted.
        any_version: whether to accept files that are not the published ones; the provenance of the
            campaigns made of them then says so.

    Raises:
        RawDataError: when files are missing, cannot be read, or are not the published ones.
    """
    files = ", ".join(dataset.files)
    if not folder.is_dir():
        raise RawDataError(
            "there is no such folder",
            where="folder of the data set",
            value=str(folder),
            allowed=f"a folder with {files}",
            remedy="correct the path, or fetch the data set",
        )
    if missing := [name for name in dataset.files if not os.path.lexists(folder / name)]:
        raise RawDataError(
            "files of the data set are missing in the folder",
            where=str(folder),
            value=", ".join(missing),
            allowed=f"a folder with {files}",
            remedy="copy the missing files there, or fetch the data set again",
        )
    published = dataset.published
    differing = differing_files(folder, {name: published.sha256[name] for name in dataset.files})
    campaigns = dataset.read(folder, max_left_out)
    if differing and not any_version:
        remedy = "fetch the data set again, or import it as it is with --any-version"
        raise refusal_of(differing, published, remedy)
    checked = []
    for campaign in campaigns:
        clauses = [
            f"{Path(file.place).name} is not the published file (SHA-256 {file.found})"
            for file in differing
            if file.place in {str(folder / path) for path in campaign.files}
        ]
        if clauses:
            provenance = f"{campaign.provenance} But {'; '.join(clauses)}."
            notes = (*campaign.notes, *clauses)
            campaign = replace(campaign, provenance=provenance, notes=notes)
        checked.append(campaign)
    return tuple(checked)


def write_campaigns(campaigns: Sequence[ImportedCampaign], folder: Path) -> list[Path]:
    """Write each campaign into a folder of its name, whole or not at all.

    A former folder of a campaign is replaced once all campaigns are written beside their places.
    The same campaigns give the same bytes.

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
                _put_in_place(beside, place)
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
    """Return `columns.poses` of an unchanged file, or of a table that states no time."""
    if isinstance(campaign.readings, AsItIs):
        return dict(campaign.readings.columns)
    names = list(campaign.readings.columns)
    if "time_s" in names:
        return {}
    columns: dict[str, Any] = {
        "joints": {"names": [name for name in names if re.fullmatch(r"q\d+_(deg|mm)", name)]}
    }
    if torques := [name for name in names if re.fullmatch(r"tau\d+_Nm", name)]:
        columns["torques"] = {"names": torques}
    if "x_mm" in names:
        columns["position"] = {"names": ["x_mm", "y_mm", "z_mm"]}
    if "qw" in names:
        rotation = {"names": ["qw", "qx", "qy", "qz"], "convention": "quaternion_wxyz"}
        columns["rotation"] = rotation
    targets = [match[1] for name in names if (match := _TARGET.fullmatch(name))]
    if targets:
        columns["targets"] = {
            target: {"names": [f"{target}_{axis}_mm" for axis in "xyz"]} for target in targets
        }
    return columns


def _file(campaign: ImportedCampaign) -> str:
    """Return the name of the file of readings."""
    readings = campaign.readings
    return readings.path.name if isinstance(readings, AsItIs) else POSES_FILE


def table_bytes(table: pd.DataFrame) -> bytes:
    """Return a gzipped CSV whose bytes depend on the table alone; nan is an empty field."""
    columns = [_as_text(table[name]) for name in table.columns]
    text = csv_text(table.columns, zip(*columns, strict=True))
    return gzip.compress(text.encode(), compresslevel=6, mtime=0)


def _as_text(column: pd.Series[Any]) -> list[str]:
    """Return the fields of a column; numbers in the format that its name decides."""
    if column.dtype.kind != "f":
        return [str(value) for value in column.tolist()]
    name = str(column.name)
    starts = [form for start, form in _STARTS.items() if name.startswith(start)]
    ends = [form for end, form in _ENDS.items() if name.endswith(end)]
    form = [*starts, *ends, _QUATERNION][0]
    values = (column + 0.0).tolist()  # + 0.0: no minus zero
    return ["" if value != value else form % value for value in values]


def _refuse_foreign(place: Path, own: frozenset[str]) -> None:
    """Refuse a place that holds anything but the files of a campaign."""
    foreign = sorted({entry.name for entry in place.glob("*")} - own)
    if foreign or place.is_file():
        raise OutputError(
            "the folder of the campaign holds something else",
            where=str(place),
            value=", ".join(foreign) or place.name,
            allowed=f"a new folder, or one with {', '.join(sorted(own))} only",
            remedy="give another folder, or move the files away",
        )


def _write(campaign: ImportedCampaign, folder: Path) -> None:
    """Write the files of a campaign into a folder, and read its description back as a check."""
    readings = campaign.readings
    if isinstance(readings, AsItIs):
        try:
            content = read_file(readings.path, LARGEST_BYTES, readings.folder)
        except OSError as error:
            raise unreadable(readings.path, error) from None
    else:
        content = table_bytes(readings)
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


def _put_in_place(beside: Path, place: Path) -> None:
    """Move the new folder to its place; restore the former folder if that fails."""
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
