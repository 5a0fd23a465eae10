"""Base frame and places of targets by least squares from a start; see `frame.hand_eye`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array
from pa10cal.errors import CalibrationError
from pa10cal.frame.descent import COST_TOLERANCE, Linearised, Split, descend, split_identified

#: How far from the target an error of attitude counts as the error of position it makes there.
LEVER_M = 0.5
LEAST_POSES = 3
#: The null space depends a little on the solution, so it is found again there.
PASSES = 2
#: Part of the cost that makes no difference between two starts.
_ROUGHLY = 1e-6


@dataclass(frozen=True)
class TargetProblem:
    """What was seen, one row a seen target of a pose."""

    shape: tuple[int, int]  # P poses and B targets
    pose: NDArray[np.intp]  # (K,) pose of every row
    target: NDArray[np.intp]  # (K,) target of every row
    p_instr_m: Array  # (K, 3) measured positions
    p_base_m: Array  # (P, 3) modelled positions of the end-effector
    R_base: Array  # (P, 3, 3) modelled attitudes
    R_cmm: Array  # (P, 3, 3) measured attitudes, or none (0, 3, 3)
    p_ee_stated_m: Array  # (B, 3) stated places of the targets
    weights: Array  # (P,) weights of the poses

    @classmethod
    def of(
        cls,
        T_base_ee: Array,
        p_instr_m: Array,
        p_ee_stated_m: Array,
        weights: Array | None,
        R_cmm: Array | None,
    ) -> TargetProblem:
        """Gather what was seen of targets (P, B, 3), nan where one was not; see the attributes.

        Args:
            T_base_ee: (P, 4, 4) modelled end-effector [m].
            p_instr_m: (P, B, 3) measured positions [m].
            p_ee_stated_m: (B, 3) stated places.
            weights: (P,) weights, or None for equal ones.
            R_cmm: (P, 3, 3) measured attitudes, or None.

        Raises:
            CalibrationError: with fewer than three poses.
        """
        seen = np.isfinite(p_instr_m[..., 0])
        poses = int(np.count_nonzero(seen.any(axis=1)))
        if poses < LEAST_POSES:
            raise CalibrationError(
                "too few poses to fit a base frame to",
                where="poses for the base frame",
                value=poses,
                allowed=f"at least {LEAST_POSES}",
                remedy="measure more poses",
            )
        pose, target = np.nonzero(seen)
        return cls(
            shape=(seen.shape[0], seen.shape[1]),
            pose=pose,
            target=target,
            p_instr_m=p_instr_m[seen],
            p_base_m=T_base_ee[:, :3, 3],
            R_base=T_base_ee[:, :3, :3],
            R_cmm=np.zeros((0, 3, 3)) if R_cmm is None else R_cmm,
            p_ee_stated_m=p_ee_stated_m,
            weights=np.ones(len(T_base_ee)) if weights is None else weights,
        )

    def thinned(self, most: int) -> TargetProblem:
        """Return the problem of so many poses at most, drawn at random, always the same."""
        count = self.shape[0]
        if count <= most:
            return self
        # Drawn, not every n-th: what was seen may alternate.
        chosen = np.sort(np.random.default_rng(0).permutation(count)[:most])
        place = np.full(count, -1)
        place[chosen] = np.arange(most)
        kept = place[self.pose] >= 0
        return replace(
            self,
            shape=(most, self.shape[1]),
            pose=place[self.pose[kept]],
            target=self.target[kept],
            p_instr_m=self.p_instr_m[kept],
            p_base_m=self.p_base_m[chosen],
            R_base=self.R_base[chosen],
            R_cmm=self.R_cmm[chosen] if len(self.R_cmm) else self.R_cmm,
            weights=self.weights[chosen],
        )

    @cached_property
    def root_weight(self) -> Array:
        """Square root of the weight of every row, (K,)."""
        return np.sqrt(self.weights[self.pose])

    def in_base(self, p_ee_m: Array) -> Array:
        """Return the modelled places (K, 3) of the targets in the base frame."""
        carried = np.einsum("kij,kj->ki", self._R_rows, p_ee_m[self.target])
        return np.asarray(self.p_base_m[self.pose] + carried)

    @cached_property
    def _R_rows(self) -> Array:
        """Modelled attitude of every row, (K, 3, 3)."""
        return self.R_base[self.pose]

    @cached_property
    def by_places(self) -> Array:
        """Return the derivative (K, 3, 3 B) of those places by the targets' places."""
        by_places = np.zeros((len(self.pose), 3, 3 * self.shape[1]))
        rows, columns = np.arange(len(self.pose))[:, None, None], 3 * self.target[:, None, None]
        by_places[rows, np.arange(3)[:, None], columns + np.arange(3)] = self._R_rows
        return by_places


@dataclass(frozen=True)
class Guess:
    """Base frame, places of the targets, and attitude of the one whose attitude was seen."""

    R_instr_base: Array
    p_instr_base_m: Array
    p_ee_m: Array
    R_ee_target: Array


