"""Files with one target a row: which column names it, and how its targets are called."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Sequence

import numpy as np
import pandas as pd

from pa10cal.arrays import Array
from pa10cal.campaign.nominal_fit import placed_by_points
from pa10cal.campaign.own_columns import TargetOfRow
from pa10cal.campaign.recognise import Roles, has_word, words_of_name
from pa10cal.campaign.sniffing import Sniffed

#: Targets at most; rows of each target, and poses, at least.
_MOST, _FEWEST = 12, 3
#: A label that ends with a target: a letter after a number, or a word behind a sign.
_ENDING = re.compile(r"(?P<pose>.*\w)(?P<ending>(?<=\d)[A-Za-z]|[_.:/\s-]+[A-Za-z]{0,12}\d{0,2})")
#: Part of the labels with such an ending, and of the poses with several targets, at least.
_NEARLY_ALL, _SEVERAL = 0.95, 0.5
#: Targets of one pose scatter by more than this part of the scatter of all places.
_APART = 1e-3
#: With several targets the misfit of the nominal arm must be so many times smaller than with one.
_CLEARER = 5.0


def target_column(
    sniffed: Sniffed, roles: Roles, p_m: Array, T_base_ee: Array | None
) -> dict[str, object] | None:
    """Return `target` of campaign.yaml for a file whose rows are of one of several targets each.

    The column of targets has labels with endings, such as P1_A and P1_B, or is named as one, or its
    words make the nominal arm agree much better. None where there is no such column.

    Args:
        sniffed: the file.
        roles: roles of its columns.
        p_m: (N, 3) the position in each row.
        T_base_ee: (N, 4, 4) the nominal end in each row, where it is known.
    """
    used = {*roles.joints, *roles.torques, *roles.uncertain.values(), *roles.times}
    used |= {name for names in roles.positions.values() for name in names}
    free = [name for name in sniffed.names if name not in used]
    for name in free:
        if endings := label_endings(sniffed.words(name), p_m):
            return {"names": name, "endings": target_names(endings)}
    for name in free:
        words = sniffed.words(name)
        counts = Counter(words)
        if "" in counts or not 2 <= len(counts) <= _MOST or min(counts.values()) < _FEWEST:
            continue
        title = words_of_name(sniffed.titled(name))
        if has_word(title, "one target") or _nearer(words, p_m, T_base_ee):
            return {"names": name, "words": target_names(sorted(counts))}
    return None


def named_in_other_log(joints: Sniffed, file: str, readings: str) -> list[str]:
    """Return what the user must do where the joints' log names the target of each reading."""
    return [
        f"target: {joints.titled(name)} of {file} says which target a row is of, and is not read "
        f"there: copy that column into {readings}, and run pa10cal columns again"
        for name in joints.names
        if has_word(words_of_name(joints.titled(name)), "one target")
        and 2 <= len(set(joints.words(name))) <= _MOST
    ]


def label_endings(labels: Sequence[str], p: Array) -> list[str]:
    """Return the endings of labels that name targets, at places p (N, 3); none where none do."""
    matches = [_ENDING.fullmatch(label) for label in labels]
    split = [(match["pose"], match["ending"]) for match in matches if match is not None]
    counts = Counter(ending for _, ending in split)
    endings_of_pose: dict[str, set[str]] = {}
    for pose, ending in split:
        endings_of_pose.setdefault(pose, set()).add(ending)
    if len(split) < _NEARLY_ALL * len(labels) or not 2 <= len(counts) <= _MOST:
        return []
    several = float(np.mean([len(endings) > 1 for endings in endings_of_pose.values()]))
    if min(counts.values()) < _FEWEST or several < _SEVERAL or len(endings_of_pose) < _FEWEST:
        return []
    # Endings may number repeats of one target instead, which lie at one place.
    axes = list("xyz")
    poses = [match["pose"] if match else "" for match in matches]
    rows = pd.DataFrame(p, columns=axes).assign(pose=poses).dropna()
    within = rows.groupby("pose")[axes].std().max(axis=1).median()
    apart = float(within) > _APART * float(rows[axes].std().max())
    return sorted(counts) if apart else []


def labels_without_targets(sniffed: Sniffed, roles: Roles) -> dict[str, list[str]]:
    """Return columns of labels such as P1_A, by their name, without the endings of targets."""
    bare: dict[str, list[str]] = {}
    for name in sniffed.texts if len(roles.positions) == 1 else ():
        (place,) = roles.positions.values()
        if endings := label_endings(sniffed.words(name), sniffed.columns(place)):
            stated = TargetOfRow(names=(name,), endings=dict.fromkeys(endings, "T1"))
            bare[name] = [stated.of(word)[0] for word in sniffed.words(name)]
    return bare


def _nearer(words: Sequence[str], p_m: Array, T_base_ee: Array | None) -> bool:
    """Return whether the nominal arm agrees much better if each word is a target of its own."""
    if T_base_ee is None:
        return False
    known = np.isfinite(p_m).all(axis=1) & np.isfinite(T_base_ee).all(axis=(1, 2))
    target, names = pd.factorize(np.array(words)[known])
    of_one = p_m[known][:, None]
    of_several = np.full((len(of_one), len(names), 3), np.nan)
    of_several[np.arange(len(of_one)), target] = of_one[:, 0]
    fit_of_one = placed_by_points(T_base_ee[known], of_one)
    fit_of_several = placed_by_points(T_base_ee[known], of_several)
    if fit_of_one is None or fit_of_several is None:
        return False
    return fit_of_several.scatter_m * _CLEARER < fit_of_one.scatter_m


def target_names(words: Sequence[str]) -> dict[str, str]:
    """Return for each word a target's name of its own: its ASCII letters and digits.

    Words that leave none, or the name of another word, are called T1, T2, … by their places in the
    list. Names of columns reserve `u` for uncertainties, and `base1` … for targets on the base.
    """

    def bare(word: str) -> str:
        name = "".join(letter for letter in word if letter.isascii() and letter.isalnum())
        return f"T{name}" if name.isdigit() or name.startswith("base") else name

    named: dict[str, str] = {}
    for word in words:
        if (name := bare(word)) not in ("", "u", *named.values()):
            named[word] = name
    for k, word in enumerate(words, start=1):
        numbered = (f"T{number}" for number in itertools.count(k))
        if word not in named:
            named[word] = next(name for name in numbered if name not in named.values())
    return {word: named[word] for word in words}
