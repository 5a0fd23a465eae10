"""A campaign.yaml proposed for a file as it is."""

from __future__ import annotations

import io
import re

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.spatial.transform import Rotation

from made_up_sightings import sighted
from pa10cal.__main__ import main
from pa10cal.arm.chain import Chain
from pa10cal.arm.urdf_writing import urdf_text
from pa10cal.campaign.read import read_campaign
from pa10cal.commands.data import label_of
from pa10cal.errors import fits_a_folder
from pa10cal.files.arms import arm_text, joint_names, load_arm
from pa10cal.settings import RESERVED

Q = [f"q{j}_deg" for j in range(1, 7)]
UR = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]
PLACE, QUATERNION = ["x_mm", "y_mm", "z_mm"], ["qw", "qx", "qy", "qz"]


@pytest.fixture
def written(tmp_path, proposed):
    """Write a table, and propose a campaign.yaml for it."""

    def run(table, *options, preamble="", **how):
        folder = tmp_path / "mine"
        folder.mkdir(exist_ok=True)
        (folder / "export.txt").write_text(preamble + table.to_csv(index=False, **how))
        text = proposed("export.txt", folder=folder, options=options)
        return yaml.safe_load(text), text, folder

    return run


def tracked(tmp_path, kind="pose", **how):
    raw = sighted(tmp_path, kind, **how)
    table = pd.read_csv(io.StringIO("\n".join(raw.poses)))
    return raw, table.drop(columns=["time_s", "kind", "pose", "load_N", "repeat"])


def attitudes(table, convention):
    R = Rotation.from_quat(table[QUATERNION], scalar_first=True)
    word, _, axes = convention.partition("_")
    if word == "quaternion":
        return R.as_quat(scalar_first=axes == "wxyz")
    if word == "rotation":
        return R.as_rotvec()
    return R.as_euler("xyz" if word == "rpy" else axes, degrees=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("convention", "names"),
    [
        ("rpy", ["Roll", "Pitch", "Yaw"]),
        ("euler_XYZ", ["Rx [deg]", "Ry [deg]", "Rz [deg]"]),
        ("euler_ZYX", ["A", "B", "C"]),
        ("rotation_vector", ["rx", "ry", "rz"]),
        ("quaternion_xyzw", ["Q0", "Q1", "Q2", "Q3"]),
        ("quaternion_wxyz", ["qw", "qx", "qy", "qz"]),
    ],
)
@pytest.mark.usefixtures("tried")
def test_the_convention_is_that_in_which_the_nominal_arm_agrees(
    tmp_path, written, convention, names
):
    raw, table = tracked(tmp_path)
    own = table.drop(columns=QUATERNION).rename(columns=dict(zip(PLACE, "XYZ", strict=True)))
    own[Q] = np.radians(own[Q])
    own = own.rename(columns={name: f"J{k}" for k, name in enumerate(Q, start=1)})
    own = own.join(pd.DataFrame(attitudes(table, convention), columns=names))
    content, text, folder = written(own, "--robot", "ur10", sep=";", decimal=",")
    assert "# read so: 40 rows can be used, 0 cannot" in text
    columns = content["columns"]["poses"]
    assert columns["rotation"]["convention"] == convention
    assert (columns["separator"], columns["decimal"]) == (";", ",")
    assert columns["joints"] == {"names": [f"J{k}" for k in range(1, 7)], "unit": "rad"}
    found = read_campaign(folder)
    assert found.quarantined == ()
    np.testing.assert_allclose(found.observations.states.q_rad, raw.q, atol=1e-8)
    np.testing.assert_allclose(
        found.observations.measured.T_instr_target, raw.T_instr_target, atol=1e-6
    )


@pytest.mark.usefixtures("tried")
def test_poses_of_the_instrument_in_the_targets_frame_are_told_by_the_arm(tmp_path, written):
    raw, table = tracked(tmp_path)
    inverse = Rotation.from_quat(table[QUATERNION], scalar_first=True).inv()
    own = table.copy()
    own[PLACE], own[QUATERNION] = -inverse.apply(table[PLACE]), inverse.as_quat()
    content, text, folder = written(own, "--robot", "ur10")  # under the contract's names, x y z w
    assert "# read so: 40 rows can be used, 0 cannot" in text
    rotation = content["columns"]["poses"]["rotation"]
    assert (rotation["convention"], rotation["inverse"]) == ("quaternion_xyzw", "pose")
    measured = read_campaign(folder).observations.measured
    np.testing.assert_allclose(measured.T_instr_target, raw.T_instr_target, atol=1e-6)


