"""Yaskawa Motoman MA2010 under OptiTrack: the data set Welding_Motoman, its folder mocap/.

Two tables a date, without headers, which belong together line by line: six joint angles [rad], and
the pose of a rigid body on the torch, x, y, z [mm] and a quaternion, w first.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from pa10cal.datasets.importing import ARMS, DataSet, ImportedCampaign, Published
from pa10cal.datasets.text_table import read_bare_table, same_rows

_FOLDER = "mocap/kinematic_raw_data"
PUBLISHED = Published.on_github(
    "hehonglu123/Welding_Motoman",
    "eba6d1acf8639dc16a0ecca7b00adf610f42d59e",
    """
6e60f04cd904662f881e8a87bf15940637e4a62646fb145518fd5bff619320df  test0516_R1/robot_q_align.csv
8d7d0fb6674b7f3fd747796934e82904ab8de46248070b67fa76b47a4cce303a  test0516_R1/mocap_T_align.csv
bf19aa9c70d7e3f1b10ca0a9ede5fd75e3e8cb2b527d86451f22542938358361  test0801_R1/robot_q_align.csv
27fff3a7fbf00dca43dca977ae7f83b9440ae61ad22779a922ee0d36a7fde94b  test0801_R1/mocap_T_align.csv
    """,
    folder=f"{_FOLDER}/",
)
CAMPAIGNS = {"ma2010-0516": "test0516_R1", "ma2010-0801": "test0801_R1"}
JOINTS = tuple(f"q{k}_rad" for k in range(1, 7))
PLACE, QUATERNION = ("x_mm", "y_mm", "z_mm"), ("qw", "qx", "qy", "qz")
#: What the tables do not state.
ASSUMED_MM = 0.1
_TOLD = (
    "Measured, not simulated: Yaskawa Motoman MA2010 with a rigid body on its torch under "
    "OptiTrack, {date} of the repository {repository}, commit {commit}, of 2023. Joint positions "
    "as read back. Not stated, hence assumed: uncertainty_mm {u}, reference temperature, an "
    "upright arm, mass 0 for a tool not described. No time was recorded. No licence is stated by "
    "the owner."
)


def read(folder: Path, max_left_out: float) -> tuple[ImportedCampaign, ...]:
    """Read the tables of both dates; see `DataSet.read`."""
    return tuple(_campaign(folder, name, date, max_left_out) for name, date in CAMPAIGNS.items())


def _campaign(folder: Path, name: str, date: str, max_left_out: float) -> ImportedCampaign:
    files = (f"{_FOLDER}/{date}/robot_q_align.csv", f"{_FOLDER}/{date}/mocap_T_align.csv")
    tables = [
        read_bare_table(folder, files[0], JOINTS, separator=","),
        read_bare_table(folder, files[1], (*PLACE, *QUATERNION), separator=","),
    ]
    joints, poses = same_rows(tables, max_left_out)
    wxyz = poses.numbers_of(QUATERNION)
    length = np.linalg.norm(wxyz, axis=1)
    wxyz = wxyz / np.where(wxyz[:, :1] < 0.0, -length[:, None], length[:, None])
    q_deg = np.degrees(joints.numbers_of(JOINTS))
    columns = {f"q{k}_deg": q_deg[:, k - 1] for k in range(1, len(JOINTS) + 1)}
    columns |= {place: poses.columns[place] for place in PLACE}
    columns |= dict(zip(QUATERNION, wxyz.T, strict=True))
    return ImportedCampaign(
        name=name,
        robot="ma2010",
        provenance=PUBLISHED.told(_TOLD, date=date, u=ASSUMED_MM),
        instrument="pose",
        uncertainty_mm=ASSUMED_MM,
        readings=pd.DataFrame(columns),
        files=files,
        left_out=tuple(row for table in tables for row in table.quarantined),
        notes=(f"{len(joints)} configurations",),
        arm=ARMS / "ma2010.yaml",
    )


DATASET = DataSet("welding-motoman", read, PUBLISHED)
