"""An arm written as URDF, into a user's own URDF and for a driver: loaded back, it is the arm."""

import re
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from changed_arm import departed, expected
from drawn_examples import examples
from pa10cal.arm.chain import BASE, Chain, end_pose
from pa10cal.arm.urdf_import import arm_from_urdf_text
from pa10cal.arm.urdf_reading import parse_urdf
from pa10cal.arm.urdf_writing import UrdfSource, patched_urdf, urdf_text
from pa10cal.errors import ArmError, visible
from pa10cal.files.arms import arm_names, load_arm


def check_against_pinocchio(chain, rng):
    """Hold the URDF of a chain off nominal against the chain, at random joint positions."""
    n = chain.arm.n
    departures = rng.normal(scale=5e-3, size=len(chain.motions))
    departures[chain.columns(BASE)] = 0.0
    coordinates = chain.coordinates(np.zeros((1, n)))[0] + departures
    model = pin.buildModelFromXML(urdf_text(chain, coordinates, chain.arm.name))
    data = model.createData()
    np.testing.assert_allclose(model.upperPositionLimit, chain.arm.limits_rad[:, 1])
    for q in rng.uniform(-1, 1, (5, n)):
        pin.framesForwardKinematics(model, data, q)
        moved = coordinates.copy()
        moved[chain.joint_columns] += q
        found = data.oMf[model.getFrameId("flange")].homogeneous
        np.testing.assert_allclose(found, end_pose(chain, moved[None])[0], atol=1e-12)


@examples(25)
@given(seed=st.integers(0, 10_000), convention=st.sampled_from(["standard", "modified"]))
def test_forward_kinematics_of_the_urdf_is_the_chains(random_arm, seed, convention):
    chain = Chain.of(random_arm(seed, 5, convention), bends=(2,))
    check_against_pinocchio(chain, np.random.default_rng(seed))


def test_what_is_not_known_is_written_as_none():
    chain = Chain.of(load_arm("irb120"))  # its rated torques are not published
    model = pin.buildModelFromXML(urdf_text(chain, chain.nominal, "irb120"))
    assert not model.effortLimit.any()


@pytest.mark.parametrize("name", ['a"b<c>&d', "--><link name='x'/>", "a\nb\tc", " -", "ä\u202e"])
def test_names_are_read_back_whatever_they_are(name):
    """What XML has no sign for stands there by its number."""
    chain = Chain.of(load_arm("irb120"))
    shown = f"{name}\x1b\x00"
    text = urdf_text(chain, chain.nominal, "irb120", shown, frames={shown: np.eye(4)})
    robot = parse_urdf(text).robot
    links = [link.get("name") for link in robot.iter("link")]
    assert len(links) == 9
    assert visible(shown) in links


@pytest.mark.parametrize("name", arm_names())
def test_another_loader_reads_the_same(name, tmp_path):
    from ikpy.chain import Chain as IkpyChain  # late: every worker imports every file of tests

    chain, path = Chain.of(load_arm(name)), tmp_path / "robot.urdf"
    coordinates = chain.nominal + np.random.default_rng(5).normal(0, 2e-3, len(chain.nominal))
    coordinates[chain.columns(BASE)] = 0.0
    path.write_text(
        urdf_text(chain, coordinates, name, "a comment", frames={"tool": T_FLANGE_TOOL})
    )
    mask = [False, *[True] * chain.arm.n, False, False]  # fixed links are told one by one
    loaded = IkpyChain.from_urdf_file(
        str(path), base_elements=["base"], symbolic=False, active_links_mask=mask
    )
    assert [link.name for link in loaded.links[-2:]] == ["to_flange", "to_tool"]
    joints = [k for k, link in enumerate(loaded.links) if link.name.startswith("joint_")]
    for q in np.random.default_rng(6).uniform(*chain.arm.limits_rad.T, (4, chain.arm.n)):
        given = np.zeros(len(loaded.links))
        given[joints] = q
        moved = coordinates.copy()
        moved[chain.joint_columns] += q
        found = loaded.forward_kinematics(given)
        np.testing.assert_allclose(
            found, end_pose(chain, moved[None])[0] @ T_FLANGE_TOOL, atol=1e-12
        )


T_FLANGE_TOOL = np.array([[0.0, -1, 0, 0.1], [1, 0, 0, -0.2], [0, 0, 1, 0.3], [0, 0, 0, 1]])

