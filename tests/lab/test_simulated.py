"""From the virtual cell to the estimator: as through files, and the truth in its coordinates."""

from dataclasses import fields, replace

import numpy as np
import pytest

from made_up_robot import track
from pa10cal.calibration.general.as_model import fitted
from pa10cal.calibration.general.calibrate import calibrate_general, find_start
from pa10cal.calibration.general.problem import choose_unknowns
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.campaign.read import read_campaign
from pa10cal.errors import CalibrationError
from pa10cal.files.arms import load_arm
from pa10cal_lab.cell.individual import draw_individual
from pa10cal_lab.cell.options import TrackerOptions
from pa10cal_lab.cell.write import write_campaign
from pa10cal_lab.coverage import coverage, coverage_by_class, coverage_by_parameter, titles_of
from pa10cal_lab.options import CoverageCaseOptions, CoverageOptions
from pa10cal_lab.simulated import (
    class_of,
    draw_by_unknowns,
    exact_observations,
    measure,
    observations_of,
    parameter_scores,
    payload_of_individual,
    prediction_scores,
)

#: Noise so small that anything but the right coordinates of the truth would show.
SHARP = {"position_mm": 1e-5, "attitude_rad": 1e-8, "unseen_share": 0.0}


@pytest.mark.parametrize("instrument", ["pose", "points", "distance"])
def test_a_campaign_in_memory_is_the_one_of_its_files(tmp_path, instrument):
    arm = load_arm("gx4_351s")
    plan = TrackerOptions(instrument=instrument, poses=12, holdout_share=0.0, targets=2)
    made = track(arm, plan, 5)
    write_campaign(made, tmp_path / "raw")
    read = read_campaign(tmp_path / "raw").calibration
    found = observations_of(made)
    assert list(found.pose) == list(read.pose)
    assert found.states.q_rad == pytest.approx(read.states.q_rad, abs=1e-8)
    for field in fields(read.measured):
        ours, theirs = getattr(found.measured, field.name), getattr(read.measured, field.name)
        if field.name in ("name", "names") or theirs is None:
            assert ours == theirs
        else:
            assert ours == pytest.approx(theirs, abs=2e-8, rel=2e-3, nan_ok=True)


def drawn(arm, plan):
    """Return a robot drawn in the coordinates of the model, and what is seen of it."""
    first = observations_of(track(arm, plan, 3))
    start = find_start(arm, first)
    unknowns = choose_unknowns(arm, CalibrationOptions().tolerances, first.measured, start)
    individual = draw_by_unknowns(arm, plan, unknowns, np.random.default_rng(4))
    seen = observations_of(measure(individual, plan, 4))
    return individual, seen


@pytest.mark.slow_but_one_in(2)
@pytest.mark.parametrize(
    ("robot", "plan"),
    [
        ("iiwa14", {"instrument": "pose"}),
        ("gx4_351s", {"instrument": "pose"}),
        ("gx4_351s", {"instrument": "points", "targets": 1}),
        ("ur10", {"instrument": "points", "targets": 1}),
        ("ur10", {"instrument": "distance"}),
        ("ur10", {"instrument": "pose", "flexible_joints": (2, 3), "hardening": False}),
    ],
)
def test_the_truth_is_stated_in_the_coordinates_of_the_model(robot, plan):
    arm = load_arm(robot)
    plan = TrackerOptions(
        poses=60, holdout_share=0.0, states_targets=False, target_m=0.05, target_rad=1.0,
        **SHARP, **plan,
    )  # fmt: skip
    individual, seen = drawn(arm, plan)
    found = calibrate_general(
        arm,
        seen,
        find_start(arm, seen),
        payload_of_individual(individual),
        CalibrationOptions().with_springs(plan.flexible_joints),
    )
    scores = parameter_scores(found, individual)
    assert len(scores) == len(found.problem.parameters)
    std = dict(
        zip([p.name for p in found.problem.parameters], np.diag(found.fit.covariance), strict=True)
    )
    # Springs act in the posture that they leave, which the estimator takes from the motors.
    off = {name: score * np.sqrt(std[name]) for name, score in scores.items()}
    allowed = 2e-5 if plan.flexible_joints else 2e-7
    assert {name: value for name, value in off.items() if abs(value) > allowed} == {}
    if not plan.flexible_joints:
        assert max(map(abs, scores.values())) < 5.0


def test_predictions_of_an_arm_off_in_any_way_are_held_to_what_it_does():
    arm = load_arm("ur10")
    plan = TrackerOptions(instrument="points", targets=1, poses=60, holdout_share=0.0)
    individual = draw_individual(arm, plan, np.random.default_rng(1))
    seen = observations_of(measure(individual, plan, 1))
    found = calibrate_general(arm, seen, find_start(arm, seen))
    scores = prediction_scores(found, exact_observations(individual, plan, 50, 2))
    assert scores.shape == (150,)
    assert 0.4 < np.sqrt(np.mean(scores**2)) < 1.8
    other = draw_individual(arm, plan, np.random.default_rng(2))
    assert np.abs(prediction_scores(found, exact_observations(other, plan, 50, 2))).mean() > 10.0


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("delta_a_2", "lengths"),
        ("delta_alpha_2", "angles"),
        ("delta_theta_10", "angles"),
        ("base_rz", "base"),
        ("target_T1_x", "targets"),
        ("windup_3", "springs"),
    ],
)
def test_parameters_have_a_class(name, kind):
    assert class_of(name) == kind


