"""What is probably wrong in the input is named, and right data are not accused."""

from __future__ import annotations

import shutil
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.spatial.transform import Rotation

from made_up_sightings import sighted
from mended import QUATERNION, describe, findings, mend, simulated
from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import Payload
from pa10cal.calibration.checked_campaign import CheckedCampaign
from pa10cal.calibration.input_checks import direction_of_gravity, explained
from pa10cal.calibration.joint_slips import signs_and_order
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.conventions import EXPECTED_M
from pa10cal.campaign.read import read_campaign
from pa10cal.errors import CalibrationError
from pa10cal.files.arms import load_arm
from pa10cal.results.calibration import InputFinding

EXAMPLES = Path(__file__).parents[2] / "examples"
TOUCHED, LOG = "cmm.csv.gz", "resolver.csv.gz"


def order(*columns):
    return lambda table: table.put(QUATERNION, table.numbers(QUATERNION)[:, columns])


def inverted(table):
    table.put(QUATERNION, table.numbers(QUATERNION) * [1, -1, -1, -1])


def euler(table):
    """Angles Z-Y-X about moving axes, taken for X-Y-Z about moving axes."""
    angles = Rotation.from_quat(table.numbers(QUATERNION), scalar_first=True).as_euler("ZYX")
    table.put(QUATERNION, Rotation.from_euler("XYZ", angles).as_quat(scalar_first=True))


def reversed_joints(*joints):
    names = [f"q{joint}_deg" for joint in joints]
    return lambda table: table.put(names, -table.numbers(names))


def exchanged_joints(first, second):
    names = [f"q{first}_deg", f"q{second}_deg"]
    return lambda table: table.put(names, table.numbers(names)[:, ::-1])


