"""Campaigns of any arm under any instrument, by the chain itself: exact data for laws."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from made_up_poses import at_rest
from pa10cal.arm.chain import Chain, end_pose
from pa10cal.arm.description import Arm
from pa10cal.files.arms import load_arm
from pa10cal.observe.observations import Observations
from pa10cal.observe.points import Distance, Points
from pa10cal.observe.pose import Pose
from pa10cal.options import Tolerances
from pa10cal.terms.offsets import link_departures

Array = NDArray[np.float64]
See = Callable[..., Observations]

P_EE_TARGETS_M = np.array([[0.04, -0.03, 0.11], [-0.06, 0.02, 0.09], [0.01, 0.07, 0.05]])


def random_joints(arm: Arm, count: int, generator: np.random.Generator) -> Array:
    """Draw joint positions (P, n) within the limits, a turn at most."""
    low, high = arm.limits_rad.T
    turning = ~arm.prismatic
    low = np.where(turning, np.maximum(low, -np.pi), low)
    high = np.where(turning, np.minimum(high, np.pi), high)
    return generator.uniform(low, high, (count, arm.n))


def see(
    robot: str | Arm,
    kind: str,
    count: int = 60,
    seed: int = 1,
    noise_m: float = 0.0,
    size: float = 1.0,
    tilted: bool = True,
    posed: Callable[[Array], Array] = lambda q_rad: q_rad,
    targets_m: Array = P_EE_TARGETS_M,
) -> Observations:
    """Let an instrument see random poses of an arm with random departures.

    Where not `tilted`, axes that were designed parallel are. `posed` makes of the joint positions
    drawn those that are measured.
    """
    arm = load_arm(robot) if isinstance(robot, str) else robot
    generator = np.random.default_rng(seed)
    chain, links = Chain.of(arm), link_departures(arm, Tolerances())
    departures = size * np.array([p.scale for p in links.parameters])
    departures *= np.random.default_rng(seed).standard_normal(len(departures))
    if not tilted:
        departures[[name.startswith("beta") for name in links.coordinates]] = 0.0
    q_rad = posed(random_joints(arm, count, np.random.default_rng([seed, count])))
    coordinates = chain.coordinates(q_rad)
    coordinates[:, chain.columns(links.coordinates)] += departures
    T_instr_base = np.eye(4)
    T_instr_base[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    T_instr_base[:3, 3] = [1.4, -0.8, 0.6]
    T_instr_ee = T_instr_base @ end_pose(chain, coordinates)
    at_20 = {"temperature_C": np.full(count, 20.0), "time_s": np.arange(count, dtype=float)}
    states = at_rest(q_rad, tau_Nm=np.full_like(q_rad, np.nan), **at_20)
    p_instr_m = T_instr_ee[:, None, :3, 3] + np.einsum(
        "pij,bj->pbi", T_instr_ee[:, :3, :3], targets_m
    )
    u_m = max(noise_m, 1e-5)
    unit = u_m**2 * np.eye(3)
    if kind == "pose":
        T = T_instr_ee.copy()
        T[:, :3, 3] = p_instr_m[:, 0] + noise_m * generator.standard_normal((count, 3))
        twist = Rotation.from_rotvec([0.3, 2.0, -0.7]).as_matrix()
        turn = Rotation.from_rotvec(10 * noise_m * generator.standard_normal((count, 3)))
        T[:, :3, :3] = turn.as_matrix() @ T[:, :3, :3] @ twist
        cov = np.zeros((count, 6, 6))
        cov[:, :3, :3], cov[:, 3:, 3:] = unit, 100 * unit
        seen: Pose | Points | Distance = Pose.of(T, cov)
    elif kind == "distance":
        d_m = np.linalg.norm(p_instr_m[:, 0], axis=1)
        seen = Distance(d_m + noise_m * generator.standard_normal(count), np.full(count, u_m))
    else:
        some = p_instr_m[:, : 1 if kind == "point" else 3]
        some = some + noise_m * generator.standard_normal(some.shape)
        names = ("T1", "T2", "T3")[: some.shape[1]]
        cov_m2 = np.tile(unit, (*some.shape[:2], 1, 1))
        if kind == "points":
            some[::7, 1], cov_m2[::7, 1] = np.nan, np.nan
        seen = Points(names, some, cov_m2, None)
    labels = np.array([f"P{k:04d}" for k in range(count)])
    return Observations.single(labels, states, seen)


@pytest.fixture(name="see", scope="session")
def _see() -> See:
    return see
