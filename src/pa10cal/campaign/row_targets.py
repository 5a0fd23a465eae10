"""Files with one target a row: which column names it, and how its targets are called."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.campaign.column_names import has_word, words_of_name
from pa10cal.campaign.nominal_fit import placed_by_points
from pa10cal.campaign.own_columns import without_ending
from pa10cal.campaign.recognise import Roles
from pa10cal.campaign.sniffing import Sniffed

#: Targets at most.
_MOST_TARGETS = 12
#: Rows of each target at least; words and endings of fewer rows are slips.
_LEAST_ROWS = 3
#: Poses in labels with endings at least.
_LEAST_POSES = 3
#: A label that ends with a target: a letter after a number, as in P1A, or a word of letters and
#: digits behind a sign, as in P1_A, P1.2, P1 - SMR2 or P1 (SMR2).
_LETTER, _WORD = r"(?<=\d)[A-Za-z]", r"[_.:/\s(-]+[A-Za-z]{0,12}\d{0,2}\)?"
_ENDING = re.compile(rf"(?P<pose>.*\w)(?P<ending>{_LETTER}|{_WORD})")
#: Part of the rows with such a word or ending, and of the poses with several targets, at least.
_NEARLY_ALL, _SEVERAL = 0.95, 0.5
#: Targets of one pose scatter by more than this part of the scatter of all places.
_APART = 1e-3
#: Within a pose the arm scatters by less than this part of what targets do, each beside all rows.
_STILL = 0.1
#: With several targets the misfit of the nominal arm must be so many times smaller than with one.
_CLEARER = 5.0


def target_column(
    sniffed: Sniffed,
    roles: Roles,
    p_m: Array,
    T_base_ee: Array | None,
    *,
    whole_labels: bool = False,
) -> dict[str, object] | None:
    """Return `target` of campaign.yaml for a file whose rows are of one of several targets each.

    The column of targets has labels with endings, such as P1_A and P1_B, or is named as one, or its
    words make the nominal arm agree much better. None where there is no such column.

    Args:
        sniffed: the file.
        roles: roles of its columns.
        p_m: (N, 3) the position in each row.
        T_base_ee: (N, 4, 4) the nominal end in each row, where it is known.
        whole_labels: whether a log of joints has the same labels, which then name no target.
    """
    free = _free_columns(sniffed, roles)
    arm = sniffed.columns(roles.joints) if roles.joints else None
    if T_base_ee is not None:
        arm = T_base_ee[:, :3].reshape(-1, 12)
    for name in () if whole_labels else free:
        endings = label_endings(sniffed.words(name), p_m, arm)
        if endings and not sniffed.holds_numbers(name):
            return {"names": name, "endings": target_names(endings)}
    for name in free:
        words = sniffed.words(name)
        frequent, share = _frequent(words)
        if not 2 <= len(frequent) <= _MOST_TARGETS or share < _NEARLY_ALL:
            continue
        if _names_target(sniffed.titled(name)) or _nearer(words, frequent, p_m, T_base_ee):
            return {"names": name, "words": target_names(frequent)}
    return None


def target_columns_not_used(sniffed: Sniffed, roles: Roles) -> Iterator[str]:
    """Yield which columns are named after targets but not read as such, and why."""
    for name in _free_columns(sniffed, roles):
        frequent, share = _frequent(sniffed.words(name))
        if not _names_target(sniffed.titled(name)) or len(frequent) < 2 or share < _SEVERAL:
            continue
        why = (
            f"it names {len(frequent)} targets, and at most {_MOST_TARGETS} are taken for such"
            if len(frequent) > _MOST_TARGETS
            else f"{1.0 - share:.0%} of the rows name none, or one of fewer than {_LEAST_ROWS} rows"
        )
        yield (
            f"target: {sniffed.titled(name)} is not taken for it, so all rows count as of one "
            f"target: {why}; correct the file, or state target"
        )


def _free_columns(sniffed: Sniffed, roles: Roles) -> list[str]:
    """Return the columns of words or whole numbers that have no role but that of labels."""
    used = {*roles.joints, *roles.torques, *roles.uncertain.values(), *roles.times}
    used |= {name for names in roles.positions.values() for name in names}
    used |= {name for key, name in roles.single.items() if key != "pose"}
    return [name for name in sniffed.texts if name not in used]


def _names_target(title: str) -> bool:
    """Return whether a column is named after targets, and not after their speed, state or size."""
    words = words_of_name(title)
    return has_word(words, "one target") and not has_word(words, "no position", "no name")


def _frequent(words: Sequence[str]) -> tuple[list[str], float]:
    """Return the words of enough rows for a target, sorted, and the part of the rows with these."""
    counts = Counter(word for word in words if word)
    frequent = sorted(word for word, count in counts.items() if count >= _LEAST_ROWS)
    return frequent, sum(counts[word] for word in frequent) / max(len(words), 1)


def named_in_other_log(joints: Sniffed, file: str, readings: str) -> list[str]:
    """Return what the user must do where the joints' log names the target of each reading."""
    return [
        f"target: {joints.titled(name)} of {file} says which target a row is of, and is not read "
        f"there: copy that column into {readings}, and run pa10cal columns again"
        for name in joints.names
        if _names_target(joints.titled(name))
        and 2 <= len({*joints.words(name)} - {""}) <= _MOST_TARGETS
    ]


