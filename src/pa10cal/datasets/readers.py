"""The data sets that can be imported: how the tables of each are read as campaigns.

What a data set holds, where its files are published and what is assumed of it is stated in
`published/<name>.yaml`. A new data set is one more of these files, and a reader here.
"""

from __future__ import annotations

import csv
import difflib
import io
import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.campaign.own_columns import refuse_too_many
from pa10cal.campaign.raw_rows import quarantined
from pa10cal.datasets.importing import AsItIs, DataSet, ImportedCampaign, Published
from pa10cal.datasets.text_table import read_bare_table, same_rows
from pa10cal.errors import RawDataError
from pa10cal.yaml_file import refusals_beside

#: Descriptions of arms that are measured in data sets and are not shipped as arms of their own.
ARMS = Path(__file__).with_name("arms")
DATASETS: dict[str, DataSet] = {}

_AXES, _QUATERNION = "xyz", ("qw", "qx", "qy", "qz")
_refusal = refusals_beside(__file__, RawDataError)

_Read = Callable[[Path, float, Published], tuple[ImportedCampaign, ...]]


def dataset_names() -> tuple[str, ...]:
    """Return the names of all data sets."""
    return tuple(sorted(DATASETS))


def dataset_named(name: str) -> DataSet:
    """Return the data set of that name; refuse one that is not there (RawDataError)."""
    if name not in DATASETS:
        near = difflib.get_close_matches(name, dataset_names(), n=1, cutoff=0.5)
        kind = "like another" if near else "no reader"
        raise _refusal(kind, "data set", name, ", ".join(dataset_names()), *near)
    return DATASETS[name]


def _reader_of(name: str, *, unread: tuple[str, ...] = ()) -> Callable[[_Read], _Read]:
    """Make a function the reader of a data set; see `DataSet.read`."""

    def register(read: _Read) -> _Read:
        published = Published.of(name)
        DATASETS[name] = DataSet(
            name, lambda folder, most: read(folder, most, published), published, unread
        )
        return read

    return register


