"""What a reader of a data set defines, and what it gives: campaigns not yet written."""

from __future__ import annotations

import difflib
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.campaign.description import JointPositions
from pa10cal.campaign.raw_rows import Quarantined
from pa10cal.datasets import readers
from pa10cal.errors import RawDataError


@dataclass(frozen=True)
class Published:
    """Where the files of a data set are published, and what they are."""

    version: str  # the version meant, such as a commit
    address: str  # what stands in front of a file's path
    sha256: Mapping[str, str]  # checksum of every file that is fetched, by its path
    repository: str = ""  # the owner's, as `owner/name`
    licence: str | None = None  # that which the owner states; None where none is

    @classmethod
    def on_github(
        cls, repository: str, commit: str, sha256: Mapping[str, str], licence: str | None = None
    ) -> Published:
        """Return files of a commit of a public repository."""
        address = f"https://raw.githubusercontent.com/{repository}/{commit}/"
        return cls(commit, address, sha256, repository, licence)

    @property
    def terms(self) -> str:
        """Return under which licence the files are, in a sentence."""
        if self.licence is not None:
            return f"{self.repository}: {self.licence}."
        return (
            f"{self.repository}: no licence is stated by the owner. The files are fetched from the "
            "owner for you alone; ask the owner before you pass them on."
        )


@dataclass(frozen=True)
class AsItIs:
    """A file that is read as it is."""

    path: Path  # where it is
    columns: Mapping[str, Any]  # `columns.poses` of campaign.yaml


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
    reference_temperature_C: float  # temperature at which lengths are nominal
    holdout: Mapping[str, float]  # which poses are held out, as campaign.yaml has it
    readings: AsItIs | pd.DataFrame  # a file that is read as it is; or columns of `files.poses`
    files: tuple[str, ...]  # paths of the files read, inside the data set's folder
    left_out: tuple[Quarantined, ...] = ()  # rows omitted
    notes: tuple[str, ...] = ()  # what the reader should know, one clause each
    joints: JointPositions = "logged"  # whether joint positions are `logged`, or those `commanded`
    arm: Path | None = None  # description of the arm where it is not a shipped one; its path
    tool_mass_kg: float = 0.0  # what the flange carries; 0 where it is not known

    @property
    def poses(self) -> pd.DataFrame:
        """Return the columns of `files.poses` of a campaign that is not read as it is."""
        assert isinstance(self.readings, pd.DataFrame)
        return self.readings


#: Descriptions of arms that are measured in data sets and are not shipped as arms of their own.
ARMS = Path(__file__).with_name("arms")


def rotation_columns(R_instr_target: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return attitudes (N, 3, 3) as the columns qw to qz, qw not negative."""
    quaternions = Rotation.from_matrix(R_instr_target).as_quat(canonical=True, scalar_first=True)
    return dict(zip(("qw", "qx", "qy", "qz"), quaternions.T, strict=True))


@dataclass(frozen=True)
class DataSet:
    """A data set that can be imported."""

    name: str  # what it is called on the command line
    title: str  # one line for the reader
    files: tuple[str, ...]  # paths inside its folder that are read
    # reads that folder, in which all `files` are; leaves out at most the given part of a file's
    # rows, or raises RawDataError
    read: Callable[[Path, float], tuple[ImportedCampaign, ...]]
    published: Published | None = None  # where it is published; None for a layout without one place


# The data sets that can be imported, found by looking through the folder of readers.


def dataset_names() -> tuple[str, ...]:
    """Return the names of all data sets: those of the readers' modules, with hyphens."""
    modules = pkgutil.iter_modules(readers.__path__)
    return tuple(sorted(module.name.replace("_", "-") for module in modules))


def dataset_named(name: str) -> DataSet:
    """Return the data set of that name.

    Raises:
        RawDataError: when there is none, naming those that there are.
    """
    known = dataset_names()
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
        raise RawDataError(
            "there is no reader of this data set",
            where="data set",
            value=name,
            allowed=", ".join(known),
            remedy=f"is {near[0]!r} meant?"
            if near
            else "correct the name, or write a reader in "
            "pa10cal/datasets/readers (docs/datasets.md)",
        )
    module = import_module(f"{readers.__name__}.{name.replace('-', '_')}")
    dataset: DataSet = module.DATASET
    return dataset