def test_weights_pull_at_the_posture_in_which_the_arm_stands():
    """At the nominal posture they would leave 3.6 um of all but exact poses, and bend springs."""
    arm = load_arm("ur10")
    plan = TrackerOptions(
        poses=60, holdout_share=0.0, states_targets=False, instrument="pose",
        flexible_joints=(2, 3), hardening=False, **SHARP,
    )  # fmt: skip
    individual, seen = drawn(arm, plan)
    unlogged = replace(seen.states, tau_Nm=np.full_like(seen.states.tau_Nm, np.nan))
    seen = seen.with_states(unlogged)
    found = calibrate_general(
        arm,
        seen,
        find_start(arm, seen),
        payload_of_individual(individual),
        CalibrationOptions().with_springs(plan.flexible_joints),
    )
    assert found.torques_from == "masses"
    off_m = np.linalg.norm(found.fit.residual[:, :3], axis=1)
    assert np.sqrt(np.mean(off_m**2)) < 5e-8
    model = fitted(found)
    assert model.deviations(model.as_modelled(seen)).distance_mm.mean() < 5e-5
    report = model.parameters.set_index("parameter").value
    for joint in plan.flexible_joints:
        stiffness = individual.springs.k_lin[joint - 1]
        assert report[f"K_lin_{joint}"] == pytest.approx(stiffness, rel=1e-5)


# Do intervals hold what they promise?


def test_normal_scores_are_covered_as_promised():
    found = coverage(np.random.default_rng(0).standard_normal((400, 10)))
    assert found.inside == pytest.approx(0.95, abs=0.01)
    assert found.inside_interval95[0] < 0.95 < found.inside_interval95[1]
    assert found.rms == pytest.approx(1.0, abs=0.03)


def test_scores_of_one_campaign_count_as_one():
    """Ten copies of a score are no more evidence than one."""
    one = np.random.default_rng(1).standard_normal((50, 1))
    alone, copied = coverage(one), coverage(np.repeat(one, 10, axis=1))
    assert alone.inside_interval95 == pytest.approx(copied.inside_interval95)


def test_campaigns_count_alike_in_the_share_and_scores_in_the_rms():
    scores = np.full((2, 100), np.nan)
    scores[0], scores[1, 0] = 0.0, 5.0
    assert coverage(scores).inside == 0.5
    assert coverage(scores).rms == pytest.approx(np.sqrt(25.0 / 101.0))


def test_a_score_that_is_not_there_counts_neither_way():
    scores = np.random.default_rng(2).standard_normal((60, 4))
    scores[::3, 1] = np.nan
    found, second = coverage(scores), coverage_by_parameter("abcd", scores)["b"]
    there = np.delete(scores[:, 1], np.arange(0, 60, 3))
    assert second.inside == pytest.approx(np.mean(np.abs(there) < 1.96))
    assert second.rms == pytest.approx(np.sqrt(np.mean(there**2)))
    assert np.isfinite([found.inside, *found.inside_interval95, found.rms]).all()


def test_a_campaign_without_intervals_does_not_count():
    scores = np.random.default_rng(2).standard_normal((60, 4))
    scores[:5] = np.nan
    assert coverage(scores) == coverage(scores[5:])
    assert coverage(scores).counted == 55
    with pytest.raises(CalibrationError, match="nothing has an interval in any campaign"):
        coverage(scores[:5])


def test_campaigns_that_are_alike_leave_the_share_uncertain():
    scores = np.zeros((20, 7))
    low, high = coverage(scores).inside_interval95
    assert 0.8 < low < 0.87  # twenty of twenty: at least 0.83
    assert high == 1.0
    scores[:, 0] = 9.0
    low, high = coverage(scores).inside_interval95
    assert low < 0.7
    assert 0.93 < high < 1.0
    assert coverage(scores[:1]).inside_interval95 == (0.0, 1.0)


def test_what_has_no_finite_score_has_no_interval():
    scores = np.random.default_rng(0).standard_normal((40, 3))
    scores[0, 0] = np.inf
    scores[:, 2] = np.nan
    assert coverage(scores).rms < 2.0
    found = coverage_by_parameter("abc", scores)
    assert list(found) == ["a", "b"]
    assert found["a"].rms == pytest.approx(np.sqrt(np.mean(scores[1:, 0] ** 2)))
    assert list(coverage_by_class(["angles", "angles", "tool"], scores)) == ["angles"]


def test_cases_of_a_study_of_coverage_have_titles_of_their_own():
    def case(**changes):
        return CoverageCaseOptions(**{"robot": "ur10", "instrument": "pose"} | changes)

    assert titles_of(
        [
            case(flexible_joints=(2,)),
            case(flexible_joints=(3, 4)),
            case(instrument="points", targets=3, flexible_joints=(2,)),
        ]
    ) == ["ur10, pose, springs 2", "ur10, pose, springs 3 4", "ur10, 3 targets, springs"]
    with pytest.raises(ValueError, match="each case once"):
        CoverageOptions(cases=[case(), case()])
    with pytest.raises(ValueError, match="each joint once"):
        case(flexible_joints=(2, 2))
    with pytest.raises(ValueError, match="an instrument of distance sees one target"):
        case(instrument="distance", targets=3)
