"""Targets that were knocked or are loose on the tool: their distances from the others change.

Distances between targets of one rigid tool need no model of the arm. Where those of one target
change by one step in time, it was knocked. Where they scatter by more than noise and those among
the others do not, that target moves on its mount.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from pa10cal.arrays import MEDIAN_TO_SIGMA, Array
from pa10cal.discovery.rules import LOOSE
from pa10cal.frame.knocked_targets import knocks_on_body
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.observe.points import distances_between
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


def knocked_targets(poses: Observations) -> tuple[Unexplained, ...]:
    """Return the targets that were knocked, each step as an unexplained part of the error.

    Of a group, those of each campaign. Nothing is told of fewer than three targets.
    """
    return _of_each_campaign(poses, lambda own: tuple(_knocked(own)))


def loose_targets(poses: Observations) -> tuple[Unexplained, ...]:
    """Return the target that is loose, or two of which one is, as an unexplained part of the error.

    Of a group, those of each campaign. Nothing is told where fewer than three targets were
    measured: which of two moves cannot be told, nor whether the stated uncertainty is too small.
    """
    return _of_each_campaign(poses, _loose)


def _of_each_campaign(
    poses: Observations, told: Callable[[Observations], tuple[Unexplained, ...]]
) -> tuple[Unexplained, ...]:
    """Return what is told of the poses, or of each campaign of a group, with its name."""
    campaigns = poses.by_campaign()
    if not campaigns:
        return told(poses)
    return tuple(
        each.model_copy(update={"of": f"{each.of} of {name}"})
        for name, own in campaigns.items()
        for each in told(own)
    )


def _loose(poses: Observations) -> tuple[Unexplained, ...]:
    """Return the loose target of one campaign."""
    measured = poses.measured.single_targets
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
    why = (
        f"its distances from other targets scatter by up to {1e3 * worst.scatter_m:.3f} mm, the "
        f"steadiest of all distances by {steady_mm:.3f} mm, whatever the arm does: it is "
        "loose, or its mount gives way; fasten it, or calibrate without it"
    )
    return (
        Unexplained(
            of=f"target {' or '.join(names)}",
            form=None,
            shared_error_mm=1e3 * float(np.sqrt(worst.scatter_m**2 - worst.noise_m**2)),
            why=why,
        ),
    )


def _knocked(poses: Observations) -> Iterator[Unexplained]:
    """Yield the targets of one campaign that distances show to have been knocked."""
    measured = poses.measured.single_targets
    in_time = np.argsort(poses.states.time_s, kind="stable")
    places_m = measured.places_m[in_time]
    if len(poses) == 0 or places_m.shape[1] < LOOSE.targets or places_m.shape[2] != 3:
        return
    variance = np.diagonal(measured.stated_covariance[in_time], axis1=1, axis2=2)
    u_m = np.sqrt(variance).reshape(places_m.shape)
    load_N = poses.states.load_N[in_time]
    for knock in knocks_on_body(places_m, u_m):
        row, names = knock.row, [measured.target_names[k] for k in knock.targets]
        before, after = (_visit(poses, in_time[k]) for k in (row - 1, row))
        lies = "it was knocked"
        if len({*load_N[:row]} & {*load_N[row:]}) == 0:
            lies += ", or gives way under the load, which is another from there on"
        remedy = "give it another name from there on, or calibrate without it"
        if measured is not poses.measured or places_m.shape[1] == LOOSE.targets:
            remedy = "calibrate the poses before and after as two campaigns, or without it"
        share = row / len(in_time)
        yield Unexplained(
            of=f"target {' or '.join(names)}",
            form=None,
            shared_error_mm=1e3 * knock.shift_m * float(np.sqrt(share * (1.0 - share))),
            why=f"its distances from other targets change by one step between poses {before} and "
            f"{after}: {lies}, by {1e3 * knock.shift_m:.3f} mm at least; {remedy}",
        )


def _visit(poses: Observations, row: int) -> str:
    """Return the pose of a reading, with load and repeat where it was visited more than once."""
    pose = str(poses.pose[row])
    if np.sum(poses.pose == poses.pose[row]) == 1:
        return pose
    return f"{pose} ({poses.states.load_N[row]:g} N, repeat {poses.repeat[row]})"


def _distances(measured: Instrument) -> Iterator[_Distance]:
    """Yield the distances that enough poses show."""
    places_m, covariance = measured.places_m, measured.stated_covariance
    for pair, length_m in distances_between(places_m).items():
        seen = np.flatnonzero(length_m > 0.0)  # at one place they show no direction
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