@pytest.mark.slow_but_one_in(8)
@pytest.mark.parametrize("kind", ["pose", "points"])
@pytest.mark.parametrize("times", [1.8, 1.1, 0.5, 1.0])
def test_one_factor_of_all_readings_is_told_with_its_number(tmp_path, kind, times):
    folder = simulated(tmp_path / "c", "ur10", kind, poses=40)
    header = (folder / "poses.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    places = [name for name in header if name.endswith(("x_mm", "y_mm", "z_mm"))]
    mend(
        folder,
        "poses.csv",
        lambda table: table.put(places, times * np.array(table.numbers(places))),
    )
    every = findings(folder)
    assert all(each.kind != "target_places" for each in every)  # of which lengths are off as well
    found = [each for each in every if each.kind == "scale"]
    if times == 1.0:
        assert found == []
        return
    (scale,) = found
    said = float(scale.remedy.split("divide the positions by ")[1].split(":")[0])
    assert said == pytest.approx(times, rel=3e-3)


def of_another_size(folder, size, times=1.0):
    """Make a campaign of a UR10 one of an arm of another size, read so many times too long."""
    arm = yaml.safe_load(files("pa10cal.files").joinpath("arms/ur10.yaml").read_text("utf-8"))
    arm["name"] = "resized"
    for row in arm["rows"]:
        row |= {key: size * row[key] for key in ("d_m", "a_m") if key in row}
        for key in ("mass_kg", "com_m", "torque_limit_Nm"):
            row.pop(key, None)
    (folder / "resized.yaml").write_text(yaml.safe_dump(arm))
    describe(folder, "robot", "resized")
    describe(folder, "instrument.uncertainty_mm", lambda stated_mm: size * stated_mm)
    describe(folder, "tool.mass_kg", lambda mass_kg: size**3 * mass_kg)
    describe(folder, "tool.com_mm", lambda com_mm: [size * part for part in com_mm])
    if "balls_mm" in (folder / "campaign.yaml").read_text():
        describe(
            folder,
            "tool.balls_mm",
            lambda balls_mm: {name: [size * part for part in at] for name, at in balls_mm.items()},
        )
    header = (folder / "poses.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    places = [name for name in header if name.endswith(("x_mm", "y_mm", "z_mm"))]
    mend(
        folder,
        "poses.csv",
        lambda table: table.put(places, times * size * np.array(table.numbers(places))),
    )


@pytest.mark.parametrize("size", [0.02, 12.0])
def test_a_factor_of_all_readings_is_told_of_arms_of_any_size(tmp_path, size):
    folder = simulated(tmp_path / "c", "ur10", "points", poses=40)
    shutil.copytree(folder, right := tmp_path / "right")
    of_another_size(right, size)
    assert findings(right) == ()
    of_another_size(folder, size, 1.08)
    (scale,) = findings(folder)
    assert "divide the positions by 1.0" in scale.remedy


@pytest.mark.parametrize("size", [0.02, 12.0])
def test_the_zero_of_a_joint_has_its_remedy_in_arms_of_any_size(tmp_path, size):
    folder = simulated(tmp_path / "c", "ur10", "pose", poses=40)
    of_another_size(folder, size)
    mend(folder, "poses.csv", lambda table: table.put(["q3_deg"], 3.0 + table.numbers(["q3_deg"])))
    (zero,) = findings(folder)
    assert (zero.kind, zero.joint) == ("joint_zero", 3)
    assert "set joint_offsets_deg: [0, 0, -3.0" in zero.remedy
    assert zero.would_leave_mm < 10.0 * size


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["ur10", "irb120", "iiwa14"])
@pytest.mark.parametrize(
    ("change", "says"),
    [
        (order(1, 2, 3, 0), "order x, y, z, w under"),
        (order(3, 0, 1, 2), "order z, w, x, y under"),
        (inverted, "the inverse rotation"),
        (euler, "Euler angles"),
    ],
)
def test_the_convention_of_attitudes_is_named(tmp_path, robot, change, says):
    folder = simulated(tmp_path / "c", robot, "pose", poses=40)
    mend(folder, "poses.csv", change)
    (found,) = findings(folder)
    assert found.kind == "attitude_convention"
    assert says in found.what


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("word", ["euler_XYZ", "euler_ZYX", "rotation_vector", "euler_ZYZ"])
def test_numbers_that_another_convention_does_not_return_are_named(tmp_path, word):
    """Of two sets of angles, and of vectors whole turns apart, the file may hold either."""
    folder = shutil.copytree(EXAMPLES / "ur10-pose", tmp_path / "c")
    text = (folder / "campaign.yaml").read_text("utf-8")
    text = text.replace("convention: euler_XYZ", f"convention: {word}")
    (folder / "campaign.yaml").write_text(text, "utf-8")
    remedies = [found.remedy for found in findings(folder)]
    expected = "set columns.poses.rotation.convention: euler_XYZ"
    assert remedies == ([] if word == "euler_XYZ" else [expected])


def scrambled(table):
    numbers = np.array(table.numbers(QUATERNION))
    table.put(QUATERNION, np.random.default_rng(0).permutation(numbers))


def test_orientations_that_agree_in_no_convention_are_told(tmp_path):
    folder = simulated(tmp_path / "c", "ur10", "pose", poses=40)
    mend(folder, "poses.csv", scrambled)
    (found,) = findings(folder)
    assert found.kind == "attitude_convention"
    assert "in every convention that is known" in found.what


@pytest.mark.slow
@pytest.mark.parametrize("instrument", ["pose", "points", "distance"])
@pytest.mark.parametrize("robot", ["ur10", "irb120", "iiwa14"])
@pytest.mark.parametrize(
    ("change", "kind", "where"),
    [
        (reversed_joints(2), "joint_sign", "q2"),
        (reversed_joints(5), "joint_sign", "q5"),
        (exchanged_joints(4, 5), "joint_order", "q4, q5"),
    ],
)
def test_joint_signs_and_order_are_named(tmp_path, robot, instrument, change, kind, where):
    folder = simulated(tmp_path / "c", robot, instrument)
    mend(folder, "poses.csv", change)
    (found,) = findings(folder)
    assert (found.kind, found.where) == (kind, where)
    assert found.would_leave_mm < 10.0


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("pair", [(1, 3), (2, 6)])
def test_any_two_joints_may_be_exchanged(tmp_path, pair):
    folder = simulated(tmp_path / "c", "ur10", "points", poses=40)
    mend(folder, "poses.csv", exchanged_joints(*pair))
    (found,) = findings(folder)
    assert (found.kind, found.where) == ("joint_order", "q{}, q{}".format(*pair))


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("by", [1, -2])
def test_columns_of_joints_that_are_all_shifted_are_named(tmp_path, by):
    def shift(table):
        names = [f"q{joint}_deg" for joint in range(1, 7)]
        table.put(names, np.roll(np.array(table.numbers(names)), by, axis=1))

    folder = simulated(tmp_path / "c", "ur10", "points", poses=40)
    mend(folder, "poses.csv", shift)
    (found,) = findings(folder)
    order = np.roll(np.arange(1, 7), -by)
    assert (found.kind, found.where) == ("joint_order", ", ".join(f"q{k}" for k in order))
    assert f"joint 1 stands in that of joint {order[0]}" in found.what
    assert found.remedy == f"put the columns in the order {found.where}"


def shifted_joints(table):
    """The first two are lost: the columns hold those that come after, and zeros."""
    names = [f"q{joint}_deg" for joint in range(1, 7)]
    values = np.roll(np.array(table.numbers(names)), -2, axis=1)
    values[:, -2:] = 0.0
    table.put(names, values)


def test_joints_that_were_not_logged_are_named(tmp_path):
    folder = simulated(tmp_path / "c", "ur10", "points", poses=40)
    mend(folder, "poses.csv", shifted_joints)
    (found,) = findings(folder)
    assert (found.kind, found.where) == ("joint_without_motion", "q5, q6")
    assert "the first ones lost" in found.what
    assert "order of all columns" in found.remedy


def test_a_joint_that_stood_still_is_no_mistake(tmp_path):
    folder = simulated(tmp_path / "c", "ur10", "points", poses=40)
    measured, arm = pd.read_csv(folder / "poses.csv"), load_arm("ur10")
    q = measured[[f"q{joint}_deg" for joint in range(1, 7)]].to_numpy()
    q[:, 5] = 30.0
    T_base_ee = Chain.of(arm).forward(np.radians(q))
    measured["q6_deg"] = 30.0
    for k, name in enumerate(["T1", "T2", "T3"]):
        places = [f"{name}_{axis}_mm" for axis in "xyz"]
        measured[places] = 1e3 * (T_base_ee @ [0.1 * (k == 0), 0.1 * (k == 1), 0.1, 1.0])[:, :3]
    measured.to_csv(folder / "poses.csv", index=False)
    assert "joint_without_motion" not in {found.kind for found in findings(folder)}


@pytest.mark.slow
def test_several_reversed_joints_are_named(tmp_path):
    folder = simulated(tmp_path / "c", "ur10", "pose")
    mend(folder, "poses.csv", reversed_joints(2, 5))
    (found,) = findings(folder)
    assert sorted(found.where.split("; ")) == ["q2", "q5"]


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("robot", ["ur10", "irb120"])
def test_the_last_joint_is_named_though_its_target_is_near_its_axis(tmp_path, robot, reverse):
    campaign = sighted(tmp_path, "points", robot=robot, poses=80, targets=1)
    rng, arm = np.random.default_rng(3), load_arm(robot)
    departed = replace(arm, alpha_rad=arm.alpha_rad + rng.normal(0, 1e-3, arm.n))
    T_base_ee = Chain.of(departed).forward(campaign.q)
    p_m = (campaign.T_instr_base @ T_base_ee @ [0.004, 0, 0.1, 1])[:, :3]
    p_m += rng.normal(0, 2e-5, p_m.shape)
    for row, place in enumerate(p_m, start=1):
        words = campaign.poses[row].split(",")
        words[-3:] = [f"{1e3 * x:.6f}" for x in place]
        if reverse:
            words[campaign.column("q6_deg")] = f"{-np.degrees(campaign.q[row - 1, 5]):.9f}"
        campaign.poses[row] = ",".join(words)
    found = [(each.kind, each.where) for each in findings(campaign.write())]
    assert found == ([("joint_sign", "q6")] if reverse else [])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "instrument", "gravity"),
    [
        ("ur10", "pose", [0, 0, 9.81]),
        ("iiwa14", "pose", [9.81, 0, 0]),
        ("ur10", "points", [0, -9.81, 0]),
        ("iiwa14", "points", [0, 0, 9.81]),
        ("ur10", "distance", [9.81, 0, 0]),
    ],
)
def test_the_direction_of_gravity_shows_in_springs(tmp_path, robot, instrument, gravity):
    folder = simulated(tmp_path / "c", robot, instrument, position_mm=0.02)
    describe(folder, "gravity_m_s2", gravity)
    (found,) = findings(folder)
    assert found.kind == "gravity"
    assert "along -z" in found.what


