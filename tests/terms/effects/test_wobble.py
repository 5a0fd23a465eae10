"""The wobble of an axis: its form, and what of it geometry and errors by angle cannot take."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from made_up_poses import at_rest, context_of
from pa10cal.arm.chain import Chain, end_pose_with_screws, frames
from pa10cal.files.arms import load_arm
from pa10cal.terms.effects.structure import AxisWobble
from pa10cal.terms.model import Model

ARMS = ("pa10_6ce", "ur10", "irb120", "iiwa14")


def wobbles(arm, span_rad=4.0):
    """The effect at every joint of an arm, by the joint; each turned by so much."""
    half = np.tile([-0.5 * span_rad, 0.5 * span_rad], (arm.n, 1))
    found = AxisWobble.everywhere(context_of(arm, q_span_rad=half))
    return {each.joint: each for each in found}


def poses(arm, count=200):
    return np.random.default_rng(7).uniform(-np.pi, np.pi, (count, arm.n))


def bending(arm):
    return Chain.of(arm, bends=tuple(range(1, arm.n)))


def on_a_wall(name):
    """An arm whose first axis lies level and starts away from the base's origin."""
    base = np.eye(4)
    base[:3, :3] = Rotation.from_euler("xyz", [0.3, 1.4, -0.5]).as_matrix()
    base[:3, 3] = 0.2, -0.4, 0.7
    return replace(load_arm(name), T_base_row1=base)


@pytest.mark.parametrize("name", ARMS)
def test_turns_what_follows_about_the_frame_of_the_joint(name):
    arm, x = on_a_wall(name), np.array([3e-5, -2e-5, 1e-5, 4e-5, -5e-5, 2e-5])
    q = poses(arm, 9)
    found = frames(Chain.of(arm), Chain.of(arm).coordinates(q))
    assert sorted(wobbles(arm)) == list(range(1, arm.n + 1))
    for joint, effect in wobbles(arm).items():
        moved = Model(bending(arm), (effect,)).predict_with_jacobian(at_rest(q), 0 * x).jacobian @ x
        at, k = q[:, joint - 1], joint - 1
        # Written out as a sum of waves of a tilt x + i y.
        wave = (x[0] + 1j * x[1]) * np.exp(-1j * at)
        for part, unit in ((x[2:4], 1.0), (x[4:6], 1j)):
            wave = wave + unit * (part[0] * np.cos(2 * at) + part[1] * np.sin(2 * at))
        tilt = np.column_stack([wave.real, wave.imag, 0.0 * at])
        turn = np.einsum("pij,pj->pi", found.T_base_joints[k, :, :3, :3], tilt)
        lever = found.T_base_ee[:, :3, 3] - found.T_base_joints[k, :, :3, 3]
        wanted = np.hstack([np.cross(turn, lever), turn])
        np.testing.assert_allclose(moved, wanted, rtol=0.0, atol=1e-15)


def moves(chain, screws, effect, tilts):
    """What tilts (P, m, k) of an effect's coordinates move of the end, (6 P, k)."""
    of_effect = screws[:, :, chain.columns(effect.coordinates)]
    return np.einsum("pbm,pmk->pbk", of_effect, tilts).reshape(6 * len(screws), -1)


def left_beside(columns, own):
    """What is left of columns beside own ones, as the part of each, and of any sum of them."""
    basis, sizes, _ = np.linalg.svd(own, full_matrices=False)
    basis = basis[:, sizes > 1e-9 * sizes[0]]
    unit = columns / np.linalg.norm(columns, axis=0)
    return np.linalg.svd(unit - basis @ (basis.T @ unit), compute_uv=False)


@pytest.mark.parametrize("name", ARMS)
def test_geometry_and_errors_by_angle_take_nothing_of_it(name):
    """Any constant of the chain, and waves to the third of every joint's angle, stand beside it."""
    arm = load_arm(name)
    chain, q = bending(arm), poses(arm)
    screws = end_pose_with_screws(chain, chain.coordinates(q)).screws
    of_joints = screws[:, :, chain.joint_columns]
    by_angle = [
        of_joints * wave(k * q)[:, None, :] for k in (1.0, 2.0, 3.0) for wave in (np.sin, np.cos)
    ]
    own = np.concatenate([screws, *by_angle], axis=2).reshape(6 * len(q), -1)
    for effect in wobbles(arm).values():
        columns = moves(chain, screws, effect, effect.derivative(at_rest(q), np.zeros(6)))
        assert left_beside(columns, own).min() > 0.8


@pytest.mark.parametrize("name", ARMS)
def test_a_tilt_that_turns_along_is_geometry(name):
    """The wave that is left out, exp(i q), and a constant tilt: nothing of them is left."""
    arm = load_arm(name)
    chain, q = bending(arm), poses(arm)
    screws = end_pose_with_screws(chain, chain.coordinates(q)).screws
    geometry = screws.reshape(6 * len(q), -1)
    for joint, effect in wobbles(arm).items():
        cos, sin = np.cos(q[:, joint - 1]), np.sin(q[:, joint - 1])
        tilts = np.stack([np.stack([cos, -sin], 1), np.stack([sin, cos], 1)], axis=1)
        if effect.of_base is not None:
            tilts = np.einsum("cm,pck->pmk", effect.of_base, tilts)
        columns = moves(chain, screws, effect, tilts)
        assert left_beside(columns, geometry).max() < 1e-9


def test_sits_where_a_joint_turned_by_a_third_of_a_turn():
    arm = load_arm("ur10")
    assert not wobbles(arm, 2.0)
    assert len(wobbles(arm, 2.1)) == arm.n
    slides = replace(arm, prismatic=np.arange(6) == 0)
    assert sorted(wobbles(slides)) == [2, 3, 4, 5, 6]
