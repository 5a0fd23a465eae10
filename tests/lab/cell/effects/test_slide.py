"""What carriages run on, in the whole chain, against a direct evaluation."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pa10cal.errors import SettingsError
from pa10cal.files.arms import load_arm
from pa10cal_lab.cell.effects import slide
from pa10cal_lab.cell.effects.effect import Site
from pa10cal_lab.cell.effects.vocabulary import make_effects
from pa10cal_lab.cell.individual import build_robot
from pa10cal_lab.cell.instruments.instrument import rest_poses
from pa10cal_lab.cell.mechanism import Departures, Mechanism
from pa10cal_lab.cell.options import HiddenEffectOptions, SimulateOptions
from pa10cal_lab.cell.robot import Springs

STROKE = (-1.0, 2.0)
Q = np.random.default_rng(5).uniform(-1.0, 1.2, (9, 6))
Q[:, 0] = np.linspace(*STROKE, 9)
ZERO = np.zeros(9)
STRAIGHT = {"across_x": (0.0,), "across_y": (0.0,), "twist": (0.0,), "excess": 0.0, "sag": 0.0}


@pytest.fixture(scope="module")
def level(robot):
    """Return the paper's robot, its first joint sliding level along x of the base."""
    base = np.eye(4)
    base[:3, :3] = Rotation.from_euler("y", np.pi / 2).as_matrix()
    arm = replace(load_arm("pa10_6ce"), prismatic=np.arange(6) == 0, T_base_row1=base)
    plain = Mechanism.of(arm, Departures.none(6), robot.mechanism.payload)
    return replace(robot, arm=arm, mechanism=plain, springs=Springs.rigid(6))


def at_rest(robot, *effects):
    return rest_poses(robot, effects, Q, ZERO, ZERO, ZERO).T_base_ee


def carriage_moved(robot, effect):
    """Return by what the carriage, where its joint stands, shifts and turns in the base, (P, 3)."""
    before, after = at_rest(robot), at_rest(robot, effect)
    motion = after @ np.linalg.inv(before)
    place = robot.mechanism.T_base_joints(Q)[0, :, :3, 3]
    shift = np.einsum("pij,pj->pi", motion[:, :3, :3], place) + motion[:, :3, 3] - place
    return shift, Rotation.from_matrix(motion[:, :3, :3]).as_rotvec()


def error(**parameters):
    known = STRAIGHT | {"stroke_m": STROKE, "bearings": 1e-4} | parameters
    return slide.SimulatedSlideError.model_validate(known).at("joint 1")


def test_a_carriage_follows_the_line_and_its_slope(level):
    # Along x of the base; x of the joint is -z of the base, y stays y.
    v = np.linspace(0.0, 1.0, 9)
    shift, turn = carriage_moved(level, error(across_x=(0.0, 1e-5), across_y=(2e-5,)))
    assert shift[:, 2] == pytest.approx(-1e-5 * np.cos(2 * np.pi * v), abs=1e-9)
    assert shift[:, 1] == pytest.approx(2e-5 * np.cos(np.pi * v), abs=1e-9)
    slope_z = 1e-5 * 2 * np.pi / 3.0 * np.sin(2 * np.pi * v)
    slope_y = -2e-5 * np.pi / 3.0 * np.sin(np.pi * v)
    assert turn[:, 1] == pytest.approx(-slope_z, abs=1e-9)
    assert turn[:, 2] == pytest.approx(slope_y, abs=1e-9)


def test_bearings_apart_smooth_the_line(level):
    # Between bearings a whole wave apart nothing of it is left but their own height.
    _, turn = carriage_moved(level, error(across_y=(0.0, 1e-5), bearings=1.0))
    assert np.abs(turn).max() < 1e-12