def first_guess(problem: TargetProblem, R_instr_base: Array, R_ee_target: Array) -> Guess:
    """Return a guess from rotations of base and target: targets as stated, origin by the mean."""
    origins_m = problem.p_instr_m - problem.in_base(problem.p_ee_stated_m) @ R_instr_base.T
    weights = problem.weights[problem.pose]
    p_instr_base_m = np.average(origins_m, axis=0, weights=weights)
    return Guess(R_instr_base, p_instr_base_m, problem.p_ee_stated_m, R_ee_target)


def refined(
    problem: TargetProblem, guess: Guess, *, roughly: bool = False
) -> tuple[Guess, Linearised, Split]:
    """Refine a guess, holding what of the targets the base can mimic.

    Args:
        problem: what was seen.
        guess: where to set out.
        roughly: whether to stop where it is clear which of several guesses leads lowest.

    Returns:
        The solution, the problem there, and which steps of the targets (places of all, then the
        attitude where one was seen) the poses identify.
    """
    for _ in range(1 if roughly else PASSES):
        whole = _linearise(problem, guess, None).by_step
        split = split_identified(whole[:, 6:], whole[:, :6])
        guess, at = descend(
            guess,
            _linearising(problem, split.identified),
            _moving(split.identified),
            _ROUGHLY if roughly else COST_TOLERANCE,
        )
    return guess, at, split


def _linearising(problem: TargetProblem, free: Array) -> Callable[[Guess], Linearised]:
    return lambda guess: _linearise(problem, guess, free)


def _moving(free: Array) -> Callable[[Guess, Array], Guess]:
    """Return how a guess moves: origin and turn of the base, along its axes, then the targets."""

    def moved(guess: Guess, step: Array) -> Guess:
        of_targets = free @ step[6:]
        places = guess.p_ee_m.size
        R_ee_target = guess.R_ee_target
        if len(of_targets) > places:
            R_ee_target = Rotation.from_rotvec(of_targets[places:]).as_matrix() @ R_ee_target
        return Guess(
            guess.R_instr_base @ Rotation.from_rotvec(step[3:6]).as_matrix(),
            guess.p_instr_base_m + guess.R_instr_base @ step[:3],
            guess.p_ee_m + of_targets[:places].reshape(-1, 3),
            R_ee_target,
        )

    return moved


def residuals(problem: TargetProblem, guess: Guess) -> tuple[Array, Array]:
    """Return seen less modelled positions (K, 3) and turns (P, 3), along base axes."""
    return _residuals(problem, guess, problem.in_base(guess.p_ee_m))


def _residuals(problem: TargetProblem, guess: Guess, p_base_m: Array) -> tuple[Array, Array]:
    R = guess.R_instr_base
    off_m = (problem.p_instr_m - guess.p_instr_base_m) @ R - p_base_m
    if not len(problem.R_cmm):
        return off_m, np.zeros((problem.shape[0], 3))
    modelled = problem.R_base @ guess.R_ee_target
    return off_m, Rotation.from_matrix(
        R.T @ problem.R_cmm @ np.swapaxes(modelled, 1, 2)
    ).as_rotvec()


def _linearise(problem: TargetProblem, guess: Guess, free: Array | None) -> Linearised:
    """Return the problem in the step of `_moving`; with all of the targets where none is named.

    The derivative of a squared angle by a small turn is exact also where the angle is not small.
    """
    p_base_m = problem.in_base(guess.p_ee_m)
    off_m, off_rad = _residuals(problem, guess, p_base_m)
    rows, places = len(problem.pose), 3 * problem.shape[1]
    turning = len(problem.R_cmm)
    by_step = np.zeros((3 * (rows + turning), 6 + places + (3 if turning else 0)))
    of_places = by_step[: 3 * rows].reshape(rows, 3, -1)
    of_places[:, :, :3] = np.eye(3)
    of_places[:, :, 3:6] = _crossed(p_base_m)
    of_places[:, :, 6 : 6 + places] = problem.by_places
    of_places *= problem.root_weight[:, None, None]
    residual = [problem.root_weight[:, None] * off_m]
    if turning:
        root = LEVER_M * np.sqrt(problem.weights)
        of_turns = by_step[3 * rows :].reshape(turning, 3, -1)
        of_turns[:, :, 3:6] = root[:, None, None] * np.eye(3)
        of_turns[:, :, -3:] = root[:, None, None] * problem.R_base
        residual.append(root[:, None] * off_rad)
    if free is not None:
        by_step = np.hstack([by_step[:, :6], by_step[:, 6:] @ free])
    return Linearised(by_step, np.concatenate(residual).ravel())


def _crossed(points: Array) -> Array:
    """Return the derivative (K, 3, 3) of w x points by w."""
    x, y, z = points.T
    crossed = np.zeros((len(points), 3, 3))
    crossed[:, 0, 1], crossed[:, 0, 2] = z, -y
    crossed[:, 1, 0], crossed[:, 1, 2] = -z, x
    crossed[:, 2, 0], crossed[:, 2, 1] = y, -x
    return crossed
