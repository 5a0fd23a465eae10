"""Columns of joints by what the joints are called."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from pa10cal.campaign.column_names import WORDS
from pa10cal.campaign.file_roles import roles_of_file
from pa10cal.campaign.joint_names import aliases_by_text, named_joints
from pa10cal.campaign.recognise import roles_of
from pa10cal.campaign.sniffing import sniff

J = [f"J{j}" for j in range(1, 7)]
UR = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]


@pytest.mark.parametrize(
    "names",
    [
        [f"{name}_joint" for name in UR],
        [f"{name}.pos" for name in UR],
        ["Base [deg]", "Shoulder [deg]", "Elbow [deg]", "Wrist 1 [deg]", "Wrist 2", "Wrist 3"],
        ["waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate"],
        ["Swivel", "ShoulderLift", "ElbowFlex", "ForearmRoll", "WristFlex", "WristRoll"],
        ["base", "épaule", "coude", "poignet 1", "poignet 2", "poignet 3"],
        ["S", "L", "U", "R", "B", "T"],
    ],
)
def test_words_of_a_limb_give_the_order_whatever_that_of_the_file(names):
    others = ["time", "x", "y", "z", "gripper.pos"]
    assert named_joints([*sorted(names), *others], 6) == tuple(names)
    assert named_joints([*names[::-1], *others], None) == tuple(names)


def test_the_arms_own_names_come_before_words():
    own = ["elbow_joint", "shoulder_joint", "axis_of_the_hand"]
    assert named_joints(["shoulder", "elbow", "axis_of_the_hand"], 3, own) == (
        "elbow",
        "shoulder",
        "axis_of_the_hand",
    )
    assert named_joints(["left_shoulder", "left_elbow", "left_axis_of_the_hand"], 3, own)


def test_measured_columns_come_before_commanded_ones():
    measured = [f"observation.state.{name}.pos" for name in UR]
    commanded = [f"action.{name}.pos" for name in UR]
    assert named_joints([*commanded, *measured], 6) == tuple(measured)
    assert named_joints(commanded, 6) == tuple(commanded)


@pytest.mark.parametrize(
    ("names", "joints", "own"),
    [
        (["elbow", "shoulder"], 6, ()),  # too few
        ([*UR, "elbow_2"], 6, ()),  # too many
        (["wrist", "wrist_joint", "wrist q", "wrist pos", "wrist deg", "wrist act"], 6, ()),
        (["J1", "J2", "J3"], 3, ()),  # numbers alone
        (["", " ", "?"], 3, ()),
        (["a", "b", "c"], 3, ["joint", "joint_pos", "state"]),  # words of any joint
        (["a", "b", "c"], 3, ["a", "b", "b"]),
        ([], None, ()),
    ],
)
def test_names_that_tell_no_order_give_none(names, joints, own):
    assert named_joints(names, joints, own) == ()


def test_columns_of_text_name_the_numbered_ones_beside_them():
    names = [f"{stem}{k}" for stem in ("name", "position", "velocity", "other") for k in range(3)]
    names = [*names, "other3", "x", "1", "2"]
    same = {"name0": "elbow", "name1": "waist", "name2": "shoulder"}
    called = aliases_by_text(names, same)
    assert called["position1"] == "waist position"
    assert called["velocity2"] == "shoulder velocity"
    assert set(called) == {f"{stem}{k}" for stem in ("position", "velocity") for k in range(3)}


@pytest.mark.parametrize(
    "same",
    [
        {},
        {"name0": "elbow"},  # a single one
        {"name0": "elbow", "name1": "elbow", "name2": "Elbow"},  # not apart
    ],
)
def test_text_that_is_no_list_of_names_names_nothing(same):
    names = [f"{stem}{k}" for stem in ("name", "position") for k in range(3)]
    assert aliases_by_text(names, same) == {}


@pytest.fixture
def roles(tmp_path):
    """Return the roles of columns of whole random numbers; those that are named are at rest."""

    def run(names, joints=None, still=(), own=()):
        table = pd.DataFrame(np.random.default_rng(3).uniform(-99, 99, (20, len(names))))
        table.columns = list(names)
        table[list(still)] = 1.5
        table.to_csv(tmp_path / "export.csv", index=False)
        return roles_of_file(sniff(tmp_path / "export.csv"), joints, own)

    return run


@pytest.mark.parametrize("word", WORDS["words"]["torque"].split())
@pytest.mark.parametrize("joints", [6, None])
def test_a_number_may_be_run_on_to_a_word_of_torques(word, joints):
    torques, q = ([f"{stem}{k}" for k in range(1, 7)] for stem in (word, "q"))
    found = roles_of([*torques, *q, "x", "y", "z"], joints)
    assert (found.joints, found.torques) == (tuple(q), tuple(torques))


@pytest.mark.parametrize("word", ["tau", "torque", "vel", "current", "err"])
def test_what_is_no_position_of_joints_is_not_taken_for_one(word):
    others, p = ([f"{stem}{k}" for k in range(1, 7)] for stem in (word, "pos"))
    assert roles_of([*others, *p, "x", "y", "z"], 6).joints == tuple(p)


@pytest.mark.parametrize(
    "others",
    [
        ["Upper Tol", "Lower Tol"],
        ["flange offset", "base height"],
        ["rail", "shoulder strain"],
        ["base temp", "elbow temp", "wrist temp"],
        ["base", "elbow", "wrist"],
    ],
)
def test_some_words_of_a_limb_are_no_joints_beside_numbered_ones(roles, others):
    assert roles([*J, "X", "Y", "Z", *others]).joints == tuple(J)


@pytest.mark.parametrize(
    "other", [["hand"], ["base_height"], ["base_x", "base_y", "base_z"], ["hand_time"], ["rail"]]
)
def test_one_more_column_of_a_limb_hides_no_joints(other):
    names = ["base", "shoulder", "elbow", "wrist1", "wrist2", "wrist3"]
    assert named_joints([*other, *names, "x"], 6) == tuple(names)


@pytest.mark.parametrize("sign", [" ", "_"])
def test_the_orientation_is_of_the_body_that_moves(roles, sign):
    axes = ("x", "y", "z", "rx", "ry", "rz")
    base, tool = ([f"{body}{sign}{axis}" for axis in axes] for body in ("base", "tool"))
    found = roles([*J, *base, *tool], 6, still=base)
    assert found.attitude[0] == tuple(tool[3:])


def test_joints_are_no_quaternion_beside_a_base_at_rest(roles):
    q = [f"q{k}" for k in range(1, 5)]
    base = [f"base_{axis}" for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    found = roles([*q, *base, "x", "y", "z"], 4, still=base)
    assert (found.joints, found.attitude) == (tuple(q), None)


def test_a_letter_that_tells_columns_apart_is_no_unit(roles):
    tcp = [f"tcp_{letter}" for letter in "XYZABC"]
    found = roles([*J, *tcp], 6)
    assert found.attitude == (tuple(tcp[3:]), "euler_ZYX")
    axes = [f"axis_{letter}" for letter in "SLURBT"]
    assert roles([*axes, *"xyz"], 6).joints == tuple(axes)
    found = roles(["t", *"SLURBT", *"xyz"], 6)
    assert (found.joints, found.single["time"]) == (tuple("SLURBT"), "t")
    assert roles([*J, "x_m", "y_m", "z_m", "temp_C"], 6).positions[""] == ("x_m", "y_m", "z_m")


@pytest.mark.parametrize(
    ("place", "turned", "convention"),
    [
        (["x1", "y1", "z1"], ["rx1", "ry1", "rz1"], "rpy"),
        (["x1", "y1", "z1"], ["phix1", "phiy1", "phiz1"], "rpy"),
        (["x1", "y1", "z1"], ["qx1", "qy1", "qz1", "qw1"], "quaternion_xyzw"),
        (["pos1_x", "pos1_y", "pos1_z"], ["rot1_x", "rot1_y", "rot1_z"], "rpy"),
    ],
)
def test_an_orientation_may_have_the_number_of_its_target(place, turned, convention):
    found = roles_of([*place, *turned, *J], 6)
    assert [*found.positions.values()] == [tuple(place)]
    assert found.attitude == (tuple(turned), convention)
    assert found.joints == tuple(J)


def test_orientations_of_several_numbered_targets_are_none_of_the_tool():
    places = [f"{axis}{k}" for k in (1, 2) for axis in "xyz"]
    turned = [f"r{axis}{k}" for k in (1, 2) for axis in "xyz"]
    found = roles_of([*places, *turned, *J], 6)
    assert len(found.positions) == 2
    assert found.attitude is None


def test_numbered_reflectors_are_places():
    names = [f"R{k}_{axis}" for k in (1, 2) for axis in "xyz"]
    assert len(roles_of([*names, *J], 6).positions) == 2


@pytest.mark.parametrize("stem", ["joint", "joint_", "e"])
def test_numbers_of_columns_without_names_are_no_names_of_joints(stem):
    own = [f"{stem}{k}" for k in range(1, 7)]
    assert named_joints([str(k) for k in range(1, 10)], 6, own) == ()
