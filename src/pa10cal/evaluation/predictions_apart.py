"""How far apart two fitted models put a frame of the robot, and how far they should."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc

from pa10cal.arrays import Array
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.forward import Forward, conditions
from pa10cal.frame.pose_error import cross_matrix
from pa10cal.results.comparison import ComparedFrame

#: Postures compared, and the seed of their draw.
POSTURES, SEED = 400, 1
#: Steps along the range of a joint in which angles seen by both are looked for.
_STEPS = 3601
#: Refinements of base and tool: each squares what is left of a wrong one.
_REFINED = 6


def shared_postures(first: FittedModel, second: FittedModel) -> Array:
    """Return postures (P, n) drawn from the joint angles in which both models hold.

    There is none where both have seen no common angle of some joint.
    """
    arm = first.arm
    low, high = np.nan_to_num(arm.limits_rad, posinf=2 * np.pi, neginf=-2 * np.pi).T
    grid = np.linspace(low, high, _STEPS)
    held = [
        where
        for model in (first, second)
        for where in (model.seen, model.falls_back.within if model.falls_back else None)
        if where is not None
    ]
    common = np.all([np.ones_like(grid, dtype=bool), *(where.each(grid) for where in held)], axis=0)
    if not common.any(axis=0).all():
        return np.zeros((0, arm.n))
    rng = np.random.default_rng(SEED)
    q = np.empty((POSTURES, arm.n))
    for joint in range(arm.n):
        q[:, joint] = rng.choice(grid[common[:, joint], joint], POSTURES)
    return q


def shared_loads(first: FittedModel, second: FittedModel) -> tuple[float, ...]:
    """Return the external loads of postures, in turn: none, and the heaviest both have seen."""
    heaviest = [max(m.fitted_to.loads_N, default=0.0) for m in (first, second) if m.fitted_to]
    most_N = min(heaviest, default=0.0)
    return (0.0, most_N) if most_N > 0.0 and len(heaviest) == 2 else (0.0,)


@dataclass(frozen=True)
class _Predicted:
    """A frame as a model predicts it in P postures."""

    T: Array  # (P, 4, 4) its poses [m]
    # (P, 6, k) its motions under k independent causes of standard size one; None where the
    # covariance is not known
    noise: Array | None


def _predicted(
    model: FittedModel, frame: str, q: Array, load_N: Array, temperature_C: float | None
) -> _Predicted:
    forward = Forward.of(model, frame)
    states = forward.states(q, conditions(model, len(q), load_N, temperature_C=temperature_C))
    end = forward.end(states)
    noise = None
    if model.covariance is not None:
        variances, axes = np.linalg.eigh(forward.covariance)
        noise = forward.by_parameters(states, end) @ (axes * np.sqrt(np.maximum(variances, 0.0)))
    return _Predicted(end.T @ forward.T_end_frame, noise)


def compared_frame(
    first: FittedModel, second: FittedModel, frame: str, q: Array, load_N: Array
) -> ComparedFrame:
    """Compare one frame in postures (P, n) under loads (P,)."""
    temperature_C = _temperature(first, second)
    one, other = (_predicted(m, frame, q, load_N, temperature_C) for m in (first, second))
    apart_mm, apart_deg = _apart(one.T, other.T)
    moved = _base_and_tool_fitted(other.T, one.T)
    left_mm, left_deg = _apart(one.T, moved)
    explained_mm, _ = _apart(moved, other.T)
    expected_mm = expected_deg = chance = None
    if one.noise is not None and other.noise is not None:
        noise = np.concatenate([one.noise, other.noise], axis=2)
        by_place, by_turn = _without_base_and_tool(noise, one.T)
        expected_m, chance_m = _expected(by_place, 1e-3 * left_mm)
        expected_rad, chance_rad = _expected(by_turn, np.radians(left_deg))
        expected_mm, expected_deg = 1e3 * expected_m, float(np.degrees(expected_rad))
        chance = min(1.0, 2.0 * min(chance_m, chance_rad))
    return ComparedFrame(
        rms_mm=_rms(apart_mm),
        peak_mm=float(apart_mm.max()),
        orientation_deg=_rms(apart_deg),
        base_and_tool_mm=_rms(explained_mm),
        remaining_rms_mm=_rms(left_mm),
        remaining_peak_mm=float(left_mm.max()),
        remaining_deg=_rms(left_deg),
        expected_mm=expected_mm,
        expected_deg=expected_deg,
        chance=chance,
    )


def _temperature(first: FittedModel, second: FittedModel) -> float | None:
    """Return the temperature between those of two fits; None where one is not known."""
    known = [m.fitted_to.temperature_C for m in (first, second) if m.fitted_to]
    mean = float(np.mean(known)) if len(known) == 2 else np.nan
    return mean if np.isfinite(mean) else None


def _apart(T: Array, T_other: Array) -> tuple[Array, Array]:
    """Return distances [mm] and angles [deg] between poses."""
    turn = Rotation.from_matrix(np.swapaxes(T[:, :3, :3], 1, 2) @ T_other[:, :3, :3])
    distance = np.linalg.norm(T[:, :3, 3] - T_other[:, :3, 3], axis=1)
    return 1e3 * distance, np.degrees(turn.magnitude())


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _base_and_tool_fitted(T: Array, T_wanted: Array) -> Array:
    """Return poses carried to others by one motion of the base and one of what the flange carries.

    Places determine the base and where the frame sits on the flange, attitudes how it is turned.
    """
    for _ in range(_REFINED):
        step, *_ = np.linalg.lstsq(_by_base_and_tool(T), (T_wanted - T)[:, :3, 3].ravel())
        base, offset = np.eye(4), np.eye(4)
        base[:3, :3] = Rotation.from_rotvec(step[3:6]).as_matrix()
        base[:3, 3], offset[:3, 3] = step[:3], step[6:]
        T = base @ T @ offset
    turn = np.eye(4)
    missing = np.swapaxes(T[:, :3, :3], 1, 2) @ T_wanted[:, :3, :3]
    turn[:3, :3] = Rotation.from_matrix(missing).mean().as_matrix()
    moved: Array = T @ turn
    return moved


def _by_base_and_tool(T: Array) -> Array:
    """Return how places follow motions of the base and offsets of the tool, (3 P, 9)."""
    ones = np.broadcast_to(np.eye(3), (len(T), 3, 3))
    columns = np.concatenate([ones, -cross_matrix(T[:, :3, 3]), T[:, :3, :3]], axis=2)
    return columns.reshape(-1, 9)


def _without_base_and_tool(motions: Array, T: Array) -> tuple[Array, Array]:
    """Return what base and tool leave of motions (P, 6, k) of places and of attitudes, (3 P, k)."""
    count = motions.shape[2]
    places = motions[:, :3].reshape(-1, count)
    columns = _by_base_and_tool(T)
    fitted, *_ = np.linalg.lstsq(columns, places)
    turns = motions[:, 3:] - fitted[3:6]
    R = T[:, :3, :3]
    turns = turns - R @ (np.swapaxes(R, 1, 2) @ turns).mean(axis=0)
    return places - columns @ fitted, turns.reshape(-1, count)


def _expected(noise: Array, left: Array) -> tuple[float, float]:
    """Return the rms size expected of differences, and the chance of those that are left.

    Their sum of squares is a weighted sum of chi-square variables; one chi-square of the same mean
    and variance stands for it (Satterthwaite).

    Args:
        noise: (3 P, k) differences under k independent causes of standard size one.
        left: (P,) differences found.
    """
    square = noise.T @ noise
    mean, spread = float(np.trace(square)), float(np.sum(square**2))
    found = float(np.sum(left**2))
    expected = float(np.sqrt(mean / len(left)))
    if spread == 0.0:
        return expected, float(found == 0.0)
    return expected, float(chdtrc(mean**2 / spread, found * mean / spread))
