"""Effects of links and base, in the whole chain, against a direct finite evaluation.

The effects are made so small that the posture's own change does not show, and compared as
displacements of the flange of the stiff arm. Those of tool and instrument against their forms.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pa10cal_lab.cell.effects import structure
from pa10cal_lab.cell.effects import structure as instrument
from pa10cal_lab.cell.instruments.instrument import rest_poses

Q = np.random.default_rng(11).uniform(-1.2, 1.2, (8, 6))
LOADS = np.resize([0.0, 44.0, 90.0], 8)
HOURS = np.linspace(0.0, 7.0, 8)
WARMING = np.linspace(-2.0, 5.0, 8)
TINY = 1e-8  # rad/(N m)


def moved(rigid, effect):
    """Displacement and turn of the flange that the effect brings, (8, 3) each, in the world."""
    state = (Q, LOADS, 3600.0 * HOURS, WARMING)
    before, after = (rest_poses(rigid, effects, *state).T_base_ee for effects in ((), (effect,)))
    turn = after[:, :3, :3] @ before[:, :3, :3].transpose(0, 2, 1)
    vector = 0.5 * np.stack(
        [
            turn[:, 2, 1] - turn[:, 1, 2],
            turn[:, 0, 2] - turn[:, 2, 0],
            turn[:, 1, 0] - turn[:, 0, 1],
        ],
        axis=1,
    )
    return after[:, :3, 3] - before[:, :3, 3], vector


def link_moved(rigid, plain, near, far, turn_of):
    """The same, when the end `far` of the link from row `near` turns and shifts by `turn_of`."""
    other = plain(rigid)
    shifts, turns = [], []
    for q, load_N in zip(Q, LOADS, strict=True):
        frames = other.frames(q)
        start, end, flange = frames[near][:3, 3], frames[far][:3, 3], frames[-1][:3, 3]
        length, axis = np.linalg.norm(end - start), (end - start) / np.linalg.norm(end - start)
        at_end, at_start = (other.moment(q, load_N, far, place) for place in (end, start))
        turn, shift = turn_of(at_end, at_start, axis, length)
        turns.append(turn)
        shifts.append(shift + np.cross(turn, flange - end))
    return np.array(shifts), np.array(turns)


def assert_same(found, wanted):
    for one, other in zip(found, wanted, strict=True):
        assert np.abs(other).max() > 0.0
        assert np.abs(one - other).max() < 1e-4 * np.abs(other).max()


#: Rows at the near and far joint of the two long links: joints 2 to 3, and 4 to 5.
LINKS = [("upper_arm", 1, 2), ("forearm", 3, 4)]


@pytest.mark.parametrize(("name", "near", "far"), LINKS)
def test_link_bending(rigid, plain, name, near, far):
    def turn_of(moment, at_start, axis, length):
        # Handbooks: M L / EI and M L^2 / 2 EI of a moment at the end, F L^2 / 2 EI and F L^3 / 3 EI
        # of a force, whose moment at the start is that of the end and F L.
        at_end, of_force = moment - axis * (axis @ moment), at_start - moment
        return TINY * (at_end + of_force / 2.0), length * TINY * np.cross(
            at_end / 2.0 + of_force / 3.0, axis
        )

    effect = structure.SimulatedLinkBending(c=TINY).at(name)
    assert_same(moved(rigid, effect), link_moved(rigid, plain, near, far, turn_of))


def test_link_torsion(rigid, plain):
    def turn_of(moment, _at_start, axis, _length):
        return TINY * axis * (axis @ moment), np.zeros(3)

    effect = structure.SimulatedLinkTorsion(c=TINY).at("forearm")
    assert_same(moved(rigid, effect), link_moved(rigid, plain, 3, 4, turn_of))


def test_base_compliance_tilts_about_x_and_y(rigid, plain):
    other = plain(rigid)
    effect = structure.SimulatedBaseCompliance(cx=TINY, cy=3 * TINY).at("base")
    turns = np.array(
        [
            np.array([TINY, 3 * TINY, 0.0]) * other.moment(q, load_N, 0, np.zeros(3))
            for q, load_N in zip(Q, LOADS, strict=True)
        ]
    )
    flanges = np.array([other.frames(q)[-1][:3, 3] for q in Q])
    assert_same(moved(rigid, effect), (np.cross(turns, flanges), turns))


def test_base_drift_moves_the_base_at_its_rate(rigid):
    rate = np.array([1e-5, -2e-5, 3e-6])
    shift, turn = moved(rigid, structure.SimulatedBaseDrift(rate=tuple(rate)).at("base"))
    assert shift == pytest.approx(np.outer(HOURS, rate), abs=1e-15)
    assert np.abs(turn).max() < 1e-15


def test_thermal_growth_stretches_pedestal_upper_arm_and_forearm(rigid, plain):
    frames = np.array([plain(rigid).frames(q) for q in Q])
    spans = sum(
        frames[:, far, :3, 3] - frames[:, near, :3, 3] for near, far in ((0, 1), (1, 2), (3, 4))
    )
    shift, turn = moved(rigid, structure.SimulatedThermalGrowth(alpha=2e-5).at("arm"))
    assert shift == pytest.approx(2e-5 * WARMING[:, None] * spans, abs=1e-14)
    assert np.abs(turn).max() < 1e-15


@pytest.mark.parametrize(("link", "near", "far"), [("upper_arm", 1, 2), ("forearm", 3, 4)])
def test_a_link_that_grows_alone_stretches_no_other(rigid, plain, link, near, far):
    frames = np.array([plain(rigid).frames(q) for q in Q])
    span = frames[:, far, :3, 3] - frames[:, near, :3, 3]
    shift, turn = moved(rigid, structure.SimulatedLinkGrowth(alpha=5e-5).at(link))
    assert shift == pytest.approx(5e-5 * WARMING[:, None] * span, abs=1e-14)
    assert np.abs(turn).max() < 1e-15


def test_springs_and_structure_yield_together(robot, plain):
    """The moment is that of the posture at rest, springs and bent link included."""
    effect = structure.SimulatedLinkBending(c=1e-6).at("upper_arm")
    zero = np.zeros(8)
    rest = rest_poses(robot, (effect,), Q, LOADS, zero, zero)
    delta = Q - rest.q
    k_lin, k_cub = robot.springs.k_lin, robot.springs.k_cub
    for j in (1, 2, 4):
        held = k_lin[j] * delta[:, j] + k_cub[j] * delta[:, j] ** 3
        assert held == pytest.approx(rest.tau_Nm[:, j], abs=1e-8)
    other = rest_poses(robot, (), Q, LOADS, zero, zero)
    assert np.abs(rest.tau_Nm - other.tau_Nm).max() > 1e-4


# Effects of apparatus and machine, each against its form written out.


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
