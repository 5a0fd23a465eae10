"""What the columns of a whole file may be, whether that suffices, and what each is read as."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pa10cal.arrays import Array
from pa10cal.campaign.bounds import in_words
from pa10cal.campaign.composed_columns import with_matrix, with_polar
from pa10cal.campaign.csv_rows import Layout, same_name
from pa10cal.campaign.joint_names import file_roles
from pa10cal.campaign.own_columns import FileColumns
from pa10cal.campaign.raw_file import own_columns
from pa10cal.campaign.recognise import Roles, beyond, roles_of, split_unit, standing
from pa10cal.campaign.sniffing import Sniffed
from pa10cal.errors import RawDataError

#: Positions beyond are no radians.
_TURN_RAD = 2.0 * np.pi + 0.1


def roles_of_file(sniffed: Sniffed, joints: int | None, joint_names: Sequence[str]) -> Roles:
    """Return what the columns of a file may be, those too that hold a place only together."""
    names = sniffed.titles or sniffed.names
    called = replace(sniffed, names=names)
    roles = with_matrix(file_roles(called, joints, joint_names), names, sniffed.numbers)
    roles = _of_what_moves(with_polar(roles, names), called)
    return roles.renamed(dict(zip(names, sniffed.names, strict=True)))


def _of_what_moves(roles: Roles, sniffed: Sniffed) -> Roles:
    """Return roles whose orientation is not that of a body that stands still, such as the base."""

    def body(name: str) -> str:
        return split_unit(name)[0].rpartition(" ")[0]

    places = {place: sniffed.columns(names) for place, names in roles.positions.items()}
    still = {body(roles.positions[place][0]) for place in standing(places)}
    if roles.attitude is None or body(roles.attitude[0][0]) not in still - {""}:
        return roles
    moving = [name for name in sniffed.names if body(name) not in still]
    return replace(roles, attitude=roles_of(moving, None).attitude)


def read_as(sniffed: Sniffed, columns: Mapping[str, Any], file: str) -> tuple[str, ...]:
    """Return a line for every column of a file: what it is read as, or that it is not read."""
    model = FileColumns.model_validate(columns)
    count = 0 if model.joints is None else len(model.joints.names)
    uses: dict[str, dict[str, None]] = {}
    for ours, source in own_columns(model, np.zeros(count, dtype=bool)):
        one = source.name in sniffed.names
        for own in [source.name] if one else source.name.split(", "):
            how = in_words(ours) + (f", in {source.unit}" if source.unit else "")
            uses.setdefault(own, {})[how] = None
    if model.target is not None:
        uses.setdefault(model.target.names[0], {})["which target the row is of"] = None
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


def notes_on_joints(sniffed: Sniffed, joints: Sequence[str]) -> list[str]:
    """Return what is to be checked of the choice of columns of joints."""
    every = sniffed.titles or sniffed.names
    titled = [every[sniffed.names.index(name)] for name in joints]
    first = titled[0].partition(" (")[0]
    same = [k for k in range(1, len(every)) if same_name(first, k) in every]
    found = []
    if more := beyond(every, titled):
        found.append(
            f"joints: the arm has {len(joints)}, so {', '.join(more)} is not read: a gripper, or "
            "an outer axis? if it is an axis of the arm, name another arm"
        )
    largest = np.nanmax(np.abs(sniffed.columns(joints)), initial=0.0)
    if all(name.endswith(".pos") for name in titled) and _TURN_RAD < largest <= 100.0:
        found.append(
            f"joints: {titled[0]} … lie within -100 to 100: LeRobot writes percents of each "
            "joint's range so, which are no angles; log degrees (use_degrees)"
        )
    if len(same) > 1:
        found.append(
            f"joints: {titled[0]} is there {len(same)} times, of several arms perhaps; "
            f"{titled[0]} to {titled[-1]} is read: name others where the arm is another one"
        )
    return found


def unit_by_size(p: Array) -> str:
    """Return the unit of positions (N, k) of a target by their size: metres or millimetres."""
    seen = np.isfinite(p).all(axis=1)
    far = np.abs(p[seen]).max(initial=0.0)  # of what stands still, too
    extent = np.ptp(p[seen], axis=0).max() if seen.any() else 0.0
    return "mm" if max(extent, 0.2 * far) > 20.0 else "m"


def follows_contract(sniffed: Sniffed) -> bool:
    """Return whether a file has the contract's own names and layout, and needs no mapping."""
    names = set(sniffed.names)
    labelled = {"time_s", "pose", "load_N", "repeat"} <= names and names & {"q1_deg", "q1_mm"}
    return sniffed.layout == Layout(own=True) and bool(labelled)


def refuse_unrecognised(
    roles: Roles, sniffed: Sniffed, file: str, *, measured: bool = False
) -> None:
    """Stop where no joint positions are recognised, or nothing that was measured.

    It is known from elsewhere that something was `measured`, or not.
    """
    measured = measured or bool(roles.positions) or "distance" in roles.single
    if roles.joints and measured:
        return
    what, other = "no joint positions were", "joint positions are"
    if roles.joints:
        what, other = "no position and no distance was", "readings are"
    header = ""
    if not sniffed.layout.header and not sniffed.layout.format and not sniffed.titles:
        header = "the file has no header: write one; or "
    raise RawDataError(
        f"{what} recognised",
        where=file,
        value=", ".join(sniffed.titles or sniffed.names),
        allowed="a column for each joint of the arm, such as q1, J1 or joint_1, and columns such "
        "as x, y, z",
        remedy=header
        + f"give both logs where the {other} in another: pa10cal columns JOINTS READINGS; or "
        "write columns.poses in campaign.yaml by hand, see docs/raw-data.md; column names may "
        "also be numbers",
    )


def label_of(path: Path) -> str:
    """Return a name for a campaign, of that of a file or folder."""
    stem = path.name.partition(".")[0]
    letters = "".join(letter if letter.isalnum() or letter in "-_" else "-" for letter in stem)
    return letters.strip("-_") or "mine"
