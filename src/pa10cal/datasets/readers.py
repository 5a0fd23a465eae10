"""The data sets that can be imported: how the tables of each are read as campaigns.

What a data set holds, where its files are published and what is assumed of it is stated in
`published/<name>.yaml`. A new data set is one more of these files, and a reader here. A table whose
columns need no change is read as it is, by `columns` of campaign.yaml.
"""

from __future__ import annotations

import csv
import difflib
import io
import re
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.campaign.own_columns import refuse_too_many
from pa10cal.campaign.raw_rows import RawRows, quarantined
from pa10cal.datasets.importing import AsItIs, DataSet, ImportedCampaign, Published
from pa10cal.errors import RawDataError
from pa10cal.input_files import open_file, read_file, reason

#: Tables of more bytes, unpacked, or more lines are none of a data set: the largest have a tenth.
_MOST_BYTES, _MOST_LINES = 32_000_000, 1_000_000
#: What a zip file that is damaged, encrypted or of another kind raises.
_BROKEN_ZIP = (
    *(zipfile.BadZipFile, zlib.error, KeyError, UnicodeDecodeError),
    *(NotImplementedError, RuntimeError, EOFError),
)
#: Descriptions of arms that are measured in data sets and are not shipped as arms of their own.
ARMS = Path(__file__).with_name("arms")
DATASETS: dict[str, DataSet] = {}

_AXES, _QUATERNION = "xyz", ("qw", "qx", "qy", "qz")
_PLACE = [f"{axis}_mm" for axis in _AXES]

_Read = Callable[[Path, float, Published], Iterator[ImportedCampaign]]


def dataset_names() -> tuple[str, ...]:
    """Return the names of all data sets."""
    return tuple(sorted(DATASETS))


def dataset_named(name: str) -> DataSet:
    """Return the data set of that name; refuse one that is not there (RawDataError)."""
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
    """Make a function the reader of a data set; see `DataSet.read`."""

    def register(read: _Read) -> _Read:
        published = Published.of(name)
        DATASETS[name] = DataSet(
            name, lambda folder, most: tuple(read(folder, most, published)), published, unread
        )
        return read

    return register


# Tables of numbers by column. A row with a field too many or too few, or with one that is no
# number, is omitted and listed with its line.


def read_bare_table(
    folder: Path,
    file: str,
    names: Sequence[str],
    *,
    separator: str | None = None,
    header: bool = False,
) -> RawRows:
    """Read a table of numbers with decimal points, a file of a data set's folder.

    Every line is a row, a blank one too: tables of one campaign belong together line by line. The
    columns are called by `names`; those of a header are not read. Without a separator blanks stand
    between the fields.

    Raises:
        RawDataError: when the file as a whole cannot be used.
    """
    path, width = folder / file, len(names)
    try:
        content = read_file(path, _MOST_BYTES, folder)
    except OSError as error:
        raise _too_much(path, reason(error)) from None
    whole = content.decode("utf-8-sig", errors="replace").rstrip()
    whole = whole.replace("\r\n", "\n").replace("\r", "\n")
    if (count := 1 + whole.count("\n")) > _MOST_LINES:
        raise _too_much(path, f"{count} lines")
    lines = whole.split("\n") if whole else []
    if not lines:
        raise _empty(f"{path}:1")
    line = np.arange(1, len(lines) + 1)[int(header) :]
    rows = [text.split(separator) for text in lines[int(header) :]]
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
    columns, text = {}, {}
    for name, fields in zip(names, words.T, strict=True):
        columns[name] = np.array(pd.to_numeric(fields, errors="coerce"), dtype=float)
        unread = np.flatnonzero(~np.isfinite(columns[name]))
        text[name] = {int(line[fits][k]): str(fields[k]) for k in unread}
    wrong_width = f"the number of fields is not {width}"
    listed = quarantined(file, line[~fits], wrong_width, widths[~fits])
    return RawRows(file, columns, line[fits], {file: len(rows)}, (), listed, text).finite(names)