@pytest.mark.usefixtures("tried")
def test_where_no_convention_agrees_the_names_decide(tmp_path, written):
    _, table = tracked(tmp_path)
    own = table.copy()
    own[Q] = np.roll(own[Q], 1, axis=0)
    content, text, _ = written(own.rename(columns={"x_mm": "X"}), "--robot", "ur10")
    assert content["columns"]["poses"]["rotation"]["convention"] == "quaternion_wxyz"
    assert "from the first row on the readings fit the joints of the row after theirs" in text


def test_units_without_a_word_are_found_by_the_arm(tmp_path, written):
    _, table = tracked(tmp_path)
    own = table.rename(columns=dict(zip(PLACE, ["px", "py", "pz"], strict=True)))
    own[["px", "py", "pz"]] *= 1e-3
    columns = written(own, "--robot", "ur10")[0]["columns"]["poses"]
    assert columns["position"] == {"names": ["px", "py", "pz"], "unit": "m"}


@pytest.mark.usefixtures("tried")
def test_an_arm_is_taken_from_a_folder_of_arms(tmp_path, written):
    _, table = tracked(tmp_path)
    arms = tmp_path / "elsewhere"
    arms.mkdir()
    own = arm_text(load_arm("ur10")).replace("ur10", "ours")
    (arms / "ours.yaml").write_text(own, encoding="utf-8")
    content, text, folder = written(table, "--robot", "ours", "--arms", str(arms))
    assert content["robot"] == "ours"
    assert "rows can be used, 0 cannot" in text
    assert read_campaign(folder, arms=arms).arm.n == 6
    assert main(["columns", str(folder / "export.txt"), "--robot", "ours"]) != 0


def test_a_joint_that_slides_is_read_in_its_own_unit(tmp_path, written):
    _, table = tracked(tmp_path, "points", robot="gx4_351s")
    table = table.rename(
        columns={f"q{k}_{'mm' if k == 3 else 'deg'}": f"J{k}" for k in range(1, 5)}
    )
    content, text, _ = written(table, "--robot", "gx4_351s")
    assert content["columns"]["poses"]["joints"]["stroke_unit"] == "mm"
    assert re.search(r"J3 +position of joint 3, in mm$", text, re.MULTILINE)
    assert re.search(r"J4 +position of joint 4, in deg$", text, re.MULTILINE)


def test_a_proposal_shows_nothing_that_a_terminal_obeys(tmp_path, written):
    """And names its columns all the same."""
    _, table = tracked(tmp_path)
    names = [f"J{k}\u202e\x1b[2J\x9b'# : {{" for k in range(1, 7)]
    own = table.rename(columns=dict(zip(Q, names, strict=True)))
    content, text, folder = written(own, "--robot", "ur10")
    assert content["columns"]["poses"]["joints"]["names"] == names
    assert all(line.isprintable() for line in text.splitlines())
    assert read_campaign(folder).arm.n == 6


@pytest.mark.usefixtures("tried")
def test_a_proposal_that_the_arm_does_not_bear_out_says_so(tmp_path, written):
    _, table = tracked(tmp_path)
    own = table.rename(columns={name: f"J{k}" for k, name in enumerate(Q, start=1)})
    own[PLACE] = own[PLACE].to_numpy()[::-1]  # of other poses
    text = written(own, "--robot", "ur10")[1]
    assert re.search(r"^# check: the nominal model, base and target fitted, is \d+ mm", text, re.M)


@pytest.mark.slow_but_one_in(6)
@pytest.mark.parametrize("times", [0.5, 1.1, 4.0])
@pytest.mark.parametrize("kind", ["pose", "points"])
@pytest.mark.usefixtures("tried")
def test_lengths_of_another_scale_are_told_by_their_factor(tmp_path, written, times, kind):
    """As of a tag that is held for another size: orientations are right, and no row is lost."""
    _, table = tracked(tmp_path, kind)
    own = table.rename(columns={name: f"J{k}" for k, name in enumerate(Q, start=1)})
    places = [name for name in own if name.endswith(("x_mm", "y_mm", "z_mm"))]
    own[places] *= times
    text = written(own, "--robot", "ur10")[1]
    assert "rows can be used, 0 cannot" in text
    assert re.search(rf"mm if lengths are divided by {times:g}: check the size of the tag", text)
    assert "none agrees with the nominal arm" not in text


