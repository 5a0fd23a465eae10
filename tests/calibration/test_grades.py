"""Grades of real campaigns: of every arm and instrument, and of each grade one."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pa10cal
from calibrated import calibrated
from mended import write_simulated
from pa10cal.calibration.campaign import calibrated_record
from pa10cal.calibration.general import as_model, case
from pa10cal.calibration.load_case import LoadCase
from pa10cal.calibration.options import CalibrationOptions, EffectOfPlace
from pa10cal.discovery.given_record import record_with_effects
from pa10cal.discovery.preparation import setup_of
from pa10cal.evaluation.holdout import Evaluation
from pa10cal.files.arms import load_arm
from pa10cal.fit.weighed_arm import weighed_arm
from pa10cal.options import DiscoveryOptions
from pa10cal.results.calibration import UNRESERVED, InputFinding

RAW = Path(__file__).parents[2] / "data/raw"
#: An error of joint 2 once a turn, far beyond the noise.
ECCENTRIC = {"id": "encoder_eccentricity", "of": "joint 2", "parameters": {"A": 5e-4, "phi": 1.0}}

LACKS = "the model is missing an effect"
REVERSED = InputFinding(
    what="its sign is reversed",
    where="joint 6",
    remedy="reverse it",
    would_leave_mm=0.05,
    kind="joint_sign",
)
ONE_STEP = CalibrationOptions(max_iterations=1)


def measured(
    folder,
    robot="ur10",
    instrument="pose",
    poses=200,
    hidden=(),
    disturbances=(),
    stated_mm=None,
    **plan,
):
    raw = {
        "random_seed": 7,
        "robot": robot,
        "hidden_effects": list(hidden),
        "disturbances": list(disturbances),
        "without_touches": {"instrument": instrument, "poses": poses, **plan},
    } | ({} if stated_mm is None else {"stated_uncertainty_mm": stated_mm})
    return pa10cal.read_campaign(write_simulated(folder / "raw", raw))


@pytest.fixture
def campaign(tmp_path):
    return partial(measured, tmp_path)


@pytest.fixture(scope="module")
def unweighed(tmp_path_factory):
    """Return a campaign of an arm whose weights nobody stated, with those that its log shows."""
    drawn = {"poses": 60, "departs": "rows", "flexible_joints": (2, 3), "hardening": False}
    found = measured(tmp_path_factory.mktemp("unstated"), **drawn)
    bare = replace(found.arm, mass_kg=None, com_m=None)
    arm = weighed_arm(bare, found.observations, found.description.payload)
    return replace(found, arm=arm)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("instrument", "plan"), [("pose", {}), ("points", {"repeats": 3}), ("distance", {})]
)
def test_a_held_out_reading_that_is_wrong_does_not_count(campaign, instrument, plan):
    wrong = [{"id": "held_out_reading_off", "parameters": {"size_mm": 4.0}}]
    found = campaign(instrument=instrument, disturbances=wrong, departs="rows", **plan)
    model = pa10cal.calibrate(found)
    assert model.grade in ("good", "few_poses"), model.fitted_to.health
    assert "held-out poses without 1 with a suspected reading" in model.fitted_to.health
    setup = setup_of(found.description, found.arm, CalibrationOptions(), DiscoveryOptions())
    models = {"uncalibrated": model.nominal(), "linear": model}
    judged = Evaluation(found.observations, models, None, setup).judge()["linear"]
    assert judged.rms_mm > 2.0 * judged.trusted.rms_mm
    assert f", {judged.trusted.rms_mm:.3f} mm over held-out" in model.fitted_to.health


def turned(every, joint, angle_rad):
    """Return observations with another zero of one joint."""
    q_rad = every.states.q_rad.copy()
    q_rad[:, joint - 1] += angle_rad
    return every.with_states(replace(every.states, q_rad=q_rad))


def graded(found, every=None, **changes):
    every = found.observations if every is None else every
    model = calibrated(found.description, found.arm, every, **changes)
    return model.grade, model.fitted_to.health


@pytest.mark.slow
@pytest.mark.parametrize("instrument", ["pose", "points", "distance"])
@pytest.mark.parametrize("robot", ["ur10", "iiwa14", "irb120", "gx4_351s"])
@pytest.mark.parametrize("repeat_every", [0, 2])
def test_right_data_of_any_arm_are_not_suspected(campaign, robot, instrument, repeat_every):
    found = campaign(robot, instrument, departs="rows", repeat_every=repeat_every)
    grade, line = graded(found)
    assert grade in ("good", "few_poses"), line


def test_a_spring_that_poses_do_not_identify_decides_no_grade(unweighed, monkeypatch):
    """Under weights that nobody stated a spring is there where poses show it, or not at all."""
    known = as_model.not_identifiable
    monkeypatch.setattr(as_model, "not_identifiable", lambda *of: known(*of) | {"windup_2"})
    monkeypatch.setattr(as_model, "GRADES", replace(as_model.GRADES, shown_share=0.0))
    model = pa10cal.calibrate(unweighed)
    assert any(name == "windup_2" for name in (p.name for p in model.model.parameters))
    assert model.grade == "good", model.fitted_to.health


def test_uncertain_joints_move_an_arm_whose_weights_nobody_stated(unweighed):
    """How far they move it is told of poses with the torques of the weights that were fitted."""
    found = unweighed
    log = found.observations.log
    log = replace(log, q_u_rounded=np.full_like(log.q_u, 1e-6))
    every = replace(found.observations, log=log)
    assert pa10cal.calibrate(replace(found, observations=every)).grade == "good"


def test_a_length_that_is_known_well_beside_open_weights_decides_no_grade(unweighed, monkeypatch):
    """Directions of weights that nobody stated hold a little of a length that poses show well."""
    known = as_model.not_identifiable
    monkeypatch.setattr(as_model, "not_identifiable", lambda *of: known(*of) | {"delta_d_4"})
    assert pa10cal.calibrate(unweighed).grade == "good"
    monkeypatch.setattr(as_model, "GRADES", replace(as_model.GRADES, shown_share=0.0))
    assert pa10cal.calibrate(unweighed).grade == "few_poses"


@pytest.mark.slow
def test_touched_balls_at_their_noise_are_good():
    """What no instrument of that kind can determine does not count against a campaign."""
    model = pa10cal.calibrate(pa10cal.read_campaign(RAW / "cell-null"))
    assert model.grade == "good"
    assert "rank 34" in model.fitted_to.health


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_touched_balls_stated_in_another_unit(factor):
    found = pa10cal.read_campaign(RAW / "cell-null")
    every = found.observations
    stated = every.with_measured(cov=factor**2 * every.measured.cov)
    grade, line = graded(found, stated)
    assert grade == "suspect_input"
    assert "check the input: stated uncertainty of the position" in line


@pytest.mark.slow
def test_gross_errors_of_touched_balls_are_no_noise():
    found = pa10cal.read_campaign(RAW / "cell-null")
    every, generator = found.observations, np.random.default_rng(0)
    grid = np.flatnonzero(every.kind == "grid")
    wrong = generator.choice(grid, len(grid) // 50, replace=False)
    T = every.measured.T_instr_target.copy()
    T[wrong, :3, 3] += 5e-3 * generator.standard_normal((len(wrong), 3))
    grade, line = graded(found, every.with_measured(T_instr_target=T))
    assert grade == "suspect_input"
    assert "repeated poses" in line
    assert "a few readings are far from their repeats" in line


def test_few_poses_and_how_many_more(campaign):
    measured = campaign(poses=60, departs="rows")
    assert graded(measured)[0] == "good"
    grade, line = graded(measured, options=CalibrationOptions(wanted_uncertainty_mm=0.002))
    assert grade == "few_poses"
    assert line.startswith("good: 0.0")
    assert "more poses would reach" in line


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "repeat_every"), [(1e3, 0), (1e3, 2), (1e-3, 0), (1e-3, 2)])
def test_a_stated_uncertainty_in_another_unit(campaign, factor, repeat_every):
    found = campaign(stated_mm=0.05 * factor, departs="rows", repeat_every=repeat_every)
    grade, line = graded(found)
    assert grade == "suspect_input", line
    assert "check the input: stated uncertainty of the position" in line
    assert "check its unit" in line


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize(
    ("plan", "zero_rad", "case", "grade", "says"),
    [
        ({"hidden": [ECCENTRIC]}, 0.0, {}, "incomplete", ("times the stated noise of", LACKS)),
        ({}, np.radians(3.0), {}, "good", ("joint 3 was mastered", "as held-out poses confirm")),
        ({}, 0.0, {"findings": (REVERSED,)}, "suspect_input", (f"input: {REVERSED}",)),
        ({}, 0.0, {"options": ONE_STEP}, "not_converged", ("raise calibration.max_iterations",)),
    ],
    ids=["missing effect", "joint zero", "checks of the input", "not converged"],
)
def test_each_grade_and_what_it_says(campaign, plan, zero_rad, case, grade, says):
    found = campaign(departs="rows", **plan)
    given, line = graded(found, turned(found.observations, 3, zero_rad), **case)
    assert given == grade
    assert all(text in line for text in says), line


def test_noise_under_several_targets_is_that_of_one(campaign):
    """With effects too: components that were not seen had counted with a metre each."""
    found = campaign(instrument="points", hidden=[ECCENTRIC], departs="rows", targets=3)
    effects = (EffectOfPlace(id=ECCENTRIC["id"], of=ECCENTRIC["of"]),)
    about = found.description, found.arm, found.observations, "combined"
    case = LoadCase(*about, CalibrationOptions(effects=effects))
    without = calibrated_record(case)
    health = record_with_effects(effects, without, case, DiscoveryOptions()).health
    assert health.noise_mm == pytest.approx(without.health.noise_mm, rel=0.1)
    assert health.error_over_noise == pytest.approx(1.0, abs=0.15)
    # Weights that the poses do not show are no unknowns that lack poses.
    assert health.rank == health.unknowns == without.health.rank + 2
    assert health.grade in UNRESERVED


def test_a_model_takes_its_grade_along(campaign, tmp_path):
    model = pa10cal.calibrate(campaign(departs="rows"))
    model.save(tmp_path / "model.yaml")
    again = pa10cal.load_model(tmp_path / "model.yaml")
    assert again.grade == model.grade
    assert model.grade in UNRESERVED
    assert again.fitted_to.health == model.fitted_to.health
    assert f"{model.grade}: {model.fitted_to.health}" in again._repr_html_()
    assert not again.nominal().grade


def test_the_largest_turn_is_that_between_any_two_poses():
    T = np.tile(np.eye(4), (800, 1, 1))
    angles_rad = np.concatenate([[0.0], np.linspace(-0.08, 0.08, 799)])
    T[:, :3, :3] = Rotation.from_rotvec(np.outer(angles_rad, [0.0, 0.6, 0.8])).as_matrix()
    model = SimpleNamespace(nominal=lambda: SimpleNamespace(as_read=lambda _: T))
    assert case._turned_rad(model, None) == pytest.approx(0.16)


def test_a_joint_that_hardly_moved_is_named_with_where_it_stood():
    arm = load_arm("ur10")
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (30, 6))
    assert case._hardly_moved(arm, q) == ()
    q[:, 4] = np.radians(55.0)
    q[:, 3] *= 0.01
    moved, still = case._hardly_moved(arm, q)
    assert moved.startswith("joint 4, which stood between -0.")
    assert still == "joint 5, which stood at 55 deg in all"
