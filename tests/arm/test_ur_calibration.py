"""Calibrations of Universal Robots: what is read and written is one arm, in every form."""

import re
from dataclasses import replace

import numpy as np
import pytest
import yaml

from changed_arm import departed, expected
from pa10cal.arm.chain import Chain, frames, placed
from pa10cal.arm.ur_calibration import (
    LINKS,
    UrLayout,
    arm_of_ur_origins,
    arm_of_ur_rows,
    flange_off_m,
    ur_deltas,
    ur_kinematics,
    ur_layout,
)
from pa10cal.errors import ArmError
from pa10cal.files.arms import arm_names, load_arm

#: Of a UR10, as its owner published what its controller holds: theta, d, a, alpha a row.
UR10_DELTAS = np.array(
    [
        [-8.20642406610e-05, 0.00050539089484, -0.00016118734230, -0.00032142399896],
        [-0.103609197138686, 11.1984514757821, 0.00304003843792, -0.00565024518540],
        [0.673631891251821, -92.5270326908668, 0.09164685557218, -0.00378922621834],
        [-0.570169747249608, 81.3282683520704, -9.6296497595e-05, -0.00106533274012],
        [-4.5963635168e-05, -0.00021285281874, -2.9759534076e-05, 0.00099958630347],
        [9.7499956113e-07, -0.00012614556100, 0.0, 0.0],
    ]
)
#: Of a UR10e, as the driver's documentation has it.
UR10E = np.array(
    [
        [-2.4147806894359e-07, 0.180539811714259, 2.12234865571206e-05, 1.57014608044242],
        [1.60233952386695, 439.140974079901, 0.0193171326277006, 0.0013941666682559],
        [-1.68607190752171, -446.027059806332, -0.569251663611088, 0.00693818880325995],
        [0.0837331147700119, 7.0603368964236, -4.61409023720934e-05, 1.56998468543761],
        [-1.01260355871158e-07, 0.119811341150314, -6.39280053471802e-05, -1.57038519650543],
        [3.91986209186124e-08, 0.115670917257426, 0.0, 0.0],
    ]
)


def centres_in_base(arm):
    chain = Chain.of(arm)
    rows = frames(chain, chain.nominal[None]).T_base_rows[:, 0]
    return np.einsum("kij,kj->ki", rows[:, :3, :3], arm.com_m) + rows[:, :3, 3]