def _numbered(name: str, values: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return values (N, n) as columns by the numbers of joints, which stand at # in the name."""
    return {name.replace("#", str(k)): column for k, column in enumerate(values.T, start=1)}


@_reader_of("dlr-elastic-calibration")
def _justin(
    folder: Path, max_left_out: float, published: Published
) -> tuple[ImportedCampaign, ...]:
    """DLR Agile Justin, one marker on each hand under Vicon: a campaign for each arm.

    A zipped table with a header: the number of the row, a list of nineteen commanded joint angles
    [rad] (torso 3, right arm 7, left arm 7, head 2), and the places of the right and of the left
    marker [m]. Lists are written as numpy prints them, over several lines. Torso, passive joint
    and arm are joints 1 to 11, the marker is the target T1.
    """
    (file,), table = published.sha256, "measurements.csv"
    try:
        with zipfile.ZipFile(folder / file) as archive:
            text = archive.read(table).decode("utf-8")
    except (zipfile.BadZipFile, KeyError, UnicodeDecodeError) as error:
        raise _refusal("zip", folder / file, str(error), table) from None
    number = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
    rows = [
        [[float(word) for word in number.findall(field)] for field in (*row[1:3], "", "")[:2]]
        for row in list(csv.reader(io.StringIO(text)))[1:]
    ]
    good = np.array([(len(q), len(p)) == (19, 6) for q, p in rows], dtype=bool)
    left_out = quarantined(
        table,
        np.flatnonzero(~good) + 1,
        "not 19 joint angles and 6 coordinates; rows are counted, not lines",
        [f"{len(rows[k][0])} and {len(rows[k][1])}" for k in np.flatnonzero(~good)],
    )
    refuse_too_many(left_out, {table: len(rows)}, max_left_out)
    q_rad = np.array([rows[k][0] for k in np.flatnonzero(good)])
    p_m = np.array([rows[k][1] for k in np.flatnonzero(good)]).reshape(-1, 2, 3)
    passive = -(q_rad[:, 1] + q_rad[:, 2])
    campaigns = []
    for marker, (side, arm) in enumerate({"right": slice(3, 10), "left": slice(10, 17)}.items()):
        q_deg = np.degrees(np.column_stack([q_rad[:, :3], passive, q_rad[:, arm]]))
        places = {f"T1_{axis}_mm": 1e3 * p_m[:, marker, k] for k, axis in enumerate(_AXES)}
        campaigns.append(
            ImportedCampaign(
                name=f"justin-{side}",
                robot=f"justin_{side}",
                provenance=published.provenance_text(side=side, file=file),
                instrument="points",
                uncertainty_mm=published.stated["uncertainty_mm"],
                readings=pd.DataFrame(_numbered("q#_deg", q_deg) | places),
                files=(file,),
                left_out=left_out,
                notes=(f"{len(q_rad)} configurations",),
                joints="commanded",
                arm=ARMS / f"justin_{side}.yaml",
            )
        )
    return tuple(campaigns)


@_reader_of("faro-irb120")
def _irb120(
    folder: Path, max_left_out: float, published: Published
) -> tuple[ImportedCampaign, ...]:
    """An IRB 120 and three reflectors under a FARO tracker, three more on its base.

    Tables of numbers between blanks, without headers, which belong together line by line: six joint
    angles [deg], then the place of a reflector [mm] in each, three at the flange and three on the
    base. Three zeros stand for a reflector that was not seen.
    """
    files = tuple(published.sha256)
    q = [f"q{joint}_deg" for joint in range(1, 7)]
    tables = [read_bare_table(folder, files[0], q)]
    for name, file in zip(("T1", "T2", "T3", "base1", "base2", "base3"), files[1:], strict=True):
        tables.append(read_bare_table(folder, file, [f"{name}_{axis}_mm" for axis in _AXES]))
    joints, *places = same_rows(tables, max_left_out)
    p_mm = np.stack([table.numbers_of(list(table.columns)) for table in places], axis=1)
    seen = np.asarray((p_mm != 0.0).any(axis=2), dtype=bool)
    some = np.asarray(seen[:, :3].any(axis=1), dtype=bool)
    unseen = quarantined(files[1], joints.line[~some], "no reflector was observed")
    columns = {name: joints.columns[name][some] for name in q}
    for b, table in enumerate(places):
        place_mm = np.where(seen[some, b, None], p_mm[some, b], np.nan)
        columns |= dict(zip(table.columns, place_mm.T, strict=True))
    flange, base = (int(part.sum()) for part in np.split(~seen[some], [3], axis=1))
    note = (
        f"{int(some.sum())} configurations, {flange} places not seen at the flange and {base} on "
        "the base"
    )
    campaign = ImportedCampaign(
        name="irb120",
        robot="irb120",
        provenance=published.provenance_text(),
        instrument="points",
        uncertainty_mm=published.stated["uncertainty_mm"],
        holdout={"last_fraction": 0.3},
        readings=pd.DataFrame(columns),
        files=files,
        left_out=(*(row for table in tables for row in table.quarantined), *unseen),
        notes=(note,),
    )
    return (campaign,)


@_reader_of("iiwa7-robot-calibration")
def _iiwa7(folder: Path, max_left_out: float, published: Published) -> tuple[ImportedCampaign, ...]:
    """KUKA LBR iiwa 7 under an optical tracker, torques logged: four tables with headers.

    In each the number of the row, seven joint angles [rad], seven torques [N m] as the controller
    logs them, and the pose of the target as sixteen numbers, row by row [mm]. The controller logs
    the load on a joint; the torque that the motor exerts is its negative. The folder of each is
    named after its payload [kg].
    """
    payloads_kg = {"iiwa7-free": 0.0, "iiwa7-0kg": 0.0, "iiwa7-1250g": 1.25, "iiwa7-2500g": 2.5}
    q, tau = ([f"{name}{k}" for k in range(1, 8)] for name in ("q", "load"))
    T = [f"T{row}{column}" for row in range(4) for column in range(4)]
    campaigns = []
    for (name, kg), file in zip(payloads_kg.items(), published.sha256, strict=True):
        table = read_bare_table(folder, file, ("row", *q, *tau, *T), separator=",", header=True)
        refuse_too_many(table.quarantined, table.totals, max_left_out)
        T_mm = table.numbers_of(T).reshape(-1, 4, 4)
        turned = Rotation.from_matrix(T_mm[:, :3, :3]).as_quat(canonical=True, scalar_first=True)
        columns = _numbered("q#_deg", np.degrees(table.numbers_of(q)))
        columns |= _numbered("tau#_Nm", -table.numbers_of(tau))
        columns |= {f"{axis}_mm": T_mm[:, k, 3] for k, axis in enumerate(_AXES)}
        columns |= dict(zip(_QUATERNION, turned.T, strict=True))
        campaigns.append(
            ImportedCampaign(
                name=name,
                robot="iiwa7",
                provenance=published.provenance_text(file=file, kg=kg),
                instrument="pose",
                uncertainty_mm=published.stated["uncertainty_mm"],
                readings=pd.DataFrame(columns),
                files=(file,),
                left_out=table.quarantined,
                notes=(f"{len(table)} configurations",),
                arm=ARMS / "iiwa7.yaml",
                tool_mass_kg=kg,
            )
        )
    return tuple(campaigns)


@_reader_of("ipa-robot-accuracy", unread=("LICENSE.md",))
def _ur10(folder: Path, _: float, published: Published) -> tuple[ImportedCampaign, ...]:
    """UR10 poses measured by a 6-D laser tracker, series A and C: files that are read as they are.

    Rows that cannot be used are found when they are read.
    """
    campaigns = []
    for name, stated in published.stated["campaigns"].items():
        file, columns = stated["file"], dict(published.stated["columns"])
        for key, names in stated.get("u", {}).items():
            columns[key] = columns[key] | {"u": names}
        time = {"time": stated["time"]} if "time" in stated else {}
        campaigns.append(
            ImportedCampaign(
                name=name,
                robot="ur10",
                provenance=f"{published.provenance_text(file=file)} {stated['provenance']}",
                instrument="pose",
                uncertainty_mm=stated["uncertainty_mm"],
                reference_temperature_C=stated["reference_temperature_C"],
                holdout={"last_fraction": 0.3},
                readings=AsItIs(folder / file, time | columns),
                files=(file,),
                joints="commanded",
            )
        )
    return tuple(campaigns)


@_reader_of("titan-robot-accuracy")
def _titan(folder: Path, max_left_out: float, published: Published) -> tuple[ImportedCampaign, ...]:
    """KUKA KR 1000 titan, three points on its end-effector: two tables with a header.

    In each the axes A1 to A6 as the controller counts them [deg], the place E of a linear axis
    [mm], three points as measured [mm] (xa1 …) and as the owner's own model has them (xn1 …). The
    arm's description turns the axes 1, 4 and 6 the other way.
    """
    axes, points = [f"A{k}" for k in range(1, 7)], (1, 2, 3)
    measured, modelled = ([f"{axis}{by}{k}" for k in points for axis in _AXES] for by in "an")
    differences = [f"{name}{k}" for k in points for name in ("dx", "dy", "dz", "err")]
    names = (*axes, "E", *measured, *modelled, *differences)
    campaigns = []
    for file, (name, robot) in zip(
        published.sha256, (("titan-fixed", "titan"), ("titan-rail", "titan_rail")), strict=True
    ):
        table = read_bare_table(folder, file, names, separator=",", header=True)
        refuse_too_many(table.quarantined, table.totals, max_left_out)
        q = table.numbers_of(axes) * np.array([-1.0, 1.0, 1.0, -1.0, 1.0, -1.0])
        columns = {"q1_mm": table["E"]} if robot == "titan_rail" else {}
        first = 1 + len(columns)
        columns |= {f"q{first + k}_deg": column for k, column in enumerate(q.T)}
        for k in points:
            columns |= {f"T{k}_{axis}_mm": table[f"{axis}a{k}"] for axis in _AXES}
        off_mm = (table.numbers_of(modelled) - table.numbers_of(measured)).reshape(-1, 3, 3)
        own_mm = float(np.sqrt(np.mean(np.sum(off_mm**2, axis=2))))
        campaigns.append(
            ImportedCampaign(
                name=name,
                robot=robot,
                provenance=published.provenance_text(file=file, own=own_mm),
                instrument="points",
                uncertainty_mm=published.stated["uncertainty_mm"],
                readings=pd.DataFrame(columns),
                files=(file,),
                left_out=table.quarantined,
                notes=(f"{len(table)} configurations",),
                joints="commanded",
                arm=ARMS / f"{robot}.yaml",
            )
        )
    return tuple(campaigns)


@_reader_of("welding-motoman")
def _motoman(
    folder: Path, max_left_out: float, published: Published
) -> tuple[ImportedCampaign, ...]:
    """Yaskawa Motoman MA2010 under OptiTrack: two tables a date, without headers.

    They belong together line by line: six joint angles [rad], and the pose of a rigid body on the
    torch, x, y, z [mm] and a quaternion, w first.
    """
    q, place = [f"q{k}_rad" for k in range(1, 7)], [f"{axis}_mm" for axis in _AXES]
    files = [tuple(published.sha256)[k : k + 2] for k in (0, 2)]
    campaigns = []
    for name, (of_joints, of_poses) in zip(("ma2010-0516", "ma2010-0801"), files, strict=True):
        tables = [
            read_bare_table(folder, of_joints, q, separator=","),
            read_bare_table(folder, of_poses, (*place, *_QUATERNION), separator=","),
        ]
        joints, poses = same_rows(tables, max_left_out)
        wxyz = poses.numbers_of(_QUATERNION)
        length = np.linalg.norm(wxyz, axis=1)
        wxyz = wxyz / np.where(wxyz[:, :1] < 0.0, -length[:, None], length[:, None])
        columns = _numbered("q#_deg", np.degrees(joints.numbers_of(q)))
        columns |= {axis: poses[axis] for axis in place}
        columns |= dict(zip(_QUATERNION, wxyz.T, strict=True))
        campaigns.append(
            ImportedCampaign(
                name=name,
                robot="ma2010",
                provenance=published.provenance_text(date=Path(of_joints).parent.name),
                instrument="pose",
                uncertainty_mm=published.stated["uncertainty_mm"],
                readings=pd.DataFrame(columns),
                files=(of_joints, of_poses),
                left_out=tuple(row for table in tables for row in table.quarantined),
                notes=(f"{len(joints)} configurations",),
                arm=ARMS / "ma2010.yaml",
            )
        )
    return tuple(campaigns)