#: As robots have it: a licence first, a prefix never declared, rounded right angles, axes along any
#: direction, a base beside the arm, a branch, a gripper, a link and a joint of one name.
OWN = """<?xml version="1.0" ?>
<!-- Licence: ours -->
<robot name="mine">
  <!-- was: ${prefix}arm -->
  <link name="world"/>
  <link name="stand"><inertial><mass value="9"/></inertial></link>
  <link name="base"/>
  <joint name="to_stand" type="fixed"><parent link="world"/><child link="stand"/>
    <origin xyz="0.1 0.2 0.3" rpy="0 0 1.5708"/></joint>
  <joint name="to_base" type="fixed"><parent link="stand"/><child link="base"/>
    <origin xyz="0 0 0" rpy="0 0 3.14159"/></joint>
  <link name="shoulder"><visual><origin xyz="0 0 1"/><geometry><box size="1 1 1"/></geometry>
    </visual></link>
  <joint name="shoulder" type="revolute"><parent link="stand"/><child link="shoulder"/>
    <origin xyz="0 0 0.4" rpy="1.57 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-2.9" upper="2.9" effort="100" velocity="3"/></joint>
  <link name="upper"/>
  <joint name="lift" type="revolute"><parent link="shoulder"/><child link="upper"/>
    <origin xyz="0 0.1 0" rpy="0 1.5708 0"/><axis xyz="0 0 -1"/>
    <limit lower="-2" upper="2" effort="100" velocity="3"/></joint>
  <link name="plate"/>
  <joint name="bolted" type="fixed"><parent link="upper"/><child link="plate"/>
    <origin xyz="0.5 0 0.1" rpy="0 0 0.3"/></joint>
  <link name="fore"/>
  <joint name="elbow" type="continuous"><parent link="plate"/><child link="fore"/>
    <axis xyz="0 0 1"/></joint>
  <link name="slider"/>
  <joint name="slide" type="prismatic"><parent link="fore"/><child link="slider"/>
    <origin xyz="0.3 0 0" rpy="0 1.57 0"/><axis xyz="0.6 0 0.8"/>
    <limit lower="-0.1" upper="0.4" effort="50" velocity="1"/></joint>
  <link name="camera"/>
  <joint name="to_camera" type="fixed"><parent link="fore"/><child link="camera"/></joint>
  <link name="TIP"/>
  <joint name="to_tip" type="fixed"><parent link="slider"/><child link="TIP"/>
    <origin xyz="0 0 0.08" rpy="0 0 0"/></joint>
  <gazebo reference="upper"><drake:declare/></gazebo>
</robot>
"""


def own(tip="tool0", base="base"):
    text = OWN.replace("TIP", tip)
    return UrdfSource(text, "mine.urdf", base, tip)


def chain_of(source):
    given = {"base": source.base, "tip": source.tip, "where": source.where}
    return Chain.of(arm_from_urdf_text(source.text, "mine", **given).arm)


def loaded(text, base, link, q):
    """Where a link is in another, by pinocchio and by its joints in order; held ones at zero."""
    model = pin.buildModelFromXML(re.sub(r"<!--.*?-->", "", text).replace("drake:", ""))
    data, found = model.createData(), []
    for positions in q:
        at = pin.neutral(model)
        for joint, value in enumerate(positions, start=1):
            index, turns = model.joints[joint].idx_q, model.joints[joint].nq == 2
            at[index : index + model.joints[joint].nq] = (
                [np.cos(value), np.sin(value)] if turns else value
            )
        pin.framesForwardKinematics(model, data, at)
        frames = [data.oMf[model.getFrameId(n, pin.FrameType.BODY)] for n in (base, link)]
        found.append(frames[0].actInv(frames[1]).homogeneous)
    return np.array(found)


Q = np.random.default_rng(3).uniform([-2, -2, -3, -0.1], [2, 2, 3, 0.4], (6, 4))


@pytest.mark.parametrize(
    ("source", "flange", "tool"),
    [
        (own(), "flange", "tool"),
        (own("flange"), "flange", "tool"),
        (own(base="world"), "flange", "tool"),
        (own("tool"), "flange", "tool_pa10cal"),
    ],
)
def test_flange_tool_and_tip_are_those_of_the_calibrated_arm(source, flange, tool):
    chain = chain_of(source)
    at = departed(chain)
    text = patched_urdf(source, chain, at, {"tool": T_FLANGE_TOOL}, "calibrated")
    T = expected(chain, at, Q)
    for link, wanted in ((flange, T), (source.tip, T), (tool, T @ T_FLANGE_TOOL)):
        np.testing.assert_allclose(loaded(text, source.base, link, Q), wanted, atol=1e-12)


