"""The simulated UR10: geometry, its errors and its readings, in plain homogeneous matrices.

Nothing here comes from the package or from a peer, so the truth shares no code with any
estimator that is compared on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Nominal rows, modified Denavit-Hartenberg: alpha [rad], a [m], theta [rad], d [m].
NOMINAL_MDH: Array = np.array(
    [
        [0.0, 0.0, 0.0, 0.1273],
        [np.pi / 2, 0.0, 0.0, 0.0],
        [0.0, -0.612, 0.0, 0.0],
        [0.0, -0.5723, 0.0, 0.163941],
        [np.pi / 2, 0.0, 0.0, 0.1157],
        [-np.pi / 2, 0.0, 0.0, 0.0922],
    ]
)
#: Rows whose axis is parallel to the one before, but for the first, which the base frame places.
PARALLEL_ROWS = (2, 3)
#: Sizes (1 sigma) of the errors of every row: lengths a and d, angles alpha and theta; and of the
#: tilts of parallel axes.
TOLERANCE_M, TOLERANCE_RAD = 0.5e-3, 1e-3
#: Noise of one measured coordinate (1 sigma).
NOISE_M = 0.05e-3
TEST_POSES = 200

#: Where the tracker sees the base and where the target sits on the flange, and how far off
#: (1 sigma) a mounting is.
_T_WORLD_BASE_XYZ_M, _T_WORLD_BASE_YAW_RAD = (2.4, -1.1, 0.35), 2.2
_P_FLANGE_TARGET_M = (0.06, -0.04, 0.15)
_MOUNTING_M, _MOUNTING_RAD = 5e-3, 5e-3
#: Joint ranges that are drawn from, and how far above the table the flange stays.
_RANGES_RAD = np.array([np.pi, np.pi, np.deg2rad(150.0), np.pi, np.pi, np.pi])
_CLEARANCE_M = 0.05


@dataclass(frozen=True)
class Truth:
    """One individual arm and its mounting.

    Attributes:
        mdh: (6, 4) true rows.
        tilt_rad: (6,) turn of every axis about y of its row, which no such row can say of axes
            that are parallel.
        T_world_base: (4, 4) base in the instrument's frame [m].
        p_flange_target_m: (3,) target in the flange's frame.
    """

    mdh: Array
    tilt_rad: Array
    T_world_base: Array
    p_flange_target_m: Array

    def positions_m(self, q_rad: Array) -> Array:
        """Return the (P, 3) positions of the target in the instrument's frame."""
        T_base_flange = flange_poses(self.mdh, q_rad, self.tilt_rad)
        return seen_m(T_base_flange, self.T_world_base, self.p_flange_target_m)


def flange_poses(mdh: Array, q_rad: Array, tilt_rad: Array | None = None) -> Array:
    """Return the (P, 4, 4) poses of the flange in the base frame.

    Args:
        mdh: (6, 4) rows alpha, a, theta, d; a pose is the product of Rx(alpha) Tx(a) Ry(tilt)
            Rz(theta + q) Tz(d) over the rows.
        q_rad: (P, 6) joint angles.
        tilt_rad: (6,) tilts, none by default.
    """
    T = np.broadcast_to(np.eye(4), (len(q_rad), 4, 4))
    tilts = np.zeros(6) if tilt_rad is None else tilt_rad
    for (alpha, a, theta, d), tilt, q in zip(mdh, tilts, q_rad.T, strict=True):
        turn = np.zeros((len(q), 4, 4))
        turn[:, 0, 0] = turn[:, 1, 1] = np.cos(theta + q)
        turn[:, 1, 0] = np.sin(theta + q)
        turn[:, 0, 1] = -turn[:, 1, 0]
        turn[:, 2, 2] = turn[:, 3, 3] = 1.0
        turn[:, 2, 3] = d
        twist = np.eye(4)
        twist[:3, :3] = _rotation(0, alpha) @ _rotation(1, tilt)
        twist[0, 3] = a
        T = T @ twist @ turn
    return T


def seen_m(T_base_flange: Array, T_world_base: Array, p_flange_target_m: Array) -> Array:
    """Return the (P, 3) positions of a target on the flange in the instrument's frame."""
    T = T_world_base @ T_base_flange
    positions: Array = T[:, :3, :3] @ p_flange_target_m + T[:, :3, 3]
    return positions


