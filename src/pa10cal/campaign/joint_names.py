"""Columns of joints that have names instead of numbers, in the order of the joints.

The order is that of the names in the arm's description, of words of a limb, which follow each other
from the base to the hand, or of the letters of a maker.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from pa10cal.campaign.column_names import WORDS, has_word, plain, split_unit, words_of_name
from pa10cal.campaign.numbered_columns import numbered_joints, numbered_sets
from pa10cal.campaign.recognise import positions_of

_LIMB = WORDS["limb"]
#: Order of words of a limb from base to hand, and of words of motions within a segment.
_SEGMENT = {word: k for k, words in enumerate(_LIMB["segments"]) for word in words.split()}
_MOTION = {word: k for k, words in enumerate(_LIMB["motions"], 1) for word in words.split()}
_RAIL, _HAND = min(_SEGMENT.values()), max(_SEGMENT.values())
#: Words of columns that are of a limb, but of none of its joints.
_NO_JOINT = frozenset(_LIMB["no joint"].split())
#: Least segments by which columns are those of a limb where the number of joints is not known.
_LEAST_SEGMENTS = 3
#: Letters that stand for the joints of an arm, in order.
_LETTERS = tuple(tuple(letters.split()) for letters in _LIMB["letters"])
_NUMBERED = re.compile(r"^(?P<stem>.*?\D)(?P<number>\d+)$")


def named_joints(
    names: Sequence[str], joints: int | None, joint_names: Sequence[str] = ()
) -> tuple[str, ...]:
    """Return the columns of joints with names, in the order of the joints; empty for none.

    Args:
        names: columns that may hold positions of joints.
        joints: number of the arm's joints; None where not known.
        joint_names: of the arm's description, in order; empty where it has none.
    """
    measured = [name for name in names if not has_word(words_of_name(name), "commanded")]
    commanded = [name for name in names if name not in measured]
    for candidates in (measured, commanded):
        found = (
            _by_description(candidates, joint_names)
            or _by_limb(candidates, joints)
            or _by_letters(candidates, joints)
        )
        if found:
            return found
    return ()


def joint_sets(
    names: Sequence[str], joints: int, joint_names: Sequence[str] = ()
) -> list[tuple[str, ...]]:
    """Return every set of columns that may be the joints of one arm, as of two arms side by side.

    They are numbered, or have names of joints and a word that all of a set share, such as left.
    """
    groups = _grouped_by_other_words(names)
    by_name = (named_joints(group, joints, joint_names) for group in groups)
    return list(dict.fromkeys(filter(None, (*numbered_sets(names, joints), *by_name))))


def _grouped_by_other_words(names: Sequence[str]) -> list[list[str]]:
    """Return names in groups, those of a group with the same words besides limbs and numbers."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for name in names:
        rest = (w for w in _naming_words(name) if w not in _SEGMENT and w not in _MOTION)
        groups.setdefault(tuple(w for w in rest if not w.isdigit()), []).append(name)
    return list(groups.values())


def _naming_words(name: str) -> tuple[str, ...]:
    """Return the words of a name by which joints differ: without such as position and joint."""
    words = [part for word in words_of_name(name) for part in re.findall(r"[a-z]+|\d+", word)]
    return tuple(word for word in words if not has_word([word], "of any joint"))


def _ends_with(column: tuple[str, ...], joint: tuple[str, ...]) -> bool:
    return bool(joint) and column[-len(joint) :] == joint


def _is_end_of(column: tuple[str, ...], joint: tuple[str, ...]) -> bool:
    return _ends_with(joint, column)


def _by_description(names: Sequence[str], joint_names: Sequence[str]) -> tuple[str, ...]:
    """Return one column for each joint of the arm's description; empty if not all are found.

    The words of a column and of a joint are the same, or else one ends with those of the other: of
    a joint called elbow also ours_elbow, and of one called ours_elbow also elbow.
    """
    # A number alone stands for the place of a column without a name.
    words_of = {name: _naming_words(name) for name in names if not name.isdigit()}
    wanted = [_naming_words(joint) for joint in joint_names]
    if not wanted or len(set(wanted)) < len(wanted) or not all(wanted):
        return ()
    for matches in (operator.eq, _ends_with, _is_end_of):
        found = [
            [name for name, words in words_of.items() if matches(words, joint)] for joint in wanted
        ]
        if all(len(each) == 1 for each in found):
            chosen = tuple(each[0] for each in found)
            if len(set(chosen)) == len(chosen):
                return chosen
    return ()


class _Place(NamedTuple):
    """Where a joint sits on a limb; places follow each other from the base on."""

    segment: int
    motion: int  # 0 without a word of it
    number: int  # 0 without one


