"""Touches gathered by configuration and ball."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.campaign.logs import Readings, Touches

Index = NDArray[np.intp]
Mask = NDArray[np.bool_]

#: Touches that a ball needs.
LEAST_TOUCHES = 4


@dataclass(frozen=True)
class TouchGroups:
    """Touches of C configurations on B balls, padded to T a ball.

    Attributes:
        of_touch: (N,) configuration of every touch.
        first: (C,) first touch of every configuration, which names it.
        row: (C, B, T) touch, 0 where there is none.
        valid: (C, B, T) where there is one.
    """

    of_touch: Index
    first: Index
    row: Index
    valid: Mask

    def __len__(self) -> int:
        return len(self.first)


def configurations(rows: Readings) -> Index:
    """Number the configurations in the order in which they first appear."""
    keys = pd.DataFrame(
        {"kind": rows.kind, "pose": rows.pose, "load": rows.load_N, "repeat": rows.repeat}
    )
    return np.asarray(keys.groupby(list(keys), sort=False).ngroup(), dtype=np.intp)


def group_touches(touches: Touches, balls: int) -> TouchGroups:
    """Gather touches, which are in order of time, by configuration and ball."""
    of_touch = configurations(touches)
    count = int(of_touch.max(initial=-1)) + 1
    key = of_touch * balls + touches.ball
    order = np.argsort(key, kind="stable")
    sizes = np.bincount(key, minlength=count * balls)
    place = np.arange(len(key)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    row = np.zeros((count * balls, int(sizes.max(initial=0))), dtype=np.intp)
    valid = np.zeros(row.shape, dtype=bool)
    row[key[order], place] = order
    valid[key[order], place] = True
    first = np.unique(of_touch, return_index=True)[1]
    shape = (count, balls, row.shape[1])
    return TouchGroups(of_touch, first, row.reshape(shape), valid.reshape(shape))


def commonest(of_touch: Index, dwell: Index) -> Index:
    """Return the dwell in which each configuration has most touches (the first of equals)."""
    pairs, counts = np.unique(np.column_stack([of_touch, dwell]), axis=0, return_counts=True)
    best_last = np.lexsort((-pairs[:, 1], counts, pairs[:, 0]))
    pairs = pairs[best_last]
    last = np.append(np.diff(pairs[:, 0]) > 0, True)
    return np.asarray(pairs[last, 1], dtype=np.intp)


def unusable_balls(valid: Mask, coplanar: Mask, names: tuple[str, ...]) -> NDArray[np.object_]:
    """Return (C,) why a configuration's balls cannot all be located; "" where they can.

    Args:
        valid: (C, B, T) touches that are there.
        coplanar: (C, B) balls whose touches lie in one plane.
        names: names of the balls.
    """
    count = valid.sum(axis=2)
    bad = (count < LEAST_TOUCHES) | coplanar
    reasons = np.full(len(valid), "", dtype=object)
    for c in np.flatnonzero(bad.any(axis=1)):
        b = int(np.argmax(bad[c]))
        if count[c, b] == 0:
            reasons[c] = f"ball {names[b]} of this configuration is missing"
        elif count[c, b] < LEAST_TOUCHES:
            reasons[c] = f"ball {names[b]} of this configuration has fewer than four touches"
        else:
            reasons[c] = f"the touches on ball {names[b]} of this configuration are coplanar"
    return reasons
