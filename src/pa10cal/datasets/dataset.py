"""What a reader of a data set defines, and what it gives: campaigns not yet written."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from pa10cal.campaign.description import JointPositions
from pa10cal.campaign.quarantine import Quarantined


@dataclass(frozen=True)
class Published:
    """Where the files of a data set are published, and what they are.

    Attributes:
        version: the version meant, such as a commit.
        address: what stands in front of a file's path.
        sha256: checksum of every file that is fetched, by its path.
    """

    version: str
    address: str
    sha256: Mapping[str, str]


@dataclass(frozen=True)
class AsItIs:
    """A file that is read as it is.

    Attributes:
        path: where it is.
        columns: `columns.poses` of campaign.yaml.
    """

    path: Path
    columns: Mapping[str, Any]


@dataclass(frozen=True)
class ImportedCampaign:
    """One campaign of a data set, as docs/raw-data.md specifies it.

    Attributes:
        name: name of the campaign and of its folder.
        robot: name of the arm description.
        provenance: whose measurements these are, and what was done with them.
        instrument: kind of the instrument.
        uncertainty_mm: standard uncertainty of one measured place, per axis.
        reference_temperature_C: temperature at which lengths are nominal.
        held_out_fraction: part of the poses, the last in time, that is held out.
        readings: a file that is read as it is; or columns of `files.poses`, rows in order of time.
        files: paths of the files read, inside the data set's folder.
        left_out: rows omitted.
        notes: what the reader should know, one clause each.
        joints: whether joint positions are `logged`, or those `commanded`.
    """

    name: str
    robot: str
    provenance: str
    instrument: str
    uncertainty_mm: float
    reference_temperature_C: float
    held_out_fraction: float
    readings: AsItIs | pd.DataFrame
    files: tuple[str, ...]
    left_out: tuple[Quarantined, ...] = ()
    notes: tuple[str, ...] = ()
    joints: JointPositions = "logged"

    @property
    def poses(self) -> pd.DataFrame:
        """Return the columns of `files.poses` of a campaign that is not read as it is."""
        assert isinstance(self.readings, pd.DataFrame)
        return self.readings


@dataclass(frozen=True)
class DataSet:
    """A data set that can be imported.

    Attributes:
        name: what it is called on the command line.
        title: one line for the reader.
        files: paths inside its folder that are read.
        read: reads that folder, in which all `files` are; leaves out at most the given part of a
            file's rows, or raises RawDataError.
        published: where it is published; None for a layout without one place.
    """

    name: str
    title: str
    files: tuple[str, ...]
    read: Callable[[Path, float], tuple[ImportedCampaign, ...]]
    published: Published | None = None
