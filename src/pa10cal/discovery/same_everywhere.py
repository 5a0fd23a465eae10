"""Whether campaigns, or turns of a joint, agree on its error by its angle."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from pa10cal.arrays import Array
from pa10cal.discovery.motor_ripple import JointSeries
from pa10cal.discovery.sensor_or_gear import Agreement

#: Arcs of a turn over which errors are averaged, and poses that each must have.
_ARCS = 120
_LEAST_POSES = 2


def agreement(series: Sequence[JointSeries]) -> Agreement | None:
    """Return how well campaigns and turns agree where two of them were; None where none were.

    The error of a pose is what the model has of it and what it leaves. Means of each pair of
    campaigns or turns are compared less their own mean: a constant is a zero, and not an error that
    depends on the angle.

    Args:
        series: the joint in each campaign.
    """
    parts = [part for each in series for part in _by_turn(each)]
    products, count = np.zeros(3), 0
    for one, other in combinations(parts, 2):
        both = np.isfinite(one[0]) & np.isfinite(other[0])
        if both.sum() < 2:
            continue
        variances = one[1][both], other[1][both]
        weight = 1.0 / (variances[0] + variances[1])
        share = weight / weight.sum()
        a, b = (mean[both] - share @ mean[both] for mean in (one[0], other[0]))
        products += (
            weight @ (a * b),
            weight @ (a**2 - variances[0] * (1.0 - share)),
            weight @ (b**2 - variances[1] * (1.0 - share)),
        )
        count += int(both.sum())
    across, first, second = products
    if not count or min(first, second) <= 0.0:
        return None
    correlation = float(np.clip(across / np.sqrt(first * second), -1.0, 1.0))
    return Agreement(correlation, float(across / first), count)


def _by_turn(series: JointSeries) -> list[tuple[Array, Array]]:
    """Return mean error and its variance in every arc, turn by turn; nan for none."""
    turns = series.q_rad / (2.0 * np.pi)
    turn = np.floor(turns).astype(int)
    arc = np.minimum(((turns - turn) * _ARCS).astype(int), _ARCS - 1)
    found = []
    for number in np.unique(turn):
        here = turn == number
        weight = np.bincount(arc[here], series.weight[here], _ARCS)
        error_rad = (series.left_rad + series.error_rad)[here]
        total = np.bincount(arc[here], series.weight[here] * error_rad, _ARCS)
        enough = np.bincount(arc[here], minlength=_ARCS) >= _LEAST_POSES
        mean, variance = np.full((2, _ARCS), np.nan)
        mean[enough], variance[enough] = total[enough] / weight[enough], 1.0 / weight[enough]
        found.append((mean, variance))
    return found