def label_endings(labels: Sequence[str], p: Array, arm: Array | None = None) -> list[str]:
    """Return the endings of labels that name targets, sorted; none where none do.

    Args:
        labels: the label of each of N rows.
        p: (N, 3) the position in each row.
        arm: (N, k) joint positions, or numbers of the nominal end, in each row, where known.
    """
    matches = [_ENDING.fullmatch(label) for label in labels]
    frequent, share = _frequent([match["ending"] if match else "" for match in matches])
    if share < _NEARLY_ALL or not 2 <= len(frequent) <= _MOST_TARGETS:
        return []
    named = [match is not None and match["ending"] in frequent for match in matches]
    pose = np.array([match["pose"] if match else "" for match in matches])
    rows = pd.DataFrame({"pose": pose, "ending": [m["ending"] if m else "" for m in matches]})
    endings_of_pose = rows[named].groupby("pose")["ending"].nunique()
    if len(endings_of_pose) < _LEAST_POSES or (endings_of_pose > 1).mean() < _SEVERAL:
        return []
    # Endings may number repeats of one target instead, which lie at one place; or the places of a
    # grid, as in R2_C5, between which the arm moves.
    within, of_all = _scatter(p, pose, named)
    if not within > _APART * of_all:
        return []
    if arm is not None:
        arm_within, arm_of_all = _scatter(arm, pose, named)
        if arm_within * of_all > _STILL * within * arm_of_all:
            return []
    return frequent


def _scatter(values: Array, pose: NDArray[np.str_], rows: Sequence[bool]) -> tuple[float, float]:
    """Return the largest scatter of values (N, k) in some rows: within a pose (median), of all."""
    known = np.isfinite(values).all(axis=1) & np.asarray(rows)
    frame = pd.DataFrame(values[known])
    within = frame.groupby(pose[known]).std().max(axis=1).median()
    return float(within), float(frame.std().max())


def labels_without_targets(sniffed: Sniffed, roles: Roles) -> dict[str, list[str]]:
    """Return columns of labels such as P1_A, by their name, without the endings of targets."""
    if len(roles.positions) != 1:
        return {}
    (place,) = roles.positions.values()
    p = sniffed.columns(place)
    bare: dict[str, list[str]] = {}
    for name in sniffed.texts:
        labels = sniffed.words(name)
        if endings := label_endings(labels, p):
            bare[name] = [without_ending(label, endings) for label in labels]
    return bare


def _nearer(
    words: Sequence[str], targets: Sequence[str], p_m: Array, T_base_ee: Array | None
) -> bool:
    """Return whether the nominal arm agrees much better if each word is a target of its own."""
    if T_base_ee is None:
        return False
    known = np.isfinite(p_m).all(axis=1) & np.isfinite(T_base_ee).all(axis=(1, 2))
    known &= np.isin(words, targets)
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