@pytest.mark.parametrize(("with_errors_mm", "told"), [(0.009, False), (0.03, True)])
def test_gravity_is_right_where_errors_of_joints_explain_as_much(with_errors_mm, told):
    up = (0.0, 0.0, 9.81)
    checked = SimpleNamespace(
        logs_torques=False,
        arm=load_arm("ur10"),
        above_noise=True,
        payload=Payload(0.0, np.zeros(3), np.zeros(3), np.array([0.0, 0.0, -9.81])),
        calibrated_mm=lambda at: (0.011 if np.allclose(at.gravity_m_s2, up) else 0.035, 0.005),
        with_errors_of_joints_mm=lambda at: with_errors_mm,
        expected_m=EXPECTED_M,
    )
    assert (direction_of_gravity(checked) is not None) == told


def test_gear_ratios_are_among_the_errors_of_joints(tmp_path):
    folder = simulated(tmp_path / "c", "irb120", "points", poses=60)
    ratio = ["q2_deg"]
    mend(folder, "poses.csv", lambda table: table.put(ratio, 1.001 * table.numbers(ratio)))
    read = read_campaign(folder)
    every = read.observations.of_kind("grid")
    checked = CheckedCampaign(read.description, read.arm, CalibrationOptions(), None, every, 0.0)
    left_mm = checked.with_errors_of_joints_mm(checked.payload)
    assert left_mm < 0.3 * checked.calibrated_mm(checked.payload)[0]


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("gravity", [[0, 0, 9.81], [9.81, 0, 0]])
def test_the_direction_of_gravity_shows_in_logged_torques(tmp_path, gravity):
    folder = simulated(tmp_path / "c", "pa10_6ce", "touches")
    describe(folder, "gravity_m_s2", gravity)
    (found,) = findings(folder)
    assert found.kind == "gravity"


