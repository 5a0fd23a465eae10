"""Many poses at once, against pinocchio, products of matrices, and the slope of the energy."""

from dataclasses import replace

import numpy as np
import pytest

from pa10cal.cell.apparatus import LOAD_POINT_M
from pa10cal.cell.built import Departures, Springs
from pa10cal.cell.equilibrium import rest_poses
from pa10cal.cell.linkage import Linkage, Payload
from pa10cal.cell.mechanism import Mechanism
from pa10cal.errors import SimulationError

LOAD_N = np.array([0.0, 22.0, 90.0, 0.0, 44.0])
GRAVITY = np.array([0.0, 0.0, -9.80665])
H = 1e-5


@pytest.fixture(scope="module")
def q():
    return np.random.default_rng(7).uniform(-1.5, 1.5, (5, 6))


@pytest.fixture
def built(robot, any_arm):
    """A robot of some kind, far off its description."""
    rng = np.random.default_rng(11)
    departures = Departures(*(rng.normal(0.0, 0.01, 6) for _ in range(5)))
    k_lin = np.where(any_arm.prismatic, np.inf, np.array([1, 2, 3, 1, 2, np.inf]) * 1e4)
    k_cub = np.where(np.isfinite(k_lin), 1e7, 0.0)
    return replace(robot, arm=any_arm, departures=departures, springs=Springs(k_lin, k_cub, "test"))


def linkage_of(built):
    apparatus = built.apparatus
    payload = Payload(apparatus.mass_kg, apparatus.com_m, apparatus.load_point_m)
    return Linkage.of(built.arm, built.departures, payload, built.springs)


def displaced(linkage, seed=3):
    """The same with joints and flange anywhere."""
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (linkage.n + 1, 1, 1))
    T[:, :3, 3] = rng.normal(0.0, 0.1, (linkage.n + 1, 3))
    T[:, :3, :3] = np.linalg.qr(rng.standard_normal((linkage.n + 1, 3, 3)))[0]
    T[:, :3, :3] *= np.linalg.det(T[:, :3, :3])[:, None, None]
    return replace(linkage, placements=linkage.placements @ T[:-1], T_last_ee=T[-1])


def energy(linkage, q, load_N):
    """Potential energy of one pose, from products of matrices."""
    T, heights = np.eye(4), []
    for k, q_k in enumerate(q):
        moved = np.eye(4)
        if linkage.slides[k]:
            moved[2, 3] = q_k
        else:
            moved[:2, :2] = [[np.cos(q_k), -np.sin(q_k)], [np.sin(q_k), np.cos(q_k)]]
        T = T @ linkage.placements[k] @ moved
        heights.append((T @ np.append(linkage.com_m[k], 1.0))[2])
    T = T @ linkage.T_last_ee
    payload = linkage.payload
    for place in (payload.com_m, payload.load_point_m):
        heights.append((T @ np.append(place, 1.0))[2])
    weights = [*(9.80665 * linkage.mass_kg), 9.80665 * payload.mass_kg, load_N]
    return float(np.dot(weights, heights))


def test_poses_are_those_of_the_product_of_the_rows(built, plain, q):
    wanted = [plain(built).flange(position) for position in q]
    assert np.abs(linkage_of(built).T_base_ee(q) - wanted).max() < 1e-12


def test_torques_are_those_of_pinocchio(built, q):
    mechanism, wanted = Mechanism.of(built), []
    for position, load_N in zip(q, LOAD_N, strict=True):
        mechanism.hang(load_N)
        wanted.append(mechanism.torques_Nm(position))
    assert np.abs(linkage_of(built).torques_Nm(q, LOAD_N) - wanted).max() < 1e-10


def test_rest_is_that_of_the_arm_pose_by_pose(built, q):
    rest = linkage_of(built).rest(q, LOAD_N)
    wanted = rest_poses(built, (), q, LOAD_N, np.zeros(5), np.zeros(5))
    assert np.abs(rest.q - wanted.q_rad).max() < 1e-12
    assert np.abs(rest.tau_Nm - wanted.tau_Nm).max() < 1e-9
    assert np.abs(rest.T_base_ee - wanted.T_base_ee).max() < 1e-12
    assert np.abs(rest.q - q).max() > 1e-4


def test_torques_of_joints_anywhere_are_the_slope_of_potential_energy(built, q):
    linkage = displaced(linkage_of(built))
    slopes = [
        [
            (energy(linkage, at + H * e, load_N) - energy(linkage, at - H * e, load_N)) / (2 * H)
            for e in np.eye(6)
        ]
        for at, load_N in zip(q, LOAD_N, strict=True)
    ]
    assert np.abs(linkage.torques_Nm(q, LOAD_N) - slopes).max() < 1e-6


def test_at_rest_springs_balance_the_torques_of_the_deflected_posture(built, q):
    linkage = displaced(linkage_of(built))
    rest = linkage.rest(q, LOAD_N)
    soft = linkage.springs.flexible
    delta = (q - rest.q)[:, soft]
    holds = linkage.springs.k_lin[soft] * delta + linkage.springs.k_cub[soft] * delta**3
    assert np.abs(holds - linkage.torques_Nm(rest.q, LOAD_N)[:, soft]).max() < 1e-7
    assert np.array_equal(rest.q[:, ~soft], q[:, ~soft])


def test_an_arm_whose_masses_are_not_known_carries_its_tool_alone(built, q):
    bare = replace(built, arm=replace(built.arm, mass_kg=None, com_m=None))
    weightless = replace(built, mass_kg=np.zeros(6))
    tau = linkage_of(bare).torques_Nm(q, LOAD_N)
    mechanism = Mechanism.of(weightless)
    mechanism.hang(LOAD_N[1])
    assert tau[1] == pytest.approx(mechanism.torques_Nm(q[1]), abs=1e-10)
    assert np.abs(tau).max() > 1.0


def test_refuses_springs_too_weak_to_hold_the_arm(built, q):
    weak = Springs(np.full(6, 20.0), np.zeros(6), "test")
    with pytest.raises(SimulationError, match="no rest"):
        replace(linkage_of(built), springs=weak).rest(q, LOAD_N)


def test_rows_of_no_pose_are_no_trouble(built):
    rest = linkage_of(built).rest(np.zeros((0, 6)), np.zeros(0))
    assert rest.T_base_ee.shape == (0, 4, 4)
    assert rest.tau_Nm.shape == (0, 6)


def test_a_heavier_payload_pulls_at_its_own_place(built, q):
    linkage = linkage_of(built)
    heavier = replace(linkage, payload=Payload(10.0, LOAD_POINT_M, LOAD_POINT_M))
    none = replace(linkage, payload=Payload(0.0, LOAD_POINT_M, LOAD_POINT_M))
    by_tool = heavier.torques_Nm(q, np.zeros(5))
    by_load = none.torques_Nm(q, np.full(5, 98.0665))
    assert by_tool == pytest.approx(by_load, abs=1e-10)
