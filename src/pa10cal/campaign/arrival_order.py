"""Directions of arrival from the order of poses, where no approach was logged."""

from __future__ import annotations

import numpy as np
import pandas as pd

#: A joint that turned less [rad, or m of a sliding joint] has not moved.
_STOOD_STILL = 1e-4


def with_arrivals(table: pd.DataFrame) -> tuple[pd.DataFrame, bool]:
    """Return the table with directions of arrival, and whether they are those of the order.

    Where no joint of any configuration has one, each joint is taken to come straight from where it
    stood in the configuration measured before, of whatever kind; one that stays keeps the direction
    of its last movement, and the first configuration has none.

    Args:
        table: from `campaign.table.read_pose_table`.
    """
    logged = [name for name in table.columns if name.startswith("s") and name[1:].isdigit()]
    if len(table) == 0 or table[logged].to_numpy().any():
        return table, False
    in_time = table.sort_values("time_s", kind="stable")
    positions = [
        next(name for name in (f"q{joint[1:]}_rad", f"q{joint[1:]}_m") if name in table.columns)
        for joint in logged
    ]
    moved = np.diff(in_time[positions].to_numpy(dtype=float), axis=0, prepend=np.nan)
    direction = pd.DataFrame(np.sign(moved), index=in_time.index, columns=logged)
    direction = direction.mask(np.abs(moved) < _STOOD_STILL).ffill().fillna(0.0)
    return table.assign(**{name: direction[name].astype(np.int8) for name in logged}), True
