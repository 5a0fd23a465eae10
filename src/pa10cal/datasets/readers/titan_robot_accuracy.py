"""KUKA KR 1000 titan, three points on its end-effector: the data set robot_accuracy.

Two tables with a header: the axes A1 to A6 as the controller counts them [deg], the place E of a
linear axis [mm], three points as measured [mm] (xa1 …) and as the owner's own model has them
(xn1 …). The arm's description turns the axes 1, 4 and 6 the other way.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from pa10cal.campaign.own_columns import refuse_too_many
from pa10cal.campaign.raw_rows import RawRows
from pa10cal.datasets.importing import ARMS, DataSet, ImportedCampaign, Published
from pa10cal.datasets.text_table import read_bare_table

PUBLISHED = Published.on_github(
    "BotScutters/robot_accuracy",
    "26417a4f4c04632c2ce2c63d246af9ec3fca96dc",
    """
d0af11fde4f1e8e4763e82b0e7f0a94398e090e095d1b33b8c314a32e3df9bde  robodata.csv
f1d606a2dd1f1ea000b0548fa1e155a04efa718918dbac213fcace3d0e7a11bc  robodata2.csv
    """,
)
#: Campaigns by their file, and the arm of each.
CAMPAIGNS = {
    "titan-fixed": ("robodata.csv", "titan"),
    "titan-rail": ("robodata2.csv", "titan_rail"),
}
AXES = tuple(f"A{k}" for k in range(1, 7))
SIGNS = np.array([-1.0, 1.0, 1.0, -1.0, 1.0, -1.0])
POINTS = (1, 2, 3)


def _places(letter: str) -> tuple[str, ...]:
    return tuple(f"{axis}{letter}{k}" for k in POINTS for axis in "xyz")


_DIFFERENCES = tuple(f"{name}{k}" for k in POINTS for name in ("dx", "dy", "dz", "err"))
COLUMNS = (*AXES, "E", *_places("a"), *_places("n"), *_DIFFERENCES)
#: What the tables do not state. Distances between the points scatter by 0.012 to 0.026 mm.
ASSUMED_MM = 0.03
_TOLD = (
    "Measured, not simulated: {file} of the repository {repository}, commit {commit}, of 2018. "
    "Axes as commanded; three points on the end-effector. The owner names neither robot nor "
    "instrument: the arm is recognised by its lengths. Not stated, hence assumed: uncertainty_mm "
    "{u} (distances between the points scatter by 0.012 to 0.026 mm), reference temperature, an "
    "upright arm, mass 0 for a tool not described. No time was recorded. The owner's own model, "
    "which is not used here, misses these points by {own:.3f} mm rms. No licence is stated by "
    "the owner."
)


def read(folder: Path, max_left_out: float) -> tuple[ImportedCampaign, ...]:
    """Read both tables; see `DataSet.read`."""
    return tuple(
        _campaign(folder, name, file, robot, max_left_out)
        for name, (file, robot) in CAMPAIGNS.items()
    )


def _campaign(
    folder: Path, name: str, file: str, robot: str, max_left_out: float
) -> ImportedCampaign:
    table = read_bare_table(folder, file, COLUMNS, separator=",", header=True)
    refuse_too_many(table.quarantined, table.totals, max_left_out)
    q_deg = table.numbers_of(AXES) * SIGNS
    columns = {"q1_mm": table.columns["E"]} if robot == "titan_rail" else {}
    first = 1 + len(columns)
    columns |= {f"q{first + k}_deg": q_deg[:, k] for k in range(len(AXES))}
    for k in POINTS:
        columns |= {f"T{k}_{axis}_mm": table.columns[f"{axis}a{k}"] for axis in "xyz"}
    return ImportedCampaign(
        name=name,
        robot=robot,
        provenance=PUBLISHED.told(_TOLD, file=file, u=ASSUMED_MM, own=_owners_error_mm(table)),
        instrument="points",
        uncertainty_mm=ASSUMED_MM,
        readings=pd.DataFrame(columns),
        files=(file,),
        left_out=table.quarantined,
        notes=(f"{len(table)} configurations",),
        joints="commanded",
        arm=ARMS / f"{robot}.yaml",
    )


def _owners_error_mm(table: RawRows) -> float:
    """Return the rms distance between the points as measured and as the owner's model has them."""
    difference_mm = table.numbers_of(_places("n")) - table.numbers_of(_places("a"))
    return float(np.sqrt(np.mean(np.sum(difference_mm.reshape(-1, len(POINTS), 3) ** 2, axis=2))))


DATASET = DataSet("titan-robot-accuracy", read, PUBLISHED)
