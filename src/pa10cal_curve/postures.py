"""Postures of a chain's arm, drawn at random: along curves of three kinds, at any feasible roll."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array, homogeneous
from pa10cal.errors import CurveError
from pa10cal_curve.angles import arm_posture, first_axes
from pa10cal_curve.curve import Curve, helix, serpenoid, spline_through
from pa10cal_curve.points import lay_points
from pa10cal_curve.roll import RollMap, feasible_rolls, joint_limits

#: A curve is so much longer than the links laid along it.
_SPARE = 1.6
#: The base leaves the first link by up to this part of the joints' limit.
_LEAN = 0.9
#: Shapes tried for each posture wanted, at most.
_MOST_TRIES = 200


@dataclass(frozen=True)
class ChainPostures:
    """P postures of the arm that `chain_arm` describes."""

    q_rad: Array  # (P, 2 n) joint positions
    shape: NDArray[np.str_]  # (P,) `spline`, `helix` or `wave`
    p_m: Array  # (P, n + 1, 3) where links join, in the arm's base frame [m]
    refused: int  # shapes drawn that the links do not fit on, or that no roll brings within limits


def draw_postures(
    links: int, link_m: float, limit_rad: float, count: int, rng: np.random.Generator
) -> ChainPostures:
    """Draw postures along splines, helices and travelling waves in turn.

    The arm's base lies anywhere about the first link, within the limits; the roll is drawn evenly
    from all that keep them.

    Args:
        links: of the chain.
        limit_rad: how far every joint turns, either way.

    Raises:
        CurveError: when hardly any shape can be taken.
    """
    q_rad: list[Array] = []
    shapes: list[str] = []
    places_m: list[Array] = []
    refused = 0
    names = list(_SHAPES)
    either_way = np.array([-limit_rad, limit_rad])
    limits = joint_limits(either_way, either_way, links)
    while len(q_rad) < count:
        name = names[len(q_rad) % len(names)]
        points = lay_points(_SHAPES[name](links * link_m, link_m, rng), link_m, links)
        found = None
        if points.n == links:
            base = _leant(points.directions[0], _LEAN * limit_rad * rng.uniform(), rng)
            directions = np.vstack([base, points.directions])
            found = _any_roll(RollMap.of(directions), limits, rng)
        if found is None:
            refused += 1
            if refused > _MOST_TRIES * count:
                raise CurveError(
                    "hardly any shape is within the joints' limits",
                    where="limit_deg",
                    value=float(np.degrees(limit_rad)),
                    allowed=f"at least a posture in {_MOST_TRIES} shapes drawn",
                    remedy="let the joints turn farther",
                )
            continue
        T_base = homogeneous(first_axes(directions, found), points.p_m[0])
        q_rad.append(arm_posture(points.p_m, T_base, link_m))
        shapes.append(name)
        places_m.append((points.p_m - points.p_m[0]) @ T_base[:3, :3])
    return ChainPostures(np.array(q_rad), np.array(shapes), np.array(places_m), refused)


def _any_roll(chain: RollMap, limits: Array, rng: np.random.Generator) -> float | None:
    """Draw a roll evenly from all that keep the limits; None where none does."""
    free = feasible_rolls(chain, limits)
    if not len(free):
        return None
    widths = free[:, 1] - free[:, 0]
    before = np.cumsum(widths) - widths
    along = rng.uniform(0.0, float(widths.sum()))
    k = int(np.searchsorted(before, along, side="right")) - 1
    return float(free[k, 0] + along - before[k])


def _leant(x: Array, by_rad: float, rng: np.random.Generator) -> Array:
    """Return a direction that leaves another by an angle, to any side."""
    aside = np.cross(x, rng.standard_normal(3))
    return np.asarray(np.cos(by_rad) * x + np.sin(by_rad) * aside / np.linalg.norm(aside))


def _spline(length_m: float, link_m: float, rng: np.random.Generator) -> Curve:
    """Return a spline through a random walk of steps of two links."""
    points_m, x = [np.zeros(3)], np.array([1.0, 0.0, 0.0])
    for _ in range(int(np.ceil(_SPARE * length_m / (2.0 * link_m))) + 1):
        points_m.append(points_m[-1] + 2.0 * link_m * x)
        x = _leant(x, np.radians(rng.uniform(0.0, 100.0)), rng)
    return spline_through(np.array(points_m))


def _helix(length_m: float, link_m: float, rng: np.random.Generator) -> Curve:
    radius_m = link_m * rng.uniform(0.8, 4.0)
    pitch_m = link_m * rng.uniform(-8.0, 8.0)
    per_turn_m = float(np.hypot(2.0 * np.pi * radius_m, pitch_m))
    return helix(radius_m, pitch_m, _SPARE * length_m / per_turn_m, rng.uniform(0.0, 2.0 * np.pi))


def _wave(length_m: float, _link_m: float, rng: np.random.Generator) -> Curve:
    """Return a moment of a serpenoid wave that travels."""
    waves, amplitude_rad = rng.uniform(0.5, 2.5), np.radians(rng.uniform(20.0, 80.0))
    phase_rad = rng.uniform(0.0, 2.0 * np.pi)
    return serpenoid(_SPARE * length_m, waves, float(amplitude_rad), phase_rad)


_SHAPES: dict[str, Callable[[float, float, np.random.Generator], Curve]] = {
    "spline": _spline,
    "helix": _helix,
    "wave": _wave,
}
