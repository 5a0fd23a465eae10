"""Noise of readings along the axes of their instrument, where nobody stated it axis by axis.

A camera is ten times less certain along its line of sight than across, and a tracker's orientations
may be ten times better than its positions suggest. A campaign states one uncertainty of positions,
and often none of orientations. An arm with springs is fitted to the calibration poses, and the
squares of what it leaves along each axis, with the variance that the fit took from them, are the
variances that it is weighted by next, until they settle (expectation and maximisation: Dempster,
Laird and Rubin 1977).

Positions stay as certain as stated on the whole: their uncertainty is distributed over the axes,
and only where the axes differ by much and the statement is about right. Else it may be the arm that
errs along one axis, as one whose joints all turn about the vertical. Orientations without a
statement are as certain as they scatter, where that is less than was assumed; more may be the arm's
error, which the scatter of a calibration takes up.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.campaign.fitted_arm import ArmFit, once_each
from pa10cal.errors import CalibrationError
from pa10cal.observe.observations import Observations
from pa10cal.rules import READINGS

#: Poses below which noise axis by axis is not told (statistics).
_LEAST_POSES = 30
#: Rounds of fit and variances, at most, and the relative change of every standard deviation after
#: which there is no further one (computing).
_MOST_ROUNDS, _SAME_SCATTER = 30, 0.02
#: Scatter below this part of what is stated is rounding, not noise (computing).
_LEAST_PART = 0.01


class Unstated(NamedTuple):
    """What a campaign does not state of the uncertainty of its readings."""

    places: bool  # of positions, axis by axis
    turns: bool  # of orientations


class Uncertainty(NamedTuple):
    """Standard uncertainties of readings, in all axes alike."""

    place_m: float  # of a coordinate, as stated
    turn_rad: float  # of an orientation about an axis, as stated or assumed


class NoiseShown(NamedTuple):
    """Readings as certain as they show, and what to say of that."""

    readings: Observations
    notes: list[str]


def with_noise_shown(
    readings: Observations,
    unstated: Unstated,
    u: Uncertainty,
    chain: Chain,
    payload: Payload | None,
    by_joints: Array,
) -> NoiseShown:
    """Return readings with the noise that they show along the axes in which they were measured.

    Args:
        readings: single readings, with the covariance that is stated or assumed.
        u: standard uncertainties, as stated or assumed.
        chain: of the nominal arm.
        payload: what the arm carries; None where that is not known.
        by_joints: (P, b, b) covariance of the readings by uncertain joint positions.
    """
    unchanged = NoiseShown(readings, [])
    if not any(unstated) or not len(readings.measured.noise_axes):
        return unchanged
    grid = np.flatnonzero(readings.kind == "grid")
    some = grid[once_each(readings.take(grid))]
    if len(some) < _LEAST_POSES:
        return unchanged
    try:
        scatter = _scatter_of(readings.take(some), unstated, u, chain, payload, by_joints[some])
    except (CalibrationError, np.linalg.LinAlgError):
        return unchanged  # base and targets are not determined
    if scatter is None:
        return unchanged
    notes = []
    u_place_m = u_turn_rad = None
    places_m, turns_rad = scatter[:3], scatter[3:]
    if unstated.places and _differ(places_m):
        times_stated = _rms(places_m) / u.place_m
        as_stated = times_stated <= READINGS.as_stated
        notes.append(_of_places(places_m, as_stated=as_stated, inverse=readings.measured.inverse))
        u_place_m = places_m / times_stated if as_stated else None
    if unstated.turns and len(turns_rad):
        shown_rad = turns_rad if _differ(turns_rad) else np.full(3, _rms(turns_rad))
        if (shown_rad < u.turn_rad / READINGS.as_stated).any():
            u_turn_rad = np.minimum(shown_rad, u.turn_rad)
            notes.append(_of_turns(u_turn_rad))
    if u_place_m is None and u_turn_rad is None:
        return NoiseShown(readings, notes)
    measured = readings.measured.with_noise_along_axes(u_place_m, u_turn_rad)
    return NoiseShown(replace(readings, measured=measured), notes)


def _rms(sizes: Array) -> float:
    return float(np.sqrt(np.mean(sizes**2)))


def _differ(sizes: Array) -> bool:
    """Return whether the scatter along one axis is so many times that along another."""
    return bool(sizes.max() > READINGS.axes_differ * sizes.min())


def _of_places(sizes_m: Array, *, as_stated: bool, inverse: bool) -> str:
    """Return what the readings show of positions along the axes, in words."""
    x, y, z = (f"{1e3 * size:.2g}" for size in sizes_m)
    frame = "target (rotation.inverse: pose)" if inverse else "instrument"
    shown = f"positions scatter by {x}, {y} and {z} mm along x, y and z of the {frame}, "
    columns = "state u_x_mm, u_y_mm and u_z_mm of the rows"
    shown += "about an arm fitted to them"
    if as_stated:
        return f"{shown}, and count as uncertain in that proportion; {columns} if they are not"
    return (
        f"{shown}, more than stated: {columns} if the instrument is so, as a camera is in depth; "
        "else the arm is"
    )


def _of_turns(sizes_rad: Array) -> str:
    """Return what the readings show of orientations, in words."""
    x, y, z = (f"{1e3 * size:.2g}" for size in sizes_rad)
    each = f"{x} mrad" if x == y == z else f"{x}, {y} and {z} mrad about x, y and z"
    return f"orientations, of unstated uncertainty, count as uncertain as they scatter, {each}"


def _scatter_of(
    poses: Observations,
    unstated: Unstated,
    u: Uncertainty,
    chain: Chain,
    payload: Payload | None,
    by_joints: Array,
) -> Array | None:
    """Return the scatter of poses about a fitted arm by the axes of noise; None of a wrong log."""
    measured = weighted = poses.measured
    axis, seen = measured.noise_axes, measured.components_seen
    to_axes = measured.along_noise_axes()
    back = to_axes.swapaxes(1, 2)
    least = _LEAST_PART * np.repeat(u, 3)[: axis.max() + 1]
    fit, at = ArmFit.begun(poses, chain, payload)
    sizes = np.zeros(0)
    for _ in range(_MOST_ROUNDS):
        own = weighted.stated_covariance
        fit = fit.weighted_by(own + by_joints)
        at, left = fit.fitted(at)
        if left.is_of_a_wrong_log:
            return None
        # the part of what is left that is the instrument's, expected, and its variance
        part = to_axes @ own @ np.linalg.inv(own + by_joints)
        errors = part @ np.concatenate([left.residual[:, :, None], left.taken], axis=2)
        spread = (to_axes @ own - part @ own) @ back
        variance = np.sum(errors**2, axis=2) + np.diagonal(spread, axis1=1, axis2=2)
        counted = left.usual[:, None] & seen
        by_axis = [variance[:, axis == k][counted[:, axis == k]].mean() for k in range(len(least))]
        before, sizes = sizes, np.maximum(np.sqrt(by_axis), least)
        if len(before) and (np.abs(sizes - before) <= _SAME_SCATTER * before).all():
            break
        weighted = measured.with_noise_along_axes(
            sizes[:3] if unstated.places else None,
            sizes[3:] if unstated.turns and len(sizes) > 3 else None,
        )
    return sizes
