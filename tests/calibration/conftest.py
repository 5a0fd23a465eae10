"""Poses of a PA10 whose departures and springs are known, made with the project's own chain.

Agreement with an arm that shares no formula with it is tested with the virtual cell, elsewhere.
"""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from made_up_parameters import solved_parameters
from made_up_poses import measured_poses
from pa10cal.arm.statics import PoseStates
from pa10cal.files.arms import load_arm
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.options import Tolerances
from pa10cal.terms.joint_spring import baseline
from pa10cal.terms.model import Model


def rows(kind, values, joints=(1, 2, 3, 4, 5, 6)):
    return {f"{kind}_{joint}": value for joint, value in zip(joints, values, strict=True)}


# Paper, Table I, with the stiffness of its text.
TABLE_I = {
    **rows("delta_a", [0.33e-3, -0.46e-3, 1.09e-3, -0.48e-3, -0.30e-3, -3.44e-3]),
    **rows("delta_alpha", [-4.9e-4, 1.2e-4, -2.3e-3, 2.1e-4, 3.7e-5, -7.1e-4]),
    **rows("delta_d", [0.09e-3, 1.26e-3, 0.22e-3, 0.10e-3, 0.17e-3], (1, 3, 4, 5, 6)),
    **rows("delta_beta", [-1.0e-3], (2,)),
    **rows("delta_theta", [-5.9e-3, -7.8e-3, 2.9e-3, 8.1e-3, -1.5e-3, 1.3e-2]),
    **rows("K_lin", [1.98e4, 1.27e4, 2.56e3], (2, 3, 5)),
    **rows("K_cub", [3.35e7, 1.46e7, 3.83e7], (2, 3, 5)),
}


@pytest.fixture(scope="session")
def pa10():
    return load_arm("pa10_6ce")


@pytest.fixture(scope="session")
def model(pa10) -> Model:
    return baseline(pa10, (2, 3, 5), Tolerances())


@pytest.fixture(scope="session")
def truth(model) -> np.ndarray:
    return solved_parameters(model, TABLE_I)


@pytest.fixture(scope="session")
def T_instr_base() -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", [0.02, -0.03, 1.1]).as_matrix()
    T[:3, 3] = [0.9, 0.4, -0.3]
    return T


@pytest.fixture(scope="session")
def states() -> PoseStates:
    """27 postures about one place, each at three loads."""
    rng = np.random.default_rng(27)
    centre = np.array([0.3, 0.35, 1.4, 0.2, -0.5, 0.4])
    q = np.repeat(centre + rng.uniform(-0.5, 0.5, (27, 6)), 3, axis=0)
    load = np.tile([0.0, 22.0, 44.0], 27)
    tau = np.zeros((81, 6))
    tau[:, 1] = -(55.0 + 0.7 * load) * (0.8 + 0.4 * np.sin(q[:, 1]))
    tau[:, 2] = -(30.0 + 0.5 * load) * (0.8 + 0.4 * np.cos(q[:, 2]))
    tau[:, 4] = -(4.0 + 0.09 * load) * np.cos(q[:, 4])
    return PoseStates(q, tau, np.ones((81, 6)), load, np.full(81, 21.0), np.arange(81.0))


@pytest.fixture(scope="session")
def observe(model, truth, T_instr_base, states) -> Callable[..., Observations[Pose]]:
    """Measure the poses with Gaussian noise of 10 um and 50 urad times `noise`."""

    def measure(noise: float = 0.0, seed: int = 0, x: np.ndarray = truth) -> Observations[Pose]:
        rng = np.random.default_rng(seed)
        T = T_instr_base @ model.predict(states, x)
        sigma = noise * np.array([1e-5] * 3 + [5e-5] * 3)
        error = sigma * rng.standard_normal((len(T), 6))
        T[:, :3, 3] += error[:, :3]
        T[:, :3, :3] = Rotation.from_rotvec(error[:, 3:]).as_matrix() @ T[:, :3, :3]
        return measured_poses(
            pose=np.repeat([f"P{k:02d}" for k in range(1, 28)], 3),
            states=states,
            T_instr_ee=T,
            cov=np.tile(np.diag(sigma**2), (len(T), 1, 1)),
        )

    return measure
