"""Which chain of a URDF is the arm, where nobody names its ends."""

import time

import pytest

from pa10cal.arm.urdf_ends import ends_of_arm
from pa10cal.errors import ArmError


def robot(*joints):
    """A URDF of joints `parent>child`, fixed, or `parent~child`, that turn; `=` slides."""
    kinds = {">": "fixed", "~": "revolute", "=": "prismatic"}
    links, elements = {}, []
    for number, text in enumerate(joints):
        mark = next(mark for mark in kinds if mark in text)
        parent, child = text.split(mark)
        links |= {parent: None, child: None}
        elements.append(
            f'<joint name="j{number}_{child}" type="{kinds[mark]}"><parent link="{parent}"/>'
            f'<child link="{child}"/><axis xyz="0 0 1"/>'
            '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        )
    named = "".join(f'<link name="{link}"/>' for link in links)
    return f'<robot name="r">{named}{"".join(elements)}</robot>'


def named(names, *joints):
    """A URDF whose joints bear these names."""
    text = robot(*joints)
    for number, name in enumerate(names):
        _, _, child = joints[number].replace(">", "~").replace("=", "~").partition("~")
        text = text.replace(f'name="j{number}_{child}"', f'name="{name}"')
    return text


def chain(first, *links):
    """Joints that turn, from one link to the next."""
    return [f"{a}~{b}" for a, b in zip((first, *links), links, strict=False)]


UR = [
    "world>base_link",
    "base_link>base",
    "base_link>base_link_inertia",
    *chain("base_link_inertia", "shoulder", "upper_arm", "forearm", "w1", "w2", "wrist_3_link"),
    *("wrist_3_link>ft_frame", "wrist_3_link>flange", "flange>tool0"),
]
FRANKA = [
    *chain("base", *(f"panda_link{k}" for k in range(1, 8))),
    *("panda_link7>panda_link8", "panda_link8>panda_hand"),
    *("panda_hand=panda_leftfinger", "panda_hand=panda_rightfinger"),
]
ROVER = [
    "chassis~wheel_left",
    "chassis~wheel_right",
    "chassis>arm_base_link",
    *chain("arm_base_link", *(f"a{k}" for k in range(1, 7))),
    *("a6>camera_link", "a6>gripper_base", "gripper_base~gripper_jaw"),
]
SLIDES = ["stand=carriage", "carriage~a1", "a1~a2", "a2=quill", "quill>ee_link"]


@pytest.mark.parametrize(
    ("joints", "ends"),
    [
        (UR, ("base", "tool0")),
        (UR[:1] + UR[2:-1], ("base_link", "flange")),
        (FRANKA, ("base", "panda_link8")),
        (ROVER, ("arm_base_link", "a6")),
        (SLIDES, ("stand", "ee_link")),
        (["torso~head", *chain("torso", "a1", "a2", "a3", "a4")], ("torso", "a4")),
        (chain("a", "b", "c"), ("a", "c")),
        ([*chain("base", *"123456"), "3~camera"], ("base", "6")),
        ([*chain("base", *"123456"), *(f"6~{k}" for k in "789")], ("base", "6")),
        ([*chain("base", *"123456"), *chain("6", "thumb_hand", "t"), "6~f_hand"], ("base", "6")),
        ([*chain("base", *"123456"), "6~linkGripper"], ("base", "6")),
        ([*chain("base", *"123456"), "6=l", "6=r"], ("base", "6")),
        (
            [*chain("base", *"123456"), *chain("6", "thumb1", "t2", "t3", "t4"), "6~index1"],
            ("base", "6"),
        ),
        ([*chain("base", *"123456"), "6~ring", "6~middle", "6~thumb"], ("base", "6")),
        ([*chain("base", *"123456"), "6=suction_cup"], ("base", "6")),
        # a base that drives, and its arm: more joints than a finger
        (
            [
                *chain("odom", "x", "y", "t"),
                *chain("t", *"123456"),
                *chain("t", "h", "i"),
                *chain("t", "wheel", "roller"),
            ],
            ("odom", "6"),
        ),
        (chain("base", *(f"handling_link{k}" for k in range(1, 7))), ("base", "handling_link6")),
        ([*chain("base", *"1234567"), "4~hand_camera"], ("base", "7")),
        (["foot>Base_Link", "Base_Link>turret", *chain("turret", *"12")], ("Base_Link", "2")),
        ([*chain("base", "link_06", "link_07"), "link_07>link_08"], ("base", "link_08")),
        (
            [*chain("world", "l1", "l2", "l3"), "l3>link_eef", "link_eef>camera"],
            ("world", "link_eef"),
        ),
        (
            [*chain("link_base", "l1", "l2"), "l2>EndEffector_Link"],
            ("link_base", "EndEffector_Link"),
        ),
    ],
)
def test_the_arm_is_the_long_chain_and_its_ends_are_base_and_flange(joints, ends):
    assert ends_of_arm(robot(*joints), "r.urdf") == ends


@pytest.mark.parametrize(
    "joints",
    [
        [
            *chain("body", *(f"l{k}" for k in range(7))),
            *chain("body", *(f"r{k}" for k in range(7))),
        ],
        [*chain("waist", *"123"), *chain("3", *"abcdefg"), *chain("3", *"hijklmn"), "3~head"],
        [*chain("waist", *"123"), *chain("3", *"abcdefg"), *chain("3", *"hijklmn")],
        [*chain("waist", *"1234"), *chain("4", *"abc"), *chain("4", *"def")],
        [*chain("waist", *"12345678"), *chain("8", *"abcdefg"), *chain("8", *"hijklmn")],
        [*chain("base", *"123456"), "4~camera"],
        [*chain("base", *"123456"), "5~camera"],
        [*chain("base", *"123456"), "5~hand_camera"],
        [*chain("base", *"123456"), *chain("5", "hand_camera", "lens")],
        [*chain("palm", "f1", "f2"), *chain("palm", "g1", "g2")],
        ["a>b"],
        ["a~b"],
        [
            *chain("base", *"123456"),
            *chain("6", "a1", "a2", "a3", "a4"),
            *chain("6", "b1", "b2"),
            *chain("6", "c1", "c2"),
        ],
        [
            *chain("body", *(f"l{k}" for k in range(6))),
            *chain("body", *(f"r{k}" for k in range(6)), "finger", "finger_tip"),
        ],
    ],
    ids=[
        "two arms",
        "torso, arms and head",
        "torso and arms",
        "long torso and short arms",
        "longer torso and arms",
        "camera on a link",
        "camera beside the last joint",
        "camera called after a hand",
        "longer camera called after a hand",
        "a hand",
        "nothing moves",
        "one joint",
        "fingers that nobody calls so",
        "two arms of which one has a gripper",
    ],
)
def test_where_no_chain_is_the_arm_its_ends_have_to_be_named(joints):
    with pytest.raises(ArmError, match=r"r\.urdf: which joints are the arm.*--base LINK --tip"):
        ends_of_arm(robot(*joints), "r.urdf")


@pytest.mark.parametrize(
    ("names", "joints", "tip"),
    [
        # SO-ARM101: its last joint turns the link of its gripper
        (
            ("pan", "lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"),
            chain("base", "shoulder", "upper", "lower", "wrist", "gripper_link", "moving_jaw"),
            "gripper_link",
        ),
        ([f"joint{k}" for k in range(6)], chain("base", *"12345", "link_hand"), "link_hand"),
        ([f"joint{k}" for k in range(6)], [*chain("base", *"12345"), "5=hand"], "5"),
        ([f"joint{k}" for k in range(6)], chain("base", *"12345", "finger_1"), "5"),
        ([f"l_hand_{k}" for k in range(7)], chain("base", *"1234567"), "7"),
        (
            ["a", "b", "c", "d", "hand_joint", "l", "r"],
            [*chain("base", *"1234", "palm"), "palm=f1", "palm=f2"],
            "4",
        ),
    ],
    ids=[
        "gripper link",
        "hand link",
        "slides",
        "finger",
        "an arm called hand",
        "hand that branches",
    ],
)
def test_the_last_joint_of_an_arm_may_carry_a_link_called_after_the_hand(names, joints, tip):
    assert ends_of_arm(named(names, *joints), "r.urdf") == ("base", tip)


def test_the_controllers_base_may_have_a_prefix():
    left = [joint.replace("base", "left_base") for joint in UR]
    assert ends_of_arm(robot(*left), "r.urdf") == ("left_base", "tool0")
    other = [*UR[:1], "base_link>camera_base", *UR[2:]]
    assert ends_of_arm(robot(*other), "r.urdf") == ("base_link", "tool0")


@pytest.mark.parametrize(
    ("beyond", "tip"),
    [
        (["6>camera_mount", "camera_mount>camera_flange"], "6"),
        (["6>gripper_base", "gripper_base>tool0", "6>flange"], "flange"),
        (["6>other_tool0", "6>tool0"], "tool0"),
        (["6>robot_flange"], "robot_flange"),
    ],
)
def test_the_tip_is_the_arms_own(beyond, tip):
    joints = [*chain("base", *"123456"), *beyond]
    assert ends_of_arm(robot(*joints), "r.urdf") == ("base", tip)


def test_chains_end_at_a_floating_joint():
    free = [*chain("base", *"123"), "base~x", *chain("y", *"abcdef"), "x>y"]
    text = robot(*free).replace("fixed", "floating")
    assert ends_of_arm(text, "r.urdf") == ("base", "3")


def test_a_chain_of_thousands_of_joints_is_read_at_once():
    begun_s = time.perf_counter()
    ends_of_arm(robot(*chain("base", *map(str, range(4900)))), "r.urdf")
    assert time.perf_counter() - begun_s < 20.0


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (robot("a~b"), "only one joint moves (got 'number of joints: 1 from j0_b')"),
        (robot("a>b"), "nothing moves (got 'no joint that moves')"),
        (
            robot("world>base", *chain("base", "1", "2", "3")).replace("fixed", "floating"),
            "the arm is beyond a floating joint (got 'joint j0_base')",
        ),
        (
            robot("a~b", "b>base", *chain("base", "1", "2")).replace("fixed", "planar"),
            "the arm is beyond a planar joint (got 'joint j1_base')",
        ),
    ],
)
def test_why_no_chain_is_the_arm_is_told_as_it_is(text, why):
    with pytest.raises(ArmError) as told:
        ends_of_arm(text, "r.urdf")
    assert f"is not clear: {why}" in str(told.value)