def test_twist_and_excess(level):
    shift, turn = carriage_moved(level, error(twist=(1e-5,), excess=1e-5))
    assert turn[:, 0] == pytest.approx(1e-5 * np.cos(np.pi * np.linspace(0, 1, 9)), abs=1e-9)
    assert shift[:, 0] == pytest.approx(1e-5 * Q[:, 0], abs=1e-9)


def test_a_level_rail_sags_as_a_beam_on_two_supports(level):
    """Handbooks: P a^2 b^2 / 3 E I l under a load, where the slope is P a b (b - a) / 3 E I l."""
    shift, turn = carriage_moved(level, error(sag=1e-5))
    a, b = Q[:, 0] - STROKE[0], STROKE[1] - Q[:, 0]
    of_load = 48.0 * 1e-5 / 3.0**3  # P / E I with which it sags by so much in the middle
    assert shift[:, 2] == pytest.approx(-of_load * (a * b) ** 2 / 9.0, abs=1e-9)
    assert turn[:, 1] == pytest.approx(of_load * a * b * (b - a) / 9.0, abs=1e-9)


def test_an_upright_column_does_not_sag(robot):
    arm = replace(load_arm("pa10_6ce"), prismatic=np.arange(6) == 0)
    plain = Mechanism.of(arm, Departures.none(6), robot.mechanism.payload)
    upright = replace(robot, arm=arm, mechanism=plain, springs=Springs.rigid(6))
    shift, turn = carriage_moved(upright, error(sag=1e-4))
    assert max(np.abs(shift).max(), np.abs(turn).max()) < 1e-12


def test_a_column_bends_as_a_cantilever(level):
    """Handbooks: M l / EI and F l^2 / 2 EI of slope, M l^2 / 2 EI and F l^3 / 3 EI of shift."""
    c = 1e-9
    effect = slide.SimulatedSlideBending(c=c, stroke_m=STROKE).at("joint 1")
    shift, turn = carriage_moved(level, effect)
    statics = level.mechanism.statics(Q, ZERO)
    end = level.mechanism.link_ends[0]
    R = level.mechanism.T_base_joints(Q)[0, :, :3, :3]
    force = np.einsum("pij,pj->pi", R, statics.link_N[:, 0] @ end[:3, :3].T)
    moment = np.einsum("pij,pj->pi", R, statics.link_Nm[:, 0] @ end[:3, :3].T)
    moment = moment + np.cross(np.einsum("pij,j->pi", R, end[:3, 3]), force)
    out_m = Q[:, :1] - STROKE[0]
    axis = np.array([1.0, 0.0, 0.0])
    by_force = np.cross(axis, force)
    wanted = c / 3.0 * (moment * out_m + by_force * out_m**2 / 2.0) * [0.0, 1.0, 1.0]
    assert turn == pytest.approx(wanted, rel=1e-4, abs=1e-4 * np.abs(wanted).max())
    wanted = c / 3.0 * np.cross(moment * out_m**2 / 2.0 + by_force * out_m**3 / 3.0, axis)
    assert shift == pytest.approx(wanted, rel=1e-4, abs=1e-4 * np.abs(wanted).max())


def test_sits_at_joints_that_slide_alone(level, robot):
    drawn = slide.SimulatedSlideError.at_size(
        Site("joint 1", stroke_m=(0.0, 2.0)), 1.0, np.random.default_rng(1)
    )
    entry = HiddenEffectOptions(id="slide_error", of="joint 1", parameters=drawn)
    (made,) = make_effects([entry], level)
    line_m = np.linalg.norm(made.across_x)
    assert line_m == pytest.approx(2e-4)
    with pytest.raises(SettingsError, match="cannot sit there"):
        make_effects([entry], robot)
    scara = build_robot(
        load_arm("gx4_351s"),
        SimulateOptions(robot="gx4_351s", without_touches={"instrument": "pose"}),
        "text_e7",
        np.random.default_rng(1),
    )
    with pytest.raises(SettingsError, match="allowed: joint 3"):
        make_effects([entry], scara)
