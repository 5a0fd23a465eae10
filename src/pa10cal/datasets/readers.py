"""Readers of the data sets that can be imported: how the tables of each become campaigns.

`published/<name>.yaml` states where the files of a data set are published, which files belong to
which campaign, and what is assumed. A new data set needs such a file and a reader here. A table
whose columns need no change is taken unchanged, with `columns` of campaign.yaml.
"""

from __future__ import annotations

import csv
import difflib
import io
import re
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.campaign.raw_rows import RawRows, quarantined
from pa10cal.campaign.screens import refuse_too_many
from pa10cal.datasets.data_set import AsItIs, DataSet, ImportedCampaign, Published
from pa10cal.errors import RawDataError
from pa10cal.input_files import open_file, read_file, reason

#: Limits of a table, unpacked: bytes and lines. The largest tables of the data sets have a tenth.
_MOST_BYTES, _MOST_LINES = 32_000_000, 1_000_000
#: Exceptions that a zip file raises which is damaged, encrypted or of another kind.
_BROKEN_ZIP = (
    zipfile.BadZipFile,
    zlib.error,
    KeyError,
    UnicodeDecodeError,
    NotImplementedError,
    RuntimeError,
    EOFError,
)
#: Folder of the descriptions of arms that data sets measured and that are not shipped arms.
ARMS = Path(__file__).with_name("arms")
#: The data sets by name; `_reader_of` adds them.
DATASETS: dict[str, DataSet] = {}

_AXES = "xyz"
#: Columns of campaign tables that hold a position and an orientation.
_POSITION = [f"{axis}_mm" for axis in _AXES]
_QUATERNION = ["qw", "qx", "qy", "qz"]

#: Yields the campaigns of a folder. The number is the largest fraction of a file's rows that may be
#: omitted.
_Read = Callable[[Path, float, Published], Iterator[ImportedCampaign]]


def dataset_names() -> tuple[str, ...]:
    """Return the names of all data sets."""
    return tuple(sorted(DATASETS))


def dataset_named(name: str) -> DataSet:
    """Return the data set of that name; RawDataError where there is none."""
    if name not in DATASETS:
        near = difflib.get_close_matches(name, dataset_names(), n=1, cutoff=0.5)
        raise RawDataError(
            "there is no reader of this data set",
            where="data set",
            value=name,
            allowed=", ".join(dataset_names()),
            remedy=f"is {near[0]!r} meant?"
            if near
            else "correct the name, or write a reader in pa10cal/datasets/readers.py "
            "(docs/datasets.md)",
        )
    return DATASETS[name]


def _reader_of(name: str, *, unread: tuple[str, ...] = ()) -> Callable[[_Read], _Read]:
    """Register a function as the reader of a data set; `unread` as in `DataSet`."""

    def register(read: _Read) -> _Read:
        published = Published.of(name)
        DATASETS[name] = DataSet(
            name, lambda folder, most: tuple(read(folder, most, published)), published, unread
        )
        return read

    return register


# Tables of numbers by column. A row with too many or too few fields, or with a field that is not a
# number, is omitted and listed with its line.


