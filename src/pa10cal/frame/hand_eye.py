"""Base frame and target on the end-effector from what an instrument saw: closed form, then refined.

With the nominal model's T_base_ee of every pose these solve T_instr_target = T_instr_base T_base_ee
T_ee_target for the two constant frames, whatever they are: the start of a calibration whose
instrument is anywhere and measures a target that is anywhere. Geometry that is a little wrong is
averaged over. What of the target's place the base frame can mimic (its height, where all attitudes
differ by turns about one axis) these poses leave open: it is held as stated and named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arrays import Array
from pa10cal.errors import CalibrationError
from pa10cal.frame.descent import OPEN, axis_text
from pa10cal.frame.target_fit import TargetProblem, first_guess, refined, residuals

#: Poses that choose between starts.
MOST_POSES = 300
#: Root mean square spread across a line that positions must have to determine a rotation.
LEAST_SPREAD_M = 1e-3


@dataclass(frozen=True)
class HandEye:
    """Base frame and targets, from B targets that were seen."""

    T_instr_base: Array  # (4, 4) instrument from base [m]
    # (3,) standard uncertainty of the directions of the base's x, y and z, per axis across each,
    # taking the residuals as independent
    axis_u_rad: Array
    # (B, 4, 4) end-effector from target [m]; the attitude is the identity where only positions
    # were seen
    T_ee_targets: Array
    # (P, B, 3) seen less modelled positions, along base axes, nan where not seen
    residuals_m: Array
    rms_m: float  # root mean square distance of seen from modelled positions
    rms_rad: float  # root mean square angle between seen and modelled attitudes
    # directions of the targets that the poses do not identify, held as stated
    held: tuple[str, ...]

    def targets(self, T_base_ee: Array) -> Array:
        """Return where the targets are in the instrument's frame, (P, B, 4, 4) [m]."""
        return np.asarray(self.T_instr_base @ T_base_ee[:, None] @ self.T_ee_targets)


def hand_eye_from_poses(
    T_base_ee: Array,
    T_instr_target: Array,
    T_ee_stated: Array | None = None,
    weights: Array | None = None,
) -> HandEye:
    """Solve T_instr_target = T_instr_base T_base_ee T_ee_target for the constant frames.

    Rotations start from the dominant singular vectors of the sum of Kronecker products of measured
    and modelled attitudes (exact for exact data with turns about more than one axis), from the
    positions alone, and from the stated attitude of the target; all starts are refined together
    with the translations by Gauss-Newton steps, and the best is returned.

    Args:
        T_base_ee: (P, 4, 4) modelled end-effector [m].
        T_instr_target: (P, 4, 4) measured target [m].
        T_ee_stated: (4, 4) value kept where the poses do not identify the target; None for the
            end-effector itself.
        weights: (P,) weights of the squared residuals; None for equal ones.

    Returns:
        One target, B = 1.

    Raises:
        CalibrationError: with fewer than three poses.
    """
    T_ee = np.eye(4) if T_ee_stated is None else T_ee_stated
    p_instr_m = T_instr_target[:, None, :3, 3]
    problem = TargetProblem.of(
        T_base_ee, p_instr_m, T_ee[None, :3, 3], weights, T_instr_target[:, :3, :3]
    )
    few = problem.thinned(MOST_POSES)
    turns = [
        _by_kronecker(few),
        _mean_turn(few.weights, few.R_cmm @ T_ee[:3, :3].T @ _transposed(few.R_base)),
        *_by_positions(few),
    ]
    starts = []
    for R_instr_base in turns:
        of_target = _transposed(R_instr_base @ few.R_base) @ few.R_cmm
        starts.append((R_instr_base, _mean_turn(few.weights, of_target)))
    starts.append((starts[1][0], T_ee[:3, :3]))
    return _best(problem, starts, ["the target"])