@pytest.mark.parametrize("temperature_C", [68.0, 104.0])
def test_degrees_fahrenheit_are_found(tmp_path, temperature_C):
    folder = simulated(tmp_path / "c", "irb120", "pose", poses=30)
    describe(folder, "reference_temperature_C", temperature_C)
    mend(folder, "poses.csv", lambda table: table.fill("temperature_C", "70.1"))
    assert [found.kind for found in findings(folder)] == ["temperature", "temperature"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shift_mm", "kinds"), [(0.003, []), (0.2, ["target_places"]), (0.5, ["target_places"])]
)
def test_balls_are_where_they_are_stated(tmp_path, shift_mm, kinds):
    folder = simulated(tmp_path / "c", "pa10_6ce", "touches")
    describe(folder, "tool.balls_mm.B", lambda place: [x + shift_mm for x in place])
    found = findings(folder)
    assert [each.kind for each in found] == kinds
    assert not kinds or found[0].where.endswith("B")


@pytest.mark.slow
def test_balls_exchanged_throughout_are_named(tmp_path):
    folder = simulated(tmp_path / "c", "pa10_6ce", "touches")
    describe(folder, "tool.balls_mm", lambda balls: {**balls, "B": balls["C"], "C": balls["B"]})
    (found,) = findings(folder)
    assert (found.kind, found.where) == ("target_label", "tool.balls_mm: B and C")


def test_few_poses_accuse_nothing(tmp_path):
    folder = simulated(tmp_path / "c", "ur10", "pose")
    mend(folder, "poses.csv", lambda table: table.rows.__delitem__(slice(3, None)))
    assert "joint_without_motion" not in {found.kind for found in findings(folder)}


@pytest.mark.slow
@pytest.mark.parametrize("instrument", ["pose", "points", "distance"])
@pytest.mark.parametrize("robot", ["ur10", "irb120", "iiwa14", "pa10_6ce", "gx4_351s"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_right_data_are_not_accused(tmp_path, robot, instrument, seed):
    rng = np.random.default_rng(seed)
    plan = {"position_mm": float(rng.choice([0.01, 0.1])), "repeat_every": 3}
    if robot in ("ur10", "iiwa14", "pa10_6ce"):
        plan |= {"logs_torques": seed == 2, "loads_N": [0.0, 30.0]}
    folder = simulated(tmp_path / "c", robot, instrument, seed, **plan)
    assert "joint_without_motion" not in {found.kind for found in findings(folder)}


def test_a_refusal_says_what_was_found():
    error = CalibrationError("it does not fit", where="here", allowed="that", remedy="look")
    assert explained(error, ()) is error
    found = InputFinding(
        what="the sign is reversed",
        where="q2",
        remedy="multiply by -1",
        would_leave_mm=None,
        kind="input",
    )
    assert str(explained(error, [found])) == (
        "here: it does not fit; allowed: that; check the input: q2: the sign is reversed; "
        "multiply by -1"
    )
    # A joint that was locked says nothing of the cause.
    still = found.model_copy(update={"kind": "joint_without_motion"})
    assert str(explained(error, [still])).endswith("multiply by -1; if that is right, look")


def test_no_change_of_signs_or_order_is_told_where_nothing_fits():
    arm = load_arm("ur10")
    axes = np.zeros((3, arm.n))
    misfit = {"nominal_misfit_m": lambda q: np.inf, "least_misfit_m": lambda q: 0.0}
    checked = SimpleNamespace(arm=arm, axes=axes, not_departures_m=0.01, **misfit)
    assert signs_and_order(checked) is None