def test_a_tip_that_a_joint_carries_gets_a_flange_of_its_own():
    source = UrdfSource(own().text, "mine.urdf", "base", "slider")
    chain = chain_of(source)
    at = departed(chain)
    text = patched_urdf(source, chain, at, {})
    np.testing.assert_allclose(
        loaded(text, "base", "flange", Q), expected(chain, at, Q), atol=1e-12
    )


def test_mimicry_stays_and_counts_from_where_the_urdf_has_it():
    """The elbow is at half the lift and 0.2: calibrated origins are those of its own zero."""
    mimic = '<axis xyz="0 0 1"/><mimic joint="lift" multiplier="0.5" offset="0.2"/>'
    text = OWN.replace("TIP", "flange").replace('<axis xyz="0 0 1"/>', mimic)
    source = UrdfSource(text, "mine.urdf", "base", "flange")
    assert source.joints == ("shoulder", "lift", "slide")
    chain = chain_of(source)
    at, axes = departed(chain), Q[:, [0, 1, 3]]
    q = chain.arm.coupling.to_joints(axes)
    in_urdf = np.add(q, [0.0, 0.0, 0.2, 0.0])
    patched = patched_urdf(source, chain, at, {})
    assert patched.count("<mimic") == 1
    np.testing.assert_allclose(
        loaded(patched, "base", "flange", in_urdf), expected(chain, at, q), atol=1e-12
    )


def without_origins(text):
    root = ElementTree.fromstring(text.replace("drake:", ""))
    for joint in root.findall("joint"):
        for origin in joint.findall("origin"):
            joint.remove(origin)
    return {
        (each.tag, each.get("name")): re.sub(r"\s+", " ", ElementTree.tostring(each, "unicode"))
        for each in root
    }


def test_all_but_origins_stays():
    source = own()
    chain = chain_of(source)
    text = patched_urdf(source, chain, departed(chain), {"target_A": T_FLANGE_TOOL}, "good -- so")
    before, after = without_origins(source.text), without_origins(text)
    assert {key: after[key] for key in before} == before
    added = {name for tag, name in after.keys() - before.keys() if tag == "link"}
    assert added == {"flange", "target_A"}
    assert text.index("<!-- good - - so -->") < text.index("<!-- Licence: ours -->")
    assert text.index("Licence") < text.index("<robot")
    assert "${prefix}arm" in text
    assert "drake:declare" in text


def test_an_export_that_is_imported_and_exported_again_has_every_name_once():
    text = own("tool").text
    for _ in range(3):
        source = UrdfSource(text, "mine.urdf", "base", "tool")
        chain = chain_of(source)
        text = patched_urdf(source, chain, departed(chain), {"tool": T_FLANGE_TOOL})
    names = [link.get("name") for link in parse_urdf(text).robot.findall("link")]
    assert len(set(names)) == len(names)
    assert {"tool_pa10cal", "tool_pa10cal_2", "tool_pa10cal_3"} <= set(names)
    chain_of(UrdfSource(text, "mine.urdf", "base", "tool"))


def test_as_designed_nothing_moves():
    source = own()
    chain = chain_of(source)
    text = patched_urdf(source, chain, chain.nominal, {})
    q = np.zeros((1, 4))
    for link in ("shoulder", "upper", "plate", "fore", "slider", "camera", "tool0"):
        here, there = (loaded(each, "world", link, q) for each in (source.text, text))
        np.testing.assert_allclose(there, here, atol=1e-6)


def test_the_urdf_of_another_arm_is_refused():
    chain = Chain.of(load_arm("ur10"))
    with pytest.raises(ArmError, match=r"mine.urdf: the URDF is not that of the arm.*4 joints"):
        patched_urdf(own(), chain, chain.nominal, {})
    source = own()
    longer = UrdfSource(source.text.replace("0.5 0 0.1", "0.51 0 0.1"), "b.urdf", "base", "tool0")
    with pytest.raises(ArmError, match=r"b.urdf: the URDF is not that of the arm"):
        patched_urdf(longer, chain_of(source), chain_of(source).nominal, {})


@examples(10)
@given(seed=st.integers(0, 10_000))
def test_arms_of_any_shape_are_patched(random_arm, seed):
    chain = Chain.of(random_arm(seed, 5, "standard"))
    text = urdf_text(chain, chain.nominal, "made_up")
    source = UrdfSource(text, "x.urdf", "base", "flange")
    again, q = chain_of(source), np.random.default_rng(seed).uniform(-1, 1, (3, 5))
    at = departed(again, seed)
    patched = patched_urdf(source, again, at, {})
    found = loaded(patched, "base", "flange", q)
    np.testing.assert_allclose(found, expected(again, at, q), atol=1e-11)
