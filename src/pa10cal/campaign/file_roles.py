"""Roles of the columns of a whole file, and whether they suffice for a campaign."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from pa10cal.arrays import Array
from pa10cal.campaign.column_names import apart_by_letters, has_word, is_of, words_of_name
from pa10cal.campaign.csv_rows import CONTRACT, is_repeated
from pa10cal.campaign.joint_names import aliases_by_text, named_joints
from pa10cal.campaign.matrices import quaternion_columns, rotation_columns, with_matrix
from pa10cal.campaign.recognise import Roles, attitude_of, polar_columns, roles_of, standing
from pa10cal.campaign.sniffing import Sniffed
from pa10cal.errors import RawDataError

#: Columns are text if less than this share of their fields are numbers.
_NUMBERS_SHARE = 0.5
#: Words of columns that hold no orientation of a target, whatever else they say.
_NO_ORIENTATION = ("uncertain", "deviation", "no position", "commanded", "torque", "force")
#: Columns of numbers that are called an orientation, at least.
_LEAST = 3
#: Letters of the place of a body, as in t_x and p1.
_LETTERS_OF_PLACE = ("t", "p")
#: Kinds of words that name no body.
_NO_WORDS_OF_BODY = ("of any joint", "rotation", "quaternion", "translation", "vector")


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
    roles = _with_moving_orientation(_with_polar(roles, names), unmixed)
    roles = _with_place_of_oriented_body(roles)
    return roles.renamed(dict(zip(names, sniffed.names, strict=True)))


def _with_polar(roles: Roles, names: Sequence[str]) -> Roles:
    """Return roles in which polar readings are a position, where there is no other."""
    taken = {*roles.joints, *roles.torques, *roles.uncertain.values()}
    polar = polar_columns([name for name in names if name not in taken])
    if roles.positions or polar is None:
        return roles
    single = {key: name for key, name in roles.single.items() if name not in polar}
    return replace(roles, positions={"": polar}, attitude=None, single=single, polar=polar)


def _with_moving_orientation(roles: Roles, sniffed: Sniffed) -> Roles:
    """Return roles whose orientation is that of a moving body, not of one at rest as the base.

    A body is what the columns of its position and of its orientation are called after.
    """
    readings = {place: sniffed.columns(names) for place, names in roles.positions.items()}
    at_rest = {_words_of_body(roles.positions[place]) for place in standing(readings)} - {()}
    # no orientation, though q1 … q4 may seem to be one
    taken = {*roles.joints, *roles.torques, *roles.uncertain.values(), *_text_columns(sniffed)}
    free = [name for name in sniffed.names if name not in taken]
    attitude = roles.attitude
    while attitude is not None and _words_of_body(attitude[0]) in at_rest:
        free = [name for name in free if name not in attitude[0]]
        attitude = roles_of(free, None).attitude
    return replace(roles, attitude=attitude)


def _with_place_of_oriented_body(roles: Roles) -> Roles:
    """Return roles in which the position of the body whose orientation is read comes first.

    A rotation vector, rvec, goes with a translation, tvec.
    """
    if roles.attitude is None:
        return roles
    columns, _ = roles.attitude
    by_vector = has_word(words_of_name(columns[0]), "rotation vector")

    def rank(place: str) -> tuple[bool, bool, bool]:
        """Return the sort key of a position, False first.

        Measured before commanded ones; then that of the same body; then, if the orientation is a
        rotation vector, translations.
        """
        names = roles.positions[place]
        words = words_of_name(names[0])
        is_commanded = has_word(words, "commanded")
        is_of_other_body = _words_of_body(names) != _words_of_body(columns)
        return is_commanded, is_of_other_body, by_vector and not has_word(words, "translation")

    places = sorted(roles.positions, key=rank)
    return replace(roles, positions={place: roles.positions[place] for place in places})


def _words_of_body(columns: Sequence[str]) -> tuple[str, ...]:
    """Return the words that all columns of a position or orientation share, as of their body."""
    first, *others = map(words_of_name, columns)
    shared = [word for word in first if all(word in words for words in others)]
    return tuple(
        word
        for word in shared
        if word not in _LETTERS_OF_PLACE and not has_word([word], *_NO_WORDS_OF_BODY)
    )


def _text_columns(sniffed: Sniffed) -> list[str]:
    """Return the columns most of whose fields are words."""
    return [
        name
        for name in sniffed.names
        if (fields := _filled(sniffed, name))
        and np.isfinite(sniffed.column(name)).sum() < _NUMBERS_SHARE * len(fields)
    ]


def _filled(sniffed: Sniffed, name: str) -> list[str]:
    """Return the fields of a column that are not blank."""
    return [field for field in sniffed.words(name) if field]


def _roles_by_name(sniffed: Sniffed, joints: int | None, joint_names: Sequence[str]) -> Roles:
    """Return the roles of the columns of a file by names, joints in the order of the arm's."""
    text_columns = _text_columns(sniffed)
    texts = {name: set(_filled(sniffed, name)) for name in text_columns}
    constant_text = {name: words.pop() for name, words in texts.items() if len(words) == 1}
    alias_of = {name: name for name in sniffed.names}
    alias_of |= aliases_by_text(sniffed.names, constant_text)
    name_of = {alias: name for name, alias in alias_of.items() if name not in text_columns}

    def by_joint(count: int | None, *, torques: bool) -> tuple[str, ...]:
        """Return the columns of positions, or torques, of `count` joints in order; empty for none.

        Of shoulder_pos, elbow_pos and elbow_std these are the first two; of name0, position0, …,
        where name0 has the text "elbow", position0 is an alias "elbow position".
        """
        aliases = [alias for alias in name_of if _may_be_of_joint(alias, torques=torques)]
        return tuple(name_of[alias] for alias in named_joints(aliases, count, joint_names))

    positions = by_joint(joints, torques=False)
    torques = by_joint(joints or len(positions) or None, torques=True)
    roles = roles_of(sniffed.names, joints, text_columns, positions)
    return replace(roles, torques=torques) if torques and positions else roles


