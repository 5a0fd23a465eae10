"""Labels that two logs share: which columns hold them, and which rows they join.

A label may come again, as that of a pose that the arm visits again. The k-th reading under it then
belongs to the k-th joints, both counted in the files, whether or not each row can be used.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arrays import Index, Mask
from pa10cal.campaign.raw_rows import InFile

#: Columns of labels share so many labels, and this part of those of the shorter column, at least.
SHARED, SHARED_PART = 3, 0.8
#: Why a reading has no joints under its label, though the log of the joints has the label.
LESS_OFTEN = "the log of the joints has its label several times, and less often than the readings"
LOST = "the row of the joints for this visit of its label cannot be used"
UNCLEAR = (
    "the two logs have its label in different numbers, and one of them has rows that cannot be read"
)


def shared_labels(
    joints: Mapping[str, Sequence[str]], readings: Mapping[str, Sequence[str]]
) -> tuple[str, str] | None:
    """Return the columns of text, one of each log, that hold the same labels; None for none.

    Names of columns do not matter. The joints' log must have half as many labels as rows at least.
    """
    best, columns = (SHARED_PART, SHARED - 1), None
    for spelling in SPELLINGS:
        for (logged, ours), (read, theirs) in product(joints.items(), readings.items()):
            shared = _shared(ours, theirs, spelling)
            if len(set(ours) - {""}) >= 0.5 * len(ours) and shared[1] >= SHARED and shared > best:
                best, columns = shared, (logged, read)
    return columns


def _shared(
    joints: Sequence[str], readings: Sequence[str], spelling: Callable[[str], str]
) -> tuple[float, int]:
    """Return which part of the labels of the shorter column both columns have, and how many.

    Both are 0 where the spelling makes one of different labels in a column.
    """
    written = [set(texts) - {""} for texts in (joints, readings)]
    ours, theirs = ({spelling(label) for label in labels} for labels in written)
    if [len(ours), len(theirs)] != [*map(len, written)]:
        return 0.0, 0
    shared_count = len(ours & theirs)
    return shared_count / max(min(len(ours), len(theirs)), 1), shared_count


def _bare(label: str) -> str:
    """Return the letters and digits of a label in lower case, numbers in it apart.

    A whole number with decimals, as programs write 1.0 for 1, is that number.
    """
    if (whole := re.fullmatch(r"\s*(\d+)[.,]0+\s*", label)) is not None:
        return whole[1]
    numbers_apart = re.sub(r"(?<=\d)[\W_]+(?=\d)", ".", label.casefold())
    return re.sub(r"[^\w.]|_|(?<!\d)\.|\.(?!\d)", "", numbers_apart)


#: How labels of two logs are compared: as written, or else by letters and digits.
SPELLINGS: tuple[Callable[[str], str], ...] = (str, _bare)


@dataclass(frozen=True)
class Visits:
    """The visits of the arm under the labels of one log, of N rows that can be used.

    They are counted in the file, also where a row cannot be used.
    """

    label: NDArray[np.str_]  # (N,) as it is compared
    visit: Index  # (N,) of the rows under its label, from 0
    count: Index  # (N,) how many rows the file has under its label
    once: Mask  # (N,) whether there is one, or all repeat it exactly
    unread: bool = False  # whether the file has rows of which no label is known

    @classmethod
    def of(cls, label: NDArray[np.str_], in_file: InFile) -> Visits:
        """Return the visits of the rows of `in_file` that can be used, with their labels (N,)."""
        every = in_file.labels.astype(object)
        every[in_file.number] = label  # of rows of targets, without the target
        rows = pd.DataFrame({"label": every, "anew": ~in_file.repeats})
        rows = rows[~in_file.unread]
        by_label = rows.groupby("label")
        counted = pd.DataFrame(
            {
                "visit": by_label.cumcount(),
                "count": by_label["label"].transform("size"),
                "once": by_label["anew"].transform("sum") == 1,
            }
        ).loc[in_file.number]
        visit, count, once = (counted[name].to_numpy() for name in counted)
        return cls(label, visit, count, once, bool(in_file.unread.any()))

    def spelled(self, spelling: Callable[[str], str]) -> Visits:
        """Return the visits under labels in another spelling."""
        return replace(self, label=np.array([spelling(label) for label in self.label], str))


def by_label(joints: NDArray[np.str_], readings: NDArray[np.str_]) -> Index:
    """Return the row of the joints for each reading by its label, -1 where there is none.

    See `by_visit`; the labels (M,) and (N,) are those of all rows of the two files.
    """
    logs = (Visits.of(labels, InFile.of_all(len(labels))) for labels in (joints, readings))
    return by_visit(*logs)[0]


def by_visit(joints: Visits, readings: Visits) -> tuple[Index, NDArray[np.str_]]:
    """Return the row of the joints for each reading (N,) by its label, -1 where there is none.

    Joints that were logged once under a label belong to all readings under it. Of a label that the
    joints' log has several times, the k-th reading has the k-th joints. Labels are compared as
    written, or by their letters and digits where the logs share more labels so.

    Also returned is why a reading (N,) has none, "" where its label is not in the joints' log.
    """
    both = joints.label.tolist(), readings.label.tolist()
    spelling = max(SPELLINGS, key=lambda spelling: _shared(*both, spelling))
    joints, readings = joints.spelled(spelling), readings.spelled(spelling)
    rows_under: dict[str, dict[int, int]] = {}  # row of the joints by visit, by label
    for row, (label, visit) in enumerate(zip(joints.label, joints.visit.tolist(), strict=True)):
        rows_under.setdefault(str(label), {})[visit] = row
    rows_under.pop("", None)  # no label
    station, why = np.full(len(readings.label), -1), np.full(len(readings.label), "", object)
    for k, label in enumerate(readings.label.tolist()):
        rows = rows_under.get(label)
        if rows is None:
            continue
        first = next(iter(rows.values()))
        visit, count = int(readings.visit[k]), int(joints.count[first])
        if joints.once[first]:
            station[k] = first
        elif count != readings.count[k] and (joints.unread or readings.unread):
            why[k] = UNCLEAR
        elif visit in rows:
            station[k] = rows[visit]
        else:
            why[k] = LOST if visit < count else LESS_OFTEN
    return station, why.astype(str)
