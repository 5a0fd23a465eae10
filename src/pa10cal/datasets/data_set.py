"""What a data set is: where its files are published, its reader, and the campaigns it gives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from pa10cal.campaign.description import JointPositions
from pa10cal.campaign.raw_rows import Quarantined
from pa10cal.errors import RawDataError
from pa10cal.yaml_file import read_yaml


@dataclass(frozen=True)
class Published:
    """Where the files of a data set are published, and what they are."""

    version: str  # the pinned version, such as a commit
    address: str  # address that the path of a file is appended to
    sha256: Mapping[str, str]  # checksum of every file that is fetched, by its path
    stated: Mapping[str, Any] = field(default_factory=dict)  # content of `published/<name>.yaml`

    @classmethod
    def of(cls, name: str) -> Published:
        """Read `published/<name>.yaml`.

        The files are those of a commit of a public repository on GitHub. Where the YAML file states
        a folder of the repository, its paths are relative to it.
        """
        path = Path(__file__).parent / "published" / f"{name}.yaml"
        stated = read_yaml(path, RawDataError, what="what is stated of the data set is unreadable")
        commit = stated["commit"]
        address = f"https://raw.githubusercontent.com/{stated['repository']}/{commit}/"
        sums = {_in_repository(file, stated): sum for file, sum in stated["sha256"].items()}
        return cls(commit, address, sums, stated)

    def path(self, file: str) -> str:
        """Return the path inside the data set's folder of a file that the YAML file names."""
        return _in_repository(file, self.stated)

    def provenance_text(self, **more: object) -> str:
        """Return the stated provenance, its placeholders filled from the YAML file and `more`."""
        text: str = self.stated["provenance"]
        return text.format(**{**self.stated, **more})

    @property
    def terms(self) -> str:
        """Return a sentence on the licence of the files."""
        repository = self.stated["repository"]
        if "licence" in self.stated:
            return f"{repository}: {self.stated['licence']}."
        return (
            f"{repository}: no licence is stated by the owner. The files are fetched from the "
            "owner for you alone; ask the owner before you pass them on."
        )


@dataclass(frozen=True)
class AsItIs:
    """A file of readings that goes into the campaign unchanged; `ingest` reads its own columns."""

    path: Path
    columns: Mapping[str, Any]  # `columns.poses` of campaign.yaml
    folder: Path  # folder of the data set, in which the file must lie


@dataclass(frozen=True)
class ImportedCampaign:
    """One campaign of a data set, as docs/raw-data.md specifies it.

    A table of readings without `time_s` says that no time was recorded: its rows are in the order
    of the file, and poses of equal joint positions are repeats.
    """

    name: str  # name of the campaign and of its folder
    robot: str  # name of the arm description
    provenance: str  # whose measurements these are, and how they were changed
    instrument: str  # kind of the instrument
    uncertainty_mm: float  # standard uncertainty of one measured place, per axis
    readings: AsItIs | pd.DataFrame  # an unchanged file, or the table to write as `files.poses`
    files: tuple[str, ...]  # paths of the files read, inside the data set's folder
    reference_temperature_C: float = 20.0  # lengths are nominal at it; assumed where not stated
    # which poses are held out, as `holdout` of campaign.yaml
    holdout: Mapping[str, float] = field(default_factory=lambda: {"every": 5})
    left_out: tuple[Quarantined, ...] = ()  # rows omitted
    notes: tuple[str, ...] = ()  # what the reader should know, one clause each
    joints: JointPositions = "logged"  # whether joint positions are `logged` or `commanded`
    arm: Path | None = None  # description of an arm that is not a shipped one
    tool_mass_kg: float = 0.0  # mass on the flange; 0 where it is not known


@dataclass(frozen=True)
class DataSet:
    """A data set that can be imported."""

    name: str  # what it is called on the command line
    # reads a folder that has all `files`; omits at most the given fraction of a file's rows, or
    # raises RawDataError
    read: Callable[[Path, float], tuple[ImportedCampaign, ...]]
    published: Published  # where it is published, and the files that are fetched
    unread: tuple[str, ...] = ()  # paths of files that are fetched and not read, such as a licence

    @property
    def files(self) -> tuple[str, ...]:
        """Return the paths inside its folder that are read."""
        return tuple(path for path in self.published.sha256 if path not in self.unread)


def _in_repository(file: str, stated: Mapping[str, Any]) -> str:
    return f"{stated['folder']}/{file}" if "folder" in stated else file
