"""KUKA LBR iiwa 7 under an optical tracker, torques logged: the data set robot-calibration.

Each table has a header, then the number of the row, seven joint angles [rad], seven torques [N m]
as the controller logs them, and the pose of the target as sixteen numbers, row by row [mm]. The
controller logs the load on a joint; the torque that the motor exerts is its negative.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from pa10cal.campaign.own_columns import refuse_too_many
from pa10cal.datasets.importing import ARMS, DataSet, ImportedCampaign, Published, rotation_columns
from pa10cal.datasets.text_table import read_bare_table

PUBLISHED = Published.on_github(
    "Zhangzhongqiu/robot-calibration",
    "be44742b3b312bde09d87d9d40e89d8a634ac83b",
    """
800f9e37b712834456c6959f219c2809da920ad58d456039152efa5f7e506987  20161118_run_1.csv
0160b0f7b92a961cbcd068929e912b83d50ae7e140dd8d961b4f7e1bee21c261  0kg/20161216_run1_0kg.csv
ca0f830e55a4365b25960264a941c84f07b66055fa1fa01865eb369588cfab84  1.25kg/20161216_run2_1.25kg.csv
5337ad463be5226880311f6aa725e37014028b111c7fb092e2f5148a61866dc0  2.5kg/20161216_run3_2.5kg.csv
    """,
)
#: Campaigns in the order of the files, and the payload that the folder of each is named after [kg].
CAMPAIGNS = {"iiwa7-free": 0.0, "iiwa7-0kg": 0.0, "iiwa7-1250g": 1.25, "iiwa7-2500g": 2.5}
JOINTS = range(1, 8)
_Q, _TAU = [f"q{k}_rad" for k in JOINTS], [f"load{k}_Nm" for k in JOINTS]
_T = [f"T{row}{column}" for row in range(4) for column in range(4)]
COLUMNS = ("row", *_Q, *_TAU, *_T)
#: What the tables do not state. In the sweep of joint 7 the target scatters about a circle by this.
ASSUMED_MM = 0.07
_TOLD = (
    "Measured, not simulated: KUKA LBR iiwa 7 R800 under an optical tracker, {file} of the "
    "repository {repository}, commit {commit}, of 2016. Torques as the controller logged them, "
    "with the sign reversed. Payload {kg:g} kg, as the folder is named; the mass of the tooling "
    "is not stated. Not stated, hence assumed: uncertainty_mm {u} (scatter about a circle in the "
    "sweep of joint 7), reference temperature, an upright arm. No time was recorded. No licence "
    "is stated by the owner."
)


def read(folder: Path, max_left_out: float) -> tuple[ImportedCampaign, ...]:
    """Read the four tables; see `DataSet.read`."""
    return tuple(
        _campaign(folder, name, file, CAMPAIGNS[name], max_left_out)
        for name, file in zip(CAMPAIGNS, PUBLISHED.sha256, strict=True)
    )


def _campaign(
    folder: Path, name: str, file: str, payload_kg: float, max_left_out: float
) -> ImportedCampaign:
    table = read_bare_table(folder, file, COLUMNS, separator=",", header=True)
    refuse_too_many(table.quarantined, table.totals, max_left_out)
    T_mm = table.numbers_of(_T).reshape(-1, 4, 4)
    q_deg, tau_Nm = np.degrees(table.numbers_of(_Q)), -table.numbers_of(_TAU)
    columns = {f"q{k}_deg": q_deg[:, k - 1] for k in JOINTS}
    columns |= {f"tau{k}_Nm": tau_Nm[:, k - 1] for k in JOINTS}
    columns |= {f"{axis}_mm": T_mm[:, k, 3] for k, axis in enumerate("xyz")}
    return ImportedCampaign(
        name=name,
        robot="iiwa7",
        provenance=PUBLISHED.told(_TOLD, file=file, kg=payload_kg, u=ASSUMED_MM),
        instrument="pose",
        uncertainty_mm=ASSUMED_MM,
        readings=pd.DataFrame(columns | rotation_columns(T_mm[:, :3, :3])),
        files=(file,),
        left_out=table.quarantined,
        notes=(f"{len(table)} configurations",),
        arm=ARMS / "iiwa7.yaml",
        tool_mass_kg=payload_kg,
    )


DATASET = DataSet("iiwa7-robot-calibration", read, PUBLISHED)
