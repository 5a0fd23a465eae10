"""The grade of a calibration, and the sentence that says what to do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pa10cal.calibration import departures
from pa10cal.calibration.accuracy import HeldOut
from pa10cal.calibration.departures import impossible_departures
from pa10cal.calibration.fit_summary import FitSummary, poses_needed
from pa10cal.calibration.grade_evidence import GradeEvidence
from pa10cal.calibration.health import RIGID
from pa10cal.calibration.health import health as health_of
from pa10cal.calibration.serial_correlation import SerialCorrelation
from pa10cal.files.arms import load_arm
from pa10cal.fit.problem import Solution, identify, not_identifiable
from pa10cal.observe.paths import HeldOutPlaces
from pa10cal.observe.quantities import Deviations
from pa10cal.results.calibration import InputFinding, RepeatScatter
from pa10cal.results.evaluation import Accuracy
from pa10cal.terms.term import TermParameter

NOISE_M = 1e-5


def ended(poses=40, unknowns=6, told=None, named="delta_a", at_bound=None, steps=None, **changes):
    """A linear fit of positions with so many unknowns, of which the rows tell some."""
    generator = np.random.default_rng(poses)
    told = unknowns if told is None else told
    position = generator.standard_normal((poses, 3, unknowns))
    position[:, :, told:] = 0.0
    parameters = tuple(TermParameter(f"{named}_{k}", "m", 1e-3) for k in range(1, unknowns + 1))
    white = position / NOISE_M
    found = identify(white.reshape(-1, unknowns), np.full(unknowns, 1e-3))
    flat = white[:, :, :told].reshape(-1, told)
    covariance = np.zeros((unknowns, unknowns))
    covariance[:told, :told] = np.linalg.inv(flat.T @ flat)
    roles = [named if named in ("weight", "target") else "link"] * unknowns
    departures = {f"delta_a_{k}": f"a_{k}" for k in range(1, unknowns + 1)}
    if at_bound is not None:
        parameters = (replace(parameters[0], name=at_bound), *parameters[1:])
        roles[0] = at_bound.partition("_")[0]
    held, stopped = np.arange(unknowns) < (at_bound is not None), steps or "settled"
    made = FitSummary(
        Solution(1e-4 * held, held, 0.0, 5, steps is None, stopped),
        np.arange(len(white)).astype(str), parameters, tuple(roles), departures,
        covariance, found, white, position,
        not_identifiable(found, parameters),
    )  # fmt: skip
    return replace(made, **changes)


@pytest.mark.parametrize(
    ("unseen", "trusted", "counted", "suspected"),
    [
        (None, [1, 1, 0, 1], 3, 1),
        ([1, 1, 0, 0], [1, 0, 0, 1], 1, 1),  # the one between that is suspected was never in it
        ([1, 1, 0, 0], [0, 0, 1, 1], 2, 0),  # where no unseen one is trusted all of them count
    ],
)
def test_held_out_poses_that_are_left_out_are_those_of_the_error(
    unseen, trusted, counted, suspected
):
    unseen, trusted = (each if each is None else np.array(each, bool) for each in (unseen, trusted))
    places = HeldOutPlaces() if unseen is None else HeldOutPlaces(unseen, ~unseen)
    errors, once = Deviations(np.ones(4), np.ones((4, 3)), None), np.ones(4, dtype=int)
    found = HeldOut.of(errors, places, trusted, once, once)
    assert (found.accuracy.configurations, found.suspected) == (counted, suspected)


def accuracy(mean_mm, peak_mm, rms_mm, configurations):
    """Errors of positions alone."""
    return Accuracy(
        mean_mm=mean_mm,
        peak_mm=peak_mm,
        rms_mm=rms_mm,
        orientation_deg=None,
        configurations=configurations,
    )


def errors(**changes):
    """What noise alone leaves."""
    left = HeldOut(accuracy(0.017, 0.03, 0.0173, 60))
    return replace(GradeEvidence(ended(), 0.0167, left, 0.0173, 500.0), **changes)


def health(fit, evidence):
    return health_of(replace(evidence, ended=fit))


def by_check(fit, evidence):
    """The checks of a calibration by what they ask."""
    return {each.check: each for each in health(fit, evidence).checks}


def repeats(found=1e-5, stated=1e-5, kind="position"):
    """What repeats show of the stated uncertainty."""
    return (RepeatScatter(kind=kind, found=found, stated=stated, pairs=100),)


def off(sizes, **fit):
    """A fit whose first parameters are so many tolerances off."""
    made = ended(**fit)
    x = np.zeros(len(made.parameters))
    x[: len(sizes)] = 1e-3 * np.array(sizes)
    with_tolerance = tuple(replace(each, tolerance=1e-3) for each in made.parameters)
    return replace(made, parameters=with_tolerance, solution=replace(made.solution, x=x))


def test_a_fit_down_to_the_noise_is_good():
    found = health(ended(), errors())
    assert found.grade == "good"
    assert "such an instrument can (rank 6)" in found.line
    assert "but for" not in found.line
    assert found.findings == ()
    alike = SerialCorrelation(1.0, 50.0)
    assert "of the base 100 poses tell as much" in health(ended(), errors(alike=alike)).line


def test_a_tilt_that_was_left_at_zero_is_not_called_determined():
    found = health(ended(), errors(not_shown=("delta_beta_2", "delta_beta_3")))
    assert found.grade == "good"
    said = "(rank 6) but for the tilts that these poses do not show, taken as zero: "
    assert f"{said}delta_beta_2, delta_beta_3" in found.line


GUESS = InputFinding(
    what="its sign is reversed",
    where="joint 6",
    remedy="correct the sign",
    would_leave_mm=0.02,
    kind="joint_sign",
)
AT_BOUNDS = "no parameter is at the end of its range"
REPEATS = "the stated uncertainty agrees with the scatter of repeats"
#: Checks of which one or more fail with a grade.
OF_GRADE = {
    "good": set(),
    "few_poses": {
        "everything that other poses could determine is determined",
        "predicted positions are certain enough",
    },
    "incomplete": {
        "noise explains the remaining error",
        "held-out poses agree with what the fit promises",
    },
    "suspect_input": {"nothing in the input is suspect", f"{REPEATS}, position"},
    "not_converged": {"the fit converged"},
}
BAD = HeldOut(accuracy(0.04, 0.1, 0.05, 60))


@pytest.mark.parametrize(
    ("fit", "left", "grade", "says"),
    [
        # good
        ({"at_bound": "windup_2"}, {}, "good", "rank 6"),
        ({"poses": 8}, {}, "good", "have a standard uncertainty of 0.009 mm"),
        ({"poses": 8}, {"wanted_mm": 0.01}, "good", "have a standard uncertainty of 0.009 mm"),
        ({"at_bound": "cubic_share_2"}, {}, "good", "K_cub_2 at the end"),
        ({}, {"suspected_outliers": 1}, "good", "1 suspected outlier; weights in the fit: tables/"),
        ({"told": 5, "hidden": frozenset({"delta_a_6"})}, {}, "good", "rank 5"),
        ({}, {"held_out": None}, "good", "fitted, as the noise explains"),
        ({}, {"repeats": repeats(1.3e-5)}, "good", "as the noise of 0.022 mm"),
        # Fewer readings behind a held-out pose let it scatter more.
        ({}, {"held_out": replace(BAD, repeats=0.1)}, "good", "0.050 mm over held-out"),
        ({}, {"held_out": replace(BAD, u_mm=0.05)}, "good", "0.050 mm over held-out"),
        # few_poses
        ({"told": 5}, {}, "few_poses", "not identifiable with these poses: delta_a_6"),
        ({"told": 3}, {}, "few_poses", "identify 3 of 6"),
        ({"told": 5, "named": "weight"}, {}, "few_poses", "state the mass of the tool"),
        ({"told": 5, "named": "target"}, {}, "few_poses", "are not seen in these poses"),
        ({"poses": 8}, {"wanted_mm": 0.006}, "few_poses", "more poses would reach 0.006 mm"),
        # incomplete
        ({}, {"noise_mm": 0.004}, "incomplete", "4.3 times the stated noise of 0.004 mm"),
        ({}, {"repeats": repeats(0.5e-5)}, "incomplete", "2 times the noise of 0.009 mm"),
        ({}, {"noise_mm": 0.01, "noise_is_found": True}, "incomplete", "missing an effect"),
        ({}, {"held_out": BAD}, "incomplete", "times the error that the fit promises"),
        # suspect_input
        ({}, {"train_rms_mm": 6.0}, "suspect_input", "does not fit the readings"),
        ({}, {"train_rms_mm": 6.0}, "suspect_input", "if the instrument errs by 6 mm, state its"),
        ({}, {"repeats": repeats(3.5e-5)}, "suspect_input", "0.01 mm is stated, repeats"),
        ({}, {"repeats": repeats(0.3e-5)}, "suspect_input", "repeats scatter by 0.003 mm"),
        ({}, {"noise_mm": 17.0}, "suspect_input", "it looks like micrometres, divide it by 1000"),
        ({}, {"noise_mm": 1.7e-5}, "suspect_input", "check its unit and value"),
        (
            {},
            {"findings": (GUESS,), "held_out": None},
            "suspect_input",
            "joint 6: its sign is reversed; correct",
        ),
        # not_converged
        ({"steps": "50 steps"}, {}, "not_converged", "converge: 50 steps"),
    ],
)
def test_the_rule(fit, left, grade, says):
    found = health(ended(**fit), errors(**left))
    assert found.grade == grade, found.line
    assert says in found.line
    assert bool(found.findings) == (grade == "suspect_input")
    fails = {each.check for each in found.checks if each.passes is False}
    assert bool(fails & OF_GRADE[grade]) == (grade != "good")
    assert grade != "good" or not fails


def test_a_check_answers_what_it_asks():
    assert "errs by" not in health(ended(), errors(train_rms_mm=6.0, repeats=repeats())).line
    suspect = by_check(ended(), errors(findings=(GUESS,), held_out=None))
    assert suspect["nothing in the input is suspect"].passes is False
    noise = suspect["noise explains the remaining error"]
    assert (noise.passes, noise.limit) == (True, "1.32 times")
    assert noise.found.endswith("0.99 times the stated noise of 0.017 mm")
    assert suspect["held-out poses agree with what the fit promises"].passes is None
    badly_held_out = by_check(ended(), errors(held_out=BAD))
    assert badly_held_out["noise explains the remaining error"].passes
    found = by_check(ended(), errors(repeats=repeats(0.5e-5)))
    assert "1.98 times the noise by repeats" in found["noise explains the remaining error"].found


def test_a_parameter_at_its_bound_has_no_part_in_the_grade():
    found = by_check(ended(at_bound="cubic_share_2"), errors())[AT_BOUNDS]
    assert (found.found, found.passes) == ("K_cub_2", None)


def test_nothing_is_promised_where_predictions_are_not_determined():
    found = by_check(ended(), errors(held_out=replace(BAD, u_mm=np.inf)))
    found = found["held-out poses agree with what the fit promises"]
    assert found.passes is None
    assert found.found == "0.050 mm rms, and predictions are not determined"


def test_identical_repeats_do_not_explain_what_remains():
    left = errors(noise_mm=0.0, noise_is_found=True)
    found = health(ended(), left)
    assert "explains" not in found.line
    assert "poses, and repeats do not differ at all, as copied readings do; " in found.line
    check = by_check(ended(), left)["noise explains the remaining error"]
    assert check.passes is None
    assert check.found == "0.017 mm, and repeats do not differ at all, as copied readings do"


def test_a_spring_at_its_rigid_end_is_at_no_end():
    found = health(ended(at_bound="windup_2"), errors())
    assert found.at_bounds == ("K_lin_2",)
    assert {each.check: each.passes for each in found.checks}[AT_BOUNDS]


def test_the_check_of_repeats_has_the_limits_of_the_grade():
    touched = by_check(ended(), errors(repeats=repeats(0.1e-5), from_touches=True))
    assert touched[f"{REPEATS}, position"].passes
    turned = by_check(ended(), errors(repeats=repeats(1e-4, kind="attitude")))
    assert turned[f"{REPEATS}, attitude"].passes


def test_distances_need_as_many_poses_as_there_are_unknowns():
    few = ended(poses=4, unknowns=9)
    one_a_pose = replace(few, white=few.white[:, :1])
    assert "measure at least 9 poses" in health(one_a_pose, errors()).line


def test_data_without_noise_are_graded():
    exact = errors(train_rms_mm=0.0, noise_mm=0.0, held_out=HeldOut(accuracy(0.0, 0.0, 0.0, 60)))
    assert exact.over_expected is None
    assert health(ended(), exact).grade == "few_poses"
    far = replace(exact, held_out=HeldOut(accuracy(1.0, 2.0, 1.0, 60)))
    assert replace(far, ended=ended()).over_expected > 10.0


def test_a_stated_uncertainty_that_is_too_small_is_among_the_causes_named():
    little = {"noise_mm": 0.0016, "without_springs_mm": 0.2}
    line = health(ended(), errors(**little)).line
    assert "or the stated uncertainty is too small" in line
    assert "soft arm" not in line  # of a hundredth of a millimetre nobody asks why it is accepted
    soft = {"train_rms_mm": 6.0, "held_out": None, "without_springs_mm": 12.0}
    found = health(ended(), errors(**soft, noise_mm=0.1))
    assert found.grade == "incomplete"
    assert "a soft arm: with rigid joints 12.000 mm remain" in found.line


def test_no_number_is_said_twice_and_few_poses_alarm_nobody():
    left = HeldOut(accuracy(0.016, 0.03, 0.01672, 60))
    line = health(ended(), errors(held_out=left)).line
    assert line.startswith("remaining error 0.017 mm rms over the poses fitted and over held-out")
    assert line.count("0.017") == 1
    few = health(ended(poses=8), errors(held_out=None, wanted_mm=0.006))
    assert few.grade == "few_poses"
    assert few.line.startswith("good: 0.009 mm standard uncertainty of predicted positions; ")
    worse = health(ended(poses=3, unknowns=8), errors(held_out=None, train_rms_mm=0.005))
    assert worse.grade == "few_poses"
    assert "more uncertain than single readings" in worse.line
    assert "1 more pose would reach 0.015 mm" in worse.line, worse.line
    wanted = health(ended(poses=8), errors(held_out=None, wanted_mm=0.006)).poses
    assert wanted.wanted_mm == wanted.u_needed_mm == 0.006
    assert health(ended(poses=8), errors(held_out=None)).poses.wanted_mm is None


@pytest.mark.parametrize(
    ("left", "says"),
    [
        ({"wanted_mm": 0.9999}, "hardly above the {0:.3f} mm required; 1 more pose would reach it"),
        ({}, "hardly above the {0:.3f} mm of single readings; 1 more pose would reach it"),
    ],
)
def test_an_uncertainty_hardly_above_the_one_required_names_it(left, says):
    few = ended(poses=8)
    u_mm = health(few, errors(held_out=None)).poses.u_model_mm
    wanted_mm = 0.9999 * u_mm
    if left:
        found = health(few, errors(held_out=None, wanted_mm=wanted_mm))
    else:
        single_mm = wanted_mm * np.sqrt(1.0 - 6.0 / 24.0)
        found = health(few, errors(held_out=None, train_rms_mm=single_mm, noise_mm=single_mm))
    assert found.grade == "few_poses"
    assert says.format(wanted_mm) in found.line


def test_the_worst_is_said_first():
    """What is wrong with the input explains an error left, and no fit explains anything."""
    lacking, suspect = {"noise_mm": 0.004}, {"findings": (GUESS,)}
    assert health(ended(told=5), errors(**lacking)).grade == "incomplete"
    assert health(ended(), errors(**lacking, **suspect)).grade == "suspect_input"
    stuck = ended(steps="50 steps")
    assert health(stuck, errors(**lacking, **suspect)).grade == "not_converged"


def test_a_fit_that_did_not_converge_keeps_what_the_checks_of_the_input_found():
    found = health(ended(steps="50 steps"), errors(findings=(GUESS, ZERO)))
    assert found.grade == "not_converged"
    assert found.findings == (GUESS, ZERO)
    assert found.line == (
        "the fit did not converge: 50 steps; check the input first: "
        f"{GUESS}; 1 more in health.findings"
    )
    assert found.departures == ()


ZERO = InputFinding(
    what="the zero of joint 3 is 2.1 deg off",
    where="joint 3",
    remedy="set joint_offsets_deg: [0, 0, 2.1]",
    kind="joint_zero",
    would_leave_mm=0.03,
    joint=3,
)


def mastered(off_rad):
    """A fit whose fourth joint has another zero than its description."""
    made = ended()
    first = replace(made.parameters[0], name="delta_theta_4", unit="rad", tolerance=5e-4)
    x = np.zeros(len(made.parameters))
    x[0] = off_rad
    parameters = (first, *made.parameters[1:])
    of = {"delta_theta_4": "theta_4"}
    solution = replace(made.solution, x=x)
    return replace(made, parameters=parameters, departures=of, solution=solution)


@pytest.mark.parametrize(
    ("slides", "coordinate", "joint", "says"),
    [
        (False, "theta_4", 4, "joint 4 was mastered 2 deg off ("),
        (False, "d_4", None, "34.9 mm from nominal ("),
        (True, "theta_4", None, "2 deg from nominal ("),
        (True, "d_4", 4, "joint 4 was mastered 34.9 mm off ("),
    ],
)
def test_the_zero_of_a_joint_is_along_its_axis_where_it_slides(slides, coordinate, joint, says):
    made, arm = mastered(np.radians(2.0)), load_arm("ur10")
    name, unit = f"delta_{coordinate}", "m" if coordinate[0] == "d" else "rad"
    parameters = (replace(made.parameters[0], name=name, unit=unit), *made.parameters[1:])
    made = replace(made, parameters=parameters, departures={name: coordinate})
    arm = replace(arm, prismatic=slides & (np.arange(arm.n) == 3))
    (found,) = impossible_departures(made, arm, 1.0)
    assert (found.where, found.joint) == (name, joint)
    assert found.what.startswith(says)


def test_departures_that_held_out_poses_confirm_are_what_was_found():
    found = health(mastered(np.radians(-1.99)), errors())
    assert found.grade == "good"
    assert found.findings == ()
    (zero,) = found.departures
    assert (zero.kind, zero.where) == ("departure", "delta_theta_4")
    assert "joint 4 was mastered 1.99 deg off (69 tolerances), as held-out" in found.line
    # So is a zero that a check of the input found, alone or beside it, and nothing else.
    both = health(mastered(np.radians(-1.99)), errors(findings=(ZERO,)))
    assert (both.grade, both.departures) == ("good", (ZERO, zero))
    found = health(ended(), errors(findings=(ZERO,)))
    assert found.departures == (ZERO,)
    assert f"as held-out poses confirm; {ZERO.remedy}" in found.line
    assert health(ended(), errors(findings=(ZERO,))).grade == "good"
    assert health(ended(), errors(findings=(GUESS,))).grade == "good"  # it leaves 0.02 mm
    better = GUESS.model_copy(update={"would_leave_mm": 0.001})
    assert health(ended(), errors(findings=(better,))).grade == "suspect_input"
    unheld = errors(findings=(GUESS,), held_out=None)
    assert health(ended(), unheld).grade == "suspect_input"


def test_where_none_are_held_out_poses_that_fit_to_the_noise_confirm_a_zero():
    fit, few = mastered(np.radians(-1.99)), HeldOut(accuracy(0.017, 0.03, 0.0173, 4))
    for held_out in (None, few):
        found = health(fit, errors(held_out=held_out))
        assert (found.grade, found.findings) == ("good", ())
        assert [each.where for each in found.departures] == ["delta_theta_4"]
        assert "(69 tolerances), as poses that fit to the noise show" in found.line
    for doubt in ({"train_rms_mm": 0.04}, {"train_rms_mm": 0.005}, {"noise_mm": None}):
        found = health(fit, errors(held_out=None, **doubt))
        assert (found.grade, found.departures) == ("suspect_input", ())
    taken = ended(poses=6, unknowns=12)
    x = np.where(np.arange(12) == 0, np.radians(-1.99), 0.0)
    parameters = (fit.parameters[0], *taken.parameters[1:])
    taken = replace(taken, parameters=parameters, departures=fit.departures)
    taken = replace(taken, solution=replace(taken.solution, x=x))
    assert health(taken, errors(held_out=None)).grade == "suspect_input"
    # A length of another arm is no matter of mastering.
    assert health(off([0.0, 200.0]), errors(held_out=None)).grade == "suspect_input"
    zero = health(ended(), errors(findings=(ZERO,), held_out=None))
    assert (zero.grade, zero.departures) == ("good", (ZERO,))


def test_what_confirms_a_zero_is_a_fit_that_ended_and_errors_that_predictions_promise():
    fit = mastered(np.radians(-1.99))
    stuck = replace(fit, solution=replace(fit.solution, converged=False, reason="50 steps"))
    found = health(stuck, errors())
    assert (found.grade, found.departures) == ("not_converged", ())
    assert "raise calibration.max_iterations" in found.line
    far = accuracy(0.05, 0.1, 0.05, 40)  # as far as predictions by few poses are uncertain
    for u_mm, grade in ((None, "suspect_input"), (0.045, "good")):
        assert health(fit, errors(held_out=HeldOut(far, u_mm))).grade == grade


def test_a_confirmed_zero_stays_beside_another_large_departure():
    fit = mastered(np.radians(-1.99))  # of joint 4
    found = health(fit, errors(findings=(ZERO,)))  # of joint 3
    assert [each.where for each in found.departures] == ["joint 3", "delta_theta_4"]
    here = {"where": "q4_deg", "what": "the zero of joint 4 is 2 deg off", "joint": 4}
    found = health(fit, errors(findings=(ZERO.model_copy(update=here),)))
    assert [each.where for each in found.departures] == ["q4_deg"]  # it says what to set


def test_a_spring_at_its_softest_is_no_rigid_joint():
    made = ended(at_bound="windup_2")
    soft = replace(made.parameters[0], lower=1e-7, upper=0.1)
    for windup_rad, said in ((0.1, True), (1e-7, False)):
        x = np.concatenate([[windup_rad], made.solution.x[1:]])
        solution = replace(made.solution, x=x)
        fit = replace(made, parameters=(soft, *made.parameters[1:]), solution=solution)
        assert ("at the end of the physical range" in health(fit, errors()).line) == said


@pytest.mark.parametrize(
    ("ratio", "turns", "says"),
    [
        (101.0, 1.0, ": 1 turn of a motor of ratio 101"),
        (101.0, -2.02, ": 2 turns of a motor of ratio 101"),
        (101.0, 1.4, "tolerances), as"),
        (np.nan, 1.0, "tolerances), as"),
    ],
)
def test_whole_turns_of_a_motor_are_told(ratio, turns, says):
    ratios = np.full(6, np.nan)
    ratios[3] = ratio
    fit = mastered(2.0 * np.pi / 101.0 * turns)
    arm = replace(load_arm("irb120"), gear_ratio=ratios)
    assert says in health(fit, errors(arm=arm)).line


def test_a_twist_beside_a_slide_is_no_turn_of_its_motor():
    arm = replace(load_arm("irb120"), gear_ratio=np.full(6, 101.0))
    assert departures._looks_like(arm, "theta_4", 2.0 * np.pi / 101.0, 1.0)
    slides = replace(arm, prismatic=np.arange(6) == 3)
    assert not departures._looks_like(slides, "theta_4", 2.0 * np.pi / 101.0, 1.0)


def test_a_length_of_the_wrong_sign_is_told():
    arm = load_arm("irb120")
    a_mm = 1e3 * arm.a_m[1]  # parameters here are of unit 1e-3
    assert a_mm > 100.0
    says = health(off([0.0, -2.05 * a_mm]), errors(arm=arm)).line
    assert f"as if the sign of its {a_mm:.4g} mm were wrong" in says
    assert "as if" not in health(off([0.0, -1.5 * a_mm]), errors(arm=arm)).line


def test_noise_that_is_stated_is_noise_however_large():
    # An arm of cameras: noise of 1.2 % of the spread, as stated.
    loud = {"train_rms_mm": 6.0, "noise_mm": 6.0, "held_out": HeldOut(accuracy(6.0, 9.0, 6.2, 60))}
    found = health(ended(), errors(**loud))
    assert found.grade == "good", found.line
    assert health(ended(), errors(**{**loud, "noise_mm": 1.5})).grade == "suspect_input"


@pytest.mark.parametrize("left_mm", [5e-3, 1e-7])
def test_less_than_the_stated_noise_is_no_mistake(left_mm):
    away = HeldOut(accuracy(left_mm, left_mm, left_mm, 60))
    found = health(ended(), errors(train_rms_mm=left_mm, held_out=away))
    assert found.grade == "good", found.line
    assert "the stated noise of 0.017 mm is larger than what remains" in found.line
    assert "more uncertain than single readings" not in found.line


def test_poses_far_from_the_model_count_in_the_error_that_is_printed():
    found = health(ended(), errors(suspected_outliers=2, all_rms_mm=0.031))
    assert (
        "remaining error 0.031 mm rms over the poses fitted (0.017 mm without 2 far" in found.line
    )
    assert RIGID not in found.line
    rigid = health(ended(), errors(suspected_outliers=2, all_rms_mm=0.031, rigid_outliers=2))
    assert f"in 2 of them {RIGID}" in rigid.line
    assert rigid.outliers_show == f"in 2 of them {RIGID}"
    assert not found.outliers_show


def test_a_nominal_arm_that_is_exact_is_said_so():
    assert "the nominal arm fits as well" in health(ended(), errors(nominal_mm=0.0170)).line
    assert "nominal" not in health(ended(), errors(nominal_mm=0.02)).line


@pytest.mark.parametrize(("forearm", "said"), [(2.9e-3, True), (-2.9e-3, False), (1e-3, False)])
def test_links_that_are_longer_by_one_share_hint_at_the_scale(forearm, said):
    arm, made = load_arm("ur10"), ended()
    x = arm.a_m * np.array([0.0, 3e-3, forearm, 0.0, 0.0, 0.0])
    longer = replace(made, solution=replace(made.solution, x=x))
    assert ("% longer than described" in health(longer, errors(arm=arm)).line) == said


def test_a_departure_that_no_arm_was_built_with():
    alone = errors(held_out=None)
    found = health(off([25.0, -90.0, 19.0]), alone)
    assert found.grade == "suspect_input"
    assert [each.where for each in found.findings] == ["delta_a_2", "delta_a_1"]
    assert "delta_a_2: -90 mm from nominal (90 tolerances)" in found.line
    assert "1 more in health.findings" in found.line
    assert health(off([19.0]), alone).grade == "good"
    # What the mounting of the apparatus may cause says nothing of the arm.
    mounted = replace(off([25.0]), of_mounting=frozenset({"delta_a_1"}))
    assert health(mounted, alone).grade == "good"


def test_a_touched_ball_may_be_stated_with_what_its_touches_share():
    touched = {"noise_is_found": True, "from_touches": True}
    assert health(ended(), errors(repeats=repeats(0.3e-5), **touched)).grade == "good"
    assert health(ended(), errors(repeats=repeats(1e-8), **touched)).grade == "suspect_input"


def test_an_attitude_is_held_to_its_unit_alone():
    for found, grade in ((1e-4, "good"), (5e-4, "suspect_input"), (1e-7, "suspect_input")):
        shown = repeats() + repeats(found, 1e-5, "attitude")
        assert health(ended(), errors(repeats=shown)).grade == grade


def test_repeats_that_scatter_more_than_stated_were_not_copied():
    line = health(ended(), errors(repeats=repeats(1e-4))).line
    assert "the load changed between repeats" in line
    assert "copied" not in line
    assert "were copied" in health(ended(), errors(repeats=repeats(1e-7))).line


def test_repeats_that_scatter_twice_as_stated_are_told():
    found = health(ended(), errors(repeats=repeats(2e-5)))
    assert "repeats scatter by 0.02 mm, 2 times what is stated" in found.line
    assert "repeats scatter" not in health(ended(), errors(repeats=repeats(1.2e-5))).line


def test_a_few_poses_promise_larger_errors_elsewhere():
    # Eight unknowns of twelve equations: residuals shrink to 0.58 of the errors.
    few = ended(poses=4, unknowns=8)
    train_rms_mm = 0.0173 * np.sqrt(1.0 - 8.0 / 12.0)
    seen = HeldOut(accuracy(0.02, 0.05, 0.0173, 60))
    found = health(few, errors(train_rms_mm=train_rms_mm, held_out=seen))
    assert "the fit promises" not in found.line


def test_the_first_poses_of_the_d_optimal_order_tell_more_than_any_others():
    made = ended(poses=30)
    found = poses_needed(made, 0.0)
    assert sorted(map(int, found.d_optimal_order)) == list(range(30))
    u_mm = [each.u_optimal_mm for each in found.expected]
    assert np.all(np.diff(u_mm) < 0.0)
    assert u_mm[-1] == pytest.approx(found.u_model_mm)
    (some,) = (each for each in found.expected if each.poses == 5)
    assert some.u_optimal_mm < some.u_measured_mm
    assert poses_needed(made, some.u_optimal_mm).needed == 5
    assert found.needed is None


def test_a_model_that_predicts_worse_without_its_torque_log_is_incomplete():
    found = health(ended(), errors(lost_without_log_mm=0.05))
    assert found.grade == "incomplete"
    assert "0.053 mm without the log, by the torques of the weights" in found.line
    check = by_check(ended(), errors(lost_without_log_mm=0.05))
    assert check["poses are predicted without the torque log as with it"].passes is False
    assert health(ended(), errors(lost_without_log_mm=0.005)).grade == "good"
    assert (
        health(ended(), errors()).checks == health(ended(), errors(lost_without_log_mm=0.0)).checks
    )
