"""Rows of one target each: which one a row is of, and rows of one pose made one."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.campaign.nominal_fit import placed_by_points
from pa10cal.campaign.own_columns import TargetOfRow
from pa10cal.campaign.raw_rows import RawRows, same_commands
from pa10cal.campaign.recognise import Roles, has_word, words_of_name
from pa10cal.campaign.sniffing import Sniffed

UNKNOWN = "the row names no target that is stated"
#: Rows of one pose whose joints differ by less were taken in it [deg, mm].
_SAME = 0.01


def targets_of_rows(
    raw: RawRows, stated: TargetOfRow
) -> tuple[RawRows, NDArray[np.str_], NDArray[np.str_]]:
    """Return the rows with a known target, its name in each, and what the label is without it."""
    fields = [str(word) for word in raw.text_of(stated.names[0])]
    split = [stated.of(field) for field in fields]
    keep = np.array([target != "" for _, target in split], dtype=bool)
    values = [f"{stated.names[0]} = {fields[k]!r}" for k in np.flatnonzero(~keep)]
    split = [each for each in split if each[1] != ""]
    poses, targets = (np.array([each[k] for each in split], dtype=str) for k in (0, 1))
    return raw.take(keep, UNKNOWN, values), targets, poses


def one_row_a_pose(raw: RawRows, targets: NDArray[np.str_], q: Sequence[str]) -> RawRows:
    """Return rows with what was measured of the other targets blank, those of one pose as one.

    Rows (N,) are of these targets. They are of one pose if its label and all else that they state
    of it is the same, and the joints `q` agree. A target that occurs again is of the next repeat.
    """
    columns, non_numeric = dict(raw.columns), dict(raw.non_numeric)
    for name in columns:
        target = name.removeprefix("u_").rpartition("_")[0].rpartition("_")[0]
        if name.endswith(("_x_mm", "_y_mm", "_z_mm")) and target:
            other = targets != target
            columns[name] = np.where(other, np.nan, columns[name])
            lines = set(raw.line[~other].tolist())
            known = non_numeric.get(name, {}).items()
            non_numeric[name] = {line: text for line, text in known if line in lines}
    raw = replace(raw, columns=columns, non_numeric=non_numeric)
    stated = [name for name in ("pose", "kind", "load_N", "repeat") if name in columns]
    there = [name for name in q if name in columns]
    if "pose" not in stated and not there:
        return raw
    keys = pd.DataFrame({name: columns[name] for name in stated}, index=range(len(raw)))
    if there:
        keys["joints"] = same_commands(np.nan_to_num(raw.numbers_of(there)), _SAME)
    again = _groups(keys.assign(target=targets)).cumcount()
    group = _groups(keys.assign(again=again)).ngroup().to_numpy()
    first = np.unique(group, return_index=True)[1]
    if len(first) == len(raw):
        return raw
    numbers = [n for n in columns if np.issubdtype(columns[n].dtype, np.floating)]
    means = pd.DataFrame({name: columns[name] for name in numbers}).groupby(group).mean()
    # What stands where a number should is that of the whole row.
    line_of = dict(zip(raw.line.tolist(), raw.line[first][group].tolist(), strict=True))
    moved = {
        name: {line_of[line]: text for line, text in texts.items()}
        for name, texts in non_numeric.items()
    }
    merged = replace(raw, non_numeric=moved).at(first)
    note = f"{raw.file}: {len(raw)} rows of one target each are {len(first)} configurations"
    return replace(
        merged.with_columns({name: means[name].to_numpy() for name in numbers if name != "time_s"}),
        notes=(*raw.notes, note),
    )


def _groups(keys: pd.DataFrame) -> Any:
    """Return rows grouped by all their keys."""
    return keys.groupby(list(keys), sort=False, dropna=False)


# Which column of an unknown file says it.

#: So many targets at most, and rows of each at least.
_MOST, _FEWEST = 12, 3
#: A label that ends with a target: a letter after a number, or what a sign sets apart.
_ENDING = re.compile(r"(?P<pose>.*\w)(?P<ending>(?<=\d)[A-Za-z]|[_.:/\s-]+[A-Za-z]{0,12}\d{0,2})")
#: Part of the labels that must end so, and of the poses that must have several targets.
_NEARLY_ALL, _SEVERAL = 0.95, 0.5
#: Targets of one pose are further apart than this part of the spread of all places.
_APART = 1e-3
#: With targets apart the nominal arm must be so many times nearer than with one.
_NEARER = 5.0


def target_column(
    sniffed: Sniffed, roles: Roles, p_m: Array, T_base_ee: Array | None
) -> dict[str, object] | None:
    """Return `target` of campaign.yaml for rows of one target each; None for rows of one alone.

    The one position of each row is at p_m (N, 3), the nominal end at (N, 4, 4), where it is known.
    Endings of labels such as P1_A and P1_B tell it, a column that is called after targets, or one
    by whose words the nominal arm is much nearer.
    """
    used = {*roles.joints, *roles.torques, *roles.uncertain.values(), *roles.times}
    used |= {name for names in roles.positions.values() for name in names}
    free = [name for name in sniffed.names if name not in used]
    for name in free:
        if endings := label_endings(sniffed.words(name), p_m):
            return {"names": name, "endings": _named(endings)}
    for name in free:
        words = sniffed.words(name)
        counts = Counter(words)
        if "" in counts or not 2 <= len(counts) <= _MOST or min(counts.values()) < _FEWEST:
            continue
        title = words_of_name(sniffed.titled(name))
        if has_word(title, "one target") or _nearer(words, p_m, T_base_ee):
            return {"names": name, "words": _named(sorted(counts))}
    return None


def named_in_other_log(joints: Sniffed, file: str, readings: str) -> list[str]:
    """Return what is to be done where the joints' log names the target of each reading."""
    return [
        f"target: {joints.titled(name)} of {file} says which target a row is of, and is not read "
        f"there: copy that column into {readings}, and run pa10cal columns again"
        for name in joints.names
        if has_word(words_of_name(joints.titled(name)), "one target")
        and 2 <= len(set(joints.words(name))) <= _MOST
    ]


