"""The general model: how many unknowns, which, how well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from made_up_model import case_of
from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import Payload
from pa10cal.calibration.general.calibrate import calibrate_general, find_start
from pa10cal.calibration.general.case import fitted, suspected_outliers
from pa10cal.calibration.options import CalibrationOptions, GeneralOptions
from pa10cal.errors import CalibrationError
from pa10cal.files.arms import load_arm
from pa10cal.observe.points import Points

KINDS = ("pose", "point", "points", "distance")


@pytest.fixture(scope="module")
def calibrated(see):
    found = {}

    def calibrate(robot, kind, **changes):
        key = (robot, kind, tuple(changes.items()))
        if key not in found:
            observations = see(robot, kind, **changes)
            arm = load_arm(robot)
            found[key] = calibrate_general(arm, observations, find_start(arm, observations))
        return found[key]

    return calibrate


# Four parameters a turning joint and six for the frames are complete and minimal (Everett, Driels
# and Mooring, 1987); a target of its own needs no orientation, a distance none of the base's
# either.
@pytest.mark.parametrize(
    ("kind", "unknowns"), [("pose", 30), ("point", 27), ("points", 33), ("distance", 24)]
)
@pytest.mark.parametrize("robot", ["pa10_6ce", "ur10", "irb120"])
def test_as_many_unknowns_as_arm_and_instrument_can_tell(calibrated, robot, kind, unknowns):
    found = calibrated(robot, kind)
    assert len(found.problem.parameters) == unknowns
    assert found.fit.identifiability.rank == unknowns


# Two a sliding joint.
@pytest.mark.parametrize(("robot", "unknowns"), [("iiwa14", 34), ("gx4_351s", 20)])
def test_sliding_and_further_joints_count_as_theory_says(calibrated, robot, unknowns):
    found = calibrated(robot, "pose")
    assert len(found.problem.parameters) == unknowns
    assert found.fit.identifiability.rank == unknowns


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("robot", ["pa10_6ce", "ur10", "iiwa14", "gx4_351s"])
def test_exact_data_are_explained_to_rounding(calibrated, robot, kind):
    found = calibrated(robot, kind)
    assert found.fit.converged
    assert np.abs(found.fit.residual).max() < 1e-9


@pytest.mark.parametrize("kind", KINDS)
def test_other_poses_are_predicted_as_well(calibrated, see, kind):
    model = fitted(calibrated("ur10", kind))
    assert model.deviations(see("ur10", kind, count=40)).distance_mm.max() < 1e-5


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_agree_with_differences(calibrated, kind):
    found = calibrated("ur10", kind)
    problem, x = found.problem, found.fit.x
    jacobian = problem.rows(x).jacobian
    for k, scale in enumerate(problem.scale):
        step = np.zeros(len(x))
        step[k] = 1e-3 * scale
        difference = (problem.residual(x + step) - problem.residual(x - step)) / (2e-3 * scale)
        assert jacobian[:, :, k] == pytest.approx(difference, abs=2e-8)


def test_what_is_left_out_says_what_others_say(calibrated):
    found = calibrated("ur10", "pose")
    names = {each.name for each in found.redundant}
    assert names == {
        "delta_a_6", "delta_alpha_6", "delta_d_1", "delta_d_6", "delta_theta_1", "delta_theta_6",
    }  # fmt: skip
    (first,) = (each for each in found.redundant if each.name == "delta_theta_1")
    assert first.replaced_by == {"base_rz": pytest.approx(1.0)}


def test_a_joint_that_never_moved_leaves_directions_open(see):
    observations, arm = see("ur10", "pose"), load_arm("ur10")
    q_rad = observations.states.q_rad.copy()
    still = see("ur10", "pose", size=0.0)
    q_rad[:, 2] = 0.4
    # Exact poses of the nominal arm with joint 3 held.
    held = still.with_states(replace(still.states, q_rad=q_rad))
    held = held.with_measured(T_instr_target=Chain.of(arm).forward(q_rad))
    record, _ = case_of(arm, held)
    assert record.rank < 30
    assert "delta_theta_3" in record.health.not_identifiable
    assert record.health.grade == "few_poses"
    assert "not identifiable" in record.health.line


def test_a_wrong_pose_is_listed_and_does_no_harm(see):
    arm = load_arm("ur10")
    observations = see("ur10", "point", count=120, noise_m=2e-5)
    good = calibrate_general(arm, observations, find_start(arm, observations))
    assert suspected_outliers(good.problem, good.fit) == ()
    assert isinstance(observations.measured, Points)
    p_instr_m = observations.measured.p_instr_m.copy()
    p_instr_m[17, 0, 1] += 3e-3
    spoilt = observations.with_measured(p_instr_m=p_instr_m)
    found = calibrate_general(arm, spoilt, find_start(arm, spoilt))
    (wrong,) = suspected_outliers(found.problem, found.fit)
    assert wrong.pose == "P0017"
    assert "mm" in wrong.why
    assert 0.0 < wrong.weight < 0.1
    assert len(found.fit.residual) == 120
    std = np.sqrt(np.diag(good.fit.covariance))
    # The base's motions start from elsewhere.
    arms = np.array([not p.name.startswith("base") for p in good.problem.parameters])
    assert np.abs((found.fit.x - good.fit.x) / std)[arms].max() < 1.0
    start, options = (
        find_start(arm, spoilt),
        CalibrationOptions(general=GeneralOptions(robust=False)),
    )
    plain = calibrate_general(arm, spoilt, start, None, options)
    assert np.abs((plain.fit.x - good.fit.x) / std)[arms].max() > 3.0


def test_scatter_beyond_the_stated_uncertainty_is_found(see):
    arm = load_arm("ur10")
    observations = see("ur10", "point", count=300, noise_m=1e-4)
    seen = observations.measured
    assert isinstance(seen, Points)
    bold = observations.with_measured(cov_m2=seen.cov_m2 / 100.0)
    found = calibrate_general(arm, bold, find_start(arm, bold))
    assert found.fit.scatter["position"] == pytest.approx(1e-4, rel=0.1)


def test_springs_without_torques_are_refused(see):
    arm, observations = load_arm("irb120"), see("irb120", "pose")
    start = find_start(arm, observations)
    with pytest.raises(CalibrationError, match="torques are not known"):
        calibrate_general(arm, observations, start, None, CalibrationOptions().with_springs((2,)))


def test_a_spring_that_nothing_loads_is_refused(see):
    arm, observations = load_arm("ur10"), see("ur10", "pose")
    payload = Payload(0.0, np.zeros(3), np.zeros(3), np.array([0.0, 0.0, -9.81]))
    with pytest.raises(CalibrationError, match="joint 1 is unloaded in all poses"):
        calibrate_general(
            arm,
            observations,
            find_start(arm, observations),
            payload,
            CalibrationOptions().with_springs((1, 2)),
        )


def test_torques_of_the_masses_stand_for_logged_ones(see):
    arm, observations = load_arm("ur10"), see("ur10", "pose")
    payload = Payload(0.0, np.zeros(3), np.zeros(3), np.array([0.0, 0.0, -9.81]))
    found = calibrate_general(arm, observations, find_start(arm, observations), payload)
    assert found.torques_from == "masses"
    assert set(found.springs) >= {2, 3}
    assert found.fit.at_bound.any()  # the arm that was seen is rigid


def test_too_few_poses_are_refused(see):
    arm, observations = load_arm("ur10"), see("ur10", "point", count=8)
    with pytest.raises(CalibrationError, match="fewer equations"):
        calibrate_general(arm, observations, find_start(arm, observations))


def test_nothing_seen_gives_no_row(see):
    observations = see("ur10", "points")
    found = observations.measured.compare(np.tile(np.eye(4), (60, 1, 1)), np.zeros(9))
    assert np.all(found.residual[::7, 3:6] == 0.0)
    assert np.all(found.by_end[::7, 3:6] == 0.0)


def test_axes_as_parallel_as_designed_are_left_so(see):
    arm = load_arm("ur10")
    tilted = see("ur10", "point", count=100, noise_m=5e-5)
    straight = see("ur10", "point", count=100, noise_m=5e-5, tilted=False)
    found = calibrate_general(arm, tilted, find_start(arm, tilted))
    assert found.settled == {}
    assert len(found.fit.x) == 27
    found = calibrate_general(arm, straight, find_start(arm, straight))
    assert list(found.settled) == ["delta_beta_2", "delta_beta_3"]
    assert all(1e-6 < each.std < 1e-4 for each in found.settled.values())
    assert len(found.fit.x) == found.fit.identifiability.rank == 25


def test_readings_of_another_arm_are_refused(see):
    arm, observations = load_arm("ur10"), see("ur10", "point", count=80, noise_m=5e-5)
    q_rad = observations.states.q_rad.copy()
    q_rad[:, 2] *= -1.0  # a sign turned round
    wrong = replace(observations, states=replace(observations.states, q_rad=q_rad))
    with pytest.raises(CalibrationError, match="does not fit the readings"):
        case_of(arm, wrong)