def _too_much(path: Path, why: str) -> RawDataError:
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
    folder: Path, max_left_out: float, tables: Mapping[str, Sequence[str]], **written: Any
) -> RawRows:
    """Read files that belong together line by line as one: the rows that can be used in each.

    Each has columns of its own; how they are written is said as to `read_bare_table`.

    Raises:
        RawDataError: when they have different numbers of rows, or too many of one cannot be used.
    """
    read = [read_bare_table(folder, file, names, **written) for file, names in tables.items()]
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
    kept = [table.at(np.flatnonzero(np.isin(table.line, line))) for table in read]
    columns = {name: column for table in kept for name, column in table.columns.items()}
    listed = tuple(row for table in read for row in table.quarantined)
    return RawRows(read[0].file, columns, line, totals, (), listed)


def _campaign(
    published: Published,
    raw: RawRows,
    columns: Mapping[str, NDArray[np.float64]],
    said: Mapping[str, object],
    **about: Any,
) -> ImportedCampaign:
    """Return a campaign of rows of tables; `said` are words of its provenance."""
    own = ARMS / f"{about['robot']}.yaml"
    usual: dict[str, Any] = {
        "provenance": published.provenance_text(**said),
        "uncertainty_mm": published.stated["uncertainty_mm"],
        "readings": pd.DataFrame(columns),
        "files": tuple(raw.totals),
        "left_out": raw.quarantined,
        "notes": (f"{len(raw)} configurations",),
        "arm": own if own.is_file() else None,
    }
    return ImportedCampaign(**usual | about)


