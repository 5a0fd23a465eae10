"""DLR Agile Justin, one marker on each hand under Vicon: the data set dlr-elastic-calibration.

A zipped table with a header: the number of the row, a list of nineteen commanded joint angles [rad]
(torso 3, right arm 7, left arm 7, head 2), and the places of the right and of the left marker [m].
Lists are written as numpy prints them, over several lines.
"""

from __future__ import annotations

import csv
import io
import re
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.campaign.own_columns import refuse_too_many
from pa10cal.campaign.raw_rows import quarantined
from pa10cal.datasets.importing import ARMS, DataSet, ImportedCampaign, Published
from pa10cal.errors import RawDataError

PUBLISHED = Published.on_github(
    "dlr-alr/dlr-elastic-calibration",
    "35149b71639187d0e05f798f679049ff59442756",
    "e56d4d2bceae6283105d643d7e4fa847731323bc84f7fb5eb8bf978d9125dfab dataset/measurements.csv.zip",
)
(FILE,) = PUBLISHED.sha256
TABLE = "measurements.csv"
#: Joints of each arm among the nineteen, and its marker among the two.
SIDES = {"right": (slice(3, 10), 0), "left": (slice(10, 17), 1)}
JOINTS, MARKERS = 19, 6
#: What the table does not state.
ASSUMED_MM = 1.0
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_TOLD = (
    "Measured, not simulated: the humanoid DLR Agile Justin, torso and {side} arm, a marker on "
    "the hand under Vicon, {file} of the repository {repository}, commit {commit} (J. "
    "Tenhumberg, B. Bäuml). Joint angles as commanded; joint 4 has no motor and keeps the chest "
    "upright, q4 = -(q2 + q3). The frame from chest to shoulder is not published and is "
    "estimated from these data. Not stated, hence assumed: uncertainty_mm {u}, reference "
    "temperature, mass 0 for a hand not described. No time was recorded. No licence is stated by "
    "the owner."
)


def read(folder: Path, max_left_out: float) -> tuple[ImportedCampaign, ...]:
    """Read the table once for each arm; see `DataSet.read`."""
    rows = list(csv.reader(io.StringIO(_text(folder / FILE))))[1:]
    numbers = [tuple(_numbers(row, place) for place in (1, 2)) for row in rows]
    good = np.array([len(q) == JOINTS and len(p) == MARKERS for q, p in numbers], dtype=bool)
    bad = np.flatnonzero(~good)
    left_out = quarantined(
        TABLE,
        bad + 1,
        f"not {JOINTS} joint angles and {MARKERS} coordinates; rows are counted, not lines",
        [f"{len(numbers[row][0])} and {len(numbers[row][1])}" for row in bad],
    )
    refuse_too_many(left_out, {TABLE: len(rows)}, max_left_out)
    q_rad = np.array([numbers[row][0] for row in np.flatnonzero(good)])
    p_m = np.array([numbers[row][1] for row in np.flatnonzero(good)]).reshape(-1, 2, 3)
    return tuple(
        ImportedCampaign(
            name=f"justin-{side}",
            robot=f"justin_{side}",
            provenance=PUBLISHED.told(_TOLD, side=side, file=FILE, u=ASSUMED_MM),
            instrument="points",
            uncertainty_mm=ASSUMED_MM,
            readings=_table(q_rad, q_rad[:, arm], p_m[:, marker]),
            files=(FILE,),
            left_out=left_out,
            notes=(f"{len(q_rad)} configurations",),
            joints="commanded",
            arm=ARMS / f"justin_{side}.yaml",
        )
        for side, (arm, marker) in SIDES.items()
    )


def _text(path: Path) -> str:
    """Return the text of the zipped table."""
    try:
        with zipfile.ZipFile(path) as archive:
            return archive.read(TABLE).decode("utf-8")
    except (zipfile.BadZipFile, KeyError, UnicodeDecodeError) as error:
        raise RawDataError(
            "the zipped table cannot be read",
            where=str(path),
            value=str(error),
            allowed=f"a zip file with {TABLE}",
            remedy="fetch the data set again",
        ) from None


def _numbers(row: list[str], place: int) -> list[float]:
    return [float(word) for word in _NUMBER.findall(row[place])] if len(row) > place else []


def _table(
    q_rad: NDArray[np.float64], q_arm_rad: NDArray[np.float64], p_m: NDArray[np.float64]
) -> pd.DataFrame:
    """Return torso, passive joint and arm as joints 1 to 11, and the marker as the target T1."""
    passive = -(q_rad[:, 1] + q_rad[:, 2])
    q_deg = np.degrees(np.column_stack([q_rad[:, :3], passive, q_arm_rad]))
    columns = {f"q{k + 1}_deg": q_deg[:, k] for k in range(q_deg.shape[1])}
    return pd.DataFrame(
        columns | {f"T1_{axis}_mm": 1e3 * p_m[:, k] for k, axis in enumerate("xyz")}
    )


DATASET = DataSet("dlr-elastic-calibration", read, PUBLISHED)
