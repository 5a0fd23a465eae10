"""Commanded joint positions in order of time: repeats found, columns of the raw-data contract."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.campaign.same_commands import labels, same_commands

Array = NDArray[np.float64]


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
    columns: dict[str, object] = {
        "time_s": time_s,
        "kind": "grid",
        "pose": labels(number),
        "load_N": 0,
        "repeat": pd.Series(number).groupby(number).cumcount().to_numpy() + 1,
    }
    for joint, column in enumerate(np.degrees(q_rad).T, start=1):
        columns[f"q{joint}_deg"] = column
    return pd.DataFrame(columns)