def target_on_base(T_instr_base: Array, T_base_ee: Array, T_instr_target: Array) -> Array:
    """Return the mean T_ee_target (4, 4) of poses (P, 4, 4), with a base frame that is known."""
    each = np.linalg.inv(T_instr_base @ T_base_ee) @ T_instr_target
    T_ee_target = each.mean(axis=0)
    T_ee_target[:3, :3] = _nearest_turn(T_ee_target[:3, :3])
    return np.asarray(T_ee_target)


def hand_eye_from_points(
    T_base_ee: Array,
    p_instr_m: Array,
    p_ee_stated_m: Array | None = None,
    weights: Array | None = None,
    names: Sequence[str] | None = None,
) -> HandEye:
    """Solve p_instr = T_instr_base (T_base_ee p_ee) for the base frame and the places of B targets.

    Carried into the base frame the equations are linear in a general matrix in the place of the
    base's rotation; its nearest rotation starts the Gauss-Newton steps from any base and any
    places. A rigid fit of the stated places is another start; the best is returned.

    Args:
        T_base_ee: (P, 4, 4) modelled end-effector [m].
        p_instr_m: (P, B, 3) measured positions [m], nan where a target was not seen.
        p_ee_stated_m: (B, 3) value where the poses do not identify a position; None for the
            origin of the end-effector.
        weights: (P,) weights of the squared residuals; None for equal ones.
        names: (B,) names of the targets, for what is held.

    Raises:
        CalibrationError: with fewer than three poses, when a target was never seen, or when the
            positions lie on one line, so that the base may turn about it.
    """
    targets = p_instr_m.shape[1]
    named = [f"target {name}" for name in names or range(1, targets + 1)]
    times = np.isfinite(p_instr_m[..., 0]).sum(axis=0)
    unseen = [name for name, seen in zip(named, times, strict=True) if not seen]
    if unseen:
        raise CalibrationError(
            f"{unseen[0]} was not observed in any pose",
            where="poses for the base frame",
            allowed="targets observed in some of the poses",
            remedy="remove this target, or measure it",
        )
    p_ee_m = np.zeros((targets, 3)) if p_ee_stated_m is None else p_ee_stated_m
    problem = TargetProblem.of(T_base_ee, p_instr_m, p_ee_m, weights, None)
    turns = _by_positions(problem.thinned(MOST_POSES))
    if not turns:
        raise CalibrationError(
            "the positions are collinear or coincide, so the turn of the base about them is free",
            where="poses for the base frame",
            allowed="poses whose positions span a plane",
            remedy="measure poses further apart across the line",
        )
    return _best(problem, [(turn, np.eye(3)) for turn in turns], named)


def _best(
    problem: TargetProblem, starts: Sequence[tuple[Array, Array]], names: list[str]
) -> HandEye:
    """Refine every start, given as the rotations of base and target, and return the best.

    Some of the poses decide which is best.
    """
    few = problem.thinned(MOST_POSES)
    found = [refined(few, first_guess(few, *start), roughly=True) for start in starts]
    best, _, split = min(found, key=lambda each: each[1].cost)
    if split.unidentified.size:
        best = replace(best, p_ee_m=problem.p_ee_stated_m)
    guess, at, split = refined(problem, best)
    poses, targets = problem.shape
    turning = len(problem.R_cmm)
    residuals_m = np.full((poses, targets, 3), np.nan)
    residuals_m[problem.pose, problem.target], residuals_rad = residuals(problem, guess)
    T_instr_base = np.eye(4)
    T_instr_base[:3, :3], T_instr_base[:3, 3] = guess.R_instr_base, guess.p_instr_base_m
    T_ee_targets = np.tile(np.eye(4), (targets, 1, 1))
    T_ee_targets[:, :3, :3], T_ee_targets[:, :3, 3] = guess.R_ee_target, guess.p_ee_m
    spare = max(len(at.residual) - at.by_step.shape[1], 1)
    covariance = np.linalg.pinv(at.by_step.T @ at.by_step)[3:6, 3:6] * at.cost / spare
    across = (np.trace(covariance) - np.diag(covariance)) / 2.0
    return HandEye(
        T_instr_base=T_instr_base,
        axis_u_rad=np.sqrt(across),
        T_ee_targets=T_ee_targets,
        residuals_m=residuals_m,
        rms_m=_rms(residuals_m[problem.pose, problem.target], problem.weights[problem.pose]),
        rms_rad=_rms(residuals_rad, problem.weights) if turning else 0.0,
        held=tuple(_said(direction, names) for direction in split.unidentified.T),
    )


