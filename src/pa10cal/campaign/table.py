"""The table of poses: a campaign's single readings as a Parquet file, written and read."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pydantic import TypeAdapter

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Mask
from pa10cal.campaign.csv_rows import MOST_COLUMNS, MOST_LABEL_LETTERS
from pa10cal.campaign.description import CampaignDescription, nominal_arm
from pa10cal.errors import RawDataError
from pa10cal.fit.weighed_arm import weighed_arm
from pa10cal.input_files import open_file, reason
from pa10cal.observe.base_targets import BaseTargets, MotionFound
from pa10cal.observe.joined import concatenated
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
#: Columns of a joint, with its number.
_OF_JOINT = re.compile(r"(?:q|tau|s)(\d+)(?:_|$)")


def write_pose_table(
    path: Path,
    every: Observations,
    prismatic: Mask,
    campaign: str,
    findings: Sequence[InputFinding] = (),
) -> None:
    """Write single readings as a Parquet table, the same bytes for the same readings.

    The file's metadata hold the name of the campaign, and findings on rows that are not in it.
    """
    table = pa.table(_columns(every, prismatic))
    metadata = {"schema": SCHEMA, "campaign": campaign}
    if findings:
        metadata["findings"] = json.dumps([finding.model_dump() for finding in findings])
    if every.base is not None and every.base.found is not None:
        metadata["base_motion"] = json.dumps(asdict(every.base.found))
    if targets := every.measured.R_first_target_of:
        metadata["targets"] = json.dumps({name: R.tolist() for name, R in targets.items()})
    if stand_m := every.measured.p_first_instr_of:
        metadata["instruments"] = json.dumps({name: p_m.tolist() for name, p_m in stand_m.items()})
    table = table.replace_schema_metadata(metadata)
    pq.write_table(table, path, compression="zstd")


def read_observations(path: Path, description: CampaignDescription) -> Observations:
    """Read the table of poses of a campaign as single readings of all kinds, in its order.

    Raises:
        RawDataError: when the file is missing, is no such table, or is of another campaign.
    """
    try:
        return _read_observations(path, description)
    except KeyError as error:
        raise _no_table(path, f"no column {error.args[0]}") from None


def _read_observations(path: Path, description: CampaignDescription) -> Observations:
    """Read the table of poses; KeyError when it lacks a column."""
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
    metadata = _metadata(path)
    targets, stand_m = (
        {name: np.array(known) for name, known in json.loads(metadata.get(key, b"{}")).items()}
        for key in (b"targets", b"instruments")
    )
    names = tuple(campaign.name for campaign in description.campaigns)
    whole = concatenated(parts, names, targets, stand_m)
    return whole.take(np.argsort(np.concatenate(rows), kind="stable"))


def arm_of(
    campaign: CampaignDescription, folder: Path, every: Observations, arm: Arm | None = None
) -> Arm:
    """Return the arm of a campaign with masses, from the folder that describes it.

    Logged torques in its single readings determine the masses; the arm may have been read already.

    Raises:
        ArmError: when there is no arm of that name, or its file cannot be used.
        SettingsError: when a key of its file is unknown, missing or of the wrong kind.
    """
    total_kg = None if campaign.masses is None else campaign.masses.total_kg
    arm = nominal_arm(campaign, folder) if arm is None else arm
    return weighed_arm(arm, every, campaign.payload, total_kg)


def as_in_table(
    every: Observations, prismatic: Mask, description: CampaignDescription
) -> Observations:
    """Return single readings of a campaign exactly as they are read back from its table.

    Orientations are quaternions there, so that results differ in their last digits.
    """
    columns = {name: np.asarray(values) for name, values in _columns(every, prismatic).items()}
    found = None if every.base is None else every.base.found
    return _observations(columns, description, BaseTargets.from_columns(columns, found))


def read_base_motion(path: Path, within: Path | None = None) -> MotionFound | None:
    """Read the motion found by targets on the base; None where there is none."""
    text = _metadata(path, within).get(b"base_motion")
    return None if text is None else TypeAdapter(MotionFound).validate_json(text)


def read_findings(path: Path) -> tuple[InputFinding, ...]:
    """Read the findings on rows that are not in a table of poses."""
    findings = json.loads(_metadata(path).get(b"findings", b"[]"))
    return tuple(InputFinding(**each) for each in findings)


def _metadata(path: Path, within: Path | None = None) -> Mapping[bytes, bytes]:
    with open_file(path, within) as file:
        return pq.read_schema(file).metadata or {}


def _read_parquet(file: IO[bytes], path: Path) -> pa.Table:
    """Return the table; labels are checked for length while they are still stored once each."""
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
    """Refuse a table that is too large by its header, before any of it is unpacked."""
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
    raise RawDataError(
        "the table of poses is larger than is read",
        where=str(path),
        value=f"{rows} rows, {columns} columns, {groups} groups of rows",
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
    n = max((int(found[1]) for name in columns if (found := _OF_JOINT.match(name))), default=0)
    prismatic = np.array([f"q{joint}_m" in columns for joint in range(1, n + 1)])
    of_joints = {
        quantity: np.column_stack([columns[name] for name in names]).astype(float)
        for quantity, names in _joint_columns(prismatic).items()
        if quantity != "q_u_rounded" or set(names) <= columns.keys()
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
        log=JointLog(
            of_joints["q_u"],
            of_joints["tau_u"],
            columns["dwell_samples"].astype(int),
            of_joints.get("q_u_rounded"),
        ),
        base=base,
    )


def _columns(every: Observations, prismatic: Mask) -> dict[str, object]:
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
    of_joints = (states.q_rad, log.q_u, log.q_u_rounded, states.tau_Nm, log.tau_u, arrival)
    for names, values in zip(_joint_columns(prismatic).values(), of_joints, strict=True):
        if values is not None:
            columns |= dict(zip(names, values.T, strict=True))
    if states.campaign is not None:
        campaigns = np.array([name for name, _ in every.measured.campaigns], dtype=object)
        columns[_CAMPAIGN] = campaigns[states.campaign]
    columns["temperature_C"] = states.temperature_C
    columns["dwell_samples"] = log.samples
    watched = {} if every.base is None else every.base.to_columns()
    return columns | every.measured.to_columns() | watched


def _joint_columns(prismatic: Mask) -> dict[str, list[str]]:
    """Return the columns of each joint by quantity, in m instead of rad for prismatic joints."""
    units = list(enumerate(np.where(prismatic, "m", "rad"), start=1))
    return {
        "q": [f"q{k}_{unit}" for k, unit in units],
        "q_u": [f"q{k}_u_{unit}" for k, unit in units],
        "q_u_rounded": [f"q{k}_u_rounded_{unit}" for k, unit in units],
        "tau": [f"tau{k}_Nm" for k, _ in units],
        "tau_u": [f"tau{k}_u_Nm" for k, _ in units],
        "arrival": [f"s{k}" for k, _ in units],
    }
