"""Poses, torques and moments against pinocchio, products of matrices, and the slope of energy."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drawn_examples import examples
from made_up_robot import rebuilt
from pa10cal.files.arms import arm_names, load_arm
from pa10cal_lab.cell.mechanism import GRAVITY_M_S2, Departures, Mechanism, SimulatedPayload, Strain
from pa10cal_lab.cell.robot import LOAD_POINT_M

angles = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6).map(np.array)
loads = st.sampled_from([0.0, 22.0, 90.0])
quick = examples(40)
Q = np.array([[0.1, 0.4, 1.2, 0.2, 0.5, 0.3]])
NO_LOAD = np.zeros(1)


def with_departures(robot, seed):
    rng = np.random.default_rng(seed)
    return rebuilt(robot, departures=Departures(*(rng.normal(0, 0.01, 6) for _ in range(5))))


def as_modified(robot):
    return rebuilt(robot, arm=replace(robot.arm, convention="modified"))


def with_slides(robot):
    prismatic = np.array([False, False, True, False, False, True])
    return rebuilt(robot, arm=replace(robot.arm, prismatic=prismatic))


def with_frames(robot):
    """Put the arm on a pillar that leans, a tool on its flange, and skew two of its rows."""
    leaning, tool = np.eye(4), np.eye(4)
    leaning[:3] = [[1.0, 0.0, 0.0, 0.3], [0.0, 0.6, -0.8, -0.1], [0.0, 0.8, 0.6, 0.5]]
    tool[:3] = [[0.0, 0.0, 1.0, 0.05], [1.0, 0.0, 0.0, 0.1], [0.0, 1.0, 0.0, 0.2]]
    beta_rad = np.array([0.0, 0.0, 0.3, 0.0, 0.0, -0.2])
    arm = replace(robot.arm, T_base_row1=leaning, T_row_n_ee=tool, beta_rad=beta_rad)
    return rebuilt(robot, arm=arm)


VARIANTS = [
    lambda robot: robot,
    as_modified,
    with_slides,
    with_frames,
    lambda robot: with_frames(with_slides(as_modified(robot))),
]


def displaced(mechanism, seed=3):
    """The same with joints and flange anywhere."""
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (mechanism.n + 1, 1, 1))
    T[:, :3, 3] = rng.normal(0.0, 0.1, (mechanism.n + 1, 3))
    T[:, :3, :3] = Rotation.random(mechanism.n + 1, random_state=seed).as_matrix()
    return replace(mechanism, placements=mechanism.placements @ T[:-1], T_last_ee=T[-1])


def strained(joints, poses, seed=4):
    """Small motions of base and links."""
    rng = np.random.default_rng(seed)
    sizes = (0.02, 0.01, 0.02, 0.01, 0.01)
    shapes = ((poses, 3), (poses, 3), (poses, joints, 3), (poses, joints, 3), (poses, joints))
    return Strain(*(size * rng.standard_normal(n) for size, n in zip(sizes, shapes, strict=True)))


def by_pinocchio(mechanism, q, load_N, strain):
    """Flange, torques and moments of one pose, from a model that pinocchio works out."""
    se3 = pin.SE3
    base = se3(Rotation.from_rotvec(strain.base_turn_rad[0]).as_matrix(), strain.base_shift_m[0])
    ends = [*mechanism.placements[1:], mechanism.T_last_ee]
    moved = []
    for k, end in enumerate(ends):
        grown = se3(end[:3, :3], end[:3, 3] * (1.0 + strain.stretch[0, k]))
        turn = Rotation.from_rotvec(strain.turn_rad[0, k]).as_matrix()
        moved.append(grown * se3(turn, strain.shift_m[0, k]))
    model = pin.Model()
    model.gravity.linear = GRAVITY_M_S2
    for k, placement in enumerate([base * se3(mechanism.placements[0]), *moved[:-1]]):
        joint = pin.JointModelPZ() if mechanism.slides[k] else pin.JointModelRZ()
        model.addJoint(k, joint, placement, f"joint {k + 1}")
        none = np.zeros((3, 3))
        model.inertias[k + 1] = pin.Inertia(float(mechanism.mass_kg[k]), mechanism.com_m[k], none)
    payload = mechanism.payload
    for mass_kg, at in (
        (payload.mass_kg, payload.com_m),
        (load_N / 9.80665, payload.load_point_m),
    ):
        model.inertias[mechanism.n] += moved[-1].act(pin.Inertia(mass_kg, at, np.zeros((3, 3))))
    data = model.createData()
    tau = pin.computeGeneralizedGravity(model, data, q).copy()
    links, forces = np.zeros((2, mechanism.n, 3))
    for k in range(2, mechanism.n + 1):
        in_end = model.jointPlacements[k].actInv(data.liMi[k])
        carried = -in_end.act(data.f[k])
        links[k - 2], forces[k - 2] = carried.angular, carried.linear
    base_Nm = -data.liMi[1].act(data.f[1]).angular
    pin.forwardKinematics(model, data, q)
    return (data.oMi[mechanism.n] * moved[-1]).homogeneous, tau, links, forces, base_Nm


@pytest.mark.parametrize("name", [*arm_names(), "displaced"])
@pytest.mark.parametrize("unloaded", [True, False], ids=["unloaded shape", "strained"])
def test_any_arm_is_that_of_pinocchio(name, unloaded):
    arm = load_arm("ur10" if name == "displaced" else name)
    rng = np.random.default_rng(7)
    departures = Departures(*(rng.normal(0.0, 0.01, arm.n) for _ in range(5)))
    payload = SimulatedPayload(1.5, np.array([0.02, -0.01, 0.08]), LOAD_POINT_M)
    mechanism = Mechanism.of(arm, departures, payload)
    mechanism = displaced(mechanism) if name == "displaced" else mechanism
    q = rng.uniform(*np.clip(arm.limits_rad.T, -2.5, 2.5), (5, arm.n))
    load_N = np.array([0.0, 22.0, 90.0, 0.0, 44.0])
    strain = Strain.none(5, arm.n) if unloaded else strained(arm.n, 5)
    given = None if unloaded else strain
    T, found = mechanism.T_base_ee(q, given), mechanism.statics(q, load_N, given)
    for k in range(5):
        one = Strain(*(values[[k]] for values in vars(strain).values()))
        wanted_T, tau, links, forces, base = by_pinocchio(mechanism, q[k], load_N[k], one)
        assert np.abs(T[k] - wanted_T).max() < 1e-12
        assert found.torque_Nm[k] == pytest.approx(tau, abs=1e-10)
        assert found.link_Nm[k] == pytest.approx(links, abs=1e-10)
        assert found.link_N[k] == pytest.approx(forces, abs=1e-10)
        assert found.base_Nm[k] == pytest.approx(base, abs=1e-10)


@quick
@given(q=angles, seed=st.integers(0, 2**32), variant=st.sampled_from(VARIANTS))
def test_flange_is_the_product_of_the_rows(robot, plain, q, seed, variant):
    built = variant(with_departures(robot, seed))
    wanted = plain(built).flange(q)
    assert np.abs(built.mechanism.T_base_ee(q[None])[0] - wanted).max() < 1e-12


def test_nominal_arm_stands_straight_up_as_its_maker_says(robot):
    flange = rebuilt(robot, departures=Departures.none(6)).mechanism.T_base_ee(np.zeros((1, 6)))
    assert flange[0, :3, 3] == pytest.approx([0.0, 0.0, 1.317], abs=1e-12)


@quick
@given(q=angles, load_N=loads, variant=st.sampled_from(VARIANTS))
def test_torques_are_the_slope_of_potential_energy(robot, plain, q, load_N, variant):
    built = variant(robot)
    other, h = plain(built), 1e-5
    slope = [
        (other.energy(q + h * e, load_N) - other.energy(q - h * e, load_N)) / (2 * h)
        for e in np.eye(6)
    ]
    found = built.mechanism.statics(q[None], np.array([load_N])).torque_Nm[0]
    assert np.abs(found - slope).max() < 1e-6


def test_an_arm_whose_masses_are_not_known_carries_its_tool_alone(robot):
    bare = rebuilt(robot, arm=replace(robot.arm, mass_kg=None, com_m=None))
    mechanism = Mechanism.of(bare.arm, robot.departures, robot.mechanism.payload)
    weightless = replace(robot.mechanism, mass_kg=np.zeros(6))
    assert mechanism.statics(Q, NO_LOAD).torque_Nm == pytest.approx(
        weightless.statics(Q, NO_LOAD).torque_Nm, abs=1e-10
    )
    assert np.abs(mechanism.statics(Q, NO_LOAD).torque_Nm).max() > 1.0


def test_strains_add_up():
    one = replace(Strain.none(1, 2), stretch=np.array([[1.0, 2.0]]), base_shift_m=np.ones((1, 3)))
    two = one + one
    assert two.stretch.tolist() == [[2.0, 4.0]]
    assert two.distance(one) == 2.0
    assert one.distance(one) == 0.0


def test_upper_arm_and_forearm_are_the_two_longest_between_first_and_last(robot):
    assert robot.mechanism.long_links == (1, 3)
    seven = load_arm("iiwa14")
    payload = robot.mechanism.payload
    assert Mechanism.of(seven, Departures.none(7), payload).long_links == (2, 4)
    short = load_arm("gx4_351s")
    assert len(Mechanism.of(short, Departures.none(4), payload).long_links) == 2
