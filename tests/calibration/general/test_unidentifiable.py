"""What arm, instrument or poses leave open is named, and does not go astray."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibrated import general
from drawn_examples import examples
from made_up_model import case_of
from pa10cal.arm.chain import Chain
from pa10cal.calibration.general.as_model import fitted
from pa10cal.files.arms import load_arm
from pa10cal.observe.points import Points

KINDS = ("pose", "point", "points", "distance")
NOISE_M = 5e-5
UR10 = load_arm("ur10")


def left_out(found):
    return {each.name: each.replaced_by for each in found.redundant}


def std_of(found):
    std = np.sqrt(np.diag(found.fit.covariance))
    return {p.name: sigma for p, sigma in zip(found.problem.parameters, std, strict=True)}


def held(joint, angle_rad, jitter_rad=0.0):
    """Hold a joint but for some jitter."""

    def posed(q_rad):
        jitter = np.random.default_rng(joint).standard_normal(len(q_rad))
        q_rad[:, joint - 1] = angle_rad + jitter_rad * jitter
        return q_rad

    return posed


# A joint that a servo holds jitters; what its reading tells by that is nothing.
@pytest.mark.slow_but_one_in(9)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("jitter_rad", [0.0, 1e-7, 1e-6, 1e-5, 1e-4])
def test_a_joint_that_never_moved(see, kind, jitter_rad):
    posed = held(3, 0.4, jitter_rad)
    record, full = case_of(UR10, see("ur10", kind, noise_m=NOISE_M, posed=posed))
    fit, parameters = full.fit, full.problem.parameters
    assert fit.converged
    assert fit.identifiability.rank < len(parameters)
    # Link 2 and link 3 are one: what is between them shows as one length, one height, one angle.
    named = set().union(*record.null_directions)
    assert {"delta_a_2", "delta_a_3", "delta_theta_2", "delta_theta_3"} <= named
    assert named <= {
        f"delta_{kind}_{row}"
        for kind in ("a", "alpha", "beta", "theta", "d")
        for row in (2, 3, 4)
    }  # fmt: skip
    assert record.health.grade == "few_poses"
    assert "not identifiable" in record.health.line
    # What is open stays about where it was; what is not is known.
    off = np.abs(fit.x / full.problem.scale)[["delta" in p.name for p in parameters]]
    assert off.max() < 10.0
    std = std_of(full)
    assert std["delta_theta_3"] > 3e-4  # about as large as departures of this arm are
    assert std["base_z"] < 1e-3
    assert std["delta_a_1"] < 0.25e-3


def test_the_joint_that_never_moved_is_not_claimed_to_be_known_elsewhere(see):
    """Intervals of predictions where it does move are as wide as what is open."""
    found = general("ur10", see("ur10", "pose", noise_m=NOISE_M, posed=held(3, 0.4)))
    others = see("ur10", "pose", count=40)
    rows = replace(found.problem, observations=others).rows(found.fit.x).jacobian[:, :3]
    wide = np.sqrt(np.einsum("pbk,kl,pbl->pb", rows, found.fit.covariance, rows))
    assert np.median(wide) > 3.0 * NOISE_M
    error_m = 1e-3 * fitted(found).deviations(others).distance_mm
    assert np.all(error_m < 3.0 * np.linalg.norm(wide, axis=1))


@pytest.mark.parametrize("size", [1.0, 8.0])
def test_links_depart_where_no_pose_shows_it_by_as_much_as_those_that_were_seen(see, size):
    found = general("ur10", see("ur10", "pose", noise_m=NOISE_M, size=size, posed=held(3, 0.4)))
    std = std_of(found)["delta_theta_3"] / 1e-3
    assert 0.2 * size < std < 2.0 * size


def test_what_poses_determine_is_left_as_it_is(see):
    found = general("ur10", see("ur10", "pose", noise_m=NOISE_M))
    np.testing.assert_array_equal(found.fit.span.rows, np.diag(1.0 / found.fit.span.reach))


def test_poses_of_one_attitude(see):
    """A SCARA that does not turn its shaft: tool and base cannot be told apart."""

    def posed(q_rad):
        q_rad[:, 3] = 0.3 - q_rad[:, 0] - q_rad[:, 1]
        return q_rad

    record, full = case_of(
        load_arm("gx4_351s"), see("gx4_351s", "pose", noise_m=NOISE_M, size=0.0, posed=posed)
    )
    assert full.fit.converged
    assert full.fit.identifiability.rank < len(full.problem.parameters)
    named = set().union(*record.null_directions)
    assert {"base_x", "base_y", "tool_x", "tool_y"} <= named
    assert record.health.grade == "few_poses"
    again = see("gx4_351s", "pose", count=40, size=0.0, posed=posed)
    assert fitted(full).deviations(again).distance_mm.max() < 0.15


def test_a_target_on_the_last_axis(see):
    """The last joint moves it nowhere: of seven lengths and angles beyond joint 5 five show."""
    on_axis_m = np.array([[0.0, 0.0, 0.11]])
    record, full = case_of(UR10, see("ur10", "point", noise_m=NOISE_M, targets_m=on_axis_m))
    names = left_out(full)
    assert names["delta_d_6"] == {"target_T1_z": pytest.approx(1.0)}
    assert max(map(abs, names["delta_theta_6"].values())) < 1e-3  # an angle, by a place on the axis
    rank, unknowns = full.fit.identifiability.rank, len(full.problem.parameters)
    assert (rank, unknowns) == (25, 27)
    named = set().union(*record.null_directions)
    assert {"delta_theta_5", "delta_d_5"} <= named
    assert named <= {"delta_theta_5", "delta_d_5", "delta_a_5", "delta_alpha_5", "target_T1_z"}
    assert full.fit.converged
    near = see("ur10", "point", count=40, targets_m=on_axis_m)
    assert fitted(full).deviations(near).distance_mm.max() < 0.15


def test_a_distance_shows_the_fixed_point_and_not_the_attitude_of_the_base(see):
    found = general("ur10", see("ur10", "distance", count=80, noise_m=NOISE_M))
    names = left_out(found)
    for turn in ("base_rx", "base_ry", "base_rz", "delta_theta_1"):
        assert set(names[turn]) <= {"base_x", "base_y", "base_z"}
        assert names[turn]
    assert names["delta_d_1"] == {"base_z": pytest.approx(1.0)}
    assert names["delta_a_6"] == {"target_x": pytest.approx(1.0)}


def test_parallel_axes_of_a_scara_say_the_same(see):
    names = left_out(general("gx4_351s", see("gx4_351s", "pose")))
    one = pytest.approx(1.0)
    assert names["tool_z"] == names["delta_d_4"] == {"base_z": one}
    assert names["delta_theta_1"] == {"base_rz": one}
    assert names["delta_theta_3"] == names["delta_theta_4"] == {"tool_rz": one}
    assert names["delta_a_3"] == {"delta_a_2": one}
    assert names["delta_a_4"] == {"tool_x": one}
    assert names["delta_alpha_4"] == {"tool_rx": one}
    assert len(names) == 8


@given(
    st.sampled_from(["pa10_6ce", "ur10", "irb120", "iiwa14", "gx4_351s"]), st.sampled_from(KINDS)
)
@examples(12)
def test_what_is_left_out_moves_what_says_the_same(see, robot, kind):
    """Said in full, and by no more than a few times as much."""
    found = general(robot, see(robot, kind, count=80))
    names = {p.name for p in found.problem.parameters} | set(found.settled)
    for name, replaced_by in left_out(found).items():
        assert replaced_by, name
        assert set(replaced_by) <= names
        assert max(map(abs, replaced_by.values())) < 4.0


def test_poses_in_one_plane_leave_no_length_astray(see):
    """All targets within a millimetre of a plane: whatever is open, nothing is metres off."""

    def posed(q_rad):
        q_rad[:, 0] = 0.2 + 1e-3 * q_rad[:, 0]
        q_rad[:, 4] = np.pi / 2
        q_rad[:, 5] = 0.1
        return q_rad

    observations = see("ur10", "point", count=80, noise_m=NOISE_M, posed=posed)
    assert isinstance(observations.measured, Points)
    record, full = case_of(UR10, observations)
    assert full.fit.converged
    assert record.null_directions
    off = full.fit.x / full.problem.scale
    links = ["delta" in parameter.name for parameter in full.problem.parameters]
    assert np.abs(off[links]).max() < 30.0
    again = see("ur10", "point", count=40, posed=posed)
    assert fitted(full).deviations(again).distance_mm.max() < 0.15


def one_orientation(q_rad):
    """Hold the tool of a UR10 upright and turned one way, wherever it goes."""
    q_rad[:, 3] = -0.5 * np.pi - q_rad[:, 1] - q_rad[:, 2]
    q_rad[:, 4] = -0.5 * np.pi
    q_rad[:, 5] = q_rad[:, 0]
    return q_rad


@pytest.mark.slow_but_one_in(7)
@pytest.mark.parametrize("kind", ["pose", "points"])
@pytest.mark.parametrize("noise_m", [2e-6, 5e-5])
@pytest.mark.parametrize("seed", [2, 3])
def test_a_tool_in_one_orientation(see, kind, noise_m, seed):
    seen = see("ur10", kind, noise_m=noise_m, posed=one_orientation, seed=seed)
    T = Chain.of(UR10).forward(seen.states.q_rad)
    np.testing.assert_allclose(T[:, :3, :3], T[:1, :3, :3].repeat(len(T), axis=0), atol=1e-9)
    record, full = case_of(UR10, seen)
    # Where the base is, and where the tool, is one number less; predictions do not know of it.
    assert full.fit.converged, full.fit.reason
    assert full.fit.identifiability.rank < len(full.problem.parameters)
    assert record.health.grade == "few_poses"
    assert "not identifiable with these poses" in record.health.line
    assert "the tool hardly turned" in record.health.line
    left = fitted(full).deviations(seen.turned(full.start.R_ee_target)).distance_mm
    assert np.sqrt(np.mean(left**2)) < 2e3 * noise_m
