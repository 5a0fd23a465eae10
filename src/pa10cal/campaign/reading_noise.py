"""Noise of readings along the axes of their instrument, where nobody stated it axis by axis.

A camera is ten times less certain along its line of sight than across, and a tracker's orientations
may be ten times better than its positions suggest. A campaign states one uncertainty of positions,
and often none of orientations. An arm with springs is fitted to the calibration poses, and the
squares of what it leaves along each axis, with the variance that the fit took from them, are the
variances that it is weighted by next, until they settle (expectation and maximisation: Dempster,
Laird and Rubin 1977).

Errors of an angle grow with the distance, and those of a depth by triangulation with its square:
the readings show whether positions do.

Positions stay as certain as stated on the whole: their uncertainty is distributed over the axes and
distances, and only where these differ by much and the statement is about right. Else it may be the
arm that errs along one axis, as one whose joints all turn about the vertical. Orientations without
a statement are as certain as they scatter, where that is less than was assumed; more may be the
arm's error, which the scatter of a calibration takes up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.campaign.fitted_arm import ArmFit, once_each
from pa10cal.errors import CalibrationError
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.rules import READINGS

#: Poses below which noise axis by axis is not told (statistics).
_LEAST_POSES = 30
#: Rounds of fit and variances, at most, and the relative change of every standard deviation after
#: which there is no further one (computing).
_MOST_ROUNDS, _SAME_SCATTER = 60, 0.005
#: Powers of the distance that positions may scatter by: of an angle, and of triangulation in depth
#: (physics); and the gain in log likelihood that one needs [nat] (level).
_POWERS, _GAIN = (1, 2), 6.0
#: Distances below this part of the usual one count as that (size).
_NEAREST = 0.1
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


class _Scatter(NamedTuple):
    """Scatter of readings along the axes of noise."""

    sizes: Array  # (k,) rms over poses, of positions [m], then of orientations [rad]
    power: int  # of the distance that positions scatter in proportion to
    distance_m: float  # at which they scatter as their rms

    def of_places(self, measured: Instrument) -> Array:
        """Return the scatter of positions along each axis in P poses, (P, 3) [m]."""
        return self.sizes[:3] * ((distances(measured) / self.distance_m) ** self.power)[:, None]

    def is_about(self, other: _Scatter) -> bool:
        """Return whether it differs from another by less than counts as a change."""
        change = np.abs(self.sizes - other.sizes) / other.sizes
        return self.power == other.power and bool(change.max() <= _SAME_SCATTER)


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
    places_m, turns_rad = scatter.sizes[:3], scatter.sizes[3:]
    if unstated.places and (_differ(places_m) or scatter.power):
        times_stated = _rms(places_m) / u.place_m
        as_stated = times_stated <= READINGS.as_stated
        if as_stated or _differ(places_m):
            inverse = readings.measured.inverse
            notes.append(_of_places(scatter, as_stated=as_stated, inverse=inverse))
        u_place_m = scatter.of_places(readings.measured) / times_stated if as_stated else None
    if unstated.turns and len(turns_rad):
        shown_rad = turns_rad if _differ(turns_rad) else np.full(3, _rms(turns_rad))
        if (shown_rad < u.turn_rad / READINGS.as_stated).any():
            u_turn_rad = np.minimum(shown_rad, u.turn_rad)
            notes.append(_of_turns(shown_rad, u.turn_rad))
    if u_place_m is None and u_turn_rad is None:
        return NoiseShown(readings, notes)
    measured = readings.measured.with_noise_along_axes(u_place_m, u_turn_rad)
    return NoiseShown(replace(readings, measured=measured), notes)


def _rms(sizes: Array) -> float:
    return float(np.sqrt(np.mean(sizes**2)))


def _differ(sizes: Array) -> bool:
    """Return whether the scatter along one axis is so many times that along another."""
    return bool(sizes.max() > READINGS.axes_differ * sizes.min())


def _of_places(scatter: _Scatter, *, as_stated: bool, inverse: bool) -> str:
    """Return what the readings show of positions along the axes, in words."""
    x, y, z = (f"{1e3 * size:.2g}" for size in scatter.sizes[:3])
    frame = "target (rotation.inverse: pose)" if inverse else "instrument"
    shown = f"positions scatter by {x}, {y} and {z} mm along x, y and z of the {frame}, "
    columns = "state the uncertainties u of x, y and z of every target"
    shown += ("", "growing with the distance, ", "growing with its square, ")[scatter.power]
    shown += "about an arm fitted to them"
    if as_stated:
        return f"{shown}, and count as uncertain in that proportion; {columns} if they are not"
    return (
        f"{shown}, more than stated: {columns} if the instrument is so, as a camera is in depth; "
        "else the arm is"
    )


def _of_turns(sizes_rad: Array, assumed_rad: float) -> str:
    """Return what the readings show of orientations, in words."""
    x, y, z = (f"{1e3 * size:.2g}" for size in sizes_rad)
    each = f"{x} mrad" if x == y == z else f"{x}, {y} and {z} mrad about x, y and z"
    if sizes_rad.max() > assumed_rad:
        each += f", at most the {1e3 * assumed_rad:.2g} mrad that are assumed"
    return f"orientations, of unstated uncertainty, count as uncertain as they scatter, {each}"


def _scatter_of(
    poses: Observations,
    unstated: Unstated,
    u: Uncertainty,
    chain: Chain,
    payload: Payload | None,
    by_joints: Array,
) -> _Scatter | None:
    """Return the scatter of poses about a fitted arm by the axes of noise; None of a wrong log."""
    measured = weighted = poses.measured
    axis, seen = measured.noise_axes, measured.components_seen
    to_axes = measured.along_noise_axes()
    back = to_axes.swapaxes(1, 2)
    least = _LEAST_PART * np.repeat([u.place_m, u.turn_rad], 3)[: axis.max() + 1]
    fit, at = ArmFit.begun(poses, chain, payload)
    scatter: _Scatter | None = None
    for _ in range(_MOST_ROUNDS):
        own = weighted.stated_covariance
        fit = fit.weighted_by(own + by_joints)
        at, left = fit.fitted(at)
        if left.is_of_a_wrong_log:
            return None
        # Of what is left, r ~ N(0, own + by_joints), the instrument's e ~ N(0, own) is expected to
        # be own (own + by_joints)^-1 r, with covariance own - own (own + by_joints)^-1 own.
        part = to_axes @ own @ np.linalg.inv(own + by_joints)
        errors = part @ np.concatenate([left.residual[:, :, None], left.taken], axis=2)
        spread = (to_axes @ own - part @ own) @ back
        variance = np.sum(errors**2, axis=2) + np.diagonal(spread, axis1=1, axis2=2)
        counted = np.where(left.usual[:, None] & seen, variance, np.nan)
        by_axis = [counted[:, axis == k] for k in range(len(least))]
        before, scatter = scatter, _scatter_by(by_axis, distances(measured), least)
        if before is not None and scatter.is_about(before):
            break
        weighted = measured.with_noise_along_axes(
            scatter.of_places(measured) if unstated.places else None,
            scatter.sizes[3:] if unstated.turns and len(least) > 3 else None,
        )
    return scatter


def distances(measured: Instrument) -> Array:
    """Return the mean distance of the targets from the origin of their frame in P poses, (P,).

    No less than a part of the usual one: noise does not vanish at the origin.
    """
    away_m = np.nanmean(np.linalg.norm(measured.places_m, axis=2), axis=1)
    return np.asarray(np.maximum(away_m, _NEAREST * np.median(away_m)))


def _scatter_by(by_axis: Sequence[Array], distance_m: Array, least: Array) -> _Scatter:
    """Return the scatter by variances (P, c) of the components along each axis, nan if unknown.

    Args:
        distance_m: (P,) of the targets.
        least: (k,) least scatter along each axis.
    """
    nats = {power: _nats_of(power, by_axis[:3], distance_m) for power in _POWERS}
    likeliest = max(nats, key=nats.__getitem__)
    likeliest = likeliest if nats[likeliest] > _GAIN else 0
    usual = np.isfinite(by_axis[0]).any(axis=1)
    middle_m = float(np.mean(distance_m[usual] ** (2 * likeliest)) ** (0.5 / max(likeliest, 1)))
    sizes = np.sqrt([np.nanmean(variance) for variance in by_axis])
    return _Scatter(np.maximum(sizes, least), likeliest, middle_m)


def _nats_of(power: int, by_axis: Sequence[Array], distance_m: Array) -> float:
    """Return the gain in log likelihood by variances (P, c) that grow with the distance."""
    unit = (distance_m ** (2 * power))[:, None]
    gained = 0.0
    for variance in by_axis:
        known = np.isfinite(variance)
        lower = np.log(np.nanmean(variance)) - np.log(np.nanmean(variance / unit))
        gained += 0.5 * float(known.sum() * lower - np.sum(known * np.log(unit)))
    return gained
