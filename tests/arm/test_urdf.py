import numpy as np
import pinocchio as pin
import pytest

from pa10cal.arm.chain import Chain, end_pose
from pa10cal.arm.urdf import urdf_text
from pa10cal.files.arms import load_arm


@pytest.mark.parametrize("seed", range(5))
def test_forward_kinematics_of_the_urdf_is_the_chains(tmp_path, seed):
    rng = np.random.default_rng(seed)
    chain = Chain.of(load_arm("pa10_6ce"))
    departures = rng.normal(scale=5e-3, size=len(chain.motions))
    departures[chain.columns(("base.x", "base.y", "base.z", "base.rx", "base.ry", "base.rz"))] = 0
    coordinates = chain.coordinates(np.zeros((1, 6)))[0] + departures
    path = tmp_path / "robot.urdf"
    path.write_text(urdf_text(chain, coordinates, "pa10_6ce"))
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    q = rng.uniform(-1, 1, 6)
    pin.framesForwardKinematics(model, data, q)
    moved = coordinates.copy()
    moved[chain.joint_columns] += q
    expected = end_pose(chain, moved[None])[0]
    found = data.oMf[model.getFrameId("flange")].homogeneous
    np.testing.assert_allclose(found[:3], expected[:3], atol=1e-9)
    np.testing.assert_allclose(model.upperPositionLimit, chain.arm.limits_rad[:, 1])