def _by_positions(problem: TargetProblem) -> list[Array]:
    """Return rotations of the base to start from, by positions; none if they span no plane."""
    root = problem.root_weight[:, None]
    mean = np.average(problem.p_instr_m, axis=0, weights=root[:, 0] ** 2)
    off = root * (problem.p_instr_m - mean)
    spread = np.linalg.svd(off, compute_uv=False)
    if spread[1] <= max(OPEN * spread[0], LEAST_SPREAD_M * np.linalg.norm(root)):
        return []
    stated = problem.in_base(problem.p_ee_stated_m)
    stated = root * (stated - np.average(stated, axis=0, weights=root[:, 0] ** 2))
    turns = [_nearest_turn(off.T @ stated)]
    # x = S (p - mean) + s - R_base p_ee, linear in S (nine), s and the places.
    of_S = np.kron(off[:, None, :], np.eye(3)).reshape(-1, 9)
    of_s = np.kron(root, np.eye(3))
    of_places = (-root[..., None] * problem.by_places).reshape(len(of_s), -1)
    x_base_m = (root * problem.p_base_m[problem.pose]).ravel()
    solved = np.linalg.lstsq(np.hstack([of_S, of_s, of_places]), x_base_m, rcond=1e-9)[0]
    # The nine go by columns of S, the inverse of the base's rotation.
    turns.append(_nearest_turn(np.asarray(solved[:9].reshape(3, 3), dtype=np.float64)))
    return turns


def _by_kronecker(problem: TargetProblem) -> Array:
    """Return the rotation of the base by attitudes alone.

    With X the target's rotation R_cmm X' = R_instr_base R_base, so that the sum of R_base (x) R_cmm
    carries X' to as many times R_instr_base as there are poses, and nothing further.
    """
    weighted = problem.weights[:, None, None] * problem.R_base
    summed = np.einsum("pij,pkl->ikjl", weighted, problem.R_cmm).reshape(9, 9)
    first = np.asarray(np.linalg.svd(summed)[0][:, 0], dtype=float)
    dominant = first.reshape(3, 3).T  # by columns
    return _nearest_turn(dominant if np.linalg.det(dominant) > 0.0 else -dominant)


def _nearest_turn(matrix: Array) -> Array:
    """Return the proper rotation nearest to a matrix."""
    U, _, Vt = np.linalg.svd(matrix)
    U[:, 2] *= np.linalg.det(U @ Vt)
    return np.asarray(U @ Vt)


def _mean_turn(weights: Array, turns: Array) -> Array:
    """Return the chordal mean of rotations (P, 3, 3)."""
    return _nearest_turn(np.tensordot(weights, turns, axes=1))


def _transposed(matrices: Array) -> Array:
    return np.swapaxes(matrices, -1, -2)


def _rms(residuals: Array, weights: Array) -> float:
    return float(np.sqrt(np.average((residuals**2).sum(axis=1), weights=weights)))


def _said(direction: Array, names: Sequence[str]) -> str:
    """Describe a direction of the targets: all positions (3 B), then the attitude if measured."""
    places, turn = direction[: 3 * len(names)].reshape(-1, 3), direction[3 * len(names) :]
    parts = []
    if len(names) > 1 and np.abs(places - places[0]).max() < 1e-6:
        parts.append(f"all targets along {axis_text(places[0])}")
    else:
        moved = np.linalg.norm(places, axis=1) > 1e-6
        named = zip(names, places, strict=True)
        parts += [
            f"{k} along {axis_text(p)}" for (k, p), far in zip(named, moved, strict=True) if far
        ]
    if len(turn) and np.linalg.norm(turn) > 1e-6:
        parts.append(f"{names[0]} about {axis_text(turn)}")
    return " with ".join(parts)