def draw_configurations(rng: np.random.Generator, count: int) -> Array:
    """Draw (count, 6) joint angles, uniform within the ranges, flange above the table."""
    kept = np.empty((0, 6))
    while len(kept) < count:
        q_rad = rng.uniform(-_RANGES_RAD, _RANGES_RAD, (4 * count, 6))
        above = flange_poses(NOMINAL_MDH, q_rad)[:, 2, 3] > _CLEARANCE_M
        kept = np.concatenate([kept, q_rad[above]])
    return kept[:count]


def draw_truth(rng: np.random.Generator, tilted: bool) -> Truth:
    """Draw one individual arm; the rows are the same whether parallel axes are tilted or not."""
    size = np.array([TOLERANCE_RAD, TOLERANCE_M, TOLERANCE_RAD, TOLERANCE_M])
    mdh = NOMINAL_MDH + rng.normal(size=(6, 4)) * size
    roll, pitch, yaw = rng.normal(scale=_MOUNTING_RAD, size=3)
    T_world_base = np.eye(4)
    T_world_base[:3, :3] = _rotation(2, _T_WORLD_BASE_YAW_RAD + yaw) @ _rotation(1, pitch)
    T_world_base[:3, :3] = T_world_base[:3, :3] @ _rotation(0, roll)
    T_world_base[:3, 3] = _T_WORLD_BASE_XYZ_M + rng.normal(scale=_MOUNTING_M, size=3)
    p_flange_target_m = _P_FLANGE_TARGET_M + rng.normal(scale=_MOUNTING_M, size=3)
    tilt_rad = np.zeros(6)
    tilt_rad[list(PARALLEL_ROWS)] = rng.normal(scale=TOLERANCE_RAD, size=len(PARALLEL_ROWS))
    return Truth(mdh, tilt_rad * tilted, T_world_base, p_flange_target_m)


def draw_readings(seed: int, count: int, tilted: bool) -> tuple[Array, Array, Array, Array]:
    """Draw an arm and what a tracker reads of it.

    Args:
        seed: number of the arm; its test poses do not depend on the count.
        count: poses to calibrate with.
        tilted: whether parallel axes are tilted too.

    Returns:
        joint angles (count, 6) and noisy positions (count, 3) to calibrate with, joint angles
        (200, 6) and noise-free positions (200, 3) to test with.
    """
    rng = np.random.default_rng([seed, 0])
    truth = draw_truth(rng, tilted)
    q_test_rad = draw_configurations(rng, TEST_POSES)
    rng = np.random.default_rng([seed, count])
    q_train_rad = draw_configurations(rng, count)
    p_train_m = truth.positions_m(q_train_rad)
    p_train_m = p_train_m + rng.normal(scale=NOISE_M, size=p_train_m.shape)
    return q_train_rad, p_train_m, q_test_rad, truth.positions_m(q_test_rad)


def first_guess(mdh: Array, q_rad: Array, p_m: Array, rounds: int = 50) -> tuple[Array, Array]:
    """Fit base frame and target with the rows as they are, in turns of two closed forms.

    Args:
        mdh: (6, 4) rows.
        q_rad: (P, 6) joint angles.
        p_m: (P, 3) measured positions in the instrument's frame.
        rounds: turns of rotation, then translation and target.

    Returns:
        (4, 4) base in the instrument's frame, (3,) target in the flange's frame [m].
    """
    T = flange_poses(mdh, q_rad)
    R_base_flange, p_base_m = T[:, :3, :3], T[:, :3, 3]
    target_m, shift_m, R = np.zeros(3), np.zeros(3), np.eye(3)
    for _ in range(rounds):
        reached_m = p_base_m + R_base_flange @ target_m
        spread = (p_m - p_m.mean(0)).T @ (reached_m - reached_m.mean(0))
        left, _, right = np.linalg.svd(spread)
        R = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
        by_target = (R @ R_base_flange).reshape(-1, 3)
        by_shift = np.tile(np.eye(3), (len(p_m), 1))
        rest_m = (p_m - p_base_m @ R.T).ravel()
        both = np.linalg.lstsq(np.hstack([by_target, by_shift]), rest_m, rcond=None)[0]
        target_m, shift_m = both[:3], both[3:]
    T_world_base = np.eye(4)
    T_world_base[:3, :3], T_world_base[:3, 3] = R, shift_m
    return T_world_base, target_m


def _rotation(axis: int, angle_rad: float) -> Array:
    R = np.eye(3)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    R[i, i] = R[j, j] = np.cos(angle_rad)
    R[j, i] = np.sin(angle_rad)
    R[i, j] = -R[j, i]
    return R
