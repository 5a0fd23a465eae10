"""Which M poses the inner level uses."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.errors import CalibrationError
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose


def spread_poses(observations: Observations[Pose], count: int | Literal["all"]) -> tuple[str, ...]:
    """Choose poses far from each other: each next one is the farthest from those chosen.

    The paper does not specify which 8 of its 27 it took; on a 3 x 3 x 3 pattern this gives corners.

    Args:
        observations: measured poses.
        count: M, or `all`.

    Raises:
        CalibrationError: when there are fewer poses than requested.
    """
    labels, places = _places(observations)
    _check(count, len(labels))
    if count == "all" or count == len(labels):
        return tuple(str(label) for label in labels)
    from_centre = np.linalg.norm(places - places.mean(axis=0), axis=1)
    chosen = [int(np.argmax(from_centre))]
    nearest = np.linalg.norm(places - places[chosen[0]], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return tuple(str(labels[k]) for k in sorted(chosen))


def random_poses(
    observations: Observations[Pose], count: int | Literal["all"], draws: int, random_seed: int
) -> list[tuple[str, ...]]:
    """Draw random choices of M poses; none when all poses are used anyway."""
    labels, _ = _places(observations)
    _check(count, len(labels))
    if count == "all" or count == len(labels):
        return []
    generator = np.random.default_rng(random_seed)
    return [
        tuple(sorted(str(label) for label in generator.choice(labels, count, replace=False)))
        for _ in range(draws)
    ]


def rows_of(observations: Observations[Pose], poses: tuple[str, ...]) -> NDArray[np.intp]:
    """Return the rows of the named poses, at every load."""
    return np.flatnonzero(np.isin(observations.pose, poses))


def _places(observations: Observations[Pose]) -> tuple[NDArray[np.str_], Array]:
    """Return each label with the mean place of its rows."""
    labels, codes = np.unique(observations.pose, return_inverse=True)
    counts = np.bincount(codes)
    places = np.stack(
        [
            np.bincount(codes, weights=observations.measured.T_instr_target[:, axis, 3]) / counts
            for axis in range(3)
        ],
        axis=1,
    )
    return labels, places


def _check(count: int | Literal["all"], available: int) -> None:
    if count != "all" and count > available:
        raise CalibrationError(
            "more inner poses than measured poses",
            where="calibration.inner_poses",
            value=count,
            allowed=f"1 to {available}, or 'all'",
            remedy="lower inner_poses",
        )
