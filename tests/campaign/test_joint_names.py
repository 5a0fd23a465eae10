"""Columns of joints by what the joints are called."""

from __future__ import annotations

import pytest

from pa10cal.campaign.file_roles import columns_by_name, named_by_text

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
    assert columns_by_name([*sorted(names), *others], 6) == tuple(names)
    assert columns_by_name([*names[::-1], *others], None) == tuple(names)


def test_the_arms_own_names_come_before_words():
    own = ["elbow_joint", "shoulder_joint", "axis_of_the_hand"]
    assert columns_by_name(["shoulder", "elbow", "axis_of_the_hand"], 3, own) == (
        "elbow",
        "shoulder",
        "axis_of_the_hand",
    )
    assert columns_by_name(["left_shoulder", "left_elbow", "left_axis_of_the_hand"], 3, own)


def test_measured_columns_come_before_commanded_ones():
    measured = [f"observation.state.{name}.pos" for name in UR]
    commanded = [f"action.{name}.pos" for name in UR]
    assert columns_by_name([*commanded, *measured], 6) == tuple(measured)
    assert columns_by_name(commanded, 6) == tuple(commanded)


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
    assert columns_by_name(names, joints, own) == ()


def test_columns_of_text_name_the_numbered_ones_beside_them():
    names = [f"{stem}{k}" for stem in ("name", "position", "velocity", "other") for k in range(3)]
    names = [*names, "other3", "x", "1", "2"]
    same = {"name0": "elbow", "name1": "waist", "name2": "shoulder"}
    called = named_by_text(names, same)
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
    assert named_by_text(names, same) == {}