def read_bare_table(
    folder: Path,
    file: str,
    names: Sequence[str],
    *,
    separator: str | None = None,
    header: bool = False,
) -> RawRows:
    """Read a table of numbers with decimal points.

    Every line is a row, even a blank one: tables of one campaign correspond line by line.

    Args:
        folder: folder of the data set.
        file: path of the table in it.
        names: names of the columns, in order.
        separator: between fields; None for blanks.
        header: whether to skip the first line.

    Raises:
        RawDataError: when the file as a whole cannot be used.
    """
    path, width = folder / file, len(names)
    try:
        content = read_file(path, _MOST_BYTES, folder)
    except OSError as error:
        raise _unreadable(path, reason(error)) from None
    text = content.decode("utf-8-sig", errors="replace").rstrip()
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    if (count := 1 + text.count("\n")) > _MOST_LINES:
        raise _unreadable(path, f"{count} lines")
    if not text:
        raise _empty(f"{path}:1")
    lines = text.split("\n")
    line = np.arange(1, len(lines) + 1)[int(header) :]
    rows = [row.split(separator) for row in lines[int(header) :]]
    widths = np.array([len(row) for row in rows], dtype=np.int64)
    fits = widths == width
    words = np.array([row for row in rows if len(row) == width], dtype=object).reshape(-1, width)
    commas = np.array(["," in word for word in words.ravel()], dtype=bool).reshape(words.shape)
    if 2 * commas.any(axis=1).sum() > len(words):
        first = int(np.argmax(commas.any(axis=1)))
        raise RawDataError(
            "decimal commas where decimal points are expected",
            where=f"{path}:{line[fits][first]}",
            value=words[first][commas[first]][0],
            allowed="numbers such as 1.5",
            remedy="take the file as it was published, not as a spreadsheet rewrote it",
        )
    columns, not_numbers = {}, {}
    for name, fields in zip(names, words.T, strict=True):
        columns[name] = np.array(pd.to_numeric(fields, errors="coerce"), dtype=float)
        unread = np.flatnonzero(~np.isfinite(columns[name]))
        not_numbers[name] = {int(line[fits][k]): str(fields[k]) for k in unread}
    wrong_width = f"the number of fields is not {width}"
    omitted = quarantined(file, line[~fits], wrong_width, widths[~fits])
    table = RawRows(file, columns, line[fits], {file: len(rows)}, (), omitted, not_numbers)
    return table.finite(names)


def _unreadable(path: Path, why: str) -> RawDataError:
    return RawDataError(
        f"a table of the data set cannot be read: {why}",
        where=str(path),
        allowed=f"a table of at most {_MOST_BYTES / 1e6:.0f} MB and {_MOST_LINES} lines",
        remedy="take the file as it was published",
    )


def _empty(where: Path | str) -> RawDataError:
    return RawDataError(
        "the file is empty", where=str(where), allowed="rows of numbers", remedy="copy it again"
    )


def read_tables(
    folder: Path,
    max_left_out: float,
    tables: Mapping[str, Sequence[str]],
    *,
    separator: str | None = None,
    header: bool = False,
) -> RawRows:
    """Read tables that correspond line by line as one: the rows that every table has.

    Args:
        folder: folder of the data set.
        max_left_out: largest fraction of a table's rows that may be omitted.
        tables: names of the columns by file; no name twice.
        separator, header: see `read_bare_table`.

    Raises:
        RawDataError: when they have different numbers of rows, or too many of one cannot be used.
    """
    read = [
        read_bare_table(folder, file, names, separator=separator, header=header)
        for file, names in tables.items()
    ]
    totals = {table.file: table.totals[table.file] for table in read}
    if len(set(totals.values())) > 1:
        counts = ", ".join(f"{file} {total}" for file, total in totals.items())
        raise RawDataError(
            "the tables have different numbers of rows",
            where=read[0].file,
            value=counts,
            allowed="one row a configuration in each table",
            remedy="fetch the data set again, or complete the shorter table",
        )
    for table in read:
        refuse_too_many(table.quarantined, table.totals, max_left_out)
    line = reduce(np.intersect1d, [table.line for table in read])
    common = [table.at(np.flatnonzero(np.isin(table.line, line))) for table in read]
    columns = {name: column for table in common for name, column in table.columns.items()}
    omitted = tuple(row for table in read for row in table.quarantined)
    return RawRows(read[0].file, columns, line, totals, (), omitted)


def _campaign(
    published: Published,
    raw: RawRows,
    columns: Mapping[str, NDArray[np.float64]],
    *,
    name: str,
    robot: str,
    instrument: str,
    **placeholders: object,
) -> ImportedCampaign:
    """Return the campaign of a table; `placeholders` fill those of the stated provenance."""
    arm = ARMS / f"{robot}.yaml"
    return ImportedCampaign(
        name=name,
        robot=robot,
        instrument=instrument,
        provenance=published.provenance_text(**placeholders),
        uncertainty_mm=published.stated["uncertainty_mm"],
        readings=pd.DataFrame(columns),
        files=tuple(raw.totals),
        left_out=raw.quarantined,
        notes=(f"{len(raw)} configurations",),
        arm=arm if arm.is_file() else None,
    )


