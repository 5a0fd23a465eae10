"""Effects outside the vocabulary, against their forms written out, alone and in the whole arm."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pa10cal.errors import SettingsError
from pa10cal_lab.cell.effects import outside
from pa10cal_lab.cell.effects.effect import JointState, Site
from pa10cal_lab.cell.effects.structure import SimulatedLinkBending
from pa10cal_lab.cell.effects.vocabulary import make_effects, vocabulary
from pa10cal_lab.cell.effects.vocabulary import outside as without_name
from pa10cal_lab.cell.instruments.instrument import rest_poses
from pa10cal_lab.cell.options import HiddenEffectOptions

RNG = np.random.default_rng(17)
Q = RNG.uniform(-1.2, 1.2, (12, 6))
S = RNG.choice([-1.0, 0.0, 1.0], (12, 6))
LOADS = np.resize([0.0, 44.0, 90.0], 12)
ZERO = np.zeros(12)

BOW = {"axis": 1, "along": 0, "sag": 1e-4, "half_m": 0.4, "centre_m": 0.4}
GOOD = [
    ("third_harmonic", "joint 1", {"A": 1e-4, "phi": 0.3}),
    (
        "bowed_axis",
        "instrument",
        BOW,
    ),
    ("dress_pack", "joint 2", {"k": 3.0, "q0": 0.2}),
    ("hysteresis", "joint 3", {"h": 2e-4}),
]


def entry(id_, of, parameters):
    return HiddenEffectOptions(id=id_, of=of, parameters=parameters)


def rest(robot, *effects):
    return rest_poses(robot, effects, Q, LOADS, ZERO, ZERO, S)


def test_they_are_hidden_by_name_and_are_not_in_the_vocabulary(robot):
    effects = make_effects([entry(*good) for good in GOOD], robot)
    assert [effect.id for effect in effects] == list(without_name())
    assert not set(without_name()) & set(vocabulary())
    assert all(field.description for e in effects for field in type(e).model_fields.values())


BAD = [
    (("third_harmonik", "joint 1", {"A": 1, "phi": 0}), ["unknown", "'third_harmonic'"]),
    (("dress_pack", "base", {"k": 1, "q0": 0}), ["cannot sit there", "joint 6"]),
    (("bowed_axis", "instrument", {**BOW, "along": 1}), ["along", "another axis"]),
    (("bowed_axis", "instrument", {**BOW, "axis": 3}), ["axis", "2"]),
    (("bowed_axis", "instrument", {**BOW, "half_m": 0}), ["half_m", "greater than 0"]),
]


@pytest.mark.parametrize(("bad", "words"), BAD, ids=range(len(BAD)))
def test_refuses_what_cannot_be_hidden(robot, bad, words):
    with pytest.raises(SettingsError) as refusal:
        make_effects([entry(*bad)], robot)
    for word in words:
        assert word in str(refusal.value)


def test_third_harmonic_turns_its_joint_three_times_a_turn():
    turn = outside.ThirdHarmonic(A=3e-4, phi=0.7).at("joint 5").added(JointState(Q, S, np.ones(6)))
    assert turn[:, 4] == pytest.approx(3e-4 * np.sin(3 * Q[:, 4] + 0.7), abs=1e-17)
    assert np.abs(np.delete(turn, 4, axis=1)).max() == 0.0


def test_bowed_axis_reads_a_parabola_and_a_little_cubic_of_another_coordinate():
    bow = outside.BowedAxis(axis=2, along=0, sag=1e-4, half_m=0.5, centre_m=0.4).at("instrument")
    points = RNG.uniform(-0.5, 1.0, (5, 3, 3))
    u = (points[..., 0] - 0.4) / 0.5
    extra = bow.read_too_much_m(points)
    assert extra[..., 2] == pytest.approx(1e-4 * u**2 * (1 + 0.2 * u), abs=1e-18)
    assert np.abs(extra[..., :2]).max() == 0.0


def test_hysteresis_lags_by_arrival_and_torque(rigid, arm):
    plain = rest(rigid)
    lagging = rest(rigid, outside.Hysteresis(h=2e-4).at("joint 2"))
    turned = lagging.q - plain.q
    load = np.abs(lagging.tau_Nm[:, 1]) / arm.torque_limit_Nm[1]
    assert turned[:, 1] == pytest.approx(2e-4 * S[:, 1] * load, abs=1e-12)
    assert np.ptp(load) > 0.1
    assert np.abs(np.delete(turned, 1, axis=1)).max() == 0.0


def test_hysteresis_needs_an_arrival(robot):
    effect = outside.Hysteresis(h=2e-4).at("joint 2")
    still = rest_poses(robot, (effect,), Q, LOADS, ZERO, ZERO)
    assert np.array_equal(still.q, rest_poses(robot, (), Q, LOADS, ZERO, ZERO).q)


def test_dress_pack_is_carried_by_a_stiff_joint_and_moves_nothing(rigid):
    plain, pulled = rest(rigid), rest(rigid, outside.DressPack(k=3.0, q0=0.2).at("joint 4"))
    assert np.array_equal(pulled.q, plain.q)
    more = pulled.tau_Nm - plain.tau_Nm
    assert more[:, 3] == pytest.approx(3.0 * (Q[:, 3] - 0.2), abs=1e-12)
    assert np.abs(np.delete(more, 3, axis=1)).max() == 0.0


def test_dress_pack_deflects_a_spring_with_the_weights(robot, plain):
    found = rest(robot, outside.DressPack(k=5.0, q0=-0.4).at("joint 3"))
    delta = Q[:, 2] - found.q[:, 2]
    k_lin, k_cub = robot.springs.k_lin[2], robot.springs.k_cub[2]
    assert k_lin * delta + k_cub * delta**3 == pytest.approx(found.tau_Nm[:, 2], abs=1e-8)
    other, h, axis = plain(robot), 1e-5, np.eye(6)[2]
    for q, tau, load_N in zip(found.q, found.tau_Nm, LOADS, strict=True):
        weights = (other.energy(q + h * axis, load_N) - other.energy(q - h * axis, load_N)) / 2 / h
        assert tau[2] == pytest.approx(weights + 5.0 * (q[2] + 0.4), abs=1e-6)


def test_dress_pack_runs_along_the_joint_so_links_bend_no_more(rigid):
    bending = SimulatedLinkBending(c=1e-6).at("forearm")
    pack = outside.DressPack(k=5.0, q0=-0.4).at("joint 4")
    assert np.array_equal(rest(rigid, bending, pack).T_base_ee, rest(rigid, bending).T_base_ee)


def test_small_waves_turn_their_joint_by_all_their_lines():
    waves = outside.SmallWaves(orders=(2.4, 61.0), A=(3e-5, 1e-5), phi=(0.2, -1.0)).at("joint 4")
    turn = waves.added(JointState(Q, S, np.ones(6)))
    q = Q[:, 3]
    expected = 3e-5 * np.sin(2.4 * q + 0.2) + 1e-5 * np.sin(61.0 * q - 1.0)
    assert turn[:, 3] == pytest.approx(expected, abs=1e-17)
    assert np.abs(np.delete(turn, 3, axis=1)).max() == 0.0
    drawn = outside.SmallWaves.at_size(Site("joint 4"), 1.0, np.random.default_rng(2))
    assert np.linalg.norm(drawn["A"]) == pytest.approx(np.radians(10 / 3600))
    with pytest.raises(ValueError, match="as many as orders"):
        outside.SmallWaves(orders=(2.4, 61.0), A=(3e-5,), phi=(0.2, -1.0))


@pytest.mark.parametrize("joint", [1, 3])
def test_a_soft_bearing_tilts_across_its_joint_and_most_about_its_soft_axis(rigid, joint):
    bare = rest(rigid)

    def tilt(phi):
        """Return by how much the links after the joint turn, along the joint's axes before it."""
        soft = outside.SoftBearing(soft=1e-6, stiff=0.0, phi=phi).at(f"joint {joint}")
        R = rest(rigid, soft).T_base_ee[:, :3, :3] @ bare.T_base_ee[:, :3, :3].transpose(0, 2, 1)
        turn = Rotation.from_matrix(R).as_rotvec()
        frame = rigid.mechanism.T_base_joints(Q)[joint - 1][:, :3, :3]
        return np.einsum("pij,pi->pj", frame, turn)

    assert np.abs(tilt(0.3)[:, 2]).max() < 1e-3 * np.abs(tilt(0.3)[:, :2]).max()
    both = outside.SoftBearing(soft=1e-6, stiff=1e-6, phi=0.3).at(f"joint {joint}")
    alike = outside.SoftBearing(soft=1e-6, stiff=1e-6, phi=1.1).at(f"joint {joint}")
    assert rest(rigid, both).T_base_ee == pytest.approx(rest(rigid, alike).T_base_ee, abs=1e-12)