def test_without_an_arm_the_reader_is_told_what_to_check(tmp_path, written):
    _, table = tracked(tmp_path)
    own = table.drop(columns=QUATERNION)
    own[["rx", "ry", "rz"]] = attitudes(table, "euler_XYZ")
    content, text, _ = written(own)
    assert content["robot"] == "my_arm"
    assert content["columns"]["poses"]["rotation"]["convention"] == "rpy"
    assert "# check rotation.convention: rpy, by the names alone" in text
    assert "--robot" in text


def test_what_was_commanded_is_not_taken_for_what_was_measured(tmp_path, written):
    _, table = tracked(tmp_path)
    goals = {"Goal x": 0.1, "Goal y": 0.2, "Goal z": 0.3, "Goal roll": 0.0}
    own = table.assign(**goals | {"Goal pitch": 0.0, "Goal yaw": 0.0})
    stamps = pd.Timestamp("2026-01-05 10:00") + pd.to_timedelta(np.arange(len(own)), unit="min")
    own = own.assign(Clock=stamps.strftime("%m/%d/%Y %H:%M:%S"), Temp_F=70.0)
    own = own.rename(columns={"Clock": "Time"}).assign(std_x_mm=0.02, std_y_mm=0.02, std_z_mm=0.02)
    content, _, folder = written(own, "--robot", "ur10", preamble="Tracker\nOperator: me\n\n")
    columns = content["columns"]["poses"]
    assert columns["header"] == 4
    assert columns["position"]["names"] == PLACE
    assert columns["position"]["u"] == ["std_x_mm", "std_y_mm", "std_z_mm"]
    assert columns["rotation"]["names"] == QUATERNION
    assert columns["time"] == {"names": "Time", "format": "%m/%d/%Y %H:%M:%S"}
    assert columns["temperature"] == {"names": "Temp_F", "unit": "F"}
    assert content["instrument"]["uncertainty_mm"] == 0.02
    assert len(read_campaign(folder).observations) == 40


def test_a_date_and_a_time_of_day_are_one_time(tmp_path, written):
    _, table = tracked(tmp_path)
    stamps = pd.Timestamp("2026-11-03 09:00") + pd.to_timedelta(10 * np.arange(len(table)), "s")
    table.insert(0, "Datum", stamps.strftime("%d.%m.%Y"))
    table.insert(1, "Uhrzeit", stamps.strftime("%H:%M:%S"))
    content, text, folder = written(table, "--robot", "ur10", sep=";", decimal=",")
    how = {"names": ["Datum", "Uhrzeit"], "format": "%d.%m.%Y %H:%M:%S"}
    assert content["columns"]["poses"]["time"] == how
    assert "# check time" not in text
    assert np.ptp(read_campaign(folder).observations.states.time_s) == 10.0 * (len(table) - 1)


def test_a_target_without_a_name_is_beside_one_that_has_its_number(tmp_path, written):
    _, table = tracked(tmp_path, "points")
    called = {"T1": "", "T2": "T1_"}
    own = table.rename(
        columns={
            f"{was}_{axis}_mm": f"{now}{axis}_mm" for was, now in called.items() for axis in "xyz"
        }
    )
    content, _, _ = written(own, "--robot", "ur10")
    targets = content["columns"]["poses"]["targets"]
    assert sorted(column for place in targets.values() for column in place["names"]) == sorted(
        name for name in own if name.endswith(("x_mm", "y_mm", "z_mm"))
    )


@pytest.mark.usefixtures("tried")
def test_numbers_behind_x_y_z_are_those_of_targets(tmp_path, written):
    _, table = tracked(tmp_path, "points")
    own = table.rename(
        columns={f"T{k}_{a}_mm": f"{a}{k}".upper() for k in (1, 2, 3) for a in "xyz"}
    )
    for names in (list(own), sorted(own)):
        content, text, _ = written(own[names], "--robot", "ur10")
        targets = content["columns"]["poses"]["targets"]
        assert [place["names"] for place in targets.values()] == [
            [f"{axis}{k}" for axis in "XYZ"] for k in (1, 2, 3)
        ]
        assert "# read so: 40 rows can be used, 0 cannot" in text


