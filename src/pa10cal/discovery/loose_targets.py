"""Targets that are loose on the tool: their distances from the others scatter.

Distances between targets of one rigid tool need no model of the arm. Where those of one target
scatter by more than noise and those among the others do not, that target moves on its mount.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from pa10cal.arrays import MEDIAN_TO_SIGMA, Array
from pa10cal.discovery.rules import LOOSE
from pa10cal.fit.tails import distances_between
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.results.discovery import Unexplained


class _Distance(NamedTuple):
    """How the distance between two targets scatters."""

    targets: tuple[int, int]
    scatter_m: float  # standard deviation, robustly
    noise_m: float  # of that the stated uncertainty gives
    surely_m: float  # scatter less some standard errors of its estimate

    @property
    def ratio(self) -> float:
        return self.scatter_m / self.noise_m


def loose_targets(poses: Observations) -> tuple[Unexplained, ...]:
    """Return the target that is loose, or two of which one is, as an unexplained part of the error.

    Of a group, those of each campaign. Nothing is told where fewer than three targets were
    measured: which of two moves cannot be told, nor whether the stated uncertainty is too small.
    """
    campaigns = poses.by_campaign()
    if not campaigns:
        return _loose(poses)
    return tuple(
        each.model_copy(update={"of": f"{each.of} of {name}"})
        for name, own in campaigns.items()
        for each in _loose(own)
    )


def _loose(poses: Observations) -> tuple[Unexplained, ...]:
    """Return the loose target of one campaign."""
    measured = poses.measured
    if len(poses) == 0 or measured.places_m.shape[1] < LOOSE.targets:
        return ()
    distances = list(_distances(measured))
    if not distances:
        return ()
    # The steadiest distance shows the noise where the stated uncertainty is too small.
    noise_ratio = max(1.0, min(each.ratio for each in distances))
    moving = [
        each for each in distances if each.surely_m > LOOSE.ratio * noise_ratio * each.noise_m
    ]
    common = set.intersection(*(set(each.targets) for each in moving)) if moving else set()
    if not common:
        return ()
    names = [measured.target_names[target] for target in sorted(common)]
    worst = max(moving, key=lambda each: each.scatter_m)
    steady_mm = 1e3 * min(each.scatter_m for each in distances)
    between = _knocked_between(poses, worst, noise_ratio)
    lies = "whatever the arm does: it is loose, or its mount gives way; fasten it, or"
    if between is not None:
        lies = (
            f"by one step between poses {between[0]} and {between[1]}: it was knocked; give it "
            "another name from there on, or"
        )
    why = (
        f"its distances from other targets scatter by up to {1e3 * worst.scatter_m:.3f} mm, the "
        f"steadiest of all distances by {steady_mm:.3f} mm, {lies} calibrate without it"
    )
    return (
        Unexplained(
            of=f"target {' or '.join(names)}",
            form=None,
            shared_error_mm=1e3 * float(np.sqrt(worst.scatter_m**2 - worst.noise_m**2)),
            why=why,
        ),
    )


def _knocked_between(
    poses: Observations, moving: _Distance, noise_ratio: float
) -> tuple[str, str] | None:
    """Return the poses between which one step makes a distance scatter; None if none does.

    Args:
        noise_ratio: of the scatter of the steadiest distance to the stated noise.
    """
    length_m = distances_between(poses.measured.places_m)[moving.targets]
    in_time = np.argsort(poses.states.time_s, kind="stable")
    in_time = in_time[np.isfinite(length_m[in_time])]
    length_m = length_m[in_time]
    first = range(LOOSE.either_side, len(length_m) - LOOSE.either_side + 1)
    if not first:
        return None
    squares = [sum(part.var() * len(part) for part in np.split(length_m, [row])) for row in first]
    row = first[int(np.argmin(squares))]
    steady_m = np.concatenate([part - np.median(part) for part in np.split(length_m, [row])])
    if MEDIAN_TO_SIGMA * np.median(np.abs(steady_m)) > LOOSE.ratio * noise_ratio * moving.noise_m:
        return None
    return str(poses.pose[in_time[row - 1]]), str(poses.pose[in_time[row]])


def _distances(measured: Instrument) -> Iterator[_Distance]:
    """Yield the distances that enough poses show."""
    places_m, covariance = measured.places_m, measured.stated_covariance
    for pair, length_m in distances_between(places_m).items():
        seen = np.flatnonzero(np.isfinite(length_m))
        if len(seen) < LOOSE.least_poses:
            continue
        between_m = places_m[seen, pair[0]] - places_m[seen, pair[1]]
        along = between_m / length_m[seen, None]
        rows = [slice(3 * target, 3 * target + 3) for target in pair]
        by_targets = np.zeros((len(seen), covariance.shape[1]))
        by_targets[:, rows[0]], by_targets[:, rows[1]] = along, -along
        noise_m = _root_mean(np.einsum("pi,pij,pj->p", by_targets, covariance[seen], by_targets))
        away_m = np.abs(length_m[seen] - np.median(length_m[seen]))
        scatter_m = MEDIAN_TO_SIGMA * float(np.median(away_m))
        std = LOOSE.median_errors / np.sqrt(len(seen))
        yield _Distance(pair, scatter_m, noise_m, scatter_m * (1.0 - LOOSE.standard_errors * std))


def _root_mean(squares: Array) -> float:
    return float(np.sqrt(squares.mean()))
