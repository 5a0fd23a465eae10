"""Effects of apparatus and machine, each against its form written out."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pa10cal.lab.cell.effects import structure as instrument

POINTS = np.random.default_rng(5).uniform(-0.5, 0.5, (7, 3, 3))


def test_scale_stretches_every_axis_by_its_own():
    s = (1e-4, -2e-4, 3e-5)
    extra = instrument.SimulatedCmmScale(s=s).at("instrument").read_too_much_m(POINTS)
    for axis in range(3):
        assert extra[..., axis] == pytest.approx(s[axis] * POINTS[..., axis], abs=1e-18)


def test_squareness_adds_y_to_x():
    extra = instrument.SimulatedCmmSquareness(xy=1e-4).at("instrument").read_too_much_m(POINTS)
    assert extra[..., 0] == pytest.approx(1e-4 * POINTS[..., 1], abs=1e-18)
    assert np.abs(extra[..., 1:]).max() == 0.0


def test_tool_sags_across_its_axis_by_its_inclination():
    sag = instrument.SimulatedToolSag(c=3e-5).at("tool")
    attitudes = Rotation.random(20, random_state=1).as_matrix()
    shift = sag.shift_m(attitudes)
    assert np.abs(shift[:, 2]).max() == 0.0
    in_world = np.einsum("pij,pj->pi", attitudes, shift)
    axis = attitudes[:, :, 2]
    down = np.array([0.0, 0.0, -1.0])
    assert in_world == pytest.approx(3e-5 * (down - axis * (axis @ down)[:, None]), abs=1e-18)


def test_tool_held_upright_does_not_sag():
    sag = instrument.SimulatedToolSag(c=3e-5).at("tool")
    assert np.abs(sag.shift_m(np.eye(3)[None])).max() == 0.0