def _by_limb(names: Sequence[str], joints: int | None) -> tuple[str, ...]:
    """Return the columns with words of a limb, such as shoulder and elbow, from the base on.

    Empty where they may be none, or not all joints of the arm have one, or several choices are.
    """
    places = _places_on_limb(names)
    if joints is None:
        others = [name for name in names if name not in places]
        segments = {place.segment for place in places.values()}
        if len(segments) < _LEAST_SEGMENTS or len(numbered_joints(others, None)) > 2:
            return ()  # few words may have other meanings; fingers are numbered, too
        return _ordered_from_base(places)
    if len(places) == joints:
        return _ordered_from_base(places)
    chosen = {
        _ordered_from_base({name: places[name] for name in group})
        for group in _possible_limbs(places)
        if len(group) == joints
    } - {()}
    return chosen.pop() if len(chosen) == 1 else ()


def _places_on_limb(names: Sequence[str]) -> dict[str, _Place]:
    """Return the place of each column with words of a limb that may be a joint."""
    taken = {name for xyz in positions_of(names).values() for name in xyz}
    places = {}
    for name in names:
        words = _naming_words(name)
        segments = [_SEGMENT[word] for word in words if word in _SEGMENT]
        no_joint = name in taken or not _NO_JOINT.isdisjoint(words) or has_word(words, "time")
        if segments and not no_joint:
            motions = [_MOTION[word] for word in words if word in _MOTION]
            numbers = [int(word) for word in words if word.isdigit()]
            places[name] = _Place(max(segments), max(motions, default=0), max(numbers, default=0))
    return places


def _ordered_from_base(places: Mapping[str, _Place]) -> tuple[str, ...]:
    """Return columns from the base on; empty unless all places differ, in two segments or more."""
    apart = len(set(places.values())) == len(places)
    segments = {place.segment for place in places.values()}
    return tuple(sorted(places, key=places.__getitem__)) if apart and len(segments) > 1 else ()


def _possible_limbs(places: Mapping[str, _Place]) -> Iterator[list[str]]:
    """Yield sets of columns that may be one arm: all of them, or those of equal other words.

    Each is yielded also without a rail and without a hand, which an arm may stand on and carry and
    which are no joints of its own.
    """
    for group in (list(places), *_grouped_by_other_words(list(places))):
        for ends in ((), (_RAIL,), (_HAND,), (_RAIL, _HAND)):
            yield [name for name in group if places[name].segment not in ends]


def _by_letters(names: Sequence[str], joints: int | None) -> tuple[str, ...]:
    """Return the columns that are called by the letters of a maker, such as S, L, U, R, B, T.

    Empty unless there is one column for each letter. A time t may be beside a joint T: of several,
    that counts which is written like the letter.
    """
    words_of = {name: _naming_words(name) for name in names}
    for letters in (each for each in _LETTERS if joints in (None, len(each))):
        found = []
        for letter in letters:
            last = tuple(re.findall(r"[a-z]+|\d+", plain(letter)))
            alike = [name for name, words in words_of.items() if _ends_with(words, last)]
            exact = [name for name in alike if split_unit(name)[0].rstrip("_").endswith(letter)]
            found.append(exact if len(alike) > 1 else alike)
        if all(len(each) == 1 for each in found):
            return tuple(each[0] for each in found)
    return ()


def aliases_by_text(names: Sequence[str], constant_text: Mapping[str, str]) -> dict[str, str]:
    """Return aliases of numbered columns, by columns of text that have the same numbers.

    A table of `/joint_states` has the joints' names under name0, name1, … and their positions under
    position0, position1, …: with 'elbow' in all rows of name0, position0 is "elbow position".

    Args:
        names: all columns.
        constant_text: the text of each column that has the same text in all rows.
    """
    series: dict[str, dict[str, str]] = {}  # columns by their numbers, by what is before these
    for name in names:
        if (found := _NUMBERED.match(split_unit(name)[0])) is not None:
            series.setdefault(found["stem"], {})[found["number"]] = name
    lists = [
        column_of
        for column_of in series.values()
        if len(column_of) >= 2 and all(name in constant_text for name in column_of.values())
    ]
    alias_of: dict[str, str] = {}
    for column_of in lists:
        texts = {number: constant_text[name] for number, name in column_of.items()}
        if len({plain(text) for text in texts.values()}) < len(texts):
            continue
        for stem, others in series.items():
            if set(others) == set(texts) and not set(others.values()) & constant_text.keys():
                alias_of |= {name: f"{texts[number]} {stem}" for number, name in others.items()}
    return alias_of
