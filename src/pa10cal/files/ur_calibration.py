"""Reads the calibration of an arm of Universal Robots, as its controller or driver wrote it.

The controller's file is `calibration.conf` in `.urcontrol`; one of a UR10 stands in the forum of
Universal Robots, "Calibrated kinamatics info" (forum.universal-robots.com/t/18921). The driver's is
`ur_calibration` of UniversalRobots/Universal_Robots_ROS2_Driver.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import FiniteFloat

from pa10cal.arm.chain import placed
from pa10cal.arm.description import Arm
from pa10cal.arm.ur_calibration import (
    COLUMNS,
    LINKS,
    ORIGIN,
    arm_of_ur_origins,
    arm_of_ur_rows,
    ur_layout,
)
from pa10cal.arrays import Array
from pa10cal.errors import ArmError
from pa10cal.files.known_arms import utf8_text
from pa10cal.input_files import read_file, reason
from pa10cal.options import Section
from pa10cal.settings_reading import parse_section
from pa10cal.yaml_file import read_yaml

#: Endings of such files.
ENDINGS = (".conf", ".yaml", ".yml")
_MOST_BYTES = 1024**2
#: What `calibration_status` says, in the words that the controller writes beside it (also in the
#: maker's C header `configuration.h`, struct Calibration). "Linearised" is taken for calibrated: a
#: purpose of the calibration is linearity, says the maker's article "Kinematic Robot Calibration".
_STATUSES = {0: "not initialised", 1: "not linearised", 2: "linearised"}
_CALIBRATED = 2

Six = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]


class _Origin(Section):
    x: FiniteFloat
    y: FiniteFloat
    z: FiniteFloat
    roll: FiniteFloat
    pitch: FiniteFloat
    yaw: FiniteFloat


class _Kinematics(Section):
    shoulder: _Origin
    upper_arm: _Origin
    forearm: _Origin
    wrist_1: _Origin
    wrist_2: _Origin
    wrist_3: _Origin
    hash: str | int = ""


class _OfDriver(Section):
    kinematics: _Kinematics


class _Rows(Section):
    dh_theta: Six
    dh_d: Six
    dh_a: Six
    dh_alpha: Six


@dataclass(frozen=True)
class UrCalibration:
    """What one file states: origins of the joints, or rows as `UrLayout.table`, or their deltas."""

    where: str  # the file
    # exactly one of these three is given
    origins: Array | None = None  # (6, 4, 4) of the joints [m]
    rows: Array | None = None  # (6, 4)
    deltas: Array | None = None  # (6, 4) differences from the rows of the arm as designed
    hash: str = ""  # by which the driver knows it
    notes: tuple[str, ...] = ()  # what the user should know, one sentence each

    def arm(self, name: str, designed: Arm | None) -> Arm:
        """Return the calibrated arm.

        Args:
            name: its name.
            designed: the arm as designed, from which limits, gears and masses are taken; None
                where it is not known. Deltas need it.

        Raises:
            ArmError: when the model is missing, or is another one.
        """
        if self.origins is not None:
            return arm_of_ur_origins(self.origins, name, designed, self.where)
        if self.rows is not None:
            return arm_of_ur_rows(self.rows, name, designed, self.where)
        assert self.deltas is not None
        if designed is None:
            raise ArmError(
                "it holds departures from a model's rows, and no model is named",
                where=self.where,
                allowed="the model's name, such as --robot ur10",
                remedy="name the model with --robot",
            )
        layout = ur_layout(designed)
        # A model of another maker has no such rows, and is refused by `arm_of_ur_rows`.
        rows = self.deltas if layout is None else layout.table + self.deltas
        return arm_of_ur_rows(rows, name, designed, self.where)


def read_ur_calibration(path: Path) -> UrCalibration:
    """Read a calibration: `calibration.conf` of a controller, or the YAML file of the driver.

    Another YAML file may hold the rows themselves, `dh_theta`, `dh_d`, `dh_a`, `dh_alpha`.

    Raises:
        ArmError: when the file cannot be read, or holds no finished calibration.
        SettingsError: when a key of a YAML file is unknown, missing or of the wrong kind; rows and
            `kinematics` do not stand in one file.
    """
    where = str(path)
    if path.suffix.lower() == ".conf":
        try:
            text = utf8_text(read_file(path, _MOST_BYTES))
        except (OSError, ValueError) as error:
            raise _no_calibration(where, f"it cannot be read: {reason(error)}") from None
        return _of_controller(text, where)
    content = read_yaml(path, ArmError, what="the calibration cannot be read")
    if isinstance(content, dict) and "dh_theta" in content:
        stated = parse_section(_Rows, content, where=where)
        rows = [getattr(stated, f"dh_{name}") for name in COLUMNS]
        return UrCalibration(where, rows=np.column_stack(rows))
    if not isinstance(content, dict) or "kinematics" not in content:
        raise _no_calibration(where, "it has no key kinematics")
    kinematics = parse_section(_OfDriver, content, where=where).kinematics
    origins = []
    for link in LINKS:
        values = np.array([getattr(getattr(kinematics, link), key) for key in ORIGIN])
        origins.append(placed(values[:3], values[3:]))
    return UrCalibration(where, origins=np.array(origins), hash=str(kinematics.hash))


def _of_controller(text: str, where: str) -> UrCalibration:
    stated = _keys_of_conf(text, where)
    columns = []
    for name in (f"delta_{column}" for column in COLUMNS):
        if name not in stated:
            raise _no_calibration(where, f"it has no {name}")
        numbers = _numbers_in(stated[name])
        if len(numbers) != 6 or not np.isfinite(numbers).all():
            raise _no_calibration(where, f"{name} is not six numbers")
        columns.append(numbers)
    notes: tuple[str, ...] = ()
    if "calibration_status" in stated:
        _refuse_unfinished(stated["calibration_status"], where)
    else:
        notes = ("It does not state calibration_status: whether the controller uses it is open.",)
    return UrCalibration(where, deltas=np.array(columns).T, notes=notes)


def _keys_of_conf(text: str, where: str) -> dict[str, str]:
    """Return the values of the keys that are read, as they are written; refuse a key twice."""
    read = {"calibration_status", *(f"delta_{name}" for name in COLUMNS)}
    stated: dict[str, str] = {}
    plain = "\n".join(line.partition("#")[0] for line in text.splitlines())
    for key, value in re.findall(r"^[ \t]*(\w+)[ \t]*=[ \t]*(\[[^\]]*\]|.*)", plain, re.MULTILINE):
        if key in stated:
            raise _no_calibration(where, f"{key} stands twice")
        if key in read:
            stated[key] = value.strip()
    return stated


def _numbers_in(value: str) -> list[float]:
    """Return the numbers of a list in brackets; empty where it is none."""
    try:
        return [float(word) for word in value.removeprefix("[").removesuffix("]").split(",")]
    except ValueError:
        return []


def _refuse_unfinished(value: str, where: str) -> None:
    try:
        status = int(value, 0)
    except ValueError:
        raise _no_calibration(
            where, f"its calibration_status is no whole number ({value})"
        ) from None
    if status != _CALIBRATED:
        meaning = _STATUSES.get(status, "unknown")
        raise _no_calibration(where, f"its calibration_status is {status} ({meaning})")


def _no_calibration(where: str, why: str) -> ArmError:
    return ArmError(
        f"no calibration of Universal Robots: {why}",
        where=where,
        allowed="calibration.conf of the controller (delta_theta, delta_a, delta_d, delta_alpha, "
        "calibration_status 2 or none), or the YAML file that ur_calibration writes (kinematics)",
        remedy="give such a file",
    )
