"""A data set's folder to campaigns: nothing missing, as published, written whole or not at all."""

from __future__ import annotations

import gzip
import hashlib
import os
import re
import shutil
import urllib.request
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from http.client import HTTPException
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pandas as pd
import yaml

from pa10cal.campaign.description import DESCRIPTION_FILE, SCHEMA, JointPositions, read_description
from pa10cal.campaign.raw_rows import Quarantined, quarantine_csv
from pa10cal.campaign.text_lines import LARGEST_BYTES
from pa10cal.errors import OutputError, RawDataError
from pa10cal.files.output import FORMER, csv_text, folder_beside, whole_files, writing_into
from pa10cal.input_files import is_file, open_file, read_file, reason
from pa10cal.yaml_file import read_yaml

# What a reader of a data set defines, and what it gives: campaigns not yet written.


@dataclass(frozen=True)
class Published:
    """Where the files of a data set are published, and what they are."""

    version: str  # the version meant, such as a commit
    address: str  # what stands in front of a file's path
    sha256: Mapping[str, str]  # checksum of every file that is fetched, by its path
    stated: Mapping[str, Any] = field(default_factory=dict)  # what its reader's YAML file states

    @classmethod
    def of(cls, name: str) -> Published:
        """Return what `published/<name>.yaml` states of a data set.

        The files are those of a commit of a public repository on GitHub, counted from a folder of
        it where one is stated.
        """
        path = Path(__file__).parent / "published" / f"{name}.yaml"
        stated = read_yaml(path, RawDataError, what="what is stated of the data set is unreadable")
        folder = f"{stated['folder']}/" if "folder" in stated else ""
        sha256 = {f"{folder}{path}": checksum for path, checksum in stated["sha256"].items()}
        commit = stated["commit"]
        address = f"https://raw.githubusercontent.com/{stated['repository']}/{commit}/"
        return cls(commit, address, sha256, stated)

    def provenance_text(self, **more: object) -> str:
        """Return the provenance with repository, commit and what else it names in their places."""
        text: str = self.stated["provenance"]
        return text.format(**{**self.stated, **more})

    @property
    def terms(self) -> str:
        """Return under which licence the files are, in a sentence."""
        repository = self.stated["repository"]
        if "licence" in self.stated:
            return f"{repository}: {self.stated['licence']}."
        return (
            f"{repository}: no licence is stated by the owner. The files are fetched from the "
            "owner for you alone; ask the owner before you pass them on."
        )


@dataclass(frozen=True)
class AsItIs:
    """A file that is read as it is."""

    path: Path  # where it is
    columns: Mapping[str, Any]  # `columns.poses` of campaign.yaml
    folder: Path  # of the data set, which it lies in


@dataclass(frozen=True)
class ImportedCampaign:
    """One campaign of a data set, as docs/raw-data.md specifies it.

    A table of readings without `time_s` says that no time was recorded: its rows are in the order
    of the file, and poses of equal joint positions are repeats.
    """

    name: str  # name of the campaign and of its folder
    robot: str  # name of the arm description
    provenance: str  # whose measurements these are, and what was done with them
    instrument: str  # kind of the instrument
    uncertainty_mm: float  # standard uncertainty of one measured place, per axis
    readings: AsItIs | pd.DataFrame  # a file that is read as it is; or columns of `files.poses`
    files: tuple[str, ...]  # paths of the files read, inside the data set's folder
    reference_temperature_C: float = 20.0  # lengths are nominal at it; assumed where not stated
    # which poses are held out, as campaign.yaml has it
    holdout: Mapping[str, float] = field(default_factory=lambda: {"every": 5})
    left_out: tuple[Quarantined, ...] = ()  # rows omitted
    notes: tuple[str, ...] = ()  # what the reader should know, one clause each
    joints: JointPositions = "logged"  # whether joint positions are `logged`, or those `commanded`
    arm: Path | None = None  # description of the arm where it is not a shipped one; its path
    tool_mass_kg: float = 0.0  # what the flange carries; 0 where it is not known


@dataclass(frozen=True)
class DataSet:
    """A data set that can be imported."""

    name: str  # what it is called on the command line
    # reads its folder, in which all `files` are; leaves out at most the given part of a file's
    # rows, or raises RawDataError
    read: Callable[[Path, float], tuple[ImportedCampaign, ...]]
    published: Published  # where it is published, and the files that are fetched
    unread: tuple[str, ...] = ()  # paths of those that are not read, such as a licence

    @property
    def files(self) -> tuple[str, ...]:
        """Return the paths inside its folder that are read."""
        return tuple(path for path in self.published.sha256 if path not in self.unread)


# Campaigns of a data set.


