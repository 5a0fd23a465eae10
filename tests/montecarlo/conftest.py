"""Arms to try the Monte Carlo on, and forward kinematics that shares nothing with the package."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.files.arms import load_arm

Array = NDArray[np.float64]


@pytest.fixture(scope="session")
def pa10() -> Arm:
    return load_arm("pa10_6ce")


@pytest.fixture(scope="session")
def pa10_chain(pa10: Arm) -> Chain:
    return Chain.of(pa10)


@pytest.fixture(scope="session")
def make_arm() -> Callable[..., Arm]:
    """Build an arm from rows (d, a, alpha_deg)."""

    def build(
        rows: list[tuple[float, float, float]],
        convention: str = "standard",
        limit_rad: float = 3.0,
        prismatic: tuple[bool, ...] | None = None,
    ) -> Arm:
        n = len(rows)
        d, a, alpha = np.array(rows).T
        return Arm(
            name="trial",
            title="trial",
            convention=convention,
            theta_rad=np.linspace(-0.4, 0.7, n),
            d_m=d,
            a_m=a,
            alpha_rad=np.radians(alpha),
            hayati=np.zeros(n, dtype=bool),
            prismatic=np.array(prismatic or (False,) * n),
            limits_rad=np.tile([-limit_rad, limit_rad], (n, 1)),
            gear_ratio=np.ones(n),
            torque_limit_Nm=np.ones(n),
            mass_kg=None,
            com_m=None,
        )

    return build


@pytest.fixture(scope="session")
def flange() -> Callable[[Arm, Array], Array]:
    """Return the flange (P, 3) by products of 4 x 4 matrices, in extended precision."""

    def motion(axis: int, angle: Array, shift: float | Array, along: int) -> Array:
        T = np.zeros((len(angle), 4, 4), dtype=np.longdouble)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        T[:, i, i] = T[:, j, j] = np.cos(angle)
        T[:, j, i], T[:, i, j] = np.sin(angle), -np.sin(angle)
        T[:, axis, axis] = T[:, 3, 3] = 1
        T[:, along, 3] = shift
        return T

    def forward(arm: Arm, q_rad: Array) -> Array:
        q = np.asarray(q_rad, dtype=np.longdouble)
        T = np.tile(np.eye(4, dtype=np.longdouble), (len(q), 1, 1))
        for i in range(arm.n):
            about_z = motion(2, arm.theta_rad[i] + q[:, i], arm.d_m[i], 2)
            about_x = motion(0, np.full(len(q), np.longdouble(arm.alpha_rad[i])), arm.a_m[i], 0)
            pair = (about_z, about_x) if arm.convention == "standard" else (about_x, about_z)
            T = np.einsum("pij,pjk,pkl->pil", T, *pair)
        return T[:, :3, 3]

    return forward