def label_endings(labels: Sequence[str], p: Array) -> list[str]:
    """Return the endings of labels that stand for targets at places (N, 3); nothing for none."""
    found = [_ENDING.fullmatch(label) for label in labels]
    split = [(each["pose"], each["ending"]) for each in found if each is not None]
    endings = Counter(ending for _, ending in split)
    poses: dict[str, set[str]] = {}
    for pose, ending in split:
        poses.setdefault(pose, set()).add(ending)
    if len(split) < _NEARLY_ALL * len(labels) or not 2 <= len(endings) <= _MOST:
        return []
    several = float(np.mean([len(of) > 1 for of in poses.values()]))
    if min(endings.values()) < _FEWEST or several < _SEVERAL or len(poses) < _FEWEST:
        return []
    # Repeats of one target end so too.
    rows = pd.DataFrame(p, columns=list("xyz")).assign(
        pose=[each["pose"] if each else "" for each in found]
    )
    rows = rows.dropna()
    within = rows.groupby("pose")[list("xyz")].std().max(axis=1).median()
    apart = float(within) > _APART * float(rows[list("xyz")].std().max())
    return sorted(endings) if apart else []


def labels_without_targets(sniffed: Sniffed, roles: Roles) -> dict[str, list[str]]:
    """Return columns of labels such as P1_A, by their name, without what stands for targets."""
    bare: dict[str, list[str]] = {}
    for name in sniffed.texts if len(roles.positions) == 1 else ():
        (place,) = roles.positions.values()
        if endings := label_endings(sniffed.words(name), sniffed.columns(place)):
            stated = TargetOfRow(names=(name,), endings=dict.fromkeys(endings, "T1"))
            bare[name] = [stated.of(word)[0] for word in sniffed.words(name)]
    return bare


def _nearer(words: Sequence[str], p_m: Array, T_base_ee: Array | None) -> bool:
    """Return whether the nominal arm is much nearer where each word is a target of its own."""
    if T_base_ee is None:
        return False
    known = np.isfinite(p_m).all(axis=1) & np.isfinite(T_base_ee).all(axis=(1, 2))
    number, count = pd.factorize(np.array(words)[known])
    one = p_m[known][:, None]
    apart = np.full((len(one), len(count), 3), np.nan)
    apart[np.arange(len(one)), number] = one[:, 0]
    fits = [placed_by_points(T_base_ee[known], each) for each in (one, apart)]
    if fits[0] is None or fits[1] is None:
        return False
    return fits[1].scatter_m * _NEARER < fits[0].scatter_m


def _named(words: Sequence[str]) -> Mapping[str, str]:
    """Return a name of letters and digits for each word."""
    named: dict[str, str] = {}
    for k, word in enumerate(words, start=1):
        bare = "".join(letter for letter in word if letter.isascii() and letter.isalnum())
        bare = f"T{bare}" if bare.isdigit() or bare.startswith("base") else bare
        taken = bare in ("", "u") or bare in named.values()
        named[word] = f"T{k}" if taken else bare
    return named
