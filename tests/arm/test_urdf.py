import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ikpy.chain import Chain as IkpyChain

from pa10cal.arm.chain import BASE, Chain, end_pose
from pa10cal.arm.exports import urdf_text
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


@pytest.mark.parametrize("name", arm_names())
def test_forward_kinematics_of_the_urdf_is_the_chains(name):
    check_against_pinocchio(Chain.of(load_arm(name)), np.random.default_rng(1))


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 10_000), convention=st.sampled_from(["standard", "modified"]))
def test_so_it_is_of_arms_of_any_shape(random_arm, seed, convention):
    chain = Chain.of(random_arm(seed, 5, convention), bends=(2,))
    check_against_pinocchio(chain, np.random.default_rng(seed))


def test_what_is_not_known_is_written_as_none():
    chain = Chain.of(load_arm("irb120"))  # its rated torques are not published
    model = pin.buildModelFromXML(urdf_text(chain, chain.nominal, "irb120"))
    assert not model.effortLimit.any()


@pytest.mark.parametrize("name", arm_names())
def test_another_loader_reads_the_same(name, tmp_path):
    chain, path = Chain.of(load_arm(name)), tmp_path / "robot.urdf"
    coordinates = chain.nominal + np.random.default_rng(5).normal(0, 2e-3, len(chain.nominal))
    coordinates[chain.columns(BASE)] = 0.0
    tool = np.array([[0.0, -1, 0, 0.1], [1, 0, 0, -0.2], [0, 0, 1, 0.3], [0, 0, 0, 1]])
    path.write_text(urdf_text(chain, coordinates, name, "a comment", frames={"tool": tool}))
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
        np.testing.assert_allclose(found, end_pose(chain, moved[None])[0] @ tool, atol=1e-12)