def import_campaigns(
    dataset: DataSet, folder: Path, *, max_left_out: float, any_version: bool
) -> tuple[ImportedCampaign, ...]:
    """Read the campaigns of a data set.

    The content is read before the checksums are judged, since a message about a line says more
    than one about a file.

    Args:
        max_left_out: part of a file's rows that may be left out.
        any_version: whether files that are not the published ones will do; the provenance of the
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
        raise _refusal_of(differing, published, remedy)
    described = []
    for campaign in campaigns:
        clauses = [
            f"{Path(file.place).name} is not the published file (SHA-256 {file.found})"
            for file in differing
            if file.place in {str(folder / own) for own in campaign.files}
        ]
        if clauses:
            provenance = f"{campaign.provenance} But {'; '.join(clauses)}."
            notes = (*campaign.notes, *clauses)
            campaign = replace(campaign, provenance=provenance, notes=notes)
        described.append(campaign)
    return tuple(described)


# Files of a data set against the checksums of their published version.


@dataclass(frozen=True)
class Differing:
    """A file that is not the published one."""

    place: str  # the file, or its address
    found: str  # its SHA-256
    published: str  # that of the published file


def sha256(content: bytes) -> str:
    """Return the checksum as text."""
    return hashlib.sha256(content).hexdigest()


def _sha256_of(folder: Path, name: str) -> str:
    try:
        with open_file(folder / name, folder) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise _unread(folder / name, error) from None


def _unread(path: Path, error: OSError) -> RawDataError:
    return RawDataError(
        f"a file of the data set cannot be read: {reason(error)}",
        where=str(path),
        allowed="the file as it was published",
        remedy="copy it there, or fetch the data set again",
    )


def differing_files(folder: Path, published: Mapping[str, str]) -> tuple[Differing, ...]:
    """Return the files, which are all there, whose SHA-256 is not the published one.

    Raises:
        RawDataError: when one is no file that can be read.
    """
    found = {name: _sha256_of(folder, name) for name in published}
    return tuple(
        Differing(str(folder / name), found[name], expected)
        for name, expected in published.items()
        if found[name] != expected
    )


def _refusal_of(
    differing: tuple[Differing, ...], published: Published, remedy: str
) -> RawDataError:
    """Return the refusal of files that are not those of a version, with both checksums of each."""
    first, *others = differing
    also = "".join(f"; so does {file.place} (SHA-256 {file.found})" for file in others)
    sums = ", ".join(file.published for file in differing)
    value = f"SHA-256 {first.found}{also}"
    return RawDataError(
        "the checksum differs from that of the published file",
        where=first.place,
        value=value,
        allowed=f"SHA-256 {sums} (version {published.version})",
        remedy=remedy,
    )


# The files of a public data set, fetched from where they are published, or from a copy.

#: Longest wait for an answer [s].
TIMEOUT_S = 60.0


def fetch(dataset: DataSet, folder: Path, source: str | None = None) -> tuple[str, ...]:
    """Bring all files of a published data set into a folder: the pinned version, or nothing.

    Files that are there already and are the published ones are not fetched again. They are taken
    from a folder or address, or from where they are published. Returns the paths that were fetched.

    Raises:
        RawDataError: when a file cannot be had, or one is not the published one.
        OutputError: when the folder cannot be written to.
    """
    published = dataset.published
    expected = {
        name: checksum
        for name, checksum in published.sha256.items()
        if not is_file(folder / name, folder) or _sha256_of(folder, name) != checksum
    }
    base = published.address
    if source is not None:
        base = source if "://" in source else Path(source).resolve().as_uri()
        base = base if base.endswith("/") else f"{base}/"
    contents = {name: _content(base + quote(name)) for name in expected}
    differing = tuple(
        Differing(base + name, sha256(content), expected[name])
        for name, content in contents.items()
        if sha256(content) != expected[name]
    )
    if differing:
        raise _refusal_of(differing, published, "fetch it again, or from another source")
    with whole_files(*(folder / name for name in expected)) as besides:
        for beside, content in zip(besides, contents.values(), strict=True):
            beside.write_bytes(content)
    return tuple(expected)


def _content(address: str) -> bytes:
    try:
        with urllib.request.urlopen(address, timeout=TIMEOUT_S) as answer:
            content: bytes = answer.read()
    except (OSError, HTTPException, ValueError) as error:
        # The reason, without the name of the function that failed.
        cause = getattr(error, "reason", error)
        reason = str(getattr(cause, "strerror", None) or cause)
        raise RawDataError(
            "the file cannot be fetched",
            where=address.removeprefix("file://"),
            value=reason,
            allowed="an address that can be reached, or a folder with the file",
            remedy="check the connection, or name a copy of the data set as the source",
        ) from None
    return content


# Imported campaigns as folders under the raw-data contract.

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
    text = csv_text(table.columns, zip(*columns, strict=True))
    return gzip.compress(text.encode(), compresslevel=6, mtime=0)


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
        raise OutputError(
            "the folder of the campaign holds something else",
            where=str(place),
            value=", ".join(foreign) or place.name,
            allowed=f"a new folder, or one with {', '.join(sorted(own))} only",
            remedy="give another folder, or move the files away",
        )


def _write(campaign: ImportedCampaign, folder: Path) -> None:
    readings = campaign.readings
    if isinstance(readings, AsItIs):
        try:
            content = read_file(readings.path, LARGEST_BYTES, readings.folder)
        except OSError as error:
            raise _unread(readings.path, error) from None
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