@pytest.mark.parametrize(
    ("word", "unit", "deg"),
    [("gon", "gon", 0.9), ("turns", "turns", 360.0), ("rev", "turns", 360.0)],
)
@pytest.mark.usefixtures("tried")
def test_angles_of_joints_may_be_gradians_or_turns(tmp_path, written, word, unit, deg):
    raw, table = tracked(tmp_path)
    own = table.rename(columns={name: f"J{k} [{word}]" for k, name in enumerate(Q, start=1)})
    own[[f"J{k} [{word}]" for k in range(1, 7)]] /= deg
    content, text, folder = written(own, "--robot", "ur10")
    assert content["columns"]["poses"]["joints"]["unit"] == unit
    np.testing.assert_allclose(read_campaign(folder).observations.states.q_rad, raw.q, atol=1e-8)
    assert "0 cannot" in text


@pytest.mark.parametrize(
    ("name", "value", "unit", "in_C"),
    [("temp [°C]", 52.0, None, 52.0), ("temp [°F]", 32.0, "F", 0.0), ("temp", 68.0, "F", 20.0)],
)
def test_a_temperature_has_the_unit_of_its_header(tmp_path, written, name, value, unit, in_C):
    _, table = tracked(tmp_path)
    content, _, _ = written(table.assign(**{name: value}), "--robot", "ur10")
    assert content["columns"]["poses"]["temperature"].get("unit") == unit
    assert content["reference_temperature_C"] == in_C


def test_several_targets_are_points_and_a_distance_is_one(tmp_path, written):
    _, table = tracked(tmp_path, "points")
    content, _, _ = written(table, "--robot", "ur10")
    assert content["instrument"]["kind"] == "points"
    assert sorted(content["columns"]["poses"]["targets"]) == ["T1", "T2", "T3"]
    _, table = tracked(tmp_path, "distance")
    content, _, _ = written(table.rename(columns={"d_mm": "Range mm"}), "--robot", "ur10")
    assert content["columns"]["poses"]["distance"] == {"names": "Range mm", "unit": "mm"}


def test_a_file_of_the_contract_needs_no_mapping(tmp_path, written):
    raw = sighted(tmp_path, "pose")
    table = pd.read_csv(io.StringIO("\n".join(raw.poses)))
    content, _, folder = written(table, "--robot", "ur10", "--name", "mine")
    assert "columns" not in content
    assert content["name"] == "mine"
    assert len(read_campaign(folder).observations) == 40


def test_of_a_file_of_the_contract_every_column_that_is_read_is_listed(tmp_path, written):
    raw = sighted(tmp_path, "pose")
    table = pd.read_csv(io.StringIO("\n".join(raw.poses)))
    beside = {"tau1_Nm": 1.5, "u_q1_deg": 0.01, "temperature_C": 20.0, "note": 7.5, "u_note": 1.5}
    _, text, _ = written(table.assign(**beside))
    not_read = [line.split()[1] for line in text.splitlines() if line.endswith("  not read")]
    assert not_read == ["tau1_Nm", "note", "u_note"]  # torques are of all joints or of none
    torques = {f"tau{j}_Nm": np.arange(len(table)) for j in range(1, 7)}
    _, text, _ = written(table.assign(**(beside | torques)))
    assert "not read" not in "".join(line for line in text.splitlines() if "tau" in line)


