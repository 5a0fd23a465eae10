"""Proposes a campaign.yaml for files as they are, by headers, numbers and the nominal arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.campaign.bounds import in_words
from pa10cal.campaign.column_names import unit_of
from pa10cal.campaign.description import DESCRIPTION_FILE, SCHEMA, CampaignDescription
from pa10cal.campaign.file_roles import follows_contract, refuse_unrecognised, roles_of_file
from pa10cal.campaign.headerless import (
    is_headerless,
    labels_of_both,
    logs_by_arm,
    of_rows_of_targets,
    of_the_arm,
    refuse_untold,
    roles_by_arm,
)
from pa10cal.campaign.joint_positions import in_radians, position_columns
from pa10cal.campaign.log_labels import shared_labels
from pa10cal.campaign.nominal_fit import off_computed_m, placed_by_points
from pa10cal.campaign.own_columns import FileColumns
from pa10cal.campaign.proposed_columns import ProposedColumns
from pa10cal.campaign.recognise import Roles, deviations_of
from pa10cal.campaign.row_targets import labels_without_targets, named_in_other_log
from pa10cal.campaign.sniffing import Sniffed, rows_at
from pa10cal.campaign.two_logs import LABELS, TwoLogs
from pa10cal.errors import RawDataError
from pa10cal.options import IngestOptions
from pa10cal.rules import STANDS
from pa10cal.settings_reading import parse_section

#: Columns of the contract that are read wherever they are.
_CONTRACT_ALONE = ("time_s", "kind", "pose", "load_N", "repeat", "temperature_C")
#: Places move as the arm does if it leaves less than this part of their spread.
_EXPLAINED = 0.3
#: Standard uncertainty of the instrument that is proposed where the file states none.
ASSUMED_MM = 0.05


@dataclass(frozen=True)
class ColumnsProposal:
    """A proposed campaign.yaml."""

    content: dict[str, Any]  # of campaign.yaml
    checks: tuple[str, ...]  # what the user should check or fill in, one sentence each
    read_as: tuple[str, ...]  # every column of the files, and what it is read as
    known: tuple[str, ...] = ()  # the known format of each file that has one, and what it holds


def propose(
    sniffed: Sniffed,
    file: str,
    name: str,
    robot: str,
    arm: Arm | None,
    joint_names: Sequence[str] = (),
) -> ColumnsProposal:
    """Propose a campaign.yaml for a file.

    Where the arm is not known (None), units and conventions follow from the header and the size of
    the numbers alone. `joint_names` are the joints' names in the arm's description, if any.

    Raises:
        RawDataError: when no joint positions, or nothing that was measured, are recognised.
    """
    roles = roles_of_file(sniffed, None if arm is None else len(arm.axes_slide), joint_names)
    if arm is not None and is_headerless(sniffed):
        by_arm = roles_by_arm((roles, sniffed), (roles, sniffed), arm)
        roles = by_arm.of_joints if by_arm else of_rows_of_targets(roles, sniffed, arm)
        if not roles.joints or not roles.positions:
            refuse_untold([(sniffed, Path(file))])
    by_name = roles
    if arm is not None and roles.positions and not roles.joints:
        by_arm = roles_by_arm((roles, sniffed), (roles, sniffed), arm)
        roles = by_arm.of_joints if by_arm else roles
    if arm is not None:
        roles = of_the_arm(roles, sniffed, arm, joint_names)
    refuse_unrecognised(roles, sniffed, file)
    making = _without_computed_places(ProposedColumns(sniffed, roles, arm), joint_names)
    if roles.joints != by_name.joints:
        making.checks.append(f"joints: {roles.joints[0]} …, by the nominal arm: no others agree")
    columns = making.joints() | making.readings(making.T_base_ee)
    columns |= making.without_numbers_of_rows(columns, making.T_base_ee)
    return _proposal(making, {"poses": (file, sniffed, columns)}, name, robot, arm)


def _without_computed_places(
    making: ProposedColumns, joint_names: Sequence[str]
) -> ProposedColumns:
    """Return a proposal without places that the controller computes from the joints, and note it.

    They stay, with another note, where no other place moves as the arm does.
    """
    tried = replace(making, checks=[])
    tried.joints()
    computed = {} if tried.T_base_ee is None else _computed(tried, tried.T_base_ee)
    if not computed:
        return making
    dropped = [name for names in computed for name in names]
    dropped += [] if making.roles.attitude is None else making.roles.attitude[0]
    rest = making.sniffed.without(dropped)
    found = roles_of_file(rest, len(making.roles.joints), joint_names)
    found = replace(found, joints=making.roles.joints, torques=making.roles.torques)
    other = replace(tried, sniffed=rest, roles=found)
    first, off_m = next(iter(computed.items()))
    what = (
        f"what a controller computes from the joints ({1e3 * off_m:.2g} mm from the nominal arm in "
        "its own base)"
    )
    if found.positions and _moves_as_arm(other):
        taken = ", ".join(next(iter(found.positions.values())))
        note = f"position: {taken} taken, as {', '.join(first)} are {what}"
        return replace(making, sniffed=rest, roles=found, checks=[note])
    deviations = deviations_of(making.sniffed.names)
    if len(deviations) == 1:
        label = next(each for each, names in making.roles.positions.items() if names == first)
        summed = replace(
            making.roles,
            positions={label: first},
            attitude=None,
            deviations=(first, deviations[0]),
        )
        note = (
            f"position: {', '.join(first)} are {what}, so {', '.join(deviations[0])} are added, "
            "which are taken for what was measured less that; deviation_sign: -1 if they are the "
            "reverse: the nominal arm agrees with both alike"
        )
        return replace(making, roles=summed, checks=[note])
    note = (
        f"position: {', '.join(first)} seem to be {what}, which calibrates nothing: name the "
        "columns that an instrument measured"
    )
    return replace(making, checks=[note])


def _computed(making: ProposedColumns, T_base_ee: Array) -> dict[tuple[str, ...], float]:
    """Return the places that a controller computed, by their columns, and how far off they are."""
    off_m = {
        names: off_computed_m(T_base_ee, p_m) for names, p_m in making.places_m(T_base_ee).items()
    }
    return {names: each for names, each in off_m.items() if each is not None}


def _moves_as_arm(making: ProposedColumns) -> bool:
    """Return whether the first place moves as the nominal arm does, or inverse poses do."""
    T_base_ee = making.T_base_ee
    places = {} if T_base_ee is None else making.places_m(T_base_ee)
    if T_base_ee is None or not places:
        return False
    if making.readings(T_base_ee).get("rotation", {}).get("inverse") == "pose":
        return True
    p_m = next(iter(places.values()))
    known = np.isfinite(p_m).all(axis=1) & np.isfinite(T_base_ee).all(axis=(1, 2))
    located = placed_by_points(T_base_ee[known], p_m[known, None])
    spread_m = float(np.sqrt(np.nanvar(p_m, axis=0).sum()))
    return located is not None and located.scatter_m < _EXPLAINED * spread_m


def propose_two_logs(
    logs: tuple[Sniffed, Sniffed],
    files: tuple[Path, Path],
    name: str,
    robot: str,
    arm: Arm | None,
    joint_names: Sequence[str] = (),
) -> ColumnsProposal:
    """Propose a campaign.yaml for a log of joints and a log of readings, in either order.

    The logs are joined by a first proposal, in which readings are points. The nominal arm, if it is
    known, then determines units and conventions at the joint positions of each reading.

    Raises:
        RawDataError: when neither has joint positions, or the other nothing that was measured.
    """
    count = None if arm is None else len(arm.axes_slide)
    both = [
        (roles_of_file(log, count, joint_names), log, file)
        for log, file in zip(logs, files, strict=True)
    ]
    if arm is not None and any(is_headerless(log) for _, log, _ in both):
        both = logs_by_arm(both, arm)
        if not any(roles.joints for roles, *_ in both):
            refuse_untold([(log, file) for _, log, file in both])
    if _readings_first(both):
        both.reverse()
    (joint_roles, joints_log, joints_file), (reading_roles, readings_log, readings_file) = both
    refuse_unrecognised(joint_roles, joints_log, joints_file.name, measured=True)
    reading_roles = replace(reading_roles, joints=(), torques=())
    refuse_unrecognised(
        replace(reading_roles, joints=joint_roles.joints), readings_log, readings_file.name
    )
    labels = _labels_of_logs(joint_roles, joints_log, reading_roles, readings_log)
    whole_labels = False
    if labels is not None:
        joint_label, reading_label = labels
        joint_roles = replace(joint_roles, single={**joint_roles.single, "pose": joint_label})
        reading_roles = replace(
            reading_roles, single={**reading_roles.single, "pose": reading_label}
        )
        found = np.isin(readings_log.words(reading_label), joints_log.words(joint_label))
        whole_labels = bool(found.mean() > 0.5)
    joints = ProposedColumns(joints_log, joint_roles, arm)
    readings = ProposedColumns(
        readings_log, reading_roles, arm, joints.checks, whole_labels=whole_labels
    )
    files_read: dict[str, Any] = {"joints": (joints_file.name, joints_log, joints.joints())}
    T_base_ee = None
    if arm is not None:
        # First as points, whose unit and place need no convention.
        of_points = replace(reading_roles, attitude=None)
        points = replace(readings, roles=of_points, checks=[]).readings(None)
        as_points = files_read | {"readings": (readings_file.name, readings_log, points)}
        content = _proposal(joints, as_points, name, robot, arm).content
        lines, T_known = _at_joints(content, (joints_file, readings_file), arm)
        if not set(lines) <= set(readings_log.lines):
            # Of a stream, the rows that stand for a dwell.
            readings = replace(readings, sniffed=rows_at(readings_file, readings_log, lines))
        if lines:
            row_of_line = {line: row for row, line in enumerate(readings.sniffed.lines)}
            T_base_ee = np.full((len(row_of_line), 4, 4), np.nan)
            T_base_ee[[row_of_line[line] for line in lines]] = T_known
    measured = readings.readings(T_base_ee)
    if "pose" not in files_read["joints"][2]:
        measured |= readings.without_numbers_of_rows(measured, T_base_ee)
    if len(reading_roles.positions) == 1 and "target" not in measured:
        readings.checks += named_in_other_log(joints_log, joints_file.name, readings_file.name)
    files_read["readings"] = (readings_file.name, readings_log, measured)
    return _proposal(readings, files_read, name, robot, arm)


def _readings_first(both: Sequence[tuple[Roles, Sniffed, Path]]) -> bool:
    """Return whether the first log is that of readings: by known formats, else it lacks joints."""
    first, second = (log.format.measured if log.format else None for _, log, _ in both)
    if first is None and second is None:
        return not both[0][0].joints
    return first is True or second is False


def _labels_of_logs(
    joint_roles: Roles, joints_log: Sniffed, reading_roles: Roles, readings_log: Sniffed
) -> tuple[str, str] | None:
    """Return the columns of labels that both logs share, targets in labels disregarded."""
    joint_texts, reading_texts = (
        {name: words for name, words in log.texts.items() if name not in roles.times}
        for roles, log in ((joint_roles, joints_log), (reading_roles, readings_log))
    )
    without_targets = labels_without_targets(readings_log, reading_roles)
    labels = (
        shared_labels(joint_texts, reading_texts)
        or shared_labels(joint_texts, without_targets)
        or labels_of_both(joints_log, readings_log)
    )
    logs = (joint_roles, joints_log), (reading_roles, readings_log)
    times = [ProposedColumns(log, roles, None).names_of_time() for roles, log in logs]
    if labels is None or any(label in read for label, read in zip(labels, times, strict=True)):
        return None  # a time that is read as such is no label, too
    return labels


def _at_joints(
    content: Mapping[str, Any], files: Sequence[Path], arm: Arm
) -> tuple[list[int], Array]:
    """Return the lines of K readings whose joints are known, and their nominal end (K, 4, 4)."""
    keys = {key: value for key, value in content.items() if key != "schema"}
    keys["columns"] = {
        key: {name: value for name, value in columns.items() if name not in ("temperature", "kind")}
        for key, columns in keys["columns"].items()
    }
    description = parse_section(CampaignDescription, keys, where=DESCRIPTION_FILE)
    try:
        two = TwoLogs.of(description, files[0].parent, arm, IngestOptions())
        two = replace(two, joints=replace(two.joints, path=files[0]))
        two = replace(two, readings=replace(two.readings, path=files[1]))
        raw = two.read([*LABELS[:-1], *two.measured_columns.names])
    except RawDataError:
        return [], np.zeros((0, 4, 4))
    axes = raw.numbers_of(position_columns(arm.axes_slide))
    q = arm.coupling.to_joints(in_radians(axes, arm.axes_slide))
    return raw.line.tolist(), Chain.of(arm).forward(q)


def _proposal(
    making: ProposedColumns,
    files: Mapping[str, tuple[str, Sniffed, dict[str, Any]]],
    name: str,
    robot: str,
    arm: Arm | None,
) -> ColumnsProposal:
    """Compose campaign.yaml from the columns found in each file."""
    files = {
        key: (file, log, {name: value for name, value in columns.items() if value is not None})
        for key, (file, log, columns) in files.items()
    }
    every = {key for _, _, columns in files.values() for key in columns}
    kind = "pose" if "rotation" in every else "distance" if "distance" in every else "points"
    checks, signs = list(making.checks), making.signs
    if arm is None:
        checks.append(
            "robot: name the arm, and run pa10cal columns again with --robot: units and the "
            "convention of orientations are then found from its kinematics"
        )
    base_moves = arm is not None and arm.base_moves
    checks.append(
        f"provenance{'' if base_moves else ' and gravity_m_s2'}: state "
        f"{'it' if base_moves else 'them'}; instrument.uncertainty_mm is "
        + ("that of the file" if making.stated_mm is not None else f"{ASSUMED_MM} mm, assumed")
    )
    if making.stated_mm is None and "poses" in files and _stands(*files["poses"][1:]):
        checks.append(
            "instrument.uncertainty_mm: that of a position, by the instrument's data sheet; what "
            "repeats scatter by while the arm stands still is the noise of a reading, and less"
        )
    checks.append("tool: state its mass and centre of mass; a mass of 0 means not stated")
    names = " and ".join(file for file, _, _ in files.values())
    content = {
        "schema": SCHEMA,
        "name": name,
        "provenance": f"to be stated; read from {names}",
        "robot": robot,
        "instrument": {"kind": kind, "uncertainty_mm": making.stated_mm or ASSUMED_MM},
        "tool": {"mass_kg": 0.0, "com_mm": [0.0, 0.0, 0.0], "load_point_mm": [0.0, 0.0, 0.0]},
        "gravity_m_s2": [0.0, 0.0, 0.0 if base_moves else -9.81],
        "reference_temperature_C": making.temperature_C,
        "files": {key: file for key, (file, _, _) in files.items()},
        **({"joint_signs": list(signs)} if signs else {}),
        **({} if "kind" in every else {"holdout": {"every": 5}}),
        "columns": {key: columns for key, (_, _, columns) in files.items()},
    }
    lines = [
        line for file, log, columns in files.values() for line in _read_as(log, columns, file, arm)
    ]
    known = tuple(
        "; ".join((f"{file}: {log.format.title}: {log.format.holds}", *log.notes)).replace("`", "")
        for file, log, _ in files.values()
        if log.format is not None
    )
    return ColumnsProposal(content, tuple(checks), tuple(lines), known)


def _stands(log: Sniffed, columns: Mapping[str, Any]) -> bool:
    """Return whether rows of a file often repeat the joint positions of the row before."""
    if "joints" not in columns:
        return False
    moves = np.diff(log.columns(columns["joints"]["names"]), axis=0)
    return int((moves == 0.0).all(axis=1).sum()) >= STANDS.least_pairs


def _read_as(
    sniffed: Sniffed, columns: Mapping[str, Any], file: str, arm: Arm | None
) -> tuple[str, ...]:
    """Return a line for every column of a file: what it is read as, or that it is not read.

    Without an arm all joints are taken for revolute ones. A file of the contract needs no mapping
    of what it states beside its readings.
    """
    model = FileColumns.model_validate(columns)
    count = 0 if model.joints is None else len(model.joints.names)
    slides = np.zeros(count, dtype=bool) if arm is None else arm.axes_slide
    uses: dict[str, dict[str, None]] = {}
    for ours, source in model.sources(slides):
        for own in source.names:
            how = in_words(ours) + (f", in {source.unit}" if source.unit else "")
            uses.setdefault(own, {})[how] = None
    if model.target is not None:
        uses.setdefault(model.target.names[0], {})["which target the row is of"] = None
    if model.time is not None and len(model.time.names) > 1 and model.time.format is None:
        parts = zip(model.time.names, model.time.unit, strict=True)
        uses |= {own: {f"time, in {unit}": None} for own, unit in parts}
    if follows_contract(sniffed):
        for name in sniffed.names:
            if name in _CONTRACT_ALONE or name.removeprefix("u_") in uses:
                unit = unit_of(name)
                uses.setdefault(name, {in_words(name) + (f", in {unit}" if unit else ""): None})
    encoding = sniffed.encoding.removesuffix("-sig")
    encoding = encoding or ("arrays" if sniffed.format else "a workbook")
    lines = [f"{file}: {encoding}, {len(sniffed.names)} columns, {len(sniffed.text)} rows seen"]
    shown = list(sniffed.names)
    if sniffed.titles:
        shown = [f"{k} ({title})" for k, title in zip(shown, sniffed.titles, strict=True)]
    width = max(map(len, shown))
    for name, label in zip(sniffed.names, shown, strict=True):
        lines.append(f"  {label:{width}}  {'; '.join(uses.get(name, ['not read']))}")
    return tuple(lines)
