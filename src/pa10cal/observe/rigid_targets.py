"""Targets of one rigid tool: what the distances between them say of the readings."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations

import numpy as np

from pa10cal.arrays import MEDIAN_TO_SIGMA, Array, Mask
from pa10cal.observe.instrument import Instrument
from pa10cal.rules import SCATTER


def distances_between(places_m: Array) -> dict[tuple[int, int], Array]:
    """Return the distances (P,) of every two targets at places (P, B, 3), nan where not seen.

    None where distances from the instrument, (P, B, 1), are all that was measured.
    """
    if places_m.shape[2] != 3:
        return {}
    return {
        (a, b): np.linalg.norm(places_m[:, a] - places_m[:, b], axis=1)
        for a, b in combinations(range(places_m.shape[1]), 2)
    }


def keep_their_distances(measured: Instrument) -> Mask:
    """Return in which of P poses the distances between targets are as in all poses, (P,).

    Readings of such poses are correct, however far they are from a model. False where fewer than
    two targets were seen, and of targets that were computed from one pose.
    """
    distances = distances_between(measured.places_m)
    if not distances or scatter_of_computed_m(measured) is not None:
        return np.zeros(len(measured.places_m), dtype=bool)
    off_m, sigma_m = _off_and_scatter(distances.values())
    seen = np.isfinite(off_m)
    same = np.where(seen, off_m, 0.0) <= SCATTER.same_distance * sigma_m
    return np.asarray(same.all(axis=0) & seen.any(axis=0))


def scatter_of_computed_m(measured: Instrument) -> float | None:
    """Return by how much distances between targets scatter that were computed from one pose.

    None of targets that were read one by one, whose distances scatter as readings do.
    """
    distances = distances_between(measured.places_m)
    apart = [d_m for d_m in distances.values() if (d_m > 0.0).any()]
    if not apart:
        return None
    _, sigma_m = _off_and_scatter(apart)
    variance = np.diagonal(measured.stated_covariance, axis1=1, axis2=2)
    u_m = float(np.sqrt(np.median(variance[measured.components_seen])))
    largest_m = float(sigma_m.max(initial=0.0))
    return largest_m if largest_m < SCATTER.computed_distance * u_m else None


def _off_and_scatter(distances_m: Iterable[Array]) -> tuple[Array, Array]:
    """Return by how much D distances (P,) are off their medians, (D, P), and scatter, (D, 1).

    Of those that were seen at all.
    """
    distance_m = np.stack([*distances_m])
    distance_m = distance_m[np.isfinite(distance_m).any(axis=1)]
    off_m = np.abs(distance_m - np.nanmedian(distance_m, axis=1, keepdims=True))
    return off_m, MEDIAN_TO_SIGMA * np.nanmedian(off_m, axis=1, keepdims=True)
