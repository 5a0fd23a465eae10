"""Commanded joint positions in order of time: repeats found, columns of the raw-data contract."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

Array = NDArray[np.float64]

#: Commands whose joints differ by less are one command [rad].
SAME_COMMAND_RAD = 1e-6


def command_columns(time_s: Array, q_rad: Array) -> pd.DataFrame:
    """Return the columns that say when and where each reading was taken.

    The same command again is another repeat of the same pose; labels count the commands in the
    order in which they first appear, and sort as text in that order.

    Args:
        time_s: (N,) times, ascending.
        q_rad: (N, n) commanded joint positions.

    Returns:
        time_s, kind (`grid`), pose, load_N (0), repeat, q1_deg … qn_deg.
    """
    number = same_commands(q_rad)
    digits = max(5, len(str(number.max(initial=0) + 1)))
    columns: dict[str, object] = {
        "time_s": time_s,
        "kind": "grid",
        "pose": [f"P{k:0{digits}d}" for k in number + 1],
        "load_N": 0,
        "repeat": pd.Series(number).groupby(number).cumcount().to_numpy() + 1,
    }
    for joint, column in enumerate(np.degrees(q_rad).T, start=1):
        columns[f"q{joint}_deg"] = column
    return pd.DataFrame(columns)


def same_commands(q_rad: Array) -> NDArray[np.intp]:
    """Number the commands (N,) from 0 in the order in which they first appear."""
    count = len(q_rad)
    pairs = cKDTree(q_rad).query_pairs(SAME_COMMAND_RAD, p=np.inf, output_type="ndarray")
    ones = np.ones(len(pairs), dtype=np.int8)
    graph = coo_array((ones, (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    group = connected_components(graph, directed=False)[1]
    return np.asarray(pd.factorize(group)[0], dtype=np.intp)
