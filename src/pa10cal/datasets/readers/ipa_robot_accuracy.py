"""UR10 poses measured by a 6-D laser tracker: the data set ipa-robot-accuracy, series A and C.

The files are read as they are: `columns` of campaign.yaml says what is in them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pa10cal.datasets.importing import AsItIs, DataSet, ImportedCampaign, Published

SERIES = {
    "ur10-a": "Series_A/measurements_grid.csv",
    "ur10-c": "Series_C/measurements_random_poses.csv",
}
LICENCE = "LICENSE.md"
PUBLISHED = Published.on_github(
    "christianlandgraf/ipa-robot-accuracy",
    "507fba69bdaf6c43c2faf306e70a7e37c5e39b89",
    f"""
2597e491177bda28228ec1e6d1966b58e01d21a2891c524e781289b32f629e3a  LICENSE.md
84d5c81234cab58ebe88b4c73c582c26ad0e407f0de5350571c91f5ce6f28b76  {SERIES["ur10-a"]}
904a1d195e558315bd21469abb02bfcc000dd1296c0cd68eb86c62e95f7ba160  {SERIES["ur10-c"]}
    """,
    licence="MIT licence",
)
COLUMNS: dict[str, Any] = {
    "separator": ";",
    "decimal": ",",
    "joints": {
        "names": [
            *("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"),
            *("wrist_1_joint", "wrist_2_joint", "wrist_3_joint"),
        ],
        "unit": "rad",
    },
    "temperature": {"names": "measurement_temperature"},
    "position": {"names": [f"measurement_{axis}" for axis in "xyz"], "unit": "mm"},
    "rotation": {
        "names": [f"measurement_r{axis}" for axis in "xyz"],
        "convention": "euler_XYZ",
        "unit": "deg",
    },
}
TIME = {"names": "Timestamp", "format": "%Y%m%d%H%M%S"}
PLACE_STD = [f"measurement_std_{axis}" for axis in "xyz"]
ATTITUDE_STD = [f"measurement_std_r{axis}" for axis in "xyz"]
#: Where no deviations are given. Neighbouring commands of series A, less than 5e-4 rad apart in
#: every joint, scatter by this per axis once the nominal arm's motion between them is taken off;
#: what the arm itself does not repeat is in it.
UNSTATED_MM = 0.02
#: Root mean square of the deviations of series C per axis, and mean temperatures of both.
STATED_MM = 0.0129
MEAN_C = {"ur10-a": 23.209, "ur10-c": 21.964}
HELD_OUT = {"last_fraction": 0.3}

_OF_ALL = (
    "Real measurements of a UR10 with a laser tracker and its T-Mac, not simulated: {file} of the "
    "data set ipa-robot-accuracy (repository {repository}, commit "
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
    """Return both series; see `DataSet.read`. Rows that cannot be used are found when they are."""
    del max_left_out
    return _series_a(folder), _series_c(folder)


def _series_a(folder: Path) -> ImportedCampaign:
    told, columns = f"{_OF_ALL} {_CLOCK} {_UNSTATED}", {"time": TIME, **COLUMNS}
    return _campaign(folder, "ur10-a", told, UNSTATED_MM, columns)


def _series_c(folder: Path) -> ImportedCampaign:
    stated = {key: dict(COLUMNS[key]) for key in ("position", "rotation")}
    stated["position"]["u"], stated["rotation"]["u"] = PLACE_STD, ATTITUDE_STD
    told, columns = f"{_OF_ALL} {_NO_CLOCK} {_STATED}", COLUMNS | stated
    return _campaign(folder, "ur10-c", told, STATED_MM, columns)


def _campaign(
    folder: Path, name: str, provenance: str, uncertainty_mm: float, columns: dict[str, Any]
) -> ImportedCampaign:
    return ImportedCampaign(
        name=name,
        robot="ur10",
        provenance=PUBLISHED.told(provenance, file=SERIES[name]),
        instrument="pose",
        uncertainty_mm=uncertainty_mm,
        reference_temperature_C=MEAN_C[name],
        holdout=HELD_OUT,
        readings=AsItIs(folder / SERIES[name], columns),
        files=(SERIES[name],),
        joints="commanded",
    )


DATASET = DataSet("ipa-robot-accuracy", read, PUBLISHED, unread=(LICENCE,))
