"""What the instrument saw in every pose, in the form in which the general model takes it."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.campaign.averages import average_states, group_means, same_pose_and_load
from pa10cal.campaign.description import Campaign
from pa10cal.campaign.seen import SeenDistances, SeenPoints, SeenPoses, Sightings
from pa10cal.campaign.table import (
    distances_m,
    in_order,
    observations,
    states_of,
    target_names,
    targets_m,
)

Array = NDArray[np.float64]
Index = NDArray[np.intp]


def sightings(
    table: pd.DataFrame, campaign: Campaign, kind: str = "grid", average: bool = True
) -> Sightings:
    """Return what the instrument saw in the poses of one kind.

    Args:
        table: from `campaign.table.read_pose_table`.
        campaign: description of the campaign that the table is of.
        kind: `grid`, `holdout`, `line_x` or `line_y`.
        average: whether repeats of the same pose and load become one row (see
            `campaign.averages.average_repeats`).

    Returns:
        P poses with the instrument's stated uncertainty, divided by the repeats averaged; none when
        the table holds no such rows.
    """
    if campaign.instrument.kind in ("touch_trigger_cmm", "pose"):
        found = observations(table, kind, average=average, covariance="instrument")
        seen = SeenPoses(found.T_instr_ee, found.cov_ee)
        return Sightings(found.pose, found.states, seen, found.repeats)
    rows = in_order(table[table["kind"] == kind])
    pose, states = rows["pose"].to_numpy(dtype=str), states_of(rows)
    code = same_pose_and_load(pose, states.load_N) if average else np.arange(len(rows))
    _, first, repeats = np.unique(code, return_index=True, return_counts=True)
    seen_apart = campaign.instrument.kind == "points"
    see = _points(rows, campaign, code) if seen_apart else _distances(rows, code)
    return Sightings(pose[first], average_states(states, code), see, repeats)


def stated_places_m(campaign: Campaign, names: tuple[str, ...]) -> Array | None:
    """Return the stated places (B, 3) of targets [m], or None where one of them is not stated."""
    stated = campaign.tool.balls_mm
    if not set(names) <= set(stated):
        return None
    return 1e-3 * np.array([stated[name] for name in names], dtype=float)


def _points(rows: pd.DataFrame, campaign: Campaign, code: Index) -> SeenPoints:
    """Average what was seen of each target over the readings in which it was."""
    names = target_names(rows)
    p_instr_m, cov_m2 = targets_m(rows)
    seen = np.isfinite(p_instr_m[..., 0])
    share = group_means(seen.astype(float), code)
    share[share == 0.0] = np.nan  # not seen in any reading
    times = share * np.bincount(code)[:, None]
    p_instr_m = group_means(np.where(seen[..., None], p_instr_m, 0.0), code)
    cov_m2 = group_means(np.where(seen[..., None, None], cov_m2, 0.0), code)
    return SeenPoints(
        names,
        p_instr_m / share[..., None],
        cov_m2 / (share * times)[..., None, None],
        stated_places_m(campaign, names),
    )


def _distances(rows: pd.DataFrame, code: Index) -> SeenDistances:
    d_m, u_m = distances_m(rows)
    return SeenDistances(
        group_means(d_m, code), np.sqrt(group_means(u_m**2, code) / np.bincount(code))
    )
