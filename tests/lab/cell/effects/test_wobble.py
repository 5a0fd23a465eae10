"""A joint in two bearings that run out, in the whole chain, against points on its axis."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pa10cal_lab.cell.effects.effect import Site
from pa10cal_lab.cell.effects.structure import SimulatedAxisWobble
from pa10cal_lab.cell.instruments.instrument import rest_poses

Q = np.random.default_rng(3).uniform(-2.5, 2.5, (12, 6))
ZERO = np.zeros(12)
NONE = (0.0, 0.0, 0.0, 0.0)


def wobble(joint, **parameters):
    straight = dict.fromkeys(("lower_x", "lower_y", "upper_x", "upper_y"), NONE)
    known = straight | {"apart_m": 0.1, "middle_m": 0.0} | parameters
    return SimulatedAxisWobble.model_validate(known).at(f"joint {joint}")


def motion(robot, effect):
    """What the effect moves the flange by in the base, (12, 4, 4)."""
    before, after = (
        rest_poses(robot, effects, Q, ZERO, ZERO, ZERO).T_base_ee for effects in ((), (effect,))
    )
    return after @ np.linalg.inv(before)


@pytest.fixture
def on_a_wall(rigid):
    """Return a stiff arm whose first joint is turned, and away from the base's origin."""
    placements = rigid.mechanism.placements.copy()
    placements[0, :3, :3] = Rotation.from_euler("xyz", [0.3, 1.4, -0.5]).as_matrix()
    placements[0, :3, 3] = 0.2, -0.4, 0.7
    return replace(rigid, mechanism=replace(rigid.mechanism, placements=placements))


@pytest.mark.parametrize("joint", range(1, 7))
def test_each_bearing_carries_the_axis_by_its_own_run_out(on_a_wall, joint):
    # So small that squares of tilts do not show.
    rings = {
        "lower_x": (2e-8, 1e-8, -3e-8, 0.0),
        "lower_y": (0.0, 4e-8, 1e-8, 2e-8),
        "upper_x": (-1e-8, 3e-8, 0.0, 2e-8),
        "upper_y": (5e-8, 0.0, 2e-8, -1e-8),
    }
    effect = wobble(joint, **rings, apart_m=0.08, middle_m=0.03)
    moved, q = motion(on_a_wall, effect), Q[:, joint - 1]
    waves = np.stack([np.cos(q), np.sin(q), np.cos(2 * q), np.sin(2 * q)], axis=1)
    T = on_a_wall.mechanism.T_base_joints(Q)[joint - 1]
    back = Rotation.from_euler("z", -q[:, None]).as_matrix()
    T[:, :3, :3] = T[:, :3, :3] @ back  # before the joint turns
    for ring, height in (("lower", -0.01), ("upper", 0.07)):
        # The joint's own turn leaves a point on its axis where it is.
        place = T[:, :3, 3] + height * T[:, :3, 2]
        got = np.einsum("pij,pj->pi", moved[:, :3, :3], place) + moved[:, :3, 3] - place
        out = np.stack([waves @ rings[f"{ring}_x"], waves @ rings[f"{ring}_y"], ZERO], axis=1)
        wanted = np.einsum("pij,pj->pi", T[:, :3, :3], out)
        assert got == pytest.approx(wanted, abs=1e-12)


def test_two_bearings_off_centre_alike_move_the_axis_and_do_not_tilt_it(rigid):
    same = (3e-6, -2e-6, 1e-6, 0.0)
    moved = motion(rigid, wobble(3, lower_x=same, upper_x=same))
    assert Rotation.from_matrix(moved[:, :3, :3]).magnitude().max() < 1e-9


def test_usual_rings_run_out_by_some_micrometres():
    drawn = SimulatedAxisWobble.at_size(Site("joint 2"), 2.0, np.random.default_rng(1))
    for ring in ("lower", "upper"):
        waves = np.array([drawn[f"{ring}_x"], drawn[f"{ring}_y"]])
        assert np.linalg.norm(waves) == pytest.approx(1e-5)
    SimulatedAxisWobble.model_validate(drawn)
