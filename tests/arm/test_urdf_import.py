"""Arms from URDF files: the same forward kinematics, limits and masses, or one clear refusal."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drawn_examples import examples
from pa10cal.arm.chain import Chain, frames
from pa10cal.arm.description import neighbouring_axes
from pa10cal.arm.dh_rows import rows_through
from pa10cal.arm.statics import Payload, statics
from pa10cal.arm.urdf_import import arm_from_urdf_text
from pa10cal.arm.urdf_reading import read_tree
from pa10cal.arm.urdf_writing import urdf_text
from pa10cal.arrays import homogeneous
from pa10cal.errors import ArmError
from pa10cal.files.arms import arm_names, load_arm

QUARTERS = st.sampled_from([0.0, np.pi / 2, -np.pi / 2, np.pi, 1.5708, 1.57, 1e-7, 0.4])
PLACES = st.sampled_from([0.0, 0.0, 0.1, -0.35, 1e-9])
AXES = st.sampled_from(
    [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -1, 0), (0, 3, 0), (0.6, 0, 0.8), (1, 1e-5, 0)]
)
KINDS = st.sampled_from(["revolute", "revolute", "continuous", "prismatic", "fixed"])
JOINTS = st.tuples(
    KINDS, st.tuples(PLACES, PLACES, PLACES), st.tuples(QUARTERS, QUARTERS, QUARTERS), AXES
)


def robot(joints, masses=None):
    """Return a URDF of a serial path of joints (kind, xyz, rpy, axis) from l0 on."""
    parts = []
    for k in range(len(joints) + 1):
        inertial = ""
        if masses is not None:
            mass_kg, com_m = masses[k]
            inertial = (
                f'<inertial><origin xyz="{words(com_m)}"/><mass value="{mass_kg}"/></inertial>'
            )
        parts.append(f'<link name="l{k}">{inertial}</link>')
    for k, (kind, xyz, rpy, axis) in enumerate(joints):
        parts.append(
            f'<joint name="j{k}" type="{kind}"><origin xyz="{words(xyz)}" rpy="{words(rpy)}"/>'
            f'<parent link="l{k}"/><child link="l{k + 1}"/><axis xyz="{words(axis)}"/>'
            '<limit lower="-1.5" upper="2" effort="7" velocity="1"/></joint>'
        )
    return f'<robot name="made_up">{"".join(parts)}</robot>'


def words(values):
    return " ".join(repr(float(value)) for value in values)


def imported(text, **options):
    return arm_from_urdf_text(text, "made_up", where="robot.urdf", **options)


def fixed(xyz, rpy):
    return homogeneous(Rotation.from_euler("xyz", rpy).as_matrix(), np.asarray(xyz))


def frames_of_links(joints, q):
    """Return the pose of every link at positions of the moving joints, straight from the file."""
    T, positions, found = np.eye(4), iter(q), [np.eye(4)]
    for kind, xyz, rpy, axis in joints:
        T = T @ fixed(xyz, rpy)
        if kind != "fixed":
            step, axis = next(positions), np.array(axis) / np.linalg.norm(axis)
            moved = np.eye(4)
            if kind == "prismatic":
                moved[:3, 3] = step * axis
            else:
                moved[:3, :3] = Rotation.from_rotvec(step * axis).as_matrix()
            T = T @ moved
        found.append(T)
    return np.array(found)


@examples(80)
@given(joints=st.lists(JOINTS, min_size=1, max_size=9), seed=st.integers(0, 1000))
def test_forward_kinematics_is_that_of_the_file(joints, seed):
    if all(kind == "fixed" for kind, *_ in joints):
        joints = [*joints, ("revolute", (0.0, 0.0, 0.1), (0.0, 0.0, 0.0), (0, 1, 0))]
    found = imported(robot(joints), tip=f"l{len(joints)}")
    arm = found.arm
    q = np.random.default_rng(seed).uniform(-1.5, 2, (5, arm.n))
    wanted = np.array([frames_of_links(joints, positions)[-1] for positions in q])
    np.testing.assert_allclose(Chain.of(arm).forward(q), wanted, atol=1e-9)
    assert found.forward_kinematics_difference_m < 1e-9
    assert found.forward_kinematics_difference_rad < 1e-9
    assert arm.prismatic.tolist() == [kind == "prismatic" for kind, *_ in joints if kind != "fixed"]
    near = {axes.row for axes in neighbouring_axes(arm) if axes.parallel}
    assert set(np.flatnonzero(arm.hayati) + 1) == near


def test_limits_that_stand_for_none_are_no_reason_to_refuse_an_arm():
    joints = [("revolute", (0.1, 0.2, 0.3), (0.4, 0.3, 1.1), (0, 1, 0))] * 3
    text = robot(joints).replace('lower="-1.5" upper="2"', 'lower="-1e16" upper="1e16"')
    assert imported(text).arm.limits_rad.tolist() == [[-1e16, 1e16]] * 3


def test_limits_of_a_joint_that_is_fixed_do_not_matter():
    at = ((0.0, 0.0, 0.3), (0.0, 0.0, 0.0), (0, 1, 0))
    text = robot([("revolute", *at), ("fixed", *at)])
    begin, end = text.split('name="j1"')
    text = begin + 'name="j1"' + end.replace('upper="2"', 'upper="-2"')
    assert imported(text).arm.n == 1


@examples(25)
@given(seed=st.integers(0, 10_000), convention=st.sampled_from(["standard", "modified"]))
def test_an_exported_arm_comes_back_the_same(random_arm, seed, convention):
    arm = random_arm(seed, 5, convention)
    chain = Chain.of(arm)
    back = imported(urdf_text(chain, chain.nominal, "made_up")).arm
    q = np.random.default_rng(seed).uniform(-3, 3, (5, 5))
    np.testing.assert_allclose(Chain.of(back).forward(q), chain.forward(q), atol=1e-12)
    np.testing.assert_array_equal(back.limits_rad, arm.limits_rad)


@pytest.mark.parametrize("name", arm_names())
def test_a_shipped_arm_comes_back_row_by_row(name):
    arm = load_arm(name)
    chain = Chain.of(arm)
    back = imported(urdf_text(chain, chain.nominal, name)).arm
    for rows in ("theta_rad", "d_m", "a_m", "alpha_rad", "beta_rad"):
        np.testing.assert_allclose(
            np.cos(getattr(back, rows)), np.cos(getattr(arm, rows)), atol=1e-12, err_msg=rows
        )
    np.testing.assert_array_equal(back.hayati, arm.hayati)
    np.testing.assert_array_equal(back.torque_limit_Nm, arm.torque_limit_Nm)
    q = np.random.default_rng(1).uniform(*arm.limits_rad.T, (5, arm.n))
    np.testing.assert_allclose(Chain.of(back).forward(q), chain.forward(q), atol=1e-12)


def test_masses_of_fixed_links_count_to_the_link_that_carries_them():
    rng = np.random.default_rng(3)
    kinds = ["fixed", "revolute", "fixed", "prismatic", "revolute", "fixed"]
    joints = [
        (kind, rng.uniform(-0.3, 0.3, 3), rng.uniform(-3, 3, 3), rng.normal(size=3))
        for kind in kinds
    ]
    masses = [(round(rng.uniform(1, 5), 3), rng.uniform(-0.2, 0.2, 3)) for _ in range(7)]
    arm = imported(robot(joints, masses)).arm
    carrier = np.cumsum([0, *(kind != "fixed" for kind in kinds)])
    mass_kg = np.array([mass for mass, _ in masses])
    np.testing.assert_allclose(arm.mass_kg, [mass_kg[carrier == k].sum() for k in (1, 2, 3)])
    # The weights act on the joints as those of the links in the file.
    g = np.array([1.0, -2.0, -9.0])
    payload = Payload(0.0, np.zeros(3), np.zeros(3), g)
    chain, q = Chain.of(arm), np.array([[0.3, 0.2, -0.7]])

    def energy_J(q):
        Ts = frames_of_links(joints, q)
        return -sum(
            m * g @ (T @ np.append(c, 1.0))[:3] for T, (m, c) in zip(Ts, masses, strict=True)
        )

    slopes = [(energy_J(q[0] + step) - energy_J(q[0] - step)) / 2e-5 for step in 1e-5 * np.eye(3)]
    found = statics(chain, chain.coordinates(q), np.zeros(1), payload).joint_Nm[0]
    np.testing.assert_allclose(found, slopes, atol=1e-6)


def test_a_base_and_a_tip_in_the_middle_are_kept():
    rng = np.random.default_rng(4)
    joints = [
        ("revolute", rng.uniform(-0.3, 0.3, 3), rng.uniform(-3, 3, 3), rng.normal(size=3))
        for _ in range(6)
    ]
    found = imported(robot(joints), base="l2", tip="l5")
    assert (found.base, found.tip, found.joints) == ("l2", "l5", ("j2", "j3", "j4"))
    assert "off the path, and held at zero: j0, j1, j5" in found.notes
    q = np.array([0.3, -0.4, 0.5])
    wanted = frames_of_links(joints[2:5], q)[-1]
    np.testing.assert_allclose(Chain.of(found.arm).forward(q[None])[0], wanted, atol=1e-12)


def test_a_base_beside_the_arm_is_kept():
    found = imported(BRANCHED, base="plate", tip="l2").arm
    q = np.array([[0.3, -0.4]])
    wanted = np.linalg.inv(fixed((0.2, 0, 0), (0, 0, np.pi))) @ Chain.of(
        imported(PLAIN).arm
    ).forward(q)
    np.testing.assert_allclose(Chain.of(found).forward(q), wanted, atol=1e-15)


def test_what_the_file_leaves_open_is_told():
    plain = (0, 0, 0.1), (0, 0, 0), (0, 0, 1)
    turn = robot([("continuous", *plain), ("revolute", *plain), ("prismatic", *plain)])
    text = turn.replace(
        '<limit lower="-1.5" upper="2" effort="7" velocity="1"/>', '<limit effort="0"/>', 2
    )
    found = imported(text)
    assert any("joint j0 turns without limit" in note for note in found.notes)
    assert any("joint j1 states no limits" in note for note in found.notes)
    assert any("no link has a mass" in note for note in found.notes)
    assert any("no rated torque (effort) of joints 1, 2" in note for note in found.notes)
    assert np.degrees(found.arm.limits_rad[:2]).tolist() == [[-360, 360], [-360, 360]]
    assert found.arm.limits_rad[2].tolist() == [-1.5, 2.0]
    assert np.isnan(found.arm.torque_limit_Nm).tolist() == [True, True, False]
    assert np.isnan(found.arm.gear_ratio).all()


def test_axes_that_are_parallel_but_for_rounding_make_no_long_links():
    # 1.5708 for a right angle: the axes of joints 2 and 3 are 7 microradians from parallel.
    turned = (1.5708, 0.0, 0.0), (-1.57079, 0.0, 0.0)
    joints = [
        ("revolute", (0, 0, 0.1), (0, 0, 0), (0, 0, 1)),
        ("revolute", (0, 0, 0), turned[0], (0, 0, 1)),
        ("fixed", (0.4, 0, 0), turned[1], (0, 0, 1)),
        ("revolute", (0, 0, 0), turned[0], (0, 0, 1)),
    ]
    arm = imported(robot(joints)).arm
    assert arm.hayati.tolist() == [False, True, False]
    assert max(np.abs(arm.a_m).max(), np.abs(arm.d_m).max()) < 0.5
    found = frames(Chain.of(arm), Chain.of(arm).nominal[None])
    assert np.linalg.norm(found.T_base_rows[:, 0, :3, 3], axis=1).max() < 0.6


PLAIN = robot([("revolute", (0, 0, 0.1), (0, 0, 0), (0, 0, 1))] * 2)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (PLAIN, "", r"it is not XML.*no element found"),
        ("<robot", "<robot <", r"it is not XML.*line 1"),
        (PLAIN, "<sdf/>", r"it is not a URDF.*sdf"),
        (PLAIN, "<robot/>", r"not form a single tree.*there are no links"),
        ('<link name="l0">', '<xacro:x xmlns:xacro="ros/xacro"/><link name="l0">', "run xacro"),
        ("0.1", "${h}", "run xacro"),
        ('type="revolute"', 'type="revolut"', r"joint j0: unknown type.*did you mean 'revolute'"),
        (
            'type="revolute"',
            'type="helical"',
            r"unknown type.*allowed: revolute, continuous, prismatic, fixed; correct the type",
        ),
        ('type="revolute"', 'type="floating"', r"joint j0: a joint of this type.*--base"),
        ('type="revolute"', 'type="planar"', r"joint j0: a joint of this type.*planar"),
        ("<axis", '<mimic joint="j7"/><axis', r"joint j0: the joint follows joint j7"),
        ("<axis", "<mimic/><axis", r"joint j0: the joint follows joint <not named>"),
        ("0.0 0.0 0.1", "0 0 1_0", "xyz cannot be read"),
        ('<parent link="l0"/>', "", r"joint j0: the joint has no parent"),
        ('<child link="l1"/>', '<child link="l9"/>', r"joint j0: .*not there.*l9.*l0, l1, l2"),
        ('<child link="l2"/>', '<child link="l1"/>', r"two joints have the same child link.*l1"),
        ('<parent link="l0"/>', '<parent link="l2"/>', r"form a loop.*l1, l2"),
        ('<link name="l0">', '<link name="l1">', r"two links have one name.*l1"),
        ('<joint name="j1"', '<joint name="j0"', r"two joints have one name.*j0"),
        ("0.0 0.0 0.1", "0,0 0,0 0,1", r"joint j0: origin: xyz cannot be read.*decimal points"),
        ("0.0 0.0 0.1", "0 0", r"joint j0: origin: xyz cannot be read.*3 numbers"),
        ("0.0 0.0 0.1", "0 0 nan", r"joint j0: origin: xyz cannot be read"),
        ('axis xyz="0.0 0.0 1.0"', 'axis xyz="0 0 0"', r"joint j0: the axis has no direction"),
        ('lower="-1.5" upper="2"', 'lower="2" upper="-1.5"', r"joint j0: the limits allow"),
        ("0.0 0.0 0.1", "0 0 101", r"joint j0: .*further than 100 m.*divide by 1000"),
        ('type="revolute"', 'type="fixed"', r"no joint moves between base and tip"),
        (
            '<link name="l2"></link>',
            '<link name="l2"/><link name="l3"/>',
            r"not form a single tree.*l0, l3",
        ),
    ],
)
def test_bad_files_are_refused_with_their_place(old, new, message):
    with pytest.raises(ArmError, match=f"robot.urdf.*{message}"):
        imported(PLAIN.replace(old, new, 2 if "fixed" in new else 1))


def test_numbers_of_joints_off_the_path_are_of_no_effect():
    off_path = (
        '<link name="fence"/><joint name="f" type="fixed"><parent link="l0"/><child link="fence"/>'
        '<origin xyz="12 0 0"/></joint><link name="lid"/><joint name="lid" type="revolute">'
        '<parent link="l0"/><child link="lid"/><axis xyz="0 0 0"/><limit lower="2" upper="1"/>'
        "</joint></robot>"
    )
    assert imported(PLAIN.replace("</robot>", off_path), tip="l2").joints == ("j0", "j1")


def test_xacro_in_a_comment_was_worked_out_already():
    text = PLAIN.replace("<link", "<!-- was: <xacro:arm length='${h}'/> of $(find arm) --><link", 1)
    assert imported(text).joints == ("j0", "j1")


def test_what_only_a_simulator_reads_may_hold_expressions():
    gazebo = "<gazebo><parameters>$(find arm)/control.yaml</parameters></gazebo></robot>"
    assert imported(PLAIN.replace("</robot>", gazebo)).arm.n == imported(PLAIN).arm.n


def test_an_effort_without_limit_is_not_stated():
    assert np.isnan(imported(PLAIN.replace('effort="7"', 'effort="inf"')).arm.torque_limit_Nm).all()


def test_a_joint_and_a_link_may_have_one_name():
    text = PLAIN.replace('"j0"', '"l1"').replace('"j1"', '"l2"')
    found = imported(text)
    assert (found.joints, found.tip) == (("l1", "l2"), "l2")
    q = np.array([[0.3, -0.4]])
    np.testing.assert_array_equal(
        Chain.of(found.arm).forward(q), Chain.of(imported(PLAIN).arm).forward(q)
    )


def test_a_sliding_joint_without_limits_is_refused():
    text = robot([("prismatic", (0, 0, 0), (0, 0, 0), (0, 0, 1))])
    with pytest.raises(ArmError, match=r"joint j0: a prismatic joint has no limits.*metres"):
        imported(text.replace('lower="-1.5" upper="2"', ""))


BRANCHED = PLAIN.replace(
    "</robot>",
    '<link name="camera"/><joint name="c" type="fixed"><parent link="l1"/><child link="camera"/>'
    '</joint><link name="plate"/><joint name="p" type="fixed"><parent link="l0"/>'
    f'<child link="plate"/><origin xyz="0.2 0 0" rpy="0 0 {np.pi}"/></joint></robot>',
)


def test_branches_need_a_named_tip():
    with pytest.raises(ArmError, match=r"branches.*allowed: l2, camera;.*--tip"):
        imported(BRANCHED)
    assert imported(BRANCHED, tip="camera").joints == ("j0",)
    assert imported(BRANCHED, tip="l2").joints == ("j0", "j1")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tip": "camra"}, r"--tip names no link.*camra.*did you mean 'camera'"),
        ({"base": "floor"}, r"--base names no link.*l0, l1, l2, camera, plate"),
        ({"tip": "xyz"}, r"--tip names no link.*name one of these links"),
        ({"base": "l1", "tip": "camera"}, r"no joint moves.*l1 to camera"),
        ({"tip": "plate"}, r"no joint moves.*l0 to plate"),
        ({"base": "l2"}, r"no joint moves.*l2 to l2"),
    ],
)
def test_ends_that_are_no_ends_are_refused(options, message):
    with pytest.raises(ArmError, match=message):
        imported(BRANCHED, **options)


HEAD = ("revolute", (0.0, 0.1, 0.2), (0.3, 0.0, 1.2), (0, 0.6, 0.8))


@examples(40)
@given(
    joints=st.lists(JOINTS, min_size=1, max_size=6),
    shoulder=st.integers(0, 5),
    masses=st.booleans(),
    seed=st.integers(0, 1000),
)
def test_seen_from_a_link_that_joints_carry(joints, shoulder, masses, seed):
    """A hand as a camera on the head sees it, or the base as a sensor on the flange does."""
    joints = [*joints, HEAD]
    shoulder %= len(joints)
    text = robot(joints, [(2.0, (0.1, 0.0, 0.0))] * (len(joints) + 1) if masses else None)
    hand = [("prismatic", *HEAD[1:]), HEAD]
    parts = "".join(
        f'<link name="h{k}"/><joint name="a{k}" type="{kind}"><origin xyz="{words(xyz)}" '
        f'rpy="{words(rpy)}"/><parent link="{f"h{k - 1}" if k else f"l{shoulder}"}"/>'
        f'<child link="h{k}"/><axis xyz="{words(axis)}"/>'
        '<limit lower="-1.5" upper="2" effort="7" velocity="1"/></joint>'
        for k, (kind, xyz, rpy, axis) in enumerate(hand)
    )
    text = text.replace("</robot>", f"{parts}</robot>")
    moving = [f"j{k}" for k, (kind, *_) in enumerate(joints) if kind != "fixed"]
    above = [name for name in reversed(moving) if int(name[1:]) >= shoulder]
    for tip, names in (("h1", [*above, "a0", "a1"]), ("l0", moving[::-1])):
        found = imported(text, base=f"l{len(joints)}", tip=tip)
        assert list(found.joints) == names
        assert found.arm.base_moves
        assert found.arm.mass_kg is None
        assert any("gravity turns with it" in note for note in found.notes)
        q = np.random.default_rng(seed).uniform(-1.5, 2, (4, found.arm.n))
        for positions, T in zip(q, Chain.of(found.arm).forward(q), strict=True):
            at = dict.fromkeys(moving, 0.0) | dict(zip(names, positions, strict=True))
            links = frames_of_links(joints, [at[name] for name in moving])
            beyond = np.eye(4)
            if tip == "h1":
                beyond = links[shoulder] @ frames_of_links(hand, [at["a0"], at["a1"]])[-1]
            np.testing.assert_allclose(T, np.linalg.inv(links[-1]) @ beyond, atol=1e-9)


TURNS = ("revolute", (0, 0, 0.1), (0, 0, 0), (0, 0, 1))


def of_kind(kind, xyz=(0, 0, 0.1)):
    return kind, xyz, (0, 0, 0), (0, 0, 1)


@pytest.mark.parametrize(
    ("joints", "says", "ends"),
    [
        ([of_kind("planar"), of_kind("floating")], "j0: .*this type.*name another base", None),
        ([TURNS, TURNS, of_kind("planar")], "j2: .*this type.*name a tip before .*l2$", ("l0", 2)),
        ([of_kind("planar"), TURNS], "j0: .*this type.*name a base beyond .*l1$", ("l1", 2)),
        ([TURNS, of_kind("planar"), TURNS], "base beyond .*l2, or a tip before .*l1$", ("l2", 3)),
        ([of_kind("fixed", (0, 200, 0)), TURNS], "j0: .*further than 10.*else .*l1$", ("l1", 2)),
        ([TURNS, of_kind("revolute", (0, 0, 190))], "j1: .*further than 10.*else .*l1$", ("l0", 1)),
    ],
)
def test_the_ends_that_a_refusal_names_are_those_that_help(joints, says, ends):
    text = robot(joints)
    with pytest.raises(ArmError, match=says):
        imported(text)
    if ends is not None:
        base, tip = ends
        assert imported(text, base=base, tip=f"l{tip}").joints


def test_a_joint_that_does_not_move_has_one_pose():
    (joint,) = read_tree(robot([of_kind("fixed")]), "robot.urdf").joints
    np.testing.assert_array_equal(joint.origin_at(1.0), joint.origin_at(0.0))


# Rows laid through axes anywhere in space, parallel, meeting and near-parallel ones too.

angles = st.sampled_from([0.0, np.pi, np.pi / 2, -np.pi / 2, 1e-12, 3e-8, 1e-3, 0.08, 0.09, 0.7])
lengths = st.sampled_from([0.0, 1e-11, 1e-6, 0.1, -0.4])
twists = st.tuples(angles, lengths, lengths, angles, angles)


def along(frames):
    """Return origins and z axes of frames."""
    return frames[:, :3, 3], frames[:, :3, 2]


def screw(turns, shifts):
    """Return a frame turned about z, shifted along z and x, turned about x and y."""
    return homogeneous(
        Rotation.from_euler("ZXY", turns).as_matrix(),
        Rotation.from_euler("z", turns[0]).apply([shifts[1], 0.0, shifts[0]]),
    )


@pytest.mark.slow
@examples(300)
@given(steps=st.lists(twists, min_size=1, max_size=7), seed=st.integers(0, 1000))
def test_rows_end_on_the_axes_and_at_the_end_effector(steps, seed):
    rng = np.random.default_rng(seed)
    T = screw(rng.uniform(-3, 3, 3), rng.uniform(-0.5, 0.5, 2)) if seed % 3 else np.eye(4)
    frames = []
    for theta, d, a, alpha, beta in steps:
        frames.append(T)
        T = T @ screw((theta, alpha, beta), (d, a))
    p_base_m, axes = along(np.array(frames))
    p_base_m = p_base_m + axes * rng.uniform(-0.3, 0.3, (len(steps), 1))  # any point of each
    rows = rows_through(p_base_m, axes, T)
    starts = np.array([rows.T_base_row1, *rows.T_base_rows[:-1]])
    origins, found = along(starts)
    np.testing.assert_allclose(found, axes, atol=1e-12)
    off = np.linalg.norm(np.cross(origins - p_base_m, axes), axis=1)
    assert off.max() < 1e-9
    np.testing.assert_allclose(rows.T_base_rows[-1] @ rows.T_row_n_ee, T, atol=1e-12)
    # No row is thrown far out by axes that are all but parallel.
    assert np.abs(rows.parameters[:, 1:3]).max() < 20.0
    assert np.all(np.abs(rows.parameters[:-1, 0]) <= np.pi / 2 + 1e-9)


def test_a_small_tilt_of_parallel_axes_is_a_small_beta():
    axes = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [1e-6, -2e-6, 1.0]])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    p_base_m = np.array([[0.0, 0.0, 0.0], [0.4, 0.0, 5.0], [0.7, 0.0, -3.0]])
    _, d_m, a_m, alpha_rad, beta_rad = rows_through(p_base_m, axes, np.eye(4)).parameters.T
    np.testing.assert_allclose(a_m[:2], [0.4, 0.3], atol=1e-5)
    np.testing.assert_allclose(d_m[:2], 0.0, atol=1e-12)
    assert alpha_rad[1] == pytest.approx(2e-6, rel=1e-3)
    assert beta_rad[1] == pytest.approx(1e-6, rel=1e-3)


SERIAL = [
    ("revolute", (0.0, 0.0, 0.3), (0.0, 0.0, 0.0), (0, 0, 1)),
    ("revolute", (0.1, 0.0, 0.1), (1.2, 0.0, 0.0), (0, 0.6, 0.8)),
    ("prismatic", (0.2, 0.1, 0.0), (0.0, 0.4, 0.0), (1, 0, 0)),
    ("prismatic", (0.05, 0.0, 0.0), (0.0, 0.0, 0.0), (1, 0, 0)),
    ("revolute", (0.0, 0.2, 0.0), (0.0, 0.0, 0.7), (0, 1, 0)),
]


def mimicking(follower, leader, multiplier, offset=0.0, text=None):
    text = robot(SERIAL) if text is None else text
    mimic = f'<mimic joint="{leader}" multiplier="{multiplier}" offset="{offset}"/>'
    head, tail = text.split(f'<joint name="{follower}"')
    return f'{head}<joint name="{follower}"{tail.replace("<axis", mimic + "<axis", 1)}'


@pytest.mark.parametrize(
    ("text", "positions"),
    [
        (mimicking("j3", "j2", 1.0), lambda q: [*q[:3], q[2], q[3]]),
        (mimicking("j4", "j1", -0.5, 0.3), lambda q: [*q, 0.3 - 0.5 * q[1]]),
        (
            mimicking("j3", "j2", 2.0, 0.1, mimicking("j2", "j1", 0.1, 0.05)),
            lambda q: [q[0], q[1], 0.05 + 0.1 * q[1], 0.2 + 0.2 * q[1], q[2]],
        ),
    ],
)
def test_mimicry_is_one_motor_that_drives_several_joints(text, positions):
    found = imported(text)
    arm, rng = found.arm, np.random.default_rng(2)
    model = pin.buildModelFromXML(text)
    data, end = model.createData(), model.getFrameId("l5")
    low, high = arm.axis_limits_rad.T
    for axes in rng.uniform(low, high, (20, len(low))):
        q = np.array(positions(axes))
        pin.framesForwardKinematics(model, data, q)
        (T,) = Chain.of(arm).forward(arm.coupling.to_joints(axes)[None])
        assert np.abs(T - data.oMf[end].homogeneous).max() < 1e-9
        assert (np.clip(q, -1.5 - 1e-9, 2.0 + 1e-9) == q).all()
    assert any("has no axis of its own" in note for note in found.notes)
    back = imported(urdf_text(Chain.of(arm), Chain.of(arm).nominal, "again")).arm
    assert [(c.joint, c.by, c.follows) for c in back.coupled] == [
        (c.joint, c.by, True) for c in arm.coupled
    ]


def test_stages_of_a_telescope_are_told():
    assert any(
        "joints 3 to 4 (j2 … j3) slide along one" in note for note in imported(robot(SERIAL)).notes
    )
    assert not any("slide along" in note for note in imported(mimicking("j3", "j2", 1.0)).notes)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            mimicking("j3", "j2", 1.0, 0.0, mimicking("j2", "j3", 1.0)),
            r"joint j2: the joint follows joint j3 \(mimic\) \(got 'in a circle'",
        ),
        (mimicking("j3", "elsewhere", 1.0), "elsewhere does not move between base and tip"),
        (mimicking("j3", "j2", 0.0), "multiplier 0"),
        (mimicking("j3", "j2", 1.0, 9.0), "which follows it, allow the joint no motion"),
        (mimicking("j3", "j2", "twice"), "multiplier cannot be read"),
    ],
)
def test_mimicry_that_no_chain_can_follow_is_refused(text, says):
    with pytest.raises(ArmError, match=says):
        imported(text)
