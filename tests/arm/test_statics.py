"""Weights on an arm at rest, against pinocchio, potential energy and the virtual cell."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drawn_examples import examples
from made_up_robot import nominal_of, pinocchio_of, rebuilt
from pa10cal.arm.chain import BASE, Chain, bend_coordinates, frames
from pa10cal.arm.statics import Payload, statics
from pa10cal.errors import ArmError
from pa10cal.files.arms import load_arm
from pa10cal.terms.joint_spring import deflection_rad, unit_deflection
from pa10cal_lab.cell.individual import build_robot
from pa10cal_lab.cell.mechanism import GRAVITY_M_S2
from pa10cal_lab.cell.options import SimulateOptions
from pa10cal_lab.cell.poses import place_poses

conventions = st.sampled_from(["standard", "modified"])
seeds = st.integers(0, 10_000)
quick = examples(25)


def drawn(seed, n, arm, bends=()):
    """Return a chain off nominal everywhere, coordinates of 3 poses, loads and a payload."""
    rng = np.random.default_rng(seed)
    chain = Chain.of(arm, bends)
    coordinates = chain.coordinates(rng.uniform(-3, 3, (3, n)))
    coordinates += rng.normal(scale=0.2, size=coordinates.shape)
    payload = Payload(2.4, *rng.uniform(-0.3, 0.3, (2, 3)), rng.normal(scale=8.0, size=3))
    return chain, coordinates, rng.uniform(0.0, 90.0, 3), payload


def energy_J(chain, coordinates, load_N, payload):
    """Return the potential energy of all weights, (P,)."""
    found = frames(chain, coordinates)

    def below(T, place_m):
        return -(T[..., :3, :3] @ place_m + T[..., :3, 3]) @ payload.gravity_m_s2

    g = np.linalg.norm(payload.gravity_m_s2)
    energy = payload.mass_kg * below(found.T_base_ee, payload.com_m)
    energy += load_N / g * below(found.T_base_ee, payload.load_point_m)
    for row, (mass_kg, com_m) in enumerate(zip(chain.arm.mass_kg, chain.arm.com_m, strict=True)):
        energy += mass_kg * below(found.T_base_rows[row], com_m)
    return energy


def slope(chain, coordinates, column, load_N, payload):
    """Return the derivative of potential energy by one coordinate, (P,)."""
    step = np.zeros(coordinates.shape[1])
    step[column] = 1e-5
    ahead = energy_J(chain, coordinates + step, load_N, payload)
    return (ahead - energy_J(chain, coordinates - step, load_N, payload)) / 2e-5


def pinocchio_torques_Nm(arm, q, load_N, payload):
    """Return the gravity torques of the same arm as pinocchio has them."""

    def carried(mass_kg, com_m):
        return T_last_ee.act(pin.Inertia(mass_kg, com_m, np.zeros((3, 3))))

    model, T_last_ee = pinocchio_of(arm)
    model.gravity.linear = payload.gravity_m_s2
    unloaded = model.inertias[arm.n] + carried(payload.mass_kg, payload.com_m)
    g = np.linalg.norm(payload.gravity_m_s2)
    torques = []
    for positions, load in zip(q, load_N, strict=True):
        model.inertias[arm.n] = unloaded + carried(load / g, payload.load_point_m)
        torques.append(pin.computeGeneralizedGravity(model, model.createData(), positions))
    return np.array(torques)


@pytest.mark.parametrize("convention", ["standard", "modified"])
@pytest.mark.parametrize("n", [1, 3, 6, 7])
def test_torques_equal_pinocchio(random_arm, n, convention):
    for seed in range(8):
        arm = random_arm(seed, n, convention)
        chain, _, load_N, payload = drawn(seed, n, arm)
        q = np.random.default_rng(seed).uniform(-3, 3, (3, n))
        found = statics(chain, chain.coordinates(q), load_N, payload)
        wanted = pinocchio_torques_Nm(arm, q, load_N, payload)
        np.testing.assert_allclose(found.joint_Nm, wanted, atol=1e-10)


@quick
@given(seed=seeds, convention=conventions)
def test_torques_are_the_slope_of_potential_energy(random_arm, seed, convention):
    chain, coordinates, load_N, payload = drawn(seed, 5, random_arm(seed, 5, convention), (2, 3))
    found = statics(chain, coordinates, load_N, payload)
    for joint, column in enumerate(chain.joint_columns):
        wanted = slope(chain, coordinates, column, load_N, payload)
        np.testing.assert_allclose(found.joint_Nm[:, joint], wanted, atol=1e-6)


@quick
@given(seed=seeds, convention=conventions)
def test_loads_work_on_the_bends_and_the_base(random_arm, seed, convention):
    # The moment of weights about an axis is what a turn about it takes off their energy, and the
    # force along it what a shift takes off.
    chain, coordinates, load_N, payload = drawn(seed, 4, random_arm(seed, 4, convention), (1, 2, 3))
    turns = [BASE[3:], *(bend_coordinates(row)[3:] for row in (1, 2, 3))]
    columns = [chain.columns(names) for names in turns]
    coordinates[:, np.concatenate(columns)] = 0.0  # there the three turns are about one frame
    coordinates[:, chain.columns(BASE[:3])] = 0.0
    carried = statics(chain, coordinates, load_N, payload)
    moments = [carried.base_Nm, *np.moveaxis(carried.link_Nm, 1, 0)]
    for moment_Nm, axes in zip(moments, columns, strict=False):
        for axis in range(3):
            wanted = -slope(chain, coordinates, axes[axis], load_N, payload)
            np.testing.assert_allclose(moment_Nm[:, axis], wanted, atol=1e-6)
    for row, force_N in zip((1, 2, 3), np.moveaxis(carried.link_N, 1, 0), strict=False):
        for axis, column in enumerate(chain.columns(bend_coordinates(row)[:3])):
            wanted = -slope(chain, coordinates, column, load_N, payload)
            np.testing.assert_allclose(force_N[:, axis], wanted, atol=1e-6)
    assert not carried.link_Nm[:, -1].any()
    assert not carried.link_N[:, -1].any()


@quick
@given(seed=seeds, convention=conventions)
def test_torques_follow_masses_and_load_as_their_derivatives_say(random_arm, seed, convention):
    arm = random_arm(seed, 5, convention)
    chain, coordinates, load_N, payload = drawn(seed, 5, arm)
    other_arm = random_arm(seed + 1, 5)
    other = replace(arm, mass_kg=other_arm.mass_kg, com_m=other_arm.com_m)
    found = statics(chain, coordinates, load_N, payload)
    heavier = statics(Chain.of(other), coordinates, load_N + 5.0, payload)

    def unknowns(arm):
        return np.hstack([arm.mass_kg[:, None], arm.mass_kg[:, None] * arm.com_m]).ravel()

    wanted = found.by_masses() @ (unknowns(other) - unknowns(arm)) + 5.0 * found.by_load
    np.testing.assert_allclose(heavier.joint_Nm - found.joint_Nm, wanted, atol=1e-10)
    np.testing.assert_allclose(heavier.by_load, found.by_load, atol=1e-15)


@quick
@given(seed=seeds, convention=conventions)
def test_torques_follow_each_weight_as_its_derivative_says(random_arm, seed, convention):
    arm = random_arm(seed, 4, convention)
    chain, coordinates, load_N, payload = drawn(seed, 4, arm)
    found = statics(chain, coordinates, load_N, payload)
    by_weights = found.by_weights

    def torque_Nm(arm=arm, payload=payload):
        return statics(Chain.of(arm), coordinates, load_N, payload).joint_Nm

    heavier = replace(arm, mass_kg=arm.mass_kg + np.array([0.0, 2.0, 0.0, 0.0]))
    elsewhere = replace(arm, com_m=arm.com_m + np.outer([0, 1, 0, 0], [0.0, 0.1, 0.0]))
    tool = replace(payload, mass_kg=payload.mass_kg + 2.0)
    wanted = [
        (torque_Nm(heavier), 2.0 * by_weights[..., 4]),
        (torque_Nm(elsewhere), 0.1 * arm.mass_kg[1] * by_weights[..., 6]),
        (torque_Nm(payload=tool), 2.0 * by_weights[..., 16]),
    ]
    for changed, by_it in wanted:
        np.testing.assert_allclose(changed - found.joint_Nm, by_it, atol=1e-10)
    g = payload.gravity_m_s2
    tilts = by_weights[..., 17:]
    rng = np.random.default_rng(seed)
    # So small that what is beyond first order, as large as the turn itself, is below what is asked.
    turn = np.cross(1e-7 * rng.normal(size=3), g)
    tilted = torque_Nm(payload=replace(payload, gravity_m_s2=g + turn)) - found.joint_Nm
    along = np.linalg.lstsq(tilts.reshape(-1, 2), tilted.ravel(), rcond=None)[0]
    np.testing.assert_allclose(tilted, tilts @ along, atol=1e-9)
    size = np.linalg.norm(turn) / np.linalg.norm(g)
    assert np.linalg.norm(along) == pytest.approx(size, rel=1e-6)


@quick
@given(seed=seeds)
def test_down_is_gravity_seen_from_the_end(random_arm, seed):
    chain, coordinates, load_N, payload = drawn(seed, 4, random_arm(seed, 4))
    down_ee = statics(chain, coordinates, load_N, payload).down_ee
    R_base_ee = frames(chain, coordinates).T_base_ee[:, :3, :3]
    along_base = np.einsum("pij,pj->pi", R_base_ee, down_ee)
    wanted = payload.gravity_m_s2 / np.linalg.norm(payload.gravity_m_s2)
    np.testing.assert_allclose(along_base, np.tile(wanted, (3, 1)), atol=1e-14)


@pytest.fixture(scope="module")
def robot():
    """The paper's robot and its apparatus, as the virtual cell builds them."""
    rng = np.random.default_rng(1)
    return build_robot(load_arm("pa10_6ce"), SimulateOptions(), "text_e7", rng)


