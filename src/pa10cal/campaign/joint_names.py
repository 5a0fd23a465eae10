"""Columns of joints by what the joints are called, whatever their order in a file.

Two things give the order of the joints: the names that the arm's own description has, and words of
a limb, which follow each other from the base to the hand.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pa10cal.campaign.recognise import (
    WORDS,
    Roles,
    has_word,
    numbered_sets,
    plain,
    roles_of,
    split_unit,
    words_of_name,
)
from pa10cal.campaign.sniffing import Sniffed

_LIMB = WORDS["limb"]
#: How far along the arm a word stands, and which motion of several there comes first.
_SEGMENT = {word: k for k, words in enumerate(_LIMB["segments"]) for word in words.split()}
_MOTION = {word: k for k, words in enumerate(_LIMB["motions"], 1) for word in words.split()}
#: Letters that stand for the joints of an arm, in order.
_LETTERS = tuple(tuple(letters.split()) for letters in _LIMB["letters"])
_NUMBERED = re.compile(r"^(?P<stem>.*?\D)(?P<number>\d+)$")


#: Columns hold no numbers if fewer of their fields are.
_NUMBERS = 0.5


def file_roles(sniffed: Sniffed, joints: int | None, own: Sequence[str] = ()) -> Roles:
    """Return what the columns of a file may be, joints in the order of the arm's.

    Args:
        sniffed: the file.
        joints: how many the arm has; None where not known.
        own: what its description calls them, in order; empty where it does not.
    """
    fields = {name: [word for word in sniffed.words(name) if word] for name in sniffed.names}
    text = [
        name
        for name, words in fields.items()
        if words and np.isfinite(sniffed.column(name)).sum() < _NUMBERS * len(words)
    ]
    same = {name: fields[name][0] for name in text if len(set(fields[name])) == 1}
    called = {name: name for name in sniffed.names} | named_by_text(sniffed.names, same)
    files_own = {call: name for name, call in called.items()}

    def by_name(*, torques: bool) -> tuple[str, ...]:
        some = []
        for name, call in called.items():
            words = words_of_name(call)
            uncertain = len(words) > 1 and has_word(words[:1], "uncertain")
            other = uncertain or has_word(words, "deviation", "no position")
            if name not in text and not other and has_word(words, "torque") == torques:
                some.append(call)
        return tuple(files_own[call] for call in columns_by_name(some, joints, own))

    turns, torques = by_name(torques=False), by_name(torques=True)
    roles = roles_of(sniffed.names, joints, text, turns)
    return replace(roles, torques=torques) if torques and turns else roles


def columns_by_name(
    names: Sequence[str], joints: int | None, own: Sequence[str] = ()
) -> tuple[str, ...]:
    """Return the columns of joints that carry names, in the order of the joints; empty for none.

    Args:
        names: of columns that hold positions of joints, or something else.
        joints: how many the arm has; None where not known.
        own: what its description calls them, in order; empty where it does not.
    """
    measured = [name for name in names if not has_word(words_of_name(name), "commanded")]
    commanded = [name for name in names if name not in measured]
    for some in (measured, commanded):
        found = _by_own(some, own) or _by_limb(some, joints) or _by_letters(some, joints)
        if found:
            return found
    return ()


def joint_sets(names: Sequence[str], joints: int, own: Sequence[str] = ()) -> list[tuple[str, ...]]:
    """Return every set of columns that may be the joints of one arm, as of two side by side.

    They are numbered, or carry names of joints beside words that all of a set share, such as left.
    """
    groups: dict[tuple[str, ...], list[str]] = {}
    for name in names:
        rest = (w for w in _bare(name) if w not in _SEGMENT and w not in _MOTION)
        groups.setdefault(tuple(w for w in rest if not w.isdigit()), []).append(name)
    called = (columns_by_name(group, joints, own) for group in groups.values())
    return list(dict.fromkeys(filter(None, (*numbered_sets(names, joints), *called))))


def _bare(name: str) -> tuple[str, ...]:
    """Return the words of a name without those that any joint's column may have."""
    words = [part for word in words_of_name(name) for part in re.findall(r"[a-z]+|\d+", word)]
    return tuple(word for word in words if not has_word([word], "of any joint"))


def _by_own(names: Sequence[str], own: Sequence[str]) -> tuple[str, ...]:
    """Return one column for each of the arm's own names, equal ones first, else the nearest."""
    columns = {name: _bare(name) for name in names}
    wanted = [_bare(each) for each in own]
    if len(set(wanted)) < len(wanted) or not all(wanted):
        return ()

    def ends(long: tuple[str, ...], short: tuple[str, ...]) -> bool:
        return bool(short) and long[-len(short) :] == short

    ways = (
        lambda of, joint: of == joint,
        lambda of, joint: ends(of, joint),  # ours_elbow under elbow
        lambda of, joint: ends(joint, of),  # elbow under ours_elbow
    )
    for way in ways:
        found = [[name for name, of in columns.items() if way(of, joint)] for joint in wanted]
        if own and all(len(each) == 1 for each in found):
            chosen = tuple(each[0] for each in found)
            if len(set(chosen)) == len(chosen):
                return chosen
    return ()


def _by_limb(names: Sequence[str], joints: int | None) -> tuple[str, ...]:
    """Return the columns under words of a limb, such as shoulder and elbow, from the base on."""
    places: dict[str, tuple[int, int, int]] = {}
    for name in names:
        words = _bare(name)
        segments = [_SEGMENT[word] for word in words if word in _SEGMENT]
        if segments:
            motions = [_MOTION[word] for word in words if word in _MOTION]
            numbers = [int(word) for word in words if word.isdigit()]
            places[name] = (max(segments), max(motions, default=0), max(numbers, default=0))
    apart = len(set(places.values())) == len(places) and len({p[0] for p in places.values()}) > 1
    enough = len(places) >= 2 if joints is None else len(places) == joints
    return tuple(sorted(places, key=lambda name: places[name])) if apart and enough else ()


def _by_letters(names: Sequence[str], joints: int | None) -> tuple[str, ...]:
    """Return the columns that are called by the letters of a maker, such as S, L, U, R, B, T."""
    columns = {name: _bare(name) for name in names}
    for letters in (each for each in _LETTERS if joints in (None, len(each))):
        words = [tuple(re.findall(r"[a-z]+|\d+", plain(letter))) for letter in letters]
        found = [[name for name, of in columns.items() if of[-len(w) :] == w] for w in words]
        if all(len(each) == 1 for each in found):
            return tuple(each[0] for each in found)
    return ()


def named_by_text(names: Sequence[str], same: Mapping[str, str]) -> dict[str, str]:
    """Return what numbered columns are called by columns of text beside them.

    A table of `/joint_states` has the joints' names under name0, name1, … and their positions under
    position0, position1, ….

    Args:
        names: of all columns.
        same: what stands in each row of a column of text, where it is the same in all.
    """
    series: dict[str, dict[str, str]] = {}
    for name in names:
        if (found := _NUMBERED.match(split_unit(name)[0])) is not None:
            series.setdefault(found["stem"], {})[found["number"]] = name
    lists = [of for of in series.values() if len(of) >= 2 and all(n in same for n in of.values())]
    called: dict[str, str] = {}
    for of in lists:
        texts = {number: same[name] for number, name in of.items()}
        if len({plain(text) for text in texts.values()}) < len(texts):
            continue
        for stem, others in series.items():
            if set(others) == set(of) and not set(others.values()) & set(same):
                called |= {name: f"{texts[number]} {stem}" for number, name in others.items()}
    return called
