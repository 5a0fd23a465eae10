"""UR10 poses measured by a 6-D laser tracker: the data set ipa-robot-accuracy, series A and C."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.datasets.commands import command_columns
from pa10cal.datasets.dataset import DataSet, ImportedCampaign, Published
from pa10cal.datasets.text_table import TextTable, read_headed_table
from pa10cal.errors import RawDataError

Array = NDArray[np.float64]

COMMIT = "507fba69bdaf6c43c2faf306e70a7e37c5e39b89"
SERIES = {
    "ur10-a": "Series_A/measurements_grid.csv",
    "ur10-c": "Series_C/measurements_random_poses.csv",
}
JOINTS = (
    *("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"),
    *("wrist_1_joint", "wrist_2_joint", "wrist_3_joint"),
)
PLACE = tuple(f"measurement_{axis}" for axis in "xyz")
ATTITUDE = tuple(f"measurement_r{axis}" for axis in "xyz")
PLACE_STD = tuple(f"measurement_std_{axis}" for axis in "xyz")
ATTITUDE_STD = tuple(f"measurement_std_r{axis}" for axis in "xyz")
REQUIRED = ("Timestamp", *JOINTS, "measurement_temperature", *PLACE, *ATTITUDE)

#: A joint of this arm makes one turn either way.
LARGEST_RAD = 2.0 * np.pi + 0.01
#: Where no deviations are given. Neighbouring commands of series A, less than 5e-4 rad apart in
#: every joint, scatter by this per axis once the nominal arm's motion between them is taken off;
#: what the arm itself does not repeat is in it.
UNSTATED_MM = 0.02
HELD_OUT = 0.3

_OF_ALL = (
    "Real measurements of a UR10 with a laser tracker and its T-Mac, not simulated: {file} of the "
    "data set ipa-robot-accuracy (repository christianlandgraf/ipa-robot-accuracy, commit "
    "{commit}, MIT licence; C. Landgraf et al., A Hybrid Neural Network Approach for Increasing "
    "the Absolute Accuracy of Industrial Robots, IEEE CASE 2021). Joint angles are the commanded "
    "ones, not read back. x, y, z and the quaternion are the T-Mac's own pose in the tracker's "
    "frame as measured; where it sits on the flange is not known (the rough guess of "
    "Trafo_TM_F_init.txt is not applied). No load. Mass and centre of mass of the T-Mac are not "
    "stated, hence 0. Gravity is that of an upright arm, which is not stated either. Reference "
    "temperature: mean of the file."
)
_CLOCK = "time_s counts from the first time stamp."
_NO_CLOCK = "Its time stamps are rounded to one value, so time_s is the number of the row."
_STATED = (
    "u_ columns are the standard deviations that the file gives of the readings averaged at each "
    "pose, not divided by the root of their number, which it does not give: what the data say, "
    "without what changes from pose to pose. uncertainty_mm is their root mean square per axis."
)
_UNSTATED = (
    "No uncertainties are given: uncertainty_mm is what readings of nearly equal commands differ "
    "by, per axis, the arm's own repeatability included."
)


def read(folder: Path, max_left_out: float) -> tuple[ImportedCampaign, ...]:
    """Read both series; see `DataSet.read`."""
    return tuple(_series(folder, name, file, max_left_out) for name, file in SERIES.items())


def _series(folder: Path, name: str, file: str, max_left_out: float) -> ImportedCampaign:
    stated = (*PLACE_STD, *ATTITUDE_STD)
    table = read_headed_table(folder, file, REQUIRED, stated, separator=";", decimal=",")
    table = _with_joints_in_range(table, folder / file)
    table, time_s = _in_time(table)
    table.refuse_too_many(max_left_out)
    numbered = np.arange(len(table), dtype=float)
    poses = command_columns(numbered if time_s is None else time_s, table.numbers(JOINTS))
    poses["temperature_C"] = table.columns["measurement_temperature"]
    poses[["x_mm", "y_mm", "z_mm"]] = table.numbers(PLACE)
    angles_deg = table.numbers(ATTITUDE)
    rotation = Rotation.from_euler("XYZ", angles_deg, degrees=True)
    poses[["qw", "qx", "qy", "qz"]] = rotation.as_quat(canonical=True, scalar_first=True)
    told = [_OF_ALL.format(file=file, commit=COMMIT), _NO_CLOCK if time_s is None else _CLOCK]
    if has_stated := set(stated) <= set(table.columns):
        u_mm = _above_zero(table.numbers(PLACE_STD))
        poses[["u_x_mm", "u_y_mm", "u_z_mm"]] = u_mm
        u = _quaternion_uncertainty(angles_deg, _above_zero(table.numbers(ATTITUDE_STD)))
        poses[["u_qw", "u_qx", "u_qy", "u_qz"]] = u
    repeats = int((poses["repeat"] > 1).sum())
    return ImportedCampaign(
        name=name,
        robot="ur10",
        provenance=" ".join([*told, _STATED if has_stated else _UNSTATED]),
        instrument="pose",
        uncertainty_mm=round(float(np.sqrt(np.nanmean(u_mm**2))), 4) if has_stated else UNSTATED_MM,
        reference_temperature_C=round(float(poses["temperature_C"].mean()), 3),
        held_out_fraction=HELD_OUT,
        poses=poses,
        files=(file,),
        left_out=table.left_out,
        notes=(f"{len(poses)} readings, {repeats} of them repeats",),
    )


def _with_joints_in_range(table: TextTable, path: Path) -> TextTable:
    """Leave out rows whose joints no command can have; refuse angles in degrees."""
    largest = np.abs(table.numbers(JOINTS)).max(axis=1)
    good = largest <= LARGEST_RAD
    if 2 * good.sum() < len(good):
        first = int(np.argmin(good))
        raise RawDataError(
            "the joint angles look like degrees",
            where=f"{path}:{table.line[first]}",
            value=float(largest[first]),
            allowed=f"joint angles in radians, none beyond {LARGEST_RAD:.2f}",
            remedy="take the file as it was published",
        )
    values = [f"{angle:g} rad" for angle in largest[~good]]
    return table.keep(good, "a joint angle beyond one turn", values)


def _in_time(table: TextTable) -> tuple[TextTable, Array | None]:
    """Return the rows in order of time and their times [s] from the first; None without a clock.

    A row that alone has no time stamp is omitted.
    """
    stamps = [f"{stamp:.0f}" for stamp in table.columns["Timestamp"]]
    moments = pd.to_datetime(pd.Series(stamps), format="%Y%m%d%H%M%S", errors="coerce")
    known = moments.notna().to_numpy()
    if not known.any():
        return table, None
    unknown = [stamp for stamp, good in zip(stamps, known, strict=True) if not good]
    table, moments = table.keep(known, "the time stamp is no time", unknown), moments[known]
    order = np.argsort(moments.to_numpy(), kind="stable")
    seconds = np.asarray((moments - moments.min()).dt.total_seconds(), dtype=np.float64)
    return table.take(order), seconds[order]


def _above_zero(u: Array) -> Array:
    """Return deviations, nan for 0: readings that do not scatter at all say nothing of theirs."""
    return np.where(u > 0.0, u, np.nan)


def _quaternion_uncertainty(angles_deg: Array, u_deg: Array) -> Array:
    """Return the standard uncertainty of each component w, x, y, z (N, 4).

    Each angle turns about its own axis, by independent errors: dq = (0, axis) q dangle / 2.
    """
    about_x = Rotation.from_euler("x", angles_deg[:, :1], degrees=True)
    rotation = Rotation.from_euler("XYZ", angles_deg, degrees=True)
    axis_x = np.tile([1.0, 0.0, 0.0], (len(angles_deg), 1))
    axes = np.stack([axis_x, about_x.apply([0.0, 1.0, 0.0]), rotation.apply([0.0, 0.0, 1.0])], 1)
    quaternion = rotation.as_quat(scalar_first=True)
    scalar, vector = quaternion[:, None, :1], quaternion[:, None, 1:]
    by_scalar = -(axes * vector).sum(axis=2, keepdims=True)
    by_vector = scalar * axes + np.cross(axes, vector)
    derivative = 0.5 * np.concatenate([by_scalar, by_vector], axis=2)  # (N, angle, component)
    u: Array = np.sqrt(((derivative * np.radians(u_deg)[:, :, None]) ** 2).sum(axis=1))
    return u


DATASET = DataSet(
    name="ipa-robot-accuracy",
    title="UR10 with a 6-D laser tracker, series A and C (real measurements)",
    files=tuple(SERIES.values()),
    read=read,
    published=Published(
        version=COMMIT,
        address=f"https://raw.githubusercontent.com/christianlandgraf/ipa-robot-accuracy/{COMMIT}/",
        sha256={
            "LICENSE.md": "2597e491177bda28228ec1e6d1966b58e01d21a2891c524e781289b32f629e3a",
            SERIES["ur10-a"]: "84d5c81234cab58ebe88b4c73c582c26ad0e407f0de5350571c91f5ce6f28b76",
            SERIES["ur10-c"]: "904a1d195e558315bd21469abb02bfcc000dd1296c0cd68eb86c62e95f7ba160",
        },
    ),
)