def _joint_columns(name: str, values: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return values (N, n) as one column a joint; the joint's number replaces # in the name."""
    return {name.replace("#", str(k)): column for k, column in enumerate(values.T, start=1)}


def _pose_columns(
    p_mm: NDArray[np.float64], wxyz: NDArray[np.float64]
) -> dict[str, NDArray[np.float64]]:
    """Return positions (N, 3) and quaternions (N, 4) as columns."""
    return dict(zip((*_POSITION, *_QUATERNION), np.hstack([p_mm, wxyz]).T, strict=True))


#: A number within text.
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


@_reader_of("dlr-elastic-calibration")
def _justin(folder: Path, max_left_out: float, published: Published) -> Iterator[ImportedCampaign]:
    """DLR Agile Justin, one marker on each hand under Vicon: a campaign for each arm.

    A zipped table with a header: the number of the row, a list of nineteen commanded joint angles
    [rad] (torso 3, right arm 7, left arm 7, head 2), and the positions of the right and of the left
    marker [m]. Lists are written as numpy prints them, over several lines. Torso, passive joint
    and arm are joints 1 to 11, the marker is the target T1.
    """
    (file,), table = published.sha256, "measurements.csv"
    text = _zipped_text(folder / file, folder, table)
    try:
        cells_of_rows = list(csv.reader(io.StringIO(text)))[1:]
    except csv.Error as error:
        raise _unreadable(folder / file, str(error)) from None
    count = len(cells_of_rows)
    if not count:
        raise _empty(folder / file)
    padded = [(*cells, "", "", "") for cells in cells_of_rows]  # cells that a row lacks are empty
    rows = [(_numbers(cells[1]), _numbers(cells[2])) for cells in padded]
    good = np.array([(len(q), len(p)) == (19, 6) for q, p in rows], dtype=bool)
    raw = RawRows(table, {}, np.arange(1, count + 1), {table: count}, (), ()).take(
        good,
        "not 19 joint angles and 6 coordinates; rows are counted, not lines",
        [f"{len(rows[k][0])} and {len(rows[k][1])}" for k in np.flatnonzero(~good)],
    )
    refuse_too_many(raw.quarantined, raw.totals, max_left_out)
    q_rad = np.array([rows[k][0] for k in np.flatnonzero(good)])
    p_mm = 1e3 * np.array([rows[k][1] for k in np.flatnonzero(good)])
    passive_rad = -(q_rad[:, 1] + q_rad[:, 2])
    for side, first, marker_mm in (("right", 3, p_mm[:, :3]), ("left", 10, p_mm[:, 3:])):
        arm_rad = np.column_stack([q_rad[:, :3], passive_rad, q_rad[:, first : first + 7]])
        columns = _joint_columns("q#_deg", np.degrees(arm_rad))
        columns |= {f"T1_{name}": marker_mm[:, k] for k, name in enumerate(_POSITION)}
        campaign = _campaign(
            published,
            raw,
            columns,
            name=f"justin-{side}",
            robot=f"justin_{side}",
            instrument="points",
            side=side,
            file=file,
        )
        yield replace(campaign, files=(file,), joints="commanded")


def _numbers(text: str) -> list[float]:
    return [float(word) for word in _NUMBER.findall(text)]


def _zipped_text(path: Path, folder: Path, name: str) -> str:
    """Return the text of one file in a zip file that lies in a folder."""
    try:
        with open_file(path, folder) as packed, zipfile.ZipFile(packed) as archive:
            with archive.open(name) as unpacked:
                content = unpacked.read(_MOST_BYTES + 1)
            if len(content) > _MOST_BYTES:
                raise _unreadable(path, "its table is larger, unpacked")
            return content.decode("utf-8")
    except OSError as error:
        raise _unreadable(path, reason(error)) from None
    except _BROKEN_ZIP as error:
        raise RawDataError(
            "the zipped table cannot be read",
            where=str(path),
            value=str(error),
            allowed=f"a zip file with {name}",
            remedy="fetch the data set again",
        ) from None


@_reader_of("faro-irb120")
def _irb120(folder: Path, max_left_out: float, published: Published) -> Iterator[ImportedCampaign]:
    """An IRB 120 and three reflectors under a FARO tracker, three more on its base.

    Tables of numbers between blanks, without headers, which correspond line by line: six joint
    angles [deg], then the position of a reflector [mm] in each table, three at the flange and three
    on the base. Three zeros stand for a reflector that was not seen.
    """
    files = {table: published.path(file) for table, file in published.stated["files"].items()}
    joints = [f"q{joint}_deg" for joint in range(1, 7)]
    reflectors = {
        target: [f"{target}_{name}" for name in _POSITION] for target in files if target != "joints"
    }
    names = {"joints": joints} | reflectors
    raw = read_tables(folder, max_left_out, {file: names[table] for table, file in files.items()})
    seen = {
        target: np.any(raw.numbers_of(names) != 0.0, axis=1) for target, names in reflectors.items()
    }
    at_flange, on_base = ("T1", "T2", "T3"), ("base1", "base2", "base3")
    used = np.any([seen[target] for target in at_flange], axis=0)
    omitted = quarantined(files["T1"], raw.line[~used], "no reflector was observed")
    raw = raw.at(np.flatnonzero(used))
    columns = {name: raw[name] for name in joints}
    for target, names_mm in reflectors.items():
        seen[target] = seen[target][used]
        columns |= {name: np.where(seen[target], raw[name], np.nan) for name in names_mm}
    unseen_flange, unseen_base = (
        sum(int(np.sum(~seen[target])) for target in targets) for targets in (at_flange, on_base)
    )
    campaign = _campaign(
        published, raw, columns, name="irb120", robot="irb120", instrument="points"
    )
    yield replace(
        campaign,
        holdout={"last_fraction": 0.3},
        left_out=(*raw.quarantined, *omitted),
        notes=(
            f"{len(raw)} configurations, {unseen_flange} places not seen at the flange and "
            f"{unseen_base} on the base",
        ),
    )


@_reader_of("iiwa7-robot-calibration")
def _iiwa7(folder: Path, max_left_out: float, published: Published) -> Iterator[ImportedCampaign]:
    """KUKA LBR iiwa 7 under an optical tracker, torques logged: four tables with headers.

    In each the number of the row, seven joint angles [rad], seven torques [N m] as the controller
    logs them, and the pose of the target as sixteen numbers, row by row [mm]. The controller logs
    the load on a joint; the torque that the motor exerts is its negative.
    """
    q, load = ([f"{name}{k}" for k in range(1, 8)] for name in ("q", "load"))
    T = [f"T{row}{column}" for row in range(4) for column in range(4)]
    names = ("row", *q, *load, *T)
    for name, stated in published.stated["campaigns"].items():
        file, payload_kg = published.path(stated["file"]), stated["payload_kg"]
        raw = read_tables(folder, max_left_out, {file: names}, separator=",", header=True)
        R = raw.numbers_of(T).reshape(-1, 4, 4)[:, :3, :3]
        raw = raw.take(np.linalg.det(R) > 0.0, "its axes are those of no right-handed frame")
        refuse_too_many(raw.quarantined, raw.totals, max_left_out)
        T_mm = raw.numbers_of(T).reshape(-1, 4, 4)
        wxyz = Rotation.from_matrix(T_mm[:, :3, :3]).as_quat(canonical=True, scalar_first=True)
        columns = _joint_columns("q#_deg", np.degrees(raw.numbers_of(q)))
        columns |= _joint_columns("tau#_Nm", -raw.numbers_of(load))
        columns |= _pose_columns(T_mm[:, :3, 3], wxyz)
        campaign = _campaign(
            published,
            raw,
            columns,
            name=name,
            robot="iiwa7",
            instrument="pose",
            file=file,
            kg=payload_kg,
        )
        yield replace(campaign, tool_mass_kg=payload_kg)


@_reader_of("ipa-robot-accuracy", unread=("LICENSE.md",))
def _ur10(folder: Path, _: float, published: Published) -> Iterator[ImportedCampaign]:
    """UR10 poses measured by a 6-D laser tracker, series A and C: files taken unchanged.

    Rows that cannot be used are found when the campaign is ingested.
    """
    for name, stated in published.stated["campaigns"].items():
        file, columns = stated["file"], dict(published.stated["columns"])
        for quantity, names in stated.get("u", {}).items():
            columns[quantity] = columns[quantity] | {"u": names}
        time = {"time": stated["time"]} if "time" in stated else {}
        yield ImportedCampaign(
            name=name,
            robot="ur10",
            provenance=f"{published.provenance_text(file=file)} {stated['provenance']}",
            instrument="pose",
            uncertainty_mm=stated["uncertainty_mm"],
            reference_temperature_C=stated["reference_temperature_C"],
            holdout={"last_fraction": 0.3},
            readings=AsItIs(folder / file, time | columns, folder),
            files=(file,),
            joints="commanded",
        )


@_reader_of("titan-robot-accuracy")
def _titan(folder: Path, max_left_out: float, published: Published) -> Iterator[ImportedCampaign]:
    """KUKA KR 1000 titan, three points on its end-effector: two tables with a header.

    In each the axes A1 to A6 as the controller counts them [deg], the position E of a linear axis
    [mm], three points as measured [mm] (xa1 …) and as the owner's own model has them (xn1 …), and
    their differences. The arm's description turns the axes 1, 4 and 6 the other way.
    """
    axes, points = [f"A{k}" for k in range(1, 7)], (1, 2, 3)
    measured, modelled = ([f"{axis}{by}{k}" for k in points for axis in _AXES] for by in "an")
    differences = [f"{name}{k}" for k in points for name in ("dx", "dy", "dz", "err")]
    names = (*axes, "E", *measured, *modelled, *differences)
    for name, stated in published.stated["campaigns"].items():
        file, robot = published.path(stated["file"]), stated["robot"]
        raw = read_tables(folder, max_left_out, {file: names}, separator=",", header=True)
        q_deg = raw.numbers_of(axes) * np.array([-1.0, 1.0, 1.0, -1.0, 1.0, -1.0])
        columns = {"q1_mm": raw["E"]} if robot == "titan_rail" else {}
        first = 1 + len(columns)
        columns |= {f"q{first + k}_deg": column for k, column in enumerate(q_deg.T)}
        columns |= {f"T{k}_{axis}_mm": raw[f"{axis}a{k}"] for k in points for axis in _AXES}
        off_mm = (raw.numbers_of(modelled) - raw.numbers_of(measured)).reshape(-1, 3, 3)
        campaign = _campaign(
            published,
            raw,
            columns,
            name=name,
            robot=robot,
            instrument="points",
            file=file,
            own=float(np.sqrt(np.mean(np.sum(off_mm**2, axis=2)))),
        )
        yield replace(campaign, joints="commanded")


@_reader_of("welding-motoman")
def _motoman(folder: Path, max_left_out: float, published: Published) -> Iterator[ImportedCampaign]:
    """Yaskawa Motoman MA2010 under OptiTrack: two tables a date, without headers.

    They correspond line by line: six joint angles [rad], and the pose of a rigid body on the torch,
    x, y, z [mm] and a quaternion, w first.
    """
    q = [f"q{k}_rad" for k in range(1, 7)]
    for name, stated in published.stated["campaigns"].items():
        joints, poses = published.path(stated["joints"]), published.path(stated["poses"])
        tables = {joints: q, poses: (*_POSITION, *_QUATERNION)}
        raw = read_tables(folder, max_left_out, tables, separator=",")
        wxyz = raw.numbers_of(_QUATERNION)
        length = np.linalg.norm(wxyz, axis=1)
        # A quaternion and its negative are the same rotation: the one with w >= 0, of length one.
        wxyz = wxyz / np.where(wxyz[:, :1] < 0.0, -length[:, None], length[:, None])
        columns = _joint_columns("q#_deg", np.degrees(raw.numbers_of(q)))
        columns |= _pose_columns(raw.numbers_of(_POSITION), wxyz)
        date = Path(joints).parent.name
        yield _campaign(
            published, raw, columns, name=name, robot="ma2010", instrument="pose", date=date
        )
