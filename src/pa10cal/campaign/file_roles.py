"""Roles of the columns of a whole file, and whether they suffice for a campaign."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pa10cal.campaign.csv_rows import CONTRACT
from pa10cal.campaign.joint_names import aliases_by_text, named_joints
from pa10cal.campaign.matrices import quaternion_columns, rotation_columns, with_matrix
from pa10cal.campaign.recognise import (
    Roles,
    apart_by_letters,
    attitude_of,
    has_word,
    roles_of,
    standing,
    with_polar,
    words_of_name,
)
from pa10cal.campaign.sniffing import Sniffed
from pa10cal.errors import RawDataError

#: Columns are text if less than this share of their fields are numbers.
_NUMBERS_SHARE = 0.5
#: Words of columns that hold no orientation of a target, whatever else they say.
_NO_ORIENTATION = ("uncertain", "deviation", "no position", "commanded", "torque", "force")
#: Columns of numbers that are called an orientation, at least.
_LEAST = 3
#: The second of two columns of one name, as of another arm.
_AGAIN = re.compile(r".* \(\d+\)")


def roles_of_file(sniffed: Sniffed, joints: int | None, joint_names: Sequence[str]) -> Roles:
    """Return the roles of the columns of a file, with polar readings and matrices.

    Args:
        sniffed: the file.
        joints: number of the arm's joints; None where not known.
        joint_names: of the arm's description, in order; empty where it has none.
    """
    names = apart_by_letters(sniffed.titles or sniffed.names)
    unmixed = replace(sniffed, names=names)
    roles = with_matrix(_roles_by_name(unmixed, joints, joint_names), names, sniffed.numbers)
    roles = _with_moving_orientation(with_polar(roles, names), unmixed)
    roles = _with_place_of_oriented_body(roles)
    return roles.renamed(dict(zip(names, sniffed.names, strict=True)))


def _with_moving_orientation(roles: Roles, sniffed: Sniffed) -> Roles:
    """Return roles whose orientation is that of a moving body, not of one at rest as the base.

    A body is what the columns of its position and of its orientation are called after.
    """
    readings = {place: sniffed.columns(names) for place, names in roles.positions.items()}
    at_rest = {_words_of_body(roles.positions[place]) for place in standing(readings)} - {()}
    attitude, names = roles.attitude, list(sniffed.names)
    while attitude is not None and _words_of_body(attitude[0]) in at_rest:
        names = [name for name in names if name not in attitude[0]]
        attitude = roles_of(names, None).attitude
    return replace(roles, attitude=attitude)


def _with_place_of_oriented_body(roles: Roles) -> Roles:
    """Return roles in which the position of the body whose orientation is read comes first.

    A rotation vector, rvec, goes with a translation, tvec.
    """
    if roles.attitude is None:
        return roles
    columns, _ = roles.attitude
    vector = has_word(words_of_name(columns[0]), "rotation vector")

    def other(place: str) -> tuple[bool, bool, bool]:
        names = roles.positions[place]
        words = words_of_name(names[0])
        translation = has_word(words, "translation")
        of_other = _words_of_body(names) != _words_of_body(columns)
        return has_word(words, "commanded"), of_other, vector and not translation

    return replace(
        roles, positions={k: roles.positions[k] for k in sorted(roles.positions, key=other)}
    )


def _words_of_body(columns: Sequence[str]) -> tuple[str, ...]:
    """Return the words that all columns of a position or orientation share, as of their body."""
    first, *others = map(words_of_name, columns)
    shared = [word for word in first if all(word in words for words in others)]
    kinds = "of any joint", "rotation", "quaternion", "translation", "vector"
    shared = [word for word in shared if word not in ("t", "p")]
    return tuple(word for word in shared if not has_word([word], *kinds))


def _roles_by_name(sniffed: Sniffed, joints: int | None, joint_names: Sequence[str]) -> Roles:
    """Return the roles of the columns of a file by names, joints in the order of the arm's."""
    fields = {name: [word for word in sniffed.words(name) if word] for name in sniffed.names}
    text_columns = [
        name
        for name, words in fields.items()
        if words and np.isfinite(sniffed.column(name)).sum() < _NUMBERS_SHARE * len(words)
    ]
    constant_text = {name: fields[name][0] for name in text_columns if len(set(fields[name])) == 1}
    alias_of = {name: name for name in sniffed.names}
    alias_of |= aliases_by_text(sniffed.names, constant_text)
    column_of_alias = {alias: name for name, alias in alias_of.items()}

    def by_name(count: int | None, *, torques: bool) -> tuple[str, ...]:
        candidates = []
        for name, alias in alias_of.items():
            words = words_of_name(alias)
            uncertain = len(words) > 1 and has_word(words[:1], "uncertain")
            excluded = uncertain or has_word(words, "deviation", "no position")
            if name not in text_columns and not excluded and has_word(words, "torque") == torques:
                candidates.append(alias)
        found = named_joints(candidates, count, joint_names)
        return tuple(column_of_alias[alias] for alias in found)

    positions = by_name(joints, torques=False)
    torques = by_name(joints or len(positions) or None, torques=True)
    roles = roles_of(sniffed.names, joints, text_columns, positions)
    return replace(roles, torques=torques) if torques and positions else roles