@pytest.mark.parametrize(
    ("folder", "name"),
    [
        ("measured", "my-measured"),
        ("2024.05.01-ur10", "2024.05.01-ur10"),
        ("Meßreihe (2) ½", "Meßreihe--2--½"),
        ("e\u0301té", "e-té"),
        (".-", "mine"),
        ("long" * 40, "long" * 25),
    ],
)
def test_the_name_of_a_folder_becomes_one_that_run_accepts(folder, name):
    assert label_of(folder) == name
    assert fits_a_folder(name)
    assert name not in RESERVED


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        ("a report\nof no numbers\nat all\n", "no rows of numbers"),
        ("k,T\n" + '1,"[[1. 0.]\n [0. 1.]]"\n' * 9, "fields hold whole matrices as text"),
        ("a,b,c,d\n" + "1,2,3,4\n" * 9, "no joint positions were recognised"),
        ("a,b,c,d\n" + "1,2,3,4\n" * 9, "joint positions are in another: pa10cal columns JOINTS"),
        ("J1,J2,J3,J4,J5,J6\n" + "1,2,3,4,5,6\n" * 9, "no position and no distance"),
        ("J1,J2,J3,J4,J5,J6\n" + "1,2,3,4,5,6\n" * 9, "readings are in another: pa10cal columns"),
    ],
)
def test_a_file_of_something_else_is_refused(tmp_path, capsys, text, message):
    path = tmp_path / "export.txt"
    path.write_text(text)
    assert main(["columns", str(path), "--robot", "ur10"]) == 2
    assert message in capsys.readouterr().err
    assert main(["columns", str(tmp_path / "none.txt")]) == 2


def test_numbered_columns_behind_the_last_joint_are_not_read_which_is_said(tmp_path, written):
    """As of a gripper: seven are there, for an arm of six."""
    raw, table = tracked(tmp_path, "points")
    own = table.rename(columns={name: f"J{k}" for k, name in enumerate(Q, start=1)})
    own["J7"] = np.linspace(0.0, 40.0, len(own))
    content, text, folder = written(own, "--robot", "ur10")
    assert content["columns"]["poses"]["joints"]["names"] == [f"J{k}" for k in range(1, 7)]
    assert "joints: the arm has 6, so J7 is not read" in text
    np.testing.assert_allclose(read_campaign(folder).observations.states.q_rad, raw.q, atol=1e-8)


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize(("largest", "said"), [(99.9, True), (160.0, False), (1.5, False)])
def test_percents_of_a_range_are_no_angles(tmp_path, written, largest, said):
    """LeRobot writes positions so, unless it is told to use degrees."""
    _, table = tracked(tmp_path, "points")
    own = table.rename(columns=dict(zip(Q, (f"{name}.pos" for name in UR), strict=True)))
    joints = own[[f"{name}.pos" for name in UR]]
    own[joints.columns] = joints * (largest / joints.abs().max())
    assert ("percents of each joint's range" in written(own, "--robot", "ur10")[1]) == said