def _may_be_of_joint(name: str, *, torques: bool) -> bool:
    """Return whether a column may hold positions, or torques, of a joint: not their uncertainty."""
    words = words_of_name(name)
    uncertain = len(words) > 1 and has_word(words[:1], "uncertain")
    excluded = uncertain or is_of(name, "deviation", "extreme", "no position")
    return not excluded and is_of(name, "torque") == torques


def orientation_not_read(sniffed: Sniffed, roles: Roles) -> tuple[str, ...]:
    """Return the columns of an orientation that seems to be there and is not read; empty for none.

    By their names or by their numbers, a moving unit quaternion or matrix, or as text.
    """
    titles = sniffed.titles or sniffed.names
    read = _read(roles)
    unread = {
        title: name
        for name, title in zip(sniffed.names, titles, strict=True)
        if name not in read
        and not has_word(words_of_name(title), *_NO_ORIENTATION)
        and not is_repeated(title, titles)
    }
    numbers = {title: sniffed.column(name) for title, name in unread.items()}
    moving = {title: values for title, values in numbers.items() if _moves(values)}
    by_name = attitude_of(list(moving))
    if by_name is not None:
        return by_name[0]
    return _rotation_by_numbers(moving) or _called_orientation(sniffed, unread, moving)


def _moves(values: Array) -> bool:
    """Return whether a column (N,) has mostly numbers, which differ."""
    return _mostly_numbers(values) and bool(np.nanmax(values) > np.nanmin(values))


def _mostly_numbers(values: Array) -> bool:
    return bool(np.isfinite(values).mean() > 0.5)


def _rotation_by_numbers(moving: Mapping[str, Array]) -> tuple[str, ...]:
    """Return the titles of a rotation matrix or a quaternion among columns (N,); empty for none."""
    if not moving:
        return ()
    titles, numbers = list(moving), np.column_stack(list(moving.values()))
    return rotation_columns(titles, numbers) or quaternion_columns(titles, numbers)


def _called_orientation(
    sniffed: Sniffed, unread: Mapping[str, str], moving: Collection[str]
) -> tuple[str, ...]:
    """Return the titles of lists as text, else of numbers, that are called an orientation.

    Args:
        sniffed: the file.
        unread: columns by their titles.
        moving: titles of those whose numbers differ.
    """
    called = [title for title in unread if has_word(words_of_name(title), "orientation")]
    lists = tuple(title for title in called if _are_lists(sniffed, unread[title]))
    numbers = tuple(title for title in called if title in moving)
    return lists or (numbers if len(numbers) >= _LEAST else ())


def _are_lists(sniffed: Sniffed, name: str) -> bool:
    """Return whether a column is text like [0.1, 0.2, 0.3]."""
    lists = any("[" in field for field in sniffed.words(name)[:5])
    return lists and not _mostly_numbers(sniffed.column(name))


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
