"""The raw files of a campaign in memory, with the operations of disturbances on them."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.errors import SettingsError

_OfPoses = Literal["loads", "masses", "springs", "repeats", "held_out"]
_OfInstrument = Literal["touches", "tracker", "attitude", "targets", "stated_targets"]
#: What a campaign must have for a disturbance to have an effect.
Need = _OfPoses | _OfInstrument
Indices = NDArray[np.int64]

_CONFIGURATION = ["kind", "pose", "load_N", "repeat"]
QUATERNION = ["qw", "qx", "qy", "qz"]


@dataclass
class RawLog:
    """Description and raw tables of a campaign; disturbances change them in place."""

    description: dict[str, Any]  # content of campaign.yaml
    tables: dict[str, pd.DataFrame]  # raw tables by their key under `files`
    arm: Arm  # the arm that the campaign names; one that is not shipped is described in the folder

    @classmethod
    def of(
        cls, description: Mapping[str, Any], tables: Mapping[str, pd.DataFrame], arm: Arm
    ) -> RawLog:
        """Return a copy of a description and its tables."""
        copied = {key: table.copy() for key, table in tables.items()}
        return cls(copy.deepcopy(dict(description)), copied, arm)

    @property
    def kind(self) -> str:
        """Return the kind of the instrument."""
        return str(self.description["instrument"]["kind"])

    @property
    def touched(self) -> bool:
        """Return whether readings and joints are in two logs."""
        return "cmm" in self.tables

    @property
    def readings(self) -> pd.DataFrame:
        """Return the table of the instrument's readings."""
        return self.tables["cmm" if self.touched else "poses"]

    @property
    def joints(self) -> pd.DataFrame:
        """Return the table of the joints."""
        return self.tables["resolver" if self.touched else "poses"]

    @property
    def configuration(self) -> Indices:
        """Return the number of the configuration, from 0, of each row of the readings."""
        if not self.touched:
            return np.arange(len(self.readings)).astype(np.int64)
        groups = self.readings.groupby(_CONFIGURATION, sort=False)
        return np.asarray(groups.ngroup(), dtype=np.int64)

    @property
    def configurations(self) -> pd.DataFrame:
        """Return kind, pose, load, repeat and time of each configuration, in order of time.

        Without a column for it the kind is `grid`, and the time the number of the first row.
        """
        first = np.unique(self.configuration, return_index=True)[1]
        table = self.readings.iloc[first].reset_index(drop=True)
        if "kind" not in table:
            table["kind"] = "grid"
        if "time_s" not in table:
            table["time_s"] = first
        return table[[*_CONFIGURATION, "time_s"]]

    def has(self, need: Need) -> bool:
        """Return whether the campaign has what a disturbance needs; springs show in no log."""
        if need in ("touches", "tracker"):
            return self.touched == (need == "touches")
        if need == "loads":
            return bool(np.ptp(self.readings["load_N"]) > 0.0)
        if need == "repeats":
            return bool((self.readings["repeat"] > 1).any())
        if need == "held_out":
            return len(self.of_kind("holdout")) > 0
        if need == "attitude":
            return QUATERNION[0] in self.readings
        if need == "targets":
            return self.touched or len(self.points) > 1
        if need == "stated_targets":
            return len(self.description["tool"].get("balls_mm", ())) > 1
        return need == "springs" or self.arm.mass_kg is not None

    def angle_column(self, joint: int) -> str:
        """Return the column of a joint's angle, of a joint from 1.

        Raises:
            SettingsError: when the log has no angle of it.
        """
        column = f"q{joint}_deg"
        if column not in self.joints:
            known = (str(name) for name in self.joints if str(name).endswith("_deg"))
            raise SettingsError(
                "the log has no angle of this joint",
                where="disturbances: joint",
                value=joint,
                allowed=", ".join(known),
                remedy="name a joint that turns",
            )
        return column

    def of_kind(self, kind: str) -> Indices:
        """Return the numbers of the configurations of a kind."""
        kinds = self.configurations["kind"].to_numpy()
        return np.flatnonzero(kinds == kind).astype(np.int64)

    @property
    def points(self) -> list[list[str]]:
        """Return the columns of each point: three coordinates, or one distance."""
        if self.kind == "distance":
            return [["d_mm"]]
        ends = [name for name in map(str, self.readings) if name.endswith("x_mm")]
        return [[f"{end[:-4]}{axis}_mm" for axis in "xyz"] for end in ends if end[:2] != "u_"]

    @property
    def uncertainties(self) -> list[str]:
        """Return the columns of stated uncertainties."""
        return [str(name) for name in self.readings if str(name).startswith("u_")]

    def move(self, shift_mm: Array, *, base: bool = True) -> None:
        """Shift the readings of each configuration by (C, 3), along the instrument's axes.

        A distance is changed by the first component.

        Args:
            base: whether readings of targets on the base are shifted too.
        """
        of_rows = shift_mm[self.configuration]
        for columns in self.points:
            if base or not columns[0].startswith("base"):
                self.readings[columns] = self.readings[columns] + of_rows[:, : len(columns)]

    def turn(self, turn_rad: Array) -> None:
        """Rotate the positions of each configuration by (C, 3) about the instrument's origin."""
        of_rows = turn_rad[self.configuration]
        for columns in self.points:
            p_mm = self.readings[columns].to_numpy(dtype=float)
            self.readings[columns] = p_mm + np.cross(of_rows, p_mm)

    def label(self, configuration: int) -> str:
        """Return the label of a configuration's pose."""
        return str(self.configurations["pose"].iloc[configuration])