def by_rows(table, q):
    """Denavit and Hartenberg's product, each row written out, at joint positions (6,)."""
    T = np.eye(4, dtype=np.longdouble)
    for (theta, d, a, alpha), angle in zip(np.longdouble(table), q, strict=True):
        c, s, ca, sa = np.cos(theta + angle), np.sin(theta + angle), np.cos(alpha), np.sin(alpha)
        T = T @ np.array(
            [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        )
    return T.astype(float)


def turned(axis, angle):
    c, s = np.cos(angle), np.sin(angle)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    R = np.eye(4)
    R[i, i], R[i, j], R[j, i], R[j, j] = c, -s, s, c
    return R


def by_origins(text, q):
    """The driver's chain: shift, yaw, pitch, roll, then the joint, at joint positions (6,)."""
    content = yaml.safe_load(text)["kinematics"]
    T = np.eye(4)
    for name, angle in zip(LINKS, q, strict=True):
        at = content[name]
        shift = np.eye(4)
        shift[:3, 3] = at["x"], at["y"], at["z"]
        R = turned("z", at["yaw"]) @ turned("y", at["pitch"]) @ turned("x", at["roll"])
        T = T @ shift @ R @ turned("z", angle)
    return T


def test_the_layout_of_a_ur_is_found():
    layout = UrLayout(0.0, 0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922)
    found = ur_layout(load_arm("ur10"))
    for name in ("yaw", "d1", "a2", "a3", "d4", "d5", "d6"):
        assert getattr(found, name) == pytest.approx(getattr(layout, name), abs=1e-12)
    assert [name for name in arm_names() if ur_layout(load_arm(name)) is not None] == ["ur10"]


@pytest.mark.parametrize("yaw", [0.0, np.pi])
def test_a_controllers_departures_become_the_arm_whose_lengths_cancel(yaw):
    base = placed(np.zeros(3), np.array([0.0, 0.0, yaw]))
    designed = replace(load_arm("ur10"), T_base_row1=base)
    table = ur_layout(load_arm("ur10")).table + UR10_DELTAS
    arm = arm_of_ur_rows(table, "mine", designed, "calibration.conf")
    q = np.random.default_rng(3).uniform(-3, 3, (20, 6))
    wanted = [base @ by_rows(table, each) for each in q]
    np.testing.assert_allclose(Chain.of(arm).forward(q), wanted, atol=1e-10)
    assert np.abs([arm.d_m, arm.a_m]).max() < 0.7
    assert arm.hayati.tolist() == [False, True, True, False, False, False]
    np.testing.assert_array_equal(arm.gear_ratio, designed.gear_ratio)
    np.testing.assert_array_equal(arm.mass_kg, designed.mass_kg)
    centres = [centres_in_base(each) for each in (arm, designed)]
    np.testing.assert_allclose(*centres, atol=1e-12)
    back = ur_deltas(Chain.of(arm), Chain.of(arm).nominal, ur_layout(designed))
    q_back = [base @ by_rows(ur_layout(load_arm("ur10")).table + back, each) for each in q]
    np.testing.assert_allclose(q_back, wanted, atol=1e-8)
    np.testing.assert_allclose(back, UR10_DELTAS, atol=1e-5)


def test_the_drivers_file_leads_back_to_the_same_arm():
    arm = arm_of_ur_rows(UR10E, "mine", None, "rows.yaml")
    chain = Chain.of(arm)
    q = np.random.default_rng(3).uniform(-3, 3, (20, 6))
    wanted = np.array([by_rows(UR10E, each) for each in q])
    np.testing.assert_allclose(chain.forward(q), wanted, atol=1e-10)
    text = ur_kinematics(chain, chain.nominal)
    np.testing.assert_allclose([by_origins(text, each) for each in q], wanted, atol=1e-10)
    content = yaml.safe_load(text)["kinematics"]
    assert content["forearm"]["x"] == pytest.approx(-0.6127, abs=2e-3)
    assert content["wrist_1"]["x"] == pytest.approx(-0.57155, abs=2e-3)
    origins = [
        placed(*np.split(np.array([content[link][key] for key in list(content[link])]), 2))
        for link in LINKS
    ]
    again = Chain.of(arm_of_ur_origins(np.array(origins), "mine", None, "a.yaml"))
    np.testing.assert_allclose(again.forward(q), wanted, atol=1e-10)


@pytest.mark.parametrize("seed", [1, 2])
def test_departures_of_a_calibrated_arm_have_its_forward_kinematics(seed):
    chain = Chain.of(load_arm("ur10"))
    at, layout = departed(chain, seed), ur_layout(load_arm("ur10"))
    assert ur_deltas(chain, at, layout) is None  # a row has no tilt of its flange about y
    at[chain.columns(("beta_6",))] = 0.0
    q = np.random.default_rng(4).uniform(-3, 3, (5, 6))
    found = [by_rows(layout.table + ur_deltas(chain, at, layout), each) for each in q]
    np.testing.assert_allclose(found, expected(chain, at, q), atol=1e-8)


def test_an_arm_as_designed_departs_by_nothing():
    chain, layout = Chain.of(load_arm("ur10")), ur_layout(load_arm("ur10"))
    np.testing.assert_allclose(ur_deltas(chain, chain.nominal, layout), 0.0, atol=1e-12)


def test_what_no_rows_of_a_controller_can_hold_is_none():
    base = placed(np.zeros(3), np.array([1e-3, 0.0, 0.0]))
    chain = Chain.of(replace(load_arm("ur10"), T_base_row1=base))
    assert ur_deltas(chain, chain.nominal, ur_layout(load_arm("ur10"))) is None


@pytest.mark.parametrize(
    ("robot", "message"),
    [("irb120", "not the layout of Universal Robots.*--robot"), ("ur10", "of another model.*mm")],
)
def test_a_calibration_of_another_arm_is_refused(robot, message):
    table = UR10E + [0.0, 0.05, 0.0, 0.0] * np.eye(6, 1)
    with pytest.raises(ArmError, match=rf"c\.conf: .*{message}"):
        arm_of_ur_rows(table, "mine", load_arm(robot), "c.conf")


def test_the_drivers_file_of_an_arm_as_designed_is_the_makers():
    chain = Chain.of(load_arm("ur10"))
    words = re.findall(r"(\w+): (\S+)", ur_kinematics(chain, chain.nominal, "a comment"))
    values = [float(value) for key, value in words if key in ("x", "y", "z")]
    maker = [0, 0, 0.1273, 0, 0, 0, -0.612, 0, 0, -0.5723, 0, 0.163941]
    np.testing.assert_allclose(values, [*maker, 0, -0.1157, 0, 0, 0.0922, 0], atol=1e-12)


@pytest.mark.parametrize("yaw", [0.0, np.pi])
def test_the_drivers_file_is_the_calibrated_arm(yaw):
    base = placed(np.zeros(3), np.array([0.0, 0.0, yaw]))
    chain = Chain.of(replace(load_arm("ur10"), T_base_row1=base))
    at = departed(chain)
    across = chain.columns(("a_6",))
    a_m = at[across] - chain.nominal[across]
    assert flange_off_m(chain, at) == pytest.approx(abs(a_m[0]))
    # What the last row departs by across its axis has no place in the file.
    held = chain.columns(("a_6", "alpha_6", "beta_6"))
    at[held] = chain.nominal[held]
    content = yaml.safe_load(ur_kinematics(chain, at))["kinematics"]
    assert [*content] == [*LINKS, "hash"]
    assert re.fullmatch(r"calib_\d+", content["hash"])
    q = np.random.default_rng(4).uniform(-2, 2, (5, 6))
    for positions, wanted in zip(q, expected(chain, at, q), strict=True):
        T = base
        for name, angle in zip(LINKS, positions, strict=True):
            six = [content[name][key] for key in ("x", "y", "z", "roll", "pitch", "yaw")]
            T = T @ placed(np.array(six[:3]), np.array(six[3:]))
            T = T @ placed(np.zeros(3), np.array([0.0, 0.0, angle]))
        np.testing.assert_allclose(T, wanted, atol=1e-12)


@pytest.mark.parametrize("name", [name for name in arm_names() if name != "ur10"])
def test_other_arms_have_no_such_file(name):
    chain = Chain.of(load_arm(name))
    assert ur_kinematics(chain, chain.nominal) is None