def payload_of(robot):
    payload = robot.mechanism.payload
    return Payload(payload.mass_kg, payload.com_m, payload.load_point_m, GRAVITY_M_S2)


@pytest.mark.parametrize("convention", ["standard", "modified"])
@pytest.mark.parametrize("sliding", [None, 1, 3])
def test_weights_act_as_in_the_virtual_cell(robot, convention, sliding):
    arm = replace(robot.arm, convention=convention, prismatic=np.arange(6) == sliding)
    built = rebuilt(robot, arm=arm)
    rng = np.random.default_rng(3)
    q, load_N = rng.uniform(-2, 2, (10, 6)), rng.uniform(0, 90, 10)
    chain = Chain.of(arm)
    found = statics(chain, chain.coordinates(q), load_N, payload_of(built))
    held = nominal_of(built).statics(q, load_N)
    for pose in range(10):
        assert found.joint_Nm[pose] == pytest.approx(held.torque_Nm[pose], abs=1e-9)
        assert found.base_Nm[pose] == pytest.approx(held.base_Nm[pose], abs=1e-9)
        for link in range(6):
            wanted = held.link_Nm[pose, link]
            if link + 1 == sliding:
                continue  # the cell takes that moment about where the joint has slid to
            if link < 5:
                # The cell's joint zero lies an offset of theta ahead of the chain's.
                turned = Rotation.from_euler("z", arm.theta_rad[link + 1])
                force_N = turned.apply(held.link_N[pose, link])
                assert found.link_N[pose, link] == pytest.approx(force_N, abs=1e-9)
                wanted = turned.apply(wanted)
            assert found.link_Nm[pose, link] == pytest.approx(wanted, abs=1e-9)