@pytest.mark.slow_but_one_in(6)
@pytest.mark.parametrize("names", [UR, [f"j{k}" for k in range(1, 7)]])
@pytest.mark.parametrize("sides", [("left", "right"), ("right", "left"), ("actual", "target")])
def test_of_two_arms_beside_words_the_nominal_arm_tells_its_own(tmp_path, written, names, sides):
    """But of what was commanded and what was measured the latter is taken, both near."""
    raw, table = tracked(tmp_path, "points")
    joints, places = table[Q].to_numpy(), table.drop(columns=Q)
    rng = np.random.default_rng(0)
    other = joints + 1e-3 if "actual" in sides else rng.permutation(joints)
    both = {"left": joints, "actual": joints, "right": other, "target": other}
    own = pd.DataFrame({f"{s}_{n}": both[s][:, k] for s in sides for k, n in enumerate(names)})
    content, _, folder = written(own.join(places), "--robot", "ur10")
    found = content["columns"]["poses"]["joints"]["names"]
    assert found == [f"{'actual' if 'actual' in sides else 'left'}_{name}" for name in names]
    np.testing.assert_allclose(read_campaign(folder).observations.states.q_rad, raw.q, atol=1e-8)


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize("other_first", [False, True])
def test_of_two_arms_under_the_same_names_the_nominal_arm_tells_its_own(
    tmp_path, written, other_first
):
    """And nine numbers side by side that are a rotation are one, under any names."""
    raw, table = tracked(tmp_path)
    R = Rotation.from_quat(table[QUATERNION], scalar_first=True).as_matrix().reshape(-1, 9)
    joints, places = table[Q].to_numpy(), 1e-3 * table[PLACE].to_numpy()
    rng = np.random.default_rng(0)
    places_of_other = rng.permutation(places)
    of_arm = np.column_stack([places, R, joints])
    of_other = np.column_stack([places_of_other, R[::-1], rng.permutation(joints)])
    both = np.column_stack([of_other, of_arm] if other_first else [of_arm, of_other])
    names = [f"pos {axis}" for axis in "xyz"] + [f"o{k}" for k in range(9)]
    own = pd.DataFrame(both, columns=2 * (names + [f"J{k}" for k in range(1, 7)]))
    content, text, folder = written(own, "--robot", "ur10")
    columns = content["columns"]["poses"]
    assert columns["joints"]["names"][0] == ("J1 (2)" if other_first else "J1")
    assert columns["rotation"]["names"][8] == ("o8 (2)" if other_first else "o8")
    assert "is there 2 times, of several arms perhaps" in text
    found = read_campaign(folder).observations
    np.testing.assert_allclose(found.states.q_rad, raw.q, atol=1e-8)
    np.testing.assert_allclose(found.measured.T_instr_target, raw.T_instr_target, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("series", ["A/measurements_grid", "C/measurements_random_poses"])
def test_the_mapping_of_the_measured_ur10_is_found(ipa_data, capsys, series):
    assert main(["columns", str(ipa_data / f"Series_{series}.csv"), "--robot", "ur10"]) == 0
    columns = yaml.safe_load(capsys.readouterr().out)["columns"]["poses"]
    assert columns["joints"]["names"][0] == "shoulder_pan_joint"
    assert columns["joints"]["unit"] == "rad"
    assert columns["position"]["names"] == [f"measurement_{axis}" for axis in "xyz"]
    assert columns["rotation"]["convention"] == "euler_XYZ"
    assert ("time" in columns) == series.startswith("A")
    assert ("u" in columns["position"]) == series.startswith("C")


def test_joints_are_mapped_by_their_names_whatever_their_order(tmp_path, written):
    raw, table = tracked(tmp_path, "points")
    called = dict(zip(Q, (f"{name}_joint" for name in UR), strict=True))
    own = table.rename(columns=called)
    own = own[[*sorted(called.values()), *(set(own) - set(called.values()))]]
    content, _, folder = written(own, "--robot", "ur10")
    assert content["columns"]["poses"]["joints"]["names"] == list(called.values())
    np.testing.assert_allclose(read_campaign(folder).observations.states.q_rad, raw.q, atol=1e-8)


def test_names_in_columns_of_text_give_the_order_and_are_no_angles(tmp_path, written):
    """A table of /joint_states: names, positions, efforts, in the order of the alphabet."""
    raw, table = tracked(tmp_path, "points")
    own = table.drop(columns=Q)
    order = np.argsort(UR)
    for k, joint in enumerate(order):
        own[f"name{k}"] = f"{UR[joint]}_joint"
        own[f"position{k}"] = np.radians(table[Q[joint]])
        own[f"velocity{k}"] = 0.0
        own[f"effort{k}"] = float(joint)
    content, text, folder = written(own, "--robot", "ur10")
    columns = content["columns"]["poses"]
    inverse = np.argsort(order)
    assert columns["joints"]["names"] == [f"position{k}" for k in inverse]
    assert columns["torques"]["names"] == [f"effort{k}" for k in inverse]
    assert "# check torques.unit: Nm, assumed" in text
    assert re.search(r"name0 +not read", text)
    every = read_campaign(folder).observations
    np.testing.assert_allclose(every.states.q_rad, raw.q, atol=1e-8)
    np.testing.assert_allclose(every.states.tau_Nm[0], np.arange(6.0))


def test_joints_have_the_names_of_the_urdf_that_the_arm_came_from(tmp_path, written):
    _, table = tracked(tmp_path, "points")
    arms, names = tmp_path / "arms", list("fedcba")
    arms.mkdir()
    arm = load_arm("ur10")
    urdf = urdf_text(Chain.of(arm), Chain.of(arm).nominal, "ours")
    for k, name in enumerate(names, start=1):
        urdf = urdf.replace(f'"joint_{k}"', f'"{name}_joint"')
    (arms / "ours.urdf").write_text(urdf, encoding="utf-8")
    source = {"file": "ours.urdf", "base": "base", "tip": "flange"}
    text = arm_text(arm, urdf=source).replace("ur10", "ours")
    (arms / "ours.yaml").write_text(text, encoding="utf-8")
    own = table.rename(columns=dict(zip(Q, (f"{name}.pos" for name in names), strict=True)))
    own = own[sorted(own)]
    content, _, _ = written(own, "--robot", "ours")
    columns = content["columns"]["poses"]["joints"]["names"]
    assert columns == [f"{name}.pos" for name in names]
    (arms / "ours.urdf").write_text("<robot", encoding="utf-8")  # names are then not known
    assert joint_names("ours", tmp_path / "mine") == ()


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize(
    ("names", "unit", "coverage"),
    [
        (["U(95) X", "U(95) Y", "U(95) Z"], None, 2.0),
        (["X U95 [mm]", "Y U95 [mm]", "Z U95 [mm]"], None, 2.0),
        (["Ux (k=2)", "Uy (k=2)", "Uz (k=2)"], None, 2.0),
        (["3 sigma X", "3 sigma Y", "3 sigma Z"], None, 3.0),
        (["U(95)"], None, 2.0),
        (["U(95) [µm]"], "um", 2.0),
        (["Uncertainty"], None, 1.0),
        (["uX", "uY", "uZ"], None, 1.0),
    ],
)
def test_expanded_uncertainties_are_divided_by_their_factor(
    tmp_path, written, names, unit, coverage
):
    _, table = tracked(tmp_path)
    own = table.drop(columns=QUATERNION).rename(columns=dict(zip(PLACE, "XYZ", strict=True)))
    size = 0.04 * (1e3 if unit == "um" else 1.0)
    own = own.assign(**dict.fromkeys(names, size))
    content, text, folder = written(own, "--robot", "ur10")
    position = content["columns"]["poses"]["targets"]["T1"]
    assert position["u"] == (names if len(names) == 3 else 3 * names)
    assert position.get("coverage", 1.0) == coverage
    assert position.get("u_unit") == unit
    assert (" are divided by " in text) == (coverage != 1.0)
    assert content["instrument"]["uncertainty_mm"] == pytest.approx(0.04 / coverage, abs=6e-4)
    variance = read_campaign(folder).observations.measured.stated_covariance
    np.testing.assert_allclose(np.sqrt(variance[:, 0, 0]), 4e-5 / coverage)


def test_a_target_called_a_b_c_is_no_euler_angle(tmp_path, written):
    _, table = tracked(tmp_path, "points")
    names = {
        f"T{k}_{axis}_mm": f"Target {letter} {axis.upper()}"
        for k, letter in enumerate("ABC", start=1)
        for axis in "xyz"
    }
    own = table.rename(columns=names).assign(robot="ours")
    own.insert(0, "Point name", [f"Pose {k}" for k in range(len(own))])
    content, _, folder = written(own, "--robot", "ur10")
    columns = content["columns"]["poses"]
    assert list(columns["targets"]) == ["TargetA", "TargetB", "TargetC"]
    assert "Pose 3" in read_campaign(folder).observations.pose


def test_a_name_that_all_rows_have_is_no_label(tmp_path, written):
    _, table = tracked(tmp_path, "points")
    content, text, _ = written(table.assign(Name="cell 1"), "--robot", "ur10")
    assert "pose" not in content["columns"]["poses"]
    assert re.search(r"Name +not read", text)


def test_beside_repeats_of_a_standing_arm_the_uncertainty_is_that_of_a_position(tmp_path, written):
    _, table = tracked(tmp_path, "points", targets=1)
    table = table[[*Q, "T1_x_mm", "T1_y_mm", "T1_z_mm"]]
    said = "# check instrument.uncertainty_mm: that of a position, by the instrument's data sheet"
    assert said not in written(table, "--robot", "ur10")[1]
    assert said in written(table.loc[table.index.repeat(3)], "--robot", "ur10")[1]


def test_rows_without_a_detection_do_not_count_against_the_convention(tmp_path, written):
    """As software writes them: no place, and no rotation."""
    _, table = tracked(tmp_path)
    own = table.rename(columns={name: f"J{k}" for k, name in enumerate(Q, start=1)})
    own.loc[::8, [*PLACE, *QUATERNION]] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    text = written(own, "--robot", "ur10")[1]
    assert "none agrees with the nominal arm" not in text
