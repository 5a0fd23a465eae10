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


def motion(axis: int, angle: Array, shift: float | Array, along: int) -> Array:
    """Return turns about an axis, and shifts along one, (P, 4, 4), as precise as the angles."""
    T = np.zeros((len(angle), 4, 4), dtype=angle.dtype)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    T[:, i, i] = T[:, j, j] = np.cos(angle)
    T[:, j, i], T[:, i, j] = np.sin(angle), -np.sin(angle)
    T[:, axis, axis] = T[:, 3, 3] = 1
    T[:, along, 3] = shift
    return T


@pytest.fixture(scope="session")
def flange() -> Callable[[Arm, Array], Array]:
    """Return the flange (P, 3) by products of 4 x 4 matrices, in extended precision."""

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


@pytest.fixture(scope="session")
def moved() -> Callable[[Arm, Array, Array], Array]:
    """Return how far turns dq (P, n) of the joints move the flange, (P, 3).

    Joint by joint, from the difference that its own turn makes: nothing large is subtracted, so
    that small turns lose no digits.
    """

    def by(arm: Arm, q_rad: Array, dq_rad: Array) -> Array:
        count = len(dq_rad)
        theta = arm.theta_rad + q_rad + np.zeros_like(dq_rad)
        carried = np.tile(np.eye(4), (count, 1, 1))
        change = np.zeros((count, 4, 4))
        for i in range(arm.n):
            at, after = (
                motion(2, theta[:, i] + turn, arm.d_m[i], 2) for turn in (0.0, dq_rad[:, i])
            )
            turned = np.zeros((count, 4, 4))
            chord, middle = 2 * np.sin(dq_rad[:, i] / 2), theta[:, i] + dq_rad[:, i] / 2
            turned[:, 0, 0] = turned[:, 1, 1] = -chord * np.sin(middle)
            turned[:, 1, 0], turned[:, 0, 1] = chord * np.cos(middle), -chord * np.cos(middle)
            link = motion(0, np.full(count, arm.alpha_rad[i]), arm.a_m[i], 0)
            before, behind = (
                (np.eye(4), link) if arm.convention == "standard" else (link, np.eye(4))
            )
            carried = carried @ before
            change = (change @ before @ at + carried @ turned) @ behind
            carried = carried @ after @ behind
        return change[:, :3, 3]

    return by