def test_torques_are_of_the_size_known_of_this_arm(robot):
    # contract, mean over poses: joint 4 under 3 N m, joints 1 and 6 near zero, joints 2 and 3:
    poses = place_poses(robot.arm, nominal_of(robot), SimulateOptions().poses, 0)
    chain = Chain.of(robot.arm)
    coordinates = chain.coordinates(poses.grid)
    wanted = {0.0: (60, 37), 22.0: (75, 48), 44.0: (89, 59), 90.0: (119, 82)}
    for load_N, joints_Nm in wanted.items():
        loads_N = np.full(len(coordinates), load_N)
        torque_Nm = statics(chain, coordinates, loads_N, payload_of(robot)).joint_Nm
        size_Nm = np.abs(torque_Nm).mean(axis=0)
        assert size_Nm[[1, 2]] == pytest.approx(joints_Nm, rel=0.1)
        assert size_Nm[[0, 5]] == pytest.approx(0.0, abs=0.5)
        assert size_Nm[3] < 3.0


@pytest.mark.parametrize("unknown", ["mass_kg", "com_m"])
def test_an_arm_without_masses_is_refused(robot, unknown):
    chain = Chain.of(replace(robot.arm, **{unknown: None}))
    with pytest.raises(ArmError, match="the arm has no masses"):
        statics(chain, chain.nominal[None], np.zeros(1), payload_of(robot))


def test_gravity_without_a_direction_is_refused(robot):
    chain = Chain.of(robot.arm)
    payload = replace(payload_of(robot), gravity_m_s2=np.zeros(3))
    with pytest.raises(ArmError, match="gravity has no direction"):
        statics(chain, chain.nominal[None], np.zeros(1), payload)


# The spring of a joint.

stiffness = st.floats(1e2, 1e6)


@settings(deadline=None)
@given(tau=st.floats(-300, 300), k_lin=stiffness, k_cub=st.floats(0, 1e11))
def test_deflection_solves_equation_1(tau, k_lin, k_cub):
    delta = deflection_rad(np.array([tau]), k_lin, k_cub)[0]
    assert abs(k_lin * delta + k_cub * delta**3 - tau) <= 1e-14 * abs(tau) + 1e-300


@settings(deadline=None)
@given(t=st.floats(-4, 4), s=st.floats(0, 0.95))
def test_unit_deflection_solves_the_cubic(t, s):
    x = unit_deflection(np.array([t]), s).x[0]
    assert abs((1 - s) * x + s * x**3 - t) <= 4e-15 * abs(t) + 1e-300


@settings(deadline=None)
@given(t=st.floats(-4, 4), s=st.floats(1e-3, 0.9))
def test_derivative_equals_finite_differences(t, s):
    step, at = 1e-5, unit_deflection(np.array([t]), s)
    ahead, back = (unit_deflection(np.array([t]), s + sign * step).x for sign in (1, -1))
    np.testing.assert_allclose((ahead - back) / (2 * step), at.by_share, rtol=1e-5, atol=1e-9)


def test_share_zero_has_the_derivative_of_its_neighbours():
    at = unit_deflection(np.array([0.7]), 0.0)
    np.testing.assert_allclose(at.by_share, [0.7 - 0.7**3], rtol=1e-14)
    assert at.x[0] == 0.7
