"""Where the loaded arm comes to rest."""

from dataclasses import replace

import numpy as np
import pytest

from pa10cal.errors import SimulationError
from pa10cal_lab.cell.effects.joint import SimulatedJointCompliance, SimulatedSoftWindup
from pa10cal_lab.cell.individual import PAPER_K_CUB, TABLE_1_K_LIN
from pa10cal_lab.cell.instruments.instrument import rest_poses
from pa10cal_lab.cell.robot import Springs

POSTURES = np.random.default_rng(7).uniform(-1.5, 1.5, (12, 6))
LOADS = np.resize([0.0, 22.0, 44.0, 90.0], 12)


def rest(robot, effects=(), drive=POSTURES, load_N=LOADS):
    zero = np.zeros(len(drive))
    return rest_poses(robot, effects, drive, load_N, zero, zero)


def energy_slope(other, q, load_N, h=1e-5):
    return np.array(
        [
            (other.energy(q + h * e, load_N) - other.energy(q - h * e, load_N)) / (2 * h)
            for e in np.eye(6)
        ]
    )


@pytest.mark.parametrize("reading", ["text_e7", "table_e8"])
def test_springs_balance_gravity_in_the_deflected_posture(robot, plain, reading):
    springs = Springs(TABLE_1_K_LIN, PAPER_K_CUB[reading], reading)
    built = replace(robot, springs=springs)
    found = rest(built)
    delta = POSTURES - found.q
    soft = springs.flexible
    assert np.abs(delta[:, ~soft]).max() == 0.0
    assert np.abs(delta[:, soft]).max() > 1e-3
    held = springs.k_lin[soft] * delta[:, soft] + springs.k_cub[soft] * delta[:, soft] ** 3
    assert np.abs(held - found.tau_Nm[:, soft]).max() < 1e-8  # 1e-13 rad by its stiffness
    for q, tau, load_N in zip(found.q, found.tau_Nm, LOADS, strict=True):
        assert tau == pytest.approx(energy_slope(plain(built), q, load_N), abs=1e-6)


def test_windup_comes_on_top_of_the_spring(robot):
    soft = SimulatedSoftWindup(A=2e-4, tau0=10.0).at("joint 2")
    yielding = SimulatedJointCompliance(K=5e4).at("joint 4")
    found = rest(robot, (soft, yielding))
    delta = POSTURES - found.q
    tau = found.tau_Nm
    delta[:, 1] -= 2e-4 * np.tanh(tau[:, 1] / 10.0)
    k_lin, k_cub = robot.springs.k_lin[1], robot.springs.k_cub[1]
    assert k_lin * delta[:, 1] + k_cub * delta[:, 1] ** 3 == pytest.approx(tau[:, 1], abs=1e-7)
    assert delta[:, 3] == pytest.approx(tau[:, 3] / 5e4, abs=1e-12)


def test_refuses_an_arm_that_falls_over(robot):
    limp = Springs(np.full(6, 5.0), np.zeros(6), "limp")
    with pytest.raises(SimulationError, match="finds no rest"):
        rest(replace(robot, springs=limp))


def test_no_pose_is_no_trouble(robot):
    none = rest(robot, drive=np.zeros((0, 6)), load_N=np.zeros(0))
    assert none.T_base_ee.shape == (0, 4, 4)
    assert none.tau_Nm.shape == (0, 6)
