"""An IRB 120 and three reflectors under a FARO tracker, three more on its base.

Tables of numbers between blanks, without headers, which belong together line by line: six joint
angles [deg] in `measured_joints.txt`, the place of a reflector [mm] in `measured_SMR_1.txt` to
`_3.txt`, of one on the base in `measured_base_1.txt` to `_3.txt`. Three zeros stand for a reflector
that was not seen.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from pa10cal.campaign.raw_rows import quarantined
from pa10cal.datasets.importing import DataSet, ImportedCampaign, Published
from pa10cal.datasets.text_table import read_bare_table, same_rows

_FOLDER = "3-Full Measurement/Output/Backup"
PUBLISHED = Published.on_github(
    "icelinker/Robot-Calibration-LaserTracker",
    "188abd2d773b26dd32bafe50943c3ab0044a72d8",
    """
87fc42231d4c61ecebd3db7b716f3af5ad346538c01fb36c29beebc22c9db3a1  measured_joints.txt
293aadc0017c02e314b23b549d7f51f129bfab3a3adf65c04fddcad6676a9bc0  measured_SMR_1.txt
6bd480669b5dbd798150297b14547ed9b027c25909233d35dd71df51970c2772  measured_SMR_2.txt
ff4ecb1edffef871c7184b43461df32fd91ee9d0bde7bb5405f8793a179fb688  measured_SMR_3.txt
c560d8b7723309498b353f589dcdba0441a3da38453a7af75e3cc7bba88e38c2  measured_base_1.txt
d76441a62762845016cd03ac9d0eb9f4c20aa2cc75b6ad0dff7aa9319b44af2b  measured_base_2.txt
c234dc42785290342c0185b1d64733a072e2ef0028182093a03a2b6cc05448e0  measured_base_3.txt
    """,
    folder=f"{_FOLDER}/",
)
JOINTS = tuple(f"q{joint}_deg" for joint in range(1, 7))
FILES = tuple(PUBLISHED.sha256)
#: Targets by their file: three at the flange, then three on the base.
TARGETS = dict(zip(("T1", "T2", "T3", "base1", "base2", "base3"), FILES[1:], strict=True))
AT_FLANGE = 3
#: What the tables do not state.
ASSUMED_MM = 0.05
_TOLD = (
    "Measured, not simulated: ABB IRB 120 with three reflectors under a FARO laser tracker, "
    "three more on its base read with every configuration; {folder} of the repository "
    "{repository}, commit {commit}. Not stated, hence assumed: uncertainty_mm {u}, reference "
    "temperature, an upright arm, no load, mass 0 for a tool not described. No time was recorded. "
    "No licence is stated by the owner."
)


def read(folder: Path, max_left_out: float) -> tuple[ImportedCampaign, ...]:
    """Read the tables; see `DataSet.read`."""
    tables = [read_bare_table(folder, FILES[0], JOINTS)]
    for name, file in TARGETS.items():
        tables.append(read_bare_table(folder, file, [f"{name}_{axis}_mm" for axis in "xyz"]))
    joints, *places = same_rows(tables, max_left_out)
    p_mm = np.stack([table.numbers_of(list(table.columns)) for table in places], axis=1)
    seen = np.asarray((p_mm != 0.0).any(axis=2), dtype=bool)
    some = np.asarray(seen[:, :AT_FLANGE].any(axis=1), dtype=bool)
    unseen = quarantined(FILES[1], joints.line[~some], "no reflector was observed")
    columns = {name: joints.columns[name][some] for name in JOINTS}
    for b, table in enumerate(places):
        place_mm = np.where(seen[some, b, None], p_mm[some, b], np.nan)
        columns |= dict(zip(table.columns, place_mm.T, strict=True))
    not_seen = [int(part.sum()) for part in np.split(~seen[some], [AT_FLANGE], axis=1)]
    return (
        ImportedCampaign(
            name="irb120",
            robot="irb120",
            provenance=PUBLISHED.told(_TOLD, folder=_FOLDER, u=ASSUMED_MM),
            instrument="points",
            uncertainty_mm=ASSUMED_MM,
            holdout={"last_fraction": 0.3},
            readings=pd.DataFrame(columns),
            files=FILES,
            left_out=(*(row for table in tables for row in table.quarantined), *unseen),
            notes=(
                f"{int(some.sum())} configurations, {not_seen[0]} places not seen at the flange "
                f"and {not_seen[1]} on the base",
            ),
        ),
    )


DATASET = DataSet("faro-irb120", read, PUBLISHED)