def _numbered(name: str, values: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return values (N, n) as columns by the numbers of joints, which stand at # in the name."""
    return {name.replace("#", str(k)): column for k, column in enumerate(values.T, start=1)}


def _pose(p_mm: NDArray[np.float64], wxyz: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return places (N, 3) and quaternions (N, 4) as columns."""
    return dict(zip((*_PLACE, *_QUATERNION), np.hstack([p_mm, wxyz]).T, strict=True))


@_reader_of("dlr-elastic-calibration")
def _justin(folder: Path, max_left_out: float, published: Published) -> Iterator[ImportedCampaign]:
    """DLR Agile Justin, one marker on each hand under Vicon: a campaign for each arm.

    A zipped table with a header: the number of the row, a list of nineteen commanded joint angles
    [rad] (torso 3, right arm 7, left arm 7, head 2), and the places of the right and of the left
    marker [m]. Lists are written as numpy prints them, over several lines. Torso, passive joint
    and arm are joints 1 to 11, the marker is the target T1.
    """
    (file,), table = published.sha256, "measurements.csv"
    try:
        with open_file(folder / file, folder) as packed, zipfile.ZipFile(packed) as archive:
            with archive.open(table) as unpacked:
                content = unpacked.read(_MOST_BYTES + 1)
            if len(content) > _MOST_BYTES:
                raise _too_much(folder / file, "its table is larger, unpacked")
            text = content.decode("utf-8")
    except OSError as error:
        raise _too_much(folder / file, reason(error)) from None
    except _BROKEN_ZIP as error:
        raise RawDataError(
            "the zipped table cannot be read",
            where=str(folder / file),
            value=str(error),
            allowed=f"a zip file with {table}",
            remedy="fetch the data set again",
        ) from None
    number = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
    try:
        rows = [
            [[float(word) for word in number.findall(field)] for field in (*row[1:3], "", "")[:2]]
            for row in list(csv.reader(io.StringIO(text)))[1:]
        ]
    except csv.Error as error:
        raise _too_much(folder / file, str(error)) from None
    if not rows:
        raise _empty(folder / file)
    good = np.array([(len(q), len(p)) == (19, 6) for q, p in rows], dtype=bool)
    raw = RawRows(table, {}, np.arange(1, len(rows) + 1), {table: len(rows)}, (), ()).take(
        good,
        "not 19 joint angles and 6 coordinates; rows are counted, not lines",
        [f"{len(rows[k][0])} and {len(rows[k][1])}" for k in np.flatnonzero(~good)],
    )
    refuse_too_many(raw.quarantined, raw.totals, max_left_out)
    values = np.array([q + p for (q, p), right in zip(rows, good, strict=True) if right])
    passive = -(values[:, 1] + values[:, 2])
    for side, first, marker in (("right", 3, 19), ("left", 10, 22)):
        q_rad = np.column_stack([values[:, :3], passive, values[:, first : first + 7]])
        columns = _numbered("q#_deg", np.degrees(q_rad))
        columns |= {f"T1_{name}": 1e3 * values[:, marker + k] for k, name in enumerate(_PLACE)}
        yield _campaign(
            published,
            raw,
            columns,
            {"side": side, "file": file},
            name=f"justin-{side}",
            robot=f"justin_{side}",
            instrument="points",
            files=(file,),
            joints="commanded",
        )


@_reader_of("faro-irb120")
def _irb120(folder: Path, max_left_out: float, published: Published) -> Iterator[ImportedCampaign]:
    """An IRB 120 and three reflectors under a FARO tracker, three more on its base.

    Tables of numbers between blanks, without headers, which belong together line by line: six joint
    angles [deg], then the place of a reflector [mm] in each, three at the flange and three on the
    base. Three zeros stand for a reflector that was not seen.
    """
    targets = ("T1", "T2", "T3", "base1", "base2", "base3")
    names = [
        [f"q{joint}_deg" for joint in range(1, 7)],
        *([f"{target}_{name}" for name in _PLACE] for target in targets),
    ]
    raw = read_tables(folder, max_left_out, dict(zip(published.sha256, names, strict=True)))
    seen = np.any([raw.numbers_of(columns) != 0.0 for columns in names[1:]], axis=2).T
    some = np.asarray(seen[:, :3].any(axis=1), dtype=bool)
    unseen = quarantined(tuple(raw.totals)[1], raw.line[~some], "no reflector was observed")
    raw, seen = raw.at(np.flatnonzero(some)), seen[some]
    flange, base = (int(part.sum()) for part in np.split(~seen, [3], axis=1))
    columns = {name: raw[name] for name in names[0]}
    for b, target in enumerate(names[1:]):
        columns |= {name: np.where(seen[:, b], raw[name], np.nan) for name in target}
    yield _campaign(
        published,
        raw,
        columns,
        {},
        name="irb120",
        robot="irb120",
        instrument="points",
        holdout={"last_fraction": 0.3},
        left_out=(*raw.quarantined, *unseen),
        notes=(
            f"{len(raw)} configurations, {flange} places not seen at the flange and {base} on the "
            "base",
        ),
    )


@_reader_of("iiwa7-robot-calibration")
def _iiwa7(folder: Path, max_left_out: float, published: Published) -> Iterator[ImportedCampaign]:
    """KUKA LBR iiwa 7 under an optical tracker, torques logged: four tables with headers.

    In each the number of the row, seven joint angles [rad], seven torques [N m] as the controller
    logs them, and the pose of the target as sixteen numbers, row by row [mm]. The controller logs
    the load on a joint; the torque that the motor exerts is its negative. The folder of each is
    named after its payload [kg].
    """
    payloads_kg = {"iiwa7-free": 0.0, "iiwa7-0kg": 0.0, "iiwa7-1250g": 1.25, "iiwa7-2500g": 2.5}
    q, tau = ([f"{name}{k}" for k in range(1, 8)] for name in ("q", "load"))
    T = [f"T{row}{column}" for row in range(4) for column in range(4)]
    for (name, kg), file in zip(payloads_kg.items(), published.sha256, strict=True):
        names = {file: ("row", *q, *tau, *T)}
        raw = read_tables(folder, max_left_out, names, separator=",", header=True)
        T_mm = raw.numbers_of(T).reshape(-1, 4, 4)
        turned = Rotation.from_matrix(T_mm[:, :3, :3]).as_quat(canonical=True, scalar_first=True)
        columns = _numbered("q#_deg", np.degrees(raw.numbers_of(q)))
        columns |= _numbered("tau#_Nm", -raw.numbers_of(tau)) | _pose(T_mm[:, :3, 3], turned)
        said = {"file": file, "kg": kg}
        about = {"name": name, "robot": "iiwa7", "instrument": "pose", "tool_mass_kg": kg}
        yield _campaign(published, raw, columns, said, **about)


@_reader_of("ipa-robot-accuracy", unread=("LICENSE.md",))
def _ur10(folder: Path, _: float, published: Published) -> Iterator[ImportedCampaign]:
    """UR10 poses measured by a 6-D laser tracker, series A and C: files that are read as they are.

    Rows that cannot be used are found when they are read.
    """
    for name, stated in published.stated["campaigns"].items():
        file, columns = stated["file"], dict(published.stated["columns"])
        for key, names in stated.get("u", {}).items():
            columns[key] = columns[key] | {"u": names}
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

    In each the axes A1 to A6 as the controller counts them [deg], the place E of a linear axis
    [mm], three points as measured [mm] (xa1 …) and as the owner's own model has them (xn1 …). The
    arm's description turns the axes 1, 4 and 6 the other way.
    """
    axes, points = [f"A{k}" for k in range(1, 7)], (1, 2, 3)
    measured, modelled = ([f"{axis}{by}{k}" for k in points for axis in _AXES] for by in "an")
    differences = [f"{name}{k}" for k in points for name in ("dx", "dy", "dz", "err")]
    names = (*axes, "E", *measured, *modelled, *differences)
    for file, robot in zip(published.sha256, ("titan", "titan_rail"), strict=True):
        raw = read_tables(folder, max_left_out, {file: names}, separator=",", header=True)
        q_deg = raw.numbers_of(axes) * np.array([-1.0, 1.0, 1.0, -1.0, 1.0, -1.0])
        columns = {"q1_mm": raw["E"]} if robot == "titan_rail" else {}
        first = 1 + len(columns)
        columns |= {f"q{first + k}_deg": column for k, column in enumerate(q_deg.T)}
        columns |= {f"T{k}_{axis}_mm": raw[f"{axis}a{k}"] for k in points for axis in _AXES}
        off_mm = (raw.numbers_of(modelled) - raw.numbers_of(measured)).reshape(-1, 3, 3)
        said = {"file": file, "own": float(np.sqrt(np.mean(np.sum(off_mm**2, axis=2))))}
        name = "titan-fixed" if robot == "titan" else "titan-rail"
        about = {"name": name, "robot": robot, "instrument": "points", "joints": "commanded"}
        yield _campaign(published, raw, columns, said, **about)


@_reader_of("welding-motoman")
def _motoman(folder: Path, max_left_out: float, published: Published) -> Iterator[ImportedCampaign]:
    """Yaskawa Motoman MA2010 under OptiTrack: two tables a date, without headers.

    They belong together line by line: six joint angles [rad], and the pose of a rigid body on the
    torch, x, y, z [mm] and a quaternion, w first.
    """
    q, files = [f"q{k}_rad" for k in range(1, 7)], tuple(published.sha256)
    for name, (joints, poses) in (("ma2010-0516", files[:2]), ("ma2010-0801", files[2:])):
        tables = {joints: q, poses: (*_PLACE, *_QUATERNION)}
        raw = read_tables(folder, max_left_out, tables, separator=",")
        wxyz = raw.numbers_of(_QUATERNION)
        length = np.linalg.norm(wxyz, axis=1)
        wxyz = wxyz / np.where(wxyz[:, :1] < 0.0, -length[:, None], length[:, None])
        columns = _numbered("q#_deg", np.degrees(raw.numbers_of(q)))
        columns |= _pose(raw.numbers_of(_PLACE), wxyz)
        said = {"date": Path(joints).parent.name}
        about = {"name": name, "robot": "ma2010", "instrument": "pose"}
        yield _campaign(published, raw, columns, said, **about)
