"""The table of poses: a campaign's readings as Parquet, and back."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pydantic import TypeAdapter
from scipy.spatial.transform import Rotation

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.campaign.csv_rows import CUT, MOST_COLUMNS, MOST_LABEL_LETTERS, column_names, read_rows
from pa10cal.campaign.description import CampaignDescription, nominal_arm
from pa10cal.campaign.raw_rows import QUATERNION, RawRows, in_radians, position_columns
from pa10cal.errors import RawDataError
from pa10cal.files.output import csv_line, csv_text
from pa10cal.fit.weighed_arm import weighed_arm
from pa10cal.input_files import open_file, reason
from pa10cal.observe.instrument import BaseTargets, MotionFound
from pa10cal.observe.joined import joined
from pa10cal.observe.observations import JointLog, Observations
from pa10cal.results.calibration import InputFinding

SCHEMA = "pa10cal-poses/1"
#: Tables of more values than this, or in more parts, are refused.
MOST_VALUES, MOST_PARTS, _BYTES_A_VALUE = 100_000_000, 200_000, 8

#: The column that says which campaign of a group a row is of, and beginnings of those that hold
#: what an instrument measured.
_CAMPAIGN, _MEASURED = "campaign", ("ball", "ee_", "d_", "shared_cov_")
#: Whether `time_s` tells time, and not an order alone; there where it does not in some row.
_TIMED = "tells_time"


def write_pose_table(
    path: Path,
    every: Observations,
    prismatic: NDArray[np.bool_],
    campaign: str,
    findings: Sequence[InputFinding] = (),
) -> None:
    """Write single readings as a Parquet table, the same bytes for the same readings.

    The file's metadata hold the name of the campaign, and what was found wrong of rows that are
    not in it.
    """
    table = pa.table(_columns(every, prismatic))
    metadata = {"schema": SCHEMA, "campaign": campaign}
    if findings:
        metadata["findings"] = json.dumps([finding.model_dump() for finding in findings])
    if every.base is not None and every.base.found is not None:
        metadata["base_motion"] = json.dumps(asdict(every.base.found))
    if targets := every.measured.R_first_target_of:
        metadata["targets"] = json.dumps({name: R.tolist() for name, R in targets.items()})
    table = table.replace_schema_metadata(metadata)
    pq.write_table(table, path, compression="zstd")


def read_observations(path: Path, description: CampaignDescription) -> Observations:
    """Read the table of poses of a campaign as single readings of all kinds, in its order.

    Raises:
        RawDataError: when the file is missing, is no such table, or is of another campaign.
    """
    table = read_pose_table(path, description.name)
    columns = {str(name): table[name].to_numpy() for name in table}
    if not description.campaigns:
        base = BaseTargets.from_columns(columns, read_base_motion(path))
        return _observations(columns, description, base)
    parts, rows = [], []
    for campaign in description.campaigns:
        here = np.flatnonzero(columns[_CAMPAIGN] == campaign.name)
        # Without the columns of other instruments.
        own = {
            name: values[here]
            for name, values in columns.items()
            if not (name.startswith(_MEASURED) and np.isnan(values[here].astype(float)).all())
        }
        parts.append(_observations(own, campaign))
        rows.append(here)
    known = json.loads(_metadata(path).get(b"targets", b"{}"))
    targets = {name: np.array(R) for name, R in known.items()}
    whole = joined(parts, tuple(campaign.name for campaign in description.campaigns), targets)
    return whole.take(np.argsort(np.concatenate(rows), kind="stable"))


def arm_of(
    campaign: CampaignDescription, folder: Path, every: Observations, arm: Arm | None = None
) -> Arm:
    """Return the arm of a campaign with weights, from the folder that describes it.

    Its single readings weigh it where torques were logged; the arm may have been read already.

    Raises:
        ArmError: when there is no arm of that name, or its file cannot be used.
        SettingsError: when a key of its file is unknown, missing or of the wrong kind.
    """
    total_kg = None if campaign.masses is None else campaign.masses.total_kg
    arm = nominal_arm(campaign, folder) if arm is None else arm
    return weighed_arm(arm, every, campaign.payload, total_kg)


def as_in_table(
    every: Observations, prismatic: NDArray[np.bool_], description: CampaignDescription
) -> Observations:
    """Return single readings of a campaign as they are read back from its table.

    An orientation is a quaternion there: what is calculated with it has other last digits.
    """
    columns = {name: np.asarray(values) for name, values in _columns(every, prismatic).items()}
    found = None if every.base is None else every.base.found
    return _observations(columns, description, BaseTargets.from_columns(columns, found))


def read_base_motion(path: Path, within: Path | None = None) -> MotionFound | None:
    """Read how the motion of targets on the base was found; None where there are none."""
    text = _metadata(path, within).get(b"base_motion")
    return None if text is None else TypeAdapter(MotionFound).validate_json(text)


def read_findings(path: Path) -> tuple[InputFinding, ...]:
    """Read what was found wrong of rows that are not in a table of poses."""
    findings = json.loads(_metadata(path).get(b"findings", b"[]"))
    return tuple(InputFinding(**each) for each in findings)


def _metadata(path: Path, within: Path | None = None) -> Mapping[bytes, bytes]:
    with open_file(path, within) as file:
        return pq.read_schema(file).metadata or {}


def _read_parquet(file: IO[bytes], path: Path) -> pa.Table:
    """Return a table; text that stands in many rows is looked at before each gets its own."""
    promised = pq.read_metadata(file)
    _refuse_larger(promised, path)
    schema = promised.schema.to_arrow_schema()
    if twice := sorted({name for name in schema.names if schema.names.count(name) > 1}):
        raise pa.ArrowInvalid(f"two columns are called {twice[0]}")
    texts = [name for name in schema.names if pa.types.is_string(schema.field(name).type)]
    file.seek(0)
    table = pq.read_table(file, read_dictionary=texts)
    for name in texts:
        column = table[name]
        if not pa.types.is_dictionary(column.type):
            continue
        words = [word for part in column.chunks for word in part.dictionary.to_pylist() if word]
        if (longest := max(map(len, words), default=0)) * len(column) > MOST_LABEL_LETTERS:
            raise RawDataError(
                f"a label under {name} has {longest} letters",
                where=str(path),
                allowed="short labels, such as P012",
                remedy="run pa10cal ingest again",
            )
        at = table.schema.get_field_index(name)
        table = table.set_column(at, schema.field(name), column.cast(schema.field(name).type))
    return table


def _refuse_larger(promised: pq.FileMetaData, path: Path) -> None:
    """Refuse a table by what its header promises, before anything of it is unpacked."""
    rows, columns, groups = promised.num_rows, promised.num_columns, promised.num_row_groups
    if columns <= MOST_COLUMNS and groups * columns <= MOST_PARTS:
        of_groups = [promised.row_group(k) for k in range(groups)]
        values = max(
            rows * columns,
            sum(of.num_rows for of in of_groups) * columns,
            sum(of.total_byte_size for of in of_groups) // _BYTES_A_VALUE,
        )
        if values <= MOST_VALUES:
            return
    promises = f"{rows} rows, {columns} columns, {groups} groups of rows"
    raise RawDataError(
        "the table of poses is larger than is read",
        where=str(path),
        value=promises,
        allowed=f"at most {MOST_VALUES} values in {MOST_COLUMNS} columns",
        remedy="run pa10cal ingest again",
    )


def read_pose_table(
    path: Path, campaign: str | None = None, within: Path | None = None
) -> pd.DataFrame:
    """Read the table of poses, `within` a folder; see the column list in docs/results.md.

    The name of the campaign is in `table.attrs["campaign"]`; it must be the one given, if any.

    Raises:
        RawDataError: when the file is missing, is no such table, or is of another campaign.
    """
    try:
        with open_file(path, within) as file:
            table = _read_parquet(file, path)
    except (OSError, ValueError, pa.ArrowException) as error:
        raise _no_table(path, " ".join(reason(error).split())) from None
    metadata = table.schema.metadata or {}
    schema = metadata.get(b"schema", b"none").decode("utf-8", "replace")
    if schema != SCHEMA:
        raise _no_table(path, f"schema {schema}")
    frame: pd.DataFrame = table.to_pandas()
    found = frame.attrs["campaign"] = metadata.get(b"campaign", b"").decode("utf-8", "replace")
    if campaign is not None and found != campaign:
        raise RawDataError(
            "the table of poses is of another campaign",
            where=str(path),
            value=found,
            allowed=f"campaign {campaign!r}",
            remedy="give the table that ingest made of this campaign",
        )
    return frame


def _no_table(path: Path, value: str) -> RawDataError:
    return RawDataError(
        "the table of poses cannot be read",
        where=str(path),
        value=value,
        allowed=f"a Parquet file of schema {SCHEMA}",
        remedy="run pa10cal ingest again",
    )


def _observations(
    columns: Mapping[str, NDArray[Any]],
    description: CampaignDescription,
    base: BaseTargets | None = None,
) -> Observations:
    """Return the readings of one campaign from columns."""
    n = sum(name.startswith("tau") and name.endswith("_u_Nm") for name in columns)
    prismatic = np.array([f"q{joint}_m" in columns for joint in range(1, n + 1)])
    of_joints = {
        quantity: np.column_stack([columns[name] for name in names]).astype(float)
        for quantity, names in _joint_columns(prismatic).items()
    }
    states = PoseStates(
        q_rad=of_joints["q"],
        tau_Nm=of_joints["tau"],
        arrival=of_joints["arrival"],
        load_N=columns["load_N"].astype(float),
        temperature_C=columns["temperature_C"].astype(float),
        time_s=columns["time_s"].astype(float),
        timed=columns[_TIMED].astype(bool) if _TIMED in columns else None,
    )
    return Observations(
        pose=columns["pose"].astype(str),
        states=states,
        measured=description.instrument.type.from_columns(columns, description.stated),
        kind=columns["kind"].astype(str),
        repeat=columns["repeat"].astype(np.int64),
        readings=np.ones(len(columns["pose"]), dtype=np.int64),
        log=JointLog(of_joints["q_u"], of_joints["tau_u"], columns["dwell_samples"].astype(int)),
        base=base,
    )


def _columns(every: Observations, prismatic: NDArray[np.bool_]) -> dict[str, object]:
    states = every.states
    unknown = np.full((len(every), states.n), np.nan)
    log = every.log or JointLog(unknown, unknown, np.zeros(len(every), dtype=np.int64))
    columns: dict[str, object] = {
        "kind": every.kind.astype(object),
        "pose": every.pose.astype(object),
        "load_N": states.load_N,
        "repeat": every.repeat,
        "time_s": states.time_s,
        **({} if states.timed is None else {_TIMED: states.timed}),
    }
    arrival: NDArray[Any] = states.arrival.astype(np.int8)
    of_joints = (states.q_rad, log.q_u, states.tau_Nm, log.tau_u, arrival)
    for names, values in zip(_joint_columns(prismatic).values(), of_joints, strict=True):
        columns |= dict(zip(names, values.T, strict=True))
    if states.campaign is not None:
        campaigns = np.array([name for name, _ in every.measured.campaigns], dtype=object)
        columns[_CAMPAIGN] = campaigns[states.campaign]
    columns["temperature_C"] = states.temperature_C
    columns["dwell_samples"] = log.samples
    watched = {} if every.base is None else every.base.to_columns()
    return columns | every.measured.to_columns() | watched


def _joint_columns(prismatic: NDArray[np.bool_]) -> dict[str, list[str]]:
    """Return the columns of what is known of each joint; m in place of rad of one that slides."""
    units = list(enumerate(np.where(prismatic, "m", "rad"), start=1))
    return {
        "q": [f"q{k}_{unit}" for k, unit in units],
        "q_u": [f"q{k}_u_{unit}" for k, unit in units],
        "tau": [f"tau{k}_Nm" for k, _ in units],
        "tau_u": [f"tau{k}_u_Nm" for k, _ in units],
        "arrival": [f"s{k}" for k, _ in units],
    }


# Lists of poses for a model: joint positions to predict, targets to compensate, and the answers.
#
# Nothing of such a list is dropped: a row that cannot be read refuses the file.

_PLACE = ("x_mm", "y_mm", "z_mm")
_OF_POSE = ("load_N", "temperature_C", "time_s")
_MM = 1e-3
#: Quaternions are written with a few digits; further from length one they are something else.
_UNIT = 1e-2
#: Targets are no nearer to the base than this all together: they are in metres then [mm].
_NEAREST_MM = 10.0
#: No joint turns further [deg], nor slides [mm].
_FARTHEST = 1e5
_JOINT = re.compile(r"q\d+_\w+")


@dataclass(frozen=True, kw_only=True)
class JointList:
    """Joint positions as a file lists them."""

    ids: NDArray[np.str_]  # (N,) names of the rows
    # (N, n) joint positions [rad, m]; of targets those near which the answer should be, nan where
    # none are given
    q: Array
    load_N: Array  # (N,) external loads; nan where none is given
    arrival: Array  # (N, n) direction of arrival of each joint, -1, 0 or 1; nan where not given
    temperature_C: Array  # (N,) temperatures; nan where none is given
    time_s: Array  # (N,) times on the campaign's clock; nan where none is given
    unused: tuple[str, ...] = ()  # columns that are not read


@dataclass(frozen=True, kw_only=True)
class TargetList(JointList):
    """Targets as a file lists them."""

    T: Array  # (N, 4, 4) poses [m]


def read_joints(path: Path, prismatic: NDArray[np.bool_]) -> JointList:
    """Read `id,q1_deg,…` (`qk_mm` of a joint that slides), and what is given of each pose.

    `load_N`, `temperature_C`, `time_s` and `arrival1`, … may be there, and blank.

    Raises:
        RawDataError: naming file and line, when a column is missing or of another arm, or a row
            cannot be read.
    """
    _, listed = _read(path, prismatic, position_columns(prismatic))
    return listed


def read_targets(path: Path, prismatic: NDArray[np.bool_]) -> TargetList:
    """Read `id,x_mm,y_mm,z_mm,qw,qx,qy,qz[,q1_deg,…]`, seeds may be blank; others as of joints.

    Raises:
        RawDataError: see `read_joints`; also for an orientation that is none, and for metres.
    """
    raw, listed = _read(path, prismatic, [*_PLACE, *QUATERNION])
    p_mm, quaternion = raw.numbers_of(_PLACE), raw.numbers_of(QUATERNION)
    length = np.linalg.norm(quaternion, axis=1)
    off = np.abs(length - 1.0) > _UNIT
    if off.any():
        row = int(np.argmax(off))
        raise RawDataError(
            "the quaternion is not of length one",
            where=f"{path}:{raw.line[row]}",
            value=f"{length[row]:.6g}",
            allowed="qw, qx, qy, qz, whose squares add up to 1",
            remedy="check the columns' order, or write more digits",
        )
    if (furthest := float(np.abs(p_mm).max())) < _NEAREST_MM:
        raise RawDataError(
            "x_mm, y_mm, z_mm: no target is further than a hundredth of a metre from the base",
            where=f"{path}:{raw.line[0]}",
            value=furthest,
            allowed="millimetres in the robot's base frame",
            remedy="multiply by 1000 if these are metres",
        )
    T = np.tile(np.eye(4), (len(raw), 1, 1))
    T[:, :3, 3] = _MM * p_mm
    T[:, :3, :3] = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    return TargetList(**vars(listed), T=T)


def _read(
    path: Path, prismatic: NDArray[np.bool_], required: Sequence[str]
) -> tuple[RawRows, JointList]:
    """Read a list whose every row can be used: its rows, and what both kinds have in common."""
    joints = position_columns(prismatic)
    sides = [f"arrival{joint}" for joint in range(1, len(joints) + 1)]
    others = [name for name in column_names(path) if _JOINT.fullmatch(name) and name not in joints]
    together = () if joints[0] in required else joints
    raw = read_rows(path, ["id", *required], [*_OF_POSE, *sides], together, repeats=True)
    if others:
        raise RawDataError(
            "a column of another arm, or in another unit",
            where=f"{path}:1",
            value=others[0],
            allowed=", ".join(joints),
            remedy="give a model of the same arm, or rename the column",
        )
    raw = raw.finite(required).finite([*together, *_OF_POSE, *sides], may_be_blank=True)
    if raw.quarantined:
        first = min(raw.quarantined, key=lambda row: row.line)
        remedy = "correct the row, or remove it"
        if first.reason == CUT:
            remedy = "end it with a line break if it is whole"
        where = f"{path}:{first.line}"
        raise RawDataError(
            first.reason,
            where=where,
            value=first.value or None,
            allowed="rows that can all be used: none is dropped",
            remedy=remedy,
        )
    q, arrival = raw.numbers_of(joints), raw.numbers_of(sides)

    given = np.isfinite(q)
    partly = given.any(axis=1) & ~given.all(axis=1)
    if partly.any():
        row = int(np.argmax(partly))
        raise RawDataError(
            "the seed lacks joints",
            where=f"{path}:{raw.line[row]}",
            value=joints[int(np.argmin(given[row]))],
            allowed="all joints, or none",
            remedy="complete the row, or leave its joints blank",
        )
    if len(far := np.argwhere(np.abs(q) > _FARTHEST)):
        row, joint = far[0]
        raise RawDataError(
            f"{joints[joint]} is no position of a joint",
            where=f"{path}:{raw.line[row]}",
            value=float(q[row, joint]),
            allowed=f"up to {_FARTHEST:g}",
            remedy="check the unit",
        )
    if len(wrong := np.argwhere(~np.isnan(arrival) & ~np.isin(arrival, (-1.0, 0.0, 1.0)))):
        row, joint = wrong[0]
        raise RawDataError(
            f"{sides[joint]} is no direction of arrival",
            where=f"{path}:{raw.line[row]}",
            value=float(arrival[row, joint]),
            allowed="-1 or 1, the sign of the joint's last motion; 0 or blank where it is not "
            "known",
            remedy="correct the value",
        )
    return raw, JointList(
        ids=raw.text_of("id"),
        q=in_radians(q, prismatic),
        arrival=arrival,
        **dict(zip(_OF_POSE, raw.numbers_of(_OF_POSE).T, strict=True)),
        unused=raw.unused,
    )


def poses_text(
    ids: NDArray[np.str_], T: Array, columns: Mapping[str, NDArray[Any]], *, header: bool = True
) -> str:
    """Return poses (N, 4, 4) as `id,x_mm,y_mm,z_mm,qw,qx,qy,qz` and further columns (N,).

    Rows that follow others have no header.
    """
    q = Rotation.from_matrix(T[:, :3, :3]).as_quat(canonical=True, scalar_first=True)
    numbers = [
        (name, values, ".9f") for name, values in zip(_PLACE, T[:, :3, 3].T / _MM, strict=True)
    ]
    numbers += [(name, values, ".12f") for name, values in zip(QUATERNION, q.T, strict=True)]
    return _answers(ids, numbers, columns, header=header)


def commands_text(
    ids: NDArray[np.str_],
    q: Array,
    prismatic: NDArray[np.bool_],
    columns: Mapping[str, NDArray[Any]],
    *,
    header: bool = True,
) -> str:
    """Return joint positions (N, n) as `id,q1_deg,…` and further columns (N,).

    Rows that follow others have no header.
    """
    positions, names = np.where(prismatic, q / _MM, np.degrees(q)), position_columns(prismatic)
    numbers = [(name, values, ".10f") for name, values in zip(names, positions.T, strict=True)]
    return _answers(ids, numbers, columns, header=header)


def _answers(
    ids: NDArray[np.str_],
    numbers: Sequence[tuple[str, Array, str]],
    columns: Mapping[str, NDArray[Any]],
    *,
    header: bool = True,
) -> str:
    """Return a table of a row an id: an id is one cell, whatever a user's file calls it."""
    cells = [[format(value, form) for value in values] for _, values, form in numbers]
    cells += [list(map(_field, values)) for values in columns.values()]
    names = ["id", *(name for name, _, _ in numbers), *columns]
    rows = zip(map(str, ids), *cells, strict=True)
    return csv_text(names, rows) if header else "".join(map(csv_line, rows))


def _field(value: object) -> str:
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else f"{float(value):.9f}"
    return str(value)
