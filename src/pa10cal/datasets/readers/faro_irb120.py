"""An IRB 120 and three reflectors seen by a laser tracker: tables of numbers between blanks.

`joints.txt` has six joint angles [deg] a row, `reflector_1.txt` to `reflector_3.txt` the place of a
reflector [mm] for the same row; `nan` or `-` is one that was not seen. Reflectors on the base, read
with every row, may be in `base_1.txt`, `base_2.txt` and so on, and whose measurements they are in
`provenance.txt`.
"""

from __future__ import annotations

from functools import reduce
from pathlib import Path

import numpy as np

from pa10cal.campaign.quarantine import quarantined
from pa10cal.datasets.commands import command_columns
from pa10cal.datasets.dataset import DataSet, ImportedCampaign
from pa10cal.datasets.text_table import TextTable, read_bare_table
from pa10cal.errors import RawDataError

JOINTS = tuple(f"q{joint}_deg" for joint in range(1, 7))
REFLECTORS = {"T1": "reflector_1.txt", "T2": "reflector_2.txt", "T3": "reflector_3.txt"}
FILES = ("joints.txt", *REFLECTORS.values())
#: Tables that need not be there: reflectors on the base.
BASE = {f"base{k}": f"base_{k}.txt" for k in range(1, 10)}
PROVENANCE = "provenance.txt"
#: What the tables do not state.
ASSUMED_MM, ASSUMED_C = 0.05, 20.0

_UNKNOWN = "Whose measurements they are, the tables do not say."
_TOLD = (
    "Places of three reflectors on an IRB 120 by a laser tracker, from tables of joint angles and "
    "places in the layout faro-irb120. The tables do not state uncertainty, temperature, load, "
    "time and where the reflectors sit: uncertainty_mm "
    f"{ASSUMED_MM} and reference temperature {ASSUMED_C} are assumed, mass 0 stands for a tool not "
    "described, gravity is that of an upright arm, time_s is the number of the row."
)


def read(folder: Path, max_left_out: float) -> tuple[ImportedCampaign, ...]:
    """Read the tables; see `DataSet.read`."""
    joints = read_bare_table(folder, FILES[0], JOINTS)
    base = {name: file for name, file in BASE.items() if (folder / file).is_file()}
    places = [
        read_bare_table(folder, file, [f"{name}_{axis}_mm" for axis in "xyz"], may_be_blank=True)
        for name, file in {**REFLECTORS, **base}.items()
    ]
    tables: list[TextTable] = [joints, *places]
    if len({table.total for table in tables}) > 1:
        raise RawDataError(
            "the tables have different numbers of rows",
            where=str(folder),
            value=", ".join(f"{table.file} {table.total}" for table in tables),
            allowed="one row a configuration in each table",
            remedy="complete the shorter table, with nan where a reflector was not observed",
        )
    for table in tables:
        table.refuse_too_many(max_left_out)
    line = reduce(np.intersect1d, [table.line for table in tables])
    joints, *places = (table.take(np.flatnonzero(np.isin(table.line, line))) for table in tables)
    p_mm = np.stack([table.numbers(list(table.columns)) for table in places], axis=1)
    seen = np.asarray(np.isfinite(p_mm).all(axis=2), dtype=bool)
    flange = seen[:, : len(REFLECTORS)]
    some = np.asarray(flange.any(axis=1), dtype=bool)
    unseen = quarantined(FILES[1], line[~some], "no reflector was observed")
    q_rad = np.deg2rad(joints.numbers(JOINTS)[some])
    poses = command_columns(np.asarray(line[some] - 1, dtype=np.float64), q_rad)
    for b, table in enumerate(places):
        place_mm = np.where(seen[some, b, None], p_mm[some, b], np.nan)
        poses[[*table.columns]] = place_mm
    return (
        ImportedCampaign(
            name="irb120",
            robot="irb120",
            provenance=f"{_whose(folder)} {_TOLD}",
            instrument="points",
            uncertainty_mm=ASSUMED_MM,
            reference_temperature_C=ASSUMED_C,
            held_out_fraction=0.3,
            readings=poses,
            files=(*FILES, *base.values()),
            left_out=(*(row for table in tables for row in table.left_out), *unseen),
            notes=(f"{len(poses)} configurations, {int((~flange[some]).sum())} places not seen",),
        ),
    )


def _whose(folder: Path) -> str:
    """Return whose measurements they are, as the folder says."""
    path = folder / PROVENANCE
    if not path.is_file():
        return _UNKNOWN
    return " ".join(path.read_text(encoding="utf-8", errors="replace").split()) or _UNKNOWN


DATASET = DataSet(
    name="faro-irb120",
    title="IRB 120 with three reflectors and a laser tracker, as text tables",
    files=FILES,
    read=read,
)