def orientation_not_read(sniffed: Sniffed, roles: Roles) -> tuple[str, ...]:
    """Return the columns of an orientation that seems to be there and is not read; empty for none.

    By their names or by their numbers, a moving unit quaternion or matrix, or as text.
    """
    free = [name for name in sniffed.names if name not in _read(roles)]
    titles = dict(zip(sniffed.names, sniffed.titles or sniffed.names, strict=True))
    free = [n for n in free if not has_word(words_of_name(titles[n]), *_NO_ORIENTATION)]
    free = [n for n in free if not _AGAIN.fullmatch(titles[n])]
    numbers = {name: sniffed.column(name) for name in free}
    known = [name for name in free if np.isfinite(numbers[name]).mean() > 0.5]
    moving = [name for name in known if np.nanmax(numbers[name]) > np.nanmin(numbers[name])]
    found = attitude_of([titles[name] for name in moving])
    if found is not None:
        return found[0]
    columns = np.column_stack([numbers[name] for name in moving]) if moving else np.zeros((0, 0))
    by_numbers = rotation_columns(moving, columns) or quaternion_columns(moving, columns)
    called = [name for name in free if has_word(words_of_name(titles[name]), "orientation")]
    texts = [n for n in called if n not in known and any("[" in w for w in sniffed.words(n)[:5])]
    called = [name for name in called if name in moving]
    chosen: Sequence[str] = by_numbers or texts or (called if len(called) >= _LEAST else ())
    return tuple(titles[name] for name in chosen)


def _read(roles: Roles) -> set[str]:
    """Return the columns that have a role."""
    read = {*roles.joints, *roles.torques, *roles.uncertain, *roles.uncertain.values()}
    read |= {*roles.times, *roles.single.values(), *(roles.polar or ())}
    read |= {name for names in roles.positions.values() for name in names}
    return read | set(roles.attitude[0] if roles.attitude else ())


def follows_contract(sniffed: Sniffed) -> bool:
    """Return whether a file has the names and layout of the contract, and needs no mapping."""
    names = set(sniffed.names)
    labelled = {"time_s", "pose", "load_N", "repeat"} <= names and names & {"q1_deg", "q1_mm"}
    return sniffed.layout == CONTRACT and bool(labelled)


def refuse_unrecognised(
    roles: Roles, sniffed: Sniffed, file: str, *, measured: bool = False
) -> None:
    """Refuse a file without recognised joint positions, or without a measured quantity.

    The latter may be `measured` in another file.
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
